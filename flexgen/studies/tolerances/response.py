"""Motion of robots that differ from the model, under the torques of the model and a motor
feedback.

With the residual R of the equations of motion of a robot p at the planned motion (zero for the
model itself), the deviation d of the coordinates follows from its own linearized equations:

    M(t, p) d'' + D(t, p) d' + K(t, p) d = B u - R(t, p) - P' z,
    u = k_s (w + k_i int w dt),  w = -k_p C d - C d'

It starts at rest with the motors at the reference: the integral part of the feedback holds what
the feedforward lacks. R, M, D and K are linear in stiffness, damping, friction and masses, so that
the only error is of second order in d. In a center of mass the matrices are quadratic, with both
terms: without the second one, M of a robot far from the model would not be positive definite.
z: torques of gears with hysteresis and of frictions with a state in addition to those of the plan,
see `flexgen.studies.tolerances.memory_states`. Torques that are late by the time s add
B (tau(t) - tau(t - s)) to R.
The equations are integrated by Newmark's method of constant mean acceleration (order 2, no damping
of its own).

Source: N. M. Newmark, A method of computation for structural dynamics, J. Eng. Mech. Div.
85, 1959.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.calls.deadline import check_time
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.motor_harmonics import gear_angles_along
from flexgen.feedback.loop.plants import LocalDynamics
from flexgen.feedback.loop.reference import MOTION
from flexgen.feedback.loop.sampled_model import output_jacobian
from flexgen.model.elements import RobotModel
from flexgen.model.friction import memory_laws
from flexgen.simulation.motor_feedback import MotorFeedback, default_feedback
from flexgen.studies.tolerances.bristle_states import bristles_of
from flexgen.studies.tolerances.gear_states import gear_rows, gears_of
from flexgen.studies.tolerances.memory_states import PlannedStates, States, plan_states
from flexgen.studies.tolerances.sources import DELAY, Sources, of_equations

# in a period of the speed control; in the motion
STEPS = 12.0
FEWEST = 200
MOST = 1500
# instants at which matrices are evaluated, linear between them; more of them where it moves
KNOTS = 60
DENSER = 3.0
PROBES = (0.0, 0.4, 1.0)  # parts of the time at which matrices are compared: at rest and in motion
SAME = 1e-9  # relative to their largest entry
SHORT = 0.1  # of a step, for the derivative of the torques

Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Along:
    """Equations of deviations along a motion, at ``t`` (k,) in equal steps.

    Attributes
    ----------
    M, D, K : arrays (k, n, n), B : array (k, n, n_m)
        Of the model.
    force : array (sources, k, n)
        Derivative of the residual of the equations of motion with respect to each source.
    constant : list of arrays (sources, n, n)
        Changes of M, D, K over those of the sources; zero for the sources in ``varying``.
    varying : dict of int to arrays (k, n, n)
        Those of sources with which they depend on time.
    feedback : MotorFeedback
    W : array (k, rows, n)
        Errors of the output; ``units`` (rows).
    twist : array (rows, n)
        Deflections of springs; ``springs``: their names, ``motors``: those of the motors.
    motion : dict of str to arrays
        The planned motion and its ``deflection``.
    states : tuple of PlannedStates
        Of gears with hysteresis, and of frictions with a state.
    squares : dict of int to arrays (k, n, n)
        Changes of M, D and K over the squares of the errors of centers of mass.
    linear : array (sources,)
        Which sources the forces are linear in: all but the delay.
    late : callable
        The forces (k, robots, n) of the delay of robots with errors (robots, sources).
    """

    t: np.ndarray
    M: np.ndarray
    D: np.ndarray
    K: np.ndarray
    B: np.ndarray
    force: np.ndarray
    constant: tuple[np.ndarray, ...]
    varying: dict[int, Matrices]
    squares: dict[int, Matrices]
    feedback: MotorFeedback
    W: np.ndarray
    units: tuple[str, ...]
    twist: np.ndarray
    springs: tuple[str, ...]
    motors: tuple[str, ...]
    motion: dict[str, np.ndarray]
    states: tuple[PlannedStates, ...]
    linear: np.ndarray
    late: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Response:
    """Deviations of robots at the instants of `Along`.

    ``error`` (k, robots, rows) of the output, ``tau_m`` (k, robots, n_m), ``deflection`` (k,
    robots, n_s) of springs.
    """

    error: np.ndarray
    tau_m: np.ndarray
    deflection: np.ndarray


def linearize(equations: Equations, trajectory: Trajectory, sources: Sources) -> Along:
    """The equations of deviations from the motion of a trajectory: ``M d'' + D d' + K d = B u -
    forces of the errors``, with the feedback of the motors.

    Matrices are computed at some instants and interpolated; time steps are as short as the
    bandwidth of the feedback asks. An error of the delay shifts the planned torque, which is not
    linear in it.
    """
    model = equations.model
    first = float(trajectory.time[0])
    last = float(trajectory.time[-1])
    feedback = default_feedback(
        equations, *(trajectory[name][0] for name in ("q_a", "q_m", "tau_m"))
    )
    steps = np.ceil(STEPS * feedback.frequencies["speed_hz"] * (last - first))
    t = np.linspace(first, last, int(np.clip(steps, FEWEST, MOST)) + 1)
    motion = trajectory.at(t)
    states = _states(model, sources, motion, float(t[1] - t[0]), feedback.rows)
    sources = of_equations(sources, model)
    changed = derive(without_states(model), [p.name for p in sources.parameters])
    force = _forces(changed, tuple(motion[name] for name in MOTION), sources)
    knots = knots_of(motion["v_a"])
    local = LocalDynamics(changed)
    points = tuple(motion[name][knots] for name in MOTION)
    M, D, K, B = local.matrices(points, sources.nominal)
    constant, varying = _changes(local, points, (M, D, K), sources)
    quadratic = _quadratic_changes(local, points, (M, D, K), sources)

    def between(x: np.ndarray) -> np.ndarray:
        return np.asarray(make_interp_spline(t[knots], x, k=1)(t))

    W, units = _output_rows(equations, motion["q_a"])
    twist, springs, motion["deflection"] = _deflections(model, motion)
    M, D, K, B = (between(x) for x in (M, D, K, B))
    delay = sources.kinds.index(DELAY) if DELAY in sources.kinds else None

    def late(errors: np.ndarray) -> np.ndarray:
        """Residual caused by a torque delay, (k, robots, n)."""
        if delay is None:
            return np.zeros((len(t), 1, 1))
        then = trajectory.at(np.clip(t - errors[:, delay, None], first, last).ravel())["tau_m"]
        change = motion["tau_m"] - then.reshape(len(errors), *motion["tau_m"].shape)
        return np.einsum("kij,rkj->kri", B, change)

    if delay is not None:
        short = (
            min(SHORT * float(t[1] - t[0]), float(sources.sd[delay]))
            * np.eye(len(sources.sd))[[delay]]
        )
        force[delay] += (late(short) - late(-short))[:, 0] / (2 * short[0, delay])
    all_of = {k: (between(x), between(y), between(z)) for k, (x, y, z) in varying.items()}
    squares: dict[int, Matrices] = {}
    for k, (slopes, second) in quadratic.items():
        all_of[k] = (between(slopes[0]), between(slopes[1]), between(slopes[2]))
        squares[k] = (between(second[0]), between(second[1]), between(second[2]))
        for change in constant:
            change[k] = 0.0
    motors = tuple(motor.name for motor in model.motors)
    rest = motion, states, np.arange(len(sources.names)) != delay, late
    return Along(
        t,
        M,
        D,
        K,
        B,
        force,
        constant,
        all_of,
        squares,
        feedback,
        W,
        units,
        twist,
        springs,
        motors,
        *rest,
    )


def knots_of(v_a: np.ndarray) -> np.ndarray:
    """Samples at which matrices are evaluated, as indices, from the joint speeds ``v_a`` (n, n_a):
    `KNOTS` at most.

    Matrices change with the pose: at the largest speed samples are 1 + `DENSER` times as dense as
    at rest.
    """
    speed = np.abs(v_a).max(axis=1)
    along = np.cumsum(1.0 + DENSER * speed / max(float(speed.max()), 1e-300))
    found = np.searchsorted(along, np.linspace(along[0], along[-1], KNOTS))
    return np.unique(np.clip(found, 0, len(v_a) - 1))


def _forces(changed: Equations, points: tuple[np.ndarray, ...], sources: Sources) -> np.ndarray:
    """Derivative of the residual of the equations of motion with respect to the sources, (sources,
    k, n).

    ``changed``: equations with the uncertain numbers as parameters; ``points``: motion at k
    instants.
    """
    residual = changed.function("residual")
    model = changed.model
    given = [ca.SX.sym(residual.name_in(i), residual.size1_in(i)) for i in range(residual.n_in())]
    r_a, r_m = residual(*given)
    by_number = ca.jacobian(ca.vertcat(r_a, *[r_m[j] for j in model.i_m]), given[-1])
    function = ca.Function("forces", given, [ca.densify(by_number @ ca.DM(sources.directions))])
    found = evaluate(function, *points, sources.nominal)[0].reshape(len(points[0]), model.dof, -1)
    return np.ascontiguousarray(found.transpose(2, 0, 1))


def _changes(
    local: LocalDynamics, points: tuple[np.ndarray, ...], own: Matrices, sources: Sources
) -> tuple[tuple[np.ndarray, ...], dict[int, Matrices]]:
    """Changes of M, D, K over those of the sources: where they are constant, and where not.

    ``points``: motion at some instants, ``own``: the matrices there. A source is constant where
    its change is the same at a few of them. Sources whose changes are at different entries of the
    matrices are evaluated together.
    """
    n = local.model.dof
    sd = sources.sd
    probes = (np.array(PROBES) * (len(points[0]) - 1)).astype(int)
    few = tuple(x[probes] for x in points)
    at = tuple(x[probes] for x in own)
    constant = np.zeros((3, len(sd), n, n))
    together: list[tuple[list[int], np.ndarray]] = []
    places: dict[int, np.ndarray] = {}
    for k, p in enumerate(sources.values(np.diag(sd))):
        found = np.array([x - y for x, y in zip(local.matrices(few, p), at, strict=False)]) / sd[k]
        size = np.array([SAME * np.abs(y).max() / sd[k] for y in at])[:, None, None]
        if (np.abs(found - found[:, :1]).max(axis=1) <= size).all():
            constant[:, k] = found[:, 0]
            continue
        places[k] = np.abs(found).max(axis=1) > size
        for group, taken in together:
            if not (taken & places[k]).any():
                group.append(k)
                taken |= places[k]
                break
        else:
            together.append(([k], places[k].copy()))
    varying: dict[int, Matrices] = {}
    for group, _ in together:
        errors = np.zeros(len(sd))
        errors[group] = sd[group]
        found = np.array(
            [
                x - y
                for x, y in zip(local.matrices(points, sources.values(errors)), own, strict=False)
            ]
        )
        for k in group:
            M, D, K = found * places[k][:, None] / sd[k]
            varying[k] = M, D, K
    return tuple(constant), varying


def _quadratic_changes(
    local: LocalDynamics, points: tuple[np.ndarray, ...], own: Matrices, sources: Sources
) -> dict[int, tuple[Matrices, Matrices]]:
    """Changes of M, D and K over the errors of centers of mass, and over their squares: from a
    standard deviation to both sides.
    """
    out = {}
    for k in np.flatnonzero(sources.signed).tolist():
        if ".com_" not in sources.names[k]:
            continue
        sd = float(sources.sd[k])
        step = sd * np.eye(len(sources.sd))[k]
        above = local.matrices(points, sources.values(step))[:3]
        below = local.matrices(points, sources.values(-step))[:3]
        first = [(x - y) / (2.0 * sd) for x, y in zip(above, below, strict=True)]
        second = [
            (x + y - 2.0 * z) / (2.0 * sd**2) for x, y, z in zip(above, below, own, strict=True)
        ]
        out[k] = ((first[0], first[1], first[2]), (second[0], second[1], second[2]))
    return out


def _output_rows(equations: Equations, q_a: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rows from deviations to errors of the output, (k, rows, n), and their units."""
    from flexgen.dynamics.mechanics.output_columns import output_units

    model = equations.model
    units = output_units(model)
    if model.output.type == "tool_pose":
        units = (*units, "rad", "rad", "rad")
    W = np.zeros((len(q_a), len(units), model.dof))
    W[:, :, : model.n_a] = evaluate(output_jacobian(equations), q_a)[0].reshape(
        len(q_a), len(units), -1
    )
    return W, units


