/*
 * elbow: from gear torques to motors, the stable stage behind the reduced inverse dynamics; private.
 *
 * A gear twisted by p carries D p' + spring(p) = tau_g; the motors follow from q_m = eta (q_g + p):
 *
 *     tau_m = J_m a_m + f(v_m) + eta^-T tau_g
 */
#ifndef ELBOW_MOTORS_H
#define ELBOW_MOTORS_H

#include "elbow_inversion.h"

enum { SPRING_STEPS = 60, QUICK_STEPS = 8, MARGIN = 3 };

static const real uneven = 2e-2; /* of a motion, see results and stream: more is no rounding and no filter's corner */

/* First and second derivative by seven samples, `stride` apart and `period` seconds; order six. */
static inline real sixty_differences(const real *x, ptrdiff_t stride)
{
    return 45.0 * (x[stride] - x[-stride]) - 9.0 * (x[2 * stride] - x[-2 * stride]) + (x[3 * stride] - x[-3 * stride]);
}

static inline real slope_of(const real *x, ptrdiff_t stride, real period)
{
    return sixty_differences(x, stride) / (60.0 * period);
}

static inline real curvature_of(const real *x, ptrdiff_t stride, real period)
{
    return (270.0 * (x[stride] + x[-stride]) - 27.0 * (x[2 * stride] + x[-2 * stride]) +
            2.0 * (x[3 * stride] + x[-3 * stride]) - 490.0 * x[0]) / (180.0 * period * period);
}

