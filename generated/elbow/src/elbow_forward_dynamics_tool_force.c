/* elbow: forward_dynamics_tool_force. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_forward_dynamics_tool_force_math.h"

#include "elbow_lanes.h"
#include "elbow_forward_dynamics_tool_force_math.h"

#include "elbow_undefine.h"

static const function_shape forward_dynamics_tool_force_shape = {
    6, 3, -1, 0, 64, {2, 2, 2, 2, 2, 6, 2, 2, 2}};

static lanes forward_dynamics_tool_force_lanes(const real *const *in, real *const *out,
    lanes *work, int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += forward_dynamics_tool_force_evaluate_v(in[0] + k, in[1] + k, in[2] + k,
            in[3] + k, in[4] + k, in[5] + k, out[0] + k, out[1] + k, out[2] + k, n);
    }
    return zero;
}

elbow_status elbow_forward_dynamics_tool_force(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real q_m[ELBOW_NM],
    const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM], const elbow_real f_tool[6],
    elbow_real a_a[ELBOW_NA], elbow_real a_m[ELBOW_NM], elbow_real tau_g[ELBOW_NG])
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL ||
        f_tool == NULL || a_a == NULL || a_m == NULL || tau_g == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (forward_dynamics_tool_force_evaluate_1(q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m,
        tau_g) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, q_m, v_m, tau_m, f_tool};
        real *const out[] = {a_a, a_m, tau_g};
        return first_failed(&forward_dynamics_tool_force_shape, in, out, 1, 1);
    }
}

static int forward_dynamics_tool_force_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_forward_dynamics_tool_force(in[0], in[1], in[2], in[3], in[4], in[5], out[0],
        out[1], out[2]) != ELBOW_OK;
}

elbow_status elbow_forward_dynamics_tool_force_batch_strided(int n, int stride,
    const elbow_real *q_a, const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m,
    const elbow_real *tau_m, const elbow_real *f_tool, elbow_real *a_a, elbow_real *a_m,
    elbow_real *tau_g, elbow_real *work)
{
    const real *const in[] = {q_a, v_a, q_m, v_m, tau_m, f_tool};
    real *const out[] = {a_a, a_m, tau_g};
    return evaluate_points(&forward_dynamics_tool_force_shape, forward_dynamics_tool_force_one,
        forward_dynamics_tool_force_lanes, in, out, n, stride, work);
}

elbow_status elbow_forward_dynamics_tool_force_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m,
    const elbow_real *f_tool, elbow_real *a_a, elbow_real *a_m, elbow_real *tau_g,
    elbow_real *work)
{
    return elbow_forward_dynamics_tool_force_batch_strided(n, n, q_a, v_a, q_m, v_m, tau_m,
        f_tool, a_a, a_m, tau_g, work);
}
