"""Six-axis arms with steep friction: ten moves each with motors that reverse, solved, and their
errors confirmed.

    python benchmarks/reversals/reversals.py RESULTS.json [--quick]

solves the moves of the arms of tests/support/arms_with_friction.py by the default method, compares
every stated error with a simulation that shares no code with flexgen
(tests/support/whole_move.py), and writes benchmarks/reversals/reversals.md from all results in the
file. Arms in the file are not computed again. With --quick: one move of one arm, printed.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parents[1] / "tests" / "support"))

from arms_with_friction import ARMS, MOVES, arm, moves_of  # noqa: E402
from claimed_error import claimed_error, claims_within  # noqa: E402

import flexgen  # noqa: E402

REFEREE = 60  # s: of the simulation that shares no code, of one move
CONFIRMED = ("seam0", "back2")  # moves that it simulates


def solve_arm(number: int, folder: str, count: int) -> list[dict[str, Any]]:
    """One row for each of the first moves of an arm."""
    equations = flexgen.derive(arm(number, folder))
    moves = moves_of(equations, number)[:count]
    # compiles the simulation of this arm, once
    flexgen.solve(equations, moves[0], ignore_limits=True)
    rows = []
    for move in moves:
        row: dict[str, Any] = {"arm": number, "move": move.name}
        began = time.process_time()
        try:
            solution = flexgen.solve(equations, move, ignore_limits=True)
        except flexgen.FlexgenError as error:
            rows.append(row | {"status": "refused", "reason": str(error)})
            continue
        speeds = solution.trajectory["v_m"]
        rows.append(
            row
            | {
                "status": str(solution.status),
                "method": solution.method,
                "cpu_s": time.process_time() - began,
                "duration_s": solution.move.duration,
                "reversals": int((speeds[:-1] * speeds[1:] < 0).sum()),
                "residual": solution.residual_relative,
                "error": claimed_error(solution),
                "confirmed": move.name in CONFIRMED,
                "false": claims_within(solution, REFEREE) if move.name in CONFIRMED else None,
                "attempts": solution.details.get("attempts", []),
            }
        )
        print(rows[-1], flush=True)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The page."""
    head = ["arm", "moves", "solved", "reversals", "processor time, median", "largest"]
    head += ["largest stated error", "moves confirmed", "false statements"]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for number in sorted({row["arm"] for row in rows}):
        of_arm = [row for row in rows if row["arm"] == number]
        solved = [row for row in of_arm if row["status"] == "solved"]
        times = [row["cpu_s"] for row in of_arm if "cpu_s" in row]
        errors = [row["error"] for row in solved]
        cells = [
            f"{number}, {'table' if number % 2 else 'template'}",
            len(of_arm),
            len(solved),
            sum(row.get("reversals", 0) for row in of_arm),
            f"{np.median(times):.1f} s",
            f"{max(times):.1f} s",
            f"{max(errors, default=0.0):.1e}",
            sum(row["false"] is not None for row in solved),
            sum(bool(row["false"]) for row in solved),
        ]
        lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    text = [
        "# Motors that reverse under steep friction",
        "",
        "Arms with six axes and elastic gears, of the template (even numbers) and of tables of "
        "Denavit and Hartenberg, with a Coulomb friction of 2 to 10 % of the largest torque in "
        "each motor and `beta` from 1 to 50 s/rad; ten moves each: polylines, circles, lines "
        "there and back, joint moves. Written by [reversals.py](reversals.py); the errors are "
        "in m and rad, and a statement is false where a simulation that shares no code with "
        "flexgen finds 1.2 times the stated error plus 1 nm.",
        "",
        *lines,
        "",
    ]
    return "\n".join(text)


def main(file: Path, quick: bool) -> None:
    """Solve the arms that are not in the file, and write it and the page; ``quick``: one move,
    printed.
    """
    with tempfile.TemporaryDirectory() as folder:
        if quick:
            print(table(solve_arm(0, folder, 1)))
            return
        rows = json.loads(file.read_text()) if file.is_file() else []
        done = {row["arm"] for row in rows}
        for number in sorted({*range(ARMS)} - done):
            rows += solve_arm(number, folder, MOVES)
            file.write_text(json.dumps(rows, indent=0))
    (FOLDER / "reversals.md").write_text(table(rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]), "--quick" in sys.argv)
