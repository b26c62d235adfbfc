/* elbow: gravity. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_gravity.c"

#include "elbow_lanes.h"
#include "elbow_gravity.c"

#define NAME(suffix) gravity_##suffix
#define PUBLIC(suffix) elbow_gravity_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) OUTPUT(g, ELBOW_NA)
#define WORK 0
#define SINGLE elbow_gravity(at_q_a, at_g)
#define TILE 64
#define RESULTS 2
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_gravity(const elbow_real q_a[ELBOW_NA], elbow_real g[ELBOW_NA])
{
    if (q_a == NULL || g == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return gravity_evaluate_1(q_a, g) == 0 ? ELBOW_OK : gravity_failed(q_a, g, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(gravity_evaluate)(const real *RESTRICT q_a, real *RESTRICT g STRIDE(ptrdiff_t n))
{
    const T t1 = IN(q_a, 0);
    const T t5 = IN(q_a, 1);
    const T t6 = t1 + t5;
    const T angle1[ANGLES(2)] = {t1, t6};
    T sine1[ANGLES(2)], cosine1[ANGLES(2)];
    F(sincos)(angle1, sine1, cosine1, 2);
    const T t2 = sine1[0];
    const T t7 = cosine1[1];
    const T t3 = 3613.4097102000005 * t2;
    const T t8 = 867.8539125000001 * t7;
    OUT(g, 1, -t8);
    const T t9 = t3 + t8;
    OUT(g, 0, -t9);
    const T z10 = 0.0 * t8 + 0.0 * t9;
    return z10;
}
#endif
