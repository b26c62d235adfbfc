/*
 * model: a small quadratic program with soft limits, by a fixed number of splitting steps; private.
 *
 *     min  z' H z / 2 + g' z + price * sum_i dist(x_i + (A z)_i, [-1, 1])
 *
 * Where the price exceeds the multipliers, the limits are kept where that is possible, and exceeded as little as
 * possible elsewhere: there is always a solution. Alternating directions: one factorization, then two triangular solves
 * and a projection per step.
 *
 * Source: B. Stellato et al., Mathematical Programming Computation 12, 2020 (OSQP); N. Parikh, S. Boyd, Proximal
 * Algorithms, 2014, sec. 6.
 */
#ifndef MODEL_QP_H
#define MODEL_QP_H

#include "model_inversion_common.h"

static const real equilibrium_of_springs = 1.6; /* over-relaxation */
/* weight of the change per step, relative to the mean diagonal of H */
static const real proximal_weight = PRECISE(1e-9, 1e-6);

/* A quadratic program and its memory; all arrays belong to the caller. */
typedef struct {
    int n, rows;
    real *H;        /* n x n, symmetric; overwritten */
    real *g;        /* n; overwritten */
    real *A;        /* rows x n; overwritten */
    const real *x;  /* rows */
    real *y;        /* rows: multipliers in units of the cost, kept from call to call */
    real *z;        /* n: the solution */
    real *K;        /* n x n */
    real *w, *v;    /* rows */
    real *b;        /* n */
    real violation; /* out: largest violation of the limits */
} qp;

/* K = L L' in the lower triangle, rows `stride` apart, diagonal inverted; 0 where a pivot is not positive. */
static inline int factor_qp(real *K, int n, int stride)
{
    for (int k = 0; k < n; ++k) {
        for (int i = k; i < n; ++i) {
            real sum = K[i * stride + k];
            for (int j = 0; j < k; ++j) {
                sum -= K[i * stride + j] * K[k * stride + j];
            }
            if (i > k) {
                K[i * stride + k] = sum * K[k * stride + k];
            } else if (sum > 0.0) {
                K[k * stride + k] = 1.0 / square_root(sum);
            } else {
                return 0;
            }
        }
    }
    return 1;
}

static inline void solve_qp(const real *K, int n, int stride, real *b)
{
    for (int i = 0; i < n; ++i) {
        real sum = b[i];
        for (int j = 0; j < i; ++j) {
            sum -= K[i * stride + j] * b[j];
        }
        b[i] = sum * K[i * stride + i];
    }
    for (int i = n - 1; i >= 0; --i) {
        b[i] *= K[i * stride + i];
        for (int j = 0; j < i; ++j) {
            b[j] -= K[i * stride + j] * b[i];
        }
    }
}

/* The solution after the given number of steps; 0 where a number is not finite. */
static inline int run_qp(qp *p, real price, int steps)
{
    const int n = p->n, rows = p->rows;
    real size = 0.0, cost = 0.0, unit;
    for (int i = 0; i < rows * n; ++i) {
        size += p->A[i] * p->A[i];
    }
    /* scale of z: the mean length of the columns of A becomes one */
    unit = size > 0.0 ? 1.0 / square_root(size / (real)n) : 1.0;
    for (int i = 0; i < n; ++i) {
        cost += p->H[i * n + i] * unit * unit;
    }
    cost = cost > 0.0 ? (real)n / cost : 1.0; /* and the diagonal of H too */
    for (int i = 0; i < n; ++i) {
        p->g[i] *= unit * cost;
        p->z[i] = 0.0;
        for (int j = 0; j <= i; ++j) {
            p->H[i * n + j] *= unit * unit * cost;
            p->K[i * n + j] = p->H[i * n + j] + (i == j ? proximal_weight : 0.0);
        }
    }
    for (int r = 0; r < rows; ++r) {
        real *a = p->A + r * n;
        for (int i = 0; i < n; ++i) {
            a[i] *= unit;
        }
        for (int i = 0; i < n; ++i) {
            for (int j = 0; j <= i; ++j) {
                p->K[i * n + j] += a[i] * a[j];
            }
        }
        p->y[r] *= cost;
        p->w[r] = fmin_1(fmax_1(0.0, -1.0 - p->x[r]), 1.0 - p->x[r]);
    }
    if (!factor_qp(p->K, n, n)) {
        return 0;
    }
    price *= cost;
    for (int step = 0; step < steps; ++step) {
        for (int i = 0; i < n; ++i) {
            p->b[i] = proximal_weight * p->z[i] - p->g[i];
        }
        for (int r = 0; r < rows; ++r) {
            const real pull = p->w[r] - p->y[r];
            for (int i = 0; i < n; ++i) {
                p->b[i] += pull * p->A[r * n + i];
            }
        }
        solve_qp(p->K, n, n, p->b);
        for (int i = 0; i < n; ++i) {
            p->z[i] = p->b[i];
        }
        for (int r = 0; r < rows; ++r) {
            real sum = 0.0, to, near;
            for (int i = 0; i < n; ++i) {
                sum += p->A[r * n + i] * p->z[i];
            }
            p->v[r] = sum;
            sum = equilibrium_of_springs * sum + (1.0 - equilibrium_of_springs) * p->w[r];
            to = sum + p->y[r];
            near = fmin_1(fmax_1(to, -1.0 - p->x[r]), 1.0 - p->x[r]);
            if (to - near > price) {
                near = to - price;
            } else if (to - near < -price) {
                near = to + price;
            }
            p->w[r] = near;
            p->y[r] = to - near;
        }
    }
    p->violation = 0.0;
    for (int r = 0; r < rows; ++r) {
        p->violation = fmax_1(p->violation, fabs_1(p->x[r] + p->v[r]) - 1.0);
        p->y[r] /= cost;
    }
    for (int i = 0; i < n; ++i) {
        p->z[i] *= unit;
    }
    return is_finite(p->z, n) && is_finite(p->y, rows);
}

#endif
