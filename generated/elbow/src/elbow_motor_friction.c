/* elbow: motor_friction. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, then lanes of numbers */
#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_motor_friction.c"

#include "elbow_lanes.h"
#include "elbow_motor_friction.c"

#define NAME(suffix) motor_friction_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT, LAST) \
    INPUT(v_m, 2) LAST(f_m, 2)
#define WORK 0
#define SINGLE elbow_motor_friction
#define TILE 64
#define RESULTS 2
#include "elbow_function.h"
#include "elbow_undefine.h"
#else /* the mathematics */
static T F(motor_friction_evaluate)(const real *RESTRICT v_m, real *RESTRICT f_m STRIDE(ptrdiff_t n))
{
    OUT(f_m, 0, F(splat)(0.0));
    OUT(f_m, 1, F(splat)(0.0));
    return 0.0 * IN(v_m, 0) + 0.0 * IN(v_m, 1);
}
#endif
