/* elbow: the quasi-static motion, the target of the end of the horizon; private to the stream. */
#ifndef ELBOW_QUASISTATIC_END_H
#define ELBOW_QUASISTATIC_END_H

#include "elbow_stream_memory.h"

#if ELBOW_NE > 0

/* One Newton step of R(q, v, a) = 0 in q at the last nodes of the path, newest first; changes q. */
static inline int balance(
    const mesh *m, lq_space *w, const real *newest, real v[LAST][NE], real a[LAST][NE], real *q, real *space)
{
    int status;
    for (int l = 0; l < POINTS; ++l) {
        const int node = l < LAST ? l : LAST - 1;
        load_reference(&w->arm, l, newest - node * (ptrdiff_t)REFERENCE);
        load_elastic(&w->arm, l, q + node * NE, v[node], a[node]);
        load_joints(&w->arm, l, m->q_g + ((ptrdiff_t)m->N * STAGES - 1) * NG);
    }
    begin_points(&w->arm);
    status = solve_kinematics(&w->arm, space);
    if (status == ELBOW_OK) {
        status = reduced_jacobians(&w->arm, space);
    }
    if (status != ELBOW_OK) {
        return status;
    }
    for (int node = 0; node < LAST; ++node) {
        real K[NE][NE + 1]; /* and the right side */
        for (int i = 0; i < NE; ++i) {
            for (int j = 0; j < NE; ++j) {
                K[i][j] = w->arm.K[j][i][node];
            }
            K[i][NE] = w->arm.row[i][node];
        }
        (void)solve_plain(&K[0][0], NE, NE + 1); /* no pivoting: stiffness dominates; where it is zero nothing moves */
        for (int i = 0; i < NE; ++i) {
            q[node * NE + i] -= fabs_1(K[i][NE]) < 1.0 ? K[i][NE] : 0.0;
        }
    }
    return ELBOW_OK;
}

/*
 * The target of the end of the horizon: the quasi-static motion, deflections in balance with gravity and the path.
 * First without motion of the deflections; then with the velocities and accelerations of this motion, by differences of
 * its last values; and so on. Each level reduces the error by the ratio of the time constants of zeros and path. All
 * nodes are balanced again with the present path: where limits modify it, differences to older values would be wrong.
 */
static inline int quasistatic_motion(mesh *m, lq_space *w, real *levels, const real *newest, real *space)
{
    static const real once[LAST][LAST] = {{25.0, -48.0, 36.0, -16.0, 3.0}, {3.0, 10.0, -18.0, 6.0, -1.0},
        {-1.0, 8.0, 0.0, -8.0, 1.0}, {1.0, -6.0, 18.0, -10.0, -3.0}, {-3.0, 16.0, -36.0, 48.0, -25.0}};
    static const real twice[LAST][LAST] = {{35.0, -104.0, 114.0, -56.0, 11.0}, {11.0, -20.0, 6.0, 4.0, -1.0},
        {-1.0, 16.0, -30.0, 16.0, -1.0}, {-1.0, 4.0, 6.0, -20.0, 11.0}, {11.0, -56.0, 114.0, -104.0, 35.0}};
    real v[LAST][NE] = {{0.0}}, a[LAST][NE] = {{0.0}};
    real *x = levels;
    for (int scale_rows = 0; scale_rows < LEVELS; ++scale_rows) {
        int status;
        x = levels + (ptrdiff_t)scale_rows * LAST * NE;
        for (int k = LAST - 1; k > 0; --k) {
            copy(x + (k - 1) * NE, NE, x + k * NE);
        }
        status = balance(m, w, newest, v, a, x, space);
        if (status != ELBOW_OK) {
            return status;
        }
        for (int k = 0; k < LAST; ++k) {
            for (int i = 0; i < NE; ++i) {
                v[k][i] = a[k][i] = 0.0;
                for (int j = 0; j < LAST; ++j) {
                    v[k][i] += once[k][j] * x[j * NE + i] / (12.0 * m->h);
                    a[k][i] += twice[k][j] * x[j * NE + i] / (12.0 * m->h * m->h);
                }
            }
        }
    }
    {
        real *target_state = m->target_state + m->N * (ptrdiff_t)STATES;
        copy(x, NE, target_state);
        copy(v[0], NE, target_state + NE);
    }
    return ELBOW_OK;
}

#endif

#endif
