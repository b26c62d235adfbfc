/* elbow: mathematics of arm_forward_dynamics, for T a number and for T lanes of numbers. */
static T F(arm_forward_dynamics_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT tau_a, real *RESTRICT a_a STRIDE(ptrdiff_t n))
{
    T t3 = IN(q_a, 1);
    T t9 = IN(q_a, 0);
    SINES_COSINES(3, 2, t3, t9)
    T t4 = sine3[0];
    T t7 = cosine3[0];
    T t10 = cosine3[1];
    T t17 = sine3[1];
    T t12 = IN(v_a, 0);
    T t13 = 1.15 * t12;
    T t11 = 9.81 * t10;
    T t18 = 9.81 * t4;
    T t25 = IN(v_a, 1);
    T t26 = t12 + t25;
    T t23 = 0.9854020620164352 * t4;
    T t33 = 3613.4097102000005 * t17;
    T t0 = IN(tau_a, 0);
    T t1 = IN(tau_a, 1);
    T t34 = t0 - t1;
    T t38 = 115.28870628581926 * t4;
    T t47 = 101.7361875 * t4;
    T t14 = t12 * t13;
    T t19 = t17 * t18;
    T t27 = 88.46625 * t26;
    T t35 = t33 + t34;
    T t39 = t4 * t38;
    T t15 = t11 - t14;
    T t28 = t26 * t27;
    T t41 = t39 - 406.22802171999996;
    T t16 = t7 * t15;
    T t29 = t7 * t28;
    T t20 = t16 - t19;
    T t21 = 88.46625 * t20;
    T t22 = t1 + t21;
    T t24 = t22 * t23;
    T t30 = t24 + t29;
    T t31 = 1.15 * t30;
    T t36 = t31 + t35;
    T t42 = t36 / t41;
    T t44 = F(guarded)(t42, -t41, F(splat)(1.1368683772161603e-13));
    OUT(a_a, 0, -t44);
    T t48 = t44 * t47;
    T t50 = 89.77680625 * t44;
    T t51 = t22 - t48;
    T t52 = t50 + t51;
    T t53 = 0.011138734398897152 * t52;
    OUT(a_a, 1, t53);
    return 0.0 * t44 + 0.0 * t53;
}
