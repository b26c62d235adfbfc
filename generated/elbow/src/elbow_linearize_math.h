/* elbow: mathematics of linearize, for T a number and for T lanes of numbers. */
SEPARATE static T F(linearize_evaluate_1_1)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, const real *RESTRICT tau_m, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    T t4 = IN(q_a, 0);
    T t18 = IN(q_a, 1);
    SINES_COSINES(4, 2, t4, t18)
    T t34 = cosine4[0];
    T t40 = sine4[0];
    T t29 = sine4[1];
    T t32 = cosine4[1];
    T t10 = IN(v_a, 0);
    T t36 = 1.15 * t10;
    T t35 = 9.81 * t34;
    T t16 = IN(q_m, 1);
    T t17 = 0.003963011889035667 * t16;
    T t22 = IN(v_m, 1);
    T t23 = 0.003963011889035667 * t22;
    T t41 = 9.81 * t29;
    T t2 = IN(q_m, 0);
    T t3 = 0.003739316239316239 * t2;
    T t8 = IN(v_m, 0);
    T t9 = 0.003739316239316239 * t8;
    T t24 = IN(v_a, 1);
    T t48 = t10 + t24;
    T t46 = 0.9854020620164352 * t29;
    T t55 = 3613.4097102000005 * t40;
    T t60 = 115.28870628581926 * t29;
    T t69 = 101.7361875 * t29;
    T t37 = t10 * t36;
    T t19 = t17 - t18;
    T t25 = t23 - t24;
    T t42 = t40 * t41;
    T t5 = t3 - t4;
    T t11 = t9 - t10;
    T t49 = 88.46625 * t48;
    T t61 = t29 * t60;
    T t38 = t35 - t37;
    T t20 = 4099900.0 * t19;
    T t26 = 600.0 * t25;
    T t6 = 7518900.0 * t5;
    T t12 = 1400.0 * t11;
    T t50 = t48 * t49;
    T t63 = t61 - 406.22802171999996;
    T t39 = t32 * t38;
    T t27 = t20 + t26;
    T t13 = t6 + t12;
    T t51 = t32 * t50;
    T t43 = t39 - t42;
    T t82 = 0.003963011889035667 * t27;
    T t56 = t13 - t27;
    T t78 = 0.003739316239316239 * t13;
    T t44 = 88.46625 * t43;
    T t81 = IN(tau_m, 1);
    T t83 = t81 - t82;
    T t57 = t55 + t56;
    T t77 = IN(tau_m, 0);
    T t79 = t77 - t78;
    T t45 = t27 + t44;
    T t84 = 84.74576271186442 * t83;
    w[17] = t84;
    T t80 = 84.74576271186442 * t79;
    w[16] = t80;
    T t47 = t45 * t46;
    T t52 = t47 + t51;
    T t53 = 1.15 * t52;
    T t58 = t53 + t57;
    T t64 = t58 / t63;
    T t66 = F(guarded)(t64, -t63, F(splat)(1.1368683772161603e-13));
    w[0] = -t66;
    T t70 = t66 * t69;
    T t72 = 89.77680625 * t66;
    T t73 = t45 - t70;
    T t74 = t72 + t73;
    T t75 = 0.011138734398897152 * t74;
    w[1] = t75;
    return 0.0 * t80 + 0.0 * t84 + 0.0 * t66 + 0.0 * t75;
}

SEPARATE static T F(linearize_evaluate_2_1)(const real *RESTRICT q_a, const real *RESTRICT v_a, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    T t0 = IN(q_a, 1);
    T t25 = IN(q_a, 0);
    SINES_COSINES(0, 2, t0, t25)
    T t1 = sine0[0];
    T t23 = cosine0[0];
    T t26 = sine0[1];
    T t29 = cosine0[1];
    T t40 = IN(v_a, 0);
    T t41 = IN(v_a, 1);
    T t42 = t40 + t41;
    T t56 = 1.15 * t40;
    T t27 = 9.81 * t26;
    T t30 = 9.81 * t29;
    T t46 = w[0];
    T t47 = w[1];
    T t48 = t46 + t47;
    T t53 = 1.15 * t46;
    T t70 = 203.472375 * t40;
    T t35 = 3613.4097102000005 * t29;
    T t7 = 203.472375 * t1;
    T t17 = 101.7361875 * t1;
    T t43 = 88.46625 * t42;
    T t57 = t40 * t56;
    T t28 = t23 * t27;
    T t31 = t1 * t30;
    T t49 = 88.46625 * t48;
    T t54 = t27 - t53;
    T t71 = t23 * t70;
    w[436] = t71;
    T t73 = 203.472375 * t42;
    T t36 = 7518900.0 - t35;
    T t14 = t7 - 496.00482796999995;
    w[32] = -t14;
    T t19 = t17 - 89.77680625;
    w[33] = w[112] = -t19;
    T t44 = t42 * t43;
    T t58 = t30 - t57;
    T t32 = t28 + t31;
    T t50 = t23 * t49;
    T t55 = t23 * t54;
    T t75 = 1400.0 + t71;
    T t74 = t23 * t73;
    w[357] = -t74;
    T t45 = t1 * t44;
    T t59 = t1 * t58;
    T t33 = 88.46625 * t32;
    w[432] = t33;
    T t76 = t74 - t75;
    w[356] = -t76;
    T t51 = t45 - t50;
    T t60 = t55 + t59;
    T t37 = t33 + t36;
    w[352] = t37;
    T t52 = 1.15 * t51;
    T t61 = 88.46625 * t60;
    T t62 = t52 + t61;
    w[353] = t62;
    T t64 = t61 + 4099900.0;
    w[433] = t64;
    w[195] = w[115] = w[35] = w[274] = w[114] = w[34] = w[273] = w[193] = w[272] = w[192] = F(splat)(0.0);
    w[598] = w[438] = w[517] = w[596] = w[515] = w[355] = w[594] = w[434] = w[513] = w[592] = F(splat)(0.0);
    w[521] = w[441] = w[361] = w[600] = w[440] = w[360] = w[519] = w[359] = F(splat)(0.0);
    w[113] = F(splat)(89.77680625);
    w[275] = w[194] = F(splat)(0.0118);
    w[354] = w[512] = F(splat)((-28115.54487179487));
    w[435] = w[593] = F(splat)((-16247.952443857332));
    w[514] = F(splat)(105.13291351632697);
    w[595] = F(splat)(64.39082870749273);
    w[358] = w[516] = F(splat)((-5.235042735042735));
    w[437] = F(splat)(600.0);
    w[439] = w[597] = F(splat)((-2.3778071334214));
    w[518] = F(splat)(0.0195754803126598);
    w[599] = F(splat)(0.009423277939582825);
    w[601] = w[520] = F(splat)((-1.0));
    T z90 = 0.0 * t14 + 0.0 * t19 + 0.0 * t33 + 0.0 * t62 + (0.0 * t64 + (0.0 * t71 + 0.0 * t74 + 0.0 * t76 + 0.0 * t37));
    return z90;
}

