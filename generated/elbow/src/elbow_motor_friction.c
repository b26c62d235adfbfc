/* elbow: motor_friction. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_motor_friction.c"

#include "elbow_lanes.h"
#include "elbow_motor_friction.c"

#define NAME(suffix) motor_friction_##suffix
#define PUBLIC(suffix) elbow_motor_friction_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(v_m, ELBOW_NM) OUTPUT(f_m, ELBOW_NM)
#define WORK 0
#define SINGLE elbow_motor_friction(at_v_m, at_f_m)
#define TILE 64
#define RESULTS 2
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_motor_friction(const elbow_real v_m[ELBOW_NM], elbow_real f_m[ELBOW_NM])
{
    if (v_m == NULL || f_m == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return motor_friction_evaluate_1(v_m, f_m) == 0 ? ELBOW_OK : motor_friction_failed(v_m, f_m, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(motor_friction_evaluate)(const real *RESTRICT v_m, real *RESTRICT f_m STRIDE(ptrdiff_t n))
{
    OUT(f_m, 0, F(splat)(0.0));
    OUT(f_m, 1, F(splat)(0.0));
    const T z3 = 0.0 * IN(v_m, 0) + 0.0 * IN(v_m, 1);
    return z3;
}
#endif
