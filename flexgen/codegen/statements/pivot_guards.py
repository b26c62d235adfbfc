"""Detection of divisions by rounding errors at run time: a singular system ends with a status, not
with numbers.

A pivot of a positive definite system is positive; its size is estimated from its values at some
states. One that is smaller than its rounding error has no meaning; the quotient becomes NaN there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from flexgen.codegen.statements.graph import Graph, Reference, copy_node

EPSILON = {"double": 2.0**-52, "single": 2.0**-23}
STATES = 64  # random ones, at which the size of a pivot is estimated

_CALLS: dict[str, Callable[..., np.ndarray]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "lt": lambda a, b: (a < b) * 1.0,
    "le": lambda a, b: (a <= b) * 1.0,
    "eq": lambda a, b: (a == b) * 1.0,
    "ne": lambda a, b: (a != b) * 1.0,
    "and": lambda a, b: ((a != 0) & (b != 0)) * 1.0,
    "or": lambda a, b: ((a != 0) | (b != 0)) * 1.0,
    "not": lambda a: (a == 0) * 1.0,
    "if_else_zero": lambda c, a: np.where(c != 0, a, 0.0),
    "pow": np.power,
    "fabs": np.abs,
    "sign": np.sign,
}


def add_pivot_guards(
    graph: Graph, names: list[str], given: Mapping[str, np.ndarray], precision: str
) -> Graph:
    """The graph with guards at its divisions by pivots.

    Parameters
    ----------
    graph : Graph
    names : list of str
        Of its input arrays.
    given : mapping of str to array
        Values of inputs that are not drawn at random.
    precision : str
        ``"double"`` or ``"single"``.
    """
    pivots = {
        graph.operands[n][1]
        for n, used in enumerate(graph.alive())
        if used and graph.kind[n] == "div"
    }
    pivots = {r for r in pivots if graph.number(r) is None}
    if not pivots:
        return graph
    values = _values(graph, names, given)
    new = Graph()
    to: dict[int, Reference] = {}
    size = len(pivots) * EPSILON[precision]
    for node, used in enumerate(graph.alive()):
        if not used:
            continue
        to[node] = copy_node(graph, new, node, to)
        if graph.kind[node] != "div" or graph.operands[node][1] not in pivots:
            continue
        divisor = graph.operands[node][1]
        seen = values[divisor >> 1]
        sign = 0
        if np.all(seen < 0.0):  # a graph may hold the negative of a pivot
            seen = -seen
            sign = 1
        # a power of two: the same on every machine
        if np.all(seen > 0.0) and np.isfinite(seen).all():
            least = new.constant(size * 2.0 ** math.ceil(math.log2(float(seen.max()))))
            to[node] = new.call("guarded", [to[node], to[divisor >> 1] ^ sign, least])
    new.outputs = [(array, entry, to[r >> 1] ^ (r & 1)) for array, entry, r in graph.outputs]
    return new


def _values(graph: Graph, names: list[str], given: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Every node at `STATES` random states: angles anywhere in a turn, other inputs in -1 to 1,
    those in ``given`` as they are; ``names``: of the input arrays.
    """
    random = np.random.default_rng(0)
    drawn: dict[tuple[int, ...], np.ndarray] = {}
    out: list[np.ndarray] = []
    needed = graph.alive()
    with np.errstate(all="ignore"):
        for node, (kind, operands) in enumerate(zip(graph.kind, graph.operands, strict=True)):
            if kind == "input":
                name = names[operands[0]]
                if name in given:
                    out.append(np.full(STATES, given[name][operands[1]]))
                else:
                    reach = math.pi if name == "q_a" else 1.0
                    out.append(drawn.setdefault(operands, random.uniform(-reach, reach, STATES)))
            elif kind == "constant":
                out.append(np.full(STATES, graph.value[node]))
            elif not needed[node]:
                out.append(np.zeros(STATES))
            else:
                arguments = [-out[r >> 1] if r & 1 else out[r >> 1] for r in operands]
                known = _CALLS.get(kind)
                function = getattr(np, kind, _unknown) if known is None else known
                out.append(function(*arguments))
    return out


def _unknown(*arguments: np.ndarray) -> np.ndarray:
    """Operation without a function of NumPy: a pivot that depends on it is not guarded."""
    return np.full(STATES, np.nan)
