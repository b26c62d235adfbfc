/*
 * elbow: the parts of an update of a stream; private.
 */
#ifndef ELBOW_STREAM_UPDATE_H
#define ELBOW_STREAM_UPDATE_H

#include "../elbow_inversion.h"

#include "elbow_limits.h"
#include "elbow_lq_step.h"
#include "elbow_mesh.h"
#include "elbow_motors.h"
#include "elbow_path.h"
#include "elbow_stream_layout.h"

/*
 * --- The memory of a stream.
 *
 * An array of numbers of the caller: a head, then arrays, see elbow_stream_layout.h. Between two
 * updates it holds the planned motion over the horizon. An update shifts it by one interval, takes
 * the next sample of the path at its end and makes one Gauss-Newton step.
 */

/* States of the head. */
enum {
    IS_EMPTY = 0,
    IS_RUNNING = 20231, /* a number that memory hardly holds by chance */
    HAS_FAILED = 2
};

static inline int stream_sizes_fit(const elbow_stream_options *o)
{
    return o->intervals >= 1 && o->intervals <= ELBOW_STREAM_INTERVALS_MAX &&
           o->samples_per_interval >= 1 && o->samples_per_interval <= ELBOW_STREAM_SAMPLES_MAX &&
           hold_fits((int)o->hold, o->delay);
}

/*
 * Whether memory holds a stream that this library started and that has not failed; it may hold
 * anything.
 */
static inline int is_running(const real *stream)
{
    const stream_head *h = head_in(stream);
    return h->state == IS_RUNNING && h->key == STREAM_KEY && h->intervals >= 1 &&
           h->intervals <= ELBOW_STREAM_INTERVALS_MAX && h->samples_per_interval >= 1 &&
           h->samples_per_interval <= ELBOW_STREAM_SAMPLES_MAX && hold_fits(h->hold, h->delay);
}

/* The layout of a running stream. */
static inline layout layout_of(const real *stream)
{
    const stream_head *h = head_in(stream);
    return laid_out(h->intervals, h->samples_per_interval, h->hold, h->delay);
}

/* POINTS instants of the arm, which only serve within a call. */
static inline problem_points *arm_of(const layout *l, real *s)
{
    return (problem_points *)(void *)(s + l->lq);
}

/*
 * --- Predict the motors over the horizon and modify the path where limits would be exceeded.
 */

enum { LEAST_INTERVALS = 4 }; /* least intervals of a horizon with limits */

static const real infeasible_factor = 2.5; /* times a limit: a stream that exceeds it more fails */

/* Time constant with which a deviation decays [s]. */
static inline real decay_time(const real *s)
{
    return head_in(s)->period * (real)head_in(s)->intervals / DECAYS;
}

/*
 * Start to keep limits, without a deviation. 0 where the horizon is too short: the path may only
 * be modified beyond the preview of the unstable zeros, so that the present motion need not
 * change.
 */
static inline int start_limits(real *s, const layout *l)
{
    const ptrdiff_t N = head_in(s)->intervals;
    const limits_layout w = limits_laid_out(N);
    real *b = s + l->limits;
    ptrdiff_t fixed = 1;
    if (N < LEAST_INTERVALS || 2 * N < 3 * fixed) {
        return 0;
    }
    head_of(s)->fixed = (int32_t)fixed;
    copy(s + l->nodes + l->past * REFERENCE, (N + 1) * REFERENCE, b + w.plan);
    for (ptrdiff_t i = 0; i < (N + 1) * DEVIATION; ++i) {
        b[w.deviation + i] = 0.0;
    }
    for (ptrdiff_t i = 0; i < (N + 1) * BOUNDED; ++i) {
        b[w.dual + i] = 0.0;
    }
    head_of(s)->has_limits = 1;
    return 1;
}

/* The deviation at a new sample: the decay of the deviation at the end of the horizon. */
static inline void next_deviation(
    const real *s, const layout *l, const real *own, real *deviation, real *next)
{
    const ptrdiff_t N = head_in(s)->intervals;
    decay_step(s + l->limits + limits_laid_out(N).deviation + N * DEVIATION,
        (real)DECAYS / (real)N, deviation);
    add_deviation(own, deviation, decay_time(s), next);
}

