/* elbow: forward_kinematics. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_forward_kinematics.c"

#include "elbow_lanes.h"
#include "elbow_forward_kinematics.c"

#define NAME(suffix) forward_kinematics_##suffix
#define PUBLIC(suffix) elbow_forward_kinematics_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) OUTPUT(p, 3) OUTPUT(R, 3 * 3)
#define WORK 0
#define SINGLE elbow_forward_kinematics(at_q_a, at_p, at_R)
#define TILE 64
#define RESULTS 12
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_forward_kinematics(const elbow_real q_a[ELBOW_NA], elbow_real p[3], elbow_real R[3 * 3])
{
    if (q_a == NULL || p == NULL || R == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return forward_kinematics_evaluate_1(q_a, p, R) == 0 ? ELBOW_OK : forward_kinematics_failed(q_a, p, R, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(forward_kinematics_evaluate)(const real *RESTRICT q_a, real *RESTRICT p, real *RESTRICT R STRIDE(ptrdiff_t n))
{
    const T t1 = IN(q_a, 0);
    const T t5 = IN(q_a, 1);
    const T t6 = t1 + t5;
    const T angle1[ANGLES(2)] = {t1, t6};
    T sine1[ANGLES(2)], cosine1[ANGLES(2)];
    F(sincos)(angle1, sine1, cosine1, 2);
    const T t2 = sine1[0];
    const T t11 = cosine1[0];
    const T t7 = cosine1[1];
    const T t13 = sine1[1];
    OUT(R, 0, t7);
    OUT(R, 8, t7);
    OUT(R, 2, -t13);
    OUT(R, 6, t13);
    const T t3 = 1.15 * t2;
    const T t8 = 1.241 * t7;
    const T t12 = 1.15 * t11;
    const T t14 = 1.241 * t13;
    const T t9 = t3 + t8;
    OUT(p, 0, t9);
    const T t15 = t12 - t14;
    OUT(p, 2, t15);
    OUT(p, 1, F(splat)(0.0));
    OUT(R, 1, F(splat)(0.0));
    OUT(R, 3, F(splat)(0.0));
    OUT(R, 5, F(splat)(0.0));
    OUT(R, 7, F(splat)(0.0));
    OUT(R, 4, F(splat)(1.0));
    const T z17 = 0.0 * t7 + 0.0 * t13;
    const T z18 = z17 + 0.0 * t9;
    const T z19 = 0.0 * t15 + z18;
    return z19;
}
#endif
