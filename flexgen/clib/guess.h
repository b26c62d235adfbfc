/*
 * model: what may be asked of a whole path, and the mesh that a solver starts from; private.
 */
#ifndef MODEL_GUESS_H
#define MODEL_GUESS_H

#include "model_mesh.h"
#include "model_path.h"

enum { MOST_SAMPLES = 1000000 };

static inline int sizes_fit(int n, int lead, int tail, int every)
{
    return n >= 2 && lead >= 0 && tail >= 0 && every >= 1 && n <= MOST_SAMPLES && lead <= MOST_SAMPLES &&
        tail <= MOST_SAMPLES && every <= MOST_SAMPLES;
}

/* Whether so many numbers can be addressed, which on small machines not all sizes can. */
static inline int is_addressable(int64_t numbers)
{
    return numbers <= (int64_t)(PTRDIFF_MAX / (ptrdiff_t)sizeof(real));
}

static const real resting = 1e-6; /* of the fastest rate: what an end that is at rest may move */

/*
 * Whether a path and the guess of its start are finite, its rotations rotations, near to each other, and its ends at
 * rest.
 */
static inline int check_path(const path *p, const real *q_start)
{
    for (int k = 0; k < p->n; ++k) {
        if (!is_finite(p->place + k * (ptrdiff_t)NT, NT) || !is_finite(p->rate + k * (ptrdiff_t)NY, NY) ||
            !is_finite(p->rate2 + k * (ptrdiff_t)NY, NY)) {
            return MODEL_INPUT_NOT_FINITE;
        }
    }
    if (!is_finite(q_start, NA)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    {
        real most = 0.0;
        for (int k = 0; k < p->n; ++k) {
            most = fmax_1(most, largest(p->rate + k * (ptrdiff_t)NY, NY));
        }
        if (!(largest(p->rate, NY) <= resting * most) ||
            !(largest(p->rate + (p->n - 1) * (ptrdiff_t)NY, NY) <= resting * most)) {
            return MODEL_BAD_ARGUMENT;
        }
    }
#if MODEL_POSE
    for (int k = 0; k < p->n; ++k) {
        const real *R = p->place + k * (ptrdiff_t)NT + 3;
        if (!is_rotation(R) || (k > 0 && !are_near(R - NT, R))) {
            return MODEL_BAD_ARGUMENT;
        }
    }
#endif
    return MODEL_OK;
}

#if MODEL_NE > 0

/*
 * The path at the Gauss points, `every` samples to an interval, and joints that follow it as if nothing deflected
 * further than at rest at q, where all nodes stand.
 */
static inline int guess_mesh(mesh *m, const path *p, const real *q, int lead, int every, arm_points *arm, real *space)
{
    real last[NG];
    for (ptrdiff_t k = 0; k <= m->N; ++k) {
        for (int i = 0; i < NE; ++i) {
            m->y[k * STATES + i] = q[i_e[i]];
            m->y[k * STATES + NE + i] = 0.0;
        }
    }
    for (ptrdiff_t k = 0; k < (ptrdiff_t)m->N * CONTROLS; ++k) {
        m->a[k] = 0.0;
    }
    for (int i = 0; i < NG; ++i) {
        last[i] = q[i_g[i]];
    }
    for (int at = 0; at < m->N * STAGES; at += POINTS) {
        const int used = m->N * STAGES - at < POINTS ? m->N * STAGES - at : (int)POINTS;
        int status;
        for (int k = at; k < at + used; ++k) {
            const real x = (k / STAGES + gauss_c[k % STAGES]) * every - lead;
            const int whole = (int)(x < 0.0 ? x - 1.0 : x);
            reference_at(p, whole, x - whole, m->reference + (ptrdiff_t)k * REFERENCE);
            for (int i = 0; i < NG; ++i) {
                m->q_g[(ptrdiff_t)k * NG + i] = last[i];
            }
        }
        for (int point = 0; point < POINTS; ++point) {
            load_point(m, at + (point < used ? point : used - 1), arm, point);
        }
        status = follow(arm, space);
        if (status != MODEL_OK) {
            return status;
        }
        for (int k = 0; k < used; ++k) {
            for (int i = 0; i < NG; ++i) {
                last[i] = arm->q[i_g[i]][k];
                m->q_g[(ptrdiff_t)(at + k) * NG + i] = last[i];
            }
        }
    }
    return MODEL_OK;
}

#endif
#endif
