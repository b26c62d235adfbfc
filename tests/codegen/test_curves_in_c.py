"""Curves of hysteresis in C: a table of polynomials, and its place in a header."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.spec.memory import Hysteresis
from flexgen.codegen.emission.constants_header import curves_text
from flexgen.codegen.emission.motor_constants import motor_constants
from flexgen.dynamics.hysteresis.hysteresis_law import curve_of


@pytest.mark.parametrize(("exponent", "gamma"), [(1.0, 0.3), (2.0, 0.5), (3.7, -0.4)])
def test_the_table_of_a_curve_in_c_is_the_curve(exponent: float, gamma: float) -> None:
    """Each row holds until the next one begins; the last one ends where the torque slips; C reads
    all of a row.
    """
    curve = curve_of(Hysteresis(1.0, 1.0, exponent, gamma))
    (first, dense, late), rows = curve.table()
    source = Path(flexgen.__file__).parent / "codegen" / "clib" / "hysteresis.h"
    body = source.read_text(encoding="utf-8").partition("real on_piece(")[2].partition("\n}\n")[0]
    # behind its begin and one over its length
    read = {int(k) for k in re.findall(r"\bc\[(\d+)\]", body)}
    assert read == set(range(rows.shape[1] - 2))
    begins = rows[:, 0]
    assert first == 0 and begins[dense] < 0.0 < begins[late] and (np.diff(begins) > 0).all()
    # pieces of one length
    assert np.ptp(np.diff(begins[: dense + 1])) < 1e-9 * np.abs(begins[0]) + 1e-12
    assert np.ptp(np.diff(begins[late:])) < 1e-9
    assert np.abs(begins[dense + 1 : late]).min() == 0.0
    for part in (0.0, 0.3, 0.999):
        u = begins + part / rows[:, 1]
        y = np.polynomial.polynomial.polyval(part, rows[:, 2:].T)
        assert_allclose(np.minimum(y, 1.0), curve.at(u), atol=1e-12)
    end = begins[-1] + 1 / rows[-1, 1]
    assert 1.0 - curve.at(np.array([end]))[0] <= 1e-13 < 1.0 - curve.at(begins[-2:-1])[0]


def test_curves_in_a_header_are_numbered_one_after_the_other() -> None:
    tables = [np.arange(20.0).reshape(2, 10), np.ones((3, 10))]
    constants = replace(
        motor_constants(flexgen.read("elbow")),
        hysteresis_curve=((0, -1), (1, 0)),
        hysteresis_bend=((1.5, 0.0), (2.0, 3.0)),
        curves=(((0, 0, 1), tables[0]), ((0, 1, 2), tables[1])),
    )
    text = curves_text(constants, "NG", lambda row: "{" + ", ".join(f"{x:g}" for x in row) + "}")
    numbers = dict(re.findall(r"(\w+)\[.* = (\{[^;]*\});", text))
    read = {
        name: np.array(json.loads(x.replace("{", "[").replace("}", "]")))
        for name, x in numbers.items()
    }
    assert read["hysteresis_curve"].tolist() == [[0, -1], [1, 0]]
    assert read["hysteresis_bend"].tolist() == [[1.5, 0.0], [2.0, 3.0]]
    # the rows of the second curve come behind the two of the first; then there is none
    assert read["curve_part"].tolist() == [[0, 0, 1], [2, 3, 4], [5, 5, 5]]
    assert read["curve_piece"].tolist() == np.vstack(tables).tolist()
    assert "[ELEMENTS][NG]" in text and "curve_part[3][3]" in text and "curve_piece[5][10]" in text
