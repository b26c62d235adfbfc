/* elbow: inverse_dynamics_derivatives. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_inverse_dynamics_derivatives.c"

#include "elbow_lanes.h"
#include "elbow_inverse_dynamics_derivatives.c"

#define NAME(suffix) inverse_dynamics_derivatives_##suffix
#define PUBLIC(suffix) elbow_inverse_dynamics_derivatives_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(a_a, ELBOW_NA) OUTPUT(dtau_dq, ELBOW_NA * ELBOW_NA) \
    OUTPUT(dtau_dv, ELBOW_NA * ELBOW_NA) OUTPUT(dtau_da, ELBOW_NA * ELBOW_NA)
#define WORK 0
#define SINGLE elbow_inverse_dynamics_derivatives(at_q_a, at_v_a, at_a_a, at_dtau_dq, at_dtau_dv, at_dtau_da)
#define TILE 64
#define RESULTS 12
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_inverse_dynamics_derivatives(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real dtau_dq[ELBOW_NA * ELBOW_NA],
    elbow_real dtau_dv[ELBOW_NA * ELBOW_NA], elbow_real dtau_da[ELBOW_NA * ELBOW_NA])
{
    if (q_a == NULL || v_a == NULL || a_a == NULL || dtau_dq == NULL || dtau_dv == NULL || dtau_da == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return inverse_dynamics_derivatives_evaluate_1(q_a, v_a, a_a, dtau_dq, dtau_dv, dtau_da) == 0 ? ELBOW_OK : inverse_dynamics_derivatives_failed(q_a, v_a, a_a, dtau_dq, dtau_dv, dtau_da, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(inverse_dynamics_derivatives_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT a_a, real *RESTRICT dtau_dq, real *RESTRICT dtau_dv, real *RESTRICT dtau_da STRIDE(ptrdiff_t n))
{
    const T t1 = IN(q_a, 1);
    const T t4 = IN(q_a, 0);
    const T angle1[ANGLES(2)] = {t1, t4};
    T sine1[ANGLES(2)], cosine1[ANGLES(2)];
    F(sincos)(angle1, sine1, cosine1, 2);
    const T t2 = cosine1[0];
    const T t8 = sine1[0];
    const T t5 = sine1[1];
    const T t9 = cosine1[1];
    const T t18 = IN(v_a, 0);
    const T t19 = IN(v_a, 1);
    const T t20 = t18 + t19;
    const T t34 = 1.15 * t18;
    const T t6 = 9.81 * t5;
    const T t10 = 9.81 * t9;
    const T t24 = IN(a_a, 0);
    const T t25 = IN(a_a, 1);
    const T t26 = t24 + t25;
    const T t31 = 1.15 * t24;
    const T t43 = 203.472375 * t18;
    const T t15 = 3613.4097102000005 * t9;
    const T t54 = 203.472375 * t8;
    const T t63 = 101.7361875 * t8;
    const T t21 = 88.46625 * t20;
    const T t35 = t18 * t34;
    const T t7 = t2 * t6;
    const T t11 = t8 * t10;
    const T t27 = 88.46625 * t26;
    const T t32 = t6 - t31;
    const T t46 = 203.472375 * t20;
    const T t44 = t2 * t43;
    OUT(dtau_dv, 1, t44);
    const T t61 = t54 - 496.00482796999995;
    OUT(dtau_da, 0, -t61);
    const T t65 = t63 - 89.77680625;
    OUT(dtau_da, 1, -t65);
    OUT(dtau_da, 2, -t65);
    const T t22 = t20 * t21;
    const T t36 = t10 - t35;
    const T t12 = t7 + t11;
    const T t28 = t2 * t27;
    const T t33 = t2 * t32;
    const T t47 = t2 * t46;
    OUT(dtau_dv, 2, -t47);
    const T t23 = t8 * t22;
    const T t37 = t8 * t36;
    const T t13 = 88.46625 * t12;
    OUT(dtau_dq, 1, t13);
    const T t48 = t44 - t47;
    OUT(dtau_dv, 0, t48);
    const T t29 = t23 - t28;
    const T t38 = t33 + t37;
    const T t16 = t13 - t15;
    OUT(dtau_dq, 0, t16);
    const T t30 = 1.15 * t29;
    const T t39 = 88.46625 * t38;
    OUT(dtau_dq, 3, t39);
    const T t40 = t30 + t39;
    OUT(dtau_dq, 2, t40);
    OUT(dtau_dv, 3, F(splat)(0.0));
    OUT(dtau_da, 3, F(splat)(89.77680625));
    const T z66 = 0.0 * t44 + 0.0 * t47;
    const T z67 = 0.0 * t48 + 0.0 * t61;
    const T z68 = 0.0 * t65 + z66;
    const T z69 = z67 + z68;
    const T z70 = 0.0 * t13 + z69;
    const T z71 = 0.0 * t16 + 0.0 * t39;
    const T z72 = z70 + 0.0 * t40;
    const T z73 = z71 + z72;
    return z73;
}
#endif
