/*
 * elbow: the parts that invert and bvp share: arguments, workspace, first guess, Newton's stop,
 * results; private.
 */
#ifndef ELBOW_WHOLE_PATH_H
#define ELBOW_WHOLE_PATH_H

#include "../elbow_inversion.h"

#include "elbow_mesh.h"
#include "elbow_motors.h"
#include "elbow_reduced_problem.h"

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
            ELBOW_OK) {
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

/* Add the motion of the deflections of samples `at` and following ones to that of the joints. */
static inline int add_deflections(
    const gear_rows *g, const gears *state, ptrdiff_t at, motor_points *p, real *space)
{
    points x[NG], value[NG], stiffness[NG];
    for (int i = 0; i < NG && state->slow; ++i) {
        copy(g->lagged + i * g->apart + at, POINTS, x[i]);
    }
    if (state->slow && evaluate_gear_law_batch(
                           POINTS, &x[0][0], &value[0][0], &stiffness[0][0], space) != ELBOW_OK) {
        return 0;
    }
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
    if (evaluate_motor_friction_batch(POINTS, &p->v_m[0][0], &friction[0][0], space) != ELBOW_OK) {
        return 0;
    }
    for (int j = 0; j < NM; ++j) {
        EACH (l) {
            lanes torque = load_v(&friction[j][l]) + rotor_inertia[j] * load_v(&p->a_m[j][l]);
            for (int i = 0; i < NG; ++i) {
                torque += eta_inverse[i][j] * load_v(g->tau + i * g->apart + at + l);
            }
            store_v(&p->tau_m[j][l], torque);
            zero += 0.0 * torque;
        }
    }
    return sum_v(zero) == 0.0;
}

/* --- Arguments, workspace, first guess, stopping rule and results. */

enum { MAX_SAMPLES = 1000000 };

static inline int path_sizes_fit(int n, const elbow_inversion_options *o)
{
    return n >= 2 && o->n_pre >= 0 && o->n_post >= 0 && o->samples_per_interval >= 1 &&
           n <= MAX_SAMPLES && o->n_pre <= MAX_SAMPLES && o->n_post <= MAX_SAMPLES &&
           o->samples_per_interval <= MAX_SAMPLES && o->growth >= 0 && o->growth <= ELBOW_GROWS;
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
static inline elbow_status check_path(
    const elbow_samples *p, const real *parameters, const real *q_start)
{
    for (int k = 0; k < p->n; ++k) {
        if (!is_finite(p->y + k * (ptrdiff_t)NT, NT) ||
            !is_finite(p->dy + k * (ptrdiff_t)NY, NY) ||
            !is_finite(p->ddy + k * (ptrdiff_t)NY, NY)) {
            return ELBOW_INPUT_NOT_FINITE;
        }
    }
    if (!is_finite(parameters, PARAMETERS) || !is_finite(q_start, NA)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
    {
        real most = 0.0;
        for (int k = 0; k < p->n; ++k) {
            most = fmax_1(most, largest(p->dy + k * (ptrdiff_t)NY, NY));
        }
        if (!(largest(p->dy, NY) <= rest_rate_max * most) ||
            !(largest(p->dy + (p->n - 1) * (ptrdiff_t)NY, NY) <= rest_rate_max * most)) {
            return ELBOW_BAD_ARGUMENT;
        }
    }
    return ELBOW_OK;
}

/* Where the arrays of both solvers are in the workspace, in reals from its start. */
typedef struct {
    int64_t samples, intervals, varying; /* varying: as in mesh */
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
    int n, const elbow_inversion_options *o, int64_t interval_factor, int steady)
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
    TAKE(at, l.q_a, l.samples * NA);
    TAKE(at, l.v_a, l.samples * NA);
    TAKE(at, l.a_a, l.samples * NA);
    TAKE(at, l.v_m, l.samples * NM);
    (void)interval_factor;
    l.y = l.a = l.a_node = l.q_g = l.reference = l.factor = l.scale = l.weights = l.joint_weights =
        0;
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
static inline elbow_status check_arguments(const elbow_samples *p, const real *parameters,
    const real *q_start, const elbow_inversion_options *o, const elbow_motion *motion,
    whole_report *report, const real *work, int64_t work_size, int64_t wanted)
{
    if (p == NULL || parameters == NULL || q_start == NULL || o == NULL || motion == NULL ||
        work == NULL || p->y == NULL || p->dy == NULL || p->ddy == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (wanted < 0 || !(p->period > 0.0 && p->period < 1e6) ||
        !(o->tolerance > 0.0 && o->tolerance < 1.0) || !hold_fits((int)o->hold, o->delay) ||
        !(o->settled >= 0.0 && o->settled < 1.0)) {
        return ELBOW_BAD_ARGUMENT;
    }
    if (work_size < wanted) {
        return ELBOW_WORK_TOO_SMALL;
    }
    report->is_set = 1;
    report->residual = report->residual_at_samples = report->kinematic_mismatch =
        report->torque_error = (real)NAN;
    report->iterations = report->intervals = 0;
    report->n_post = o->n_post;
    return check_path(p, parameters, q_start);
}

/*
 * largest residual at the samples of a status OK, in tolerances; the same where the error of a
 * torque is larger
 */
static const real sampled_tolerances = PRECISE(1e2, 1.0), torque_error_max = 5e-3;
static const real exact_tolerances = PRECISE(0.0, 1.0);

/* The results at the samples: arrays of the caller or of the workspace, sample after sample. */
typedef struct {
    const elbow_samples *p;
    const elbow_inversion_options *o;
    ptrdiff_t samples; /* of the motion: n_pre + n + n_post, or fewer where it has settled */
    real *q_a, *v_a, *a_a, *tau_g, *q_m, *v_m, *tau_m;
    gear_rows gear;
    real *a_m;  /* samples x NM: accelerations of the motors; where the deflections have been */
    real *most; /* NM: the largest torques of the motors */
} results;

/* The first `count` points of n entries, sample after sample; n: a constant. */
ELBOW_INLINE void store_samples(points *x, const int n, ptrdiff_t count, real *to)
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
    (void)scale;
    *worst = 0.0;
    for (int i = 0; i < NG; ++i) {
        joints[i] = q[i_g[i]];
    }
    joints_at_rest(joints, &last);
    begin_points(arm);
    for (ptrdiff_t at = 0; at < all; at += POINTS) {
        const int used = all - at < POINTS ? (int)(all - at) : (int)POINTS;
        int status = ELBOW_UNREACHABLE; /* without a guess from a mesh */
        for (int point = 0; point < POINTS; ++point) {
            const ptrdiff_t k = at + (point < used ? point : used - 1);
            real reference[REFERENCE];
            reference_sample(r->p, k - r->o->n_pre, reference);
            load_reference(arm, point, reference);
            time[point] = (real)k * r->p->period;
        }
        status = status == ELBOW_OK ? status : follow_kinematics(arm, &last, time, space);
        status = status == ELBOW_OK ? evaluate_rows(arm, space) : status;
        if (status != ELBOW_OK) {
            return status;
        }
        for (int i = 0; i < NG; ++i) {
            copy(arm->tau_g[i], POINTS, r->gear.tau + i * r->gear.apart + at);
        }
        for (int k = 0; k < used; ++k) {
            if (!(arm->side[k] * side >= 0.0)) {
                return ELBOW_UNREACHABLE; /* it passed a singular pose */
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
        if (used > 1) {
            keep_joints(arm, used - 1, (real)(at + used - 1) * r->p->period,
                (real)(used - 1) * r->p->period, &last);
        }
    }
    return ELBOW_OK;
}

/*
 * Of each column of samples: its largest size and its largest difference to finite differences of
 * another array.
 */
typedef struct {
    real most[NA], off[NA]; /* off: times 60 periods */
} column_maxima;

/* The same of the columns of x, whose integrals are those of y; `columns`: a constant. */
ELBOW_INLINE void add_column_maxima(const real *y, const real *x, const int columns,
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
    add_column_maxima(r->v_m, r->a_m, NM, r->samples, sixty, &of_motors);
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
    /* accelerations of arm and motors, speeds of the arm, torques of the rotors */
    for (int i = 0; i < 4; ++i) {
        worst = fmax_1(worst, off[i] / (sixty * most[i]));
    }
    return worst;
}

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

/* Motors at the samples, through the gears. */
static inline int motors_at_samples(const results *r, real *space)
{
    const gear_rows *g = &r->gear;
    gears state;
    motor_points p;
    if (!deflections_at_samples(r, &state, space)) {
        return ELBOW_RESULT_NOT_FINITE;
    }
    for (ptrdiff_t at = 0; at < r->samples; at += POINTS) {
        const int used = load_joints_at(r, at, &p);
        if (!add_deflections(g, &state, at, &p, space) || !motors_of_points(g, at, &p, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
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
    return ELBOW_OK;
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
    status = evaluate_rows(arm, space);
    if (status != ELBOW_OK) {
        return status;
    }
    for (int i = 0; i < NG; ++i) {
        tau_g[i] = arm->tau_g[i][0];
    }
    if (!static_deflection(tau_g, deflection, stiffness, space)) {
        return ELBOW_RESULT_NOT_FINITE;
    }
    for (int i = 0; i < NG; ++i) {
        joints[i] = q[i_g[i]] + deflection[i];
    }
    if (!motors_of(joints, still, still, tau_g, q_m, v_m, tau_m, space)) {
        return ELBOW_RESULT_NOT_FINITE;
    }
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
    return ELBOW_OK;
}

/*
 * Motion at the samples from that of the mesh (or from the path alone), checked: the last part of
 * both solvers. The motion is at the first `samples`; from the last of them on it rests at q_end
 * (null: where the path ends), where there are more.
 */
static inline elbow_status finish(const elbow_samples *p, const elbow_inversion_options *o,
    const whole_layout *l, const real *q,
    const real *q_end, ptrdiff_t samples, problem_points *arm, elbow_motion *motion,
    whole_report *report, real *work)
{
    results r;
    real most[NM] = {0.0};
    int status;
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
    r.a_m = work + l->deflection;
    r.most = most;
    status = arm_at_samples(
        &r, q, work + l->scale, arm, work + l->space, &report->residual_at_samples);
    if (status == ELBOW_OK) {
        status = motors_at_samples(&r, work + l->space);
    }
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    report->kinematic_mismatch = kinematic_mismatch(&r, &report->torque_error);
    if (r.samples < (ptrdiff_t)l->samples) {
        real end[NA];
        copy(q_end != NULL ? q_end : r.q_a + (r.samples - 1) * NA, NA, end);
        status = rest_at_samples(
            &r, r.samples - 1, (ptrdiff_t)l->samples, end, arm, work + l->space);
        if (status != ELBOW_OK) {
            return (elbow_status)status;
        }
        report->n_post = (int)r.samples - o->n_pre - p->n;
    }
    if (r.tau_m != NULL) {
        hold_torques(r.tau_m, (ptrdiff_t)l->samples, (int)o->hold, o->delay);
    }
    return report->residual_at_samples <= sampled_tolerances * o->tolerance &&
                   report->kinematic_mismatch <= mismatch_max &&
                   (report->torque_error <= torque_error_max ||
                       (report->residual_at_samples <= exact_tolerances * o->tolerance &&
                           report->torque_error < (real)INFINITY)) ?
               ELBOW_OK :
               ELBOW_TOLERANCE_NOT_MET;
}

#endif