def _deflections(
    model: RobotModel, motion: dict[str, np.ndarray]
) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """Rows (count, dof) from deviations to deflections of elastic gears, arm side, and springs
    without motor; their names; their planned ones (n, count) [rad, m].
    """
    rows = []
    names = []
    planned = []
    for k, (i, row) in enumerate(zip(model.i_g, gear_rows(model), strict=True)):
        if np.any(row[model.n_a :]):
            rows.append(row)
            names.append(model.coordinates[i].name)
            planned.append(_gear_deflections(model, motion)[:, k])
    for i in model.i_e:
        rows.append(np.eye(model.dof)[i])
        names.append(model.coordinates[i].name)
        planned.append(motion["q_a"][:, i])
    # a rigid robot has no rows
    count = len(rows)
    instants = len(motion["q_a"])
    return (
        np.array(rows).reshape(count, model.dof),
        tuple(names),
        np.array(planned).reshape(count, instants).T,
    )


def _gear_deflections(model: RobotModel, motion: dict[str, np.ndarray]) -> np.ndarray:
    """Of all gears along a motion (k, n_g), arm side."""
    return np.asarray(gear_angles_along(model, motion["q_m"]) - motion["q_a"][:, list(model.i_g)])


def _states(
    model: RobotModel,
    sources: Sources,
    motion: dict[str, np.ndarray],
    h: float,
    motors: np.ndarray,
) -> tuple[PlannedStates, ...]:
    """States of gears and of frictions along a motion in steps of ``h`` [s]; ``motors``: rows to
    the motor angles.
    """

    def of_gears() -> PlannedStates:
        deflections = _gear_deflections(model, motion)
        return plan_states(model, sources, gears_of, gear_rows(model), deflections)

    def of_frictions() -> PlannedStates:
        return plan_states(
            model, sources, lambda robots: bristles_of(robots, h), motors, motion["q_m"]
        )

    planned = {"hysteresis": of_gears, "lugre": of_frictions}
    return tuple(planned[law.key]() for law in memory_laws(model))


