/* Many robots with states, inputs and parameters of their own, integrated over short segments by the classical
   Runge-Kutta method of order four. */

#include <math.h>
#include <stdint.h>

#if defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT __declspec(dllexport)
#endif

/* (x, u, p) -> x', written by CasADi: no workspace of its own where `w` is NULL. */
typedef int (*function)(const double **arguments, double **results, long long *iw, double *w, int memory);

typedef struct {
    function rate;
    long long *iw;
    double *w;
    int64_t n, n_u, n_p, n_y; /* states, inputs, parameters, outputs */
    int64_t lanes, samples;   /* of each segment: outputs at samples 0 to `samples` */
    int64_t steps;            /* from one sample to the next */
    double step;              /* s */
    const double *start;      /* (lanes, n) */
    const double *input;      /* (sets, samples * steps, 3, n_u): at the start, middle and end of each step */
    const int64_t *set;       /* (lanes): which input */
    const double *offset;     /* (lanes, n_u): added to the input */
    const double *parameters; /* (lanes, n_p) */
    const double *rows;       /* (n_y, n): of the outputs */
    double *output;           /* (lanes, samples + 1, n_y) */
    double *memory;           /* 6 n + n_u */
} segments;

static void segments_show(const segments *s, const double *x, double *y)
{
    for (int64_t i = 0; i < s->n_y; i++) {
        double sum = 0.0;
        for (int64_t j = 0; j < s->n; j++)
            sum += s->rows[i * s->n + j] * x[j];
        y[i] = sum;
    }
}

/* Returns the number of lanes whose state is not finite at their end. */
EXPORT int64_t segments_run(const segments *s)
{
    const int64_t n = s->n, n_u = s->n_u, all = s->samples * s->steps;
    double *x = s->memory, *k = x + n, *at = k + 4 * n, *u = at + n, h = s->step;
    int64_t failed = 0;
    for (int64_t lane = 0; lane < s->lanes; lane++) {
        const double *inputs = s->input + s->set[lane] * all * 3 * n_u, *offset = s->offset + lane * n_u;
        double *y = s->output + lane * (s->samples + 1) * s->n_y, sum = 0.0;
        for (int64_t i = 0; i < n; i++)
            x[i] = s->start[lane * n + i];
        segments_show(s, x, y);
        for (int64_t step = 0; step < all; step++) {
            for (int stage = 0; stage < 4; stage++) {
                const double *from = inputs + (step * 3 + (stage + 1) / 2) * n_u;
                const double ahead = stage == 0 ? 0.0 : stage == 3 ? h : h / 2;
                const double *arguments[3] = {at, u, s->parameters + lane * s->n_p};
                double *results[1] = {k + stage * n};
                for (int64_t i = 0; i < n_u; i++)
                    u[i] = from[i] + offset[i];
                for (int64_t i = 0; i < n; i++)
                    at[i] = stage ? x[i] + ahead * k[(stage - 1) * n + i] : x[i];
                s->rate(arguments, results, s->iw, s->w, 0);
            }
            for (int64_t i = 0; i < n; i++)
                x[i] += h / 6 * ((k[i] + k[3 * n + i]) + 2 * (k[n + i] + k[2 * n + i]));
            if ((step + 1) % s->steps == 0)
                segments_show(s, x, y += s->n_y);
        }
        for (int64_t i = 0; i < n; i++)
            sum += 0.0 * x[i];
        failed += sum != 0.0;
    }
    return failed;
}
