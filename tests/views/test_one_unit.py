"""A quantity has one unit in a report: that of its largest value, also in the columns of tables.

The lengths of made-up results are spread over seven powers of ten, so that a report that chooses a
unit for each number prints at least two.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from made_results import Indexed, Made, derived, made_run, made_simulation, made_trajectory

import flexgen.base.display
from flexgen.base.display import choose_scale, figure_rows
from flexgen.base.rows import Inner, Row
from flexgen.feedback.loop.content import content_of_feedforwards, content_of_run
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import Solution
from flexgen.paths.accuracy.figures import PathAccuracy
from flexgen.simulation.result import Simulation
from flexgen.views.reports.html import accuracy_tables, scales_of_page
from flexgen.views.reports.row_views import text_of_rows

# A length or an angle: a number with its unit, or the unit in the heading of a column.
LENGTH = re.compile(r"(?:\d|, |<td>|in )\s*([umµ]?)(m|rad)(?![\w/^])")
ERRORS = ("error_max", "dynamic_error_max", "error_end", "static_error_start", "static_error_end")


def units_in(text: str) -> set[str]:
    """Prefixed units of all lengths and angles in a text; the micro sign counts as u."""
    return {found[1].replace("µ", "u") + found[2] for found in LENGTH.finditer(text)}


def a_loop(largest: float) -> Any:
    """A closed loop of three robots whose errors are from 1e-7 to 1 of the largest."""
    run = made_run()
    sizes = {r.name: largest * 10.0 ** (-3.5 * k) for k, r in enumerate(run.runs)}
    for r in run.runs:
        r.failure = ""
        r.saturated = 0
        r.load = ""
    each = tuple(sizes.values())
    accuracy = PathAccuracy(
        tuple(sizes),
        "m",
        1e-4,
        *(each[0], each[1], each[2], each[1]),
        *(0.01, 0.002, 0.03),
        each,
        (0.1, 0.2, None),
        each,
        (0.1, 0.2, None),
        each,
    )
    own = {
        "unstable": {},
        "status": "done",
        "hardware": Made(sample_s=1e-3, encoder_noise_rad=0.0),
        "steps": 4,
        "wall_s": 0.75,
        "delay_s": 0.0,
        "accuracy": lambda: accuracy,
        "margins": dict,
        "figures": lambda r: (
            {
                f"{key}_{u}": sizes[r.name] / (k + 1) if u == "m" else None
                for k, key in enumerate(ERRORS)
                for u in ("m", "rad")
            }
            | {"torque_max_Nm": 9.5, "plant": r.name, "saturated_samples": 0}
        ),
    }
    return Indexed(**{**vars(run), **own})


def compared(run: Any, factor: float) -> Any:
    """A comparison whose errors without feedforward are larger by a factor."""
    rows = [
        {"robot": r.name, "what": "error", "unit": "m", "none": factor * x, "elastic": x}
        for r in run.runs
        for x in [run.figures(r)["error_max_m"]]
    ]
    return Made(
        runs={"none": run, "elastic": run},
        elastic=Indexed(**{**vars(run), "solution": Made(method="lq")}),
        missing={},
        rows=lambda: rows,
    )


def a_solution() -> Solution:
    """A solution with errors from 2 um to 2 mm."""
    equations = derived("kr300_efjm")
    trajectory = made_trajectory(equations, move="line")
    run = Simulation(
        made_simulation(trajectory, len(trajectory.labels["y_ref"]), True).trajectory,
        2.3e-6,
        5.6e-4,
        3e-9,
        12.5,
        321.0,
        4567,
        0.25,
        growth=12.3,
        held_s=0.5,
        later_error_max_m=2e-3,
        later_error_max_rad=7e-6,
        defect_max_m=3e-9,
    )
    return Solution(
        equations.model,
        equations.model.moves[0],
        "lq",
        Status.SOLVED,
        trajectory=trajectory,
        residual_max_Nm=1e-4,
        residual_relative=3e-7,
        iterations=7,
        wall_s=1.5,
        cpu_s=2.5,
        preactuation_s=0.125,
        simulation=run,
        verdict="found",
    )


@pytest.mark.parametrize("largest", [3e-7, 4e-4, 7e-2])
def test_a_closed_loop_with_its_comparison_has_one_unit(largest: float) -> None:
    run = a_loop(largest)
    other = compared(run, 30.0)
    inner = Inner("feedforward", content_of_feedforwards(other))
    text = text_of_rows((*content_of_run(run), inner))
    expected = choose_scale([30.0 * largest], "m").unit
    assert units_in(text) == {expected}, text
    assert units_in(text_of_rows(content_of_run(run))) == {choose_scale([largest], "m").unit}


@pytest.mark.parametrize("largest", [3e-7, 4e-4, 7e-2])
def test_tables_of_a_page_have_one_unit(largest: float) -> None:
    run = a_loop(largest)
    scales = scales_of_page((), (largest, "m"))
    page = accuracy_tables(run.accuracy(), scales)
    assert units_in(page) == {choose_scale([largest], "m").unit}, page


def test_a_solution_has_one_unit_for_lengths_and_one_for_angles() -> None:
    found = a_solution()
    for text in (found.to_text(), str(found)):
        assert units_in(text) == {"mm", "urad"}, text
        assert "< 0.0001" in text


def test_the_law_finds_a_unit_for_each_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the unit of each number is chosen from that number."""

    def own(scale: Any, value: float | None) -> str:
        assert value is not None
        return choose_scale([value], scale.unit[-1]).unit

    figures = [Row("a", 2e-3, "m", "a"), Row("b", 3e-6, "m", "b")]
    assert units_in(str(figure_rows(figures))) == {"mm"}
    monkeypatch.setattr(
        flexgen.base.display.UnitScale, "text", lambda scale, x: f"{x} {own(scale, x)}"
    )
    assert units_in(str(figure_rows(figures))) == {"mm", "um"}


def test_numbers_in_the_unit_of_a_report_are_the_values() -> None:
    """Also of noise, of zero, of what is not known and of what is infinite."""
    values = [0.0, 3e-8, -4e-8, 2.5e-6, 0.0123, math.inf, math.nan, None]
    scale = choose_scale(values, "rad")
    assert scale.unit == "mrad"
    cells = [scale.cell(value) for value in values]
    assert cells[:3] == [0.0, "< 0.0001", "< 0.0001"] and cells[5:] == ["-", "-", "-"]
    assert np.allclose([float(x) for x in cells[3:5]], [2.5e-3, 12.3], rtol=1e-15)
