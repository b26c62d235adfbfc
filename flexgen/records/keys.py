"""Keys of the TOML file that describes recordings: what is read, and the page of them."""

from __future__ import annotations

from dataclasses import dataclass

REQUIRED = "required"


@dataclass(frozen=True)
class Row:
    """A key: its name, what its value is, its default (empty: optional), and its meaning."""

    key: str
    value: str
    default: str
    meaning: str


@dataclass(frozen=True)
class Rows:
    """A table of the file: its heading, its meaning, its keys."""

    title: str
    meaning: str
    rows: tuple[Row, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the keys."""
        return tuple(row.key for row in self.rows)


FILE = Rows(
    "The file",
    "What was recorded on which robot",
    (
        Row("model", "text", REQUIRED, "a model file next to this file, or as MODEL of a verb"),
        Row("time", "table", REQUIRED, "the column of the time"),
        Row("torque", "list of tables", REQUIRED, "one for each motor"),
        Row("angle", "list of tables", REQUIRED, "one for each motor"),
        Row("recording", "list of tables", REQUIRED, "one for each file, or set of files"),
        Row("columns", "list of texts", "", "names of the columns of CSV files without a header; `-` is left out"),
        Row("hold", "`zoh`, `none`", "", "torque between samples: constant, or not known; required for `frf`"),
        Row("period_s", "number > 0", "", "of a periodic excitation [s], for `frf` and `refine`"),
        Row("segment_s", "number > 0", "", "instead of `period_s`, of a motion without period: of its segments [s]"),
        Row("transients", "whole number", "0", "periods of each file before those that count"),
        Row("lines", "`excited`, `odd`, `all`", "excited", "multiples of 1/period between `f_min` and `f_max` that are used"),
        Row("line_numbers", "list of whole numbers", "", "instead of `lines`: these multiples"),
        Row("f_min", "number > 0", "1/period", "lowest frequency of the lines [Hz]"),
        Row("f_max", "number > 0", "0.45 of the sample rate", "highest frequency of the lines [Hz]"),
        Row("delay_s", "number >= 0", "0", "of the torques [s]"),
        Row("signal", "list of tables", "", "channels of the `[[sensor]]` tables of the model"),
        Row("reference", "list of tables", "", "one for each motor: what a drive follows, for `refine`, and to find the excited lines"),
        Row("drive", "table", "", "position and speed control, for `refine`"),
    ),
)  # fmt: skip
TIME = Rows(
    "`[time]`",
    "The clock, in every file",
    (
        Row("name", "text", REQUIRED, "name of the array or column"),
        Row("unit", "`s`, `ms`, `us`, `ns`, `min`", REQUIRED, "its unit"),
    ),
)
CHANNEL = (
    Row("name", "text", REQUIRED, "name of the array or column"),
    Row("index", "whole number", "", "row or column of an array with two dimensions, from 0"),
    Row("time", "text", "", "another clock, in the unit of `[time]`, of a channel with another rate"),
    Row("offset", "number", "0", "added to the recorded value, in its unit"),
    Row("scale", "number other than 0", "1", "factor of that sum: -1 turns the sign"),
)  # fmt: skip
TORQUE = Rows(
    "`[[torque]]`",
    "The torque of a motor",
    (
        Row("motor", "name", REQUIRED, "of the motor"),
        Row("unit", "`N m`, `N cm`, `N mm`, `mN m`, `kN m`, `A`, `mA`", REQUIRED, "its unit"),
        Row("constant", "number > 0", "", "torque constant [N m/A], required with `A` and `mA`"),
        Row("side", "`motor`, `arm`", REQUIRED, "of the gear"),
        *CHANNEL,
    ),
)
ANGLE = Rows(
    "`[[angle]]`, `[[reference]]`",
    "The angle of a motor, measured or commanded",
    (
        Row("motor", "name", REQUIRED, "of the motor"),
        Row("unit", "`rad`, `mrad`, `urad`, `deg`, `arcmin`, `rev`; with `side = \"arm\"` of a joint that slides `m`, `mm`, `cm`, `um`", REQUIRED, "its unit"),
        Row("side", "`motor`, `arm`", REQUIRED, "of the gear"),
        *CHANNEL,
    ),
)  # fmt: skip
SIGNAL = Rows(
    "`[[signal]]`",
    "A channel of a sensor of the model",
    (
        Row("sensor", "name", REQUIRED, "of the channel, such as `acc.x`"),
        Row("unit", "text", REQUIRED, "one of the kind of the sensor, as in the model file"),
        *CHANNEL,
    ),
)
RECORDING = Rows(
    "`[[recording]]`",
    "One file, or files that one clock stamps",
    (
        Row("file", "text", "", "`.csv`, `.npz` or `.mat` (version 5), relative to this file"),
        Row("files", "list of texts", "", "instead of `file`: files with different channels and rates"),
        Row("pose_rad", "list of numbers", "", "joints, for frequency responses; or `pose_deg`"),
        Row("pose_deg", "list of numbers", "", "the same in degrees; joints that slide in m"),
        Row("offset", "table", "", "motor or channel = number: in these files in addition to `offset` of the channel"),
    ),
)  # fmt: skip
DRIVE = Rows(
    "`[drive]`",
    "Position and speed control at the sample time h: u = k_v (w + k_i h sum w), w = k_p (r - q) + D (r - q), "
    "D x = (x_k - x_(k-1))/h; lists have a number for each motor",
    (
        Row("position_gain", "list of numbers >= 0", REQUIRED, "k_p [1/s]"),
        Row("speed_gain", "list of numbers > 0", REQUIRED, "k_v [N m s/rad, motor side]"),
        Row("integral_gain", "list of numbers >= 0", "0", "k_i [1/s]"),
        Row("low_pass", "table", "", "of the torque: `frequency_hz`, `damping` (0.7)"),
        Row("notch", "table", "", "of the torque: `frequency_hz`, `zero_damping` (0.1), `pole_damping` (0.7)"),
        Row("encoder_resolution_rad", "number >= 0", "0", "[rad, motor side]"),
        Row("encoder_noise_rad", "number >= 0", "0", "moves the motors in addition to the reference [rad, motor side]"),
        Row("torque_noise_Nm", "number >= 0", "0", "[N m, motor side]"),
    ),
)  # fmt: skip
TABLES = (FILE, TIME, TORQUE, ANGLE, SIGNAL, RECORDING, DRIVE)
