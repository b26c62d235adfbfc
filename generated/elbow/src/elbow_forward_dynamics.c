/* elbow: forward_dynamics. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_forward_dynamics.c"

#include "elbow_lanes.h"
#include "elbow_forward_dynamics.c"

#define NAME(suffix) forward_dynamics_##suffix
#define PUBLIC(suffix) elbow_forward_dynamics_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(q_m, ELBOW_NM) INPUT(v_m, ELBOW_NM) INPUT(tau_m, ELBOW_NM) \
    OUTPUT(a_a, ELBOW_NA) OUTPUT(a_m, ELBOW_NM)
#define WORK 0
#define SINGLE elbow_forward_dynamics(at_q_a, at_v_a, at_q_m, at_v_m, at_tau_m, at_a_a, at_a_m)
#define TILE 64
#define RESULTS 4
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_forward_dynamics(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM],
    elbow_real a_a[ELBOW_NA], elbow_real a_m[ELBOW_NM])
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || a_a == NULL || a_m == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return forward_dynamics_evaluate_1(q_a, v_a, q_m, v_m, tau_m, a_a, a_m) == 0 ? ELBOW_OK : forward_dynamics_failed(q_a, v_a, q_m, v_m, tau_m, a_a, a_m, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(forward_dynamics_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, const real *RESTRICT tau_m, real *RESTRICT a_a, real *RESTRICT a_m STRIDE(ptrdiff_t n))
{
    const T t4 = IN(q_a, 0);
    const T t18 = IN(q_a, 1);
    const T angle4[ANGLES(2)] = {t4, t18};
    T sine4[ANGLES(2)], cosine4[ANGLES(2)];
    F(sincos)(angle4, sine4, cosine4, 2);
    const T t34 = cosine4[0];
    const T t40 = sine4[0];
    const T t29 = sine4[1];
    const T t32 = cosine4[1];
    const T t10 = IN(v_a, 0);
    const T t36 = 1.15 * t10;
    const T t35 = 9.81 * t34;
    const T t16 = IN(q_m, 1);
    const T t17 = 0.003963011889035667 * t16;
    const T t22 = IN(v_m, 1);
    const T t23 = 0.003963011889035667 * t22;
    const T t41 = 9.81 * t29;
    const T t2 = IN(q_m, 0);
    const T t3 = 0.003739316239316239 * t2;
    const T t8 = IN(v_m, 0);
    const T t9 = 0.003739316239316239 * t8;
    const T t24 = IN(v_a, 1);
    const T t48 = t10 + t24;
    const T t46 = 0.9854020620164352 * t29;
    const T t55 = 3613.4097102000005 * t40;
    const T t60 = 115.28870628581926 * t29;
    const T t69 = 101.7361875 * t29;
    const T t37 = t10 * t36;
    const T t19 = t17 - t18;
    const T t25 = t23 - t24;
    const T t42 = t40 * t41;
    const T t5 = t3 - t4;
    const T t11 = t9 - t10;
    const T t49 = 88.46625 * t48;
    const T t61 = t29 * t60;
    const T t38 = t35 - t37;
    const T t20 = 4099900.0 * t19;
    const T t26 = 600.0 * t25;
    const T t6 = 7518900.0 * t5;
    const T t12 = 1400.0 * t11;
    const T t50 = t48 * t49;
    const T t63 = t61 - 406.22802171999996;
    const T t39 = t32 * t38;
    const T t27 = t20 + t26;
    const T t13 = t6 + t12;
    const T t51 = t32 * t50;
    const T t43 = t39 - t42;
    const T t82 = 0.003963011889035667 * t27;
    const T t56 = t13 - t27;
    const T t78 = 0.003739316239316239 * t13;
    const T t44 = 88.46625 * t43;
    const T t81 = IN(tau_m, 1);
    const T t83 = t81 - t82;
    const T t57 = t55 + t56;
    const T t77 = IN(tau_m, 0);
    const T t79 = t77 - t78;
    const T t45 = t27 + t44;
    const T t84 = 84.74576271186442 * t83;
    OUT(a_m, 1, t84);
    const T t80 = 84.74576271186442 * t79;
    OUT(a_m, 0, t80);
    const T t47 = t45 * t46;
    const T t52 = t47 + t51;
    const T t53 = 1.15 * t52;
    const T t58 = t53 + t57;
    const T t64 = t58 / t63;
    const T t66 = F(guarded)(t64, -t63, F(splat)(1.1368683772161603e-13));
    OUT(a_a, 0, -t66);
    const T t70 = t66 * t69;
    const T t72 = 89.77680625 * t66;
    const T t73 = t45 - t70;
    const T t74 = t72 + t73;
    const T t75 = 0.011138734398897152 * t74;
    OUT(a_a, 1, t75);
    const T z85 = 0.0 * t80 + 0.0 * t84;
    const T z86 = z85 + 0.0 * t66;
    const T z87 = z86 + 0.0 * t75;
    return z87;
}
#endif
