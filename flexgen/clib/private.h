/*
 * model: shared by the function files; private. Written by flexgen; see model.h.
 */
#ifndef MODEL_PRIVATE_H
#define MODEL_PRIVATE_H

#include "model_kernel.h"

#include <math.h>
#include <stddef.h>

#if defined(__GNUC__)
#define RESTRICT __restrict
#define SEPARATE __attribute__((noinline))
#else
#define RESTRICT
#define SEPARATE
#endif

static inline real sum_v(const lanes x)
{
    real sum = ZERO;
    for (int k = 0; k < LANES; ++k) {
        sum += ((const real *)&x)[k];
    }
    return sum;
}

static inline int all_finite(const real *x, int size, ptrdiff_t stride)
{
    for (int k = 0; k < size; ++k) {
        if (!isfinite(x[k * stride])) {
            return 0;
        }
    }
    return 1;
}

static inline void set_nan(real *x, int size, ptrdiff_t stride)
{
    for (int k = 0; k < size; ++k) {
        x[k * stride] = (real)NAN;
    }
}

/* Copy the entries of some points; the lanes after the last point repeat the first. */
static inline void gather_points(const real *x, int size, int count, ptrdiff_t stride, real *to, ptrdiff_t to_stride)
{
    for (int i = 0; i < size; ++i) {
        int k = 0;
        for (; k < count; ++k) {
            to[i * to_stride + k] = x[i * stride + k];
        }
        for (; k % LANES != 0; ++k) {
            to[i * to_stride + k] = x[i * stride];
        }
    }
}

static inline void scatter_points(const real *x, int size, int count, ptrdiff_t stride, real *to, ptrdiff_t to_stride)
{
    for (int i = 0; i < size; ++i) {
        for (int k = 0; k < count; ++k) {
            to[i * to_stride + k] = x[i * stride + k];
        }
    }
}

#endif
