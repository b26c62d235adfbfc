"""Loops of real springs: a series elastic actuator against a locked output."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import flexgen

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FLEXGEN_DATA", ROOT.parent / "shared" / "data")) / "sea_spring"


def ramp(name: str) -> Path:
    """The recording of a current [A] and a run."""
    found = sorted(DATA.glob(f"kt-{name}-*.npz"))
    if not found:
        pytest.skip("no recordings sea_spring: series elastic actuator of Imperial College")
    return found[0]


def loops(fitted: str, *held: str, **options: object) -> flexgen.SpringFit:
    """A fit to one recording, others held out."""
    return flexgen.identify_spring(
        "elbow",
        ramp(fitted),
        validate=[ramp(name) for name in held],
        joint="q1",
        names=("displacement", "torque_out_Nm"),
        progress=False,
        **options,
    )


@pytest.mark.parametrize(("fitted", "held"), [("7-1", "4-7"), ("4-7", "7-1")])
def test_smooth_ramps_predict_those_of_another_size(fitted, held):
    """Shape and width of the loop that was held out, within 10 % of its range."""
    found = loops(fitted, held)
    other = found.records[-1]
    assert found.status == "small error" and not other.is_fitted
    assert other.error < 0.1
    if other.width_of_model is not None:
        assert abs(other.width_of_model - other.width) < 0.1 * np.ptp(other.points[:, 0])


def test_ramps_that_stick_and_slip_are_poorly_validated():
    """Up to 10 % of the torques: deflections jump back while the torque rises, so that no law
    of the path alone can fit them, and the status says so.
    """
    found = loops("4-1", "3-3", "2-2", "1-1")
    assert found.status == "poorly validated"
    assert max(one.error for one in found.records) < 0.11
    for one in found.records[1:]:
        d, torque, _ = one.points.T
        rising = np.diff(torque) > 0.0
        assert (np.diff(d)[rising] < 0.0).any()
