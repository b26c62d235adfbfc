"""Runs of generated robots: each robot is a separate process, whose moves are solved and confirmed
one by one.

    python tests/support/generated_runs.py FIRST LAST RESULTS.json
    robots FIRST ... LAST-1; those in the file stay

A result has the outcome ``confirmed``, ``wrong`` (reported as solved, but the tool does not
follow), ``coarse`` (the tool follows, but samples differ from their derivatives by more than
1e-4), ``doubted`` (tolerance not met), ``refused`` (an error with its reason) or ``time`` (no
result within the limit). ``false``: the stated errors that an independent simulation of the whole
move contradicts, None where that takes too long; a solution with one is ``wrong``. ``in_c``:
whether `invert` in C converges at its default tolerance, ``growth_in_c``: the growth in its info.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flexgen.model.elements import RobotModel

LIMIT = float(os.environ.get("FLEXGEN_ROBOTS_LIMIT", "120"))  # s: of one solve
REFEREE = 60  # s: of the simulation of the whole move
UPRIGHT = 1000  # number from which on robots stand upright
START = 60.0  # s: to import, to write the robot and to derive its equations


def solve_moves(number: int, first: int, last: int, out: Path) -> None:
    """Solve and confirm the moves ``first`` ... ``last`` - 1 of a robot; a line of JSON each."""
    from claimed_error import claimed_error, claims_within
    from confirmation import confirm, holds, is_false
    from generated_robots import kind_of, robots_folder
    from inverted_in_c import invert_in_c

    import flexgen

    folder = robots_folder()
    assert folder is not None
    family, kind = kind_of(number)
    robot = {"robot": number, "family": family, "kind": kind}
    try:
        equations = flexgen.derive(robot_of(number, folder, out))
    except flexgen.FlexgenError as error:
        for k in range(first, last):
            say(
                {
                    **robot,
                    "move": k,
                    "outcome": "refused",
                    "reason": f"{type(error).__name__}: {error}",
                }
            )
        return
    for k in range(first, last):
        say({"begin": k})
        wall = time.perf_counter()
        cpu = time.process_time()
        row: dict[str, Any] = {**robot, "move": k}
        try:
            # effort of the URDF file
            solution = flexgen.solve(equations, f"m{k}", ignore_limits=True)
        except flexgen.FlexgenError as error:
            row |= {"outcome": "refused", "reason": f"{type(error).__name__}: {error}"}
            solution = None
        row |= {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        if solution is not None:
            simulation = solution.simulation
            row |= {
                "method": solution.method,
                "status": str(solution.status),
                "error_m": solution.tool_error_max_m,
                "error_rad": solution.tool_error_max_rad,
                "residual": solution.residual_relative,
                "growth": getattr(simulation, "growth", None),
                "evaluations": getattr(simulation, "evaluations", None),
                "energy": getattr(simulation, "energy_error", None),
                "warnings": [
                    text for text in solution.warnings if "exceeds its limit" not in text
                ],
                "details": {key: str(value) for key, value in solution.details.items()},
            }
            row["figures"] = confirm(equations.model, solution.trajectory)
            row["claimed"] = claimed_error(solution)
            row["false"] = claims_within(solution, REFEREE)
            row["feedback"] = simulation is not None and simulation.feedback is not None
            row |= invert_in_c(equations, f"m{k}")
            if solution.status == "solved":
                holds_it = not row["false"]
                found = "coarse" if holds_it and not is_false(row["figures"]) else "wrong"
                row["outcome"] = "confirmed" if holds_it and holds(row["figures"]) else found
            else:
                row["outcome"] = "doubted"
        say(row)


def robot_of(number: int, folder: Path, out: Path) -> RobotModel:
    """A generated robot; from `UPRIGHT` on with gravity turned over and moves that take twice as
    long.

    Such a robot is an inverted pendulum wherever the other one hangs.
    """
    from generated_robots import generated_robot

    from flexgen.model.reader import read

    model = read(generated_robot(number % UPRIGHT, folder, out))
    if number < UPRIGHT:
        return model
    moves = tuple(replace(move, duration=2 * move.duration) for move in model.moves)
    return replace(model, gravity=tuple(-x for x in model.gravity), moves=moves)


def say(row: dict[str, Any]) -> None:
    """One line for the parent."""
    print(json.dumps(row), flush=True)


def run_robot(number: int, done: set[int], moves: int, limit: float) -> list[dict[str, Any]]:
    """Results of the moves of a robot; a process that takes too long over one is ended, and the
    next one is solved.
    """
    rows: list[dict[str, Any]] = []
    first = next((k for k in range(moves) if k not in done), moves)
    while first < moves:
        with tempfile.TemporaryDirectory() as folder:
            arguments = [
                sys.executable,
                __file__,
                "--robot",
                str(number),
                str(first),
                str(moves),
                folder,
            ]
            process = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)
            deadline = [time.monotonic() + START + REFEREE + limit]
            stop = threading.Event()

            def watch(process=process, deadline=deadline, stop=stop) -> None:
                while not stop.wait(0.5):
                    if time.monotonic() > deadline[0]:
                        process.kill()
                        return

            watcher = threading.Thread(target=watch)
            watcher.start()
            begun = first
            assert process.stdout is not None
            for line in process.stdout:
                row = json.loads(line)
                if "begin" in row:
                    begun = row["begin"]
                    deadline[0] = time.monotonic() + limit + START + REFEREE
                    continue
                rows.append(row)
                first = row["move"] + 1
            stop.set()
            watcher.join()
            code = process.wait()
            process.stdout.close()
        if first < moves and code != 0:  # ended by the watch, or it crashed
            late = code == -9
            reason = f"no result within {limit:g} s" if late else f"the process ended with {code}"
            rows.append(
                {
                    "robot": number,
                    "move": begun,
                    "outcome": "time" if late else "crash",
                    "reason": reason,
                }
            )
            first = begun + 1
    return [row for row in rows if row["move"] not in done]


def run(
    first: int, last: int, results: Path | None, moves: int, limit: float = LIMIT
) -> list[dict[str, Any]]:
    """All results of robots first ... last - 1; with a file, those in it are not computed
    again.
    """
    rows = json.loads(results.read_text()) if results is not None and results.is_file() else []
    for number in range(first, last):
        done = {row["move"] for row in rows if row["robot"] == number}
        rows += run_robot(number, done, moves, limit)
        if results is not None:
            results.write_text(json.dumps(rows, indent=0))
    return [row for row in rows if first <= row["robot"] < last]


if __name__ == "__main__":
    if sys.argv[1] == "--robot":
        solve_moves(*map(int, sys.argv[2:5]), Path(sys.argv[5]))
    else:
        for result in run(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]), 5):
            print(
                {
                    key: result.get(key)
                    for key in ("robot", "family", "kind", "move", "outcome", "cpu_s", "reason")
                }
            )
