"""Other programs for the same torques, in the same run: collocation with IPOPT, solve_bvp of
scipy, opty.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path as FilePath
from unittest.mock import patch

import casadi as ca
import numpy as np
from inversion_bvp import ReducedProblem, Setting
from inversion_opty_job import job, torque_of
from inversion_paths import EXACT, MESHES, PathRow, least_ms

from flexgen.base.errors import FlexgenError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.methods import collocation
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.unverified_solution import make_solution
from flexgen.paths.path import Path
from flexgen.simulation.simulate import simulate

COLLOCATED = ("planar5_nmp", "manutec_r3_18", "manutec_r3_24", "manutec_r3_30")
MOVE = "line"
PLANAR = "planar5_nmp"
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
NODES = (15, 30, 60, 120)
PATIENCE = 600  # s


@dataclass
class PeerRow:
    """One program: time per second of path [ms], what it contains, verified error [m, rad], ratio
    to lq.
    """

    what: str
    robot: str
    setting: str
    contains: str
    ms: float = np.nan
    error_m: float = np.nan
    error_rad: float | None = None
    ours_ms: float = np.nan
    missing: str = ""


class _Timed:
    """A solver of CasADi whose calls are timed."""

    spent = 0.0

    def __init__(self, solver: ca.Function) -> None:
        self._solver = solver

    def __call__(self, *arguments: object, **named: object) -> object:
        began = time.process_time()
        try:
            return self._solver(*arguments, **named)
        finally:
            _Timed.spent += time.process_time() - began

    def stats(self) -> object:
        return self._solver.stats()


_nlpsol = ca.nlpsol


def _timed(*given: object) -> _Timed:
    """Replacement for casadi.nlpsol."""
    return _Timed(_nlpsol(*given))


def collocation_rows(
    ours: dict[str, PathRow], quick: bool, say: Callable[[str], None]
) -> list[PeerRow]:
    """IPOPT on the same reduced problem: the coarsest accurate mesh, IPOPT alone and
    everything.
    """
    rows = []
    for robot in COLLOCATED[:1] if quick else COLLOCATED:
        if robot not in ours:
            continue
        equations = derive(robot)
        duration = equations.model.move(MOVE).duration
        for mesh in MESHES:
            _Timed.spent = 0.0
            began = time.process_time()
            try:
                problem = InversionProblem(
                    equations, Path(equations, equations.model.move(MOVE)), mesh=mesh
                )
                with patch("casadi.nlpsol", _timed):
                    answer = collocation.solve(problem, mesh)
                whole = time.process_time() - began
                found = make_solution(problem, "collocation", answer)
                simulation = simulate(equations, found.trajectory, start=problem.equilibrium)
            except FlexgenError as failure:
                say(f"  collocation, {robot}, {1e3 * mesh:g} ms: {failure}")
                continue
            error = simulation.tool_error_max_m or 0.0, simulation.tool_error_max_rad
            if max(error[0], error[1] or 0.0) > EXACT:
                continue
            what = f"mesh {1e3 * mesh:g} ms, {found.iterations} iterations"
            for contains, spent in (
                ("IPOPT alone", _Timed.spent),
                ("everything, building the problem too", whole),
            ):
                rows.append(
                    PeerRow(
                        "collocation, IPOPT",
                        robot,
                        what,
                        contains,
                        1e3 * spent / duration,
                        *error,
                        ours[robot].native_ms,
                    )
                )
                say(
                    f"  collocation, {robot}: {rows[-1].ms:.0f} ms, {contains}, {what}, "
                    f"{1e6 * error[0]:.2g} um"
                )
            break
        else:
            missing = "no mesh was solved and accurate enough"
            rows.append(
                PeerRow(
                    "collocation, IPOPT",
                    robot,
                    "",
                    "",
                    ours_ms=ours[robot].native_ms,
                    missing=missing,
                )
            )
    return rows


def scipy_row(ours: dict[str, PathRow], quick: bool, say: Callable[[str], None]) -> list[PeerRow]:
    """The fastest accurate setting of solve_bvp, of all tolerances and first meshes, with and
    without Jacobian.
    """
    if PLANAR not in ours:
        return []
    equations = derive(PLANAR)
    problem = ReducedProblem(equations, MOVE, inversion_library(equations, "lq", native=True))
    timed = []
    for tolerance, nodes, jacobian in itertools.product(
        TOLERANCES, NODES[::2] if quick else NODES, (True, False)
    ):
        setting = Setting(tolerance, nodes, jacobian)
        call = problem.call(setting)
        answer = problem.answer(call())
        if answer is not None:
            timed.append((least_ms(call), setting, answer))
    row = PeerRow("scipy solve_bvp", PLANAR, "", "solve_bvp alone", ours_ms=ours[PLANAR].native_ms)
    for ms, setting, answer in sorted(timed, key=lambda each: each[0]):
        solution = make_solution(problem.problem, "solve_bvp", answer)
        simulation = simulate(equations, solution.trajectory, start=problem.problem.equilibrium)
        error = simulation.tool_error_max_m or 0.0
        say(f"  solve_bvp, {setting}: {ms:.2f} ms, {1e6 * error:.2g} um")
        if error <= EXACT:
            row.ms = ms / problem.path.duration
            row.error_m = error
            row.setting = f"tol {setting.tolerance:g}, {setting.nodes} nodes at first" + (
                ", Jacobian given" if setting.jacobian else ""
            )
            return [row]
    row.missing = "no setting was accurate enough"
    return [row]


def _told(command: list[str]) -> dict:
    """The result of another interpreter, or the reason for none."""
    try:
        answer = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return {"missing": f"no answer in {PATIENCE} s"}
    lines = answer.stdout.strip().splitlines()
    if answer.returncode or not lines:
        return {"missing": (answer.stderr.strip().splitlines() or ["no answer"])[-1]}
    return dict(json.loads(lines[-1]))


def opty_rows(
    python: str, ours: dict[str, PathRow], quick: bool, say: Callable[[str], None]
) -> list[PeerRow]:
    """opty on the original equations, in an interpreter with opty."""
    if PLANAR not in ours:
        return []
    equations = derive(PLANAR)
    problem = InversionProblem(equations, Path(equations, equations.model.move(MOVE)))
    rows = []
    for tracking, nodes in ((False, 401), (True, 201))[: 1 if quick else None]:
        what = f"{'tracking' if tracking else 'algebraic rows'}, {nodes} nodes"
        row = PeerRow("opty, IPOPT", PLANAR, what, "IPOPT alone", ours_ms=ours[PLANAR].native_ms)
        rows.append(row)
        with tempfile.TemporaryDirectory() as folder:
            file = FilePath(folder) / "job.json"
            file.write_text(json.dumps(job(problem, nodes, tracking)))
            command = [python, str(FilePath(__file__).with_name("inversion_opty.py")), str(file)]
            told = _told(command)
        if "missing" in told:
            row.missing = f"not measured here: {told['missing']}"
            say(f"  opty: {row.missing}")
            continue
        row.ms = 1e3 * told["seconds"] / problem.path.duration
        row.setting += f", {told['status']} after {told['iterations']} iterations"
        trajectory = torque_of(problem, told)
        simulation = simulate(equations, trajectory, start=problem.equilibrium)
        row.error_m = simulation.tool_error_max_m or 0.0
        say(f"  opty, {row.setting}: {row.ms:.0f} ms, {1e6 * row.error_m:.3g} um")
    return rows
