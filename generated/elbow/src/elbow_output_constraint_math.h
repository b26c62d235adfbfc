/* elbow: mathematics of output_constraint, for T a number and for T lanes of numbers. */
static T F(output_constraint_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT target, real *RESTRICT y_err, real *RESTRICT W, real *RESTRICT Wdot_v STRIDE(ptrdiff_t n))
{
    T t1 = IN(q_a, 0);
    T t5 = IN(q_a, 1);
    T t6 = t1 + t5;
    SINES_COSINES(1, 2, t1, t6)
    T t2 = sine1[0];
    T t12 = cosine1[0];
    T t7 = cosine1[1];
    T t14 = sine1[1];
    T t20 = IN(v_a, 0);
    T t23 = IN(v_a, 1);
    T t24 = t20 + t23;
    T t3 = 1.15 * t2;
    T t8 = 1.241 * t7;
    OUT(W, 3, -t8);
    T t13 = 1.15 * t12;
    T t15 = 1.241 * t14;
    T t21 = t20 * t20;
    T t25 = t24 * t24;
    T t9 = t3 + t8;
    OUT(W, 1, -t9);
    T t16 = t13 - t15;
    OUT(W, 0, t16);
    T t22 = t3 * t21;
    T t29 = t13 * t21;
    T t26 = t8 * t25;
    T t28 = t15 * t25;
    T t10 = IN(target, 0);
    T t11 = t9 - t10;
    OUT(y_err, 0, t11);
    T t17 = IN(target, 1);
    T t18 = t16 - t17;
    OUT(y_err, 1, t18);
    T t19 = t13 - t16;
    OUT(W, 2, -t19);
    T t27 = t22 + t26;
    OUT(Wdot_v, 0, -t27);
    T t30 = t28 - t29;
    OUT(Wdot_v, 1, t30);
    T z37 = 0.0 * t8 + 0.0 * t9 + (0.0 * t16 + 0.0 * t11) + (0.0 * t18 + 0.0 * t19 + (0.0 * t27 + 0.0 * t30));
    return z37;
}
