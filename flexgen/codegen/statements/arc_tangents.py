"""Sines and cosines of angles that contain arc tangents, without the arc tangents.

    cos(a + atan2(y, x)) = (x cos a - y sin a) / r
    sin(a + atan2(y, x)) = (x sin a + y cos a) / r,    r = sqrt(x^2 + y^2)

The joints of closed loops are arc tangents, and bodies need their sines and cosines alone. Terms
of the argument that cancel are left out.
"""

from __future__ import annotations

from flexgen.codegen.statements.graph import Graph, Reference, copy_node

Turn = tuple[Reference, Reference]  # cosine and sine of an angle


def replace_arc_tangents(graph: Graph) -> Graph:
    """The graph with the equations of the module at its sines and cosines of sums with arc
    tangents; the graph itself where there are none.
    """
    needed = graph.alive()
    terms = {
        node: sum_terms(graph, graph.operands[node][0])
        for node, kind in enumerate(graph.kind)
        if kind in ("sin", "cos") and needed[node]
    }
    terms = {
        node: found
        for node, found in terms.items()
        if any(graph.kind[term] == "atan2" for term in found)
    }
    if not terms:
        return graph
    new = Graph()
    to: dict[int, Reference] = {}
    units: dict[int, Turn] = {}
    for node, used in enumerate(needed):
        if not used:
            continue
        if node in terms:
            cosine, sine = _turn_by(graph, new, terms[node], to, units)
            to[node] = cosine if graph.kind[node] == "cos" else sine
        else:
            to[node] = copy_node(graph, new, node, to)
    new.outputs = [(array, entry, to[r >> 1] ^ (r & 1)) for array, entry, r in graph.outputs]
    return new


def sum_terms(graph: Graph, r: Reference) -> dict[int, int]:
    """Terms of a sum, by node, with the number of times they are added; those that cancel are left
    out.
    """
    found: dict[int, int] = {}
    stack = [r]
    while stack:
        r = stack.pop()
        kind = graph.kind[r >> 1]
        if kind in ("add", "sub"):
            a, b = graph.operands[r >> 1]
            stack += [a ^ (r & 1), b ^ (r & 1) ^ (kind == "sub")]
        else:
            found[r >> 1] = found.get(r >> 1, 0) + (-1 if r & 1 else 1)
    return {node: count for node, count in found.items() if count}


def _turn_by(
    graph: Graph,
    new: Graph,
    terms: dict[int, int],
    to: dict[int, Reference],
    units: dict[int, Turn],
) -> Turn:
    """Cosine and sine of a sum of terms of the old graph, in the new one.

    ``units``: those of arc tangents that are known already.
    """
    rest = new.constant(0.0)
    turns: list[Turn] = []
    for node, count in terms.items():
        if graph.kind[node] != "atan2":
            rest = new.add(rest, new.multiply(new.constant(float(count)), to[node]))
            continue
        if node not in units:
            y, x = (to[r >> 1] ^ (r & 1) for r in graph.operands[node])
            square = new.add(new.multiply(x, x), new.multiply(y, y))
            inverse = new.divide(new.constant(1.0), new.call("sqrt", [square]))
            units[node] = new.multiply(x, inverse), new.multiply(y, inverse)
        cosine, sine = units[node]
        turns += [(cosine, sine ^ (count < 0))] * abs(count)
    cosine, sine = turns[0]
    angle = new.number(rest)
    if angle != 0.0:
        turns.append((new.call("cos", [rest]), new.call("sin", [rest])))
    for c, s in turns[1:]:
        turned = new.add(new.multiply(cosine, c), new.multiply(sine, s) ^ 1)
        sine = new.add(new.multiply(sine, c), new.multiply(cosine, s))
        cosine = turned
    return cosine, sine
