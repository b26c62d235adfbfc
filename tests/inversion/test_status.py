"""The status of a solution: its values, its texts, and what files and JSON store of it."""

from __future__ import annotations

import json
import pickle

import pytest

import flexgen
from flexgen.inversion.judge.status import Status


def test_values():
    assert [status.value for status in Status] == [
        "solved",
        "limits active",
        "limits exceeded",
        "baseline",
        "tolerance not met",
    ]
    assert flexgen.Status is Status


@pytest.mark.parametrize("status", Status)
def test_a_status_has_a_sentence_and_an_advice(status):
    for text in (status.sentence, status.advice):
        assert text.endswith(".") and len(text.split()) > 4
    assert (
        len({other.sentence for other in Status})
        == len({other.advice for other in Status})
        == len(Status)
    )


@pytest.mark.parametrize("status", Status)
def test_a_status_is_stored_as_its_value(status):
    assert str(status) == f"{status}" == status.value and json.loads(
        json.dumps({"status": status})
    ) == {"status": status.value}
    assert Status(status.value) is status and pickle.loads(pickle.dumps(status)) is status


def test_an_unknown_status_is_refused():
    with pytest.raises(ValueError, match="inaccurate"):
        Status("inaccurate")


def test_figures_of_a_solution_store_the_value():
    solution = flexgen.solve("elbow", verify=False)
    assert solution.status is Status.SOLVED and type(solution.to_dict()["status"]) is str


def test_figures_are_rows_of_label_value_and_unit():
    solution = flexgen.solve("elbow")
    rows = solution.figures()
    assert all(label and isinstance(unit, str) for label, _, unit, _ in rows)
    assert len({key for *_, key in rows}) == len(rows)
    data = solution.to_dict()
    assert {key: data[key] for *_, key in rows} == {key: value for _, value, _, key in rows}
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    measured = {key: (value, unit) for _, value, unit, key in rows}
    assert (
        measured["tool_error_max_m"] == (solution.tool_error_max_m, "m")
        and solution.tool_error_max_m is not None
    )
    assert measured["intervals"] == (None, "") and measured["preactuation_s"] == (0.0, "s")