/* Shift by one interval, with the given sample of the path and its deviation. */
static inline void shift_limits(real *s, const layout *l, const real *own, const real *deviation)
{
    const ptrdiff_t N = head_in(s)->intervals;
    const limits_layout w = limits_laid_out(N);
    real *b = s + l->limits;
    copy(b + w.plan + REFERENCE, N * REFERENCE, b + w.plan);
    copy(own, REFERENCE, b + w.plan + N * REFERENCE);
    copy(b + w.deviation + DEVIATION, N * DEVIATION, b + w.deviation);
    copy(deviation, DEVIATION, b + w.deviation + N * DEVIATION);
    copy(b + w.dual + BOUNDED, N * BOUNDED, b + w.dual);
}

/*
 * Whether limits are active in the interval that begins now: its path is modified, or a limit is
 * exceeded. off: distance and angle from the given path, if larger than before; ends: 1 where a
 * limit is exceeded so far that the stream fails.
 */
static inline int is_limited(
    const real *s, const layout *l, const real *v_m, const real *tau_m, real off[2], int *ends)
{
    const limits_layout w = limits_laid_out(head_in(s)->intervals);
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
    for (ptrdiff_t i = 0; i < (ptrdiff_t)head_in(s)->samples_per_interval * NM; ++i) {
        const real torque = b[w.bound + i % NM], speed = b[w.bound + NM + i % NM];
        /* an exceeded limit is reported */
        if (fabs_1(tau_m[i]) > torque || fabs_1(v_m[i]) > speed) {
            limited = 1;
        }
        if (fabs_1(tau_m[i]) > infeasible_factor * torque ||
            fabs_1(v_m[i]) > infeasible_factor * speed) {
            *ends = deviated; /* modifications that cause one another */
        }
    }
    return limited;
}

/* Node k of the horizon, 0 ... N, into a point of `arm`, with guesses of the joints. */
static inline void load_node(
    real *s, const layout *l, ptrdiff_t k, const real *joints, problem_points *arm, int lane)
{
    const ptrdiff_t node = l->past + k;
    load_reference(arm, lane, s + l->nodes + node * REFERENCE);
    load_joints(arm, lane, joints);
}

/*
 * Planned motion and torques of the arm at the nodes, and the torques and speeds of the motors
 * there.
 */
