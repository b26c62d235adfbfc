"""Simulation: a motion under motor torques and its figures, each stated once for tables, JSON,
reports and prints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import both_measured, choose_scales
from flexgen.base.files.trajectory_files import common_unit
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.rows import Data, Part, Row
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units, turn_angle
from flexgen.simulation.motor_feedback import MotorFeedback

AFTER = 2.0  # s after the end of the trajectory: of the second figure of the error


@checked_result
@dataclass(frozen=True, repr=False)
class Simulation(Result):
    """Motion of the robot under the torque.

    Attributes
    ----------
    trajectory : Trajectory
        Channels ``q_a v_a q_m v_m tau_m``, ``error`` of the output where the reference was given,
        ``contact`` with a wall.
    tool_error_max_m, tool_error_max_rad : float or None [m], [rad]
        Largest error of the output until ``held_s`` after the end of the trajectory, with the
        ``feedback`` that is named there; None without reference, or where the output has no such
        part.
    energy_error : float
        Largest violation of the energy balance, relative to the energy exchanged.
    torque_max_Nm, speed_max_rad_s : float [N m], [rad/s]
        Largest torque and speed of a motor, motor side.
    evaluations : int
        Of the right-hand side.
    wall_s : float [s]
    warnings : tuple of str
    growth : float or None
        Growth of perturbations of the open loop until ``held_s`` after the arm has come to rest;
        None where it was not estimated. ``growth_whole``: until ``held_s`` after the last sample.
    defect_max_m, defect_max_rad : float or None [m], [rad]
        Defect: the residual of the equations of motion between the samples, propagated to the
        output over the directions that do not grow, see `flexgen.simulation.verification.defect`;
        None where the trajectory has no accelerations.
    integrator : str
        ``DOP853``, or ``LSODA`` where the problem is stiff.
    held_s : float [s]
        How long the last torque was held after the end of the trajectory.
    later_error_max_m, later_error_max_rad : float or None [m], [rad]
        Largest error of the output until `AFTER` = 2 s after the end, predicted by the
        linearization about the last state: a robot without brakes drifts in open loop. None where
        the last torque was not held, and where rounding errors grow to the size of this error.
    feedback : MotorFeedback or None
        The motor feedback that the robot was simulated with; None: open loop.
    open_loop : Simulation or None
        The same without the feedback; None where there is none, or where rounding errors grow to
        the size of its error.

    Examples
    --------
    >>> solution = flexgen.solve("elbow")
    >>> motion = flexgen.simulate(
    ...     flexgen.read("elbow", overrides={"motor.m1.inertia": 0.013}), solution.trajectory
    ... )
    >>> f"{1e3 * motion.tool_error_max_m:.0f} mm"
    '33 mm'
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
    growth: float | None = None
    growth_whole: float | None = None
    integrator: str = "DOP853"
    held_s: float = 0.0
    later_error_max_m: float | None = None
    later_error_max_rad: float | None = None
    feedback: MotorFeedback | None = None
    open_loop: Simulation | None = None
    defect_max_m: float | None = None
    defect_max_rad: float | None = None

    def __repr__(self) -> str:
        return f"<Simulation {self.trajectory.meta.get('model', '')}: {error_lines(self)[0]}>"

    def content(self) -> tuple[Part, ...]:
        """The figures."""
        return *self.figures(), Data("warnings", list(self.warnings))

    def figures(self) -> tuple[Row, ...]:
        """The figures of the simulation, in SI units: what tables and JSON show."""
        contact = self.trajectory.channels.get("contact")
        force = [] if contact is None else [float((contact**2).sum(axis=1).max() ** 0.5)]
        return (
            *error_figures(self),
            *(Row("force of the wall, largest", x, "N", "contact_max_N") for x in force),
            Row("energy error", self.energy_error, "relative", "energy_error"),
            Row("motor torque, largest", self.torque_max_Nm, "N m", "torque_max_Nm"),
            Row("motor speed, largest", self.speed_max_rad_s, "rad/s", "speed_max_rad_s"),
            Row("evaluations of the equations of motion", self.evaluations, "", "evaluations"),
            Row("wall time", self.wall_s, "s", "wall_s"),
        )


def error_figures(
    simulation: Simulation | None, what: str = "tool", label: str | None = None
) -> tuple[Row, ...]:
    """Errors of the output, each with its name and the conditions under which it holds.

    ``what``: the name of the output; ``label``: of the largest error, where it means something
    else.
    """
    run = simulation
    closed = None if run is None or run.feedback is None else run.feedback.title
    alone = None if run is None else run.open_loop
    label = (
        label
        or f"{what} error {'open loop' if closed is None else 'with motor feedback'}, largest"
    )
    later = f"{what} error until {AFTER:g} s after the end, predicted, largest"
    without = f"{what} error open loop, largest"
    defect = "defect of the equations of motion, propagated, largest"
    rows: list[tuple[str, str | float | None, str, str]] = [
        (label, None if run is None else run.tool_error_max_m, "m", "tool_error_max_m"),
        (label, None if run is None else run.tool_error_max_rad, "rad", "tool_error_max_rad"),
        (
            "until how long after the end",
            None if run is None else run.held_s or None,
            "s",
            "held_s",
        ),
        (later, None if run is None else run.later_error_max_m, "m", "later_error_max_m"),
        (later, None if run is None else run.later_error_max_rad, "rad", "later_error_max_rad"),
        ("motor feedback", closed, "", "motor_feedback"),
        (
            "growth of perturbations in open loop until the arm rests",
            None if run is None else run.growth,
            "",
            "growth",
        ),
        ("growth until the end", None if run is None else run.growth_whole, "", "growth_whole"),
        (without, None if alone is None else alone.tool_error_max_m, "m", "open_loop_error_max_m"),
        (
            without,
            None if alone is None else alone.tool_error_max_rad,
            "rad",
            "open_loop_error_max_rad",
        ),
        (defect, None if run is None else run.defect_max_m, "m", "defect_max_m"),
        (defect, None if run is None else run.defect_max_rad, "rad", "defect_max_rad"),
    ]
    return tuple(Row(*row) for row in rows)


