/*
 * model: common to all files of the inversion: sizes, Gauss points of an interval, memory;
 * private.
 */
#ifndef MODEL_INVERSION_COMMON_H
#define MODEL_INVERSION_COMMON_H

#include "model_inversion.h"

#include "model_motor_constants.h"
#include "model_private.h"

enum {
    NA = MODEL_NA,
    NG = MODEL_NG,
    NE = MODEL_NE,
    NM = MODEL_NM,
    NY = MODEL_NY,
    NT = MODEL_NT,
    PLACES = MODEL_POSE ? NY - 3 : NY, /* outputs before the rotation of a pose */
    PARAMETERS = MODEL_PARAMETERS,     /* run-time parameters */
    POINTS = BLOCK,
    STAGES = 3,
#if MODEL_FORCE
    /* force on the output, dual to dy, and its first two time derivatives */
    FORCES = 3 * NY,
    REFERENCE = NT + 2 * NY + FORCES /* numbers of a path sample: y, dy, ddy, forces */
#else                                /* MODEL_FORCE */
    REFERENCE = NT + 2 * NY /* numbers of a path sample: y, dy, ddy */
#endif                               /* MODEL_FORCE */
};

static const real gauss_c[STAGES] = {0.11270166537925831, 0.5, 0.8872983346207417};
#if MODEL_NE > 0
static const real gauss_b[STAGES] = {5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0};
static const real gauss_A[STAGES][STAGES] = {
    {5.0 / 36.0, -0.035976667524938878, 0.0097894440152484326},
    {0.30026319498086457, 2.0 / 9.0, -0.022485417203086778},
    {0.26798833376246944, 0.48042111196938331, 5.0 / 36.0}};
#if MODEL_DIRECT
/*
 * Integrals, up to the Gauss points, of the integrals of the quadratic through them. Where a
 * motion has no inertia, gauss_A gauss_A leaves an error that is a hundred times as large; but
 * that is stable for all vibrations.
 */
static const real gauss_AA[STAGES][STAGES] = {
    {1.0 / 120.0, -0.0027329632490537084, 0.00075046260534953094},
    {0.10587476869732523, 1.0 / 48.0, -0.0017081020306585679},
    {0.21591620406131715, 0.16939962991572038, 1.0 / 120.0}};
#endif /* MODEL_DIRECT */
#endif

/* The largest lane; where one is NaN it is overlooked. */
static inline real largest_lane(const lanes x)
{
    real all[LANES];
    store_v(all, x);
    for (int half = LANES / 2; half > 0; half /= 2) {
        for (int i = 0; i < half; ++i) {
            all[i] = fmax_1(all[i], all[i + half]);
        }
    }
    return all[0];
}

static inline real sum_lanes(const lanes x)
{
    real all[LANES];
    store_v(all, x);
    for (int half = LANES / 2; half > 0; half /= 2) {
        for (int i = 0; i < half; ++i) {
            all[i] += all[i + half];
        }
    }
    return all[0];
}

/* The largest size; NaN where an entry is not finite, so that no comparison holds. */
static inline real largest(const real *x, int n)
{
    lanes most = splat_v(0.0), zero = splat_v(0.0);
    real all, not_finite;
    const int whole = n / LANES * LANES;
    for (int i = 0; i < whole; i += LANES) {
        const lanes at = load_v(x + i);
        most = fmax_v(most, fabs_v(at));
        zero += 0.0 * at;
    }
    all = whole > 0 ? largest_lane(most) : 0.0;
    not_finite = whole > 0 ? sum_lanes(zero) : 0.0;
    for (int i = whole; i < n; ++i) {
        all = fmax_1(all, fabs_1(x[i]));
        not_finite += 0.0 * x[i];
    }
    return all + not_finite;
}

/* Square root by Newton's method: the library needs no function of the C library for it. */
static inline real square_root(real x)
{
    real r = 1.0;
    if (!(x > 0.0 && x < PRECISE(1e300, 1e37))) {
        return x;
    }
    while (r * r > 4.0 * x) {
        r *= 0.5;
    }
    while (r * r < 0.25 * x) {
        r *= 2.0;
    }
    for (int i = 0; i < 7; ++i) {
        r = 0.5 * (r + x / r);
    }
    return r;
}

static inline int is_finite(const real *x, int n)
{
    return all_finite(x, n, 1);
}

/*
 * Status of a function of the library that was called with computed states: not inputs of the
 * caller.
 */
static inline int inner_status(int status)
{
    return status == MODEL_INPUT_NOT_FINITE ? MODEL_RESULT_NOT_FINITE : status;
}

static inline void set_zero(real *x, ptrdiff_t n)
{
    for (ptrdiff_t i = 0; i < n; ++i) {
        x[i] = 0.0;
    }
}

static inline void copy(const real *from, ptrdiff_t n, real *to)
{
    for (ptrdiff_t i = 0; i < n; ++i) {
        to[i] = from[i];
    }
}

/* Workspace of the functions that are used here; the run-time parameters are stored behind it. */
static inline ptrdiff_t function_work(void)
{
#if MODEL_FORCE
    return MODEL_INVERSION_SPACE + BLOCK + MODEL_PARAMETERS + FORCES;
#else  /* MODEL_FORCE */
    return MODEL_INVERSION_SPACE + BLOCK + MODEL_PARAMETERS;
#endif /* MODEL_FORCE */
}

/*
 * Store the run-time parameters where the functions that are called with this workspace find them.
 */
static inline void keep_parameters(const real *parameters, real *space)
{
    copy(parameters, PARAMETERS, PARAMETERS_OF(space));
}
#if MODEL_FORCE