/* The same by Newton's method kept inside a bracket, from anywhere. */
static inline int safe_twist(const real *torque, real *twist, real *slope, real *space)
{
    real low[NG], high[NG], value[NG], at[NG];
    int short_of = 1;
    for (int i = 0; i < NG; ++i) {
        at[i] = 0.0;
    }
    if (elbow_gear_law(at, value, slope, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        high[i] = gear_is_rigid[i] ? 0.0 : 1e-9 + fabs_1(torque[i]) / fmax_1(slope[i], 1e-6);
    }
    for (int step = 0; step < 200 && short_of; ++step) {
        short_of = 0;
        if (elbow_gear_law(high, value, slope, space) != ELBOW_OK) {
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
        at[i] = gear_is_rigid[i] ? 0.0 : fmin_1(fmax_1(twist[i], low[i]), high[i]);
    }
    for (int step = 0; step < SPRING_STEPS; ++step) {
        real most = 0.0;
        if (elbow_gear_law(at, value, slope, space) != ELBOW_OK) {
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
            next = slope[i] > 0.0 ? at[i] - error / slope[i] : 0.5 * (low[i] + high[i]);
            if (!(next >= low[i] && next <= high[i])) {
                next = 0.5 * (low[i] + high[i]);
            }
            most = fmax_1(most, fabs_1(next - at[i]) - 4e-16 * fabs_1(at[i]));
            at[i] = next;
        }
        if (!(most > 0.0)) {
            break;
        }
    }
    if (!is_finite(at, NG) || elbow_gear_law(at, value, slope, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        const real size = fabs_1(torque[i]) + fabs_1(slope[i] * at[i]);
        if (!gear_is_rigid[i] && !(fabs_1(value[i] - torque[i]) <= 1e-12 * size)) {
            return 0; /* no twist carries so much */
        }
        twist[i] = at[i];
    }
    return 1;
}

/* Static twist of all gears under the torques, from a guess; 0 where there is none. */
static inline int static_twist(const real *torque, real *twist, real *slope, real *space)
{
    real value[NG], at[NG];
    for (int i = 0; i < NG; ++i) {
        at[i] = gear_is_rigid[i] ? 0.0 : twist[i];
    }
    for (int step = 0; step < QUICK_STEPS; ++step) {
        int done = 1;
        if (elbow_gear_law(at, value, slope, space) != ELBOW_OK) {
            return 0;
        }
        for (int i = 0; i < NG; ++i) {
            real change;
            if (gear_is_rigid[i]) {
                continue;
            }
            change = (value[i] - torque[i]) / slope[i];
            at[i] -= change;
            done = done && (gear_is_linear[i] || fabs_1(change) <= 1e-15 * fabs_1(at[i]));
        }
        if (!is_finite(at, NG)) {
            break;
        }
        if (done) {
            for (int i = 0; i < NG; ++i) {
                twist[i] = at[i];
            }
            return 1;
        }
    }
    return safe_twist(torque, twist, slope, space);
}

/* Gauss elimination of a 3 x 3 system with rows in a[i][0..2] and right side a[i][3], pivots on the diagonal. */
static inline void solve_three(real a[3][4])
{
    for (int k = 0; k < 3; ++k) {
        for (int i = k + 1; i < 3; ++i) {
            const real f = a[i][k] / a[k][k];
            for (int j = k; j < 4; ++j) {
                a[i][j] -= f * a[k][j];
            }
        }
    }
    for (int k = 2; k >= 0; --k) {
        for (int j = k + 1; j < 3; ++j) {
            a[k][3] -= a[k][j] * a[j][3];
        }
        a[k][3] /= a[k][k];
    }
}

static const real radau_c[3] = {0.15505102572168219, 0.64494897427831781, 1.0};
static const real radau_A[3][3] = {
    {0.19681547722366044, -0.06553542585019839, 0.02377097434822015},
    {0.39442431473908727, 0.29207341166522846, -0.04154875212599793},
    {0.37640306270046725, 0.51248582618842161, 1.0 / 9.0}};

/*
 * The step of `twist_step` for gears with a linear spring, p1 = f[0] p0 + sum_s f[1 + s] tau(c_s); slope: of the
 * springs.
 */
static inline void linear_steps(real h, const real *slope, real (*f)[4])
{
    for (int i = 0; i < NG; ++i) {
        for (int column = 0; column < 4; ++column) {
            real a[3][4];
            f[i][column] = 0.0;
            if (!gear_is_linear[i] || !(gear_damping[i] > 0.0)) {
                continue;
            }
            for (int s = 0; s < 3; ++s) {
                for (int t = 0; t < 3; ++t) {
                    a[s][t] = h * radau_A[s][t] * slope[i] / gear_damping[i] + (s == t ? 1.0 : 0.0);
                }
                a[s][3] = column == 0 ? 1.0 : h * radau_A[s][column - 1] / gear_damping[i];
            }
            solve_three(a);
            f[i][column] = a[2][3];
        }
    }
}

/* One step of D p' + spring(p) = tau by Radau IIA with three stages; the torque is a quintic between the samples. */
static inline int twist_step(
    real h, real (*linear)[4], real left[NG][3], real right[NG][3], real *p, real *space)
{
    real torque[3][NG], x[3][NG], value[3][NG], slope[3][NG];
    int nonlinear = 0;
    for (int i = 0; i < NG; ++i) {
        nonlinear |= !gear_is_rigid[i] && !gear_is_linear[i] && gear_damping[i] > 0.0;
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
            if (elbow_gear_law(x[s], value[s], slope[s], space) != ELBOW_OK) {
                return 0;
            }
        }
        for (int i = 0; i < NG; ++i) {
            real a[3][4], size = 1e-3;
            if (gear_is_rigid[i] || gear_is_linear[i] || !(gear_damping[i] > 0.0)) {
                continue;
            }
            for (int s = 0; s < 3; ++s) {
                real sum = x[s][i] - p[i];
                for (int t = 0; t < 3; ++t) {
                    const real rate = h * radau_A[s][t] / gear_damping[i];
                    sum -= rate * (torque[t][i] - value[t][i]);
                    a[s][t] = rate * slope[t][i] + (s == t ? 1.0 : 0.0);
                }
                a[s][3] = sum;
                size += fabs_1(x[s][i]);
            }
            solve_three(a);
            for (int s = 0; s < 3; ++s) {
                x[s][i] -= a[s][3];
                most = fmax_1(most, fabs_1(a[s][3]) / size);
            }
        }
        if (!(most > 1e-15)) {
            break;
        }
        if (step == SPRING_STEPS) {
            if (!(most < 1e-12)) { /* more than rounding */
                return 0;
            }
            break;
        }
    }
    for (int i = 0; i < NG; ++i) {
        if (gear_is_linear[i] && gear_damping[i] > 0.0) { /* the same formula, solved before */
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

/*
 * Whether a gear's twist lags so little behind its static value that the lag is an expansion; 0 where none can tell.
 * By the least stiffness that the spring has, which is at no twist or at a large one: the answer must not change on the
 * way, for a twist that is integrated has to be known from the beginning.
 */
static inline int which_follow_at_once(real period, int *quick, real *space)
{
    real at[NG], value[NG], least[NG], far[NG];
    for (int i = 0; i < NG; ++i) {
        at[i] = 0.0;
    }
    if (elbow_gear_law(at, value, least, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        at[i] = gear_is_rigid[i] ? 0.0 : 1.0;
    }
    if (elbow_gear_law(at, value, far, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        quick[i] = gear_is_rigid[i] || gear_damping[i] <= 5e-3 * period * fmin_1(least[i], far[i]);
    }
    return 1;
}

/* Motor angle, speed and torque of one instant from the joints and their twists. */
static inline int motors_of(
    const real *q, const real *v, const real *a, const real *tau_g, real *q_m, real *v_m, real *tau_m, real *space)
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
    if (elbow_motor_friction(v_m, friction, space) != ELBOW_OK) {
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

#endif
