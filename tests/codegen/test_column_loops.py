"""Steps on columns of intermediate arrays as C: against NumPy, the same bits for one point and for
many.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from emission import Small, spec_of
from toolchain import needs_compiler

from flexgen.base.spec.ports import Port
from flexgen.codegen.statements.evaluation import evaluate_routine
from flexgen.codegen.statements.routine import (
    Block,
    Columns,
    Expressions,
    Factor,
    Products,
    Routine,
    Rows,
    Selected,
    Solve,
    Sums,
    Zeros,
)

OPTIONS = ("-std=c99", "-O2", "-ffp-contract=off")
POINTS = 37  # no multiple of any number of lanes
WIDTHS = [(), ("-march=native",), ("-DSMALL_NO_VECTORS",)]


def function(name: str, inputs: dict[str, ca.SX], results: dict[str, ca.SX]) -> ca.Function:
    dense = [ca.densify(x) for x in results.values()]
    return ca.Function(name, [*inputs.values()], dense, [*inputs], [*results])


def made(n: int) -> tuple[Routine, tuple[Port, ...], tuple[Port, ...]]:
    """A routine with every step: sums both ways, over all columns and some, two triangles, a
    factor used twice.
    """
    q = ca.SX.sym("q", 3, n)
    r = ca.SX.sym("r", n)
    x = ca.SX.sym("x", 3)
    y = ca.SX.sym("y", 3)
    number = ca.SX.sym("number", 2)
    row = ca.SX.sym("row")
    every = tuple(range(n))
    some = tuple(range(1, n - 1, 2))
    rng = np.random.default_rng(n)
    twisted = ca.vertcat(x[1] * number[0], x[2] - row, 2.0 * row - x[0] * number[1])
    S, W, G, U = (Rows(name, 0, 3) for name in ("S", "W", "G", "U"))
    steps = (
        Expressions(function("start", {"q": q, "r": r}, {"S": 1.0 * q, "row": r.T})),
        Columns(
            function("first", {"S": x, "number": number, "row": row}, {"W": twisted}),
            n,
            {"number": rng.normal(size=(2, n))},
        ),
        Sums("W", "G", 3, n, every, start=(0.5, 0.0, -1.0)),
        Selected("G", "few", 3, some),
        Sums("few", "back", 3, n, some, backward=True),
        Sums("few", "forth", 3, n, some),
        Columns(function("second", {"back": x, "forth": y}, {"U": ca.sin(ca.SX(1)) * x + y}), n),
        Products((S, W), (W, S), n, "M"),
        Products((S, W), (G, U), n, "D"),
        Products((S, S), (S, S), n, "A"),
        Expressions(function("rotors", {}, {"A": (3 + n) * ca.SX.eye(n)}), added=True),
        Factor("A", "row", "a", n, (0,) * n),
        Zeros("R", n, 2 * n + 1),
        Products((S, W), (G, U), n, "R", first=n),
        Expressions(
            function("shares", {"r": r}, {"R": ca.horzcat(ca.SX(n, 2 * n), r)}), added=True
        ),
        Columns(function("third", {"a": row, "S": x}, {"scaled": row * x}), n),
        Products(
            (Rows("scaled", 1, 2), Rows("S", 1, 2)),
            (Rows("S", 1, 2), Rows("scaled", 1, 2)),
            n,
            "B",
        ),
        Solve(
            "A",
            "R",
            n,
            2 * n + 1,
            True,
            (0,) * n,
            (Block("X", 0, n, n + 1), Block("Y", 0, 2 * n + 1, n)),
            (),
            True,
        ),
    )
    outputs = [Port(name, (n, n), "1", "") for name in ("M", "D", "B")]
    outputs += [Port("X", (n, n + 1), "1", ""), Port("Y", (n, n), "1", "")]
    return Routine(steps), (Port("q", (3, n), "1", ""), Port("r", (n,), "1", "")), tuple(outputs)


@needs_compiler
@pytest.mark.parametrize("n", [*(pytest.param(n, marks=pytest.mark.slow) for n in (8, 9)), 19])
@pytest.mark.parametrize("flags", WIDTHS)
def test_every_step_is_that_of_numpy(n, flags, tmp_path):
    program, inputs, outputs = made(n)
    library = Small(spec_of(program, inputs, outputs), tmp_path, flags=(*OPTIONS, *flags))
    rng = np.random.default_rng(4)
    q = rng.normal(size=(POINTS, 3, n))
    r = rng.normal(size=(POINTS, n))
    status, many = library.batch(q.transpose(0, 2, 1).reshape(POINTS, -1), r)
    assert status == 0
    for k in range(POINTS):
        status, one = library.point(q[k], r[k])
        assert status == 0
        expected = evaluate_routine(program, {"q": q[k], "r": r[k]})
        for port, x, y in zip(outputs, one, many, strict=True):
            assert np.array_equal(x, y[k])
            given = x.reshape(port.shape, order="F")
            assert np.allclose(
                given, expected[port.name], rtol=0, atol=1e-12 * np.abs(expected[port.name]).max()
            )
    for bad in (np.nan, np.inf):
        spoilt = r[0].copy()
        spoilt[n - 1] = bad
        assert library.point(q[0], spoilt)[0] == -2


@needs_compiler
@pytest.mark.parametrize("n", [8, 19])
@pytest.mark.slow
def test_vectors_of_every_width_give_the_same_bits(n, tmp_path):
    program, inputs, outputs = made(n)
    rng = np.random.default_rng(7)
    given = rng.normal(size=(3, n)), rng.normal(size=n)
    found = []
    for k, flags in enumerate(WIDTHS):
        folder = tmp_path / str(k)
        folder.mkdir()
        status, results = Small(
            spec_of(program, inputs, outputs), folder, flags=(*OPTIONS, *flags)
        ).point(*given)
        assert status == 0
        found.append(results)
    for others in found[1:]:
        assert all(np.array_equal(x, y) for x, y in zip(found[0], others, strict=True))


@needs_compiler
@pytest.mark.parametrize(
    "flags",
    [WIDTHS[1], *(pytest.param(x, marks=pytest.mark.slow) for x in (WIDTHS[0], WIDTHS[2]))],
)
def test_single_precision(flags, tmp_path):
    program, inputs, outputs = made(9)
    library = Small(
        spec_of(program, inputs, outputs, "single"), tmp_path, flags=(*OPTIONS, *flags)
    )
    rng = np.random.default_rng(5)
    q = rng.normal(size=(POINTS, 3, 9))
    r = rng.normal(size=(POINTS, 9))
    status, many = library.batch(q.transpose(0, 2, 1).reshape(POINTS, -1), r)
    assert status == 0
    status, one = library.point(q[0], r[0])
    expected = evaluate_routine(program, {"q": q[0], "r": r[0]})
    for port, x, y in zip(outputs, one, many, strict=True):
        assert np.array_equal(x, y[0])
        given = x.reshape(port.shape, order="F")
        assert np.allclose(
            given, expected[port.name], rtol=0, atol=1e-4 * np.abs(expected[port.name]).max()
        )


@needs_compiler
@pytest.mark.slow
def test_a_singular_matrix_of_a_factor_has_an_error_status(tmp_path):
    """Without what the rotors add, the matrix has rank three."""
    program, inputs, outputs = made(9)
    library = Small(spec_of(program, inputs, outputs), tmp_path)
    rng = np.random.default_rng(6)
    given = rng.normal(size=(3, 9)), rng.normal(size=9)
    assert library.point(*given)[0] == 0
    steps = tuple(
        step
        for step in program.steps
        if not (isinstance(step, Expressions) and step.function.name() == "rotors")
    )
    (tmp_path / "other").mkdir()
    singular = Small(spec_of(replace(program, steps=steps), inputs, outputs), tmp_path / "other")
    status, results = singular.point(*given)
    assert status == -3 and all(np.isnan(x).all() for x in results)


def test_functions_with_nonzero_values_at_zero_are_refused():
    """Columns beyond the last one are zeros, and must stay so."""
    x = ca.SX.sym("x", 2)
    with pytest.raises(ValueError, match="zeros"):
        Columns(function("f", {"x": x}, {"y": x + 1}), 9)
