"""Recordings of a real robot: files that a TOML file describes, as an experiment.

    model = "bench.toml"                 as `flexgen.read` takes it; or a file next to this one
    period_s = 1.0                       of the excitation
    hold = "zoh"                         of the torques between samples: "zoh" or "none"
    segment_s = 2.0                      instead of period_s, of a motion without period: of its
                                         segments
    lines = "excited"                    or "odd", "all": which multiples of 1/period_s between
                                         f_min and f_max; or line_numbers = [5, 7, 11]: these
                                         multiples
    f_min = 1.0                          Hz, optional, of the lines; also f_max, default 0.45 of
                                         the sample rate
    transients = 1                       periods of each file before those that count; delay_s: of
                                         the torques

    [time]
    name = "time"                        array of the file
    unit = "us"                          s, ms, us, ns, min

    [[torque]]                           one for each motor
    motor = "m1"
    name = "iq"                          or a list of names, whose arrays are added
    unit = "A"                           N m, N cm, kN m, ...; A, mA with constant [N m/A];
                                         V, mV with constant [N m/V]
    constant = 0.1
    side = "motor"                       of the gear: motor or arm

    [[angle]]
    motor = "m1"
    name = "theta"                       with index = 0: this row or column of an array with two
                                         dimensions
    unit = "rad"                         rad, deg, mrad, rev, ...; arm side also m, mm
    side = "motor"
    offset = 0.0                         added to the recorded value, in its unit
    scale = -1.0                         factor of the sum: -1 turns the sign; also of torques and
                                         signals

    [[reference]]                        optional, one for each motor, keys as of [[angle]]: what a
    motor = "m1"                         drive follows, for `refine`, and to find the excited lines

    [drive]                              optional, for `refine`: position and speed control, one
                                         number a motor:
                                         k_v (w + k_i h sum w), w = k_p (r - q) + D (r - q),
                                         D x = (x_k - x_(k-1))/h
    position_gain = [8.0]                1/s
    speed_gain = [0.4]                   N m s/rad, motor side
    integral_gain = [0.0]                1/s, optional
    low_pass = { frequency_hz = 400.0 }  optional, of the torque of the control; damping = 0.7
    notch = { frequency_hz = 80.0 }      optional; zero_damping = 0.1, pole_damping = 0.7
    encoder_noise_rad = 0.0              optional, motor side: what moves the motors in addition to
                                         the reference
    torque_noise_Nm = 0.0                also encoder_resolution_rad

    [[signal]]                           optional, one for each channel of the model's sensors
    sensor = "acc.x"
    name = "acc_x"
    unit = "m/s^2"                       one of its kind, as in the model file

    [[recording]]                        one for each file: .mat (version 5), .npz, or .csv with
                                         names in line 1
    file = "run1.mat"
    pose_rad = [0.0]                     joints; or pose_deg; for frequency responses
    offset = { m1 = 0.1 }                optional, in this file in addition: of angles, references
                                         and signals

Recordings with the same pose are experiments of one realization, in their order. Without period_s,
segment_s and poses they are motions, for rigid bodies and for fits in the time domain. Instead of
file, files = ["fast.csv", "slow.csv"] have different channels; columns = ["t", "q1", ...] are the
names of CSV files without a header; time = "t2" in a channel is another clock of the same unit.
All keys: `flexgen.identification.records.keys`.

Jitter, unequal steps, empty cells and several rates become equal steps, see
`flexgen.base.numerics.sampling`; motions are split at gaps. Of a periodic recording with gaps the
longest part of whole periods, or segments, without a gap is read; periods are counted from the
beginning of the file.
What cannot be used is refused with file, channel and time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.files.record_columns import column_of
from flexgen.base.files.record_tables import SKIPPED, read_arrays
from flexgen.base.numerics.records import lost_samples, skipped_samples
from flexgen.base.numerics.sampling import GAP, Gap, Piece, Sampled, drop_repeats, resample
from flexgen.base.spec.sensors import UNITS
from flexgen.base.spec.tables import Table, closest, parse_file
from flexgen.base.spec.units import ELECTRIC, FACTORS, factor_of, spelling
from flexgen.identification.records import keys
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

TIME_UNITS = FACTORS["s"]
ANGLE_UNITS = FACTORS["rad"]
SIDES = ("motor", "arm")
KINDS = ("torque", "angle", "signal", "reference")
# of a sample time: larger differences of those of several recordings are other rates
JITTER = 0.05
# rad: a larger step between two samples, and far larger than all others, is an encoder that wraps
WRAP = 1.0
JUMP = 50.0  # of the tenth largest step of an angle: a jump
# of the samples: jumps after repeated ones from which on a recording is refused; a real arm has
# 0.003
REPEATED = 0.005
# equal samples in a row at the largest torque; more where samples are often equal, so that chance
# has a row of them in a hundred records
CLIPPED = 3
ARM_SIDE = 3.0  # torque over the limit of its motor, from which on it is not that of the motor
CHANCE = 1e-2
MOVED = 1e-3  # of the range of an angle: a motor that moves by less in such a row rests
SIZE_MAX = 2_000_000_000  # bytes of a file


@dataclass(frozen=True)
class _Channel:
    """An array of the files: motor or sensor channel, name in the files, and the names of arrays
    that are added to it.

    With the factors that make motor-side SI units of it.
    """

    of: str
    name: str
    factor: float
    offset: float = 0.0
    index: int | None = None
    time: str | None = None
    added: tuple[str, ...] = ()

    @property
    def shown(self) -> str:
        """The names for a message."""
        return " + ".join(map(repr, (self.name, *self.added)))


@dataclass(frozen=True)
class Description:
    """Content of a description: its tables, the robot, and one entry for each file, of motions for
    each piece of it.

    ``notes``: what was done to the files, as sentences.
    """

    source: Path
    root: Table
    model: RobotModel
    sensors: tuple[str, ...]
    recordings: tuple[tuple[Table, Recording], ...]
    notes: tuple[str, ...] = ()


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
    root.only(*keys.FILE.names)
    try:
        beside = source.parent / root.text("model")
        model = read(beside if beside.is_file() else root.text("model"))
    except (ArgumentError, OSError, ValueError) as error:
        raise root.fail("model", f"a model that can be read ({error})") from None
    time = root.table("time")
    if time is None:
        raise root.fail("time", "a table with name and unit")
    time.only(*keys.TIME.names)
    clock = _Channel("", time.text("name"), _unit(time, "s"))
    torques = _channels(root, "torque", model)
    angles = _channels(root, "angle", model)
    signals = _signals(root, model)
    references = _channels(root, "reference", model) if "reference" in root else []
    channels = torques, angles, signals, references
    columns = _columns(root) if "columns" in root else None
    found = []
    for table in root.tables("recording"):
        table.only(*keys.RECORDING.names)
        first, *more = _files(source, table)
        kinds = _shift(table, channels)
        one = Recording(first, clock, kinds, model, more=more, columns=columns, alone=False)
        found.append((table, one))
    for rests in zip(*(one.rests for _, one in found), strict=True):
        if all(rests):
            raise ArgumentError(rests[0])
    recordings, notes = _at_one_rate(source, root, found)
    return Description(
        source,
        root,
        model,
        tuple(signal.of for signal in signals),
        tuple(recordings),
        tuple(notes),
    )


def _at_one_rate(
    source: Path, root: Table, found: list[tuple[Table, Recording]]
) -> tuple[list[tuple[Table, Recording]], list[str]]:
    """The recordings at equal steps, motions split at gaps; and what was done to them."""
    steps = [one.sample_s for _, one in found]
    spread = (max(steps) / min(steps) - 1) * (min(len(one.t) for _, one in found) - 1)
    resampled = any(one.resampled for _, one in found)
    if spread > 2 * JITTER and not resampled:
        raise ArgumentError(
            f"{source}: given recordings with sample times {sorted(set(steps))} s, expected one"
        )
    key = next((key for key in ("period_s", "segment_s") if key in root), None)
    period = None if key is None else root.number(key, above=0.0)
    transients = root.whole("transients", 0, 1000) if "transients" in root else 0
    out = []
    notes = []
    for table, one in found:
        if key is not None and period is not None and one.gaps:
            is_periodic = key == "period_s"
            parts = [one.whole_periods(max(steps), period, transients, is_periodic)]
        else:
            parts = one.pieces(max(steps), period) if resampled else [one]
        out += [(table, part) for part in parts]
        notes += [f"{one.file}: {note}" for note in parts[0].notes]
    return out, notes


def _columns(root: Table) -> list[str]:
    """Names of the columns of files without a header; those that are left out may repeat."""
    given = root.plain("columns", "a list of names")
    words = given if isinstance(given, list) else []
    kept = [word for word in words if word != SKIPPED]
    if not kept or not all(isinstance(word, str) for word in words) or len(set(kept)) < len(kept):
        raise root.fail("columns", f"a list of different names; {SKIPPED!r} leaves a column out")
    return words


def _files(source: Path, table: Table) -> list[Path]:
    """The files of a recording, relative to the description."""
    if ("file" in table) == ("files" in table):
        if "file" in table:
            raise table.fail("files", "either file or files")
        raise table.fail("file", "the path of a file, relative to this one")
    key = "file" if "file" in table else "files"
    names = [table.text("file")] if key == "file" else table.words("files")
    out = []
    for name in names:
        try:
            file = source.parent / name
            if not file.is_file():
                raise OSError
        except (OSError, ValueError):  # a name that no file can have
            raise table.fail(key, "the path of a file, relative to this one") from None
        out.append(file)
    return out


def _unit(table: Table, si: str) -> float:
    """Factor of the key ``unit``; of a current 1 A, of a voltage 1 V."""
    given = table.text("unit")
    known = {**FACTORS[si], **(ELECTRIC if si == "N m" else {})}
    factor = next((x for name, x in known.items() if spelling(name) == spelling(given)), None)
    if factor is None:
        raise table.fail("unit", closest(given, known))
    for named in map(column_of, table.words("name")):
        short = len(spelling(named.unit)) < 2 and "_" in named.text
        other = None if short or not named.unit else factor_of(named.unit, si)
        electric = not short and spelling(named.unit) in ELECTRIC and si == "N m"
        if electric != (spelling(given) in ELECTRIC) and (electric or other is not None):
            raise table.fail("unit", f"{named.unit}, as the name {named.text!r} states")
        if other is not None and not np.isclose(other, factor, rtol=1e-9):
            raise table.fail("unit", f"{named.unit}, as the name {named.text!r} states")
    return factor


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


def _channels(root: Table, kind: str, model: RobotModel) -> list[_Channel]:
    """The channels of a kind in the order of the motors."""
    motors = [motor.name for motor in model.motors]
    found: dict[str, _Channel] = {}
    rows = keys.TORQUE if kind == "torque" else keys.ANGLE
    for table in root.tables(kind):
        table.only(*rows.names)
        motor = table.choice("motor", motors)
        if motor in found:
            raise table.fail("motor", f"one {kind} for each motor")
        side = table.choice("side", SIDES)
        j = motors.index(motor)
        if side == "arm" and len(model.motors[j].drives) != 1:
            raise table.fail("side", "motor: this motor drives several joints")
        factor = _unit(table, _si_unit(kind, side, model, j))
        if kind == "torque" and spelling(table.text("unit")) in ELECTRIC:
            factor *= table.number("constant", above=0.0)
        elif "constant" in table:
            raise table.fail("constant", "no constant where the unit is not A or V")
        if side == "arm":
            ratio = model.motors[j].ratio[0]
            factor = factor / ratio if kind == "torque" else factor * ratio
        found[motor] = _channel(table, motor, factor)
    for motor in motors:
        if motor not in found:
            raise root.fail(kind, f"a table [[{kind}]] for motor {motor}, too")
    return [found[motor] for motor in motors]


def _si_unit(kind: str, side: str, model: RobotModel, motor: int) -> str:
    """SI unit of a torque or angle of a motor, or of its joint."""
    joint = model.coordinates[model.i_g[int(np.argmax(np.abs(model.eta[motor])))]]
    slides = side == "arm" and joint.unit == "m"
    if kind == "torque":
        return "N" if slides else "N m"
    return "m" if slides else "rad"


def _signals(root: Table, model: RobotModel) -> list[_Channel]:
    """The sensor channels in the order of the file."""
    of = {name: sensor for sensor in model.sensors for name in sensor.channels}
    found: list[_Channel] = []
    for table in root.tables("signal", required=False):
        table.only(*keys.SIGNAL.names)
        if not of:
            raise table.fail(
                "sensor", "a channel of a [[sensor]] of the model; the model has none"
            )
        name = table.choice("sensor", tuple(of))
        if name in [channel.of for channel in found]:
            raise table.fail("sensor", "one signal for each channel")
        sensor = of[name]
        units = UNITS[of[name].type]
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
    time = table.text("time") if "time" in table else None
    offset = table.number("offset", 0.0)
    name, *added = table.words("name")
    return _Channel(of, name, factor * scale, offset, index, time, tuple(added))


class Recording:
    """One file, or files of one clock, checked; at equal steps the first piece before a gap.

    ``t`` (n,) [s]; ``tau_m``, ``q_m`` (n, n_m), motor side [N m], [rad]; ``signals`` (n,
    channels), SI units; ``references`` (n, n_m or 0) [rad], motor side; ``sample_s`` [s];
    ``gaps``; ``periods_before``: whole periods of the file before the part that is read, None
    without gaps; ``resampled``: whether values are interpolated; ``rests``: of each torque, angle
    and signal, why it is none, or empty; ``notes``.
    """

    def __init__(
        self,
        file: Path,
        clock: _Channel,
        kinds: tuple[list[_Channel], ...],
        model: RobotModel,
        *,
        more: Sequence[Path] = (),
        columns: Sequence[str] | None = None,
        alone: bool = True,
    ) -> None:
        self.file = file
        named = () if columns is None else (columns,)
        self._tables = {path: read_arrays(path, SIZE_MAX, *named) for path in (file, *more)}
        self._clock = clock
        self._sizes = [len(channels) for channels in kinds]
        self.rests: list[str] = []
        self._times = []
        self._values = []
        self._smooth = []
        for kind, channels in zip(KINDS, kinds, strict=True):
            for channel in channels:
                t, x = self._samples(kind, channel)
                if kind in ("angle", "reference"):
                    t, x = drop_repeats(t, x)
                self._times.append(t)
                self._values.append(x)
                self._smooth.append(kind in ("angle", "reference"))
                if kind != "reference":
                    where = f"{self.file}: {_describe(kind, channel)}"
                    words = f"{where}: the same value at all times, expected a signal"
                    self.rests.append(words if np.ptp(x) == 0.0 else "")
        first = next(filter(None, self.rests), "")
        if alone and first:
            raise ArgumentError(first)
        self._check(kinds, model)
        self.arrays = self._tables[file]
        self.periods_before: int | None = None
        self.notes: tuple[str, ...] = ()
        self._fill(self._resample(None, None))

    def _resample(self, step: float | None, period: float | None) -> Sampled:
        return resample(
            str(self.file), self._times, self._values, self._smooth, step=step, period=period
        )

    def _fill(self, found: Sampled, piece: Piece | None = None) -> None:
        """Take the channels of a piece, of the first one by default."""
        piece = piece or found.pieces[0]
        ends = np.cumsum(self._sizes)[:-1]
        self.t = piece.time
        self.sample_s = found.step
        self.tau_m, self.q_m, self.signals, self.references = np.split(piece.values, ends, axis=1)
        self.gaps = found.gaps
        self.resampled = found.resampled
        self.notes = found.notes

    def pieces(self, step: float, period: float | None = None) -> list[Recording]:
        """The pieces between gaps, at equal steps [s] that are a whole part of the period [s]."""
        found = self._resample(step, period)
        out = []
        for piece in found.pieces:
            one = copy(self)
            one._fill(found, piece)
            out.append(one)
        return out

    def whole_periods(
        self, step: float, period: float, transients: int, is_periodic: bool
    ) -> Recording:
        """The longest part of whole periods [s] without a gap, after the transient ones.

        Periods are counted from the beginning of the file; segments of a motion that is not
        periodic may begin anywhere.

        Raises
        ------
        ArgumentError
            Fewer than two periods are left: the rows of the gaps.
        """
        found = self._resample(step, period)
        begin = found.pieces[0].time[0]
        samples = round(period / found.step)
        best: tuple[int, int, int, Piece] | None = None
        for piece in found.pieces:
            before = math.ceil((piece.time[0] - begin) / period - 1e-6) if is_periodic else 0
            before = max(before, transients)
            start = 0
            if is_periodic:
                start = round((begin + before * period - piece.time[0]) / found.step)
            count = max(len(piece.time) - start, 0) // samples
            if best is None or count > best[0]:
                best = count, before, start, piece
        assert best is not None
        count, before, start, piece = best
        what = "periods" if is_periodic else "segments"
        gaps = "; ".join(f"gap of {gap}, {self._rows_of(gap)}" for gap in found.gaps)
        if count < 2:
            after = f" after {transients} transient ones" if transients else ""
            raise ArgumentError(
                f"{self.file}: given {gaps}, expected at least two whole {what} of {period:g} s "
                f"without a gap{after}; record again, or take shorter {what}"
            )
        part = slice(start, start + count * samples)
        one = copy(self)
        one._fill(found, Piece(piece.time[part], piece.values[part]))
        one.periods_before = before
        first, last = piece.time[part][[0, -1]]
        kept = [note for note in found.notes if not note.startswith("gap of ")]
        used = f"{count} whole {what} from {first:.6g} to {last:.6g} s are used: {gaps}"
        one.notes = (*kept, used)
        return one

    def _rows_of(self, gap: Gap) -> str:
        """The rows of the file before and after a gap, counted from 1 below a header."""
        t = self._numbers(self._tables[self.file], self._clock)
        t = np.ma.filled(np.ma.asarray(t, dtype=float), np.nan)
        rows = [int(np.nanargmin(np.abs(t - instant))) + 1 for instant in (gap.begin, gap.end)]
        return f"rows {rows[0]} and {rows[1]}"

    def _samples(self, kind: str, channel: _Channel) -> tuple[np.ndarray, np.ndarray]:
        """Instants [s] and values of a channel where it was sampled: SI units, motor side."""
        tables = [arrays for arrays in self._tables.values() if channel.name in arrays]
        if not tables:
            listed = ", ".join(sorted({name for x in self._tables.values() for name in x}))
            raise ArgumentError(
                f"{self.file}: given no channel {channel.name!r}, expected one of {listed}"
            )
        if len(tables) > 1:
            raise ArgumentError(
                f"{self.file}: given the channel {channel.name!r} in several files, expected it "
                "in one"
            )
        x = self._numbers(tables[0], channel)
        t = self._numbers(tables[0], replace(self._clock, name=channel.time or self._clock.name))
        if len(x) != len(t):
            raise ArgumentError(
                f"{self.file}: {_describe(kind, channel)}: given {len(x)} samples, expected "
                f"{len(t)} as of the time"
            )
        empty = np.ma.getmaskarray(x) | np.ma.getmaskarray(t)
        if (~empty).sum() < CLIPPED:
            raise ArgumentError(
                f"{self.file}: {_describe(kind, channel)}: given {(~empty).sum()} samples, "
                f"expected {CLIPPED} or more"
            )
        return np.asarray(t[~empty]), np.asarray(x[~empty])

    def _numbers(self, arrays: dict[str, np.ndarray], channel: _Channel) -> np.ndarray:
        """An array (n,) of a file in SI units, masked where cells are empty."""
        if channel.name not in arrays:
            raise ArgumentError(
                f"{self.file}: given no channel {channel.name!r}, expected one of "
                f"{', '.join(sorted(arrays))}"
            )
        x: Any = np.ma.asanyarray(arrays[channel.name])
        for name in channel.added:
            x = x + self._addend(arrays, channel, name)
        if channel.index is not None:
            x = self._row(x, channel)
        if (
            not np.issubdtype(x.dtype, np.number)
            or np.iscomplexobj(x)
            or x.size < 3
            or x.size != max(x.shape)
        ):
            raise ArgumentError(
                f"{self.file}: channel {channel.name!r}: given shape {x.shape}, expected numbers "
                "(n,)"
            )
        x = x.ravel().astype(float)
        bad = np.flatnonzero(~np.isfinite(x.filled(0.0)))
        if len(bad):
            raise ArgumentError(
                f"{self.file}: channel {channel.name!r}: sample {bad[0]} is not a finite number"
            )
        return (x + channel.offset) * channel.factor

    def _addend(self, arrays: dict[str, np.ndarray], channel: _Channel, name: str) -> Any:
        """An array that is added to the first one of a channel: of the same file and shape."""
        first = np.ma.asanyarray(arrays[channel.name])
        found = np.ma.asanyarray(arrays[name]) if name in arrays else None
        if (
            found is None
            or found.shape != first.shape
            or not np.issubdtype(found.dtype, np.number)
        ):
            given = "no such array" if found is None else f"shape {found.shape}"
            raise ArgumentError(
                f"{self.file}: channel {name!r}: given {given}, expected numbers of shape "
                f"{first.shape}, as {channel.name!r} has, to which they are added"
            )
        return found

    def _row(self, x: np.ndarray, channel: _Channel) -> np.ndarray:
        """A row or a column of an array with two dimensions: the longer one is the time."""
        assert channel.index is not None
        if x.ndim != 2 or channel.index >= min(x.shape):
            raise ArgumentError(
                f"{self.file}: channel {channel.name!r}: given shape {x.shape}, expected two "
                f"dimensions and more than {channel.index} channels"
            )
        return x[channel.index] if x.shape[0] <= x.shape[1] else x[:, channel.index]

    def _check(self, kinds: tuple[list[_Channel], ...], model: RobotModel) -> None:
        """ArgumentError for angles that wrap or have lost samples, and for torques at a limit."""
        torques, angles = kinds[:2]
        n = len(torques)
        check_common_jump(str(self.file), self._times[n : 2 * n], self._values[n : 2 * n])
        for j, channel in enumerate(angles):
            t = self._times[n + j]
            x = self._values[n + j]
            _check_angle(f"{self.file}: {_describe('angle', channel)}", t, x)
        check_skipped(str(self.file), self._times[n : 2 * n], self._values[n : 2 * n])
        for j, channel in enumerate(torques):
            t = self._times[j]
            tau = self._values[j]
            angle = np.interp(t, self._times[n + j], self._values[n + j])
            where = f"{self.file}: {_describe('torque', channel)}"
            _check_torque(where, t, tau, angle, model.motors[j].torque_max)


def _find_jump(t: np.ndarray, x: np.ndarray) -> tuple[int, float] | None:
    """Row before a jump of an angle, and its size [rad]; None: there is none."""
    if np.ptp(x) == 0.0:
        return None
    between = np.diff(t)
    steps = np.abs(np.diff(x)) * (between < GAP * np.median(between))
    k = int(np.argmax(steps))
    return (k, float(steps[k])) if steps[k] > JUMP * np.partition(steps, -10)[-10] else None


def check_common_jump(
    where: str, times: Sequence[np.ndarray], angles: Sequence[np.ndarray]
) -> None:
    """ArgumentError where several angles jump in the same row: no two encoders wrap at once."""
    jumps = [_find_jump(t, x) for t, x in zip(times, angles, strict=True)]
    rows = [jump[0] for jump in jumps if jump is not None]
    for k in rows:
        if rows.count(k) > 1:
            raise ArgumentError(
                f"{where}: {rows.count(k)} angles jump at t = {times[0][k]:.6g} s: samples are "
                "lost there, and the times have no gap; record again, or take a part before or "
                "after it"
            )


def _check_angle(where: str, t: np.ndarray, x: np.ndarray) -> None:
    """ArgumentError for an angle that wraps or has lost samples."""
    if np.ptp(x) == 0.0:
        return
    jump = _find_jump(t, x)
    if jump is not None and jump[1] > WRAP:
        k, size = jump
        raise ArgumentError(
            f"{where}: jumps by {size:.3g} rad at t = {t[k]:.6g} s: the encoder wraps; unwrap it"
        )
    if len(lost := lost_samples(x)) > REPEATED * len(x):
        raise ArgumentError(
            f"{where}: stands still and jumps {len(lost)} times, first at t = {t[lost[0]]:.6g} s: "
            "samples are lost; record again, or take a part without gaps"
        )


def check_skipped(where: str, times: Sequence[np.ndarray], angles: Sequence[np.ndarray]) -> None:
    """ArgumentError where the angles (n,) of all axes advance by several steps at once, though
    their times [s], which are the same, have no gap.
    """
    first = times[0]
    if any(len(t) != len(first) or not np.array_equal(t, first) for t in times):
        return
    found = skipped_samples(first, np.column_stack(angles))
    if found:
        k, count = found[0]
        many = f"{count} samples" if count > 1 else "a sample"
        raise ArgumentError(
            f"{where}: at t = {first[k]:.6g} s the angles advance by {count + 1} steps at once, "
            f"as if {many} were lost, and the times have no gap there, so that what follows is "
            "late against other signals; record again, or take a part before or after it"
        )


def _check_torque(
    where: str, t: np.ndarray, tau: np.ndarray, angle: np.ndarray, limit: float | None
) -> None:
    """ArgumentError for a torque at a limit: equal samples in a row at the largest one while the
    motor moves.

    More samples where samples are often equal: of coarse sensors, and of torques that are recorded
    several times.
    """
    size = np.abs(tau)
    top = size.max()
    at_top = size >= (1 - 1e-9) * top
    if top == 0.0:
        return
    equal = (np.diff(tau) == 0.0)[~(at_top[1:] & at_top[:-1])]
    share = float(equal.mean()) if len(equal) else 0.0
    chance = np.log(CHANCE / len(tau)) / np.log(share) if 0.0 < share < 1.0 else 0.0
    length = int(min(max(CLIPPED, np.ceil(1 + chance)), len(tau)))
    rows = np.lib.stride_tricks.sliding_window_view(at_top, length).all(axis=1)
    moved = np.abs(angle[length - 1 :] - angle[: len(angle) - length + 1])
    clipped = rows & (moved > MOVED * np.ptp(angle))
    if limit is not None and top > ARM_SIDE * limit:
        raise ArgumentError(
            f"{where}: given up to {top:.4g} N m, expected the torque of a motor whose limit in "
            f"the model file is {limit:.4g} N m: probably it is on the arm side of the gear, or "
            "in another unit"
        )
    if clipped.any() or (limit is not None and top >= 0.999 * limit):
        k = int(np.argmax(at_top))
        raise ArgumentError(
            f"{where}: at its limit of {top:.4g} N m at t = {t[k]:.6g} s: excite less"
        )


def _describe(kind: str, channel: _Channel) -> str:
    return f"{kind} of {'' if kind == 'signal' else 'motor '}{channel.of} ({channel.shown})"


def is_description(path: str | Path) -> bool:
    """Whether a path is that of a TOML file that describes recordings."""
    return Path(path).suffix == ".toml"
