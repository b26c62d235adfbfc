/*
 * model: the parts that invert and bvp share: arguments, workspace, first guess, Newton's stop,
 * results; private.
 */
#ifndef MODEL_WHOLE_PATH_H
#define MODEL_WHOLE_PATH_H

#include "model_inversion.h"

#if MODEL_HYSTERESIS
#include "model_hysteresis.h"
#endif /* MODEL_HYSTERESIS */
#include "model_mesh.h"
#include "model_motors.h"
#include "model_reduced_problem.h"
#if MODEL_POSITION
#include "model_servo.h"
#endif /* MODEL_POSITION */
#if MODEL_LUGRE
#include "model_lugre.h"
#endif /* MODEL_LUGRE */

/*
 * --- Gears and motors at all samples of a path, POINTS samples at a time.
 *
 * Torques and deflections of a gear are a row: entry k belongs to sample k, entries before the
 * first sample and after the last one repeat these.
 */

/*
 * Samples after the last one that are computed too, for the derivatives there: of the torques for
 * the lag of the gears, and of the deflections for the motors.
 */
enum { BEYOND = 2 * MARGIN, BEFORE = BLOCK, TAPS = 2 * MARGIN + 2 };

/* Rows of all gears; the arrays begin at sample 0 of the first gear. */
typedef struct {
    ptrdiff_t apart; /* numbers from the row of a gear to that of the next */
    real *tau, *deflection, *stiffness, *lagged;
#if MODEL_COUPLED
    real *still; /* torques where no rotor moves */
#endif           /* MODEL_COUPLED */
} gear_rows;

/* Length of a row. */
static inline int64_t row_length(int64_t samples)
{
    return BEFORE + padded(samples + BEYOND + POINTS);
}

/*
 * Repeat the first of `count` entries before it, and the last as far as is read; the motion begins
 * at equilibrium.
 */
static inline void hold_ends(const gear_rows *g, real *x, ptrdiff_t count)
{
    const ptrdiff_t row_end = g->apart - BEFORE, read = count + BEYOND + POINTS;
    for (int i = 0; i < NG; ++i) {
        real *row = x + i * g->apart;
        for (ptrdiff_t k = 1; k <= MARGIN; ++k) {
            row[-k] = row[0];
        }
        for (ptrdiff_t k = count; k < read && k < row_end; ++k) {
            row[k] = row[count - 1];
        }
    }
}

/* Static deflections of samples `at` to at + POINTS - 1, from that of the sample before. */
static inline int static_deflections_at(const gear_rows *g, ptrdiff_t at, real *space)
{
    real torque[NG][POINTS], x[NG][POINTS], value[NG][POINTS], stiffness[NG][POINTS];
    for (int i = 0; i < NG; ++i) {
        const real *tau = g->tau + i * g->apart + at;
        const ptrdiff_t before = i * g->apart + at - 1;
        const real from = at > 0 ? g->tau[before] : 0.0,
                   slope = at > 0 ? g->stiffness[before] : 1.0;
        EACH (l) {
            const lanes now = load_v(tau + l);
            lanes guess = splat_v(0.0);
            if (at > 0 && !gear_is_rigid[i]) {
                guess = (now - from) / slope + g->deflection[before];
            }
            store_v(&torque[i][l], now);
            store_v(&x[i][l], guess);
        }
    }
    for (int step = 0; step < QUICK_STEPS; ++step) {
        lanes missed = splat_v(0.0);
        if (evaluate_gear_law_batch(POINTS, &x[0][0], &value[0][0], &stiffness[0][0], space) !=
            MODEL_OK) {
            break;
        }
        for (int i = 0; i < NG; ++i) {
            EACH (l) {
                if (!gear_is_rigid[i]) {
                    const lanes change = (load_v(&value[i][l]) - load_v(&torque[i][l])) /
                                         load_v(&stiffness[i][l]);
                    const lanes next = load_v(&x[i][l]) - change;
                    store_v(&x[i][l], next);
                    missed += 0.0 * next; /* NaN where it is not finite */
                    if (!gear_is_linear[i]) {
                        missed += not_v(le_v(fabs_v(change), PRECISE(1e-15, 3e-7) * fabs_v(next)));
                    }
                }
            }
        }
        if (sum_v(missed) == 0.0) {
            for (int i = 0; i < NG; ++i) {
                copy(x[i], POINTS, g->deflection + i * g->apart + at);
                copy(stiffness[i], POINTS, g->stiffness + i * g->apart + at);
            }
            return 1;
        }
    }
    /* one by one, within a bracket where that is needed */
    for (ptrdiff_t k = at; k < at + POINTS; ++k) {
        real wanted[NG], found[NG], slope[NG];
        for (int i = 0; i < NG; ++i) {
            wanted[i] = g->tau[i * g->apart + k];
            found[i] = k > 0 ? g->deflection[i * g->apart + k - 1] : 0.0;
        }
        if (!static_deflection(wanted, found, slope, space)) {
            return 0;
        }
        for (int i = 0; i < NG; ++i) {
            g->deflection[i * g->apart + k] = found[i];
            g->stiffness[i * g->apart + k] = slope[i];
        }
    }
    return 1;
}

/*
 * Deflections of a gear with a linear spring whose lag is integrated. The step of `linear_steps`,
 * its torque a quintic through derivatives by differences, is p(k + 1) = p(k) + sum_j taps[j]
 * tau(k - MARGIN + j) - gain p(k).
 */
static inline void integrate_linear(
    const gear_rows *g, int gear, const real *step, ptrdiff_t count)
{
    const ptrdiff_t row = gear * g->apart;
    const real gain = (step[1] + step[2] + step[3]) * g->stiffness[row];
    real taps[TAPS], p = g->deflection[row];
    for (int j = 0; j < TAPS; ++j) {
        real x[TAPS] = {0.0}, sides[2][3];
        x[j] = 1.0;
        taps[j] = 0.0;
        for (int side = 0; side < 2; ++side) {
            sides[side][0] = x[MARGIN + side];
            sides[side][1] = derivative_of(x + MARGIN + side, 1, 1.0);
            sides[side][2] = second_derivative_of(x + MARGIN + side, 1, 1.0);
        }
        for (int s = 0; s < 3; ++s) {
            real out[3];
            quintic(radau_c[s], sides[0], sides[1], out);
            taps[j] += step[1 + s] * out[0];
        }
    }
    for (ptrdiff_t at = 0; at < count; at += POINTS) {
        const real *tau = g->tau + row + at - MARGIN;
        real forced[POINTS];
        EACH (l) {
            lanes sum = splat_v(0.0);
            for (int j = 0; j < TAPS; ++j) {
                sum += taps[j] * load_v(tau + l + j);
            }
            store_v(forced + l, sum);
        }
        for (int l = 0; l < POINTS; ++l) {
            g->lagged[row + at + l] = p;
            p += forced[l] - gain * p;
        }
    }
}

/* Deflections with their lag, of the first `count` samples. */
static inline int lagged_rows(const gear_rows *g, gears *state, ptrdiff_t count, real *space)
{
    int one_by_one = 0;
    for (int i = 0; i < NG; ++i) {
        const ptrdiff_t row = i * g->apart;
        if (!state->quick[i] && gear_is_linear[i]) {
            integrate_linear(g, i, state->linear[i], count);
        } else if (!state->quick[i]) {
            one_by_one = 1;
        } else {
            for (ptrdiff_t at = 0; at < count; at += LANES) {
                const real *x = g->deflection + row + at;
                lanes now = load_v(x);
                if (!gear_is_rigid[i]) {
                    now -= damping_of(i, space) / load_v(g->stiffness + row + at) *
                           derivative_v(x, state->period);
                }
                store_v(g->lagged + row + at, now);
            }
        }
    }
    for (ptrdiff_t k = 0; k < count && one_by_one; ++k) {
        if (!advance_gears(state, k == 0, g->tau + k, g->apart, 1, space)) {
            return 0;
        }
        for (int i = 0; i < NG; ++i) {
            if (!state->quick[i] && !gear_is_linear[i]) {
                g->lagged[i * g->apart + k] = state->now[i];
            }
        }
    }
    return 1;
}

