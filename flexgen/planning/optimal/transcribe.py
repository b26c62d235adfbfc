"""From phases to the blocks of a nonlinear program.

Unknowns: for each phase those of `flexgen.base.numerics.transcription` in relative time sigma =
(t - t_0) / T, with the motor torques at the collocation points; then the durations T of the phases
and the further unknown numbers. With

    v = dy/dsigma / T,     a = d2y/dsigma2 / T^2

all that connects the nodes is linear, also where T is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from flexgen.base.numerics.tableaus import Tableau
from flexgen.base.numerics.transcription import motion_at
from flexgen.planning.optimal.blocks import Block
from flexgen.planning.optimal.phase import Band, Phase
from flexgen.planning.optimal.signals import residual_of


@dataclass(frozen=True)
class Layout:
    """Indices of the unknowns of all phases: ``first`` of each phase, then ``theta`` (durations,
    parameters).
    """

    phases: tuple[Phase, ...]
    parameters: tuple[ca.SX, ...]

    @property
    def first(self) -> list[int]:
        """Number of the first unknown of each phase."""
        return (
            np.concatenate([[0], np.cumsum([phase.mesh.size for phase in self.phases])])
            .astype(int)
            .tolist()
        )

    @property
    def theta(self) -> np.ndarray:
        """Places of durations and parameters."""
        return self.first[-1] + np.arange(len(self.phases) + len(self.parameters))

    @property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.first[-1] + len(self.phases) + len(self.parameters)

    def node(self, number: int, k: int) -> np.ndarray:
        """Places of (y, dy) at node ``k`` of a phase."""
        phase = self.phases[number]
        n = phase.mesh.n
        return self.first[number] + (k % (phase.mesh.N + 1)) * 2 * n + np.arange(2 * n)


class _Instants:
    """Instants of one phase: unknowns z, numbers p, and the signals as expressions of them."""

    def __init__(self, layout: Layout, phase: Phase, *, own: bool) -> None:
        """Motion at an instant of an interval from unknowns z (states at its begin, accelerations
        and torques at its stages, durations) and numbers p (weights of the place, length, time).

        ``own``: the torque is that of the instant's own stage, else the polynomial through all.
        """
        mesh = phase.mesh
        signals = phase.signals
        n = mesh.n
        s = mesh.s
        n_m = phase.equations.model.n_m
        self.layout = layout
        self.phase = phase
        self.own = own
        n_tau = n_m if own else s * n_m
        n_theta = len(layout.theta)
        self.z = ca.SX.sym("z", (2 + s) * n + n_tau + n_theta)
        self.p = ca.SX.sym("p", 4 + 3 * s + signals.reference.numel())
        row = self.p[: 1 + 3 * s]
        h = self.p[1 + 3 * s]
        sigma = self.p[2 + 3 * s]
        self.weight = self.p[3 + 3 * s]
        z = self.z
        theta = self.z[(2 + s) * n + n_tau :]
        y, dy, ddy = motion_at(z, row, h, n, s)
        tau = z[(2 + s) * n : (2 + s) * n + n_m]
        if not own:
            tau = sum(
                (row[1 + 2 * s + j] * z[(2 + s) * n + j * n_m :][:n_m] for j in range(s)),
                ca.SX.zeros(n_m),
            )
        T = theta[phase.number]
        start = ca.sum1(theta[: phase.number]) if phase.number else ca.SX(0)
        self.T = T
        self.h = h
        made = [y, dy / T, ddy / T**2, tau, start + T * sigma, self.p[4 + 3 * s :]]
        self.symbols = [
            *signals.symbols,
            *(other.duration for other in layout.phases),
            *layout.parameters,
        ]
        self.made = [*made, *ca.vertsplit(theta)]

    def of(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """Expressions of the signals as expressions of z and p."""
        function = ca.Function("at", self.symbols, list(expressions), {"allow_free": False})
        found = function(*self.made)
        return list(found) if isinstance(found, tuple) else [found]

    def places(self, interval: np.ndarray, stage: np.ndarray | None) -> np.ndarray:
        """Places of z in x (count, n_z) for instants in these intervals; ``stage``: whose torque
        counts, None: all.
        """
        mesh = self.phase.mesh
        n_m = self.phase.equations.model.n_m
        first = self.layout.first[self.phase.number]
        n = mesh.n
        s = mesh.s
        inner = (first + mesh.n_nodes + mesh.n_inner * interval)[:, None]
        torque = inner + s * n + (n_m * stage[:, None] if stage is not None else 0)
        width = n_m if self.own else s * n_m
        return np.hstack(
            [
                (first + 2 * n * interval)[:, None] + np.arange(2 * n),
                inner + np.arange(s * n),
                torque + np.arange(width),
                np.tile(self.layout.theta, (len(interval), 1)),
            ]
        )

    def numbers(
        self, interval: np.ndarray, theta: np.ndarray, weight: np.ndarray, reference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values of p (n_p, count) at the relative places ``theta`` of intervals; and (phase,
        relative time) of the instants (count, 2), for messages.

        ``weight`` (count,): of the integral, ``reference`` (count, n_t): targets.
        """
        mesh = self.phase.mesh
        known, place = np.unique(theta, return_inverse=True)
        once, twice = mesh.table.weights(known)
        lagrange = mesh.table.lagrange(known)
        h = mesh.h[interval]
        sigma = mesh.nodes[interval] + theta * h
        columns = [
            theta[:, None],
            once[place],
            twice[place],
            lagrange[place],
            h[:, None],
            sigma[:, None],
        ]
        columns += [weight[:, None], reference]
        return np.hstack(columns).T, np.column_stack(
            [np.full(len(sigma), float(self.phase.number)), sigma]
        )


