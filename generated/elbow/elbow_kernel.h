/* Numbers, vectors of numbers and their functions, for the sources of this library only.
 *
 * What ends in _1 works on one number (real), what ends in _v on LANES numbers at once (lanes). Sine, cosine, exp and
 * tanh are polynomials without branches, tables or calls: the same bits for a number and a vector, on every processor
 * and at every level of optimisation, unless the compiler contracts products and sums (-ffp-contract=off forbids it).
 *
 *   sin, cos    error <= 1 unit of the last place for |x| <= 1000000 rad; NaN beyond
 *   exp         error <= 1 unit; infinity above and zero below the numbers, fewer bits next to zero
 *   tanh        error <= 3 units
 */
#ifndef ELBOW_KERNEL_H
#define ELBOW_KERNEL_H

#include <float.h>
#include <math.h>
#include <stdint.h>

#include "elbow.h"

#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(_M_FP_FAST) || \
    (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0)
#error "compile without -ffast-math: it removes the rounding that sine, cosine and exp need"
#endif
#if FLT_EVAL_METHOD != 0
#error "compile for arithmetic that rounds every operation to its type, such as -msse2 -mfpmath=sse"
#endif

typedef elbow_real real;
typedef uint64_t bits;
typedef char elbow_real_has_64_bits[sizeof(real) == sizeof(bits) ? 1 : -1];

#if defined(__GNUC__)
#define ELBOW_INLINE static inline __attribute__((always_inline))
#else
#define ELBOW_INLINE static inline
#endif

/* A vector has the alignment of one number and may alias numbers: any place in an array can be read as a vector. */
#if defined(__GNUC__) && !defined(ELBOW_NO_VECTORS) && \
    (defined(__SSE2__) || defined(__aarch64__) || defined(__VSX__))
#if defined(__AVX512F__)
#define ELBOW_VECTOR 64
#elif defined(__AVX__)
#define ELBOW_VECTOR 32
#else
#define ELBOW_VECTOR 16
#endif
#define LANES (ELBOW_VECTOR / 8)
typedef real lanes __attribute__((vector_size(ELBOW_VECTOR), aligned(8), may_alias));
typedef bits lanes_bits __attribute__((vector_size(ELBOW_VECTOR), aligned(8), may_alias));
#else
#define LANES 1
typedef real lanes;
#endif

#define PADDED(n) (((n) + (LANES - 1)) / LANES * LANES) /* n rounded up to whole vectors */

/* One number. A mask is all ones where a comparison holds, all zeros elsewhere. */
static inline real splat_1(const real x) { return x; }
static inline real load_1(const real *p) { return *p; }
static inline real gather_1(const real *p) { return *p; }
static inline void store_1(real *p, const real x) { *p = x; }

static inline bits bits_1(const real x)
{
    union { real number; bits pattern; } both;
    both.number = x;
    return both.pattern;
}

static inline real from_bits_1(const bits x)
{
    union { real number; bits pattern; } both;
    both.pattern = x;
    return both.number;
}

static inline bits less_1(const real a, const real b) { return 0 - (bits)(a < b); }
static inline bits less_equal_1(const real a, const real b) { return 0 - (bits)(a <= b); }
static inline bits equal_1(const real a, const real b) { return 0 - (bits)(a == b); }

static inline real choose_1(const bits mask, const real a, const real b)
{
    return from_bits_1((bits_1(a) & mask) | (bits_1(b) & ~mask));
}

static inline real fabs_1(const real x) { return from_bits_1(bits_1(x) & ~UINT64_C(0x8000000000000000)); }

static inline real copysign_1(const real x, const real y)
{
    return from_bits_1((bits_1(x) & ~UINT64_C(0x8000000000000000)) | (bits_1(y) & UINT64_C(0x8000000000000000)));
}

