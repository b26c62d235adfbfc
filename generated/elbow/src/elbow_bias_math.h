/* elbow: mathematics of bias, for T a number and for T lanes of numbers. */
static T F(bias_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, real *RESTRICT h STRIDE(ptrdiff_t n))
{
    T t1 = IN(q_a, 0);
    T t5 = IN(q_a, 1);
    SINES_COSINES(1, 2, t1, t5)
    T t2 = sine1[0];
    T t8 = cosine1[0];
    T t6 = cosine1[1];
    T t16 = sine1[1];
    T t11 = IN(v_a, 0);
    T t12 = 1.15 * t11;
    T t9 = 9.81 * t8;
    T t21 = IN(v_a, 1);
    T t22 = t11 + t21;
    T t17 = 9.81 * t16;
    T t3 = 3613.4097102000005 * t2;
    T t13 = t11 * t12;
    T t24 = 101.7361875 * t22;
    T t18 = t2 * t17;
    T t14 = t9 - t13;
    T t25 = t22 * t24;
    T t15 = t6 * t14;
    T t26 = t6 * t25;
    T t19 = t15 - t18;
    T t27 = t3 + t26;
    T t20 = 88.46625 * t19;
    OUT(h, 1, -t20);
    T t28 = t20 + t27;
    OUT(h, 0, -t28);
    return 0.0 * t20 + 0.0 * t28;
}
