"""Paths through recorded samples of analytic paths, against their closed-form torques.

Samples are rounded, stamped late or with kinks.
"""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.model.moves import Move
from flexgen.paths.path import Path
from flexgen.paths.samples import sample_smoothing
from flexgen.paths.samples.sample_files import read_samples
from flexgen.paths.samples.sample_smoothing import kinks_of, noise_of, smooth_spline

T = 2.0
N = 201
SIZE = 0.3


def law(t: np.ndarray) -> np.ndarray:
    """A quintic from rest to rest, (4, n): 0 to 3 derivatives in time."""
    x = t / T
    return SIZE * np.array(
        [
            10 * x**3 - 15 * x**4 + 6 * x**5,
            (30 * x**2 - 60 * x**3 + 30 * x**4) / T,
            (60 * x - 180 * x**2 + 120 * x**3) / T**2,
            (60 - 360 * x + 360 * x**2) / T**3,
        ]
    )


TIME = np.linspace(0.0, T, N)
LARGEST = SIZE * 10 / np.sqrt(3) / T**2  # of the second derivative, in closed form


def rounded(digits: int) -> tuple[np.ndarray, np.ndarray]:
    return TIME, np.round(law(TIME)[0], digits)


def jittered(late: float) -> tuple[np.ndarray, np.ndarray]:
    """Right positions with wrong times."""
    away = np.random.default_rng(0).uniform(-late, late, N)
    away[[0, -1]] = 0.0
    return TIME + away, law(TIME)[0]


CASES = {
    "rounded to 1e-3": (rounded(3), 1.5e-3),
    "rounded to 1e-4": (rounded(4), 2e-4),
    "late by 1 ms": (jittered(1e-3), 6e-4),
    "late by 3 ms": (jittered(3e-3), 2e-3),
}


def write(file: FilePath, columns: dict[str, np.ndarray]) -> str:
    rows = np.stack(list(columns.values()), axis=1)
    text = "\n".join(",".join(f"{x:.12g}" for x in row) for row in rows)
    file.write_text(",".join(columns) + "\n" + text + "\n")
    return str(file)


@pytest.mark.parametrize("name", CASES)
def test_a_smooth_path_has_the_second_derivative_of_the_analytic_one(name: str) -> None:
    """The spline through the samples has 2 to 100 times of it; the stated deviation is kept."""
    (t, x), smooth = CASES[name]
    fine = np.linspace(0.0, T, 2001)
    through = make_interp_spline(
        t, x[:, None], k=7, bc_type=([(k, [0.0]) for k in (1, 2, 3)],) * 2
    )
    assert np.abs(through.derivative(2)(fine)).max() > 2.0 * LARGEST
    found = smooth_spline(t, x[:, None], 7, smooth, 0, rest=True)
    measured = np.abs(found.spline(t)[:, 0] - x).max()
    assert found.deviation == pytest.approx(measured) and measured <= smooth
    assert np.abs(found.spline(fine)[:, 0] - law(fine)[0]).max() < 2.0 * smooth
    second = found.spline.derivative(2)(fine)[:, 0]
    assert np.abs(second).max() == pytest.approx(LARGEST, rel=0.1)
    assert np.sqrt(((second - law(fine)[2]) ** 2).mean()) < 0.06 * LARGEST


@pytest.mark.parametrize("digits", [2, 3, 4, 5])
def test_the_noise_of_rounding_is_its_closed_form(digits: int) -> None:
    """The standard deviation of rounding is the unit over sqrt(12); a smooth path has none."""
    fast = 0.7 * np.sin(np.linspace(0.0, 40.0, 4000))
    t = np.arange(4000.0)
    assert noise_of(t, np.round(fast, digits)) == pytest.approx(
        10.0**-digits / np.sqrt(12), rel=0.2
    )
    assert noise_of(t, fast) < 1e-12


@pytest.mark.parametrize("count", [12, 30, 60, 400])
def test_smooth_paths_are_not_called_noise(count: int, tmp_path: FilePath) -> None:
    """Of few or many samples with nine decimals, also with uneven steps."""
    robot = flexgen.derive("planar5_nmp")
    t = T * np.sort(np.random.default_rng(1).uniform(0.0, 1.0, count))
    t[[0, -1]] = 0.0, T
    t = 0.5 * (t + np.linspace(0.0, T, count))
    file = write(tmp_path / "s.csv", {"t": t, "q1": np.round(law(t)[0], 9), "q2": 0 * t - 1.0})
    path = Path(robot, Move("s", "sampled", (), 0.0, 0, file=file))
    assert not [line for line in path.notes if "noise" in line or "kink" in line]


