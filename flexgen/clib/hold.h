/*
 * model: torques for a drive that holds each of them, or goes on a straight line to the next one; private.
 *
 * The motor has the torque of sample k from k + delay on, in samples. v: the mean of the torque from there to the next
 * one (HOLD_ZOH), or its value there, from the quintic polynomial through six samples. The torque to send is
 *
 *     HOLD_ZOH      u = v - D2 v / 12                    D2: second difference v_(k-1) - 2 v_k + v_(k+1)
 *     HOLD_LINEAR   u = v - D2 v / 12 + 7/720 D2 D2 v
 *
 * because the hold smooths v. Up to the order 6 in the period the values of HOLD_LINEAR are those of the straight lines
 * with the least squared distance from the torque. With limits and for HOLD_SPLINE u = v.
 */
#ifndef MODEL_HOLD_H
#define MODEL_HOLD_H

#include "model_inversion_common.h"

enum {
    HOLD_BEFORE =
        4, /* samples before that of a held torque and after it, which it depends on; the delay comes on top */
    HOLD_AFTER = 5,
    HOLD_TAPS = HOLD_BEFORE + 1 + HOLD_AFTER,
    HOLD_NODES = 6
};

/* Lagrange polynomials of the nodes -2 to 3, times 120: coefficients of 1, x, ..., x^5. */
static const real lagrange_120[HOLD_NODES][HOLD_NODES] = {{0.0, 6.0, -5.0, -5.0, 5.0, -1.0},
    {0.0, -60.0, 80.0, -5.0, -20.0, 5.0}, {120.0, -40.0, -150.0, 50.0, 30.0, -10.0},
    {0.0, 120.0, 80.0, -70.0, -20.0, 10.0}, {0.0, -30.0, -5.0, 35.0, 5.0, -5.0}, {0.0, 4.0, 0.0, -5.0, 0.0, 1.0}};

static inline int hold_fits(real hold, real delay)
{
    return (hold == (real)MODEL_HOLD_SPLINE || hold == (real)MODEL_HOLD_LINEAR || hold == (real)MODEL_HOLD_ZOH) &&
           delay >= 0.0 && delay <= MODEL_HOLD_DELAY_MAX;
}

/* Whether the torques to send differ from the samples. */
static inline int is_held(real hold, real delay)
{
    return hold != (real)MODEL_HOLD_SPLINE || delay > 0.0;
}

/* Weights of the samples k + (whole delay) - HOLD_BEFORE and following ones in the torque of sample k. */
static inline void hold_weights(real hold, real delay, int limited, real weight[HOLD_TAPS])
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
        if (hold == (real)MODEL_HOLD_ZOH) {
            v[i + 4] += whole - part;
            v[i + 5] += part;
        } else {
            v[i + 4] += value;
        }
    }
    for (int i = 0; i < HOLD_TAPS; ++i) {
        weight[i] = v[i + 2];
        if (hold != (real)MODEL_HOLD_SPLINE && !limited) {
            weight[i] -= (v[i + 1] - 2.0 * v[i + 2] + v[i + 3]) / 12.0;
        }
        if (hold == (real)MODEL_HOLD_LINEAR && !limited) {
            weight[i] += (v[i] - 4.0 * v[i + 1] + 6.0 * v[i + 2] - 4.0 * v[i + 3] + v[i + 4]) * 7.0 / 720.0;
        }
    }
}

/* The torques to send instead of n samples of the motor torques, in place; constant torque before and after them. */
static inline void hold_torques(real *tau, ptrdiff_t n, real hold, real delay)
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
            const real *sample = at < k ? before[at - k + HOLD_BEFORE] : tau + (at < n ? at : n - 1) * NM;
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
