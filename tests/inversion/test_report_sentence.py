"""The first sentence of a report: what the torques do, how sure that is, under what conditions."""

from __future__ import annotations

import dataclasses

import pytest

import flexgen
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.problem_text import problem_of
from flexgen.views.reports.sentence import in_words


@pytest.fixture(scope="module")
def solution():
    return flexgen.solve("elbow", "line")


def test_the_sentence_of_a_verified_solution_has_error_conditions_and_robot(solution):
    text = in_words(solution)
    assert text.startswith(
        "These motor torques move the tool of elbow along the move line of 1 s. "
    )
    assert (
        "under these torques alone, without feedback, the error is at most " in text
        and "(numerical)" in text
    )
    assert "another one needs feedback" in text


def test_without_a_simulation_the_sentence_says_so(solution):
    assert "no simulation has verified them" in in_words(
        dataclasses.replace(solution, simulation=None)
    )


def test_an_error_above_a_tenth_of_a_micrometer_is_not_called_numerical(solution):
    run = dataclasses.replace(solution.simulation, tool_error_max_m=2e-6)
    text = in_words(dataclasses.replace(solution, simulation=run))
    assert "at most 2 um" in text and "numerical" not in text


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (Status.LIMITS_ACTIVE, "keep the limits"),
        (Status.LIMITS_EXCEEDED, "The robot cannot give these motor torques"),
        (Status.BASELINE, "come from a simplified model (method "),
        (Status.TOLERANCE_NOT_MET, "Do not use these motor torques"),
    ],
)
def test_each_status_has_its_words(solution, status, words):
    assert words in in_words(dataclasses.replace(solution, status=status))


@pytest.mark.slow
def test_the_page_begins_with_the_sentence(solution, tmp_path):
    page = solution.report(tmp_path / "r").read_text(encoding="utf-8")
    assert page.index("These motor torques move the tool") < page.index("<h2>Summary</h2>")


def test_a_hold_that_is_too_long_is_the_reason():
    solution = flexgen.solve("elbow", "joints", hold="zoh", sample_time=0.1)
    assert solution.status == Status.TOLERANCE_NOT_MET and solution.tool_error_max_m < 1e-6
    assert problem_of(solution, 1e-5).startswith(
        "tolerance not met: the zero-order hold at 100 ms makes the output"
    )
    assert " mm until" in in_words(solution)