/*
 * Motors at POINTS samples: motion of the joints in; that of the motors and their torques out, and
 * whether all is finite.
 */
typedef struct {
    points q[NG], v[NG], a[NG];
    points q_m[NM], v_m[NM], a_m[NM], tau_m[NM];
} motor_points;

#if MODEL_HYSTERESIS
/*
 * Deflections of the first `count` samples, of gears at rest with the deflections `first`; 0 where
 * there are none.
 */
static inline int hysteretic_rows(
    const gear_rows *g, real period, const real *first, ptrdiff_t count, real *space)
{
    branches b;
    quintics q = {{{0.0}}};
    points once[NG], twice[NG];
    real right[NG][3] = {{0.0}};
    if (!begin_branches(&b, period, first, space)) {
        return 0;
    }
    for (ptrdiff_t at = 0; at < count; at += POINTS) {
        for (int i = 0; i < NG; ++i) {
            const real *tau = g->tau + i * g->apart + at;
            EACH (l) {
                store_v(&once[i][l], period * derivative_v(tau + l, period));
                store_v(&twice[i][l], period * period * second_derivative_v(tau + l, period));
            }
        }
        for (int l = 0; l < POINTS && at + l < count; ++l) {
            for (int i = 0; i < NG; ++i) {
                const real now[3] = {g->tau[i * g->apart + at + l], once[i][l], twice[i][l]};
                set_quintic(&q, i, right[i], now);
                copy(now, 3, right[i]);
            }
            if (at + l > 0 && !advance_branches(&b, &q, space)) {
                return 0;
            }
            for (int i = 0; i < NG; ++i) {
                g->lagged[i * g->apart + at + l] = b.p[i];
            }
        }
    }
    return 1;
}
#endif /* MODEL_HYSTERESIS */
/* Add the motion of the deflections of samples `at` and following ones to that of the joints. */
static inline int add_deflections(
    const gear_rows *g, const gears *state, ptrdiff_t at, motor_points *p, real *space)
{
#if MODEL_HYSTERESIS
    points value[NG] = {{0.0}}, stiffness[NG] = {{0.0}}; /* not used: all rates are differences */
#else                                                    /* MODEL_HYSTERESIS */
    points x[NG], value[NG], stiffness[NG];
    for (int i = 0; i < NG && state->slow; ++i) {
        copy(g->lagged + i * g->apart + at, POINTS, x[i]);
    }
    if (state->slow && evaluate_gear_law_batch(
                           POINTS, &x[0][0], &value[0][0], &stiffness[0][0], space) != MODEL_OK) {
        return 0;
    }
#endif                                                   /* MODEL_HYSTERESIS */
    for (int i = 0; i < NG; ++i) {
        EACH (l) {
            const real *deflection = g->lagged + i * g->apart + at + l,
                       *tau = g->tau + i * g->apart + at + l;
            lanes once, twice;
            if (state->quick[i]) {
                once = derivative_v(deflection, state->period);
                twice = second_derivative_v(deflection, state->period);
            } else {
                const lanes now = load_v(tau), left = now - load_v(&value[i][l]);
                /* not rounding */
                const lanes moves = lt_v(PRECISE(0.0, 2e-7) * fabs_v(now), fabs_v(left));
                once = select_v(moves, left, splat_v(0.0)) / damping_of(i, space);
                twice = (derivative_v(tau, state->period) - load_v(&stiffness[i][l]) * once) /
                        damping_of(i, space);
            }
            store_v(&p->q[i][l], load_v(&p->q[i][l]) + load_v(deflection));
            store_v(&p->v[i][l], load_v(&p->v[i][l]) + once);
            store_v(&p->a[i][l], load_v(&p->a[i][l]) + twice);
        }
    }
    return 1;
}

/* Motor angles, speeds and torques as `motors_of` finds them. */
static inline int motors_of_points(const gear_rows *g, ptrdiff_t at, motor_points *p, real *space)
{
    points friction[NM];
#if MODEL_HARMONICS
    points w[3][NM], share[NM], cogging[NM], gain[NM];
#endif /* MODEL_HARMONICS */
    lanes zero = splat_v(0.0);
    for (int j = 0; j < NM; ++j) {
        EACH (l) {
            lanes q = splat_v(0.0), v = splat_v(0.0), a = splat_v(0.0);
            for (int i = 0; i < NG; ++i) {
                q += eta[j][i] * load_v(&p->q[i][l]);
                v += eta[j][i] * load_v(&p->v[i][l]);
                a += eta[j][i] * load_v(&p->a[i][l]);
            }
            store_v(&p->q_m[j][l], q);
            store_v(&p->v_m[j][l], v);
            store_v(&p->a_m[j][l], a);
            zero += 0.0 * q;
        }
    }
#if MODEL_HARMONICS
    copy(&p->q_m[0][0], (ptrdiff_t)NM * POINTS, &w[0][0][0]);
    copy(&p->v_m[0][0], (ptrdiff_t)NM * POINTS, &w[1][0][0]);
    copy(&p->a_m[0][0], (ptrdiff_t)NM * POINTS, &w[2][0][0]);
    if (evaluate_motor_harmonics_batch(POINTS, &w[0][0][0], &w[1][0][0], &w[2][0][0],
            &p->q_m[0][0], &p->v_m[0][0], &p->a_m[0][0], &share[0][0], &cogging[0][0], &gain[0][0],
            space) != MODEL_OK) {
        return 0;
    }
#endif /* MODEL_HARMONICS */
#if MODEL_LOAD
    points load[NM];
    for (int j = 0; j < NM; ++j) {
        EACH (l) {
            lanes carried = splat_v(0.0);
            for (int i = 0; i < NG; ++i) {
                carried += eta_inverse[i][j] * load_v(g->tau + i * g->apart + at + l);
            }
#if MODEL_HARMONICS
            carried *= load_v(&share[j][l]);
#endif /* MODEL_HARMONICS */
            store_v(&load[j][l], carried);
        }
    }
    if (evaluate_loaded_friction_batch(
            POINTS, &p->v_m[0][0], &load[0][0], &friction[0][0], space) != MODEL_OK) {
        return 0;
    }
#else  /* MODEL_LOAD */
    if (evaluate_motor_friction_batch(POINTS, &p->v_m[0][0], &friction[0][0], space) != MODEL_OK) {
        return 0;
    }
#endif /* MODEL_LOAD */
    for (int j = 0; j < NM; ++j) {
        EACH (l) {
            lanes torque = load_v(&friction[j][l]) + rotor_inertia[j] * load_v(&p->a_m[j][l]);
#if MODEL_HARMONICS
            torque -= load_v(&cogging[j][l]);
            for (int i = 0; i < NG; ++i) {
                torque += load_v(&share[j][l]) * eta_inverse[i][j] *
                          load_v(g->tau + i * g->apart + at + l);
            }
            torque /= load_v(&gain[j][l]);
#else  /* MODEL_HARMONICS */
            for (int i = 0; i < NG; ++i) {
                torque += eta_inverse[i][j] * load_v(g->tau + i * g->apart + at + l);
            }
#endif /* MODEL_HARMONICS */
            store_v(&p->tau_m[j][l], torque);
            zero += 0.0 * torque;
        }
    }
    return sum_v(zero) == 0.0;
}

