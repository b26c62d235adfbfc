/* elbow: mass_matrix, the mathematics; included for T a real and for T lanes of reals. Written by flexgen. */
static T F(mass_matrix_evaluate)(const real *RESTRICT q_a, real *RESTRICT M STRIDE(ptrdiff_t n))
{
    const T t0 = IN(q_a, 1);
    const T angle0[ANGLES(1)] = {t0};
    T sine0[ANGLES(1)], cosine0[ANGLES(1)];
    F(sincos)(angle0, sine0, cosine0, 1);
    const T t1 = sine0[0];
    const T t7 = 203.472375 * t1;
    const T t17 = 101.7361875 * t1;
    const T t14 = t7 - 496.00482796999995;
    OUT(M, 0, -t14);
    const T t19 = t17 - 89.77680625;
    OUT(M, 1, -t19);
    OUT(M, 2, -t19);
    OUT(M, 3, F(splat)(89.77680625));
    const T z21 = 0.0 * IN(q_a, 0) + 0.0 * t14;
    const T z22 = 0.0 * t19 + z21;
    return z22;
}