SEPARATE static T F(linearize_step_3)(real *RESTRICT A, real *RESTRICT B, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    static const unsigned char first[4] = {0, 0, 2, 3};
    static const unsigned char last[4] = {2, 2, 3, 4};
    T *const matrix = w + 32;
    T *const inverse = w + 672;
    ROW *const rows = ROWS(w + 352);
    const int count = ROW_FOURS(10);
    ROW sum = ROW_OF(0);
    int i, j, k;
    for (i = 0; i < 4; ++i) {
        for (j = 4; j < ROW_COUNT(4) * ROW_LANES; j += ROW_LANES) {
            *ROWS(matrix + i * 80 + j) = ROW_OF(0);
        }
        for (j = 10; j < ROW_FOURS(10) * ROW_LANES; j += ROW_LANES) {
            *ROWS(w + 352 + i * 80 + j) = ROW_OF(0);
        }
    }
    for (i = 0; i < 4; ++i) {
        inverse[i] = 8.881784197001252e-16 * matrix[i * 81];
    }
    for (j = 0; j < 4; ++j) {
        T *const upper = matrix + j * 80;
        const T pivot = F(guarded)(F(splat)(1) / upper[j], upper[j], inverse[j]);
        inverse[j] = pivot;
        for (k = ROW_OF_COLUMN(j + 1); k < ROW_COUNT(4); ++k) {
            const ROW x = ROWS(upper)[k];
            const int end = LESSER(last[j], (k + 1) * ROW_LANES);
            for (i = j + 1; i < end; ++i) {
                ROWS(matrix + i * 80)[k] -= pivot * upper[i] * x;
            }
        }
        for (k = ROW_OF_COLUMN(j); k < ROW_COUNT(4); ++k) {
            ROWS(upper)[k] = pivot * ROWS(upper)[k];
        }
    }
    k = 0;
    for (; k + 8 <= count; k += 8) {
        for (i = 0; i < 4; ++i) {
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            EIGHT(LOAD_ROW)
            for (j = first[i]; j < i; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[j * 80 + i];
                EIGHT(SUBTRACT_ROW)
            }
            EIGHT(STORE_ROW)
        }
        for (i = 3; i >= 0; --i) {
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
        for (i = 0; i < 4; ++i) {
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            FOUR(LOAD_ROW)
            for (j = first[i]; j < i; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[j * 80 + i];
                FOUR(SUBTRACT_ROW)
            }
            FOUR(STORE_ROW)
        }
        for (i = 3; i >= 0; --i) {
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
    for (i = 0; i < 64; ++i) {
        OUT(A, i, F(splat)(0));
    }
    for (j = 0; j < 8; ++j) {
        for (i = 0; i < 4; ++i) {
            OUT(A, (j + 0) * 8 + 4 + i, F(splat)(0) - w[352 + i * 80 + j + 0]);
        }
    }
    OUT(A, 32, F(splat)(1));
    OUT(A, 41, F(splat)(1));
    OUT(A, 50, F(splat)(1));
    OUT(A, 59, F(splat)(1));
    for (i = 0; i < 16; ++i) {
        OUT(B, i, F(splat)(0));
    }
    for (j = 0; j < 2; ++j) {
        for (i = 0; i < 4; ++i) {
            OUT(B, (j + 0) * 8 + 4 + i, F(splat)(0) - w[352 + i * 80 + j + 8]);
        }
    }
    for (i = 0; i < 4; ++i) {
        const ROW *const x = rows + i * ROW_COUNT(80);
        for (k = 0; k < count; k += 4) {
            sum += ZERO * (x[k] + x[k + 1] + (x[k + 2] + x[k + 3]));
        }
    }
    return ROW_SUM(sum);
}

static T F(linearize_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, const real *RESTRICT tau_m, real *RESTRICT A, real *RESTRICT B, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    T zero = F(splat)(0.0);
    w = F(aligned)(w);
    zero += F(linearize_evaluate_1_1)(q_a, v_a, q_m, v_m, tau_m, w STRIDE(n));
    zero += F(linearize_evaluate_2_1)(q_a, v_a, w STRIDE(n));
    zero += F(linearize_step_3)(A, B, w STRIDE(n));
    return zero;
}
