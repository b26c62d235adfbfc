/* elbow: mathematics of gravity, for T a number and for T lanes of numbers. */
static T F(gravity_evaluate)(const real *RESTRICT q_a, real *RESTRICT g STRIDE(ptrdiff_t n))
{
    T t1 = IN(q_a, 0);
    T t5 = IN(q_a, 1);
    T t6 = t1 + t5;
    SINES_COSINES(1, 2, t1, t6)
    T t2 = sine1[0];
    T t7 = cosine1[1];
    T t3 = 3613.4097102000005 * t2;
    T t8 = 867.8539125000001 * t7;
    OUT(g, 1, -t8);
    T t9 = t3 + t8;
    OUT(g, 0, -t9);
    return 0.0 * t8 + 0.0 * t9;
}