def blocks_of(layout: Layout, phase: Phase, reference: Any, curvature: bool) -> list[Block]:
    """The blocks of a phase: motion, constraints along it and at its ends, bounds of polynomials.

    ``reference``: a function of relative times that gives targets (k, n_t); ``curvature``: of the
    constraints goes into the Hessian.
    """
    out = [_motion(layout, phase, reference, curvature)]
    for nodes in (False, True):
        out += _path(layout, phase, reference, curvature, nodes=nodes)
    for where in ("start", "end"):
        if phase.content.rows[where] or phase.content.costs[where]:
            out.append(_end(layout, phase, where, reference, curvature))
    linear = [band for band in phase.content.bands.values() if _kind(phase, band) is not None]
    out += [block for block in (_polynomials(layout, phase, linear),) if block is not None]
    return out


def _kind(phase: Phase, band: Band) -> str | None:
    """``"y"``, ``"dy"``, ``"tau"`` where the signal is linear in those alone, so that it is a
    polynomial.
    """
    signals = phase.signals
    parts = {"y": signals.y, "dy": signals.dy, "tau": signals.tau}
    used = [name for name, part in parts.items() if ca.depends_on(band.value, part)]
    others = ca.depends_on(band.value, ca.veccat(signals.ddy, signals.time, signals.reference))
    if len(used) != 1 or others:
        return None
    symbol = parts[used[0]]
    return None if ca.depends_on(ca.jacobian(band.value, symbol), symbol) else used[0]


def _path_rows(
    phase: Phase, *, states_only: bool
) -> tuple[list[ca.SX], np.ndarray, np.ndarray, list[str]]:
    """Rows of constraints and of bounds that are not polynomials; ``states_only``: inequalities in
    states alone.
    """
    rows = [(row.name, row.value, row.lower, row.upper) for row in phase.content.rows["path"]]
    bands = [band for band in phase.content.bands.values() if _kind(phase, band) is None]
    rows += [(f"bound of {band.name}", band.value, band.lower, band.upper) for band in bands]
    inner = ca.veccat(phase.signals.ddy, phase.signals.tau)
    values = []
    lower = [np.zeros(0)]
    upper = [np.zeros(0)]
    names = []
    for name, value, low, high in rows:
        if states_only and ca.depends_on(value, inner):
            continue
        keep = [i for i in range(value.numel()) if not (states_only and low[i] == high[i])]
        keep = [i for i in keep if np.isfinite(low[i]) or np.isfinite(high[i])]
        if keep:
            values.append(value[keep])
            lower.append(low[keep])
            upper.append(high[keep])
            names += [name] * len(keep)
    return values, np.concatenate(lower), np.concatenate(upper), names


def _motion(layout: Layout, phase: Phase, reference: Any, curvature: bool) -> Block:
    """Equations of motion and the integral of the cost at the collocation points."""
    instants = _Instants(layout, phase, own=True)
    mesh = phase.mesh
    signals = phase.signals
    model = phase.equations.model
    n = phase.equations.model.dof
    force = (
        [] if phase.push is None else [phase.push.of(signals.y[n] if signals.with_path else None)]
    )
    motion = residual_of(
        phase.equations, signals.y[:n], signals.dy[:n], signals.ddy[:n], signals.tau, *force
    )
    rate = ca.sum1(ca.vertcat(0, *phase.content.costs["path"]))
    rows, rate, squares = instants.of(
        [motion, rate, ca.vertcat(ca.SX(0, 1), *phase.content.squares)]
    )
    interval, stage = np.divmod(np.arange(mesh.N * mesh.s), mesh.s)
    weight = mesh.h[interval] * mesh.table.b[stage]
    p, times = instants.numbers(interval, mesh.table.c[stage], weight, reference(mesh.times))
    share = instants.weight * instants.T
    zero = np.zeros((n, len(interval)))
    moving = [c.name for c in model.coordinates] + [model.motors[j].name for j in model.i_m]
    return Block(
        instants.z,
        instants.p,
        instants.places(interval, stage),
        p,
        rows,
        zero,
        zero,
        [f"equation of motion of {name}" for name in moving],
        share * rate,
        ca.sqrt(share) * squares,
        times,
        curvature,
    )


