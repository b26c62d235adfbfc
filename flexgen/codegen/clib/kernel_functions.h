/*
 * model: elementary functions, for T a real and for T lanes of reals; private. Written by flexgen;
 * see model.h.
 *
 * Included twice by model_kernel.h: T is the type, B the unsigned integers of its width, F(name)
 * the name of a function. Both hold the same operations in the same order, each rounded once, so
 * that they give the same bits.
 */

static inline T F(choose)(const B mask, const T a, const T b)
{
    return F(from_bits)((F(bits)(a) & mask) | (F(bits)(b) & ~mask));
}

static inline T F(fabs)(const T x)
{
    return F(from_bits)(F(bits)(x) & ~SIGN_BIT);
}

static inline T F(copysign)(const T x, const T y)
{
    return F(from_bits)((F(bits)(x) & ~SIGN_BIT) | (F(bits)(y) & SIGN_BIT));
}

/* Truth is 1 or 0; what is not 0 is true, NaN too. */
static inline T F(truth)(const B mask)
{
    return F(from_bits)(mask & F(bits)(F(splat)(ONE)));
}
static inline B F(holds)(const T x)
{
    return ~F(equal)(x, F(splat)(ZERO));
}
static inline T F(lt)(const T a, const T b)
{
    return F(truth)(F(less)(a, b));
}
static inline T F(le)(const T a, const T b)
{
    return F(truth)(F(less_equal)(a, b));
}
static inline T F(eq)(const T a, const T b)
{
    return F(truth)(F(equal)(a, b));
}
static inline T F(ne)(const T a, const T b)
{
    return F(truth)(~F(equal)(a, b));
}
static inline T F (and)(const T a, const T b)
{
    return F(truth)(F(holds)(a) & F(holds)(b));
}
static inline T F(or)(const T a, const T b)
{
    return F(truth)(F(holds)(a) | F(holds)(b));
}
static inline T F(not)(const T a)
{
    return F(truth)(~F(holds)(a));
}
static inline T F(select)(const T c, const T a, const T b)
{
    return F(choose)(F(holds)(c), a, b);
}
static inline T F(if_else_zero)(const T c, const T a)
{
    return F(from_bits)(F(holds)(c) & F(bits)(a));
}

/* x, or NaN where d is not above its least. */
static inline T F(guarded)(const T x, const T d, const T least)
{
    return F(from_bits)(F(bits)(x) | ~F(less)(least, d));
}

/* -1, 0 or 1; a zero and NaN stay as they are. */
static inline T F(sign)(const T x)
{
    return F(choose)(
        F(less)(x, F(splat)(ZERO)) | F(less)(F(splat)(ZERO), x), F(copysign)(F(splat)(ONE), x), x);
}

/* Where one is NaN, the other; where both are equal, the first. */
static inline T F(fmin)(const T a, const T b)
{
    return F(choose)(F(less_equal)(a, b) | ~F(equal)(b, b), a, b);
}
static inline T F(fmax)(const T a, const T b)
{
    return F(choose)(F(less_equal)(b, a) | ~F(equal)(b, b), a, b);
}

/* The nearest whole number, of the sign of x; from WHOLE_FROM on every number is whole. */
static inline T F(whole)(const T x)
{
    const T a = F(fabs)(x);
    const T n = (a + WHOLE_FROM) - WHOLE_FROM;
    return F(copysign)(F(choose)(F(less)(a, F(splat)(WHOLE_FROM)), n, a), x);
}

static inline T F(floor)(const T x)
{
    const T n = F(whole)(x);
    return n - F(lt)(x, n);
}

static inline T F(ceil)(const T x)
{
    const T n = F(whole)(x);
    return F(copysign)(n + F(lt)(n, x), x);
}

/*
 * x = k pi/2 + r - tail with a whole number k and |r| <= pi/4: the products with the first three
 * parts of pi/2 and the differences up to r are exact. The lowest bits of *turns hold k; beyond
 * the range *tail is NaN.
 */
