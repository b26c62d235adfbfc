/*
 * model: stable and unstable motions near an equilibrium, and the boundary rows of the two-point problem; private.
 *
 * While the output does not move, the unactuated coordinates w follow A w'' + D w' + K w = 0, and the state x = (w, w')
 * follows x' = G x. The sign S of G is the limit of Newton's method X <- (X + X^-1) / 2 from X = G. It is -1 on the
 * stable motions and +1 on the unstable ones, so that the rows of 1 + S vanish on the stable motions and those of 1 - S
 * on the unstable ones.
 */
#ifndef MODEL_DICHOTOMY_H
#define MODEL_DICHOTOMY_H

#include "model_dense.h"
#include "model_lq_step.h"

#if MODEL_NE > 0

enum { SIGN_STEPS = 45 };

/* least pivot of the scaled A: below it the inertias cancel to rounding */
static const real least_inertia = 1e-9;
static const real sign_tolerance = 1e-6; /* largest error of an entry of S S - 1 */

typedef struct {
    real A[NE][NE], D[NE][NE], K[NE][NE]; /* rows */
    real inertia[NE];                     /* of the unactuated coordinates, with a free output */
} zero_dynamics;

typedef real square[STATES][STATES];

/* X becomes its inverse by Gauss and Jordan with row pivoting, n rows; 0 where a pivot is below `least`. */
static inline int invert_square(square X, int n, real least)
{
    int from[STATES];
    for (int k = 0; k < n; ++k) {
        const int best = pivot_row(X[0], n, STATES, k);
        real pivot;
        from[k] = best;
        if (!(fabs_1(X[best][k]) > least)) {
            return 0;
        }
        swap_rows(X[k], X[best], n);
        pivot = 1.0 / X[k][k];
        X[k][k] = 1.0;
        for (int j = 0; j < n; ++j) {
            X[k][j] *= pivot;
        }
        for (int i = 0; i < n; ++i) {
            const real f = X[i][k];
            if (i == k) {
                continue;
            }
            X[i][k] = 0.0;
            for (int j = 0; j < n; ++j) {
                X[i][j] -= f * X[k][j];
            }
        }
    }
    for (int k = n - 1; k >= 0; --k) {
        for (int i = 0; i < n && from[k] != k; ++i) {
            const real t = X[i][k];
            X[i][k] = X[i][from[k]];
            X[i][from[k]] = t;
        }
    }
    return 1;
}

/* Sum of squares. */
static inline real squared_norm(square X)
{
    real sum = 0.0;
    for (int i = 0; i < STATES; ++i) {
        for (int j = 0; j < STATES; ++j) {
            sum += X[i][j] * X[i][j];
        }
    }
    return sum;
}

/* X becomes its sign; 0 where an eigenvalue is, or may be, on the imaginary axis. */
static inline int matrix_sign(square X)
{
    square Y;
    for (int step = 0; step < SIGN_STEPS; ++step) {
        real scale, moved = 0.0, size;
        for (int i = 0; i < STATES; ++i) {
            for (int j = 0; j < STATES; ++j) {
                Y[i][j] = X[i][j];
            }
        }
        size = squared_norm(X);
        if (!invert_square(Y, STATES, 0.0) || !(size < 1e200) || !(squared_norm(Y) < 1e200)) {
            return 0;
        }
        scale = square_root(square_root(squared_norm(Y) / size)); /* X and its inverse become equally large */
        scale = fabs_1(scale - 1.0) < 0.05 ? 1.0 : scale;
        for (int i = 0; i < STATES; ++i) {
            for (int j = 0; j < STATES; ++j) {
                const real next = 0.5 * (scale * X[i][j] + Y[i][j] / scale);
                moved += (next - X[i][j]) * (next - X[i][j]);
                X[i][j] = next;
            }
        }
        if (moved <= 1e-22 * size) {
            break;
        }
    }
    for (int i = 0; i < STATES; ++i) { /* whether X X = 1 */
        for (int j = 0; j < STATES; ++j) {
            real sum = i == j ? -1.0 : 0.0, size = 1.0;
            for (int k = 0; k < STATES; ++k) {
                sum += X[i][k] * X[k][j];
                size += fabs_1(X[i][k] * X[k][j]);
            }
            if (!(fabs_1(sum) <= sign_tolerance * size)) {
                return 0;
            }
        }
    }
    return 1;
}

