/* elbow: motor_friction, the mathematics; included for T a real and for T lanes of reals. Written by flexgen. */
static T F(motor_friction_evaluate)(const real *RESTRICT v_m, real *RESTRICT f_m STRIDE(ptrdiff_t n))
{
    OUT(f_m, 0, F(splat)(0.0));
    OUT(f_m, 1, F(splat)(0.0));
    const T z3 = 0.0 * IN(v_m, 0) + 0.0 * IN(v_m, 1);
    return z3;
}
