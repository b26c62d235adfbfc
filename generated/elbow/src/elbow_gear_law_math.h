/* elbow: mathematics of gear_law, for T a number and for T lanes of numbers. */
static T F(gear_law_evaluate)(const real *RESTRICT deflection, real *RESTRICT tau_p, real *RESTRICT dtau_p STRIDE(ptrdiff_t n))
{
    T t1 = IN(deflection, 0);
    T t2 = 7518900.0 * t1;
    OUT(tau_p, 0, t2);
    T t4 = IN(deflection, 1);
    T t5 = 4099900.0 * t4;
    OUT(tau_p, 1, t5);
    OUT(dtau_p, 0, F(splat)(7518900.0));
    OUT(dtau_p, 1, F(splat)(4099900.0));
    return 0.0 * t2 + 0.0 * t5;
}