static inline void F(reduce)(const T x, T *turns, T *remainder, T *tail)
{
    const T t = x * PER_QUARTER + SHIFT; /* rounds to k */
    const T k = t - SHIFT;
    const T rough = (x - k * HALF_PI_1) - k * HALF_PI_2;
    const T w = k * HALF_PI_3;
    const T r = rough - w;
    const T rest = (w - (rough - r)) + k * HALF_PI_4;
    *turns = t;
    *remainder = r;
    *tail = F(from_bits)(F(bits)(rest) | F(less)(F(splat)(ANGLE_MAX), F(fabs)(x)));
}

/*
 * Sine and cosine from the results of reduce: one polynomial for each, exchanged for odd k. The
 * sine of -0 is -0.
 */
static inline void F(sine_cosine_part)(const T turns, const T r, const T tail, T *sine, T *cosine)
{
    const T z = r * r;
    const T z2 = z * z;
    const T p = SINE(z, z2);
    const T q = COSINE(z, z2);
    const T half = HALF * z;
    const T most = ONE - half;
    const T s = r - (tail * most - (z * r) * p);
    const T c = most + (z2 * q + (((ONE - most) - half) + tail * r));
    const B n = F(bits)(turns);
    const B swap = (F(bits)(s) ^ F(bits)(c)) & (0 - (n & 1));
    const B minus_s = (n & 2) << TO_SIGN;
    const B minus_c = ((n + 1) & 2) << TO_SIGN;
    *sine = F(from_bits)((F(bits)(s) ^ swap) ^ minus_s);
    *cosine = F(from_bits)((F(bits)(c) ^ swap) ^ minus_c);
}

MODEL_INLINE void F(sine_cosine)(const T x, T *sine, T *cosine)
{
    T turns, r, tail;
    F(reduce)(x, &turns, &r, &tail);
    F(sine_cosine_part)(turns, r, tail, sine, cosine);
}

static inline T F(sin)(const T x)
{
    T s, c;
    F(sine_cosine)(x, &s, &c);
    return s;
}

static inline T F(cos)(const T x)
{
    T s, c;
    F(sine_cosine)(x, &s, &c);
    return c;
}

/* exp(r) - 1 where x = k log(2) + r; the lowest bits of *t hold k. */
static inline T F(exp_part)(const T x, T *t)
{
    const T shifted = x * PER_LOG_2 + SHIFT;
    const T k = shifted - SHIFT;
    const T rough = x - k * LOG_2_1;
    const T w = k * LOG_2_2;
    const T r = rough - w;
    const T tail = (rough - r) - w;
    const T r2 = r * r;
    const T r4 = r2 * r2;
    const T p = EXPONENTIAL(r, r2, r4);
    *t = shifted;
    return r + (tail + r2 * p);
}

/*
 * exp(x): 2^k in two factors, so that large results reach infinity and small ones lose their bits
 * one by one.
 */
static inline T F(exp)(const T x)
{
    const B above = F(less)(F(splat)(HIGHEST), x);
    const B below = F(less)(x, F(splat)(LOWEST));
    T t;
    const T part = F(exp_part)(x, &t);
    const B k = F(bits)(t) - TWICE_BIASED;
    const B first = k >> 1;
    const T y = ((ONE + part) * F(from_bits)(first << DIGITS)) *
                F(from_bits)((k - first) << DIGITS);
    return F(from_bits)((F(bits)(y) & ~(above | below)) | (above & INFINITE));
}

/*
 * tanh(x) = e / (e + 2) with e = exp(2 |x|) - 1 = 2^k (exp(r) - 1) + (2^k - 1), and the sign of x.
 */
static inline T F(tanh)(const T x)
{
    const T a = F(fabs)(x);
    const B above = F(less)(F(splat)(ONE_FROM), a);
    T t;
    const T part = F(exp_part)(a + a, &t);
    const T scale = F(from_bits)((F(bits)(t) - BIASED) << DIGITS);
    const T e = scale * part + (scale - ONE);
    const T y = F(choose)(above, F(splat)(ONE), e / (e + TWO));
    return F(from_bits)(F(bits)(y) | (F(bits)(x) ^ F(bits)(a)));
}
