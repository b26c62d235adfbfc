/* elbow: motion and torques of the interval that begins now, and their kinematic mismatch; private to the stream. */
#ifndef ELBOW_STREAM_OUTPUT_H
#define ELBOW_STREAM_OUTPUT_H

#include "elbow_stream_memory.h"
#include "elbow_motors.h"
#include "elbow_interpolation.h"
#include "elbow_path_deviation.h"

enum { MEMORY_DECAYS = 4 }; /* time constants of the memory of the largest values, per horizon */

/* of a motor torque from one interval to the next, relative to its largest value */
static const real torque_step_max = PRECISE(2e-4, 5e-3);

/* m or rad: joints that move less within an interval are at rest; a smaller step of the output is none */
static const real negligible_motion = PRECISE(3e-8, 1e-5), negligible_step = PRECISE(1e-8, 1e-6);

/* Results of an update, sample after sample. */
typedef struct {
    real *q_a, *v_a, *tau_g, *q_m, *v_m, *tau_m;
} interval_results;

/* Motion and gear torques of the arm in the window around the interval; worst: the largest residual in the interval. */
static inline int arm_in_window(real *s, const layout *l, const interval_results *out, real *worst)
{
    const int samples_per_interval = (int)s[SAMPLES_PER_INTERVAL], intervals = (int)s[INTERVALS],
              end = (int)l->past + intervals;
    real *joints_now = s + l->q_g + (ptrdiff_t)intervals * STAGES * NG;
    const real fine = s[PERIOD] / (real)samples_per_interval;
    joint_motion last;
    real time[POINTS];
    problem_points *arm = arm_of(l, s);
#if ELBOW_NE > 0
    mesh m = mesh_of(l, s);
    interpolant f;
    m.y = s + l->y; /* with the past */
    m.a = s + l->a;
    m.N += (int)l->past;
    prepare(&f);
    nodal_accelerations(&m, s + l->a_node);
#endif
    *worst = 0.0;
    /* All samples from the present plan, the past too: derivatives must not contain steps between plans. */
    joints_at_rest(joints_now, &last);
    begin_points(arm);
    for (int at = 0; at < l->window; at += POINTS) {
        const int used = (int)(l->window - at < POINTS ? l->window - at : (ptrdiff_t)POINTS);
        int status;
        for (int point = 0; point < POINTS; ++point) {
            const int k = at + (point < used ? point : used - 1) - BACK + (int)l->past * samples_per_interval;
            const int node = k / samples_per_interval < end ? k / samples_per_interval : end - 1;
            const real x = k / samples_per_interval < end ?
                               (real)(k - node * samples_per_interval) / (real)samples_per_interval :
                               1.0;
            real reference[REFERENCE];
            between_samples(s + l->nodes + node * (ptrdiff_t)REFERENCE, s[PERIOD], x, reference);
            load_reference(arm, point, reference);
            time[point] = (real)(at + (point < used ? point : used - 1)) * fine;
#if ELBOW_NE > 0
            {
                real weight[3 * TERMS];
                weights_at(&f, m.h, x, weight);
                load_between(&m, s + l->a_node, weight, node, arm, point);
            }
#endif
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
            if (!(arm->side[point] * s[SIDE] > 0.0)) {
                return ELBOW_UNREACHABLE; /* deflections brought it to the other side of a singular pose */
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
#if ELBOW_NE > 0
            for (int i = 0; i < NE; ++i) {
                *worst = fmax_1(*worst, fabs_1(arm->row[i][point]) / m.scale[i]);
            }
#endif
        }
        if (used > 1) {
            keep_joints(arm, used - 1, (real)(at + used - 1) * fine, (real)(used - 1) * fine, &last);
        }
    }
    return ELBOW_OK;
}

/*
 * Step of the output [m], [rad]: the static deflections of the gears step from those that the plan before predicted,
 * and the joints follow, since the motors cannot step.
 */
static inline void output_step_of(real *s, const layout *l, const real *deflection, real size[2])
{
    const problem_points *arm = arm_of(l, s);
    const real *expected = s + l->expected + 1 + NM;
    real step[NY] = {0.0};
    for (int i = 0; i < NG && s[l->expected] > 0.0; ++i) {
        for (int k = 0; k < NY; ++k) {
            step[k] += arm->W[i_g[i]][k][0] * (deflection[i] - expected[i]);
        }
    }
    size_of_deviation(step, size);
}

/*
 * The largest step of a motor torque from the value that the plan before predicted, relative to the largest of that
 * motor within about a horizon, or to a hundredth of that of all motors. A step is no motion, although each plan is
 * smooth.
 */
static inline real torque_step_of(real *s, const layout *l, const real *tau_m)
{
    const real N = s[INTERVALS], kept = N / (N + MEMORY_DECAYS);
    const real *expected = s + l->expected + 1;
    real *most = s + l->most + MEASURES, all = 1e-12, worst = 0.0;
    for (int i = 0; i < NM; ++i) {
        most[i] = fmax_1(fabs_1(tau_m[i]), kept * most[i]);
        all = fmax_1(all, most[i]);
    }
    for (int i = 0; i < NM && s[l->expected] > 0.0; ++i) {
        worst = fmax_1(worst, fabs_1(tau_m[i] - expected[i]) / fmax_1(most[i], 0.01 * all));
    }
    return worst;
}

/* The torques to send in the interval from those of the motors, of which the last are kept for the next update. */
static inline void hold_interval(real *s, const layout *l, real *tau_m)
{
    const ptrdiff_t samples_per_interval = (ptrdiff_t)s[SAMPLES_PER_INTERVAL];
    const real *sample = s + l->torque + (int)s[DELAY] * NM;
    real weight[HOLD_TAPS];
    hold_weights(s[HOLD], s[DELAY], s[l->limits] > 0.0, weight);
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
 * Motors in the interval; the deflections of the gears are carried on from update to update. step, output_step: of the
 * motor torques and of the output at its start; steps at rest are not counted.
 */
static inline int motors_in_interval(
    real *s, const layout *l, const interval_results *out, real *step, real output_step[2])
{
    const ptrdiff_t samples_per_interval = (ptrdiff_t)s[SAMPLES_PER_INTERVAL];
    const int is_first = !(s[l->expected] > 0.0);
    real *space = s + l->space, *torque = s + l->torque, last_stiffness[NG];
    gears g;
    if (!begin_gears(&g, s[PERIOD] / (real)samples_per_interval, s + l->now, space) ||
        !static_deflections(s + l->tau, l->window, s + l->now, s + l->deflection, last_stiffness, space)) {
        return ELBOW_RESULT_NOT_FINITE;
    }
    for (ptrdiff_t k = MARGIN; k + MARGIN < l->window; ++k) {
        real value[NG], stiffness[NG];
        if (k >= BACK && k <= BACK + samples_per_interval + l->ahead &&
            !advance_gears(&g, k == BACK, s + l->tau + k * NG, 1, NG, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        if (g.slow && k == BACK + samples_per_interval) {
            copy(g.now, NG, s + l->now);
        }
        if (evaluate_gear_law(s + l->deflection + k * NG, value, stiffness, space) != ELBOW_OK) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        lagged_deflections(&g, s + l->deflection + k * NG, stiffness, s + l->lagged + k * NG, space);
    }
#if ELBOW_PARAMETERS > 0
    for (int i = 0; i < NG;
        ++i) { /* after a change of its damping the deflection of a gear may have to be integrated */
        if (g.quick[i]) {
            s[l->now + i] = s[l->lagged + (BACK + samples_per_interval) * NG + i];
        }
    }
#endif
    for (ptrdiff_t k = 0; k <= samples_per_interval + l->ahead; ++k) {
        const real *tau = s + l->tau + (k + BACK) * NG, *deflection = s + l->lagged + (k + BACK) * NG;
        const real *joint = s + l->joint + (k + BACK) * JOINT;
        real q[NG], v[NG], a[NG], q_m[NM], v_m[NM], tau_m[NM];
        copy(joint, NG, q);
        copy(joint + NG, NG, v);
        copy(joint + 2 * NG, NG, a);
        if (!motors_at_sample(&g, tau, deflection, q, v, a, q_m, v_m, tau_m, space)) {
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
            s[l->expected] = 1.0;
            copy(tau_m, NM, s + l->expected + 1);
            copy(s + l->deflection + (k + BACK) * NG, NG, s + l->expected + 1 + NM);
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
 * Kinematic mismatch of joints and motors in this interval, and at the samples after it that held torques depend on, by
 * finite differences, as for a whole path. It is relative to the largest values within about a horizon: past values,
 * which are forgotten gradually, present ones, and the planned ones of the joints. Deflections without damping: damping
 * makes them smoother. Differences and torques that need more than the horizon are wrong, and appear here.
 */
static inline real kinematic_mismatch_now(real *s, const layout *l)
{
    const ptrdiff_t samples_per_interval = (ptrdiff_t)s[SAMPLES_PER_INTERVAL], N = (ptrdiff_t)s[INTERVALS];
    const real h = s[PERIOD], fine = h / (real)samples_per_interval, sixty = 60.0 * fine;
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
