"""A blind trial: a true robot is drawn, the user gets a data sheet and records.

    python benchmarks/commissioning/trial.py FOLDER [--robot three_axes] [--seed 1] [--quick]

writes into FOLDER the model file `arm.toml` of the data sheet and the records of the true robot,
and prints the tool errors of three kinds of feedforward on the test paths: the cascade of the
drives alone, the rigid model of `flexgen identify --rigid`, and flexible joints with the stiffness
of the catalogue. `--model FILE` scores the feedforward of another model file instead, as
`flexgen solve` computes it. `--draws N` draws N robots whose data sheets are far off and compares
elastic feedforward after `calibrate`, and after `commission`, with the rigid one. With --quick:
short records, one path.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path

from benchmarks.commissioning.datasheet import write_datasheet
from benchmarks.commissioning.paths import test_paths
from benchmarks.commissioning.plant import Plant
from benchmarks.commissioning.records import QUICK, Campaign, write_records
from benchmarks.commissioning.robots import NAMES, Traits, draw, stated
from benchmarks.commissioning.score import Score, cascade_alone, named_path, score

DRAWN = replace(Campaign(), spots=0, tracked=2, quick=8, rigid_s=10.0)
RECORDS = """
[[record]]
file = "rigid.toml"
kind = "motion"

[[record]]
file = "tracked.csv"
kind = "tracked"

