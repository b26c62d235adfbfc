/* elbow: inversion_rows. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_inversion_rows.c"

#include "elbow_lanes.h"
#include "elbow_inversion_rows.c"

#define NAME(suffix) inversion_rows_##suffix
#define PUBLIC(suffix) elbow_inversion_rows_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(a_a, ELBOW_NA) OUTPUT(tau_g, ELBOW_NG)
#define WORK 0
#define SINGLE elbow_inversion_rows(at_q_a, at_v_a, at_a_a, at_tau_g)
#define TILE 64
#define RESULTS 2
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_inversion_rows(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real tau_g[ELBOW_NG])
{
    if (q_a == NULL || v_a == NULL || a_a == NULL || tau_g == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return inversion_rows_evaluate_1(q_a, v_a, a_a, tau_g) == 0 ? ELBOW_OK : inversion_rows_failed(q_a, v_a, a_a, tau_g, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(inversion_rows_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT a_a, real *RESTRICT tau_g STRIDE(ptrdiff_t n))
{
    const T t4 = IN(q_a, 0);
    const T t14 = IN(q_a, 1);
    const T angle4[ANGLES(2)] = {t4, t14};
    T sine4[ANGLES(2)], cosine4[ANGLES(2)];
    F(sincos)(angle4, sine4, cosine4, 2);
    const T t5 = sine4[0];
    const T t17 = cosine4[0];
    const T t15 = cosine4[1];
    const T t25 = sine4[1];
    const T t20 = IN(v_a, 0);
    const T t21 = 1.15 * t20;
    const T t38 = IN(v_a, 1);
    const T t39 = t20 + t38;
    const T t1 = IN(a_a, 0);
    const T t9 = IN(a_a, 1);
    const T t10 = t1 + t9;
    const T t18 = 9.81 * t17;
    const T t26 = 1.15 * t1;
    const T t27 = 9.81 * t5;
    const T t2 = 402.47802171999996 * t1;
    const T t8 = 3.75 * t1;
    const T t6 = 3613.4097102000005 * t5;
    const T t22 = t20 * t21;
    const T t40 = 88.46625 * t39;
    const T t36 = 88.46625 * t10;
    const T t12 = 2.0 * t10;
    const T t33 = 87.77680625 * t10;
    const T t28 = t26 - t27;
    const T t45 = t2 + t8;
    const T t23 = t18 - t22;
    const T t41 = t39 * t40;
    const T t37 = t25 * t36;
    const T t34 = t12 + t33;
    const T t29 = t25 * t28;
    const T t46 = t6 - t45;
    const T t24 = t15 * t23;
    const T t42 = t15 * t41;
    const T t30 = t24 + t29;
    const T t43 = t37 + t42;
    const T t31 = 88.46625 * t30;
    const T t44 = 1.15 * t43;
    const T t35 = t31 - t34;
    OUT(tau_g, 1, -t35);
    const T t47 = t44 + t46;
    const T t48 = t35 + t47;
    OUT(tau_g, 0, -t48);
    const T z49 = 0.0 * t35 + 0.0 * t48;
    return z49;
}
#endif
