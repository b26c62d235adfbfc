"""Throughput of a GPU: functions of points, and whole inversions, against one call for all on the
cores of the CPU.

    cd benchmarks && python -m array_parts.gpu

prints a table with the name of the card and writes it to benchmarks/arrays_gpu.md; without a card
it states that and writes nothing. Results of both are compared bit for bit; the shortest times of
ROUNDS are in the table.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from array_parts.problems import AFTER, BEFORE, EACH, problems_of

import flexgen

ROBOT = "planar5_nmp"
FUNCTIONS = ("mass_matrix", "inverse_dynamics", "arm_forward_dynamics")
POINTS = 2_000_000
PROBLEMS = 20_000
ROUNDS = 20
HEADER = (
    "| what | number | CPU, all cores, per second | {card}, per second | same bits |\n"
    "|---|---|---|---|---|\n"
)


def shortest(way: Callable[[], Any]) -> tuple[float, Any]:
    """The shortest time of a call [s], and its result."""
    best = np.inf
    result = None
    for _ in range(ROUNDS):
        began = time.perf_counter()
        result = way()
        best = min(best, time.perf_counter() - began)
    return best, result


def row_of(what: str, number: int, on_cpu: Callable[[], Any], on_card: Callable[[], Any]) -> str:
    """A row of the table."""
    seconds, expected = shortest(on_cpu)
    card_seconds, found = shortest(on_card)
    same = "yes" if np.array_equal(found.numpy(), expected, equal_nan=True) else "**no**"
    return (
        f"| {what} | {number} | {number / seconds:.3g} | {number / card_seconds:.3g} | {same} |\n"
    )


def measure(folder: Path) -> str:
    """The table; BuildError where there is no card."""
    library = flexgen.load(flexgen.generate(ROBOT, folder / "functions", openmp=True).directory)
    robot: Any = flexgen.load(library.directory, device="cuda")
    rows = ""
    random = np.random.default_rng(0)
    for name in FUNCTIONS:
        given = [
            np.asfortranarray(random.normal(size=(POINTS, *x.shape)))
            for x in library.functions[name].inputs
        ]
        arrays = [robot.array(x) for x in given]
        cpu = library.functions[name]
        card = robot.functions[name]
        rows += row_of(
            f"`{name}`", POINTS, lambda f=cpu, x=given: f(*x), lambda f=card, x=arrays: f(*x)
        )
    p = problems_of(ROBOT, folder, PROBLEMS)
    many: Any = flexgen.load(p.library.directory, device="cuda")
    options = flexgen.InversionOptions(n_pre=BEFORE, n_post=AFTER, samples_per_interval=EACH)
    path = {key: x if key == "period" else many.array(x, order="C") for key, x in p.path.items()}
    values = many.array(p.parameters, order="C")
    rows += row_of(
        "`invert_many`",
        len(p.parameters),
        lambda: p.library.invert_many(**p.path, parameters=p.parameters, options=options).tau_m,
        lambda: many.invert_many(**path, parameters=values, options=options).tau_m,
    )
    note = (
        f"Robot `{ROBOT}`, double precision, arrays on the device; each call waits for its "
        "results.\n"
    )
    return HEADER.format(card=robot.card.name) + rows + "\n" + note


if __name__ == "__main__":
    try:
        with tempfile.TemporaryDirectory() as made:
            text = measure(Path(made))
    except flexgen.BuildError as error:
        sys.exit(f"no table: {error}")
    print(text)
    Path(__file__).parents[1].joinpath("arrays_gpu.md").write_text(text, encoding="utf-8")
