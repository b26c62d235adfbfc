"""Where the intermediate arrays of a routine lie in the workspace, and the C functions around the
loops over them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from flexgen.codegen.statements.routine import (
    Columns,
    Expressions,
    Factor,
    Products,
    Routine,
    Selected,
    Solve,
    Sums,
)

WHOLE = 16  # entries: the longest vector of any precision
LONGEST = {"double": 8, "single": 16}  # entries of the longest vector


@dataclass(frozen=True)
class Layout:
    """Intermediate arrays in the workspace: their starts, the stride of rows of those stored by
    rows, size.

    ``filled``: rows and columns of arrays for columns as lanes, where the ends of rows are to be
    filled with zeros.
    """

    places: Mapping[str, int]
    strides: Mapping[str, int]
    size: int
    filled: Mapping[str, tuple[int, int]]
    precision: str

    def at(self, array: str, row: int) -> int:
        """Where a row begins."""
        return self.places[array] + row * self.strides[array]


def column_stride(n: int, precision: str) -> int:
    """Entries between the rows of an array of n columns: an odd number of whole vectors.

    With a power of two, rows would meet in the same places of the cache.
    """
    whole = LONGEST[precision]
    vectors = -(-n // whole)
    return (vectors + 1 - vectors % 2) * whole


def pivots_of(matrix: str) -> str:
    """The intermediate array with the reciprocals of the pivots of a matrix."""
    return f"pivots of {matrix}"


def layout_of(program: Routine, outputs: Collection[str], precision: str) -> Layout:
    """Places in the workspace of every array that a step computes for a later one; ``outputs``:
    ports, which have memory of their own. Each array begins at a whole vector.
    """
    strides: dict[str, int] = {}
    by_columns: set[str] = set()
    shapes: dict[str, tuple[int, int]] = {}
    vectors: set[str] = set()  # written by whole vectors
    for step in program.steps:
        match step:
            case Solve():
                strides |= {step.matrix: step.matrix_stride, step.right: step.stride}
                shapes |= {step.matrix: (step.n, step.n), step.right: (step.n, step.width)}
                shapes[pivots_of(step.matrix)] = (1, step.n)
            case Factor():
                by_columns |= {step.right, step.solution}
                shapes[step.solution] = (1, step.n)
            case Sums():
                by_columns |= {step.source, step.target}
                shapes[step.target] = (step.rows, step.n)
            case Selected():
                by_columns |= {step.source, step.target}
                shapes[step.target] = (step.rows, len(step.at))
            case Columns():
                names = step.function.name_in()
                results = step.function.name_out()
                by_columns |= {*names, *results} - set(step.tables)
                shapes |= {
                    name: (step.function.numel_out(i), step.n) for i, name in enumerate(results)
                }
                vectors |= {*results}
            case Products():
                by_columns |= {rows.array for rows in (*step.above, *step.below)}
            case Expressions():
                for i, name in enumerate(step.function.name_out()):
                    if name not in outputs:
                        shapes.setdefault(name, step.function.size_out(i))
    strides |= {name: column_stride(shapes[name][1], precision) for name in by_columns}
    places: dict[str, int] = {}
    at = 0
    for name, (rows, columns) in shapes.items():
        places[name] = at
        # all begin with a whole vector
        at += -(-rows * strides.get(name, columns) // WHOLE) * WHOLE
    filled = {
        name: shapes[name]
        for name in shapes
        if name in by_columns - vectors and shapes[name][1] % WHOLE
    }
    return Layout(places, strides, at, filled, precision)


def loop_function(name: str, ports: Iterable[str], lines: Iterable[str], result: str = "T") -> str:
    """A C function around ``lines``, of a step that is a loop: it takes the outputs ``ports`` and
    the workspace; ``result``: its return type.
    """
    given = [f"real *RESTRICT {port}" for port in ports]
    stride = " STRIDE(ptrdiff_t n)" if given else ""
    body = "".join(f"    {line}\n" for line in lines)
    return (
        f"SEPARATE static {result} F({name})({', '.join([*given, 'T *RESTRICT w'])}{stride})\n"
        "{\n"
        f"{body}}}\n"
    )
