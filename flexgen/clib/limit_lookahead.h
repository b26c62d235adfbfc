/*
 * model: predict the motors over the horizon and modify the path where limits would be exceeded; private to the stream.
 */
#ifndef MODEL_LIMIT_LOOKAHEAD_H
#define MODEL_LIMIT_LOOKAHEAD_H

#include "model_stream_memory.h"

enum { LEAST_INTERVALS = 4 }; /* least intervals of a horizon with limits */

#if MODEL_NE > 0
static const real preview_share = 1e-3; /* part of a change of the path that the present motion may still respond to */
#endif
static const real infeasible_factor = 2.5; /* times a limit: a stream that exceeds it more fails */

/* Time constant with which a deviation decays [s]. */
static inline real decay_time(const real *s)
{
    return s[PERIOD] * s[INTERVALS] / DECAYS;
}

/*
 * Start to keep limits, without a deviation. 0 where the horizon is too short: the path may only be modified beyond the
 * preview of the unstable zeros, so that the present motion need not change.
 */
static inline int start_limits(real *s, const layout *l)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    const limits_layout w = limits_laid_out(N);
    real *b = s + l->limits;
    ptrdiff_t fixed = 1;
#if MODEL_NE > 0
    const mesh m = mesh_of(l, s);
    const int ahead = lq_preview(&m, s + l->cost, preview_share, b + w.x);
    fixed = ahead > fixed ? ahead : fixed;
#endif
    if (N < LEAST_INTERVALS || 2 * N < 3 * fixed) {
        return 0;
    }
    b[w.fixed] = (real)fixed;
    copy(s + l->nodes + l->past * REFERENCE, (N + 1) * REFERENCE, b + w.plan);
    for (ptrdiff_t i = 0; i < (N + 1) * DEVIATION; ++i) {
        b[w.deviation + i] = 0.0;
    }
    for (ptrdiff_t i = 0; i < (N + 1) * BOUNDED; ++i) {
        b[w.dual + i] = 0.0;
    }
    b[w.on] = 1.0;
    return 1;
}

/* The deviation at a new sample: the decay of the deviation at the end of the horizon. */
static inline void next_deviation(const real *s, const layout *l, const real *own, real *deviation, real *next)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    decay_step(s + l->limits + limits_laid_out(N).deviation + N * DEVIATION, (real)DECAYS / (real)N, deviation);
    add_deviation(own, deviation, decay_time(s), next);
}

/* Shift by one interval, with the given sample of the path and its deviation. */
static inline void shift_limits(real *s, const layout *l, const real *own, const real *deviation)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    const limits_layout w = limits_laid_out(N);
    real *b = s + l->limits;
    copy(b + w.plan + REFERENCE, N * REFERENCE, b + w.plan);
    copy(own, REFERENCE, b + w.plan + N * REFERENCE);
    copy(b + w.deviation + DEVIATION, N * DEVIATION, b + w.deviation);
    copy(deviation, DEVIATION, b + w.deviation + N * DEVIATION);
    copy(b + w.dual + BOUNDED, N * BOUNDED, b + w.dual);
}

/*
 * Whether limits are active in the interval that begins now: its path is modified, or a limit is exceeded. off:
 * distance and angle from the given path, if larger than before; ends: 1 where a limit is exceeded so far that the
 * stream fails.
 */
static inline int is_limited(const real *s, const layout *l, const real *v_m, const real *tau_m, real off[2], int *ends)
{
    const limits_layout w = limits_laid_out((ptrdiff_t)s[INTERVALS]);
    const real *b = s + l->limits;
    int limited, deviated;
    *ends = 0;
    for (int k = 0; k < 2; ++k) {
        real size[2];
        size_of_deviation(b + w.deviation + k * DEVIATION, size);
        off[0] = fmax_1(off[0], size[0]);
        off[1] = fmax_1(off[1], size[1]);
    }
    limited = deviated = off[0] > deviation_zero || off[1] > deviation_zero;
    for (ptrdiff_t i = 0; i < (ptrdiff_t)s[SAMPLES_PER_INTERVAL] * NM; ++i) {
        const real torque = b[w.bound + i % NM], speed = b[w.bound + NM + i % NM];
        if (fabs_1(tau_m[i]) > torque || fabs_1(v_m[i]) > speed) { /* an exceeded limit is reported */
            limited = 1;
        }
        if (fabs_1(tau_m[i]) > infeasible_factor * torque || fabs_1(v_m[i]) > infeasible_factor * speed) {
            *ends = deviated; /* modifications that cause one another */
        }
    }
    return limited;
}