/* Truth is 1 or 0; what is not 0 is true, NaN too. */
static inline real truth_1(const bits mask) { return from_bits_1(mask & bits_1(splat_1(1.0))); }
static inline bits holds_1(const real x) { return ~equal_1(x, splat_1(0.0)); }
static inline real lt_1(const real a, const real b) { return truth_1(less_1(a, b)); }
static inline real le_1(const real a, const real b) { return truth_1(less_equal_1(a, b)); }
static inline real eq_1(const real a, const real b) { return truth_1(equal_1(a, b)); }
static inline real ne_1(const real a, const real b) { return truth_1(~equal_1(a, b)); }
static inline real and_1(const real a, const real b) { return truth_1(holds_1(a) & holds_1(b)); }
static inline real or_1(const real a, const real b) { return truth_1(holds_1(a) | holds_1(b)); }
static inline real not_1(const real a) { return truth_1(~holds_1(a)); }
static inline real select_1(const real c, const real a, const real b) { return choose_1(holds_1(c), a, b); }
static inline real if_else_zero_1(const real c, const real a) { return from_bits_1(holds_1(c) & bits_1(a)); }

/* x, or NaN where d is not above its least. */
static inline real guarded_1(const real x, const real d, const real least)
{
    return from_bits_1(bits_1(x) | ~less_1(least, d));
}

/* -1, 0 or 1; a zero and NaN stay as they are. */
static inline real sign_1(const real x)
{
    return choose_1(less_1(x, splat_1(0.0)) | less_1(splat_1(0.0), x), copysign_1(splat_1(1.0), x), x);
}

/* Where one is NaN, the other; where both are equal, the first. */
static inline real fmin_1(const real a, const real b) { return choose_1(less_equal_1(a, b) | ~equal_1(b, b), a, b); }
static inline real fmax_1(const real a, const real b) { return choose_1(less_equal_1(b, a) | ~equal_1(b, b), a, b); }

/* The nearest whole number, of the sign of x; from 4503599627370496.0 on every number is whole. */
static inline real whole_1(const real x)
{
    const real a = fabs_1(x);
    const real n = (a + 4503599627370496.0) - 4503599627370496.0;
    return copysign_1(choose_1(less_1(a, splat_1(4503599627370496.0)), n, a), x);
}

static inline real floor_1(const real x)
{
    const real n = whole_1(x);
    return n - lt_1(x, n);
}

static inline real ceil_1(const real x)
{
    const real n = whole_1(x);
    return copysign_1(n + lt_1(n, x), x);
}

/* x = k pi/2 + r - tail with a whole number k and |r| <= pi/4: the products with the first three parts of pi/2 and the
   differences up to r are exact. The lowest bits of *turns hold k; beyond the range *tail is NaN. */
static inline void reduce_1(const real x, real *turns, real *remainder, real *tail)
{
    const real t = x * 0.6366197723675814 + 6755399441055744.0; /* rounds to k */
    const real k = t - 6755399441055744.0;
    const real rough = (x - k * 1.5707963267341256) - k * 6.077094383272197e-11;
    const real w = k * 6.12323399538461e-17;
    const real r = rough - w;
    const real rest = (w - (rough - r)) + k * 3.5215598651832e-27;
    *turns = t;
    *remainder = r;
    *tail = from_bits_1(bits_1(rest) | less_1(splat_1(1000000.0), fabs_1(x)));
}

