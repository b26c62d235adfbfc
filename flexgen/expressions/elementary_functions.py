"""The C text of sine, cosine, exp and tanh, written once for a number and once for a vector of numbers.

Both texts hold the same operations in the same order, each rounded once, so that they give the same bits. A ``$T`` is
the type (``real`` or ``lanes``), ``$B`` the unsigned integers of the same width, ``$N`` the ending of a name.
"""

from __future__ import annotations

from dataclasses import dataclass
from string import Template


@dataclass(frozen=True)
class Precision:
    """The numbers that a precision needs; polynomials from the constant on, found by Remez' exchange.

    Parameters
    ----------
    digits : int
        Bits of the mantissa that are stored.
    bias : int
        Of the exponent.
    half_pi, log_2 : tuple of float
        Parts whose sum is pi/2 and log(2): every part but the last has so few bits that its product with the number of
        steps is exact.
    angle : float
        [rad] largest angle; beyond it sine and cosine are NaN.
    highest, lowest : float
        Above and below, exp is infinite and zero.
    one : float
        From here on tanh is 1.
    sine, cosine, exponential : tuple of float
        ``(sin(r)/r - 1)/z`` and ``(cos(r) - 1 + z/2)/z^2`` in ``z = r^2``, |r| <= pi/4; ``(exp(r) - 1 - r)/r^2`` in r,
        |r| <= log(2)/2.
    """

    digits: int
    bias: int
    half_pi: tuple[float, ...]
    log_2: tuple[float, ...]
    angle: float
    highest: float
    lowest: float
    one: float
    sine: tuple[float, ...]
    cosine: tuple[float, ...]
    exponential: tuple[float, ...]


DOUBLE = Precision(
    digits=52,
    bias=1023,
    half_pi=(1.5707963267341256, 6.077094383272197e-11, 6.12323399538461e-17, 3.5215598651832e-27),
    log_2=(0.6931471805598903, 5.497923018708371e-14),
    angle=1e6,
    highest=710.0,
    lowest=-746.0,
    one=22.0,
    sine=(
        -0.16666666666666632,
        0.008333333333322425,
        -0.00019841269829816863,
        2.755731369519521e-06,
        -2.5050758648160705e-08,
        1.5896827621544008e-10,
    ),
    cosine=(
        0.0416666666666666,
        -0.0013888888888874138,
        2.4801587289491742e-05,
        -2.755731435521654e-07,
        2.087572368084499e-09,
        -1.1359669674695726e-11,
    ),
    exponential=(
        0.5000000000000007,
        0.1666666666666669,
        0.0416666666665598,
        0.00833333333331177,
        0.001388888893676217,
        0.000198412699089098,
        2.480149951410159e-05,
        2.7557222947699084e-06,
        2.762815299425782e-07,
        2.5115979876370163e-08,
    ),
)

SINGLE = Precision(
    digits=23,
    bias=127,
    half_pi=(1.5703125, 0.0004837512969970703, 7.549533620476723e-08, 2.5633440682570896e-12),
    log_2=(0.693145751953125, 1.428606765330187e-06),
    angle=1e4,
    highest=89.0,
    lowest=-104.0,
    one=10.0,
    sine=(-0.16666655242443085, 0.008332173340022564, -0.00019516670727171004),
    cosine=(0.04166664555668831, -0.001388736185617745, 2.4437746105832048e-05),
    exponential=(0.5, 0.1666652411222458, 0.04166622459888458, 0.008368466049432755, 0.0013949504354968667),
)

PRECISIONS = {"double": DOUBLE, "single": SINGLE}

# Bounds of the errors in units of the last place of the result, of both precisions; the tests hold them.
ERRORS = {"sincos": 1.0, "exp": 1.0, "tanh": 3.0}


def number(x: float, precision: str) -> str:
    """A number as a C literal of the precision, with enough digits to read back to the same bits."""
    if precision == "double":
        return repr(float(x))
    text = f"{x:.9g}"
    return (text if "." in text or "e" in text else f"{text}.0") + "f"


