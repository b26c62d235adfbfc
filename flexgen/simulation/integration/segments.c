/*
 * Many robots with states, inputs and parameters of their own, integrated over short segments by
 * the classical Runge-Kutta method of order four, LANES of them at once. RATE(x, u, p, x', w) and
 * OUTPUT(x, u, p, y, w), and what is before them, are written by
 * `flexgen.codegen.build.lanes_module`.
 */

#if defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT __declspec(dllexport)
#endif

#define WORK (RATE_WORK > OUTPUT_WORK ? RATE_WORK : OUTPUT_WORK)

typedef struct {
    int64_t n, n_u, n_p, n_y; /* states, inputs, parameters, outputs */
    int64_t robots, samples;  /* of each segment: outputs at samples 0 to `samples` */
    int64_t steps;            /* from one sample to the next */
    double step;              /* s */
    int64_t states;           /* outputs are the states, n_y = n of them */
    const double *start;      /* (robots, n) */
    /* (sets, samples * steps, 3, n_u): at the start, middle and end of each step */
    const double *input;
    const int64_t *set;       /* (robots): which input */
    const double *offset;     /* (robots, n_u): added to the input */
    const double *parameters; /* (robots, n_p) */
    double *output;           /* (robots, samples + 1, n_y) */
    double *memory;           /* `segments_memory` */
} segments;

/* Numbers of the working memory. */
EXPORT int64_t segments_memory(const segments *s)
{
    return LANES * (6 * s->n + 2 * s->n_u + s->n_p + s->n_y + WORK + 1);
}

/* Robots that are computed at once. */
EXPORT int64_t segments_lanes(void)
{
    return LANES;
}

/* Rows of `count` numbers, one row a lane, as vectors; entries are `apart` from row to row. */
static void load_rows(const double *from, int64_t first, int64_t last, int64_t count, double *to)
{
    for (int64_t l = 0; l < LANES; ++l) {
        const double *row = from + (first + l < last ? first + l : last) * count;
        for (int64_t i = 0; i < count; ++i) {
            to[i * LANES + l] = row[i];
        }
    }
}

/* The inputs of all lanes at an instant. */
static void load_inputs(const double *const *from, ptrdiff_t at, int alike, int64_t n_u,
    const double *offset, double *u)
{
    for (int64_t i = 0; i < n_u; ++i) {
        lanes now = splat_v(from[0][at + i]);
        for (int l = 1; l < LANES && !alike; ++l) {
            ((double *)&now)[l] = from[l][at + i];
        }
        store_v(u + i * LANES, now + load_v(offset + i * LANES));
    }
}

/*
 * The segments of the robots `first` to `last` - 1, at most LANES; returns how many states are not
 * finite at the end. /
 */
static int64_t run_lanes(const segments *s, int64_t first, int64_t last)
{
    const int64_t n = s->n, n_u = s->n_u, all = s->samples * s->steps;
    const double halves[4] = {0.0, s->step / 2, s->step / 2, s->step};
    double *x = (double *)aligned_1(s->memory), *k = x + n * LANES, *at = k + 4 * n * LANES,
           *u = at + n * LANES;
    double *offset = u + n_u * LANES, *p = offset + n_u * LANES, *y = p + s->n_p * LANES;
    lanes *w = (lanes *)(y + s->n_y * LANES);
    const double *from[LANES];
    int64_t failed = 0, sample = 0;
    int alike = 1;
    load_rows(s->start, first, last - 1, n, x);
    load_rows(s->offset, first, last - 1, n_u, offset);
    load_rows(s->parameters, first, last - 1, s->n_p, p);
    for (int64_t l = 0; l < LANES; ++l) {
        from[l] = s->input + s->set[first + l < last ? first + l : last - 1] * all * 3 * n_u;
        alike = alike && from[l] == from[0];
    }
    for (int64_t step = 0;; ++step) {
        load_inputs(
            from, step < all ? step * 3 * n_u : (all * 3 - 1) * n_u, alike, n_u, offset, u);
        if (step == sample * s->steps) {
            const double *shown = x;
            if (!s->states) {
                OUTPUT(x, u, p, y, w);
                shown = y;
            }
            for (int64_t lane = first; lane < last; ++lane) {
                double *to = s->output + (lane * (s->samples + 1) + sample) * s->n_y;
                for (int64_t i = 0; i < s->n_y; ++i) {
                    to[i] = shown[i * LANES + (lane - first)];
                }
            }
            ++sample;
        }
        if (step == all) {
            break;
        }
        for (int stage = 0; stage < 4; ++stage) {
            const lanes ahead = splat_v(halves[stage]);
            const double *rate = stage == 0 ? k : k + (stage - 1) * n * LANES;
            if (stage % 2 == 1) {
                load_inputs(from, (step * 3 + (stage + 1) / 2) * n_u, alike, n_u, offset, u);
            }
            for (int64_t i = 0; i < n * LANES; i += LANES) {
                const lanes now = load_v(x + i);
                if (stage == 0) {
                    store_v(at + i, now);
                } else {
                    store_v(at + i, now + ahead * load_v(rate + i));
                }
            }
            RATE(at, u, p, k + stage * n * LANES, w);
        }
        for (int64_t i = 0; i < n * LANES; i += LANES) {
            const double *rate = k + i;
            const lanes outer = load_v(rate) + load_v(rate + 3 * n * LANES);
            const lanes inner = load_v(rate + n * LANES) + load_v(rate + 2 * n * LANES);
            store_v(x + i, load_v(x + i) + splat_v(s->step / 6) * (outer + splat_v(2.0) * inner));
        }
    }
    for (int64_t lane = first; lane < last; ++lane) {
        for (int64_t i = 0; i < n; ++i) {
            failed += !isfinite(x[i * LANES + (lane - first)]);
        }
    }
    return failed;
}

/*
 * The segments of the robots `first` to `last` - 1; returns how many states are not finite at the
 * end.
 */
EXPORT int64_t segments_run(const segments *s, int64_t first, int64_t last)
{
    int64_t failed = 0;
    for (; first < last; first += LANES) {
        failed += run_lanes(s, first, first + LANES < last ? first + LANES : last);
    }
    return failed;
}
