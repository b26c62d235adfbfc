"""Arms with more motors than outputs: a move becomes a motion of all joints, which are then the
outputs.

A joint move determines all joints. A move of the tool does not: the joints change as little as
possible,

    dq_g/ds = J^+ dx/ds,

with the pseudoinverse of the Jacobian J of the tool and the parameter s of its path, and a joint
can be kept where it is. Where all coordinates have a motor, the joints are the outputs: the
torques follow their motion exactly, and with it the tool. Where others have none, as the tilt of a
carriage, the outputs are those of the tool and as many joints as motors are left: the torques
follow the path of the tool exactly, with the deflections.

Source: D. E. Whitney, IEEE Transactions on Man-Machine Systems 10, 1969 (resolved motion rate
control).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.linalg import qr

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.model.elements import Output, RobotModel
from flexgen.model.moves import Move
from flexgen.paths.geometry.jets import JET, Attitude, compose
from flexgen.paths.path import Path
from flexgen.paths.reference import PathSample, Reference
from flexgen.paths.timing.timed_segments import JointMotion, TimedSegment

DEGREE = 9  # of the spline through the joints
# of a piece of the path; more where the tool is off between them
INTERVALS = (64, 128, 256, 512, 1024)
CLOSE = 1e-9  # m for each meter of reach, rad: of the tool between the samples
STEPS = 20  # of Newton's method back to the path
SINGULAR = 1e-6  # smallest allowed ratio of the singular values of the Jacobian
TOLERANCE = 1e-10  # of the integration
# instants of each motion at which the outputs of tool and joints are checked to be independent
CHECKED = 33


def is_redundant(model: RobotModel) -> bool:
    """Whether the outputs do not determine the joints: fewer outputs than motors."""
    return model.output.size < model.n_g == model.n_m


def problem_of_move(
    equations: Equations, move: Move, fixed_joint: str | None, log: Callable[[str], None] | None
) -> tuple[Equations, Path]:
    """The path of a move, and its equations: with all joints as outputs where the outputs do not
    determine them.

    ``fixed_joint``: see `joint_problem`; ArgumentError for another arm. ``log``: for messages.
    """
    model = equations.model
    if not is_redundant(model):
        if fixed_joint is not None:
            expected = "None, because the outputs determine all joints"
            raise ArgumentError(
                f"fixed_joint: given {fixed_joint!r} for model {model.name}, expected {expected}"
            )
        return equations, Path(equations, move)
    joints, path = joint_problem(equations, move, fixed_joint)
    if log is not None:
        rule = f", {path.move.rule}" if isinstance(path.move, JointMotion) else ""
        log(
            f"{model.output.size} outputs, {model.n_m} motors: the outputs of this move are all "
            f"joints{rule}"
        )
    return joints, path


def joint_problem(
    equations: Equations, move: Move, fixed_joint: str | None = None
) -> tuple[Equations, Path]:
    """The equations with all joints as outputs, and the path of these.

    Parameters
    ----------
    equations : Equations
        Of a model with more motors than outputs.
    move : Move
        A joint move; a move of the tool where all coordinates have a motor.
    fixed_joint : str, optional
        An actuated coordinate that does not move in a move of the tool.

    Raises
    ------
    ArgumentError
        The joint is unknown, or the model has coordinates without motor and the move is one of the
        tool.
    SolverError
        The path leaves the workspace or passes a singular pose.
    """
    model = equations.model
    names = [model.coordinates[i].name for i in model.i_g]
    if fixed_joint is not None and fixed_joint not in names:
        raise ArgumentError(
            f"fixed_joint: given {fixed_joint!r}, expected one of {', '.join(names)}"
        )
    joints = derive(_with_joint_outputs(model))
    if move.type == "joint" or isinstance(move, JointMotion):
        return joints, Path(joints, move)
    path = Path(equations, move)
    spaces = {segment.space for segment in path.segments}
    if spaces != {"joint"} and model.n_e and model.output.type == "tool_pose":
        without = ", ".join(model.coordinates[i].name for i in model.i_e)
        raise ArgumentError(
            f"model {model.name}: given a {move.type} of a tool_pose with {model.output.size} "
            f"outputs, {model.n_m} motors and coordinates without motor ({without}); expected a "
            "joint move, or as many outputs as motors"
        )
    free = np.array([name != fixed_joint for name in names])
    follower = _Follower(equations, free)
    segments = []
    q_g = path.q_start[list(model.i_g)]
    for segment in path.segments:
        if segment.space != "joint":
            segment = replace(segment, space="joint", curve=follower.joints_along(segment, q_g))
        segments.append(segment)
        q_g = segment.at(np.array([segment.start + segment.law.duration]))[0][0, :, 0]
    if spaces != {"joint"} and model.n_e:
        joints = derive(_with_joints(follower, segments))
    rule = "least change of the joints" + (f", {fixed_joint} fixed" if fixed_joint else "")
    common = {field.name: getattr(path.move, field.name) for field in fields(Move)}
    return joints, Path(joints, JointMotion(**common, segments=tuple(segments), rule=rule))


def _with_joint_outputs(model: RobotModel) -> RobotModel:
    """The model with all its actuated coordinates as outputs."""
    rows = tuple(tuple(float(i == k) for k in range(model.n_a)) for i in model.i_g)
    units = {model.coordinates[i].unit for i in model.i_g}
    return replace(
        model, output=Output("combination", "", rows, units.pop() if len(units) == 1 else "mixed")
    )


def _with_joints(follower: _Follower, segments: Sequence[TimedSegment]) -> RobotModel:
    """The model with joints as outputs after those of the tool, as many outputs as motors.

    They are those that, in the middle of the path, move most in the motions of the joints at which
    the tool rests.
    """
    model = follower.model
    i_g = list(follower.model.i_g)
    q = np.concatenate(
        [
            s.at(s.start + s.law.duration * np.linspace(0.0, 1.0, CHECKED))[0][:, :, 0]
            for s in segments
        ]
    )
    W = np.array([follower.jacobian(x) for x in q])
    spare = np.linalg.svd(W[len(W) // 2])[2][model.output.size :]
    held = np.flatnonzero(~follower.free)
    # a joint that is kept is an output; of the others those that move most while the tool rests
    order = [k for k in qr(spare, pivoting=True)[2] if k not in held]
    chosen = sorted([*held, *order][: len(spare)])
    sums = np.eye(len(i_g))[chosen]
    sizes = np.array([np.linalg.svd(np.vstack([one, sums]), compute_uv=False) for one in W])
    if not (sizes[:, -1] > SINGULAR * sizes[:, 0]).all():
        raise SolverError(
            "redundant arm: the joints that the tool leaves free change too much along the path; "
            "shorten it, or keep a joint (fixed_joint, --fixed-joint)"
        )
    rows = np.zeros((len(sums), model.n_a))
    rows[:, i_g] = sums
    output = replace(model.output, weights=tuple(tuple(map(float, row)) for row in rows))
    return replace(model, output=output)


class _Follower:
    """Joints of the undeflected arm along a path of its tool."""

    def __init__(self, equations: Equations, free: np.ndarray) -> None:
        """Compile output and its Jacobian in the actuated joints; ``free`` (n_g,): joints that
        follow the output, others keep their value.
        """
        self.model = equations.model
        self.reference = Reference(equations)
        self.free = free
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
            return self._solve_least_norm(
                self._at(q, sample)[1], sample.derivative(1)[0], s / segment.curve.length
            )

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
            q = np.array([self._correct(x, sample, k, s[k]) for k, x in enumerate(found.sol(s).T)])
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

    def _solve_least_norm(
        self, jacobian: np.ndarray, rate: np.ndarray, share: float
    ) -> np.ndarray:
        """The smallest change (n_g,) of the free joints with this ``rate`` (n_y,) of the output;
        the other joints keep their values. SolverError at a singular pose; ``share``: part of the
        path, for its message.
        """
        U, sizes, V = np.linalg.svd(jacobian[:, self.free], full_matrices=False)
        if len(sizes) < len(rate) or not sizes[-1] > SINGULAR * sizes[0]:
            raise SolverError(
                f"redundant arm: a singular pose after {100 * share:.3g} % of the path"
            )
        change = np.zeros(len(self.free))
        change[self.free] = V.T @ ((U.T @ rate) / sizes)
        return change

    def _correct(self, q_g: np.ndarray, sample: PathSample, k: int, s: float) -> np.ndarray:
        """The joints (n_g,) nearest to ``q_g`` with the output of row ``k`` of a sample, by Newton
        steps of least norm; ``s``: part of the path, for errors.
        """
        for _ in range(STEPS):
            error, jacobian = self._at(q_g, sample, k)
            change = self._solve_least_norm(jacobian, -error, s)
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
