"""Move planning: the timed segments of a move or program, each a curve with a time law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from flexgen.base.errors import ArgumentError, ModelError, SolverError
from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.model.elements import OF_ROTATION
from flexgen.model.moves import (
    DEGREES,
    TOOL_MOVES,
    Carrier,
    Move,
    MoveC,
    MoveJ,
    MoveL,
    Program,
    Step,
    Vector,
    Where,
    WorkFrame,
)
from flexgen.paths.geometry.blended_curve import MIN_CORNER_SPEED, BlendedCurve
from flexgen.paths.geometry.jets import (
    Attitude,
    axis_angle,
    quaternion,
    rotation_matrices,
    rotation_vector,
)
from flexgen.paths.geometry.segments import POSITION, Arc, Line, Segment, WithAngle, circle_through
from flexgen.paths.reference import Reference
from flexgen.paths.timing.joint_limits import InverseKinematics
from flexgen.paths.timing.time_laws import Clock, Law, SplineLaw, TimeLaw
from flexgen.paths.timing.timed_segments import (
    Curve,
    JointMotion,
    PlannedMove,
    TimedSegment,
    configuration_at_end,
    plan_law,
)

if TYPE_CHECKING:
    from flexgen.paths.geometry.spline import SplineCurve
    from flexgen.paths.inverse_kinematics.targets import Failure
    from flexgen.paths.samples.sample_files import Samples

TYPES = ("tool_line", "tool_circle", "tool_polyline", "sampled", "joint", "output_line", "program")
NO_ROTATION = np.zeros(3)
# rad: tilt of a given orientation from that of a tool that rotates about one axis only: rounding
# of decimals in files
SAME_TILT = 1e-6

NO_MOTION = 1e-9  # m for each meter of reach: motion along an axis that is not an output
# of their geometry
KEYS = {"tool_circle": "axis", "tool_polyline": "legs", "program": "steps", "sampled": "file"}


def wrong(where: Where | None, name: str, key: str, given: object, expected: str) -> Exception:
    """The error to raise for a key of a move; it names file and line if the move is from a
    file.
    """
    if where is None:
        return ArgumentError(f"{name}: given {key} {given}, expected {expected}")
    path, line = where.find(key)
    return ModelError(where.file, line, path, str(given), expected)


def plan_move(reference: Reference, move: Move) -> PlannedMove:
    """Plan the timed segments of a move or program.

    Parameters
    ----------
    reference : Reference
        Of the model.
    move : Move

    Returns
    -------
    PlannedMove

    Raises
    ------
    ArgumentError, ModelError
        The move does not fit the model; a ModelError names file, line and key of a move from a
        file.
    SolverError
        The path leaves the workspace or passes a singular pose.
    """
    if isinstance(move, JointMotion):
        return PlannedMove(move.segments, np.array(move.start))
    return _Planner(reference, move).plan()


class _Planner:
    """Checks the data of one move and builds its timed segments."""

    def __init__(self, reference: Reference, move: Move) -> None:
        self.reference = reference
        self.model = reference.model
        self.move = move
        self.name = f"move {move.name}"
        if move.type not in TYPES:
            raise ArgumentError(
                f"{self.name}: given type {move.type!r}, expected {', '.join(TYPES[:-1])} or "
                f"{TYPES[-1]}"
            )
        if not (move.type == "sampled" and not move.start):
            self._numbers("start", move.start, self.model.n_g)
        if move.type in TOOL_MOVES:
            self._require_tool(move.where, self.name, move.type)
        self.q_g = np.array(move.start, dtype=float)
        self._bounds(move.profile, "profile")
        self.carriers: tuple[Carrier, ...] = () if move.carrier is None else (move.carrier,)
        self.fixed_tool: WorkFrame | None = None
        if move.frame is not None or move.fixed_tool is not None:
            self._stand(move.frame, move.fixed_tool)

    def plan(self) -> PlannedMove:
        """Build the segments."""
        move = self.move
        if isinstance(move, Program):
            self._bounds(move.joint_profile, "joint_profile")
            segments = self._program(move)
        elif move.type == "sampled":
            segments = self._plan_samples()
        else:
            space, curve, speeds = self._curve()
            curve = self._carry(space, curve)
            segments = [TimedSegment(space, curve, self._law(space, curve, speeds))]
        for segment in segments:
            self._check_axes(segment)
        return PlannedMove(tuple(segments), self.q_g)

    def _stand(self, frame: WorkFrame | None, fixed_tool: WorkFrame | None) -> None:
        """Place a move that is stated in a frame where the frame is at the start, or find where a
        tool in the room is then; both may be carried by an element.
        """
        from flexgen.paths.geometry.element_frames import stand

        move = self.move
        key = "fixed_tool" if frame is None else "frame"
        if move.type not in TOOL_MOVES:
            expected = "a move of the tool: " + ", ".join(TOOL_MOVES)
            raise wrong(move.where, self.name, key, f"with a {move.type}", expected)
        if move.carrier is not None or (frame is not None and fixed_tool is not None):
            raise wrong(move.where, self.name, key, "with another frame", "one of them")
        if fixed_tool is not None and not self.reference.pose:
            expected = "an output that is the pose of the workpiece (tool_pose)"
            raise wrong(move.where, self.name, key, fixed_tool.name, expected)
        chosen = fixed_tool if frame is None else frame
        assert chosen is not None
        at = stand(self.model, chosen, self.q_g, move.posture, move.name)
        placed, self.carriers = at
        if frame is None:
            self.fixed_tool = placed
        else:
            self.move = placed.place(replace(move, frame=None))

    def _carry(self, space: str, curve: Curve) -> Curve:
        """The curve of a workpiece along a tool in the room, or in the frames that carry it, if
        they move.
        """
        move = self.move
        key = "fixed_tool" if self.fixed_tool is not None else "carrier"
        if not self.carriers and self.fixed_tool is None:
            return curve
        if space != "tool" or move.profile:
            given = f"a {move.type}" if space != "tool" else "a profile"
            expected = "a move of the tool with a duration and a smoothness"
            raise wrong(move.where, self.name, key, given, expected)
        if self.fixed_tool is not None:
            from flexgen.paths.geometry.fixed_tool import FixedToolCurve

            curve = FixedToolCurve(curve, self.fixed_tool)
        for carrier in self.carriers[::-1]:
            curve = self._carry_curve(curve, carrier)
        return curve

    def _carry_curve(self, curve: Curve, carrier: Carrier) -> Curve:
        """The curve in a frame with this motion."""
        from flexgen.paths.geometry.carried_curve import CarriedCurve

        for key in ("origin", "displacement", "rotation"):
            self._numbers(key, getattr(carrier, key), 3)
        output = self.model.output
        if output.has_angle and output.is_tilted_by(tuple(carrier.rotation)):
            raise wrong(
                self.move.where,
                self.name,
                "carrier" if self.move.carrier is not None else "frame",
                list(carrier.rotation),
                f"a rotation about the axis of the output, {output.axis_text}: a multiple of it",
            )
        axis = np.array(output.rotation_axis) if output.has_angle else None
        return CarriedCurve(curve, carrier, axis)

    def _check_axes(self, segment: TimedSegment) -> None:
        """Refuse a motion of the tool along an axis that is not an output: it would not be carried
        out.
        """
        axes = self.reference.axes
        if segment.space != "tool" or len(axes) == 3:
            return
        t = segment.start + np.linspace(0.0, segment.law.duration, 65)
        x = segment.at(t)[0][:, :, 0]
        moved = np.ptp(x, axis=0)
        for i in set(range(3)) - set(axes):
            if moved[i] > NO_MOTION * (1.0 + np.abs(x).max()):
                given = f"with {moved[i]:.3g} m along {'xyz'[i]}"
                expected = (
                    f"a path along {', '.join(self.model.output.axes)} only, because the output "
                    f"has the axes "
                    f'"{self.model.output.axes}"; or add {"xyz"[i]} to output.axes of the model'
                )
                raise wrong(
                    self.move.where,
                    self.name,
                    KEYS.get(self.move.type, "displacement"),
                    given,
                    expected,
                )

    def _numbers(self, key: str, values: Sequence[float], size: int) -> np.ndarray:
        if len(values) != size or not np.isfinite(values).all():
            raise wrong(self.move.where, self.name, key, values, f"{size} finite numbers")
        return np.array(values, dtype=float)

    def _bounds(self, profile: Sequence[float], key: str) -> None:
        """Refuse a profile of bounds, and a smoothness, that a law cannot have; ``key``: name of
        the profile in the model file.
        """
        if profile and (len(profile) < 2 or not all(np.isfinite(b) and b > 0 for b in profile)):
            expected = "two or more positive bounds: speed, acceleration, jerk, ..."
            raise wrong(self.move.where, self.name, key, list(profile), expected)
        smooth = self.move.smoothness
        if (profile or self.move.type == "program") and not (smooth == 0 or 2 <= smooth <= 9):
            raise wrong(
                self.move.where, self.name, "smoothness", smooth, "0 for trapezoids, or 2 to 9"
            )

    def _require_tool(self, where: Where | None, name: str, what: str) -> None:
        """Refuse a move of the tool, ``what``, where the output of the model is not the tool;
        ``where``, ``name``: place in the file, for the error.
        """
        if not self.reference.tool:
            expected = (
                "an output_line or joint move, because the output is not the position or pose "
                "of the tool"
            )
            if where:
                raise wrong(where, name, "type", what, expected)
            raise ArgumentError(f"{name}: given a {what}, expected {expected}")

    def _law(self, space: str, curve: Curve, speeds: list[float] | None = None) -> Law:
        """The time law of a curve: of the move's duration and smoothness, of its given timing, or
        the fastest one within its profile; ``speeds``: bounds of the curve's segments.
        """
        move = self.move
        if not move.profile:
            if move.timing:
                return SplineLaw(move.duration, tuple(move.timing), curve.length)
            return TimeLaw(move.duration, move.smoothness, curve.length)
        return plan_law(
            self.reference,
            space,
            curve,
            tuple(move.profile),
            move.smoothness,
            move.radius,
            self.q_g,
            speeds,
        )

    def _curve(self) -> tuple[str, Curve, list[float] | None]:
        """Space and curve of a single move, and the speeds of its segments if they are given."""
        move = self.move
        speeds: list[float] | None = None
        if move.type == "joint":
            end = self._end(move, partial(wrong, move.where, self.name), self.q_g)
            space = "joint"
            start = self.q_g
            R = None
            segments: list[Segment] = [Line(end - self.q_g, NO_ROTATION, largest=True)]
        elif move.type == "output_line":
            displacement = self._numbers("displacement", move.displacement, self.model.output.size)
            if self.reference.pose:
                raise wrong(
                    move.where,
                    self.name,
                    "type",
                    move.type,
                    "a tool_line, because the output is a tool_pose",
                )
            space = "output"
            start = self.reference.outputs(self.q_g)
            R = None
            segments = [Line(displacement, NO_ROTATION, largest=True)]
        else:
            space = "tool"
            start, R = self.reference.tool_start(self.q_g)
            if self.fixed_tool is not None:
                from flexgen.paths.geometry.fixed_tool import seen_from

                start, R = seen_from(start, R, self.fixed_tool)
            if move.type == "tool_polyline":
                return "tool", *self._polyline(start, R, move.legs, move.radius)
            segments = [self._single()]
        if (
            move.profile
            and not segments[0].total.any()
            and not segments[0].rotation.any()
            and move.type != "tool_circle"
        ):
            raise wrong(
                move.where,
                self.name,
                "profile",
                list(move.profile),
                "a move with a displacement or rotation, or a duration instead of a profile",
            )
        return space, BlendedCurve(start, self._pose(R), segments, []), speeds

    def _end(self, step: Move | MoveJ, fail: Failure, before: np.ndarray) -> np.ndarray:
        """The actuated coordinates (n_g,) at the end of a joint move, which may be given by the
        pose of the tool.
        """
        from flexgen.paths.inverse_kinematics.targets import joints_of_target

        if step.target is not None:
            if step.end:
                raise fail("end", step.end, "either end or target")
            return joints_of_target(self.model, step.target, before, fail)
        if len(step.end) != self.model.n_g or not np.isfinite(step.end).all():
            raise fail("end", step.end, f"{self.model.n_g} finite numbers")
        return np.array(step.end, dtype=float)

    def _pose(self, R: np.ndarray | None) -> np.ndarray | None:
        """The orientation if it is part of the output, else None."""
        return R if self.reference.pose else None

    def _single(self) -> Segment:
        """The line or the arc of a single move of the tool."""
        move = self.move
        rotation = self._numbers("rotation", move.rotation, 3)
        expected = self._refused_rotation(rotation)
        if expected:
            raise wrong(move.where, self.name, "rotation", rotation.tolist(), expected)
        if move.type == "tool_line":
            way = self._numbers("displacement", move.displacement, 3)
            return self._with_angle(Line(way, rotation, move.radius))
        center = self._numbers("center", move.center, 3)
        axis = self._numbers("axis", move.axis, 3)
        if not axis.any():
            raise wrong(move.where, self.name, "axis", move.axis, "a nonzero direction")
        if not np.isfinite(move.angle) or move.angle == 0:
            raise wrong(move.where, self.name, "angle", move.angle, "a nonzero angle [rad]")
        arc = Arc(center, axis / np.linalg.norm(axis), move.angle, rotation, move.radius)
        if not arc.size > 0:
            raise wrong(
                move.where,
                self.name,
                "center",
                move.center,
                "a center off the axis through the start",
            )
        return self._with_angle(arc)

    def _with_angle(self, segment: Line | Arc) -> Segment:
        """The segment with the angle of the tool, where that is an output."""
        output = self.model.output
        return WithAngle(segment, np.array(output.rotation_axis)) if output.has_angle else segment

    def _refused_rotation(self, rotation: np.ndarray) -> str:
        """End of the message about a rotation vector that is not one of the output, or empty."""
        output = self.model.output
        if not rotation.any() or self.reference.pose:
            return ""
        if not output.has_angle:
            return f"no rotation, because the output is the position of the tool, or {OF_ROTATION}"
        if output.is_tilted_by(tuple(rotation)):
            return f"a rotation about the axis of the output, {output.axis_text}: a multiple of it"
        return ""

    def _plan_samples(self) -> list[TimedSegment]:
        """Path through the samples of a file, from turn to turn; sets the joints at the start."""
        from flexgen.paths.geometry.spline import SplineCurve, turns_of
        from flexgen.paths.samples.sample_angles import with_angles
        from flexgen.paths.samples.sample_files import read_samples

        move = self.move
        reference = self.reference
        if move.degree not in DEGREES:
            raise wrong(
                move.where,
                self.name,
                "degree",
                move.degree,
                "one of " + ", ".join(map(str, DEGREES)),
            )
        samples = read_samples(move.file, self.model, 2)
        if samples.timed and (move.profile or move.smoothness):
            key = "profile" if move.profile else "smoothness"
            raise wrong(
                move.where,
                self.name,
                key,
                "together with times in the file",
                f"no {key}, or a file without column t",
            )
        if not samples.timed and not move.profile and not move.duration > 0:
            expected = "a duration and smoothness, or a profile, because the file has no column t"
            raise wrong(move.where, self.name, "duration", move.duration, expected)
        fixed = None
        if samples.space != "joint":
            self.q_g = self._numbers("start", move.start, self.model.n_g)
        if samples.space == "tool" and reference.pose and samples.quaternions is None:
            fixed = reference.tool_pose(self.q_g)[1]
        if samples.space == "tool" and self.model.output.has_angle:
            samples = with_angles(samples, self.model, *reference.tool_start(self.q_g))
        turns = turns_of(samples, move.radius)
        if not samples.timed and not turns and len(samples.values) <= move.degree:
            expected = f"more than {move.degree} samples, or a lower degree"
            raise ModelError(move.file, 0, "file", f"{len(samples.values)} samples", expected)
        parts = [samples.part(*ends) for ends in pairwise([0, *turns, len(samples.values) - 1])]
        unit = self._unit_of(samples)
        curves = [
            SplineCurve(part, move.degree, move.radius, fixed, move.smooth, unit) for part in parts
        ]
        if samples.space == "joint":
            self.q_g = samples.values[0]
        else:
            first = TimedSegment(samples.space, curves[0], Clock(1.0, 0)).at(np.zeros(1))
            self.q_g = InverseKinematics(reference.equations).follow(
                reference.sample(samples.space, *first), self.q_g
            )[0]
        if samples.timed:
            law = Clock(curves[0].length, (move.degree - 1) // 2)
            return [TimedSegment(samples.space, curves[0], law)]
        return self._there_and_back(samples.space, curves)

    def _unit_of(self, samples: Samples) -> str:
        """The SI units of the columns of samples, for a text."""
        if samples.space == "joint":
            units = {self.model.coordinates[i].unit for i in self.model.i_g}
        elif samples.space == "output":
            units = set(output_units(self.model))
        else:
            turns = samples.quaternions is not None or samples.values.shape[1] > POSITION
            units = {"m", "rad"} if turns else {"m"}
        return " or ".join(sorted(units))

    def _there_and_back(self, space: str, curves: Sequence[SplineCurve]) -> list[TimedSegment]:
        """Curves from turn to turn, with a stop at each.

        In a given duration they have equal largest accelerations.
        """
        roots = np.sqrt([curve.length for curve in curves])
        segments: list[TimedSegment] = []
        start = 0.0
        for curve, share in zip(curves, roots / roots.sum(), strict=True):
            law = self._law(space, curve)
            if len(curves) > 1 and not self.move.profile:
                law = TimeLaw(share * self.move.duration, self.move.smoothness, curve.length)
            segments.append(TimedSegment(space, curve, law, start))
            start += law.duration
        return segments

    # --- polylines and programs ------------------------------------------------------------------
    def _polyline(
        self, start: np.ndarray, R: np.ndarray, steps: Sequence[MoveL], radius: float
    ) -> tuple[BlendedCurve, list[float] | None]:
        """Consecutive lines and arcs of the tool from the pose ``start`` [m], ``R``, with rounded
        corners, and the speeds of the segments where the move has a profile.
        """
        segments: list[Segment] = []
        zones = []
        position = start
        orientation = R
        if not steps:
            raise wrong(self.move.where, self.name, "legs", "none", "one or more")
        for k, step in enumerate(steps):
            segment = self._segment(step, k, position[:POSITION], orientation, radius)
            axis, angle = axis_angle(segment.rotation)
            position = position + segment.total
            orientation = rotation_matrices(axis, np.array([angle]))[0] @ orientation
            segments.append(segment)
            zones.append(step.zone)
        if zones[-1] != 0:
            raise self._step_wrong(steps[-1], len(steps) - 1, "zone", zones[-1], "0 at the end")
        for k, step in enumerate(steps[:-1]):
            if not step.zone > 0:
                raise self._step_wrong(
                    step,
                    k,
                    "zone",
                    step.zone,
                    "a radius > 0 [m], because the tool does not stop here",
                )
        self._corners(segments, zones[:-1], steps)
        speeds = [self._speed(step, k, self.move.profile) for k, step in enumerate(steps)]
        return BlendedCurve(
            start, self._pose(R), segments, zones[:-1]
        ), speeds if self.move.profile else None

    def _corners(
        self, segments: list[Segment], zones: list[float], steps: Sequence[Step], first: int = 0
    ) -> None:
        """Check that zones do not overlap and that the path does not reverse in a corner.
        ``zones``: radii [m or rad] between the segments; ``steps``: of the file, for errors,
        numbered from ``first`` on.
        """
        around = [0.0, *zones, 0.0]
        for k, segment in enumerate(segments):
            if around[k] + around[k + 1] > segment.length * (1 + 1e-12):
                at = k if around[k + 1] > 0 else k - 1
                expected = (
                    f"zones that fit into the length {segment.length:.6g} of step {first + k + 1}"
                )
                raise self._step_wrong(
                    steps[at], first + at, "zone", f"{around[k]:g} and {around[k + 1]:g}", expected
                )
        trial = BlendedCurve(np.zeros(len(segments[0].total)), None, segments, zones)
        for k, zone in enumerate(zones):
            if zone > 0 and trial.min_corner_speed(k) < MIN_CORNER_SPEED:
                raise self._step_wrong(
                    steps[k], first + k, "zone", zone, "0, because the path reverses here"
                )

    def _step_wrong(self, step: Step, k: int, key: str, given: object, expected: str) -> Exception:
        return wrong(step.where, f"{self.name}, step {k + 1}", key, given, expected)

    def _speed(self, step: Step, k: int, profile: Sequence[float]) -> float:
        """Bound on the speed of step ``k``: its own, else the first number of the profile; 1 where
        only ratios of speeds count. A speed without a profile is refused.
        """
        if step.speed is None:
            return profile[0] if profile else 1.0
        if not profile and not self.move.timing:
            raise self._step_wrong(
                step, k, "speed", step.speed, "no speed, or a move with a profile"
            )
        if not (np.isfinite(step.speed) and step.speed > 0):
            raise self._step_wrong(step, k, "speed", step.speed, "a speed > 0")
        return float(step.speed)

    def _segment(
        self, step: MoveL, k: int, position: np.ndarray, R: np.ndarray, radius: float
    ) -> Segment:
        """The line or arc of step ``k`` of the tool, from the pose ``position`` (3,) [m], ``R``
        (3, 3); ``radius`` [m]: with which rotations count as lengths.
        """

        def vector(key: str, values: Sequence[float], size: int = 3) -> np.ndarray:
            if len(values) != size or not np.isfinite(values).all():
                raise self._step_wrong(step, k, key, values, f"{size} finite numbers")
            return np.array(values, dtype=float)

        if not (np.isfinite(step.zone) and step.zone >= 0):
            raise self._step_wrong(step, k, "zone", step.zone, "a radius >= 0 [m]")
        if bool(step.displacement) == bool(step.position):
            raise self._step_wrong(
                step, k, "displacement", step.displacement, "either displacement or position"
            )
        absolute = bool(step.position)
        total = (
            vector("position", step.position) - position
            if absolute
            else vector("displacement", step.displacement)
        )
        rotation = vector("rotation", step.rotation)
        if step.orientation:
            to = np.array(step.orientation, dtype=float)
            if (
                to.shape != (3, 3)
                or not np.abs(to @ to.T - np.eye(3)).max() < 1e-6
                or np.linalg.det(to) < 0
            ):
                raise self._step_wrong(
                    step, k, "orientation", step.orientation, "a rotation matrix"
                )
            if rotation.any():
                raise self._step_wrong(
                    step, k, "rotation", step.rotation, "either rotation or orientation"
                )
            rotation = self._rotation_to(step, k, to, R)
        expected = self._refused_rotation(rotation)
        if expected:
            raise self._step_wrong(step, k, "rotation", rotation.tolist(), expected)
        if isinstance(step, MoveC):
            via = vector("via", step.via) - (position if absolute else 0.0)
            found = circle_through(via, total)
            if found is None:
                raise self._step_wrong(
                    step, k, "via", step.via, "a point that is not on a line through start and end"
                )
            return self._with_angle(Arc(*found, rotation, radius))
        if not total.any() and not rotation.any():
            key = "position" if absolute else "displacement"
            raise self._step_wrong(
                step, k, key, total.tolist(), "a step with a displacement or rotation"
            )
        return self._with_angle(Line(total, rotation, radius))

    def _rotation_to(self, step: MoveL, k: int, to: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Rotation vector from R to another orientation, about the axis of the output if any."""
        rotation = rotation_vector(quaternion(to @ R.T))
        if not self.model.output.has_angle:
            return rotation
        axis = np.array(self.model.output.rotation_axis)
        tilted = to @ R.T @ axis
        off = float(np.arctan2(np.linalg.norm(np.cross(axis, tilted)), axis @ tilted))
        if off > SAME_TILT:
            expected = (
                f"an orientation with the tilt of the tool, which only rotates about "
                f"{self.model.output.axis_text}; it is off by {np.degrees(off):.3g} deg"
            )
            raise self._step_wrong(step, k, "orientation", step.orientation, expected)
        return axis * (axis @ rotation)

    def _program(self, program: Program) -> list[TimedSegment]:
        """The segments of a program: one for all steps between two stops."""
        from flexgen.paths.inverse_kinematics.targets import check_configuration

        if not program.steps:
            raise wrong(program.where, self.name, "step", "none", "one or more steps")
        stops = sum(step.zone == 0 for step in program.steps)
        if program.laws and (len(program.laws) != stops or min(map(len, program.laws)) < 2):
            expected = (
                f"none, or {stops}, one for each motion from rest to rest: its duration and "
                "coefficients"
            )
            raise wrong(program.where, self.name, "laws", program.laws, expected)
        segments: list[TimedSegment] = []
        q_g = self.q_g
        time = 0.0
        position, R = self.reference.tool_start(q_g)
        first = 0
        limited = InverseKinematics(self.reference.equations).has_limits
        for k, step in enumerate(program.steps):
            self._check_step(step, k, program)
            if step.zone > 0 and k + 1 < len(program.steps):
                continue
            group = program.steps[first : k + 1]
            given = program.laws[len(segments)] if program.laws else None
            segment = self._group(program, group, first, q_g, position, R, time, given)
            segments.append(segment)
            later = program.steps[k + 1 :]
            if (limited and later) or any(
                isinstance(x, MoveJ) or x.configuration for x in (*group, *later)
            ):
                q_g = configuration_at_end(self.reference, segment, q_g)
            for number, own in enumerate(group, first):
                if isinstance(own, MoveL) and own.configuration:
                    check_configuration(
                        self.model, q_g, own.configuration, partial(self._step_wrong, own, number)
                    )
            x, attitude = segment.at(np.array([segment.start + segment.law.duration]))
            if segment.space == "joint":
                position, R = self.reference.tool_start(x[0, :, 0])
                q_g = x[0, :, 0]
            else:
                R = self._orientation_at(x[0, :, 0], attitude, position, R)
                position = x[0, :, 0]
            time += segment.law.duration + step.pause
            first = k + 1
        return segments

    def _orientation_at(
        self, end: np.ndarray, attitude: Attitude | None, start: np.ndarray, R: np.ndarray
    ) -> np.ndarray:
        """Orientation of the tool at the end of a segment from ``start``, where it was R."""
        if attitude is not None:
            return np.asarray(attitude[0][0])
        if not self.model.output.has_angle:
            return R
        axis = np.array(self.model.output.rotation_axis)
        return np.asarray(rotation_matrices(axis, end[POSITION:] - start[POSITION:])[0] @ R)

    def _check_step(self, step: Step, k: int, program: Program) -> None:
        """Refuse step ``k`` of a program that is of another type, or whose zone or pause does not
        fit: a step with a zone has no pause, is not the last one, and is followed by one of the
        same space.
        """
        if not isinstance(step, (MoveJ, MoveL)):
            raise ArgumentError(
                f"{self.name}, step {k + 1}: given {step!r}, expected a MoveJ, MoveL or MoveC"
            )
        if isinstance(step, MoveL):
            self._require_tool(step.where, f"{self.name}, step {k + 1}", type(step).__name__)
        if not (np.isfinite(step.zone) and step.zone >= 0):
            raise self._step_wrong(step, k, "zone", step.zone, "a zone >= 0")
        if not (np.isfinite(step.pause) and step.pause >= 0):
            raise self._step_wrong(step, k, "pause", step.pause, "a time >= 0 [s]")
        last = k + 1 == len(program.steps)
        if step.zone > 0 and last:
            raise self._step_wrong(step, k, "zone", step.zone, "0 at the end of the program")
        if step.zone > 0 and step.pause > 0:
            raise self._step_wrong(
                step, k, "pause", step.pause, "0 because the step has a zone, or no zone"
            )
        if step.zone > 0 and not last and program.steps[k + 1].space != step.space:
            expected = (
                "0 between a MoveJ and a move of the tool, because only moves of one space can "
                "be blended"
            )
            raise self._step_wrong(step, k, "zone", step.zone, expected)

    def _group(
        self,
        program: Program,
        group: tuple[Step, ...],
        first: int,
        q_g: np.ndarray,
        position: np.ndarray,
        R: np.ndarray,
        time: float,
        timing: Vector | None,
    ) -> TimedSegment:
        """The timed segment of steps without a stop between them.

        Parameters
        ----------
        group : tuple of steps
            All joint moves, or all moves of the tool.
        first : int
            Number of the first step in the program.
        q_g : array (n_g,) [rad or m]
            Joints at its start.
        position, R : array [m], (3, 3)
            Pose of the tool there.
        time : float [s]
            Of the start.
        timing : vector or None
            Duration and coefficients of a given time law; None: the fastest one within the
            profile.
        """
        joints = isinstance(group[0], MoveJ)
        profile = tuple(program.joint_profile if joints else program.profile)
        if not profile:
            key = "joint_profile" if joints else "profile"
            raise wrong(
                program.where,
                self.name,
                key,
                "none",
                "bounds on speed, acceleration, ... of these steps",
            )
        segments: list[Segment] = []
        start, orientation = (q_g, None) if joints else (position, self._pose(R))
        here = start
        orientation_here = R
        for k, step in enumerate(group, first):
            if isinstance(step, MoveJ):
                end = self._end(step, partial(self._step_wrong, step, k), here)
                segment: Segment = Line(end - here, NO_ROTATION, largest=True)
                if not segment.total.any():
                    key, given = (
                        ("position", step.target.position) if step.target else ("end", step.end)
                    )
                    raise self._step_wrong(
                        step, k, key, given, "an end different from the start of the step"
                    )
            else:
                segment = self._segment(step, k, here[:POSITION], orientation_here, program.radius)
                axis, angle = axis_angle(segment.rotation)
                orientation_here = rotation_matrices(axis, np.array([angle]))[0] @ orientation_here
            segments.append(segment)
            here = here + segment.total
        zones = [step.zone for step in group[:-1]]
        self._corners(segments, zones, group, first)
        speeds = [self._speed(step, k, profile) for k, step in enumerate(group, first)]
        curve = BlendedCurve(start, orientation, segments, zones)
        space = "joint" if joints else "tool"
        if timing is not None:
            return TimedSegment(
                space, curve, SplineLaw(timing[0], tuple(timing[1:]), curve.length), time
            )
        try:
            law = plan_law(
                self.reference,
                space,
                curve,
                profile,
                program.smoothness,
                program.radius,
                q_g,
                speeds,
            )
        except SolverError as error:
            names = (
                f"step {first + 1}"
                if len(group) == 1
                else f"steps {first + 1} to {first + len(group)}"
            )
            raise SolverError(f"{self.name}, {names}: {error}") from None
        return TimedSegment(space, curve, law, time)
