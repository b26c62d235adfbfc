/* elbow: arm_forward_dynamics. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_arm_forward_dynamics.c"

#include "elbow_lanes.h"
#include "elbow_arm_forward_dynamics.c"

#define NAME(suffix) arm_forward_dynamics_##suffix
#define PUBLIC(suffix) elbow_arm_forward_dynamics_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(tau_a, ELBOW_NA) OUTPUT(a_a, ELBOW_NA)
#define WORK 0
#define SINGLE elbow_arm_forward_dynamics(at_q_a, at_v_a, at_tau_a, at_a_a)
#define TILE 64
#define RESULTS 2
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_arm_forward_dynamics(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real tau_a[ELBOW_NA], elbow_real a_a[ELBOW_NA])
{
    if (q_a == NULL || v_a == NULL || tau_a == NULL || a_a == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return arm_forward_dynamics_evaluate_1(q_a, v_a, tau_a, a_a) == 0 ? ELBOW_OK : arm_forward_dynamics_failed(q_a, v_a, tau_a, a_a, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(arm_forward_dynamics_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT tau_a, real *RESTRICT a_a STRIDE(ptrdiff_t n))
{
    const T t3 = IN(q_a, 1);
    const T t9 = IN(q_a, 0);
    const T angle3[ANGLES(2)] = {t3, t9};
    T sine3[ANGLES(2)], cosine3[ANGLES(2)];
    F(sincos)(angle3, sine3, cosine3, 2);
    const T t4 = sine3[0];
    const T t7 = cosine3[0];
    const T t10 = cosine3[1];
    const T t17 = sine3[1];
    const T t12 = IN(v_a, 0);
    const T t13 = 1.15 * t12;
    const T t11 = 9.81 * t10;
    const T t18 = 9.81 * t4;
    const T t25 = IN(v_a, 1);
    const T t26 = t12 + t25;
    const T t23 = 0.9854020620164352 * t4;
    const T t33 = 3613.4097102000005 * t17;
    const T t0 = IN(tau_a, 0);
    const T t1 = IN(tau_a, 1);
    const T t34 = t0 - t1;
    const T t38 = 115.28870628581926 * t4;
    const T t47 = 101.7361875 * t4;
    const T t14 = t12 * t13;
    const T t19 = t17 * t18;
    const T t27 = 88.46625 * t26;
    const T t35 = t33 + t34;
    const T t39 = t4 * t38;
    const T t15 = t11 - t14;
    const T t28 = t26 * t27;
    const T t41 = t39 - 406.22802171999996;
    const T t16 = t7 * t15;
    const T t29 = t7 * t28;
    const T t20 = t16 - t19;
    const T t21 = 88.46625 * t20;
    const T t22 = t1 + t21;
    const T t24 = t22 * t23;
    const T t30 = t24 + t29;
    const T t31 = 1.15 * t30;
    const T t36 = t31 + t35;
    const T t42 = t36 / t41;
    const T t44 = F(guarded)(t42, -t41, F(splat)(1.1368683772161603e-13));
    OUT(a_a, 0, -t44);
    const T t48 = t44 * t47;
    const T t50 = 89.77680625 * t44;
    const T t51 = t22 - t48;
    const T t52 = t50 + t51;
    const T t53 = 0.011138734398897152 * t52;
    OUT(a_a, 1, t53);
    const T z54 = 0.0 * t44 + 0.0 * t53;
    return z54;
}
#endif
