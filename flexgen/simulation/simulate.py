"""Forward simulation of the full model under given motor torques: the verification of inverse
dynamics.

The integrator (explicit Runge-Kutta of order 8 by Dormand and Prince, tight tolerance; an implicit
method for stiff problems) and the Lagrange equations that it integrates share no code with the
solvers.
The torque is a quintic spline through the samples or, where limits are active, the polynomials
that it was sampled from; if there are none, a monotone cubic that stays within the limits. Work
and losses are integrated too. The energy balance

    E(t) - E(0) = int P_motor dt - int P_dissipated dt

verifies the integration.

Where perturbations of the open loop grow by more than `open_loop.UNSTABLE` over the move, no
open-loop simulation measures the error of the torques, and no robot can be moved by them alone.
There the whole move is simulated with motor feedback around the torques
(`flexgen.simulation.motor_feedback`), and once more without it.

Source: E. Hairer, S. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 1993, sec.
II.5 (DOP853).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from flexgen.base.calls.deadline import check_time, limit_call
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import TimeLimit
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.torque_curve import (
    constant,
    side_by_side,
    spline,
    then_constant,
    torque_curve,
)
from flexgen.base.motion.trajectory import Trajectory, channel_values, convert_to_si
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import channel_units, output_labels, output_units
from flexgen.dynamics.mechanics.statics import Equilibrium
from flexgen.model.elements import RobotModel
from flexgen.model.friction import memory_laws
from flexgen.simulation.integration.hold import SAME, TorqueCommand, command_in
from flexgen.simulation.motor_feedback import MotorFeedback, default_feedback
from flexgen.simulation.result import Simulation, growth_text, output_error, record_motion
from flexgen.simulation.run import Input, Run, run
from flexgen.simulation.start import start_state

if TYPE_CHECKING:
    from flexgen.simulation.environment.wall import Wall
    from flexgen.simulation.verification.growth import Growth

FORCE = 6  # entries of a force and a torque on the tool
# of the meta data: how long the verification of a solution holds its last torque
HELD_KEY = "held_s"
# s: of a torque that is held after the end, and the step at which errors are taken
HELD_MAX = 60.0
HELD_STEP = 2e-3
RTOL = 1e-11  # a tenth of a nanometer over a meter of reach and a thousand steps
# of its span: a trajectory that begins later is one with a clock such as seconds since 1970
FAR = 1e6
FALLEN = 0.1  # rad, m: a robot falls where rounding errors grow to this size
AUTO = "auto"
NONE = "none"
PPI = "ppi"
FEEDBACKS = (AUTO, NONE, PPI)


def _read_channels(
    model: RobotModel, data: Trajectory, moving: bool = False
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The channels that a simulation needs, with columns in the order of the model, and warnings:
    a start that is not at rest (unless ``moving``), or another model. ArgumentError for missing or
    wrong ones.
    """
    names_m = tuple(m.name for m in model.motors)
    of_a = {c.name: c.unit for c in model.coordinates}
    wanted = {
        "tau_m": dict.fromkeys(names_m, "N m"),
        "q_a": of_a,
        "q_m": dict.fromkeys(names_m, "rad"),
    }
    found = {}
    for name, units in wanted.items():
        if name not in data.channels:
            raise ArgumentError(
                f"trajectory: channel {name} is missing; write one with 'flexgen solve "
                f"{model.name} --out FILE'"
            )
        found[name] = channel_values("trajectory", data, name, units)
    outputs = output_labels(model)
    if "y_ref" in data.channels:
        units = dict(zip(outputs["y_ref"], output_units(model), strict=True))
        found["y_ref"] = channel_values("trajectory", data, "y_ref", units)
    for name, labels in outputs.items():
        if name not in data.channels or name in found:
            continue
        if sorted(data.labels[name]) != sorted(labels) or not np.isfinite(data[name]).all():
            raise ArgumentError(
                f"trajectory channel {name}: given columns {', '.join(data.labels[name])}, "
                f"expected {', '.join(labels)} of finite numbers"
            )
        found[name] = data[name][:, [data.labels[name].index(label) for label in labels]]
    if "force" in data.channels:
        from flexgen.paths.force.tool_force import read_force

        found["force"] = read_force(data)
    warnings = []
    if not moving and "v_a" in data.channels and np.abs(data["v_a"][0]).max() > 1e-6:
        warnings.append(
            "the trajectory does not start at rest; the simulation does: expect an error at the "
            "start"
        )
    for key, own in (("model", model.name), ("variant", model.variant)):
        other = data.meta.get(key, own)
        if other != own:
            warnings.append(
                f"the trajectory was written for {key} {other or 'none'!r}, this is "
                f"{own or 'none'!r}"
            )
    return found, tuple(warnings)