def functions(precision: str) -> Template:
    """C text of sine and cosine, exp and tanh, with ``$T``, ``$B`` and ``$N`` left open."""
    p = PRECISIONS[precision]

    def c(x: float) -> str:
        return number(x, precision)

    shift = 1.5 * 2.0**p.digits
    zero = ((p.bias + p.digits) << p.digits) + (1 << (p.digits - 1))  # the bits of the shift
    sine, sine_value = _sum_of_pairs("u", "z", tuple(map(c, p.sine)))
    cosine, cosine_value = _sum_of_pairs("v", "z", tuple(map(c, p.cosine)))
    exponential, exponential_value = _sum_of_pairs("u", "r", tuple(map(c, p.exponential)))
    values = {
        "SHIFT": c(shift),
        "PER_QUARTER": c(2.0 / 3.141592653589793),
        **{f"HALF_PI_{k + 1}": c(x) for k, x in enumerate(p.half_pi)},
        "PER_LOG_2": c(1.4426950408889634),
        **{f"LOG_2_{k + 1}": c(x) for k, x in enumerate(p.log_2)},
        "ANGLE": c(p.angle),
        "HIGHEST": c(p.highest),
        "LOWEST": c(p.lowest),
        "ONE_FROM": c(p.one),
        "HALF": c(0.5),
        "ONE": c(1.0),
        "TWO": c(2.0),
        "SINE_POWER": "" if len(p.sine) <= 4 else "    const $T z4 = z2 * z2;\n",
        "EXP_POWER": "" if len(p.exponential) <= 8 else "    const $T r8 = r4 * r4;\n",
        "SINE": sine,
        "SINE_VALUE": sine_value,
        "COSINE": cosine,
        "COSINE_VALUE": cosine_value,
        "EXPONENTIAL": exponential,
        "EXPONENTIAL_VALUE": exponential_value,
        "DIGITS": str(p.digits),
        "TO_SIGN": "62" if precision == "double" else "30",
        "TWICE_BIASED": _bits(zero - 2 * p.bias, precision),
        "INFINITE": _bits(((2 * p.bias + 1) << p.digits), precision),
        "BIASED": _bits(zero - p.bias, precision),
    }
    return Template(Template(_FUNCTIONS).safe_substitute(values))


def _bits(x: int, precision: str) -> str:
    """An unsigned integer as a C literal of the width of a number."""
    return f"UINT64_C(0x{x:016x})" if precision == "double" else f"UINT32_C(0x{x:08x})"


def _sum_of_pairs(name: str, variable: str, coefficients: tuple[str, ...]) -> tuple[str, str]:
    """A polynomial as statements for its pairs of terms, and the expression that joins them with few steps in a row."""
    statements, terms = [], []
    for i in range(0, len(coefficients) - 1, 2):
        term = f"{name}{i // 2}"
        low, high = coefficients[i : i + 2]
        statements.append(f"    const $T {term} = {low} + {high} * {variable};\n")
        terms.append(term)
    if len(coefficients) % 2:
        terms.append(coefficients[-1])
    power = 2
    while len(terms) > 1:
        joined = [f"({a} + {variable}{power} * {b})" for a, b in zip(terms[::2], terms[1::2], strict=False)]
        terms = joined + (terms[-1:] if len(terms) % 2 else [])
        power *= 2
    return "".join(statements), terms[0]


