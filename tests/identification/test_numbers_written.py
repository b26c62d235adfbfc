"""Figures of runs, rows of recorded files and the stack of functions, each of them by hand."""

from __future__ import annotations

import inspect
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError, BuildError
from flexgen.codegen.emission import clib_files
from flexgen.codegen.statements import column_loops
from flexgen.identification.servo import record
from flexgen.identification.servo.record import ServoRecord
from flexgen.studies.scenarios import measures


def test_figures_of_an_output_by_hand() -> None:
    """Peak to peak, root mean square about the mean, and the time until it stays within the
    tolerance.
    """
    z = np.array([0.0, 3.0, -1.0, 0.5, 0.25, -0.125, 0.0, 0.0, 0.0, 0.0])
    scenario: Any = Made(sample_s=0.05, tolerance=0.25, measures_version=1)
    assert measures.LAST_S == 0.1  # two samples: what it settles to
    assert measures._of_output("peak", z, scenario) == 4.0
    assert measures._of_output("rms", z, scenario) == pytest.approx(np.std(z))
    # equal to the tolerance is inside
    assert measures._of_output("settling", z, scenario) == pytest.approx(0.05 * 3)
    assert measures._of_output("settling", z - 1.0, scenario) == pytest.approx(0.05 * 3)
    assert measures._of_output("settling", 0.2 + 0 * z, scenario) == 0.0
    scenario.measures_version = 2
    # the envelope from the end over the tolerance less a half, from zero to one
    shares = np.clip(np.array([3.0, 3.0, 1.0, 0.5, 0.25, 0.125]) / 0.25 - 0.5, 0.0, 1.0)
    assert (
        measures._of_output("settling", z, scenario) == pytest.approx(0.05 * shares.sum())
        and shares[4] == 0.5
    )


@pytest.mark.parametrize("last", ["0.02,3,4\n", "\n0.02,3,4\n"])
def test_rows_of_a_record_of_a_servo(
    last: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Times in s or ms; the line of a mistake is that of the file."""
    monkeypatch.setattr(record, "FEWEST", 2)
    model: Any = Made(i_g=(0,), coordinates=[Made(name="q1", unit="rad")], title="arm", name="arm")
    read: Any = inspect.unwrap(vars(ServoRecord)["read"].__func__)
    file = tmp_path / "record.csv"
    file.write_text("time_s,q1_command_rad,q1_rad\n0.00,1,2\n0.01,2,3\n" + last)
    found = read(ServoRecord, file, model)
    assert_allclose(found.time, [0.0, 0.01, 0.02])
    assert_allclose(np.hstack([found.command, found.angle]), [[1, 2], [2, 3], [3, 4]])
    file.write_text("time_ms, q1_command_deg ,q1_deg\n0,180,90\n10,2,3,\n20,3,4\n")
    found = read(ServoRecord, file, model)
    assert_allclose(found.time, [0.0, 0.01, 0.02])
    assert_allclose([found.command[0, 0], found.angle[0, 0]], [np.pi, np.pi / 2])
    for text, line, given in (("10,2", 3, 2), ("10,2,3,4", 3, 4), ("10,2,3\n20,1", 4, 2)):
        file.write_text(f"time_ms,q1_command_deg,q1_deg\n0,1,2\n{text}\n")
        with pytest.raises(
            ArgumentError,
            match=rf"record\.csv:{line}: given {given} cells, expected 3, one for each",
        ):
            read(ServoRecord, file, model)


def test_stacks_of_functions_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """In whole KiB; each feature of a library adds its arrays."""
    asked: dict[str, Any] = {}
    defaults = {"has_positions": False, "filter_sizes": (0, 0, 0), "count_elements": 0}
    defaults |= {"is_curved": False, "is_harmonic": False, "is_bristled": False}

    def size(**more: Any) -> int:
        asked.clear()
        asked.update(defaults | more)
        for name, value in asked.items():
            monkeypatch.setattr(clib_files, name, lambda spec, value=value: value)
        spec: Any = Made(sizes={"n_a": 7, "n_e": 2, "n_y": 3, "n_g": 5, "n_m": 6})
        return clib_files.stack_bytes(spec)

    base = 7 * (7 + 12 + 6 + 16) + 3 * 2 * 3 + 80
    for more, reals in (
        ({}, 0),
        ({"has_positions": True}, 55 + 3),
        ({"has_positions": True, "filter_sizes": (9, 9, 4)}, 55 + 3 + 80),
        ({"filter_sizes": (9, 9, 4)}, 0),
        ({"count_elements": 1}, 80 * 13 + 80),
        ({"count_elements": 3}, 80 * 13 + 80 + 6 * 13),
        ({"count_elements": 3, "is_curved": True}, 80 * 13 + 80 + 6 * 13 + 3 * 13 + 60),
        ({"is_harmonic": True}, 960),
        ({"is_bristled": True}, 140),
    ):
        found = size(**more)
        least = 8 * (base + reals) + 10_000
        assert found % 1024 == 0 and least <= found < least + 1024, more


def test_loops_over_columns_have_sums_and_products_only() -> None:
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x], [ca.sin(x[0]) + x[1]], ["x"], ["y"])
    step: Any = Made(function=function, tables={}, n=4)
    layout: Any = Made(at=lambda array, row: 10 * row, precision="double")
    with pytest.raises(
        BuildError, match="columns of f: given the operation sin, expected sums and products"
    ):
        column_loops.columns_text("f", step, layout, str)
    step.function = ca.Function("f", [x], [x[0] * x[1] - x[1]], ["x"], ["y"])
    text, operations, depth = column_loops.columns_text("f", step, layout, str)
    assert operations == 2 and depth >= 2 and "for (k = 0; k < ROW_COUNT(4); ++k) {" in text
