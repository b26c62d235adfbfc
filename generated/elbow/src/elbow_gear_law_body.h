/* elbow: gear_law, the mathematics; included for T a real and for T lanes of reals. Written by flexgen. */
static T F(gear_law_evaluate)(const real *RESTRICT deflection, real *RESTRICT tau_p, real *RESTRICT dtau_p STRIDE(ptrdiff_t n))
{
    const T t1 = IN(deflection, 0);
    const T t2 = 7518900.0 * t1;
    OUT(tau_p, 0, t2);
    const T t4 = IN(deflection, 1);
    const T t5 = 4099900.0 * t4;
    OUT(tau_p, 1, t5);
    OUT(dtau_p, 0, F(splat)(7518900.0));
    OUT(dtau_p, 1, F(splat)(4099900.0));
    const T z6 = 0.0 * t2 + 0.0 * t5;
    return z6;
}
