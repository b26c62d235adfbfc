"""The private header ``<name>_kernel.h``: numbers, vectors of numbers, and the functions of both in C.

An emitted function is compiled twice from one text: for one point, with the type ``real`` and names that end in ``_1``,
and for ``LANES`` points at a time, with the vector type ``lanes`` and names that end in ``_v``. Here is what both use.
"""

from __future__ import annotations

from string import Template

from flexgen.errors import ArgumentError
from flexgen.expressions.elementary_functions import ERRORS, PRECISIONS, functions, number

# Functions of <math.h> that are applied to one number at a time.
_OF_ONE = "sqrt log expm1 log1p erf tan asin acos atan sinh cosh asinh acosh atanh".split()
_OF_TWO = "atan2 pow fmod remainder hypot".split()

# Everything else that has a text for one number and one for a vector.
_OWN = (
    "splat load store gather bits from_bits less less_equal equal choose fabs copysign truth holds lt le eq ne and or "
    "not select if_else_zero guarded sign fmin fmax whole floor ceil reduce sine_cosine_part "
    "sine_cosine sin cos exp_part exp tanh"
).split()


def kernel(name: str, precision: str) -> str:
    """The text of ``<name>_kernel.h``.

    Parameters
    ----------
    name : str
        Name of the library, which its header is called.
    precision : str
        ``double`` or ``single``.

    Returns
    -------
    str
        C99 that is C++17 too; no operation or literal of another precision.

    Raises
    ------
    ArgumentError
        For another precision.
    """
    if precision not in PRECISIONS:
        raise ArgumentError(f"the precision is {precision!r}, it can be {' or '.join(map(repr, PRECISIONS))}")
    own = Template(_NUMBERS + "\n" + functions(precision).template)
    p = PRECISIONS[precision]
    double = precision == "double"
    values = {
        "name": name,
        "NAME": name.upper(),
        "WIDTH": "64" if double else "32",
        "BYTES": "8" if double else "4",
        "BITS": "uint64_t" if double else "uint32_t",
        "SIGN_BIT": "UINT64_C(0x8000000000000000)" if double else "UINT32_C(0x80000000)",
        "ZERO": number(0.0, precision),
        "UNIT": number(1.0, precision),
        "WHOLE": number(2.0**p.digits, precision),
        "ANGLE": f"{p.angle:.0f}",
        "SINE_ERROR": f"{ERRORS['sincos']:g}",
        "EXP_ERROR": f"{ERRORS['exp']:g}",
        "TANH_ERROR": f"{ERRORS['tanh']:g}",
        "f": "" if double else "f",
    }

    def fill(text: str, **more: str) -> str:
        return Template(text).substitute(values | more)

    libm_1 = [f"static inline real {f}_1(const real x) {{ return {f}{values['f']}(x); }}" for f in _OF_ONE]
    libm_1 += [
        f"static inline real {f}_1(const real x, const real y) {{ return {f}{values['f']}(x, y); }}" for f in _OF_TWO
    ]
    libm_v = [f"{values['NAME']}_OF_ONE({f})" for f in _OF_ONE] + [f"{values['NAME']}_OF_TWO({f})" for f in _OF_TWO]
    aliases = [f"#define {f}_v {f}_1" for f in [*_OWN, *_OF_ONE, *_OF_TWO]]
    return "\n".join(
        [
            fill(_TYPES),
            fill(_PRIMITIVES_1),
            fill(own.template, T="real", B="bits", N="_1"),
            "/* The other functions: those of <math.h>. */",
            *libm_1,
            "",
            "#if LANES > 1",
            fill(_PRIMITIVES_V),
            fill(own.template, T="lanes", B="lanes_bits", N="_v"),
            fill(_LIBM_V),
            *libm_v,
            "",
            "#else /* a vector is one number */",
            *aliases,
            "#endif",
            "",
            fill(_ARRAYS),
        ]
    )


_TYPES = """\
/* Numbers, vectors of numbers and their functions, for the sources of this library only.
 *
 * What ends in _1 works on one number (real), what ends in _v on LANES numbers at once (lanes). Sine, cosine, exp and
 * tanh are polynomials without branches, tables or calls: the same bits for a number and a vector, on every processor
 * and at every level of optimisation, unless the compiler contracts products and sums (-ffp-contract=off forbids it).
 *
 *   sin, cos    error <= $SINE_ERROR unit of the last place for |x| <= $ANGLE rad; NaN beyond
 *   exp         error <= $EXP_ERROR unit; infinity above and zero below the numbers, fewer bits next to zero
 *   tanh        error <= $TANH_ERROR units
 */
#ifndef ${NAME}_KERNEL_H
#define ${NAME}_KERNEL_H

#include <float.h>
#include <math.h>
#include <stdint.h>

#include "$name.h"

#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(_M_FP_FAST) || \\
    (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0)
#error "compile without -ffast-math: it removes the rounding that sine, cosine and exp need"
#endif
#if FLT_EVAL_METHOD != 0
#error "compile for arithmetic that rounds every operation to its type, such as -msse2 -mfpmath=sse"
#endif

typedef ${name}_real real;
typedef $BITS bits;
typedef char ${name}_real_has_${WIDTH}_bits[sizeof(real) == sizeof(bits) ? 1 : -1];

#if defined(__GNUC__)
#define ${NAME}_INLINE static inline __attribute__((always_inline))
#else
#define ${NAME}_INLINE static inline
#endif

/* A vector has the alignment of one number and may alias numbers: any place in an array can be read as a vector. */
#if defined(__GNUC__) && !defined(${NAME}_NO_VECTORS) && \\
    (defined(__SSE2__) || defined(__aarch64__) || defined(__VSX__))
#if defined(__AVX512F__)
#define ${NAME}_VECTOR 64
#elif defined(__AVX__)
#define ${NAME}_VECTOR 32
#else
#define ${NAME}_VECTOR 16
#endif
#define LANES (${NAME}_VECTOR / $BYTES)
typedef real lanes __attribute__((vector_size(${NAME}_VECTOR), aligned($BYTES), may_alias));
typedef bits lanes_bits __attribute__((vector_size(${NAME}_VECTOR), aligned($BYTES), may_alias));
#else
#define LANES 1
typedef real lanes;
#endif

#define PADDED(n) (((n) + (LANES - 1)) / LANES * LANES) /* n rounded up to whole vectors */
"""

