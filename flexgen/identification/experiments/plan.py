"""`excite`: plan an experiment: drives, multisines and poses, with the accuracy that it will
have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from flexgen.analysis.linear import linearize
from flexgen.analysis.second_order import motor_inertias
from flexgen.base.calls.deadline import keep_best, limit_fit, part_known, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Count, CountOrZero, NotNegative, Positive, Seed, TimeLimit
from flexgen.base.checks.counts import PERIODS, SAMPLES, count_of, seconds_of
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.codegen.emission.digest import model_digest
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.parameters import has_group
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments import operating_points
from flexgen.identification.experiments.excitation import (
    Plan,
    motor_speeds,
    odd_lines,
    speed_amplitudes,
)
from flexgen.identification.experiments.obstacles import Box, Surroundings
from flexgen.identification.experiments.optimal_spectrum import with_optimal_spectrum
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.response_outputs import channels, check_channels
from flexgen.model.abilities import check_ability
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

BANDWIDTH = 8.0  # Hz, of the speed control
POSITION_GAIN = 8.0  # 1/s
SAMPLED_GAIN = 0.3  # of speed gain times sample time over inertia; unstable at 1 to 2
CANDIDATES = 300
FREE = ("stiffness", "damping")
OPTIMAL = "optimal"


@checked_types(own=("period_s", "periods", "realizations"))
@reported("excite")
def excite(
    model: RobotModel | str | Path,
    *,
    poses: Count | Sequence[Sequence[float]] | np.ndarray = 8,
    criterion: operating_points.CriterionName = "A",
    free: Sequence[str] | None = None,
    speed_rms: Positive | Sequence[float] = 0.05,
    f_min: Positive | None = None,
    f_max: Positive | None = None,
    lines: Count = 63,
    spectrum: float | str = 0.5,
    period_s: Positive = 4.0,
    periods: Count = 4,
    transients: CountOrZero = 1,
    realizations: Count = 1,
    hardware: DriveHardware | None = None,
    sensors: Sequence[str] | None = None,
    obstacles: Sequence[Box] = (),
    clearance: NotNegative = 0.1,
    seed: Seed = 0,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> Plan:
    """Plan an experiment for the identification of a model's elastic parameters.

    Parameters
    ----------
    model : RobotModel, str or Path
    poses : int or array (k, n_g)
        Number of poses to choose. Or joint positions [rad or m].
    criterion : str
        Of the best poses: ``"A"`` (least sum of variances, the default), ``"D"`` (least
        determinant) or ``"random"``.
    free : sequence of str, optional
        As of `flexgen.identify`: the parameters whose accuracy counts.
    speed_rms : float or sequence (n_g,) [rad/s or m/s]
        Of each joint. Joint side.
    f_min : float, optional [Hz]
        Lowest frequency; default: from the modes. An eighth of the lowest natural frequency of the
        elastic modes at home.
    f_max : float, optional [Hz]
        Highest frequency; default: from the modes. The highest natural frequency of the elastic
        modes at home times 1.5, and at most a fifth of the sampling frequency.
    lines : int
        Number of frequencies. At most; the band may have fewer.
    spectrum : float or "optimal"
        Speeds rise with this power of the frequency, or 'optimal': half of the power where it
        tells most. See `optimal_spectrum`.
    period_s : float [s]
        Of the excitation.
    periods : int
        That are measured.
    transients : int
        Periods before them that are not.
    realizations : int
        Of the random phases; 6 with friction.
    hardware : DriveHardware, optional
        Sample time, delay, noise and limits of the drives.
    sensors : sequence of str, optional
        Channels of ``[[sensor]]`` tables; default: all. They are recorded too.
    obstacles : sequence of Box
        Boxes in the world, such as the floor, from which links and tool stay away.
    clearance : float [m]
        Least distance of obstacles from the lines between the joints.
    seed : int
        Of phases and candidate poses.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the poses are the best of the
        candidates that were computed, and ``ended`` says so. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    Plan
        Its ``predicted`` has the expected standard deviation of the logarithm of each free
        parameter.

    Raises
    ------
    ArgumentError
        An argument is wrong, or the motion leaves the limits of joints or motors, or comes too
        near to an obstacle.
    OutOfTime
        The time was over before as many candidates were computed as poses are chosen.

    Examples
    --------
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)  # rad, Hz
    >>> plan
    <Plan elbow: 1 poses, 1 x 2 experiments of 1 + 4 periods of 1 s, 10 lines 3 .. 67 Hz: 10 s>
    >>> list(plan.predicted)
    ['q1.stiffness', 'q1.damping', 'q2.stiffness', 'q2.damping']
    """
    robot = model if isinstance(model, RobotModel) else read(model)
    hardware = hardware or DriveHardware()
    check_ability(robot, "excite")
    _check_counts(periods, transients, realizations)
    seconds_of("period_s", period_s, SAMPLES * hardware.sample_s)
    lines_ = odd_lines(*_band(robot, f_min, f_max, hardware), lines, period_s)
    plan = Plan(
        model=str(model) if not isinstance(model, RobotModel) else _name(model),
        digest=model_digest(robot),
        motors=tuple(motor.name for motor in robot.motors),
        poses=np.zeros((0, robot.n_m)),
        lines=lines_,
        period_s=float(period_s),
        amplitudes=_amplitudes(robot, lines_ / period_s, speed_rms, spectrum),
        phases=np.random.default_rng(seed).uniform(
            0, 2 * np.pi, (realizations, len(lines_), robot.n_m)
        ),
        periods=periods,
        transients=transients,
        hardware=hardware,
        controller=default_cascade(robot, hardware.sample_s + hardware.delay_s),
        sensors=check_channels(robot, channels(robot) if sensors is None else sensors),
    )
    vector = ParameterVector(robot, free or default_free(robot))
    tell = progress if callable(progress) else None
    with limit_fit("excite", time_limit, tell, first="poses"):
        room = _Room(robot, obstacles, clearance)
        plan = _with_poses(plan, room, vector, poses, criterion, seed, progress)
        part_known("poses", 0.0, 0)
        whole = None
        with keep_best():
            whole = _predict_accuracy(plan, vector, room, spectrum)
        # without it the accuracy of the parameters is not known
        return whole or replace(plan, ended=reason_of_end())


def _amplitudes(
    model: RobotModel,
    frequencies: np.ndarray,
    speed_rms: float | Sequence[float],
    spectrum: float | str,
) -> np.ndarray:
    """Amplitudes (lines, n_m) of the motor speeds."""
    if not isinstance(spectrum, int | float) and spectrum != OPTIMAL:
        raise ArgumentError(
            f"spectrum: given {spectrum!r}, expected a power of the frequency, or {OPTIMAL!r}"
        )
    speed = motor_speeds(model, np.asarray(speed_rms, dtype=float))
    return speed_amplitudes(frequencies, speed, 0.5 if isinstance(spectrum, str) else spectrum)


def _check_counts(periods: int, transients: int, realizations: int) -> None:
    counts = {
        "periods": (periods, 2),
        "transients": (transients, 0),
        "realizations": (realizations, 1),
    }
    for name, (value, least) in counts.items():
        count_of(name, value, PERIODS, least)


def default_free(model: RobotModel) -> list[str]:
    """Stiffness and damping, and the viscous frictions that the model has; ArgumentError where it
    has none of them.
    """
    viscous = [f"{motor.name}.viscous" for motor in model.motors if motor.friction.viscous != 0.0]
    names = [name for name in (*FREE, *viscous) if has_group(model, name)]
    if not names:
        raise ArgumentError(
            f"free: given none, expected names: {model.title} has no springs or viscous friction"
        )
    return names


def default_cascade(model: RobotModel, sample_s: float = 5e-4) -> Cascade:
    """Gains from the motor inertias with all springs stiff: 8 Hz of speed control, position gain 8
    1/s.

    Less where the inertia that a motor moves at high frequencies, with all springs soft, is so
    small that a sampled control would be unstable; ``sample_s``: sample time and delay together.
    """
    home = np.array(model.home)
    equations = derive(model)
    linear = linearize(equations, hold_joints(equations, home))
    inertia, moved = motor_inertias(model, linear.M, linear.B, linear.C_m)
    gain = np.minimum(inertia * 2 * np.pi * BANDWIDTH, SAMPLED_GAIN * moved / sample_s)
    n = model.n_m
    return Cascade(np.full(n, POSITION_GAIN), gain, np.zeros(n))


def _band(
    model: RobotModel, f_min: float | None, f_max: float | None, hardware: DriveHardware
) -> tuple[float, float]:
    most = 0.2 / hardware.sample_s
    if f_min is None or f_max is None:
        equations = derive(model)
        linear = linearize(equations, hold_joints(equations, np.array(model.home)))
        squares = np.sort(np.abs(np.linalg.eigvals(np.linalg.solve(linear.M, linear.K))))[
            model.n_m :
        ]
        if len(squares) == 0:
            raise ArgumentError(
                f"f_min, f_max: the model {model.name} has no elastic natural frequency; name a "
                "band in Hz"
            )
        lowest, highest = np.sqrt(squares[[0, -1]]) / (2 * np.pi)
        f_min = lowest / 8 if f_min is None else f_min
        f_max = min(1.5 * highest, most) if f_max is None else f_max
    if f_max > 0.45 / hardware.sample_s:
        raise ArgumentError(
            f"f_max: given {f_max} Hz, expected at most {0.45 / hardware.sample_s:.4g} Hz for a "
            f"sample time of {hardware.sample_s} s"
        )
    return f_min, f_max


def _with_poses(
    plan: Plan,
    room: _Room,
    vector: ParameterVector,
    poses: int | Sequence[Sequence[float]] | np.ndarray,
    criterion: str,
    seed: int,
    progress: Choice,
) -> Plan:
    """The plan with its poses."""
    model = room.model
    tell = progress if callable(progress) else None
    if isinstance(poses, int | np.integer):
        if poses < 1 or criterion not in operating_points.CRITERIA:
            expected = ", ".join(operating_points.CRITERIA)
            raise ArgumentError(
                f"poses, criterion: given {poses!r}, {criterion!r}, expected >= 1 and one of "
                f"{expected}"
            )
        swing = _swing(plan)
        offered = operating_points.candidates(
            model, CANDIDATES if criterion != "random" else int(poses), seed
        )
        reasons = [room.left_at(pose, swing) for pose in offered]
        offered = offered[[reason is None for reason in reasons]]
        if len(offered) == 0:
            raise ArgumentError(
                f"speed_rms, obstacles: no pose has room for the motion; for example, "
                f"{reasons[0]}; expected less speed_rms or clearance"
            )
        if criterion == "random":
            plan = replace(plan, poses=offered)
        else:
            every = max(1, len(plan.lines) // 20)  # twenty lines tell which pose is better
            F, used = operating_points.information(
                vector, plan, offered, every=every, fewest=int(poses), progress=tell
            )
            ended = reason_of_end()
            chosen = operating_points.choose(F, int(poses), vector, criterion)
            plan = replace(plan, poses=offered[used[sorted(chosen)]], ended=ended)
    else:
        q_g = np.atleast_2d(np.asarray(poses, dtype=float))
        if q_g.ndim != 2 or q_g.shape[1] != model.n_g or not np.isfinite(q_g).all():
            raise ArgumentError(
                f"poses: given an array of shape {q_g.shape}, expected (poses, {model.n_g}) in "
                "rad or m"
            )
        plan = replace(plan, poses=q_g @ model.eta.T)
        _check_room(plan, room)
    _check_speeds(plan, model)
    return plan


def _check_room(plan: Plan, room: _Room) -> None:
    """ArgumentError where the motion leaves the limits of a joint, or comes near an obstacle."""
    swing = _swing(plan)
    for k, pose in enumerate(plan.poses):
        reason = room.left_at(pose, swing)
        if reason is not None:
            raise ArgumentError(
                f"pose {k + 1}: {reason}; take less speed_rms, a higher f_min, or another pose"
            )
    _check_speeds(plan, room.model)


def _predict_accuracy(
    plan: Plan, vector: ParameterVector, room: _Room, spectrum: float | str
) -> Plan:
    """The plan with its spectrum and the expected accuracy of the parameters."""
    if spectrum == OPTIMAL:
        plan = with_optimal_spectrum(plan, vector)
        _check_room(plan, room)
    F, _ = operating_points.information(vector, plan, plan.poses)
    sd = np.sqrt(np.diag(operating_points.covariance(F.sum(axis=0), vector.prior_sd)))
    return replace(plan, predicted=dict(zip(vector.names, sd.tolist(), strict=True)))


def _swing(plan: Plan) -> np.ndarray:
    """Largest deviation of each motor from the pose [rad], over all experiments, (n_m,)."""
    found = [
        np.abs(plan.reference(r, e)).max(axis=0)
        for r in range(plan.realizations)
        for e in range(plan.experiments)
    ]
    return np.max(found, axis=0)


class _Room:
    """Where a robot may move: within the limits of its joints, away from obstacles."""

    def __init__(self, model: RobotModel, obstacles: Sequence[Box], clearance: float) -> None:
        self.model = model
        self._around = Surroundings(model, obstacles, clearance)

    def left_at(self, pose: np.ndarray, swing: np.ndarray) -> str | None:
        """Why the motion by ``swing`` (n_m,) about a pose (n_m,) [rad, motor side] leaves the
        room, or None.
        """
        inverse = np.linalg.inv(self.model.eta)
        q = inverse @ pose
        moved = np.abs(inverse) @ swing
        for k, i in enumerate(self.model.i_g):
            dof = self.model.coordinates[i].dof
            assert dof is not None
            for limit, side in ((dof.lower, -1.0), (dof.upper, 1.0)):
                if limit is not None and side * (q[k] + side * moved[k] - limit) > 0:
                    return (
                        f"the motion of {dof.name} reaches {q[k] + side * moved[k]:.4g}, expected "
                        f"within {limit:.4g}"
                    )
        return self._around.find_contact(q, moved)


def _check_speeds(plan: Plan, model: RobotModel) -> None:
    """ArgumentError where a motor or a joint would have to be faster than its limit."""
    motors = np.zeros(model.n_m)
    joints = np.zeros(model.n_g)
    inverse = np.linalg.inv(model.eta).T
    for r in range(plan.realizations):
        for e in range(plan.experiments):
            q = plan.reference(r, e)
            speed = np.diff(np.vstack([q, q[:1]]), axis=0) / plan.hardware.sample_s
            motors = np.maximum(motors, np.abs(speed).max(axis=0))
            joints = np.maximum(joints, np.abs(speed @ inverse).max(axis=0))
    limits = [
        (f"motor {m.name}", m.speed_max, float(v))
        for m, v in zip(model.motors, motors, strict=True)
    ]
    for i, v in zip(model.i_g, joints, strict=True):
        dof = model.coordinates[i].dof
        limits.append(
            (
                f"joint {model.coordinates[i].name}",
                None if dof is None else dof.speed_max,
                float(v),
            )
        )
    for name, limit, largest in limits:
        if limit is not None and largest > limit:
            raise ArgumentError(
                f"speed_rms: {name} would reach {largest:.4g}, expected at most {limit:.4g} "
                "(speed_max, rad/s or m/s); take less speed_rms"
            )


def _name(model: RobotModel) -> str:
    return (model.file or model.name) + (f"@{model.variant}" if model.variant else "")
