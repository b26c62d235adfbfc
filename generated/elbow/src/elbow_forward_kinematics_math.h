/* elbow: mathematics of forward_kinematics, for T a number and for T lanes of numbers. */
static T F(forward_kinematics_evaluate)(const real *RESTRICT q_a, real *RESTRICT p, real *RESTRICT R STRIDE(ptrdiff_t n))
{
    T t1 = IN(q_a, 0);
    T t5 = IN(q_a, 1);
    T t6 = t1 + t5;
    SINES_COSINES(1, 2, t1, t6)
    T t2 = sine1[0];
    T t11 = cosine1[0];
    T t7 = cosine1[1];
    T t13 = sine1[1];
    OUT(R, 0, t7);
    OUT(R, 8, t7);
    OUT(R, 2, -t13);
    OUT(R, 6, t13);
    T t3 = 1.15 * t2;
    T t8 = 1.241 * t7;
    T t12 = 1.15 * t11;
    T t14 = 1.241 * t13;
    T t9 = t3 + t8;
    OUT(p, 0, t9);
    T t15 = t12 - t14;
    OUT(p, 2, t15);
    OUT(p, 1, F(splat)(0.0));
    OUT(R, 1, F(splat)(0.0));
    OUT(R, 3, F(splat)(0.0));
    OUT(R, 5, F(splat)(0.0));
    OUT(R, 7, F(splat)(0.0));
    OUT(R, 4, F(splat)(1.0));
    return 0.0 * t15 + (0.0 * t7 + 0.0 * t13 + 0.0 * t9);
}