/* Node k of the horizon, 0 ... N, into a point of `arm`, with guesses of the joints. */
static inline void load_node(real *s, const layout *l, ptrdiff_t k, const real *joints, problem_points *arm, int lane)
{
    const ptrdiff_t node = l->past + k;
    load_reference(arm, lane, s + l->nodes + node * REFERENCE);
    load_joints(arm, lane, joints);
#if MODEL_NE > 0
    {
        const real *y = s + l->y + node * STATES;
        load_elastic(arm, lane, y, y + NE, s + l->a_node + node * NE);
    }
#endif
}

/* Planned motion and torques of the arm at the nodes, and the torques and speeds of the motors there. */
static inline int predict_motors(real *s, const layout *l, const limits_layout *w)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    real *b = s + l->limits, joints[NG];
    problem_points *arm = arm_of(l, s);
    copy(s + l->q_g + N * STAGES * NG, NG, joints);
    for (ptrdiff_t at = 0; at <= N; at += POINTS) {
        const ptrdiff_t used = N + 1 - at < POINTS ? N + 1 - at : (ptrdiff_t)POINTS;
        int status;
        for (int lane = 0; lane < POINTS; ++lane) {
            load_node(s, l, at + (lane < used ? lane : used - 1), joints, arm, lane);
        }
        status = evaluate_torques(arm, s + l->space);
        if (status != MODEL_OK) {
            return status;
        }
        for (int lane = 0; lane < used; ++lane) {
            for (int i = 0; i < NG; ++i) {
                const ptrdiff_t to = (at + lane) * NG + i;
                b[w->q + to] = joints[i] = arm->q[i_g[i]][lane];
                b[w->v + to] = arm->v[i_g[i]][lane];
                b[w->a + to] = arm->a[i_g[i]][lane];
                b[w->tau + to] = arm->tau_g[i][lane];
            }
        }
    }
    return motors_at_nodes(b, w, N, s[PERIOD], s + l->space) ? MODEL_OK : MODEL_RESULT_NOT_FINITE;
}

/* The path of the horizon becomes the given one with its deviation. */
static inline void modify_path(real *s, const layout *l, const limits_layout *w)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    const real *b = s + l->limits;
    real *nodes = s + l->nodes + l->past * REFERENCE;
    for (ptrdiff_t k = 1; k <= N; ++k) {
        add_deviation(
            b + w->plan + k * REFERENCE, b + w->deviation + k * DEVIATION, decay_time(s), nodes + k * REFERENCE);
    }
    for (ptrdiff_t k = 1; k < N; ++k) {
        for (int g = 0; g < STAGES; ++g) {
            real *to = s + l->reference + (k * STAGES + g) * REFERENCE;
            between_samples(nodes + k * REFERENCE, s[PERIOD], gauss_c[g], to);
        }
    }
    copy(nodes + N * REFERENCE, REFERENCE, s + l->last);
}

/* Check whether the motors will exceed their limits, and modify the path beyond the fixed nodes. */
static inline int apply_limits(real *s, const layout *l)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    const limits_layout w = limits_laid_out(N);
    real *b = s + l->limits, *space = s + l->space, worst = 0.0, deviated;
    const ptrdiff_t fixed = (ptrdiff_t)b[w.fixed];
    ptrdiff_t where = fixed + 1;
    int status = predict_motors(s, l, &w);
    if (status != MODEL_OK) {
        return status;
    }
    for (ptrdiff_t k = fixed + 1; k <= N; ++k) {
        const real here = largest(b + w.value + k * BOUNDED, MOTORS);
        if (here > worst) {
            worst = here;
            where = k;
        }
    }
    deviated = largest(b + w.deviation, (int)((N + 1) * DEVIATION));
    if (worst * (1.0 + limit_margin) <= 1.0 && deviated < deviation_decayed) {
        for (ptrdiff_t i = 0; i < (N + 1) * DEVIATION && deviated < deviation_removed; ++i) {
            b[w.deviation + i] = 0.0;
        }
    } else { /* with the Jacobians at the worst node */
        problem_points *arm = arm_of(l, s);
        jacobian_ahead jacobian;
        for (int lane = 0; lane < POINTS; ++lane) {
            load_node(s, l, where, b + w.q + where * NG, arm, lane);
        }
        status = evaluate_torques(arm, space);
        if (status != MODEL_OK) {
            return status;
        }
        if (!jacobian_at(arm, b + w.tau + where * NG, b + w.bound, &jacobian, space)) {
            return MODEL_RESULT_NOT_FINITE;
        }
        if (!change_deviation(b, &w, N, decay_time(s), &jacobian)) {
            return MODEL_OK; /* the present deviations are kept */
        }
    }
    modify_path(s, l, &w);
    return MODEL_OK;
}

#endif
