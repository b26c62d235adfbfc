"""The C text of the steps of a routine that are loops."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from flexgen.codegen.statements.column_loops import (
    columns_text,
    products_text,
    selected_text,
    sums_text,
    zeros_text,
)
from flexgen.codegen.statements.layout import Layout
from flexgen.codegen.statements.literals import literal
from flexgen.codegen.statements.pivot_guards import EPSILON
from flexgen.codegen.statements.routine import (
    Columns,
    Factor,
    Products,
    Selected,
    Solve,
    Step,
    Sums,
    Zeros,
)
from flexgen.codegen.statements.solve_loops import factor_text, solve_text


@dataclass(frozen=True)
class StepText:
    """A C function, its operations and the latency of their longest chain, and how it is called.

    ``ports``: outputs that it takes before the workspace; ``checks``: it returns zero, or NaN
    where a result is not finite.
    """

    text: str
    operations: int
    depth: int
    ports: tuple[str, ...] = ()
    checks: bool = False


def step_text(
    name: str, step: Step, layout: Layout, outputs: Mapping[str, int], precision: str
) -> StepText:
    """The C function of a step that is a loop.

    Parameters
    ----------
    name : str
        Of the function.
    step : Step
        Any but `Expressions`.
    layout : Layout
    outputs : mapping of str to int
        Entries of each output.
    precision : str
        ``"double"`` or ``"single"``.
    """
    number = partial(literal, precision=precision)
    match step:
        case Solve():
            text = solve_text(name, step, layout, outputs, number(step.n * EPSILON[precision]))
            ports = [port for port in outputs if port in step.ports]
            return StepText(text, step.operations, step.depth, tuple(ports), True)
        case Factor():
            text = factor_text(name, step, layout, number(step.n * EPSILON[precision]))
            return StepText(text, step.operations, step.depth, (), True)
        case Products():
            text = products_text(name, step, layout, outputs)
            ports = [port for port in outputs if port == step.target]
            return StepText(text, step.operations, step.depth, tuple(ports), True)
        case Columns():
            text, operations, depth = columns_text(name, step, layout, number)
            return StepText(text, step.n * operations, depth)
        case Sums():
            text = sums_text(name, step, layout, number)
            return StepText(text, step.rows * len(step.at), 4 * len(step.at))
        case Selected():
            return StepText(selected_text(name, step, layout), 0, 0)
        case Zeros():
            return StepText(zeros_text(name, step, layout), 0, 0)
    raise AssertionError(step)
