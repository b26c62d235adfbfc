/*
 * elbow: the motion of the coordinates without motor over a mesh of intervals; private.
 */
#ifndef ELBOW_MESH_H
#define ELBOW_MESH_H

#include "elbow_reduced_problem.h"

#if ELBOW_NE > 0

enum {
    CONTROLS = STAGES * NE, /* accelerations in an interval, the controls */
    STATES = 2 * NE         /* coordinates and speeds at a node */
};

/* Mesh and unknowns; all arrays belong to the caller. */
typedef struct {
    int N;                   /* intervals */
    int varying;             /* the intervals after so many are all at the end of the path, at rest */
    int factored;            /* so many have a factor of their own; the others share that of an endless equilibrium */
    real h;                  /* their length */
    real *y;                 /* (N + 1) x STATES: at the nodes */
    real *a;                 /* N x STAGES x NE */
    real *q_g;               /* N x STAGES x NG: at the Gauss points */
    real *reference;         /* N x STAGES x REFERENCE: the path there */
    real *target_state;      /* (N + 1) x STATES: targets of the nodes; NULL: their present states */
    const real *equilibrium; /* STATES: target of the last node where target_state is NULL; NULL: its present state */
    real *factor;            /* N x CONTROLS x WIDTH: rows of the elimination, pivots inverted on the diagonal */
    int base;                /* where the factors begin: that of interval k is number (base + k) modulo N */
    real *scale;             /* NE: torque of a row */
    const real *end;         /* STATES x STATES: weight of the last node; NULL: the regularization */
    real residual;           /* out: largest |R / s_r| */
} mesh;

/* Number of what is stored for interval k. */
static inline ptrdiff_t slot_of(const mesh *m, ptrdiff_t k)
{
    const ptrdiff_t at = m->base + k;
    return at < m->N ? at : at - m->N;
}

/* Coordinates and speeds at a Gauss point from the node before and the accelerations of the interval. */
static inline void stage_state(const real *y, const real *a, real h, int s, real *q, real *v)
{
    for (int i = 0; i < NE; ++i) {
        real once = 0.0, twice = 0.0;
        for (int j = 0; j < STAGES; ++j) {
            real A2 = 0.0;
            for (int k = 0; k < STAGES; ++k) {
                A2 += gauss_A[s][k] * gauss_A[k][j];
            }
            once += gauss_A[s][j] * a[j * NE + i];
            twice += A2 * a[j * NE + i];
        }
        q[i] = y[i] + h * gauss_c[s] * y[NE + i] + h * h * twice;
        v[i] = y[NE + i] + h * once;
    }
}

/* Coordinates and speeds at the next node. */
static inline void next_node(const real *y, const real *a, real h, real *next)
{
    for (int i = 0; i < NE; ++i) {
        real once = 0.0, twice = 0.0;
        for (int j = 0; j < STAGES; ++j) {
            once += gauss_b[j] * a[j * NE + i];
            twice += gauss_b[j] * (1.0 - gauss_c[j]) * a[j * NE + i];
        }
        next[i] = y[i] + h * y[NE + i] + h * h * twice;
        next[NE + i] = y[NE + i] + h * once;
    }
}

/*
 * The motion from rest at the first node to rest at q_end (NE) at the last varying one, by a polynomial of degree five
 * of the time; at rest from there on.
 */
static inline void move_smoothly(mesh *m, const real *q_end)
{
    const real whole = (real)m->varying * m->h;
    real q_start[NE];
    for (int i = 0; i < NE; ++i) {
        q_start[i] = m->y[i];
    }
    for (ptrdiff_t k = 0; k < m->N; ++k) {
        real *y = m->y + k * STATES, *a = m->a + k * CONTROLS;
        for (int s = 0; s < STAGES; ++s) {
            const real x = ((real)k + gauss_c[s]) / (real)m->varying;
            const real bend = k < m->varying ? 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (whole * whole) : 0.0;
            for (int i = 0; i < NE; ++i) {
                a[s * NE + i] = bend * (q_end[i] - q_start[i]);
            }
        }
        if (k + 1 < m->varying) {
            next_node(y, a, m->h, y + STATES);
        } else {
            for (int i = 0; i < NE; ++i) {
                y[STATES + i] = q_end[i];
                y[STATES + NE + i] = 0.0;
            }
        }
    }
}

/* Copy Gauss point number `at` (of all) into point l. */
static inline void load_point(const mesh *m, int at, problem_points *p, int l)
{
    const int k = at / STAGES, s = at % STAGES;
    const real *a = m->a + (ptrdiff_t)k * CONTROLS;
    real q[NE], v[NE];
    stage_state(m->y + (ptrdiff_t)k * STATES, a, m->h, s, q, v);
    load_elastic(p, l, q, v, a + s * NE);
    load_joints(p, l, m->q_g + (ptrdiff_t)at * NG);
    load_reference(p, l, m->reference + (ptrdiff_t)at * REFERENCE);
}

#endif

#endif
