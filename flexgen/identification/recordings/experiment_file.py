"""Recordings of a real robot: read from files that a TOML file describes, checked, and turned into an experiment.

    model = "bench.toml"                       as `flexgen.read` takes it; or a file beside this one
    period_s = 1.0                             of the excitation
    hold = "zoh"                               of the torques between samples: "zoh" or "none"
    segment_s = 2.0                            instead of period_s, of a motion without period: of its segments
    lines = "excited"                          or "odd", "all": which multiples of 1/period_s between f_min and f_max;
                                               or line_numbers = [5, 7, 11]: these multiples

    [time]
    name = "time"                              array of the file
    unit = "us"                                s, ms, us

    [[torque]]                                 one for each motor
    motor = "m1"
    name = "iq"
    unit = "A"                                 N m; A with constant [N m/A]
    constant = 0.1
    side = "motor"                             of the gear: motor or arm

    [[angle]]
    motor = "m1"
    name = "theta"
    unit = "rad"                               rad, deg, mrad
    side = "motor"

    [[signal]]                                 optional, one for each channel of the model's sensors
    sensor = "acc.x"
    name = "acc_x"
    unit = "m/s^2"                             one of its kind, as in the model file

    [[recording]]                              one for each file: .mat (version 5), .npz, or .csv with names in line 1
    file = "run1.mat"
    pose_rad = [0.0]                           joints; or pose_deg

Recordings with the same pose are experiments of one realization, in their order. Nothing is mended: what cannot be used
is refused with file, channel and time.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.identification.excitation import Plan
from flexgen.identification.experiment import HOLDS, Experiment
from flexgen.identification.outputs import output_orders
from flexgen.identification.spectra import line_offsets, spectrum, windowed_spectrum
from flexgen.loop.closed_loop import Cascade, DriveHardware
from flexgen.model.checked_table import Table
from flexgen.model.digest import model_digest
from flexgen.model.elements import RobotModel
from flexgen.model.reader import parse_file, read
from flexgen.model.sensors import UNITS
from flexgen.npz_files import NpzError, read_npz

KEYS = (
    "model period_s segment_s hold lines line_numbers f_min f_max delay_s transients time torque angle signal recording"
).split()
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
ANGLE_UNITS = {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180}
TORQUE_UNITS = {"N m": 1.0, "A": 1.0}
SIDES = ("motor", "arm")
LINES = ("excited", "odd", "all")
EXCITED = 0.02  # part of the largest amplitude
JITTER = 0.05  # of a sample time: larger differences are lost samples
WRAP = 1.0  # rad: a larger step between two samples, and far larger than all others, is an encoder that wraps
CLIPPED = 3  # equal samples in a row at the largest torque
SIZE_MAX = 2_000_000_000  # bytes of a file


@dataclass(frozen=True)
class _Channel:
    """An array of the files: motor or sensor channel, name in the files, and the factor to motor-side SI units."""

    motor: str
    name: str
    factor: float


def read_experiment(path: str | Path) -> Experiment:
    """Read the recordings that a TOML file describes.

    Parameters
    ----------
    path : str or Path
        See the module's description.

    Returns
    -------
    Experiment

    Raises
    ------
    ModelError
        The TOML file has an error: file, line, key.
    ArgumentError
        A recording cannot be used: file, channel, time.
    """
    source = Path(path)
    if not source.is_file():
        raise ArgumentError(f"experiment: given {str(path)!r}, which is not a file, expected a .toml or .npz file")
    root = Table(str(source), parse_file(source, str(source)), "")
    root.only(*KEYS)
    try:
        beside = source.parent / root.text("model")
        model = read(beside if beside.is_file() else root.text("model"))
    except (ArgumentError, OSError, ValueError) as error:
        raise root.fail("model", f"a model that can be read ({error})") from None
    time = root.table("time")
    if time is None:
        raise root.fail("time", "a table with name and unit")
    time.only("name", "unit")
    clock = _Channel("", time.text("name"), TIME_UNITS[time.choice("unit", tuple(TIME_UNITS))])
    torques = _channels(root, "torque", TORQUE_UNITS, model)
    angles = _channels(root, "angle", ANGLE_UNITS, model)
    signals = _signals(root, model)
    periodic = "segment_s" not in root
    if not periodic and ("period_s" in root or "transients" in root):
        raise root.fail("segment_s", "either period_s, or segment_s without transients")
    period = root.number("period_s" if periodic else "segment_s", above=0.0)
    transients = root.whole("transients", 0, 1000) if "transients" in root else 0
    poses: dict[tuple[float, ...], list[tuple[np.ndarray, ...]]] = {}
    steps = []
    for table in root.tables("recording"):
        table.only("file", "pose_rad", "pose_deg")
        joints = table.angles("pose", [model.coordinates[i].unit == "rad" for i in model.i_g])
        file = _beside(source, table)
        recording = _Recording(file, clock, (torques, angles, signals), period, transients, periodic, model)
        steps.append(recording.sample_s)
        poses.setdefault(tuple(joints), []).append(recording.columns)
    if max(steps) - min(steps) > 1e-9 * max(steps):
        raise ArgumentError(f"{source}: given recordings with sample times {sorted(set(steps))} s, expected one")
    return _experiment(root, model, poses, steps[0], source, tuple(signal.motor for signal in signals))


def _beside(source: Path, table: Table) -> Path:
    """The file of a recording, relative to the description."""
    try:
        file = source.parent / table.text("file")
        if file.is_file():
            return file
    except (OSError, ValueError):  # a name that no file can have
        pass
    raise table.fail("file", "the path of a file, relative to this one")


def _channels(root: Table, kind: str, units: dict[str, float], model: RobotModel) -> list[_Channel]:
    """The channels of a kind in the order of the motors."""
    motors = [motor.name for motor in model.motors]
    found: dict[str, _Channel] = {}
    for table in root.tables(kind):
        table.only("motor", "name", "unit", "side", "constant", "offset")
        motor = table.choice("motor", motors)
        if motor in found:
            raise table.fail("motor", f"one {kind} for each motor")
        unit, side = table.choice("unit", tuple(units)), table.choice("side", SIDES)
        factor = units[unit]
        if unit == "A":
            factor *= table.number("constant", above=0.0)
        elif "constant" in table:
            raise table.fail("constant", "no constant where the unit is not A")
        if side == "arm":
            j = motors.index(motor)
            if len(model.motors[j].drives) != 1:
                raise table.fail("side", "motor: this motor drives several joints")
            ratio = model.motors[j].ratio[0]
            factor = factor / ratio if kind == "torque" else factor * ratio
        found[motor] = _Channel(motor, table.text("name"), factor)
    for motor in motors:
        if motor not in found:
            raise root.fail(kind, f"a table [[{kind}]] for motor {motor}, too")
    return [found[motor] for motor in motors]


def _signals(root: Table, model: RobotModel) -> list[_Channel]:
    """The sensor channels in the order of the file."""
    of = {name: sensor for sensor in model.sensors for name in sensor.channels}
    found: list[_Channel] = []
    for table in root.tables("signal", required=False):
        table.only("sensor", "name", "unit")
        if not of:
            raise table.fail("sensor", "a channel of a [[sensor]] of the model; the model has none")
        name = table.choice("sensor", tuple(of))
        if name in [channel.motor for channel in found]:
            raise table.fail("sensor", "one signal for each channel")
        units = UNITS[of[name].type]
        if of[name].type == "link_encoder":
            units = {unit: x for unit, x in units.items() if (unit in ANGLE_UNITS) == (of[name].unit == "rad")}
        unit = table.choice("unit", tuple(units))
        found.append(_Channel(name, table.text("name"), units[unit]))
    return found


class _Recording:
    """One file: ``columns``: torques, angles (motor side) and signals (periods, samples, n); and ``sample_s``."""

    def __init__(
        self,
        file: Path,
        clock: _Channel,
        kinds: tuple[list[_Channel], list[_Channel], list[_Channel]],
        period_s: float,
        transients: int,
        periodic: bool,
        model: RobotModel,
    ) -> None:
        self.file, self.arrays = file, _arrays(file)
        self.t = self._column(clock)
        self.sample_s = self._sample_time()
        whole = period_s / self.sample_s
        samples = round(whole)
        if samples < 2 or abs(whole - samples) > 1e-3:
            raise ArgumentError(
                f"{file}: given a sample time of {self.sample_s:.6g} s, expected a whole number of samples in "
                f"period_s = {period_s} s, not {whole:.4f}"
            )
        periods = len(self.t) // samples - transients
        if periods < 2:
            raise ArgumentError(
                f"{file}: given {len(self.t)} samples, expected at least two periods of {samples} samples after "
                f"{transients} transient ones"
            )
        columns = []
        for kind, channels in zip(("torque", "angle", "signal"), kinds, strict=True):
            found = [self._column(channel) for channel in channels]
            x = np.stack(found, axis=1) if found else np.zeros((len(self.t), 0))
            self._check(kind, channels, x, model)
            if periodic:
                whole_periods = x[transients * samples : (transients + periods) * samples]
                columns.append(whole_periods.reshape(periods, samples, -1))
            else:  # segments that overlap by half
                starts = range(0, len(x) - samples + 1, max(samples // 2, 1))
                columns.append(np.array([x[start : start + samples] for start in starts]))
        self.columns = tuple(columns)

    def _column(self, channel: _Channel) -> np.ndarray:
        """A channel in SI units on the motor side."""
        if channel.name not in self.arrays:
            listed = ", ".join(sorted(self.arrays))
            raise ArgumentError(f"{self.file}: given no channel {channel.name!r}, expected one of {listed}")
        x = np.asarray(self.arrays[channel.name])
        if not np.issubdtype(x.dtype, np.number) or np.iscomplexobj(x) or x.size < 3 or x.size != max(x.shape):
            raise ArgumentError(f"{self.file}: channel {channel.name!r}: given shape {x.shape}, expected numbers (n,)")
        x = x.ravel().astype(float)
        bad = np.flatnonzero(~np.isfinite(x))
        if len(bad):
            raise ArgumentError(f"{self.file}: channel {channel.name!r}: sample {bad[0]} is not a finite number")
        return x * channel.factor

    def _sample_time(self) -> float:
        steps = np.diff(self.t)
        step = float(np.median(steps))
        wrong = np.flatnonzero(np.abs(steps - step) > JITTER * abs(step)) if step > 0 else np.zeros(1, int)
        if len(wrong):
            k = int(wrong[0])
            raise ArgumentError(
                f"{self.file}: time goes from {self.t[k]:.6g} to {self.t[k + 1]:.6g} s at sample {k}, expected equal "
                f"steps of {step:.6g} s: samples are lost, or the unit of the time is another one"
            )
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))

    def _check(self, kind: str, channels: list[_Channel], x: np.ndarray, model: RobotModel) -> None:
        """ArgumentError for channels that do not move, wrap, are limited, or are shorter than the time."""
        for j, channel in enumerate(channels):
            of = "" if kind == "signal" else "motor "
            where = f"{self.file}: {kind} of {of}{channel.motor} ({channel.name!r})"
            column = x[:, j]
            if len(column) != len(self.t):
                raise ArgumentError(f"{where}: given {len(column)} samples, expected {len(self.t)} as of the time")
            if np.ptp(column) == 0.0:
                raise ArgumentError(f"{where}: the same value at all times, expected a signal")
            steps = np.abs(np.diff(column))
            if kind == "angle":
                k = int(np.argmax(steps))
                if steps[k] > WRAP and steps[k] > 50 * np.partition(steps, -10)[-10]:
                    raise ArgumentError(
                        f"{where}: jumps by {steps[k]:.3g} rad at t = {self.t[k]:.6g} s: the encoder wraps; unwrap it"
                    )
                continue
            if kind == "signal":
                continue
            top = np.abs(column).max()
            limit = model.motors[j].torque_max
            at_top = np.abs(column) >= (1 - 1e-9) * top
            row = at_top[: -CLIPPED + 1] & at_top[1 : -CLIPPED + 2] & at_top[2:]
            if row.any() or (limit is not None and top >= 0.999 * limit):
                k = int(np.argmax(at_top))
                raise ArgumentError(f"{where}: at its limit of {top:.4g} N m at t = {self.t[k]:.6g} s: excite less")


def _experiment(
    root: Table,
    model: RobotModel,
    poses: dict[tuple[float, ...], list[tuple[np.ndarray, ...]]],
    sample_s: float,
    source: Path,
    sensors: tuple[str, ...],
) -> Experiment:
    """The spectra at the lines, (poses, 1, experiments, periods, lines, n_m)."""
    counts = {len(runs) for runs in poses.values()}
    lengths = {x.shape[:2] for runs in poses.values() for run in runs for x in run}
    if len(counts) > 1 or len(lengths) > 1:
        raise root.fail("recording", "the same number of recordings, and of whole periods in each, at every pose")
    experiments, (periods, _) = counts.pop(), lengths.pop()
    if experiments < model.n_m:
        raise root.fail("recording", f"at least {model.n_m} recordings at each pose, one for each motor")
    periodic = "segment_s" not in root
    period = root.number("period_s" if periodic else "segment_s", above=0.0)
    # (poses, experiments, periods, samples, n)
    tau, q, signals = (np.array([[run[k] for run in runs] for runs in poses.values()]) for k in range(3))
    lines = _lines(root, tau, period)
    transformed = spectrum if periodic else windowed_spectrum
    # (poses, realizations, experiments, periods, lines, n)
    tau_m, q_m, found = (
        np.array([[[[transformed(p, lines) for p in run] for run in runs]] for runs in x]) for x in (tau, q, signals)
    )
    offsets, beside = _beside_lines(np.concatenate([tau, q, signals], axis=-1), lines) if periodic else (None, None)
    w = 2 * np.pi * lines / period
    speed = np.sqrt((np.abs(w[:, None] * q_m) ** 2).sum(axis=-2).mean(axis=(1, 2, 3)) / 2)
    n = model.n_m
    plan = Plan(
        model=f"{model.file}@{model.variant}" if model.variant else model.file,
        digest=model_digest(model),
        motors=tuple(motor.name for motor in model.motors),
        poses=np.array(list(poses)) @ model.eta.T,
        lines=lines,
        period_s=period,
        amplitudes=np.zeros((len(lines), n)),
        phases=np.zeros((1, len(lines), n)),
        periods=periods,
        transients=0,
        hardware=DriveHardware(sample_s, root.number("delay_s", 0.0, least=0.0)),
        controller=Cascade(*np.zeros((3, n))),
        sensors=sensors,
    )
    hold = root.choice("hold", HOLDS)
    orders = tuple(output_orders(model, sensors)[n:].tolist()) if sensors else None
    return Experiment(
        plan, tau_m, q_m, speed, np.zeros(len(poses), np.int64), str(source), hold, found if sensors else None, offsets,
        beside, orders, periodic,
    )  # fmt: skip


def _beside_lines(x: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Offsets and spectra beside the lines of x (poses, experiments, periods, samples, n); None: too few periods."""
    periods, samples = x.shape[2:4]
    try:
        offsets = line_offsets(lines, periods)
    except ArgumentError:
        return None, None
    whole = 2.0 / (periods * samples) * np.fft.fft(x.reshape(*x.shape[:2], periods * samples, -1), axis=2)
    at = periods * lines[None, :] + offsets[:, None]
    return offsets, whole[:, :, at][:, None]


