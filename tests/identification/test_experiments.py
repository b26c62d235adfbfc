"""Experiments in files: all that is kept is read again, arrays that do not fit are refused by
name; spectra between the excited lines.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments import experiment as experiments
from flexgen.identification.experiments.experiment import LARGEST, Experiment
from flexgen.identification.responses.spectra import MOST_OFFSETS, all_spectra_beside, line_offsets
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


def test_spectra_next_to_lines_are_those_of_the_whole_record() -> None:
    """Amplitudes of unexcited frequencies around each line; none where there are too few
    periods.
    """
    rng = np.random.default_rng(1)
    lines = np.array([2, 5])
    periods = 4
    samples = 16
    x = rng.normal(size=(1, 2, periods, samples, 3))
    kept = all_spectra_beside(x, lines)
    offsets = kept["offsets"]
    found = kept["beside"]
    assert 0 not in offsets % periods and found.shape == (1, 1, 2, len(offsets), 2, 3)
    whole = x.reshape(1, 2, periods * samples, 3)
    t = np.arange(periods * samples) / (periods * samples)
    for k, d in enumerate(offsets):
        for j, line in enumerate(lines):
            wave = np.exp(-2j * np.pi * (periods * line + d) * t)
            expected = 2 * np.einsum("t,petc->pec", wave, whole) / len(t)
            assert_allclose(found[:, 0, :, k, j], expected, atol=1e-12)
    # three periods have no record without the first
    later = all_spectra_beside(x[:, :, 1:], lines)
    assert set(later) == {"offsets", "beside"} and all_spectra_beside(x[:, :, :1], lines) == {}
    assert_allclose(kept["offsets_later"], later["offsets"])
    assert_allclose(kept["beside_later"], later["beside"], atol=1e-14)


def test_unexcited_frequencies_lie_between_the_lines() -> None:
    """Not at multiples of the period, not at excited ones, not below zero; the nearest first."""
    found = line_offsets(np.array([3, 7]), 4)
    assert 0 < len(found) <= 2 * MOST_OFFSETS
    assert_allclose(np.sort(found), np.sort(-found))
    free = [d for d in range(1, 12) if d % 4][:MOST_OFFSETS]
    assert sorted(set(np.abs(found))) == free
    with pytest.raises(
        ArgumentError,
        match="given 1 periods and lines from 3 on, expected two unexcited frequencies",
    ):
        line_offsets(np.array([3, 7]), 1)
    assert sorted(set(np.abs(line_offsets(np.array([1, 7]), 4)))) == [1, 2, 3]
    with pytest.raises(ArgumentError, match="transients: given 2 periods and lines from 1 on"):
        line_offsets(np.array([1, 7]), 2)


def test_groups_of_runs_have_noise_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """The seed of a group is a multiple of the seed, and the number of its first run."""
    seeds: list[int] = []
    loop = experiments.ClosedLoop

    def made(*given: Any, seed: int, **more: Any) -> Any:
        seeds.append(seed)
        return loop(*given, seed=seed, **more)

    monkeypatch.setattr(experiments, "LANES", 2)
    monkeypatch.setattr(experiments, "ClosedLoop", made)
    poses = [[0.5, -0.3], [0.1, 0.4]]
    plan = flexgen.excite("elbow", poses=poses, period_s=0.2, f_min=5.0, lines=2, periods=2)
    flexgen.measure(plan, seed=5)
    assert seeds == [5 * 1_000_003 + first for first in (0, 2)]
