"""Graphs made shorter: angles without arc tangents, shared reciprocals, angles that are sums, sums
in the order in which their terms become known.

None of this changes a result by more than rounding.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence

from flexgen.codegen.statements.arc_tangents import replace_arc_tangents
from flexgen.codegen.statements.graph import Graph, Reference, copy_node


def simplify_graph(graph: Graph) -> Graph:
    """The graph after all of this.

    Sines and cosines of arc tangents become ratios. Divisions by the same value become one
    reciprocal. Sine and cosine of a sum of angles follow
    from those of the angles, where these are needed anyway. Sums and products of many terms are
    built so that operands that are known early are combined first, which shortens the longest
    chain of operations: the time of a single call.
    """
    return _balance_sums(_reciprocals(_angle_sums(replace_arc_tangents(graph))))


def _reciprocals(graph: Graph) -> Graph:
    """The graph with one reciprocal where several values are divided by the same one."""
    needed = graph.alive()
    divisions: dict[int, int] = {}
    for node, kind in enumerate(graph.kind):
        if kind == "div" and needed[node]:
            divisor = graph.operands[node][1] >> 1
            divisions[divisor] = divisions.get(divisor, 0) + 1
    if all(count == 1 for count in divisions.values()):
        return graph
    new = Graph()
    to: dict[int, Reference] = {}
    for node, kind in enumerate(graph.kind):
        if not needed[node]:
            continue
        if kind == "div" and divisions[graph.operands[node][1] >> 1] > 1:
            a, b = (to[r >> 1] ^ (r & 1) for r in graph.operands[node])
            to[node] = new.multiply(a, new.divide(new.constant(1.0), b))
        else:
            to[node] = copy_node(graph, new, node, to)
    new.outputs = [(array, entry, to[r >> 1] ^ (r & 1)) for array, entry, r in graph.outputs]
    return new


def _angle_sums(graph: Graph) -> Graph:
    """The graph with sines and cosines of ``a + b`` by products of those of a and b, where these
    are needed anyway.
    """
    needed = graph.alive()
    turned = {
        graph.operands[n][0] >> 1
        for n, kind in enumerate(graph.kind)
        if kind in ("sin", "cos") and needed[n]
    }
    sums = {
        a for a in turned if graph.kind[a] in ("add", "sub") and set(graph.arguments(a)) <= turned
    }
    if not sums:
        return graph
    new = Graph()
    to: dict[int, Reference] = {}

    def turn(angle: int) -> tuple[Reference, Reference]:
        """Sine and cosine of an angle of the old graph."""
        if angle not in sums:
            return new.call("sin", [to[angle]]), new.call("cos", [to[angle]])
        a, b = graph.operands[angle]
        (sine_a, cosine_a) = turn(a >> 1)
        (sine_b, cosine_b) = turn(b >> 1)
        sine_b ^= 1 if graph.kind[angle] == "sub" else 0
        return (
            new.add(new.multiply(sine_a, cosine_b), new.multiply(cosine_a, sine_b)),
            new.add(new.multiply(cosine_a, cosine_b), new.multiply(sine_a, sine_b) ^ 1),
        )

    for node, kind in enumerate(graph.kind):
        if not needed[node]:
            continue
        if kind in ("sin", "cos") and graph.operands[node][0] >> 1 in sums:
            to[node] = turn(graph.operands[node][0] >> 1)[0 if kind == "sin" else 1]
        else:
            to[node] = copy_node(graph, new, node, to)
    new.outputs = [(array, entry, to[r >> 1] ^ (r & 1)) for array, entry, r in graph.outputs]
    return new


def _balance_sums(graph: Graph) -> Graph:  # noqa: C901
    """The graph with sums and products of more than two terms rebuilt: operands known first are
    combined first.
    """
    needed = graph.alive()
    uses = [0] * len(graph.kind)
    for node, used in enumerate(needed):
        if used:
            for other in graph.arguments(node):
                uses[other] += 1
    for _, _, r in graph.outputs:
        uses[r >> 1] += 1
    family = {"add": "sum", "sub": "sum", "mul": "product"}
    inner = [False] * len(graph.kind)  # nodes that only serve a larger sum or product
    for node, used in enumerate(needed):
        if used and graph.kind[node] in family:
            for other in graph.arguments(node):
                if uses[other] == 1 and family.get(graph.kind[other]) == family[graph.kind[node]]:
                    inner[other] = True
    new = Graph()
    to: dict[int, Reference] = {}
    for node, used in enumerate(needed):
        if not used or inner[node]:
            continue
        kind = graph.kind[node]
        if kind not in family:
            to[node] = copy_node(graph, new, node, to)
            continue
        terms = [to[r >> 1] ^ (r & 1) for r in _terms(graph, node, inner)]
        join = new.add if family[kind] == "sum" else new.multiply
        heap = [(new.depth[r >> 1], k, r) for k, r in enumerate(terms)]
        heapq.heapify(heap)
        count = len(heap)
        while len(heap) > 1:
            a = heapq.heappop(heap)[2]
            b = heapq.heappop(heap)[2]
            joined = join(a, b)
            heapq.heappush(heap, (new.depth[joined >> 1], count, joined))
            count += 1
        to[node] = heap[0][2]
    new.outputs = [(array, entry, to[r >> 1] ^ (r & 1)) for array, entry, r in graph.outputs]
    return new


def _terms(graph: Graph, node: int, inner: Sequence[bool]) -> list[Reference]:
    """Terms of a sum (with their signs) or factors of a product; nodes marked in ``inner`` are
    taken apart.
    """
    out: list[Reference] = []
    stack = [2 * node]
    while stack:
        r = stack.pop()
        if r != 2 * node and not inner[r >> 1]:
            out.append(r)
            continue
        a, b = graph.operands[r >> 1]
        kind = graph.kind[r >> 1]
        sign = r & 1
        if kind == "mul":  # the sign of a product goes to its first factor
            stack += [b, a ^ sign]
        else:
            stack += [b ^ sign ^ (1 if kind == "sub" else 0), a ^ sign]
    return out
