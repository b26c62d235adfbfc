/* elbow: jacobian. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_jacobian_math.h"

#include "elbow_lanes.h"
#include "elbow_jacobian_math.h"

#include "elbow_undefine.h"

static const function_shape jacobian_shape = {
    1, 1, -1, 0, 64, {2, 6 * 2}};

static lanes jacobian_lanes(const real *const *in, real *const *out, lanes *work, int count,
    ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += jacobian_evaluate_v(in[0] + k, out[0] + k, n);
    }
    return zero;
}

elbow_status elbow_jacobian(const elbow_real q_a[ELBOW_NA], elbow_real J[6 * ELBOW_NA])
{
    if (q_a == NULL || J == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (jacobian_evaluate_1(q_a, J) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a};
        real *const out[] = {J};
        return first_failed(&jacobian_shape, in, out, 1, 1);
    }
}

static int jacobian_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_jacobian(in[0], out[0]) != ELBOW_OK;
}

elbow_status elbow_jacobian_batch_strided(int n, int stride, const elbow_real *q_a,
    elbow_real *J, elbow_real *work)
{
    const real *const in[] = {q_a};
    real *const out[] = {J};
    return evaluate_points(&jacobian_shape, jacobian_one, jacobian_lanes, in, out, n, stride,
        work);
}

elbow_status elbow_jacobian_batch(int n, const elbow_real *q_a, elbow_real *J, elbow_real *work)
{
    return elbow_jacobian_batch_strided(n, n, q_a, J, work);
}
