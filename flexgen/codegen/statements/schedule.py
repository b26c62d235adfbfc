"""The order in which the operations of a graph are written.

A compiler reorders little over hundreds of statements, and a processor looks some hundred
instructions ahead. Functions that wait for their longest chain are written with the operations on
it first; large ones so that a value is used soon after it is made, and need not be stored.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable

from flexgen.codegen.statements.graph import LATENCY, OTHER_LATENCY, Graph

PER_CYCLE = 4  # operations that the assumed processor starts in a cycle
LARGE = 2500  # operations beyond which keeping values costs more than waiting for them
WIDE = 3  # operations per cycle of the longest chain beyond which the processor is busy anyway


def choose_order(graph: Graph, roots: Iterable[int], seen: set[int]) -> list[int]:
    """Nodes that the roots need and that were not seen before, in the order that suits the
    graph.
    """
    count = graph.operations()
    depth = max((graph.depth[r >> 1] for _, _, r in graph.outputs), default=0)
    chosen = schedule_nodes if count <= LARGE and count <= WIDE * depth else order_by_depth
    return chosen(graph, roots, seen)


def order_by_depth(graph: Graph, roots: Iterable[int], seen: set[int]) -> list[int]:
    """Nodes that the roots need and that were not seen before, each after its operands, a use
    close to its value.
    """
    out: list[int] = []
    for root in roots:
        stack = [(root, False)]
        while stack:
            node, done = stack.pop()
            if done:
                out.append(node)
            elif node not in seen:
                seen.add(node)
                stack.append((node, True))
                # the deepest operand first, so that the shallow ones do not occupy registers
                below = sorted(set(graph.arguments(node)), key=lambda n: graph.depth[n])
                stack += [(other, False) for other in below if other not in seen]
    return out


def schedule_nodes(graph: Graph, roots: Iterable[int], seen: set[int]) -> list[int]:
    """Nodes that the roots need and that were not seen before, in the order in which a processor
    would start them.

    Of the operations whose operands are known, those with the longest chain behind them come
    first.
    """
    wanted: set[int] = set()
    stack = list(roots)
    while stack:
        node = stack.pop()
        if node not in wanted and node not in seen:
            wanted.add(node)
            stack += graph.arguments(node)
    behind = [0] * len(graph.kind)
    users: dict[int, list[int]] = {}
    missing: dict[int, int] = {}
    for node in sorted(wanted, reverse=True):
        below = {other for other in graph.arguments(node) if other in wanted}
        missing[node] = len(below)
        for other in below:
            users.setdefault(other, []).append(node)
            behind[other] = max(behind[other], behind[node] + _latency(graph, node))
    ready = [(-behind[node], node) for node in sorted(wanted) if missing[node] == 0]
    heapq.heapify(ready)
    waiting: list[tuple[float, int]] = []  # when the operands are known, node
    known: dict[int, float] = {}
    now = 0.0
    out = []
    while ready or waiting:
        while waiting and waiting[0][0] <= now:
            node = heapq.heappop(waiting)[1]
            heapq.heappush(ready, (-behind[node], node))
        if not ready:
            now = waiting[0][0]
            continue
        node = heapq.heappop(ready)[1]
        out.append(node)
        for user in users.get(node, ()):
            known[user] = max(known.get(user, 0.0), now + _latency(graph, node))
            missing[user] -= 1
            if missing[user] == 0:
                heapq.heappush(waiting, (known[user], user))
        now += 1.0 / PER_CYCLE if graph.arguments(node) else 0.0
    seen.update(out)
    return out


def _latency(graph: Graph, node: int) -> int:
    """Cycles until the value of a node is known; sines and cosines are known before."""
    kind = graph.kind[node]
    return 0 if kind in ("input", "constant", "sin", "cos") else LATENCY.get(kind, OTHER_LATENCY)
