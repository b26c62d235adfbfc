"""Forward simulation of the full model under a given motor torque: the verification of inverse dynamics.

The integrator (explicit Runge-Kutta of order 8 by Dormand and Prince, tight tolerance; an implicit method for stiff
problems) and the Lagrange equations that it integrates share no code with the solvers.
The torque is a quintic spline through the samples or, where limits are active, the polynomials that it was sampled
from; if there are none, a monotone cubic that stays within the limits. Work and losses are integrated too. The energy
balance

    E(t) - E(0) = int P_motor dt - int P_dissipated dt

verifies the integration.

If perturbations of the open loop grow by more than 1e5 over the move, the verification integrates in windows. Each
window starts in a state of the solution; the distance between the end of a window and the start of the next one is an
error too.

Source: E. Hairer, S. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 1993, sec. II.5 (DOP853).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.mechanics.equations import Equations, derive
from flexgen.mechanics.statics import Equilibrium
from flexgen.model.elements import RobotModel
from flexgen.model.output_columns import output_labels, output_units
from flexgen.numerics.evaluate import evaluate
from flexgen.numerics.rotations import turn_angle
from flexgen.ports import Port
from flexgen.progress import Choice, reported
from flexgen.simulation.growth import LARGEST_GROWTH, Growth, Motion, growth_along
from flexgen.simulation.hold import SAME, TorqueCommand, command_in, extended
from flexgen.simulation.open_loop import TorqueInput, run_windows
from flexgen.simulation.start import start_state
from flexgen.simulation.torque_curve import then_constant, torque_curve
from flexgen.trajectory import Trajectory
from flexgen.trajectory_files import common_unit

HELD_MAX, HELD_STEP = 60.0, 2e-3  # s: of a torque that is held after the end, and the step at which errors are taken
RTOL, ATOL = 1e-11, 1e-12  # a tenth of a nanometer over a meter of reach and a thousand steps


@dataclass(frozen=True, repr=False)
class Simulation:
    """Motion of the robot under the torque.

    Attributes
    ----------
    trajectory : Trajectory
        Channels ``q_a v_a q_m v_m tau_m`` and, where the reference was given, ``error`` of the output.
    tool_error_max_m, tool_error_max_rad : float or None [m], [rad]
        Largest error of the output; None without reference, or where the output has no such part.
    energy_error : float
        Largest violation of the energy balance, relative to the energy exchanged.
    torque_max_Nm, speed_max_rad_s : float [N m], [rad/s]
        Largest torque and speed of a motor, motor side.
    evaluations : int
        Of the right-hand side.
    wall_s : float [s]
    warnings : tuple of str
    windows : int
        Number of separate integrations.
    growth : float or None
        Growth of perturbations of the open loop over the move; None where it was not estimated.
    window_gap : float [rad or m]
        Largest distance of a coordinate (motors: arm side) between the end of a window and the start of the next.
    integrator : str
        ``DOP853``, or ``LSODA`` where the problem is stiff.
    """

    trajectory: Trajectory
    tool_error_max_m: float | None
    tool_error_max_rad: float | None
    energy_error: float
    torque_max_Nm: float
    speed_max_rad_s: float
    evaluations: int
    wall_s: float
    warnings: tuple[str, ...] = ()
    windows: int = 1
    growth: float | None = None
    window_gap: float = 0.0
    integrator: str = "DOP853"

    def __repr__(self) -> str:
        errors = [
            f"{e:.3g} {u}" for e, u in ((self.tool_error_max_m, "m"), (self.tool_error_max_rad, "rad")) if e is not None
        ]
        return f"<Simulation {self.trajectory.meta.get('model', '')}: tool error {', '.join(errors) or 'not measured'}>"


def _checked(
    model: RobotModel, data: Trajectory, moving: bool = False
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The channels that a simulation needs, with columns in the order of the model, and warnings."""
    names_m, of_a = tuple(m.name for m in model.motors), {c.name: c.unit for c in model.coordinates}
    wanted = {
        "tau_m": (names_m, dict.fromkeys(names_m, "N m")),
        "q_a": (tuple(of_a), of_a),
        "q_m": (names_m, dict.fromkeys(names_m, "rad")),
    }
    found = {}
    for name, (labels, units) in wanted.items():
        if name not in data.channels:
            raise ArgumentError(
                f"trajectory: channel {name} is missing; write one with 'flexgen solve {model.name} --out FILE'"
            )
        if sorted(data.labels[name]) != sorted(labels):
            raise ArgumentError(
                f"trajectory channel {name}: given columns {', '.join(data.labels[name])}, expected "
                f"{', '.join(labels)} for model {model.name}; take the model that it was written for"
            )
        for label, unit in zip(data.labels[name], data.units[name], strict=True):
            if unit != units[label] and not (name == "q_a" and unit == "rad or m"):
                raise ArgumentError(
                    f"trajectory channel {name}: given in {unit}, expected in {units[label]} (column {label})"
                )
        if not np.isfinite(data[name]).all():
            raise ArgumentError(f"trajectory channel {name}: given NaN or infinity, expected finite numbers")
        found[name] = data[name][:, [data.labels[name].index(label) for label in labels]]
    for name, labels in output_labels(model).items():
        if name not in data.channels:
            continue
        if sorted(data.labels[name]) != sorted(labels) or not np.isfinite(data[name]).all():
            raise ArgumentError(
                f"trajectory channel {name}: given columns {', '.join(data.labels[name])}, expected "
                f"{', '.join(labels)} of finite numbers"
            )
        found[name] = data[name][:, [data.labels[name].index(label) for label in labels]]
    warnings = []
    if not moving and "v_a" in data.channels and np.abs(data["v_a"][0]).max() > 1e-6:
        warnings.append("the trajectory does not start at rest; the simulation does: expect an error at the start")
    for key, own in (("model", model.name), ("variant", model.variant)):
        other = data.meta.get(key, own)
        if other != own:
            warnings.append(f"the trajectory was written for {key} {other or 'none'!r}, this is {own or 'none'!r}")
    return found, tuple(warnings)