@pytest.mark.parametrize("name", CASES)
def test_noise_is_named_with_its_figures_and_what_to_do(name: str, tmp_path: FilePath) -> None:
    """The proposed deviation gives the right second derivative."""
    (t, x), _ = CASES[name]
    robot = flexgen.derive("planar5_nmp")
    file = write(tmp_path / "s.csv", {"t": t, "q1": x, "q2": 0 * t - 1.0})
    (note,) = Path(robot, Move("s", "sampled", (), 0.0, 0, file=file)).notes
    assert "second derivative of the samples of q1 is noise" in note
    smooth = float(note.rpartition("smooth = ")[2].split()[0])
    path = Path(robot, Move("s", "sampled", (), 0.0, 0, file=file, smooth=smooth))
    assert f"(smooth = {smooth:g} rad)" in path.notes[0]
    assert path.warnings == ()
    found = path.sample(np.linspace(0.0, T, 1001)).q_g
    assert found is not None
    assert np.abs(found[:, 0, 2]).max() == pytest.approx(LARGEST, rel=0.1)


def test_torques_of_a_smooth_path_are_those_of_the_analytic_path(tmp_path: FilePath) -> None:
    """Torques of the elastic arm too, which depend on the fourth derivative.

    The spline through the samples fails.
    """
    robot = flexgen.read("planar5_nmp")
    (t, x), smooth = CASES["rounded to 1e-4"]
    exact = write(tmp_path / "a.csv", {"t": TIME, "q1": law(TIME)[0], "q2": 0 * TIME - 1.0})
    noisy = write(tmp_path / "b.csv", {"t": t, "q1": x, "q2": 0 * t - 1.0})
    torque = {}
    for name, file, deviation in (
        ("exact", exact, 0.0),
        ("through", noisy, 0.0),
        ("smooth", noisy, smooth),
    ):
        move = Move(name, "sampled", (), 0.0, 0, file=file, smooth=deviation)
        solution = flexgen.solve(robot, move, verify=False, ignore_limits=True)
        torque[name] = float(np.abs(solution.trajectory["tau_m"][:, 0]).max())
    assert torque["smooth"] == pytest.approx(torque["exact"], rel=0.1)
    assert torque["through"] > 1.4 * torque["exact"]


