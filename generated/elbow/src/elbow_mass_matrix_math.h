/* elbow: mathematics of mass_matrix, for T a number and for T lanes of numbers. */
static T F(mass_matrix_evaluate)(const real *RESTRICT q_a, real *RESTRICT M STRIDE(ptrdiff_t n))
{
    T t0 = IN(q_a, 1);
    SINES_COSINES(0, 1, t0)
    T t1 = sine0[0];
    T t7 = 203.472375 * t1;
    T t17 = 101.7361875 * t1;
    T t14 = t7 - 496.00482796999995;
    OUT(M, 0, -t14);
    T t19 = t17 - 89.77680625;
    OUT(M, 1, -t19);
    OUT(M, 2, -t19);
    OUT(M, 3, F(splat)(89.77680625));
    return 0.0 * t19 + (0.0 * IN(q_a, 0) + 0.0 * t14);
}
