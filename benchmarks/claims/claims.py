"""Errors that `flexgen.solve` states, against a simulation that shares no code with it; the status
of `invert` in C.

    python benchmarks/claims/claims.py RESULTS.json

solves the moves of generated robots (the package example-robot-data, see
tests/support/generated_robots.py), some with gravity turned over, and writes
benchmarks/claims/claims.md. Moves in the file are not computed again; all take about two hours on
one core.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parents[1] / "tests" / "support"))

from generated_runs import UPRIGHT, run  # noqa: E402

SLOW = (2, 20, 26, 32)  # sharp friction of light rotors: minutes to simulate, as 8 and 14
HANGING = [number for number in (*range(37), 39) if number not in (*SLOW, 35)]
TURNED = [
    UPRIGHT + number for number in (0, 1, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 15, 16, 19, 23, 28)
]
MOVES = 3  # of each robot
TITLES = ("as they are", "gravity turned over, twice the time")


def row(title: str, rows: Sequence[dict[str, Any]]) -> list[str]:
    """A row of the table."""
    solved = [each for each in rows if each.get("status") == "solved"]
    checked = [each for each in solved if each.get("false") is not None]
    false = [each for each in checked if each["false"]]
    in_c = [each for each in solved if each.get("in_c")]
    ratios = [each["growth_in_c"] / each["growth"] for each in in_c if each.get("growth")]
    return [
        title,
        str(len(rows)),
        str(len(solved)),
        str(sum(bool(each["feedback"]) for each in solved)),
        str(len(checked)),
        str(len(false)),
        str(len(in_c)),
        f"{min(ratios):.2g} to {max(ratios):.2g}" if ratios else "-",
    ]


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The page."""
    groups = [
        [each for each in rows if (each["robot"] >= UPRIGHT) == upright]
        for upright in (False, True)
    ]
    head = [
        "robots",
        "moves",
        "solved",
        "of them with motor feedback",
        "compared with a simulation",
        "with a false error",
        "converged in C",
        "growth in C over that of solve",
    ]
    lines = [
        head,
        ["---"] * len(head),
        *(row(*each) for each in zip(TITLES, groups, strict=True)),
        row("all", rows),
    ]
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    missed = [
        f"{each['robot'] % UPRIGHT}/m{each['move']}"
        for each in rows
        if each.get("status") != "solved"
    ]
    return f"""{text}

Every error that a solution states is compared: in open loop or with motor feedback, until 0.5 s \
and until 2 s after the
end, and the error in open loop of moves with feedback where it is stated. It is false where the \
simulation
(tests/support/whole_move.c) finds more than 1.2 times it and 1 nm or 1 nrad. Moves that are not \
compared have sharp
friction: their simulation takes more than a minute. Not solved: {", ".join(missed) or "none"}.
"""


def main(results: Path, quick: bool) -> None:
    """Solve what the file lacks, and write the page; ``quick``: one move of one robot, printed."""
    if quick:
        print(table(run(HANGING[0], HANGING[0] + 1, results, 1)))
        return
    rows = [
        each for number in (*HANGING, *TURNED) for each in run(number, number + 1, results, MOVES)
    ]
    (FOLDER / "claims.md").write_text(table(rows), encoding="utf-8")
    print(table(rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]), "--quick" in sys.argv)