/* Sine and cosine of what reduce gave: one polynomial for each; k tells which is which. Of -0 the sine is -0. */
static inline void sine_cosine_part_1(const real turns, const real r, const real tail, real *sine, real *cosine)
{
    const real z = r * r;
    const real z2 = z * z;
    const real z4 = z2 * z2;
    const real u0 = -0.16666666666666632 + 0.008333333333322425 * z;
    const real u1 = -0.00019841269829816863 + 2.755731369519521e-06 * z;
    const real u2 = -2.5050758648160705e-08 + 1.5896827621544008e-10 * z;
    const real v0 = 0.0416666666666666 + -0.0013888888888874138 * z;
    const real v1 = 2.4801587289491742e-05 + -2.755731435521654e-07 * z;
    const real v2 = 2.087572368084499e-09 + -1.1359669674695726e-11 * z;
    const real p = ((u0 + z2 * u1) + z4 * u2);
    const real q = ((v0 + z2 * v1) + z4 * v2);
    const real half = 0.5 * z;
    const real most = 1.0 - half;
    const real s = r - (tail * most - (z * r) * p);
    const real c = most + (z2 * q + (((1.0 - most) - half) + tail * r));
    const bits n = bits_1(turns);
    const bits swap = (bits_1(s) ^ bits_1(c)) & (0 - (n & 1));
    const bits minus_s = (n & 2) << 62;
    const bits minus_c = ((n + 1) & 2) << 62;
    *sine = from_bits_1((bits_1(s) ^ swap) ^ minus_s);
    *cosine = from_bits_1((bits_1(c) ^ swap) ^ minus_c);
}

static inline void sine_cosine_1(const real x, real *sine, real *cosine)
{
    real turns, r, tail;
    reduce_1(x, &turns, &r, &tail);
    sine_cosine_part_1(turns, r, tail, sine, cosine);
}

static inline real sin_1(const real x)
{
    real s, c;
    sine_cosine_1(x, &s, &c);
    return s;
}

static inline real cos_1(const real x)
{
    real s, c;
    sine_cosine_1(x, &s, &c);
    return c;
}

/* exp(r) - 1 where x = k log(2) + r; the lowest bits of *t hold k. */
static inline real exp_part_1(const real x, real *t)
{
    const real shifted = x * 1.4426950408889634 + 6755399441055744.0;
    const real k = shifted - 6755399441055744.0;
    const real rough = x - k * 0.6931471805598903;
    const real w = k * 5.497923018708371e-14;
    const real r = rough - w;
    const real tail = (rough - r) - w;
    const real r2 = r * r;
    const real r4 = r2 * r2;
    const real r8 = r4 * r4;
    const real u0 = 0.5000000000000007 + 0.1666666666666669 * r;
    const real u1 = 0.0416666666665598 + 0.00833333333331177 * r;
    const real u2 = 0.001388888893676217 + 0.000198412699089098 * r;
    const real u3 = 2.480149951410159e-05 + 2.7557222947699084e-06 * r;
    const real u4 = 2.762815299425782e-07 + 2.5115979876370163e-08 * r;
    const real p = (((u0 + r2 * u1) + r4 * (u2 + r2 * u3)) + r8 * u4);
    *t = shifted;
    return r + (tail + r2 * p);
}

/* exp(x): 2^k in two factors, so that large results reach infinity and small ones lose their bits one by one. */
static inline real exp_1(const real x)
{
    const bits above = less_1(splat_1(710.0), x);
    const bits below = less_1(x, splat_1(-746.0));
    real t;
    const real part = exp_part_1(x, &t);
    const bits k = bits_1(t) - UINT64_C(0x4337fffffffff802);
    const bits first = k >> 1;
    const real y = ((1.0 + part) * from_bits_1(first << 52)) * from_bits_1((k - first) << 52);
    return from_bits_1((bits_1(y) & ~(above | below)) | (above & UINT64_C(0x7ff0000000000000)));
}

/* tanh(x) = e / (e + 2) with e = exp(2 |x|) - 1 = 2^k (exp(r) - 1) + (2^k - 1), and the sign of x. */
static inline real tanh_1(const real x)
{
    const real a = fabs_1(x);
    const bits above = less_1(splat_1(22.0), a);
    real t;
    const real part = exp_part_1(a + a, &t);
    const real scale = from_bits_1((bits_1(t) - UINT64_C(0x4337fffffffffc01)) << 52);
    const real e = scale * part + (scale - 1.0);
    const real y = choose_1(above, splat_1(1.0), e / (e + 2.0));
    return from_bits_1(bits_1(y) | (bits_1(x) ^ bits_1(a)));
}

