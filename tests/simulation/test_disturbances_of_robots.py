"""Disturbances of robots in a simulation: functions of time, tables, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.base.errors import ArgumentError
from flexgen.simulation.environment.disturbances import Disturbance, disturbance_table, rows_of


def test_disturbances_as_functions_of_time() -> None:
    t = np.array([-1.0, 0.0, 0.5, 1.0, 1.999, 2.0, 3.0])
    cases = {
        Disturbance("step", "m1", 2.0, 0.5): [0, 0, 2, 2, 2, 2, 2],
        Disturbance("step", "m1", 2.0, 0.5, 1.5): [0, 0, 2, 2, 2, 0, 0],
        Disturbance("pulse", "m1", -1.0, 0.0, 1.0): [0, -1, -1, 0, 0, 0, 0],
        Disturbance("ramp", "m1", 4.0, 0.0, 2.0): [0, 0, 1, 2, 3.998, 4, 4],
    }
    for made, expected in cases.items():
        assert_allclose(made.values(t), expected, atol=1e-12)
    chirp = Disturbance("chirp", "m1", 3.0, 0.5, 1.5, (2.0, 8.0))
    growth = np.log(4.0) / 1.5
    s = t - 0.5
    expected = np.where(
        (s >= 0) & (t < 2), 3 * np.sin(2 * np.pi * 2.0 * (np.exp(growth * s) - 1) / growth), 0
    )
    assert_allclose(chirp.values(t), expected, atol=1e-9)
    assert [x.end_s for x in (*cases, chirp)] == [np.inf, 2.0, 1.0, np.inf, 2.0]
    noise = Disturbance("noise", "m1", 0.5, 0.0, 4.0, (10.0, 20.0))
    long = np.arange(0.0, 4.0, 1e-3)
    x = noise.values(long, 3)
    lines = 40
    f = 10 + 10 * (np.arange(lines) + 0.5) / lines
    phase = 2 * np.pi * np.random.default_rng(3).random(lines)
    assert_allclose(
        x,
        0.5 * np.sqrt(2 / lines) * np.sin(2 * np.pi * np.outer(long, f) + phase).sum(axis=1),
        atol=1e-10,
    )
    assert x.std() == pytest.approx(0.5, rel=0.2)
    assert Disturbance("noise", "m1", 1.0, 0.0, 0.01, (1.0, 2.0)).values(np.zeros(1), 3)[
        0
    ] == pytest.approx(np.sqrt(2) * np.sin(phase[0]))
    assert (
        len(np.unique(Disturbance("noise", "m1", 1.0, 0.0, 99.0, (1.0, 9.0)).values(long))) > 3000
    )


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            ("bump", "m1", 1.0),
            "given kind 'bump', expected one of step, pulse, ramp, chirp, noise",
        ),
        (("step", "m1", np.inf), "step on m1, size: given inf"),
        (("step", "m1", 1.0, np.nan), "start_s: given nan"),
        (("pulse", "m1", 1.0), "length_s: given none"),
        (("pulse", "m1", 1.0, 0.0, 0.0), r"length_s: given 0\.0, expected a time > 0"),
        (("step", "m1", 1.0, 0.0, np.inf), "length_s: given inf"),
        (("chirp", "m1", 1.0, 0.0, 1.0), "frequency_hz: given None, expected two increasing"),
        (("chirp", "m1", 1.0, 0.0, 1.0, (2.0, 2.0)), "expected two increasing"),
        (("noise", "m1", 1.0, 0.0, 1.0, (0.0, 2.0)), "expected two increasing"),
        (("noise", "m1", 1.0, 0.0, 1.0, (1.0, np.inf)), "expected two increasing"),
        (("ramp", "m1", 1.0, 0.0, 1.0, (1.0, 2.0)), "expected none for this kind"),
    ],
)
def test_wrong_disturbances(given: tuple, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        Disturbance(*given)


def test_disturbances_of_robots_side_by_side() -> None:
    push = Disturbance("step", "tool.y", 5.0)
    twist = Disturbance("step", "m2", 1.0, 0.5)
    noise = Disturbance("noise", "m1", 1.0, 0.0, 1.0, (1.0, 9.0))
    t = np.array([0.25, 0.75])
    table = disturbance_table({0: (push,), 1: (twist, noise)}, ["m1", "m2"], t, 2, 4)
    assert table.shape == (2, 8, 2)
    assert_array_equal(table[:, 3, 0], [5, 5])
    assert_array_equal(table[:, 1, 1], [0, 1])
    assert_array_equal(table[:, 0, 1], noise.values(t, 5))
    assert np.count_nonzero(table) == 5
    assert disturbance_table({0: (push,), 1: (push,)}, ["m1"], t, 2).shape == (2, 7, 1)
    assert disturbance_table({0: (), 1: ()}, ["m1"], t, 2) is None
    assert [rows_of(x, ["a", "b"]) for x in ("b", "tool.x", "tool.rz")] == [1, 2, 7]
    with pytest.raises(ArgumentError, match="given the place 'c', expected one of a, b, tool"):
        rows_of("c", ["a", "b"])
