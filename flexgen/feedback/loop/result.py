"""Result of a closed loop: the motion of every robot, its output errors and torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import choose_scales
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.rows import Part
from flexgen.base.spec.ports import Port
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import (
    columns_in,
    output_labels,
    output_units,
    turn_angle,
    unit_of,
)
from flexgen.feedback.loop.closed_loop import NOT_FINITE, TOO_LONG
from flexgen.feedback.loop.content import content_of_run
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.feedback.loop.interface import Controller
from flexgen.feedback.loop.margins import LoopAtPose, Margins, loops_at
from flexgen.feedback.loop.named_controllers import FeedforwardOnly
from flexgen.feedback.loop.plants import NOMINAL, Plants
from flexgen.feedback.loop.reference import MotionReference
from flexgen.feedback.loop.sampled_model import PoseModels
from flexgen.inversion.solution import Solution
from flexgen.model.elements import RobotModel
from flexgen.paths.accuracy.corners import corner_figures, find_corners
from flexgen.paths.accuracy.figures import BAND, PathAccuracy, path_accuracy
from flexgen.paths.force.tool_force import CHANNEL, LABELS
from flexgen.paths.force.tool_force import UNITS as UNITS_OF_FORCE

UNITS = ("m", "rad")
SHOWN = 20  # robots in the printed text
ADVICE = {
    NOT_FINITE: "; lower the gains, or take a shorter sample time",
    TOO_LONG: (
        ": the loop is unstable, or what is commanded jumps; lower the gains, or command "
        "smoother motions"
    ),
}
DONE = "done"
UNSTABLE = "unstable"
GROWTH = 1e-6
"""Excess over 1 of an eigenvalue of an unstable sampled loop: rounding is below it."""

LAST_S = 0.1
"""Time [s] at the begin and end of the rest after the motion, to compare motor errors."""

RUNAWAY = 0.1
RUNAWAY_GROWTH = 1.5
"""A loop diverges where motors at rest are off by this part of 1 rad and their motion, and the
error still grows by this factor over the rest."""


@checked_result
@dataclass(frozen=True, repr=False)
class PlantRun(Result):
    """One robot in the loop.

    Attributes
    ----------
    name : str
    q_a, q_m : arrays (n, n_a), (n, n_m) [rad, m]
        At the samples.
    tau_m : array (n, n_m) [N m]
        Commanded torques.
    error : array (n, n_y) [m, or rad for rotations of a combination]
        Output minus reference.
    turn : array (n,) or None [rad]
        Angle between tool and reference, where the output is a pose.
    saturated : int
        Samples at a torque limit.
    failure : str
        Reason why it stopped early, or empty.
    measured : array (n, n_m) [rad]
        Measured motor angles.
    sensors : array (n, n_s)
        Signals of the sensors of the model file.
    load : str
        Mass that was added to the payload, and where; empty: none.
    contact : array (n, 3) or None [N]
        Force of the wall on the tool, world axes; None: there is no wall.

    Examples
    --------
    >>> run = flexgen.control("elbow", plants={"soft": {"stiffness": 0.8}})["soft"]
    >>> run.tau_m.shape, run.saturated, f"{1e6 * abs(run.error).max():.0f} um"
    ((7009, 2), 0, '231 um')
    """

    name: str
    q_a: np.ndarray
    q_m: np.ndarray
    tau_m: np.ndarray
    error: np.ndarray
    turn: np.ndarray | None
    saturated: int
    failure: str
    measured: np.ndarray
    sensors: np.ndarray
    load: str = ""
    contact: np.ndarray | None = None

    def __repr__(self) -> str:
        how = (
            self.failure
            or f"error up to {np.abs(self.error).max(initial=0.0):.3g}, {self.saturated} saturated"
        )
        return f"<PlantRun {self.name}: {len(self.error)} samples, {how}>"


@checked_result
@dataclass(frozen=True, repr=False)
class ControlRun(Result):
    """Result of `flexgen.control`: the model and the other robots under one controller.

    Attributes
    ----------
    model : RobotModel
    solution : Solution
        The feedforward.
    controller : str
        Its name.
    law : Controller
    reference : MotionReference
    hardware : DriveHardware
    delay_samples : int
        Whole samples of the delay; the rest is ``hardware.delay_s``.
    runs : tuple of PlantRun
        The first is the model.
    steps : int
        Integration steps in a sample.
    wall_s : float [s]
        Of the simulation.
    force : array (n, 6) or None [N, N m]
        Of a process on all tools at the samples, world axes; None: there is none.
    plants : Plants or None
        Numbers in which the robots differ from the model.
    ended : str
        Empty; ``"time limit"`` or ``"interrupted"`` where not all robots were simulated.

    Examples
    --------
    >>> run = flexgen.control("elbow", plants={"soft": {"stiffness": 0.8}})
    >>> [robot.name for robot in run.runs], f"{1e6 * run.distance(run['soft']).max():.0f} um"
    (['nominal', 'soft'], '242 um')
    """

    model: RobotModel
    solution: Solution
    controller: str
    law: Controller
    reference: MotionReference
    hardware: DriveHardware
    delay_samples: int
    runs: tuple[PlantRun, ...]
    steps: int
    wall_s: float
    force: np.ndarray | None = None
    plants: Plants | None = field(default=None, compare=False)
    ended: str = ""

    def __repr__(self) -> str:
        return (
            f"<ControlRun {self.model.name}, {self.controller}: {len(self.runs)} robots, "
            f"{self.status}>"
        )

    def __str__(self) -> str:
        """One line for each robot, of 20 at most."""
        late = f", delay {1e3 * self.delay_s:.4g} ms" if self.delay_s else ""
        lines = [
            f"{self.model.name}, move {self.solution.move.name}: controller {self.controller} at "
            f"{1e3 * self.hardware.sample_s:.4g} ms{late}: {self.status}",
            *(f"  {line}" for line in self.force_lines()),
        ]
        shown = self.runs[:SHOWN]
        keys = ("error_max", "dynamic_error_max")
        found = [self.figures(run) for run in shown if not run.failure]
        scales = choose_scales(
            (), *((row[f"{k}_{u}"], u) for row in found for k in keys for u in UNITS)
        )
        for run in shown:
            row = self.figures(run)
            texts = {key: [(row[f"{key}_{u}"], u) for u in UNITS] for key in keys}
            whole, dynamic = (
                " and ".join(scales[u].text(x) for x, u in each if x is not None)
                for each in texts.values()
            )
            text = run.failure or (
                f"error up to {whole}, dynamic {dynamic}, torque up to "
                f"{row['torque_max_Nm']:.4g} N m"
            )
            full = (
                f", {run.saturated} samples at the torque limit"
                if run.saturated and not run.failure
                else ""
            )
            lines.append(f"  {run.name}: {text}{full}{f', load {run.load}' if run.load else ''}")
        more = len(self.runs) - SHOWN
        return "\n".join([*lines, *([f"  and {more} more robots in .runs"] if more > 0 else [])])

    @cached_property
    def unstable(self) -> dict[str, str]:
        """Robots whose loop is unstable, each with the reason; empty: none was found.

        A linear loop is unstable where an eigenvalue at the begin, middle or end of the motion
        leaves the unit circle; another one where the motion of its robot grows at rest, or is not
        finite.
        """
        found = {run.name: run.failure for run in self.runs if run.failure == NOT_FINITE}
        # without feedback an elastic arm drifts: it is not a loop
        closed = () if isinstance(self.law, FeedforwardOnly) else self.runs
        for run in closed:
            if run.failure:
                continue
            loops = self.loops(run.name)
            largest = {name: loop.largest_eigenvalue() for name, loop in loops.items()}
            poses = [name for name, size in largest.items() if size > 1.0 + GROWTH]
            if poses:
                worst = max(largest.values())
                where = ", ".join(poses)
                found[run.name] = (
                    f"the linear loop at {where} of the motion has an eigenvalue of {worst:.5f}"
                )
            elif not loops and self._runs_away(run):
                found[run.name] = "its motors go away at rest"
        return found

    def _runs_away(self, run: PlantRun) -> bool:
        """Whether the error of the motors grows at rest after the motion."""
        wanted = self.reference.motion["q_m"]
        error = np.abs(run.q_m - wanted)
        count = max(int(LAST_S / self.hardware.sample_s), 1)
        first = int(np.searchsorted(self.reference.time, self.reference.end))
        if first + 2 * count > len(error):
            return False
        before = error[first : first + count].max(axis=0)
        last = error[-count:].max(axis=0)
        large = last > RUNAWAY * (1.0 + np.ptp(wanted, axis=0))
        return bool((large & (last > RUNAWAY_GROWTH * before)).any())

    @property
    def status(self) -> str:
        """``done``; ``unstable: ...`` or ``failed: ...`` with the first such robot.

        Where not all robots were simulated: ``time limit: ...`` or ``interrupted: ...`` with their
        names.
        """
        for name, reason in self.unstable.items():
            advice = ADVICE.get(self[name].failure, ADVICE[NOT_FINITE])
            return f"{UNSTABLE}: {name}: {reason}{advice}"
        failed = (
            f"failed: {run.name}: {run.failure}{ADVICE.get(run.failure, '')}"
            for run in self.runs
            if run.failure
        )
        return next(failed, self._early_end() or DONE)

    def _early_end(self) -> str:
        """Why which robots were not simulated, or empty."""
        if not self.ended or self.plants is None:
            return ""
        return f"{self.ended}: not simulated: {', '.join(self.plants.names[len(self.runs) :])}"

    @property
    def nominal(self) -> PlantRun:
        """The robot that is as the model says."""
        return self.runs[0]

    def __getitem__(self, name: str) -> PlantRun:
        for run in self.runs:
            if run.name == name:
                return run
        raise ArgumentError(
            f"plant: given {name!r}, expected one of {', '.join(run.name for run in self.runs)}"
        )

    @property
    def tool_error_max_m(self) -> float | None:
        """Largest distance of the model's output from its reference [m]; None without lengths, NaN
        where it failed.
        """
        found: float | None = self.figures(self.nominal)["error_max_m"]
        return found

    @property
    def tool_error_max_rad(self) -> float | None:
        """Largest angle of the model's output from its reference [rad]; None without angles, NaN
        where it failed.
        """
        found: float | None = self.figures(self.nominal)["error_max_rad"]
        return found

    @property
    def unit(self) -> str:
        """``"m"``, or ``"rad"`` where the output has no lengths."""
        return unit_of(self.model)

    @property
    def assumed_force(self) -> np.ndarray:
        """The force on the tool that the feedforward assumes at the samples, (n, 6) [N, N m],
        world axes.
        """
        found = self.reference.motion.get(CHANNEL)
        return (
            np.zeros((len(self.reference.time), len(UNITS_OF_FORCE))) if found is None else found
        )

    def force_figures(self) -> dict[str, float]:
        """Largest force of the process, the largest assumed one, and their largest difference [N];
        empty without one.

        Of a process that exerts moments too their sizes [N m].
        """
        if self.force is None:
            return {}
        found: dict[str, float] = {}
        assumed = self.assumed_force
        for unit, part in (("N", slice(0, 3)), ("Nm", slice(3, 6))):
            if unit == "N" or self.force[:, part].any() or assumed[:, part].any():
                forces = {
                    "force": self.force,
                    "assumed_force": assumed,
                    "force_error": assumed - self.force,
                }
                sizes = {
                    name: np.linalg.norm(x[:, part], axis=1).max() for name, x in forces.items()
                }
                found |= {f"{name}_max_{unit}": float(x) for name, x in sizes.items()}
        return found

    def force_lines(self) -> tuple[str, ...]:
        """Force figures in words, a line for forces and one for moments."""
        found = self.force_figures()
        lines = []
        for word, unit in (("force", "N"), ("moment", "N m")):
            key = unit.replace(" ", "")
            if f"force_max_{key}" in found:
                true, assumed, error = (
                    found[f"{x}_max_{key}"] for x in ("force", "assumed_force", "force_error")
                )
                lines.append(
                    f"{word} of the process up to {true:.4g} {unit}, in the feedforward up to "
                    f"{assumed:.4g} {unit}, difference up to {error:.4g} {unit}"
                )
        return tuple(lines)

    @property
    def worst(self) -> PlantRun:
        """The robot with the largest dynamic error; the first that failed where one did."""
        failed = [run for run in self.runs if run.failure]
        key = f"dynamic_error_max_{self.unit}"
        return failed[0] if failed else max(self.runs, key=lambda run: self.figures(run)[key])

    def distance(self, run: PlantRun, unit: str | None = None) -> np.ndarray:
        """Distance of a robot's output from its reference at the samples (n,), of its columns in m
        or rad.

        ``unit``: default `unit`.
        """
        return np.asarray(
            np.linalg.norm(run.error[:, columns_in(self.model, unit or self.unit)], axis=1)
        )

    def dynamic(self, run: PlantRun, unit: str | None = None) -> np.ndarray:
        """Dynamic errors: without the static errors at start and end, (n,) [m or rad]."""
        reference = self.reference
        e = run.error[:, columns_in(self.model, unit or self.unit)]
        start = int(np.searchsorted(reference.time, reference.begin)) - 1
        share = np.clip(reference.time / max(reference.path_end, 1e-12), 0.0, 1.0)[:, None]
        static = (1 - share) * e[max(start, 0)] + share * e[-1]
        moving = reference.time >= reference.begin
        return np.asarray(np.linalg.norm(e - static, axis=1) * moving)

    def figures(self, run: PlantRun) -> dict[str, Any]:
        """Largest errors and torques of a robot, SI units; NaN where it failed, None where the
        output has no such part.

        Angles of a pose: ``error_max_rad`` and ``turn_max_rad``, the largest between tool and
        reference.
        """
        moving = self.reference.time >= self.reference.begin
        start = max(int(np.searchsorted(self.reference.time, self.reference.begin)) - 1, 0)
        values: dict[str, float | None] = {}
        for unit in UNITS:
            found: list[float | None] = [None] * 4
            if columns_in(self.model, unit):
                far = self.distance(run, unit)
                dynamic = self.dynamic(run, unit)
                found = [
                    float(far[moving].max()),
                    float(far[-1]),
                    float(far[start]),
                    float(dynamic.max()),
                ]
            keys = ("error_max", "error_end", "static_error_start", "dynamic_error_max")
            values |= {f"{key}_{unit}": x for key, x in zip(keys, found, strict=True)}
        values["turn_max_rad"] = turn = None if run.turn is None else float(run.turn[moving].max())
        values["error_max_rad"] = turn if run.turn is not None else values["error_max_rad"]
        values["torque_max_Nm"] = float(np.abs(run.tau_m).max())
        if run.contact is not None:
            values["contact_max_N"] = float((run.contact**2).sum(axis=1).max() ** 0.5)
        if run.failure:
            values = {key: None if x is None else float("nan") for key, x in values.items()}
        return {
            "plant": run.name,
            **values,
            "saturated_samples": run.saturated,
            "failure": run.failure,
            "load": run.load,
        }

    def accuracy(self, robots: Sequence[str] | None = None, *, band: float = BAND) -> PathAccuracy:
        """Path accuracy, repeatability, settling and speed of the robots in the sense of ISO 9283.

        Parameters
        ----------
        robots : sequence of str, optional
            Names; default: all that did not fail. A repeatability is that of these robots, not of
            the cycles of one.
        band : float [m, or rad where the output has no lengths]
            Half width of the band of the settling times.

        Returns
        -------
        PathAccuracy

        Raises
        ------
        ArgumentError
            A robot is not known, or failed, or none is left; the band is not a positive number.
        """
        chosen = (
            [run for run in self.runs if not run.failure]
            if robots is None
            else [self[name] for name in robots]
        )
        failed = [run.name for run in chosen if run.failure]
        if failed or not chosen:
            given = f"{failed[0]!r}, which failed" if failed else "no robots that reached the end"
            raise ArgumentError(
                f"robots: given {given}, expected names of robots that did not fail"
            )
        columns = columns_in(self.model, self.unit)
        y = self.reference.y_ref
        attained = np.array([(y + run.error)[:, columns] for run in chosen])
        named: dict[str, Any] = {
            "robots": tuple(run.name for run in chosen),
            "unit": self.unit,
            "band": band,
        }
        if self.reference.R_ref is not None:
            forward = derive(self.model).function("forward_kinematics")
            turned = np.array([evaluate(forward, run.q_a)[1] for run in chosen])
            named["orientations"] = self.reference.R_ref.reshape(-1, 3, 3), turned
        motion = self.reference.time, y[:, columns], attained
        corners = find_corners(self.model, self.solution.move)
        found = path_accuracy(*motion, self.reference.path_end, **named)
        return replace(found, **corner_figures(corners, *motion))

    def trajectory(self, name: str = NOMINAL) -> Trajectory:
        """Motion, torques and errors of a robot at the samples of the controller."""
        run = self[name]
        robot = self.model
        coordinates = tuple(c.name for c in robot.coordinates)
        motors = tuple(m.name for m in robot.motors)
        units = output_units(robot)
        rows = {
            "q_a": (
                run.q_a,
                coordinates,
                "rad or m",
                "arm coordinates",
                tuple(c.unit for c in robot.coordinates),
            ),
            "q_m": (run.q_m, motors, "rad", "motor angles, motor side", ()),
            "tau_m": (run.tau_m, motors, "N m", "commanded torques, motor side", ()),
            "tau_ff": (self.reference.held, motors, "N m", "feedforward torques, motor side", ()),
            "error": (
                run.error,
                output_labels(robot)["y_ref"],
                "rad or m",
                "output minus reference",
                tuple(units),
            ),
        }
        if self.force is not None:
            doc = "force and torque of the process on the tool, world axes"
            rows[CHANNEL] = self.force, LABELS, "N or N m", doc, UNITS_OF_FORCE
        ports = {}
        for key, (x, _, unit, doc, own) in rows.items():
            ports[key] = Port(key, (x.shape[1],), own[0] if len(set(own)) == 1 else unit, doc)
        meta = {
            "model": robot.name,
            "variant": robot.variant,
            "kind": "closed loop",
            "controller": self.controller,
        }
        return Trajectory(
            self.reference.time,
            {key: row[0] for key, row in rows.items()},
            ports,
            {key: row[1] for key, row in rows.items()},
            meta | {"plant": name},
            {key: row[4] for key, row in rows.items() if row[4]},
        )

    @property
    def delay_s(self) -> float:
        """From a measurement to its torque [s]."""
        return self.delay_samples * self.hardware.sample_s + self.hardware.delay_s

    @property
    def pose_samples(self) -> dict[str, int]:
        """The samples at the start, middle and end of the motion."""
        reference = self.reference
        times = {"begin": reference.begin, "middle": reference.path_end / 2, "end": reference.end}
        at = np.searchsorted(reference.time, list(times.values())).clip(0, len(reference.time) - 1)
        return dict(zip(times, at.tolist(), strict=True))

    def loops(self, robot: str = NOMINAL) -> dict[str, LoopAtPose]:
        """The linear loops of a robot at these poses; empty for a law that is not linear."""
        if not isinstance(self.law, Cascade | Linear):
            return {}
        samples = self.pose_samples
        at = np.array([*samples.values()])
        points = self.reference.points(at)
        sample_s = self.hardware.sample_s
        poses = self._poses(robot)
        found = loops_at(self.model, self.law, sample_s, self.delay_s, points, at, poses)
        return dict(zip(samples, found, strict=False))

    def _poses(self, robot: str) -> PoseModels | None:
        """The linear models of a robot that differs from the model; None for one that does not."""
        if robot == NOMINAL or self.plants is None or not self.plants.parameters:
            return None
        if robot not in self.plants.names:
            known = ", ".join(self.plants.names)
            raise ArgumentError(f"robot: given {robot!r}, expected one of {known}")
        names = [parameter.name for parameter in self.plants.parameters]
        values = self.plants.values[self.plants.names.index(robot)]
        return PoseModels(without_states(self.model), names, values)

    def margins(self, robot: str = NOMINAL) -> dict[str, Margins]:
        """Stability margins of a robot at these poses, of its linear loop."""
        return {name: loop.margins() for name, loop in self.loops(robot).items()}

    def content(self) -> tuple[Part, ...]:
        """The loop, errors of its robots, figures of ISO 9283, and stability margins."""
        return content_of_run(self)


def output_errors(
    equations: Equations, reference: MotionReference, q_a: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Output minus reference (n, n_y), and the angle between tool and reference (n,) for a
    pose.
    """
    y = evaluate(equations.function("output"), q_a)[0].reshape(len(q_a), -1)
    turn = None
    if reference.R_ref is not None:
        R = evaluate(equations.function("forward_kinematics"), q_a)[1]
        turn = turn_angle(R, reference.R_ref.reshape(-1, 3, 3))
    return y - reference.y_ref, turn
