/*
 * Extended Kalman filter of a robot, one update for each sample of the controller:
 *
 *     state         z = (x, d),    x = (q_a, q_m, v_a, v_m), of the motors those behind elastic
 *                   gears
 *     model         x' = f(x, u + d),    d: torque on each motor, a random walk
 *     prediction    x by the classical Runge-Kutta method, P <- F P F' + Q
 *                   F = (1 + s A + s^2/2 A^2 + s^3/6 A^3 + s^4/24 A^4)^(2^doublings),  s = h /
 *                     2^doublings,
 *                   (A, B): linearization at the predicted state of the last sample
 *     correction    one scalar measurement after the other, y = g(x, u + d) + noise
 *
 * The model is that of the emitted library: functions for one point. No memory is allocated, and
 * the memory of a filter holds no address into itself. Matrices have rows of `stride` numbers;
 * entries beyond their columns are zero.
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

enum {
    OBSERVER_DONE = 0,
    OBSERVER_NOT_FINITE = 1,
    OBSERVER_NOT_POSITIVE = 2,
    OBSERVER_MODEL_FAILED = 3
};
/* of a tile of a product; numbers of a cache line, where parts begin */
enum { ROWS = 4, COLUMNS = 8, LINE = 8 };

/* Functions of the library with five and with three arguments, and with or without a workspace. */
typedef int (*model_two)(const double *, const double *, const double *, const double *,
    const double *, double *, double *, double *work);
typedef int (*model_two_plain)(const double *, const double *, const double *, const double *,
    const double *, double *, double *);
typedef int (*model_one)(const double *, const double *, const double *, double *, double *work);
typedef int (*model_one_plain)(const double *, const double *, const double *, double *);
typedef int (*model_three)(
    const double *, const double *, const double *, double *, double *, double *, double *work);
typedef int (*model_three_plain)(
    const double *, const double *, const double *, double *, double *, double *);

typedef struct {
    void (*call)(void);
    int64_t work; /* numbers of its workspace; 0: it takes none */
} model_function;

typedef struct {
    int32_t n_a, n_m, n_e; /* arm coordinates, motors, motors behind elastic gears */
    /* disturbances (0 or n_m), measured channels, signals of the sensors */
    int32_t n_d, n_y, n_s;
    int32_t steps, doublings; /* of the integrator a sample, and of F */
    int32_t accelerating;     /* whether a channel depends on accelerations */
    int32_t status, begun, unused;
    int64_t stride;
    double sample_s;
    model_function dynamics, linearize, sensors, derivatives;
    const int32_t *elastic; /* (n_e): their motors */
    /* (n_y): of a state below 0: -1 - its number; else of a signal, or n_s + a row of gears */
    const int32_t *channel;
    /* (n_m, n_a): motor angles behind rigid gears from the arm's coordinates */
    const double *gears;
    const double *noise;   /* (n_y): variances of the measurements */
    const double *torque;  /* (n_m): variances of the torques of a sample */
    const double *walk;    /* (n_d): growth of the variances of the disturbances in a sample */
    const double *process; /* (n_x, stride): more noise of the states in a sample */
    double normalized;     /* innovations over their deviations, squares added */
} kalman;

/* Parts of the memory behind the struct. */
typedef struct {
    double *z, *P; /* what the filter knows */
    /* linearization, by columns, one behind the other */
    double *A, *B;
    double *Ft, *Zt;                              /* F', P F' */
    double *cross;                                /* rows of P for the disturbances */
    double *q_m, *v_m, *tau, *rate, *at;          /* points of the integrator: rate four times */
    double *a_a, *a_m, *y_s, *by_q, *by_v, *by_a; /* signals and their derivatives */
    /* derivatives of all signals in the state, of one */
    double *Ht, *row;
    double *gain, *innovation, *predicted, *work;
} kalman_parts;

/* n rounded up to whole tiles. */
static size_t tiles(size_t n, size_t tile)
{
    return (n + tile - 1) / tile * tile;
}

static size_t kalman_states(const kalman *e)
{
    return 2 * ((size_t)e->n_a + (size_t)e->n_e);
}

