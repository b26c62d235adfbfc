/*
 * elbow: the motion between the Gauss points and nodes of a mesh; private.
 */
#ifndef ELBOW_SAMPLES_H
#define ELBOW_SAMPLES_H

#include "elbow_lq.h"
#include "elbow_motors.h"

#if ELBOW_NE > 0

/* Second derivative at x of x^3 (1 - x)^3 x^k, and the two lower ones. */
static inline void bump(real x, int k, real out[3])
{
    static const real c[4] = {1.0, -3.0, 3.0, -1.0};
    out[0] = out[1] = out[2] = 0.0;
    for (int i = 3; i >= 0; --i) {
        const int degree = 3 + i + k;
        real power = c[i];
        for (int j = 0; j < degree - 2; ++j) {
            power *= x;
        }
        out[0] += power * x * x;
        out[1] += degree * power * x;
        out[2] += degree * (degree - 1) * power;
    }
}

/* Coordinates in an interval: the polynomial with value, two derivatives at its nodes and a_e at its Gauss points. */
typedef struct {
    real inverse[STAGES][STAGES];
} interpolant;

static inline void prepare(interpolant *f)
{
    for (int c = 0; c < STAGES; ++c) {
        real a[3][4], out[3];
        for (int i = 0; i < STAGES; ++i) {
            for (int j = 0; j < STAGES; ++j) {
                bump(gauss_c[i], j, out);
                a[i][j] = out[2];
            }
            a[i][3] = i == c ? 1.0 : 0.0;
        }
        solve_three(a);
        for (int i = 0; i < STAGES; ++i) {
            f->inverse[i][c] = a[i][3];
        }
    }
}

static inline void between(const interpolant *f, const real left[3], const real right[3], const real *a,
    ptrdiff_t stride, real h, real x, real out[3])
{
    real miss[STAGES], own[3];
    for (int i = 0; i < STAGES; ++i) {
        quintic(gauss_c[i], left, right, own);
        miss[i] = h * h * a[i * stride] - own[2];
    }
    quintic(x, left, right, out);
    for (int i = 0; i < STAGES; ++i) {
        real weight = 0.0;
        for (int j = 0; j < STAGES; ++j) {
            weight += f->inverse[i][j] * miss[j];
        }
        bump(x, i, own);
        for (int j = 0; j < 3; ++j) {
            out[j] += weight * own[j];
        }
    }
}

/* Accelerations at the nodes: the polynomial through the Gauss points on both sides, at the first one rest. */
static inline void nodal_accelerations(const mesh *m, real *a_node)
{
    real weight[2 * STAGES], end[STAGES];
    for (int i = 0; i < 2 * STAGES; ++i) {
        const real x = i < STAGES ? gauss_c[i] - 1.0 : gauss_c[i - STAGES];
        weight[i] = 1.0;
        for (int j = 0; j < 2 * STAGES; ++j) {
            const real other = j < STAGES ? gauss_c[j] - 1.0 : gauss_c[j - STAGES];
            if (j != i) {
                weight[i] *= other / (other - x);
            }
        }
    }
    for (int i = 0; i < STAGES; ++i) {
        end[i] = 1.0;
        for (int j = 0; j < STAGES; ++j) {
            if (j != i) {
                end[i] *= (1.0 - gauss_c[j]) / (gauss_c[i] - gauss_c[j]);
            }
        }
    }
    for (int k = 0; k <= m->N; ++k) {
        const real *right = m->a + (ptrdiff_t)k * CONTROLS;
        const real *left = right - CONTROLS;
        for (int i = 0; i < NE; ++i) {
            real sum = 0.0;
            for (int s = 0; s < STAGES; ++s) {
                if (k == m->N) {
                    sum += end[s] * left[s * NE + i];
                } else {
                    sum += (k > 0 ? weight[s] * left[s * NE + i] : 0.0) + weight[STAGES + s] * right[s * NE + i];
                }
            }
            a_node[(ptrdiff_t)k * NE + i] = k == 0 ? 0.0 : sum;
        }
    }
}