_FUNCTIONS = """\
/* x = k pi/2 + r - tail with a whole number k and |r| <= pi/4: the products with the first three parts of pi/2 and the
   differences up to r are exact. The lowest bits of *turns hold k; beyond the range *tail is NaN. */
static inline void reduce$N(const $T x, $T *turns, $T *remainder, $T *tail)
{
    const $T t = x * $PER_QUARTER + $SHIFT; /* rounds to k */
    const $T k = t - $SHIFT;
    const $T rough = (x - k * $HALF_PI_1) - k * $HALF_PI_2;
    const $T w = k * $HALF_PI_3;
    const $T r = rough - w;
    const $T rest = (w - (rough - r)) + k * $HALF_PI_4;
    *turns = t;
    *remainder = r;
    *tail = from_bits$N(bits$N(rest) | less$N(splat$N($ANGLE), fabs$N(x)));
}

/* Sine and cosine of what reduce gave: one polynomial for each; k tells which is which. Of -0 the sine is -0. */
static inline void sine_cosine_part$N(const $T turns, const $T r, const $T tail, $T *sine, $T *cosine)
{
    const $T z = r * r;
    const $T z2 = z * z;
$SINE_POWER$SINE$COSINE    const $T p = $SINE_VALUE;
    const $T q = $COSINE_VALUE;
    const $T half = $HALF * z;
    const $T most = $ONE - half;
    const $T s = r - (tail * most - (z * r) * p);
    const $T c = most + (z2 * q + ((($ONE - most) - half) + tail * r));
    const $B n = bits$N(turns);
    const $B swap = (bits$N(s) ^ bits$N(c)) & (0 - (n & 1));
    const $B minus_s = (n & 2) << $TO_SIGN;
    const $B minus_c = ((n + 1) & 2) << $TO_SIGN;
    *sine = from_bits$N((bits$N(s) ^ swap) ^ minus_s);
    *cosine = from_bits$N((bits$N(c) ^ swap) ^ minus_c);
}

static inline void sine_cosine$N(const $T x, $T *sine, $T *cosine)
{
    $T turns, r, tail;
    reduce$N(x, &turns, &r, &tail);
    sine_cosine_part$N(turns, r, tail, sine, cosine);
}

static inline $T sin$N(const $T x)
{
    $T s, c;
    sine_cosine$N(x, &s, &c);
    return s;
}

static inline $T cos$N(const $T x)
{
    $T s, c;
    sine_cosine$N(x, &s, &c);
    return c;
}

/* exp(r) - 1 where x = k log(2) + r; the lowest bits of *t hold k. */
static inline $T exp_part$N(const $T x, $T *t)
{
    const $T shifted = x * $PER_LOG_2 + $SHIFT;
    const $T k = shifted - $SHIFT;
    const $T rough = x - k * $LOG_2_1;
    const $T w = k * $LOG_2_2;
    const $T r = rough - w;
    const $T tail = (rough - r) - w;
    const $T r2 = r * r;
    const $T r4 = r2 * r2;
$EXP_POWER$EXPONENTIAL    const $T p = $EXPONENTIAL_VALUE;
    *t = shifted;
    return r + (tail + r2 * p);
}

/* exp(x): 2^k in two factors, so that large results reach infinity and small ones lose their bits one by one. */
static inline $T exp$N(const $T x)
{
    const $B above = less$N(splat$N($HIGHEST), x);
    const $B below = less$N(x, splat$N($LOWEST));
    $T t;
    const $T part = exp_part$N(x, &t);
    const $B k = bits$N(t) - $TWICE_BIASED;
    const $B first = k >> 1;
    const $T y = (($ONE + part) * from_bits$N(first << $DIGITS)) * from_bits$N((k - first) << $DIGITS);
    return from_bits$N((bits$N(y) & ~(above | below)) | (above & $INFINITE));
}

/* tanh(x) = e / (e + 2) with e = exp(2 |x|) - 1 = 2^k (exp(r) - 1) + (2^k - 1), and the sign of x. */
static inline $T tanh$N(const $T x)
{
    const $T a = fabs$N(x);
    const $B above = less$N(splat$N($ONE_FROM), a);
    $T t;
    const $T part = exp_part$N(a + a, &t);
    const $T scale = from_bits$N((bits$N(t) - $BIASED) << $DIGITS);
    const $T e = scale * part + (scale - $ONE);
    const $T y = choose$N(above, splat$N($ONE), e / (e + $TWO));
    return from_bits$N(bits$N(y) | (bits$N(x) ^ bits$N(a)));
}
"""
