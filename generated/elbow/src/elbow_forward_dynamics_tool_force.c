/* elbow: forward_dynamics_tool_force. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, then lanes of numbers */
#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_forward_dynamics_tool_force.c"

#include "elbow_lanes.h"
#include "elbow_forward_dynamics_tool_force.c"

#define NAME(suffix) forward_dynamics_tool_force_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT, LAST) \
    INPUT(q_a, 2) INPUT(v_a, 2) INPUT(q_m, 2) INPUT(v_m, 2) INPUT(tau_m, 2) INPUT(f_tool, 6) OUTPUT(a_a, 2) \
    OUTPUT(a_m, 2) LAST(tau_g, 2)
#define WORK 0
#define SINGLE elbow_forward_dynamics_tool_force
#define TILE 64
#define RESULTS 6
#include "elbow_function.h"
#include "elbow_undefine.h"
#else /* the mathematics */
static T F(forward_dynamics_tool_force_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, const real *RESTRICT tau_m, const real *RESTRICT f_tool, real *RESTRICT a_a, real *RESTRICT a_m, real *RESTRICT tau_g STRIDE(ptrdiff_t n))
{
    T t4 = IN(q_a, 0);
    T t18 = IN(q_a, 1);
    SINES_COSINES(4, 2, t4, t18)
    T t15 = cosine4[0];
    T t19 = sine4[0];
    T t20 = sine4[1];
    T t21 = cosine4[1];
    T t22 = t19 * t21;
    T t23 = t15 * t20;
    T t40 = IN(q_m, 1);
    T t41 = 0.003963011889035667 * t40;
    T t45 = IN(v_m, 1);
    T t46 = 0.003963011889035667 * t45;
    T t25 = t15 * t21;
    T t26 = t19 * t20;
    T t10 = IN(v_a, 0);
    T t61 = 1.15 * t10;
    T t2 = IN(q_m, 0);
    T t3 = 0.003739316239316239 * t2;
    T t8 = IN(v_m, 0);
    T t9 = 0.003739316239316239 * t8;
    T t16 = 1.15 * t15;
    T t60 = 9.81 * t15;
    T t65 = 9.81 * t20;
    T t47 = IN(v_a, 1);
    T t72 = t10 + t47;
    T t32 = 1.15 * t19;
    T t79 = 3613.4097102000005 * t19;
    T t70 = 0.9854020620164352 * t20;
    T t87 = 115.28870628581926 * t20;
    T t24 = t22 + t23;
    T t42 = t18 - t41;
    T t48 = t46 - t47;
    T t96 = 101.7361875 * t20;
    T t27 = t25 - t26;
    T t62 = t10 * t61;
    T t5 = t3 - t4;
    T t11 = t9 - t10;
    T t66 = t19 * t65;
    T t73 = 88.46625 * t72;
    T t88 = t20 * t87;
    T t28 = 1.241 * t24;
    T t43 = 4099900.0 * t42;
    T t49 = 600.0 * t48;
    T t33 = 1.241 * t27;
    T t63 = t60 - t62;
    T t6 = 7518900.0 * t5;
    T t12 = 1400.0 * t11;
    T t74 = t72 * t73;
    T t90 = t88 - 406.22802171999996;
    T t29 = t16 - t28;
    T t50 = t43 - t49;
    OUT(tau_g, 1, -t50);
    T t35 = IN(f_tool, 2);
    T t53 = t33 * t35;
    T t64 = t21 * t63;
    T t34 = t32 + t33;
    T t13 = t6 + t12;
    OUT(tau_g, 0, t13);
    T t75 = t21 * t74;
    T t51 = t16 - t29;
    T t30 = IN(f_tool, 0);
    T t31 = t29 * t30;
    T t37 = IN(f_tool, 4);
    T t54 = t37 - t50;
    T t109 = 0.003963011889035667 * t50;
    T t67 = t64 - t66;
    T t36 = t34 * t35;
    T t80 = t13 + t37;
    T t105 = 0.003739316239316239 * t13;
    T t52 = t30 * t51;
    T t55 = t53 - t54;
    T t108 = IN(tau_m, 1);
    T t110 = t108 + t109;
    T t68 = 88.46625 * t67;
    T t81 = t79 + t80;
    T t104 = IN(tau_m, 0);
    T t106 = t104 - t105;
    T t56 = t52 + t55;
    T t111 = 84.74576271186442 * t110;
    OUT(a_m, 1, t111);
    T t82 = t31 + t81;
    T t107 = 84.74576271186442 * t106;
    OUT(a_m, 0, t107);
    T t69 = t56 - t68;
    T t83 = t36 - t82;
    T t71 = t69 * t70;
    T t84 = t56 - t83;
    T t76 = t71 - t75;
    T t77 = 1.15 * t76;
    T t85 = t77 - t84;
    T t91 = t85 / t90;
    T t93 = F(guarded)(t91, -t90, F(splat)(1.1368683772161603e-13));
    OUT(a_a, 0, t93);
    T t97 = t93 * t96;
    T t99 = 89.77680625 * t93;
    T t100 = t69 - t97;
    T t101 = t99 + t100;
    T t102 = 0.011138734398897152 * t101;
    OUT(a_a, 1, -t102);
    T z118 = 0.0 * t50 + (0.0 * IN(f_tool, 5) + (0.0 * IN(f_tool, 1) + 0.0 * IN(f_tool, 3)) + 0.0 * t13);
    return 0.0 * t111 + (z118 + 0.0 * t107) + 0.0 * t93 + 0.0 * t102;
}
#endif
