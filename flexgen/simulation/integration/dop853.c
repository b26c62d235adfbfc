/*
 * Explicit Runge-Kutta method of order 8 by Dormand and Prince with dense output of order 7, for
 * x' = f(x, u(t)) with a piecewise polynomial input u. The steps are those of scipy's DOP853.
 * With motor feedback (n_m > 0) the input is (torques, reference angles, reference speeds), and
 * the state ends with the integrals of w:  w = v_ref + position_gain (q_ref - q) - v,    u = tau_m
 * + speed_gain (w + integral_gain int w dt)  Source: E. Hairer, S. Norsett, G. Wanner, Solving
 * Ordinary Differential Equations I, 1993, sec. II.5 and II.10.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { STAGES = 12, ALL = 16, DENSE = 7 };
enum { DONE, MORE, STEP_TOO_SMALL, NOT_FINITE };

/* A function in C by CasADi: no workspace of its own where `w` is NULL. */
typedef int (*function)(
    const double **arguments, double **results, long long *iw, double *w, int memory);

typedef struct {
    function rate;     /* (x, u) -> x', without the integrals of the feedback */
    long long *iw;     /* workspace of the function */
    double *w;         /* the same, reals */
    int64_t n, n_u;    /* entries of the state and of the input */
    int64_t pieces, k; /* of the input: polynomials, and coefficients of each */
    /* (pieces + 1), (pieces, k, n_u): highest power first, about the left break */
    const double *breaks, *coefficients;
    double rtol;
    const double *atol; /* (n) */
    /* the tableau: A and C with the three stages for dense output */
    const double *A, *B, *C, *E3, *E5, *dense;
    /* of the feedback: motors, and coordinates; n_m = 0: none */
    int64_t n_m, dof;
    /* motor angles from coordinates (n_m, dof); gains (3, n_m) */
    const double *rows, *gains;
} problem;

/*
 * Where the integration is; memory: (ALL + 4 + DENSE) * n + n_u, kept between calls. The first n
 * are the state.
 */
typedef struct {
    double t, step;
    int64_t evaluations, piece, begun;
    double *memory;
} position;

static void input(const problem *p, position *s, double t, double *u)
{
    int64_t i = s->piece;
    while (i + 1 < p->pieces && t >= p->breaks[i + 1])
        i++;
    while (i > 0 && t < p->breaks[i])
        i--;
    s->piece = i;
    const double *c = p->coefficients + i * p->k * p->n_u, x = t - p->breaks[i];
    for (int64_t j = 0; j < p->n_u; j++)
        u[j] = c[j];
    for (int64_t m = 1; m < p->k; m++) {
        c += p->n_u;
        for (int64_t j = 0; j < p->n_u; j++)
            u[j] = u[j] * x + c[j];
    }
}

/*
 * Add the torques of the feedback to the first n_m inputs, and write w behind the rates of the
 * robot.
 */
static void add_feedback(const problem *p, const double *x, double *u, double *out)
{
    const int64_t n_m = p->n_m;
    const double *integrals = x + p->n - n_m, *position = p->gains, *speed = position + n_m,
                 *integral = speed + n_m;
    for (int64_t j = 0; j < n_m; j++) {
        double q = 0.0, v = 0.0;
        for (int64_t i = 0; i < p->dof; i++) {
            q += p->rows[j * p->dof + i] * x[i];
            v += p->rows[j * p->dof + i] * x[p->dof + i];
        }
        const double w = u[2 * n_m + j] + position[j] * (u[n_m + j] - q) - v;
        u[j] += speed[j] * (w + integral[j] * integrals[j]);
        out[p->n - n_m + j] = w;
    }
}

static void evaluate(
    const problem *p, position *s, double t, const double *x, double *u, double *out)
{
    const double *arguments[2] = {x, u};
    double *results[1] = {out};
    input(p, s, t, u);
    if (p->n_m > 0)
        add_feedback(p, x, u, out);
    p->rate(arguments, results, p->iw, p->w, 0);
    s->evaluations++;
}

