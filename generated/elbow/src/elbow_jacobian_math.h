/* elbow: mathematics of jacobian, for T a number and for T lanes of numbers. */
static T F(jacobian_evaluate)(const real *RESTRICT q_a, real *RESTRICT J STRIDE(ptrdiff_t n))
{
    T t1 = IN(q_a, 0);
    T t5 = IN(q_a, 1);
    T t6 = t1 + t5;
    SINES_COSINES(1, 2, t1, t6)
    T t2 = cosine1[0];
    T t11 = sine1[0];
    T t7 = sine1[1];
    T t13 = cosine1[1];
    T t3 = 1.15 * t2;
    T t8 = 1.241 * t7;
    T t12 = 1.15 * t11;
    T t14 = 1.241 * t13;
    OUT(J, 8, -t14);
    T t9 = t3 - t8;
    OUT(J, 0, t9);
    T t15 = t12 + t14;
    OUT(J, 2, -t15);
    T t17 = t3 - t9;
    OUT(J, 6, -t17);
    OUT(J, 1, F(splat)(0.0));
    OUT(J, 3, F(splat)(0.0));
    OUT(J, 5, F(splat)(0.0));
    OUT(J, 7, F(splat)(0.0));
    OUT(J, 9, F(splat)(0.0));
    OUT(J, 11, F(splat)(0.0));
    OUT(J, 4, F(splat)(1.0));
    OUT(J, 10, F(splat)(1.0));
    return 0.0 * t14 + 0.0 * t9 + (0.0 * t15 + 0.0 * t17);
}
