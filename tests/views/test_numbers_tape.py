"""Expressions on a tape against the same ones in NumPy, their derivatives against CasADi's, and
tables as texts.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.codegen.recursion.tape import Tape
from flexgen.views.reports import text_tables
from flexgen.views.reports.text_tables import figures, fit_tables, number, paragraph, roots, table


def drawn(seed: int) -> tuple[Tape, list[Any], list[Any], ca.SX, list[ca.SX]]:
    """Random expressions on a tape and in CasADi: the tape, its symbols and results, those of
    CasADi.
    """
    rng = np.random.default_rng(seed)
    tape = Tape()
    x = ca.SX.sym("x", 4)
    symbols: list[Any] = tape.vector(x)
    ours = list(symbols)
    theirs = ca.vertsplit(x)
    c = tape.sine(symbols[0], cosine=True)
    s = tape.sine(-symbols[0])
    ours += [
        c * symbols[1] + s * symbols[2],
        s * symbols[2] - c * symbols[3],
        -(c * symbols[1]) - s * symbols[3],
    ]
    C = ca.cos(x[0])
    S = -ca.sin(x[0])
    theirs += [C * x[1] + S * x[2], S * x[2] - C * x[3], -(C * x[1]) - S * x[3]]
    for _ in range(30):
        i, j = rng.integers(len(ours), size=2)
        kind = int(rng.integers(9))
        k = float(rng.choice([0.5, -2.0, 1.0, -1.0, 3.0]))
        a = ours[i]
        b = ours[j]
        A = theirs[i]
        B = theirs[j]
        pairs: list[tuple[Any, Any]] = [
            (a + b, A + B),
            (a - b, A - B),
            (a * b, A * B),
            (-a, -A),
            (a + k, A + k),
        ]
        pairs += [(k - a, k - A), (a * k, A * k)]
        if isinstance(a, type(symbols[0])):  # numbers have no sine on a tape
            pairs += [(tape.inverse(a * a + 2.0), 1 / (A * A + 2))]
            pairs += [(tape.sine(a, cosine=k > 0), ca.cos(A) if k > 0 else ca.sin(A))]
        kind = min(kind, len(pairs) - 1)
        ours.append(pairs[kind][0])
        theirs.append(ca.SX(pairs[kind][1]))
    return tape, symbols, ours[-8:], x, theirs[-8:]


def values(tape: Tape, results: list[Any], x: ca.SX, at: np.ndarray) -> np.ndarray:
    return np.array(ca.Function("f", [x], [ca.vertcat(*tape.build(results))])(at)).ravel()


@pytest.mark.parametrize("seed", range(4))
def test_expressions_of_a_tape_and_their_derivatives(seed: int) -> None:
    tape, symbols, ours, x, theirs = drawn(seed)
    at = np.array([0.4, -0.7, 1.1, 0.3])
    rng = np.random.default_rng(99)
    whole = ca.vertcat(*theirs)
    expected, J = (np.array(y) for y in ca.Function("g", [x], [whole, ca.jacobian(whole, x)])(at))
    close: Any = {"rtol": 1e-10, "atol": 1e-10}
    assert_allclose(values(tape, ours, x, at), expected[:, 0], **close)
    for k, symbol in enumerate(symbols):
        assert_allclose(values(tape, tape.tangents(ours, symbol), x, at), J[:, k], **close)
    for k, result in enumerate(ours[:3]):
        assert_allclose(values(tape, tape.gradient(result, symbols), x, at), J[k], **close)
    dx = rng.standard_normal(4)
    w = rng.standard_normal(8)
    assert_allclose(
        values(tape, tape.jvp(ours, list(zip(symbols, dx.tolist(), strict=True))), x, at),
        J @ dx,
        **close,
    )
    assert_allclose(
        values(tape, tape.vjp(list(zip(ours, w.tolist(), strict=True)), symbols), x, at),
        w @ J,
        **close,
    )


def test_what_costs_nothing_on_a_tape() -> None:
    """Operations that are counted: equal ones once, numbers and inner signs not at all."""
    tape = Tape()
    x = ca.SX.sym("x", 2)
    a, b = tape.vector(x)
    for results, count in (
        ([a + b, b + a, -(a + b)], 2),
        ([a - b, b - a], 2),
        ([-(a - b)], 1),
        ([a * b + 0.0, 1.0 * (b * a)], 1),
        ([a * 0.0, 2.0 * a + 3.0 * a], 1),
        ([2.0 * (3.0 * a), 6.0 * a], 1),
        ([tape.sine(a), tape.sine(-a)], 1),
        ([tape.sine(a, cosine=True), tape.sine(-a, cosine=True)], 0),
        ([-a], 1),
        ([tape.inverse(a), tape.inverse(4.0)], 1),
    ):
        assert tape.count(results) == count, results
    assert (a * 0.0, a - a, tape.inverse(4.0)) == (0.0, 0.0, 0.25)


# --- tables --------------------------------------------------------------------------------------
def test_numbers_and_roots_as_texts() -> None:
    cases: list[tuple[Any, str]] = [
        (None, "-"),
        (True, "yes"),
        (False, "no"),
        (float("nan"), "-"),
        (float("inf"), "-"),
        (3, "3"),
        (12345, "12345"),
        (0.123456, "0.1235"),
        (999.96, "1000"),
        (999.94, "999.9"),
        (1000.4, "1000"),
        (-1234.5678, "-1235"),
        (9999999.0, "9999999"),
        (1e7, "1e+07"),
        (-1e7, "-1e+07"),
        ("x", "x"),
    ]  # from 1000 to 1e7 without digits behind the point
    for value, text in cases:
        assert number(value) == text
    assert number(0.123456, 2) == "0.12"
    found = roots([[1.0, 2.0], [1.0, -2.0], [-3.0, 0.0], [-3.0, 0.0], [None, None], [0.5, 0]])
    assert found == ["1 +/- 2i", "-3 (2 times)", "-", "0.5"]


ROWS = [["first", 1.5, None, "a b"], ["second name", 22.25, 3, "c"]]
HEAD = ("what", "x", "n", "text")


def test_a_table_has_aligned_columns() -> None:
    assert table(ROWS, HEAD).splitlines() == [
        "what             x  n  text",
        "-----------  -----  -  ----",
        "first          1.5  -  a b",
        "second name  22.25  3  c",
    ]
    assert table(ROWS).splitlines() == ["first          1.5  -  a b", "second name  22.25  3  c"]
    assert table([]) == "" and table([], ("a", "bc")).splitlines() == ["a  bc", "-  --"]
    assert figures([("a", 1.5, "m"), ("b", None, "s"), ("c", True, "")]).splitlines() == [
        "quantity  value  unit",
        "--------  -----  ----",
        "a         1.5    m",
        "c         yes",
    ]


def test_a_table_is_not_wider_than_its_terminal() -> None:
    """Texts are wrapped to 16 characters at least; then the last columns are left out, and
    named.
    """
    long = [["a sentence of seven words in all", 1.0, "short", 2.0]]
    with fit_tables(41):
        lines = table(long, ("what", "x", "y", "z")).splitlines()
    assert lines[0] == "what" + " " * 26 + "x  y      z" and max(map(len, lines)) == 41
    with fit_tables(22):
        lines = table(long, ("what", "x", "y", "z")).splitlines()
    assert lines[:4] == [
        "what              x",
        "----------------  -",
        "a sentence of     1",
        "seven words in",
    ]
    assert " ".join(lines[5:]) == "(left out: y, z; a wider terminal, a pipe or --json shows all)"
    with fit_tables(8):
        lines = table([["a sentence", 1.0]]).splitlines()
    assert lines[:2] == ["a", "sentence"] and " ".join(lines[2:]).startswith(
        "(left out: 1 columns; a wider"
    )
    with fit_tables(12):
        assert paragraph("one two three") == "one two\nthree"
    assert paragraph("one two three") == "one two three" and text_tables.terminal_width() is None
