/* elbow: gear_law. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_gear_law_math.h"

#include "elbow_lanes.h"
#include "elbow_gear_law_math.h"

#include "elbow_undefine.h"

static const function_shape gear_law_shape = {
    1, 2, -1, 0, 64, {2, 2, 2}};

static lanes gear_law_lanes(const real *const *in, real *const *out, lanes *work, int count,
    ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += gear_law_evaluate_v(in[0] + k, out[0] + k, out[1] + k, n);
    }
    return zero;
}

elbow_status elbow_gear_law(const elbow_real deflection[ELBOW_NG], elbow_real tau_p[ELBOW_NG],
    elbow_real dtau_p[ELBOW_NG])
{
    if (deflection == NULL || tau_p == NULL || dtau_p == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (gear_law_evaluate_1(deflection, tau_p, dtau_p) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {deflection};
        real *const out[] = {tau_p, dtau_p};
        return first_failed(&gear_law_shape, in, out, 1, 1);
    }
}

static int gear_law_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_gear_law(in[0], out[0], out[1]) != ELBOW_OK;
}

elbow_status elbow_gear_law_batch_strided(int n, int stride, const elbow_real *deflection,
    elbow_real *tau_p, elbow_real *dtau_p, elbow_real *work)
{
    const real *const in[] = {deflection};
    real *const out[] = {tau_p, dtau_p};
    return evaluate_points(&gear_law_shape, gear_law_one, gear_law_lanes, in, out, n, stride,
        work);
}

elbow_status elbow_gear_law_batch(int n, const elbow_real *deflection, elbow_real *tau_p,
    elbow_real *dtau_p, elbow_real *work)
{
    return elbow_gear_law_batch_strided(n, n, deflection, tau_p, dtau_p, work);
}
