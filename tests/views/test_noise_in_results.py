"""Results for people: a number below the error of the computation is a bound, not digits of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import flexgen
from flexgen.base.display import choose_scale, figure_rows
from flexgen.base.rows import Row
from flexgen.studies.templates.new_model import new_model

# Digits of a number below 1e-7 in SI units, in mm or mrad below 1e-4.
DIGITS = re.compile(r"(?<!< )\b\d(\.\d+)?e-(0[5-9]|1\d)\b")


@pytest.mark.parametrize(
    ("value", "shown"), [(0.0, 0.0), (2.9e-12, "< 0.0001"), (-1e-9, "< 0.0001"), (2e-3, 2.0)]
)
def test_small_lengths_of_tables_are_bounds(value: float, shown: float | str) -> None:
    assert choose_scale([2e-3], "m").cell(value) == shown


def test_small_speeds_are_bounds_and_other_relative_numbers_are_not() -> None:
    rows = figure_rows(
        (
            Row("speed accuracy AV", 3.9e-11, "relative", "speed_accuracy"),
            Row("speed fluctuation FV", 7.5e-12, "m/s", "speed_fluctuation_m_s"),
            Row("speed fluctuation FV", 0.0125, "m/s", "speed_fluctuation_m_s"),
            Row("energy error", 3.9e-11, "relative", "energy_error"),
        )
    )
    texts = [text for _, text in rows]
    assert texts == ["< 1e-07 relative", "< 1e-07 m/s", "0.0125 m/s", "3.9e-11 relative"]


def test_the_closed_loop_of_an_exact_model_prints_no_noise(
    tmp_path: Path,
) -> None:
    file = tmp_path / "arm.toml"
    file.write_text(new_model("arm", "planar"))
    run = flexgen.control(flexgen.read(file))
    text = run.to_text()
    assert "< 0.1" in text
    assert not DIGITS.search(text), text
    assert DIGITS.search(text.replace("< 0.1", "2.924e-09"))
