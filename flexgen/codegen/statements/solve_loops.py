"""The C text of a linear solve in loops: small code for systems whose unrolled elimination would
be long.

For one point the loops run over lanes of columns of the right side, for lanes of points over its
columns.
"""

from __future__ import annotations

from collections.abc import Mapping

from flexgen.codegen.statements.layout import Layout, loop_function, pivots_of
from flexgen.codegen.statements.routine import Factor, Solve


def solve_text(
    name: str, step: Solve, layout: Layout, outputs: Mapping[str, int], rounding: str
) -> str:
    """The C function of a `Solve`: factor, substitute, and write the solution to its ports.

    A = L' D L with ``d_j = U_jj, L_jk = U_jk / d_j``: row j is taken from those below it,
    ``U_ik -= L_ji U_jk``. Then ``Y_ik = R_ik - sum_j L_ji Y_jk`` for all j < i within the profile
    and ``X_ik = Y_ik / d_i - sum_j L_ij X_jk`` for all j > i. A pivot d_i below ``rounding`` times
    A_ii is a rounding error: its reciprocal becomes NaN.
    """
    n = step.n
    ports = [port for port in outputs if port in step.ports]
    lines = [
        *_matrix(step, layout),
        f"ROW *const rows = ROWS(w + {layout.places[step.right]});",
        f"const int count = ROW_FOURS({step.width});",
        "ROW sum = ROW_OF(0);",
        "int i, j, k;",
        *_padding_lines(step, layout),
        *([] if step.factored else _elimination_lines(step, n, rounding)),
        *_substitution_lines(step),
        *_solution_lines(step, layout, outputs),
        f"for (i = 0; i < {n}; ++i) {{",
        f"    const ROW *const x = rows + i * ROW_COUNT({step.stride});",
        "    for (k = 0; k < count; k += 4) {",
        "        sum += ZERO * (x[k] + x[k + 1] + (x[k + 2] + x[k + 3]));",
        "    }",
        "}",
        "return ROW_SUM(sum);",
    ]
    return loop_function(name, ports, lines)


def factor_text(name: str, step: Factor, layout: Layout, rounding: str) -> str:
    """The C function of a `Factor`: as `solve_text` does, with the right side as one more column
    of the matrix.
    """
    n = step.n
    stride = step.matrix_stride
    x = f"w[{layout.at(step.solution, 0)} + i]"
    lines = [
        *_matrix(step, layout),
        "T zero = F(splat)(0);",
        "int i, j, k;",
        f"for (i = 0; i < {n}; ++i) {{",
        f"    for (j = {n}; j < ROW_COUNT({n + 1}) * ROW_LANES; j += ROW_LANES) {{",
        f"        *ROWS(matrix + i * {stride} + j) = ROW_OF(0);",
        "    }",
        f"    matrix[i * {stride} + {n}] = w[{layout.at(step.right, 0)} + i];",
        "}",
        *_elimination_lines(step, n + 1, rounding),
        f"for (i = 0; i < {n}; ++i) {{",
        f"    {x} = matrix[i * {stride} + {n}];",
        "}",
        f"for (j = {n - 1}; j >= 0; --j) {{",
        f"    const T known = w[{layout.at(step.solution, 0)} + j];",
        "    zero += ZERO * known;",
        "    for (i = first[j]; i < j; ++i) {",
        f"        {x} -= matrix[i * {stride} + j] * known;",
        "    }",
        "}",
        "return zero;",
    ]
    return loop_function(name, (), lines)


def _matrix(step: Solve | Factor, layout: Layout) -> list[str]:
    """Lines with the matrix, the reciprocals of its pivots, and the profile: first column of a
    row, end of a column.
    """
    ends = [1 + max(i for i in range(j, step.n) if step.profile[i] <= j) for j in range(step.n)]
    return [
        f"static const unsigned char first[{step.n}] = {{{', '.join(map(str, step.profile))}}};",
        f"static const unsigned char last[{step.n}] = {{{', '.join(map(str, ends))}}};",
        f"T *const matrix = w + {layout.places[step.matrix]};",
        f"T *const inverse = w + {layout.places[pivots_of(step.matrix)]};",
    ]


def _padding_lines(step: Solve, layout: Layout) -> list[str]:
    """Lines that fill entries that are not computed: unit columns, and ends of rows that are not
    whole vectors.
    """
    n = step.n
    right = f"w + {layout.places[step.right]} + i * {step.stride}"
    ends = [
        f"    for (j = {n}; j < ROW_COUNT({n}) * ROW_LANES; j += ROW_LANES) {{",
        f"        *ROWS(matrix + i * {step.matrix_stride} + j) = ROW_OF(0);",
        "    }",
    ]
    lines = [
        f"for (i = 0; i < {n}; ++i) {{",
        *([] if step.factored else ends),
        (
            f"    for (j = {step.columns}; j < ROW_FOURS({step.width}) * ROW_LANES; j += "
            "ROW_LANES) {"
        ),
        f"        *ROWS({right} + j) = ROW_OF(0);",
        "    }",
    ]
    if step.unit:
        lines.append(
            f"    w[{layout.places[step.right]} + i * {step.stride + 1} + {step.columns}] = "
            "F(splat)(-1);"
        )
    return [*lines, "}"]