/* The parts, in this order; the sum of their sizes is the result. */
static size_t kalman_layout(const kalman *e, double *memory, kalman_parts *p)
{
    size_t n_x = kalman_states(e), n_a = (size_t)e->n_a, n_m = (size_t)e->n_m,
           n_s = (size_t)e->n_s;
    size_t stride = (size_t)e->stride, all = n_x + n_m, used = 0, work = 1;
    const model_function *f[] = {&e->dynamics, &e->linearize, &e->sensors, &e->derivatives};
    for (size_t i = 0; i < 4; ++i) {
        work = (size_t)f[i]->work > work ? (size_t)f[i]->work : work;
    }
    struct {
        double **part;
        size_t size;
    } const list[] = {{&p->z, all}, {&p->P, stride * stride}, {&p->innovation, (size_t)e->n_y},
        {&p->A, n_x * (all + ROWS)}, {&p->Ft, stride * stride}, {&p->Zt, stride * stride},
        {&p->cross, n_m * stride}, {&p->q_m, n_m}, {&p->v_m, n_m}, {&p->tau, n_m},
        {&p->rate, 4 * n_x}, {&p->at, n_x}, {&p->a_a, n_a}, {&p->a_m, n_m}, {&p->y_s, n_s},
        {&p->by_q, n_s * n_a}, {&p->by_v, n_s * n_a}, {&p->by_a, n_s * n_a + COLUMNS},
        {&p->Ht, n_s > 0 ? stride * tiles(n_s, COLUMNS) : 0}, {&p->row, stride},
        {&p->gain, stride}, {&p->predicted, all}, {&p->work, work}};
    for (size_t i = 0; i < sizeof list / sizeof *list; ++i) {
        if (memory) {
            *list[i].part = memory + used;
        }
        used += tiles(list[i].size, LINE);
    }
    if (memory) {
        p->B = p->A + n_x * n_x;
    }
    return used;
}

static kalman_parts parts_of(kalman *e)
{
    kalman_parts p;
    (void)kalman_layout(e, (double *)(void *)e + tiles(sizeof(kalman) / sizeof(double), LINE), &p);
    return p;
}

/* A factor of a product: entry r of row k is at [k * inner + r * outer]. */
typedef struct {
    const double *at;
    size_t inner, outer;
} factor;

/*
 * Four rows and eight columns of A' B; each row has its own sums and loop, and b a copy: compilers
 * turn that into vectors.
 */
static void tile(const double *restrict a, size_t inner_a, size_t outer_a,
    const double *restrict b, size_t stride_b, size_t inner, double *restrict out)
{
    double sum0[COLUMNS] = {0.0}, sum1[COLUMNS] = {0.0}, sum2[COLUMNS] = {0.0},
           sum3[COLUMNS] = {0.0};
    double row[COLUMNS];
    for (size_t k = 0; k < inner; ++k, a += inner_a, b += stride_b) {
        const double a0 = a[0], a1 = a[outer_a], a2 = a[2 * outer_a], a3 = a[3 * outer_a];
        memcpy(row, b, sizeof row);
        for (size_t j = 0; j < COLUMNS; ++j) {
            sum0[j] += a0 * row[j];
        }
        for (size_t j = 0; j < COLUMNS; ++j) {
            sum1[j] += a1 * row[j];
        }
        for (size_t j = 0; j < COLUMNS; ++j) {
            sum2[j] += a2 * row[j];
        }
        for (size_t j = 0; j < COLUMNS; ++j) {
            sum3[j] += a3 * row[j];
        }
    }
    memcpy(out, sum0, sizeof sum0);
    memcpy(out + COLUMNS, sum1, sizeof sum1);
    memcpy(out + 2 * COLUMNS, sum2, sizeof sum2);
    memcpy(out + 3 * COLUMNS, sum3, sizeof sum3);
}

/*
 * C = A' B, of A (inner, rows) and B (inner, columns), the rows of B and C at the given distances.
 * Rows and columns are rounded up to tiles, where all matrices must have memory. symmetric: only
 * tiles that reach the diagonal of C or lie above it.
 */
static void product(factor A, const double *B, size_t stride_b, size_t inner, size_t rows,
    size_t columns, int symmetric, double *C, size_t stride)
{
    for (size_t r = 0; r < rows; r += ROWS) {
        for (size_t c = symmetric ? r / COLUMNS * COLUMNS : 0; c < columns; c += COLUMNS) {
            double sum[ROWS * COLUMNS];
            tile(A.at + r * A.outer, A.inner, A.outer, B + c, stride_b, inner, sum);
            for (size_t i = 0; i < ROWS; ++i) {
                memcpy(C + (r + i) * stride + c, sum + i * COLUMNS, COLUMNS * sizeof *sum);
            }
        }
    }
}

/*
 * Motor angles and speeds of a state, with those behind elastic gears; the others are not read by
 * the model.
 */
