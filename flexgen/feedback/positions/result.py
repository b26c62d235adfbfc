"""Result of `flexgen.command_positions`: the samples to send, and the errors of the robot under
these commands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import choose_scales, lines_of
from flexgen.base.files.atomic_files import write_text
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.results import Result
from flexgen.base.rows import Data, Part, Prose, Row
from flexgen.feedback.loop.result import ControlRun
from flexgen.feedback.positions.columns import command_columns
from flexgen.feedback.positions.servo import Servo
from flexgen.inversion.judge.status import Status

LITTLE = 0.5  # of the error with the planned motor angles: where stability is looked at
GROWN = 1e3  # deviations over the motion, in an unstable loop
UNITS = {"rad": {"deg": np.pi / 180.0, "rad": 1.0}, "m": {"deg": 1e-3, "rad": 1.0}}
NAMES = {"rad": {"deg": "deg", "rad": "rad"}, "m": {"deg": "mm", "rad": "m"}}


@checked_result
@dataclass(frozen=True, repr=False)
class PositionCommands(Result):
    """Positions to send to a robot, so that its servos send the torques of inverse dynamics.

    Attributes
    ----------
    time : array (k,) [s]
        When each position begins to act; zero where the path begins. Send it the latency of the
        interface before.
    motor : array (k, n_m) [rad]
        Positions, motor side.
    joint : array (k, n_g) [rad or m]
        The same for the joints, as rigid gears would turn them.
    joints : tuple of str (n_g,)
        Their names.
    units : tuple of str (n_g,)
        "rad" or "m".
    period : float [s]
        Between two positions.
    interpolation : str
        Between two positions, see `flexgen.feedback.positions.samples`.
    servo : Servo
        That the inverse is of.
    run : ControlRun
        The robot, and others where they are asked for, that is sent these positions: a simulation
        of servo and robot.
    today : ControlRun
        The same robot that is sent the planned motor angles.
    active : tuple of str
        Limits that are reached.

    Examples
    --------
    >>> found = flexgen.command_positions("planar5_nmp", period=0.004)
    >>> found.joint.shape[1], found.interpolation
    (2, 'linear')
    >>> f"{1e6 * found.tool_error_max_m:.1f} um instead of {1e6 * found.today_error_max_m:.0f} um"
    '0.1 um instead of 1552 um'
    """

    time: np.ndarray
    motor: np.ndarray
    joint: np.ndarray
    joints: tuple[str, ...]
    units: tuple[str, ...]
    period: float
    interpolation: str
    servo: Servo
    run: ControlRun
    today: ControlRun
    active: tuple[str, ...]

    def __repr__(self) -> str:
        return (
            f"<PositionCommands {self.run.model.name}, {self.run.solution.move.name}: "
            f"{self.status}>"
        )

    def __str__(self) -> str:
        """The figures as lines."""
        return lines_of(self.content())

    @property
    def status(self) -> str:
        """``solved``; ``limits active``, with an error that they cost; ``failed`` with the
        reason.
        """
        if self.problem:
            return f"failed: {self.problem}"
        limited = self.run.solution.status == Status.LIMITS_ACTIVE
        active = [*(["those of the solution"] if limited else []), *self.active]
        return f"limits active: {', '.join(active)}" if active else "solved"

    @property
    def problem(self) -> str:
        """Why the positions cannot be sent."""
        run = self.run.nominal
        full = f"{run.saturated} samples at the torque limit" if run.saturated else ""
        return self._unstable or run.failure or full

    @cached_property
    def _unstable(self) -> str:
        """Where the loop of servo and robot is unstable; looked for where the positions reduce the
        error little.
        """
        errors = (
            (self.tool_error_max_m, self.today_error_max_m),
            (self.tool_error_max_rad, self.today_error_max_rad),
        )
        if all(now is None or before is None or now <= LITTLE * before for now, before in errors):
            return ""
        for where, loop in self.run.loops().items():
            largest = loop.largest_eigenvalue()
            if len(self.run.reference.time) * np.log(largest) > np.log(GROWN):
                return (
                    f"the loop of servo and robot is unstable, eigenvalue {largest:.5g} in the "
                    f"{where} of the motion"
                )
        return ""

    @property
    def tool_error_max_m(self) -> float | None:
        """Largest error of the tool with these positions [m]; None without lengths."""
        return self.run.tool_error_max_m

    @property
    def tool_error_max_rad(self) -> float | None:
        """Largest angle error of the tool with these positions [rad]; None without angles."""
        return self.run.tool_error_max_rad

    @property
    def today_error_max_m(self) -> float | None:
        """Largest error of the tool with the planned motor angles as commands [m]."""
        return self.today.tool_error_max_m

    @property
    def today_error_max_rad(self) -> float | None:
        """Largest angle error of the tool with the planned motor angles as commands [rad]."""
        return self.today.tool_error_max_rad

    @property
    def speed(self) -> np.ndarray:
        """Speeds of the joints (k - 1, n_g) between two positions [rad/s or m/s]."""
        return np.diff(self.joint, axis=0) / self.period

    @property
    def acceleration(self) -> np.ndarray:
        """Second differences of the joints (k - 2, n_g) [rad/s^2 or m/s^2]."""
        return np.diff(self.joint, n=2, axis=0) / self.period**2

    def figures(self) -> tuple[Row, ...]:
        """The figures in SI units, for tables."""
        now = (self.tool_error_max_m, self.tool_error_max_rad)
        before = (self.today_error_max_m, self.today_error_max_rad)
        rows = []
        for unit, x, y in zip(("m", "rad"), now, before, strict=True):
            rows += [
                Row("tool error with these positions", x, unit, f"tool_error_max_{unit}"),
                Row(
                    "tool error with the planned motor angles", y, unit, f"today_error_max_{unit}"
                ),
            ]
            for other in self.run.runs[1:]:
                error = self.run.figures(other)[f"error_max_{unit}"]
                rows += [
                    Row(
                        f"tool error of {other.name}",
                        error,
                        unit,
                        f"{other.name}.tool_error_max_{unit}",
                    )
                ]
        return (
            *rows,
            Row("positions", len(self.time), "", "samples"),
            Row("period", self.period, "s", "period"),
            Row("interpolation", self.interpolation, "", "interpolation"),
            Row("first position before the path", max(-float(self.time[0]), 0.0), "s", "before"),
            Row("limits that are reached", ", ".join(self.active), "", "active"),
        )

    def content(self) -> tuple[Part, ...]:
        """The figures, the largest speed and acceleration of each joint, and the positions as
        data.
        """
        head = f"{self.run.model.title}, move {self.run.solution.move.name}: {self.status}"
        arrays = ("time", "motor", "joint", "joints", "units")
        return (
            Prose(head, is_title=True),
            Data("model", self.run.model.title),
            Data("move", self.run.solution.move.name),
            Data("status", self.status),
            *self.figures(),
            *self._speeds(),
            *(Data(name, getattr(self, name)) for name in arrays),
        )

    def _speeds(self) -> tuple[Part, ...]:
        """Largest speed and acceleration of each joint."""
        speed = np.abs(self.speed).max(axis=0)
        acceleration = np.abs(self.acceleration).max(axis=0)
        speeds = choose_scales((), *zip(speed.tolist(), self.units, strict=True))
        accelerations = choose_scales((), *zip(acceleration.tolist(), self.units, strict=True))
        rows = (
            Row(
                f"{name}, commanded up to",
                f"{speeds[u].text(v)}/s, {accelerations[u].text(a)}/s^2",
            )
            for name, u, v, a in zip(self.joints, self.units, speed, acceleration, strict=True)
        )
        largest = Data("speed_max", speed), Data("acceleration_max", acceleration)
        return (*rows, *largest)

    def trajectory(self) -> Trajectory:
        """The positions as a trajectory with the channels ``command_m`` (motor side) and
        ``command_g`` (joints).
        """
        ports, labels, units = command_columns(self.run.model)
        meta = {
            "model": self.run.model.name,
            "kind": "position commands",
            "interpolation": self.interpolation,
        }
        return Trajectory(
            self.time,
            {"command_m": self.motor, "command_g": self.joint},
            ports,
            labels,
            meta,
            units,
        )

    def save(self, path: str | Path, unit: Literal["deg", "rad"] = "deg") -> Path:
        """Write the positions to a file: ``.csv``, a plain table for the interface of a robot.

        A line for each position, one period apart. The first line names the columns: ``time_s``,
        then ``JOINT_deg`` (``JOINT_mm`` of a joint that slides), or with ``unit="rad"``
        ``JOINT_rad`` and ``JOINT_m``. ``.npz``, ``.mat``: the trajectory; ``.json``: what
        `to_dict` returns.
        """
        if Path(path).suffix != ".csv":
            return super().save(path)
        names = [
            f"{name}_{NAMES[own][unit]}" for name, own in zip(self.joints, self.units, strict=True)
        ]
        values = self.joint / [UNITS[own][unit] for own in self.units]
        rows = [
            f"{t:.9g}," + ",".join(f"{x:.12g}" for x in row)
            for t, row in zip(self.time, values, strict=True)
        ]
        return write_text(Path(path), "\n".join([",".join(["time_s", *names]), *rows]) + "\n")
