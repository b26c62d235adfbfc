"""Checks of the arguments of planned motions."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import check_not_negative, check_positive, is_number, is_whole

HessianName = Literal["auto", "exact", "gauss-newton"]
HESSIANS: tuple[HessianName, ...] = get_args(HessianName)
MOST = 5000  # intervals of a mesh


def check_solve(
    hessian: Any, accuracy: Any, max_iterations: Any, time_limit: Any, compiled: Any
) -> None:
    """ArgumentError where an argument of `PlanProblem.solve` is out of range."""
    if hessian not in HESSIANS:
        raise ArgumentError(f"hessian: given {hessian!r}, expected one of {', '.join(HESSIANS)}")
    check_positive("accuracy", accuracy)
    if not is_whole(max_iterations):
        raise ArgumentError(
            f"max_iterations: given {max_iterations!r}, expected a positive whole number"
        )
    if time_limit is not None:
        check_not_negative(
            "time_limit", time_limit, "a finite number >= 0, in s; None or 0: no limit"
        )
    if compiled is not None and not isinstance(compiled, bool):
        raise ArgumentError(f"compiled: given {compiled!r}, expected True, False or None")


def check_parameter(name: Any, known: list[str], lower: Any, upper: Any, guess: Any) -> None:
    """ArgumentError unless an unknown number has a new name, and a finite guess within its
    bounds.
    """
    if not isinstance(name, str) or not name:
        raise ArgumentError(f"parameter: given the name {name!r}, expected a text")
    if name in known:
        raise ArgumentError(
            f"parameter {name}: there is one of this name already, expected another name"
        )
    bounds = all(
        is_number(x) or (isinstance(x, float) and abs(x) == np.inf) for x in (lower, upper)
    )
    if not bounds or not is_number(guess) or not lower <= guess <= upper:
        raise ArgumentError(
            f"parameter {name}: given guess {guess!r}, expected a number from {lower} to {upper}"
        )


def numbers_of(value: Any, text: str) -> np.ndarray:
    """The value as an array; ArgumentError with the text where it is not an array of finite
    numbers.
    """
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(text) from None
    if not np.isfinite(array).all():
        raise ArgumentError(text)
    return array


def mesh_nodes(mesh: Any, duration: float) -> np.ndarray:
    """Nodes from 0 to 1 of a mesh: a number of intervals, their length [s], or relative nodes."""
    if isinstance(mesh, bool | str | bytes) or mesh is None:
        raise ArgumentError(
            f"mesh: given {mesh!r}, expected a number of intervals, a length in s or relative "
            "nodes"
        )
    if isinstance(mesh, int | np.integer):
        count: float = int(mesh)
    elif isinstance(mesh, float):
        check_positive("mesh", mesh)
        count = (
            float(np.ceil(duration / float(mesh) - 1e-9)) if mesh * MOST > duration / 2 else np.inf
        )
    else:
        text = f"mesh: given {mesh!r}, expected increasing relative nodes from 0 to 1"
        nodes = numbers_of(mesh, text)
        if nodes.ndim != 1 or len(nodes) < 2 or not (np.diff(nodes) > 0).all():
            raise ArgumentError(text)
        if not np.allclose(nodes[[0, -1]], [0, 1]):
            raise ArgumentError(text)
        return np.r_[0.0, nodes[1:-1], 1.0]
    if not 1 <= count <= MOST:
        raise ArgumentError(
            f"mesh: given {mesh!r}, which makes {count} intervals, expected 1 to {MOST}"
        )
    return np.linspace(0.0, 1.0, int(count) + 1)
