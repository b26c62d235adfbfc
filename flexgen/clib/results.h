/*
 * model: what a whole path gives: motion and torques of arm and motors at the samples; private.
 */
#ifndef MODEL_RESULTS_H
#define MODEL_RESULTS_H

#include "model_motors.h"
#include "model_samples.h"

/* The samples that are asked for: the caller's arrays, sample after sample, and room of the workspace. */
typedef struct {
    const path *p;
    int lead, every;   /* samples before the path, and per interval of the mesh */
    ptrdiff_t samples; /* lead, path and tail */
    real *q_a, *v_a, *a_a, *tau_g, *q_m, *v_m, *tau_m;
    real *tau, *twist, *late; /* (samples + 2 MARGIN) x NG: torques, static and real twists of the gears */
    real *slope;              /* samples x NG: stiffness of the gears */
#if MODEL_NE > 0
    const mesh *m;
    const real *a_node; /* accelerations at its nodes */
#endif
} results;

/* Motion and gear torques of the arm, from rest at q; worst: the largest residual, relative to `scale`. */
static inline int arm_at_samples(
    const results *r, const real *q, const real *scale, arm_points *arm, real *space, real *worst)
{
    real last[NG], side = 0.0;
#if MODEL_NE > 0
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
            load_joints(arm, point, last);
#if MODEL_NE > 0
            {
                const ptrdiff_t interval = k / r->every < r->m->N ? k / r->every : r->m->N - 1;
                const real x = (real)(k - interval * r->every) / r->every;
                load_between(r->m, r->a_node, &f, interval, x, arm, point);
            }
#endif
        }
        status = torques(arm, space);
        if (status != MODEL_OK) {
            return status;
        }
        for (int k = 0; k < used; ++k) {
            for (int i = 0; i < NA; ++i) {
                r->q_a[(at + k) * NA + i] = arm->q[i][k];
                r->v_a[(at + k) * NA + i] = arm->v[i][k];
                r->a_a[(at + k) * NA + i] = arm->a[i][k];
            }
            if (!(arm->side[k] * side >= 0.0)) {
                return MODEL_UNREACHABLE; /* it stepped over a singular pose */
            }
            side = arm->side[k];
            for (int i = 0; i < NG; ++i) {
                r->tau_g[(at + k) * NG + i] = arm->tau_g[i][k];
                r->tau[(at + k + MARGIN) * NG + i] = arm->tau_g[i][k];
                last[i] = arm->q[i_g[i]][k];
            }
#if MODEL_NE > 0
            for (int i = 0; i < NE; ++i) {
                *worst = fmax_1(*worst, fabs_1(arm->row[i][k]) / scale[i]);
            }
#endif
        }
    }
    return MODEL_OK;
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
            if (inside || MODEL_NE == 0) {
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
    return residual <= tolerance && unevenness_there <= uneven ? MODEL_OK : MODEL_INEXACT;
}

/* Motors at the samples, through the gears. */
static inline int motors_at_samples(const results *r, real *space)
{
    const ptrdiff_t first = MARGIN * NG;
    const real rest[NG] = {0.0};
    gears g;
    hold_ends(r->tau, r->samples);
    if (!static_twists(r->tau + first, r->samples, rest, r->twist + first, r->slope, NG, space)) {
        return MODEL_RESULT_NOT_FINITE;
    }
    hold_ends(r->twist, r->samples);
    if (!begin_gears(&g, r->p->period, r->twist + first, space)) {
        return MODEL_RESULT_NOT_FINITE;
    }
    for (ptrdiff_t k = 0; k < r->samples; ++k) {
        const ptrdiff_t at = first + k * NG;
        if (!carry_gears(&g, k == 0, r->tau + at, space)) {
            return MODEL_RESULT_NOT_FINITE;
        }
        late_twists(&g, r->twist + at, r->slope + k * NG, r->late + at);
    }
    hold_ends(r->late, r->samples);
    for (ptrdiff_t k = 0; k < r->samples; ++k) {
        const ptrdiff_t at = first + k * NG;
        real q[NG], v[NG], a[NG];
        for (int i = 0; i < NG; ++i) {
            q[i] = r->q_a[k * NA + i_g[i]];
            v[i] = r->v_a[k * NA + i_g[i]];
            a[i] = r->a_a[k * NA + i_g[i]];
        }
        if (!motors_behind(&g, r->tau + at, r->late + at, q, v, a, r->q_m + k * NM, r->v_m + k * NM, r->tau_m + k * NM,
                space)) {
            return MODEL_RESULT_NOT_FINITE;
        }
        copy(a, NG, r->twist + at); /* for `unevenness`; the static twists have served */
    }
    return MODEL_OK;
}

#endif