static void motors_of(const kalman *e, const kalman_parts *p, const double *x)
{
    size_t n = kalman_states(e) / 2;
    for (int32_t j = 0; j < e->n_e; ++j) {
        p->q_m[e->elastic[j]] = x[e->n_a + j];
        p->v_m[e->elastic[j]] = x[n + (size_t)e->n_a + (size_t)j];
    }
}

/* Accelerations at a state under the torques that act. */
static int accelerations(const kalman *e, const kalman_parts *p, const double *x)
{
    const double *v_a = x + kalman_states(e) / 2;
    motors_of(e, p, x);
    if (e->dynamics.work) {
        return ((model_two)e->dynamics.call)(
            x, v_a, p->q_m, p->v_m, p->tau, p->a_a, p->a_m, p->work);
    }
    return ((model_two_plain)e->dynamics.call)(x, v_a, p->q_m, p->v_m, p->tau, p->a_a, p->a_m);
}

static int rate_of(const kalman *e, const kalman_parts *p, const double *x, double *dx)
{
    size_t n = kalman_states(e) / 2, n_a = (size_t)e->n_a;
    int failed = accelerations(e, p, x);
    memcpy(dx, x + n, n * sizeof *dx);
    memcpy(dx + n, p->a_a, n_a * sizeof *dx);
    for (int32_t j = 0; j < e->n_e; ++j) {
        dx[n + n_a + (size_t)j] = p->a_m[e->elastic[j]];
    }
    return failed;
}

/* The state after a sample, by the classical Runge-Kutta method. */
static int integrate(const kalman *e, const kalman_parts *p, double *x)
{
    size_t n = kalman_states(e);
    double h = e->sample_s / e->steps, *k1 = p->rate, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n,
           *at = p->at;
    int failed = 0;
    for (int32_t step = 0; step < e->steps; ++step) {
        failed |= rate_of(e, p, x, k1);
        for (size_t i = 0; i < n; ++i) {
            at[i] = x[i] + 0.5 * h * k1[i];
        }
        failed |= rate_of(e, p, at, k2);
        for (size_t i = 0; i < n; ++i) {
            at[i] = x[i] + 0.5 * h * k2[i];
        }
        failed |= rate_of(e, p, at, k3);
        for (size_t i = 0; i < n; ++i) {
            at[i] = x[i] + h * k3[i];
        }
        failed |= rate_of(e, p, at, k4);
        for (size_t i = 0; i < n; ++i) {
            x[i] += h / 6.0 * ((k1[i] + k4[i]) + 2.0 * (k2[i] + k3[i]));
        }
    }
    return failed;
}

/*
 * M' (n_x + n_m, n_x) of M = 1 + h (A, B) + half (A, B)^2: rows of the state, then what constant
 * torques do.
 */
static void second_order(const kalman *e, const kalman_parts *p, double h, double half)
{
    size_t n_x = kalman_states(e), n = n_x / 2, stride = (size_t)e->stride,
           all = n_x + (size_t)e->n_m;
    double *Ft = p->Ft;
    const factor lower = {p->A + n, 1, n_x};
    /* lower rows of A (A, B), L_2 (L_1 L_2 B_2), transposed; L_1 is added to L_2 L_2 */
    product(
        lower, p->A + n * n_x + n, n_x, n, tiles(all, ROWS), tiles(n, COLUMNS), 0, Ft + n, stride);
    for (size_t j = 0; j < all; ++j) {
        const double *column = p->A + j * n_x + n;
        const double *of_speed = j >= n && j < n_x ? p->A + (j - n) * n_x + n : NULL;
        double *restrict row = Ft + j * stride;
        for (size_t i = 0; i < n; ++i) {
            row[i] = half * column[i];
            row[n + i] = h * column[i] + half * row[n + i];
        }
        if (of_speed) {
            for (size_t i = 0; i < n; ++i) {
                row[n + i] += half * of_speed[i];
            }
            row[j - n] += h;
        }
        if (j < n_x) {
            row[j] += 1.0;
        }
        for (size_t i = n_x; i < tiles(n_x, COLUMNS); ++i) {
            row[i] = 0.0;
        }
    }
}

