/*
 * elbow: a quadratic program with limits that may be exceeded at a price, by an interior point method; private.
 *
 *     min  z' H z / 2 + g' z + price * s    s.t.  x_r + A_r z <= 1 + s,    s >= 0
 *
 * There is always a solution, and s is zero where all limits can be kept and the price exceeds the multipliers.
 *
 * Source: S. Mehrotra, SIAM Journal on Optimization 2(4), 1992; J. Nocedal, S. Wright, Numerical Optimization, 2006,
 * ch. 16.6.
 */
#ifndef ELBOW_INTERIOR_POINT_H
#define ELBOW_INTERIOR_POINT_H

#include "elbow_qp.h"

enum { IP_STEPS = 80 };

static const real ip_accuracy = 1e-9;   /* of the limits */
static const real ip_gap = 1e-13;       /* of the price: complementarity at the solution */
static const real ip_gap_enough = 1e-9; /* the same, where the steps have no effect any more */
static const real ip_boundary = 0.9995; /* part of the step to the boundary */

/*
 * The program and its memory; all arrays belong to the caller. `stride`: n + 1, rounded up to whole vectors. A row has
 * the numbers of A, then -1 for s, then zeros; the last row is that of s >= 0. Only its columns from `first` are not
 * zero, of the columns before n.
 */
typedef struct {
    int n, rows, stride; /* rows without that of s */
    const real *H;       /* n x n, positive definite */
    const real *g;       /* n */
    const real *A;       /* (rows + 1) x stride */
    const real *x;       /* rows */
    const int *range;    /* 2 for each row: first column that is not zero, and the column after the last one */
    real price;
    real *z;                                                 /* stride: the solution, then s */
    real *K;                                                 /* stride x stride */
    real *step;                                              /* stride */
    real *dual, *slack, *d_dual, *d_slack, *primal, *scaled; /* rows + 1 each */
} interior_point;

/* A_r z - s of row r; -s of the last one. */
static inline real ip_row(const interior_point *p, int r, const real *z)
{
    const real *a = p->A + (ptrdiff_t)r * p->stride;
    real sum = -z[p->n];
    for (int i = p->range[2 * r]; i < p->range[2 * r + 1]; ++i) {
        sum += a[i] * z[i];
    }
    return sum;
}

/* Sum of products from a column to another one; BLOCK partial sums, so that the bits are those of any vector width. */
static inline real ip_dot(const real *a, const real *b, int from, int to)
{
    lanes sums[BLOCK / LANES];
    real parts[BLOCK], sum = 0.0;
    int j = from;
    for (int k = 0; k < BLOCK / LANES; ++k) {
        sums[k] = splat_v(0.0);
    }
    for (; j + BLOCK <= to; j += BLOCK) {
        for (int k = 0; k < BLOCK / LANES; ++k) {
            sums[k] += load_v(a + j + k * LANES) * load_v(b + j + k * LANES);
        }
    }
    for (int k = 0; k < BLOCK / LANES; ++k) {
        store_v(parts + k * LANES, sums[k]);
    }
    for (; j < to; ++j) {
        sum += a[j] * b[j];
    }
    for (int k = 0; k < BLOCK; ++k) {
        sum += parts[k];
    }
    return sum;
}

/*
 * K = L L' in the lower triangle, as factor_qp; entries before the first one of a row that is not zero stay zero. 0
 * where a pivot is not positive.
 */
static inline int ip_cholesky(real *K, int n, int stride)
{
    for (int i = 0; i < n; ++i) {
        real *row = K + (ptrdiff_t)i * stride;
        int first = 0;
        while (first < i && !(fabs_1(row[first]) > 0.0)) {
            ++first;
        }
        for (int k = first; k < i; ++k) {
            const real *top = K + (ptrdiff_t)k * stride;
            row[k] = (row[k] - ip_dot(row, top, first, k)) * top[k];
        }
        row[i] -= ip_dot(row, row, first, i);
        if (!(row[i] > 0.0)) {
            return 0;
        }
        row[i] = 1.0 / square_root(row[i]);
    }
    return 1;
}

/* K = H + G' diag(dual / slack) G, factored; 0 where a pivot is not positive. The lower triangle is filled. */
static inline int ip_factor(interior_point *p)
{
    const int n = p->n, stride = p->stride;
    for (int i = 0; i <= n; ++i) {
        for (int j = 0; j < stride; ++j) {
            p->K[(ptrdiff_t)i * stride + j] = i < n && j < n ? p->H[(ptrdiff_t)i * n + j] : 0.0;
        }
    }
    for (int r = 0; r <= p->rows; ++r) {
        const real weight = p->dual[r] / p->slack[r];
        const real *a = p->A + (ptrdiff_t)r * stride;
        const int from = p->range[2 * r] / LANES * LANES, to = p->range[2 * r + 1];
        real *last = p->K + (ptrdiff_t)n * stride;
        for (int i = from; i < to; ++i) {
            const lanes scaled = splat_v(weight * a[i]);
            real *row = p->K + (ptrdiff_t)i * stride;
            for (int j = from; j <= i; j += LANES) { /* a spline acts on a part of the motion only */
                store_v(row + j, load_v(row + j) + scaled * load_v(a + j));
            }
            last[i] -= weight * a[i];
        }
        last[n] += weight;
    }
    return ip_cholesky(p->K, n + 1, stride);
}

