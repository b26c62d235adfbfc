"""The folder of a move that is learned, its history, and the rule that ends learning.

    trajectory.csv       motion and torques of the next run, as `flexgen.solve` writes them
    command_0.csv, ...   the trajectories of all runs; 0: without a correction
    history.csv          a line for each measured run

Learning ends where the error does not fall any more, or grows. Errors of two runs differ by their
scatter: that of records of one trajectory where there are several, and at least that of the noise
of the records. A fall is one of more than twice the scatter and `FALL` of the best error, a growth
one of more than twice the scatter and `GROWTH`. Then the best trajectory is that of the next run.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import atomic_file, write_text
from flexgen.base.motion.trajectory import Trajectory

HISTORY = "history.csv"
TRAJECTORY = "trajectory"
ENDINGS = (".csv", ".npz")
KEY = "learning"  # of the number of its iteration in the meta data of a trajectory
# Smallest fall of the error over the best one, and largest growth of one that stays.
FALL = 0.05
GROWTH = 0.10
CERTAIN = 2.0  # scatters by which two errors differ

LEARNS = "learns"
ENDED = "no longer falls"
GREW = "grew"


@checked_class
@dataclass(frozen=True)
class LearningRun:
    """A measured run of a move that is learned.

    Attributes
    ----------
    iteration : int
        Number of the trajectory that ran; 0: without a correction.
    measured : str
        ``"tool"`` or ``"motors"``.
    rms, largest : float [m; of motors rad]
        Of the error along the path and after it.
    scatter : float [m; of motors rad]
        Of the rms error from run to run, as far as it is known.
    frequency_hz : float [Hz]
        Up to which the next run learns from this one, from 0 Hz on.
    gain : float
    state : str
        ``"learns"``, ``"no longer falls"`` or ``"grew"``: what the error did.
    record, digest : str
        File of the measurement, and the digest of its content.

    Examples
    --------
    >>> flexgen.LearningRun(0, "tool", 2e-4, 5e-4, 1e-6, 8.0, 1.0, "learns", "run.csv", "").unit
    'm'
    """

    iteration: int
    measured: str
    rms: float
    largest: float
    scatter: float
    frequency_hz: float
    gain: float
    state: str
    record: str
    digest: str

    @property
    def unit(self) -> str:
        """Unit of the errors."""
        return "m" if self.measured == "tool" else "rad"


def judge(
    before: Sequence[LearningRun], iteration: int, rms: float, largest: float, scatter: float
) -> str:
    """Judgment of the error of a run: ``learns``, ``no longer falls`` or ``grew``.

    Parameters
    ----------
    before : sequence of LearningRun
        Earlier runs with the same measurement.
    iteration : int
        Of the trajectory that ran. A repeated one is not judged: it shows the scatter.
    rms, largest, scatter : float
        In the unit of the errors.
    """
    others = [run for run in before if run.iteration != iteration]
    if not others or any(run.iteration == iteration for run in before):
        return LEARNS
    best = min(others, key=lambda run: run.rms)
    noise = CERTAIN * max(scatter, best.scatter)
    if rms > (1.0 + GROWTH) * best.rms + noise:
        return GREW
    return LEARNS if rms < (1.0 - FALL) * best.rms - noise else ENDED


def best_of(runs: Sequence[LearningRun]) -> int:
    """Iteration with the smallest rms error; of a repeated one the mean of its runs counts."""
    iterations = sorted({run.iteration for run in runs})
    means = [np.mean([run.rms for run in runs if run.iteration == k]) for k in iterations]
    return iterations[int(np.argmin(means))]


def scatter_of(runs: Sequence[LearningRun], iteration: int, rms: float) -> float:
    """Standard deviation of the rms errors of all runs that repeated one trajectory, with this
    one; 0 where none was repeated.
    """
    errors = [(run.iteration, run.rms) for run in runs] + [(iteration, rms)]
    squares = 0.0
    freedom = 0
    for k in {k for k, _ in errors}:
        own = [x for j, x in errors if j == k]
        squares += float(((np.array(own) - np.mean(own)) ** 2).sum())
        freedom += len(own) - 1
    return float(np.sqrt(squares / freedom)) if freedom else 0.0


@dataclass(frozen=True, eq=False)
class LearningFolder:
    """The folder of one move.

    ``path``; ``ending`` of its trajectories; ``trajectory``: of the run that was measured;
    ``iteration``: its number; ``runs``: earlier ones.
    """

    path: Path
    ending: str
    trajectory: Trajectory
    iteration: int
    runs: tuple[LearningRun, ...]

    def command(self, iteration: int) -> Path:
        """File of the trajectory of an iteration."""
        return self.path / f"command_{iteration}{self.ending}"

    @property
    def next_iteration(self) -> int:
        """Number of the next new trajectory."""
        known = {int(p.stem.removeprefix("command_")) for p in self.path.glob("command_*")}
        return max({*known, self.iteration, *(run.iteration for run in self.runs)}) + 1


def read_folder(path: str | Path) -> LearningFolder:
    """Read the folder of a move.

    Raises
    ------
    ArgumentError
        There is no trajectory, or two; the history is damaged, or the trajectory is not the one
        that the history has.
    """
    folder = Path(path)
    found = [f for f in (folder / f"{TRAJECTORY}{ending}" for ending in ENDINGS) if f.is_file()]
    if len(found) != 1:
        given = "no folder" if not folder.is_dir() else f"{len(found)} of them"
        raise ArgumentError(
            f"{folder}: given {given}, expected a folder with one file trajectory.csv or "
            f"trajectory.npz, the torques of the run: flexgen solve MODEL --move NAME --out "
            f"{folder / 'trajectory.csv'}"
        )
    file = found[0]
    trajectory = Trajectory.load(file)
    iteration = trajectory.meta.get(KEY, 0)
    if not isinstance(iteration, int) or iteration < 0:
        raise ArgumentError(f"{file}: given the iteration {iteration!r}, expected a number >= 0")
    runs = _read_history(folder / HISTORY)
    own = LearningFolder(folder, file.suffix, trajectory, iteration, runs)
    command = own.command(iteration)
    if runs and not command.is_file():
        raise ArgumentError(
            f"{file}: given the trajectory of iteration {iteration}, but {command.name} is "
            f"missing, expected the files that the last run left: restore them, or begin anew in "
            "an empty folder with flexgen solve"
        )
    if command.is_file() and command.read_bytes() != file.read_bytes():
        raise ArgumentError(
            f"{file}: differs from {command.name}, expected the trajectory that was written for "
            f"this run: copy {command.name} to {file.name}, or begin anew in an empty folder"
        )
    return own


def _read_history(file: Path) -> tuple[LearningRun, ...]:
    """The runs of a history file; none where there is no file."""
    if not file.is_file():
        return ()
    names = [f.name for f in fields(LearningRun)]
    runs = []
    try:
        rows = list(csv.reader(io.StringIO(file.read_text(encoding="utf-8"))))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ArgumentError(f"{file}: cannot be read: {error}") from None
    for line, row in enumerate(rows[1:], start=2):
        try:
            values = dict(zip(names, row, strict=True))
            rms, largest, scatter = (float(values[k]) for k in ("rms", "largest", "scatter"))
            band, gain = (float(values[k]) for k in ("frequency_hz", "gain"))
            if rows[0] != names or not np.isfinite([rms, largest, scatter, band, gain]).all():
                raise ValueError("other columns")
            runs.append(
                LearningRun(
                    int(values["iteration"]),
                    values["measured"],
                    rms,
                    largest,
                    scatter,
                    band,
                    gain,
                    values["state"],
                    values["record"],
                    values["digest"],
                )
            )
        except ValueError:
            raise ArgumentError(
                f"{file}:{line}: given {','.join(row)[:80]!r}, expected a run as flexgen writes "
                f"it: {','.join(names)}"
            ) from None
    return tuple(runs)


def write_folder(
    folder: LearningFolder, runs: Sequence[LearningRun], new: Trajectory | None, next_: int
) -> Path:
    """Write the next trajectory and the history.

    ``new``: a trajectory that is not in the folder yet, of the iteration ``next_``; None: that of
    ``next_`` is there. The trajectory is written last: until then the folder is that of the run
    before.
    """
    first = folder.command(folder.iteration)
    current = folder.path / f"{TRAJECTORY}{folder.ending}"
    if not first.exists():
        _copy(current, first)
    if new is not None:
        new.save(folder.command(next_))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([f.name for f in fields(LearningRun)])
    writer.writerows(asdict(run).values() for run in runs)
    write_text(folder.path / HISTORY, text.getvalue())
    _copy(folder.command(next_), current)
    return current


def _copy(source: Path, target: Path) -> None:
    """Copy a file, completely or not at all."""
    with atomic_file(target) as stream:
        stream.write(source.read_bytes())
