"""The C text of a linear solve in loops: small code for systems whose unrolled elimination would be long.

For one point the loops run over lanes of columns of the right side, for lanes of points over its columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flexgen.expressions.routine import Products, Solve


@dataclass(frozen=True)
class Layout:
    """Intermediate arrays in the workspace: their starts, the stride of rows of those stored by rows, size."""

    places: Mapping[str, int]
    strides: Mapping[str, int]
    size: int


def solve_text(name: str, step: Solve, layout: Layout, outputs: Mapping[str, int], rounding: str) -> str:
    """The C function of a `Solve`: factor, substitute, and write the solution to its ports.

    A = U' D^-1 U by rows: ``U_ik = A_ik - sum_j f_j U_jk`` and ``Y_ik = R_ik - sum_j f_j Y_jk`` with
    ``f_j = U_ji / d_j`` for all j < i within the profile, ``d_i = U_ii``; then
    ``X_ik = Y_ik / d_i - sum_j (U_ij / d_i) X_jk`` for all j > i.
    A pivot d_i below ``rounding`` times A_ii is noise: its reciprocal becomes NaN. Every sum stays
    in a register.
    """
    n, width = step.n, step.width
    ports = [port for port in outputs if port in step.ports]
    parameters = ", ".join([*(f"real *RESTRICT {port}" for port in ports), "T *RESTRICT w"])
    lines = [
        f"static const unsigned char first[{n}] = {{{', '.join(map(str, step.profile))}}};",
        f"T *const matrix = w + {layout.places[step.matrix]};",
        "ROW *const upper = ROWS(matrix);",
        f"ROW *const rows = ROWS(w + {layout.places[step.right]});",
        f"const int count = ROW_FOURS({width});",
        f"T inverse[{n}], factor[{n}];",
        "ROW sum = ROW_OF(0);",
        "int i, j, k, begin;",
    ]
    lines += _padded(step, layout)
    lines += _eliminated(step, rounding)
    lines += _substituted(step)
    lines += _placed(step, layout, outputs)
    lines += [
        f"for (i = 0; i < {n}; ++i) {{",
        f"    const ROW *const x = rows + i * ROW_COUNT({step.stride});",
        "    for (k = 0; k < count; ++k) {",
        "        sum += ZERO * x[k];",
        "    }",
        "}",
        "return ROW_SUM(sum);",
    ]
    body = "".join(f"    {line}\n" for line in lines)
    return f"SEPARATE static T F({name})({parameters} STRIDE(ptrdiff_t n))\n{{\n{body}}}\n"


def products_text(name: str, step: Products, layout: Layout) -> str:
    """The C function of `Products`: rows of M, right of the diagonal from S_i and F, left of it from F_i and S.

    For one point, what is left of the diagonal is computed as well where it fills whole vectors; the products are the
    same, and so are the bits. A vector may end in the next row, which is written later; the last entry of all is alone.
    """
    n, stride, port = step.n, step.stride, step.port
    S, F, M = (layout.places[key] for key in (step.left, step.right, _matrix_of(step)))

    def total(terms: list[str]) -> str:
        """The sum of the terms in pairs, so that few of them wait for each other."""
        while len(terms) > 1:
            pairs = [f"({' + '.join(terms[k : k + 2])})" for k in range(0, len(terms), 2)]
            terms = pairs
        return terms[0]

    def row(vectors: int, numbers: int, begin: str, end: str) -> list[str]:
        rows = range(step.rows)
        products = total([f"x{k} * ROWS(w + {vectors + k * stride})[k]" for k in rows])
        return [
            "    {",
            *(f"        const T x{k} = w[{numbers + k * stride} + i];" for k in rows),
            f"        for (k = {begin}; k < {end}; ++k) {{",
            f"            const ROW sum = {products};",
            f"            ROW_OUT({port}, i * {n}, k, sum);",
            "            if (!ONE_POINT) {",
            f"                ROWS(w + {M} + i * {stride})[k] = sum;",
            "            }",
            "            check += ZERO * sum;",
            "        }",
            "    }",
        ]

    last = total([f"w[{S + k * stride + n - 1}] * w[{F + k * stride + n - 1}]" for k in range(step.rows)])
    lines = [
        "ROW check = ROW_OF(0);",
        f"const T last = {last};",
        "int i, j, k;",
        f"for (i = 0; i < {step.rows}; ++i) {{",
        f"    for (j = {n}; j < ROW_COUNT({n}) * ROW_LANES; ++j) {{",
        f"        w[{S} + i * {stride} + j] = w[{F} + i * {stride} + j] = F(splat)(0);",
        "    }",
        "}",
        f"for (i = 0; i < {n}; ++i) {{",
        *row(S, F, "0", "ROWS_LEFT(i)"),
        f"    if (i + 1 < {n}) {{",
        *(f"    {line}" for line in row(F, S, "ROW_OF_COLUMN(i)", f"ROW_COUNT({n})")),
        "    }",
        "    for (j = ROWS_LEFT(i) * ROW_LANES; j < i; ++j) {",
        f"        OUT({port}, i * {n} + j, ONE_POINT ? IN({port}, j * {n} + i) : w[{M} + j * {stride} + i]);",
        "    }",
        "}",
        f"OUT({port}, {n * n - 1}, last);",
        "return ROW_SUM(check) + ZERO * last;",
    ]
    body = "".join(f"    {line}\n" for line in lines)
    return f"SEPARATE static T F({name})(real *RESTRICT {port}, T *RESTRICT w STRIDE(ptrdiff_t n))\n{{\n{body}}}\n"


def _matrix_of(step: Products) -> str:
    """Name of the matrix in the workspace."""
    return f"rows of {step.port}"


def extra_arrays(step: Products) -> dict[str, int]:
    """Arrays of the workspace that a step needs for itself, with their sizes."""
    return {_matrix_of(step): step.n * step.stride}


def _padded(step: Solve, layout: Layout) -> list[str]:
    """Lines that fill what is not computed: the unit columns, and the ends of rows that are not whole vectors."""
    n = step.n
    right = f"w[{layout.places[step.right]} + i * {step.stride} + j]"
    lines = [
        f"for (i = 0; i < {n}; ++i) {{",
        f"    for (j = {n}; j < ROW_END({n}); ++j) {{",
        f"        matrix[i * {step.matrix_stride} + j] = F(splat)(0);",
        "    }",
        f"    for (j = {step.columns}; j < ROW_END({step.width}); ++j) {{",
        f"        {right} = F(splat)(0);",
        "    }",
    ]
    if step.unit:
        lines.append(f"    w[{layout.places[step.right]} + i * {step.stride + 1} + {step.columns}] = F(splat)(-1);")
    return [*lines, "}"]


def _less(row: str, factor: str, other: str, begin: str, end: str, start: str = "x[k]") -> list[str]:
    """Lines that take multiples of other rows from a row: four sums at a time, which do not wait for each other."""
    places = ["k", "k + 1", "k + 2", "k + 3"]
    return [
        f"    for (k = {begin}; k < {end}; k += 4) {{",
        *(f"        ROW rest{i} = {start.replace('k]', f'{place}]')};" for i, place in enumerate(places)),
        f"        for ({other}) {{",
        f"            const T times = {factor};",
        *(f"            rest{i} -= times * {row.replace('k]', f'{place}]')};" for i, place in enumerate(places)),
        "        }",
        *(f"        x[{place}] = rest{i};" for i, place in enumerate(places)),
        "    }",
    ]


def _eliminated(step: Solve, rounding: str) -> list[str]:
    """Lines that factor the matrix; the factors f_j of row i in its lower half, reciprocals of pivots in `inverse`."""
    n, stride = step.n, step.matrix_stride
    above = "j = first[i]; j < i; ++j"
    return [
        f"for (i = 0; i < {n}; ++i) {{",
        f"    ROW *const x = upper + i * ROW_COUNT({stride});",
        f"    const T whole = matrix[i * {stride + 1}];",
        f"    for ({above}) {{",
        f"        factor[j] = matrix[j * {stride} + i] * inverse[j];",
        "    }",
        *_less(
            f"upper[j * ROW_COUNT({stride}) + k]", "factor[j]", above, "ROW_OF_COLUMN(i) / 4 * 4", f"ROW_FOURS({n})"
        ),
        f"    for ({above}) {{",
        f"        matrix[i * {stride} + j] = factor[j];",
        "    }",
        f"    inverse[i] = F(guarded)(F(splat)(1) / matrix[i * {stride + 1}], matrix[i * {stride + 1}], "
        f"{rounding} * whole);",
        "}",
        f"for (i = 0; i < {n}; ++i) {{",
        f"    for (j = i + 1; j < {n}; ++j) {{",
        f"        matrix[i * {stride} + j] = matrix[i * {stride} + j] * inverse[i];",
        "    }",
        "}",
    ]


def _substituted(step: Solve) -> list[str]:
    """Lines that combine the rows of the right side as the factors demand, a few columns at a time."""
    n, stride = step.n, step.matrix_stride
    other, factor = f"rows[j * ROW_COUNT({step.stride}) + k]", f"matrix[i * {stride} + j]"
    lines = [
        f"for (i = 0; i < {n}; ++i) {{",
        f"    ROW *const x = rows + i * ROW_COUNT({step.stride});",
        *_less(other, factor, "j = first[i]; j < i; ++j", "begin", "end"),
        "}",
        f"for (i = {n - 1}; i >= 0; --i) {{",
        f"    ROW *const x = rows + i * ROW_COUNT({step.stride});",
        "    const T pivot = inverse[i];",
        *_less(other, factor, f"j = i + 1; j < {n}; ++j", "begin", "end", "pivot * x[k]"),
        "}",
    ]
    return [
        "for (begin = 0; begin < count; begin += ROW_BLOCK) {",
        "    const int end = begin + ROW_BLOCK < count ? begin + ROW_BLOCK : count;",
        *(f"    {line}" for line in lines),
        "}",
    ]


def _placed(step: Solve, layout: Layout, outputs: Mapping[str, int]) -> list[str]:
    """Lines that write the solution, and the constants around it."""
    lines: list[str] = []
    for port in step.ports:
        blocks = [block for block in step.blocks if block.port == port]
        covered = sum(block.count for block in blocks) * step.n
        rows = outputs[port] // sum(block.count for block in blocks)
        if covered < outputs[port]:
            lines += [f"for (i = 0; i < {outputs[port]}; ++i) {{", f"    OUT({port}, i, F(splat)(0));", "}"]
        column = 0
        for block in blocks:
            lines += [
                f"for (j = 0; j < {block.count}; ++j) {{",
                f"    for (i = 0; i < {step.n}; ++i) {{",
                f"        OUT({port}, (j + {column}) * {rows} + {block.row} + i, "
                f"F(splat)(0) - w[{layout.places[step.right]} + i * {step.stride} + j + {block.first}]);",
                "    }",
                "}",
            ]
            column += block.count
        lines += [
            f"OUT({port}, {row + column_of * rows}, F(splat)(1));" for name, row, column_of in step.ones if name == port
        ]
    return lines
