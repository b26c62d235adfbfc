"""Polynomials in constants and in sines and cosines of angles: exact, canonical, and arranged for
a reader.

Every entry of the closed-form equations of a chain is such a polynomial. Sums and products are
those of a sparse polynomial ring over the rationals, with one generator for each sine and cosine;
``sin^2 = 1 - cos^2`` is applied after each product, so that equal expressions are equal objects
and zeros are recognised without any guessing. What a person reads is the shortest of several equal
forms: multiple angles, or powers of sines and cosines of relative or absolute angles.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sp
from sympy.polys.orderings import lex
from sympy.polys.rings import PolyRing

from flexgen.base.errors import ArgumentError

Element = Any  # an element of a sympy PolyRing
Vector3 = list[Element]
Matrix3 = list[list[Element]]
Rows = Sequence[Sequence[int]]
Levels = Sequence[Sequence[sp.Symbol] | None]
Waves = dict[tuple[int, ...], list[Element]]

MAX_TERMS = 3000  # in one polynomial: longer expressions are not readable
MAX_TERMS_TIDIED = 250  # up to here all forms are tried and factored
MAX_TERMS_FACTORED = 24


class TrigonometricRing:
    """Polynomials with rational coefficients in symbols and in sines and cosines of angles.

    Parameters
    ----------
    constants : sequence of Symbol
        Variables of the polynomials, speeds included.
    angles : sequence of Symbol
        Symbols that appear inside sines and cosines; one that is also in ``constants`` may be
        both.
    unit_vectors : sequence of tuple of Symbol
        Symbols whose squares add up to one.
    heavy, light : sequence of Symbol
        What to collect by: quantities in which the expressions are linear (masses, inertias), and
        speeds.
    absolute : sequence of sequence of int
        Rows: absolute angles as sums of ``angles`` (lower triangular, entries -1, 0, 1,
        determinant 1 or -1).
    """

    def __init__(
        self,
        constants: Sequence[sp.Symbol],
        angles: Sequence[sp.Symbol],
        unit_vectors: Sequence[tuple[sp.Symbol, ...]] = (),
        heavy: Sequence[sp.Symbol] = (),
        light: Sequence[sp.Symbol] = (),
        absolute: Rows = (),
    ) -> None:
        self.constants = tuple(constants)
        self.angles = tuple(angles)
        self.heavy = heavy
        self.light = light
        self.n = len(self.constants)
        self._trig = [sp.Dummy(f"{f}_{a}", real=True) for a in self.angles for f in ("c", "s")]
        self.ring = PolyRing([*self.constants, *self._trig], sp.QQ, lex)
        self.zero = self.ring.zero
        self.one = self.ring.one
        self._at = {symbol: i for i, symbol in enumerate(self.ring.symbols)}
        gens = self.ring.gens
        self._squares = {
            self.n + 2 * i + 1: self.one - gens[self.n + 2 * i] ** 2
            for i in range(len(self.angles))
        }
        for vector in unit_vectors:
            others = [gens[self._at[symbol]] ** 2 for symbol in vector[:-1]]
            self._squares[self._at[vector[-1]]] = self.one - sum(others, self.zero)
        identity = [[int(i == j) for j in range(len(angles))] for i in range(len(angles))]
        self._bases: list[tuple[Rows, Rows]] = [(identity, identity)]
        if absolute and list(map(list, absolute)) != identity:
            inverse = np.rint(np.linalg.inv(np.array(absolute))).astype(int).tolist()
            self._bases.append((absolute, inverse))

    def element(self, value: sp.Expr | int) -> Element:
        """A rational number, or a symbol, or the product of both."""
        number, symbol = sp.sympify(value).as_coeff_Mul()
        generator = self.ring.gens[self._at[symbol]] if symbol.is_Symbol else self.one
        return generator * sp.QQ(number.p, number.q)

    def cos(self, angle: sp.Symbol) -> Element:
        """Cosine of one of the angles."""
        return self.ring.gens[self.n + 2 * self.angles.index(angle)]

    def sin(self, angle: sp.Symbol) -> Element:
        """Sine of one of the angles."""
        return self.ring.gens[self.n + 2 * self.angles.index(angle) + 1]

    def reduce(self, p: Element) -> Element:
        """The canonical form of ``p``: squares of sines, and of the last component of symbolic
        unit vectors, are replaced by ``1 - ...`` until none is left. ArgumentError where it has
        too many terms to be of use.
        """
        while True:
            if len(p) > MAX_TERMS:
                raise ArgumentError(
                    f"symbolic: given a model whose equations have more than {MAX_TERMS} terms "
                    "in one entry, expected one small enough for a closed form; the numeric "
                    "(CasADi) equations are available for any model"
                )
            kept = {}
            changed = self.zero
            for monomial, coefficient in p.items():
                factor = None
                powers = None
                for i, square in self._squares.items():
                    if monomial[i] >= 2:
                        powers = list(monomial) if powers is None else powers
                        powers[i] = monomial[i] % 2
                        factor = square ** (monomial[i] // 2) * (
                            self.one if factor is None else factor
                        )
                if factor is None:
                    kept[monomial] = coefficient
                else:
                    changed = changed + factor * self.ring.from_dict(
                        {tuple(powers or ()): coefficient}
                    )
            if not changed:
                return p
            p = changed + self.ring.from_dict(kept)

    def diff(self, p: Element, by: sp.Symbol) -> Element:
        """Derivative by a symbol, be it a constant, an angle or both."""
        out = p.diff(self.element(by)) if by in self._at else self.zero
        if by in self.angles:
            c = self.cos(by)
            s = self.sin(by)
            out = out + p.diff(s) * c - p.diff(c) * s
        return self.reduce(out)

    # --- vectors and matrices, as lists ----------------------------------------------------------

    def dot(self, a: Sequence[Element], b: Sequence[Element]) -> Element:
        """Scalar product."""
        return self.reduce(sum((x * y for x, y in zip(a, b, strict=True) if x and y), self.zero))

    def cross(self, a: Vector3, b: Vector3) -> Vector3:
        """Vector product."""
        return [
            self.reduce(a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3])
            for i in range(3)
        ]

    def multiply(self, A: Matrix3, b: Vector3) -> Vector3:
        """Product of a matrix and a vector."""
        return [self.dot(row, b) for row in A]

    def rotation(self, axis: Vector3, c: Element, s: Element) -> Matrix3:
        """Rotation about a unit axis by the angle with cosine ``c`` and sine ``s`` (Rodrigues)."""
        x, y, z = axis
        skew = [[self.zero, -z, y], [z, self.zero, -x], [-y, x, self.zero]]
        turn = [
            [axis[i] * axis[j] * (self.one - c) + skew[i][j] * s for j in range(3)]
            for i in range(3)
        ]
        return [
            [self.reduce(turn[i][j] + (c if i == j else self.zero)) for j in range(3)]
            for i in range(3)
        ]

    # --- equal forms -----------------------------------------------------------------------------

    def expression(self, p: Element) -> sp.Expr:
        """The form of ``p`` that is shortest to read: as a whole, or part by part, each in the
        form that suits it.
        """
        common, p = _extract_common(p, self.n)
        found = [self._find_shortest(p, [[self.heavy, None], [None], [self.light, None]])]
        for by in (self.heavy, self.light, [*self.heavy, *self.light]):
            groups = _group(p, by)
            if len(groups) > 1:
                parts = []
                for key, part in groups:
                    shared, rest = _extract_common(part, self.n)
                    parts.append(
                        _times(
                            key.as_expr() * shared,
                            self._find_shortest(rest, [[None], [self.light, None]]),
                        )
                    )
                found.append(sp.Add(*parts))
        return _times(common, min(found, key=sp.count_ops))

    def _find_shortest(self, p: Element, orders: Sequence[Levels]) -> sp.Expr:
        """The shortest form of ``p``, collected in one of the orders; None in an order means sines
        and cosines.
        """
        if len(p) <= 1 and not any(any(m[self.n :]) for m in p):
            return p.as_expr()
        found = []
        for form, functions in self._forms(p):
            trig = list(functions)
            for order in (
                orders if len(form) <= MAX_TERMS_TIDIED else [[self.heavy, self.light, trig]]
            ):
                levels = [trig if level is None else level for level in order]
                found.append(_nest(form, levels).xreplace(functions))
        return min(found, key=sp.count_ops)

    def _forms(self, p: Element) -> Iterator[tuple[Element, dict[sp.Dummy, sp.Expr]]]:
        """Equal forms of ``p``, of which the shortest is chosen: polynomials with dummies, and the
        expressions of the dummies.

        As a sum of waves, then as polynomials in sines and cosines of each basis of angles (such
        as sums of parallel joints), then with squares of sines instead of cosines. Long ones
        (`MAX_TERMS_TIDIED`) stay as they are.
        """
        if len(p) > MAX_TERMS_TIDIED:
            yield p, self._functions(self._bases[0][0])
            return
        waves = self._waves(p)
        functions: dict[sp.Dummy, sp.Expr] = {}
        terms = []
        for frequency, pair in waves.items():
            angle = sum(
                (k * a for k, a in zip(frequency, self.angles, strict=True)), sp.Integer(0)
            )
            for coefficient, f in zip(pair, (sp.cos, sp.sin), strict=True):
                if coefficient:
                    dummy = sp.Dummy(real=True) if angle != 0 else None
                    if dummy is not None:
                        functions[dummy] = f(angle)
                    terms.append((coefficient, dummy))
        ring = PolyRing([*self.constants, *functions], sp.QQ, lex)
        at = {dummy: self.n + i for i, dummy in enumerate(functions)}
        wave_form = ring.zero
        for coefficient, dummy in terms:
            unit = [int(at.get(dummy) == self.n + i) for i in range(len(functions))]
            wave_form += ring.from_dict({(*m[: self.n], *unit): k for m, k in coefficient.items()})
        yield wave_form, functions
        for basis, inverse in self._bases:
            q = self.zero
            for frequency, (c, s) in waves.items():
                turned = (
                    sum(f * x for f, x in zip(frequency, column, strict=True))
                    for column in zip(*inverse, strict=True)
                )
                real, imaginary = self._powers(tuple(turned))
                q = q + c * real + s * imaginary
            q = self.reduce(q)
            yield q, self._functions(basis)
            # squares of sines instead of those of cosines
            for i in range(self.n, self.n + len(self._trig), 2):
                q = self._without_squares(q, i, self.one - self.ring.gens[i + 1] ** 2)
            yield q, self._functions(basis)

    def _functions(self, basis: Rows) -> dict[sp.Dummy, sp.Expr]:
        """Expressions of the generators of cosines and sines where they mean sums of the
        angles.
        """
        angles = [
            sum((k * a for k, a in zip(row, self.angles, strict=True)), sp.Integer(0))
            for row in basis
        ]
        values = [f(angle) for angle in angles for f in (sp.cos, sp.sin)]
        return dict(zip(self._trig, values, strict=True))

    def _without_squares(self, p: Element, i: int, square: Element) -> Element:
        """``p`` with even powers of generator ``i`` replaced by powers of ``square``, an equal
        polynomial.
        """
        out = self.zero
        for monomial, coefficient in p.items():
            rest = self.ring.from_dict(
                {(*monomial[:i], monomial[i] % 2, *monomial[i + 1 :]): coefficient}
            )
            out = out + rest * square ** (monomial[i] // 2)
        return out

    def _waves(self, p: Element) -> Waves:
        """Fourier form: frequency -> factors (free of angles) of cosine and sine of
        ``frequency . angles``.
        """
        waves: Waves = {}
        for monomial, coefficient in p.items():
            rest = self.ring.from_dict(
                {(*monomial[: self.n], *[0] * len(self._trig)): coefficient}
            )
            for frequency, (c, s) in _expand(monomial[self.n :]).items():
                pair = waves.setdefault(frequency, [self.zero, self.zero])
                pair[0] = pair[0] + rest * c
                pair[1] = pair[1] + rest * s
        return {frequency: pair for frequency, pair in waves.items() if any(pair)}

    def _powers(self, frequency: tuple[int, ...]) -> tuple[Element, Element]:
        """Cosine and sine of ``frequency . angles`` as polynomials in the cosines and sines of the
        angles.
        """
        real = self.one
        imaginary = self.zero
        for i, k in enumerate(frequency):
            c = self.ring.gens[self.n + 2 * i]
            s = self.ring.gens[self.n + 2 * i + 1]
            s = s if k > 0 else -s
            for _ in range(abs(k)):
                real, imaginary = real * c - imaginary * s, real * s + imaginary * c
        return real, imaginary


def _extract_common(p: Element, n: int | None = None) -> tuple[sp.Expr, Element]:
    """The number and the monomial (in the first ``n`` symbols) common to all terms of ``p``, and
    what remains.
    """
    if not p:
        return sp.Integer(0), p
    ring = p.ring
    powers = tuple(min(k) if n is None or i < n else 0 for i, k in enumerate(zip(*p, strict=True)))
    rest = ring.from_dict(
        {tuple(x - y for x, y in zip(m, powers, strict=True)): k for m, k in p.items()}
    )
    number, rest = rest.primitive()
    if len(rest) == 1 and rest.LC < 0:
        number = -number
        rest = -rest
    return ring.from_dict({powers: number}).as_expr(), rest


def _extract_sign(inner: sp.Expr) -> tuple[int, sp.Expr]:
    """The sign of most terms of a sum, and the sum without it."""
    negative = (
        sum(1 if term.could_extract_minus_sign() else -1 for term in inner.args)
        if inner.is_Add
        else 0
    )
    return (-1, sp.Add(*[-term for term in inner.args])) if negative > 0 else (1, inner)


def _times(common: sp.Expr, inner: sp.Expr) -> sp.Expr:
    """The product; a sum of mostly negative terms hands its sign to the factor before it."""
    sign, positive = _extract_sign(inner)
    return sp.Mul(common, inner) if common.is_Number else sp.Mul(sign * common, positive)


def _group(p: Element, by: Sequence[sp.Symbol]) -> list[tuple[Element, Element]]:
    """``p`` as a sum of monomials in the symbols ``by`` times what is free of them."""
    ring = p.ring
    present = {i for i, symbol in enumerate(ring.symbols) if symbol in by and any(m[i] for m in p)}
    groups: dict[tuple[int, ...], dict[tuple[int, ...], Any]] = {}
    for monomial, coefficient in p.items():
        key = tuple(k if i in present else 0 for i, k in enumerate(monomial))
        rest = tuple(0 if i in present else k for i, k in enumerate(monomial))
        groups.setdefault(key, {})[rest] = coefficient
    return [
        (ring.from_dict({key: ring.domain.one}), ring.from_dict(part))
        for key, part in groups.items()
    ]


def _nest(p: Element, levels: Sequence[Sequence[sp.Symbol]]) -> sp.Expr:
    """``p`` collected by the symbols of the first level, each part by the next; factored where it
    can be.
    """
    common, p = _extract_common(p)
    if len(p) <= 1:
        return common
    factors = _factor(p) if len(p) <= MAX_TERMS_FACTORED else [(p, 1)]
    if len(factors) > 1 or factors[0][1] > 1:
        signed = [(_extract_sign(_nest(part, levels)), power) for part, power in factors]
        return sp.Mul(
            common,
            *[sign**power for (sign, _), power in signed],
            *[x**power for (_, x), power in signed],
        )
    groups: list[tuple[Element, Element]] = []
    while levels and len(groups) <= 1:
        groups = _group(p, levels[0])
        levels = levels[1:]
    if len(groups) <= 1:
        return _times(common, p.as_expr())
    terms = []
    for key, part in groups:
        shared, rest = _extract_common(part)
        terms.append(_times(key.as_expr() * shared, _nest(rest, levels)))
    return _times(common, sp.Add(*terms))


def _factor(p: Element) -> list[tuple[Element, int]]:
    """Factors of ``p``, which has no common monomial and number, up to sign.

    A polynomial that is linear in a symbol, ``a x + b``, has the factors of ``gcd(a, b)`` and one
    more; where a or b is a single term there are no others. Only what is linear in no symbol takes
    a general factorization.
    """
    ring = p.ring
    used = [i for i in range(ring.ngens) if any(m[i] for m in p)]
    linear = [i for i in used if all(m[i] <= 1 for m in p)]
    shares = [sum(m[i] for m in p) for i in linear]
    if any(share in (1, len(p) - 1) for share in shares):
        return [(p, 1)]
    small = PolyRing([ring.symbols[i] for i in used], ring.domain, lex)
    q = small.from_dict({tuple(m[i] for i in used): k for m, k in p.items()})
    place = {i: k for k, i in enumerate(used)}

    def back(part: Element) -> Element:
        monomials = {
            tuple(m[place[i]] if i in place else 0 for i in range(ring.ngens)): c
            for m, c in part.items()
        }
        return ring.from_dict(monomials)

    if linear:
        x = place[linear[0]]
        b = small.from_dict({m: k for m, k in q.items() if not m[x]})
        a = small.from_dict({(*m[:x], 0, *m[x + 1 :]): k for m, k in q.items() if m[x]})
        divisor = back(a.gcd(b)).primitive()[1]
        return [(p, 1)] if divisor.is_ground else [*_factor(divisor), (p.quo(divisor), 1)]
    number, factors = q.factor_list()
    found = [(back(part), power) for part, power in factors]
    return [*found, (ring.ground_new(number), 1)] if number != 1 else found


@lru_cache(maxsize=4096)
def _expand(powers: tuple[int, ...]) -> dict[tuple[int, ...], tuple[Any, Any]]:
    """Product of powers of cosines and sines (c, s, c, s ...) as a sum: frequency -> factors of
    its cosine and sine.
    """
    waves: dict[tuple[int, ...], tuple[Any, Any]] = {
        (): (sp.QQ(1), sp.QQ(0))
    }  # complex amplitudes of exp(i f . angles)
    for n_c, n_s in zip(powers[::2], powers[1::2], strict=True):
        line: dict[int, tuple[Any, Any]] = {0: (sp.QQ(1), sp.QQ(0))}
        for is_sine in [False] * n_c + [True] * n_s:
            new: dict[int, tuple[Any, Any]] = {}
            for k, (re, im) in line.items():
                for step in (1, -1):
                    # cos = (z + 1/z)/2, sin = -i (z - 1/z)/2
                    add = (im * step / 2, -re * step / 2) if is_sine else (re / 2, im / 2)
                    old = new.get(k + step, (sp.QQ(0), sp.QQ(0)))
                    new[k + step] = (old[0] + add[0], old[1] + add[1])
            line = new
        waves = {
            (*f, k): (a * re - b * im, a * im + b * re)
            for f, (a, b) in waves.items()
            for k, (re, im) in line.items()
        }
    out: dict[tuple[int, ...], tuple[Any, Any]] = {}
    for frequency, (re, im) in waves.items():
        first = next((k for k in frequency if k), 0)
        if first >= 0:  # the conjugate wave doubles all but the constant
            pair = (2 * re, -2 * im) if first else (re, sp.QQ(0))
            if any(pair):
                out[frequency] = pair
    return out


def accumulate_angles(same: Sequence[int]) -> list[list[int]]:
    """Rows of absolute angles: ``same[i]`` is +1 or -1 where angle i turns about the axis of angle
    i - 1, else 0.

    >>> accumulate_angles([0, 1, 0])
    [[1, 0, 0], [1, 1, 0], [0, 0, 1]]
    """
    rows = [[int(i == j) for j in range(len(same))] for i in range(len(same))]
    for (before, row), sign in zip(pairwise(rows), same[1:], strict=True):
        if sign:
            row[:] = [sign * x + y for x, y in zip(before, row, strict=True)]
    return rows
