"""Experiments in files: all that is kept is read again, and arrays that do not fit are refused by
name.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.experiment import LARGEST, Experiment
from flexgen.identification.experiments.sensor_simulation import SensorSignals
from flexgen.model.position_servo.filters import LowPass, Notch

SHAPE = (2, 1, 2, 3, 5, 2)  # poses, realizations, experiments, periods, lines, motors


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    """Random spectra of all kinds that an experiment may have, with two channels of sensors."""
    rng = np.random.default_rng(1)
    plan = flexgen.excite(
        "elbow",
        poses=[[0.5, -0.3], [0.1, 0.4]],
        period_s=0.5,
        lines=5,
        periods=3,
        hardware=DriveHardware(1e-3),
        progress=False,
    )
    filters = (LowPass(80.0), Notch(30.0, 0.2, 0.5))
    plan = replace(
        plan, sensors=("acc.x", "acc.y"), controller=replace(plan.controller, filters=filters)
    )

    def spectra(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    return Experiment(
        plan,
        spectra(*SHAPE),
        spectra(*SHAPE),
        rng.uniform(1, 2, (2, 2)),
        np.array([0.0, 0.25]),
        "run",
        "none",
        spectra(*SHAPE[:-1], 2),
        np.array([-1, 1, 2]),
        spectra(2, 1, 2, 3, 5, 6),
        (0, 1),
        False,
        rng.standard_normal((2, 1, 2, plan.samples, 2)),
        True,
    )


def test_an_experiment_is_read_as_it_was_written(experiment: Experiment, tmp_path: Path) -> None:
    found = Experiment.load(experiment.save(tmp_path / "a.npz"))
    for name in (
        "tau_m",
        "q_m",
        "speed_sd",
        "saturated",
        "signals",
        "offsets",
        "beside",
        "references",
    ):
        assert_array_equal(getattr(found, name), getattr(experiment, name), err_msg=name)
    for name in ("source", "hold", "orders", "periodic", "lines_by_torque"):
        assert getattr(found, name) == getattr(experiment, name)
    assert (
        found.plan.controller.filters == experiment.plan.controller.filters
        and found.plan.sensors
        == (
            "acc.x",
            "acc.y",
        )
    )
    assert found.offsets is not None and found.offsets.dtype == int
    assert_array_equal(found.reference(1, 0, 1), experiment.references[1, 0, 1])
    plan = replace(experiment.plan, sensors=())
    plain = replace(
        experiment,
        plan=plan,
        signals=None,
        offsets=None,
        beside=None,
        orders=None,
        references=None,
    )
    found = Experiment.load(plain.save(tmp_path / "b.npz"))
    assert (found.signals, found.offsets, found.beside, found.orders, found.references) == (
        None,
    ) * 5
    expected = plan.poses[1] + plan.reference(0, 1)
    assert_array_equal(found.reference(1, 0, 1), expected)
    for wrong in ((2, 0, 0), (0, 1, 0), (0, 0, 2), (-1, 0, 0)):
        with pytest.raises(ArgumentError):
            found.reference(*wrong)
    assert repr(plain).startswith("<Experiment run: <Plan ")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tau_m": (2, 1, 2, 3, 4, 2)}, "arrays of different sizes"),
        ({"q_m": (2, 1, 2, 3, 5, 1)}, "arrays of different sizes"),
        ({"speed_sd": (2, 1)}, "arrays of different sizes"),
        ({"saturated": (3,)}, "arrays of different sizes"),
        (
            {"tau_m": (2, 1, 2, 4, 5, 2), "q_m": (2, 1, 2, 4, 5, 2)},
            "periods and hold: expected 3 and one of",
        ),
        ({"hold": "foh"}, "periods and hold: expected 3 and one of"),
        ({"signals": (2, 1, 2, 3, 5, 3)}, "signals: expected those of 2 sensor channels"),
        ({"signals": None}, "signals: expected those of 2 sensor channels"),
        ({"orders": [0]}, "orders: expected 2 numbers from 0 to 2"),
        ({"orders": [0, 3]}, "orders: expected 2 numbers from 0 to 2"),
        ({"orders": None}, "orders: expected 2 numbers from 0 to 2"),
        ({"offsets": None}, "offsets, beside: expected both or none"),
        ({"beside": None}, "offsets, beside: expected both or none"),
        ({"offsets": (2, 3)}, "offsets, beside: arrays of different sizes"),
        ({"beside": (2, 1, 2, 3, 5, 5)}, "offsets, beside: arrays of different sizes"),
        ({"beside": (2, 1, 2, 2, 5, 6)}, "offsets, beside: arrays of different sizes"),
        ({"references": (2, 1, 2, 3, 2)}, "references: expected a period of each experiment"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(
    experiment: Experiment, changes: dict[str, Any], words: str
) -> None:
    arrays, meta = experiment.data()
    for name, value in changes.items():
        if name in ("hold", "orders"):
            meta[name] = value
        elif value is None:
            del arrays[name]
        else:
            arrays[name] = np.ones(value)
    with pytest.raises(ValueError, match=f"^{words}"):
        Experiment.from_data(arrays, meta)


@pytest.mark.parametrize("name", ["tau_m", "q_m", "signals", "beside"])
def test_numbers_beyond_reason_are_refused(experiment: Experiment, name: str) -> None:
    arrays, meta = experiment.data()
    arrays[name] = arrays[name].copy()
    arrays[name].flat[3] = LARGEST
    Experiment.from_data(arrays, meta)
    arrays[name].flat[3] = 1.01 * LARGEST
    with pytest.raises(
        ValueError, match=f"^{name}: expected numbers up to {LARGEST:g}".replace("+", r"\+")
    ):
        Experiment.from_data(arrays, meta)


def test_sensors_sample_at_multiples_of_the_drives() -> None:
    """Which divide the period, and show the highest frequency; a difference of a millionth is
    none.
    """
    hardware = SimpleNamespace(sample_s=1e-3)
    frequencies = np.array([2.0, 20.0])
    plan: Any = SimpleNamespace(
        hardware=hardware, samples=500, lines=[1, 10], period_s=0.5, frequencies=frequencies
    )
    step = SensorSignals._step
    assert [step("acc.x", x, plan) for x in (None, 1e-3, 4e-3, 4e-3 + 9e-10, 2e-2)] == [
        1,
        1,
        4,
        4,
        20,
    ]
    words = (
        r"^sensor channel acc\.x: given sample_s = .* s, expected a multiple of 0\.001 s, the "
        r"sample time of the dri"
    )
    for wrong in (4e-3 + 2e-9, 3e-3, 4e-4, 1.5e-3):
        with pytest.raises(ArgumentError, match=words):
            step("acc.x", wrong, plan)
    with pytest.raises(
        ArgumentError, match=r"expected less than half a period of the highest frequency, 20 Hz$"
    ):
        step("acc.x", 2.5e-2, plan)