def _lines(root: Table, tau: np.ndarray, period: float) -> np.ndarray:
    """The excited multiples of ``1 / period``."""
    samples = tau.shape[3]
    if "line_numbers" in root:
        if "lines" in root or "f_min" in root or "f_max" in root:
            raise root.fail("line_numbers", "no lines, f_min or f_max beside it")
        given = root.entries["line_numbers"].value
        numbers = [entry.value for entry in given] if isinstance(given, list) else []
        if not numbers or not all(isinstance(x, int) and 0 < x < samples / 2 for x in numbers):
            raise root.fail("line_numbers", f"whole numbers from 1 to {(samples - 1) // 2}")
        return np.unique(np.array(numbers))
    which = root.choice("lines", LINES, "excited")
    low = root.number("f_min", 1.0 / period, above=0.0)
    high = root.number("f_max", 0.45 * samples / period, above=low)
    lines = np.arange(max(1, int(np.ceil(low * period - 1e-9))), int(high * period + 1e-9) + 1)
    lines = lines[lines < samples / 2]
    if which == "odd":
        lines = lines[lines % 2 == 1]
    if which == "excited" and len(lines):
        size = np.abs(np.fft.rfft(tau.mean(axis=2), axis=2)).max(axis=(0, 1, 3))
        lines = lines[size[lines] > EXCITED * size[1:].max()]
    if len(lines) == 0:
        raise root.fail("period_s", "a period that has lines between f_min and f_max")
    return lines


