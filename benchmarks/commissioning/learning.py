"""Learning on the true robot: tool errors of runs whose torques `flexgen learn --measured` wrote.

    python benchmarks/commissioning/learning.py FOLDER MODEL [--robot three_axes] [--seed 1]

solves each test path with MODEL, such as `commissioned.toml@commissioned`, lets the true robot run
it, and learns from what a tracker and the encoders show, three times. The user has: the record of
the drives, whose clock says when the path begins; positions of a tracker at the tool, with noise,
at a rate and with a clock of its own, which is another one in each run; and the frame of the
tracker as the static poses `FOLDER/poses.csv` give it with MODEL. `--known clock`, `--known frame`
or `--known clock,frame` state the true ones instead, to see what they cost.
"""

from __future__ import annotations

import argparse
import json
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from benchmarks.commissioning.chains import rigid_pose
from benchmarks.commissioning.datasheet import listed, write_samples
from benchmarks.commissioning.paths import test_paths
from benchmarks.commissioning.plant import Motion, Plant
from benchmarks.commissioning.records import frame, motor_names, write_table
from benchmarks.commissioning.robots import NAMES, draw
from benchmarks.commissioning.score import named_path, read_feedforward
from benchmarks.commissioning.trial import solved

RUNS = 4  # the first one without a correction
NOISE = 3e-5  # m, of each coordinate of the tracker
EVERY = 4  # samples of the drives between two rows
OFFSET = 0.02  # s: largest offset of the tracker's clock from that of the drives
DRIFT = 2e-5  # of the tracker's clock
BEFORE = 0.3  # s at rest before the feedforward begins
AFTER = 0.5  # s after the path that count


@dataclass(frozen=True)
class Run:
    """A run of the true robot: instants (N,) [s], 0 where the path begins, and its motion."""

    time: np.ndarray
    motion: Motion


def run(plant: Plant, table: Path, duration: float) -> Run:
    """The motion of the true robot under torques and references of a file."""
    given = read_feedforward(table)
    sample = plant.hardware.sample_s
    begin = min(given.time[0], 0.0) - BEFORE
    end = duration + 2 * AFTER
    time = begin + sample * np.arange(round((end - begin) / sample))
    inside = np.clip(time, given.time[0], given.time[-1])
    motion = plant.run(
        CubicSpline(given.time, given.angles)(inside),
        CubicSpline(given.time, given.torques)(inside),
    )
    return Run(time, motion)


def largest_error(plant: Plant, path: str, done: Run) -> float:
    """Largest distance of the tool from the path in the frame of the base [m]."""
    tested = named_path(plant, path)
    place, _ = rigid_pose(plant.chain, tested.start())
    away = np.linalg.norm(done.motion.tool - place - tested.displacement(done.time), axis=1)
    counted = (done.time >= 0.0) & (done.time <= tested.duration + AFTER)
    return float(away[counted].max())


def with_paths_in_base(model: str, plant: Plant, place: Path) -> str:
    """The model with the test paths as positions in the base, as `NAME_in_base`.

    The paths of the data sheet begin where the joints are at stated angles: with other lengths
    and zeros that is another place.
    """
    file, _, variant = model.partition("@")
    text = Path(file).read_text(encoding="utf-8")
    for path in test_paths(plant.chain):
        write_samples(path, plant.chain, place / f"{path.name}_in_base.csv")
        text += f'\n[[move]]\nname = "{path.name}_in_base"\ntype = "sampled"\n'
        text += f'start_deg = {listed(path.start_deg)}\nfile = "{path.name}_in_base.csv"\n'
        text += "degree = 9\n"
    out = place / "in_base.toml"
    out.write_text(text, encoding="utf-8")
    return f"{out}@{variant}" if variant else str(out)


