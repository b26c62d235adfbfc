"""Batches: joint moves in closed form of a shard, computed together by the emitted C."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexgen.base.errors import BuildError, FlexgenError
from flexgen.base.files.atomic_files import temporary_folder
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.codegen.build.generate import generate
from flexgen.dynamics.dae.signature import structural_index
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import limit_warnings
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.runtime import load
from flexgen.studies.sweeps.closed_form_batch import InverseDynamics, JointMoves, Peaks, unfit
from flexgen.studies.sweeps.jobs import Job, Row, Shard, failed_row

Derived = Callable[[str, RobotModel], Equations]

LIBRARIES: dict[str, InverseDynamics | None] = {}
MOVERS: dict[tuple[str, float, int], JointMoves] = {}
KEPT = 4  # models, and time laws, whose buffers a worker keeps


@dataclass(frozen=True)
class Batches:
    """The cases of a shard that can be computed in batches; the others are left to
    `flexgen.solve`.

    The case alone decides which of the two computes it, and so the bits of its results.
    """

    shard: Shard
    derived: Derived

    def rows(self) -> dict[int, tuple[Row, Row]]:
        """Rows of results and of times by the cases' numbers."""
        batches: dict[tuple[str, float, int], list[tuple[Job, Move]]] = {}
        for job in self.shard.jobs:
            robot = self.shard.robots[job.key]
            if (
                isinstance(robot, RobotModel)
                and job.method in ("auto", "closed-form")
                and self._unverified()
            ):
                move = _plain_move(job, robot)
                if move is not None:
                    batches.setdefault((job.key, move.duration, move.smoothness), []).append(
                        (job, move)
                    )
        out: dict[int, tuple[Row, Row]] = {}
        for (key, duration, smoothness), batch in batches.items():
            robot = self.shard.robots[key]
            assert isinstance(robot, RobotModel)  # checked above
            out |= self._batch(key, robot, TimeLaw(duration, smoothness), batch)
        return out

    def _unverified(self) -> bool:
        """Whether the options allow batches: no verification, and no option of a solver."""
        options = dict(self.shard.options)
        for name in ("batch", "time_limit"):
            options.pop(name, None)
        return options.pop("verify", True) is False and not any(
            value for value in options.values()
        )

    def _batch(
        self, key: str, robot: RobotModel, law: TimeLaw, batch: list[tuple[Job, Move]]
    ) -> dict[int, tuple[Row, Row]]:
        """Rows of results and times by number of the case, of the moves of one model (``key``: in
        the shard) and one time law; none where they cannot be computed in batches. Times are
        shared equally.
        """
        if unfit(robot):
            return {}
        wall = time.perf_counter()
        cpu = time.process_time()
        try:
            mover = self._mover(key, robot, law)
        except FlexgenError:  # flexgen.solve will report the reason
            return {}
        if mover is None:
            return {}
        starts = np.array([move.start for _, move in batch])
        ends = np.array([move.end for _, move in batch])
        rows = [
            {"move": move.name} | row
            for (_, move), row in zip(
                batch, figures_or_reasons(robot, mover, starts, ends), strict=True
            )
        ]
        took = {
            "wall": (time.perf_counter() - wall) / len(batch),
            "cpu": (time.process_time() - cpu) / len(batch),
        }
        return {job.number: (row, took) for (job, _), row in zip(batch, rows, strict=True)}

    def _mover(self, key: str, robot: RobotModel, law: TimeLaw) -> JointMoves | None:
        """The moves of a model and a time law; None where the torque would jump or have kinks: see
        `flexgen.solve`.
        """
        at = (key, law.duration, law.smoothness)
        if at not in MOVERS:
            equations = self.derived(key, robot)
            index = structural_index(equations).index
            if index is not None and law.smoothness < index:
                return None
            while len(MOVERS) >= KEPT:
                MOVERS.pop(next(iter(MOVERS)))
            MOVERS[at] = JointMoves(equations, law, _library(key, equations))
        return MOVERS[at]


def _plain_move(job: Job, robot: RobotModel) -> Move | None:
    """The move of a job where it is a joint move with a polynomial law, else None."""
    try:
        chosen = job.move_of(robot)
        move = chosen if isinstance(chosen, Move) else robot.move(chosen)
    except FlexgenError:
        return None
    if (
        move.type != "joint"
        or not move.duration > 0
        or len(move.start) != robot.n_g
        or len(move.end) != robot.n_g
    ):
        return None
    plain = Move(move.name, "joint", move.start, move.duration, move.smoothness, end=move.end)
    return plain if move == plain and np.isfinite([*move.start, *move.end]).all() else None