def _path(
    layout: Layout, phase: Phase, reference: Any, curvature: bool, *, nodes: bool
) -> list[Block]:
    """Constraints at the collocation points, or (``nodes``) inequalities of the states at the
    other nodes; arguments as for `blocks_of`. Points that are known from a neighbor are left out.
    """
    values, low, high, names = _path_rows(phase, states_only=nodes)
    mesh = phase.mesh
    c = phase.mesh.table.c
    if nodes:
        interval = np.r_[np.arange(mesh.N), mesh.N - 1]
        stage = np.zeros(mesh.N + 1, int)
        place = np.r_[np.zeros(mesh.N), 1.0]
        known = (
            [False if k else c[0] == 0.0 for k in range(mesh.N + 1)]
            if c[-1] < 1.0
            else [True] * (mesh.N + 1)
        )
        known[0] = bool(c[0] == 0.0)
    else:
        interval, stage = np.divmod(np.arange(mesh.N * mesh.s), mesh.s)
        place = c[stage]
        # the end of an interval is the start of the next one
        known = list((place == 0.0) & (interval > 0) & phase.torque_continuous)
    kept = ~np.array(known)
    interval = interval[kept]
    stage = stage[kept]
    place = place[kept]
    if not values or not len(interval):
        return []
    instants = _Instants(layout, phase, own=True)
    count = len(interval)
    sigma = mesh.nodes[interval] + place * mesh.h[interval]
    p, times = instants.numbers(interval, place, np.zeros(count), reference(sigma))
    rows = instants.of([ca.vertcat(*values)])[0]
    lower, upper = (np.tile(x[:, None], count) for x in (low, high))
    where = instants.places(interval, stage)
    none = ca.SX(0), ca.SX(0, 1)
    return [
        Block(
            instants.z,
            instants.p,
            where,
            p,
            rows,
            lower,
            upper,
            names,
            none[0],
            none[1],
            times,
            curvature,
        )
    ]


def _end(layout: Layout, phase: Phase, where: str, reference: Any, curvature: bool) -> Block:
    """Constraints and costs at the ``"start"`` or the ``"end"`` of a phase; arguments as for
    `blocks_of`.
    """
    instants = _Instants(layout, phase, own=False)
    mesh = phase.mesh
    interval, theta = (
        (np.zeros(1, int), np.zeros(1))
        if where == "start"
        else (np.array([mesh.N - 1]), np.ones(1))
    )
    p, sigma = instants.numbers(interval, theta, np.zeros(1), reference(theta))
    stated = phase.content.rows[where]
    cost = ca.sum1(ca.vertcat(0, *phase.content.costs[where]))
    rows, cost = instants.of([ca.vertcat(ca.SX(0, 1), *[row.value for row in stated]), cost])
    low, high = (
        np.concatenate([np.zeros(0), *[getattr(row, x) for row in stated]])
        for x in ("lower", "upper")
    )
    names = [f"{row.name} at the {where}" for row in stated for _ in range(row.value.numel())]
    return Block(
        instants.z,
        instants.p,
        instants.places(interval, None),
        p,
        rows,
        low[:, None],
        high[:, None],
        names,
        cost,
        ca.SX(0, 1),
        sigma,
        curvature,
    )