def write_record(plant: Plant, done: Run, file: Path, seed: int, iteration: int) -> float:
    """Record of a run: motor angles by the clock of the drives, the tool by that of the tracker.

    Returns
    -------
    Offset of the tracker's clock [s].

    """
    random = np.random.default_rng([seed, iteration, 77])
    offset = float(random.uniform(-OFFSET, OFFSET))
    time = done.motion.time
    rows = slice(None, None, EVERY)
    seen_at = np.clip(offset + (1.0 + DRIFT) * time[rows], 0.0, time[-1])
    tool = CubicSpline(time, done.motion.tool)(seen_at)
    turn, place = frame(seed)
    tool = tool @ turn.T + place + NOISE * random.normal(size=tool.shape)
    n = plant.n
    names = [*motor_names(n)[: 1 + n], *(f"tool_{axis} m" for axis in "xyz")]
    write_table(file, names, np.column_stack([time[rows], done.motion.angles[rows], tool]))
    return offset


def true_frame(seed: int) -> np.ndarray:
    """Pose of the tracker in the base (6,): position [m] and rotation vector [rad]."""
    turn, place = frame(seed)
    return np.concatenate([-turn.T @ place, Rotation.from_matrix(turn.T).as_rotvec()])


def words_of_drives(plant: Plant) -> list[str]:
    """Options of `flexgen learn` for the feedback of the drives."""
    sample = plant.hardware.sample_s
    return ["--sample-time", repr(sample), "--delay", repr(sample)]


def learned_errors(
    plant: Plant,
    model: str,
    path: str,
    place: Path,
    seed: int,
    frame_words: list[str],
    is_clock_known: bool,
) -> tuple[list[float], list[dict[str, object]]]:
    """Largest error of each run [m], and what `flexgen learn` says of each."""
    from flexgen.cli.main import main as flexgen

    place.mkdir(parents=True, exist_ok=True)
    for old in (*place.glob("command_*"), place / "history.csv"):
        old.unlink(missing_ok=True)
    table = solved(model, f"{path}_in_base", "auto", place / "trajectory.csv")
    duration = named_path(plant, path).duration
    errors = []
    said = []
    for iteration in range(RUNS):
        done = run(plant, table, duration)
        errors.append(largest_error(plant, path, done))
        file = place / f"run_{iteration}.csv"
        offset = write_record(plant, done, file, seed, iteration)
        clock = -float(done.time[0])
        words = ["learn", model, "--measured", str(file), "--folder", str(place), "--json", "-q"]
        words += words_of_drives(plant)
        if is_clock_known:
            words += ["--clock", repr(clock - offset)]
        else:
            words += ["--clock", repr(clock), "--clock-of", "drives"]
        words += frame_words
        text = StringIO()
        with redirect_stdout(text):
            flexgen(words)
        found = json.loads(text.getvalue())
        late = found["clock_s"] - (clock - offset)
        said.append({**found, "late_s": late})
    return errors, said


def main() -> None:
    """Table of the errors of all runs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("model")
    parser.add_argument("--robot", choices=NAMES, default="three_axes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--known", default="")
    parser.add_argument("--paths", default="")
    given = parser.parse_args()
    plant = Plant(draw(given.robot, given.seed), given.seed)
    known = given.known.split(",")
    model = with_paths_in_base(given.model, plant, given.folder)
    words = ["--poses", str(given.folder / "poses.csv")]
    if "frame" in known:
        words = ["--frame", *(repr(float(x)) for x in true_frame(given.seed))]
    print("| path | largest error in runs 0 to 3, um | clock late, us | |\n|---|---|---|---|")
    for path in (
        given.paths.split(",") if given.paths else [p.name for p in test_paths(plant.chain)]
    ):
        place = given.folder / f"learned_{path}"
        errors, said = learned_errors(
            plant, model, path, place, given.seed, words, "clock" in known
        )
        cells = [path, " / ".join(f"{1e6 * error:.0f}" for error in errors)]
        cells.append(" / ".join(f"{1e6 * each['late_s']:.0f}" for each in said))
        cells.append(str(said[-1]["runs"][-1]["frequency_hz"]) + " " + said[-1]["stopped"])
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
