"""A real rotary flexible link: from the voltage to the angles of motor and tip."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from flexible_link import FREE, simulate_link, write_link
from scipy.io import loadmat

import flexgen

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FLEXGEN_DATA", ROOT.parent / "shared" / "data")) / "quanser_link"


def fit(measured: np.ndarray, computed: np.ndarray) -> float:
    """Explained part [%] of a signal about its mean."""
    error = np.linalg.norm(measured - computed)
    return float(100 * (1 - error / np.linalg.norm(measured - measured.mean())))


def test_motor_and_tip_of_a_flexible_link_from_the_voltage(tmp_path):
    """Fitted to 3 s, predicted for the 1.5 s after: each angle from the voltage alone, by a
    simulation that is not flexgen's.
    """
    if not DATA.is_dir():
        pytest.skip("no recordings quanser_link: rotary flexible link of Quanser")
    columns = {"t": ("vm", 0), "vm": ("vm", 1), "theta": ("theta", 2), "alpha": ("alpha", 1)}
    whole = {
        name: loadmat(DATA / f"data_{file}.mat")[f"data_{file}"][:, k]
        for name, (file, k) in columns.items()
    }
    paths = []
    for name, begin, end in (("fitted", 0.2, 3.2), ("held", 3.2, 5.0)):
        part = (whole["t"] >= begin) & (whole["t"] <= end)
        paths.append(write_link(tmp_path, name, {k: x[part] for k, x in whole.items()}))
    found = flexgen.fit_motion(
        None, paths[0], free=FREE, segment_s=0.4, validate=paths[1], progress=False
    )
    assert found.status in ("model error", "poorly validated")
    assert found.held_out_percent[0] > 85 and found.held_out_percent[1] > 50
    # the data sheet has 0.0688 N m s/rad of back EMF and 0.0038 kg m^2 of the link, clamped
    assert found.values["m1.viscous"] == pytest.approx(0.07, rel=0.15)
    assert 2e-3 < found.values["link.inertia_zz"] < 4e-3
    part = (whole["t"] >= 3.25) & (whole["t"] <= 4.75)
    t = whole["t"][part]
    volts = whole["vm"][part]
    theta, alpha = (np.deg2rad(whole[name][part]) for name in ("theta", "alpha"))
    rates = [(x[5] - x[0]) / (t[5] - t[0]) for x in (theta, alpha)]
    y = simulate_link(found.values, t, volts, np.array([theta[0], alpha[0], *rates]))
    assert fit(theta, y[:, 0]) > 80
    assert fit(theta + alpha, y[:, 0] + y[:, 1]) > 80
    assert fit(alpha, y[:, 1]) > 65
