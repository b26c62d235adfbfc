"""The C text of a linear solve in loops: small code for systems whose unrolled elimination would be long.

For one point the loops run over lanes of columns of the right side, for lanes of points over its columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flexgen.expressions.routine import Solve


@dataclass(frozen=True)
class Layout:
    """Intermediate arrays in the workspace: their starts, the stride of rows of those stored by rows, size."""

    places: Mapping[str, int]
    strides: Mapping[str, int]
    size: int


def solve_text(name: str, step: Solve, layout: Layout, outputs: Mapping[str, int], rounding: str) -> str:
    """The C function of a `Solve`: factor, substitute, and write the solution to its ports.

    L D L' by rows within the profile: ``w_ij = A_ij - sum_k w_ik L_jk``, ``L_ij = w_ij / d_j``, ``d_i = A_ii - sum_k
    w_ik L_ik``. A pivot d_i below ``rounding`` times A_ii is noise: its reciprocal becomes NaN. The rows of R are then
    combined as the factors demand.
    """
    n, width = step.n, step.width
    ports = [port for port in outputs if port in step.ports]
    parameters = ", ".join([*(f"real *RESTRICT {port}" for port in ports), "T *RESTRICT w"])
    lines = [
        f"static const unsigned char first[{n}] = {{{', '.join(map(str, step.profile))}}};",
        f"T *const matrix = w + {layout.places[step.matrix]};",
        f"ROW *const rows = ROWS(w + {layout.places[step.right]});",
        f"const int count = ROW_COUNT({width});",
        f"T inverse[{n}];",
        "ROW sum = ROW_OF(0);",
        "int i, j, k;",
    ]
    lines += _padded(step, layout)
    lines += _factored(n, rounding)
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


def _padded(step: Solve, layout: Layout) -> list[str]:
    """Lines that fill the columns of the right side that are not computed."""
    n, columns = step.n, step.columns
    lines: list[str] = []
    if step.unit or step.width < step.stride:
        lines += [
            f"for (i = 0; i < {n}; ++i) {{",
            f"    for (j = {columns}; j < {step.stride}; ++j) {{",
            f"        w[{layout.places[step.right]} + i * {step.stride} + j] = F(splat)(0);",
            "    }",
        ]
        if step.unit:
            lines.append(f"    w[{layout.places[step.right]} + i * {step.stride + 1} + {columns}] = F(splat)(-1);")
        lines.append("}")
    return lines


def _factored(n: int, rounding: str) -> list[str]:
    """Lines that factor the matrix; reciprocals of the pivots in ``inverse``."""
    return [
        f"for (i = 0; i < {n}; ++i) {{",
        f"    const T whole = matrix[i * {n + 1}];",
        "    T d = whole;",
        "    for (j = first[i]; j < i; ++j) {",
        f"        T x = matrix[i * {n} + j];",
        "        for (k = first[i] > first[j] ? first[i] : first[j]; k < j; ++k) {",
        f"            x -= matrix[i * {n} + k] * matrix[j * {n} + k];",
        "        }",
        f"        matrix[i * {n} + j] = x;",
        "    }",
        "    for (j = first[i]; j < i; ++j) {",
        f"        const T x = matrix[i * {n} + j];",
        f"        matrix[i * {n} + j] = x * inverse[j];",
        f"        d -= x * matrix[i * {n} + j];",
        "    }",
        f"    inverse[i] = F(guarded)(F(splat)(1) / d, d, {rounding} * whole);",
        "}",
    ]


def _substituted(step: Solve) -> list[str]:
    """Lines that combine the rows of the right side as the factors demand."""
    n = step.n
    return [
        f"for (i = 0; i < {n}; ++i) {{",
        f"    ROW *const x = rows + i * ROW_COUNT({step.stride});",
        "    for (j = first[i]; j < i; ++j) {",
        f"        const T factor = matrix[i * {n} + j];",
        f"        const ROW *const y = rows + j * ROW_COUNT({step.stride});",
        "        for (k = 0; k < count; ++k) {",
        "            x[k] -= factor * y[k];",
        "        }",
        "    }",
        "}",
        f"for (i = {n - 1}; i >= 0; --i) {{",
        f"    ROW *const x = rows + i * ROW_COUNT({step.stride});",
        "    const T pivot = inverse[i];",
        "    for (k = 0; k < count; ++k) {",
        "        x[k] *= pivot;",
        "    }",
        f"    for (j = i + 1; j < {n}; ++j) {{",
        "        if (first[j] <= i) {",
        f"            const T factor = matrix[j * {n} + i];",
        f"            const ROW *const y = rows + j * ROW_COUNT({step.stride});",
        "            for (k = 0; k < count; ++k) {",
        "                x[k] -= factor * y[k];",
        "            }",
        "        }",
        "    }",
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