/* --- Arguments, workspace, first guess, stopping rule and results. */

enum { MAX_SAMPLES = 1000000 };

static inline int path_sizes_fit(int n, const model_inversion_options *o)
{
    return n >= 2 && o->n_pre >= 0 && o->n_post >= 0 && o->samples_per_interval >= 1 &&
           n <= MAX_SAMPLES && o->n_pre <= MAX_SAMPLES && o->n_post <= MAX_SAMPLES &&
           o->samples_per_interval <= MAX_SAMPLES && o->growth >= 0 && o->growth <= MODEL_GROWS;
}

/* Whether so many numbers can be addressed: on small processors not all sizes can. */
static inline int is_addressable(int64_t numbers)
{
    return numbers <= (int64_t)(PTRDIFF_MAX / (ptrdiff_t)sizeof(real));
}

/* largest rate of an output at rest, relative to the largest rate of the path */
static const real rest_rate_max = 1e-6;

/*
 * Whether a path, the run-time parameters and the guess of the start are finite, all rotations are
 * rotations and close to each other, and the output is at rest at both ends.
 */
static inline model_status check_path(
    const model_samples *p, const real *parameters, const real *q_start)
{
    for (int k = 0; k < p->n; ++k) {
        if (!is_finite(p->y + k * (ptrdiff_t)NT, NT) ||
            !is_finite(p->dy + k * (ptrdiff_t)NY, NY) ||
            !is_finite(p->ddy + k * (ptrdiff_t)NY, NY)) {
            return MODEL_INPUT_NOT_FINITE;
        }
    }
#if MODEL_FORCE
    for (int k = 0; k < p->n && p->force != NULL; ++k) {
        if (!is_finite(p->force + k * (ptrdiff_t)FORCES, FORCES)) {
            return MODEL_INPUT_NOT_FINITE;
        }
    }
#endif /* MODEL_FORCE */
    if (!is_finite(parameters, PARAMETERS) || !is_finite(q_start, NA)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    {
        real most = 0.0;
        for (int k = 0; k < p->n; ++k) {
            most = fmax_1(most, largest(p->dy + k * (ptrdiff_t)NY, NY));
        }
        if (!(largest(p->dy, NY) <= rest_rate_max * most) ||
            !(largest(p->dy + (p->n - 1) * (ptrdiff_t)NY, NY) <= rest_rate_max * most)) {
            return MODEL_BAD_ARGUMENT;
        }
    }
#if MODEL_POSE
    for (int k = 0; k < p->n; ++k) {
        const real *R = p->y + k * (ptrdiff_t)NT + PLACES;
        if (!is_rotation(R) || (k > 0 && !are_near(R - NT, R))) {
            return MODEL_BAD_ARGUMENT;
        }
    }
#endif
    return MODEL_OK;
}

#if MODEL_NE > 0

/* The time of Gauss point k from the first node on. */
static inline real time_of_point(const mesh *m, int k)
{
    return m->h * ((real)(k / STAGES) + gauss_c[k % STAGES]);
}

#if MODEL_FORCE
/*
 * Residuals of the `used` Gauss points from number `at` on by the force: by what is not held in
 * equilibrium at the ends of the path, between which the first guess of the motion moves as in
 * `move_smoothly`.
 */
static inline void residuals_of_force(
    const mesh *m, const model_samples *p, int at, int used, const problem_points *arm, real *row)
{
    const real *first = p->force, *last = p->force + (p->n - 1) * (ptrdiff_t)FORCES;
    points moved, sums[NE];
    for (int l = 0; l < POINTS; ++l) {
        const real x = fmin_1(time_of_point(m, at + l) / (m->h * (real)m->varying), 1.0);
        moved[l] = x * x * x * (10.0 - x * (15.0 - 6.0 * x));
    }
    EACH (l) {
        lanes F[NY];
        for (int j = 0; j < NY; ++j) {
            F[j] = load_v(&arm->force[j][l]) - first[j] - (last[j] - first[j]) * load_v(moved + l);
        }
        for (int i = 0; i < NE; ++i) {
            lanes sum = splat_v(0.0);
            for (int j = 0; j < NY; ++j) {
                sum -= load_v(&arm->W[i_e[i]][j][l]) * F[j];
            }
            store_v(&sums[i][l], sum / m->scale[i]);
        }
    }
    for (ptrdiff_t k = 0; k < used; ++k) {
        for (int i = 0; i < NE; ++i) {
            row[(at + k) * NE + i] = sums[i][k];
        }
    }
}

#endif /* MODEL_FORCE */
/*
 * The path at the Gauss points, and joints that follow it with the deflections of the equilibrium
 * q.
 */
#if MODEL_FORCE
/* row: residuals of the points by the force; not written if null. */
#endif /* MODEL_FORCE */
static inline int guess_mesh(mesh *m, const model_samples *p, const real *q, int n_pre,
    int samples_per_interval,
#if MODEL_FORCE
    problem_points *arm, real *row, real *space)
#else  /* MODEL_FORCE */
    problem_points *arm, real *space)
#endif /* MODEL_FORCE */
{
    /* The path of the last one is that of all others; so are the joints. */
    const int solved = m->varying < m->N ? m->varying * STAGES + 1 : m->N * STAGES;
    joint_motion last;
    real joints[NG], time[POINTS];
    for (ptrdiff_t k = 0; k <= m->N; ++k) {
        for (int i = 0; i < NE; ++i) {
            m->y[k * STATES + i] = q[i_e[i]];
            m->y[k * STATES + NE + i] = 0.0;
        }
    }
    set_zero(m->a, (ptrdiff_t)m->N * CONTROLS);
    for (int i = 0; i < NG; ++i) {
        joints[i] = q[i_g[i]];
    }
    joints_at_rest(joints, &last);
    begin_points(arm);
    for (int at = 0; at < solved; at += POINTS) {
        const int used = solved - at < POINTS ? solved - at : (int)POINTS;
        int status;
        for (int k = at; k < at + used; ++k) {
            const real x = ((real)(k / STAGES) + gauss_c[k % STAGES]) *
                               (real)samples_per_interval -
                           (real)n_pre;
            const int whole = (int)(x < 0.0 ? x - 1.0 : x);
            reference_at(p, whole, x - (real)whole, m->reference + (ptrdiff_t)k * REFERENCE);
            for (int i = 0; i < NG; ++i) {
                m->q_g[(ptrdiff_t)k * NG + i] = joints[i];
            }
        }
        for (int point = 0; point < POINTS; ++point) {
            const int k = at + (point < used ? point : used - 1);
            load_point(m, k, arm, point);
            time[point] = time_of_point(m, k);
        }
        status = follow_kinematics(arm, &last, time, space);
        if (status != MODEL_OK) {
            return status;
        }
        for (int k = 0; k < used; ++k) {
            for (int i = 0; i < NG; ++i) {
                m->q_g[(ptrdiff_t)(at + k) * NG + i] = arm->q[i_g[i]][k];
            }
        }
#if MODEL_FORCE
        if (row != NULL) {
            residuals_of_force(m, p, at, used, arm, row);
        }
#endif /* MODEL_FORCE */
        if (used > 1) {
            const real now = time_of_point(m, at + used - 1);
            keep_joints(arm, used - 1, now, now - time_of_point(m, at), &last);
        }
    }
    for (ptrdiff_t k = solved; k < (ptrdiff_t)m->N * STAGES; ++k) {
        copy(m->reference + (k - 1) * REFERENCE, REFERENCE, m->reference + k * REFERENCE);
        copy(m->q_g + (k - 1) * NG, NG, m->q_g + k * NG);
    }
    return MODEL_OK;
}

