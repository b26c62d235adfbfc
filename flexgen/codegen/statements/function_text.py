"""The mathematics of one function as C: one local per operation, set once, for one point or for
lanes of points.

The text is included twice, see `flexgen.codegen.emission.emit`: with ``T`` a real for one point,
and with ``T`` a vector of reals, one per point. ``IN``, ``OUT`` and ``P`` reach an entry of an
input, an output and the parameters; ``F(name)`` is the kernel's function for T. Sines and cosines
are computed first, all angles at once. Long functions are split into chunks, as compile time and
memory grow faster than length; values that outlive a chunk pass through the workspace.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from flexgen.codegen.statements.column_loops import fill_text
from flexgen.codegen.statements.graph import Graph, read_graph
from flexgen.codegen.statements.layout import WHOLE, Layout, layout_of
from flexgen.codegen.statements.literals import literal
from flexgen.codegen.statements.pivot_guards import add_pivot_guards
from flexgen.codegen.statements.routine import Expressions, Routine
from flexgen.codegen.statements.schedule import choose_order, order_by_depth
from flexgen.codegen.statements.simplify import simplify_graph
from flexgen.codegen.statements.step_text import step_text

# operations per C function: a compiler keeps values in registers, and is quick, where functions
# are short
CHUNK = 500
MARGIN = 500  # a function that is longer than a chunk by less than this stays in one piece

AT_ONCE = 10  # entries of the workspace that a statement sets to the same value
LONG = 90  # characters of a sum that becomes a statement

_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}


@dataclass(frozen=True)
class FunctionText:
    """The text of the static C functions and what the caller needs to know of them.

    Parameters
    ----------
    text : str
        Definitions, to be included once per ``T``; ``F(<prefix>evaluate)`` is the last. It takes
        all inputs, all outputs, the stride of a batch and, where ``work`` > 0, the workspace, and
        returns zero where everything is finite, else NaN.
    work : int
        Entries of workspace, of type T.
    operations, depth : int
        Arithmetic operations per evaluation, and the latency of the longest chain of them in
        cycles, about.
    calls : int
        Those of the operations that are calls of a function, such as a sine.
    stack : int
        Reals in local variables at most, for one point.
    """

    text: str
    work: int
    operations: int
    depth: int
    stack: int
    calls: int = 0


@dataclass
class _Piece:
    """A C function: its lines, the ports it uses, whether it uses the workspace, how many locals
    it has.
    """

    lines: list[str] = field(default_factory=list)
    ports: set[str] = field(default_factory=set)
    workspace: bool = False
    locals: int = 0
    known: set[int] = field(default_factory=set)
    stored: set[int] = field(default_factory=set)
    broken: bool = False  # a result is never finite


def function_text(
    program: Routine,
    inputs: Mapping[str, int],
    outputs: Mapping[str, int],
    parameters: str | None = None,
    precision: str = "double",
    values: Sequence[float] = (),
    prefix: str = "",
    shared: bool = True,
) -> FunctionText:
    """C text of a program; BuildError names an operation that cannot be written.

    Parameters
    ----------
    program : Routine
    inputs, outputs : mapping of str to int
        Entries of each port, in the order of the arguments.
    parameters : str, optional
        The input that holds the parameters: the same for all points of a batch where ``shared``.
    precision : str
        ``"double"`` or ``"single"``.
    values : sequence of float
        Values of the parameters in the model file.
    prefix : str
        Begin of the names of the static functions, so that several functions fit into one C file.
    shared : bool
        False: the parameters are an input like the others, one vector for each point.
    """
    common = parameters if shared else None
    layout = layout_of(program, outputs, precision)
    texts: list[str] = []
    calls: list[str] = []
    work = layout.size
    stack = 0
    operations = 0
    depth = 0
    called = 0
    # entries of inputs that show in a result where they are not finite
    seen: set[tuple[str, int]] = set()
    whole = False  # one function computes everything
    if layout.size > 0:
        work += WHOLE
        calls.append("w = F(aligned)(w);")
    if layout.filled:
        texts.append(fill_text(f"{prefix}fill", layout))
        calls.append(_call(f"{prefix}fill", [], workspace=True))
    for k, step in enumerate(program.steps):
        if not isinstance(step, Expressions):
            loop = step_text(f"{prefix}step_{k + 1}", step, layout, outputs, precision)
            texts.append(loop.text)
            calls.append(
                "zero += " * loop.checks
                + _call(f"{prefix}step_{k + 1}", loop.ports, workspace=True)
            )
            operations = operations + loop.operations
            depth = depth + loop.depth
            continue
        graph = simplify_graph(read_graph(step.function))
        if step.pivots:
            given = {parameters: np.array(values)} if parameters is not None else {}
            graph = add_pivot_guards(graph, step.function.name_in(), given, precision)
        writer = _Writer(graph, step, layout, common, precision)
        pieces = writer.pieces()
        seen |= _trace_inputs(graph, step, {*outputs, *layout.places})
        whole = len(pieces) == len(program.steps) == 1
        for i, piece in enumerate(pieces):
            stack = max(stack, piece.locals)
            if whole:
                unread = [
                    (port, e)
                    for port, size in inputs.items()
                    for e in range(size)
                    if (port, e) not in seen
                ]
                piece.lines += writer.check(piece, unread)
                texts.append(_function(f"{prefix}evaluate", piece, [*inputs], [*outputs]))
                continue
            piece.lines += writer.check(piece, ())
            name = f"{prefix}evaluate_{k + 1}_{i + 1}"
            ports = [port for port in (*inputs, *outputs) if port in piece.ports]
            kinds = (
                [port for port in ports if port in inputs],
                [port for port in ports if port in outputs],
            )
            texts.append("SEPARATE " + _function(name, piece, *kinds, common))
            calls.append("zero += " + _call(name, ports, piece.workspace, common))
        work = max(work, writer.start + writer.spilled + (WHOLE if layout.size > 0 else 0))
        operations = operations + graph.operations()
        called = called + graph.calls()
        depth += max((graph.depth[r >> 1] for _, _, r in graph.outputs), default=0)
    if not whole:
        zero = literal(0.0, precision)
        unread = [
            (port, e)
            for port, size in inputs.items()
            for e in range(size)
            if (port, e) not in seen
        ]
        calls = [f"T zero = F(splat)({zero});", *calls]
        calls += [f"zero += {zero} * {_access(port, e, common)};" for port, e in unread]
        last = _Piece([*calls, "return zero;"], workspace=work > 0)
        texts.append(_function(f"{prefix}evaluate", last, [*inputs], [*outputs]))
    return FunctionText("\n".join(texts), work, operations, depth, stack, called)


# --- around the expressions ----------------------------------------------------------------------


def _call(name: str, ports: Sequence[str], workspace: bool, parameters: str | None = None) -> str:
    arguments = ", ".join([*ports, *(["w"] if workspace else [])])
    return f"F({name})({arguments}{' STRIDE(n)' if set(ports) - {parameters} else ''});"


def _function(
    name: str,
    piece: _Piece,
    inputs: Sequence[str],
    outputs: Sequence[str],
    shared: str | None = None,
) -> str:
    """The C function of a piece: ports, workspace where it has one, stride where a port has one
    value per point; ``shared``: the input that is the same for all points.
    """
    parameters = [f"const real *RESTRICT {port}" for port in inputs]
    parameters += [f"real *RESTRICT {port}" for port in outputs]
    if piece.workspace:
        parameters.append("T *RESTRICT w")
    stride = " STRIDE(ptrdiff_t n)" if {*inputs, *outputs} - {shared} else ""
    body = "".join(f"    {line}\n" for line in piece.lines)
    return f"static T F({name})({', '.join(parameters) or 'void'}{stride})\n{{\n{body}}}\n"


def _trace_inputs(
    graph: Graph, step: Expressions, arrays: Collection[str]
) -> set[tuple[str, int]]:
    """Entries of inputs that make an entry of the given arrays NaN or infinite where they are."""
    function = step.function
    carried = graph.find_carriers(
        {i for i, name in enumerate(function.name_out()) if name in arrays}
    )
    names = function.name_in()
    entries = (graph.operands[node] for node in carried if graph.kind[node] == "input")
    return {(names[array], entry) for array, entry in entries}


def _access(name: str, entry: int, parameters: str | None) -> str:
    return f"P({name}, {entry})" if name == parameters else f"IN({name}, {entry})"


# --- expressions ---------------------------------------------------------------------------------


class _Writer:
    """Writes the expressions of one step."""

    def __init__(
        self,
        graph: Graph,
        step: Expressions,
        layout: Layout,
        parameters: str | None,
        precision: str,
    ) -> None:
        """``step``: whose ``graph`` is written; ``layout``: of the workspace; ``parameters``: name
        of the input that all points share, None: none; ``precision``: of literals. ValueError
        where it adds to an output.
        """
        self.graph = graph
        self.layout = layout
        self.parameters = parameters
        self.precision = precision
        self.added = step.added
        self.inputs = step.function.name_in()
        self.outputs = step.function.name_out()
        self.input_rows = [step.function.size1_in(i) for i in range(step.function.n_in())]
        if step.added and not set(self.outputs) <= set(layout.places):
            raise ValueError(
                f"expressions {self.outputs}: given an output, expected intermediate arrays to "
                "add to"
            )
        self.rows = [step.function.size1_out(i) for i in range(step.function.n_out())]
        self.needed = graph.alive()
        self.start = layout.size
        self.spilled = 0
        self.slots: dict[int, int] = {}
        self.stores: dict[int, list[tuple[int, int, int]]] = {}
        for array, entry, r in graph.outputs:
            self.stores.setdefault(r >> 1, []).append((array, entry, r))
        self.turning: dict[int, list[int]] = {}  # angle: its sine and its cosine, where needed
        for node, kind in enumerate(graph.kind):
            if kind in ("sin", "cos") and self.needed[node]:
                self.turning.setdefault(graph.operands[node][0] >> 1, []).append(node)

    def pieces(self) -> list[_Piece]:
        """The functions, in the order of their calls."""
        order = self._order()
        if len(order) <= CHUNK + MARGIN:
            parts = [order]
        else:
            count = math.ceil(len(order) / CHUNK)
            parts = [
                order[len(order) * k // count : len(order) * (k + 1) // count]
                for k in range(count)
            ]
        self._place(parts)
        made = [self._piece(part, last=k == len(parts) - 1) for k, part in enumerate(parts)]
        return [piece for piece in made if piece.lines] or made[:1]

    def _order(self) -> list[int | tuple[int, ...]]:
        """Nodes in the order of computation; a tuple of angles where their sines and cosines are
        computed.
        """
        graph = self.graph
        level = [0] * len(graph.kind)  # how many rounds of sines and cosines a value needs
        groups: dict[int, list[int]] = {}
        for node, kind in enumerate(graph.kind):
            level[node] = max((level[other] for other in graph.arguments(node)), default=0)
            if kind in ("sin", "cos"):
                level[node] += 1
            if node in self.turning:
                groups.setdefault(level[node], []).append(node)
        out: list[int | tuple[int, ...]] = []
        seen: set[int] = set()
        for key in sorted(groups):
            out += order_by_depth(graph, groups[key], seen)
            out.append(tuple(groups[key]))
            seen.update(node for angle in groups[key] for node in self.turning[angle])
        return out + choose_order(graph, (r >> 1 for _, _, r in graph.outputs), seen)

    def _uses(self, item: int | tuple[int, ...]) -> tuple[int, ...]:
        return item if isinstance(item, tuple) else (item, *self.graph.arguments(item))

    def _gives(self, item: int | tuple[int, ...]) -> list[int]:
        if isinstance(item, tuple):
            return [node for angle in item for node in self.turning[angle]]
        return [] if self.graph.kind[item] in ("input", "constant") else [item]

    def _place(self, parts: Sequence[Sequence[int | tuple[int, ...]]]) -> None:
        """Place in the workspace of every value that outlives its piece; free again after the
        piece of its last use. An item of a part is a node, or the sine and cosine of one angle.
        """
        born: dict[int, int] = {}
        last: dict[int, int] = {}
        for k, part in enumerate(parts):
            for item in part:
                for node in self._gives(item):
                    born[node] = k
                for node in self._uses(item):
                    last[node] = k
        free: list[int] = []
        ending: dict[int, list[int]] = {}
        for k, part in enumerate(parts):
            for item in part:
                for node in self._gives(item):
                    if last.get(node, k) > k:
                        if not free:
                            free.append(self.spilled)
                            self.spilled += 1
                        self.slots[node] = free.pop()
                        ending.setdefault(last[node], []).append(self.slots[node])
            free.extend(reversed(ending.get(k, [])))

    def _piece(self, part: Sequence[int | tuple[int, ...]], last: bool) -> _Piece:
        """The statements of one part of the schedule; the ``last`` one also writes the results
        that are constants.
        """
        piece = _Piece()
        for item in part:
            if isinstance(item, tuple):
                self._sincos(piece, item)
            elif self.graph.kind[item] not in ("input", "constant"):
                self._compute(piece, item)
            if isinstance(item, tuple):
                for node in self._gives(item):
                    self._store(piece, node)
            elif self.graph.kind[item] != "constant":
                self._store(piece, item)
        if last:
            for node in self.stores:
                if self.graph.kind[node] == "constant":
                    self._store(piece, node)
        return piece

    def _operand(self, r: int) -> str:
        number = self.graph.number(r)
        if number is not None:
            return literal(number, self.precision)
        return f"-t{r >> 1}" if r & 1 else f"t{r >> 1}"

    def _argument(self, r: int) -> str:
        """An operand of type T."""
        return (
            f"F(splat)({self._operand(r)})"
            if self.graph.number(r) is not None
            else self._operand(r)
        )

    def _fetch(self, piece: _Piece, node: int) -> None:
        """Load a value: an input is read, a value of an earlier piece comes from the workspace."""
        kind = self.graph.kind[node]
        if node in piece.known or kind == "constant":
            return
        piece.known.add(node)
        piece.locals += 1
        if kind == "input":
            array, entry = self.graph.operands[node]
            text = self._input(piece, self.inputs[array], entry)
        else:
            piece.workspace = True
            text = f"w[{self.start + self.slots[node]}]"
        piece.lines.append(f"T t{node} = {text};")

    def _input(self, piece: _Piece, name: str, entry: int) -> str:
        """C expression for entry ``entry`` (by columns) of the input ``name``, in the workspace or
        a port.
        """
        if name in self.layout.places:
            piece.workspace = True
            if name in self.layout.strides:  # by rows
                rows = self.input_rows[self.inputs.index(name)]
                entry = (entry % rows) * self.layout.strides[name] + entry // rows
            return f"w[{self.layout.places[name] + entry}]"
        piece.ports.add(name)
        return _access(name, entry, self.parameters)

    def _define(self, piece: _Piece, node: int, text: str) -> None:
        """Declare ``t<node>`` with the C expression ``text``, and keep it in the workspace where a
        later piece reads it.
        """
        piece.known.add(node)
        piece.locals += 1
        piece.lines.append(f"T t{node} = {text};")
        if node in self.slots:
            piece.workspace = True
            piece.lines.append(f"w[{self.start + self.slots[node]}] = t{node};")

    def _compute(self, piece: _Piece, node: int) -> None:
        """Fetch the operands of a node and declare its value."""
        kind = self.graph.kind[node]
        operands = self.graph.operands[node]
        for r in operands:
            self._fetch(piece, r >> 1)
        if kind in _INFIX:
            text = f" {_INFIX[kind]} ".join(self._operand(r) for r in operands)
        else:
            text = f"F({kind})({', '.join(self._argument(r) for r in operands)})"
        self._define(piece, node, text)

    def _sincos(self, piece: _Piece, angles: tuple[int, ...]) -> None:
        """Sines and cosines of a group of angles."""
        for angle in angles:
            self._fetch(piece, angle)
        n = len(angles)
        first = angles[0]
        values = ", ".join(f"t{angle}" for angle in angles)
        piece.lines.append(f"SINES_COSINES({first}, {n}, {values})")
        piece.locals += 3 * -(-n // 16) * 16
        for k, angle in enumerate(angles):
            for node in self.turning[angle]:
                self._define(
                    piece,
                    node,
                    f"{'sine' if self.graph.kind[node] == 'sin' else 'cosine'}{first}[{k}]",
                )

    def _store(self, piece: _Piece, node: int) -> None:
        """Write a value wherever it is a result."""
        places: dict[str, list[str]] = {}  # of the workspace, by the text of the value
        for array, entry, r in self.stores.get(node, ()):
            if self.added and self.graph.number(r) == 0.0:
                continue
            self._fetch(piece, node)
            name = self.outputs[array]
            rows = self.rows[array]
            if self.graph.kind[node] != "constant":
                piece.stored.add(node)
            elif not math.isfinite(self.graph.value[node]):
                piece.broken = True
            if name not in self.layout.places:
                piece.ports.add(name)
                piece.lines.append(f"OUT({name}, {entry}, {self._argument(r)});")
                continue
            piece.workspace = True
            if name in self.layout.strides:  # by rows
                entry = (entry % rows) * self.layout.strides[name] + entry // rows
            place = f"w[{self.layout.places[name] + entry}]"
            if self.added:
                piece.lines.append(f"{place} += {self._argument(r)};")
            else:
                places.setdefault(self._argument(r), []).append(place)
        for value, equal in places.items():
            chunks = (equal[k : k + AT_ONCE] for k in range(0, len(equal), AT_ONCE))
            # C begins with the last
            piece.lines += [" = ".join([*reversed(chunk), value]) + ";" for chunk in chunks]

    def check(self, piece: _Piece, unread: Sequence[tuple[str, int]]) -> list[str]:
        """C lines that return the sum of zero times every result and of the entries ``unread``,
        (input, entry): NaN where one is not finite. They are combined in the order in which they
        become known.
        """
        zero = literal(0.0, self.precision)
        heap: list[tuple[int, int, str]] = [
            (self.graph.depth[node], node, f"{zero} * t{node}") for node in sorted(piece.stored)
        ]
        count = len(self.graph.kind)
        if piece.broken:
            heap.append((0, count, "F(splat)(NAN)"))
            count += 1
        for name, entry in unread:
            heap.append((0, count, f"{zero} * {_access(name, entry, self.parameters)}"))
            count += 1
        heapq.heapify(heap)
        lines = []
        while len(heap) > 1:
            a = heapq.heappop(heap)
            b = heapq.heappop(heap)
            text = f"{a[2]} + ({b[2]})" if "+" in b[2] else f"{a[2]} + {b[2]}"
            if len(text) > LONG:
                lines.append(f"T z{count} = {text};")
                text = f"z{count}"
            heapq.heappush(heap, (max(a[0], b[0]) + 4, count, text))
            count += 1
        return [*lines, f"return {heap[0][2] if heap else f'F(splat)({zero})'};"]
