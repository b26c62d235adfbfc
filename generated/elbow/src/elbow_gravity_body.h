/* elbow: gravity, the mathematics; included for T a real and for T lanes of reals. Written by flexgen. */
static T F(gravity_evaluate)(const real *RESTRICT q_a, real *RESTRICT g STRIDE(ptrdiff_t n))
{
    const T t1 = IN(q_a, 0);
    const T t5 = IN(q_a, 1);
    const T t6 = t1 + t5;
    const T angle1[ANGLES(2)] = {t1, t6};
    T sine1[ANGLES(2)], cosine1[ANGLES(2)];
    F(sincos)(angle1, sine1, cosine1, 2);
    const T t2 = sine1[0];
    const T t7 = cosine1[1];
    const T t3 = 3613.4097102000005 * t2;
    const T t8 = 867.8539125000001 * t7;
    OUT(g, 1, -t8);
    const T t9 = t3 + t8;
    OUT(g, 0, -t9);
    const T z10 = 0.0 * t8 + 0.0 * t9;
    return z10;
}
