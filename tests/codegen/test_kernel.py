"""The private header of the emitted C: how exact its functions are, and that every compiler gives
the same bits.
"""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from kernel_constants import ERRORS, PRECISIONS
from kernel_program import (
    LIBM_OF_ONE,
    LIBM_OF_TWO,
    NAME,
    POINTS,
    TYPES,
    angles,
    applied,
    both,
    error,
    needs_compiler,
    needs_long_double,
    program,
    same_bits,
)
from kernel_reference import DIGITS, minimax

from flexgen.base.errors import BuildError
from flexgen.codegen.emission.clib_files import kernel_files

# As the header states them. Every single-precision number was tried once: 0.87 (sine, cosine),
# 0.95 (exp), 2.61 (tanh).
SINCOS = ERRORS["sincos"]
EXP = ERRORS["exp"]
TANH = ERRORS["tanh"]
# |r| passes pi/4 where k is rounded the wrong way
MARGIN = {"double": mp.mpf(2) ** -20, "single": mp.mpf(2) ** -10}


def results(
    precision: str, name: str, x: np.ndarray, edits: tuple[tuple[str, str], ...] = ()
) -> np.ndarray:
    """One function's results, which are the same for numbers and vectors; (2, n) for sine and
    cosine.
    """
    by_numbers, by_vectors = applied(program(precision, edits), precision, {name: x})[name]
    assert same_bits(by_numbers, by_vectors)
    return by_vectors


def near_quarters(precision: str) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """The number next to every multiple of pi/2 in the range, which multiple, and 2^200 (number -
    multiple).
    """
    with mp.workdps(90):
        quarter = int(mp.nint(mp.ldexp(mp.pi / 2, 200)))
    steps = int(PRECISIONS[precision].angle / (np.pi / 2))
    exact = [k * quarter for k in range(1, steps)]
    x = np.array([math.ldexp(float(n), -200) for n in exact]).astype(TYPES[precision])
    return (
        x,
        np.arange(1, steps),
        [int(math.ldexp(v, 200)) - n for v, n in zip(x.tolist(), exact, strict=True)],
    )


