/* elbow: arm_forward_derivatives. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_arm_forward_derivatives.c"

#include "elbow_lanes.h"
#include "elbow_arm_forward_derivatives.c"

#define NAME(suffix) arm_forward_derivatives_##suffix
#define PUBLIC(suffix) elbow_arm_forward_derivatives_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(tau_a, ELBOW_NA) OUTPUT(da_dq, ELBOW_NA * ELBOW_NA) \
    OUTPUT(da_dv, ELBOW_NA * ELBOW_NA) OUTPUT(da_dtau, ELBOW_NA * ELBOW_NA)
#define WORK 368
#define SINGLE elbow_arm_forward_derivatives(at_q_a, at_v_a, at_tau_a, at_da_dq, at_da_dv, at_da_dtau, work)
#define TILE 64
#define RESULTS 12
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_arm_forward_derivatives(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real tau_a[ELBOW_NA], elbow_real da_dq[ELBOW_NA * ELBOW_NA], elbow_real da_dv[ELBOW_NA * ELBOW_NA],
    elbow_real da_dtau[ELBOW_NA * ELBOW_NA], elbow_real *work)
{
    if (q_a == NULL || v_a == NULL || tau_a == NULL || da_dq == NULL || da_dv == NULL || da_dtau == NULL || work == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return arm_forward_derivatives_evaluate_1(q_a, v_a, tau_a, da_dq, da_dv, da_dtau, work) == 0 ? ELBOW_OK : arm_forward_derivatives_failed(q_a, v_a, tau_a, da_dq, da_dv, da_dtau, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
SEPARATE static T F(arm_forward_derivatives_evaluate_1_1)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT tau_a, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    const T t3 = IN(q_a, 1);
    const T t9 = IN(q_a, 0);
    const T angle3[ANGLES(2)] = {t3, t9};
    T sine3[ANGLES(2)], cosine3[ANGLES(2)];
    F(sincos)(angle3, sine3, cosine3, 2);
    const T t4 = sine3[0];
    const T t7 = cosine3[0];
    const T t10 = cosine3[1];
    const T t17 = sine3[1];
    const T t12 = IN(v_a, 0);
    const T t13 = 1.15 * t12;
    const T t11 = 9.81 * t10;
    const T t18 = 9.81 * t4;
    const T t25 = IN(v_a, 1);
    const T t26 = t12 + t25;
    const T t23 = 0.9854020620164352 * t4;
    const T t33 = 3613.4097102000005 * t17;
    const T t0 = IN(tau_a, 0);
    const T t1 = IN(tau_a, 1);
    const T t34 = t0 - t1;
    const T t38 = 115.28870628581926 * t4;
    const T t47 = 101.7361875 * t4;
    const T t14 = t12 * t13;
    const T t19 = t17 * t18;
    const T t27 = 88.46625 * t26;
    const T t35 = t33 + t34;
    const T t39 = t4 * t38;
    const T t15 = t11 - t14;
    const T t28 = t26 * t27;
    const T t41 = t39 - 406.22802171999996;
    const T t16 = t7 * t15;
    const T t29 = t7 * t28;
    const T t20 = t16 - t19;
    const T t21 = 88.46625 * t20;
    const T t22 = t1 + t21;
    const T t24 = t22 * t23;
    const T t30 = t24 + t29;
    const T t31 = 1.15 * t30;
    const T t36 = t31 + t35;
    const T t42 = t36 / t41;
    const T t44 = F(guarded)(t42, -t41, F(splat)(1.1368683772161603e-13));
    w[0] = -t44;
    const T t48 = t44 * t47;
    const T t50 = 89.77680625 * t44;
    const T t51 = t22 - t48;
    const T t52 = t50 + t51;
    const T t53 = 0.011138734398897152 * t52;
    w[1] = t53;
    const T z54 = 0.0 * t44 + 0.0 * t53;
    return z54;
}

SEPARATE static T F(arm_forward_derivatives_evaluate_2_1)(const real *RESTRICT q_a, const real *RESTRICT v_a, T *RESTRICT w STRIDE(ptrdiff_t n))
{
    const T t0 = IN(q_a, 1);
    const T t23 = IN(q_a, 0);
    const T angle0[ANGLES(2)] = {t0, t23};
    T sine0[ANGLES(2)], cosine0[ANGLES(2)];
    F(sincos)(angle0, sine0, cosine0, 2);
    const T t1 = sine0[0];
    const T t21 = cosine0[0];
    const T t24 = sine0[1];
    const T t27 = cosine0[1];
    const T t36 = IN(v_a, 0);
    const T t37 = IN(v_a, 1);
    const T t38 = t36 + t37;
    const T t52 = 1.15 * t36;
    const T t25 = 9.81 * t24;
    const T t28 = 9.81 * t27;
    const T t42 = w[0];
    const T t43 = w[1];
    const T t44 = t42 + t43;
    const T t49 = 1.15 * t42;
    const T t60 = 203.472375 * t36;
    const T t7 = 203.472375 * t1;
    const T t17 = 101.7361875 * t1;
    const T t33 = 3613.4097102000005 * t27;
    const T t39 = 88.46625 * t38;
    const T t53 = t36 * t52;
    const T t26 = t21 * t25;
    const T t29 = t1 * t28;
    const T t45 = 88.46625 * t44;
    const T t50 = t25 - t49;
    const T t63 = 203.472375 * t38;
    const T t61 = t21 * t60;
    w[258] = t61;
    const T t14 = t7 - 496.00482796999995;
    w[16] = -t14;
    const T t19 = t17 - 89.77680625;
    w[96] = -t19;
    w[17] = -t19;
    const T t40 = t38 * t39;
    const T t54 = t28 - t53;
    const T t30 = t26 + t29;
    const T t46 = t21 * t45;
    const T t51 = t21 * t50;
    const T t64 = t21 * t63;
    w[179] = -t64;
    const T t41 = t1 * t40;
    const T t55 = t1 * t54;
    const T t31 = 88.46625 * t30;
    w[256] = t31;
    const T t65 = t61 - t64;
    w[178] = t65;
    const T t47 = t41 - t46;
    const T t56 = t51 + t55;
    const T t34 = t31 - t33;
    w[176] = t34;
    const T t48 = 1.15 * t47;
    const T t57 = 88.46625 * t56;
    w[257] = t57;
    const T t58 = t48 + t57;
    w[177] = t58;
    w[97] = F(splat)(89.77680625);
    w[259] = F(splat)(0.0);
    const T z66 = 0.0 * t61 + 0.0 * t64;
    const T z67 = 0.0 * t14 + 0.0 * t19;
    const T z68 = 0.0 * t65 + z66;
    const T z69 = z67 + z68;
    const T z70 = 0.0 * t31 + z69;
    const T z71 = 0.0 * t34 + 0.0 * t57;
    const T z72 = z70 + 0.0 * t58;
    const T z73 = z71 + z72;
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
        for (i = 1; i >= 0; --i) {
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
        for (i = 0; i < 2; ++i) {
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
        for (i = 1; i >= 0; --i) {
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
#endif
