/*
 * elbow: what a whole path gives: motion and torques of the arm at the samples, and of the motors behind them; private.
 */
#ifndef ELBOW_RESULTS_H
#define ELBOW_RESULTS_H

#include "elbow_samples.h"

/* The samples that are asked for: the caller's arrays, sample after sample, and room of the workspace. */
typedef struct {
    const path *p;
    int lead, every;   /* samples before the path, and per interval of the mesh */
    ptrdiff_t samples; /* lead, path and tail */
    real *q_a, *v_a, *a_a, *tau_g, *q_m, *v_m, *tau_m;
    real *tau, *twist, *late; /* (samples + 2 MARGIN) x NG: torques, static and real twists of the gears */
    real *slope;              /* samples x NG: stiffness of the gears */
#if ELBOW_NE > 0
    const mesh *m;
    const real *a_node; /* accelerations at its nodes */
#endif
} results;

/* Motion and gear torques of the arm, from rest at q; worst: the largest residual, relative to `scale`. */
static inline int arm_at_samples(
    const results *r, const real *q, const real *scale, arm_points *arm, real *space, real *worst)
{
    real last[NG], side = 0.0;
#if ELBOW_NE > 0
    interpolant f;
    prepare(&f);
#else
    (void)scale;
#endif
    *worst = 0.0;
    for (int i = 0; i < NG; ++i) {
        last[i] = q[i_g[i]];
    }
    for (ptrdiff_t at = 0; at < r->samples; at += POINTS) {
        const int used = r->samples - at < POINTS ? (int)(r->samples - at) : (int)POINTS;
        int status;
        for (int point = 0; point < POINTS; ++point) {
            const ptrdiff_t k = at + (point < used ? point : used - 1);
            real reference[REFERENCE];
            reference_at(r->p, (int)(k - r->lead), 0.0, reference);
            load_reference(arm, point, reference);
            for (int i = 0; i < NG; ++i) {
                arm->q[i_g[i]][point] = last[i];
                arm->v[i_g[i]][point] = 0.0;
                arm->a[i_g[i]][point] = 0.0;
            }
#if ELBOW_NE > 0
            {
                const ptrdiff_t interval = k / r->every < r->m->N ? k / r->every : r->m->N - 1;
                const real x = (real)(k - interval * r->every) / r->every;
                load_elastic(r->m, r->a_node, &f, interval, x, arm, point);
            }
#endif
        }
        status = torques(arm, space);
        if (status != ELBOW_OK) {
            return status;
        }
        for (int k = 0; k < used; ++k) {
            for (int i = 0; i < NA; ++i) {
                r->q_a[(at + k) * NA + i] = arm->q[i][k];
                r->v_a[(at + k) * NA + i] = arm->v[i][k];
                r->a_a[(at + k) * NA + i] = arm->a[i][k];
            }
            if (!(arm->side[k] * side >= 0.0)) {
                return ELBOW_UNREACHABLE; /* it stepped over a singular pose */
            }
            side = arm->side[k];
            for (int i = 0; i < NG; ++i) {
                r->tau_g[(at + k) * NG + i] = arm->tau_g[i][k];
                r->tau[(at + k + MARGIN) * NG + i] = arm->tau_g[i][k];
                last[i] = arm->q[i_g[i]][k];
            }
#if ELBOW_NE > 0
            for (int i = 0; i < NE; ++i) {
                *worst = fmax_1(*worst, fabs_1(arm->row[i][k]) / scale[i]);
            }
#endif
        }
    }
    return ELBOW_OK;
}

/* Before the first sample its value, after the last one that one. */
static inline void hold_ends(real *x, ptrdiff_t samples)
{
    for (ptrdiff_t k = 0; k < MARGIN * NG; ++k) {
        x[k] = x[MARGIN * NG + k % NG];
        x[(samples + MARGIN) * NG + k] = x[(samples + MARGIN - 1) * NG + k % NG];
    }
}

/*
 * How far positions and speeds of arm and motors are from being integrals of speeds and accelerations, by differences,
 * relative to the largest one of these: next to nothing where the samples show the motion; much where they are too far
 * apart for it or too near for the digits, where the path jumps, and where the arm is thrown back by a singular pose.
 * An arm without coordinates that have no motor rests before the samples and after them, and is judged at all of them.
 */
