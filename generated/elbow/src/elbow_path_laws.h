/*
 * elbow: the table of a planned path, and its laws: distance along a curve over time; private to the path sampler.
 *
 * The layout of the table is in flexgen/paths/path_table.py. Every operation is that of flexgen/paths/, in the same
 * order, so that samples have the bits of Python's.
 */
#ifndef ELBOW_PATH_LAWS_H
#define ELBOW_PATH_LAWS_H

#include "elbow_inversion_common.h"

enum { JET = 3 }; /* a value and two derivatives */

/* What is not yet read of a block of the table. */
typedef struct {
    const real *at, *end;
} reader;

/* The next n numbers; null where the block has fewer. */
static inline const real *take(reader *r, ptrdiff_t n)
{
    const real *x = r->at;
    if (n < 0 || n > r->end - r->at) {
        return NULL;
    }
    r->at += n;
    return x;
}

/* The next number as a count from 0 to `most`; -1 where it is none. */
static inline int take_count(reader *r, int most)
{
    const real *x = take(r, 1);
    return x != NULL && *x >= 0.0 && *x <= (real)most && *x == (real)(int)*x ? (int)*x : -1;
}

/* The next block inside a block, which is skipped; 0 where there is none. */
static inline int take_block(reader *r, reader *block)
{
    const real *length = take(r, 1);
    if (length == NULL || !(*length >= 1.0 && *length - 1.0 <= (real)(r->end - r->at))) {
        return 0;
    }
    block->at = r->at;
    block->end = r->at + ((ptrdiff_t)*length - 1);
    r->at = block->end;
    return 1;
}

/* The last of `count` rising numbers that is not above x, counted from 0; 0 where all are. */
static inline int last_below(const real *x, int count, real value)
{
    int at = 0;
    for (int i = 1; i < count; ++i) {
        if (x[i] <= value) {
            at = i;
        }
    }
    return at;
}

static inline real clipped(real x, real low, real high)
{
    return x < low ? low : x > high ? high : x;
}

/* A polynomial step: coefficients of its integral, value and two derivatives in t / duration. */
typedef struct {
    real duration, scale;
    const real *power; /* powers 1 and 2 of the duration */
    const real *rows;  /* 4 x n */
    int n;
} polynomial;

enum { COEFFICIENTS_MAX = 64, PHASES_MAX = 100000 };

static inline int take_polynomial(reader *r, polynomial *p)
{
    const real *head = take(r, 4);
    if (head == NULL) {
        return 0;
    }
    p->duration = head[0];
    p->power = head + 1;
    p->scale = head[3];
    p->n = take_count(r, COEFFICIENTS_MAX);
    p->rows = p->n < 1 ? NULL : take(r, 4 * (ptrdiff_t)p->n);
    return p->rows != NULL;
}

static inline real horner(const polynomial *p, int row, real x)
{
    const real *c = p->rows + (ptrdiff_t)row * p->n;
    real sum = c[p->n - 1];
    for (int i = p->n - 2; i >= 0; --i) {
        sum = c[i] + sum * x;
    }
    return sum;
}

/* Value and two derivatives; at rest before 0 and after the duration. The second half mirrors the first. */
static inline void polynomial_at(const polynomial *p, real t, real out[JET])
{
    const real u = clipped(t / p->duration, 0.0, 1.0), x = u > 0.5 ? 1.0 - u : u;
    const int late = u > 0.5, inside = t > 0.0 && t < p->duration;
    const real value = horner(p, 1, x);
    out[0] = late ? 1.0 - value : value;
    out[1] = inside ? horner(p, 2, x) / p->power[0] : 0.0;
    out[2] = inside ? (late ? -1.0 : 1.0) * horner(p, 3, x) / p->power[1] : 0.0;
    for (int k = 0; k < JET; ++k) {
        out[k] = p->scale * out[k];
    }
}

