"""A nonlinear program from blocks: small functions that repeat at many instants, with exact
derivatives.

Each block is a scalar function in few unknowns z. Its Jacobian and Hessian are formed once,
evaluated at all instants and put in their places in the large sparse matrices; CasADi colors
nothing. The small functions can be compiled C.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import scipy.sparse as sp

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.nlp import NonlinearProgram
from flexgen.codegen.build.casadi_module import in_c

SMALLEST = 1e-300
# of the gradient of the cost where the search starts: below it the cost is not scaled
SMALL = 1e-12


@dataclass
class Block:
    """Rows and a cost in the unknowns ``z`` and the numbers ``p``, at ``count`` instants.

    ``where`` (count, n_z): places of z in x; ``values`` (n_p, count); ``rows`` (m,) between
    ``lower`` and ``upper`` (m, count); ``names`` (m,): of the rows; ``cost``: a scalar;
    ``squares``: its squares are added to the cost, with a Gauss-Newton Hessian.
    """

    z: ca.SX
    p: ca.SX
    where: np.ndarray
    values: np.ndarray
    rows: ca.SX
    lower: np.ndarray
    upper: np.ndarray
    names: list[str]
    cost: ca.SX
    squares: ca.SX
    times: np.ndarray
    curvature: bool = True
    scale: np.ndarray = field(default_factory=lambda: np.ones(0))

    @property
    def count(self) -> int:
        """Number of instants."""
        return len(self.where)


@dataclass(frozen=True, kw_only=True)
class Program(NonlinearProgram):
    """A nonlinear program in the scaled unknowns x, with exact derivatives and names.

    ``names``: of the rows of g, with the instants ``times`` (m, 2) and the factors ``scale`` that
    the rows were multiplied with; each instant: number of the phase, relative time.
    ``cost_scale``: factor of the cost.
    """

    gradient: ca.MX
    jacobian: ca.MX
    lower: np.ndarray
    upper: np.ndarray
    cost_scale: float
    names: list[str]
    times: np.ndarray
    scale: np.ndarray


class _Local:
    """The functions of a block, evaluated at all its instants."""

    def __init__(self, block: Block, index: int, compile_from: float) -> None:
        """Functions of one instant of a block: values, slopes, gradient and curvature, each with
        its sparsity; compiled where a block has ``compile_from`` operations or more.

        Of ``squares`` the curvature is that of Gauss and Newton. ``index``: number of the block,
        in names.
        """
        z = block.z
        p = block.p
        m = block.rows.numel()
        total = block.cost + ca.sumsqr(block.squares)
        slope = ca.jacobian(block.rows, z)
        self.row, self.col = (np.array(i, int) for i in slope.sparsity().get_triplet())
        lam = ca.SX.sym("lam", m)
        sigma = ca.SX.sym("sigma")
        lagrangian = sigma * block.cost + (ca.dot(lam, block.rows) if block.curvature else 0)
        curve = ca.hessian(lagrangian, z)[0]
        if block.squares.numel():
            J = ca.jacobian(block.squares, z)
            curve = curve + 2 * sigma * ca.mtimes(J.T, J)
        curve = ca.triu(ca.sparsify(curve))
        self.row_h, self.col_h = (np.array(i, int) for i in curve.sparsity().get_triplet())
        self.count = block.count
        entries = ca.vertcat(*slope.nonzeros()) if len(self.row) else ca.SX(0, 1)
        curves = ca.vertcat(*curve.nonzeros()) if len(self.row_h) else ca.SX(0, 1)
        outputs = {
            "values": ([z, p], [block.rows, total]),
            "slopes": ([z, p], [block.rows, entries]),
            "gradient": ([z, p], [total, ca.densify(ca.gradient(total, z))]),
            "curves": ([z, p, lam, sigma], [curves]),
        }
        self.plain = {
            name: ca.Function(
                f"plan{index}_{name}", inputs, [ca.densify(x) for x in out], {"cse": True}
            )
            for name, (inputs, out) in outputs.items()
        }
        self.functions = {
            name: _compile_large(function, self.count, compile_from)
            for name, function in self.plain.items()
        }

    def __call__(self, name: str, *arguments: ca.MX) -> list[ca.MX]:
        function = self.functions[name]
        found = (function if self.count == 1 else function.map(self.count))(*arguments)
        return list(found) if isinstance(found, tuple) else [found]


def _compile_large(function: ca.Function, count: int, compile_from: float) -> ca.Function:
    """The function in compiled C where that saves time, see `flexgen.planning.optimal.problem`."""
    if function.n_instructions() * count < compile_from:
        return function
    return in_c(function)


def program(
    size: int,
    blocks: list[Block],
    linear: tuple[sp.spmatrix, list[str], np.ndarray],
    scale_x: np.ndarray,
    guess: np.ndarray,
    general: Callable[[ca.MX], tuple[ca.MX, ca.MX]] | None = None,
    general_bounds: tuple[np.ndarray, np.ndarray, list[str]] | None = None,
    compile_from: float = np.inf,
) -> Program:
    """Put blocks together.

    Parameters
    ----------
    size : int
        Number of unknowns.
    blocks : list of Block
    linear : (sparse matrix (m, size), names, scale)
        Rows that are zero.
    scale_x, guess : arrays (size,)
        The true unknowns are ``scale_x x``; ``guess``: a true point at which the rows are scaled.
    general : callable, optional
        Cost and constraints in the true unknowns outside of blocks, differentiated by CasADi.
    general_bounds : (lower, upper, names), optional
    compile_from : float
        Operations times instants from which on a function is compiled.
    """
    x = ca.MX.sym("x", size)
    true = x * ca.DM(scale_x)
    local = [_Local(block, k, compile_from) for k, block in enumerate(blocks)]
    for block, one in zip(blocks, local, strict=True):
        block.scale = _row_scale(block, one, scale_x, guess)
    at = [ca.reshape(true[b.where.ravel().tolist()], b.where.shape[1], b.count) for b in blocks]
    parts = list(zip(blocks, local, at, [ca.DM(b.values) for b in blocks], strict=True))
    rows = []
    costs = [ca.MX(0)]
    gradients = []
    entries = []
    for block, one, z, p in parts:
        found = one("values", z, p)
        rows.append(ca.vec(found[0]) * ca.DM(np.tile(block.scale, block.count)))
        costs.append(ca.sum2(found[1]))
        slope = one("slopes", z, p)[1]
        factors = block.scale[one.row][None] * scale_x[block.where[:, one.col]]
        entries.append(ca.vec(slope) * ca.DM(factors.ravel()))
        gradients.append(
            _scatter(
                block.where.ravel(), scale_x[block.where.ravel()], size, one("gradient", z, p)[1]
            )
        )
    matrix, names_c, scale_c = linear
    fixed = (sp.diags(scale_c) @ sp.csc_matrix(matrix) @ sp.diags(scale_x)).tocoo()
    entries.append(ca.MX(ca.DM(fixed.data)))
    g = ca.densify(ca.vertcat(*rows, ca.mtimes(ca.DM(sp.csc_matrix(fixed)), x)))
    jacobian = _jacobian(blocks, local, entries, fixed, size)
    extra_cost, extra_g = general(true) if general is not None else (ca.MX(0), ca.MX(0, 1))
    low, high, names_g = general_bounds or (np.zeros(0), np.zeros(0), [])
    cost = sum(costs[1:], costs[0]) + extra_cost
    gradient = ca.densify(sum(gradients[1:], gradients[0]))  # IPOPT reads it as dense
    if general is not None:
        gradient = gradient + ca.gradient(extra_cost, x)
        jacobian = ca.vertcat(jacobian, ca.jacobian(extra_g, x))
        g = ca.vertcat(g, extra_g)

    steepest = float(
        np.abs(np.array(ca.Function("first", [x], [gradient])(guess / scale_x))).max()
    )
    scale_f = 1 / steepest if SMALL < steepest < np.inf else 1.0

    def hessian(lam_f: ca.MX, lam_g: ca.MX) -> ca.MX:
        return _hessian(x, parts, scale_x, scale_f * lam_f, lam_g, (extra_cost, extra_g))

    return Program(
        x=x,
        cost=scale_f * cost,
        gradient=scale_f * gradient,
        cost_scale=scale_f,
        g=g,
        jacobian=jacobian,
        hessian=hessian,
        lower=np.concatenate(
            [
                *((b.lower * b.scale[:, None]).T.ravel() for b in blocks),
                np.zeros(len(names_c)),
                low,
            ]
        ),
        upper=np.concatenate(
            [
                *((b.upper * b.scale[:, None]).T.ravel() for b in blocks),
                np.zeros(len(names_c)),
                high,
            ]
        ),
        names=[*(n for b in blocks for _ in range(b.count) for n in b.names), *names_c, *names_g],
        times=np.vstack(
            [
                *(np.repeat(b.times, len(b.names), axis=0) for b in blocks),
                np.full((len(names_c) + len(names_g), 2), np.nan),
            ]
        ),
        scale=np.concatenate(
            [*(np.tile(b.scale, b.count) for b in blocks), scale_c, np.ones(len(names_g))]
        ),
    )


def check_finite(made: Program, x: np.ndarray) -> None:
    """ArgumentError where the cost, its gradient or a constraint is not finite at x."""
    cost, gradient, g = (
        np.array(value).ravel()
        for value in ca.Function("first", [made.x], [made.cost, made.gradient, made.g])(x)
    )
    wrong = [made.names[k] for k in np.flatnonzero(~np.isfinite(g))[:1]]
    if not (np.isfinite(cost).all() and np.isfinite(gradient).all()):
        wrong = ["cost"]
    if wrong:
        raise ArgumentError(
            f"plan: {wrong[0]!r} is NaN or infinite where the search starts, expected a finite "
            "number; check its expression, or give another guess"
        )


def _row_scale(block: Block, local: _Local, scale_x: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Factors (m,) of the rows, from their slopes at five instants of the ``guess``: a change of
    the unknowns by their scales changes a row by one or less.
    """
    size = np.full(block.rows.numel(), SMALLEST)
    for k in np.unique(np.linspace(0, block.count - 1, 5).astype(int)):
        entries = np.array(
            local.plain["slopes"](guess[block.where[k]], block.values[:, k])[1]
        ).ravel()
        sizes = np.abs(entries * scale_x[block.where[k, local.col]])
        np.maximum.at(size, local.row, np.where(np.isfinite(sizes), sizes, 0.0))
    return np.where(size > SMALLEST, 1 / size, 1.0)