@reported("simulate")
def simulate(
    model: str | FilePath | RobotModel | Equations,
    trajectory: Trajectory | str | FilePath,
    *,
    start: Equilibrium | None = None,
    rtol: float = RTOL,
    windows: bool = False,
    held: float = 0.0,
    command: TorqueCommand | None = None,
    moving: bool = False,
    progress: Choice = None,
) -> Simulation:
    """Simulate the full model from equilibrium under the torque of a trajectory.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    trajectory : Trajectory or path
        Channels ``tau_m`` (n, n_m) [N m, motor side; held where the meta data state it], and ``q_a``, ``q_m``, whose
        first samples are the equilibrium at the start; with ``y_ref`` (and ``R_ref``) the output's error is computed.
    start : Equilibrium, optional
        Equilibrium at the start; default: the first sample of the trajectory.
    rtol : float
        Relative tolerance of the integrator.
    windows : bool
        Verify a solution of this model. If perturbations of the open loop grow by more than 1e5 over the move, restart
        from states of the trajectory (channels ``v_a a_a v_m a_m``): the growth in each window is at most 1e3.
    held : float
        How long [s] the last torque is held after the trajectory; errors and energy cover this time.
    command : TorqueCommand, optional
        The torques that a controller sends instead of those of the trajectory, see `Solution.torque_command`.
    moving : bool
        Start with the speeds of the first sample, not at rest.

    Returns
    -------
    Simulation

    Raises
    ------
    ArgumentError
        The trajectory does not belong to the model.
    SolverError
        The integration failed; the text gives the time.
    """
    equations = model if isinstance(model, Equations) else derive(model)
    _check_choices(trajectory, rtol, held)
    data = trajectory if isinstance(trajectory, Trajectory) else Trajectory.load(trajectory)
    began, robot = time.perf_counter(), equations.model
    given, warnings = _checked(robot, data, moving)
    torque, command = _torque(robot, data, given["tau_m"], command)
    t, given = _with_held_end(data.time, given, held)
    applied = given["tau_m"] if command is None else command.at(t)
    n_a, i_m, n = robot.n_a, list(robot.i_m), robot.dof
    motion = _motion(robot, data, t, given) if windows else None
    growth = None if motion is None else growth_along(equations, motion)
    begin = start_state(robot, data, given, start, moving)
    starts = _starts(begin, motion, growth, i_m, len(data.time) - 1 if held > 0.0 else None)
    instants, own, starts = _with_edges(t, _with_ripple(equations, data, t, starts, command), command)
    run = run_windows(equations, instants, torque, starts, rtol, ATOL, progress if callable(progress) else None)
    states = run.states[own]
    q_a, v_a = states[:, :n_a], states[:, n : n + n_a]
    q_m, v_m = (part[:, list(robot.i_g)] @ robot.eta.T for part in (q_a, v_a))
    q_m[:, i_m], v_m[:, i_m] = states[:, n_a:n], states[:, n + n_a : 2 * n]
    in_m, in_rad, recorded = _recorded(equations, data, {**given, "tau_m": applied}, (q_a, v_a, q_m, v_m))
    return Simulation(
        trajectory=recorded,
        tool_error_max_m=in_m,
        tool_error_max_rad=in_rad,
        energy_error=_energy_error(equations, (q_a, v_a, q_m, v_m), run.start_energy[own], *states[:, 2 * n :].T),
        torque_max_Nm=float(np.abs(applied).max()),
        speed_max_rad_s=float(np.abs(v_m).max()),
        evaluations=run.evaluations,
        wall_s=time.perf_counter() - began,
        warnings=(*warnings, *_growth_warning(growth)),
        windows=sum(state is not None for _, state in starts),
        growth=None if growth is None else growth.largest,
        window_gap=run.gap,
        integrator=run.integrator,
    )