/* The other functions: those of <math.h>. */
static inline real sqrt_1(const real x) { return sqrt(x); }
static inline real log_1(const real x) { return log(x); }
static inline real expm1_1(const real x) { return expm1(x); }
static inline real log1p_1(const real x) { return log1p(x); }
static inline real erf_1(const real x) { return erf(x); }
static inline real tan_1(const real x) { return tan(x); }
static inline real asin_1(const real x) { return asin(x); }
static inline real acos_1(const real x) { return acos(x); }
static inline real atan_1(const real x) { return atan(x); }
static inline real sinh_1(const real x) { return sinh(x); }
static inline real cosh_1(const real x) { return cosh(x); }
static inline real asinh_1(const real x) { return asinh(x); }
static inline real acosh_1(const real x) { return acosh(x); }
static inline real atanh_1(const real x) { return atanh(x); }
static inline real atan2_1(const real x, const real y) { return atan2(x, y); }
static inline real pow_1(const real x, const real y) { return pow(x, y); }
static inline real fmod_1(const real x, const real y) { return fmod(x, y); }
static inline real remainder_1(const real x, const real y) { return remainder(x, y); }
static inline real hypot_1(const real x, const real y) { return hypot(x, y); }

#if LANES > 1
/* A vector. */
static inline lanes splat_v(const real x)
{
    const lanes zero = {0};
    return x - zero;
}

static inline lanes load_v(const real *p) { return *(const lanes *)p; }
static inline void store_v(real *p, const lanes x) { *(lanes *)p = x; }

/* The same as load_v for numbers that were written one by one just before: they need not pass through memory. */
ELBOW_INLINE lanes gather_v(const real *p)
{
#if LANES == 2
    const lanes x = {p[0], p[1]};
#elif LANES == 4
    const lanes x = {p[0], p[1], p[2], p[3]};
#elif LANES == 8
    const lanes x = {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]};
#else
    const lanes x = {p[0], p[1], p[2],  p[3],  p[4],  p[5],  p[6],  p[7],
                     p[8], p[9], p[10], p[11], p[12], p[13], p[14], p[15]};
#endif
    return x;
}

static inline lanes_bits bits_v(const lanes x) { return (lanes_bits)x; }
static inline lanes from_bits_v(const lanes_bits x) { return (lanes)x; }
static inline lanes_bits less_v(const lanes a, const lanes b) { return (lanes_bits)(a < b); }
static inline lanes_bits less_equal_v(const lanes a, const lanes b) { return (lanes_bits)(a <= b); }
static inline lanes_bits equal_v(const lanes a, const lanes b) { return (lanes_bits)(a == b); }

static inline lanes choose_v(const lanes_bits mask, const lanes a, const lanes b)
{
    return from_bits_v((bits_v(a) & mask) | (bits_v(b) & ~mask));
}

static inline lanes fabs_v(const lanes x) { return from_bits_v(bits_v(x) & ~UINT64_C(0x8000000000000000)); }

static inline lanes copysign_v(const lanes x, const lanes y)
{
    return from_bits_v((bits_v(x) & ~UINT64_C(0x8000000000000000)) | (bits_v(y) & UINT64_C(0x8000000000000000)));
}

