"""The programs of examples/motion_control and their planned paths."""

from __future__ import annotations

from functools import cache

from emitted import ROOT

from flexgen.model.reader import read
from flexgen.paths.move_files import read_moves
from flexgen.paths.path import Path as PlannedPath
from flexgen.paths.path import plan

EXAMPLE = ROOT / "examples" / "motion_control.c"
PROGRAMS = {
    "planar5_nmp": (ROOT / "examples" / "program.toml", "seam"),
    "manutec_r3_24": (
        ROOT / "examples" / "motion_control" / "manutec_r3_24" / "program.toml",
        "cycle",
    ),
}


@cache
def planned(name: str) -> PlannedPath:
    """The path of the program of a robot."""
    file, move = PROGRAMS[name]
    robot = read(name)
    return plan(robot, next(m for m in read_moves(file, robot) if m.name == move))