def _check_choices(trajectory: Any, rtol: float, held: float) -> None:
    """ArgumentError for an argument that is out of range."""
    if not isinstance(trajectory, Trajectory | str | FilePath):
        raise ArgumentError(
            f"trajectory: given {type(trajectory).__name__}, expected a Trajectory or the path of a file"
        )
    if not 1e-14 < rtol < 1e-2:
        raise ArgumentError(f"rtol: given {rtol}, expected a relative tolerance between 1e-14 and 1e-2")
    if not 0.0 <= held <= HELD_MAX:
        raise ArgumentError(f"held: given {held}, expected a time between 0 and {HELD_MAX:g} s")


def _starts(
    start: np.ndarray, motion: Motion | None, growth: Growth | None, i_m: list[int], corner: int | None
) -> list[tuple[int, np.ndarray | None]]:
    """Samples at which windows begin, with their states; at the torque's ``corner`` integration starts again."""
    starts: list[tuple[int, np.ndarray | None]] = [(0, start)]
    if motion is not None and growth is not None:
        x = np.hstack([motion.q_a, motion.q_m[:, i_m], motion.v_a, motion.v_m[:, i_m]])
        starts += [(first, x[first]) for first in growth.starts[1:]]
    if corner is not None:
        starts = sorted([*starts, (corner, None)], key=lambda one: (one[0], one[1] is not None))
    return starts


def _torque(
    robot: RobotModel, data: Trajectory, tau_m: np.ndarray, command: TorqueCommand | None
) -> tuple[TorqueInput, TorqueCommand | None]:
    """The torque that acts, and what a controller sends for it: as given, or as the trajectory states; or None."""
    sent = command or command_in(data.time, tau_m, tuple(motor.name for motor in robot.motors), data.meta)
    return _held_curve(data, tau_m) if sent is None else _checked_command(robot, sent), sent


def _checked_command(robot: RobotModel, command: TorqueCommand) -> TorqueInput:
    """The torque of a command; ArgumentError where it has other motors or does not fit together."""
    names = tuple(motor.name for motor in robot.motors)
    n = len(command.time)
    if command.labels != names or command.values.shape != (n, len(names)) or n < 2:
        raise ArgumentError(
            f"command: given {command.values.shape} torques of {', '.join(command.labels)} at {n} ticks, expected "
            f"torques of {', '.join(names)} at two ticks or more"
        )
    if not (np.isfinite(command.values).all() and (np.diff(command.time) > 0).all()):
        raise ArgumentError("command: given NaN, infinity or ticks that do not increase, expected finite torques")
    return command.between


