/*
 * Observer with constant gains at each pose, linear about a reference, one update for each sample
 * of the controller:
 *
 *     x- = F x + G (d + u - u_ref),    e = y - y_ref - C x- - D (d + u - u_ref)
 *     x = x- + M_x e,    d <- d + M_d e,    result: x_ref + x, d
 *
 * Part i of the matrices is used for the samples from i * samples on, the last one to the end. (F
 * G) is stored in panels of PANEL rows, each by columns; rows of C that pick one state are a list.
 * No memory is allocated.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__GNUC__)
#define OBSERVER_API __attribute__((visibility("default")))
#else
#define OBSERVER_API
#endif

/* rows side by side, of a panel; rows of C side by side */
enum { WIDTH = 8, PANEL = 24, DENSE = 4 };

typedef struct {
    int32_t n_x, n_m, n_y, n_dense; /* dense: channels that are not a state, the last ones */
    int32_t parts, failed;
    /* samples of a part; rows of the references; numbers of a part */
    int64_t samples, references, part;
    const int32_t *state;   /* (n_y - n_dense): the state that a channel shows */
    const double *matrices; /* (parts): (F G), (C D)', M' */
    const double *y_ref, *u_ref, *x_ref;
    /* then w = (x, d + u - u_ref), x-, e, d */
} constant_gain;

static size_t rounded(size_t n, size_t unit)
{
    return (n + unit - 1) / unit * unit;
}

/* out = (F G) w, a panel after the other: each row is summed from the first column to the last. */
static void panels(const double *restrict A, const double *restrict w, size_t rows, size_t columns,
    double *restrict out)
{
    for (size_t r = 0; r < rows; r += PANEL) {
        double sum0[WIDTH] = {0.0}, sum1[WIDTH] = {0.0}, sum2[WIDTH] = {0.0};
        for (size_t j = 0; j < columns; ++j, A += PANEL) {
            const double factor = w[j];
            for (size_t i = 0; i < WIDTH; ++i) {
                sum0[i] += A[i] * factor;
            }
            for (size_t i = 0; i < WIDTH; ++i) {
                sum1[i] += A[WIDTH + i] * factor;
            }
            for (size_t i = 0; i < WIDTH; ++i) {
                sum2[i] += A[2 * WIDTH + i] * factor;
            }
        }
        memcpy(out + r, sum0, sizeof sum0);
        memcpy(out + r + WIDTH, sum1, sizeof sum1);
        memcpy(out + r + 2 * WIDTH, sum2, sizeof sum2);
    }
}

/* Numbers of memory behind the struct. */
OBSERVER_API int64_t flexgen_constant_gain_size(const void *self)
{
    const constant_gain *c = (const constant_gain *)self;
    size_t n_x = (size_t)c->n_x, n_m = (size_t)c->n_m;
    return (int64_t)(rounded(n_x, PANEL) + n_x + 2 * n_m + rounded((size_t)c->n_y, DENSE) + DENSE);
}

/*
 * Sample k: u (n_m) acted since the last one, y (n_y) is measured now; z (n_x + n_m): the
 * estimate. 0: done.
 */
OBSERVER_API int flexgen_constant_gain_step(
    void *self, int64_t k, const double *y, const double *u, double *z)
{
    constant_gain *c = (constant_gain *)self;
    size_t n_x = (size_t)c->n_x, n_m = (size_t)c->n_m, n_y = (size_t)c->n_y,
           dense = (size_t)c->n_dense;
    size_t row = (size_t)(k < c->references ? k : c->references - 1), plain = n_y - dense,
           n_z = n_x + n_m;
    int64_t part = k / c->samples < c->parts ? k / c->samples : c->parts - 1;
    const double *A = c->matrices + part * c->part, *C = A + rounded(n_x, PANEL) * n_z;
    const double *M = C + rounded(dense, DENSE) * n_z;
    double *predicted = (double *)(void *)(c + 1), *w = predicted + rounded(n_x, PANEL),
           *e = w + n_z;
    double *d = e + rounded(n_y, DENSE) + DENSE;
    double finite = 0.0;
    if (c->failed) {
        return 1;
    }
    for (size_t j = 0; j < n_m; ++j) {
        w[n_x + j] = d[j] + u[j] - c->u_ref[row * n_m + j];
    }
    panels(A, w, n_x, n_z, predicted);
    for (size_t i = 0; i < n_y; ++i) {
        e[i] = y[i] - c->y_ref[row * n_y + i];
    }
    for (size_t i = 0; i < plain; ++i) {
        e[i] -= predicted[c->state[i]];
    }
    for (size_t first = 0; first < dense; first += DENSE, C += DENSE * n_z) {
        double even[DENSE] = {0.0}, odd[DENSE] = {0.0};
        size_t j = 0;
        for (; j + 1 < n_x; j += 2) { /* two sums, so that none waits for the last product */
            for (size_t i = 0; i < DENSE; ++i) {
                even[i] += C[j * DENSE + i] * predicted[j];
            }
            for (size_t i = 0; i < DENSE; ++i) {
                odd[i] += C[(j + 1) * DENSE + i] * predicted[j + 1];
            }
        }
        for (; j < n_z; ++j) {
            for (size_t i = 0; i < DENSE; ++i) {
                even[i] += C[j * DENSE + i] * (j < n_x ? predicted[j] : w[j]);
            }
        }
        for (size_t i = 0; i < DENSE && first + i < dense; ++i) {
            e[plain + first + i] -= even[i] + odd[i];
        }
    }
    memcpy(w, predicted, n_x * sizeof *w);
    for (size_t j = 0; j < n_m; ++j) {
        w[n_x + j] = d[j];
    }
    for (size_t i = 0; i < n_y; ++i, M += n_z) {
        const double factor = e[i];
        const double *restrict column = M;
        double *restrict state = w;
        finite += factor;
        for (size_t j = 0; j < n_z; ++j) {
            state[j] += column[j] * factor;
        }
    }
    for (size_t j = 0; j < n_m; ++j) {
        d[j] = w[n_x + j];
        z[n_x + j] = d[j];
    }
    for (size_t i = 0; i < n_x; ++i) {
        z[i] = c->x_ref[row * n_x + i] + w[i];
    }
    c->failed = !isfinite(finite);
    return c->failed;
}

/*
 * Samples one after the other from sample `first` on: y (n, n_y), u (n, n_m), z (n, n_x + n_m).
 * How many were done.
 */
OBSERVER_API int64_t flexgen_constant_gain_run(
    void *self, int64_t first, int64_t n, const double *y, const double *u, double *z)
{
    const constant_gain *c = (const constant_gain *)self;
    size_t n_y = (size_t)c->n_y, n_m = (size_t)c->n_m, n_z = (size_t)c->n_x + n_m;
    for (int64_t k = 0; k < n; ++k) {
        size_t at = (size_t)k;
        if (flexgen_constant_gain_step(
                self, first + k, y + at * n_y, u + at * n_m, z + at * n_z) != 0) {
            return k;
        }
    }
    return n;
}