def bernstein(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Equidistant places (degree + 1,), and the matrix from values there to Bernstein
    coefficients.
    """
    theta = np.linspace(0.0, 1.0, degree + 1)
    basis = [
        [comb(degree, i) * x**i * (1 - x) ** (degree - i) for i in range(degree + 1)]
        for x in theta
    ]
    return theta, np.linalg.inv(np.array(basis))


def _polynomials(layout: Layout, phase: Phase, bands: list[Band]) -> Block | None:
    """Bounds of Bernstein coefficients: of coordinates, speeds and torques, which are polynomials
    on each interval.
    """
    mesh = phase.mesh
    table = phase.mesh.table
    instants = _Instants(layout, phase, own=False)
    rows = []
    lower = []
    upper = []
    names = []
    h = ca.SX.sym("h")
    for band in bands:
        kind = _kind(phase, band)
        degree = {"tau": mesh.s - 1, "dy": mesh.s, "y": mesh.s + 1}[kind or "y"]
        theta, matrix = bernstein(degree)
        values = ca.horzcat(*[_value_at(instants, table, band, float(x)) for x in theta])
        coefficients = ca.mtimes(values, ca.DM(matrix).T)[:, 0 if kind == "tau" else 1 :]
        finite = [
            i
            for i in range(band.value.numel())
            if np.isfinite(band.lower[i]) or np.isfinite(band.upper[i])
        ]
        for column in range(coefficients.shape[1]):
            rows += [coefficients[i, column] for i in finite]
            lower += [band.lower[i] for i in finite]
            upper += [band.upper[i] for i in finite]
            names += [f"bound of {band.name}"] * len(finite)
    if not rows:
        return None
    interval = np.arange(mesh.N)
    value = ca.substitute(ca.vertcat(*rows), h, instants.h)
    p, sigma = instants.numbers(interval, np.full(mesh.N, 0.5), np.zeros(mesh.N),
                                np.zeros((mesh.N, phase.signals.reference.numel())))  # fmt: skip
    low, high = (np.tile(np.array(x)[:, None], mesh.N) for x in (lower, upper))
    return Block(
        instants.z,
        instants.p,
        instants.places(interval, None),
        p,
        value,
        low,
        high,
        names,
        ca.SX(0),
        ca.SX(0, 1),
        sigma,
    )


def _value_at(instants: _Instants, table: Tableau, band: Band, theta: float) -> ca.SX:
    """A signal at a relative place of the interval."""
    once, twice = table.weights(np.array([theta]))
    row = np.concatenate([[theta], once[0], twice[0], table.lagrange(np.array([theta]))[0]])
    value = instants.of([band.value])[0]
    return ca.substitute(value, instants.p[: len(row)], ca.SX(ca.DM(row)))


def links(layout: Layout, periodic: bool) -> tuple[list[Block], sp.csc_matrix, list[str]]:
    """Connections: nodes of each phase, its torques, and from phase to phase. Blocks and rows that
    are zero.
    """
    matrices = []
    names = []
    blocks = []
    for number, phase in enumerate(layout.phases):
        mesh = phase.mesh
        first = layout.first[number]
        between = mesh.continuity
        matrices.append(_place(between, first, layout.size))
        names += ["continuity of the states"] * between.shape[0]
        if phase.torque_continuous:
            rows = _torque_steps(phase)
            matrices.append(_place(rows, first, layout.size))
            names += ["continuity of the torques"] * rows.shape[0]
    pairs = [(k, k + 1) for k in range(len(layout.phases) - 1)]
    pairs += [(len(layout.phases) - 1, 0)] if periodic else []
    for before, after in pairs:
        n = (
            layout.phases[0].equations.model.dof
            if before > after or before == after
            else layout.phases[0].mesh.n
        )
        a = layout.node(before, -1)
        b = layout.node(after, 0)
        full = layout.phases[0].mesh.n
        what = (
            "periodicity"
            if (before, after) == pairs[-1] and periodic
            else "connection of the phases"
        )
        one = np.ones(n)
        entries = (np.r_[one, -one], (np.r_[np.arange(n), np.arange(n)], np.r_[a[:n], b[:n]]))
        matrices.append(sp.csc_matrix(entries, shape=(n, layout.size)))
        names += [what] * n
        z = ca.SX.sym("z", 2 * n + len(layout.theta))
        T = z[2 * n :]
        rows_v = z[:n] / T[before] - z[n : 2 * n] / T[after]
        where = np.concatenate([a[full : full + n], b[full : full + n], layout.theta])[None]
        zero = np.zeros((n, 1))
        blocks.append(
            Block(
                z,
                ca.SX(0, 1),
                where,
                np.zeros((0, 1)),
                rows_v,
                zero,
                zero,
                [f"{what} (speed)"] * n,
                ca.SX(0),
                ca.SX(0, 1),
                np.array([[float(after), 0.0]]),
            )
        )
    return blocks, sp.vstack(matrices).tocsc(), names


def _place(matrix: sp.spmatrix, first: int, size: int) -> sp.csc_matrix:
    found = matrix.tocoo()
    return sp.csc_matrix(
        (found.data, (found.row, found.col + first)), shape=(found.shape[0], size)
    )


def _torque_steps(phase: Phase) -> sp.csc_matrix:
    """Torque at the end of an interval less that at the start of the next one."""
    mesh = phase.mesh
    n_m = phase.equations.model.n_m
    ends = mesh.table.lagrange(np.array([0.0, 1.0]))
    rows = []
    cols = []
    values = []
    for k in range(mesh.N - 1):
        for j in range(mesh.s):
            for interval, weight in ((k, ends[1, j]), (k + 1, -ends[0, j])):
                at = mesh.n_nodes + mesh.n_inner * interval + mesh.s * mesh.n + n_m * j
                rows += list(range(k * n_m, (k + 1) * n_m))
                cols += list(range(at, at + n_m))
                values += [weight] * n_m
    return sp.csc_matrix((values, (rows, cols)), shape=((mesh.N - 1) * n_m, mesh.size))