/* x + h sum_j a_j K_j, j < count */
static void combined(
    int64_t n, const double *x, double h, const double *a, int count, const double *K, double *out)
{
    for (int64_t i = 0; i < n; i++)
        out[i] = K[i] * a[0];
    for (int j = 1; j < count; j++) {
        const double *Kj = K + j * n, aj = a[j];
        if (aj == 0.0)
            continue;
        for (int64_t i = 0; i < n; i++)
            out[i] += Kj[i] * aj;
    }
    for (int64_t i = 0; i < n; i++)
        out[i] = x[i] + h * out[i];
}

static double rms(int64_t n, const double *x, const double *scale)
{
    double sum = 0.0;
    for (int64_t i = 0; i < n; i++)
        sum += x[i] / scale[i] * (x[i] / scale[i]);
    return sqrt(sum / (double)n);
}

static double first_step(const problem *p, position *s, double end, double *x, double *f,
    double *a, double *b, double *u)
{
    const int64_t n = p->n;
    double *scale = b;
    for (int64_t i = 0; i < n; i++)
        scale[i] = p->atol[i] + fabs(x[i]) * p->rtol;
    const double d0 = rms(n, x, scale), d1 = rms(n, f, scale), span = end - s->t;
    double h0 = d0 < 1e-5 || d1 < 1e-5 ? 1e-6 : 0.01 * d0 / d1;
    if (h0 > span)
        h0 = span;
    double *moved = a, *rate = a + n;
    for (int64_t i = 0; i < n; i++)
        moved[i] = x[i] + h0 * f[i];
    evaluate(p, s, s->t + h0, moved, u, rate);
    for (int64_t i = 0; i < n; i++)
        rate[i] -= f[i];
    const double d2 = rms(n, rate, scale) / h0, larger = d1 > d2 ? d1 : d2;
    const double h1 = larger <= 1e-15 ? (h0 * 1e-3 > 1e-6 ? h0 * 1e-3 : 1e-6) :
                                        pow(0.01 / larger, 1.0 / 8.0);
    double h = 100 * h0 < h1 ? 100 * h0 : h1;
    return h < span ? h : span;
}

static double error_norm(const problem *p, const double *K, double h, const double *scale)
{
    double sum5 = 0.0, sum3 = 0.0;
    for (int64_t i = 0; i < p->n; i++) {
        double e5 = 0.0, e3 = 0.0;
        for (int j = 0; j <= STAGES; j++) {
            e5 += K[j * p->n + i] * p->E5[j];
            e3 += K[j * p->n + i] * p->E3[j];
        }
        e5 /= scale[i], e3 /= scale[i];
        sum5 += e5 * e5, sum3 += e3 * e3;
    }
    if (sum5 == 0.0 && sum3 == 0.0)
        return 0.0;
    return fabs(h) * sum5 / sqrt((sum5 + 0.01 * sum3) * (double)p->n);
}

/* The polynomials of the dense output over a step from (t, x) to `next`: (DENSE, n). */
static void prepare_dense(const problem *p, position *s, double h, const double *x,
    const double *next, double *K, double *stage, double *u, double *F)
{
    const int64_t n = p->n;
    for (int j = STAGES + 1; j < ALL; j++) {
        combined(n, x, h, p->A + j * ALL, j, K, stage);
        evaluate(p, s, s->t + p->C[j] * h, stage, u, K + j * n);
    }
    const double *begin = K, *end = K + STAGES * n;
    for (int64_t i = 0; i < n; i++) {
        const double change = next[i] - x[i];
        F[i] = change;
        F[n + i] = h * begin[i] - change;
        F[2 * n + i] = 2 * change - h * (end[i] + begin[i]);
    }
    for (int m = 0; m < DENSE - 3; m++) {
        double *Fm = F + (3 + m) * n;
        for (int64_t i = 0; i < n; i++)
            Fm[i] = 0.0;
        for (int j = 0; j < ALL; j++) {
            const double *Kj = K + j * n, d = p->dense[m * ALL + j];
            if (d == 0.0)
                continue;
            for (int64_t i = 0; i < n; i++)
                Fm[i] += Kj[i] * d;
        }
        for (int64_t i = 0; i < n; i++)
            Fm[i] *= h;
    }
}

