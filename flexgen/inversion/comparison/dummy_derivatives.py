"""Index reduction by dummy derivatives: the inverse dynamics as an equivalent DAE of index 1, as
CasADi functions.

Equation i of the second-order system (motion and output) is differentiated 0 to c_i times, unknown
j of (y, tau_m) occurs up to its d_j-th derivative; c and d are the offsets of the signature
method. All derivatives of an unknown are unknowns of their own,

    Y = (y_j^(0), ..., y_j^(d_j)),       G(Y, U) = 0 : all equations and their derivatives,

too few to be solved for Y by sum d - sum c: the degrees of freedom. For the k-th derivatives that
were added, as many unknowns are chosen whose k-th highest derivative is a *dummy*: no longer the
rate of the one below it, but just an unknown. An unknown that keeps its rate is a state. The
choice is made by QR factorization with column pivoting of the system Jacobian
``dF_i^(c_i)/dy_j^(d_j)`` at a point, and holds as long as the chosen block is well conditioned.

Source: S. E. Mattsson, G. Soederlind, SIAM J. Sci. Comput. 14(3), 1993; J. D. Pryce, BIT
41(2), 2001.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.linalg import qr

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.system import InverseDae

SINGULAR = 1e-10  # relative size of the last pivot below which no choice works
ITERATIONS = 30
TOLERANCE = 1e-15
# a correction that is smaller, in units of the scales, and shrinks no more is rounding
STALLED = 1e-6


@dataclass(frozen=True)
class Choice:
    """``depth[j]``: how many of the highest derivatives of unknown j are dummies.

    ``states``, ``algebraic``: places in Y of the states and of all else; ``rates``: of what each
    state's rate is.
    """

    depth: tuple[int, ...]
    states: tuple[int, ...]
    algebraic: tuple[int, ...]
    rates: tuple[int, ...]


class DummyDerivatives:
    """The differentiated system ``G(Y, U) = 0`` and the choices of states.

    Parameters
    ----------
    dae : InverseDae
    c, d : sequences of int
        Offsets of the rows (motion, output) and of the unknowns (y, tau_m).

    ``place[j][r]``: where the r-th derivative of unknown j stands in Y; ``orders``: highest
    derivative of the target; ``freedom``: number of states.
    """

    def __init__(self, dae: InverseDae, c: Sequence[int], d: Sequence[int]) -> None:
        """``c``: how often each row is differentiated, ``d``: highest derivative of each unknown;
        ArgumentError where their numbers do not fit.
        """
        if len(c) != dae.n + dae.model.output.size or len(d) != dae.n + dae.model.n_m:
            raise ArgumentError(
                f"offsets: given {len(c)} of rows and {len(d)} of unknowns, expected "
                f"{dae.n + dae.model.output.size} and {dae.n + dae.model.n_m}; a structurally "
                "singular model has none"
            )
        self.dae = dae
        self.c = tuple(c)
        self.d = tuple(d)
        self.orders = max(c)
        self.freedom = sum(d) - sum(c)
        starts = np.concatenate([[0], np.cumsum(np.array(d) + 1)])
        self.size = int(starts[-1])
        self.place = [[int(starts[j]) + r for r in range(d[j] + 1)] for j in range(len(d))]
        self.system, self.jacobian = self._differentiate()

    def _differentiate(self) -> tuple[ca.Function, ca.Function]:
        """The differentiated system as CasADi functions of the unknowns Y and the path U.

        Row i is differentiated ``c[i]`` times; its last derivative contains the highest
        derivatives of the unknowns.

        Returns
        -------
        system : ca.Function
            (Y, U) -> G, dG/dY: all rows with all their derivatives.
        highest : ca.Function
            (Y, U) -> the Jacobian of the last derivatives in the highest ones, (rows, unknowns).
        """
        dae = self.dae
        n = self.dae.n
        c = self.c
        Y = ca.SX.sym("Y", self.size)
        U = ca.SX.sym("U", dae.n_u, self.orders + 1)

        def level(r: int) -> list[ca.SX]:
            return [Y[places[r]] if r < len(places) else ca.SX(0) for places in self.place]

        y, v, a = (ca.vertcat(*level(r)[:n]) for r in range(3))
        tau = ca.vertcat(*level(0)[n:])
        rows = ca.vertcat(dae.motion_rows(y, v, a, tau), dae.output_rows(y, U[:, 0]))
        moving = [places[r] for places in self.place for r in range(len(places) - 1)]
        rising = [places[r + 1] for places in self.place for r in range(len(places) - 1)]
        held = [
            i for places in self.place for i in places[-1:]
        ]  # they cannot occur where there is more to differentiate
        symbols = ca.vertcat(Y[moving], Y[held], ca.vec(U[:, :-1]))
        rates = ca.vertcat(Y[rising], ca.SX.zeros(len(held)), ca.vec(U[:, 1:]))
        left = list(range(len(c)))
        found = [rows]
        top = [ca.SX(0)] * len(c)
        for k in range(self.orders + 1):
            for i, row in zip(left, ca.vertsplit(rows), strict=True):
                if c[i] == k:
                    top[i] = row
            keep = [position for position, i in enumerate(left) if c[i] > k]
            left = [left[position] for position in keep]
            if left:
                rows = ca.jtimes(rows[keep], symbols, rates)
                found.append(rows)
        G = ca.vertcat(*found)
        highest = ca.vertcat(*[Y[places[-1]] for places in self.place])
        return (
            ca.Function(
                "system",
                [Y, U],
                [ca.densify(G), ca.densify(ca.jacobian(G, Y))],
                ["Y", "U"],
                ["G", "dG"],
            ),
            ca.Function(
                "highest",
                [Y, U],
                [ca.densify(ca.jacobian(ca.vertcat(*top), highest))],
                ["Y", "U"],
                ["J"],
            ),
        )

    def at_rest(self, x: np.ndarray) -> np.ndarray:
        """Y of a robot at rest in the state x of the DAE."""
        n = self.dae.n
        Y = np.zeros(self.size)
        Y[[places[0] for places in self.place]] = np.concatenate([x[:n], x[2 * n :]])
        return Y

    def states_of(self, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x and x' (k, n_x) of the DAE from Y (k, size); rates of the torques, which Y may not
        have, are zero.
        """
        n = self.dae.n
        y, v, a = ([places[r] for places in self.place[:n]] for r in range(3))
        tau = [places[0] for places in self.place[n:]]
        return np.hstack([Y[:, y], Y[:, v], Y[:, tau]]), np.hstack(
            [Y[:, v], Y[:, a], np.zeros((len(Y), len(tau)))]
        )

    def scales(self, x_rest: np.ndarray) -> np.ndarray:
        """Sizes of the numbers of Y: of its unknowns, times a typical rate for each derivative."""
        size, torque, rate = self.dae.scales(x_rest)
        unit = np.concatenate([size, torque])
        return np.array(
            [unit[j] * rate**r for j, places in enumerate(self.place) for r in range(len(places))]
        )

    # --- choice ----------------------------------------------------------------------------------

    def choose(self, Y: np.ndarray, U: np.ndarray) -> Choice:
        """The choice of states with the best pivots at a point Y, U.

        Level by level, the columns with the largest pivots of a QR decomposition of the system
        Jacobian become algebraic; the others remain states.

        Raises
        ------
        SolverError
            The Jacobian is singular there, or no choice is possible.
        """
        J = self._scale_jacobian(Y, U)
        columns = np.flatnonzero(np.array(self.d) > 0)
        depth = np.zeros(len(self.d), dtype=int)
        full = np.linalg.svd(J, compute_uv=False)
        if not full[-1] > SINGULAR * full[0]:
            raise SolverError(
                "the system Jacobian is singular: at a singular pose, where a zero is at "
                "infinity, or because the structural index is not the true one; use "
                "kunkel-mehrmann or lq"
            )
        for k in range(1, self.orders + 1):
            rows = np.flatnonzero(np.array(self.c) >= k)
            columns = columns[np.array(self.d)[columns] >= k]
            _, R, order = qr(J[np.ix_(rows, columns)], mode="economic", pivoting=True)
            pivots = np.abs(np.diag(R))
            if len(pivots) < len(rows) or pivots[len(rows) - 1] < SINGULAR * pivots[0]:
                raise SolverError("no choice of states is possible at a singular pose; use lq")
            columns = np.sort(columns[order[: len(rows)]])
            depth[columns] = k
        return self.choice(depth)

    def choice(self, depth: Sequence[int] | np.ndarray) -> Choice:
        """The choice with a given depth of each unknown."""
        states = []
        rates = []
        for j, places in enumerate(self.place):
            for r in range(self.d[j] - int(depth[j])):
                states.append(places[r])
                rates.append(places[r + 1])
        algebraic = sorted(set(range(self.size)) - set(states))
        return Choice(tuple(int(k) for k in depth), tuple(states), tuple(algebraic), tuple(rates))

    def quality(self, choice: Choice, Y: np.ndarray, U: np.ndarray) -> float:
        """Conditioning of a choice at a point Y, U: 1 for the best choice, 0 for a singular one.

        The smallest over all levels of the smallest singular value of the chosen block, relative
        to that of all columns.
        """
        J = self._scale_jacobian(Y, U)
        worst = 1.0
        for k in range(1, self.orders + 1):
            rows = np.flatnonzero(np.array(self.c) >= k)
            chosen = np.flatnonzero(np.array(choice.depth) >= k)
            whole = np.linalg.svd(J[rows], compute_uv=False)[-1]
            block = np.linalg.svd(J[np.ix_(rows, chosen)], compute_uv=False)[-1]
            worst = min(worst, float(block / max(whole, 1e-300)))
        return worst

    def _scale_jacobian(self, Y: np.ndarray, U: np.ndarray) -> np.ndarray:
        """The system Jacobian with columns and then rows of size one."""
        J = self.jacobian(Y, U).full()
        J = J / np.maximum(np.abs(J).max(axis=0), 1e-300)
        return J / np.maximum(np.abs(J).max(axis=1), 1e-300)[:, None]

    # --- functions of a choice -------------------------------------------------------------------

    def index_one(self, choice: Choice) -> ca.Function:
        """The semi-explicit DAE of index 1: (s, z, U) -> ds/dt, G."""
        s = ca.SX.sym("s", len(choice.states))
        z = ca.SX.sym("z", len(choice.algebraic))
        U = ca.SX.sym("U", self.dae.n_u, self.orders + 1)
        Y = ca.SX.zeros(self.size)
        Y[list(choice.states)] = s
        Y[list(choice.algebraic)] = z
        G = self.system(Y, U)[0]
        rates = Y[list(choice.rates)] if choice.rates else ca.SX(0, 1)
        return ca.Function("index_one", [s, z, U], [rates, G], ["s", "z", "U"], ["ds", "G"])

    def consistent(
        self, choice: Choice, Y: np.ndarray, U: np.ndarray, scale: np.ndarray
    ) -> tuple[np.ndarray, int]:
        """Consistent values Y (size,) by Newton's method, and its iterations; the states of the
        ``choice`` keep their values, the other unknowns start at those given.

        ``U``: path and derivatives at the instant; ``scale`` (size,): see `scales`. SolverError
        where it does not converge.
        """
        Y = np.array(Y, dtype=float)
        free = list(choice.algebraic)
        before = np.inf
        for iteration in range(1, ITERATIONS + 1):
            G, jacobian = (x.full() for x in self.system(Y, U))
            J = jacobian[:, free]
            column = scale[free]
            row = np.maximum(np.abs(J * column).max(axis=1), 1e-300)
            try:
                step = column * np.linalg.solve(J * column / row[:, None], -G[:, 0] / row)
            except np.linalg.LinAlgError:
                break
            Y[free] += step
            size = float((np.abs(step) / (scale[free] + np.abs(Y[free]))).max())
            if size <= TOLERANCE or (size < STALLED and size > 0.3 * before):
                return Y, iteration
            if not np.isfinite(size):
                break
            before = size
        raise SolverError(
            "no consistent values found: the path leaves the workspace or passes a singular "
            "pose, or the system is nearly singular, such as with a weakly damped gear; use "
            "kunkel-mehrmann"
        )
