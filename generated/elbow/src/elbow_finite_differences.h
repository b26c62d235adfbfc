/*
 * elbow: derivatives of a sampled motion by differences; private.
 */
#ifndef ELBOW_FINITE_DIFFERENCES_H
#define ELBOW_FINITE_DIFFERENCES_H

#include "elbow_inversion_common.h"

enum { MARGIN = 3 }; /* samples on either side that a derivative needs */

/* largest kinematic mismatch of a status OK: beyond rounding and the corner of a filter */
static const real mismatch_max = PRECISE(2e-2, 2.5e-1);

/* First and second derivative by seven samples, `stride` apart and `period` seconds; order six. */
static inline real sixty_differences(const real *x, ptrdiff_t stride)
{
    return 45.0 * (x[stride] - x[-stride]) - 9.0 * (x[2 * stride] - x[-2 * stride]) + (x[3 * stride] - x[-3 * stride]);
}

/* The same of LANES samples that follow each other from `x` on. */
static inline lanes sixty_differences_v(const real *x, ptrdiff_t stride)
{
    return 45.0 * (load_v(x + stride) - load_v(x - stride)) - 9.0 * (load_v(x + 2 * stride) - load_v(x - 2 * stride)) +
           (load_v(x + 3 * stride) - load_v(x - 3 * stride));
}

static inline real derivative_of(const real *x, ptrdiff_t stride, real period)
{
    return sixty_differences(x, stride) / (60.0 * period);
}

static inline lanes derivative_v(const real *x, real period)
{
    return sixty_differences_v(x, 1) / (60.0 * period);
}

static inline real second_derivative_of(const real *x, ptrdiff_t stride, real period)
{
#if BYTES == 8
    return (270.0 * (x[stride] + x[-stride]) - 27.0 * (x[2 * stride] + x[-2 * stride]) +
               2.0 * (x[3 * stride] + x[-3 * stride]) - 490.0 * x[0]) /
           (180.0 * period * period);
#else /* from differences: a large value that they share does not cost digits */
    const real one = (x[stride] - x[0]) + (x[-stride] - x[0]);
    const real two = (x[2 * stride] - x[0]) + (x[-2 * stride] - x[0]);
    const real three = (x[3 * stride] - x[0]) + (x[-3 * stride] - x[0]);
    return (270.0 * one - 27.0 * two + 2.0 * three) / (180.0 * period * period);
#endif
}

static inline lanes second_derivative_v(const real *x, real period)
{
    const lanes now = load_v(x);
#if BYTES == 8
    return (270.0 * (load_v(x + 1) + load_v(x - 1)) - 27.0 * (load_v(x + 2) + load_v(x - 2)) +
               2.0 * (load_v(x + 3) + load_v(x - 3)) - 490.0 * now) /
           (180.0 * period * period);
#else
    const lanes one = (load_v(x + 1) - now) + (load_v(x - 1) - now);
    const lanes two = (load_v(x + 2) - now) + (load_v(x - 2) - now);
    const lanes three = (load_v(x + 3) - now) + (load_v(x - 3) - now);
    return (270.0 * one - 27.0 * two + 2.0 * three) / (180.0 * period * period);
#endif
}

#endif
