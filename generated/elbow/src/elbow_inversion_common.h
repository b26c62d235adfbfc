/* elbow: common to all files of the inversion: sizes, Gauss points of an interval, memory; private. */
#ifndef ELBOW_INVERSION_COMMON_H
#define ELBOW_INVERSION_COMMON_H

#include "elbow_private.h"

#include "../elbow_inversion.h"

#include "elbow_motor_constants.h"

enum {
    NA = ELBOW_NA,
    NG = ELBOW_NG,
    NE = ELBOW_NE,
    NM = ELBOW_NM,
    NY = ELBOW_NY,
    NT = ELBOW_NT,
    PARAMETERS = ELBOW_PARAMETERS, /* run-time parameters */
    POINTS = BLOCK,
    STAGES = 3,
    REFERENCE = NT + 2 * NY /* numbers of a path sample: y, dy, ddy */
};

static const real gauss_c[STAGES] = {0.11270166537925831, 0.5, 0.8872983346207417};
#if ELBOW_NE > 0
static const real gauss_b[STAGES] = {5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0};
static const real gauss_A[STAGES][STAGES] = {{5.0 / 36.0, -0.035976667524938878, 0.0097894440152484326},
    {0.30026319498086457, 2.0 / 9.0, -0.022485417203086778}, {0.26798833376246944, 0.48042111196938331, 5.0 / 36.0}};
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

/* Status of a function of the library that was called with computed states: they are no inputs of the caller. */
static inline int inner_status(int status)
{
    return status == ELBOW_INPUT_NOT_FINITE ? ELBOW_RESULT_NOT_FINITE : status;
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
    return ELBOW_INVERSION_SPACE + BLOCK + ELBOW_PARAMETERS;
}

/* Store the run-time parameters where the functions that are called with this workspace find them. */
static inline void keep_parameters(const real *parameters, real *space)
{
    copy(parameters, PARAMETERS, PARAMETERS_OF(space));
}

/* Room in the workspace, in numbers; whole vectors apart. */
static inline int64_t padded(int64_t n)
{
    return (n + BLOCK - 1) / BLOCK * BLOCK;
}

#endif