/*
 * The force on the output that equilibria hold, of a stream that of the next sample; behind the
 * run-time parameters.
 */
#define FORCE_OF(space) (PARAMETERS_OF(space) + PARAMETERS)

/* Keep that of sample k; zero where no forces are given. */
static inline void keep_force(const model_samples *p, ptrdiff_t k, real *space)
{
    for (int i = 0; i < FORCES; ++i) {
        FORCE_OF(space)[i] = p->force == NULL ? 0.0 : p->force[k * FORCES + i];
    }
}
#endif /* MODEL_FORCE */

/* Room in the workspace, in numbers; whole vectors apart. */
static inline int64_t padded(int64_t n)
{
    return (n + BLOCK - 1) / BLOCK * BLOCK;
}

/*
 * --- Small dense systems of equations by elimination.
 *
 * Matrices by rows, `width` numbers from row to row.
 */

/*
 * Gauss elimination with pivots on the diagonal, n rows: of the matrix in columns 0 ... n - 1, and
 * of the right sides in the columns after it, which become the solutions. 0 where a pivot is zero:
 * its unknown becomes zero.
 */
static inline int solve_plain(real *a, int n, int width)
{
    int regular = 1;
    for (int k = 0; k < n; ++k) {
        const real *top = a + k * width;
        const int is_pivot = fabs_1(top[k]) > 0.0;
        regular = regular && is_pivot;
        for (int i = k + 1; i < n; ++i) {
            real *row = a + i * width;
            const real f = is_pivot ? row[k] / top[k] : 0.0;
            for (int j = k + 1; j < width; ++j) {
                row[j] -= f * top[j];
            }
        }
    }
    for (int k = n - 1; k >= 0; --k) {
        real *row = a + k * width;
        for (int c = n; c < width; ++c) {
            for (int j = k + 1; j < n; ++j) {
                row[c] -= row[j] * a[j * width + c];
            }
            row[c] = fabs_1(row[k]) > 0.0 ? row[c] / row[k] : 0.0;
        }
    }
    return regular;
}

/* The row of the largest entry in column k, of the rows from k on. */
static inline int pivot_row(const real *a, int height, int width, int k)
{
    int best = k;
    for (int i = k + 1; i < height; ++i) {
        if (fabs_1(a[i * width + k]) > fabs_1(a[best * width + k])) {
            best = i;
        }
    }
    return best;
}

static inline void swap_rows(real *one, real *other, int columns)
{
    for (int j = 0; j < columns; ++j) {
        const real t = one[j];
        one[j] = other[j];
        other[j] = t;
    }
}

/*
 * --- Derivatives of a sampled motion by differences.
 */

enum { MARGIN = 3 }; /* samples on either side that a derivative needs */

/* largest kinematic mismatch of a status OK: beyond rounding and the corner of a filter */
static const real mismatch_max = PRECISE(2e-2, 2.5e-1);

/* First and second derivative by seven samples, `stride` apart and `period` seconds; order six. */
static inline real sixty_differences(const real *x, ptrdiff_t stride)
{
    return 45.0 * (x[stride] - x[-stride]) - 9.0 * (x[2 * stride] - x[-2 * stride]) +
           (x[3 * stride] - x[-3 * stride]);
}

/* The same of LANES samples that follow each other from `x` on. */
static inline lanes sixty_differences_v(const real *x, ptrdiff_t stride)
{
    return 45.0 * (load_v(x + stride) - load_v(x - stride)) -
           9.0 * (load_v(x + 2 * stride) - load_v(x - 2 * stride)) +
           (load_v(x + 3 * stride) - load_v(x - 3 * stride));
}

static inline real derivative_of(const real *x, ptrdiff_t stride, real period)
{
    return sixty_differences(x, stride) / (60.0 * period);
}

static inline lanes derivative_v(const real *x, real period)
{
    return sixty_differences_v(x, 1) / (60.0 * period);
}

static inline real second_derivative_of(const real *x, ptrdiff_t stride, real period)
{
#if BYTES == 8
    return (270.0 * (x[stride] + x[-stride]) - 27.0 * (x[2 * stride] + x[-2 * stride]) +
               2.0 * (x[3 * stride] + x[-3 * stride]) - 490.0 * x[0]) /
           (180.0 * period * period);
#else /* from differences: a large value that they share does not cost digits */
    const real one = (x[stride] - x[0]) + (x[-stride] - x[0]);
    const real two = (x[2 * stride] - x[0]) + (x[-2 * stride] - x[0]);
    const real three = (x[3 * stride] - x[0]) + (x[-3 * stride] - x[0]);
    return (270.0 * one - 27.0 * two + 2.0 * three) / (180.0 * period * period);
#endif
}

static inline lanes second_derivative_v(const real *x, real period)
{
    const lanes now = load_v(x);
#if BYTES == 8
    return (270.0 * (load_v(x + 1) + load_v(x - 1)) - 27.0 * (load_v(x + 2) + load_v(x - 2)) +
               2.0 * (load_v(x + 3) + load_v(x - 3)) - 490.0 * now) /
           (180.0 * period * period);
#else
    const lanes one = (load_v(x + 1) - now) + (load_v(x - 1) - now);
    const lanes two = (load_v(x + 2) - now) + (load_v(x - 2) - now);
    const lanes three = (load_v(x + 3) - now) + (load_v(x - 3) - now);
    return (270.0 * one - 27.0 * two + 2.0 * three) / (180.0 * period * period);
#endif
}

/* Whether a motion has what its growth depends on. */
static inline int has_state_and_torques(const model_motion *m)
{
    return m != NULL && m->q_a != NULL && m->v_a != NULL && m->q_m != NULL && m->v_m != NULL &&
           m->tau_m != NULL;
}

#endif
