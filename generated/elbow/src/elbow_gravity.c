/* elbow: gravity. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_gravity_math.h"

#include "elbow_lanes.h"
#include "elbow_gravity_math.h"

#include "elbow_undefine.h"

static const function_shape gravity_shape = {
    1, 1, -1, 0, 64, {2, 2}};

static lanes gravity_lanes(const real *const *in, real *const *out, lanes *work, int count,
    ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += gravity_evaluate_v(in[0] + k, out[0] + k, n);
    }
    return zero;
}

elbow_status elbow_gravity(const elbow_real q_a[ELBOW_NA], elbow_real g[ELBOW_NA])
{
    if (q_a == NULL || g == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (gravity_evaluate_1(q_a, g) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a};
        real *const out[] = {g};
        return first_failed(&gravity_shape, in, out, 1, 1);
    }
}

static int gravity_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_gravity(in[0], out[0]) != ELBOW_OK;
}

elbow_status elbow_gravity_batch_strided(int n, int stride, const elbow_real *q_a, elbow_real *g,
    elbow_real *work)
{
    const real *const in[] = {q_a};
    real *const out[] = {g};
    return evaluate_points(&gravity_shape, gravity_one, gravity_lanes, in, out, n, stride, work);
}

elbow_status elbow_gravity_batch(int n, const elbow_real *q_a, elbow_real *g, elbow_real *work)
{
    return elbow_gravity_batch_strided(n, n, q_a, g, work);
}