/* M <- 1 + factor_h (A, B) M. */
static void next_order(const kalman *e, const kalman_parts *p, double factor_h)
{
    size_t n_x = kalman_states(e), n = n_x / 2, stride = (size_t)e->stride,
           all = n_x + (size_t)e->n_m;
    const factor M = {p->Ft, 1, stride};
    /* lower rows of A M, transposed */
    product(M, p->A + n, n_x, n_x, tiles(all, ROWS), tiles(n, COLUMNS), 0, p->Zt + n, stride);
    for (size_t j = 0; j < all; ++j) {
        const double *column = j < n_x ? NULL : p->A + j * n_x + n,
                     *lower = p->Zt + j * stride + n;
        double *restrict row = p->Ft + j * stride;
        for (size_t i = 0; i < n; ++i) {
            row[i] = factor_h * row[n + i];
        }
        for (size_t i = 0; i < n; ++i) {
            row[n + i] = factor_h * (column ? lower[i] + column[i] : lower[i]);
        }
        if (j < n_x) {
            row[j] += 1.0;
        }
    }
}

/* F' over the time s, of fourth order, by Horner's rule. */
static void transition(const kalman *e, const kalman_parts *p)
{
    double s = ldexp(e->sample_s, -e->doublings);
    second_order(e, p, s / 3.0, s * s / 12.0);
    next_order(e, p, s / 2.0);
    next_order(e, p, s);
}

/* F' over twice the time, and what constant torques do in it: F F and (F + 1) G. */
static void doubled(const kalman *e, const kalman_parts *p)
{
    size_t n_x = kalman_states(e), stride = (size_t)e->stride, all = n_x + (size_t)e->n_m;
    const factor F = {p->Ft, 1, stride};
    product(F, p->Ft, stride, n_x, tiles(all, ROWS), tiles(n_x, COLUMNS), 0, p->Zt, stride);
    for (size_t r = n_x; r < all; ++r) {
        for (size_t c = 0; c < n_x; ++c) {
            p->Zt[r * stride + c] += p->Ft[r * stride + c];
        }
    }
    memcpy(p->Ft, p->Zt, all * stride * sizeof(double));
}

/* P <- F P F' + Q. */
static void predict_covariance(const kalman *e, const kalman_parts *p)
{
    size_t n_x = kalman_states(e), n_d = (size_t)e->n_d, n_m = (size_t)e->n_m,
           stride = (size_t)e->stride;
    size_t wide = tiles(n_x, COLUMNS);
    const factor P = {p->P, stride, 1}, Z = {p->Zt, stride, 1};
    transition(e, p);
    for (int32_t i = 0; i < e->doublings; ++i) {
        doubled(e, p);
    }
    /* P F' */
    product(P, p->Ft, stride, n_x + n_d, tiles(n_x + n_d, ROWS), wide, 0, p->Zt, stride);
    /* what P will have for the disturbances; noise of the torques */
    for (size_t j = 0; j < n_m; ++j) {
        double *restrict of = p->Zt + (n_x + j) * stride;
        const double *restrict g = p->Ft + (n_x + j) * stride;
        if (n_d) {
            memcpy(p->cross + j * stride, of, n_x * sizeof *of);
            memcpy(p->cross + j * stride + n_x, p->P + (n_x + j) * stride + n_x, n_d * sizeof *of);
            p->cross[j * stride + n_x + j] += e->walk[j];
        }
        for (size_t i = 0; i < wide; ++i) {
            of[i] = (n_d ? of[i] : 0.0) + e->torque[j] * g[i];
        }
    }
    product(Z, p->Ft, stride, n_x + n_m, tiles(n_x, ROWS), wide, 1, p->P, stride);
    for (size_t i = 0; i < n_x; ++i) {
        double *restrict row = p->P + i * stride;
        const double *restrict more = e->process + i * stride;
        for (size_t k = i / COLUMNS * COLUMNS; k < wide; ++k) {
            row[k] += more[k];
        }
    }
    for (size_t i = 1; i < n_x; ++i) {
        for (size_t k = 0; k < i; ++k) {
            p->P[i * stride + k] = p->P[k * stride + i];
        }
    }
    for (size_t j = 0; j < n_d; ++j) {
        memcpy(p->P + (n_x + j) * stride, p->cross + j * stride, (n_x + n_d) * sizeof(double));
        for (size_t i = 0; i < n_x; ++i) {
            p->P[i * stride + n_x + j] = p->cross[j * stride + i];
        }
    }
}

