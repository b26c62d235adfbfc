"""Polynomials in constants and in sines and cosines of angles: exact, canonical, and arranged for a reader.

Every entry of the closed-form equations of a chain is such a polynomial. Sums and products are those of a sparse
polynomial ring over the rationals, with one generator for each sine and cosine; ``sin^2 = 1 - cos^2`` is applied after
each product, so that equal expressions are equal objects and zeros are recognised without any guessing. What a person
reads is chosen among several equal forms: multiple angles, or powers of sines and cosines of relative or absolute angles.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import sympy as sp
from sympy.polys.rings import PolyRing

from flexgen.errors import ArgumentError

Element = Any  # an element of a sympy PolyRing
Vector3 = list[Element]
Matrix3 = list[list[Element]]
Waves = dict[tuple[int, ...], list[Element]]

MAX_TERMS = 6000  # in one polynomial: beyond, nobody reads the result
MAX_TERMS_TIDIED = 250  # up to here all forms are tried and factored
MAX_TERMS_FACTORED = 24


class TrigonometricRing:
    """Polynomials with rational coefficients in symbols and in sines and cosines of angles.

    Parameters
    ----------
    constants : sequence of Symbol
        What the expressions are polynomials in, speeds included.
    angles : sequence of Symbol
        Symbols that appear inside sines and cosines; one that is also in ``constants`` may be both.
    unit_vectors : sequence of tuple of Symbol
        Symbols whose squares add up to one.
    heavy, light : sequence of Symbol
        What to collect by: quantities in which the expressions are linear (masses, inertias), and speeds.
    absolute : sequence of sequence of int
        Rows: absolute angles as sums of ``angles`` (lower triangular, entries -1, 0, 1, determinant 1 or -1).
    """

    def __init__(
        self,
        constants: Sequence[sp.Symbol],
        angles: Sequence[sp.Symbol],
        unit_vectors: Sequence[tuple[sp.Symbol, ...]] = (),
        heavy: Sequence[sp.Symbol] = (),
        light: Sequence[sp.Symbol] = (),
        absolute: Sequence[Sequence[int]] = (),
    ) -> None:
        self.constants, self.angles, self.heavy, self.light = tuple(constants), tuple(angles), heavy, light
        self.n = len(self.constants)
        self._trig = [sp.Dummy(f"{f}_{a}", real=True) for a in self.angles for f in ("c", "s")]
        self.ring = PolyRing([*self.constants, *self._trig], sp.QQ, sp.polys.orderings.lex)
        self.zero, self.one = self.ring.zero, self.ring.one
        self._at = {symbol: i for i, symbol in enumerate(self.ring.symbols)}
        gens = self.ring.gens
        self._squares = {self.n + 2 * i + 1: self.one - gens[self.n + 2 * i] ** 2 for i in range(len(self.angles))}
        for vector in unit_vectors:
            others = [gens[self._at[symbol]] ** 2 for symbol in vector[:-1]]
            self._squares[self._at[vector[-1]]] = self.one - sum(others, self.zero)
        identity = sp.eye(len(self.angles))
        self._bases = [identity]
        if absolute and sp.Matrix(absolute) != identity:
            self._bases.append(sp.Matrix(absolute))

    def element(self, value: sp.Expr | int) -> Element:
        """The generator of a symbol, or a rational number."""
        value = sp.sympify(value)
        if value.is_Symbol:
            return self.ring.gens[self._at[value]]
        return self.ring.ground_new(sp.QQ(value.p, value.q))

    def cos(self, angle: sp.Symbol) -> Element:
        """Cosine of one of the angles."""
        return self.ring.gens[self.n + 2 * self.angles.index(angle)]

    def sin(self, angle: sp.Symbol) -> Element:
        """Sine of one of the angles."""
        return self.ring.gens[self.n + 2 * self.angles.index(angle) + 1]

    def reduce(self, p: Element) -> Element:
        """The canonical form of ``p``; ArgumentError where it has too many terms to be of use."""
        while True:
            if len(p) > MAX_TERMS:
                raise ArgumentError(
                    f"symbolic: given a model whose equations have more than {MAX_TERMS} terms in one entry, expected "
                    "one small enough for a closed form; the numeric (CasADi) equations are available for any model"
                )
            kept, changed = {}, self.zero
            for monomial, coefficient in p.items():
                factor, powers = None, None
                for i, square in self._squares.items():
                    if monomial[i] >= 2:
                        powers = list(monomial) if powers is None else powers
                        powers[i] = monomial[i] % 2
                        factor = square ** (monomial[i] // 2) * (self.one if factor is None else factor)
                if factor is None:
                    kept[monomial] = coefficient
                else:
                    changed = changed + factor * self.ring.from_dict({tuple(powers or ()): coefficient})
            if not changed:
                return p
            p = changed + self.ring.from_dict(kept)

    def diff(self, p: Element, by: sp.Symbol) -> Element:
        """Derivative by a symbol, be it a constant, an angle or both."""
        out = p.diff(self.element(by)) if by in self._at else self.zero
        if by in self.angles:
            c, s = self.cos(by), self.sin(by)
            out = out + p.diff(s) * c - p.diff(c) * s
        return self.reduce(out)

    # --- vectors and matrices, as lists --------------------------------------------------------------------------

    def dot(self, a: Sequence[Element], b: Sequence[Element]) -> Element:
        """Scalar product."""
        return self.reduce(sum((x * y for x, y in zip(a, b, strict=True) if x and y), self.zero))

    def cross(self, a: Vector3, b: Vector3) -> Vector3:
        """Vector product."""
        return [self.reduce(a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]) for i in range(3)]

    def multiply(self, A: Matrix3, b: Vector3) -> Vector3:
        """Product of a matrix and a vector."""
        return [self.dot(row, b) for row in A]

    def rotation(self, axis: Vector3, c: Element, s: Element) -> Matrix3:
        """Rotation about a unit axis by the angle with cosine ``c`` and sine ``s`` (Rodrigues)."""
        x, y, z = axis
        skew = [[self.zero, -z, y], [z, self.zero, -x], [-y, x, self.zero]]
        turn = [[axis[i] * axis[j] * (self.one - c) + skew[i][j] * s for j in range(3)] for i in range(3)]
        return [[self.reduce(turn[i][j] + (c if i == j else self.zero)) for j in range(3)] for i in range(3)]

    # --- equal forms ----------------------------------------------------------------------------------------------

    def expression(self, p: Element) -> sp.Expr:
        """The form of ``p`` that is shortest to read."""
        if not p:
            return sp.Integer(0)
        trig = self._functions(self._bases[0])
        if len(p) > MAX_TERMS_TIDIED:
            return self._nest(p.as_expr(), [self.heavy, self.light, self._trig], False).xreplace(trig)
        best = None
        for form, functions in self._forms(p):
            for levels in ([self.heavy, list(functions)], [list(functions)], [self.heavy, self.light], [self.light]):
                found = self._nest(form, levels, True).xreplace(functions)
                size = sp.count_ops(found)
                if best is None or size < best[0]:
                    best = size, found
        assert best is not None
        return best[1]

    def _functions(self, basis: sp.Matrix) -> dict[sp.Dummy, sp.Expr]:
        angles = basis * sp.Matrix(self.angles) if self.angles else []
        values = [f(angle) for angle in angles for f in (sp.cos, sp.sin)]
        return dict(zip(self._trig, values, strict=True))

    def _forms(self, p: Element) -> Iterator[tuple[sp.Expr, dict[sp.Dummy, sp.Expr]]]:
        """Equal forms of ``p``: expressions in dummies, and what the dummies stand for."""
        waves = self._waves(p)
        functions: dict[sp.Dummy, sp.Expr] = {}
        terms = []
        for frequency, pair in waves.items():
            angle = sum((k * a for k, a in zip(frequency, self.angles, strict=True)), sp.Integer(0))
            for coefficient, f in zip(pair, (sp.cos, sp.sin), strict=True):
                if coefficient:
                    dummy = sp.Integer(1) if angle == 0 else sp.Dummy(real=True)
                    if angle != 0:
                        functions[dummy] = f(angle)
                    terms.append((coefficient.as_expr() * dummy).expand())
        yield sp.Add(*terms), functions
        swap = [(self.n + 2 * i, self.n + 2 * i + 1) for i in range(len(self.angles))]
        for basis in self._bases:
            inverse = basis.inv()
            q = self.zero
            for frequency, (c, s) in waves.items():
                real, imaginary = self._powers(tuple(int(k) for k in sp.Matrix([frequency]) * inverse))
                q = q + c * real + s * imaginary
            q = self.reduce(q)
            yield q.as_expr(), self._functions(basis)
            for i_c, i_s in swap:  # the other choice: squares of sines kept, those of cosines replaced
                q = self._without_squares(q, i_c, self.one - self.ring.gens[i_s] ** 2)
            yield q.as_expr(), self._functions(basis)

    def _without_squares(self, p: Element, i: int, square: Element) -> Element:
        out = self.zero
        for monomial, coefficient in p.items():
            rest = self.ring.from_dict({(*monomial[:i], monomial[i] % 2, *monomial[i + 1 :]): coefficient})
            out = out + rest * square ** (monomial[i] // 2)
        return out

    def _waves(self, p: Element) -> Waves:
        """Fourier form: frequency -> factors (free of angles) of the cosine and of the sine of ``frequency . angles``."""
        waves: Waves = {}
        for monomial, coefficient in p.items():
            rest = self.ring.from_dict({(*monomial[: self.n], *[0] * len(self._trig)): coefficient})
            for frequency, (c, s) in _expand(monomial[self.n :]).items():
                pair = waves.setdefault(frequency, [self.zero, self.zero])
                pair[0], pair[1] = pair[0] + rest * c, pair[1] + rest * s
        return {frequency: pair for frequency, pair in waves.items() if any(pair)}

    def _powers(self, frequency: tuple[int, ...]) -> tuple[Element, Element]:
        """Cosine and sine of ``frequency . angles`` as polynomials in the cosines and sines of the angles."""
        real, imaginary = self.one, self.zero
        for i, k in enumerate(frequency):
            c, s = self.ring.gens[self.n + 2 * i], self.ring.gens[self.n + 2 * i + 1]
            s = s if k > 0 else -s
            for _ in range(abs(k)):
                real, imaginary = real * c - imaginary * s, real * s + imaginary * c
        return real, imaginary

    def _nest(self, form: sp.Expr, levels: Sequence[Sequence[sp.Symbol]], factor: bool) -> sp.Expr:
        """``form`` collected by the symbols of the first level, each part by those of the next; factored where it can be."""
        if not form.is_Add:
            return form
        if factor and len(form.args) <= MAX_TERMS_FACTORED:
            factored = _factor(form)
            if factored.is_Pow:
                return factored
            if factored.is_Mul:
                return sp.Mul(*[self._nest(part, levels, False) for part in factored.args])
        if not levels:
            return form
        present = [symbol for symbol in levels[0] if form.has(symbol)]
        if not present:
            return self._nest(form, levels[1:], factor)
        parts = sp.Poly(form, *present).terms()
        keys = [sp.Mul(*[x**k for x, k in zip(present, powers, strict=True)]) for powers, _ in parts]
        return sp.Add(*[key * self._nest(part, levels[1:], factor) for key, (_, part) in zip(keys, parts, strict=True)])


@lru_cache(maxsize=4096)
def _factor(form: sp.Expr) -> sp.Expr:
    return sp.factor(form)


@lru_cache(maxsize=4096)
def _expand(powers: tuple[int, ...]) -> dict[tuple[int, ...], tuple[Any, Any]]:
    """Product of powers of cosines and sines (c, s, c, s ...) as a sum: frequency -> factors of its cosine and sine."""
    waves: dict[tuple[int, ...], tuple[Any, Any]] = {(): (sp.QQ(1), sp.QQ(0))}  # complex amplitudes of exp(i f . angles)
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
            (*f, k): (a * re - b * im, a * im + b * re) for f, (a, b) in waves.items() for k, (re, im) in line.items()
        }
    out: dict[tuple[int, ...], tuple[Any, Any]] = {}
    for frequency, (re, im) in waves.items():
        first = next((k for k in frequency if k), 0)
        if first >= 0:  # the conjugate wave doubles all but the constant
            pair = (2 * re, -2 * im) if first else (re, sp.QQ(0))
            if any(pair):
                out[frequency] = pair
    return out


def chained(same: Sequence[int]) -> list[list[int]]:
    """Rows of absolute angles: ``same[i]`` is +1 or -1 where angle i turns about the axis of angle i - 1, else 0.

    >>> chained([0, 1, 0])
    [[1, 0, 0], [1, 1, 0], [0, 0, 1]]
    """
    rows = [[int(i == j) for j in range(len(same))] for i in range(len(same))]
    for (before, row), sign in zip(pairwise(rows), same[1:], strict=True):
        if sign:
            row[:] = [sign * x + y for x, y in zip(before, row, strict=True)]
    return rows
