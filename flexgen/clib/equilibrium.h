/* model: equilibrium with the output at a target: springs and gravity in balance; private. */
#ifndef MODEL_EQUILIBRIUM_H
#define MODEL_EQUILIBRIUM_H

#include "model_dense.h"

enum { EQUILIBRIUM_STEPS = 60 };

/* x = M^-1 b by elimination with row pivoting, rows of M scaled to one; 0 where a pivot is rounding. */
static inline int solve_square(real (*M)[NA], real *b, real *x)
{
    for (int i = 0; i < NA; ++i) {
        const real size = largest(M[i], NA);
        if (!(size > 0.0)) {
            return 0;
        }
        for (int j = 0; j < NA; ++j) {
            M[i][j] /= size;
        }
        b[i] /= size;
    }
    for (int k = 0; k < NA; ++k) {
        const int best = pivot_row(&M[0][0], NA, NA, k);
        if (!(fabs_1(M[best][k]) > PRECISE(1e-12, 1e-6))) {
            return 0;
        }
        swap_rows(M[k], M[best], NA);
        swap_rows(b + k, b + best, 1);
        for (int i = k + 1; i < NA; ++i) {
            const real f = M[i][k] / M[k][k];
            for (int j = k + 1; j < NA; ++j) {
                M[i][j] -= f * M[k][j];
            }
            b[i] -= f * b[k];
        }
    }
    for (int k = NA - 1; k >= 0; --k) {
        for (int j = k + 1; j < NA; ++j) {
            b[k] -= M[k][j] * x[j];
        }
        x[k] = b[k] / M[k][k];
    }
    return is_finite(x, NA);
}

/* Whether the actuated columns of W can be inverted: if so it is the springs that do not carry the arm. */
static inline int can_move(const real *W, real (*M)[NA], real *b, real *x)
{
    for (int i = 0; i < NA; ++i) {
        b[i] = 0.0;
        for (int j = 0; j < NA; ++j) {
            M[i][j] = i < NY && j < NG ? W[i_g[j] * NY + i] : i == j ? 1.0 : 0.0;
        }
    }
    return solve_square(M, b, x);
}

/*
 * Newton's method for the equilibrium at a target, from a guess q. scale: the torque of each unactuated row for a
 * deflection of 0.01 rad or 0.01 m.
 */
static inline int equilibrium_at(const real *target, real *q, real *scale, real *space)
{
    static const real zero[NA] = {0.0};
    real error[NY], W[NA * NY], bias[NY], M[NA][NA], b[NA], x[NA]; /* matrices of the library by columns */
#if MODEL_NE > 0
    real y1_q[NA * NY], y2_q[NA * NY], y2_v[NA * NY], row[NE], row_q[NA * NE], row_v[NA * NE], row_a[NA * NE];
#endif
    real before = -1.0;
    for (int step = 0; step < EQUILIBRIUM_STEPS; ++step) {
        real most;
        int status = evaluate_output_constraint(q, zero, target, error, W, bias, space);
        if (status != MODEL_OK) {
            return inner_status(status);
        }
        for (int i = 0; i < NY; ++i) {
            for (int j = 0; j < NA; ++j) {
                M[i][j] = W[j * NY + i];
            }
            b[i] = error[i];
        }
#if MODEL_NE > 0
        status = evaluate_inversion_jacobians(q, zero, zero, y1_q, y2_q, y2_v, row, row_q, row_v, row_a, space);
        if (status != MODEL_OK) {
            return inner_status(status);
        }
        for (int i = 0; i < NE; ++i) {
            for (int j = 0; j < NA; ++j) {
                M[NY + i][j] = row_q[j * NE + i];
            }
            b[NY + i] = row[i];
            scale[i] = fmax_1(1e-2 * fabs_1(row_q[i_e[i] * NE + i]), 1e-9);
        }
#else
        (void)scale;
#endif
        if (!solve_square(M, b, x)) {
            return can_move(W, M, b, x) ? MODEL_NOT_CONVERGED : MODEL_UNREACHABLE;
        }
        most = largest(x, NA);
        for (int i = 0; i < NA; ++i) {
            q[i] -= most > 0.5 ? 0.5 / most * x[i] : x[i];
        }
        if (most < PRECISE(1e-13, 1e-6) * (1.0 + largest(q, NA)) ||
            (most < PRECISE(1e-10, 1e-4) && before >= 0.0 && most >= before)) {
            return MODEL_OK;
        }
        before = most;
    }
    return before < PRECISE(1e-9, 1e-3) ? MODEL_OK : MODEL_UNREACHABLE;
}

#endif
