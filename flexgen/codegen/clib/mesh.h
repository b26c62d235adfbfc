/*
 * model: the motion of the coordinates without motor over a mesh of intervals; private.
 */
#ifndef MODEL_MESH_H
#define MODEL_MESH_H

#include "model_inversion_common.h"
#include "model_path.h"
#include "model_reduced_problem.h"

#if MODEL_NE > 0

enum {
    CONTROLS = STAGES * NE, /* accelerations in an interval, the controls */
    STATES = 2 * NE         /* coordinates and speeds at a node */
};

/* Mesh and unknowns; all arrays belong to the caller. */
typedef struct {
    int N; /* intervals */
    /* the intervals after so many are all at the end of the path, at rest */
    int varying;
    /* so many have a factor of their own; the others share that of an endless equilibrium */
    int factored;
    real h;          /* their length */
    real *y;         /* (N + 1) x STATES: at the nodes */
    real *a;         /* N x STAGES x NE */
    real *q_g;       /* N x STAGES x NG: at the Gauss points */
    real *reference; /* N x STAGES x REFERENCE: the path there */
    /* (N + 1) x STATES: targets of the nodes; NULL: their present states */
    real *target_state;
    /* STATES: target of the last node where target_state is NULL; NULL: its present state */
    const real *equilibrium;
    /* N x CONTROLS x WIDTH: rows of the elimination, pivots inverted on the diagonal */
    real *factor;
    /* where the factors begin: that of interval k is number (base + k) modulo N */
    int base;
    real *scale; /* NE: torque of a row */
    /* STATES x STATES: weight of the last node; NULL: the regularization */
    const real *end;
    real residual; /* out: largest |R / s_r| */
} mesh;

/* Number of what is stored for interval k. */
static inline ptrdiff_t slot_of(const mesh *m, ptrdiff_t k)
{
    const ptrdiff_t at = m->base + k;
    return at < m->N ? at : at - m->N;
}

/*
 * Coordinates and speeds at a Gauss point from the node before and the accelerations of the
 * interval.
 */
