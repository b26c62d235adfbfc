/*
 * model: numbers, vectors of numbers and their functions; private. Written by flexgen; see
 * model.h.
 *
 * A name that ends in _1 works on one number (real), a name that ends in _v on LANES numbers at
 * once (lanes). Sine, cosine, exp and tanh are polynomials without branches, tables or calls: the
 * same bits for a number and a vector, on every processor and at every optimization level, unless
 * the compiler contracts products and sums (-ffp-contract=off prevents this).
 *
 *   sin, cos    error <= 1 unit in the last place for |x| <= ANGLE_MAX; NaN beyond
 *   exp         error <= 1 unit; infinity on overflow, zero on underflow, subnormal results are
 *               less accurate
 *   tanh        error <= 3 units
 */
#ifndef MODEL_KERNEL_H
#define MODEL_KERNEL_H

#include <float.h>
#include <math.h>
#include <stdint.h>

#include "model.h"
#include "model_precision.h"

#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || \
    defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0)
#error "compile without -ffast-math: it removes the rounding that sine, cosine and exp need"
#endif
/*
 * Clang has no macro for -funsafe-math-optimizations and its parts: switched off, up to the end of
 * the source.
 */
#if defined(__clang__) && __clang_major__ >= 13
#if defined(__x86_64__) || defined(__i386__) || defined(__aarch64__)
#pragma float_control(precise, on)
#endif
#pragma clang fp reassociate(off) contract(off)
#endif
#if FLT_EVAL_METHOD != 0
#error \
    "compile for arithmetic that rounds every operation to its type, such as -msse2 -mfpmath=sse"
#endif

typedef model_real real;
typedef char model_real_has_the_width_of_bits[sizeof(real) == sizeof(bits) ? 1 : -1];

#if defined(__GNUC__)
#define MODEL_INLINE static inline __attribute__((always_inline))
#else
#define MODEL_INLINE static inline
#endif

/*
 * A vector has the alignment of one number and may alias numbers: any position in an array can be
 * read as a vector.
 */
#if defined(__GNUC__) && !defined(MODEL_NO_VECTORS) && \
    (defined(__SSE2__) || defined(__aarch64__) || defined(__VSX__))
#if defined(__AVX512F__)
#define MODEL_VECTOR 64
#elif defined(__AVX__)
#define MODEL_VECTOR 32
#else
#define MODEL_VECTOR 16
#endif
#define LANES (MODEL_VECTOR / BYTES)
typedef real lanes __attribute__((vector_size(MODEL_VECTOR), aligned(BYTES), may_alias));
typedef bits lanes_bits __attribute__((vector_size(MODEL_VECTOR), aligned(BYTES), may_alias));
#else
#define LANES 1
typedef real lanes;
typedef bits lanes_bits;
#endif

#define LESSER(a, b) ((a) < (b) ? (a) : (b))
#define PADDED(n) (((n) + (LANES - 1)) / LANES * LANES) /* n rounded up to whole vectors */

/* One number. A mask is all ones where a comparison holds, all zeros elsewhere. */
static inline real splat_1(const real x)
{
    return x;
}

static inline real load_1(const real *p)
{
    return *p;
}
static inline real gather_1(const real *p)
{
    return *p;
}
static inline void store_1(real *p, const real x)
{
    *p = x;
}

static inline bits bits_1(const real x)
{
    union {
        real number;
        bits pattern;
    } both;
    both.number = x;
    return both.pattern;
}

static inline real from_bits_1(const bits x)
{
    union {
        real number;
        bits pattern;
    } both;
    both.pattern = x;
    return both.number;
}

static inline bits less_1(const real a, const real b)
{
    return 0 - (bits)(a < b);
}
static inline bits less_equal_1(const real a, const real b)
{
    return 0 - (bits)(a <= b);
}
static inline bits equal_1(const real a, const real b)
{
    return 0 - (bits)(a == b);
}

#define T real
#define B bits
#define F(name) name##_1
#include "model_kernel_functions.h"
#undef T
#undef B
#undef F

/* The other functions call <math.h>; those of one argument, and of two. */
#define MODEL_CIRCULAR(DO) DO(tan) DO(asin) DO(acos) DO(atan)
#define MODEL_HYPERBOLIC(DO) DO(sinh) DO(cosh) DO(asinh) DO(acosh) DO(atanh)
#define MODEL_OF_ONE(DO) \
    MODEL_CIRCULAR(DO) MODEL_HYPERBOLIC(DO) DO(sqrt) DO(log) DO(expm1) DO(log1p) DO(erf)
#define MODEL_OF_TWO(DO) DO(atan2) DO(pow) DO(fmod) DO(remainder) DO(hypot)

#define CALL_ONE(f) \
    static inline real f##_1(const real x) \
    { \
        return LIBM(f)(x); \
    }
#define CALL_TWO(f) \
    static inline real f##_1(const real x, const real y) \
    { \
        return LIBM(f)(x, y); \
    }
MODEL_OF_ONE(CALL_ONE)
MODEL_OF_TWO(CALL_TWO)

#if LANES > 1
/* A vector. */
static inline lanes splat_v(const real x)
{
    const lanes zero = {0};
    return x - zero;
}

static inline lanes load_v(const real *p)
{
    return *(const lanes *)p;
}
static inline void store_v(real *p, const lanes x)
{
    *(lanes *)p = x;
}

/*
 * Store at an address that is a multiple of MODEL_VECTOR without reading the line into the cache.
 */