/* The first `rank` rows of P become a basis of all of them, by elimination with complete pivoting. */
static inline void row_basis(square P, int rank)
{
    for (int k = 0; k < rank; ++k) {
        int row = k, column = 0;
        real pivot;
        for (int i = k; i < STATES; ++i) {
            for (int j = 0; j < STATES; ++j) {
                if (fabs_1(P[i][j]) > fabs_1(P[row][column])) {
                    row = i;
                    column = j;
                }
            }
        }
        pivot = 1.0 / P[row][column];
        for (int j = 0; j < STATES; ++j) {
            const real t = P[row][j] * pivot;
            P[row][j] = P[k][j];
            P[k][j] = t;
        }
        for (int i = 0; i < STATES; ++i) {
            const real f = P[i][column];
            for (int j = 0; j < STATES && i != k; ++j) {
                P[i][j] -= f * P[k][j];
            }
        }
    }
}

/*
 * Rows of the scaled state that vanish on the unstable motions (grows = 1) or on the stable ones (0), `count` of them,
 * and the number of unstable zeros.
 */
static inline int boundary_rows(const zero_dynamics *given, int grows, square rows, int *count, int *unstable)
{
    square inverse; /* of A in its first rows */
    real unit[NE], size_A = 0.0, size_K = 0.0, rate, trace = 0.0;
    for (int i = 0; i < NE; ++i) {
        if (!(given->inertia[i] > 0.0)) {
            return MODEL_RESULT_NOT_FINITE;
        }
        unit[i] = 1.0 / square_root(given->inertia[i]);
    }
    for (int i = 0; i < NE; ++i) {
        for (int j = 0; j < NE; ++j) {
            const real K = unit[i] * given->K[i][j] * unit[j];
            inverse[i][j] = unit[i] * given->A[i][j] * unit[j];
            size_A += inverse[i][j] * inverse[i][j];
            size_K += K * K;
        }
    }
    if (!invert_square(inverse, NE, least_inertia)) {
        return MODEL_ZERO_AT_INFINITY;
    }
    rate = square_root(square_root(size_K / size_A));
    if (!(rate > 0.0 && rate < 1e100)) {
        return MODEL_ZERO_ON_AXIS;
    }
    for (int i = 0; i < NE; ++i) {
        for (int j = 0; j < NE; ++j) {
            real K = 0.0, D = 0.0;
            for (int k = 0; k < NE; ++k) {
                K -= inverse[i][k] * unit[k] * given->K[k][j] * unit[j];
                D -= inverse[i][k] * unit[k] * given->D[k][j] * unit[j];
            }
            rows[i][j] = 0.0;
            rows[i][NE + j] = i == j ? 1.0 : 0.0;
            rows[NE + i][j] = K / (rate * rate);
            rows[NE + i][NE + j] = D / rate;
        }
    }
    if (!matrix_sign(rows)) {
        return MODEL_ZERO_ON_AXIS;
    }
    for (int i = 0; i < STATES; ++i) {
        trace += rows[i][i];
    }
    *unstable = (int)(0.5 * (STATES + trace) + 0.5);
    *count = grows ? STATES - *unstable : *unstable;
    for (int i = 0; i < STATES; ++i) {
        for (int j = 0; j < STATES; ++j) {
            rows[i][j] = 0.5 * ((i == j ? 1.0 : 0.0) + (grows ? -rows[i][j] : rows[i][j]));
        }
    }
    row_basis(rows, *count);
    for (int i = 0; i < *count; ++i) {
        real most = 0.0;
        for (int j = 0; j < NE; ++j) {
            rows[i][j] *= scale_q / unit[j];
            rows[i][NE + j] *= scale_v / (unit[j] * rate);
        }
        most = largest(rows[i], STATES);
        for (int j = 0; j < STATES; ++j) {
            rows[i][j] /= most;
        }
    }
    return MODEL_OK;
}

/* The pencil of the arm at the equilibrium q with the output at its target. */
static inline int zero_dynamics_at(
    const real *target, const real *q, problem_points *arm, real *space, zero_dynamics *to)
{
    int status;
    real reference[REFERENCE];
    for (int i = 0; i < REFERENCE; ++i) {
        reference[i] = i < NT ? target[i] : 0.0;
    }
    for (int l = 0; l < POINTS; ++l) {
        load_reference(arm, l, reference);
        for (int i = 0; i < NA; ++i) {
            arm->q[i][l] = q[i];
            arm->v[i][l] = 0.0;
            arm->a[i][l] = 0.0;
        }
    }
    begin_points(arm);
    status = solve_kinematics(arm, space);
    if (status == MODEL_OK) {
        status = reduced_jacobians(arm, space);
    }
    for (int i = 0; i < NE && status == MODEL_OK; ++i) {
        for (int j = 0; j < NE; ++j) {
            to->A[i][j] = arm->A[j][i][0];
            to->D[i][j] = arm->D[j][i][0];
            to->K[i][j] = arm->K[j][i][0];
        }
        to->inertia[i] = arm->row_a[i_e[i]][i][0];
    }
    return status;
}

#endif
#endif
