"""Recordings in files: what is read, and what is refused with file, channel and time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.identification.records.description import check_common_jump, read_description
from flexgen.identification.records.experiment_file import read_experiment

BENCH = Path(__file__).resolve().parents[2] / "examples" / "motor_bench" / "bench.toml"
T = 1e-3
TIME = np.arange(1000) * T
TORQUE = np.sin(2 * np.pi * 10 * TIME) + 0.5 * np.cos(2 * np.pi * 30 * TIME)
ANGLE = 0.01 * np.cos(2 * np.pi * 10 * TIME) + 0.001 * np.sin(2 * np.pi * 30 * TIME)

TEXT = """\
model = "bench.toml"
period_s = 0.2
hold = "zoh"

[time]
name = "t"
unit = "s"

[[torque]]
motor = "m1"
name = "current"
unit = "A"
constant = 0.5
side = "motor"

[[angle]]
motor = "m1"
name = "angle"
unit = "rad"
side = "motor"

[[recording]]
file = "run.npz"
pose_rad = [0.0]
"""


def hold(count: int, burst: int) -> np.ndarray:
    """Indices of 1000 samples of which some, in bursts, are the one before."""
    kept = np.arange(1000)
    for first in np.random.default_rng(7).integers(1, 1000 - burst, count):
        kept[first : first + burst] = first - 1
    return kept


HELD = hold(10, 5)


def written(folder: Path, text: str = TEXT, **changes: np.ndarray) -> Path:
    """The description, the model and the recording in a folder."""
    (folder / "bench.toml").write_text(BENCH.read_text())
    (folder / "recordings.toml").write_text(text)
    arrays = {"t": TIME, "current": TORQUE, "angle": ANGLE} | changes
    np.savez(folder / "run.npz", **arrays)
    savemat(folder / "run.mat", {name: x.reshape(-1, 1) for name, x in arrays.items()})
    rows = np.stack([np.resize(x, 1000) for x in arrays.values()], axis=1)
    np.savetxt(
        folder / "run.csv", rows, delimiter=",", header=",".join(arrays), comments="", fmt="%.17g"
    )
    return folder / "recordings.toml"


@pytest.mark.parametrize("ending", ["npz", "mat", "csv"])
def test_spectra_of_a_recording(ending, tmp_path):
    found = read_experiment(written(tmp_path, TEXT.replace("run.npz", f"run.{ending}")))
    assert found.plan.lines.tolist() == [2, 6] and found.plan.periods == 5
    assert found.tau_m.shape == (1, 1, 1, 5, 2, 1)
    assert np.allclose(found.tau_m[0, 0, 0, 0, :, 0], [-0.5j, 0.25], atol=1e-12)
    assert np.allclose(found.q_m[0, 0, 0, 3, :, 0], [0.01, -0.001j], atol=1e-12)
    speed = np.sqrt((0.01 * 2 * np.pi * 10) ** 2 / 2 + (0.001 * 2 * np.pi * 30) ** 2 / 2)
    assert found.speed_sd[0, 0] == pytest.approx(speed)
    data = flexgen.frf(found)
    assert data.sample_s == pytest.approx(T) and np.allclose(
        data.G[0, 0], -((2 * np.pi * 10) ** 2) * 0.01 / -0.5j
    )


GAPS = {
    "in the second period": (0.25, 0.31, [2, 3, 4]),
    "in the last period": (0.9, 0.95, [0, 1, 2, 3]),
    "over two periods": (0.35, 0.45, [3, 4]),
}


@pytest.mark.parametrize("gap", GAPS)
def test_whole_periods_without_a_gap_are_read(gap: str, tmp_path: Path) -> None:
    """A drift tells the periods apart: they are those of the whole record."""
    begin, end, periods = GAPS[gap]
    drift = 1.0 + 0.1 * np.floor(TIME / 0.2 + 1e-9)
    whole = read_experiment(written(tmp_path, current=TORQUE * drift, angle=ANGLE * drift))
    kept = (begin >= TIME) | (end <= TIME)
    arrays = {"t": TIME, "current": TORQUE * drift, "angle": ANGLE * drift}
    told: list[str] = []
    changed = {name: x[kept] for name, x in arrays.items()}
    found = read_experiment(written(tmp_path, **changed), told.append)
    assert found.plan.periods == len(periods)
    # a spline through the samples gives the same values at the same instants
    for name in ("tau_m", "q_m"):
        right = getattr(whole, name)[:, :, :, periods]
        assert np.allclose(getattr(found, name), right, rtol=1e-6, atol=1e-9 * np.abs(right).max())
    first = 0.2 * periods[0]
    last = 0.2 * (periods[-1] + 1) - T
    words = f"{len(periods)} whole periods from {first:.6g} to {last:.6g} s are used: gap of"
    assert any(words in line and "rows" in line for line in told)


def test_the_other_recordings_are_cut_to_the_periods_that_are_left(tmp_path: Path) -> None:
    text = TEXT + '\n[[recording]]\nfile = "other.npz"\npose_rad = [0.0]\n'
    kept = (TIME <= 0.25) | (TIME >= 0.31)
    file = written(tmp_path, text)
    arrays = {"t": TIME[kept], "current": TORQUE[kept], "angle": ANGLE[kept]}
    np.savez(tmp_path / "other.npz", **arrays)
    found = read_experiment(file)
    assert found.q_m.shape[:4] == (1, 1, 2, 3)
    assert np.allclose(found.q_m[0, 0, 0], found.q_m[0, 0, 1], rtol=1e-6, atol=1e-10)


def test_transient_periods_before_a_gap_are_not_read(tmp_path: Path) -> None:
    text = TEXT.replace("period_s = 0.2", "period_s = 0.2\ntransients = 1")
    kept = (TIME <= 0.65) | (TIME >= 0.7)
    arrays = {"t": TIME[kept], "current": TORQUE[kept], "angle": ANGLE[kept]}
    assert read_experiment(written(tmp_path, text, **arrays)).plan.periods == 2


def test_units_and_sides_are_converted(tmp_path):
    """Degrees on the arm side of a gear with ratio 50."""
    text = TEXT.replace('unit = "rad"\nside = "motor"', 'unit = "deg"\nside = "arm"').replace(
        'constant = 0.5\nside = "motor"', 'constant = 0.5\nside = "arm"'
    )
    file = written(tmp_path, text, angle=np.degrees(ANGLE))
    (tmp_path / "bench.toml").write_text(BENCH.read_text().replace("ratio = 1", "ratio = 50"))
    found = read_experiment(file)
    assert np.allclose(found.q_m[0, 0, 0, 0, 0, 0], 50 * 0.01, atol=1e-10)
    assert np.allclose(found.tau_m[0, 0, 0, 0, 0, 0], -0.5j / 50, atol=1e-12)


def test_recordings_with_a_rounded_clock_have_one_sample_time(tmp_path):
    """Whole microseconds at 1024 Hz, in files of different lengths; a clock that is 0.1 % slow is
    another one.
    """
    t = np.round(1e6 * np.arange(1000) / 1024) / 1e6
    file = written(tmp_path, TEXT + '\n[[recording]]\nfile = "other.npz"\npose_rad = [0.0]\n', t=t)
    for rate in (1.0, 1.001):
        np.savez(
            tmp_path / "other.npz", t=5.0 + rate * t[:900], current=TORQUE[:900], angle=ANGLE[:900]
        )
        if rate == 1.0:
            assert len({one.sample_s for _, one in read_description(file).recordings}) == 2
    with pytest.raises(ArgumentError, match=r"sample times .*, expected one"):
        read_description(file)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"angle": np.where(TIME[17] == TIME, np.nan, ANGLE)},
            "channel 'angle': sample 17 is not a finite number",
        ),
        (
            {"t": TIME + 0.01 * np.floor(TIME / 0.3 + 1e-9)},
            r"run\.npz: given gap of 0\.011 s from 0\.299 to 0\.31 s, rows 300 and 301; .*, "
            r"expected at least two whole periods of 0\.2 s without a gap",
        ),
        ({"t": TIME * 1e3}, "expected at least two periods|whole number"),
        ({"t": -TIME}, "time goes from"),
        (
            {"current": 0 * TORQUE},
            r"torque of motor m1 \('current'\): the same value at all times",
        ),
        ({"angle": 0 * ANGLE + 1}, r"angle of motor m1 \('angle'\): the same value"),
        (
            {"current": np.clip(TORQUE, -0.9, 0.9)},
            r"at its limit of 0\.45 N m at t = .*: excite less",
        ),
        (
            {"angle": np.where(TIME > 0.3, ANGLE + 6.28, ANGLE)},
            r"jumps by 6\.\d+ rad at t = 0\.3 s: the encoder wraps",
        ),
        (
            {"angle": ANGLE[HELD]},
            r"m1 .*: stands still and jumps \d+ times, first at t = 0\.\d+ s: samples are lost",
        ),
        ({"angle": ANGLE[:900]}, "given 900 samples, expected 1000"),
        (
            {"angle": np.ones((1000, 2))},
            r"channel 'angle': given shape \(1000, 2\), expected numbers",
        ),
    ],
)
def test_recordings_that_cannot_be_used_are_refused(changes, words, tmp_path):
    with pytest.raises(ArgumentError, match=words):
        read_experiment(written(tmp_path, **changes))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('unit = "rad"\n', "", r"recordings.toml:\d+:angle.*unit: given nothing"),
        ('unit = "rad"', 'unit = "gon"', r"unit: given \"gon\", expected one of .*deg"),
        ('side = "motor"\n\n[[angle]]', "\n[[angle]]", "side: given nothing"),
        ("constant = 0.5\n", "", "constant: given nothing, expected a number"),
        (
            'motor = "m1"\nname = "angle"',
            'motor = "m2"\nname = "angle"',
            "motor: given .m2.|expected .*m1",
        ),
        (
            'name = "angle"',
            'name = "theta"',
            "given no channel 'theta', expected one of angle, current, t",
        ),
        ("pose_rad = [0.0]", "pose = [0.0]", "pose_rad or pose_deg"),
        ("pose_rad = [0.0]", "pose_rad = [0.0, 1.0]", "pose_rad"),
        ('file = "run.npz"', 'file = "none.npz"', "the path of a file"),
        ("period_s = 0.2", "period_s = 0.20033", "whole number of samples in period_s"),
        ("period_s = 0.2", "period_s = 0.9", "expected at least two periods of 900 samples"),
        ('hold = "zoh"', 'hold = "foh"', "hold: given"),
        ('hold = "zoh"', 'hold = "zoh"\nf_min = 31.0', "lines between f_min and f_max|above"),
        ("[time]", "[clock]", "clock: given an unknown key"),
    ],
)
def test_mistakes_in_the_description_are_named(old, new, words, tmp_path):
    assert old in TEXT
    with pytest.raises((ModelError, ArgumentError), match=words):
        read_experiment(written(tmp_path, TEXT.replace(old, new)))


def test_a_pose_beyond_the_limits_of_the_joints_is_refused(tmp_path):
    """As of degrees under pose_rad."""
    file = written(tmp_path, TEXT.replace("pose_rad = [0.0]", "pose_rad = [30.0]"))
    (tmp_path / "bench.toml").write_text(
        BENCH.read_text().replace("axis =", "lower_deg = -90\nupper_deg = 90\naxis =")
    )
    with pytest.raises(
        ModelError,
        match=r"pose_rad: given \[30.0\], .*goes to 30 rad, its range is -1.571 to 1.571",
    ):
        read_experiment(file)


def test_a_damaged_file_is_refused(tmp_path):
    file = written(tmp_path)
    (tmp_path / "run.npz").write_bytes(b"no archive")
    with pytest.raises(ArgumentError, match=r"run\.npz"):
        read_experiment(file)
    file = written(tmp_path, TEXT.replace("run.npz", "run.mat"))
    (tmp_path / "run.mat").write_bytes(b"no archive at all" * 20)
    with pytest.raises(ArgumentError, match=r"run\.mat: cannot be read as a MAT file"):
        read_experiment(file)
    file = written(tmp_path, TEXT.replace("run.npz", "run.csv"))
    (tmp_path / "run.csv").write_text("t,current,angle\n1,2\n3,4,5\n")
    with pytest.raises(
        ArgumentError,
        match=r"run\.csv:2: given 2 cells, expected 3, one for each name in the first line",
    ):
        read_experiment(file)
    (tmp_path / "run.csv").write_text("t,current,angle\n")
    with pytest.raises(
        ArgumentError, match=r"run\.csv: cannot be read: no numbers; expected names"
    ):
        read_experiment(file)
    with pytest.raises(ArgumentError, match="which is not a file"):
        read_experiment(tmp_path / "none.toml")


def test_spectra_of_unequal_steps_late_stamps_and_two_rates(tmp_path: Path) -> None:
    """The lines of the signals that were sampled, at a step that divides the period."""
    rng = np.random.default_rng(8)

    def signals(t: np.ndarray) -> dict[str, np.ndarray]:
        torque = np.sin(2 * np.pi * 10 * t) + 0.5 * np.cos(2 * np.pi * 30 * t)
        angle = 0.01 * np.cos(2 * np.pi * 10 * t) + 0.001 * np.sin(2 * np.pi * 30 * t)
        return {"current": torque, "angle": angle}

    even = 5e-4 * np.arange(2400)
    unequal = np.cumsum(rng.choice([0.9e-3, 1.15e-3], size=1200))
    late = even + np.clip(rng.normal(size=2400), -2, 2) * 1e-4
    slow = {"t_slow": even[::2], "current": signals(even[::2])["current"]}
    text = TEXT.replace('name = "current"', 'name = "current"\ntime = "t_slow"')
    for case, words, arrays in (
        ("unequal", TEXT, {"t": unequal} | signals(unequal)),
        ("late", TEXT, {"t": late} | signals(even)),
        ("rates", text, {"t": even} | signals(even) | slow),
    ):
        file = written(tmp_path, words)
        np.savez(tmp_path / "run.npz", **arrays)
        found = read_experiment(file)
        # the start of the record is another one: phases of both, relative to each other
        G = -0.5 * found.q_m[0, 0, 0, :, :, 0] / found.tau_m[0, 0, 0, :, :, 0]
        truth = -0.5 * np.array([0.01 / -0.5j, -0.001j / 0.25])
        assert found.plan.lines.tolist() == [2, 6], case
        assert np.allclose(G / truth, 1.0, atol=2e-3), case


SIZES = {1: 1.0, 3: 0.021, 4: 0.5, 5: 0.019, 9: 0.03}  # amplitudes of multiples of 5 Hz


@pytest.mark.parametrize(
    ("keys", "lines"),
    [
        ("", [1, 3, 4, 9]),  # above a fiftieth of the largest
        ('lines = "all"', list(range(1, 91))),  # to 0.45 of the sample rate
        ('lines = "odd"', list(range(1, 91, 2))),
        ('lines = "all"\nf_min = 10.0\nf_max = 15.0', [2, 3]),
        ('lines = "all"\nf_min = 10.1\nf_max = 19.9', [3]),
        ('lines = "all"\nf_min = 490.0\nf_max = 900.0', [98, 99]),
        ("line_numbers = [7, 1, 99, 7]", [1, 7, 99]),
        ("line_numbers = [100]", "line_numbers: .*whole numbers from 1 to 99"),
        ("line_numbers = []", "line_numbers: .*whole numbers from 1 to 99"),
        ("line_numbers = [1.0]", "line_numbers: .*whole numbers from 1 to 99"),
        ("line_numbers = [1]\nf_max = 9.0", "no lines, f_min or f_max in addition to it"),
        ('lines = "all"\nf_min = 6.0\nf_max = 9.0', "lines between f_min and f_max"),
    ],
)
def test_lines_of_recordings_are_excited_odd_all_or_numbered(keys, lines, tmp_path):
    """The mean of a torque does not count, nor what differs from period to period."""
    tau = sum(a * np.sin(2 * np.pi * 5 * k * TIME) for k, a in SIZES.items()) + 5.0
    tau = tau + 0.3 * np.array([1, -1, 1, -1, 0])[(TIME / 0.2 + 1e-9).astype(int)]
    text = TEXT.replace("period_s = 0.2", f"period_s = 0.2\n{keys}")
    file = written(tmp_path, text, current=tau)
    if isinstance(lines, list):
        assert read_experiment(file).plan.lines.tolist() == lines
        return
    with pytest.raises(ModelError, match=lines):
        read_experiment(file)


def test_a_list_of_names_is_the_sum_of_their_arrays(tmp_path):
    """Also of rows of arrays with two dimensions, with offset and scale of the sum."""
    (tmp_path / "bench.toml").write_text(BENCH.read_text(encoding="utf-8"))
    table = np.array([TORQUE - 0.2, TIME])
    more = {"load": table, "friction": np.array([0.2 + 0 * TIME, TIME])}
    np.savez(tmp_path / "run.npz", t=TIME, angle=ANGLE, current=TORQUE, **more)
    text = TEXT.replace('name = "current"', 'name = ["load", "friction"]\nindex = 0\nscale = 2.0')
    (tmp_path / "sum.toml").write_text(text)
    (tmp_path / "one.toml").write_text(TEXT)
    one, two = (read_description(tmp_path / f"{x}.toml").recordings[0][1] for x in ("one", "sum"))
    np.testing.assert_allclose(two.tau_m, 2.0 * one.tau_m, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (
            '["current", "t2"]',
            r"channel 't2': given no such array, expected .* of shape \(1000,\)",
        ),
        ('["current", "short"]', r"channel 'short': given shape \(9,\), expected"),
        ('["current", "current"]', "a list of different names"),
        ("[]", "name"),
        ('["current", "tau_Nm"]', "unit"),
    ],
)
def test_sums_that_cannot_be_formed_are_refused(tmp_path, names, words):
    (tmp_path / "bench.toml").write_text(BENCH.read_text(encoding="utf-8"))
    arrays = {"short": TIME[:9], "tau_Nm": TORQUE}
    np.savez(tmp_path / "run.npz", t=TIME, angle=ANGLE, current=TORQUE, **arrays)
    (tmp_path / "a.toml").write_text(TEXT.replace('name = "current"', f"name = {names}"))
    with pytest.raises((ArgumentError, ModelError), match=words):
        read_description(tmp_path / "a.toml")


def test_torques_near_the_limit_of_the_motor_are_refused(tmp_path):
    """From 99.9 % on; two equal samples at the largest torque are none of a limit."""
    top = 0.5 * np.abs(TORQUE).max()
    file = written(tmp_path)
    bench = BENCH.read_text()
    for limit, refused in ((top / 0.998, False), (top / 0.9995, True)):
        (tmp_path / "bench.toml").write_text(
            bench.replace("ratio = 1", f"torque_max = {limit}\nratio = 1")
        )
        if refused:
            with pytest.raises(ArgumentError, match="at its limit"):
                read_experiment(file)
        else:
            read_experiment(file)
    twice = TORQUE.copy()
    twice[50:52] = 2.0
    read_experiment(written(tmp_path, current=twice))
    twice[52] = 2.0
    with pytest.raises(ArgumentError, match=r"at its limit of 1 N m at t = 0\.05 s: excite less"):
        read_experiment(written(tmp_path, current=twice))


def test_a_block_of_lost_samples_is_not_a_wrap() -> None:
    """Both angles jump in the same row; where one alone does, its encoder may have wrapped."""
    time = np.arange(0.0, 2.0, 1e-3)
    whole = [np.sin(3.0 * time), 2.0 * np.cos(2.0 * time)]
    kept = np.delete(np.arange(len(time)), slice(700, 1100))
    times = [time[: len(kept)]] * 2
    with pytest.raises(ArgumentError, match=r"2 angles jump at t = 0\.699 s: samples are lost"):
        check_common_jump("run", times, [angle[kept] for angle in whole])
    check_common_jump("run", [time] * 2, whole)
    wrapped = whole[0] + 6.28 * (time > 0.5)
    check_common_jump("run", [time] * 2, [wrapped, whole[1]])
