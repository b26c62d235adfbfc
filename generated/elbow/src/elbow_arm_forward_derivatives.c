/* elbow: arm_forward_derivatives. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_arm_forward_derivatives_math.h"

#include "elbow_lanes.h"
#include "elbow_arm_forward_derivatives_math.h"

#include "elbow_undefine.h"

static const function_shape arm_forward_derivatives_shape = {
    3, 3, -1, 368, 64, {2, 2, 2, 2 * 2, 2 * 2, 2 * 2}};

static lanes arm_forward_derivatives_lanes(const real *const *in, real *const *out, lanes *work,
    int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    for (int k = 0; k < count; k += LANES) {
        zero += arm_forward_derivatives_evaluate_v(in[0] + k, in[1] + k, in[2] + k, out[0] + k,
            out[1] + k, out[2] + k, work, n);
    }
    return zero;
}

elbow_status elbow_arm_forward_derivatives(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real tau_a[ELBOW_NA],
    elbow_real da_dq[ELBOW_NA * ELBOW_NA], elbow_real da_dv[ELBOW_NA * ELBOW_NA],
    elbow_real da_dtau[ELBOW_NA * ELBOW_NA], elbow_real *work)
{
    if (q_a == NULL || v_a == NULL || tau_a == NULL || da_dq == NULL || da_dv == NULL ||
        da_dtau == NULL || work == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (arm_forward_derivatives_evaluate_1(q_a, v_a, tau_a, da_dq, da_dv, da_dtau, work) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, tau_a};
        real *const out[] = {da_dq, da_dv, da_dtau};
        return first_failed(&arm_forward_derivatives_shape, in, out, 1, 1);
    }
}

static int arm_forward_derivatives_one(const real *const *in, real *const *out, real *work)
{
    return elbow_arm_forward_derivatives(in[0], in[1], in[2], out[0], out[1], out[2],
        work) != ELBOW_OK;
}

elbow_status elbow_arm_forward_derivatives_batch_strided(int n, int stride,
    const elbow_real *q_a, const elbow_real *v_a, const elbow_real *tau_a, elbow_real *da_dq,
    elbow_real *da_dv, elbow_real *da_dtau, elbow_real *work)
{
    const real *const in[] = {q_a, v_a, tau_a};
    real *const out[] = {da_dq, da_dv, da_dtau};
    return evaluate_points(&arm_forward_derivatives_shape, arm_forward_derivatives_one,
        arm_forward_derivatives_lanes, in, out, n, stride, work);
}

elbow_status elbow_arm_forward_derivatives_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *tau_a, elbow_real *da_dq, elbow_real *da_dv,
    elbow_real *da_dtau, elbow_real *work)
{
    return elbow_arm_forward_derivatives_batch_strided(n, n, q_a, v_a, tau_a, da_dq, da_dv,
        da_dtau, work);
}
