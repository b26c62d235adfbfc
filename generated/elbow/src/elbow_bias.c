/* elbow: bias. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_bias.c"

#include "elbow_lanes.h"
#include "elbow_bias.c"

#define NAME(suffix) bias_##suffix
#define PUBLIC(suffix) elbow_bias_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) OUTPUT(h, ELBOW_NA)
#define WORK 0
#define SINGLE elbow_bias(at_q_a, at_v_a, at_h)
#define TILE 64
#define RESULTS 2
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_bias(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA], elbow_real h[ELBOW_NA])
{
    if (q_a == NULL || v_a == NULL || h == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return bias_evaluate_1(q_a, v_a, h) == 0 ? ELBOW_OK : bias_failed(q_a, v_a, h, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(bias_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, real *RESTRICT h STRIDE(ptrdiff_t n))
{
    const T t1 = IN(q_a, 0);
    const T t5 = IN(q_a, 1);
    const T angle1[ANGLES(2)] = {t1, t5};
    T sine1[ANGLES(2)], cosine1[ANGLES(2)];
    F(sincos)(angle1, sine1, cosine1, 2);
    const T t2 = sine1[0];
    const T t8 = cosine1[0];
    const T t6 = cosine1[1];
    const T t16 = sine1[1];
    const T t11 = IN(v_a, 0);
    const T t12 = 1.15 * t11;
    const T t9 = 9.81 * t8;
    const T t21 = IN(v_a, 1);
    const T t22 = t11 + t21;
    const T t17 = 9.81 * t16;
    const T t3 = 3613.4097102000005 * t2;
    const T t13 = t11 * t12;
    const T t24 = 101.7361875 * t22;
    const T t18 = t2 * t17;
    const T t14 = t9 - t13;
    const T t25 = t22 * t24;
    const T t15 = t6 * t14;
    const T t26 = t6 * t25;
    const T t19 = t15 - t18;
    const T t27 = t3 + t26;
    const T t20 = 88.46625 * t19;
    OUT(h, 1, -t20);
    const T t28 = t20 + t27;
    OUT(h, 0, -t28);
    const T z29 = 0.0 * t20 + 0.0 * t28;
    return z29;
}
#endif