def _with_edges(
    t: np.ndarray, starts: list[tuple[int, np.ndarray | None]], command: TorqueCommand | None
) -> tuple[np.ndarray, np.ndarray, list[tuple[int, np.ndarray | None]]]:
    """All instants of the integration, which of them are those in ``t``, and the starts with those at the edges."""
    if command is None:
        return t, np.arange(len(t)), starts
    edges = command.edges
    edges = edges[(edges > t[0]) & (edges < t[-1])]
    nearest = t[np.searchsorted((t[:-1] + t[1:]) / 2, edges)]
    edges = np.where(np.abs(nearest - edges) < SAME * command.sample_time, nearest, edges)
    instants = np.unique(np.concatenate([t, edges]))
    own = np.searchsorted(instants, t)
    moved = [(int(own[first]), state) for first, state in starts]
    taken = {first for first, _ in moved}
    corners = [(int(k), None) for k in np.searchsorted(instants, edges) if k not in taken]
    return instants, own, sorted([*moved, *corners], key=lambda one: (one[0], one[1] is not None))


def _with_ripple(
    equations: Equations,
    data: Trajectory,
    t: np.ndarray,
    starts: list[tuple[int, np.ndarray | None]],
    command: TorqueCommand | None,
) -> list[tuple[int, np.ndarray | None]]:
    """The starts of later windows with the velocities that a motion under the held torque has at these instants."""
    if command is None:
        return starts
    rate, n = equations.function("state_rate"), equations.model.dof
    curve = extended(data.time, data["tau_m"], data.meta.get("torque") == "limited")
    out = starts[:1]
    for first, state in starts[1:]:
        if state is not None:
            ripple = command.ripple(t[first], curve)
            change = np.array(rate(state, ripple) - rate(state, 0 * ripple)).ravel()
            state = state + np.concatenate([np.zeros(n), change[n:]])
        out.append((first, state))
    return out


def _held_curve(data: Trajectory, torque: np.ndarray) -> TorqueInput:
    """The motor torque at an instant, its last value after the end."""
    curve = torque_curve(data.time, torque, limited=data.meta.get("torque") == "limited")
    held = then_constant(curve, torque[-1])
    return lambda begin, finish: held