def linear_response(along: Along) -> Response:
    """Response to each source alone, to first order: for an error of 1, (k, sources, rows)."""
    parts = along.M, along.D, along.K
    states = [each.linear() for each in along.states]
    return _integrate(
        along,
        len(along.force),
        lambda k: (parts[0][k], parts[1][k], parts[2][k]),
        lambda k: along.force[:, k],
        states,
    )


def response(along: Along, errors: np.ndarray) -> Response:
    """Response of robots whose sources have these errors (robots, sources), with the matrices of
    each.
    """
    own = [np.tensordot(errors, x, 1) for x in along.constant]
    some = list(along.varying)
    n = along.M.shape[1]
    changes = [
        np.array(
            [*(along.varying[j][i] for j in some), *(x[i] for x in along.squares.values())]
        ).reshape(len(some) + len(along.squares), len(along.t), n * n)
        for i in range(3)
    ]
    by_time = [np.ascontiguousarray(x.transpose(1, 0, 2)) if x.any() else None for x in changes]
    given = np.hstack([errors[:, some], errors[:, list(along.squares)] ** 2])

    def matrices(k: int) -> Matrices:
        M, D, K = (
            x[k] + y if z is None else x[k] + y + (given @ z[k]).reshape(-1, n, n)
            for x, y, z in zip((along.M, along.D, along.K), own, by_time, strict=True)
        )
        return M, D, K

    states = [each.robots(errors) for each in along.states]
    late = along.late(errors)
    known = errors * along.linear
    return _integrate(
        along, len(errors), matrices, lambda k: known @ along.force[:, k] + late[k], states
    )


