/*
 * elbow: motors behind the gears, from the motion and torques of the reduced problem; private.
 *
 * With the deflections p of the gears the motor angles are q_m = eta (q_g + p), and
 *
 *     tau_m = J_m a_m + f(v_m) + eta^-T tau_g
 */
#ifndef ELBOW_MOTORS_H
#define ELBOW_MOTORS_H

#include "elbow_inversion_common.h"
#include "elbow_path.h"

/*
 * --- Deflections of the gears under their torques.
 *
 * A gear with the deflection p carries D p' + spring(p) = tau_g. Where the damping is small the
 * deflection lags little behind its static value, and the lag is a series; elsewhere the equation
 * is integrated from sample to sample.
 */

enum { SPRING_STEPS = 60, QUICK_STEPS = 8 };

/* `static_deflection` by Newton's method inside a bracket, from any guess. */
static inline int bracketed_deflection(
    const real *torque, real *deflection, real *stiffness, real *space)
{
    real low[NG], high[NG], value[NG], at[NG];
    int short_of = 1;
    set_zero(at, NG);
    if (evaluate_gear_law(at, value, stiffness, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        high[i] = gear_is_rigid[i] ? 0.0 : 1e-9 + fabs_1(torque[i]) / fmax_1(stiffness[i], 1e-6);
    }
    for (int step = 0; step < 200 && short_of; ++step) {
        short_of = 0;
        if (evaluate_gear_law(high, value, stiffness, space) != ELBOW_OK) {
            return 0;
        }
        for (int i = 0; i < NG; ++i) {
            if (!gear_is_rigid[i] && fabs_1(value[i]) < fabs_1(torque[i])) {
                high[i] *= 2.0;
                short_of = 1;
            }
        }
    }
    for (int i = 0; i < NG; ++i) {
        low[i] = -high[i];
        at[i] = gear_is_rigid[i] ? 0.0 : fmin_1(fmax_1(deflection[i], low[i]), high[i]);
    }
    for (int step = 0; step < SPRING_STEPS; ++step) {
        real most = 0.0;
        if (evaluate_gear_law(at, value, stiffness, space) != ELBOW_OK) {
            return 0;
        }
        for (int i = 0; i < NG; ++i) {
            const real error = value[i] - torque[i];
            real next;
            if (gear_is_rigid[i]) {
                continue;
            }
            if (error <= 0.0) {
                low[i] = at[i];
            }
            if (error >= 0.0) {
                high[i] = at[i];
            }
            next = stiffness[i] > 0.0 ? at[i] - error / stiffness[i] : 0.5 * (low[i] + high[i]);
            if (!(next >= low[i] && next <= high[i])) {
                next = 0.5 * (low[i] + high[i]);
            }
            most = fmax_1(most, fabs_1(next - at[i]) - PRECISE(4e-16, 2e-7) * fabs_1(at[i]));
            at[i] = next;
        }
        if (!(most > 0.0)) {
            break;
        }
    }
    if (!is_finite(at, NG) || evaluate_gear_law(at, value, stiffness, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        const real size = fabs_1(torque[i]) + fabs_1(stiffness[i] * at[i]);
        if (!gear_is_rigid[i] && !(fabs_1(value[i] - torque[i]) <= PRECISE(1e-12, 1e-5) * size)) {
            return 0; /* no deflection carries this torque */
        }
        deflection[i] = at[i];
    }
    return 1;
}

/* Static deflections of all gears under the torques, from a guess; 0 where there are none. */
static inline int static_deflection(
    const real *torque, real *deflection, real *stiffness, real *space)
{
    real value[NG], at[NG];
    for (int i = 0; i < NG; ++i) {
        at[i] = gear_is_rigid[i] ? 0.0 : deflection[i];
    }
    for (int step = 0; step < QUICK_STEPS; ++step) {
        int done = 1;
        if (evaluate_gear_law(at, value, stiffness, space) != ELBOW_OK) {
            return 0;
        }
        for (int i = 0; i < NG; ++i) {
            real change;
            if (gear_is_rigid[i]) {
                continue;
            }
            change = (value[i] - torque[i]) / stiffness[i];
            at[i] -= change;
            done = done &&
                   (gear_is_linear[i] || fabs_1(change) <= PRECISE(1e-15, 3e-7) * fabs_1(at[i]));
        }
        if (!is_finite(at, NG)) {
            break;
        }
        if (done) {
            copy(at, NG, deflection);
            return 1;
        }
    }
    return bracketed_deflection(torque, deflection, stiffness, space);
}

/*
 * Static deflections at n samples, each from the sample before, the first from a guess; the
 * stiffness at the last one.
 */
static inline int static_deflections(const real *tau, ptrdiff_t n, const real *guess,
    real *deflection, real *stiffness, real *space)
{
    real last[NG];
    copy(guess, NG, last);
    for (ptrdiff_t k = 0; k < n; ++k) {
        if (!static_deflection(tau + k * NG, last, stiffness, space)) {
            return 0;
        }
        copy(last, NG, deflection + k * NG);
    }
    return 1;
}

static const real radau_c[3] = {0.15505102572168219, 0.64494897427831781, 1.0};
static const real radau_A[3][3] = {
    {0.19681547722366044, -0.06553542585019839, 0.02377097434822015},
    {0.39442431473908727, 0.29207341166522846, -0.04154875212599793},
    {0.37640306270046725, 0.51248582618842161, 1.0 / 9.0}};

/*
 * The step of `deflection_step` for gears with a linear spring, p1 = f[0] p0 + sum_s f[1 + s]
 * tau(c_s).
 */
static inline void linear_steps(real h, const real *stiffness, real (*f)[4], const real *space)
{
    for (int i = 0; i < NG; ++i) {
        real a[3][7]; /* and four right sides */
        int solved;
        for (int column = 0; column < 4; ++column) {
            f[i][column] = 0.0;
        }
        if (!gear_is_linear[i] || !(damping_of(i, space) > 0.0)) {
            continue;
        }
        for (int s = 0; s < 3; ++s) {
            a[s][3] = 1.0;
            for (int t = 0; t < 3; ++t) {
                a[s][t] = h * radau_A[s][t] * stiffness[i] / damping_of(i, space) +
                          (s == t ? 1.0 : 0.0);
                a[s][4 + t] = h * radau_A[s][t] / damping_of(i, space);
            }
        }
        solved = solve_plain(&a[0][0], 3, 7);
        for (int column = 0; column < 4; ++column) {
            f[i][column] = solved ? a[2][3 + column] : (real)NAN;
        }
    }
}

/*
 * One step of D p' + spring(p) = tau by Radau IIA with three stages; the torque is a quintic
 * between the samples.
 */
static inline int deflection_step(
    real h, real (*linear)[4], real left[NG][3], real right[NG][3], real *p, real *space)
{
    real torque[3][NG], x[3][NG], value[3][NG], stiffness[3][NG];
    int nonlinear = 0;
    for (int i = 0; i < NG; ++i) {
        nonlinear |= !gear_is_rigid[i] && !gear_is_linear[i] && damping_of(i, space) > 0.0;
    }
    for (int i = 0; i < NG; ++i) {
        for (int s = 0; s < 3; ++s) {
            real out[3];
            quintic(radau_c[s], left[i], right[i], out);
            torque[s][i] = out[0];
            x[s][i] = p[i];
        }
    }
    for (int step = 0; nonlinear; ++step) {
        real most = 0.0;
        for (int s = 0; s < 3; ++s) {
            if (evaluate_gear_law(x[s], value[s], stiffness[s], space) != ELBOW_OK) {
                return 0;
            }
        }
        for (int i = 0; i < NG; ++i) {
            real a[3][4], size = 1e-3;
            if (gear_is_rigid[i] || gear_is_linear[i] || !(damping_of(i, space) > 0.0)) {
                continue;
            }
            for (int s = 0; s < 3; ++s) {
                real sum = x[s][i] - p[i];
                for (int t = 0; t < 3; ++t) {
                    const real rate = h * radau_A[s][t] / damping_of(i, space);
                    sum -= rate * (torque[t][i] - value[t][i]);
                    a[s][t] = rate * stiffness[t][i] + (s == t ? 1.0 : 0.0);
                }
                a[s][3] = sum;
                size += fabs_1(x[s][i]);
            }
            if (!solve_plain(&a[0][0], 3, 4)) {
                return 0;
            }
            for (int s = 0; s < 3; ++s) {
                x[s][i] -= a[s][3];
                most = fmax_1(most, fabs_1(a[s][3]) / size);
            }
        }
        if (!(most > PRECISE(1e-15, 3e-7))) {
            break;
        }
        if (step == SPRING_STEPS) {
            if (!(most < PRECISE(1e-12, 1e-5))) { /* more than rounding */
                return 0;
            }
            break;
        }
    }
    for (int i = 0; i < NG; ++i) {
        /* the same formula, solved before */
        if (gear_is_linear[i] && damping_of(i, space) > 0.0) {
            p[i] = linear[i][0] * p[i];
            for (int s = 0; s < 3; ++s) {
                p[i] += linear[i][1 + s] * torque[s][i];
            }
        } else {
            p[i] = x[2][i];
        }
    }
    return is_finite(p, NG);
}

/* All gears on their way from sample to sample. */
typedef struct {
    real period;   /* of the samples */
    int quick[NG]; /* 1: the lag is small, a series is accurate */
    int slow;      /* whether any does not */
    real linear[NG][4];
    /* torque at the sample before and at this one, with derivatives times the period */
    real left[NG][3], right[NG][3];
    real now[NG]; /* integrated deflections at this sample */
} gears;

/*
 * Stiffness of the springs at zero, and the least one, at zero or at a large deflection; 0 where
 * one is not finite.
 */
static inline int least_stiffness(real *at_zero, real *least, real *space)
{
    real at[NG], value[NG];
    set_zero(at, NG);
    if (evaluate_gear_law(at, value, at_zero, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        at[i] = gear_is_rigid[i] ? 0.0 : 1.0;
    }
    if (evaluate_gear_law(at, value, least, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        least[i] = fmin_1(at_zero[i], least[i]);
    }
    return 1;
}

/*
 * Prepare the first sample, with the deflections there; 0 where a number is not finite. Whether
 * the lag of a gear is small is decided once, from the least stiffness of its spring: an
 * integrated deflection must be known from the start.
 */
static inline int begin_gears(gears *g, real period, const real *deflection, real *space)
{
    real at_zero[NG], least[NG];
    if (!least_stiffness(at_zero, least, space)) {
        return 0;
    }
    g->period = period;
    g->slow = 0;
    for (int i = 0; i < NG; ++i) {
        g->quick[i] = gear_is_rigid[i] || damping_of(i, space) <= 5e-3 * period * least[i];
        g->slow |= !g->quick[i];
        for (int j = 0; j < 3; ++j) {
            g->left[i][j] = g->right[i][j] = 0.0;
        }
    }
    linear_steps(period, at_zero, g->linear, space);
    copy(deflection, NG, g->now);
    return 1;
}

/*
 * Advance to the next sample, or to the first one. tau: its torque; those of the gears are
 * `across` numbers apart, those of the samples before and after it `along`.
 */
static inline int advance_gears(
    gears *g, int first, const real *tau, ptrdiff_t across, ptrdiff_t along, real *space)
{
    const real period = g->period;
    for (int i = 0; i < NG && g->slow; ++i) {
        const real *at = tau + i * across;
        copy(g->right[i], 3, g->left[i]);
        g->right[i][0] = *at;
        g->right[i][1] = period * derivative_of(at, along, period);
        g->right[i][2] = period * period * second_derivative_of(at, along, period);
    }
    return first || !g->slow ||
           deflection_step(period, g->linear, g->left, g->right, g->now, space);
}

/* Time by which a deflection lags behind its static value [s]. */
static inline real lag_time(int gear, real stiffness, const real *space)
{
    return gear_is_rigid[gear] ? 0.0 : damping_of(gear, space) / stiffness;
}

/* LAGS: of the slowest gear, after which its deflection has decayed */
static const real lags = 20.0;

/*
 * Time in which the deflections of all gears decay at rest [s]; 0 where the stiffness is not
 * finite.
 */
static inline real gear_settling(real *space)
{
    real at_zero[NG], least[NG], time = 0.0;
    if (!least_stiffness(at_zero, least, space)) {
        return 0.0;
    }
    for (int i = 0; i < NG; ++i) {
        time = fmax_1(time, lags * lag_time(i, least[i], space));
    }
    return time;
}

/* Deflections at this sample from the static ones at this sample and its neighbors. */
static inline void lagged_deflections(
    const gears *g, const real *deflection, const real *stiffness, real *lagged, const real *space)
{
    for (int i = 0; i < NG; ++i) {
        const real lag = lag_time(i, stiffness[i], space);
        lagged[i] = g->quick[i] ?
                        deflection[i] - lag * derivative_of(deflection + i, NG, g->period) :
                        g->now[i];
    }
}

/* --- Motor angle, speed and torque from the joints and their deflections. */

/* Motor angle, speed and torque at one instant from the joints and their deflections. */
static inline int motors_of(const real *q, const real *v, const real *a, const real *tau_g,
    real *q_m, real *v_m, real *tau_m, real *space)
{
    real friction[NM];
    for (int j = 0; j < NM; ++j) {
        q_m[j] = 0.0;
        v_m[j] = 0.0;
        for (int i = 0; i < NG; ++i) {
            q_m[j] += eta[j][i] * q[i];
            v_m[j] += eta[j][i] * v[i];
        }
    }
    if (evaluate_motor_friction(v_m, friction, space) != ELBOW_OK) {
        return 0;
    }
    for (int j = 0; j < NM; ++j) {
        real torque = friction[j];
        for (int i = 0; i < NG; ++i) {
            torque += rotor_inertia[j] * eta[j][i] * a[i] + eta_inverse[i][j] * tau_g[i];
        }
        tau_m[j] = torque;
    }
    return is_finite(q_m, NM) && is_finite(v_m, NM) && is_finite(tau_m, NM);
}

/*
 * Add the motion of the deflections at a sample to that of the joints. `tau`, `deflection`: gear
 * torques and deflections at this sample, between their neighbors.
 */
static inline int deflect_joints(const gears *g, const real *tau, const real *deflection, real *q,
    real *v, real *a, real *space)
{
    const real period = g->period;
    real value[NG], stiffness[NG];
    if (evaluate_gear_law(deflection, value, stiffness, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        real once, twice;
        if (g->quick[i]) {
            once = derivative_of(deflection + i, NG, period);
            twice = second_derivative_of(deflection + i, NG, period);
        } else {
            real left = tau[i] - value[i];
            /* not rounding */
            left = fabs_1(left) <= PRECISE(0.0, 2e-7) * fabs_1(tau[i]) ? 0.0 : left;
            once = left / damping_of(i, space);
            twice = (derivative_of(tau + i, NG, period) - stiffness[i] * once) /
                    damping_of(i, space);
        }
        q[i] += deflection[i];
        v[i] += once;
        a[i] += twice;
    }
    return 1;
}

/*
 * --- Torques for a drive that holds each of them, or follows a straight line to the next one.
 *
 * The motor has the torque of sample k from k + delay on, in samples. v: the mean of the torque
 * from there to the next one (HOLD_ZOH), or its value there, from the quintic polynomial through
 * six samples. The torque to send is
 *
 *     HOLD_ZOH      u = v - D2 v / 12                    D2: second difference v_(k-1) - 2 v_k +
 *                   v_(k+1)
 *     HOLD_LINEAR   u = v - D2 v / 12 + 7/720 D2 D2 v
 *
 * because the hold smooths v. Up to the order 6 in the period the values of HOLD_LINEAR are those
 * of the straight lines with the least squared distance from the torque. With limits and for
 * HOLD_SPLINE u = v.
 */

enum {
    HOLD_BEFORE =
        /*
         * samples before that of a held torque and after it, which it depends on; the delay comes
         * on top
         */
    4,
    HOLD_AFTER = 5,
    HOLD_TAPS = HOLD_BEFORE + 1 + HOLD_AFTER,
    HOLD_NODES = 6
};

/* Lagrange polynomials of the nodes -2 to 3, times 120: coefficients of 1, x, ..., x^5. */
static const real lagrange_120[HOLD_NODES][HOLD_NODES] = {{0.0, 6.0, -5.0, -5.0, 5.0, -1.0},
    {0.0, -60.0, 80.0, -5.0, -20.0, 5.0}, {120.0, -40.0, -150.0, 50.0, 30.0, -10.0},
    {0.0, 120.0, 80.0, -70.0, -20.0, 10.0}, {0.0, -30.0, -5.0, 35.0, 5.0, -5.0},
    {0.0, 4.0, 0.0, -5.0, 0.0, 1.0}};

static inline int hold_fits(int hold, real delay)
{
    return (hold == ELBOW_HOLD_SPLINE || hold == ELBOW_HOLD_LINEAR || hold == ELBOW_HOLD_ZOH) &&
           delay >= 0.0 && delay <= ELBOW_HOLD_DELAY_MAX;
}

/* Whether the torques to send differ from the samples. */
static inline int is_held(int hold, real delay)
{
    return hold != ELBOW_HOLD_SPLINE || delay > 0.0;
}

/*
 * Weights of the samples k + (whole delay) - HOLD_BEFORE and following ones in the torque of
 * sample k.
 */
static inline void hold_weights(int hold, real delay, int limited, real weight[HOLD_TAPS])
{
    const real x = delay - (real)(int)delay;
    real v[HOLD_TAPS + 4] = {0.0}; /* two more on either side */
    for (int i = 0; i < HOLD_NODES; ++i) {
        real value = 0.0, part = 0.0, whole = 0.0; /* at x; integrals from 0 to x and to 1 */
        for (int p = HOLD_NODES - 1; p >= 0; --p) {
            const real c = lagrange_120[i][p] / 120.0;
            value = value * x + c;
            part = (part + c / (real)(p + 1)) * x;
            whole += c / (real)(p + 1);
        }
        if (hold == ELBOW_HOLD_ZOH) {
            v[i + 4] += whole - part;
            v[i + 5] += part;
        } else {
            v[i + 4] += value;
        }
    }
    for (int i = 0; i < HOLD_TAPS; ++i) {
        weight[i] = v[i + 2];
        if (hold != ELBOW_HOLD_SPLINE && !limited) {
            weight[i] -= (v[i + 1] - 2.0 * v[i + 2] + v[i + 3]) / 12.0;
        }
        if (hold == ELBOW_HOLD_LINEAR && !limited) {
            weight[i] += (v[i] - 4.0 * v[i + 1] + 6.0 * v[i + 2] - 4.0 * v[i + 3] + v[i + 4]) *
                         7.0 / 720.0;
        }
    }
}

/*
 * The torques to send instead of n samples of the motor torques, in place; constant torque before
 * and after them.
 */
static inline void hold_torques(real *tau, ptrdiff_t n, int hold, real delay)
{
    real weight[HOLD_TAPS], before[HOLD_BEFORE][NM];
    if (!is_held(hold, delay)) {
        return;
    }
    hold_weights(hold, delay, 0, weight);
    for (int i = 0; i < HOLD_BEFORE; ++i) {
        copy(tau, NM, before[i]);
    }
    for (ptrdiff_t k = 0; k < n; ++k) {
        real held[NM] = {0.0}, *now = tau + k * NM;
        for (int i = 0; i < HOLD_TAPS; ++i) {
            const ptrdiff_t at = k + (int)delay + i - HOLD_BEFORE;
            const real *sample = at < k ? before[at - k + HOLD_BEFORE] :
                                          tau + (at < n ? at : n - 1) * NM;
            for (int j = 0; j < NM; ++j) {
                held[j] += weight[i] * sample[j];
            }
        }
        copy(before[1], (HOLD_BEFORE - 1) * NM, before[0]);
        copy(now, NM, before[HOLD_BEFORE - 1]);
        copy((real)k + delay >= (real)(n - 1) ? tau + (n - 1) * NM : held, NM, now);
    }
}

#endif