/* Truth is 1 or 0; what is not 0 is true, NaN too. */
static inline lanes truth_v(const lanes_bits mask) { return from_bits_v(mask & bits_v(splat_v(1.0))); }
static inline lanes_bits holds_v(const lanes x) { return ~equal_v(x, splat_v(0.0)); }
static inline lanes lt_v(const lanes a, const lanes b) { return truth_v(less_v(a, b)); }
static inline lanes le_v(const lanes a, const lanes b) { return truth_v(less_equal_v(a, b)); }
static inline lanes eq_v(const lanes a, const lanes b) { return truth_v(equal_v(a, b)); }
static inline lanes ne_v(const lanes a, const lanes b) { return truth_v(~equal_v(a, b)); }
static inline lanes and_v(const lanes a, const lanes b) { return truth_v(holds_v(a) & holds_v(b)); }
static inline lanes or_v(const lanes a, const lanes b) { return truth_v(holds_v(a) | holds_v(b)); }
static inline lanes not_v(const lanes a) { return truth_v(~holds_v(a)); }
static inline lanes select_v(const lanes c, const lanes a, const lanes b) { return choose_v(holds_v(c), a, b); }
static inline lanes if_else_zero_v(const lanes c, const lanes a) { return from_bits_v(holds_v(c) & bits_v(a)); }

/* x, or NaN where d is not above its least. */
static inline lanes guarded_v(const lanes x, const lanes d, const lanes least)
{
    return from_bits_v(bits_v(x) | ~less_v(least, d));
}

/* -1, 0 or 1; a zero and NaN stay as they are. */
static inline lanes sign_v(const lanes x)
{
    return choose_v(less_v(x, splat_v(0.0)) | less_v(splat_v(0.0), x), copysign_v(splat_v(1.0), x), x);
}

/* Where one is NaN, the other; where both are equal, the first. */
static inline lanes fmin_v(const lanes a, const lanes b) { return choose_v(less_equal_v(a, b) | ~equal_v(b, b), a, b); }
static inline lanes fmax_v(const lanes a, const lanes b) { return choose_v(less_equal_v(b, a) | ~equal_v(b, b), a, b); }

/* The nearest whole number, of the sign of x; from 4503599627370496.0 on every number is whole. */
static inline lanes whole_v(const lanes x)
{
    const lanes a = fabs_v(x);
    const lanes n = (a + 4503599627370496.0) - 4503599627370496.0;
    return copysign_v(choose_v(less_v(a, splat_v(4503599627370496.0)), n, a), x);
}

static inline lanes floor_v(const lanes x)
{
    const lanes n = whole_v(x);
    return n - lt_v(x, n);
}

static inline lanes ceil_v(const lanes x)
{
    const lanes n = whole_v(x);
    return copysign_v(n + lt_v(n, x), x);
}

/* x = k pi/2 + r - tail with a whole number k and |r| <= pi/4: the products with the first three parts of pi/2 and the
   differences up to r are exact. The lowest bits of *turns hold k; beyond the range *tail is NaN. */
static inline void reduce_v(const lanes x, lanes *turns, lanes *remainder, lanes *tail)
{
    const lanes t = x * 0.6366197723675814 + 6755399441055744.0; /* rounds to k */
    const lanes k = t - 6755399441055744.0;
    const lanes rough = (x - k * 1.5707963267341256) - k * 6.077094383272197e-11;
    const lanes w = k * 6.12323399538461e-17;
    const lanes r = rough - w;
    const lanes rest = (w - (rough - r)) + k * 3.5215598651832e-27;
    *turns = t;
    *remainder = r;
    *tail = from_bits_v(bits_v(rest) | less_v(splat_v(1000000.0), fabs_v(x)));
}

