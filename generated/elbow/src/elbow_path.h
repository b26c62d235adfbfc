/*
 * elbow: the path that the output follows: samples, interpolation between them, and small
 * rotations; private.
 */
#ifndef ELBOW_PATH_H
#define ELBOW_PATH_H

#include "elbow_inversion_common.h"

static inline void cross(const real *a, const real *b, real *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* The quintic through value and two derivatives at 0 and 1; value and two derivatives at x. */
static inline void quintic(real x, const real left[3], const real right[3], real out[3])
{
    const real d = right[0] - left[0];
    const real a3 = 10.0 * d - 6.0 * left[1] - 4.0 * right[1] - 1.5 * left[2] + 0.5 * right[2];
    const real a4 = -15.0 * d + 8.0 * left[1] + 7.0 * right[1] + 1.5 * left[2] - right[2];
    const real a5 = 6.0 * d - 3.0 * left[1] - 3.0 * right[1] - 0.5 * left[2] + 0.5 * right[2];
    out[0] = left[0] + x * (left[1] + x * (0.5 * left[2] + x * (a3 + x * (a4 + x * a5))));
    out[1] = left[1] + x * (left[2] + x * (3.0 * a3 + x * (4.0 * a4 + x * 5.0 * a5)));
    out[2] = left[2] + x * (6.0 * a3 + x * (12.0 * a4 + x * 20.0 * a5));
}

/*
 * A coordinate between two samples of value, rate times T and second derivative times T^2; both
 * change. For a short period T the rates give the difference of values, which have too few digits
 * for accelerations.
 */
static inline void between_positions(real x, real T, real left[3], real right[3], real out[3])
{
    const real first = left[0], d = right[0] - first;
    left[0] = 0.0;
    right[0] = T < 4e-4 ? 0.5 * (left[1] + right[1]) + (left[2] - right[2]) / 12.0 : d;
    quintic(x, left, right, out);
    out[0] = first + (out[0] + x * (d - right[0]));
}

/* y, dy and ddy at sample k; the path is constant before the first and after the last sample. */
static inline void reference_sample(const elbow_samples *p, ptrdiff_t k, real *out)
{
    const ptrdiff_t at = k < 0 ? 0 : k >= p->n - 1 ? p->n - 1 : k;
    copy(p->y + at * NT, NT, out);
    if (k < 0 || k >= p->n - 1) {
        for (int i = NT; i < REFERENCE; ++i) {
            out[i] = 0.0;
        }
    } else {
        copy(p->dy + at * NY, NY, out + NT);
        copy(p->ddy + at * NY, NY, out + NT + NY);
    }
}

/* The same at sample k + x, 0 <= x <= 1. */
static inline void reference_at(const elbow_samples *p, int k, real x, real *out)
{
    const real T = p->period;
    const ptrdiff_t at = k;
    if (k < 0 || k >= p->n - 1) {
        reference_sample(p, k, out);
    } else {
        const real *y0 = p->y + at * NT, *y1 = y0 + NT;
        const real *v0 = p->dy + at * NY, *v1 = v0 + NY;
        const real *a0 = p->ddy + at * NY, *a1 = a0 + NY;
        for (int i = 0; i < PLACES; ++i) {
            real left[3] = {y0[i], T * v0[i], T * T * a0[i]};
            real right[3] = {y1[i], T * v1[i], T * T * a1[i]};
            real q[3];
            between_positions(x, T, left, right, q);
            out[i] = q[0];
            out[NT + i] = q[1] / T;
            out[NT + NY + i] = q[2] / (T * T);
        }
    }
}

/* The path at x, 0 <= x <= 1, between two consecutive samples of REFERENCE numbers each. */
static inline void between_samples(const real *samples, real period, real x, real *out)
{
    real y[2 * NT], dy[2 * NY], ddy[2 * NY];
    const elbow_samples two = {2, period, y, dy, ddy};
    for (int j = 0; j < 2; ++j) {
        copy(samples + j * REFERENCE, NT, y + j * NT);
        copy(samples + j * REFERENCE + NT, NY, dy + j * NY);
        copy(samples + j * REFERENCE + NT + NY, NY, ddy + j * NY);
    }
    reference_at(&two, 0, x, out);
}

/*
 * --- A deviation from the path, and its decay.
 *
 * The deviation d of each output is the end of a chain of five integrators, so that four
 * derivatives are continuous.
 */

enum {
    CHAIN = 5, /* derivatives 0 to 4, the fifth is the input */
    DEVIATION = CHAIN * NY,
    DECAYS = 4 /* time constants of the deviation in a horizon */
};

/* One step of the chain, for one output: value and derivatives times T^i, a step of h = tau T. */
static inline void chain_step(
    const real *x, ptrdiff_t stride, real u, real tau, real *out, ptrdiff_t to)
{
    for (int i = 0; i < CHAIN; ++i) {
        real term = 1.0, sum = 0.0;
        for (int j = i; j < CHAIN; ++j) {
            sum += term * x[j * stride];
            term *= tau / (real)(j - i + 1);
        }
        out[i * to] = sum + term * u;
    }
}

/* The free decay of a deviation in the next interval: all five poles at -1/T. */
static inline void decay_step(const real *x, real tau, real *out)
{
    static const real binomial[CHAIN] = {1.0, 5.0, 10.0, 10.0, 5.0};
    for (int j = 0; j < NY; ++j) {
        real u = 0.0;
        for (int i = 0; i < CHAIN; ++i) {
            u -= binomial[i] * x[i * NY + j];
        }
        chain_step(x + j, NY, u, tau, out + j, NY);
    }
}

/* A path with a deviation, at one instant. */
static inline void add_deviation(const real *plan, const real *x, real T, real *out)
{
    for (int i = 0; i < REFERENCE; ++i) {
        out[i] = plan[i];
    }
    for (int i = 0; i < PLACES; ++i) {
        out[i] += x[i];
        out[NT + i] += x[NY + i] / T;
        out[NT + NY + i] += x[2 * NY + i] / (T * T);
    }
}

/* Length and angle of a deviation. */
static inline void size_of_deviation(const real *x, real out[2])
{
    out[0] = out[1] = 0.0;
    for (int i = 0; i < NY; ++i) {
        out[i < PLACES ? 0 : 1] += x[i] * x[i];
    }
    out[0] = square_root(out[0]);
    out[1] = square_root(out[1]);
}

#endif
