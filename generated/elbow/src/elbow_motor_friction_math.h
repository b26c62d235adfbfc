/* elbow: mathematics of motor_friction, for T a number and for T lanes of numbers. */
static T F(motor_friction_evaluate)(const real *RESTRICT v_m, real *RESTRICT f_m STRIDE(ptrdiff_t n))
{
    OUT(f_m, 0, F(splat)(0.0));
    OUT(f_m, 1, F(splat)(0.0));
    return 0.0 * IN(v_m, 0) + 0.0 * IN(v_m, 1);
}
