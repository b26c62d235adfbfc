"""`commission`: from a datasheet and a folder of records to a model that is known well enough for
feedforward.

1. Each record is compared with the model of the file; a mistake is named, and nothing is fitted.
2. One fit of bodies, springs, gears, friction, zeros and lengths to all records together, to four
   fifths of each record.
3. The rest of each record is the verdict: the model has to predict it better than the file, and
   where a tracker saw the robot, better than a rigid robot. Else the model is refused.
4. The same fit to all of the records.
5. Gears whose stiffness rises with their load: the fit again with a curve for each gear, which is
   taken where it predicts the rest of the records better.

There is no order of steps in which an error of the first is a trap for the next: bodies that are
fitted before the springs take the springs' errors, and the reverse. In one fit the bodies stay
within the tolerance of their CAD, and records of all kinds determine the springs.

Zeros and lengths act on positions only; torques see a zero through the angle of gravity, and no
lengths: their changes of a millimetre are less than what torques show.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flexgen.base.calls.deadline import is_over, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import TimeLimit
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.hysteresis.hysteresis import without_hysteresis
from flexgen.dynamics.mechanics.lagrangian import gears as gears_of
from flexgen.identification.commissioning.blocks import Block, Channel
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.commissioning.folder import Records, list_records, read_records
from flexgen.identification.commissioning.joint_fit import JointFit, fit_jointly
from flexgen.identification.commissioning.misfit import measure_misfit
from flexgen.identification.commissioning.motion_block import MotionBlock
from flexgen.identification.commissioning.poses_block import PosesBlock, in_frame
from flexgen.identification.commissioning.record_faults import check_motion, check_responses
from flexgen.identification.commissioning.responses_block import ResponsesBlock
from flexgen.identification.commissioning.result import Commissioning, HeldOut
from flexgen.identification.commissioning.unknowns import (
    DatasheetTolerances,
    linear_geometry,
    make_unknowns,
)
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.poses.frames import search_start
from flexgen.identification.poses.mistakes import find_start
from flexgen.identification.poses.poses import StaticPoses
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tree import Tree
from flexgen.model.abilities import check_ability
from flexgen.model.elements import Dof, LinearSpring, RobotModel, SmoothSpring
from flexgen.model.reader import read

Tell = Callable[[str], None]
HELD_OUT = 5  # one part of so many of each record is held out
POSES_OF_MOTION = 60  # samples of a tracked motion that find the frame of its tracker
# Of the errors on held-out parts: a curve of the gears is taken up to this factor, and a model is
# refused above the other.
WORTH_IT = 0.97
WORSE = 1.02
# Rise of the logarithm of a stiffness that is one: standard deviations, and at least.
SURE = 2.5
LEAST_RISE = 0.05
# Torque of a gear over its largest one, or over that of the records, at which its curve bends.
BEND = 0.1


@checked_types(own=("time_limit",))
@reported("commission")
def commission(
    model: str | Path | RobotModel,
    records: Records | str | Path,
    *,
    tolerances: DatasheetTolerances | None = None,
    lengths: bool = True,
    curves: bool | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> Commissioning:
    """Fit a model from a datasheet to a folder of records: bodies, springs, gears, friction, zeros
    and lengths in one fit.

    Parameters
    ----------
    model : name, path or RobotModel
        With plausible springs, and a tracker for each point whose position was measured.
    records : Records, or the name of their folder
        Motions, tracked motions, static poses and responses; see
        `flexgen.identification.commissioning.folder`.
    tolerances : DatasheetTolerances, optional
        How well the model is known: priors of all numbers.
    lengths : bool
        Fit the places of the elements, where positions were measured.
    curves : bool, optional
        Give all gears a stiffness that rises with the load; default: where it predicts held-out
        parts better.
    time_limit : float, optional [s]
        Time limit: then, or after Ctrl-C, the result is the best step so far; 0: no limit.
    progress : callable or bool, optional

    Returns
    -------
    Commissioning

    Raises
    ------
    ArgumentError
        A record does not belong to the model; the error names it, and the mistake where one
        explains it.
    SolverError
        The model does not rest at a pose of the records.

    Examples
    --------
    >>> from pathlib import Path
    >>> Path("lab").mkdir()
    >>> _ = flexgen.solve("elbow").trajectory.save("lab/move.csv")
    >>> found = flexgen.commission("elbow", "lab")  # one short motion, no tracker
    >>> found.missing[0].partition(";")[0]
    'not determined: q1.damping, q2.damping'
    """
    tell: Tell = progress if callable(progress) else lambda line: None
    began = time.perf_counter()
    robot = model if isinstance(model, RobotModel) else read(model)
    check_ability(robot, "identify_gears")
    known = DatasheetTolerances() if tolerances is None else tolerances
    if isinstance(records, Records):
        data = records
    else:
        trackers = [s for s in robot.sensors if s.type == "tracker"]
        data = read_records(robot, list_records(records, robot), trackers, tell)
    if not any(data.kinds.values()):
        raise ArgumentError("records: given none, expected a motion, poses or responses")
    with limit_fit("commission", time_limit, tell):
        first = _Study(robot, data, known, lengths, tell)
        first.check_records()
        other = None if curves is False else _with_curves(first)
        chosen = other if curves and other is not None else first
        verdict = chosen.judge()
        if curves is None and other is not None and not is_over():
            judged = other.judge()
            better = _factor(judged.held_out, verdict.held_out)
            tell(f"gears with a curve: errors on held-out parts are {better:.3g} times")
            if better < WORTH_IT and _has_curves(judged.fit):
                chosen = other
                verdict = judged
        fit = verdict.fit if is_over() else chosen.fit_all(verdict.fit)
    return _result(robot, chosen, data, verdict, fit, time.perf_counter() - began)


@dataclass(frozen=True, eq=False)
class _Verdict:
    """Fit to a part of the records, errors on the others, and their `measure_misfit`."""

    fit: JointFit
    held_out: tuple[HeldOut, ...]
    misfit: float | None


class _Study:
    """A robot, its records and the blocks of residuals that they give."""

    def __init__(
        self,
        robot: RobotModel,
        data: Records,
        tolerances: DatasheetTolerances,
        lengths: bool,
        tell: Tell,
    ) -> None:
        self.robot = robot
        self.plain = plain = without_hysteresis(robot)
        self.data = data
        self.tolerances = tolerances
        self.lengths = lengths
        self.tell = tell
        tell("equations of the arm behind its motors")
        self.unknowns = unknowns = make_unknowns(
            plain,
            tolerances,
            bodies=bool(data.motions or data.responses),
            positions=data.has_positions,
            lengths=lengths and data.has_positions,
            motions=len(data.motions),
            levels=len(data.responses),
        )
        self.torques = ElasticArm(unknowns, ()) if data.motions else None
        self.arm = ElasticArm(unknowns, unknowns.sensors) if data.has_positions else None
        self._blocks: list[Block] | None = None
        self.start = unknowns.start.copy()

    def check_records(self) -> None:
        """ArgumentError where a record does not belong to the robot."""
        for index, motion in enumerate(self.data.motions):
            assert self.torques is not None
            check_motion(self.torques, motion, index, self.tell)
        for name, responses in self.data.responses:
            self.tell(f"comparing {name} with the model of the file")
            check_responses(self.plain, name, responses)
        self._find_frame(check=True)

    def _find_frame(self, check: bool) -> None:
        """Frame and trackers at the start, from the robot without deflections; poses with a
        mistake are refused.
        """
        if not self.data.has_positions:
            return
        tree = Tree(linear_geometry(self.plain))
        sets = [(name, poses) for name, poses in self.data.poses]
        inverse = np.linalg.inv(self.plain.eta)
        for motion in self.data.motions:
            if motion.positions is None:
                continue
            rows = np.linspace(0, len(motion.positions) - 1, POSES_OF_MOTION).astype(int)
            q = motion.trajectory["q_m"][rows] @ inverse.T
            p = motion.positions[rows].reshape(len(rows), -1, 3)
            sets.append((motion.name, StaticPoses(q, p, motion.name)))
        if check:
            for _, poses in sets:
                find_start(Statics(tree, poses.commands), poses, (), self.tell)
        statics = Statics(tree, np.vstack([poses.commands for _, poses in sets]))
        measured = np.concatenate([poses.positions for _, poses in sets])
        rigid = replace(Numbers.of(tree), compliances=np.zeros(len(tree.elastic)))
        found = search_start(statics, measured, (), rigid)[1]
        parts = self.unknowns.parts
        self.start[parts.frame] = found.frame
        self.start[parts.trackers] = np.clip(
            found.trackers.ravel(),
            self.unknowns.start[parts.trackers] - self.tolerances.tracker,
            self.unknowns.start[parts.trackers] + self.tolerances.tracker,
        )

    @property
    def blocks(self) -> list[Block]:
        """Blocks of all records."""
        if self._blocks is None:
            self._blocks = self._make_blocks()
        return self._blocks

    def _make_blocks(self) -> list[Block]:
        out: list[Block] = []
        for index, motion in enumerate(self.data.motions):
            arm = self.torques if motion.positions is None else self.arm
            assert arm is not None
            self.tell(f"preparing {motion.name}")
            block = MotionBlock(arm, motion, index)
            if motion.positions is not None:
                commands = block.q_m @ np.linalg.inv(self.plain.eta).T
                block.of_lengths = self._slopes_of_lengths(commands)
            out.append(block)
        for name, poses in self.data.poses:
            assert self.arm is not None
            slopes = self._slopes_of_lengths(poses.commands)
            out.append(PosesBlock(self.arm, name, poses, slopes))
        for index, (name, responses) in enumerate(self.data.responses):
            out.append(ResponsesBlock(self.unknowns, name, responses, index))
        return out

    def _slopes_of_lengths(self, commands: np.ndarray) -> np.ndarray:
        """Derivatives (N, 3 k, lengths) of the trackers in the world in the lengths."""
        tree = Tree(linear_geometry(self.plain))
        of_lengths = [u for u in self.unknowns.places if not u.name.endswith(".zero")]
        numbers = Numbers.of(tree)
        statics = Statics(tree, commands)
        rest = statics.rest(numbers)
        J, _ = statics.slopes(numbers, rest, of_lengths)
        return np.asarray(J.reshape(len(commands), -1, len(of_lengths)))

    def keep_fitted(self, name: str, channel: Channel) -> np.ndarray:
        """Rows of a channel that are not held out: of motions, the last fifth is; else every
        fifth part.
        """
        return ~self.held_out_rows(channel)

    def held_out_rows(self, channel: Channel) -> np.ndarray:
        """Rows that the verdict is on; none of a record of one part."""
        count = int(channel.piece.max(initial=0)) + 1
        if count < 2:
            return np.zeros(len(channel.piece), bool)
        if channel.neighbors and count >= HELD_OUT and channel.title != "responses":
            return channel.piece >= count - max(1, count // HELD_OUT)
        each = min(HELD_OUT, count)
        return channel.piece % each == each - 1

    def judge(self) -> _Verdict:
        """Fit four fifths of each record, and compare the errors on the others."""
        parts = self.unknowns.parts
        # what a record has of its own is fitted for the model of the file, too
        own = np.ones(parts.size, bool)
        own[parts.model] = own[parts.zeros] = own[parts.lengths] = False
        file = fit_jointly(
            self.unknowns, self.blocks, self.start, self.tell, keep=self.keep_fitted,
            free=own, rounds=2, what="model of the file",
        )  # fmt: skip
        before = self._errors(file.x)
        fit = fit_jointly(
            self.unknowns, self.blocks, file.x, self.tell, keep=self.keep_fitted,
            what="fit without a fifth",
        )  # fmt: skip
        after = self._errors(fit.written)
        rigid = self._rigid_errors(file.x)
        rows = [HeldOut(*key, before[key], after[key], rigid.get(key)) for key in after]
        misfit = measure_misfit(self.blocks, fit.written, self.held_out_rows)
        return _Verdict(fit, tuple(rows), misfit)

    def fit_all(self, near: JointFit) -> JointFit:
        """Fit all parts of all records."""
        return fit_jointly(
            self.unknowns, self.blocks, near.x, self.tell, rounds=3, what="fit to all"
        )

    def _errors(self, x: np.ndarray) -> dict[tuple[str, str, str], float]:
        """Record, channel and unit -> root mean square of the errors on held-out parts."""
        out = {}
        for block in self.blocks:
            block.relinearize(x)
            for channel in block.channels(x, False):
                rows = self.held_out_rows(channel) & channel.told
                if rows.any():
                    rms = float(np.sqrt(np.mean(channel.residual[rows] ** 2)))
                    out[block.name, channel.title, channel.unit] = rms
        return out

    def _rigid_errors(self, x: np.ndarray) -> dict[tuple[str, str, str], float]:
        """Record, channel and unit -> error of the positions of a rigid robot on held-out parts
        [m], with the frame and the trackers that are best for it.
        """
        out: dict[tuple[str, str, str], float] = {}
        for block in self.blocks:
            if isinstance(block, PosesBlock):
                q = block.commands
                measured = block.measured
            elif isinstance(block, MotionBlock) and block.positions is not None:
                q = block.inner(block.q_m) @ np.linalg.inv(self.plain.eta).T
                measured = np.where(block.seen, block.measured_positions(x), np.nan)
            else:
                continue
            tree = Tree(linear_geometry(self.plain))
            statics = Statics(tree, q)
            y = measured.reshape(len(q), -1, 3)
            rigid = replace(Numbers.of(tree), compliances=np.zeros(len(tree.elastic)))
            channel = next(c for c in block.channels(x, False) if c.title == "positions")
            rows = self.held_out_rows(channel).reshape(len(q), -1)[:, 0]
            found = search_start(statics.among(np.flatnonzero(~rows)), y[~rows], (), rigid)[1]
            rest = statics.rest(found, rigid=True)
            points = in_frame(found.frame, rest.points.reshape(len(q), -1))
            errors = (points - measured)[rows]
            out[block.name, "positions", "m"] = float(np.sqrt(np.nanmean(errors**2)))
        return out


def _factor(new: Sequence[HeldOut], old: Sequence[HeldOut]) -> float:
    """Geometric mean of the errors on held-out parts over the old ones: of each record the mean
    of its channels.
    """
    before = {(row.record, row.channel): row.after for row in old}
    logs: dict[str, list[float]] = {}
    for row in new:
        ratio = max(row.after, 1e-300) / max(before[row.record, row.channel], 1e-300)
        logs.setdefault(row.record, []).append(float(np.log(ratio)))
    return float(np.exp(np.mean([np.mean(x) for x in logs.values()]))) if logs else 1.0


def _has_curves(fit: JointFit) -> bool:
    """Whether the stiffness of a gear rises by more than a few percent and its accuracy."""
    names = list(fit.unknowns.names)
    for name in names:
        if not name.endswith(".low"):
            continue
        joint = name.removesuffix(".low")
        low = names.index(name)
        high = names.index(f"{joint}.high")
        rise = fit.x[high] - fit.x[low]
        C = fit.covariance
        sd = np.sqrt(max(C[low, low] + C[high, high] - 2 * C[low, high], 0.0))
        if rise > max(SURE * sd, LEAST_RISE):
            return True
    return False


def _with_curves(study: _Study) -> _Study | None:
    """The study with springs of gears that stiffen; None: no gear has a linear spring."""
    robot = study.robot
    largest = {}
    for motor in robot.motors:
        for joint, ratio in zip(motor.drives, motor.ratio, strict=True):
            largest[joint] = abs(ratio) * (motor.torque_max or 0.0)
    for motion in study.data.motions:
        arm = np.abs(motion.trajectory["tau_m"] @ robot.eta).max(axis=0)
        for i, torque in zip(robot.i_g, arm.tolist(), strict=True):
            name = robot.coordinates[i].name
            largest[name] = largest.get(name) or torque
    ratios = {
        robot.coordinates[i].name: ratio
        for i, (_, ratio) in zip(robot.i_g, gears_of(robot), strict=True)
    }
    changed = []

    def change(dof: Dof) -> Dof:
        gear = dof.gear
        if gear is None or not isinstance(gear.spring, LinearSpring):
            return dof
        stiffness = gear.spring.stiffness
        side = ratios[dof.name] if gear.side == "motor" else 1.0
        torque = BEND * (largest.get(dof.name) or 0.0) / side
        at = torque / stiffness if torque > 0.0 else 1e-4
        changed.append(dof.name)
        spring = SmoothSpring(low=0.8 * stiffness, high=stiffness, break_at=at)
        return replace(dof, gear=replace(gear, spring=spring))

    elements = tuple(
        replace(element, dofs=tuple(change(dof) for dof in element.dofs))
        for element in robot.elements
    )
    if not changed:
        return None
    new = replace(robot, elements=elements)
    other = _Study(new, study.data, study.tolerances, study.lengths, study.tell)
    other._find_frame(check=False)
    return other


# The verdict on a fit is what it predicts: a search that ends where no step is better, as on
# records with hysteresis, is not refused where its numbers predict the held-out parts.
ENDED_EARLY = (
    "the search ended at its best step, before the minimum that its quadratic model predicts; the "
    "errors on held-out parts are the verdict"
)


def _result(
    robot: RobotModel,
    study: _Study,
    data: Records,
    verdict: _Verdict,
    fit: JointFit,
    wall_s: float,
) -> Commissioning:
    """Status and sentences of a fit."""
    status = FitStatus.FITTED
    problems = []
    factor = _factor(
        verdict.held_out, [replace(row, after=row.before) for row in verdict.held_out]
    )
    if not verdict.held_out:
        status = FitStatus.NOT_CHECKED
    elif factor > WORSE:
        status = FitStatus.POORLY_VALIDATED
        problems.append(
            f"the fitted model predicts held-out parts {factor:.3g} times as badly as the file"
        )
    for row in verdict.held_out:
        if row.rigid is not None and row.after > WORSE * row.rigid:
            status = FitStatus.POORLY_VALIDATED
            problems.append(
                f"{row.record}: positions of held-out parts are off by {1e3 * row.after:.3g} mm, "
                f"those of a rigid robot by {1e3 * row.rigid:.3g} mm"
            )
    notes = [*data.notes]
    if not fit.converged and status is FitStatus.FITTED:
        notes.append(ENDED_EARLY)
    elif not fit.converged and status is FitStatus.NOT_CHECKED:
        status = FitStatus.NOT_CONVERGED
    if reason := reason_of_end():
        status = FitStatus.of_value(reason)
    return Commissioning(
        robot, study.robot, fit, status, tuple(problems), verdict.held_out, data.kinds,
        tuple(notes), wall_s, verdict.misfit,
    )  # fmt: skip
