/*
 * elbow: the end of a motion along a path, where what is left of it moves the output no more; private.
 *
 * After the path the motion of the unactuated coordinates decays to the equilibrium. What is left of it moves the
 * output by about
 *
 *     max over X in {W_e, D} of max(|X (q_e - q_e,end)|, HELD |X v_e|),    dy/dt = W v_a,
 *
 * while the joints stand still or, D = W_g M_gg^-1 M_ge - W_e, while the torque is held and they keep their momentum.
 * It does not end before the deflections of damped gears have decayed, see `shortest_motion_after`.
 */
#ifndef ELBOW_SETTLING_H
#define ELBOW_SETTLING_H

#include "elbow_dense.h"
#include "elbow_whole_path.h"

#if ELBOW_NE > 0

static const real held_time = 0.5; /* s: HELD */

typedef struct {
    real allowed;       /* what may be left [m or rad]; 0: the motion is not cut */
    real q[NA];         /* the equilibrium */
    real X[2 * NY][NE]; /* W_e and D there */
    real shortest;      /* motion after the path, at least [s] */
    int intervals;      /* with motion */
} settling;

/* The matrices at the equilibrium, M by inverse dynamics of unit accelerations. */
static inline int settling_at(const real *target, problem_points *arm, settling *s, real *space)
{
    real M[NG][NG + NE], at_rest[NG];
    for (int i = 0; i < NT; ++i) {
        for (int l = 0; l < POINTS; ++l) {
            arm->target[i][l] = target[i];
        }
    }
    for (int begin = 0; begin <= NA; begin += POINTS) {
        int status;
        for (int i = 0; i < NA; ++i) {
            for (int l = 0; l < POINTS; ++l) {
                arm->q[i][l] = s->q[i];
                arm->v[i][l] = 0.0;
                arm->a[i][l] = begin + l == i + 1 ? 1.0 : 0.0; /* the first: at rest */
            }
        }
        status = evaluate_rows(arm, space);
        if (status != ELBOW_OK) {
            return status;
        }
        for (int i = 0; i < NG; ++i) {
            at_rest[i] = begin == 0 ? arm->tau_g[i][0] : at_rest[i];
            for (int j = 0; j < NG + NE; ++j) {
                const int l = (j < NG ? i_g[j] : i_e[j - NG]) + 1 - begin;
                if (l >= 0 && l < POINTS) {
                    M[i][j] = arm->tau_g[i][l] - at_rest[i];
                }
            }
        }
    }
    (void)solve_plain(&M[0][0], NG, NG + NE);
    evaluate_constraint(arm, space);
    for (int i = 0; i < NY; ++i) {
        for (int j = 0; j < NE; ++j) {
            s->X[i][j] = arm->W[i_e[j]][i][0];
            s->X[NY + i][j] = -s->X[i][j];
            for (int k = 0; k < NG; ++k) {
                s->X[NY + i][j] += arm->W[i_g[k]][i][0] * M[k][NG + j];
            }
        }
    }
    return ELBOW_OK;
}

/* Whether what is left of the motion at node k of the mesh moves the output by more than `allowed`. */
static inline int moves_at(const mesh *m, const settling *s, ptrdiff_t k, real allowed)
{
    const real *y = m->y + k * STATES;
    for (int part = 0; part < 2; ++part) {
        real squares[2] = {0.0, 0.0};
        for (int i = part * NY; i < (part + 1) * NY; ++i) {
            real q = 0.0, v = 0.0;
            for (int j = 0; j < NE; ++j) {
                q += s->X[i][j] * (y[j] - m->equilibrium[j]);
                v += s->X[i][j] * held_time * y[NE + j];
            }
            squares[0] += q * q;
            squares[1] += v * v;
        }
        if (!(fmax_1(squares[0], squares[1]) <= allowed * allowed)) {
            return 1;
        }
    }
    return 0;
}

/*
 * Leave out the intervals after the motion, but for those that its last derivatives need. Half of what is allowed: the
 * next steps change the motion, and a vibration can be larger between two nodes.
 */
static inline void cut_mesh(mesh *m, int samples_per_interval, settling *s)
{
    const int margin = (BEYOND + samples_per_interval - 1) / samples_per_interval;
    int k = m->N;
    while ((real)(k - m->varying) * m->h > s->shortest && !moves_at(m, s, k, 0.5 * s->allowed)) {
        --k;
    }
    if (k + 1 + margin < m->N) {
        m->N = k + 1 + margin;
        s->intervals = k + 1;
    }
}

/* Whether the motion that has been found moves after its end, which was chosen before its last steps. */
static inline int is_cut_early(const mesh *m, const settling *s)
{
    for (int k = s->intervals; s->intervals < m->N && k <= m->N; ++k) {
        if (moves_at(m, s, k, s->allowed)) {
            return 1;
        }
    }
    return 0;
}

#endif

#endif
