/* elbow: mathematics of arm_forward_derivatives, for T a number and for T lanes of numbers. */
SEPARATE static T F(arm_forward_derivatives_evaluate_1_1)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT tau_a, T *RESTRICT w STRIDE(ptrdiff_t n))
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
    w[0] = -t44;
    T t48 = t44 * t47;
    T t50 = 89.77680625 * t44;
    T t51 = t22 - t48;
    T t52 = t50 + t51;
    T t53 = 0.011138734398897152 * t52;
    w[1] = t53;
    return 0.0 * t44 + 0.0 * t53;
}

SEPARATE static T F(arm_forward_derivatives_evaluate_2_1)(const real *RESTRICT q_a, const real *RESTRICT v_a, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    T t0 = IN(q_a, 1);
    T t23 = IN(q_a, 0);
    SINES_COSINES(0, 2, t0, t23)
    T t1 = sine0[0];
    T t21 = cosine0[0];
    T t24 = sine0[1];
    T t27 = cosine0[1];
    T t36 = IN(v_a, 0);
    T t37 = IN(v_a, 1);
    T t38 = t36 + t37;
    T t52 = 1.15 * t36;
    T t25 = 9.81 * t24;
    T t28 = 9.81 * t27;
    T t42 = w[0];
    T t43 = w[1];
    T t44 = t42 + t43;
    T t49 = 1.15 * t42;
    T t60 = 203.472375 * t36;
    T t7 = 203.472375 * t1;
    T t17 = 101.7361875 * t1;
    T t33 = 3613.4097102000005 * t27;
    T t39 = 88.46625 * t38;
    T t53 = t36 * t52;
    T t26 = t21 * t25;
    T t29 = t1 * t28;
    T t45 = 88.46625 * t44;
    T t50 = t25 - t49;
    T t63 = 203.472375 * t38;
    T t61 = t21 * t60;
    w[258] = t61;
    T t14 = t7 - 496.00482796999995;
    w[16] = -t14;
    T t19 = t17 - 89.77680625;
    w[17] = w[96] = -t19;
    T t40 = t38 * t39;
    T t54 = t28 - t53;
    T t30 = t26 + t29;
    T t46 = t21 * t45;
    T t51 = t21 * t50;
    T t64 = t21 * t63;
    w[179] = -t64;
    T t41 = t1 * t40;
    T t55 = t1 * t54;
    T t31 = 88.46625 * t30;
    w[256] = t31;
    T t65 = t61 - t64;
    w[178] = t65;
    T t47 = t41 - t46;
    T t56 = t51 + t55;
    T t34 = t31 - t33;
    w[176] = t34;
    T t48 = 1.15 * t47;
    T t57 = 88.46625 * t56;
    w[257] = t57;
    T t58 = t48 + t57;
    w[177] = t58;
    w[97] = F(splat)(89.77680625);
    w[259] = F(splat)(0.0);
    T z73 = 0.0 * t34 + 0.0 * t57 + (0.0 * t31 + (0.0 * t14 + 0.0 * t19 + (0.0 * t65 + (0.0 * t61 + 0.0 * t64))) + 0.0 * t58);
    return z73;
}

