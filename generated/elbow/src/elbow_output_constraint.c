/* elbow: output_constraint. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_output_constraint.c"

#include "elbow_lanes.h"
#include "elbow_output_constraint.c"

#define NAME(suffix) output_constraint_##suffix
#define PUBLIC(suffix) elbow_output_constraint_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(target, ELBOW_NT) OUTPUT(y_err, ELBOW_NY) OUTPUT(W, ELBOW_NY * \
    ELBOW_NA) OUTPUT(Wdot_v, ELBOW_NY)
#define WORK 0
#define SINGLE elbow_output_constraint(at_q_a, at_v_a, at_target, at_y_err, at_W, at_Wdot_v)
#define TILE 64
#define RESULTS 8
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_output_constraint(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real target[ELBOW_NT], elbow_real y_err[ELBOW_NY], elbow_real W[ELBOW_NY * ELBOW_NA],
    elbow_real Wdot_v[ELBOW_NY])
{
    if (q_a == NULL || v_a == NULL || target == NULL || y_err == NULL || W == NULL || Wdot_v == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return output_constraint_evaluate_1(q_a, v_a, target, y_err, W, Wdot_v) == 0 ? ELBOW_OK : output_constraint_failed(q_a, v_a, target, y_err, W, Wdot_v, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(output_constraint_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT target, real *RESTRICT y_err, real *RESTRICT W, real *RESTRICT Wdot_v STRIDE(ptrdiff_t n))
{
    const T t1 = IN(q_a, 0);
    const T t5 = IN(q_a, 1);
    const T t6 = t1 + t5;
    const T angle1[ANGLES(2)] = {t1, t6};
    T sine1[ANGLES(2)], cosine1[ANGLES(2)];
    F(sincos)(angle1, sine1, cosine1, 2);
    const T t2 = sine1[0];
    const T t12 = cosine1[0];
    const T t7 = cosine1[1];
    const T t14 = sine1[1];
    const T t20 = IN(v_a, 0);
    const T t23 = IN(v_a, 1);
    const T t24 = t20 + t23;
    const T t3 = 1.15 * t2;
    const T t8 = 1.241 * t7;
    OUT(W, 3, -t8);
    const T t13 = 1.15 * t12;
    const T t15 = 1.241 * t14;
    const T t21 = t20 * t20;
    const T t25 = t24 * t24;
    const T t9 = t3 + t8;
    OUT(W, 1, -t9);
    const T t16 = t13 - t15;
    OUT(W, 0, t16);
    const T t22 = t3 * t21;
    const T t29 = t13 * t21;
    const T t26 = t8 * t25;
    const T t28 = t15 * t25;
    const T t10 = IN(target, 0);
    const T t11 = t9 - t10;
    OUT(y_err, 0, t11);
    const T t17 = IN(target, 1);
    const T t18 = t16 - t17;
    OUT(y_err, 1, t18);
    const T t19 = t13 - t16;
    OUT(W, 2, -t19);
    const T t27 = t22 + t26;
    OUT(Wdot_v, 0, -t27);
    const T t30 = t28 - t29;
    OUT(Wdot_v, 1, t30);
    const T z31 = 0.0 * t8 + 0.0 * t9;
    const T z32 = 0.0 * t16 + 0.0 * t11;
    const T z33 = 0.0 * t18 + 0.0 * t19;
    const T z34 = 0.0 * t27 + 0.0 * t30;
    const T z35 = z31 + z32;
    const T z36 = z33 + z34;
    const T z37 = z35 + z36;
    return z37;
}
#endif
