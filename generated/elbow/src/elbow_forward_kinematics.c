/* elbow: forward_kinematics. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_forward_kinematics_math.h"

#include "elbow_lanes.h"
#include "elbow_forward_kinematics_math.h"

#include "elbow_undefine.h"

static const function_shape forward_kinematics_shape = {
    1, 2, -1, 0, 64, {2, 3, 3 * 3}};

static lanes forward_kinematics_lanes(const real *const *in, real *const *out, lanes *work,
    int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += forward_kinematics_evaluate_v(in[0] + k, out[0] + k, out[1] + k, n);
    }
    return zero;
}

elbow_status elbow_forward_kinematics(const elbow_real q_a[ELBOW_NA], elbow_real p[3],
    elbow_real R[3 * 3])
{
    if (q_a == NULL || p == NULL || R == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (forward_kinematics_evaluate_1(q_a, p, R) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a};
        real *const out[] = {p, R};
        return first_failed(&forward_kinematics_shape, in, out, 1, 1);
    }
}

static int forward_kinematics_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_forward_kinematics(in[0], out[0], out[1]) != ELBOW_OK;
}

elbow_status elbow_forward_kinematics_batch_strided(int n, int stride, const elbow_real *q_a,
    elbow_real *p, elbow_real *R, elbow_real *work)
{
    const real *const in[] = {q_a};
    real *const out[] = {p, R};
    return evaluate_points(&forward_kinematics_shape, forward_kinematics_one,
        forward_kinematics_lanes, in, out, n, stride, work);
}

elbow_status elbow_forward_kinematics_batch(int n, const elbow_real *q_a, elbow_real *p,
    elbow_real *R, elbow_real *work)
{
    return elbow_forward_kinematics_batch_strided(n, n, q_a, p, R, work);
}
