"""Recordings of a real robot: read from files that a TOML file describes, checked, and turned into an experiment.

    model = "bench.toml"                       as `flexgen.read` takes it; or a file next to this one
    period_s = 1.0                             of the excitation
    hold = "zoh"                               of the torques between samples: "zoh" or "none"
    segment_s = 2.0                            instead of period_s, of a motion without period: of its segments
    lines = "excited"                          or "odd", "all": which multiples of 1/period_s between f_min and f_max;
                                               or line_numbers = [5, 7, 11]: these multiples
    f_min = 1.0                                Hz, optional, of the lines; also f_max, default 0.45 of the sample rate
    transients = 1                             periods of each file before those that count; delay_s: of the torques

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
    name = "theta"                             with index = 0: this row or column of an array with two dimensions
    unit = "rad"                               rad, deg, mrad
    side = "motor"
    offset = 0.0                               added to the recorded value, in its unit
    scale = -1.0                               factor of the sum: -1 turns the sign; also of torques and signals

    [[reference]]                              optional, one for each motor, keys as of [[angle]]: what a drive follows,
    motor = "m1"                               for `refine`, and to find the excited lines

    [drive]                                    optional, for `refine`: position and speed control, one number a motor:
                                               k_v (w + k_i h sum w), w = k_p (r - q) + D (r - q),
                                               D x = (x_k - x_(k-1))/h
    position_gain = [8.0]                      1/s
    speed_gain = [0.4]                         N m s/rad, motor side
    integral_gain = [0.0]                      1/s, optional
    low_pass = { frequency_hz = 400.0 }        optional, of the torque of the control; damping = 0.7
    notch = { frequency_hz = 80.0 }            optional; zero_damping = 0.1, pole_damping = 0.7
    encoder_noise_rad = 0.0                    optional, motor side: what moves the motors in addition to the reference
    torque_noise_Nm = 0.0                      also encoder_resolution_rad

    [[signal]]                                 optional, one for each channel of the model's sensors
    sensor = "acc.x"
    name = "acc_x"
    unit = "m/s^2"                             one of its kind, as in the model file

    [[recording]]                              one for each file: .mat (version 5), .npz, or .csv with names in line 1
    file = "run1.mat"
    pose_rad = [0.0]                           joints; or pose_deg; for frequency responses
    offset = { m1 = 0.1 }                      optional, in this file in addition: of angles, references and signals

Recordings with the same pose are experiments of one realization, in their order. Without period_s, segment_s and poses
they are motions, for rigid bodies and for fits in the time domain. Nothing is mended: what cannot be used is refused
with file, channel and time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.numerics.records import lost_samples, read_named
from flexgen.sensors import UNITS
from flexgen.spec.tables import Table, parse_file

KEYS = (
    "model period_s segment_s hold lines line_numbers f_min f_max delay_s transients time torque angle signal "
    "recording reference drive"
).split()
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
ANGLE_UNITS = {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180}
TORQUE_UNITS = {"N m": 1.0, "A": 1.0}
SIDES = ("motor", "arm")
# of a sample time: larger differences are lost samples, smaller ones the rounding of a clock
JITTER = 0.05
# rad: a larger step between two samples, and far larger than all others, is an encoder that wraps
WRAP = 1.0
# of the samples: jumps after repeated ones from which on a recording is refused; a real arm has
# 0.003
REPEATED = 0.005
CLIPPED = 3  # equal samples in a row at the largest torque
SIZE_MAX = 2_000_000_000  # bytes of a file


@dataclass(frozen=True)
class _Channel:
    """An array of the files: motor or sensor channel, name in the files, and what makes motor-side SI units of it."""

    of: str
    name: str
    factor: float
    offset: float = 0.0
    index: int | None = None


@dataclass(frozen=True)
class Description:
    """Content of a description: its tables, the robot, and one entry for each file."""

    source: Path
    root: Table
    model: RobotModel
    sensors: tuple[str, ...]
    recordings: tuple[tuple[Table, Recording], ...]


def read_description(path: str | Path) -> Description:
    """Read a description and its files.

    Raises
    ------
    ModelError
        The TOML file has an error: file, line, key.
    ArgumentError
        A recording cannot be used: file, channel, time.
    """
    source = Path(path)
    if not source.is_file():
        raise ArgumentError(
            f"experiment: given {str(path)!r}, which is not a file, expected a .toml or .npz file"
        )
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
    references = _channels(root, "reference", ANGLE_UNITS, model) if "reference" in root else []
    channels = torques, angles, signals, references
    recordings = []
    for table in root.tables("recording"):
        table.only("file", "pose_rad", "pose_deg", "offset")
        shifted = _shift(table, channels)
        recordings.append((table, Recording(_beside(source, table), clock, shifted, model)))
    steps = [recording.sample_s for _, recording in recordings]
    if (max(steps) / min(steps) - 1) * (min(len(one.t) for _, one in recordings) - 1) > 2 * JITTER:
        raise ArgumentError(
            f"{source}: given recordings with sample times {sorted(set(steps))} s, expected one"
        )
    return Description(
        source, root, model, tuple(signal.of for signal in signals), tuple(recordings)
    )


def _beside(source: Path, table: Table) -> Path:
    """The file of a recording, relative to the description."""
    try:
        file = source.parent / table.text("file")
        if file.is_file():
            return file
    except (OSError, ValueError):  # a name that no file can have
        pass
    raise table.fail("file", "the path of a file, relative to this one")


def _shift(table: Table, channels: tuple[list[_Channel], ...]) -> tuple[list[_Channel], ...]:
    """The channels with the offsets that this file has in addition."""
    offsets = table.table("offset")
    if offsets is None:
        return channels
    names = [channel.of for kind in channels[1:3] for channel in kind]
    offsets.only(*names)
    more = {name: offsets.number(name, 0.0) for name in names}
    return (
        channels[0],
        *(
            [replace(channel, offset=channel.offset + more[channel.of]) for channel in kind]
            for kind in channels[1:]
        ),
    )


def _channels(root: Table, kind: str, units: dict[str, float], model: RobotModel) -> list[_Channel]:
    """The channels of a kind in the order of the motors."""
    motors = [motor.name for motor in model.motors]
    found: dict[str, _Channel] = {}
    for table in root.tables(kind):
        table.only("motor", "name", "unit", "side", "constant", "offset", "scale", "index")
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
        found[motor] = _channel(table, motor, factor)
    for motor in motors:
        if motor not in found:
            raise root.fail(kind, f"a table [[{kind}]] for motor {motor}, too")
    return [found[motor] for motor in motors]


def _signals(root: Table, model: RobotModel) -> list[_Channel]:
    """The sensor channels in the order of the file."""
    of = {name: sensor for sensor in model.sensors for name in sensor.channels}
    found: list[_Channel] = []
    for table in root.tables("signal", required=False):
        table.only("sensor", "name", "unit", "offset", "scale", "index")
        if not of:
            raise table.fail("sensor", "a channel of a [[sensor]] of the model; the model has none")
        name = table.choice("sensor", tuple(of))
        if name in [channel.of for channel in found]:
            raise table.fail("sensor", "one signal for each channel")
        sensor, units = of[name], UNITS[of[name].type]
        own = dict(zip(sensor.channels, sensor.units, strict=True))[name]
        if sensor.type == "link_encoder":
            units = {
                unit: x for unit, x in units.items() if (unit in ANGLE_UNITS) == (own == "rad")
            }
        elif sensor.of_force:
            units = {
                unit: x
                for unit, x in (units | {"N m": 1.0}).items()
                if (unit == "N m") == (own == "N m")
            }
        unit = table.choice("unit", tuple(units))
        found.append(_channel(table, name, units[unit]))
    return found


def _channel(table: Table, of: str, factor: float) -> _Channel:
    index = table.whole("index", 0, 1000) if "index" in table else None
    scale = table.number("scale", 1.0)
    if scale == 0.0:
        raise table.fail("scale", "a factor other than 0")
    return _Channel(of, table.text("name"), factor * scale, table.number("offset", 0.0), index)


class Recording:
    """One file, checked.

    ``t`` (n,) [s]; ``tau_m``, ``q_m`` (n, n_m), motor side [N m], [rad]; ``signals`` (n, channels), SI units;
    ``references`` (n, n_m or 0) [rad], motor side; ``sample_s`` [s].
    """

    def __init__(
        self,
        file: Path,
        clock: _Channel,
        kinds: tuple[list[_Channel], ...],
        model: RobotModel,
    ) -> None:
        self.file, self.arrays = file, read_named(file, SIZE_MAX)
        self.t = self._column(clock)
        self.sample_s = self._sample_time()
        columns = []
        for kind, channels in zip(("torque", "angle", "signal", "reference"), kinds, strict=True):
            found = [self._column(channel) for channel in channels]
            for channel, column in zip(channels, found, strict=True):
                if len(column) != len(self.t):
                    raise ArgumentError(
                        f"{self.file}: {_describe(kind, channel)}: given {len(column)} samples, expected {len(self.t)} "
                        "as of the time"
                    )
            x = np.stack(found, axis=1) if found else np.zeros((len(self.t), 0))
            self._check(kind, channels, x, model)
            columns.append(x)
        self.tau_m, self.q_m, self.signals, self.references = columns

    def _column(self, channel: _Channel) -> np.ndarray:
        """A channel in SI units on the motor side."""
        if channel.name not in self.arrays:
            listed = ", ".join(sorted(self.arrays))
            raise ArgumentError(
                f"{self.file}: given no channel {channel.name!r}, expected one of {listed}"
            )
        x = np.asarray(self.arrays[channel.name])
        if channel.index is not None:
            x = self._row(x, channel)
        if (
            not np.issubdtype(x.dtype, np.number)
            or np.iscomplexobj(x)
            or x.size < 3
            or x.size != max(x.shape)
        ):
            raise ArgumentError(
                f"{self.file}: channel {channel.name!r}: given shape {x.shape}, expected numbers (n,)"
            )
        x = x.ravel().astype(float)
        bad = np.flatnonzero(~np.isfinite(x))
        if len(bad):
            raise ArgumentError(
                f"{self.file}: channel {channel.name!r}: sample {bad[0]} is not a finite number"
            )
        return (x + channel.offset) * channel.factor

    def _row(self, x: np.ndarray, channel: _Channel) -> np.ndarray:
        """A row or a column of an array with two dimensions: the longer one is the time."""
        assert channel.index is not None
        if x.ndim != 2 or channel.index >= min(x.shape):
            raise ArgumentError(
                f"{self.file}: channel {channel.name!r}: given shape {x.shape}, expected two dimensions and more than "
                f"{channel.index} channels"
            )
        return np.asarray(x[channel.index] if x.shape[0] <= x.shape[1] else x[:, channel.index])

    def _sample_time(self) -> float:
        steps = np.diff(self.t)
        step = float(np.median(steps))
        wrong = (
            np.flatnonzero(np.abs(steps - step) > JITTER * abs(step))
            if step > 0
            else np.zeros(1, int)
        )
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
            where = f"{self.file}: {_describe(kind, channel)}"
            column = x[:, j]
            if kind == "reference":
                continue  # that of a motor may stand still
            if np.ptp(column) == 0.0:
                raise ArgumentError(f"{where}: the same value at all times, expected a signal")
            steps = np.abs(np.diff(column))
            if kind == "angle":
                k = int(np.argmax(steps))
                if steps[k] > WRAP and steps[k] > 50 * np.partition(steps, -10)[-10]:
                    raise ArgumentError(
                        f"{where}: jumps by {steps[k]:.3g} rad at t = {self.t[k]:.6g} s: the encoder wraps; unwrap it"
                    )
                if len(lost := lost_samples(column)) > REPEATED * len(column):
                    raise ArgumentError(
                        f"{where}: stands still and jumps {len(lost)} times, first at t = {self.t[lost[0]]:.6g} s: "
                        "samples are lost; record again, or take a part without gaps"
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
                raise ArgumentError(
                    f"{where}: at its limit of {top:.4g} N m at t = {self.t[k]:.6g} s: excite less"
                )


def _describe(kind: str, channel: _Channel) -> str:
    return f"{kind} of {'' if kind == 'signal' else 'motor '}{channel.of} ({channel.name!r})"


def is_description(path: str | Path) -> bool:
    """Whether a path is that of a TOML file that describes recordings."""
    return Path(path).suffix == ".toml"
