/* elbow: bias. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_bias_math.h"

#include "elbow_lanes.h"
#include "elbow_bias_math.h"

#include "elbow_undefine.h"

static const function_shape bias_shape = {
    2, 1, -1, 0, 64, {2, 2, 2}};

static lanes bias_lanes(const real *const *in, real *const *out, lanes *work, int count,
    ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += bias_evaluate_v(in[0] + k, in[1] + k, out[0] + k, n);
    }
    return zero;
}

elbow_status elbow_bias(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    elbow_real h[ELBOW_NA])
{
    if (q_a == NULL || v_a == NULL || h == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (bias_evaluate_1(q_a, v_a, h) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a};
        real *const out[] = {h};
        return first_failed(&bias_shape, in, out, 1, 1);
    }
}

static int bias_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_bias(in[0], in[1], out[0]) != ELBOW_OK;
}

elbow_status elbow_bias_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, elbow_real *h, elbow_real *work)
{
    const real *const in[] = {q_a, v_a};
    real *const out[] = {h};
    return evaluate_points(&bias_shape, bias_one, bias_lanes, in, out, n, stride, work);
}

elbow_status elbow_bias_batch(int n, const elbow_real *q_a, const elbow_real *v_a, elbow_real *h,
    elbow_real *work)
{
    return elbow_bias_batch_strided(n, n, q_a, v_a, h, work);
}
