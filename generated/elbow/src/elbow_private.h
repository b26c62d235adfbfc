/*
 * elbow: shared by the function files; private. Written by flexgen; see elbow.h.
 */
#ifndef ELBOW_PRIVATE_H
#define ELBOW_PRIVATE_H

#include "../elbow_batch.h"
#include "elbow_kernel.h"

#include <math.h>
#include <stddef.h>

#if defined(__GNUC__)
#define RESTRICT __restrict
#define SEPARATE __attribute__((noinline))
/* not part of an update: short code, no unrolled loops */
#define COLD __attribute__((cold))
#define MAY_ALIAS __attribute__((may_alias)) /* in memory that the caller declared as numbers */
#else
#define RESTRICT
#define SEPARATE
#define COLD
#define MAY_ALIAS
#endif

/* Sines and cosines of n angles: arrays whose names end with k. */
#define SINES_COSINES(k, n, ...) \
    const T angle##k[ANGLES(n)] = {__VA_ARGS__}; \
    T sine##k[ANGLES(n)], cosine##k[ANGLES(n)]; \
    F(sincos)(angle##k, sine##k, cosine##k, n);

/*
 * Statements for each of four or eight vectors of a row x, from which multiples of other rows are
 * subtracted.
 */
#define FOUR(DO) DO(0) DO(1) DO(2) DO(3)
#define EIGHT(DO) FOUR(DO) DO(4) DO(5) DO(6) DO(7)
#define LOAD_ROW(i) ROW rest##i = x[i];
#define LOAD_SCALED_ROW(i) ROW rest##i = pivot * x[i];
#define SUBTRACT_ROW(i) rest##i -= times * other[i];
#define STORE_ROW(i) x[i] = rest##i;

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
static inline void gather_points(
    const real *x, int size, int count, ptrdiff_t stride, real *to, ptrdiff_t to_stride)
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

/*
 * Copy the results of some points to their places. past: bypassing the cache, since the results
 * are not read again; `end_scatter` makes them visible.
 */
static inline void scatter_points(
    const real *x, int size, int count, ptrdiff_t stride, real *to, ptrdiff_t to_stride, int past)
{
    for (int i = 0; i < size; ++i) {
        const real *from = x + i * stride;
        real *into = to + i * to_stride;
        int k = 0;
#if defined(ELBOW_STREAMS)
        if (past) {
            for (; k < count && (uintptr_t)(into + k) % ELBOW_VECTOR != 0; ++k) {
                into[k] = from[k];
            }
            for (; k + LANES <= count; k += LANES) {
                stream_v(into + k, load_v(from + k));
            }
        }
#else
        (void)past;
#endif
        for (; k + LANES <= count; k += LANES) {
            store_v(into + k, load_v(from + k));
        }
        for (; k < count; ++k) {
            into[k] = from[k];
        }
    }
}

static inline void end_scatter(int past)
{
#if defined(ELBOW_STREAMS)
    if (past) {
        __builtin_ia32_sfence();
    }
#else
    (void)past;
#endif
}

#endif