static inline int predict_motors(real *s, const layout *l, const limits_layout *w)
{
    const ptrdiff_t N = head_in(s)->intervals;
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
        if (status != ELBOW_OK) {
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
    return motors_at_nodes(b, w, N, head_in(s)->period, s + l->space) ? ELBOW_OK :
                                                                        ELBOW_RESULT_NOT_FINITE;
}

/* The path of the horizon becomes the given one with its deviation. */
static inline void modify_path(real *s, const layout *l, const limits_layout *w)
{
    const ptrdiff_t N = head_in(s)->intervals;
    const real *b = s + l->limits;
    real *nodes = s + l->nodes + l->past * REFERENCE;
    for (ptrdiff_t k = 1; k <= N; ++k) {
        add_deviation(b + w->plan + k * REFERENCE, b + w->deviation + k * DEVIATION, decay_time(s),
            nodes + k * REFERENCE);
    }
    for (ptrdiff_t k = 1; k < N; ++k) {
        for (int g = 0; g < STAGES; ++g) {
            real *to = s + l->reference + (k * STAGES + g) * REFERENCE;
            between_samples(nodes + k * REFERENCE, head_in(s)->period, gauss_c[g], to);
        }
    }
    copy(nodes + N * REFERENCE, REFERENCE, s + l->last);
}

/*
 * Check whether the motors will exceed their limits, and modify the path beyond the fixed nodes.
 */
static inline int apply_limits(real *s, const layout *l)
{
    const ptrdiff_t N = head_in(s)->intervals;
    const limits_layout w = limits_laid_out(N);
    real *b = s + l->limits, *space = s + l->space, worst = 0.0, deviated;
    const ptrdiff_t fixed = head_in(s)->fixed;
    ptrdiff_t where = fixed + 1;
    int status = predict_motors(s, l, &w);
    if (status != ELBOW_OK) {
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
        if (status != ELBOW_OK) {
            return status;
        }
        if (!jacobian_at(arm, b + w.tau + where * NG, b + w.bound, &jacobian, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        if (!change_deviation(b, &w, N, fixed, decay_time(s), &jacobian)) {
            return ELBOW_OK; /* the present deviations are kept */
        }
    }
    modify_path(s, l, &w);
    return ELBOW_OK;
}

/* --- The quasi-static motion, the target of the end of the horizon. */

/* --- How a stream advances by one interval, to the next sample of the path. */

/* The new interval: path and joints at its Gauss points, and its side of singular poses. */
typedef struct {
    real reference[STAGES][REFERENCE], joints[STAGES][NG], side;
} next_interval;

/* Whether the arm can reach the next sample; if not, nothing has changed. */
static inline int reach_next_sample(real *s, const layout *l, const real *next, next_interval *to)
{
    const real *joint = s + l->q_g + ((ptrdiff_t)head_in(s)->intervals * STAGES - 1) * NG;
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
            between_samples(both[0], head_in(s)->period, gauss_c[stage], to->reference[stage]);
        }
        /* extrapolated: through a singular pose rather than back from it */
        for (int i = 0; i < NG; ++i) {
            guess[i] = joint[i] + onward * (joint[i] - joint[i - NG]);
        }
        load_reference(arm, point, to->reference[stage]);
        load_joints(arm, point, guess);
    }
    begin_points(arm);
    status = solve_kinematics(arm, s + l->space);
    if (status != ELBOW_OK) {
        return status;
    }
    to->side = arm->side[0];
    for (int stage = 0; stage < STAGES; ++stage) {
        if (!(arm->side[stage] * (head_in(s)->side != 0 ? (real)head_in(s)->side : to->side) >
                0.0)) {
            return ELBOW_UNREACHABLE; /* on the other side of a singular pose */
        }
        for (int i = 0; i < NG; ++i) {
            to->joints[stage][i] = arm->q[i_g[i]][stage];
        }
    }
    return ELBOW_OK;
}

/*
 * Shift the path and the joints by one interval; the joints at the start of the horizon are stored
 * after those of the Gauss points.
 */
static inline void shift_path(
    real *s, const layout *l, const real *next, const next_interval *arrived)
{
    const ptrdiff_t N = head_in(s)->intervals, stages = (N - 1) * STAGES;
    real *q_g = s + l->q_g, *reference = s + l->reference, *nodes = s + l->nodes;
    head_of(s)->side = arrived->side > 0.0 ? 1 : -1;
    copy(q_g + STAGES * NG, stages * NG, q_g);
    copy(arrived->joints[0], STAGES * NG, q_g + stages * NG);
    copy(reference + STAGES * REFERENCE, stages * REFERENCE, reference);
    copy(arrived->reference[0], STAGES * REFERENCE, reference + stages * REFERENCE);
    copy(nodes + REFERENCE, (l->past + N) * REFERENCE, nodes);
    copy(next, REFERENCE, nodes + (l->past + N) * REFERENCE);
    copy(next, REFERENCE, s + l->last);
}

/*
 * --- One Gauss-Newton step of the motion over the horizon, in parts.
 *
 * Between two updates most intervals of the horizon only become one interval older: their
 * Jacobians, factors and costs to go are kept, and only those of some intervals are computed
 * again, of more at the end of the horizon, where the motion still changes. The residuals are
 * computed everywhere.
 */

/* --- Motion and torques of the interval that begins now, and their kinematic mismatch. */

enum { MEMORY_DECAYS = 4 }; /* time constants of the memory of the largest values, per horizon */

/* of a motor torque from one interval to the next, relative to its largest value */
static const real torque_step_max = PRECISE(2e-4, 5e-3);

/*
 * m or rad: joints that move less within an interval are at rest; a smaller step of the output is
 * none
 */
static const real negligible_motion = PRECISE(3e-8, 1e-5), negligible_step = PRECISE(1e-8, 1e-6);

/* Results of an update, sample after sample. */
typedef struct {
    real *q_a, *v_a, *tau_g, *q_m, *v_m, *tau_m;
} interval_results;

/*
 * Motion and gear torques of the arm in the window around the interval; worst: the largest
 * residual in the interval.
 */
static inline int arm_in_window(real *s, const layout *l, const interval_results *out, real *worst)
{
    const int samples_per_interval = head_in(s)->samples_per_interval,
              intervals = head_in(s)->intervals, end = (int)l->past + intervals;
    real *joints_now = s + l->q_g + (ptrdiff_t)intervals * STAGES * NG;
    const real fine = head_in(s)->period / (real)samples_per_interval;
    joint_motion last;
    real time[POINTS];
    problem_points *arm = arm_of(l, s);
    *worst = 0.0;
    /*
     * All samples from the present plan, the past too: derivatives must not contain steps between
     * plans.
     */
    joints_at_rest(joints_now, &last);
    begin_points(arm);
    for (int at = 0; at < l->window; at += POINTS) {
        const int used = (int)(l->window - at < POINTS ? l->window - at : (ptrdiff_t)POINTS);
        int status;
        for (int point = 0; point < POINTS; ++point) {
            const int k = at + (point < used ? point : used - 1) - BACK +
                          (int)l->past * samples_per_interval;
            const int node = k / samples_per_interval < end ? k / samples_per_interval : end - 1;
            const real x = k / samples_per_interval < end ?
                               (real)(k - node * samples_per_interval) /
                                   (real)samples_per_interval :
                               1.0;
            real reference[REFERENCE];
            between_samples(
                s + l->nodes + node * (ptrdiff_t)REFERENCE, head_in(s)->period, x, reference);
            load_reference(arm, point, reference);
            time[point] = (real)(at + (point < used ? point : used - 1)) * fine;
        }
        status = follow_kinematics(arm, &last, time, s + l->space);
        status = status == ELBOW_OK ? evaluate_rows(arm, s + l->space) : status;
        if (status != ELBOW_OK) {
            return status;
        }
        for (int point = 0; point < used; ++point) {
            const int k = at + point - BACK;
            real *tau = s + l->tau + (at + point) * (ptrdiff_t)NG;
            real *joint = s + l->joint + (at + point) * (ptrdiff_t)JOINT;
            if (!(arm->side[point] * (real)head_in(s)->side > 0.0)) {
                /* deflections brought it to the other side of a singular pose */
                return ELBOW_UNREACHABLE;
            }
            for (int i = 0; i < NG; ++i) {
                tau[i] = arm->tau_g[i][point];
                joint[i] = arm->q[i_g[i]][point];
                joint[NG + i] = arm->v[i_g[i]][point];
                joint[2 * NG + i] = arm->a[i_g[i]][point];
            }
            if (k < 0 || k >= samples_per_interval) {
                continue;
            }
            for (int i = 0; i < NA; ++i) {
                out->q_a[k * NA + i] = arm->q[i][point];
                out->v_a[k * NA + i] = arm->v[i][point];
            }
            copy(tau, NG, out->tau_g + k * NG);
            if (k == samples_per_interval - 1) {
                copy(joint, NG, joints_now);
            }
        }
        if (used > 1) {
            keep_joints(
                arm, used - 1, (real)(at + used - 1) * fine, (real)(used - 1) * fine, &last);
        }
    }
    return ELBOW_OK;
}

/*
 * Step of the output [m], [rad]: the static deflections of the gears step from those that the plan
 * before predicted, and the joints follow, since the motors cannot step.
 */
static inline void output_step_of(real *s, const layout *l, const real *deflection, real size[2])
{
    const problem_points *arm = arm_of(l, s);
    const real *expected = s + l->expected + NM;
    real step[NY] = {0.0};
    for (int i = 0; i < NG && head_in(s)->is_predicted; ++i) {
        for (int k = 0; k < NY; ++k) {
            step[k] += arm->W[i_g[i]][k][0] * (deflection[i] - expected[i]);
        }
    }
    size_of_deviation(step, size);
}

/*
 * The largest step of a motor torque from the value that the plan before predicted, relative to
 * the largest of that motor within about a horizon, or to a hundredth of that of all motors. A
 * step is not a motion, although each plan is smooth.
 */
static inline real torque_step_of(real *s, const layout *l, const real *tau_m)
{
    const real N = (real)head_in(s)->intervals, kept = N / (N + MEMORY_DECAYS);
    const real *expected = s + l->expected;
    real *most = s + l->most + MEASURES, all = 1e-12, worst = 0.0;
    for (int i = 0; i < NM; ++i) {
        most[i] = fmax_1(fabs_1(tau_m[i]), kept * most[i]);
        all = fmax_1(all, most[i]);
    }
    for (int i = 0; i < NM && head_in(s)->is_predicted; ++i) {
        worst = fmax_1(worst, fabs_1(tau_m[i] - expected[i]) / fmax_1(most[i], 0.01 * all));
    }
    return worst;
}

/*
 * The torques to send in the interval from those of the motors, of which the last are kept for the
 * next update.
 */
static inline void hold_interval(real *s, const layout *l, real *tau_m)
{
    const ptrdiff_t samples_per_interval = head_in(s)->samples_per_interval;
    const real *sample = s + l->torque + (int)head_in(s)->delay * NM;
    real weight[HOLD_TAPS];
    hold_weights(head_in(s)->hold, head_in(s)->delay, head_in(s)->has_limits, weight);
    for (ptrdiff_t k = 0; k < samples_per_interval; ++k) {
        for (int j = 0; j < NM; ++j) {
            real sum = 0.0;
            for (int i = 0; i < HOLD_TAPS; ++i) {
                sum += weight[i] * sample[(k + i) * NM + j];
            }
            tau_m[k * NM + j] = sum;
        }
    }
    copy(s + l->torque + samples_per_interval * NM, HOLD_BEFORE * NM, s + l->torque);
}

/*
 * Deflections of the gears in the window from their torques; keep: those at the end of the
 * interval are carried on to the next update.
 */
static inline int deflections_in_window(real *s, const layout *l, gears *g, int keep)
{
    const ptrdiff_t samples_per_interval = head_in(s)->samples_per_interval;
    real *space = s + l->space, last_stiffness[NG];
    if (!begin_gears(g, head_in(s)->period / (real)samples_per_interval, s + l->now, space) ||
        !static_deflections(
            s + l->tau, l->window, s + l->now, s + l->deflection, last_stiffness, space)) {
        return 0;
    }
    for (ptrdiff_t k = MARGIN; k + MARGIN < l->window; ++k) {
        real value[NG], stiffness[NG];
        if (k >= BACK && k <= BACK + samples_per_interval + l->ahead &&
            !advance_gears(g, k == BACK, s + l->tau + k * NG, 1, NG, space)) {
            return 0;
        }
        if (keep && g->slow && k == BACK + samples_per_interval) {
            copy(g->now, NG, s + l->now);
        }
        if (evaluate_gear_law(s + l->deflection + k * NG, value, stiffness, space) != ELBOW_OK) {
            return 0;
        }
        lagged_deflections(
            g, s + l->deflection + k * NG, stiffness, s + l->lagged + k * NG, space);
    }
    return 1;
}

/*
 * Motors in the interval; the deflections of the gears are carried on from update to update. step,
 * output_step: of the motor torques and of the output at its start; steps at rest are not counted.
 */
static inline int motors_in_interval(
    real *s, const layout *l, const interval_results *out, real *step, real output_step[2])
{
    const ptrdiff_t samples_per_interval = head_in(s)->samples_per_interval;
    const int is_first = !head_in(s)->is_predicted;
    real *space = s + l->space, *torque = s + l->torque;
    gears g;
    if (!deflections_in_window(s, l, &g, 1)) {
        return ELBOW_RESULT_NOT_FINITE;
    }
    for (ptrdiff_t k = 0; k <= samples_per_interval + l->ahead; ++k) {
        const real *tau = s + l->tau + (k + BACK) * NG,
                   *deflection = s + l->lagged + (k + BACK) * NG;
        const real *joint = s + l->joint + (k + BACK) * JOINT;
        real q[NG], v[NG], a[NG], q_m[NM], v_m[NM], tau_m[NM];
        copy(joint, NG, q);
        copy(joint + NG, NG, v);
        copy(joint + 2 * NG, NG, a);
        if (!deflect_joints(&g, tau, deflection, q, v, a, space) ||
            !motors_of(q, v, a, tau, q_m, v_m, tau_m, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        if (k == 0) {
            *step = torque_step_of(s, l, tau_m);
            output_step_of(s, l, s + l->deflection + BACK * NG, output_step);
            *step = fmax_1(output_step[0], output_step[1]) > negligible_step ? *step : 0.0;
        }
        if (k < samples_per_interval) {
            copy(q_m, NM, out->q_m + k * NM);
            copy(v_m, NM, out->v_m + k * NM);
            copy(tau_m, NM, out->tau_m + k * NM);
        } else if (k == samples_per_interval) {
            head_of(s)->is_predicted = 1;
            copy(tau_m, NM, s + l->expected);
            copy(s + l->deflection + (k + BACK) * NG, NG, s + l->expected + NM);
        }
        if (l->ahead > 0) {
            copy(tau_m, NM, torque + (HOLD_BEFORE + k) * NM);
        }
        for (int i = 0; i < HOLD_BEFORE && k == 0 && is_first && l->ahead > 0; ++i) {
            copy(tau_m, NM, torque + i * NM); /* at equilibrium before */
        }
    }
    if (l->ahead > 0) {
        hold_interval(s, l, out->tau_m);
    }
    return ELBOW_OK;
}

/*
 * Kinematic mismatch of joints and motors in this interval, and at the samples after it that held
 * torques depend on, by finite differences, as for a whole path. It is relative to the largest
 * values within about a horizon: past values, which are forgotten gradually, present ones, and the
 * planned ones of the joints. Deflections without damping: damping makes them smoother.
 * Differences and torques that need more than the horizon are wrong, and appear here.
 */
static inline real kinematic_mismatch_now(real *s, const layout *l)
{
    const ptrdiff_t samples_per_interval = head_in(s)->samples_per_interval,
                    N = head_in(s)->intervals;
    const real h = head_in(s)->period, fine = h / (real)samples_per_interval, sixty = 60.0 * fine;
    const real slow = negligible_motion / (mismatch_max * h), acceleration = slow / h;
    /* smallest scales: at rest there is only rounding */
    real most[MEASURES] = {fmax_1(1e-4, acceleration), 1e-2, fmax_1(1e-7, slow), 1e-4};
    real off[MEASURES] = {0.0}, worst = 0.0;
    for (int j = 0; j < NM; ++j) {
        real ratio = 0.0;
        for (int i = 0; i < NG; ++i) {
            ratio = fmax_1(ratio, fabs_1(eta[j][i]));
        }
        most[1] = fmax_1(most[1], ratio * acceleration);
        most[3] = fmax_1(most[3], rotor_inertia[j] * ratio * acceleration);
    }
    for (ptrdiff_t k = 0; k < samples_per_interval + l->ahead; ++k) {
        real a_of[NG], miss[NG];
        for (int i = 0; i < NG; ++i) {
            const real *q = s + l->joint + (k + BACK) * JOINT + i, *v = q + NG, a = q[2 * NG];
            const real *deflection = s + l->deflection + (k + BACK) * NG + i;
            real speed[2 * MARGIN + 1];
            for (ptrdiff_t j = -MARGIN; j <= MARGIN; ++j) {
                speed[j + MARGIN] = v[j * JOINT] + derivative_of(deflection + j * NG, NG, fine);
            }
            a_of[i] = a + second_derivative_of(deflection, NG, fine);
            miss[i] = sixty_differences(speed + MARGIN, 1) - sixty * a_of[i];
            most[0] = fmax_1(most[0], fabs_1(a));
            most[2] = fmax_1(most[2], fabs_1(v[0]));
            off[0] = fmax_1(off[0], fabs_1(sixty_differences(v, JOINT) - sixty * a));
            off[2] = fmax_1(off[2], fabs_1(sixty_differences(q, JOINT) - sixty * v[0]));
        }
        for (int j = 0; j < NM; ++j) {
            real a = 0.0, b = 0.0;
            for (int i = 0; i < NG; ++i) {
                a += eta[j][i] * a_of[i];
                b += eta[j][i] * miss[i];
            }
            most[1] = fmax_1(most[1], fabs_1(a));
            most[3] = fmax_1(most[3], rotor_inertia[j] * fabs_1(a));
            off[1] = fmax_1(off[1], fabs_1(b));
            off[3] = fmax_1(off[3], rotor_inertia[j] * fabs_1(b));
        }
    }
    for (ptrdiff_t k = 1; k + 1 < N; ++k) {
        const real *q = s + l->q_g + k * STAGES * NG;
        real a[NG];
        for (int i = 0; i < NG; ++i) {
            const real before = q[i - STAGES * NG], after = q[i + STAGES * NG];
            a[i] = (after - 2.0 * q[i] + before) / (h * h);
            most[0] = fmax_1(most[0], fabs_1(a[i]));
            most[2] = fmax_1(most[2], fabs_1(after - before) / (2.0 * h));
        }
        for (int j = 0; j < NM; ++j) {
            real sum = 0.0;
            for (int i = 0; i < NG; ++i) {
                sum += eta[j][i] * a[i];
            }
            most[1] = fmax_1(most[1], fabs_1(sum));
            most[3] = fmax_1(most[3], rotor_inertia[j] * fabs_1(sum));
        }
    }
    for (int i = 0; i < MEASURES; ++i) {
        most[i] = fmax_1(most[i], s[l->most + i] * (real)N / (real)(N + MEMORY_DECAYS));
        s[l->most + i] = most[i];
        worst = fmax_1(worst, off[i] / (sixty * most[i]));
    }
    return worst;
}

#endif
