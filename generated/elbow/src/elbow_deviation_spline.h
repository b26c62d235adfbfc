/*
 * elbow: deviations from a path as splines of degree seven in time; private to invert_limited.
 *
 * d = sum c_i B_i with knots `spacing` samples apart, the first one at the first sample. Spline i is not zero in the
 * knot intervals i to i + 7, so that a deviation and six derivatives are zero at both ends of the path.
 *
 * Source: C. de Boor, A Practical Guide to Splines, 2001, ch. IX.
 */
#ifndef ELBOW_DEVIATION_SPLINE_H
#define ELBOW_DEVIATION_SPLINE_H

#include "elbow_path_deviation.h"

enum { DEGREE = 7, SPLINES = DEGREE + 1 };

/* The splines of a degree that are not zero in a knot interval, at its part u. */
static inline void splines_of_degree(int degree, real u, real out[SPLINES])
{
    for (int j = 0; j < SPLINES; ++j) {
        out[j] = j == 0 ? 1.0 : 0.0;
    }
    for (int p = 1; p <= degree; ++p) {
        for (int j = p; j >= 0; --j) {
            const real left = j > 0 ? out[j - 1] : 0.0, right = j < p ? out[j] : 0.0;
            out[j] = ((u + (real)(p - j)) * left + ((real)(j + 1) - u) * right) / (real)p;
        }
    }
}

/* Derivative of an order of all splines that are not zero there, per knot interval; the last is the newest. */
static inline void spline_derivatives(int order, real u, real out[SPLINES])
{
    splines_of_degree(DEGREE - order, u, out);
    for (int k = 0; k < order; ++k) { /* B' = B_i - B_(i+1) of the degree below */
        for (int j = DEGREE - order + k + 1; j >= 0; --j) {
            const real left = j > 0 ? out[j - 1] : 0.0, right = j <= DEGREE - order + k ? out[j] : 0.0;
            out[j] = left - right;
        }
    }
}

/* Number of splines of a path of n samples. */
static inline int spline_count(int n, int spacing)
{
    return (n - 1) / spacing - DEGREE;
}

/* Deviation at a sample: value, first and second derivative [1/s^k], NY each. */
static inline void deviation_at(const real *c, int count, int spacing, real period, int sample, real out[3 * NY])
{
    const int interval = sample / spacing;
    const real u = (real)(sample - interval * spacing) / (real)spacing, h = (real)spacing * period;
    real scale = 1.0;
    for (int order = 0; order < 3; ++order) {
        real b[SPLINES];
        spline_derivatives(order, u, b);
        for (int i = 0; i < NY; ++i) {
            real sum = 0.0;
            for (int j = 0; j < SPLINES; ++j) {
                const int spline = interval - DEGREE + j;
                if (spline >= 0 && spline < count) {
                    sum += c[spline * NY + i] * b[j];
                }
            }
            out[order * NY + i] = sum / scale;
        }
        scale *= h;
    }
}

#endif
