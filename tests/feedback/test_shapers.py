"""Input shapers: what remains of one mode is that of the closed form, ZV cancels it, ZVD also its
slope; robots whose motors follow positions.
"""

from __future__ import annotations

import numpy as np
import pytest
from panda import panda_urdf
from scipy.integrate import solve_ivp
from slide import DAMPING, FREQUENCY, SLIDE

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.positions import shapers

EXACT = 1e-12
OF_SIMULATION = 2e-5  # of the vibration without a shaper


@pytest.fixture
def slide(tmp_path) -> flexgen.RobotModel:
    path = tmp_path / "slide.toml"
    path.write_text(SLIDE, encoding="utf-8")
    return flexgen.read(path)


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.3, 0.7])
def test_zv_and_zvd_leave_nothing_of_the_mode(damping):
    for name in ("zv", "zvd"):
        shaper = flexgen.Shaper.of_mode(name, 3.0, damping)
        assert shaper.vibration(3.0, damping) < EXACT
        assert shaper.amplitudes.sum() == pytest.approx(1.0, abs=EXACT)
    assert flexgen.Shaper.of_mode("none", 3.0, damping).vibration(3.0, damping) == 1.0


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.3])
def test_slope_over_the_frequency_is_zero_of_zvd_alone(damping):
    """The vibration that remains falls with the error of the frequency, or with its square."""
    for name, power in (("zv", 1), ("zvd", 2)):
        shaper = flexgen.Shaper.of_mode(name, 3.0, damping)
        rest = [shaper.vibration(3.0 * (1 + x), damping) for x in (2e-4, 1e-4)]
        assert rest[0] / rest[1] == pytest.approx(2.0**power, rel=2e-3)


def planted_shaper(monkeypatch) -> None:
    """Impulses at half periods of the undamped mode with equal amplitudes."""
    plain = flexgen.Shaper.of_mode

    def wrong(name, frequency_hz, damping=0.0):
        return plain(name, frequency_hz, 0.0)

    monkeypatch.setattr(shapers.Shaper, "of_mode", staticmethod(wrong))


def test_the_planted_shaper_without_damping_is_seen(monkeypatch):
    planted_shaper(monkeypatch)
    assert flexgen.Shaper.of_mode("zv", 3.0, 0.3).vibration(3.0, 0.3) > 0.1


def test_shaped_steps_stop_an_oscillator():
    """An oscillator under the impulses, integrated by another program."""
    w = 2 * np.pi * 3.0
    d = 0.1
    shaper = flexgen.Shaper.of_mode("zv", 3.0, d)
    end = shaper.delay_s

    def slope(t, x):
        command = sum(a for at, a in zip(shaper.times, shaper.amplitudes, strict=True) if t >= at)
        return [x[1], w**2 * (command - x[0]) - 2 * d * w * x[1]]

    first = solve_ivp(slope, (0.0, end - 1e-12), [0.0, 0.0], rtol=1e-11, atol=1e-13)
    assert first.y[:, -1] == pytest.approx([1.0, 0.0], abs=1e-7)


def test_positions_of_a_table_are_shaped_and_end_at_rest():
    time = 0.004 * np.arange(100)
    positions = np.column_stack([np.linspace(0.0, 1.0, 100), np.ones(100)])
    shaper = flexgen.Shaper.of_mode("zvd", 3.0, 0.02)
    longer, shaped = shaper.shape(time, positions)
    assert longer[-1] >= time[-1] + shaper.delay_s > longer[-2]
    assert shaped[[0, -1]] == pytest.approx(positions[[0, -1]])
    assert (np.diff(shaped[:, 0]) >= -EXACT).all()


@pytest.mark.parametrize("detuning", [0.8, 1.0, 1.1])
def test_simulated_vibration_is_that_of_the_closed_form(slide, detuning):
    found = flexgen.compare_shapers(slide, detuning=[detuning])
    plain, *others = found.runs
    assert found.coordinate == "sway"
    assert found.frequency_hz == pytest.approx(FREQUENCY, rel=1e-6)
    assert found.damping == pytest.approx(DAMPING, rel=1e-6)
    for run in others:
        shaper = flexgen.Shaper.of_mode(run.shaper, FREQUENCY * detuning, DAMPING)
        expected = shaper.vibration(FREQUENCY, DAMPING)
        ratio = run.vibration / plain.vibration
        assert ratio == pytest.approx(expected, rel=0.05, abs=OF_SIMULATION)
        assert run.duration_s == pytest.approx(0.3 + shaper.delay_s)


def test_joints_with_elastic_gears_are_free():
    found = flexgen.compare_shapers("planar5_nmp", detuning=[1.0], coordinate="q2")
    assert (found.coordinate, found.unit) == ("q2", "rad")
    plain, zv, zvd = (run.vibration for run in found.runs)
    assert zvd < zv < plain


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"coordinate": "q1"}, "expected one of sway"),
        ({"detuning": []}, "numbers from 0.1 to 10"),
        ({"detuning": [1.0, 20.0]}, "numbers from 0.1 to 10"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(slide, change, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.compare_shapers(slide, **change)


def test_invalid_shapers_are_refused(tmp_path):
    for times, amplitudes, words in (
        ([0.1, 0.2], [0.5, 0.5], "from 0 on"),
        ([0.0, 0.2], [0.5, 0.6], "of sum 1"),
        ([0.0, 0.2], [1.5, -0.5], "positive"),
        ([0.0, 0.2], [1.0], "expected"),
    ):
        with pytest.raises(ArgumentError, match=words):
            flexgen.Shaper(np.array(times), np.array(amplitudes))
    shaper = flexgen.Shaper.of_mode("zv", 3.0)
    with pytest.raises(ArgumentError, match="expected equal steps"):
        shaper.shape(np.array([0.0, 0.1, 0.3]), np.zeros((3, 1)))
    with pytest.raises(ArgumentError, match="has no elastic coordinates"):
        rigid = tmp_path / "panda.urdf"
        rigid.write_text(panda_urdf(), encoding="utf-8")
        flexgen.compare_shapers(flexgen.read(rigid, base="link0", tip="flange"))
