/*
 * model: motors behind the gears, from the motion and torques of the reduced problem; private.
 *
 * With the deflections p of the gears the motor angles are q_m = eta (q_g + p), and
 *
 *     tau_m = J_m a_m + f(v_m) + eta^-T tau_g
 */
#ifndef MODEL_MOTORS_H
#define MODEL_MOTORS_H

#include "model_gear_deflection.h"

/* Motor angle, speed and torque at one instant from the joints and their deflections. */
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
    if (evaluate_motor_friction(v_m, friction, space) != MODEL_OK) {
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
 * The same from the motion of the joints, to which that of the deflections is added. `tau`, `deflection`: gear torques
 * and deflections at this sample, between their neighbors.
 */
static inline int motors_at_sample(const gears *g, const real *tau, const real *deflection, real *q, real *v, real *a,
    real *q_m, real *v_m, real *tau_m, real *space)
{
    const real period = g->period;
    real value[NG], stiffness[NG];
    if (evaluate_gear_law(deflection, value, stiffness, space) != MODEL_OK) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        real once, twice;
        if (g->quick[i]) {
            once = derivative_of(deflection + i, NG, period);
            twice = second_derivative_of(deflection + i, NG, period);
        } else {
            real left = tau[i] - value[i];
            left = fabs_1(left) <= PRECISE(0.0, 2e-7) * fabs_1(tau[i]) ? 0.0 : left; /* rounding is no motion */
            once = left / damping_of(i, space);
            twice = (derivative_of(tau + i, NG, period) - stiffness[i] * once) / damping_of(i, space);
        }
        q[i] += deflection[i];
        v[i] += once;
        a[i] += twice;
    }
    return motors_of(q, v, a, tau, q_m, v_m, tau_m, space);
}

#endif
