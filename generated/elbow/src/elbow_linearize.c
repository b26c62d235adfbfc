/* elbow: linearize. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_linearize_math.h"

#include "elbow_lanes.h"
#include "elbow_linearize_math.h"

#include "elbow_undefine.h"

static const function_shape linearize_shape = {
    5, 2, -1, 704, 64, {2, 2, 2, 2, 2, 8 * 8, 8 * 2}};

static lanes linearize_lanes(const real *const *in, real *const *out, lanes *work, int count,
    ptrdiff_t n)
{
    lanes zero = splat_v(0);
    for (int k = 0; k < count; k += LANES) {
        zero += linearize_evaluate_v(in[0] + k, in[1] + k, in[2] + k, in[3] + k, in[4] + k,
            out[0] + k, out[1] + k, work, n);
    }
    return zero;
}

elbow_status elbow_linearize(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM],
    const elbow_real tau_m[ELBOW_NM], elbow_real A[ELBOW_NX * ELBOW_NX],
    elbow_real B[ELBOW_NX * ELBOW_NM], elbow_real *work)
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || A == NULL
        || B == NULL || work == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (linearize_evaluate_1(q_a, v_a, q_m, v_m, tau_m, A, B, work) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, q_m, v_m, tau_m};
        real *const out[] = {A, B};
        return first_failed(&linearize_shape, in, out, 1, 1);
    }
}

static int linearize_one(const real *const *in, real *const *out, real *work)
{
    return elbow_linearize(in[0], in[1], in[2], in[3], in[4], out[0], out[1], work) != ELBOW_OK;
}

elbow_status elbow_linearize_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m,
    elbow_real *A, elbow_real *B, elbow_real *work)
{
    const real *const in[] = {q_a, v_a, q_m, v_m, tau_m};
    real *const out[] = {A, B};
    return evaluate_points(&linearize_shape, linearize_one, linearize_lanes, in, out, n, stride,
        work);
}

elbow_status elbow_linearize_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m, elbow_real *A,
    elbow_real *B, elbow_real *work)
{
    return elbow_linearize_batch_strided(n, n, q_a, v_a, q_m, v_m, tau_m, A, B, work);
}