/* Non-actuated coordinates, speeds and accelerations at x, 0 <= x <= 1, of an interval, into place l. */
static inline void load_elastic(
    const mesh *m, const real *a_node, const interpolant *f, ptrdiff_t interval, real x, arm_points *arm, int l)
{
    const real h = m->h;
    const real *y0 = m->y + interval * STATES, *y1 = y0 + STATES;
    const real *a0 = a_node + interval * NE, *a1 = a0 + NE;
    for (int i = 0; i < NE; ++i) {
        const real left[3] = {y0[i], h * y0[NE + i], h * h * a0[i]};
        const real right[3] = {y1[i], h * y1[NE + i], h * h * a1[i]};
        real out[3];
        between(f, left, right, m->a + interval * CONTROLS + i, NE, h, x, out);
        arm->q[i_e[i]][l] = out[0];
        arm->v[i_e[i]][l] = out[1] / h;
        arm->a[i_e[i]][l] = out[2] / (h * h);
    }
}

#endif

/* Gear torques and residuals of POINTS instants whose non-actuated motion is known. */
static inline int torques(arm_points *arm, real *space)
{
    const int status = follow(arm, space);
    if (status != ELBOW_OK) {
        return status;
    }
#if ELBOW_NE > 0
    return inner(elbow_inversion_rows_batch(POINTS, &arm->q[0][0], &arm->v[0][0], &arm->a[0][0], &arm->tau_g[0][0],
        &arm->row[0][0], space));
#else
    return inner(elbow_inversion_rows_batch(
        POINTS, &arm->q[0][0], &arm->v[0][0], &arm->a[0][0], &arm->tau_g[0][0], space));
#endif
}

/* Largest of the workspaces that the functions used here want. */
static inline ptrdiff_t space_wanted(void)
{
    ptrdiff_t most = ELBOW_OUTPUT_CONSTRAINT_BATCH_WORK;
#if ELBOW_NE > 0
    most = most < ELBOW_INVERSION_SLOPES_BATCH_WORK ? ELBOW_INVERSION_SLOPES_BATCH_WORK : most;
    most = most < ELBOW_INVERSION_SLOPES_WORK ? ELBOW_INVERSION_SLOPES_WORK : most;
#endif
    most = most < ELBOW_OUTPUT_CONSTRAINT_WORK ? ELBOW_OUTPUT_CONSTRAINT_WORK : most;
    most = most < ELBOW_INVERSION_ROWS_BATCH_WORK ? ELBOW_INVERSION_ROWS_BATCH_WORK : most;
    most = most < ELBOW_GEAR_LAW_WORK ? ELBOW_GEAR_LAW_WORK : most;
    most = most < ELBOW_MOTOR_FRICTION_WORK ? ELBOW_MOTOR_FRICTION_WORK : most;
    return most + 8;
}

/* Room in the workspace, in numbers; whole vectors apart. */
static inline int64_t room(int64_t n)
{
    return (n + 7) / 8 * 8;
}

#if ELBOW_POSE
/* Whether R, by columns, is a rotation. */
static inline int is_rotation(const real *R)
{
    for (int i = 0; i < 3; ++i) {
        real c[3];
        for (int j = 0; j < 3; ++j) {
            const real *a = R + 3 * i, *b = R + 3 * j;
            const real dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            if (!(fabs_1(dot - (i == j ? 1.0 : 0.0)) < 1e-6)) {
                return 0;
            }
        }
        cross(R + 3 * i, R + 3 * ((i + 1) % 3), c);
        for (int j = 0; j < 3; ++j) {
            if (!(fabs_1(c[j] - R[3 * ((i + 2) % 3) + j]) < 1e-6)) {
                return 0;
            }
        }
    }
    return 1;
}

/* Whether two orientations are close enough for a quintic between them. */
static inline int are_near(const real *R0, const real *R1)
{
    real f[3];
    turned(R0, R1, f);
    return largest(f, 3) < 0.3;
}
#endif

#endif
