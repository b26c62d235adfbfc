"""`flexgen solve` with a warm cache: the torques of a move and their verification, everything
included.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass

ROBOTS = ("planar5_nmp", "manutec_r3_18", "manutec_r3_24", "manutec_r3_efjm")
QUICK_ROBOTS = ("planar5_nmp",)
TIMES = 5
_CODE = """
import json, sys, time, flexgen
robot = sys.argv[1]
flexgen.solve(robot, progress=False)
best = None
for _ in range(int(sys.argv[2])):
    equations = flexgen.derive(robot)
    solution = flexgen.solve(equations, progress=False)
    if best is None or solution.wall_s < best[0]:
        best = (solution.wall_s, solution.simulation.wall_s, solution.simulation.evaluations, \
solution.tool_error_max_m)
print(json.dumps(best))
"""


@dataclass(frozen=True)
class SolveRow:
    """Shortest wall time [s] of `solve`, of its simulation, evaluations in it, and the verified
    tool error [m].
    """

    robot: str
    wall_s: float
    simulation_s: float
    evaluations: int
    error_m: float


def solve_rows(quick: bool, say: Callable[[str], None]) -> list[SolveRow]:
    """Each robot in a separate process: its C is compiled before the first of the timed calls."""
    import json

    rows = []
    for robot in QUICK_ROBOTS if quick else ROBOTS:
        done = subprocess.run(
            [sys.executable, "-c", _CODE, robot, str(TIMES)],
            check=True,
            capture_output=True,
            text=True,
        )
        rows.append(SolveRow(robot, *json.loads(done.stdout.splitlines()[-1])))
        say(f"  {robot}: {rows[-1].wall_s:.2f} s, simulation {rows[-1].simulation_s:.2f} s")
    return rows
