/* elbow: output_constraint. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_output_constraint_math.h"

#include "elbow_lanes.h"
#include "elbow_output_constraint_math.h"

#include "elbow_undefine.h"

static const function_shape output_constraint_shape = {
    3, 3, -1, 0, 64, {2, 2, 2, 2, 2 * 2, 2}};

static lanes output_constraint_lanes(const real *const *in, real *const *out, lanes *work,
    int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += output_constraint_evaluate_v(in[0] + k, in[1] + k, in[2] + k, out[0] + k,
            out[1] + k, out[2] + k, n);
    }
    return zero;
}

elbow_status elbow_output_constraint(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real target[ELBOW_NT],
    elbow_real y_err[ELBOW_NY], elbow_real W[ELBOW_NY * ELBOW_NA], elbow_real Wdot_v[ELBOW_NY])
{
    if (q_a == NULL || v_a == NULL || target == NULL || y_err == NULL || W == NULL ||
        Wdot_v == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (output_constraint_evaluate_1(q_a, v_a, target, y_err, W, Wdot_v) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, target};
        real *const out[] = {y_err, W, Wdot_v};
        return first_failed(&output_constraint_shape, in, out, 1, 1);
    }
}

static int output_constraint_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_output_constraint(in[0], in[1], in[2], out[0], out[1], out[2]) != ELBOW_OK;
}

elbow_status elbow_output_constraint_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *target, elbow_real *y_err, elbow_real *W,
    elbow_real *Wdot_v, elbow_real *work)
{
    const real *const in[] = {q_a, v_a, target};
    real *const out[] = {y_err, W, Wdot_v};
    return evaluate_points(&output_constraint_shape, output_constraint_one,
        output_constraint_lanes, in, out, n, stride, work);
}

elbow_status elbow_output_constraint_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *target, elbow_real *y_err, elbow_real *W, elbow_real *Wdot_v,
    elbow_real *work)
{
    return elbow_output_constraint_batch_strided(n, n, q_a, v_a, target, y_err, W, Wdot_v, work);
}