def _library(key: str, equations: Equations) -> InverseDynamics | None:
    """The emitted inverse dynamics of a model; None without a compiler, where CasADi computes
    it.
    """
    if key not in LIBRARIES:
        while len(LIBRARIES) >= KEPT:
            LIBRARIES.pop(next(iter(LIBRARIES)))
        try:
            with temporary_folder() as folder:
                made = generate(equations, f"{folder}/library", functions=["inverse_dynamics"])
                LIBRARIES[key] = load(made.directory).inverse_dynamics
        except BuildError:
            LIBRARIES[key] = None
    return LIBRARIES[key]


def figures_or_reasons(
    robot: RobotModel, mover: JointMoves, starts: np.ndarray, ends: np.ndarray
) -> list[Row]:
    """Rows of moves as `figures` makes them; a move that fails has the reason instead, and does
    not affect others.

    A batch that fails is halved until the moves that fail are alone.
    """
    try:
        return figures(robot, mover, starts, ends)
    except FlexgenError as error:
        if len(starts) == 1:
            return [failed_row(str(error))]
    half = len(starts) // 2
    halves = (slice(half), slice(half, None))
    return [
        row
        for rows in halves
        for row in figures_or_reasons(robot, mover, starts[rows], ends[rows])
    ]


def figures(
    robot: RobotModel, mover: JointMoves, starts: np.ndarray, ends: np.ndarray
) -> list[Row]:
    """Rows of the table of moves from ``starts`` to ``ends`` (N, n_g) [rad, m]: largest torque [N
    m], its root mean square, largest speed [rad/s], energy [J] and warnings.
    """
    peaks = mover.peaks(starts, ends)
    torque, rms, speed = (
        x.max(axis=1) for x in (peaks.torque_max, peaks.torque_rms, peaks.speed_max)
    )
    energy = peaks.energy.sum(axis=1)
    doubtful = _beyond(robot, peaks, starts, ends)
    beyond = [
        _warnings(robot, peaks, starts, ends, k) if doubtful[k] else () for k in range(len(starts))
    ]
    return [
        {
            "method_used": "closed-form",
            "status": (Status.LIMITS_EXCEEDED if beyond[k] else Status.SOLVED).value,
            "verdict": "not verified",
            "torque_max": float(torque[k]),
            "torque_rms": float(rms[k]),
            "speed_max": float(speed[k]),
            "energy": float(energy[k]),
            "iterations": 0,
            "samples": mover.n,
            "preactuation": 0.0,
            "warnings": "\n".join(beyond[k]),
        }
        for k in range(len(starts))
    ]


def _beyond(robot: RobotModel, peaks: Peaks, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Whether each move may exceed a limit, (N,): a quick test before warnings are written;
    arguments as for `figures`.
    """
    dofs = [robot.coordinates[i].dof for i in robot.i_g]
    low = np.minimum(starts, ends)
    high = np.maximum(starts, ends)
    out = np.zeros(len(starts), dtype=bool)
    for values, limits in (
        (peaks.torque_max, [motor.torque_max for motor in robot.motors]),
        (peaks.speed_max, [motor.speed_max for motor in robot.motors]),
        (peaks.speed, [None if dof is None else dof.speed_max for dof in dofs]),
        (peaks.acceleration, [None if dof is None else dof.acceleration_max for dof in dofs]),
        (high, [None if dof is None else dof.upper for dof in dofs]),
        (-low, [None if dof is None or dof.lower is None else -dof.lower for dof in dofs]),
    ):
        out |= (values > np.array([np.inf if limit is None else limit for limit in limits])).any(
            axis=1
        )
    return out


def _warnings(
    robot: RobotModel, peaks: Peaks, starts: np.ndarray, ends: np.ndarray, k: int
) -> tuple[str, ...]:
    """Limits of the model file that move k exceeds, worded as in a solution: two samples contain
    all the extremes.
    """
    channels = {
        "tau_m": np.tile(peaks.torque_max[k], (2, 1)),
        "v_m": np.tile(peaks.speed_max[k], (2, 1)),
        "q_a": np.stack([starts[k], ends[k]]),
        "v_a": np.tile(peaks.speed[k], (2, 1)),
        "a_a": np.tile(peaks.acceleration[k], (2, 1)),
    }
    ports = {name: Port(name, (x.shape[1],), "mixed", "extremes") for name, x in channels.items()}
    labels = {name: tuple(map(str, range(x.shape[1]))) for name, x in channels.items()}
    return limit_warnings(robot, Trajectory(np.array([0.0, 1.0]), channels, ports, labels))
