/* elbow: gear_law. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_gear_law.c"

#include "elbow_lanes.h"
#include "elbow_gear_law.c"

#define NAME(suffix) gear_law_##suffix
#define PUBLIC(suffix) elbow_gear_law_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(deflection, ELBOW_NG) OUTPUT(tau_p, ELBOW_NG) OUTPUT(dtau_p, ELBOW_NG)
#define WORK 0
#define SINGLE elbow_gear_law(at_deflection, at_tau_p, at_dtau_p)
#define TILE 64
#define RESULTS 4
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_gear_law(const elbow_real deflection[ELBOW_NG], elbow_real tau_p[ELBOW_NG],
    elbow_real dtau_p[ELBOW_NG])
{
    if (deflection == NULL || tau_p == NULL || dtau_p == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return gear_law_evaluate_1(deflection, tau_p, dtau_p) == 0 ? ELBOW_OK : gear_law_failed(deflection, tau_p, dtau_p, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(gear_law_evaluate)(const real *RESTRICT deflection, real *RESTRICT tau_p, real *RESTRICT dtau_p STRIDE(ptrdiff_t n))
{
    const T t1 = IN(deflection, 0);
    const T t2 = 7518900.0 * t1;
    OUT(tau_p, 0, t2);
    const T t4 = IN(deflection, 1);
    const T t5 = 4099900.0 * t4;
    OUT(tau_p, 1, t5);
    OUT(dtau_p, 0, F(splat)(7518900.0));
    OUT(dtau_p, 1, F(splat)(4099900.0));
    const T z6 = 0.0 * t2 + 0.0 * t5;
    return z6;
}
#endif