/* Integral, value and first derivative. */
static inline void polynomial_integral(const polynomial *p, real t, real out[JET])
{
    const real held = clipped(t, 0.0, p->duration), u = held / p->duration;
    const int late = u > 0.5;
    const real value = horner(p, 0, late ? 1.0 - u : u);
    real law[JET];
    polynomial_at(p, held, law);
    out[0] = p->scale * (p->duration * (late ? (u - 0.5) + value : value));
    out[1] = law[0];
    out[2] = law[1];
}

/* The same of a step whose highest derivative is piecewise constant. */
static inline int trapezoid_integral(reader *r, real t, real out[JET])
{
    const real *duration = take(r, 1), *knots, *values, *left;
    const int count = take_count(r, COEFFICIENTS_MAX), size = take_count(r, COEFFICIENTS_MAX);
    real held, x, dt;
    int late;
    knots = count < 1 ? NULL : take(r, count);
    values = knots == NULL || size < 1 ? NULL : take(r, (ptrdiff_t)count * size);
    if (duration == NULL || values == NULL) {
        return 0;
    }
    held = clipped(t, 0.0, *duration);
    late = held > *duration / 2.0;
    x = late ? *duration - held : held;
    left = values + (ptrdiff_t)last_below(knots, count, x) * size;
    dt = x - knots[last_below(knots, count, x)];
    for (int j = 0; j < JET; ++j) {
        real sum = 0.0;
        for (int i = size - 1; i >= j; --i) {
            sum = left[i] + sum * dt / (real)(i - j + 1);
        }
        out[j] = late && j == 1 ? -sum : sum;
    }
    if (late) {
        out[0] += held - *duration / 2.0;
        out[1] += 1.0;
    }
    return 1;
}

/* Integral, value and first derivative of a step; 0 where the table is damaged. */
static inline int step_at(reader *r, real t, real out[JET])
{
    const int kind = take_count(r, 1);
    polynomial p;
    if (kind == 1) {
        return trapezoid_integral(r, t, out);
    }
    if (kind != 0 || !take_polynomial(r, &p)) {
        return 0;
    }
    polynomial_integral(&p, t, out);
    return 1;
}

/* Distance by phases of constant and of changing speed. */
static inline int phases_at(reader *r, real t, real s[JET])
{
    const real *scale = take(r, 3), *starts, *distances, *first, *last;
    const int m = take_count(r, PHASES_MAX);
    reader step = {NULL, NULL};
    real x, tau, part[JET];
    int at;
    starts = m < 1 ? NULL : take(r, (ptrdiff_t)m + 1);
    distances = starts == NULL ? NULL : take(r, (ptrdiff_t)m + 1);
    first = distances == NULL ? NULL : take(r, m);
    last = first == NULL ? NULL : take(r, m);
    if (scale == NULL || last == NULL) {
        return 0;
    }
    x = t / scale[0];
    s[0] = x > 0.0 ? distances[m] : 0.0;
    s[1] = s[2] = 0.0;
    if (!(x > 0.0 && x < starts[m])) {
        return 1;
    }
    at = last_below(starts, m, x);
    for (int k = 0; k <= at; ++k) {
        if (!take_block(r, &step)) {
            return 0;
        }
    }
    tau = x - starts[at];
    s[0] = distances[at] + first[at] * tau;
    s[1] = first[at];
    if (step.at < step.end) {
        if (!step_at(&step, tau, part)) {
            return 0;
        }
        for (int k = 0; k < JET; ++k) {
            s[k] = s[k] + (last[at] - first[at]) * part[k];
        }
    }
    s[1] = s[1] / scale[1];
    s[2] = s[2] / scale[2];
    return 1;
}

/* Distance along the curve and two time derivatives; 0 where the table is damaged. */
static inline int law_at(reader *r, real t, real s[JET])
{
    const int kind = take_count(r, 2);
    polynomial p;
    if (kind == 2) {
        return phases_at(r, t, s);
    }
    if (kind != 0 || !take_polynomial(r, &p)) {
        return 0;
    }
    polynomial_at(&p, t, s);
    return 1;
}

#endif
