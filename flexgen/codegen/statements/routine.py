"""The steps of a function of the library: expressions, and loops over columns or for linear
systems.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Expressions:
    """Results of an SX function with dense arguments.

    Arguments and results are the ports of that name, or else intermediate arrays of the program.

    Parameters
    ----------
    function : casadi.Function
    pivots : bool
        True: its divisions are those of positive definite systems, and are guarded against
        singular ones.
    added : bool
        True: the results are added to what the intermediate arrays hold, where they are not zero
        by structure.
    """

    function: ca.Function
    pivots: bool = False
    added: bool = False


@dataclass(frozen=True)
class Block:
    """Target of a part of a solution: columns ``first ... first + count - 1`` into the rows from
    ``row`` of a port.
    """

    port: str
    row: int
    first: int
    count: int


@dataclass(frozen=True)
class Zeros:
    """An intermediate array of zeros, (rows, columns)."""

    array: str
    rows: int
    columns: int


@dataclass(frozen=True)
class Factor:
    """Factors ``A``, symmetric and positive definite, in place for a later `Solve`, and solves
    ``A x = b``.

    Parameters
    ----------
    matrix : str
        Intermediate array A (n, n), of which the upper half is read.
    right, solution : str
        Intermediate arrays b and x (1, n).
    n : int
    profile : tuple of int
        First column of each row of A that is not zero by structure.
    """

    matrix: str
    right: str
    solution: str
    n: int
    profile: tuple[int, ...]

    @property
    def matrix_stride(self) -> int:
        """Entries between the rows of A in the workspace: b is one more column."""
        return _stride(self.n + 1)

    @property
    def operations(self) -> int:
        """Arithmetic operations."""
        factor = sum(
            (i - first) * (2 * (self.n + 1 - i) + 1) for i, first in enumerate(self.profile)
        )
        return factor + self.n * (self.n + 1) // 2 + self.n * (self.n - 1)

    @property
    def depth(self) -> int:
        """Latency of the longest chain of operations in cycles, about."""
        return 30 * self.n


@dataclass(frozen=True)
class Solve:
    """``X = -A^-1 R`` with ``A`` symmetric positive definite, written as loops: elimination and
    substitution.

    Parameters
    ----------
    matrix, right : str
        Intermediate arrays ``A`` (n, n), of which the upper half is read, and ``R`` (n, columns).
    n, columns : int
        Sizes of R.
    unit : bool
        True: n more columns follow those of R and end as the inverse ``A^-1``.
    profile : tuple of int
        First column of each row of A that is not zero by structure.
    blocks : tuple of Block
        Targets of the solution. Entries that no block covers are zero, except for ``ones``.
    ones : tuple of (str, int, int)
        Port, row and column of entries that are one.
    factored : bool
        True: a `Factor` of this matrix came before.
    """

    matrix: str
    right: str
    n: int
    columns: int
    unit: bool
    profile: tuple[int, ...]
    blocks: tuple[Block, ...]
    ones: tuple[tuple[str, int, int], ...] = ()
    factored: bool = False

    @property
    def width(self) -> int:
        """Columns of the system, the unit ones included."""
        return self.columns + (self.n if self.unit else 0)

    @property
    def stride(self) -> int:
        """Entries between the rows of R in the workspace."""
        return _stride(self.width)

    @property
    def matrix_stride(self) -> int:
        """Entries between the rows of A in the workspace."""
        return _stride(self.n + 1 if self.factored else self.n)

    @property
    def ports(self) -> tuple[str, ...]:
        """Outputs that it writes."""
        return tuple(dict.fromkeys(block.port for block in self.blocks))

    @property
    def operations(self) -> int:
        """Arithmetic operations."""
        filled = sum(i - first for i, first in enumerate(self.profile))
        factor = sum((i - first) * (2 * (self.n - i) + 1) for i, first in enumerate(self.profile))
        below = self.n * (self.n - 1) // 2
        return (0 if self.factored else factor + below) + (
            2 * filled + 2 * below + self.n
        ) * self.width

    @property
    def depth(self) -> int:
        """Latency of the longest chain of operations in cycles, about: for each pivot a reciprocal
        and two products.
        """
        return 40 * self.n


@dataclass(frozen=True)
class Columns:
    """Expressions evaluated for each of n columns of intermediate arrays: for one point, lanes
    hold columns.

    Parameters
    ----------
    function : casadi.Function
        An SX function of dense columns. Its arguments and results are columns of the intermediate
        arrays of these names, or of the tables; sums, differences and products only. Where all
        arguments are zero the results are zero: rows end in zeros, up to a whole vector.
    n : int
        Number of columns.
    tables : mapping of str to numpy.ndarray
        Numbers, (rows, n).
    """

    function: ca.Function
    n: int
    tables: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        f = self.function
        results = f.call([ca.DM.zeros(f.size_in(i)) for i in range(f.n_in())])
        if any(np.any(result.full() != 0.0) for result in results):
            raise ValueError(f"columns: given {f.name()}, which does not give zeros for zeros")


@dataclass(frozen=True)
class Sums:
    """Columns of an intermediate array added one after the other:
    ``target_j = start + sum_k source_k``.

    Parameters
    ----------
    source, target : str
        Intermediate arrays of as many rows; (rows, len(at)) and (rows, n).
    rows, n : int
    at : tuple of int
        Column of the target, in rising order, at which each column of the source is added.
    backward : bool
        False: the sum is over all k with ``at_k <= j``; True: with ``at_k >= j``.
    start : tuple of float
        One number for each row; empty: zeros.
    """

    source: str
    target: str
    rows: int
    n: int
    at: tuple[int, ...]
    backward: bool = False
    start: tuple[float, ...] = ()


@dataclass(frozen=True)
class Selected:
    """Some columns of an intermediate array: ``target_k = source_at[k]``, for as many rows as
    given.
    """

    source: str
    target: str
    rows: int
    at: tuple[int, ...]


@dataclass(frozen=True)
class Rows:
    """Rows of an intermediate array, from ``first`` on."""

    array: str
    first: int
    count: int


@dataclass(frozen=True)
class Products:
    """A matrix whose two triangles are products, written as loops.

    ``A_ij = sum_k S_ki W_kj`` above the diagonal, ``sum_k G_ki U_kj`` on it and below it.

    Parameters
    ----------
    above, below : tuple of Rows
        (S, W) and (G, U): rows of intermediate arrays with n columns, as many in both of a pair.
    n : int
        Rows and columns of A, at least `LEAST`: a vector that begins in a line before the last one
        ends in A.
    target : str
        A port (n, n); or an intermediate array, by rows. Of a symmetric matrix in an array, only
        the diagonal and what is above it are defined.
    first : int
        Column of the array at which A begins.
    """

    LEAST: ClassVar[int] = 8

    above: tuple[Rows, Rows]
    below: tuple[Rows, Rows]
    n: int
    target: str
    first: int = 0

    def __post_init__(self) -> None:
        if self.n < self.LEAST:
            raise ValueError(f"products: given {self.n} columns, expected at least {self.LEAST}")

    @property
    def symmetric(self) -> bool:
        """Whether the triangles are those of a symmetric matrix."""
        return self.above == self.below[::-1]

    @property
    def operations(self) -> int:
        """Arithmetic operations."""
        above, below = (2 * rows[0].count - 1 for rows in (self.above, self.below))
        outside = self.n * (self.n - 1) // 2
        all_below = self.n * (self.n + 1) // 2
        return below * all_below + (0 if self.symmetric else above * outside)

    @property
    def depth(self) -> int:
        """Latency of the longest chain of operations in cycles, about."""
        return 8 * max(self.above[0].count, self.below[0].count)


def _stride(width: int) -> int:
    """Room for whole groups of four vectors of any width, so that few rows share the same lines of
    the cache.
    """
    return -(-width // 64) * 64 + 16


Step = Expressions | Columns | Sums | Selected | Products | Zeros | Factor | Solve


@dataclass(frozen=True)
class Routine:
    """Steps in order; later ones may use the intermediate arrays of earlier ones."""

    steps: tuple[Step, ...]


def profile(function: ca.Function, result: str) -> tuple[int, ...]:
    """First column of each row of a symmetric result of an SX function that is not zero by
    structure.
    """
    symbols = [ca.SX.sym(f"x{i}", function.sparsity_in(i)) for i in range(function.n_in())]
    pattern = ca.sparsify(function.call(symbols)[function.index_out(result)]).sparsity()
    return tuple(
        next(j for j in range(i + 1) if j == i or pattern.has_nz(i, j))
        for i in range(pattern.size1())
    )