def _elimination_lines(step: Solve | Factor, columns: int, rounding: str) -> list[str]:
    """C lines that factor the matrix in place: L in its upper half, reciprocals of pivots in
    `inverse`.

    ``columns``: of the matrix and the right sides behind it; ``rounding``: C text of the share of
    a diagonal entry below which a pivot is a rounding error.
    """
    n = step.n
    stride = step.matrix_stride
    return [
        f"for (i = 0; i < {n}; ++i) {{",
        f"    inverse[i] = {rounding} * matrix[i * {stride + 1}];",
        "}",
        f"for (j = 0; j < {n}; ++j) {{",
        f"    T *const upper = matrix + j * {stride};",
        "    const T pivot = F(guarded)(F(splat)(1) / upper[j], upper[j], inverse[j]);",
        "    inverse[j] = pivot;",
        f"    for (k = ROW_OF_COLUMN(j + 1); k < ROW_COUNT({columns}); ++k) {{",
        "        const ROW x = ROWS(upper)[k];",
        "        const int end = LESSER(last[j], (k + 1) * ROW_LANES);",
        "        for (i = j + 1; i < end; ++i) {",
        f"            ROWS(matrix + i * {stride})[k] -= pivot * upper[i] * x;",
        "        }",
        "    }",
        f"    for (k = ROW_OF_COLUMN(j); k < ROW_COUNT({columns}); ++k) {{",
        "        ROWS(upper)[k] = pivot * ROWS(upper)[k];",
        "    }",
        "}",
    ]


def _less(step: Solve, each: str, factor: str, others: str, start: str) -> list[str]:
    """C lines that take from row i ``factor`` times row j, for j in the loop ``others``: ``each``
    is the macro that repeats a statement for vectors of the row, ``start`` the statement that
    loads them.
    """
    row = f"rows + {{}} * ROW_COUNT({step.stride}) + k"
    return [
        f"        ROW *const x = {row.format('i')};",
        f"        {each}({start})",
        f"        for ({others}) {{",
        f"            const ROW *const other = {row.format('j')};",
        f"            const T times = {factor};",
        f"            {each}(SUBTRACT_ROW)",
        "        }",
        f"        {each}(STORE_ROW)",
    ]


def _substitution_lines(step: Solve) -> list[str]:
    """Lines that combine the rows of the right side with the factors, block of columns by block of
    columns.

    So the rows that are combined stay in the first cache.
    """
    n = step.n
    stride = step.matrix_stride

    def some(lanes: int, each: str) -> list[str]:
        """Both substitutions for blocks of ``lanes`` vectors while as many are left; ``each``:
        macro that repeats a statement as often.
        """
        return [
            f"for (; k + {lanes} <= count; k += {lanes}) {{",
            f"    for (i = 0; i < {n}; ++i) {{",
            *_less(
                step, each, f"matrix[j * {stride} + i]", "j = first[i]; j < i; ++j", "LOAD_ROW"
            ),
            "    }",
            f"    for (i = {n - 1}; i >= 0; --i) {{",
            "        const T pivot = inverse[i];",
            *_less(
                step,
                each,
                f"matrix[i * {stride} + j]",
                "j = i + 1; j < last[i]; ++j",
                "LOAD_SCALED_ROW",
            ),
            "    }",
            "}",
        ]

    return ["k = 0;", *some(8, "EIGHT"), *some(4, "FOUR")]


def _solution_lines(step: Solve, layout: Layout, outputs: Mapping[str, int]) -> list[str]:
    """Lines that write the solution, and the constants around it."""
    lines: list[str] = []
    for port in step.ports:
        blocks = [block for block in step.blocks if block.port == port]
        covered = sum(block.count for block in blocks) * step.n
        rows = outputs[port] // sum(block.count for block in blocks)
        if covered < outputs[port]:
            lines += [
                f"for (i = 0; i < {outputs[port]}; ++i) {{",
                f"    OUT({port}, i, F(splat)(0));",
                "}",
            ]
        column = 0
        for block in blocks:
            lines += [
                f"for (j = 0; j < {block.count}; ++j) {{",
                f"    for (i = 0; i < {step.n}; ++i) {{",
                f"        OUT({port}, (j + {column}) * {rows} + {block.row} + i, F(splat)(0) - "
                f"w[{layout.places[step.right]} + i * {step.stride} + j + {block.first}]);",
                "    }",
                "}",
            ]
            column += block.count
        lines += [
            f"OUT({port}, {row + column_of * rows}, F(splat)(1));"
            for name, row, column_of in step.ones
            if name == port
        ]
    return lines