#endif

/* Where the arrays of both solvers are in the workspace, in reals from its start. */
typedef struct {
    int64_t samples, intervals, varying; /* varying: as in mesh */
#if MODEL_COUPLED
    int64_t still;
#endif /* MODEL_COUPLED */
    int64_t tau, deflection, stiffness, lagged, q_a, v_a, a_a, v_m, y, a, a_node, q_g, reference,
        factor, scale, weights, joint_weights, space;
    int64_t end; /* where the arrays of one solver begin */
} whole_layout;

static const real shortest_end = 0.05; /* s: motion after the path, at least */

/* No motion ends before this time after the path: deflections of damped gears decay in it [s]. */
static inline real shortest_motion_after(real *space)
{
    return fmax_1(shortest_end, gear_settling(space));
}

#define TAKE(at, name, size) \
    (name) = (at); \
    (at) += padded(size)

/* interval_factor: numbers of a factor; steady: the intervals after the path may share one. */
static inline whole_layout lay_out(
    int n, const model_inversion_options *o, int64_t interval_factor, int steady)
{
    whole_layout l;
    int64_t at = 0;
    l.samples = (int64_t)o->n_pre + n + o->n_post;
    l.intervals = (l.samples - 1 + BEYOND + o->samples_per_interval - 1) / o->samples_per_interval;
    l.varying = steady ? ((int64_t)o->n_pre + n - 1 + o->samples_per_interval - 1) /
                             o->samples_per_interval :
                         l.intervals;
    l.varying = l.varying < l.intervals ? l.varying : l.intervals;
    TAKE(at, l.tau, row_length(l.samples) * NG);
    TAKE(at, l.deflection, row_length(l.samples) * NG);
    TAKE(at, l.stiffness, row_length(l.samples) * NG);
    TAKE(at, l.lagged, row_length(l.samples) * NG);
#if MODEL_COUPLED
    TAKE(at, l.still, row_length(l.samples) * NG);
#endif /* MODEL_COUPLED */
    TAKE(at, l.q_a, l.samples * NA);
    TAKE(at, l.v_a, l.samples * NA);
    TAKE(at, l.a_a, l.samples * NA);
    TAKE(at, l.v_m, l.samples * NM);
#if MODEL_NE > 0
    TAKE(at, l.y, (l.intervals + 1) * STATES);
    TAKE(at, l.a, l.intervals * CONTROLS);
    TAKE(at, l.a_node, (l.intervals + 1) * NE);
    TAKE(at, l.q_g, l.intervals * STAGES * NG);
    TAKE(at, l.reference, l.intervals * STAGES * REFERENCE);
    TAKE(at, l.factor, l.intervals * interval_factor);
    TAKE(at, l.scale, NE);
    TAKE(at, l.weights, ((int64_t)o->samples_per_interval + 1) * 3 * TERMS);
    TAKE(at, l.joint_weights,
        l.intervals > 1 ? (2 * (int64_t)o->samples_per_interval + 1) * 3 * JOINTS : 0);
#else
    (void)interval_factor;
    l.y = l.a = l.a_node = l.q_g = l.reference = l.factor = l.scale = l.weights = l.joint_weights =
        0;
#endif
    TAKE(at, l.space, function_work());
    l.end = at;
    return l;
}

/* What a solver finds on the way; the public functions give their part of it to the caller. */
typedef struct {
    int is_set; /* the arguments are of the right sizes */
    real residual, residual_at_samples, kinematic_mismatch, torque_error;
    int iterations, intervals, n_post;
} whole_report;

/*
 * Check the arguments of a solver that needs `wanted` reals of workspace, and set the report to
 * NaN.
 */