def _with_held_end(
    t: np.ndarray, given: dict[str, np.ndarray], held: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Instants and channels with those of the time after the end, where all keep their last values."""
    more = int(np.ceil(held / HELD_STEP))
    later = t[-1] + held * np.arange(1, more + 1) / max(more, 1)
    return np.concatenate([t, later]), {
        name: np.concatenate([x, np.repeat(x[-1:], more, axis=0)]) for name, x in given.items()
    }


def _growth_warning(growth: Growth | None) -> tuple[str, ...]:
    """The warning of a verification in windows."""
    if growth is None or growth.largest <= LARGEST_GROWTH:
        return ()
    return (
        f"the open loop is unstable: perturbations grow by a factor of {growth.largest:.1e} over the move; the torques "
        f"were verified in {len(growth.starts)} windows, each from a state of the solution; use feedback",
    )


def _motion(robot: RobotModel, data: Trajectory, t: np.ndarray, given: dict[str, np.ndarray]) -> Motion | None:
    """The motion of a trajectory at the instants ``t``, at rest after its end; None without speeds or accelerations."""
    names = {"a": tuple(c.name for c in robot.coordinates), "m": tuple(m.name for m in robot.motors)}
    found = {"q_a": given["q_a"], "q_m": given["q_m"], "tau_m": given["tau_m"]}
    for name in ("v_a", "a_a", "v_m", "a_m"):
        labels = names[name[-1]]
        if name not in data.channels or sorted(data.labels[name]) != sorted(labels):
            return None
        values = data[name][:, [data.labels[name].index(label) for label in labels]]
        found[name] = np.pad(values, ((0, len(t) - len(values)), (0, 0)))
    return Motion(t, **found) if all(np.isfinite(x).all() for x in found.values()) else None


def _energy_error(
    equations: Equations, motion: tuple[np.ndarray, ...], start: np.ndarray, work: np.ndarray, loss: np.ndarray
) -> float:
    """Largest violation of the energy balance, relative to the energy exchanged; ``start``: energy at the beginning."""
    energies = [x.reshape(len(work)) for x in evaluate(equations.function("energy"), *motion)]
    total = energies[0] + energies[1]
    imbalance = total - start - work + loss
    # rounding of constant energies is no violation
    exchanged = max(np.ptp(energies[0]), np.ptp(energies[1]), np.ptp(work), 1e-6 * np.abs(total).max(), 1e-9)
    return float(np.abs(imbalance).max() / exchanged)


def _recorded(
    equations: Equations, data: Trajectory, given: dict[str, np.ndarray], motion: tuple[np.ndarray, ...]
) -> tuple[float | None, float | None, Trajectory]:
    """Largest output error [m] and [rad], and the simulated motion as a trajectory."""
    robot = equations.model
    q_a, v_a, q_m, v_m = motion
    channels = {"q_a": q_a, "v_a": v_a, "q_m": q_m, "v_m": v_m, "tau_m": given["tau_m"]}
    names_a, names_m = tuple(c.name for c in robot.coordinates), tuple(m.name for m in robot.motors)
    labels = {"q_a": names_a, "v_a": names_a, "q_m": names_m, "v_m": names_m, "tau_m": names_m}
    of_a = tuple(c.unit for c in robot.coordinates)
    units = {"q_a": of_a, "v_a": tuple(f"{unit}/s" for unit in of_a)}
    ports = {
        "q_a": Port("q_a", (robot.n_a,), common_unit(of_a), "arm coordinates, simulated"),
        "v_a": Port("v_a", (robot.n_a,), common_unit(units["v_a"]), "their speeds"),
        "q_m": Port("q_m", (robot.n_m,), "rad", "motor angles, motor side"),
        "v_m": Port("v_m", (robot.n_m,), "rad/s", "motor speeds, motor side"),
        "tau_m": Port("tau_m", (robot.n_m,), "N m", "motor torques, motor side"),
    }
    in_m, in_rad = None, None
    if "y_ref" in given:
        error, in_m, in_rad = _output_error(equations, given, q_a)
        channels["error"] = error
        units["error"] = output_units(robot)
        ports["error"] = Port("error", (error.shape[1],), common_unit(units["error"]), "output minus reference")
        labels["error"] = output_labels(robot)["y_ref"]
        if in_rad is not None and robot.output.type == "tool_pose":
            channels["turn"] = _turn_error(equations, given, q_a)[:, None]
            ports["turn"] = Port("turn", (1,), "rad", "angle between tool and reference")
            labels["turn"] = ("angle",)
    meta = {"model": robot.name, "variant": robot.variant, "kind": "simulation"}
    channels = {name: x[: len(data.time)] for name, x in channels.items()}
    return in_m, in_rad, Trajectory(data.time, channels, ports, labels, meta, units)


def _output_error(
    equations: Equations, data: dict[str, np.ndarray], q_a: np.ndarray
) -> tuple[np.ndarray, float | None, float | None]:
    """Output minus reference (n, n_y), largest distance [m] and angle [rad]."""
    output = equations.model.output
    y = evaluate(equations.function("output"), q_a)[0].reshape(len(q_a), -1)
    error = y - data["y_ref"]
    if output.type == "combination":
        units = output_units(equations.model)
        columns = [error[:, [u == unit for u in units]] for unit in ("m", "rad")]
        worst = [float(np.linalg.norm(x, axis=1).max()) if x.shape[1] else None for x in columns]
        return error, worst[0], worst[1]
    largest = float(np.linalg.norm(error, axis=1).max())
    if output.type == "tool_pose" and "R_ref" in data:
        return error, largest, float(_turn_error(equations, data, q_a).max())
    return error, largest, None


def _turn_error(equations: Equations, data: dict[str, np.ndarray], q_a: np.ndarray) -> np.ndarray:
    """Angle between the tool and its reference orientation, (n,) [rad]."""
    R = evaluate(equations.function("forward_kinematics"), q_a)[1]
    return turn_angle(R, data["R_ref"].reshape(-1, 3, 3))
