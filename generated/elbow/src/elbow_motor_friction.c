/* elbow: motor_friction. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_motor_friction_math.h"

#include "elbow_lanes.h"
#include "elbow_motor_friction_math.h"

#include "elbow_undefine.h"

static const function_shape motor_friction_shape = {
    1, 1, -1, 0, 64, {2, 2}};

static lanes motor_friction_lanes(const real *const *in, real *const *out, lanes *work,
    int count, ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += motor_friction_evaluate_v(in[0] + k, out[0] + k, n);
    }
    return zero;
}

elbow_status elbow_motor_friction(const elbow_real v_m[ELBOW_NM], elbow_real f_m[ELBOW_NM])
{
    if (v_m == NULL || f_m == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (motor_friction_evaluate_1(v_m, f_m) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {v_m};
        real *const out[] = {f_m};
        return first_failed(&motor_friction_shape, in, out, 1, 1);
    }
}

static int motor_friction_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_motor_friction(in[0], out[0]) != ELBOW_OK;
}

elbow_status elbow_motor_friction_batch_strided(int n, int stride, const elbow_real *v_m,
    elbow_real *f_m, elbow_real *work)
{
    const real *const in[] = {v_m};
    real *const out[] = {f_m};
    return evaluate_points(&motor_friction_shape, motor_friction_one, motor_friction_lanes, in,
        out, n, stride, work);
}

elbow_status elbow_motor_friction_batch(int n, const elbow_real *v_m, elbow_real *f_m,
    elbow_real *work)
{
    return elbow_motor_friction_batch_strided(n, n, v_m, f_m, work);
}
