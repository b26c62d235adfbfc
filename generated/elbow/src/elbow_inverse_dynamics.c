/* elbow: inverse_dynamics. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_inverse_dynamics_math.h"

#include "elbow_lanes.h"
#include "elbow_inverse_dynamics_math.h"

#include "elbow_undefine.h"

static const function_shape inverse_dynamics_shape = {
    3, 1, -1, 0, 64, {2, 2, 2, 2}};

static lanes inverse_dynamics_lanes(const real *const *in, real *const *out, lanes *work,
    int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += inverse_dynamics_evaluate_v(in[0] + k, in[1] + k, in[2] + k, out[0] + k, n);
    }
    return zero;
}

elbow_status elbow_inverse_dynamics(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real a_a[ELBOW_NA], elbow_real tau_a[ELBOW_NA])
{
    if (q_a == NULL || v_a == NULL || a_a == NULL || tau_a == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (inverse_dynamics_evaluate_1(q_a, v_a, a_a, tau_a) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, a_a};
        real *const out[] = {tau_a};
        return first_failed(&inverse_dynamics_shape, in, out, 1, 1);
    }
}

static int inverse_dynamics_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_inverse_dynamics(in[0], in[1], in[2], out[0]) != ELBOW_OK;
}

elbow_status elbow_inverse_dynamics_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, elbow_real *tau_a, elbow_real *work)
{
    const real *const in[] = {q_a, v_a, a_a};
    real *const out[] = {tau_a};
    return evaluate_points(&inverse_dynamics_shape, inverse_dynamics_one, inverse_dynamics_lanes,
        in, out, n, stride, work);
}

elbow_status elbow_inverse_dynamics_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *a_a, elbow_real *tau_a, elbow_real *work)
{
    return elbow_inverse_dynamics_batch_strided(n, n, q_a, v_a, a_a, tau_a, work);
}