static inline model_status check_arguments(const model_samples *p, const real *parameters,
    const real *q_start, const model_inversion_options *o, const model_motion *motion,
    whole_report *report, const real *work, int64_t work_size, int64_t wanted)
{
    if (p == NULL || parameters == NULL || q_start == NULL || o == NULL || motion == NULL ||
        work == NULL || p->y == NULL || p->dy == NULL || p->ddy == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (wanted < 0 || !(p->period > 0.0 && p->period < 1e6) ||
        !(o->tolerance > 0.0 && o->tolerance < 1.0) || !hold_fits((int)o->hold, o->delay) ||
        !(o->settled >= 0.0 && o->settled < 1.0)) {
        return MODEL_BAD_ARGUMENT;
    }
#if MODEL_POSITION
    if (o->servo != NULL && (motion->command_m != NULL || motion->command_g != NULL)) {
        if (motion->q_m == NULL || motion->tau_m == NULL || !has_gains(o->servo)) {
            return MODEL_NULL_ARGUMENT;
        }
        if (!servo_fits(o->servo, p->period, (int)o->hold, o->delay)) {
            return MODEL_BAD_ARGUMENT;
        }
    }
#endif /* MODEL_POSITION */
    if (work_size < wanted) {
        return MODEL_WORK_TOO_SMALL;
    }
    report->is_set = 1;
    report->residual = report->residual_at_samples = report->kinematic_mismatch =
        report->torque_error = (real)NAN;
    report->iterations = report->intervals = 0;
    report->n_post = o->n_post;
    return check_path(p, parameters, q_start);
}

#if MODEL_NE > 0

/* The mesh in the workspace. */
static inline mesh mesh_in(
    const whole_layout *l, const model_samples *p, const model_inversion_options *o, real *work)
{
    mesh m;
    m.N = (int)l->intervals;
    m.varying = m.factored = (int)l->varying;
    m.h = (real)o->samples_per_interval * p->period;
    m.y = work + l->y;
    m.a = work + l->a;
    m.q_g = work + l->q_g;
    m.reference = work + l->reference;
    m.target_state = NULL;
    m.equilibrium = NULL;
    m.factor = work + l->factor;
    m.base = 0;
    m.scale = work + l->scale;
    m.end = NULL;
    m.residual = (real)NAN;
    return m;
}

enum { NEWTON_CONTINUES, NEWTON_CONVERGED, NEWTON_FAILED, NEWTON_STEPS = 25 };

/* Progress of a Newton iteration. */
typedef struct {
    real before; /* residual of the iteration before; negative where there is none */
    int steps, worse;
} newton;

/*
 * Whether to stop after an iteration that leaves `residual`: converged below the share `target` of
 * the tolerance, or below it where an iteration gains less than a factor of ten; failed after
 * NEWTON_STEPS, or four iterations in a row that gain less than a factor of two.
 */
static inline int newton_state(newton *s, real residual, real tolerance, real target)
{
    ++s->steps;
    if (residual <= target * tolerance ||
        (residual <= tolerance && s->before >= 0.0 && residual > 0.1 * s->before)) {
        return NEWTON_CONVERGED;
    }
    s->worse = s->before >= 0.0 && residual > 0.5 * s->before ? s->worse + 1 : 0;
    if (s->steps == NEWTON_STEPS || s->worse == 4 || !(residual < 1e12)) {
        return residual <= tolerance ? NEWTON_CONVERGED : NEWTON_FAILED;
    }
    s->before = residual;
    return NEWTON_CONTINUES;
}

#endif

/*
 * largest residual at the samples of a status OK, in tolerances; the same where the error of a
 * torque is larger
 */
static const real sampled_tolerances = PRECISE(1e2, 1.0), torque_error_max = 5e-3;
#if MODEL_HARMONICS
/* they accelerate rotors within an interval, which the estimate takes for a ripple */
static const real exact_tolerances = PRECISE(1e-2, 1.0);
#else  /* MODEL_HARMONICS */
static const real exact_tolerances = PRECISE(0.0, 1.0);
#endif /* MODEL_HARMONICS */

/* The results at the samples: arrays of the caller or of the workspace, sample after sample. */
typedef struct {
    const model_samples *p;
    const model_inversion_options *o;
    ptrdiff_t samples; /* of the motion: n_pre + n + n_post, or fewer where it has settled */
    real *q_a, *v_a, *a_a, *tau_g, *q_m, *v_m, *tau_m;
    gear_rows gear;
    real *a_m;  /* samples x NM: accelerations of the motors; where the deflections have been */
    real *most; /* NM: the largest torques of the motors */
#if MODEL_LUGRE
    real *held; /* NM: torques of the bristles at the last sample, at rest */
#endif          /* MODEL_LUGRE */
#if MODEL_NE > 0
    const mesh *m;
    const real *a_node; /* accelerations at its nodes */
    /* of the interpolation at the samples of an interval, and of the joints at those of two */
    real *weights, *joint_weights;
#endif
} results;

#if MODEL_NE > 0
/* Weights of the samples of an interval, and of two for the joints. */
static inline void tabulate_weights(const results *r)
{
    const ptrdiff_t each = r->o->samples_per_interval;
    interpolant f;
    prepare(&f);
    for (ptrdiff_t k = 0; k <= each; ++k) {
        weights_at(&f, r->m->h, (real)k / (real)each, r->weights + k * 3 * TERMS);
    }
    for (ptrdiff_t k = -each; k <= each && r->m->N > 1; ++k) {
        joint_weights_at(
            r->m->h, (real)k / (real)each, r->joint_weights + (k + each) * 3 * JOINTS);
    }
}

/*
 * Motion of the mesh at sample k into point l: known for the unactuated coordinates, a guess for
 * the joints.
 */
static inline void load_sample(const results *r, ptrdiff_t k, problem_points *arm, int l)
{
    const ptrdiff_t each = r->o->samples_per_interval, last = r->m->N - 1;
    const ptrdiff_t interval = k / each < last ? k / each : last, inside = k - interval * each;
    load_between(r->m, r->a_node, r->weights + inside * 3 * TERMS, interval, arm, l);
    if (r->m->N > 1) { /* the neighbor that is nearer */
        ptrdiff_t first = 2 * inside < each ? interval - 1 : interval;
        first = first < 0 ? 0 : first < last ? first : last - 1;
        load_joints_between(r->m->q_g + first * STAGES * NG,
            r->joint_weights + (k - first * each) * 3 * JOINTS, arm, l);
    }
}
#endif

/* The first `count` points of n entries, sample after sample; n: a constant. */
MODEL_INLINE void store_samples(points *x, const int n, ptrdiff_t count, real *to)
{
    for (ptrdiff_t k = 0; k < count; ++k) {
        for (int i = 0; i < n; ++i) {
            to[k * n + i] = x[i][k];
        }
    }
}

/*
 * Motion and gear torques of the arm, from the equilibrium q, the torques also beyond the last
 * sample; worst: the largest residual at the samples, relative to `scale`.
 */
static inline int arm_at_samples(const results *r, const real *q, const real *scale,
    problem_points *arm, real *space, real *worst)
{
    const ptrdiff_t all = r->samples + BEYOND;
    joint_motion last;
    real joints[NG], time[POINTS], side = 0.0;
#if MODEL_NE > 0
    tabulate_weights(r);
#else
    (void)scale;
#endif
    *worst = 0.0;
    for (int i = 0; i < NG; ++i) {
        joints[i] = q[i_g[i]];
    }
    joints_at_rest(joints, &last);
    begin_points(arm);
    for (ptrdiff_t at = 0; at < all; at += POINTS) {
        const int used = all - at < POINTS ? (int)(all - at) : (int)POINTS;
        int status = MODEL_UNREACHABLE; /* without a guess from a mesh */
        for (int point = 0; point < POINTS; ++point) {
            const ptrdiff_t k = at + (point < used ? point : used - 1);
            real reference[REFERENCE];
            reference_sample(r->p, k - r->o->n_pre, reference);
            load_reference(arm, point, reference);
            time[point] = (real)k * r->p->period;
#if MODEL_NE > 0
            load_sample(r, k, arm, point);
#endif
        }
#if MODEL_NE > 0
        status = r->m->N > 1 ? improve_kinematics(arm, space) : status;
#endif
        status = status == MODEL_OK ? status : follow_kinematics(arm, &last, time, space);
        status = status == MODEL_OK ? evaluate_rows(arm, space) : status;
        if (status != MODEL_OK) {
            return status;
        }
        for (int i = 0; i < NG; ++i) {
            copy(arm->tau_g[i], POINTS, r->gear.tau + i * r->gear.apart + at);
        }
        for (int k = 0; k < used; ++k) {
            if (!(arm->side[k] * side >= 0.0)) {
                return MODEL_UNREACHABLE; /* it passed a singular pose */
            }
            side = arm->side[k];
        }
        {
            const ptrdiff_t left = r->samples > at ? r->samples - at : 0,
                            inside = left < used ? left : used;
            if (inside == 0) {
                continue;
            }
            store_samples(arm->q, NA, inside, r->q_a + at * NA);
            store_samples(arm->v, NA, inside, r->v_a + at * NA);
            store_samples(arm->a, NA, inside, r->a_a + at * NA);
            if (r->tau_g != NULL) {
                store_samples(arm->tau_g, NG, inside, r->tau_g + at * NG);
            }
        }
#if MODEL_NE > 0
        {
            lanes most = splat_v(*worst);
            for (int i = 0; i < NE; ++i) {
                for (ptrdiff_t l = r->samples - at; l < POINTS; ++l) { /* beyond the last sample */
                    arm->row[i][l] = 0.0;
                }
                EACH (l) {
                    most = fmax_v(most, fabs_v(load_v(&arm->row[i][l])) / scale[i]);
                }
            }
            *worst = largest_lane(most);
        }
#endif
        if (used > 1) {
            keep_joints(arm, used - 1, (real)(at + used - 1) * r->p->period,
                (real)(used - 1) * r->p->period, &last);
        }
    }
    return MODEL_OK;
}

/*
 * Of each column of samples: its largest size and its largest difference to finite differences of
 * another array.
 */
typedef struct {
    real most[NA], off[NA]; /* off: times 60 periods */
} column_maxima;

/* The same of the columns of x, whose integrals are those of y; `columns`: a constant. */
MODEL_INLINE void add_column_maxima(const real *y, const real *x, const int columns,
    ptrdiff_t samples, real sixty, column_maxima *out)
{
    const ptrdiff_t first = MARGIN * (ptrdiff_t)columns, last = (samples - MARGIN) * columns,
                    all = samples * columns;
    lanes most[NA], off[NA]; /* lane l of vector i: column (i LANES + l) modulo `columns` */
    ptrdiff_t at = first;
    for (int i = 0; i < columns; ++i) {
        most[i] = off[i] = splat_v(0.0);
    }
    for (; at + columns * LANES <= last; at += columns * LANES) {
        for (int i = 0; i < columns; ++i) {
            const real *from = y + at + i * LANES;
            const lanes now = load_v(x + at + i * LANES);
            most[i] = fmax_v(most[i], fabs_v(now));
            off[i] = fmax_v(off[i], fabs_v(sixty_differences_v(from, columns) - sixty * now));
        }
    }
    for (int i = 0; i < columns * LANES; ++i) {
        out->most[i % columns] = fmax_1(out->most[i % columns], ((const real *)most)[i]);
        out->off[i % columns] = fmax_1(out->off[i % columns], ((const real *)off)[i]);
    }
    for (; at < last; ++at) {
        const int i = (int)(at % columns);
        out->most[i] = fmax_1(out->most[i], fabs_1(x[at]));
        out->off[i] = fmax_1(
            out->off[i], fabs_1(sixty_differences(y + at, columns) - sixty * x[at]));
    }
    for (at = 0; at < all; ++at) { /* the samples at the ends */
        at = at == first && last > first ? last : at;
        if (at < all) {
            out->most[at % columns] = fmax_1(out->most[at % columns], fabs_1(x[at]));
        }
    }
}

#if MODEL_NE > 0
/*
 * Estimate of the largest error of a motor torque, relative to its largest one. Between Gauss
 * points a residual ripples with the intervals; a rotor behind a gear follows it, with a torque J
 * (2 pi / h)^2 / K times as large. A sixth difference over quarters of an interval is 8 to 64
 * times such a ripple. At a node the torque may have a spike: the accelerations differ by `off`
 * from differences of the speeds.
 */
static inline real torque_error(const results *r, const real *off)
{
    const ptrdiff_t step = (r->o->samples_per_interval + 3) / 4 * (ptrdiff_t)NM;
    const real least = 1e-9 + 1e-2 * largest(r->most, NM), binomial[4] = {1.0, -6.0, 15.0, -10.0};
    real worst = 0.0;
    for (int j = 0; j < NM; ++j) {
        real most = 0.5 * off[j];
        for (ptrdiff_t k = j; k + 6 * step < r->samples * NM; k += NM) {
            real sixth = 0.0;
            for (int i = 0; i < 4; ++i) {
                sixth += binomial[i] * (r->a_m[k + i * step] + r->a_m[k + (6 - i) * step]);
            }
            most = fmax_1(most, fabs_1(sixth) / 24.0);
        }
        worst = fmax_1(worst, rotor_inertia[j] * most / fmax_1(r->most[j], least));
    }
    return worst;
}

#endif
/*
 * Kinematic mismatch: the largest difference between finite differences of positions and
 * velocities and the velocities and accelerations, relative to the largest of these. It is large
 * where they are too far apart or too close, where the path jumps, and where a singular pose
 * throws the arm back. A model without unactuated coordinates is at rest before and after the
 * samples and is checked at all of them.
 */
static inline real kinematic_mismatch(const results *r, real *of_torques)
{
    const real sixty = 60.0 * r->p->period;
    /* least that is measured */
    real most[4] = {1e-6, 1e-6, 1e-9, 1e-6}, off[4] = {0.0, 0.0, 0.0, 0.0}, worst = 0.0;
    column_maxima of_v = {{0.0}, {0.0}}, of_q = {{0.0}, {0.0}}, of_motors = {{0.0}, {0.0}};
    add_column_maxima(r->v_a, r->a_a, NA, r->samples, sixty, &of_v);
    add_column_maxima(r->q_a, r->v_a, NA, r->samples, sixty, &of_q);
#if MODEL_HYSTERESIS
    (void)of_motors; /* where a gear reverses, the acceleration of its motor is not smooth */
#else                /* MODEL_HYSTERESIS */
    add_column_maxima(r->v_m, r->a_m, NM, r->samples, sixty, &of_motors);
#endif               /* MODEL_HYSTERESIS */
    most[0] = fmax_1(most[0], largest(of_v.most, NA));
    most[1] = fmax_1(most[1], largest(of_motors.most, NM));
    most[2] = fmax_1(most[2], largest(of_q.most, NA));
    off[0] = largest(of_v.off, NA);
    off[1] = largest(of_motors.off, NM);
    off[2] = largest(of_q.off, NA);
    for (int j = 0; j < NM; ++j) {
        most[3] = fmax_1(most[3], rotor_inertia[j] * of_motors.most[j]);
        off[3] = fmax_1(off[3], rotor_inertia[j] * of_motors.off[j]);
        of_motors.off[j] /= sixty;
    }
#if MODEL_NE > 0
    *of_torques = torque_error(r, of_motors.off);
#else
    *of_torques = 0.0;
    for (ptrdiff_t k = 0; k < r->samples; ++k) { /* the samples at the ends */
        for (int i = 0; i < NA && (k < MARGIN || k + MARGIN >= r->samples); ++i) {
            real q[2 * MARGIN + 1], v[2 * MARGIN + 1];
            for (int j = 0; j <= 2 * MARGIN; ++j) {
                const ptrdiff_t at = k + j - MARGIN;
                const ptrdiff_t held = at < 0 ? 0 : at < r->samples ? at : r->samples - 1;
                q[j] = r->q_a[held * NA + i];
                v[j] = held == at ? r->v_a[at * NA + i] : 0.0;
            }
            off[0] = fmax_1(
                off[0], fabs_1(sixty_differences(v + MARGIN, 1) - sixty * r->a_a[k * NA + i]));
            off[2] = fmax_1(off[2], fabs_1(sixty_differences(q + MARGIN, 1) - sixty * v[MARGIN]));
        }
    }
#endif
    /* accelerations of arm and motors, speeds of the arm, torques of the rotors */
    for (int i = 0; i < 4; ++i) {
        worst = fmax_1(worst, off[i] / (sixty * most[i]));
    }
    return worst;
}

#if MODEL_LUGRE
/*
 * Add the torques of the bristles to those of the motors; their impulses are where the stiffness
 * of the gears was.
 */
static inline int add_bristles(const results *r)
{
    const real period = r->p->period;
    bristles b = {{0.0}, {0.0}};
    for (int j = 0; j < NM; ++j) {
        real *impulse = r->gear.stiffness + j * r->gear.apart, finite = 0.0;
        for (ptrdiff_t k = 1; k <= MARGIN; ++k) {
            impulse[-k] = 0.0;
        }
        for (ptrdiff_t k = 0; k + 1 < r->samples && lugre_coulomb[j] > 0.0; k += LANES) {
            real v[LANES + 1], a[LANES + 1];
            const ptrdiff_t left = r->samples - 1 - k,
                            used = left < LANES ? left : (ptrdiff_t)LANES;
            for (ptrdiff_t l = 0; l <= used; ++l) {
                v[l] = r->v_m[(k + l) * NM + j];
                a[l] = r->a_m[(k + l) * NM + j];
            }
            if (used < LANES ||
                !bristle_impulses(j, period, v, a, impulse + k, &b.z[j], &b.since[j])) {
                for (ptrdiff_t l = 0; l < used; ++l) {
                    impulse[k + l] = bristle_impulse(
                        j, period, v + l, a + l, &b.z[j], &b.since[j]);
                }
            }
            for (ptrdiff_t l = 0; l < used; ++l) {
                finite += 0.0 * impulse[k + l];
            }
        }
        if (!(lugre_coulomb[j] > 0.0)) {
            continue;
        }
        r->held[j] = lugre_stiffness[j] * b.z[j];
        for (ptrdiff_t k = r->samples - 1; k < r->samples + MARGIN; ++k) {
            impulse[k] = period * r->held[j];
        }
        for (ptrdiff_t k = 0; k < r->samples; ++k) {
            r->tau_m[k * NM + j] += bristle_torque(impulse + k, 1, period);
        }
        if (finite != 0.0) {
            return 0;
        }
    }
    return 1;
}

#endif /* MODEL_LUGRE */
#if MODEL_HYSTERESIS
#else /* MODEL_HYSTERESIS */
/* Deflections of the gears at the samples from their torques. */
static inline int deflections_at_samples(const results *r, gears *state, real *space)
{
    const gear_rows *g = &r->gear;
    const ptrdiff_t known = r->samples + BEYOND, lagged = r->samples + MARGIN;
    real first[NG];
    hold_ends(g, g->tau, known);
    for (ptrdiff_t at = 0; at < known; at += POINTS) {
        if (!static_deflections_at(g, at, space)) {
            return 0;
        }
    }
    hold_ends(g, g->deflection, known);
    hold_ends(g, g->stiffness, known);
    for (int i = 0; i < NG; ++i) {
        first[i] = g->deflection[i * g->apart];
    }
    if (!begin_gears(state, r->p->period, first, space) || !lagged_rows(g, state, lagged, space)) {
        return 0;
    }
    hold_ends(g, g->lagged, lagged);
    return 1;
}

#endif /* MODEL_HYSTERESIS */
/* Motion of the joints at samples `at` and following ones; the last one again after it. */
static inline int load_joints_at(const results *r, ptrdiff_t at, motor_points *p)
{
    const int used = r->samples - at < POINTS ? (int)(r->samples - at) : (int)POINTS;
    for (int l = 0; l < POINTS; ++l) {
        const ptrdiff_t k = (at + (l < used ? l : used - 1)) * NA;
        for (int i = 0; i < NG; ++i) {
            p->q[i][l] = r->q_a[k + i_g[i]];
            p->v[i][l] = r->v_a[k + i_g[i]];
            p->a[i][l] = r->a_a[k + i_g[i]];
        }
    }
    return used;
}

#if MODEL_COUPLED
/*
 * Forces of the rotors on the joints and torques that their carriers take from them at the `used`
 * samples from `at` on; p: the joints with their deflections there.
 */
static inline int rotors_of_points(const results *r, ptrdiff_t at, int used, const motor_points *p,
    points *on_joints, points *taken, real *space)
{
    points arm[3][NA], v_m[NM], a_m[NM];
    for (int l = 0; l < POINTS; ++l) {
        const ptrdiff_t k = (at + (l < used ? l : used - 1)) * NA;
        for (int i = 0; i < NA; ++i) {
            arm[0][i][l] = r->q_a[k + i];
            arm[1][i][l] = r->v_a[k + i];
            arm[2][i][l] = r->a_a[k + i];
        }
    }
    for (int j = 0; j < NM; ++j) {
        EACH (l) {
            lanes v = splat_v(0.0), a = splat_v(0.0);
            for (int i = 0; i < NG; ++i) {
                v += eta[j][i] * load_v(&p->v[i][l]);
                a += eta[j][i] * load_v(&p->a[i][l]);
            }
            store_v(&v_m[j][l], v);
            store_v(&a_m[j][l], a);
        }
    }
    return evaluate_rotor_coupling_batch(POINTS, &arm[0][0][0], &arm[1][0][0], &arm[2][0][0],
               &v_m[0][0], &a_m[0][0], &on_joints[0][0], &taken[0][0], space) == MODEL_OK;
}

/*
 * Add the forces of the moving rotors to the torques of the gears: a pass for each stage of
 * motors, with the motors of the pass before. After the last sample they are those at it.
 */
static inline int couple_rotors(const results *r, real *space)
{
    const gear_rows *g = &r->gear;
    const ptrdiff_t known = r->samples + BEYOND;
    gears state;
    for (int i = 0; i < NG; ++i) {
        copy(g->tau + i * g->apart, known, g->still + i * g->apart);
    }
    for (int stage = 0; stage < COUPLING_STAGES; ++stage) {
        points last[NG] = {{0.0}}, on_joints[NG], taken[NM];
        if (!deflections_at_samples(r, &state, space)) {
            return 0;
        }
        for (ptrdiff_t at = 0; at < known; at += POINTS) {
            const ptrdiff_t all = known - at < POINTS ? known - at : (ptrdiff_t)POINTS;
            int used = 0;
            if (at < r->samples) {
                motor_points p;
                used = load_joints_at(r, at, &p);
                if (!add_deflections(g, &state, at, &p, space) ||
                    !rotors_of_points(r, at, used, &p, on_joints, taken, space)) {
                    return 0;
                }
            }
            for (int i = 0; i < NG; ++i) {
                const ptrdiff_t row = i * g->apart + at;
                for (ptrdiff_t l = 0; l < all; ++l) {
                    last[i][0] = l < used ? on_joints[i][l] : last[i][0];
                    g->tau[row + l] = g->still[row + l] + last[i][0];
                }
            }
        }
    }
    for (ptrdiff_t k = 0; k < r->samples && r->tau_g != NULL; ++k) {
        for (int i = 0; i < NG; ++i) {
            r->tau_g[k * NG + i] = g->tau[i * g->apart + k];
        }
    }
    return 1;
}

#endif /* MODEL_COUPLED */
/* Motors at the samples, through the gears. */
static inline int motors_at_samples(const results *r, real *space)
{
    const gear_rows *g = &r->gear;
    gears state;
    motor_points p;
#if MODEL_HYSTERESIS
    const ptrdiff_t known = r->samples + BEYOND, lagged = r->samples + MARGIN;
    real tau[NG], first[NG] = {0.0}, stiffness[NG];
    set_differences(&state, r->p->period);
    hold_ends(g, g->tau, known);
    for (int i = 0; i < NG; ++i) {
        tau[i] = g->tau[i * g->apart];
    }
    if (!static_deflection(tau, first, stiffness, space)) {
        return MODEL_RESULT_NOT_FINITE;
    }
    if (!hysteretic_rows(g, r->p->period, first, lagged, space)) {
        return MODEL_NOT_CONVERGED;
    }
    hold_ends(g, g->lagged, lagged);
#else /* MODEL_HYSTERESIS */
#if MODEL_COUPLED
    if (!couple_rotors(r, space)) {
        return MODEL_RESULT_NOT_FINITE;
    }
#endif /* MODEL_COUPLED */
    if (!deflections_at_samples(r, &state, space)) {
        return MODEL_RESULT_NOT_FINITE;
    }
#endif /* MODEL_HYSTERESIS */
    for (ptrdiff_t at = 0; at < r->samples; at += POINTS) {
        const int used = load_joints_at(r, at, &p);
#if MODEL_COUPLED
        points on_joints[NG], taken[NM];
#endif /* MODEL_COUPLED */
        if (!add_deflections(g, &state, at, &p, space) || !motors_of_points(g, at, &p, space)) {
            return MODEL_RESULT_NOT_FINITE;
        }
#if MODEL_COUPLED
        if (!rotors_of_points(r, at, used, &p, on_joints, taken, space)) {
            return MODEL_RESULT_NOT_FINITE;
        }
        for (int j = 0; j < NM; ++j) {
            EACH (l) {
                store_v(&p.tau_m[j][l], load_v(&p.tau_m[j][l]) + load_v(&taken[j][l]));
            }
        }
#endif /* MODEL_COUPLED */
        if (r->q_m != NULL) {
            store_samples(p.q_m, NM, used, r->q_m + at * NM);
        }
        if (r->tau_m != NULL) {
            store_samples(p.tau_m, NM, used, r->tau_m + at * NM);
        }
        store_samples(p.v_m, NM, used, r->v_m + at * NM);
        store_samples(p.a_m, NM, used, r->a_m + at * NM);
        for (int j = 0; j < NM; ++j) {
            r->most[j] = fmax_1(r->most[j], largest(p.tau_m[j], used));
        }
    }
#if MODEL_LUGRE
    if (r->tau_m != NULL && !add_bristles(r)) {
        return MODEL_RESULT_NOT_FINITE;
    }
#endif /* MODEL_LUGRE */
    return MODEL_OK;
}

/* The equilibrium q at the samples from `first` on. */
static inline int rest_at_samples(const results *r, ptrdiff_t first, ptrdiff_t all, const real *q,
    problem_points *arm, real *space)
{
    real joints[NG], tau_g[NG], deflection[NG] = {0.0}, stiffness[NG], still[NG] = {0.0}, q_m[NM],
                                v_m[NM], tau_m[NM];
    int status;
    for (int i = 0; i < NA; ++i) {
        for (int l = 0; l < POINTS; ++l) {
            arm->q[i][l] = q[i];
            arm->v[i][l] = arm->a[i][l] = 0.0;
        }
    }
#if MODEL_FORCE
    for (int l = 0; l < POINTS; ++l) {
        real reference[REFERENCE];
        reference_sample(r->p, r->p->n, reference);
        load_reference(arm, l, reference);
    }
    evaluate_constraint(arm, space); /* W */
#endif                               /* MODEL_FORCE */
    status = evaluate_rows(arm, space);
    if (status != MODEL_OK) {
        return status;
    }
    for (int i = 0; i < NG; ++i) {
        tau_g[i] = arm->tau_g[i][0];
    }
#if MODEL_HYSTERESIS
    (void)stiffness;
    /* of the gears as they are: their torque depends on the motion */
    for (int i = 0; i < NG; ++i) {
        deflection[i] = r->gear.lagged[i * r->gear.apart + first];
    }
#else  /* MODEL_HYSTERESIS */
    if (!static_deflection(tau_g, deflection, stiffness, space)) {
        return MODEL_RESULT_NOT_FINITE;
    }
#endif /* MODEL_HYSTERESIS */
    for (int i = 0; i < NG; ++i) {
        joints[i] = q[i_g[i]] + deflection[i];
    }
    if (!motors_of(joints, still, still, tau_g, q_m, v_m, tau_m, space)) {
        return MODEL_RESULT_NOT_FINITE;
    }
#if MODEL_LUGRE
    for (int j = 0; j < NM; ++j) {
        tau_m[j] += r->held[j];
    }
#endif /* MODEL_LUGRE */
    for (ptrdiff_t k = first; k < all; ++k) {
        copy(q, NA, r->q_a + k * NA);
        for (int i = 0; i < NA; ++i) {
            r->v_a[k * NA + i] = r->a_a[k * NA + i] = 0.0;
        }
        if (r->tau_g != NULL) {
            copy(tau_g, NG, r->tau_g + k * NG);
        }
        if (r->q_m != NULL) {
            copy(q_m, NM, r->q_m + k * NM);
        }
        copy(v_m, NM, r->v_m + k * NM);
        if (r->tau_m != NULL) {
            copy(tau_m, NM, r->tau_m + k * NM);
        }
    }
    return MODEL_OK;
}

/*
 * Motion at the samples from that of the mesh (or from the path alone), checked: the last part of
 * both solvers. The motion is at the first `samples`; from the last of them on it rests at q_end
 * (null: where the path ends), where there are more.
 */
static inline model_status finish(const model_samples *p, const model_inversion_options *o,
    const whole_layout *l, const real *q,
#if MODEL_NE > 0
    const mesh *m,
#endif
    const real *q_end, ptrdiff_t samples, problem_points *arm, model_motion *motion,
    whole_report *report, real *work)
{
    results r;
    real most[NM] = {0.0};
    int status;
#if MODEL_LUGRE
    real held[NM] = {0.0};
    r.held = held;
#endif /* MODEL_LUGRE */
    r.p = p;
    r.o = o;
    r.samples = samples < (ptrdiff_t)l->samples ? samples : (ptrdiff_t)l->samples;
    r.q_a = motion->q_a != NULL ? motion->q_a : work + l->q_a;
    r.v_a = motion->v_a != NULL ? motion->v_a : work + l->v_a;
    r.a_a = motion->a_a != NULL ? motion->a_a : work + l->a_a;
    r.v_m = motion->v_m != NULL ? motion->v_m : work + l->v_m;
    r.tau_g = motion->tau_g;
    r.q_m = motion->q_m;
    r.tau_m = motion->tau_m;
    r.gear.apart = (ptrdiff_t)row_length(l->samples);
    r.gear.tau = work + l->tau + BEFORE;
    r.gear.deflection = work + l->deflection + BEFORE;
    r.gear.stiffness = work + l->stiffness + BEFORE;
    r.gear.lagged = work + l->lagged + BEFORE;
#if MODEL_COUPLED
    r.gear.still = work + l->still + BEFORE;
#endif /* MODEL_COUPLED */
    r.a_m = work + l->deflection;
    r.most = most;
#if MODEL_NE > 0
    r.m = m;
    r.a_node = work + l->a_node;
    r.weights = work + l->weights;
    r.joint_weights = work + l->joint_weights;
    nodal_accelerations(m, work + l->a_node);
#endif
    status = arm_at_samples(
        &r, q, work + l->scale, arm, work + l->space, &report->residual_at_samples);
    if (status == MODEL_OK) {
        status = motors_at_samples(&r, work + l->space);
    }
    if (status != MODEL_OK) {
        return (model_status)status;
    }
    report->kinematic_mismatch = kinematic_mismatch(&r, &report->torque_error);
    if (r.samples < (ptrdiff_t)l->samples) {
        real end[NA];
        copy(q_end != NULL ? q_end : r.q_a + (r.samples - 1) * NA, NA, end);
        status = rest_at_samples(
            &r, r.samples - 1, (ptrdiff_t)l->samples, end, arm, work + l->space);
        if (status != MODEL_OK) {
            return (model_status)status;
        }
        report->n_post = (int)r.samples - o->n_pre - p->n;
    }
#if MODEL_POSITION
    if (o->servo != NULL && (motion->command_m != NULL || motion->command_g != NULL)) {
        real servo[SERVO_NUMBERS];
        keep_servo(o->servo, servo);
        /* before the torques are held: the first one holds the robot at rest */
        begin_servo(r.tau_m, r.q_m, servo);
        hold_torques(r.tau_m, (ptrdiff_t)l->samples, (int)o->hold, o->delay);
#if MODEL_FILTERS
        give_commands(r.tau_m, 0, (ptrdiff_t)l->samples - 1, r.q_m, (ptrdiff_t)l->samples, servo,
            motion->command_m, motion->command_g);
#else  /* MODEL_FILTERS */
        give_commands(
            r.tau_m, r.q_m, (ptrdiff_t)l->samples, servo, motion->command_m, motion->command_g);
#endif /* MODEL_FILTERS */
    } else {
        no_commands((ptrdiff_t)l->samples, motion->command_m, motion->command_g);
        if (r.tau_m != NULL) {
            hold_torques(r.tau_m, (ptrdiff_t)l->samples, (int)o->hold, o->delay);
        }
    }
#else  /* MODEL_POSITION */
    if (r.tau_m != NULL) {
        hold_torques(r.tau_m, (ptrdiff_t)l->samples, (int)o->hold, o->delay);
    }
#endif /* MODEL_POSITION */
    return report->residual_at_samples <= sampled_tolerances * o->tolerance &&
                   report->kinematic_mismatch <= mismatch_max &&
                   (report->torque_error <= torque_error_max ||
                       (report->residual_at_samples <= exact_tolerances * o->tolerance &&
                           report->torque_error < (real)INFINITY)) ?
               MODEL_OK :
               MODEL_TOLERANCE_NOT_MET;
}

#endif
