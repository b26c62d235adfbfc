/* elbow: how a stream advances by one interval, to the next sample of the path; private to the stream. */
#ifndef ELBOW_STREAM_SHIFT_H
#define ELBOW_STREAM_SHIFT_H

#include "elbow_limit_lookahead.h"

/* The new interval: path and joints at its Gauss points, and its side of singular poses. */
typedef struct {
    real reference[STAGES][REFERENCE], joints[STAGES][NG], side;
} next_interval;

/* Whether the arm can reach the next sample; if not, nothing has changed. */
static inline int reach_next_sample(real *s, const layout *l, const real *next, next_interval *to)
{
    const real *joint = s + l->q_g + ((ptrdiff_t)s[INTERVALS] * STAGES - 1) * NG;
    real both[2][REFERENCE];
    problem_points *arm = arm_of(l, s);
    int status;
    copy(s + l->last, REFERENCE, both[0]);
    copy(next, REFERENCE, both[1]);
    for (int point = 0; point < POINTS; ++point) {
        const int stage = point < STAGES ? point : STAGES - 1;
        const real onward = (1.0 + gauss_c[stage] - gauss_c[2]) / (gauss_c[2] - gauss_c[1]);
        real guess[NG];
        if (point < STAGES) {
            between_samples(both[0], s[PERIOD], gauss_c[stage], to->reference[stage]);
        }
        for (int i = 0; i < NG; ++i) { /* extrapolated: through a singular pose rather than back from it */
            guess[i] = joint[i] + onward * (joint[i] - joint[i - NG]);
        }
        load_reference(arm, point, to->reference[stage]);
        load_joints(arm, point, guess);
#if ELBOW_NE > 0
        {
            static const real zero[NE] = {0.0};
            const real *y = s + l->y + (ptrdiff_t)s[INTERVALS] * STATES;
            real q[NE];
            for (int i = 0; i < NE; ++i) {
                q[i] = y[i] + gauss_c[stage] * s[PERIOD] * y[NE + i];
            }
            load_elastic(arm, point, q, y + NE, zero);
        }
#endif
    }
    begin_points(arm);
    status = solve_kinematics(arm, s + l->space);
    if (status != ELBOW_OK) {
        return status;
    }
    to->side = arm->side[0];
    for (int stage = 0; stage < STAGES; ++stage) {
        if (!(arm->side[stage] * (fabs_1(s[SIDE]) > 0.0 ? s[SIDE] : to->side) > 0.0)) {
            return ELBOW_UNREACHABLE; /* on the other side of a singular pose */
        }
        for (int i = 0; i < NG; ++i) {
            to->joints[stage][i] = arm->q[i_g[i]][stage];
        }
    }
    return ELBOW_OK;
}

/*
 * Shift the path and the joints by one interval; the joints at the start of the horizon are stored after those of the
 * Gauss points.
 */
static inline void shift_path(real *s, const layout *l, const real *next, const next_interval *arrived)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS], stages = (N - 1) * STAGES;
    real *q_g = s + l->q_g, *reference = s + l->reference, *nodes = s + l->nodes;
    s[SIDE] = arrived->side;
    copy(q_g + STAGES * NG, stages * NG, q_g);
    copy(arrived->joints[0], STAGES * NG, q_g + stages * NG);
    copy(reference + STAGES * REFERENCE, stages * REFERENCE, reference);
    copy(arrived->reference[0], STAGES * REFERENCE, reference + stages * REFERENCE);
    copy(nodes + REFERENCE, (l->past + N) * REFERENCE, nodes);
    copy(next, REFERENCE, nodes + (l->past + N) * REFERENCE);
    copy(next, REFERENCE, s + l->last);
}

#endif