static inline real unevenness(const results *r)
{
    const real sixty = 60.0 * r->p->period;
    real most[4] = {1e-6, 1e-6, 1e-9, 1e-6}, off[4] = {0.0, 0.0, 0.0, 0.0}, worst = 0.0; /* least that is measured */
    for (ptrdiff_t k = 0; k < r->samples; ++k) {
        const int inside = k >= MARGIN && k + MARGIN < r->samples;
        for (int i = 0; i < NA; ++i) {
            real q[2 * MARGIN + 1], v[2 * MARGIN + 1];
            const real a = r->a_a[k * NA + i];
            for (int j = 0; j <= 2 * MARGIN; ++j) {
                const ptrdiff_t at = k + j - MARGIN;
                const ptrdiff_t held = at < 0 ? 0 : at < r->samples ? at : r->samples - 1;
                q[j] = r->q_a[held * NA + i];
                v[j] = held == at ? r->v_a[at * NA + i] : 0.0;
            }
            most[0] = fmax_1(most[0], fabs_1(a));
            most[2] = fmax_1(most[2], fabs_1(v[MARGIN]));
            if (inside || ELBOW_NE == 0) {
                off[0] = fmax_1(off[0], fabs_1(sixty_differences(v + MARGIN, 1) - sixty * a));
                off[2] = fmax_1(off[2], fabs_1(sixty_differences(q + MARGIN, 1) - sixty * v[MARGIN]));
            }
        }
        for (int j = 0; j < NM; ++j) {
            const real *v = r->v_m + k * NM + j;
            real a = 0.0;
            for (int i = 0; i < NG; ++i) {
                a += eta[j][i] * r->twist[(k + MARGIN) * NG + i];
            }
            most[1] = fmax_1(most[1], fabs_1(a));
            most[3] = fmax_1(most[3], rotor_inertia[j] * fabs_1(a));
            a = inside ? fabs_1(sixty_differences(v, NM) - sixty * a) : 0.0;
            off[1] = fmax_1(off[1], a);
            off[3] = fmax_1(off[3], rotor_inertia[j] * a);
        }
    }
    for (int i = 0; i < 4; ++i) { /* accelerations of arm and motors, speeds of the arm, torques of the rotors */
        worst = fmax_1(worst, off[i] / (sixty * most[i]));
    }
    return worst;
}

/* Whether the samples are as good as the solution on the mesh: residual and unevenness there. */
static inline int judged(real residual, real unevenness_there, real tolerance)
{
    return residual <= tolerance && unevenness_there <= uneven ? ELBOW_OK : ELBOW_INEXACT;
}

/* Motors at the samples, through the gears. */
static inline int motors_at_samples(const results *r, real *space)
{
    const real period = r->p->period;
    real last[NG], now[NG], left[NG][3] = {{0.0}}, right[NG][3] = {{0.0}};
    real linear[NG][4];
    int quick[NG], slow = 0;
    hold_ends(r->tau, r->samples);
    if (!which_follow_at_once(period, quick, space)) {
        return ELBOW_RESULT_NOT_FINITE;
    }
    for (int i = 0; i < NG; ++i) {
        last[i] = 0.0;
    }
    for (ptrdiff_t k = 0; k < r->samples; ++k) {
        real slope[NG];
        if (!static_twist(r->tau + (k + MARGIN) * NG, last, slope, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        for (int i = 0; i < NG; ++i) {
            r->twist[(k + MARGIN) * NG + i] = last[i];
            r->slope[k * NG + i] = slope[i];
        }
    }
    hold_ends(r->twist, r->samples);
    linear_steps(period, r->slope, linear);
    for (int i = 0; i < NG; ++i) {
        now[i] = r->twist[MARGIN * NG + i];
        slow |= !quick[i];
    }
    for (ptrdiff_t k = 0; k < r->samples; ++k) {
        const real *tau = r->tau + (k + MARGIN) * NG, *twist = r->twist + (k + MARGIN) * NG;
        for (int i = 0; i < NG && slow; ++i) {
            for (int j = 0; j < 3; ++j) {
                left[i][j] = right[i][j];
            }
            right[i][0] = tau[i];
            right[i][1] = period * slope_of(tau + i, NG, period);
            right[i][2] = period * period * curvature_of(tau + i, NG, period);
        }
        if (slow && k > 0 && !twist_step(period, linear, left, right, now, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        for (int i = 0; i < NG; ++i) {
            const real lag = gear_is_rigid[i] ? 0.0 : gear_damping[i] / r->slope[k * NG + i];
            r->late[(k + MARGIN) * NG + i] = quick[i] ? twist[i] - lag * slope_of(twist + i, NG, period) : now[i];
        }
    }
    hold_ends(r->late, r->samples);
    for (ptrdiff_t k = 0; k < r->samples; ++k) {
        const real *tau = r->tau + (k + MARGIN) * NG, *twist = r->late + (k + MARGIN) * NG;
        real value[NG], slope[NG], theta[NG], omega[NG], alpha[NG];
        if (elbow_gear_law(twist, value, slope, space) != ELBOW_OK) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        for (int i = 0; i < NG; ++i) {
            real once, twice;
            if (quick[i]) {
                once = slope_of(twist + i, NG, period);
                twice = curvature_of(twist + i, NG, period);
            } else {
                once = (tau[i] - value[i]) / gear_damping[i];
                twice = (slope_of(tau + i, NG, period) - slope[i] * once) / gear_damping[i];
            }
            theta[i] = r->q_a[k * NA + i_g[i]] + twist[i];
            omega[i] = r->v_a[k * NA + i_g[i]] + once;
            alpha[i] = r->a_a[k * NA + i_g[i]] + twice;
            r->twist[(k + MARGIN) * NG + i] = alpha[i]; /* for `unevenness`; the static twists have served */
        }
        if (!motors_of(theta, omega, alpha, tau, r->q_m + k * NM, r->v_m + k * NM, r->tau_m + k * NM, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
    }
    return ELBOW_OK;
}

#endif
