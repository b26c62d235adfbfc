/* elbow: inverse_dynamics_derivatives. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, then lanes of numbers */
#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_inverse_dynamics_derivatives.c"

#include "elbow_lanes.h"
#include "elbow_inverse_dynamics_derivatives.c"

#define NAME(suffix) inverse_dynamics_derivatives_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT, LAST) \
    INPUT(q_a, 2) INPUT(v_a, 2) INPUT(a_a, 2) OUTPUT(dtau_dq, 2 * 2) OUTPUT(dtau_dv, 2 * 2) LAST(dtau_da, 2 * 2)
#define WORK 0
#define SINGLE elbow_inverse_dynamics_derivatives
#define TILE 64
#define RESULTS 12
#include "elbow_function.h"
#include "elbow_undefine.h"
#else /* the mathematics */
static T F(inverse_dynamics_derivatives_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT a_a, real *RESTRICT dtau_dq, real *RESTRICT dtau_dv, real *RESTRICT dtau_da STRIDE(ptrdiff_t n))
{
    T t1 = IN(q_a, 1);
    T t4 = IN(q_a, 0);
    SINES_COSINES(1, 2, t1, t4)
    T t2 = cosine1[0];
    T t8 = sine1[0];
    T t5 = sine1[1];
    T t9 = cosine1[1];
    T t18 = IN(v_a, 0);
    T t19 = IN(v_a, 1);
    T t20 = t18 + t19;
    T t34 = 1.15 * t18;
    T t6 = 9.81 * t5;
    T t10 = 9.81 * t9;
    T t24 = IN(a_a, 0);
    T t25 = IN(a_a, 1);
    T t26 = t24 + t25;
    T t31 = 1.15 * t24;
    T t43 = 203.472375 * t18;
    T t15 = 3613.4097102000005 * t9;
    T t54 = 203.472375 * t8;
    T t63 = 101.7361875 * t8;
    T t21 = 88.46625 * t20;
    T t35 = t18 * t34;
    T t7 = t2 * t6;
    T t11 = t8 * t10;
    T t27 = 88.46625 * t26;
    T t32 = t6 - t31;
    T t46 = 203.472375 * t20;
    T t44 = t2 * t43;
    OUT(dtau_dv, 1, t44);
    T t61 = t54 - 496.00482796999995;
    OUT(dtau_da, 0, -t61);
    T t65 = t63 - 89.77680625;
    OUT(dtau_da, 1, -t65);
    OUT(dtau_da, 2, -t65);
    T t22 = t20 * t21;
    T t36 = t10 - t35;
    T t12 = t7 + t11;
    T t28 = t2 * t27;
    T t33 = t2 * t32;
    T t47 = t2 * t46;
    OUT(dtau_dv, 2, -t47);
    T t23 = t8 * t22;
    T t37 = t8 * t36;
    T t13 = 88.46625 * t12;
    OUT(dtau_dq, 1, t13);
    T t48 = t44 - t47;
    OUT(dtau_dv, 0, t48);
    T t29 = t23 - t28;
    T t38 = t33 + t37;
    T t16 = t13 - t15;
    OUT(dtau_dq, 0, t16);
    T t30 = 1.15 * t29;
    T t39 = 88.46625 * t38;
    OUT(dtau_dq, 3, t39);
    T t40 = t30 + t39;
    OUT(dtau_dq, 2, t40);
    OUT(dtau_dv, 3, F(splat)(0.0));
    OUT(dtau_da, 3, F(splat)(89.77680625));
    T z73 = 0.0 * t16 + 0.0 * t39 + (0.0 * t13 + (0.0 * t48 + 0.0 * t61 + (0.0 * t65 + (0.0 * t44 + 0.0 * t47))) + 0.0 * t40);
    return z73;
}
#endif
