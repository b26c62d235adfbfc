"""Motions of the joints along a path of the tool that leaves some of them free.

The joints change as little as possible,

    dq/ds = W^-1 J' (J W^-1 J')^-1 (dx/ds - J_f p) + p,     min (dq/ds)' W (dq/ds)

with the Jacobian J of the tool, the parameter s of its path and the diagonal matrix W of weights;
joints with a motion of their own have the given rate p, in proportion to the path, and J_f are
their columns (they are left out of W and J). The splines through the joints have `DEGREE` - 1
continuous derivatives, more than the inverse dynamics of any robot needs.

Source: D. E. Whitney, IEEE Transactions on Man-Machine Systems 10, 1969 (resolved motion rate
control).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Posture
from flexgen.paths.geometry.jets import JET, Attitude, compose
from flexgen.paths.reference import PathSample, Reference
from flexgen.paths.timing.timed_segments import TimedSegment

DEGREE = 9  # of the spline through the joints
# of a piece of the path; more where the tool is off between them
INTERVALS = (64, 128, 256, 512, 1024)
# rad, of a joint from one sample to the next: a spline of degree 9 through samples of a sine is
# off by about (x / pi)^10 of its amplitude, with this x by 1e-9.
TURN = 0.39
CLOSE = 1e-9  # m for each meter of reach, rad: of the tool between the samples
STEPS = 20  # of Newton's method back to the path
SINGULAR = 1e-6  # smallest allowed ratio of the singular values of the Jacobian
TOLERANCE = 1e-10  # of the integration


def check_posture(model: RobotModel, posture: Posture, move: str) -> None:
    """ArgumentError where a posture does not fit a model: unknown joints, more joints than the
    tool leaves free, a weight that is not positive.
    """
    names = [model.coordinates[i].name for i in model.i_g]
    spare = len(names) - model.output.of_tool.size
    what = f"move {move}: posture"
    if spare < 1:
        raise ArgumentError(
            f"{what}: given for model {model.name}, expected none, because the tool determines "
            "all joints"
        )
    for name in (*posture.joints, *posture.weighted):
        if name not in names:
            raise ArgumentError(
                f"{what}: given joint {name!r}, expected one of {', '.join(names)}"
            )
    if len(posture.joints) > spare:
        raise ArgumentError(
            f"{what}: given motions of {len(posture.joints)} joints, expected at most {spare}: "
            "the tool determines the others"
        )
    most = TURN * INTERVALS[-1]
    for name, change in zip(posture.joints, posture.change, strict=True):
        turns = model.coordinates[model.i_g[names.index(name)]].unit == "rad"
        if turns and abs(change) > most:
            raise ArgumentError(
                f"{what}: given a change of {change:g} rad of joint {name!r}, expected at most "
                f"{most:.0f} rad, {most / (2.0 * np.pi):.0f} turns, in a move: beyond it the tool "
                "is off the path between the samples of the joints"
            )
    if not all(weight > 0.0 for weight in posture.weights):
        raise ArgumentError(f"{what}: given weights {list(posture.weights)}, expected numbers > 0")


def joint_segments(
    equations: Equations,
    segments: Sequence[TimedSegment],
    q_g: np.ndarray,
    posture: Posture | None,
) -> tuple[list[TimedSegment], Follower]:
    """The segments of a path of the tool as motions of the joints, and the `Follower` that found
    them.

    Parameters
    ----------
    equations : Equations
        Of the model whose output is that of the tool alone.
    segments : sequence of TimedSegment
    q_g : array (n_g,) [rad or m]
        Joints at the start.
    posture : Posture or None
        How the joints are chosen; None: they change as little as possible.

    Raises
    ------
    SolverError
        The path leaves the workspace or passes a singular pose.
    """
    total = sum(s.curve.length for s in segments if s.space != "joint")
    follower = Follower(equations, posture or Posture(), total)
    found = []
    for segment in segments:
        if segment.space != "joint":
            segment = replace(segment, space="joint", curve=follower.joints_along(segment, q_g))
        found.append(segment)
        q_g = segment.at(np.array([segment.start + segment.law.duration]))[0][0, :, 0]
    return found, follower


class Follower:
    """Joints of the undeflected arm along a path of its tool."""

    def __init__(self, equations: Equations, posture: Posture, total: float) -> None:
        """Compile output and its Jacobian in the actuated joints; ``total``: length of the path,
        in which the joints of the posture move by their changes.
        """
        self.model = equations.model
        self.reference = Reference(equations)
        names = [self.model.coordinates[i].name for i in self.model.i_g]
        self.free = np.array([name not in posture.joints for name in names])
        self.rate = np.zeros(len(names))  # of the joints with a motion of their own
        for name, change in zip(posture.joints, posture.change, strict=True):
            self.rate[names.index(name)] = change / total
        weights = dict(zip(posture.weighted, posture.weights, strict=True))
        self.root = np.sqrt([weights.get(name, 1.0) for name in names])
        map_ = output_map(equations)
        symbol = equations.lagrangian.chain.q_a
        rate = ca.densify(map_.rate[:, list(self.model.i_g)])
        self._error = ca.Function("error", [symbol, map_.target], [ca.densify(map_.error), rate])

    def jacobian(self, q_g: np.ndarray) -> np.ndarray:
        """From rates of the joints to those of the output, (n_y, n_g), at coordinates (n_g,)."""
        target = np.zeros(self.model.output.target_size)
        return np.array(self._error(self.reference.expand(q_g), target)[1])

    def joints_along(self, segment: TimedSegment, q_g: np.ndarray) -> JointCurve:
        """The joints over the parameter of the segment's curve, from ``q_g`` on."""
        curve = segment.curve
        inner = [s for s in curve.breaks if 1e-9 * curve.length < s < (1 - 1e-9) * curve.length]
        ends = [0.0, *inner, curve.length]
        pieces = []
        for low, high in pairwise(ends):
            pieces.append(self._piece(segment, low, high, q_g))
            q_g = pieces[-1](high)
        return JointCurve(tuple(pieces), tuple(inner), curve.length)

    def _piece(
        self, segment: TimedSegment, low: float, high: float, q_g: np.ndarray
    ) -> Callable[..., np.ndarray]:
        """The spline of the actuated coordinates over the arc length from ``low`` to ``high``,
        from ``q_g`` (n_g,) at its start.

        The motion of least norm is integrated and corrected at equidistant samples; their number
        grows until the tool is on the path between them too.

        Raises
        ------
        SolverError
            The integration fails, or the finest spline is off the path.
        """
        within = np.nextafter(low, high), np.nextafter(high, low)

        def slope(s: float, q: np.ndarray) -> np.ndarray:
            sample = self._tool(segment, np.clip([s], *within))
            J = self._at(q, sample)[1]
            own = sample.derivative(1)[0] - J @ self.rate
            return self.rate + self._solve(J, own, s / segment.curve.length)

        found = solve_ivp(
            slope, (low, high), q_g, "DOP853", dense_output=True, rtol=TOLERANCE, atol=TOLERANCE
        )
        if not found.success:
            raise SolverError(
                f"redundant arm: the joints cannot be integrated along the path: {found.message}"
            )
        for n in INTERVALS:
            s = np.linspace(low, high, n + 1)
            sample = self._tool(segment, np.clip(s, *within))
            first = found.sol(s).T
            first[:, ~self.free] = (q_g + np.outer(s - low, self.rate))[:, ~self.free]
            shares = s / segment.curve.length
            q = np.array([self._correct(x, sample, k, shares[k]) for k, x in enumerate(first)])
            q[0] = q_g
            spline = make_interp_spline(s, q, k=DEGREE)
            between = (s[1:] + s[:-1]) / 2
            there = self._tool(segment, between)
            worst = max(
                np.abs(self._at(x, there, k)[0]).max() for k, x in enumerate(spline(between))
            )
            if worst < CLOSE * (1.0 + np.abs(sample.y[:, :, 0]).max()):
                return spline
        raise SolverError(
            f"redundant arm: the joints are {worst:.2e} m or rad off the path between {n} samples"
        )

    def _tool(self, segment: TimedSegment, s: np.ndarray) -> PathSample:
        """The output at parameters of the curve, with derivatives in the parameter."""
        jet = np.zeros((len(s), JET))
        jet[:, 0] = s
        jet[:, 1] = 1.0
        return self.reference.sample(segment.space, *segment.curve(jet))

    def _at(
        self, q_g: np.ndarray, sample: PathSample, k: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Error (n_y,) of the output at ``q_g`` (n_g,) from row ``k`` of a sample, and its
        Jacobian (n_y, n_g).
        """
        target = (
            sample.y[k, :, 0]
            if sample.R is None
            else np.r_[sample.y[k, :, 0], sample.R[k].T.ravel()]
        )
        error, jacobian = self._error(self.reference.expand(q_g), target)
        return np.array(error)[:, 0], np.array(jacobian)

    def _solve(self, jacobian: np.ndarray, rate: np.ndarray, share: float) -> np.ndarray:
        """The change (n_g,) of the free joints, of least weighted norm, with this ``rate`` (n_y,)
        of the output; the other joints keep their values. SolverError at a singular pose;
        ``share``: part of the path, for its message.
        """
        scaled = jacobian[:, self.free] / self.root[self.free]
        U, sizes, V = np.linalg.svd(scaled, full_matrices=False)
        if len(sizes) < len(rate) or not sizes[-1] > SINGULAR * sizes[0]:
            raise SolverError(
                f"redundant arm: a singular pose after {100 * share:.3g} % of the path"
            )
        change = np.zeros(len(self.free))
        change[self.free] = V.T @ ((U.T @ rate) / sizes) / self.root[self.free]
        return change

    def _correct(self, q_g: np.ndarray, sample: PathSample, k: int, s: float) -> np.ndarray:
        """The joints (n_g,) nearest to ``q_g`` with the output of row ``k`` of a sample, by Newton
        steps of least norm; ``s``: part of the path, for errors.
        """
        for _ in range(STEPS):
            error, jacobian = self._at(q_g, sample, k)
            change = self._solve(jacobian, -error, s)
            q_g = q_g + change
            if np.abs(change).max() < 1e-13 * (1.0 + np.abs(q_g).max()):
                break
        return q_g


@dataclass(frozen=True)
class JointCurve:
    """Joints over the parameter of a path of the tool: a spline in each piece of the path."""

    pieces: tuple[Callable[..., np.ndarray], ...]
    inner: tuple[float, ...]
    length: float
    smoothness: int = DEGREE - 1

    @property
    def breaks(self) -> np.ndarray:
        """Parameters between the pieces."""
        return np.array(self.inner)

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, n_g, k) of the joints from the jet (n, k) of the parameter."""
        at = np.clip(s[:, 0], 0.0, self.length)
        number = np.searchsorted(self.inner, at, side="right")
        width = self.pieces[0](0.0).size
        q = np.zeros((len(s), width, JET))
        for i, piece in enumerate(self.pieces):
            here = number == i
            for k in range(JET):
                q[here, :, k] = piece(at[here], nu=k)
        return compose(q, s), None