static inline void stage_state(const real *y, const real *a, real h, int s, real *q, real *v)
{
    for (int i = 0; i < NE; ++i) {
        real once = 0.0, twice = 0.0;
        for (int j = 0; j < STAGES; ++j) {
#if MODEL_DIRECT
            const real A2 = gauss_AA[s][j];
#else  /* MODEL_DIRECT */
            real A2 = 0.0;
            for (int k = 0; k < STAGES; ++k) {
                A2 += gauss_A[s][k] * gauss_A[k][j];
            }
#endif /* MODEL_DIRECT */
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
 * The motion from rest at the first node to rest at q_end (NE) at the last varying one, by a
 * polynomial of degree five of the time; at rest from there on.
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
            const real bend = k < m->varying ?
                                  60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (whole * whole) :
                                  0.0;
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

/*
 * --- The motion between the Gauss points and nodes of a mesh.
 */

#if MODEL_NE > 0

/* Second derivative at x of x^3 (1 - x)^3 x^k, and the two lower ones. */
static inline void bump(real x, int k, real out[3])
{
    static const real c[4] = {1.0, -3.0, 3.0, -1.0};
    out[0] = out[1] = out[2] = 0.0;
    for (int i = 3; i >= 0; --i) {
        const int degree = 3 + i + k;
        real power = c[i];
        for (int j = 0; j < degree - 2; ++j) {
            power *= x;
        }
        out[0] += power * x * x;
        out[1] += (real)degree * power * x;
        out[2] += (real)(degree * (degree - 1)) * power;
    }
}

/*
 * Coordinates in an interval: the polynomial with value, two derivatives at its nodes and a_e at
 * its Gauss points. It is linear in y1 - y0, v0, v1, a0, a1 and the accelerations at the Gauss
 * points.
 */
enum { TERMS = 5 + STAGES };

typedef struct {
    /* what each of them adds of each bump, for an interval of length 1 */
    real bumps[STAGES][TERMS];
} interpolant;

/* The quintic of one of its terms: value and two derivatives at x. */
static inline void quintic_term(int term, real x, real out[3])
{
    real left[3] = {0.0, 0.0, 0.0}, right[3] = {0.0, 0.0, 0.0};
    if (term == 0) {
        right[0] = 1.0;
    } else if (term < 5) {
        *(term % 2 == 1 ? left + (term + 1) / 2 : right + term / 2) = 1.0;
    }
    quintic(x, left, right, out);
}

MODEL_INLINE void prepare(interpolant *f)
{
    real a[STAGES][STAGES + TERMS];
    for (int i = 0; i < STAGES; ++i) {
        real out[3];
        for (int j = 0; j < STAGES; ++j) {
            bump(gauss_c[i], j, out);
            a[i][j] = out[2];
        }
        /* what the quintic misses at the Gauss points */
        for (int term = 0; term < TERMS; ++term) {
            quintic_term(term, gauss_c[i], out);
            a[i][STAGES + term] = (term == 5 + i ? 1.0 : 0.0) - out[2];
        }
    }
    (void)solve_plain(&a[0][0], STAGES, STAGES + TERMS); /* regular */
    for (int i = 0; i < STAGES; ++i) {
        copy(a[i] + STAGES, TERMS, f->bumps[i]);
    }
}

/*
 * Weights of the terms in value, speed and acceleration at x, 0 <= x <= 1, of an interval of
 * length h.
 */
MODEL_INLINE void weights_at(const interpolant *f, real h, real x, real weight[3 * TERMS])
{
    /* of h that makes a term a position */
    static const int power[TERMS] = {0, 1, 1, 2, 2, 2, 2, 2};
    real bumps[STAGES][3];
    for (int i = 0; i < STAGES; ++i) {
        bump(x, i, bumps[i]);
    }
    for (int term = 0; term < TERMS; ++term) {
        real out[3];
        quintic_term(term, x, out);
        for (int order = 0; order < 3; ++order) {
            for (int i = 0; i < STAGES; ++i) {
                out[order] += f->bumps[i][term] * bumps[i][order];
            }
            for (int i = order; i < power[term]; ++i) {
                out[order] *= h;
            }
            for (int i = power[term]; i < order; ++i) {
                out[order] /= h;
            }
            weight[order * TERMS + term] = out[order];
        }
    }
}

/*
 * Accelerations at the nodes: the polynomial through the Gauss points on both sides; zero at the
 * first node.
 */
static inline void nodal_accelerations(const mesh *m, real *a_node)
{
    real weight[2 * STAGES], end[STAGES];
    for (int i = 0; i < 2 * STAGES; ++i) {
        const real x = i < STAGES ? gauss_c[i] - 1.0 : gauss_c[i - STAGES];
        weight[i] = 1.0;
        for (int j = 0; j < 2 * STAGES; ++j) {
            const real other = j < STAGES ? gauss_c[j] - 1.0 : gauss_c[j - STAGES];
            if (j != i) {
                weight[i] *= other / (other - x);
            }
        }
    }
    for (int i = 0; i < STAGES; ++i) {
        end[i] = 1.0;
        for (int j = 0; j < STAGES; ++j) {
            if (j != i) {
                end[i] *= (1.0 - gauss_c[j]) / (gauss_c[i] - gauss_c[j]);
            }
        }
    }
    for (int k = 0; k <= m->N; ++k) {
        const real *right = m->a + (ptrdiff_t)k * CONTROLS;
        const real *left = right - CONTROLS;
        for (int i = 0; i < NE; ++i) {
            real sum = 0.0;
            for (int s = 0; s < STAGES; ++s) {
                if (k == m->N) {
                    sum += end[s] * left[s * NE + i];
                } else {
                    sum += (k > 0 ? weight[s] * left[s * NE + i] : 0.0) +
                           weight[STAGES + s] * right[s * NE + i];
                }
            }
            a_node[(ptrdiff_t)k * NE + i] = k == 0 ? 0.0 : sum;
        }
    }
}

/*
 * Joints between the Gauss points of two intervals: the polynomial through all of them. Its
 * weights in value, velocity and acceleration at x, -1 <= x <= 1, intervals of length h before and
 * after 0.
 */
enum { JOINTS = 2 * STAGES };

static inline void joint_weights_at(real h, real x, real weight[3 * JOINTS])
{
    real at[JOINTS];
    for (int i = 0; i < JOINTS; ++i) {
        at[i] = i < STAGES ? gauss_c[i] - 1.0 : gauss_c[i - STAGES];
    }
    for (int i = 0; i < JOINTS; ++i) {
        real value = 1.0, once = 0.0, twice = 0.0; /* of the product of the factors so far */
        for (int j = 0; j < JOINTS; ++j) {
            if (j != i) {
                const real slope = 1.0 / (at[i] - at[j]), factor = (x - at[j]) * slope;
                twice = twice * factor + 2.0 * once * slope;
                once = once * factor + value * slope;
                value *= factor;
            }
        }
        weight[i] = value;
        weight[JOINTS + i] = once / h;
        weight[2 * JOINTS + i] = twice / (h * h);
    }
}

/*
 * A guess of the joints into point l, from those at the Gauss points of two intervals by these
 * weights.
 */
static inline void load_joints_between(
    const real *q_g, const real *weight, problem_points *arm, int l)
{
    for (int begin = 0; begin < NG; begin += LANES) { /* a vector may read beyond them */
        real out[3][LANES];
        for (int order = 0; order < 3; ++order) {
            lanes sum = splat_v(0.0);
            for (int j = 0; j < JOINTS; ++j) {
                sum += splat_v(weight[order * JOINTS + j]) * load_v(q_g + j * NG + begin);
            }
            store_v(out[order], sum);
        }
        for (int i = begin; i < NG && i < begin + LANES; ++i) {
            arm->q[i_g[i]][l] = out[0][i - begin];
            arm->v[i_g[i]][l] = out[1][i - begin];
            arm->a[i_g[i]][l] = out[2][i - begin];
        }
    }
}

/*
 * Unactuated coordinates, velocities and accelerations where an interval has these weights, into
 * point l.
 */
static inline void load_between(const mesh *m, const real *a_node, const real *weight,
    ptrdiff_t interval, problem_points *arm, int l)
{
    const real *y0 = m->y + interval * STATES, *y1 = y0 + STATES;
    const real *a0 = a_node + interval * NE, *a1 = a0 + NE, *a = m->a + interval * CONTROLS;
    real out[3][NE];
    int i = 0;
    while (i < NE) { /* the last vector begins earlier, so that it ends with the last coordinate */
        if (NE >= LANES) {
            const int at = i + LANES <= NE ? i : NE - LANES;
            lanes term[TERMS];
            term[0] = load_v(y1 + at) - load_v(y0 + at);
            term[1] = load_v(y0 + NE + at);
            term[2] = load_v(y1 + NE + at);
            term[3] = load_v(a0 + at);
            term[4] = load_v(a1 + at);
            for (int s = 0; s < STAGES; ++s) {
                term[5 + s] = load_v(a + s * NE + at);
            }
            for (int order = 0; order < 3; ++order) {
                lanes sum = order == 0 ? load_v(y0 + at) : splat_v(0.0);
                for (int j = 0; j < TERMS; ++j) {
                    sum += splat_v(weight[order * TERMS + j]) * term[j];
                }
                store_v(out[order] + at, sum);
            }
            i += LANES;
        } else {
            real term[TERMS];
            term[0] = y1[i] - y0[i];
            term[1] = y0[NE + i];
            term[2] = y1[NE + i];
            term[3] = a0[i];
            term[4] = a1[i];
            for (int s = 0; s < STAGES; ++s) {
                term[5 + s] = a[s * NE + i];
            }
            for (int order = 0; order < 3; ++order) {
                real sum = order == 0 ? y0[i] : 0.0;
                for (int j = 0; j < TERMS; ++j) {
                    sum += weight[order * TERMS + j] * term[j];
                }
                out[order][i] = sum;
            }
            ++i;
        }
    }
    load_elastic(arm, l, out[0], out[1], out[2]);
}

#endif

#endif