def is_description(path: str | Path) -> bool:
    """Whether a path is that of a TOML file that describes recordings."""
    return Path(path).suffix == ".toml"


def _arrays(file: Path) -> dict[str, Any]:
    """The arrays of a recording."""
    if file.stat().st_size > SIZE_MAX:
        raise ArgumentError(f"{file}: given {file.stat().st_size} bytes, expected at most {SIZE_MAX}")
    if file.suffix == ".npz":
        try:
            return dict(read_npz(file, SIZE_MAX))
        except NpzError as error:
            raise ArgumentError(f"{file}: {error}") from None
    if file.suffix == ".csv":
        return _csv(file)
    if file.suffix == ".mat":
        from scipy.io import loadmat

        try:
            found = loadmat(str(file))
        except Exception as error:  # the reader raises many kinds for a damaged file
            raise ArgumentError(f"{file}: cannot be read as a MAT file of version 5 ({error})") from None
        return {name: x for name, x in found.items() if isinstance(x, np.ndarray) and not name.startswith("_")}
    raise ArgumentError(f"{file}: given the ending {file.suffix!r}, expected .mat, .npz or .csv")


def _csv(file: Path) -> dict[str, Any]:
    """Columns by the names in the first line."""
    try:
        with file.open(encoding="utf-8-sig") as stream:
            names = [name.strip() for name in stream.readline().split(",")]
            values = np.loadtxt(stream, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise ArgumentError(f"{file}: cannot be read: {error}; expected names in line 1, then numbers") from None
    if values.shape[1] != len(names) or len(set(names)) != len(names):
        raise ArgumentError(f"{file}: given {values.shape[1]} columns and the names {names}, expected one name each")
    return dict(zip(names, values.T, strict=True))