[[record]]
file = "poses.csv"
kind = "poses"
"""


def verb(words: list[str]) -> int:
    """Exit status of a verb of flexgen; what it prints is left out, its errors are not."""
    from flexgen.cli.main import main as flexgen

    with redirect_stdout(StringIO()):
        return int(flexgen(words))


def solved(model: Path | str, path: str, method: str, out: Path) -> Path:
    """The table that `flexgen solve` writes for a move."""
    out.unlink(missing_ok=True)
    words = ["solve", str(model), "--move", path, "--method", method, "--out", str(out)]
    status = verb([*words, "--no-verify", "--ignore-limits", "--quiet"])
    if not out.is_file():
        raise SystemExit(f"flexgen {' '.join(words)} ended with the status {status}")
    return out


def identified_rigid(folder: Path) -> Path:
    """The model file that `flexgen identify --rigid` writes."""
    out = folder / "rigid_identified.toml"
    if not out.is_file():
        words = ["identify", f"{folder}/arm.toml@joints", f"{folder}/rigid.toml", "--rigid"]
        status = verb([*words, "--out", str(out), "--quiet"])
        if not out.is_file():
            raise SystemExit(f"flexgen {' '.join(words)} ended with the status {status}")
    return out


def baselines(plant: Plant, folder: Path, paths: list[str]) -> dict[str, list[Score]]:
    """Scores of the three simple kinds of feedforward."""
    rigid = identified_rigid(folder)
    found: dict[str, list[Score]] = {
        "cascade alone": [],
        "rigid, identified": [],
        "flexible joints, catalogue": [],
    }
    for path in paths:
        given = cascade_alone(plant.chain, named_path(plant, path))
        found["cascade alone"].append(score(plant, given, path))
        table = solved(rigid, path, "rigid", folder / f"rigid_{path}.csv")
        found["rigid, identified"].append(score(plant, table, path))
        table = solved(f"{folder}/arm.toml@joints", path, "fjm", folder / f"fjm_{path}.csv")
        found["flexible joints, catalogue"].append(score(plant, table, path))
    return found


def table(found: dict[str, list[Score]]) -> str:
    """Largest errors and, in parentheses, rms errors in um."""
    paths = [each.path for each in next(iter(found.values()))]
    lines = [f"| method | {' | '.join(paths)} |", f"|{'---|' * (1 + len(paths))}"]
    for method, scores in found.items():
        cells = [f"{1e6 * each.largest:.0f} ({1e6 * each.rms:.0f})" for each in scores]
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return "\n".join(lines)


def calibrated(folder: Path) -> str:
    """The model that `flexgen calibrate` writes from the poses and the bodies of a rigid fit."""
    start = identified_rigid(folder)
    out = folder / "calibrated.toml"
    words = ["calibrate", str(start), f"{folder}/poses.csv", "--free", "compliances"]
    status = verb([*words, "--out", str(out), "--quiet"])
    if not out.is_file():
        raise SystemExit(f"flexgen {' '.join(words)} ended with the status {status}")
    return f"{out}@calibrated"


def commissioned(folder: Path) -> str:
    """The model that `flexgen commission` writes from all records but responses."""
    out = folder / "commissioned.toml"
    (folder / "records.toml").write_text(RECORDS, encoding="utf-8")
    words = ["commission", f"{folder}/arm.toml", str(folder), "--out", str(out), "--quiet"]
    status = verb(words)
    if not out.is_file():
        raise SystemExit(f"flexgen {' '.join(words)} ended with the status {status}")
    return f"{out}@commissioned"


def draw_with_wrong_data(robot: str, seed: int, place: Path) -> Plant:
    """Records of a true robot whose data sheet is far off, in a folder.

    Stiffnesses of the catalogue are 0.8 to 2 times the true ones, guesses of bearings wrong by up
    to a factor of 3.
    """
    plant = Plant(draw(robot, seed, Traits(gear=(0.5, 1.25), bearing=3.0)), seed)
    if not (place / "tracked.csv").is_file():
        place.mkdir(exist_ok=True)
        write_datasheet(stated(robot), place / "arm.toml")
        write_records(plant, place, DRAWN, seed)
    return plant


def error_or_refusal(plant: Plant, found: Callable[[], Path]) -> float | str:
    """Largest error [m] on the line of the torques that are found, or why there are none."""
    try:
        return score(plant, found(), "line").largest
    except SystemExit as error:
        return str(error)


def rigid_torques(place: Path) -> Path:
    """Table of the rigid feedforward of the line."""
    return solved(identified_rigid(place), "line", "rigid", place / "rigid_line.csv")


def elastic_torques(place: Path) -> Path:
    """Table of the elastic feedforward of the line."""
    return solved(calibrated(place), "line", "auto", place / "elastic_line.csv")


def commissioned_torques(place: Path) -> Path:
    """Table of the elastic feedforward of the line, of the commissioned model."""
    return solved(commissioned(place), "line", "auto", place / "commissioned_line.csv")


def draws(robot: str, folder: Path, count: int) -> str:
    """Line of true robots whose data sheets are far off: rigid and elastic feedforward.

    One elastic model is that of `calibrate` from 60 poses and the bodies of a rigid fit, the other
    one that of `commission`.
    """
    lines = [
        "| seed | rigid, um | calibrated, um | commissioned, um | calibrated / rigid "
        "| commissioned / rigid |",
        f"|{'---|' * 6}",
    ]
    for seed in range(1, count + 1):
        place = folder / f"draw{seed}"
        plant = draw_with_wrong_data(robot, seed, place)
        errors = [
            error_or_refusal(plant, partial(find, place))
            for find in (rigid_torques, elastic_torques, commissioned_torques)
        ]
        cells = [x if isinstance(x, str) else f"{1e6 * x:.0f}" for x in errors]
        rigid = errors[0]
        for elastic in errors[1:]:
            known = not isinstance(rigid, str) and not isinstance(elastic, str)
            cells.append(f"{elastic / rigid:.2f}" if known else "")  # type: ignore[operator]
        lines.append(f"| {seed} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def arguments() -> argparse.Namespace:
    """Of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", choices=NAMES, default="three_axes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--model")
    parser.add_argument("--method", default="auto")
    parser.add_argument("--draws", type=int, default=0)
    parser.add_argument("--quick", action="store_true")
    return parser.parse_args()


def main() -> None:
    """The trial."""
    given = arguments()
    folder: Path = given.folder
    folder.mkdir(parents=True, exist_ok=True)
    if given.draws:
        print(draws(given.robot, folder, given.draws))
        return
    plant = Plant(draw(given.robot, given.seed), given.seed)
    paths = [path.name for path in test_paths(plant.chain)][: 1 if given.quick else None]
    if given.model:
        found = {
            given.model: [
                score(
                    plant,
                    solved(given.model, path, given.method, folder / f"solved_{path}.csv"),
                    path,
                )
                for path in paths
            ]
        }
    else:
        if not (folder / "rigid.toml").is_file():
            began = time.perf_counter()
            write_datasheet(stated(given.robot), folder / "arm.toml")
            write_records(plant, folder, QUICK if given.quick else Campaign(), given.seed)
            print(f"records in {time.perf_counter() - began:.0f} s")
        found = baselines(plant, folder, paths)
    print(table(found))


if __name__ == "__main__":
    main()
