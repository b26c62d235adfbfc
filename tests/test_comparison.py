"""Side by side: the torque of simpler models leaves the tool beside the path, each by less than the one before."""

from __future__ import annotations

import pytest

import flexgen
from flexgen.comparison import compare, error_rows
from flexgen.mechanics.equations import derive
from flexgen.report import write_report
from flexgen.solvers.robustness import Plant
from flexgen.solvers.robustness import compare as on_other_machines


@pytest.fixture(scope="module")
def beside():
    equations = derive("planar5_nmp")
    said: list[str] = []
    solutions = compare(equations, flexgen.solve(equations), said.append)
    assert len(said) == 3
    return equations, solutions


def test_each_model_is_better_than_the_simpler_one(beside) -> None:
    rows = error_rows(beside[1])
    assert [row["method"] for row in rows] == ["rigid", "fjm", "quasistatic", "lq"]
    largest = [row["largest_m"] for row in rows]
    assert largest[0] > 1e-4 and largest[1] > 1e-5  # m
    assert largest[0] > largest[1] > 10 * largest[2] > 100 * largest[3]


def test_a_machine_without_elastic_coordinates_has_one_baseline() -> None:
    equations = derive("elbow")
    assert [s.method for s in compare(equations, flexgen.solve(equations))] == ["rigid", "closed-form"]


def test_report_shows_them_together(beside, tmp_path) -> None:
    equations, solutions = beside
    named = {solution.method: solution for solution in solutions}
    rows = on_other_machines(equations, named, plants=(Plant("stiffness -5 %", stiffness=0.95),))
    page = write_report(equations, solutions[-1], tmp_path, beside=solutions, robustness=rows).read_text("utf-8")
    for text in ("Tool error by method", "quasistatic", "Robustness", "stiffness -5 %", 'id="methods"'):
        assert text in page
    # on another machine, too, the better model stays the better one
    errors = {(row["control"], row["method"]): row["error_max_m"] for row in rows}
    assert errors["feedback", "lq"] < errors["feedback", "rigid"]
