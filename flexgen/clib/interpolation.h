/*
 * model: the motion between the Gauss points and nodes of a mesh; private.
 */
#ifndef MODEL_INTERPOLATION_H
#define MODEL_INTERPOLATION_H

#include "model_dense.h"
#include "model_mesh.h"
#include "model_path.h"

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

/* Coordinates in an interval: the polynomial with value, two derivatives at its nodes and a_e at its Gauss points. */
typedef struct {
    real inverse[STAGES][STAGES];
} interpolant;

static inline void prepare(interpolant *f)
{
    real a[STAGES][2 * STAGES];
    for (int i = 0; i < STAGES; ++i) {
        for (int j = 0; j < STAGES; ++j) {
            real out[3];
            bump(gauss_c[i], j, out);
            a[i][j] = out[2];
            a[i][STAGES + j] = i == j ? 1.0 : 0.0;
        }
    }
    (void)solve_plain(&a[0][0], STAGES, 2 * STAGES); /* regular */
    for (int i = 0; i < STAGES; ++i) {
        copy(a[i] + STAGES, STAGES, f->inverse[i]);
    }
}

/* Value and two derivatives, times h and h^2, at x of an interval of length h. */
static inline void between(const interpolant *f, const real left[3], const real right[3], const real *a,
    ptrdiff_t stride, real h, real x, real out[3])
{
    real miss[STAGES], own[3];
    for (int i = 0; i < STAGES; ++i) {
        quintic(gauss_c[i], left, right, own);
        miss[i] = h * h * a[i * stride] - own[2];
    }
    quintic(x, left, right, out);
    for (int i = 0; i < STAGES; ++i) {
        real weight = 0.0;
        for (int j = 0; j < STAGES; ++j) {
            weight += f->inverse[i][j] * miss[j];
        }
        bump(x, i, own);
        for (int j = 0; j < 3; ++j) {
            out[j] += weight * own[j];
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

/* Unactuated coordinates, velocities and accelerations at x, 0 <= x <= 1, of an interval, into point l. */
static inline void load_between(
    const mesh *m, const real *a_node, const interpolant *f, ptrdiff_t interval, real x, problem_points *arm, int l)
{
    const real h = m->h;
    const real *y0 = m->y + interval * STATES, *y1 = y0 + STATES;
    const real *a0 = a_node + interval * NE, *a1 = a0 + NE;
    real q[NE], v[NE], a[NE];
    for (int i = 0; i < NE; ++i) {
        const real left[3] = {y0[i], h * y0[NE + i], h * h * a0[i]};
        const real right[3] = {y1[i], h * y1[NE + i], h * h * a1[i]};
        real out[3];
        between(f, left, right, m->a + interval * CONTROLS + i, NE, h, x, out);
        q[i] = out[0];
        v[i] = out[1] / h;
        a[i] = out[2] / (h * h);
    }
    load_elastic(arm, l, q, v, a);
}

#endif

#endif
