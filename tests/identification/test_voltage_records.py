"""Records whose input is the voltage of a motor: back EMF is viscous friction."""

from __future__ import annotations

import numpy as np
import pytest
from flexible_link import CONSTANT, DESCRIPTION, FREE, simulate_link, write_link

import flexgen
from flexgen.base.spec.units import conversion
from flexgen.identification.records.description import read_description

TRUE = {
    "hub.inertia_zz": 2.4e-3,
    "link.inertia_zz": 3.2e-3,
    "alpha.stiffness": 1.2,
    "alpha.damping": 8e-3,
    "m1.viscous": 0.02,
    "m1.coulomb": 0.02,
}
BACK_EMF = 0.5  # V s/rad, at the arm


def test_a_fit_to_voltages_finds_friction_and_back_emf(tmp_path):
    """Torque = k_t/R (V - k_e w): fitted is the viscous friction plus k_t k_e/R."""
    t = 2e-3 * np.arange(2001)
    volts = np.random.default_rng(3).choice([-4.0, 0.0, 4.0], 41).repeat(49)[:2001]
    y = simulate_link(TRUE, t, volts, np.zeros(4), BACK_EMF)
    degrees = np.rad2deg(y[:, :2])
    path = write_link(
        tmp_path, "run", {"t": t, "vm": volts, "theta": degrees[:, 0], "alpha": degrees[:, 1]}
    )
    found = flexgen.fit_motion(None, path, free=FREE, segment_s=0.4, progress=False)
    wanted = TRUE | {"m1.viscous": TRUE["m1.viscous"] + CONSTANT * BACK_EMF}
    for name, value in wanted.items():
        assert found.values[name] == pytest.approx(value, rel=0.01), name


def test_volts_are_torques_by_their_constant(tmp_path):
    t = 2e-3 * np.arange(100)
    arrays = {"t": t, "vm": np.sin(9 * t), "theta": np.sin(9 * t), "alpha": np.sin(9 * t)}
    path = write_link(tmp_path, "run", arrays)
    volts = read_description(path).recordings[0][1].tau_m
    path.write_text(DESCRIPTION.replace("NAME", "run").replace('"V"', '"mV"'))
    assert read_description(path).recordings[0][1].tau_m == pytest.approx(1e-3 * volts)
    assert volts[:, 0] == pytest.approx(CONSTANT * np.sin(9 * t))


@pytest.mark.parametrize(
    ("unit", "words"),
    [
        ("V", "given a voltage in V, expected a torque"),
        ("V (0 N m/V)", "expected a number > 0 .N m/V."),
        ("V (0.1 N m/A)", "given 'V .0.1 N m/A.', an unknown unit"),
    ],
)
def test_voltages_without_their_constant_are_refused(unit, words):
    with pytest.raises(flexgen.ArgumentError, match=words):
        conversion("log.csv: column 'm1'", unit, "N m")
    assert conversion("log.csv", "mV (0.2 N m/V)", "N m") == pytest.approx(2e-4)