def error_near_quarters(precision: str, edits: tuple[tuple[str, str], ...] = ()) -> float:
    """Where the sine or cosine of an angle is next to zero it is r - r^3/6, up to its sign, with a
    tiny r.
    """
    x, k, distance = near_quarters(precision)
    distance = [d - d**3 // (6 << 400) for d in distance]
    s, c = results(precision, "sincos", x, edits)
    small = np.where(k % 2 == 0, s, c) * np.array([1, -1, -1, 1], TYPES[precision])[k % 4]
    _, exponents = np.frexp(np.array([float(d) for d in distance]))
    digits = PRECISIONS[precision].digits + 1
    return max(
        abs(int(math.ldexp(y, 200)) - d) / 2.0 ** (e - digits)
        for y, d, e in zip(small.tolist(), distance, exponents.tolist(), strict=True)
    )


# --- the numbers ---------------------------------------------------------------------------------


@pytest.mark.slow
@both
def test_polynomials_have_the_minimax_error(precision):
    p = PRECISIONS[precision]
    with mp.workdps(DIGITS):
        margin = 1 + MARGIN[precision]
        end = (mp.pi / 4 * margin) ** 2
        half = mp.log(2) / 2 * margin
        sine = [(-1) ** (j + 1) / mp.factorial(2 * j + 3) for j in range(18)]
        cosine = [(-1) ** j / mp.factorial(2 * j + 4) for j in range(18)]
        exponential = [1 / mp.factorial(j + 2) for j in range(24)]
        cases = [
            (p.sine, sine, lambda z: z, end / 1000, end),
            (p.cosine, cosine, lambda z: z * z, end / 1000, end),
            (p.exponential, exponential, lambda r: r * r + half * half / 16, -half, half),
        ]
        for literals, series, weight, low, high in cases:
            best, worst = minimax(
                lambda x, c=series[::-1]: mp.polyval(c, x), weight, low, high, len(literals)
            )
            assert [TYPES[precision](c) for c in literals] == [
                TYPES[precision](float(c)) for c in best
            ]
            assert worst < 2.0 ** -(p.digits + 5)  # small relative to the rounding errors


@both
def test_parts_of_constants_are_exact(precision):
    p = PRECISIONS[precision]
    with mp.workdps(60):
        for whole, parts, steps in (
            (mp.pi / 2, p.half_pi, math.ceil(p.angle / (math.pi / 2))),
            (mp.log(2), p.log_2, math.ceil(-p.lowest / math.log(2))),
        ):
            rest = whole - mp.fsum(map(mp.mpf, parts))
            assert abs(rest) < abs(mp.mpf(parts[-1])) * 2.0**-p.digits
            for part in parts[:-1]:
                numerator = part.as_integer_ratio()[0]
                assert numerator.bit_length() + steps.bit_length() <= p.digits + 1
    assert [float(TYPES[precision](x)) for x in (*p.half_pi, *p.log_2)] == pytest.approx(
        p.half_pi + p.log_2, rel=1e-7
    )


def test_kernel_files_are_ascii_with_short_lines():
    for precision in PRECISIONS:
        for text in kernel_files(NAME, precision).values():
            assert (
                text.isascii()
                and text.endswith("\n")
                and "model" not in text.replace("the model", "")
            )
            assert max(map(len, text.splitlines())) <= 120 + len(NAME)
    with pytest.raises(BuildError, match="'half', expected double or single"):
        kernel_files(NAME, "half")


# --- how exact -----------------------------------------------------------------------------------


@needs_compiler
@needs_long_double
@both
def test_sine_and_cosine_are_exact_to_one_place(precision):
    wide = np.longdouble if precision == "double" else np.float64
    for name, x in angles(precision).items():
        s, c = results(precision, "sincos", x)
        assert error(s, np.sin(x.astype(wide))) <= SINCOS, name
        assert error(c, np.cos(x.astype(wide))) <= SINCOS, name
        assert (
            np.max(np.abs(s.astype(float) ** 2 + c.astype(float) ** 2 - 1))
            < 4 * np.finfo(s.dtype).eps
        )
        assert same_bits(s, results(precision, "sin", x))
        assert same_bits(c, results(precision, "cos", x))
        minus_s, minus_c = results(precision, "sincos", -x)
        assert same_bits(minus_s, -s) and same_bits(minus_c, c)


@needs_compiler
@both
def test_sine_and_cosine_against_many_digits(precision):
    for x in angles(precision).values():
        few = x[:250]
        s, c = results(precision, "sincos", few)
        with mp.workdps(60):
            for y, f in ((s, mp.sin), (c, mp.cos)):
                for a, b in zip(few.tolist(), y.tolist(), strict=True):
                    exact = f(mp.mpf(a))
                    place = mp.mpf(float(np.spacing(TYPES[precision](abs(float(exact))))))
                    assert abs(b - exact) <= SINCOS * place


@needs_compiler
@both
def test_sine_and_cosine_next_to_their_zeros(precision):
    assert error_near_quarters(precision) <= SINCOS


@needs_compiler
@needs_long_double
@both
def test_exp_and_tanh(precision):
    wide = np.longdouble if precision == "double" else np.float64
    dtype = TYPES[precision]
    rng = np.random.default_rng(11)
    low = math.log(float(np.finfo(dtype).tiny))
    high = math.log(float(np.finfo(dtype).max))
    signs = rng.choice([-1.0, 1.0], POINTS)
    for span in (
        rng.uniform(low, high, POINTS),
        rng.uniform(-1, 1, POINTS),
        signs * 10 ** rng.uniform(-30, 0, POINTS),
    ):
        x = span.astype(dtype)
        x = x[(x > low) & (x < high)]
        assert error(results(precision, "exp", x), np.exp(x.astype(wide))) <= EXP
    for span in (
        rng.uniform(-1, 1, POINTS),
        rng.uniform(-25, 25, POINTS),
        signs * 10 ** rng.uniform(-30, 0, POINTS),
    ):
        x = span.astype(dtype)
        y = results(precision, "tanh", x)
        assert error(y, np.tanh(x.astype(wide))) <= TANH
        assert np.all(np.abs(y) <= 1)
        assert same_bits(-y, results(precision, "tanh", -x))
    # results below the normal numbers
    gradual = rng.uniform(PRECISIONS[precision].lowest, low, 1000).astype(dtype)
    assert error(results(precision, "exp", gradual), np.exp(gradual.astype(wide))) <= EXP


@needs_compiler
@both
def test_special_values(precision):
    dtype = TYPES[precision]
    limit = dtype(PRECISIONS[precision].angle)
    beyond = np.nextafter(limit, dtype(np.inf))
    x = np.array(
        [0.0, -0.0, limit, -limit, beyond, -beyond, np.finfo(dtype).max, np.inf, -np.inf, np.nan],
        dtype,
    )
    s, c = results(precision, "sincos", x)
    assert same_bits(s[:2], x[:2]) and np.all(c[:2] == 1)
    assert np.all(np.isfinite(s[2:4])) and np.all(np.isfinite(c[2:4]))
    assert np.all(np.isnan(s[4:])) and np.all(np.isnan(c[4:]))
    tiny = np.array(
        [np.finfo(dtype).smallest_subnormal, -np.finfo(dtype).tiny, 3 * np.finfo(dtype).tiny],
        dtype,
    )
    assert same_bits(results(precision, "sin", tiny), tiny)
    assert same_bits(results(precision, "tanh", tiny), tiny)
    x = np.array(
        [0.0, -0.0, np.inf, -np.inf, np.nan, np.finfo(dtype).max, np.finfo(dtype).min], dtype
    )
    assert np.array_equal(
        results(precision, "exp", x), [1, 1, np.inf, 0, np.nan, np.inf, 0], equal_nan=True
    )
    y = results(precision, "tanh", x)
    assert (
        np.array_equal(y, [0, 0, 1, -1, np.nan, 1, -1], equal_nan=True)
        and math.copysign(1, y[1]) == -1
    )
    top = dtype(math.log(float(np.finfo(dtype).max)))
    bottom = dtype(math.log(float(np.finfo(dtype).smallest_subnormal)))
    x = np.array(
        [
            np.nextafter(top, dtype(0)),
            top * dtype(1.001),
            bottom * dtype(0.9999),
            bottom * dtype(1.01),
        ],
        dtype,
    )
    y = results(precision, "exp", x)
    assert np.isfinite(y[0]) and np.isinf(y[1]) and y[2] > 0 and y[3] == 0


@needs_compiler
@both
def test_comparisons_and_rounding(precision):
    dtype = TYPES[precision]
    big = 2.0 ** PRECISIONS[precision].digits
    edge = [
        0.0,
        -0.0,
        0.3,
        -0.3,
        0.5,
        -0.5,
        0.999,
        -0.999,
        1.0,
        -1.0,
        1.5,
        -1.5,
        2.5,
        big - 0.5,
        big,
        4 * big,
    ]
    edge += [-big, np.inf, -np.inf, np.nan, float(np.finfo(dtype).smallest_subnormal)]
    x = np.array(edge, dtype)
    a, b = (v.ravel() for v in np.meshgrid(x, x))
    true_a = a != 0
    true_b = b != 0
    of_one = {"fabs": np.abs(x), "floor": np.floor(x), "ceil": np.ceil(x), "not": x == 0}
    of_one["sign"] = np.where(x == 0, x, np.sign(x))
    for name, expected in of_one.items():
        assert same_bits(results(precision, name, x), expected.astype(dtype)), name
    of_two = {
        "copysign": np.copysign(a, b),
        "fmin": np.where((a == b) | np.isnan(b), a, np.fmin(a, b)),
        "fmax": np.where((a == b) | np.isnan(b), a, np.fmax(a, b)),
        "lt": a < b,
        "le": a <= b,
        "eq": a == b,
        "ne": a != b,
        "and": true_a & true_b,
        "or": true_a | true_b,
        "if_else_zero": np.where(true_a, b, 0),
    }
    for name, expected in of_two.items():
        assert same_bits(results(precision, name, np.array([a, b])), expected.astype(dtype)), name
    with np.errstate(all="ignore"):
        other = dtype(2.5) * b + dtype(1)
    assert same_bits(results(precision, "select", np.array([a, b])), np.where(true_a, b, other))


@needs_compiler
@both
def test_functions_of_the_mathematical_library(precision):
    dtype = TYPES[precision]
    x = np.linspace(0.05, 0.95, 64).astype(dtype)
    for name in LIBM_OF_ONE:
        y = results(precision, name, 1 + x if name == "acosh" else x)
        exact = getattr(mp, name)(mp.mpf(float((1 + x if name == "acosh" else x)[5])))
        assert float(y[5]) == pytest.approx(float(exact), rel=8 * float(np.finfo(dtype).eps))
    a = 7 * x
    b = x[::-1] + dtype(0.5)
    expected = {"atan2": np.arctan2, "pow": np.power, "fmod": np.fmod, "hypot": np.hypot}
    expected["remainder"] = lambda a, b: np.array(
        [math.remainder(float(u), float(v)) for u, v in zip(a, b, strict=True)]
    )
    for name in LIBM_OF_TWO:
        y = results(precision, name, np.array([a, b]))
        np.testing.assert_allclose(y, expected[name](a, b), rtol=8 * np.finfo(dtype).eps)


# --- planted bugs --------------------------------------------------------------------------------


@pytest.mark.slow
@needs_compiler
@needs_long_double
def test_wrong_digit_is_noticed():
    x = angles("double")["turns"]
    for digit, wrong in (
        ("0.008333333333322425", "0.008333333333422425"),
        ("-2.5050758648160705e-08", "-2.5053e-08"),
    ):
        s, c = results("double", "sincos", x, ((digit, wrong),))
        assert error(s, np.sin(x.astype(np.longdouble))) > SINCOS
    s, c = results("double", "sincos", x, (("2.087572368084499e-09", "2.087672368084499e-09"),))
    assert error(c, np.cos(x.astype(np.longdouble))) > SINCOS


@pytest.mark.slow
@needs_compiler
def test_lost_part_of_pi_is_noticed():
    assert error_near_quarters("double", (("3.5215598651832e-27", "0.0"),)) > SINCOS
    assert error_near_quarters("single", (("2.56334407e-12f", "0.0f"),)) > SINCOS