def test_a_planted_spline_through_the_samples_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the score of samples that are left out, the most knots are best.

    They have the noise of the samples.
    """
    monkeypatch.setattr(sample_smoothing, "MOST_FITTED", 0.0)
    monkeypatch.setattr(sample_smoothing, "NEARLY", 1.0)
    (t, x), smooth = CASES["rounded to 1e-4"]
    found = smooth_spline(t, x[:, None], 7, smooth, 0, rest=True)
    fine = np.linspace(0.0, T, 2001)
    assert np.abs(found.spline.derivative(2)(fine)).max() > 1.1 * LARGEST


def test_a_deviation_that_no_smooth_path_keeps_names_the_sample() -> None:
    x = law(TIME)[0].copy()
    x[120] += 0.05
    with pytest.raises(ArgumentError, match=r"smooth: given 0.001, but near sample 121 "):
        smooth_spline(TIME, x[:, None], 7, 1e-3, 0, rest=True)


def test_kinks_are_named_by_their_row(tmp_path: FilePath) -> None:
    """A corner of 40 deg of a path without times, and a jump of the speed with times."""
    s = np.linspace(0.0, 1.0, 30)
    corner = np.stack(
        [s + np.where(s > 0.5, 0.0, 0.0), np.tan(np.radians(40)) * np.maximum(s - s[14], 0)],
        axis=1,
    )
    ((at, angle),) = kinks_of(s, corner, timed=False)
    assert at == 14 and np.degrees(angle) == pytest.approx(40.0)
    robot = flexgen.derive("planar5_nmp")
    q = np.minimum(TIME, 0.8)
    file = write(tmp_path / "k.csv", {"t": TIME, "q1": 0.2 * q, "q2": 0 * q})
    notes = Path(robot, Move("k", "sampled", (), 0.0, 0, file=file)).notes
    assert any("kink at sample 81 (line 82)" in line for line in notes)
    ring = np.linspace(0.0, 2.0, 40)
    assert kinks_of(ring, np.stack([np.cos(ring), np.sin(ring)], axis=1), timed=False) == []


@pytest.mark.parametrize(
    ("step", "fails"), [(0.0, True), (3e-9, True), (1e-6, True), (0.02, False)]
)
def test_rows_at_nearly_the_same_time_are_refused_by_row(
    step: float, fails: bool, tmp_path: FilePath
) -> None:
    robot = flexgen.read("planar5_nmp")
    t = np.concatenate([[0.0, step], np.linspace(0.1, 2.0, 20)])
    text = "".join(f"{x!r},{0.1 * x!r},0\n" for x in t.tolist())
    file = tmp_path / "n.csv"
    file.write_text("t,q1,q2\n" + text)
    if not fails:
        assert len(read_samples(str(file), robot, 2).values) == 22
        return
    with pytest.raises(ModelError, match=r"n\.csv:3:t: given "):
        read_samples(str(file), robot, 2)


def test_units_and_euler_angles_are_those_of_their_columns(tmp_path: FilePath) -> None:
    """Units mm, deg and ms; orientations as roll, pitch and yaw, against scipy's rotations."""
    from scipy.spatial.transform import Rotation

    planar = flexgen.read("planar5_nmp")
    plain = write(tmp_path / "a.csv", {"t": TIME, "q1": law(TIME)[0], "q2": 0.1 * TIME})
    units = {"t_ms": 1e3 * TIME, "q1_deg": np.degrees(law(TIME)[0]), "q2 [mrad]": 100 * TIME}
    one, other = (
        read_samples(file, planar, 2) for file in (plain, write(tmp_path / "b.csv", units))
    )
    assert np.allclose(one.values, other.values, atol=1e-9)
    assert one.knots is not None and other.knots is not None
    assert np.allclose(one.knots, other.knots, atol=1e-9)
    robot = flexgen.read("manutec_r3")
    angles = np.stack([0.3 * TIME, -0.2 * TIME, 0.4 * TIME], axis=1)
    columns = {"x_mm": 300 + 10 * TIME, "y_mm": 0 * TIME, "z": 0.9 + 0 * TIME}
    columns |= dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), np.degrees(angles).T, strict=True))
    found = read_samples(write(tmp_path / "p.csv", columns), robot, 2)
    expected = Rotation.from_euler("xyz", angles).as_quat()[:, [3, 0, 1, 2]]
    assert found.quaternions is not None and np.allclose(found.values[:, 0], 0.3 + 0.01 * TIME)
    same = np.abs((found.quaternions * expected).sum(axis=1))
    assert np.allclose(same, 1.0, atol=1e-9)
    wrong = write(tmp_path / "w.csv", {"x_deg": TIME, "y": TIME, "z": TIME})
    with pytest.raises(ModelError, match='the unit "deg", expected one of m, mm, um'):
        read_samples(wrong, robot, 2)


@pytest.mark.parametrize(
    "profile", [(), pytest.param((0.5, 4.0, 40.0, 400.0), marks=pytest.mark.slow)]
)
def test_out_and_back_stops_at_each_turn(profile: tuple[float, ...], tmp_path: FilePath) -> None:
    """Samples without times that go out, back and out again rest at the two turns."""
    robot = flexgen.derive("planar5_nmp")
    way = np.concatenate(
        [np.linspace(0.0, 0.4, 21), np.linspace(0.38, 0.1, 15), np.linspace(0.12, 0.5, 20)]
    )
    file = write(tmp_path / "w.csv", {"q1": way, "q2": 0.5 * way})
    given = (0.0, 0) if profile else (2.0, 5)
    path = Path(robot, Move("w", "sampled", (), *given, profile=profile, file=file))
    assert len(path.segments) == 3
    turns = np.array([segment.start for segment in path.segments[1:]])
    q = path.sample(turns).q_g
    assert q is not None and np.abs(q[:, :, 1]).max() < 1e-9
    assert q[:, 0, 0] == pytest.approx([0.4, 0.1], abs=1e-9)
    fine = path.sample(np.linspace(0.0, path.duration, 2001)).q_g
    assert fine is not None and fine[:, 0, 0].max() < 0.5 + 1e-9
    assert fine[-1, 0, 0] == pytest.approx(0.5)