/* Sine and cosine of what reduce gave: one polynomial for each; k tells which is which. Of -0 the sine is -0. */
static inline void sine_cosine_part_v(const lanes turns, const lanes r, const lanes tail, lanes *sine, lanes *cosine)
{
    const lanes z = r * r;
    const lanes z2 = z * z;
    const lanes z4 = z2 * z2;
    const lanes u0 = -0.16666666666666632 + 0.008333333333322425 * z;
    const lanes u1 = -0.00019841269829816863 + 2.755731369519521e-06 * z;
    const lanes u2 = -2.5050758648160705e-08 + 1.5896827621544008e-10 * z;
    const lanes v0 = 0.0416666666666666 + -0.0013888888888874138 * z;
    const lanes v1 = 2.4801587289491742e-05 + -2.755731435521654e-07 * z;
    const lanes v2 = 2.087572368084499e-09 + -1.1359669674695726e-11 * z;
    const lanes p = ((u0 + z2 * u1) + z4 * u2);
    const lanes q = ((v0 + z2 * v1) + z4 * v2);
    const lanes half = 0.5 * z;
    const lanes most = 1.0 - half;
    const lanes s = r - (tail * most - (z * r) * p);
    const lanes c = most + (z2 * q + (((1.0 - most) - half) + tail * r));
    const lanes_bits n = bits_v(turns);
    const lanes_bits swap = (bits_v(s) ^ bits_v(c)) & (0 - (n & 1));
    const lanes_bits minus_s = (n & 2) << 62;
    const lanes_bits minus_c = ((n + 1) & 2) << 62;
    *sine = from_bits_v((bits_v(s) ^ swap) ^ minus_s);
    *cosine = from_bits_v((bits_v(c) ^ swap) ^ minus_c);
}

static inline void sine_cosine_v(const lanes x, lanes *sine, lanes *cosine)
{
    lanes turns, r, tail;
    reduce_v(x, &turns, &r, &tail);
    sine_cosine_part_v(turns, r, tail, sine, cosine);
}

static inline lanes sin_v(const lanes x)
{
    lanes s, c;
    sine_cosine_v(x, &s, &c);
    return s;
}

static inline lanes cos_v(const lanes x)
{
    lanes s, c;
    sine_cosine_v(x, &s, &c);
    return c;
}

/* exp(r) - 1 where x = k log(2) + r; the lowest bits of *t hold k. */
static inline lanes exp_part_v(const lanes x, lanes *t)
{
    const lanes shifted = x * 1.4426950408889634 + 6755399441055744.0;
    const lanes k = shifted - 6755399441055744.0;
    const lanes rough = x - k * 0.6931471805598903;
    const lanes w = k * 5.497923018708371e-14;
    const lanes r = rough - w;
    const lanes tail = (rough - r) - w;
    const lanes r2 = r * r;
    const lanes r4 = r2 * r2;
    const lanes r8 = r4 * r4;
    const lanes u0 = 0.5000000000000007 + 0.1666666666666669 * r;
    const lanes u1 = 0.0416666666665598 + 0.00833333333331177 * r;
    const lanes u2 = 0.001388888893676217 + 0.000198412699089098 * r;
    const lanes u3 = 2.480149951410159e-05 + 2.7557222947699084e-06 * r;
    const lanes u4 = 2.762815299425782e-07 + 2.5115979876370163e-08 * r;
    const lanes p = (((u0 + r2 * u1) + r4 * (u2 + r2 * u3)) + r8 * u4);
    *t = shifted;
    return r + (tail + r2 * p);
}

/* exp(x): 2^k in two factors, so that large results reach infinity and small ones lose their bits one by one. */
static inline lanes exp_v(const lanes x)
{
    const lanes_bits above = less_v(splat_v(710.0), x);
    const lanes_bits below = less_v(x, splat_v(-746.0));
    lanes t;
    const lanes part = exp_part_v(x, &t);
    const lanes_bits k = bits_v(t) - UINT64_C(0x4337fffffffff802);
    const lanes_bits first = k >> 1;
    const lanes y = ((1.0 + part) * from_bits_v(first << 52)) * from_bits_v((k - first) << 52);
    return from_bits_v((bits_v(y) & ~(above | below)) | (above & UINT64_C(0x7ff0000000000000)));
}

