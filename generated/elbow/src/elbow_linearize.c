/* elbow: linearize. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_linearize.c"

#include "elbow_lanes.h"
#include "elbow_linearize.c"

#define NAME(suffix) linearize_##suffix
#define PUBLIC(suffix) elbow_linearize_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(q_m, ELBOW_NM) INPUT(v_m, ELBOW_NM) INPUT(tau_m, ELBOW_NM) \
    OUTPUT(A, ELBOW_NX * ELBOW_NX) OUTPUT(B, ELBOW_NX * ELBOW_NM)
#define WORK 704
#define SINGLE elbow_linearize(at_q_a, at_v_a, at_q_m, at_v_m, at_tau_m, at_A, at_B, work)
#define TILE 64
#define RESULTS 80
#define COLLIDE 1
#include "elbow_function.h"

elbow_status elbow_linearize(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM],
    elbow_real A[ELBOW_NX * ELBOW_NX], elbow_real B[ELBOW_NX * ELBOW_NM], elbow_real *work)
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || A == NULL || B == NULL || work == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return linearize_evaluate_1(q_a, v_a, q_m, v_m, tau_m, A, B, work) == 0 ? ELBOW_OK : linearize_failed(q_a, v_a, q_m, v_m, tau_m, A, B, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
SEPARATE static T F(linearize_evaluate_1_1)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, const real *RESTRICT tau_m, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    const T t4 = IN(q_a, 0);
    const T t18 = IN(q_a, 1);
    const T angle4[ANGLES(2)] = {t4, t18};
    T sine4[ANGLES(2)], cosine4[ANGLES(2)];
    F(sincos)(angle4, sine4, cosine4, 2);
    const T t34 = cosine4[0];
    const T t40 = sine4[0];
    const T t29 = sine4[1];
    const T t32 = cosine4[1];
    const T t10 = IN(v_a, 0);
    const T t36 = 1.15 * t10;
    const T t35 = 9.81 * t34;
    const T t16 = IN(q_m, 1);
    const T t17 = 0.003963011889035667 * t16;
    const T t22 = IN(v_m, 1);
    const T t23 = 0.003963011889035667 * t22;
    const T t41 = 9.81 * t29;
    const T t2 = IN(q_m, 0);
    const T t3 = 0.003739316239316239 * t2;
    const T t8 = IN(v_m, 0);
    const T t9 = 0.003739316239316239 * t8;
    const T t24 = IN(v_a, 1);
    const T t48 = t10 + t24;
    const T t46 = 0.9854020620164352 * t29;
    const T t55 = 3613.4097102000005 * t40;
    const T t60 = 115.28870628581926 * t29;
    const T t69 = 101.7361875 * t29;
    const T t37 = t10 * t36;
    const T t19 = t17 - t18;
    const T t25 = t23 - t24;
    const T t42 = t40 * t41;
    const T t5 = t3 - t4;
    const T t11 = t9 - t10;
    const T t49 = 88.46625 * t48;
    const T t61 = t29 * t60;
    const T t38 = t35 - t37;
    const T t20 = 4099900.0 * t19;
    const T t26 = 600.0 * t25;
    const T t6 = 7518900.0 * t5;
    const T t12 = 1400.0 * t11;
    const T t50 = t48 * t49;
    const T t63 = t61 - 406.22802171999996;
    const T t39 = t32 * t38;
    const T t27 = t20 + t26;
    const T t13 = t6 + t12;
    const T t51 = t32 * t50;
    const T t43 = t39 - t42;
    const T t82 = 0.003963011889035667 * t27;
    const T t56 = t13 - t27;
    const T t78 = 0.003739316239316239 * t13;
    const T t44 = 88.46625 * t43;
    const T t81 = IN(tau_m, 1);
    const T t83 = t81 - t82;
    const T t57 = t55 + t56;
    const T t77 = IN(tau_m, 0);
    const T t79 = t77 - t78;
    const T t45 = t27 + t44;
    const T t84 = 84.74576271186442 * t83;
    w[17] = t84;
    const T t80 = 84.74576271186442 * t79;
    w[16] = t80;
    const T t47 = t45 * t46;
    const T t52 = t47 + t51;
    const T t53 = 1.15 * t52;
    const T t58 = t53 + t57;
    const T t64 = t58 / t63;
    const T t66 = F(guarded)(t64, -t63, F(splat)(1.1368683772161603e-13));
    w[0] = -t66;
    const T t70 = t66 * t69;
    const T t72 = 89.77680625 * t66;
    const T t73 = t45 - t70;
    const T t74 = t72 + t73;
    const T t75 = 0.011138734398897152 * t74;
    w[1] = t75;
    const T z85 = 0.0 * t80 + 0.0 * t84;
    const T z86 = z85 + 0.0 * t66;
    const T z87 = z86 + 0.0 * t75;
    return z87;
}

SEPARATE static T F(linearize_evaluate_2_1)(const real *RESTRICT q_a, const real *RESTRICT v_a, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    const T t0 = IN(q_a, 1);
    const T t25 = IN(q_a, 0);
    const T angle0[ANGLES(2)] = {t0, t25};
    T sine0[ANGLES(2)], cosine0[ANGLES(2)];
    F(sincos)(angle0, sine0, cosine0, 2);
    const T t1 = sine0[0];
    const T t23 = cosine0[0];
    const T t26 = sine0[1];
    const T t29 = cosine0[1];
    const T t40 = IN(v_a, 0);
    const T t41 = IN(v_a, 1);
    const T t42 = t40 + t41;
    const T t56 = 1.15 * t40;
    const T t27 = 9.81 * t26;
    const T t30 = 9.81 * t29;
    const T t46 = w[0];
    const T t47 = w[1];
    const T t48 = t46 + t47;
    const T t53 = 1.15 * t46;
    const T t70 = 203.472375 * t40;
    const T t35 = 3613.4097102000005 * t29;
    const T t7 = 203.472375 * t1;
    const T t17 = 101.7361875 * t1;
    const T t43 = 88.46625 * t42;
    const T t57 = t40 * t56;
    const T t28 = t23 * t27;
    const T t31 = t1 * t30;
    const T t49 = 88.46625 * t48;
    const T t54 = t27 - t53;
    const T t71 = t23 * t70;
    w[436] = t71;
    const T t73 = 203.472375 * t42;
    const T t36 = 7518900.0 - t35;
    const T t14 = t7 - 496.00482796999995;
    w[32] = -t14;
    const T t19 = t17 - 89.77680625;
    w[112] = -t19;
    w[33] = -t19;
    const T t44 = t42 * t43;
    const T t58 = t30 - t57;
    const T t32 = t28 + t31;
    const T t50 = t23 * t49;
    const T t55 = t23 * t54;
    const T t75 = 1400.0 + t71;
    const T t74 = t23 * t73;
    w[357] = -t74;
    const T t45 = t1 * t44;
    const T t59 = t1 * t58;
    const T t33 = 88.46625 * t32;
    w[432] = t33;
    const T t76 = t74 - t75;
    w[356] = -t76;
    const T t51 = t45 - t50;
    const T t60 = t55 + t59;
    const T t37 = t33 + t36;
    w[352] = t37;
    const T t52 = 1.15 * t51;
    const T t61 = 88.46625 * t60;
    const T t62 = t52 + t61;
    w[353] = t62;
    const T t64 = t61 + 4099900.0;
    w[433] = t64;
    w[192] = F(splat)(0.0);
    w[272] = F(splat)(0.0);
    w[193] = F(splat)(0.0);
    w[273] = F(splat)(0.0);
    w[34] = F(splat)(0.0);
    w[114] = F(splat)(0.0);
    w[274] = F(splat)(0.0);
    w[35] = F(splat)(0.0);
    w[115] = F(splat)(0.0);
    w[195] = F(splat)(0.0);
    w[592] = F(splat)(0.0);
    w[513] = F(splat)(0.0);
    w[434] = F(splat)(0.0);
    w[594] = F(splat)(0.0);
    w[355] = F(splat)(0.0);
    w[515] = F(splat)(0.0);
    w[596] = F(splat)(0.0);
    w[517] = F(splat)(0.0);
    w[438] = F(splat)(0.0);
    w[598] = F(splat)(0.0);
    w[359] = F(splat)(0.0);
    w[519] = F(splat)(0.0);
    w[360] = F(splat)(0.0);
    w[440] = F(splat)(0.0);
    w[600] = F(splat)(0.0);
    w[361] = F(splat)(0.0);
    w[441] = F(splat)(0.0);
    w[521] = F(splat)(0.0);
    w[113] = F(splat)(89.77680625);
    w[194] = F(splat)(0.0118);
    w[275] = F(splat)(0.0118);
    w[512] = F(splat)((-28115.54487179487));
    w[354] = F(splat)((-28115.54487179487));
    w[593] = F(splat)((-16247.952443857332));
    w[435] = F(splat)((-16247.952443857332));
    w[514] = F(splat)(105.13291351632697);
    w[595] = F(splat)(64.39082870749273);
    w[516] = F(splat)((-5.235042735042735));
    w[358] = F(splat)((-5.235042735042735));
    w[437] = F(splat)(600.0);
    w[597] = F(splat)((-2.3778071334214));
    w[439] = F(splat)((-2.3778071334214));
    w[518] = F(splat)(0.0195754803126598);
    w[599] = F(splat)(0.009423277939582825);
    w[520] = F(splat)((-1.0));
    w[601] = F(splat)((-1.0));
    const T z83 = 0.0 * t71 + 0.0 * t74;
    const T z84 = 0.0 * t14 + 0.0 * t19;
    const T z85 = z83 + 0.0 * t76;
    const T z86 = z84 + 0.0 * t33;
    const T z87 = z85 + 0.0 * t37;
    const T z88 = z86 + 0.0 * t62;
    const T z89 = 0.0 * t64 + z87;
    const T z90 = z88 + z89;
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
            ROW rest0 = x[0];
            ROW rest1 = x[1];
            ROW rest2 = x[2];
            ROW rest3 = x[3];
            ROW rest4 = x[4];
            ROW rest5 = x[5];
            ROW rest6 = x[6];
            ROW rest7 = x[7];
            for (j = first[i]; j < i; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[j * 80 + i];
                rest0 -= times * other[0];
                rest1 -= times * other[1];
                rest2 -= times * other[2];
                rest3 -= times * other[3];
                rest4 -= times * other[4];
                rest5 -= times * other[5];
                rest6 -= times * other[6];
                rest7 -= times * other[7];
            }
            x[0] = rest0;
            x[1] = rest1;
            x[2] = rest2;
            x[3] = rest3;
            x[4] = rest4;
            x[5] = rest5;
            x[6] = rest6;
            x[7] = rest7;
        }
        for (i = 3; i >= 0; --i) {
            const T pivot = inverse[i];
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            ROW rest0 = pivot * x[0];
            ROW rest1 = pivot * x[1];
            ROW rest2 = pivot * x[2];
            ROW rest3 = pivot * x[3];
            ROW rest4 = pivot * x[4];
            ROW rest5 = pivot * x[5];
            ROW rest6 = pivot * x[6];
            ROW rest7 = pivot * x[7];
            for (j = i + 1; j < last[i]; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[i * 80 + j];
                rest0 -= times * other[0];
                rest1 -= times * other[1];
                rest2 -= times * other[2];
                rest3 -= times * other[3];
                rest4 -= times * other[4];
                rest5 -= times * other[5];
                rest6 -= times * other[6];
                rest7 -= times * other[7];
            }
            x[0] = rest0;
            x[1] = rest1;
            x[2] = rest2;
            x[3] = rest3;
            x[4] = rest4;
            x[5] = rest5;
            x[6] = rest6;
            x[7] = rest7;
        }
    }
    for (; k + 4 <= count; k += 4) {
        for (i = 0; i < 4; ++i) {
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            ROW rest0 = x[0];
            ROW rest1 = x[1];
            ROW rest2 = x[2];
            ROW rest3 = x[3];
            for (j = first[i]; j < i; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[j * 80 + i];
                rest0 -= times * other[0];
                rest1 -= times * other[1];
                rest2 -= times * other[2];
                rest3 -= times * other[3];
            }
            x[0] = rest0;
            x[1] = rest1;
            x[2] = rest2;
            x[3] = rest3;
        }
        for (i = 3; i >= 0; --i) {
            const T pivot = inverse[i];
            ROW *const x = rows + i * ROW_COUNT(80) + k;
            ROW rest0 = pivot * x[0];
            ROW rest1 = pivot * x[1];
            ROW rest2 = pivot * x[2];
            ROW rest3 = pivot * x[3];
            for (j = i + 1; j < last[i]; ++j) {
                const ROW *const other = rows + j * ROW_COUNT(80) + k;
                const T times = matrix[i * 80 + j];
                rest0 -= times * other[0];
                rest1 -= times * other[1];
                rest2 -= times * other[2];
                rest3 -= times * other[3];
            }
            x[0] = rest0;
            x[1] = rest1;
            x[2] = rest2;
            x[3] = rest3;
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
#endif
