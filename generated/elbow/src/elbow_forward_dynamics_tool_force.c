/* elbow: forward_dynamics_tool_force. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_forward_dynamics_tool_force.c"

#include "elbow_lanes.h"
#include "elbow_forward_dynamics_tool_force.c"

#define NAME(suffix) forward_dynamics_tool_force_##suffix
#define PUBLIC(suffix) elbow_forward_dynamics_tool_force_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(q_m, ELBOW_NM) INPUT(v_m, ELBOW_NM) INPUT(tau_m, ELBOW_NM) \
    INPUT(f_tool, 6) OUTPUT(a_a, ELBOW_NA) OUTPUT(a_m, ELBOW_NM) OUTPUT(tau_g, ELBOW_NG)
#define WORK 0
#define SINGLE elbow_forward_dynamics_tool_force(at_q_a, at_v_a, at_q_m, at_v_m, at_tau_m, at_f_tool, at_a_a, at_a_m, at_tau_g)
#define TILE 64
#define RESULTS 6
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_forward_dynamics_tool_force(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM],
    const elbow_real f_tool[6], elbow_real a_a[ELBOW_NA], elbow_real a_m[ELBOW_NM], elbow_real tau_g[ELBOW_NG])
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || f_tool == NULL || a_a == NULL || a_m == NULL || tau_g == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return forward_dynamics_tool_force_evaluate_1(q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m, tau_g) == 0 ? ELBOW_OK : forward_dynamics_tool_force_failed(q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m, tau_g, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(forward_dynamics_tool_force_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, const real *RESTRICT tau_m, const real *RESTRICT f_tool, real *RESTRICT a_a, real *RESTRICT a_m, real *RESTRICT tau_g STRIDE(ptrdiff_t n))
{
    const T t4 = IN(q_a, 0);
    const T t18 = IN(q_a, 1);
    const T angle4[ANGLES(2)] = {t4, t18};
    T sine4[ANGLES(2)], cosine4[ANGLES(2)];
    F(sincos)(angle4, sine4, cosine4, 2);
    const T t15 = cosine4[0];
    const T t19 = sine4[0];
    const T t20 = sine4[1];
    const T t21 = cosine4[1];
    const T t22 = t19 * t21;
    const T t23 = t15 * t20;
    const T t40 = IN(q_m, 1);
    const T t41 = 0.003963011889035667 * t40;
    const T t45 = IN(v_m, 1);
    const T t46 = 0.003963011889035667 * t45;
    const T t25 = t15 * t21;
    const T t26 = t19 * t20;
    const T t10 = IN(v_a, 0);
    const T t61 = 1.15 * t10;
    const T t2 = IN(q_m, 0);
    const T t3 = 0.003739316239316239 * t2;
    const T t8 = IN(v_m, 0);
    const T t9 = 0.003739316239316239 * t8;
    const T t16 = 1.15 * t15;
    const T t60 = 9.81 * t15;
    const T t65 = 9.81 * t20;
    const T t47 = IN(v_a, 1);
    const T t72 = t10 + t47;
    const T t32 = 1.15 * t19;
    const T t79 = 3613.4097102000005 * t19;
    const T t70 = 0.9854020620164352 * t20;
    const T t87 = 115.28870628581926 * t20;
    const T t24 = t22 + t23;
    const T t42 = t18 - t41;
    const T t48 = t46 - t47;
    const T t96 = 101.7361875 * t20;
    const T t27 = t25 - t26;
    const T t62 = t10 * t61;
    const T t5 = t3 - t4;
    const T t11 = t9 - t10;
    const T t66 = t19 * t65;
    const T t73 = 88.46625 * t72;
    const T t88 = t20 * t87;
    const T t28 = 1.241 * t24;
    const T t43 = 4099900.0 * t42;
    const T t49 = 600.0 * t48;
    const T t33 = 1.241 * t27;
    const T t63 = t60 - t62;
    const T t6 = 7518900.0 * t5;
    const T t12 = 1400.0 * t11;
    const T t74 = t72 * t73;
    const T t90 = t88 - 406.22802171999996;
    const T t29 = t16 - t28;
    const T t50 = t43 - t49;
    OUT(tau_g, 1, -t50);
    const T t35 = IN(f_tool, 2);
    const T t53 = t33 * t35;
    const T t64 = t21 * t63;
    const T t34 = t32 + t33;
    const T t13 = t6 + t12;
    OUT(tau_g, 0, t13);
    const T t75 = t21 * t74;
    const T t51 = t16 - t29;
    const T t30 = IN(f_tool, 0);
    const T t31 = t29 * t30;
    const T t37 = IN(f_tool, 4);
    const T t54 = t37 - t50;
    const T t109 = 0.003963011889035667 * t50;
    const T t67 = t64 - t66;
    const T t36 = t34 * t35;
    const T t80 = t13 + t37;
    const T t105 = 0.003739316239316239 * t13;
    const T t52 = t30 * t51;
    const T t55 = t53 - t54;
    const T t108 = IN(tau_m, 1);
    const T t110 = t108 + t109;
    const T t68 = 88.46625 * t67;
    const T t81 = t79 + t80;
    const T t104 = IN(tau_m, 0);
    const T t106 = t104 - t105;
    const T t56 = t52 + t55;
    const T t111 = 84.74576271186442 * t110;
    OUT(a_m, 1, t111);
    const T t82 = t31 + t81;
    const T t107 = 84.74576271186442 * t106;
    OUT(a_m, 0, t107);
    const T t69 = t56 - t68;
    const T t83 = t36 - t82;
    const T t71 = t69 * t70;
    const T t84 = t56 - t83;
    const T t76 = t71 - t75;
    const T t77 = 1.15 * t76;
    const T t85 = t77 - t84;
    const T t91 = t85 / t90;
    const T t93 = F(guarded)(t91, -t90, F(splat)(1.1368683772161603e-13));
    OUT(a_a, 0, t93);
    const T t97 = t93 * t96;
    const T t99 = 89.77680625 * t93;
    const T t100 = t69 - t97;
    const T t101 = t99 + t100;
    const T t102 = 0.011138734398897152 * t101;
    OUT(a_a, 1, -t102);
    const T z115 = 0.0 * IN(f_tool, 1) + 0.0 * IN(f_tool, 3);
    const T z116 = 0.0 * IN(f_tool, 5) + z115;
    const T z117 = z116 + 0.0 * t13;
    const T z118 = 0.0 * t50 + z117;
    const T z119 = z118 + 0.0 * t107;
    const T z120 = 0.0 * t111 + z119;
    const T z121 = z120 + 0.0 * t93;
    const T z122 = z121 + 0.0 * t102;
    return z122;
}
#endif