@checked_types
@reported("simulate")
def simulate(
    model: str | FilePath | RobotModel | Equations,
    trajectory: Trajectory | str | FilePath,
    *,
    start: Equilibrium | None = None,
    rtol: float = RTOL,
    held: float | None = None,
    command: TorqueCommand | None = None,
    moving: bool = False,
    feedback: str = AUTO,
    wall: Wall | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> Simulation:
    """Simulate the full model from equilibrium under the torque of a trajectory.

    A solution that was saved gives the errors that `flexgen.solve` states.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    trajectory : Trajectory or path
        File written by 'flexgen solve --out'. Or a trajectory with the channels ``tau_m`` (n, n_m)
        [N m, motor side; held where the meta data state it], and ``q_a``, ``q_m``, whose first
        samples are the equilibrium at the start; with ``y_ref`` (and ``R_ref``) the output's error
        is computed.
    start : Equilibrium, optional
        Equilibrium at the start; default: the first sample of the trajectory.
    rtol : float
        Relative tolerance of the integrator.
    held : float, optional
        How long [s] the last torque is held after the trajectory; errors and energy cover this
        time. Default: as long as in the verification, where the trajectory is a solution, else 0.
    command : TorqueCommand, optional
        The torques that a controller sends instead of those of the trajectory, see
        `Solution.torque_command`.
    moving : bool
        Start with the speeds of the first sample, not at rest.
    feedback : str
        ``"auto"``: with motor feedback where perturbations of the open loop grow by more than 100
        over the move (known where the trajectory has the channels ``v_a a_a v_m a_m``), and once
        more without it as far as rounding errors do not grow to its size; ``"ppi"``: with it;
        ``"none"``: open loop. See `flexgen.simulation.motor_feedback`.
    wall : Wall, optional
        A wall that pushes the tool. Its force on the tool is the channel ``contact`` of the
        result.
    time_limit : float, optional
        Time limit [s], after which it ends without a result; default: no limit. The result is that
        of the whole motion. None or 0: unlimited.
    progress : callable or bool, optional
        Called with a line of text; True, False: show messages or not; default: on a terminal and
        in a notebook.

    Returns
    -------
    Simulation

    Raises
    ------
    ArgumentError
        The trajectory does not belong to the model.
    OutOfTime
        The time limit is over.
    SolverError
        The integration failed; the text gives the time.

    Examples
    --------
    >>> motion = flexgen.simulate("elbow", flexgen.solve("elbow").trajectory)
    >>> motion.tool_error_max_m < 1e-6
    True
    """
    from flexgen.simulation import open_loop

    with limit_call("simulate", time_limit):
        equations = model if isinstance(model, Equations) else derive(model)
        data = _check_choices(trajectory, rtol, held, feedback)
        if abs(data.time[0]) > FAR * np.ptp(data.time):
            options = {
                "rtol": rtol,
                "held": held,
                "feedback": feedback,
                "progress": progress,
                "wall": wall,
            }
            return _simulate_late(
                equations, data, command, options | {"start": start, "moving": moving}
            )
        data = convert_to_si("trajectory", data, channel_units(equations.model))
        given, warnings = _read_channels(equations.model, data, moving)
        given |= {} if wall is None else _before_wall(wall, equations, given)
        task = _task(
            equations,
            data,
            given,
            start,
            moving,
            float(data.meta.get(HELD_KEY, 0.0)) if held is None else held,
        )
        task = _push(
            replace(
                task, command=_command(equations.model, data, given["tau_m"], command), wall=wall
            )
        )
        tell = progress if callable(progress) else None
        growth = None
        known = dict[str, Any]()
        if feedback == AUTO:
            growth, known = open_loop.analyze(
                equations, data, task.given, task.held, task.command is None
            )
        known = {"warnings": warnings} | (known if wall is None else {})
        if feedback == NONE or (
            feedback == AUTO and (growth is None or growth.whole <= open_loop.UNSTABLE)
        ):
            return replace(
                open_loop.without_lost_errors(
                    _simulate_once(task, open_loop.precise(rtol, growth), None, tell), growth
                ),
                **known,
            )
        chosen = default_feedback(equations, given["q_a"][0], given["q_m"][0], given["tau_m"][0])
        if growth is not None:
            known["warnings"] = (*warnings, _growth_warning(growth, chosen))
        closed = _simulate_once(task, rtol, chosen, tell)
        return replace(closed, open_loop=_simulate_open_loop(task, rtol, growth, tell), **known)


def _simulate_late(
    equations: Equations, data: Trajectory, command: TorqueCommand | None, options: dict[str, Any]
) -> Simulation:
    """The simulation from time zero on: steps of an integrator can be below the resolution of a
    time far from it.
    """
    late = float(data.time[0])
    sent = None if command is None else replace(command, time=command.time - late)
    near = simulate(equations, replace(data, time=data.time - late), command=sent, **options)
    alone = near.open_loop and _shift(near.open_loop, late)
    return replace(_shift(near, late), open_loop=alone)


def _shift(run: Simulation, late: float) -> Simulation:
    return replace(run, trajectory=replace(run.trajectory, time=run.trajectory.time + late))


def _simulate_open_loop(
    task: _Task, rtol: float, growth: Growth | None, progress: Callable[[str], None] | None
) -> Simulation | None:
    """The simulation without feedback; None where rounding errors grow to the size of its error,
    or it fails. ``rtol`` is lowered by the growth of perturbations.
    """
    from flexgen.simulation import open_loop

    floor = open_loop.ROUNDING if growth is None else growth.whole * open_loop.ROUNDING
    if floor > FALLEN:
        return None
    try:
        alone = _simulate_once(task, open_loop.precise(rtol, growth), None, progress)
    except SolverError:
        return None
    found = max(alone.tool_error_max_m or 0.0, alone.tool_error_max_rad or 0.0)
    return (
        open_loop.without_lost_errors(alone, growth)
        if found >= open_loop.RESOLVED * floor
        else None
    )


@dataclass(frozen=True)
class _Task:
    """Inputs of a simulation: ``t`` and ``given`` with the time after the end; ``begin``: the
    state at the start.
    """

    equations: Equations
    data: Trajectory
    t: np.ndarray
    given: dict[str, np.ndarray]
    begin: np.ndarray
    held: float
    command: TorqueCommand | None = None
    wall: Wall | None = None


def _task(
    equations: Equations,
    data: Trajectory,
    given: dict[str, np.ndarray],
    start: Equilibrium | None,
    moving: bool,
    held: float,
) -> _Task:
    """Input of one simulation: instants and channels, with the time ``held`` [s] after the end,
    and the first state, at rest or ``moving``.
    """
    t, longer = _with_held_end(data.time, given, held)
    return _Task(
        equations, data, t, longer, start_state(equations.model, data, given, start, moving), held
    )


def _before_wall(
    wall: Wall, equations: Equations, given: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """The force on the tool without the wall; ArgumentError where the tool begins behind it."""
    from flexgen.simulation.environment.wall import check_start

    check_start(wall, equations, given["q_a"][0])
    return {"force": given.get("force", np.zeros((len(given["q_a"]), FORCE)))}


def _push(task: _Task) -> _Task:
    """The task with equations for the force on its tool."""
    equations = task.equations
    if task.wall is not None:
        from flexgen.simulation.environment.wall import contact_function

        return replace(task, equations=equations.touching(contact_function(task.wall, equations)))
    return replace(task, equations=equations.pushed) if "force" in task.given else task


def _simulate_once(
    task: _Task,
    rtol: float,
    feedback: MotorFeedback | None,
    progress: Callable[[str], None] | None,
) -> Simulation:
    """One simulation of the whole move and the time after it, under torques of samples or of a
    command, with a relative tolerance ``rtol``.
    """
    began = time.perf_counter()
    equations = task.equations
    robot = task.equations.model
    n_a = robot.n_a
    i_m = list(robot.i_m)
    n = robot.dof
    command = task.command
    count = len(task.data.time)
    applied = task.given["tau_m"] if command is None else command.at(task.t)
    corner = [count - 1] if task.held > 0.0 else []
    instants, own, corners = _with_edges(task.t, corner, command)
    source = _input(task, feedback)
    found = run(equations, instants, source, task.begin, corners, rtol, feedback, progress)
    states = found.states[own]
    q_a = states[:, :n_a]
    v_a = states[:, n : n + n_a]
    q_m, v_m = (part[:, list(robot.i_g)] @ robot.eta.T for part in (q_a, v_a))
    q_m[:, i_m] = states[:, n_a:n]
    v_m[:, i_m] = states[:, n + n_a : 2 * n]
    in_m, in_rad, recorded = record_motion(
        equations, task.data, {**task.given, "tau_m": applied}, (q_a, v_a, q_m, v_m)
    )
    if task.wall is not None:
        from flexgen.simulation.environment.wall import add_contact

        recorded = add_contact(task.wall, equations, recorded)
    check_time("simulation of the time after the end")
    later_m, later_rad = _later_errors(task, found, (in_m, in_rad))
    return Simulation(
        trajectory=recorded,
        tool_error_max_m=in_m,
        tool_error_max_rad=in_rad,
        energy_error=_energy_error(
            equations, (q_a, v_a, q_m, v_m), *states[:, 2 * n : 2 * n + 2].T
        ),
        torque_max_Nm=float(np.abs(applied).max()),
        speed_max_rad_s=float(np.abs(v_m).max()),
        evaluations=found.evaluations,
        wall_s=time.perf_counter() - began,
        integrator=found.integrator,
        held_s=task.held,
        later_error_max_m=later_m,
        later_error_max_rad=later_rad,
        feedback=feedback,
    )


def _later_errors(
    task: _Task, found: Run, before: tuple[float | None, float | None]
) -> tuple[float | None, float | None]:
    """Largest errors of the output until `AFTER` after the end [m], [rad], with those until
    ``held`` after it, ``before``; None where they are not measured.
    """
    from flexgen.simulation.after_end import errors_after_end, simulate_after_end

    if task.held <= 0.0 or "y_ref" not in task.given:
        return None, None
    n_a = task.equations.model.n_a
    follow = simulate_after_end if memory_laws(task.equations.model) else errors_after_end
    q_a = follow(found, float(task.t[-1]), task.held)[:, :n_a]
    last = {name: np.repeat(values[-1:], len(q_a), axis=0) for name, values in task.given.items()}
    _, in_m, in_rad = output_error(task.equations, last, q_a)
    pairs = zip((in_m, in_rad), before, strict=True)
    later = [None if x is None or y is None else max(x, y) for x, y in pairs]
    return later[0], later[1]


def _check_choices(trajectory: Any, rtol: float, held: float | None, feedback: str) -> Trajectory:
    """The trajectory; ArgumentError for an argument that is out of range."""
    if not isinstance(trajectory, Trajectory | str | FilePath):
        raise ArgumentError(
            f"trajectory: given {type(trajectory).__name__}, expected a Trajectory or the path "
            "of a file"
        )
    if not 1e-14 < rtol < 1e-2:
        raise ArgumentError(
            f"rtol: given {rtol}, expected a relative tolerance between 1e-14 and 1e-2"
        )
    if held is not None and not 0.0 <= held <= HELD_MAX:
        raise ArgumentError(f"held: given {held}, expected a time between 0 and {HELD_MAX:g} s")
    if feedback not in FEEDBACKS:
        raise ArgumentError(
            f"feedback: given {feedback!r}, expected one of {', '.join(FEEDBACKS)}"
        )
    return trajectory if isinstance(trajectory, Trajectory) else Trajectory.load(trajectory)


def _command(
    robot: RobotModel, data: Trajectory, tau_m: np.ndarray, command: TorqueCommand | None
) -> TorqueCommand | None:
    """Torques that a controller sends: as given, or as the meta data of the trajectory state for
    its samples ``tau_m`` (n, n_m) [N m]; None: the continuous torque of the samples.
    """
    sent = command or command_in(
        data.time, tau_m, tuple(motor.name for motor in robot.motors), data.meta
    )
    return None if sent is None else _check_command(robot, sent)


def _input(task: _Task, feedback: MotorFeedback | None) -> Input:
    """The input of the rate between two instants, as a polynomial: motor torques, with feedback
    also the motors' reference angles and speeds, and the force on the tool behind them; references
    are constant after the end.
    """
    torque = (
        _hold_curve(task.data, task.given["tau_m"])
        if task.command is None
        else task.command.between
    )
    if feedback is None and "force" not in task.given:
        return torque
    q_m = task.given["q_m"]
    samples = q_m[: len(task.data.time)]
    angles = spline(task.data.time, samples)
    speeds = then_constant(angles.derivative(), np.zeros(samples.shape[1]))
    angles = then_constant(angles, samples[-1])
    more = []
    if "force" in task.given:
        from flexgen.paths.force.tool_force import interpolate_force

        more = [interpolate_force(task.data.time, task.given["force"])]
        angles, speeds = (
            (constant(0.0 * samples[0], *angles.x[[0, -1]]),) * 2
            if feedback is None
            else (angles, speeds)
        )
    return lambda begin, finish: side_by_side(
        [torque(begin, finish), angles, speeds, *more], begin, finish
    )


def _check_command(robot: RobotModel, command: TorqueCommand) -> TorqueCommand:
    """The command; ArgumentError where it has other motors or does not fit together."""
    names = tuple(motor.name for motor in robot.motors)
    n = len(command.time)
    if command.labels != names or command.values.shape != (n, len(names)) or n < 2:
        raise ArgumentError(
            f"command: given {command.values.shape} torques of {', '.join(command.labels)} at "
            f"{n} ticks, expected torques of {', '.join(names)} at two ticks or more"
        )
    if not (np.isfinite(command.values).all() and (np.diff(command.time) > 0).all()):
        raise ArgumentError(
            "command: given NaN, infinity or ticks that do not increase, expected finite torques"
        )
    return command


def _with_edges(
    t: np.ndarray, corners: list[int], command: TorqueCommand | None
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """All instants [s] of the integration, which of them are those in ``t``, and the numbers of
    those at which the input is not smooth: the ``corners`` and the edges of a held command. An
    edge next to a sample is moved onto it.
    """
    if command is None:
        return t, np.arange(len(t)), corners
    edges = command.edges
    edges = edges[(edges > t[0]) & (edges < t[-1])]
    nearest = t[np.searchsorted((t[:-1] + t[1:]) / 2, edges)]
    edges = np.where(np.abs(nearest - edges) < SAME * command.sample_time, nearest, edges)
    instants = np.unique(np.concatenate([t, edges]))
    own = np.searchsorted(instants, t)
    return (
        instants,
        own,
        sorted(
            {*(int(own[k]) for k in corners), *(int(k) for k in np.searchsorted(instants, edges))}
        ),
    )


def _hold_curve(data: Trajectory, torque: np.ndarray) -> Input:
    """The motor torque at an instant, its last value after the end."""
    samples = torque[: len(data.time)]
    curve = torque_curve(data.time, samples, limited=data.meta.get("torque") == "limited")
    held = then_constant(curve, samples[-1])
    return lambda begin, finish: held


def _with_held_end(
    t: np.ndarray, given: dict[str, np.ndarray], held: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Instants [s] and channels with ``held`` [s] of time after the end, in which all keep their
    last values.
    """
    more = int(np.ceil(held / HELD_STEP))
    later = t[-1] + held * np.arange(1, more + 1) / max(more, 1)
    return np.concatenate([t, later]), {
        name: np.concatenate([x, np.repeat(x[-1:], more, axis=0)]) for name, x in given.items()
    }


def _growth_warning(growth: Growth, feedback: MotorFeedback) -> str:
    """The warning of a robot that torques alone do not move."""
    grow = growth_text(growth.movement, growth.whole)
    return (
        f"the open loop is unstable: perturbations grow {grow}; the tool error is that with "
        f"{feedback.title}"
    )


def _energy_error(
    equations: Equations, motion: tuple[np.ndarray, ...], work: np.ndarray, loss: np.ndarray
) -> float:
    """Largest violation of the energy balance, relative to the energy exchanged: kinetic and
    potential energy less ``work`` plus ``loss`` (n,) [J] is constant along ``q_a, v_a, q_m, v_m``.
    """
    energies = [x.reshape(len(work)) for x in evaluate(equations.function("energy"), *motion)]
    total = energies[0] + energies[1]
    imbalance = total - total[0] - work + loss
    # rounding of constant energies is not a violation
    exchanged = max(
        np.ptp(energies[0]), np.ptp(energies[1]), np.ptp(work), 1e-6 * np.abs(total).max(), 1e-9
    )
    return float(np.abs(imbalance).max() / exchanged)