def error_lines(simulation: Simulation, what: str = "tool") -> list[str]:
    """The errors of the output, each with its name and the conditions under which it holds."""
    run = simulation
    scales = choose_scales(error_figures(run))
    errors = both_measured(run.tool_error_max_m, run.tool_error_max_rad, scales)
    if not errors:
        return [f"{what} error not measured (the trajectory has no reference)"]
    until = f" until {run.held_s:g} s after the end" if run.held_s else ""
    later = both_measured(run.later_error_max_m, run.later_error_max_rad, scales)
    more = f", {later} until {AFTER:g} s" if later else ""
    growth = (
        ""
        if run.growth is None
        else f" (perturbations grow {growth_text(run.growth, run.growth_whole)})"
    )
    if run.feedback is None:
        lines = [f"{what} error open loop up to {errors}{until}{more}{growth}"]
    else:
        alone = run.open_loop
        with_feedback = f"{what} error with motor feedback up to {errors}{until}{more}"
        found = (
            "not determined"
            if alone is None
            else both_measured(alone.tool_error_max_m, alone.tool_error_max_rad, scales)
        )
        lines = [with_feedback, run.feedback.title, f"{what} error open loop {found}{growth}"]
    defect = both_measured(run.defect_max_m, run.defect_max_rad, scales)
    return [*lines, *([f"defect {defect}"] if defect else [])]


def growth_text(growth: float, whole: float | None) -> str:
    """By how much perturbations grow, also until the end where that is much more."""
    more = f", by {whole:.2g} until the end" if whole is not None and whole > 10 * growth else ""
    return f"by {growth:.2g}{more}"


def error_text(simulation: Simulation, what: str = "tool") -> str:
    """Errors of a simulation in one line."""
    return "; ".join(error_lines(simulation, what))


def record_motion(
    equations: Equations,
    data: Trajectory,
    given: dict[str, np.ndarray],
    motion: tuple[np.ndarray, ...],
) -> tuple[float | None, float | None, Trajectory]:
    """Largest output error [m] and [rad], None where not measured, and the simulated motion as a
    trajectory.

    ``given``: channels of the trajectory that is simulated, with its reference; ``motion``: ``q_a,
    v_a, q_m, v_m`` at its instants and after them.
    """
    robot = equations.model
    q_a, v_a, q_m, v_m = motion
    channels = {"q_a": q_a, "v_a": v_a, "q_m": q_m, "v_m": v_m, "tau_m": given["tau_m"]}
    names_a = tuple(c.name for c in robot.coordinates)
    names_m = tuple(m.name for m in robot.motors)
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
    in_m = None
    in_rad = None
    if "y_ref" in given:
        error, in_m, in_rad = output_error(equations, given, q_a)
        channels["error"] = error
        units["error"] = output_units(robot)
        ports["error"] = Port(
            "error", (error.shape[1],), common_unit(units["error"]), "output minus reference"
        )
        labels["error"] = output_labels(robot)["y_ref"]
        if in_rad is not None and robot.output.type == "tool_pose":
            channels["turn"] = _turn_error(equations, given, q_a)[:, None]
            ports["turn"] = Port("turn", (1,), "rad", "angle between tool and reference")
            labels["turn"] = ("angle",)
    meta = {"model": robot.name, "variant": robot.variant, "kind": "simulation"}
    channels = {name: x[: len(data.time)] for name, x in channels.items()}
    return in_m, in_rad, Trajectory(data.time, channels, ports, labels, meta, units)


def output_error(
    equations: Equations, data: dict[str, np.ndarray], q_a: np.ndarray
) -> tuple[np.ndarray, float | None, float | None]:
    """Output minus reference (n, n_y), largest distance [m] and angle [rad], None where the output
    has no such part. ``data``: has ``y_ref``, of poses also ``R_ref``; ``q_a`` (n, n_a).
    """
    output = equations.model.output
    y = evaluate(equations.function("output"), q_a)[0].reshape(len(q_a), -1)
    error = y - data["y_ref"]
    if output.type == "combination" or output.has_angle or output.weights:
        units = output_units(equations.model)
        columns = [error[:, [u == unit for u in units]] for unit in ("m", "rad")]
        worst = [float(np.linalg.norm(x, axis=1).max()) if x.shape[1] else None for x in columns]
        if output.is_pose and "R_ref" in data:
            worst[1] = max(worst[1] or 0.0, float(_turn_error(equations, data, q_a).max()))
        return error, worst[0], worst[1]
    largest = float(np.linalg.norm(error, axis=1).max())
    if output.type == "tool_pose" and "R_ref" in data:
        return error, largest, float(_turn_error(equations, data, q_a).max())
    return error, largest, None


def _turn_error(equations: Equations, data: dict[str, np.ndarray], q_a: np.ndarray) -> np.ndarray:
    """Angle between the tool and its reference orientation, (n,) [rad]."""
    R = evaluate(equations.function("forward_kinematics"), q_a)[1]
    return turn_angle(R, data["R_ref"].reshape(-1, 3, 3))
