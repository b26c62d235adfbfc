"""Whole paths: processor time of one inversion per second of path, on the coarsest mesh that is
accurate enough.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec

import numpy as np

import flexgen
from flexgen.base.errors import FlexgenError
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion.judge.settling import SETTLED
from flexgen.inversion.problem import sampling
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.solution import Solution
from flexgen.paths.path import Path
from flexgen.runtime.inversion.path_inversion import TOLERANCE, Inversion, Inverter

EXACT = 1e-6  # m and rad: what the tool may stray in simulation
MESHES = (20e-3, 10e-3, 5e-3, 2.5e-3)  # s, tried in this order
MOVES = ("line", "joints", "turning_line", "circle")
ROBOTS = {  # and the target, ms per second of path
    "planar5_mp": 0.2,
    "planar5_nmp": 0.2,
    "planar5_soft": 0.2,
    "kr300_balancer": 1.2,
    "manutec_r3_18": 1.2,
    "manutec_r3_24": 2.0,
    "manutec_r3_30": 3.8,
}
QUICK = ("planar5_nmp", "manutec_r3_18")
METHODS = ("lq", *(("bvp",) if find_spec("flexgen.inversion.methods.bvp") else ()))
# s: of processor time that a figure is the least of, at least; others on the machine come in
# bursts
SPAN = 1.0
TIMES = 7  # calls, at least
# of the largest torque: the tolerance of lq is 1e-6, and the motion may end at another time
SAME = 1e-5


@dataclass
class PathRow:
    """One robot, move and method: mesh, verdict, and times; ``refused``: why there are none.

    ``native_ms`` and ``default_ms``: for each second of path, by build. ``native_differs``:
    largest difference of the torque between the builds, relative to the largest torque.
    """

    robot: str
    move: str
    method: str
    wanted_ms: float
    dof: int = 0
    duration: float = 0.0
    # with what is before the path and after it, until the motion has settled
    motion_s: float = 0.0
    mesh_ms: float = 0.0
    intervals: int = 0
    iterations: int = 0
    error_m: float = np.nan
    error_rad: float | None = None
    native_ms: float = np.nan
    default_ms: float = np.nan
    native_differs: float = np.nan
    is_ok: bool = False  # the status of the C at its default tolerance: OK, not TOLERANCE_NOT_MET
    refused: str = ""


def moves_of(equations: Equations, quick: bool) -> list[str]:
    """The moves of a model that are measured."""
    known = [move.name for move in equations.model.moves]
    return [move for move in MOVES if move in known][: 1 if quick else None]


@cache
def verified(robot: str, move: str, method: str) -> tuple[float, Solution] | str:
    """The coarsest mesh [s] whose solution is accurate in simulation, and this solution; or the
    reason for none.
    """
    equations = derive(robot)
    reason = "no mesh was accurate enough"
    for mesh in MESHES:
        try:
            found = flexgen.solve(equations, move, method, mesh=mesh)
        except FlexgenError as error:
            reason = str(error)
            continue
        if error_of(found) <= EXACT:
            return mesh, found
    return reason


def error_of(solution: Solution) -> float:
    """Largest tool error in simulation [m or rad]."""
    assert solution.simulation is not None
    return max(
        solution.simulation.tool_error_max_m or 0.0, solution.simulation.tool_error_max_rad or 0.0
    )


def arguments(equations: Equations, move: str, mesh: float) -> dict:
    """Arguments of the library for a move on a mesh of intervals of this length [s]."""
    path = Path(equations, equations.model.move(move))
    n, period, samples_per_interval, n_pre, n_post = sampling.grid(
        InversionProblem(equations, path, mesh=mesh), mesh
    )
    y, dy, ddy = sampling.samples(Reduction(equations), path, period, n)
    given = {"y": y, "dy": dy, "ddy": ddy, "q_start": path.q_start}
    return {
        **given,
        "period": period,
        "samples_per_interval": samples_per_interval,
        "n_pre": n_pre,
        "n_post": n_post,
    }


def least_ms(call: Callable[[], object]) -> float:
    """Minimum processor time of a call in this thread [ms]."""
    best = np.inf
    began = time.thread_time()
    count = 0
    while count < TIMES or time.thread_time() - began < SPAN:
        start = time.thread_time_ns()
        call()
        best = min(best, 1e-6 * (time.thread_time_ns() - start))
        count += 1
    return float(best)


def inverted(
    robot: str, method: str, given: dict, native: bool
) -> tuple[Inversion, Callable[[], object]]:
    """The result of the library of one build, and the call that computes it."""
    library = inversion_library(derive(robot), method, native=native)
    invert: Inverter = getattr(library, "invert" if method == "lq" else method)
    options = {"tolerance": TOLERANCE}  # of both methods in `solve`
    if method == "lq":  # as `solve` calls it; bvp computes all samples
        options["settled"] = SETTLED * InversionProblem.accuracy
    return invert(**given, **options), lambda: invert(**given, **options)


def path_row(robot: str, move: str, method: str, wanted: float) -> PathRow:
    """Verify, then time both builds."""
    equations = derive(robot)
    row = PathRow(robot, move, method, wanted, equations.model.dof)
    checked = verified(robot, move, method)
    if isinstance(checked, str):
        row.refused = checked
        return row
    mesh, solution = checked
    assert solution.simulation is not None
    row.mesh_ms = 1e3 * mesh
    row.error_m = solution.simulation.tool_error_max_m or 0.0
    row.error_rad = solution.simulation.tool_error_max_rad
    given = arguments(equations, move, mesh)
    default, call = inverted(robot, method, given, False)
    native, native_call = inverted(robot, method, given, True)
    # it begins and ends where the robot is at rest, perhaps at other times
    found = solution.trajectory
    same = np.array([np.interp(found.time, default.t, column) for column in default.tau_m.T]).T
    difference = np.abs(same - found["tau_m"]).max() / np.abs(default.tau_m).max()
    assert difference < SAME, f"timed is not what was verified: torques differ by {difference:.1e}"
    row.duration = Path(equations, equations.model.move(move)).duration
    row.motion_s = float(default.t[-1] - default.t[0])
    row.intervals = default.intervals
    row.iterations = default.iterations
    row.is_ok = default.converged
    row.default_ms, row.native_ms = (least_ms(each) / row.duration for each in (call, native_call))
    row.native_differs = float(
        np.abs(native.tau_m - default.tau_m).max() / np.abs(default.tau_m).max()
    )
    return row


def path_rows(robots: list[str], quick: bool, say: Callable[[str], None]) -> list[PathRow]:
    """All rows, reported as they come."""
    rows = []
    for robot in robots:
        for move in moves_of(derive(robot), quick):
            for method in METHODS:
                row = path_row(robot, move, method, ROBOTS[robot])
                reason = row.refused or (
                    f"{row.native_ms:.2f} ms native, {row.default_ms:.2f} ms default per s of "
                    f"path, {1e6 * row.error_m:.2g} um, mesh {row.mesh_ms:.3g} ms, "
                    f"{row.iterations} iterations"
                )
                say(f"  {robot} {move} {method}: {reason}")
                rows.append(row)
    return rows
