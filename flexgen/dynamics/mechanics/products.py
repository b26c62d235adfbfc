"""Products of a function's derivatives with a direction of its inputs, or with weights of its
results.

    jvp:  dy = (dy/dx) dx,        vjp:  x_bar = (dy/dx)' y_bar,
    x: all inputs, run-time parameters included

Source: A. Griewank, A. Walther, Evaluating Derivatives, 2008, ch. 3.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from flexgen.dynamics.mechanics.signatures import COTANGENT, TANGENT
from flexgen.dynamics.mechanics.system import Built, System


def symbols_like(
    arrays: Sequence[ca.SX], names: Sequence[str], suffix: str
) -> tuple[list[ca.SX], list[str]]:
    """Symbols of the shapes of some arrays, with a suffix to their names."""
    made = [name + suffix for name in names]
    return [ca.SX.sym(name, x.sparsity()) for name, x in zip(made, arrays, strict=True)], made


def jvp(
    inputs: list[ca.SX], names: list[str], outputs: list[ca.SX], names_out: list[str]
) -> Built:
    """Change of the results for a small change of the inputs, ``dy = (dy/dx) dx``, as a function
    with the directions dx as further inputs, named as the inputs with the ending `TANGENT`.
    """
    directions, named = symbols_like(inputs, names, TANGENT)
    outputs = [ca.densify(y) for y in outputs]
    flat = ca.jtimes(ca.veccat(*outputs), ca.veccat(*inputs), ca.veccat(*directions))
    return (
        [*inputs, *directions],
        [*names, *named],
        _split(flat, outputs),
        [name + TANGENT for name in names_out],
    )


def vjp(
    inputs: list[ca.SX], names: list[str], outputs: list[ca.SX], names_out: list[str]
) -> Built:
    """Derivatives ``(dy/dx)' w`` of the weighted sum of all results in the inputs, as a function
    with the weights w as further inputs, named as the results with the ending `COTANGENT`.
    """
    outputs = [ca.densify(y) for y in outputs]
    weights, named = symbols_like(outputs, names_out, COTANGENT)
    flat = ca.jtimes(ca.veccat(*outputs), ca.veccat(*inputs), ca.veccat(*weights), True)
    return (
        [*inputs, *weights],
        [*names, *named],
        _split(flat, inputs),
        [name + COTANGENT for name in names],
    )


def _split(flat: ca.SX, like: Sequence[ca.SX]) -> list[ca.SX]:
    """Arrays of the shapes of others from all their entries, common subexpressions shared."""
    ends = np.cumsum([0, *(x.numel() for x in like)]).tolist()
    parts = ca.vertsplit(ca.densify(flat), ends)
    return ca.cse([ca.reshape(part, x.shape) for part, x in zip(parts, like, strict=True)])


def differentiated(system: System, kind: str, built: Built) -> Built:
    """The ``"jvp"`` or ``"vjp"`` of a function; the run-time parameters that it depends on are
    inputs as well.
    """
    inputs, names, outputs, names_out = built
    if system.parameters and ca.depends_on(ca.veccat(*outputs), system.symbols):
        inputs = [*inputs, system.symbols]
        names = [*names, "parameters"]
    given, named, found, found_names = (jvp if kind == "jvp" else vjp)(
        inputs, names, outputs, names_out
    )
    # (`System.build` appends them)
    kept = [i for i, name in enumerate(named) if name != "parameters"]
    return [given[i] for i in kept], [named[i] for i in kept], found, found_names
