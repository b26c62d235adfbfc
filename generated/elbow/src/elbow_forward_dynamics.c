/* elbow: forward_dynamics. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, then lanes of numbers */
#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_forward_dynamics.c"

#include "elbow_lanes.h"
#include "elbow_forward_dynamics.c"

#define NAME(suffix) forward_dynamics_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT, LAST) \
    INPUT(q_a, 2) INPUT(v_a, 2) INPUT(q_m, 2) INPUT(v_m, 2) INPUT(tau_m, 2) OUTPUT(a_a, 2) LAST(a_m, 2)
#define WORK 0
#define SINGLE elbow_forward_dynamics
#define TILE 64
#define RESULTS 4
#include "elbow_function.h"
#include "elbow_undefine.h"
#else /* the mathematics */
static T F(forward_dynamics_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, const real *RESTRICT tau_m, real *RESTRICT a_a, real *RESTRICT a_m STRIDE(ptrdiff_t n))
{
    T t4 = IN(q_a, 0);
    T t18 = IN(q_a, 1);
    SINES_COSINES(4, 2, t4, t18)
    T t34 = cosine4[0];
    T t40 = sine4[0];
    T t29 = sine4[1];
    T t32 = cosine4[1];
    T t10 = IN(v_a, 0);
    T t36 = 1.15 * t10;
    T t35 = 9.81 * t34;
    T t16 = IN(q_m, 1);
    T t17 = 0.003963011889035667 * t16;
    T t22 = IN(v_m, 1);
    T t23 = 0.003963011889035667 * t22;
    T t41 = 9.81 * t29;
    T t2 = IN(q_m, 0);
    T t3 = 0.003739316239316239 * t2;
    T t8 = IN(v_m, 0);
    T t9 = 0.003739316239316239 * t8;
    T t24 = IN(v_a, 1);
    T t48 = t10 + t24;
    T t46 = 0.9854020620164352 * t29;
    T t55 = 3613.4097102000005 * t40;
    T t60 = 115.28870628581926 * t29;
    T t69 = 101.7361875 * t29;
    T t37 = t10 * t36;
    T t19 = t17 - t18;
    T t25 = t23 - t24;
    T t42 = t40 * t41;
    T t5 = t3 - t4;
    T t11 = t9 - t10;
    T t49 = 88.46625 * t48;
    T t61 = t29 * t60;
    T t38 = t35 - t37;
    T t20 = 4099900.0 * t19;
    T t26 = 600.0 * t25;
    T t6 = 7518900.0 * t5;
    T t12 = 1400.0 * t11;
    T t50 = t48 * t49;
    T t63 = t61 - 406.22802171999996;
    T t39 = t32 * t38;
    T t27 = t20 + t26;
    T t13 = t6 + t12;
    T t51 = t32 * t50;
    T t43 = t39 - t42;
    T t82 = 0.003963011889035667 * t27;
    T t56 = t13 - t27;
    T t78 = 0.003739316239316239 * t13;
    T t44 = 88.46625 * t43;
    T t81 = IN(tau_m, 1);
    T t83 = t81 - t82;
    T t57 = t55 + t56;
    T t77 = IN(tau_m, 0);
    T t79 = t77 - t78;
    T t45 = t27 + t44;
    T t84 = 84.74576271186442 * t83;
    OUT(a_m, 1, t84);
    T t80 = 84.74576271186442 * t79;
    OUT(a_m, 0, t80);
    T t47 = t45 * t46;
    T t52 = t47 + t51;
    T t53 = 1.15 * t52;
    T t58 = t53 + t57;
    T t64 = t58 / t63;
    T t66 = F(guarded)(t64, -t63, F(splat)(1.1368683772161603e-13));
    OUT(a_a, 0, -t66);
    T t70 = t66 * t69;
    T t72 = 89.77680625 * t66;
    T t73 = t45 - t70;
    T t74 = t72 + t73;
    T t75 = 0.011138734398897152 * t74;
    OUT(a_a, 1, t75);
    return 0.0 * t80 + 0.0 * t84 + 0.0 * t66 + 0.0 * t75;
}
#endif