/* The Newton step to complementarity `scaled`: K dz = -(H z + g + G' dual) - G' ((dual primal - scaled) / slack). */
static inline void ip_step(interior_point *p)
{
    const int n = p->n;
    for (int i = 0; i < n; ++i) {
        real sum = -p->g[i];
        for (int j = 0; j < n; ++j) {
            sum -= p->H[(ptrdiff_t)i * n + j] * p->z[j];
        }
        p->step[i] = sum;
    }
    p->step[n] = -p->price;
    for (int r = 0; r <= p->rows; ++r) {
        const real pull = p->dual[r] + (p->dual[r] * p->primal[r] - p->scaled[r]) / p->slack[r];
        const real *a = p->A + (ptrdiff_t)r * p->stride;
        for (int i = p->range[2 * r]; i < p->range[2 * r + 1]; ++i) {
            p->step[i] -= pull * a[i];
        }
        p->step[n] += pull;
    }
    solve_qp(p->K, n + 1, p->stride, p->step);
    for (int r = 0; r <= p->rows; ++r) {
        p->d_slack[r] = -p->primal[r] - ip_row(p, r, p->step);
        p->d_dual[r] = (-p->scaled[r] - p->dual[r] * p->d_slack[r]) / p->slack[r];
    }
}

/* The longest step, at most one, that keeps slacks and multipliers positive. */
static inline real ip_longest(const interior_point *p)
{
    real most = 1.0;
    for (int r = 0; r <= p->rows; ++r) {
        if (p->slack[r] + most * p->d_slack[r] < 0.0) {
            most = -p->slack[r] / p->d_slack[r];
        }
        if (p->dual[r] + most * p->d_dual[r] < 0.0) {
            most = -p->dual[r] / p->d_dual[r];
        }
    }
    return most;
}

/* Solve; 0 where it does not converge. */
static inline int solve_interior_point(interior_point *p)
{
    const int n = p->n, rows = p->rows + 1;
    int good = 0;
    for (int i = 0; i <= n; ++i) {
        p->z[i] = 0.0;
    }
    for (int r = 0; r < p->rows; ++r) {
        p->z[n] = fmax_1(p->z[n], p->x[r] - 1.0);
    }
    p->z[n] += 1.0;
    for (int r = 0; r < rows; ++r) {
        p->slack[r] = 1.0;
        p->dual[r] = p->price / (real)rows;
    }
    for (int step = 0; step < IP_STEPS; ++step) {
        real gap = 0.0, least, affine = 0.0, off = 0.0, length;
        for (int r = 0; r < rows; ++r) {
            const real room = r < p->rows ? 1.0 - p->x[r] : 0.0;
            p->primal[r] = ip_row(p, r, p->z) + p->slack[r] - room;
            gap += p->dual[r] * p->slack[r];
            off = fmax_1(off, fabs_1(p->primal[r]));
        }
        gap /= (real)rows;
        good = gap * (real)rows <= ip_gap_enough * p->price && off <= ip_accuracy && is_finite(p->z, n + 1);
        if (good && gap * (real)rows <= ip_gap * p->price) {
            return 1;
        }
        if (!ip_factor(p)) {
            return good;
        }
        for (int r = 0; r < rows; ++r) {
            p->scaled[r] = p->dual[r] * p->slack[r];
        }
        ip_step(p); /* the affine step shows how far the gap can be closed */
        length = ip_longest(p);
        for (int r = 0; r < rows; ++r) {
            affine += (p->dual[r] + length * p->d_dual[r]) * (p->slack[r] + length * p->d_slack[r]);
        }
        affine /= (real)rows;
        least = affine / gap;
        least = least * least * least * gap;
        for (int r = 0; r < rows; ++r) {
            p->scaled[r] = p->dual[r] * p->slack[r] + p->d_dual[r] * p->d_slack[r] - least;
        }
        ip_step(p);
        length = ip_boundary * ip_longest(p);
        length = length > 1.0 ? 1.0 : length;
        for (int i = 0; i <= n; ++i) {
            p->z[i] += length * p->step[i];
        }
        for (int r = 0; r < rows; ++r) {
            p->slack[r] += length * p->d_slack[r];
            p->dual[r] += length * p->d_dual[r];
        }
    }
    return good;
}

#endif
