/* elbow: inversion_rows. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_inversion_rows_math.h"

#include "elbow_lanes.h"
#include "elbow_inversion_rows_math.h"

#include "elbow_undefine.h"

static const function_shape inversion_rows_shape = {
    3, 1, -1, 0, 64, {2, 2, 2, 2}};

static lanes inversion_rows_lanes(const real *const *in, real *const *out, lanes *work,
    int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += inversion_rows_evaluate_v(in[0] + k, in[1] + k, in[2] + k, out[0] + k, n);
    }
    return zero;
}

elbow_status elbow_inversion_rows(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real tau_g[ELBOW_NG])
{
    if (q_a == NULL || v_a == NULL || a_a == NULL || tau_g == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (inversion_rows_evaluate_1(q_a, v_a, a_a, tau_g) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, a_a};
        real *const out[] = {tau_g};
        return first_failed(&inversion_rows_shape, in, out, 1, 1);
    }
}

static int inversion_rows_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_inversion_rows(in[0], in[1], in[2], out[0]) != ELBOW_OK;
}

elbow_status elbow_inversion_rows_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, elbow_real *tau_g, elbow_real *work)
{
    const real *const in[] = {q_a, v_a, a_a};
    real *const out[] = {tau_g};
    return evaluate_points(&inversion_rows_shape, inversion_rows_one, inversion_rows_lanes, in,
        out, n, stride, work);
}

elbow_status elbow_inversion_rows_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *a_a, elbow_real *tau_g, elbow_real *work)
{
    return elbow_inversion_rows_batch_strided(n, n, q_a, v_a, a_a, tau_g, work);
}