static void interpolate(int64_t n, const double *x, const double *F, double at, double *out)
{
    for (int64_t i = 0; i < n; i++) {
        double y = 0.0;
        for (int m = 0; m < DENSE; m++) {
            y += F[(DENSE - 1 - m) * n + i];
            y *= m % 2 == 0 ? at : 1.0 - at;
        }
        out[i] = x[i] + y;
    }
}

static int all_finite(int64_t n, const double *x)
{
    double sum = 0.0;
    for (int64_t i = 0; i < n; i++)
        sum += 0.0 * x[i];
    return sum == 0.0;
}

/*
 * Integrate to the last of `count` instants and write the states there; `done`: how many of them
 * are written already. Returns MORE after about `most` evaluations: call again to continue.
 */
EXPORT int simulation_advance(const problem *p, position *s, int64_t count, const double *instants,
    double *out, int64_t *done, int64_t most)
{
    const int64_t n = p->n, until = s->evaluations + most;
    const double end = instants[count - 1];
    double *x = s->memory, *next = x + n, *stage = next + n, *scale = stage + n, *F = scale + n,
           *K = F + DENSE * n, *u = K + ALL * n;
    if (!s->begun) {
        evaluate(p, s, s->t, x, u, K);
        if (!all_finite(n, K))
            return NOT_FINITE;
        s->step = first_step(p, s, end, x, K, F, scale, u);
        s->begun = 1;
    }
    while (*done < count) {
        const double least = 10.0 * fabs(nextafter(s->t, INFINITY) - s->t);
        double h = s->step > least ? s->step : least, error = 0.0;
        for (int rejected = 0;;) {
            if (!(h >= least))
                return STEP_TOO_SMALL;
            const double to = s->t + h < end ? s->t + h : end;
            h = to - s->t;
            for (int j = 1; j < STAGES; j++) {
                combined(n, x, h, p->A + j * ALL, j, K, stage);
                evaluate(p, s, s->t + p->C[j] * h, stage, u, K + j * n);
            }
            combined(n, x, h, p->B, STAGES, K, next);
            evaluate(p, s, to, next, u, K + STAGES * n);
            for (int64_t i = 0; i < n; i++)
                scale[i] = p->atol[i] +
                           (fabs(x[i]) > fabs(next[i]) ? fabs(x[i]) : fabs(next[i])) * p->rtol;
            error = error_norm(p, K, h, scale);
            if (error < 1.0) {
                double factor = error == 0.0 ? 10.0 : 0.9 * pow(error, -1.0 / 8.0);
                if (factor > 10.0)
                    factor = 10.0;
                if (rejected && factor > 1.0)
                    factor = 1.0;
                s->step = h * factor;
                break;
            }
            if (!isfinite(error)) {
                if (rejected > 60)
                    return NOT_FINITE;
                h *= 0.2;
            } else {
                const double factor = 0.9 * pow(error, -1.0 / 8.0);
                h *= factor > 0.2 ? factor : 0.2;
            }
            rejected++;
        }
        const double to = s->t + h;
        if (!all_finite(n, next))
            return NOT_FINITE;
        if (instants[*done] <= to || to >= end) {
            prepare_dense(p, s, h, x, next, K, stage, u, F);
            for (; *done < count && (instants[*done] <= to || to >= end); ++*done)
                interpolate(n, x, F, (instants[*done] - s->t) / h, out + *done * n);
        }
        s->t = to >= end ? end : to;
        memcpy(x, next, (size_t)n * sizeof(double));
        memcpy(K, K + STAGES * n, (size_t)n * sizeof(double));
        if (s->evaluations >= until && *done < count)
            return MORE;
    }
    return DONE;
}
