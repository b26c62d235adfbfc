"""`commission`: from a datasheet and a folder of records to a model that is known well enough for
feedforward.

1. Each record is compared with the model of the file; a mistake is named, and nothing is fitted.
2. One fit of bodies, springs, gears, friction, zeros and lengths to all records together, to four
   fifths of each record.
3. The rest of each record is the verdict: the model has to predict it better than the file, and
   where a tracker saw the robot, better than a rigid robot. Else the model is refused.
4. The same fit to all of the records.

The robot that is fitted has more than that of the file: a curve for each gear whose spring is
linear and, where a tracker followed a motion, friction of the joints behind their gears, and a
link that bends in its middle. Curves and bending that the records do not determine are left out,
and the fit is repeated.

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
from flexgen.identification.commissioning.blocks import Block, Channel
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.commissioning.folder import Records, list_records, read_records
from flexgen.identification.commissioning.forms import (
    BendingLink,
    friction_tolerances,
    measure_extent,
    with_bending_link,
    with_curves,
    with_joint_friction,
)
from flexgen.identification.commissioning.joint_fit import JointFit, fit_jointly
from flexgen.identification.commissioning.misfit import measure_misfit
from flexgen.identification.commissioning.motion_block import MotionBlock
from flexgen.identification.commissioning.poses_block import PosesBlock, in_frame
from flexgen.identification.commissioning.quick_moves import find_quicker_moves
from flexgen.identification.commissioning.reasons import check_payload_of
from flexgen.identification.commissioning.record_faults import check_motion, check_responses
from flexgen.identification.commissioning.responses_block import ResponsesBlock
from flexgen.identification.commissioning.result import Commissioning, HeldOut
from flexgen.identification.commissioning.unknowns import (
    DatasheetTolerances,
    FormNumbers,
    Unknowns,
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
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

Tell = Callable[[str], None]
HELD_OUT = 5  # one part of so many of each record is held out
POSES_OF_MOTION = 60  # samples of a tracked motion that find the frame of its tracker
# Factor of the errors on held-out parts above which a model is refused.
WORSE = 1.02
# Misfit of positions over elastic displacement from which on a model is refused.
MOST_MISFIT = 1.0
# Rise of the logarithm of a stiffness that is one: standard deviations, and at least.
SURE = 2.5
LEAST_RISE = 0.05


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
        Give all gears a stiffness that rises with the load; default: where the records determine
        it.
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
        tell("testing the payload of the file")
        payload = check_payload_of(robot, data.motions)
        file = first.fit_own()
        chosen = _richest(first, curves)
        verdict = chosen.judge(file, chosen.start_near(first.unknowns, file.x))
        simpler = None if is_over() else _without_undetermined(chosen, verdict.fit, curves)
        if simpler is not None:
            tell("the records do not ask for all of these numbers: a simpler form of the robot")
            near = simpler.start_near(chosen.unknowns, verdict.fit.x)
            chosen = simpler
            verdict = chosen.judge(file, near)
        fit = verdict.fit if is_over() else chosen.fit_all(verdict.fit)
    if chosen.bending is not None:
        robot = chosen.bending.robot
    quicker = find_quicker_moves(first.file, chosen.blocks)
    found = _result(robot, chosen, data, verdict, fit, time.perf_counter() - began)
    return replace(found, payload=payload, quicker=quicker)


_Errors = dict[tuple[str, str, str], float]


@dataclass(frozen=True, eq=False)
class _File:
    """The model of the file: numbers x with those that records have of their own, and ``errors``
    on held-out parts, those of a rigid robot too, by record, channel and unit.
    """

    x: np.ndarray
    errors: _Errors
    rigid: _Errors


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
        first: _Study | None = None,
        bending: BendingLink | None = None,
        curved: bool = False,
    ) -> None:
        self.file = robot
        self.first = self if first is None else first
        self.bending = bending
        self.curved = curved
        self.extent = measure_extent(robot, data.motions)
        if any(motion.positions is not None for motion in data.motions):
            robot = with_joint_friction(robot, self.extent)
            rubbing = friction_tolerances(robot, self.extent)
        else:
            rubbing = {}
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
            form=FormNumbers(rubbing, () if bending is None else (bending.tip,)),
        )
        needs = bool(data.motions) or data.has_positions
        self.arm = ElasticArm(unknowns, unknowns.sensors) if needs else None
        self._blocks: list[Block] | None = None
        self.start = unknowns.start.copy()

    def check_records(self) -> None:
        """ArgumentError where a record does not belong to the robot."""
        for index, motion in enumerate(self.data.motions):
            assert self.arm is not None
            check_motion(self.arm, motion, index, self.tell)
        for name, responses in self.data.responses:
            self.tell(f"comparing {name} with the model of the file")
            check_responses(self.plain, name, responses)
        self._find_frame()

    def _find_frame(self) -> None:
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
            assert self.arm is not None
            self.tell(f"preparing {motion.name}")
            block = MotionBlock(self.arm, motion, index)
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
        if not of_lengths:
            return np.zeros((len(commands), 3 * len(self.unknowns.sensors), 0))
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
        if channel.neighbors and count >= HELD_OUT and channel.unit != "1":
            return channel.piece >= count - max(1, count // HELD_OUT)
        each = min(HELD_OUT, count)
        return channel.piece % each == each - 1

    def fit_own(self) -> _File:
        """The model of the file with what a record has of its own, such as the frame of a tracker
        and friction, fitted to four fifths of each record; and its errors on the others.
        """
        parts = self.unknowns.parts
        own = np.ones(parts.size, bool)
        own[parts.model] = own[parts.zeros] = own[parts.lengths] = False
        fit = fit_jointly(
            self.unknowns, self.blocks, self.start, self.tell, keep=self.keep_fitted,
            free=own, rounds=2, what="model of the file",
        )  # fmt: skip
        return _File(fit.x, self._errors(fit.x), self._rigid_errors(fit.x))

    def start_near(self, others: Unknowns, x: np.ndarray) -> np.ndarray:
        """Start of a search at the numbers x of another form of the robot: a gear with a curve has
        the stiffness of one without at large torques, and the ratio of both as at first; both
        halves of a link change as the link.
        """
        values = dict(zip(others.names, x - others.start, strict=True))
        out = self.unknowns.start.copy()
        for k, name in enumerate(self.unknowns.names):
            part, _, kind = name.rpartition(".")
            if self.bending is not None and part == self.bending.tip:
                part = self.bending.link
            kinds = {"low": "stiffness", "high": "stiffness", "stiffness": "high"}
            same = f"{part}.{kind}"
            if same not in values:
                same = f"{part}.{kinds.get(kind, kind)}"
            out[k] = self.unknowns.start[k] + values.get(name, values.get(same, 0.0))
        return np.clip(out, *self.unknowns.bounds)

    def judge(self, file: _File, start: np.ndarray) -> _Verdict:
        """Fit four fifths of each record, and compare the errors on the others."""
        fit = fit_jointly(
            self.unknowns, self.blocks, start, self.tell, keep=self.keep_fitted,
            what="fit without a fifth",
        )  # fmt: skip
        after = self._errors(fit.written)
        rows = [HeldOut(*key, file.errors[key], after[key], file.rigid.get(key)) for key in after]
        misfit = measure_misfit(self.blocks, fit.written, self.held_out_rows)
        return _Verdict(fit, tuple(rows), misfit)

    def fit_all(self, near: JointFit) -> JointFit:
        """Fit all parts of all records."""
        return fit_jointly(
            self.unknowns, self.blocks, near.x, self.tell, rounds=3, what="fit to all"
        )

    def _errors(self, x: np.ndarray) -> _Errors:
        """Record, channel and unit -> root mean square of the errors on held-out parts; all
        elements of responses are one.
        """
        squares: dict[tuple[str, str, str], list[np.ndarray]] = {}
        for block in self.blocks:
            block.relinearize(x)
            for channel in block.channels(x, False):
                rows = self.held_out_rows(channel) & channel.told
                if not rows.any():
                    continue
                title = block.kind if block.kind == ResponsesBlock.kind else channel.title
                key = block.name, title, channel.unit
                squares.setdefault(key, []).append(channel.residual[rows] ** 2)
        return {key: float(np.sqrt(np.mean(np.concatenate(x)))) for key, x in squares.items()}

    def _rigid_errors(self, x: np.ndarray) -> _Errors:
        """Record, channel and unit -> error of the positions of a rigid robot on held-out parts
        [m], with the frame and the trackers that are best for it.
        """
        out: _Errors = {}
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


def _study_of(first: _Study, has_curves: bool, bends: bool) -> _Study:
    """The study of a form of the robot, as far as the robot has it: gears with curves, and a link
    that bends where a tracker followed a motion.
    """
    tracked = any(motion.positions is not None for motion in first.data.motions)
    bending = with_bending_link(first.file) if bends and tracked else None
    robot = first.file if bending is None else bending.robot
    curved = with_curves(robot, first.extent) if has_curves else None
    if bending is None and curved is None:
        return first
    new = robot if curved is None else curved
    return _Study(
        new, first.data, first.tolerances, first.lengths, first.tell, first, bending, bool(curved)
    )


def _richest(first: _Study, curves: bool | None) -> _Study:
    """The form with all numbers that records may ask for."""
    return _study_of(first, curves is not False, True)


def _without_undetermined(study: _Study, fit: JointFit, curves: bool | None) -> _Study | None:
    """The form without the curves, or the link that bends, that a fit does not determine; None:
    it determines them.
    """
    has_curves = study.curved and (bool(curves) or _has_curves(fit))
    bends = study.bending is not None and _bends(fit, study.bending)
    if has_curves == study.curved and bends == (study.bending is not None):
        return None
    return _study_of(study.first, has_curves, bends)


def _bends(fit: JointFit, bending: BendingLink) -> bool:
    """Whether the stiffness of a link is determined."""
    names = fit.unknowns.names
    own = tuple(f"{dof.name}.stiffness" for e in bending.robot.elements if e.name == bending.tip
                for dof in e.dofs)  # fmt: skip
    return any(bool(fit.determined[names.index(name)]) for name in own)


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
    if verdict.misfit is not None and verdict.misfit > MOST_MISFIT:
        status = FitStatus.POORLY_VALIDATED
        problems.append(
            f"positions of held-out parts are off by {verdict.misfit:.2g} times the elastic "
            "displacement: a tracker that jumped, a target that slipped, or noise as large as the "
            "deflections"
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