_PRIMITIVES_1 = """\
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
"""

_PRIMITIVES_V = """\
/* A vector. */
static inline lanes splat_v(const real x)
{
    const lanes zero = {0};
    return x - zero;
}

static inline lanes load_v(const real *p) { return *(const lanes *)p; }
static inline void store_v(real *p, const lanes x) { *(lanes *)p = x; }

/* The same as load_v for numbers that were written one by one just before: they need not pass through memory. */
${NAME}_INLINE lanes gather_v(const real *p)
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
"""

_NUMBERS = """\
static inline $T choose$N(const $B mask, const $T a, const $T b)
{
    return from_bits$N((bits$N(a) & mask) | (bits$N(b) & ~mask));
}

static inline $T fabs$N(const $T x) { return from_bits$N(bits$N(x) & ~$SIGN_BIT); }

static inline $T copysign$N(const $T x, const $T y)
{
    return from_bits$N((bits$N(x) & ~$SIGN_BIT) | (bits$N(y) & $SIGN_BIT));
}

/* Truth is 1 or 0; what is not 0 is true, NaN too. */
static inline $T truth$N(const $B mask) { return from_bits$N(mask & bits$N(splat$N($UNIT))); }
static inline $B holds$N(const $T x) { return ~equal$N(x, splat$N($ZERO)); }
static inline $T lt$N(const $T a, const $T b) { return truth$N(less$N(a, b)); }
static inline $T le$N(const $T a, const $T b) { return truth$N(less_equal$N(a, b)); }
static inline $T eq$N(const $T a, const $T b) { return truth$N(equal$N(a, b)); }
static inline $T ne$N(const $T a, const $T b) { return truth$N(~equal$N(a, b)); }
static inline $T and$N(const $T a, const $T b) { return truth$N(holds$N(a) & holds$N(b)); }
static inline $T or$N(const $T a, const $T b) { return truth$N(holds$N(a) | holds$N(b)); }
static inline $T not$N(const $T a) { return truth$N(~holds$N(a)); }
static inline $T select$N(const $T c, const $T a, const $T b) { return choose$N(holds$N(c), a, b); }
static inline $T if_else_zero$N(const $T c, const $T a) { return from_bits$N(holds$N(c) & bits$N(a)); }

/* x, or NaN where d is not above its least. */
static inline $T guarded$N(const $T x, const $T d, const $T least)
{
    return from_bits$N(bits$N(x) | ~less$N(least, d));
}

/* -1, 0 or 1; a zero and NaN stay as they are. */
static inline $T sign$N(const $T x)
{
    return choose$N(less$N(x, splat$N($ZERO)) | less$N(splat$N($ZERO), x), copysign$N(splat$N($UNIT), x), x);
}

/* Where one is NaN, the other; where both are equal, the first. */
static inline $T fmin$N(const $T a, const $T b) { return choose$N(less_equal$N(a, b) | ~equal$N(b, b), a, b); }
static inline $T fmax$N(const $T a, const $T b) { return choose$N(less_equal$N(b, a) | ~equal$N(b, b), a, b); }

/* The nearest whole number, of the sign of x; from $WHOLE on every number is whole. */
static inline $T whole$N(const $T x)
{
    const $T a = fabs$N(x);
    const $T n = (a + $WHOLE) - $WHOLE;
    return copysign$N(choose$N(less$N(a, splat$N($WHOLE)), n, a), x);
}

static inline $T floor$N(const $T x)
{
    const $T n = whole$N(x);
    return n - lt$N(x, n);
}

static inline $T ceil$N(const $T x)
{
    const $T n = whole$N(x);
    return copysign$N(n + lt$N(n, x), x);
}
"""

_LIBM_V = """\
#define ${NAME}_OF_ONE(f) \\
    static inline lanes f##_v(const lanes x) \\
    { \\
        lanes y = x; \\
        for (int i = 0; i < LANES; ++i) { y[i] = f##_1(x[i]); } \\
        return y; \\
    }
#define ${NAME}_OF_TWO(f) \\
    static inline lanes f##_v(const lanes a, const lanes b) \\
    { \\
        lanes y = a; \\
        for (int i = 0; i < LANES; ++i) { y[i] = f##_1(a[i], b[i]); } \\
        return y; \\
    }"""

_ARRAYS = """\
#define AT_ONCE 32 /* vectors of angles, whose reductions wait for their polynomials */

/* Sines and cosines of n angles; the arrays have PADDED(n) entries, the angles beyond n are zeros. */
${NAME}_INLINE void sincos_1(const real *x, real *s, real *c, const int n)
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
${NAME}_INLINE void sincos_v(const lanes *x, lanes *s, lanes *c, const int n)
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
"""
