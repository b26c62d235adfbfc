"""Intervals and instants of the methods: of the inversion in C, and of the closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from inversion_cases import question
from numpy.testing import assert_allclose

from flexgen.base.errors import SolverError
from flexgen.inversion.methods import closed_form, lq


@pytest.mark.parametrize(
    ("mesh", "h", "parts", "interval"),
    [
        (None, 2e-3, 1, 4e-3),
        (None, 4.9e-3, 1, 9.8e-3),
        (None, 6e-3, 1, 1e-2),
        (None, 6e-3, 4, 2.5e-3),
        (5e-4, 2e-2, 1, 2e-2),
        (5e-4, 2e-2, 2, 1e-2),
    ],
)
def test_intervals_in_c_are_two_steps_and_ten_milliseconds_at_most(
    mesh: float | None, h: float, parts: int, interval: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a mesh that is given, its own length; each divided into parts."""

    def grid(problem: Any, length: float) -> None:
        raise SolverError(f"asked {length:.12g}")

    monkeypatch.setattr(lq, "grid", grid)
    monkeypatch.setattr(lq, "inversion_library", lambda *given, **more: None)
    with pytest.raises(SolverError, match=f"^asked {interval:.12g}$"):
        lq.invert_path(question("elbow", mesh=mesh), "lq", h, parts)


@pytest.mark.parametrize(
    ("duration", "step", "settling", "on_path", "after"),
    [
        (1.0, 0.3, 0.6, 4, 3),
        (2.0, 0.5, 0.0, 4, 0),
        (1.0, 1e-9, 1e9, closed_form.SAMPLES, closed_form.SAMPLES),
    ],
)
def test_samples_have_equal_steps_and_one_at_the_end_of_the_path(
    duration: float, step: float, settling: float, on_path: int, after: int
) -> None:
    t, count = closed_form.instants(duration, step, settling)
    assert count == after and len(t) == on_path + after + 1
    assert t[0] == 0.0 and t[on_path] == duration
    assert_allclose(np.diff(t), duration / on_path, rtol=1e-6)
