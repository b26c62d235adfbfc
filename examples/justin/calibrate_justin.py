"""Calibration of an elastic humanoid upper body from 400 static poses.

    python examples/justin/calibrate_justin.py poses.csv

poses.csv: commanded joints q0_rad to q16_rad, and the positions m0_x_m to m1_z_m of a marker on
each hand in the frame of the camera, one line for each pose, such as those that DLR offers with J.
Tenhumberg and B. Baeuml, IEEE Humanoids
2021. Prints the errors of seven models from rigid to all numbers, on poses that were not fitted;
      then calibrates with
four fifths of the poses, writes the model file, and compares where `flexgen.tracker_positions`
puts the hands of the new model at the remaining commands with what was measured. Writes
calibration.svg next to the new model file, in reports/justin.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import flexgen

MODEL = Path(__file__).with_name("justin.toml")
RIGID = 1e9  # N m/rad
STAGES = (  # name, springs that are free, groups
    ("frames only, rigid", "none", ()),
    ("+ joint zeros", "none", ("zeros",)),
    ("+ places of all elements", "none", ("zeros", "placements")),
    ("+ springs of the joints", "gears", ("zeros", "placements", "compliances")),
    ("+ springs across the joints", "all", ("zeros", "placements", "compliances")),
    ("+ factors of the mechanism", "all", ("zeros", "placements", "compliances", "mechanisms")),
    (
        "+ masses and their centers",
        "all",
        ("zeros", "placements", "compliances", "mechanisms", "masses"),
    ),
)


def model_with(springs: str) -> flexgen.RobotModel:
    """The model with rigid springs: all of them, those across the joints, or none."""
    robot = flexgen.read(MODEL)
    stiff = {}
    for element in robot.elements:
        for dof in element.dofs:
            place = f"element.{element.name}.dof.{dof.name}"
            if dof.gear is not None and springs == "none":
                stiff[f"{place}.gear.spring.stiffness"] = RIGID
            if dof.spring is not None and springs != "all" and dof.name != "chest_z":
                stiff[f"{place}.spring.stiffness"] = RIGID
            # the axis of the mechanism is one of the joints
            if dof.name == "chest_z" and springs == "none":
                stiff[f"{place}.spring.stiffness"] = RIGID
    return flexgen.read(MODEL, overrides=stiff)


def main(file: Path) -> None:
    """Print the stages; calibrate, write, compare."""
    poses = flexgen.StaticPoses.read(file, flexgen.read(MODEL))
    print(
        "errors of the hands, mm                       numbers    fit   on poses not fitted   "
        "other hand seen   time, s"
    )
    for name, springs, free in STAGES:
        began = time.perf_counter()
        found = flexgen.calibrate(
            model_with(springs), poses, free=free, place=["right1", "left1"], progress=False
        )
        held, seen = (
            1e3 * float(np.nanmean(e)) for e in (found.errors_held_out, found.errors_seen)
        )
        fit = 1e3 * float(np.nanmean(found.errors))
        wall = time.perf_counter() - began
        print(f"{name:45s} {len(found.x):7d} {fit:6.2f} {held:21.2f} {seen:17.2f} {wall:9.1f}")
    for warning in found.warnings:
        print(f"warning: {warning}")

    order = np.random.default_rng(1).permutation(len(poses))
    fitted = np.sort(order[: len(order) * 4 // 5])
    left_out = np.sort(order[len(order) * 4 // 5 :])
    part = flexgen.StaticPoses(
        poses.commands[fitted], poses.positions[fitted], f"{len(fitted)} poses of {file.name}"
    )
    began = time.perf_counter()
    found = flexgen.calibrate(MODEL, part, place=["right1", "left1"], folds=0, progress=False)
    print(f"\n{len(fitted)} poses fitted in {time.perf_counter() - began:.1f} s")
    folder = Path("reports") / "justin"
    folder.mkdir(parents=True, exist_ok=True)
    new = found.write(folder / "justin_calibrated.toml", world="measurement")
    found.plot(folder / "calibration.svg")
    robot = flexgen.read(f"{new}@calibrated")
    for name, sag in (("with sag", True), ("without", False)):
        there = flexgen.tracker_positions(robot, poses.commands[left_out], sag=sag)
        error = np.linalg.norm(there - poses.positions[left_out], axis=2)
        print(
            f"model file {new}, {len(left_out)} other poses, {name}: {1e3 * error.mean():.2f} mm"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