def _scatter(places: np.ndarray, factors: np.ndarray, size: int, values: ca.MX) -> ca.MX:
    """The sum of ``factors * values`` in their places of a vector (size,)."""
    matrix = sp.csc_matrix((factors, (places, np.arange(len(places)))), shape=(size, len(places)))
    return ca.mtimes(ca.DM(matrix), ca.vec(values))


def _jacobian(
    blocks: list[Block], local: list[_Local], entries: list[ca.MX], fixed: sp.coo_matrix, size: int
) -> ca.MX:
    """The Jacobian (rows, size) from the nonzero ``entries`` of each block, and the ``fixed`` rows
    behind them.
    """
    rows = []
    cols = []
    first = 0
    for block, one in zip(blocks, local, strict=True):
        m = block.rows.numel()
        rows.append((first + np.arange(block.count)[:, None] * m + one.row).ravel())
        cols.append(block.where[:, one.col].ravel())
        first += m * block.count
    row = np.concatenate([*rows, first + fixed.row])
    col = np.concatenate([*cols, fixed.col])
    order = np.lexsort((row, col))  # column by column, as CasADi stores it
    pattern = ca.Sparsity.triplet(first + fixed.shape[0], size, row.tolist(), col.tolist())
    return ca.MX(pattern, ca.vertcat(*entries)[order.tolist()])


