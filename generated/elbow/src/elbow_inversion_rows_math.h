/* elbow: mathematics of inversion_rows, for T a number and for T lanes of numbers. */
static T F(inversion_rows_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT a_a, real *RESTRICT tau_g STRIDE(ptrdiff_t n))
{
    T t4 = IN(q_a, 0);
    T t14 = IN(q_a, 1);
    SINES_COSINES(4, 2, t4, t14)
    T t5 = sine4[0];
    T t17 = cosine4[0];
    T t15 = cosine4[1];
    T t25 = sine4[1];
    T t20 = IN(v_a, 0);
    T t21 = 1.15 * t20;
    T t38 = IN(v_a, 1);
    T t39 = t20 + t38;
    T t1 = IN(a_a, 0);
    T t9 = IN(a_a, 1);
    T t10 = t1 + t9;
    T t18 = 9.81 * t17;
    T t26 = 1.15 * t1;
    T t27 = 9.81 * t5;
    T t2 = 402.47802171999996 * t1;
    T t8 = 3.75 * t1;
    T t6 = 3613.4097102000005 * t5;
    T t22 = t20 * t21;
    T t40 = 88.46625 * t39;
    T t36 = 88.46625 * t10;
    T t12 = 2.0 * t10;
    T t33 = 87.77680625 * t10;
    T t28 = t26 - t27;
    T t45 = t2 + t8;
    T t23 = t18 - t22;
    T t41 = t39 * t40;
    T t37 = t25 * t36;
    T t34 = t12 + t33;
    T t29 = t25 * t28;
    T t46 = t6 - t45;
    T t24 = t15 * t23;
    T t42 = t15 * t41;
    T t30 = t24 + t29;
    T t43 = t37 + t42;
    T t31 = 88.46625 * t30;
    T t44 = 1.15 * t43;
    T t35 = t31 - t34;
    OUT(tau_g, 1, -t35);
    T t47 = t44 + t46;
    T t48 = t35 + t47;
    OUT(tau_g, 0, -t48);
    return 0.0 * t35 + 0.0 * t48;
}
