/* elbow: jacobian. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_jacobian.c"

#include "elbow_lanes.h"
#include "elbow_jacobian.c"

#define NAME(suffix) jacobian_##suffix
#define PUBLIC(suffix) elbow_jacobian_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) OUTPUT(J, 6 * ELBOW_NA)
#define WORK 0
#define SINGLE elbow_jacobian(at_q_a, at_J)
#define TILE 64
#define RESULTS 12
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_jacobian(const elbow_real q_a[ELBOW_NA], elbow_real J[6 * ELBOW_NA])
{
    if (q_a == NULL || J == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return jacobian_evaluate_1(q_a, J) == 0 ? ELBOW_OK : jacobian_failed(q_a, J, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(jacobian_evaluate)(const real *RESTRICT q_a, real *RESTRICT J STRIDE(ptrdiff_t n))
{
    const T t1 = IN(q_a, 0);
    const T t5 = IN(q_a, 1);
    const T t6 = t1 + t5;
    const T angle1[ANGLES(2)] = {t1, t6};
    T sine1[ANGLES(2)], cosine1[ANGLES(2)];
    F(sincos)(angle1, sine1, cosine1, 2);
    const T t2 = cosine1[0];
    const T t11 = sine1[0];
    const T t7 = sine1[1];
    const T t13 = cosine1[1];
    const T t3 = 1.15 * t2;
    const T t8 = 1.241 * t7;
    const T t12 = 1.15 * t11;
    const T t14 = 1.241 * t13;
    OUT(J, 8, -t14);
    const T t9 = t3 - t8;
    OUT(J, 0, t9);
    const T t15 = t12 + t14;
    OUT(J, 2, -t15);
    const T t17 = t3 - t9;
    OUT(J, 6, -t17);
    OUT(J, 1, F(splat)(0.0));
    OUT(J, 3, F(splat)(0.0));
    OUT(J, 5, F(splat)(0.0));
    OUT(J, 7, F(splat)(0.0));
    OUT(J, 9, F(splat)(0.0));
    OUT(J, 11, F(splat)(0.0));
    OUT(J, 4, F(splat)(1.0));
    OUT(J, 10, F(splat)(1.0));
    const T z18 = 0.0 * t14 + 0.0 * t9;
    const T z19 = 0.0 * t15 + 0.0 * t17;
    const T z20 = z18 + z19;
    return z20;
}
#endif