def _hessian(
    x: ca.MX,
    parts: list[tuple[Block, _Local, ca.MX, ca.DM]],
    scale_x: np.ndarray,
    lam_f: ca.MX,
    lam_g: ca.MX,
    extra: tuple[ca.MX, ca.MX],
) -> ca.MX:
    """Upper triangle of the Hessian of the Lagrangian in the scaled unknowns.

    ``parts``: of each block its functions, unknowns z and numbers p; ``lam_f``, ``lam_g``:
    multipliers of cost and rows; ``extra``: cost and rows outside of blocks.
    """
    size = x.numel()
    first = 0
    entries = []
    rows = []
    cols = []
    factors = []
    for block, one, z, p in parts:
        m = block.rows.numel()
        count = block.count
        lam = ca.reshape(
            lam_g[first : first + m * count] * ca.DM(np.tile(block.scale, count)), m, count
        )
        first += m * count
        if not len(one.row_h):
            continue
        entries.append(ca.vec(one("curves", z, p, lam, ca.repmat(lam_f, 1, count))[0]))
        i = block.where[:, one.row_h].ravel()
        j = block.where[:, one.col_h].ravel()
        rows.append(np.minimum(i, j))
        cols.append(np.maximum(i, j))
        factors.append(scale_x[i] * scale_x[j])
    total = ca.MX(size, size)
    if entries:
        row, col, factor = (np.concatenate(part) for part in (rows, cols, factors))
        flat, place = np.unique(col.astype(np.int64) * size + row, return_inverse=True)
        pattern = ca.Sparsity.triplet(size, size, (flat % size).tolist(), (flat // size).tolist())
        total = ca.MX(pattern, _scatter(place, factor, len(flat), ca.vertcat(*entries)))
    if extra[1].numel() or not extra[0].is_constant():
        rest = lam_f * extra[0] + ca.dot(lam_g[lam_g.numel() - extra[1].numel() :], extra[1])
        total = total + ca.triu(ca.hessian(rest, x)[0])
    return total