SEPARATE static T F(arm_forward_derivatives_step_3)(real *RESTRICT da_dq, real *RESTRICT da_dv, real *RESTRICT da_dtau, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    static const unsigned char first[2] = {0, 0};
    static const unsigned char last[2] = {2, 2};
    T *const matrix = w + 16;
    T *const inverse = w + 336;
    ROW *const rows = ROWS(w + 176);
    const int count = ROW_FOURS(6);
    ROW sum = ROW_OF(0);
    int i, j, k;
    for (i = 0; i < 2; ++i) {
        for (j = 2; j < ROW_COUNT(2) * ROW_LANES; j += ROW_LANES) {
            *ROWS(matrix + i * 80 + j) = ROW_OF(0);
        }
        for (j = 4; j < ROW_FOURS(6) * ROW_LANES; j += ROW_LANES) {
            *ROWS(w + 176 + i * 80 + j) = ROW_OF(0);
        }
        w[176 + i * 81 + 4] = F(splat)(-1);
    }
    for (i = 0; i < 2; ++i) {
        inverse[i] = 4.440892098500626e-16 * matrix[i * 81];
    }
    for (j = 0; j < 2; ++j) {
        T *const upper = matrix + j * 80;
        const T pivot = F(guarded)(F(splat)(1) / upper[j], upper[j], inverse[j]);
        inverse[j] = pivot;
        for (k = ROW_OF_COLUMN(j + 1); k < ROW_COUNT(2); ++k) {
            const ROW x = ROWS(upper)[k];
            const int end = LESSER(last[j], (k + 1) * ROW_LANES);
            for (i = j + 1; i < end; ++i) {
                ROWS(matrix + i * 80)[k] -= pivot * upper[i] * x;
            }
        }
        for (k = ROW_OF_COLUMN(j); k < ROW_COUNT(2); ++k) {
            ROWS(upper)[k] = pivot * ROWS(upper)[k];
        }
    }
    k = 0;
    for (; k + 8 <= count; k += 8) {
        for (i = 0; i < 2; ++i) {
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            EIGHT(LOAD_ROW)
            for (j = first[i]; j < i; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[j * 80 + i];
                EIGHT(SUBTRACT_ROW)
            }
            EIGHT(STORE_ROW)
        }
        for (i = 1; i >= 0; --i) {
            const T pivot = inverse[i];
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            EIGHT(LOAD_SCALED_ROW)
            for (j = i + 1; j < last[i]; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[i * 80 + j];
                EIGHT(SUBTRACT_ROW)
            }
            EIGHT(STORE_ROW)
        }
    }
    for (; k + 4 <= count; k += 4) {
        for (i = 0; i < 2; ++i) {
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            FOUR(LOAD_ROW)
            for (j = first[i]; j < i; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[j * 80 + i];
                FOUR(SUBTRACT_ROW)
            }
            FOUR(STORE_ROW)
        }
        for (i = 1; i >= 0; --i) {
            const T pivot = inverse[i];
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            FOUR(LOAD_SCALED_ROW)
            for (j = i + 1; j < last[i]; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[i * 80 + j];
                FOUR(SUBTRACT_ROW)
            }
            FOUR(STORE_ROW)
        }
    }
    for (j = 0; j < 2; ++j) {
        for (i = 0; i < 2; ++i) {
            OUT(da_dq, (j + 0) * 2 + 0 + i, F(splat)(0) - w[176 + i * 80 + j + 0]);
        }
    }
    for (j = 0; j < 2; ++j) {
        for (i = 0; i < 2; ++i) {
            OUT(da_dv, (j + 0) * 2 + 0 + i, F(splat)(0) - w[176 + i * 80 + j + 2]);
        }
    }
    for (j = 0; j < 2; ++j) {
        for (i = 0; i < 2; ++i) {
            OUT(da_dtau, (j + 0) * 2 + 0 + i, F(splat)(0) - w[176 + i * 80 + j + 4]);
        }
    }
    for (i = 0; i < 2; ++i) {
        const ROW *const x = rows + i * ROW_COUNT(80);
        for (k = 0; k < count; k += 4) {
            sum += ZERO * (x[k] + x[k + 1] + (x[k + 2] + x[k + 3]));
        }
    }
    return ROW_SUM(sum);
}

static T F(arm_forward_derivatives_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT tau_a, real *RESTRICT da_dq, real *RESTRICT da_dv, real *RESTRICT da_dtau, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    T zero = F(splat)(0.0);
    w = F(aligned)(w);
    zero += F(arm_forward_derivatives_evaluate_1_1)(q_a, v_a, tau_a, w STRIDE(n));
    zero += F(arm_forward_derivatives_evaluate_2_1)(q_a, v_a, w STRIDE(n));
    zero += F(arm_forward_derivatives_step_3)(da_dq, da_dv, da_dtau, w STRIDE(n));
    return zero;
}
