/*
 * elbow: the motion between the Gauss points and nodes of a mesh; private.
 */
#ifndef ELBOW_INTERPOLATION_H
#define ELBOW_INTERPOLATION_H

#include "elbow_dense.h"
#include "elbow_mesh.h"
#include "elbow_path.h"

#if ELBOW_NE > 0

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
 * Coordinates in an interval: the polynomial with value, two derivatives at its nodes and a_e at its Gauss points. It
 * is linear in y1 - y0, v0, v1, a0, a1 and the accelerations at the Gauss points.
 */
enum { TERMS = 5 + STAGES };

typedef struct {
    real bumps[STAGES][TERMS]; /* what each of them adds of each bump, for an interval of length 1 */
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

static inline void prepare(interpolant *f)
{
    real a[STAGES][STAGES + TERMS];
    for (int i = 0; i < STAGES; ++i) {
        real out[3];
        for (int j = 0; j < STAGES; ++j) {
            bump(gauss_c[i], j, out);
            a[i][j] = out[2];
        }
        for (int term = 0; term < TERMS; ++term) { /* what the quintic misses at the Gauss points */
            quintic_term(term, gauss_c[i], out);
            a[i][STAGES + term] = (term == 5 + i ? 1.0 : 0.0) - out[2];
        }
    }
    (void)solve_plain(&a[0][0], STAGES, STAGES + TERMS); /* regular */
    for (int i = 0; i < STAGES; ++i) {
        copy(a[i] + STAGES, TERMS, f->bumps[i]);
    }
}

/* Weights of the terms in value, speed and acceleration at x, 0 <= x <= 1, of an interval of length h. */
static inline void weights_at(const interpolant *f, real h, real x, real weight[3 * TERMS])
{
    static const int power[TERMS] = {0, 1, 1, 2, 2, 2, 2, 2}; /* of h that makes a term a position */
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

/* Accelerations at the nodes: the polynomial through the Gauss points on both sides; zero at the first node. */
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
                    sum += (k > 0 ? weight[s] * left[s * NE + i] : 0.0) + weight[STAGES + s] * right[s * NE + i];
                }
            }
            a_node[(ptrdiff_t)k * NE + i] = k == 0 ? 0.0 : sum;
        }
    }
}

/*
 * Joints between the Gauss points of two intervals: the polynomial through all of them. Its weights in value, velocity
 * and acceleration at x, -1 <= x <= 1, intervals of length h before and after 0.
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

/* A guess of the joints into point l, from those at the Gauss points of two intervals by these weights. */
static inline void load_joints_between(const real *q_g, const real *weight, problem_points *arm, int l)
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

/* Unactuated coordinates, velocities and accelerations where an interval has these weights, into point l. */
static inline void load_between(
    const mesh *m, const real *a_node, const real *weight, ptrdiff_t interval, problem_points *arm, int l)
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