def _integrate(
    along: Along,
    robots: int,
    matrices: Callable[[int], Matrices],
    force: Callable[[int], np.ndarray],
    states: Sequence[States],
) -> Response:
    """Integrate the deviations by the trapezoidal rule; ``matrices`` (n, n) or (robots, n, n) and
    ``force`` (robots, n) at an instant.

    The feedback torque ``u = k_s (w + k_i int w)`` with ``w = -C v - k_p C d`` is part of the
    equations for the new acceleration, as it depends on it.
    """
    f = along.feedback
    h = along.t[1] - along.t[0]
    C = along.feedback.rows
    n_m, n = C.shape
    k_s = f.speed_gain
    k_p = f.position_gain[:, None]
    k_i = f.integral_gain
    d, total, u = _rest(along, matrices(0)[2], force(0))
    v = np.zeros((robots, n))
    a = np.zeros((robots, n))
    w = -(d @ (k_p * C).T)
    out = Response(
        *(np.empty((len(along.t), robots, m)) for m in (along.W.shape[1], n_m, len(along.twist)))
    )
    per_torque = (1.0 + k_i * h / 2) * k_s
    for each in states:
        each.start(d)
    for k in range(len(along.t)):
        if k:
            if k % 50 == 0:
                check_time("uncertainty")
            M, D, K = matrices(k)
            in_w = C * (h / 2) + k_p * C * (h * h / 4)  # -dw / da
            # without the new acceleration
            d = d + h * v + h * h / 4 * a
            v = v + h / 2 * a
            w_0 = -(d @ (k_p * C).T + v @ C.T)
            u_0 = k_s * (w_0 + k_i * (total + h / 2 * (w + w_0)))
            left = M + h / 2 * D + h * h / 4 * K + along.B[k] @ (per_torque[:, None] * in_w)
            right = u_0 @ along.B[k].T - force(k) - _times(D, v) - _times(K, d)
            for each in states:
                own, rise = each.at(k, d)
                left = left + h * h / 4 * rise
                right = right - own
            a = (
                np.linalg.solve(left, right.T).T
                if left.ndim == 2
                else np.linalg.solve(left, right[..., None])[..., 0]
            )
            d = d + h * h / 4 * a
            v = v + h / 2 * a
            for each in states:
                each.keep(k, d)
            w_1 = w_0 - a @ in_w.T
            total = total + h / 2 * (w + w_1)
            w = w_1
            u = k_s * (w + k_i * total)
        out.error[k] = d @ along.W[k].T
        out.tau_m[k] = u
        out.deflection[k] = d @ along.twist.T
    return out


def _times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Matrices (n, n) or (robots, n, n) times vectors (robots, n)."""
    return x @ A.T if A.ndim == 2 else np.matmul(A, x[..., None])[..., 0]


def _rest(
    along: Along, K: np.ndarray, force: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Deviations (robots, n) at rest with the motors at their reference, integral of w, and
    torques of the feedback (robots, n_m), from ``K d - B u = -force`` and ``C d = 0``.
    """
    f = along.feedback
    (n_m, n) = along.feedback.rows.shape
    A = np.zeros((*K.shape[:-2], n + n_m, n + n_m))
    A[..., :n, :n] = K
    A[..., :n, n:] = -along.B[0]
    A[..., n:, :n] = f.rows
    right = np.concatenate([-force, np.zeros((len(force), n_m))], axis=1)
    found = (
        np.linalg.solve(A, right.T).T
        if A.ndim == 2
        else np.linalg.solve(A, right[..., None])[..., 0]
    )
    d = found[:, :n]
    u = found[:, n:]
    return d, u / (f.speed_gain * f.integral_gain), u
