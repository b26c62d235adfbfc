"""The C text of steps on columns of intermediate arrays: expressions for each of them, sums along
them, products.

Arrays are stored by rows. For one point, lanes hold columns; for lanes of points, each column is
done for itself. The operations are the same, and so are the bits. Rows end in zeros that fill a
vector.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from flexgen.base.errors import BuildError
from flexgen.codegen.statements.graph import read_graph
from flexgen.codegen.statements.layout import Layout, column_stride, loop_function
from flexgen.codegen.statements.routine import Columns, Products, Rows, Selected, Sums, Zeros
from flexgen.codegen.statements.schedule import choose_order
from flexgen.codegen.statements.simplify import simplify_graph

GROUP = 8  # rows that are summed at once: their sums stay in registers and are independent

_INFIX = {"add": "+", "sub": "-", "mul": "*"}
Literal = Callable[[float], str]


def columns_text(
    name: str, step: Columns, layout: Layout, literal: Literal
) -> tuple[str, int, int]:
    """The C function ``name`` of `Columns`, a loop over vectors of columns; operations for one
    column, and the latency of their longest chain [cycles].

    ``layout``: where arrays are in the workspace; ``literal``: writes a number.
    """
    graph = simplify_graph(read_graph(step.function))
    inputs = step.function.name_in()
    outputs = step.function.name_out()
    lines = []
    tables = []
    for array in inputs:
        if array in step.tables:
            tables += _table(
                array, step.tables[array], column_stride(step.n, layout.precision), literal
            )

    def operand(r: int) -> str:
        number = graph.number(r)
        if number is not None:
            return literal(number)
        return f"-t{r >> 1}" if r & 1 else f"t{r >> 1}"

    for node in choose_order(graph, (r >> 1 for _, _, r in graph.outputs), set()):
        kind = graph.kind[node]
        operands = graph.operands[node]
        if kind == "constant":
            continue
        if kind == "input":
            array = inputs[operands[0]]
            row = operands[1]
            if array in step.tables:
                text = f"ROW_TABLE({array}, {row * column_stride(step.n, layout.precision)}, k)"
            else:
                text = f"ROWS(w + {layout.at(array, row)})[k]"
        else:
            if kind not in _INFIX:
                raise BuildError(
                    f"columns of {name}: given the operation {kind}, expected sums and products"
                )
            text = f" {_INFIX[kind]} ".join(operand(r) for r in operands)
        lines.append(f"const ROW t{node} = {text};")
    for array, row, r in graph.outputs:
        value = operand(r) if graph.number(r) is None else f"ROW_OF({operand(r)})"
        lines.append(f"ROWS(w + {layout.at(outputs[array], row)})[k] = {value};")
    lines = [
        *tables,
        "int k;",
        f"for (k = 0; k < ROW_COUNT({step.n}); ++k) {{",
        *(f"    {line}" for line in lines),
        "}",
    ]
    depth = max((graph.depth[r >> 1] for _, _, r in graph.outputs), default=0)
    return loop_function(name, (), lines, "void"), graph.operations(), depth


def _table(name: str, numbers: np.ndarray, width: int, literal: Literal) -> list[str]:
    """Lines with the numbers of all columns, as wide as the rows of an array."""
    lines = [f"static const real {name}[{numbers.shape[0] * width}] = {{"]
    for row in numbers:
        padded = [*row.tolist(), *[0.0] * (width - len(row))]
        lines += [f"    {', '.join(map(literal, padded))},"]
    return [*lines, "};"]


def sums_text(name: str, step: Sums, layout: Layout, literal: Literal) -> str:
    """The C function ``name`` of `Sums`: running totals of columns, `GROUP` rows at a time in
    registers; arguments as for `columns_text`.
    """
    lines = ["int j, k;"]
    columns = [*step.at]
    dense = columns == [*range(step.n)]
    if not dense:
        lines.insert(
            0,
            f"static const unsigned char at[{len(columns)}] = {{{', '.join(map(str, columns))}}};",
        )
    for first in range(0, step.rows, GROUP):
        rows = range(first, min(first + GROUP, step.rows))
        starts = ", ".join(
            f"x{i} = F(splat)({literal(step.start[i] if step.start else 0.0)})" for i in rows
        )
        added = [f"x{i} += w[{layout.at(step.source, i)} + k];" for i in rows]
        stored = [f"w[{layout.at(step.target, i)} + j] = x{i};" for i in rows]
        lines += ["{", f"    T {starts};"]
        if dense:
            order = (
                f"j = {step.n - 1}; j >= 0; --j" if step.backward else f"j = 0; j < {step.n}; ++j"
            )
            lines += [
                f"    for ({order}) {{",
                "        k = j;",
                *_indent(added, 2),
                *_indent(stored, 2),
                "    }",
            ]
        elif step.backward:
            lines += [
                f"    j = {step.n - 1};",
                f"    for (k = {len(columns) - 1}; k >= 0; --k) {{",
                "        for (; j > at[k]; --j) {",
                *_indent(stored, 3),
                "        }",
                *_indent(added, 2),
                "    }",
                "    for (; j >= 0; --j) {",
                *_indent(stored, 2),
                "    }",
            ]
        else:
            lines += [
                "    j = 0;",
                f"    for (k = 0; k < {len(columns)}; ++k) {{",
                "        for (; j < at[k]; ++j) {",
                *_indent(stored, 3),
                "        }",
                *_indent(added, 2),
                "    }",
                f"    for (; j < {step.n}; ++j) {{",
                *_indent(stored, 2),
                "    }",
            ]
        lines.append("}")
    return loop_function(name, (), lines, "void")


def selected_text(name: str, step: Selected, layout: Layout) -> str:
    """The C function ``name`` of `Selected`, which copies some columns of an array; arguments as
    for `columns_text`.
    """
    source = layout.at(step.source, 0)
    target = layout.at(step.target, 0)
    lines = [
        f"static const unsigned char at[{len(step.at)}] = {{{', '.join(map(str, step.at))}}};",
        "int j, k;",
        f"for (j = 0; j < {step.rows}; ++j) {{",
        f"    for (k = 0; k < {len(step.at)}; ++k) {{",
        f"        w[{target} + j * {layout.strides[step.target]} + k] = "
        f"w[{source} + j * {layout.strides[step.source]} + at[k]];",
        "    }",
        "}",
    ]
    return loop_function(name, (), lines, "void")


def zeros_text(name: str, step: Zeros, layout: Layout) -> str:
    """The C function ``name`` of `Zeros`, whole vectors at a time; arguments as for
    `columns_text`.
    """
    lines = [
        "int i, k;",
        f"for (i = 0; i < {step.rows}; ++i) {{",
        f"    for (k = 0; k < ROW_COUNT({step.columns}); ++k) {{",
        (
            f"        ROWS(w + {layout.places[step.array]} + i * "
            f"{layout.strides[step.array]})[k] = ROW_OF(0);"
        ),
        "    }",
        "}",
    ]
    return loop_function(name, (), lines, "void")


def fill_text(name: str, layout: Layout) -> str:
    """The C function that ends rows in zeros, up to whole vectors: of all arrays that are not
    written by vectors.

    It comes first: what it writes before the end of a row is overwritten.
    """
    lines = []
    for array, (rows, columns) in layout.filled.items():
        lines += [
            f"for (i = 0; i < {rows} && ROW_LANES > 1; ++i) {{",
            (
                f"    ROWS(w + {layout.at(array, 0)} + i * "
                f"{layout.strides[array]})[ROW_COUNT({columns}) - 1] = ROW_OF(0);"
            ),
            "}",
        ]
    return loop_function(name, (), ["int i;", *lines], "void")


def products_text(name: str, step: Products, layout: Layout, outputs: Mapping[str, int]) -> str:
    """The C function of `Products`: lines, which are columns of a port or rows of an array, vector
    by vector.

    Vectors at the same place of the lines share registers; the last place is computed first, as
    for one point the memory after the end of a line is the begin of the next one. The last vector
    of a port's last line is copied. A vector with entries of both triangles is computed for both.
    Of a symmetric matrix in an array one triangle is enough, and for lanes of points it is
    computed once.
    """
    port = step.target in outputs
    n = step.n
    if port and step.first:
        raise ValueError(
            f"products into {step.target}: given column {step.first}, expected 0 for an output"
        )
    # the part above the diagonal is on the left of columns, and on the right of rows
    left, right = (step.above, step.below) if port else (step.below[::-1], step.above[::-1])

    def each(begin: str, end: str, value: str, more: Sequence[str] = ()) -> list[str]:
        """C lines that compute the lines ``begin <= i < end`` of the matrix as ``value``;
        ``more``: statements added for each.
        """
        return [
            f"    for (i = {begin}; i < {end}; ++i) {{",
            *([f"        real *const at = ROW_LAST(i, k, {n}) ? last : {at};"] if port else []),
            f"        const ROW sum = {value};",
            f"        {put};",
            *more,
            "        check += ZERO * sum;",
            "    }",
        ]

    if port:
        at = f"ROW_ENTRY({step.target}, i * {n} + k * ROW_LANES)"
        put = "ROW_OUT(at, sum)"
    else:
        put = (
            f"ROWS(w + {layout.at(step.target, 0) + step.first} + i * "
            f"{layout.strides[step.target]})[k] = sum"
        )
    once = ["#if !ONE_POINT", f"        OUT({step.target}, k * {n} + i, sum);", "#endif"]
    lines = [
        "ROW check = ROW_OF(0);",
        *(["real last[ROW_LANES];"] if port else []),
        "int i, k;",
        f"for (k = ROW_COUNT({n}) - 1; k >= 0; --k) {{",
        *_vectors(right, "right", layout),
    ]
    ahead = 0 if port or step.symmetric else 1  # the diagonal belongs to the lower triangle
    whole = f"    const int whole = LESSER({n}, (k + 1) * ROW_LANES - {ahead});"
    if step.symmetric and not port:
        lines += [
            whole,
            *each("0", "whole", _total(right, "right", layout)),
            "#if ONE_POINT",
            f"    for (i = whole; i < {n}; ++i) {{",
            f"        {put.replace('sum', 'ROW_OF(0)')};",
            "    }",
            "#endif",
        ]
    else:
        mixed = (
            f"before_v(i - k * ROW_LANES + {ahead}, {_total(left, 'left', layout)}, "
            f"{_total(right, 'right', layout)})"
        )
        lines += [
            *each(
                "0",
                f"k * ROW_LANES + {1 - ahead}",
                _total(right, "right", layout),
                once if step.symmetric else (),
            ),
            *(["#if ONE_POINT"] if step.symmetric else []),
            whole,
            *_vectors(left, "left", layout),
            *each(f"k * ROW_LANES + {1 - ahead}", "whole", mixed),
            *each("whole", str(n), _total(left, "left", layout)),
            *(["#endif"] if step.symmetric else []),
        ]
    lines.append("}")
    if port:
        lines += [
            f"for (i = {n} / ROW_LANES * ROW_LANES; i < {n} && ROW_LANES > 1; ++i) {{",
            f"    {step.target}[{n * (n - 1)} + i] = last[i % ROW_LANES];",
            "}",
        ]
    lines.append("return ROW_SUM(check);")
    return loop_function(name, (step.target,) if port else (), lines, "T")


def _vectors(pair: tuple[Rows, Rows], side: str, layout: Layout) -> list[str]:
    """Lines that keep the vectors of the first rows in registers."""
    rows = range(pair[0].count)
    return [
        f"    const ROW {side}{k} = ROWS(w + {layout.at(pair[0].array, pair[0].first + k)})[k];"
        for k in rows
    ]


def _total(pair: tuple[Rows, Rows], side: str, layout: Layout) -> str:
    """C expression: entry i of each second row times the vector ``side`` k of the first, added in
    pairs, so that few of the additions wait for each other.
    """
    rows = range(pair[0].count)
    terms = [f"w[{layout.at(pair[1].array, pair[1].first + k)} + i] * {side}{k}" for k in rows]
    while len(terms) > 1:
        terms = [" + ".join(terms[k : k + 2]) for k in range(0, len(terms), 2)]
        terms = [f"({term})" if len(terms) > 1 else term for term in terms]
    return terms[0]


def _indent(lines: Iterable[str], levels: int) -> list[str]:
    return ["    " * levels + line for line in lines]
