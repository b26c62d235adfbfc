/* elbow: mathematics of tool_motion, for T a number and for T lanes of numbers. */
static T F(tool_motion_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT a_a, real *RESTRICT v_tool, real *RESTRICT a_tool STRIDE(ptrdiff_t n))
{
    T t2 = IN(q_a, 0);
    T t6 = IN(q_a, 1);
    T t7 = t2 + t6;
    SINES_COSINES(2, 2, t2, t7)
    T t3 = cosine2[0];
    T t16 = sine2[0];
    T t8 = sine2[1];
    T t18 = cosine2[1];
    T t0 = IN(v_a, 0);
    T t12 = IN(v_a, 1);
    T t24 = t0 + t12;
    OUT(v_tool, 4, t24);
    T t4 = 1.15 * t3;
    T t9 = 1.241 * t8;
    T t17 = 1.15 * t16;
    T t19 = 1.241 * t18;
    T t27 = t0 * t0;
    T t25 = IN(a_a, 0);
    T t29 = IN(a_a, 1);
    T t30 = t25 + t29;
    OUT(a_tool, 4, t30);
    T t32 = t24 * t24;
    T t26 = t4 * t25;
    T t10 = t4 - t9;
    T t39 = t17 * t25;
    T t20 = t17 + t19;
    T t28 = t17 * t27;
    T t31 = t9 * t30;
    T t38 = t19 * t30;
    T t40 = t4 * t27;
    T t13 = t9 * t12;
    T t22 = t12 * t19;
    T t33 = t19 * t32;
    T t37 = t9 * t32;
    T t11 = t0 * t10;
    T t21 = t0 * t20;
    T t34 = t26 - t28;
    T t41 = t39 + t40;
    T t35 = t31 + t33;
    T t42 = t37 - t38;
    T t14 = t11 - t13;
    OUT(v_tool, 0, t14);
    T t23 = t21 + t22;
    OUT(v_tool, 2, -t23);
    T t36 = t34 - t35;
    OUT(a_tool, 0, t36);
    T t43 = t41 - t42;
    OUT(a_tool, 2, -t43);
    OUT(v_tool, 1, F(splat)(0.0));
    OUT(v_tool, 3, F(splat)(0.0));
    OUT(v_tool, 5, F(splat)(0.0));
    OUT(a_tool, 1, F(splat)(0.0));
    OUT(a_tool, 3, F(splat)(0.0));
    OUT(a_tool, 5, F(splat)(0.0));
    return 0.0 * t23 + 0.0 * t36 + (0.0 * t43 + (0.0 * t24 + 0.0 * t30 + 0.0 * t14));
}
