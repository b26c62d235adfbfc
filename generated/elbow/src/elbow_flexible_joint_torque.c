/* elbow: flexible_joint_torque. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_flexible_joint_torque_math.h"

#include "elbow_lanes.h"
#include "elbow_flexible_joint_torque_math.h"

#include "elbow_undefine.h"

static const function_shape flexible_joint_torque_shape = {
    7, 1, -1, 0, 64, {2, 2, 2, 2, 2, 2, 2, 2}};

static lanes flexible_joint_torque_lanes(const real *const *in, real *const *out, lanes *work,
    int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += flexible_joint_torque_evaluate_v(in[0] + k, in[1] + k, in[2] + k, in[3] + k,
            in[4] + k, in[5] + k, in[6] + k, out[0] + k, n);
    }
    return zero;
}

elbow_status elbow_flexible_joint_torque(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real a_a[ELBOW_NA],
    const elbow_real j_a[ELBOW_NA], const elbow_real s_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], elbow_real tau_m[ELBOW_NM])
{
    if (q_a == NULL || v_a == NULL || a_a == NULL || j_a == NULL || s_a == NULL || q_m == NULL
        || v_m == NULL || tau_m == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (flexible_joint_torque_evaluate_1(q_a, v_a, a_a, j_a, s_a, q_m, v_m, tau_m) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, a_a, j_a, s_a, q_m, v_m};
        real *const out[] = {tau_m};
        return first_failed(&flexible_joint_torque_shape, in, out, 1, 1);
    }
}

static int flexible_joint_torque_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_flexible_joint_torque(in[0], in[1], in[2], in[3], in[4], in[5], in[6],
        out[0]) != ELBOW_OK;
}

elbow_status elbow_flexible_joint_torque_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, const elbow_real *j_a, const elbow_real *s_a,
    const elbow_real *q_m, const elbow_real *v_m, elbow_real *tau_m, elbow_real *work)
{
    const real *const in[] = {q_a, v_a, a_a, j_a, s_a, q_m, v_m};
    real *const out[] = {tau_m};
    return evaluate_points(&flexible_joint_torque_shape, flexible_joint_torque_one,
        flexible_joint_torque_lanes, in, out, n, stride, work);
}

elbow_status elbow_flexible_joint_torque_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, const elbow_real *j_a, const elbow_real *s_a,
    const elbow_real *q_m, const elbow_real *v_m, elbow_real *tau_m, elbow_real *work)
{
    return elbow_flexible_joint_torque_batch_strided(n, n, q_a, v_a, a_a, j_a, s_a, q_m, v_m,
        tau_m, work);
}
