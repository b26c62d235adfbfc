/*
 * model: gears and motors at all samples of a path, POINTS samples at a time; private.
 *
 * Torques and deflections of a gear are a row: entry k belongs to sample k, entries before the first sample and after
 * the last one repeat these.
 */
#ifndef MODEL_MOTOR_SAMPLES_H
#define MODEL_MOTOR_SAMPLES_H

#include "model_motors.h"
#include "model_reduced_problem.h"

/*
 * Samples after the last one that are computed too, for the derivatives there: of the torques for the lag of the gears,
 * and of the deflections for the motors.
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

/* Repeat the first of `count` entries before it, and the last as far as is read; the motion begins at equilibrium. */
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
        const real from = at > 0 ? g->tau[before] : 0.0, slope = at > 0 ? g->stiffness[before] : 1.0;
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
        if (evaluate_gear_law_batch(POINTS, &x[0][0], &value[0][0], &stiffness[0][0], space) != MODEL_OK) {
            break;
        }
        for (int i = 0; i < NG; ++i) {
            EACH (l) {
                if (!gear_is_rigid[i]) {
                    const lanes change = (load_v(&value[i][l]) - load_v(&torque[i][l])) / load_v(&stiffness[i][l]);
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
    for (ptrdiff_t k = at; k < at + POINTS; ++k) { /* one by one, within a bracket where that is needed */
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
 * Deflections of a gear with a linear spring whose lag is integrated. The step of `linear_steps`, its torque a quintic
 * through derivatives by differences, is p(k + 1) = p(k) + sum_j taps[j] tau(k - MARGIN + j) - gain p(k).
 */
static inline void integrate_linear(const gear_rows *g, int gear, const real *step, ptrdiff_t count)
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
                    now -= damping_of(i, space) / load_v(g->stiffness + row + at) * derivative_v(x, state->period);
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

/* Motors at POINTS samples: motion of the joints in; that of the motors and their torques out, and whether all is
   finite. */
typedef struct {
    points q[NG], v[NG], a[NG];
    points q_m[NM], v_m[NM], a_m[NM], tau_m[NM];
} motor_points;

/* Add the motion of the deflections of samples `at` and following ones to that of the joints. */
static inline int add_deflections(const gear_rows *g, const gears *state, ptrdiff_t at, motor_points *p, real *space)
{
    points x[NG], value[NG], stiffness[NG];
    for (int i = 0; i < NG && state->slow; ++i) {
        copy(g->lagged + i * g->apart + at, POINTS, x[i]);
    }
    if (state->slow && evaluate_gear_law_batch(POINTS, &x[0][0], &value[0][0], &stiffness[0][0], space) != MODEL_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        EACH (l) {
            const real *deflection = g->lagged + i * g->apart + at + l, *tau = g->tau + i * g->apart + at + l;
            lanes once, twice;
            if (state->quick[i]) {
                once = derivative_v(deflection, state->period);
                twice = second_derivative_v(deflection, state->period);
            } else {
                const lanes now = load_v(tau), left = now - load_v(&value[i][l]);
                const lanes moves = lt_v(PRECISE(0.0, 2e-7) * fabs_v(now), fabs_v(left)); /* rounding is no motion */
                once = select_v(moves, left, splat_v(0.0)) / damping_of(i, space);
                twice = (derivative_v(tau, state->period) - load_v(&stiffness[i][l]) * once) / damping_of(i, space);
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
    if (evaluate_motor_friction_batch(POINTS, &p->v_m[0][0], &friction[0][0], space) != MODEL_OK) {
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

#endif
