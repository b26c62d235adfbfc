/* elbow: gear_law. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, then lanes of numbers */
#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_gear_law.c"

#include "elbow_lanes.h"
#include "elbow_gear_law.c"

#define NAME(suffix) gear_law_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT, LAST) \
    INPUT(deflection, 2) OUTPUT(tau_p, 2) LAST(dtau_p, 2)
#define WORK 0
#define SINGLE elbow_gear_law
#define TILE 64
#define RESULTS 4
#include "elbow_function.h"
#include "elbow_undefine.h"
#else /* the mathematics */
static T F(gear_law_evaluate)(const real *RESTRICT deflection, real *RESTRICT tau_p, real *RESTRICT dtau_p STRIDE(ptrdiff_t n))
{
    T t1 = IN(deflection, 0);
    T t2 = 7518900.0 * t1;
    OUT(tau_p, 0, t2);
    T t4 = IN(deflection, 1);
    T t5 = 4099900.0 * t4;
    OUT(tau_p, 1, t5);
    OUT(dtau_p, 0, F(splat)(7518900.0));
    OUT(dtau_p, 1, F(splat)(4099900.0));
    return 0.0 * t2 + 0.0 * t5;
}
#endif
