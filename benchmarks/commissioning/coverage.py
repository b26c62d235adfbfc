"""How often the error that `flexgen predict` states holds the true error of a path.

    python benchmarks/commissioning/coverage.py FOLDER [--robot three_axes] [--seeds 1,2]

draws true robots, writes their records into FOLDER/ROBOT_SEED/records, commissions the data
sheet, and compares the error that 95 % of the predicted robots keep with the largest error of the
true one on each test path. Without --full the records are short. What exists already is not
computed again.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from benchmarks.commissioning.datasheet import write_datasheet
from benchmarks.commissioning.paths import test_paths
from benchmarks.commissioning.plant import Plant
from benchmarks.commissioning.records import Campaign, write_records
from benchmarks.commissioning.robots import NAMES, draw, stated
from benchmarks.commissioning.score import score

SHORT = replace(Campaign(), tracked=8, rigid_s=12.0, spots=2, levels=(0.06, 0.012))
DRAWN = 32  # robots that `predict` simulates


def commissioned(plant: Plant, robot: str, seed: int, folder: Path, campaign: Campaign) -> Path:
    """The model file that `flexgen commission` writes from records of a plant."""
    import flexgen

    out = folder / "commissioned.toml"
    records = folder / "records"
    if not out.is_file():
        if not (records / "poses.csv").is_file():
            records.mkdir(parents=True, exist_ok=True)
            write_datasheet(stated(robot), records / "arm.toml")
            write_records(plant, records, campaign, seed, workers=1)
        write_datasheet(stated(robot), folder / "arm.toml")
        flexgen.commission(folder / "arm.toml", records).write(out)
    return out


def compare(plant: Plant, model: Path, path: str) -> tuple[float, float | None, str]:
    """True error and stated error [m] on a path, and the largest share of the stated one."""
    import flexgen

    solution = flexgen.solve(f"{model}@commissioned", path, verify=False)
    found = flexgen.predict(solution.model, solution=solution, robots=DRAWN)
    largest = found.shares[0]
    cause = f"{largest.name} {100 * largest.share:.0f} %"
    return score(plant, solution, path).largest, found.error_m, cause


def main() -> None:
    """Table of all paths of all robots."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", choices=NAMES, default="three_axes")
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--full", action="store_true")
    given = parser.parse_args()
    print("| robot, seed | path | true, um | stated, um | inside | largest share |")
    print("|---|---|---|---|---|---|")
    inside = []
    for seed in (int(text) for text in given.seeds.split(",")):
        plant = Plant(draw(given.robot, seed), seed)
        folder = given.folder / f"{given.robot}_{seed}"
        campaign = Campaign() if given.full else SHORT
        model = commissioned(plant, given.robot, seed, folder, campaign)
        for path in test_paths(plant.chain):
            true, stated_m, cause = compare(plant, model, path.name)
            is_in = stated_m is not None and true <= stated_m
            inside.append(is_in)
            shown = "unstable" if stated_m is None else f"{1e6 * stated_m:.0f}"
            cells = [f"{given.robot}, {seed}", path.name, f"{1e6 * true:.0f}", shown]
            print(f"| {' | '.join([*cells, 'yes' if is_in else 'no', cause])} |", flush=True)
    print(f"\n{sum(inside)} of {len(inside)} paths inside")


if __name__ == "__main__":
    main()
