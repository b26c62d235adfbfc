/* elbow: tool_motion. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_tool_motion.c"

#include "elbow_lanes.h"
#include "elbow_tool_motion.c"

#define NAME(suffix) tool_motion_##suffix
#define PUBLIC(suffix) elbow_tool_motion_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(a_a, ELBOW_NA) OUTPUT(v_tool, 6) OUTPUT(a_tool, 6)
#define WORK 0
#define SINGLE elbow_tool_motion(at_q_a, at_v_a, at_a_a, at_v_tool, at_a_tool)
#define TILE 64
#define RESULTS 12
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_tool_motion(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real v_tool[6], elbow_real a_tool[6])
{
    if (q_a == NULL || v_a == NULL || a_a == NULL || v_tool == NULL || a_tool == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return tool_motion_evaluate_1(q_a, v_a, a_a, v_tool, a_tool) == 0 ? ELBOW_OK : tool_motion_failed(q_a, v_a, a_a, v_tool, a_tool, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(tool_motion_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT a_a, real *RESTRICT v_tool, real *RESTRICT a_tool STRIDE(ptrdiff_t n))
{
    const T t2 = IN(q_a, 0);
    const T t6 = IN(q_a, 1);
    const T t7 = t2 + t6;
    const T angle2[ANGLES(2)] = {t2, t7};
    T sine2[ANGLES(2)], cosine2[ANGLES(2)];
    F(sincos)(angle2, sine2, cosine2, 2);
    const T t3 = cosine2[0];
    const T t16 = sine2[0];
    const T t8 = sine2[1];
    const T t18 = cosine2[1];
    const T t0 = IN(v_a, 0);
    const T t12 = IN(v_a, 1);
    const T t24 = t0 + t12;
    OUT(v_tool, 4, t24);
    const T t4 = 1.15 * t3;
    const T t9 = 1.241 * t8;
    const T t17 = 1.15 * t16;
    const T t19 = 1.241 * t18;
    const T t27 = t0 * t0;
    const T t25 = IN(a_a, 0);
    const T t29 = IN(a_a, 1);
    const T t30 = t25 + t29;
    OUT(a_tool, 4, t30);
    const T t32 = t24 * t24;
    const T t26 = t4 * t25;
    const T t10 = t4 - t9;
    const T t39 = t17 * t25;
    const T t20 = t17 + t19;
    const T t28 = t17 * t27;
    const T t31 = t9 * t30;
    const T t38 = t19 * t30;
    const T t40 = t4 * t27;
    const T t13 = t9 * t12;
    const T t22 = t12 * t19;
    const T t33 = t19 * t32;
    const T t37 = t9 * t32;
    const T t11 = t0 * t10;
    const T t21 = t0 * t20;
    const T t34 = t26 - t28;
    const T t41 = t39 + t40;
    const T t35 = t31 + t33;
    const T t42 = t37 - t38;
    const T t14 = t11 - t13;
    OUT(v_tool, 0, t14);
    const T t23 = t21 + t22;
    OUT(v_tool, 2, -t23);
    const T t36 = t34 - t35;
    OUT(a_tool, 0, t36);
    const T t43 = t41 - t42;
    OUT(a_tool, 2, -t43);
    OUT(v_tool, 1, F(splat)(0.0));
    OUT(v_tool, 3, F(splat)(0.0));
    OUT(v_tool, 5, F(splat)(0.0));
    OUT(a_tool, 1, F(splat)(0.0));
    OUT(a_tool, 3, F(splat)(0.0));
    OUT(a_tool, 5, F(splat)(0.0));
    const T z44 = 0.0 * t24 + 0.0 * t30;
    const T z45 = z44 + 0.0 * t14;
    const T z46 = 0.0 * t23 + 0.0 * t36;
    const T z47 = 0.0 * t43 + z45;
    const T z48 = z46 + z47;
    return z48;
}
#endif