#if defined(__x86_64__) && defined(__SSE2__)
#define MODEL_STREAMS
typedef real lanes_aligned __attribute__((vector_size(MODEL_VECTOR), may_alias));
static inline void stream_v(real *p, const lanes x)
{
#if defined(__clang__)
    __builtin_nontemporal_store((lanes_aligned)x, (lanes_aligned *)p);
#elif BYTES == 8 && MODEL_VECTOR == 64
    __builtin_ia32_movntpd512(p, (lanes_aligned)x);
#elif BYTES == 8 && MODEL_VECTOR == 32
    __builtin_ia32_movntpd256(p, (lanes_aligned)x);
#elif BYTES == 8
    __builtin_ia32_movntpd(p, (lanes_aligned)x);
#elif MODEL_VECTOR == 64
    __builtin_ia32_movntps512(p, (lanes_aligned)x);
#elif MODEL_VECTOR == 32
    __builtin_ia32_movntps256(p, (lanes_aligned)x);
#else
    __builtin_ia32_movntps(p, (lanes_aligned)x);
#endif
}
#endif

/*
 * The same as load_v for numbers that were written one by one just before: they need not pass
 * through memory.
 */
MODEL_INLINE lanes gather_v(const real *p)
{
#if LANES == 2
    const lanes x = {p[0], p[1]};
#elif LANES == 4
    const lanes x = {p[0], p[1], p[2], p[3]};
#elif LANES == 8
    const lanes x = {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]};
#else
    const lanes x = {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11],
        p[12], p[13], p[14], p[15]};
#endif
    return x;
}

static inline lanes_bits bits_v(const lanes x)
{
    return (lanes_bits)x;
}
static inline lanes from_bits_v(const lanes_bits x)
{
    return (lanes)x;
}
static inline lanes_bits less_v(const lanes a, const lanes b)
{
    return (lanes_bits)(a < b);
}
static inline lanes_bits less_equal_v(const lanes a, const lanes b)
{
    return (lanes_bits)(a <= b);
}
static inline lanes_bits equal_v(const lanes a, const lanes b)
{
    return (lanes_bits)(a == b);
}

#else /* a vector is one number */
#define splat_v splat_1
#define load_v load_1
#define store_v store_1
#define gather_v gather_1
#define bits_v bits_1
#define from_bits_v from_bits_1
#define less_v less_1
#define less_equal_v less_equal_1
#define equal_v equal_1
#endif

#define T lanes
#define B lanes_bits
#define F(name) name##_v
#include "model_kernel_functions.h"
#undef T
#undef B
#undef F

#if LANES > 1
/* The first whole vector from p on. */
static inline lanes *aligned_v(lanes *p)
{
    return (lanes *)(((uintptr_t)p + (MODEL_VECTOR - 1)) / MODEL_VECTOR * MODEL_VECTOR);
}
static inline real *aligned_1(real *p)
{
    return (real *)aligned_v((lanes *)p);
}

/* The first lanes, `count` of them, from a, the others from b. */
static inline lanes before_v(const int count, const lanes a, const lanes b)
{
#define ALL ~(bits)0
    static const bits first[32] = {
        ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL, ALL};
#undef ALL
    return choose_v(*(const lanes_bits *)(first + 16 - count), a, b);
}

#define EACH_ONE(f) \
    static inline lanes f##_v(const lanes x) \
    { \
        lanes y = x; \
        for (int i = 0; i < LANES; ++i) { \
            y[i] = f##_1(x[i]); \
        } \
        return y; \
    }
#define EACH_TWO(f) \
    static inline lanes f##_v(const lanes a, const lanes b) \
    { \
        lanes y = a; \
        for (int i = 0; i < LANES; ++i) { \
            y[i] = f##_1(a[i], b[i]); \
        } \
        return y; \
    }
#else
#define before_v(count, a, b) (b)
#define aligned_1(p) (p)
#define aligned_v(p) (p)
#define EACH_ONE(f) \
    static inline lanes f##_v(const lanes x) \
    { \
        return f##_1(x); \
    }
#define EACH_TWO(f) \
    static inline lanes f##_v(const lanes a, const lanes b) \
    { \
        return f##_1(a, b); \
    }
#endif
MODEL_OF_ONE(EACH_ONE)
MODEL_OF_TWO(EACH_TWO)

#define AT_ONCE 32 /* vectors of angles, whose reductions wait for their polynomials */

/*
 * Sines and cosines of n angles; the arrays have PADDED(n) entries, the angles beyond n are zeros.
 */
MODEL_INLINE void sincos_1(const real *x, real *s, real *c, const int n)
{
    const int few = n <= 8 || n <= LANES;
#if defined(__clang__) || (defined(__GNUC__) && __GNUC__ >= 8)
#pragma GCC unroll 4
#endif
    for (int i = 0; i < n; i += LANES) {
        const lanes angles = few ? gather_v(x + i) : load_v(x + i);
        lanes sine, cosine;
        sine_cosine_v(angles, &sine, &cosine);
        store_v(s + i, sine);
        store_v(c + i, cosine);
    }
}

/*
 * Sines and cosines of n vectors of angles. All reductions come first, written out, then all
 * polynomials: the processor waits for a chain of operations less, as the chains are shorter and
 * it sees more of them at once.
 */
MODEL_INLINE void sincos_v(const lanes *x, lanes *s, lanes *c, const int n)
{
    for (int first = 0; first < n; first += AT_ONCE) {
        const int end = n - first < AT_ONCE ? n : first + AT_ONCE;
        lanes turns[AT_ONCE];
#if defined(__clang__) || (defined(__GNUC__) && __GNUC__ >= 8)
#pragma GCC unroll 32
#endif
        for (int i = first; i < end; ++i) {
            reduce_v(x[i], turns + (i - first), s + i, c + i);
        }
        for (int i = first; i < end; ++i) {
            sine_cosine_part_v(turns[i - first], s[i], c[i], s + i, c + i);
        }
    }
}

#endif
