/* elbow: forward_dynamics. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_forward_dynamics_math.h"

#include "elbow_lanes.h"
#include "elbow_forward_dynamics_math.h"

#include "elbow_undefine.h"

static const function_shape forward_dynamics_shape = {
    5, 2, -1, 0, 64, {2, 2, 2, 2, 2, 2, 2}};

static lanes forward_dynamics_lanes(const real *const *in, real *const *out, lanes *work,
    int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += forward_dynamics_evaluate_v(in[0] + k, in[1] + k, in[2] + k, in[3] + k,
            in[4] + k, out[0] + k, out[1] + k, n);
    }
    return zero;
}

elbow_status elbow_forward_dynamics(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real q_m[ELBOW_NM],
    const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM], elbow_real a_a[ELBOW_NA],
    elbow_real a_m[ELBOW_NM])
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || a_a == NULL
        || a_m == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (forward_dynamics_evaluate_1(q_a, v_a, q_m, v_m, tau_m, a_a, a_m) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, q_m, v_m, tau_m};
        real *const out[] = {a_a, a_m};
        return first_failed(&forward_dynamics_shape, in, out, 1, 1);
    }
}

static int forward_dynamics_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_forward_dynamics(in[0], in[1], in[2], in[3], in[4], out[0], out[1]) != ELBOW_OK;
}

elbow_status elbow_forward_dynamics_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m,
    elbow_real *a_a, elbow_real *a_m, elbow_real *work)
{
    const real *const in[] = {q_a, v_a, q_m, v_m, tau_m};
    real *const out[] = {a_a, a_m};
    return evaluate_points(&forward_dynamics_shape, forward_dynamics_one, forward_dynamics_lanes,
        in, out, n, stride, work);
}

elbow_status elbow_forward_dynamics_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m, elbow_real *a_a,
    elbow_real *a_m, elbow_real *work)
{
    return elbow_forward_dynamics_batch_strided(n, n, q_a, v_a, q_m, v_m, tau_m, a_a, a_m, work);
}
