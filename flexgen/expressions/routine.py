"""What a function of the library computes, step by step: expressions, and linear solves that stay loops in C."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca


@dataclass(frozen=True)
class Expressions:
    """Results of an SX function with dense arguments.

    Arguments and results are the ports of that name, or else intermediate arrays of the program.

    Parameters
    ----------
    function : casadi.Function
    pivots : bool
        True: its divisions are those of positive definite systems, and are guarded against singular ones.
    """

    function: ca.Function
    pivots: bool = False


@dataclass(frozen=True)
class Block:
    """Where a part of a solution goes: columns ``first ... first + count - 1`` into the rows from ``row`` of a port."""

    port: str
    row: int
    first: int
    count: int


@dataclass(frozen=True)
class Solve:
    """``X = -A^-1 R`` with ``A`` symmetric positive definite, written as loops: elimination and substitution.

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
        Where the solution goes. What no block covers is zero, but for ``ones``.
    ones : tuple of (str, int, int)
        Port, row and column of entries that are one.
    """

    matrix: str
    right: str
    n: int
    columns: int
    unit: bool
    profile: tuple[int, ...]
    blocks: tuple[Block, ...]
    ones: tuple[tuple[str, int, int], ...] = ()

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
        """The same between the rows of A."""
        return _stride(self.n)

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
        return factor + below + (2 * filled + 2 * below + self.n) * self.width

    @property
    def depth(self) -> int:
        """Latency of the longest chain of operations in cycles, about: a pivot and two products after the other."""
        return 40 * self.n


@dataclass(frozen=True)
class Products:
    """A symmetric matrix ``M_ij = sum_k S_ki F_kj`` for i <= j, written as loops.

    Parameters
    ----------
    left, right : str
        Intermediate arrays S and F, (rows, n).
    rows, n : int
        Their sizes, n at least `LEAST`: a vector that begins in a row before the last one ends in M.
    port : str
        The output M, (n, n).
    """

    LEAST: ClassVar[int] = 8

    left: str
    right: str
    rows: int
    n: int
    port: str

    def __post_init__(self) -> None:
        if self.n < self.LEAST:
            raise ValueError(f"products: given {self.n} columns, expected at least {self.LEAST}")

    @property
    def stride(self) -> int:
        """Entries between the rows of S, F and M in the workspace."""
        return _stride(self.n)

    @property
    def ports(self) -> tuple[str, ...]:
        """Outputs that it writes."""
        return (self.port,)

    @property
    def operations(self) -> int:
        """Arithmetic operations."""
        return (2 * self.rows - 1) * self.n * (self.n + 1) // 2

    @property
    def depth(self) -> int:
        """Latency of the longest chain of operations in cycles, about."""
        return 8 * self.rows


def _stride(width: int) -> int:
    """Room for whole groups of four vectors of any width, so that few rows share the same lines of the cache."""
    return -(-width // 64) * 64 + 16


@dataclass(frozen=True)
class Routine:
    """Steps in order; later ones may use the intermediate arrays of earlier ones."""

    steps: tuple[Expressions | Solve | Products, ...]


def profile(function: ca.Function, result: str) -> tuple[int, ...]:
    """First column of each row of a symmetric result of an SX function that is not zero by structure."""
    symbols = [ca.SX.sym(f"x{i}", function.sparsity_in(i)) for i in range(function.n_in())]
    pattern = ca.sparsify(function.call(symbols)[function.index_out(result)]).sparsity()
    return tuple(next(j for j in range(i + 1) if j == i or pattern.has_nz(i, j)) for i in range(pattern.size1()))
