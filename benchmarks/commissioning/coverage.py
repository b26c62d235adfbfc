"""Share of paths whose true error the one that `flexgen predict` states holds, end to end.

    python benchmarks/commissioning/coverage.py FOLDER [--robot three_axes] [--seeds 1,2,3,4,5,6]

draws true robots, writes their records into FOLDER/ROBOT_SEED, where they alone lie with the data
sheet, commissions it by the verb `flexgen commission`, which measures the misfit of the model
itself, and compares the error that 95 % of the predicted robots keep with the largest error of the
true one on each test path. With --short the records are short. What exists already is not computed
again; a model that `commission` refuses is stated, and its paths do not count.
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
from benchmarks.commissioning.trial import verb

SHORT = replace(Campaign(), tracked=8, rigid_s=12.0, spots=2, levels=(0.06, 0.012))
DRAWN = 32  # robots that `predict` simulates


def commissioned(plant: Plant, robot: str, seed: int, folder: Path, campaign: Campaign) -> Path:
    """The model file that `flexgen commission` writes from records of a plant.

    It is not there where the fit was refused.
    """
    out = folder / "commissioned.toml"
    if out.is_file():
        return out
    if not (folder / "tracked.csv").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_datasheet(stated(robot), folder / "arm.toml")
        write_records(plant, folder, campaign, seed, workers=1)
    verb(["commission", str(folder / "arm.toml"), str(folder), "--out", str(out), "--quiet"])
    return out


def compare(plant: Plant, model: Path, path: str) -> tuple[float, float | None, str]:
    """True error and stated error [m] on a path, and the largest share of the stated one."""
    import flexgen

    solution = flexgen.solve(f"{model}@commissioned", path, verify=False)
    found = flexgen.predict(solution.model, solution=solution, robots=DRAWN)
    largest = found.shares[0]
    cause = f"{largest.name} {100 * largest.share:.0f} %"
    return score(plant, solution, path).largest, found.error_m, cause


def rows_of(plant: Plant, model: Path, name: str) -> list[tuple[str, bool]]:
    """Row of each test path, and whether the true error is inside."""
    import flexgen

    misfit = flexgen.read(f"{model}@commissioned").uncertainty.misfit
    found = []
    for path in test_paths(plant.chain):
        true, stated_m, cause = compare(plant, model, path.name)
        is_in = stated_m is not None and true <= stated_m
        shown = "unstable" if stated_m is None else f"{1e6 * stated_m:.0f}"
        cells = [name, f"{misfit:.3f}", path.name, f"{1e6 * true:.0f}", shown]
        cells += ["yes" if is_in else "no", cause]
        found.append((f"| {' | '.join(cells)} |", is_in))
        print(found[-1][0], flush=True)
    return found


def main() -> None:
    """Table of all paths of all robots."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", choices=NAMES, default="three_axes")
    parser.add_argument("--seeds", default="1,2,3,4,5,6")
    parser.add_argument("--short", action="store_true")
    given = parser.parse_args()
    print("| robot, seed | misfit | path | true, um | stated, um | inside | largest share |")
    print("|---|---|---|---|---|---|---|")
    inside: list[bool] = []
    for seed in (int(text) for text in given.seeds.split(",")):
        plant = Plant(draw(given.robot, seed), seed)
        folder = given.folder / f"{given.robot}_{seed}"
        campaign = SHORT if given.short else Campaign()
        model = commissioned(plant, given.robot, seed, folder, campaign)
        name = f"{given.robot}, {seed}"
        if not model.is_file():
            print(f"| {name} | refused by commission | | | | | |", flush=True)
            continue
        inside += [is_in for _, is_in in rows_of(plant, model, name)]
    print(f"\n{sum(inside)} of {len(inside)} paths inside")


if __name__ == "__main__":
    main()