/* tanh(x) = e / (e + 2) with e = exp(2 |x|) - 1 = 2^k (exp(r) - 1) + (2^k - 1), and the sign of x. */
static inline lanes tanh_v(const lanes x)
{
    const lanes a = fabs_v(x);
    const lanes_bits above = less_v(splat_v(22.0), a);
    lanes t;
    const lanes part = exp_part_v(a + a, &t);
    const lanes scale = from_bits_v((bits_v(t) - UINT64_C(0x4337fffffffffc01)) << 52);
    const lanes e = scale * part + (scale - 1.0);
    const lanes y = choose_v(above, splat_v(1.0), e / (e + 2.0));
    return from_bits_v(bits_v(y) | (bits_v(x) ^ bits_v(a)));
}

#define ELBOW_OF_ONE(f) \
    static inline lanes f##_v(const lanes x) \
    { \
        lanes y = x; \
        for (int i = 0; i < LANES; ++i) { y[i] = f##_1(x[i]); } \
        return y; \
    }
#define ELBOW_OF_TWO(f) \
    static inline lanes f##_v(const lanes a, const lanes b) \
    { \
        lanes y = a; \
        for (int i = 0; i < LANES; ++i) { y[i] = f##_1(a[i], b[i]); } \
        return y; \
    }
ELBOW_OF_ONE(sqrt)
ELBOW_OF_ONE(log)
ELBOW_OF_ONE(expm1)
ELBOW_OF_ONE(log1p)
ELBOW_OF_ONE(erf)
ELBOW_OF_ONE(tan)
ELBOW_OF_ONE(asin)
ELBOW_OF_ONE(acos)
ELBOW_OF_ONE(atan)
ELBOW_OF_ONE(sinh)
ELBOW_OF_ONE(cosh)
ELBOW_OF_ONE(asinh)
ELBOW_OF_ONE(acosh)
ELBOW_OF_ONE(atanh)
ELBOW_OF_TWO(atan2)
ELBOW_OF_TWO(pow)
ELBOW_OF_TWO(fmod)
ELBOW_OF_TWO(remainder)
ELBOW_OF_TWO(hypot)

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
#define choose_v choose_1
#define fabs_v fabs_1
#define copysign_v copysign_1
#define truth_v truth_1
#define holds_v holds_1
#define lt_v lt_1
#define le_v le_1
#define eq_v eq_1
#define ne_v ne_1
#define and_v and_1
#define or_v or_1
#define not_v not_1
#define select_v select_1
#define if_else_zero_v if_else_zero_1
#define guarded_v guarded_1
#define sign_v sign_1
#define fmin_v fmin_1
#define fmax_v fmax_1
#define whole_v whole_1
#define floor_v floor_1
#define ceil_v ceil_1
#define reduce_v reduce_1
#define sine_cosine_part_v sine_cosine_part_1
#define sine_cosine_v sine_cosine_1
#define sin_v sin_1
#define cos_v cos_1
#define exp_part_v exp_part_1
#define exp_v exp_1
#define tanh_v tanh_1
#define sqrt_v sqrt_1
#define log_v log_1
#define expm1_v expm1_1
#define log1p_v log1p_1
#define erf_v erf_1
#define tan_v tan_1
#define asin_v asin_1
#define acos_v acos_1
#define atan_v atan_1
#define sinh_v sinh_1
#define cosh_v cosh_1
#define asinh_v asinh_1
#define acosh_v acosh_1
#define atanh_v atanh_1
#define atan2_v atan2_1
#define pow_v pow_1
#define fmod_v fmod_1
#define remainder_v remainder_1
#define hypot_v hypot_1
#endif

#define AT_ONCE 32 /* vectors of angles, whose reductions wait for their polynomials */

/* Sines and cosines of n angles; the arrays have PADDED(n) entries, the angles beyond n are zeros. */
ELBOW_INLINE void sincos_1(const real *x, real *s, real *c, const int n)
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

/* Sines and cosines of n vectors of angles. All reductions come first, written out, then all polynomials: the processor
   waits for a chain of operations less, as the chains are shorter and it sees more of them at once. */
ELBOW_INLINE void sincos_v(const lanes *x, lanes *s, lanes *c, const int n)
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