/* Linearization at the state, and signals of the sensors with their derivatives. */
static int linearized(const kalman *e, const kalman_parts *p)
{
    const double *x = p->z, *v_a = x + kalman_states(e) / 2;
    int failed = 0;
    motors_of(e, p, x);
    if (e->linearize.work) {
        failed |= ((model_two)e->linearize.call)(
            x, v_a, p->q_m, p->v_m, p->tau, p->A, p->B, p->work);
    } else {
        failed |= ((model_two_plain)e->linearize.call)(x, v_a, p->q_m, p->v_m, p->tau, p->A, p->B);
    }
    if (e->n_s == 0) {
        return failed;
    }
    if (e->accelerating) {
        failed |= accelerations(e, p, x);
    }
    if (e->sensors.work) {
        failed |= ((model_one)e->sensors.call)(x, v_a, p->a_a, p->y_s, p->work);
    } else {
        failed |= ((model_one_plain)e->sensors.call)(x, v_a, p->a_a, p->y_s);
    }
    if (e->derivatives.work) {
        failed |= ((model_three)e->derivatives.call)(
            x, v_a, p->a_a, p->by_q, p->by_v, p->by_a, p->work);
    } else {
        failed |= ((model_three_plain)e->derivatives.call)(
            x, v_a, p->a_a, p->by_q, p->by_v, p->by_a);
    }
    return failed;
}

/*
 * Derivatives of the sensors' signals in (x, d), transposed: (n_x + n_d, n_s), rows at distance
 * `wide`.
 */
static void measurement_rows(const kalman *e, const kalman_parts *p)
{
    size_t n_x = kalman_states(e), n = n_x / 2, n_s = (size_t)e->n_s, n_a = (size_t)e->n_a;
    size_t wide = tiles(n_s, COLUMNS), all = n_x + (size_t)e->n_d;
    if (e->accelerating) { /* a_a = rows of (A, B) */
        const factor rows = {p->A + n, 1, n_x};
        product(rows, p->by_a, n_s, n_a, tiles(all, ROWS), wide, 0, p->Ht, wide);
    } else {
        memset(p->Ht, 0, all * wide * sizeof(double));
    }
    for (size_t i = 0; i < n_a; ++i) {
        for (size_t s = 0; s < n_s; ++s) {
            p->Ht[i * wide + s] += p->by_q[i * n_s + s];
            p->Ht[(n + i) * wide + s] += p->by_v[i * n_s + s];
        }
    }
}

/* P <- P - g g'/S and z <- z + g innovation/S, g = P h. */
static void corrected(const kalman *e, const kalman_parts *p, double innovation, double variance)
{
    size_t all = kalman_states(e) + (size_t)e->n_d, stride = (size_t)e->stride;
    size_t wide = tiles(all, COLUMNS);
    const double *restrict g = p->gain;
    for (size_t i = 0; i < all; ++i) {
        double factor = g[i] / variance, *restrict row = p->P + i * stride;
        p->z[i] += factor * innovation;
        for (size_t k = 0; k < wide; ++k) {
            row[k] -= factor * g[k];
        }
    }
}

/* All channels of a sample, one after the other; the status. */
static int correct(kalman *e, const kalman_parts *p, const double *y)
{
    size_t n_x = kalman_states(e), all = n_x + (size_t)e->n_d, stride = (size_t)e->stride;
    size_t wide = tiles(all, COLUMNS);
    double sum = 0.0;
    memcpy(p->predicted, p->z, all * sizeof(double));
    if (e->n_s > 0) {
        measurement_rows(e, p);
    }
    for (int32_t c = 0; c < e->n_y; ++c) {
        int32_t from = e->channel[c];
        double innovation, variance = e->noise[c];
        if (from < 0) { /* a state itself */
            size_t i = (size_t)(-1 - from);
            memcpy(p->gain, p->P + i * stride, wide * sizeof(double));
            innovation = y[c] - p->z[i];
            variance += p->gain[i];
        } else {
            double value = 0.0;
            if (from < e->n_s) {
                value = p->y_s[from];
                for (size_t i = 0; i < all; ++i) {
                    p->row[i] = p->Ht[i * tiles((size_t)e->n_s, COLUMNS) + (size_t)from];
                }
            } else {
                memset(p->row, 0, stride * sizeof *p->row);
                for (size_t i = 0; i < (size_t)e->n_a; ++i) {
                    p->row[i] = e->gears[(size_t)(from - e->n_s) * (size_t)e->n_a + i];
                    value += p->row[i] * p->predicted[i];
                }
            }
            memset(p->gain, 0, stride * sizeof *p->gain);
            innovation = y[c] - value;
            for (size_t i = 0; i < all; ++i) {
                double h = p->row[i], *restrict g = p->gain;
                const double *restrict row = p->P + i * stride;
                if (h != 0.0) {
                    innovation -= h * (p->z[i] - p->predicted[i]);
                    for (size_t k = 0; k < wide; ++k) {
                        g[k] += h * row[k];
                    }
                }
            }
            for (size_t i = 0; i < all; ++i) {
                variance += p->row[i] * p->gain[i];
            }
        }
        if (!isfinite(innovation) || !isfinite(variance)) {
            return OBSERVER_NOT_FINITE;
        }
        if (!(variance > 0.0)) {
            return OBSERVER_NOT_POSITIVE;
        }
        corrected(e, p, innovation, variance);
        p->innovation[c] = innovation;
        sum += innovation * innovation / variance;
    }
    e->normalized = sum;
    return OBSERVER_DONE;
}

