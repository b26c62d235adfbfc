"""Texts of loops: operations, outputs that they take and results that they check; rows of arrays
in a workspace.
"""

from __future__ import annotations

import re

import casadi as ca
import pytest

from flexgen.codegen.statements.layout import LONGEST, Layout, column_stride, pivots_of
from flexgen.codegen.statements.literals import literal
from flexgen.codegen.statements.pivot_guards import EPSILON
from flexgen.codegen.statements.routine import (
    Block,
    Columns,
    Factor,
    Products,
    Rows,
    Selected,
    Solve,
    Step,
    Sums,
    Zeros,
)
from flexgen.codegen.statements.step_text import step_text

N = 8
X = ca.SX.sym("x", 2)
ARRAYS = ("x", "y", "A", "R", "b", "f", "s", "M", pivots_of("A"))
TWICE = ca.Function("twice", [X], [X * X + 3.0 * X], ["x"], ["y"])
PAIR = ((Rows("x", 0, 2), Rows("y", 0, 2)), (Rows("y", 0, 2), Rows("x", 0, 2)), N)
BLOCKS = (Block("p", 0, 0, 2), Block("o", 0, 2, 1))
OUTPUTS = {"o": N, "unused": 3, "p": 2 * N}
# A step, its operations (None: those of elimination, which are counted in test_routine), and the
# outputs that it takes, in their order among all outputs.
STEPS: dict[str, tuple[Step, int | None, tuple[str, ...]]] = {
    "solve": (Solve("A", "R", N, 3, False, (0,) * N, BLOCKS), None, ("o", "p")),
    "factor": (Factor("A", "b", "f", N, (0,) * N), None, ()),
    "products to an output": (Products(*PAIR, "o"), None, ("o",)),
    "products to the workspace": (Products(*PAIR, "M"), None, ()),
    "columns": (Columns(TWICE, N), N * 2 * 3, ()),
    "sums": (Sums("x", "s", 2, N, (0, 1, 3)), 2 * 3, ()),
    "selected": (Selected("x", "s", 2, (1, 3)), 0, ()),
    "zeros": (Zeros("s", 2, 3), 0, ()),
}


@pytest.mark.parametrize("kind", STEPS)
@pytest.mark.parametrize("precision", LONGEST)
def test_texts_of_loops_state_their_operations_and_outputs(kind: str, precision: str) -> None:
    """A text returns a number exactly where results are checked, and takes the outputs that it
    names.
    """
    step, operations, ports = STEPS[kind]
    places = {name: 256 * k for k, name in enumerate(ARRAYS)}
    layout = Layout(places, dict.fromkeys(ARRAYS, 16), 256 * len(ARRAYS), {}, precision)
    found = step_text("f", step, layout, OUTPUTS, precision)
    assert found.operations == (step.operations if operations is None else operations)
    assert (found.depth > 0) == (found.operations > 0)
    assert found.ports == ports
    result, given = re.search(r"static (\w+)\s+F\(f\)\(([^)]*)\)", found.text).groups()
    assert tuple(re.findall(r"real \*RESTRICT (\w+)", given)) == ports
    assert found.checks == (result == "T")
    guarded = isinstance(step, Solve | Factor)
    assert (literal(N * EPSILON[precision], precision=precision) in found.text) == guarded


@pytest.mark.parametrize(("precision", "size"), [("double", 8), ("single", 16)])
def test_rows_begin_an_odd_number_of_whole_vectors_apart(precision: str, size: int) -> None:
    """As few as the columns need: 64 bytes each, and never a power of two above one of them."""
    for n in range(1, 200):
        vectors, rest = divmod(column_stride(n, precision), size)
        assert rest == 0 and vectors % 2 == 1
        assert (vectors - 2) * size < n <= vectors * size
