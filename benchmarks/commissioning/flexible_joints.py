"""A model with flexible joints, fitted to the records of a trial: one stiffness for each axis.

    python benchmarks/commissioning/flexible_joints.py FOLDER --robot three_axes --seed 1

fits the gears of `FOLDER/rigid_identified.toml`, whose bodies and friction are those of `identify
--rigid`, to the tracked motion and the static poses of the folder, with the estimator of
`commission`: bodies, lengths and zeros stay, bearings and links are rigid. It prints the tool
errors of the torques of `solve --method fjm`, so that `commission` is compared with what the same
tracker gives to a model of flexible joints.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.commissioning.paths import test_paths
from benchmarks.commissioning.plant import Plant
from benchmarks.commissioning.robots import NAMES, draw
from benchmarks.commissioning.score import Score, score
from benchmarks.commissioning.trial import identified_rigid, solved, table

KNOWN = 1e-6  # tolerance of numbers that stay, over their size, in rad or in m
RECORDS = """
[[record]]
file = "../tracked.csv"
kind = "tracked"

[[record]]
file = "../poses.csv"
kind = "poses"
"""


def fitted(folder: Path) -> str:
    """The model file with the stiffness of each gear, and its variant."""
    import flexgen

    out = folder / "flexible_joints.toml"
    if not out.is_file():
        place = folder / "tracker"
        place.mkdir(exist_ok=True)
        (place / "records.toml").write_text(RECORDS, encoding="utf-8")
        stay = flexgen.DatasheetTolerances(
            bodies=KNOWN, zero=KNOWN, position=KNOWN, rotation=KNOWN
        )
        found = flexgen.commission(
            str(identified_rigid(folder)), place, tolerances=stay, lengths=False, curves=False
        )
        found.write(out)
    return f"{out}@commissioned"


def main() -> None:
    """Fit and score."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", choices=NAMES, default="three_axes")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    plant = Plant(draw(given.robot, given.seed), given.seed)
    model = fitted(given.folder)
    scores: list[Score] = []
    for path in test_paths(plant.chain):
        file = given.folder / f"flexible_{path.name}.csv"
        scores.append(score(plant, solved(model, path.name, "fjm", file), path.name))
    print(table({"flexible joints, fitted to the tracker": scores}))


if __name__ == "__main__":
    main()