static int checked(const kalman *e, const kalman_parts *p)
{
    size_t all = kalman_states(e) + (size_t)e->n_d;
    for (size_t i = 0; i < all; ++i) {
        double variance = p->P[i * ((size_t)e->stride + 1)];
        if (!isfinite(p->z[i]) || !isfinite(variance)) {
            return OBSERVER_NOT_FINITE;
        }
        if (!(variance > 0.0)) {
            return OBSERVER_NOT_POSITIVE;
        }
    }
    return OBSERVER_DONE;
}

/* Bytes of a filter; it is fastest where its memory begins at a cache line. */
OBSERVER_API int64_t flexgen_kalman_size(const void *self)
{
    kalman_parts p;
    return (int64_t)(sizeof(double) * (tiles(sizeof(kalman) / sizeof(double), LINE) +
                                          kalman_layout((const kalman *)self, NULL, &p)));
}

/* Where z, P and the innovations (n_y) lie in the memory of a filter [bytes]. */
OBSERVER_API void flexgen_kalman_offsets(void *self, int64_t *offsets)
{
    kalman_parts p = parts_of((kalman *)self);
    offsets[0] = (const char *)p.z - (const char *)self;
    offsets[1] = (const char *)p.P - (const char *)self;
    offsets[2] = (const char *)p.innovation - (const char *)self;
}

/*
 * One sample: u (n_m) [N m] acted since the last one, and just before this one; y (n_y) is
 * measured now. The first sample after a reset corrects only. After an error every call returns it
 * again.
 */
OBSERVER_API int flexgen_kalman_step(void *self, const double *y, const double *u)
{
    kalman *e = (kalman *)self;
    kalman_parts p = parts_of(e);
    size_t n_x = kalman_states(e);
    if (e->status != OBSERVER_DONE) {
        return e->status;
    }
    for (size_t j = 0; j < (size_t)e->n_m; ++j) {
        p.tau[j] = u[j] + (e->n_d ? p.z[n_x + j] : 0.0);
    }
    if (e->begun) {
        predict_covariance(e, &p);
        if (integrate(e, &p, p.z) != 0) {
            return e->status = OBSERVER_MODEL_FAILED;
        }
    }
    e->begun = 1;
    if (linearized(e, &p) != 0) {
        return e->status = OBSERVER_MODEL_FAILED;
    }
    e->status = correct(e, &p, y);
    if (e->status == OBSERVER_DONE) {
        e->status = checked(e, &p);
    }
    return e->status;
}

/*
 * Samples one after the other: y (n, n_y), u (n, n_m); z (n, n_x + n_d) and deviation (n, n_x +
 * n_d) of each estimate, innovation (n, n_y), normalized (n). Returns how many were done.
 */
OBSERVER_API int64_t flexgen_kalman_run(void *self, int64_t n, const double *y, const double *u,
    double *z, double *deviation, double *innovation, double *normalized)
{
    kalman *e = (kalman *)self;
    kalman_parts p = parts_of(e);
    size_t all = kalman_states(e) + (size_t)e->n_d, n_y = (size_t)e->n_y;
    for (int64_t k = 0; k < n; ++k) {
        size_t at = (size_t)k;
        if (flexgen_kalman_step(self, y + at * n_y, u + at * (size_t)e->n_m) != OBSERVER_DONE) {
            return k;
        }
        memcpy(z + at * all, p.z, all * sizeof *z);
        memcpy(innovation + at * n_y, p.innovation, n_y * sizeof *innovation);
        normalized[k] = e->normalized;
        for (size_t i = 0; i < all; ++i) {
            deviation[at * all + i] = sqrt(p.P[i * ((size_t)e->stride + 1)]);
        }
    }
    return n;
}
