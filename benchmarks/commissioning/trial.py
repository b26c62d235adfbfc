"""A blind trial: a true robot is drawn, the user gets a data sheet and records.

    python benchmarks/commissioning/trial.py FOLDER [--robot three_axes] [--seed 1] [--quick]

writes into FOLDER the model file `arm.toml` of the data sheet and the records of the true robot,
and prints the tool errors of three kinds of feedforward on the test paths: the cascade of the
drives alone, the rigid model of `flexgen identify --rigid`, and flexible joints with the stiffness
of the catalogue. `--model FILE` scores the feedforward of another model file instead, as
`flexgen solve` computes it. With --quick: short records, one path.
"""

from __future__ import annotations

import argparse
import time
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from benchmarks.commissioning.datasheet import write_datasheet
from benchmarks.commissioning.paths import test_paths
from benchmarks.commissioning.plant import Plant
from benchmarks.commissioning.records import QUICK, Campaign, write_records
from benchmarks.commissioning.robots import NAMES, draw, stated
from benchmarks.commissioning.score import Score, cascade_alone, named_path, score


def solved(model: Path | str, path: str, method: str, out: Path) -> Path:
    """The table that `flexgen solve` writes for a move."""
    from flexgen.cli.main import main as flexgen

    out.unlink(missing_ok=True)
    words = ["solve", str(model), "--move", path, "--method", method, "--out", str(out)]
    with redirect_stdout(StringIO()):
        status = flexgen([*words, "--no-verify", "--ignore-limits", "--quiet"])
    if not out.is_file():
        raise SystemExit(f"flexgen {' '.join(words)} ended with the status {status}")
    return out


def identified_rigid(folder: Path) -> Path:
    """The model file that `flexgen identify --rigid` writes."""
    from flexgen.cli.main import main as flexgen

    out = folder / "rigid_identified.toml"
    if not out.is_file():
        words = ["identify", f"{folder}/arm.toml@joints", f"{folder}/rigid.toml", "--rigid"]
        with redirect_stdout(StringIO()):
            status = flexgen([*words, "--out", str(out), "--quiet"])
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
    parser.add_argument("--quick", action="store_true")
    return parser.parse_args()


def main() -> None:
    """The trial."""
    given = arguments()
    folder: Path = given.folder
    folder.mkdir(parents=True, exist_ok=True)
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
