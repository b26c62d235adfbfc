"""Keys of the TOML file that describes recordings: what is read, and the page of them.

A row is ``key | value | default | meaning``, with the rest of long rows indented below; no
default: optional.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """A key: its name, what its value is, its default, and its meaning."""

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


def _rows(title: str, meaning: str, text: str) -> Rows:
    """The table of a text with a row for each key."""
    lines = text.strip().replace("\n    ", " ").splitlines()
    cells = ([cell.strip() for cell in line.split("|")] for line in lines if line)
    return Rows(title, meaning, tuple(Row(*four) for four in cells))


CHANNEL = """
name | text or list of texts | required | name of the array or column; of several: their sum
index | whole number |  | row or column of an array with two dimensions, from 0
time | text |  | another clock, in the unit of `[time]`, of a channel with another rate
offset | number | 0 | added to the recorded value, in its unit
scale | number other than 0 | 1 | factor of that sum: -1 turns the sign
"""
FILE = _rows(
    "The file",
    "What was recorded on which robot",
    """
model | text | required | a model file next to this file, or as MODEL of a verb
time | table | required | the column of the time
torque | list of tables | required | one for each motor
angle | list of tables | required | one for each motor
recording | list of tables | required | one for each file, or set of files
columns | list of texts |  | names of the columns of CSV files without a header; `-` is left out
hold | `zoh`, `none` |  | torque between samples: constant, or not known; required for `frf`
period_s | number > 0 |  | of a periodic excitation [s], for `frf` and `refine`
segment_s | number > 0 |  | instead of `period_s`, of a motion without period: of its segments
    [s]
transients | whole number | 0 | periods of each file before those that count
lines | `excited`, `odd`, `all` | excited | multiples of 1/period between `f_min` and `f_max`
    that are used
line_numbers | list of whole numbers |  | instead of `lines`: these multiples
f_min | number > 0 | 1/period | lowest frequency of the lines [Hz]
f_max | number > 0 | 0.45 of the sample rate | highest frequency of the lines [Hz]
delay_s | number >= 0 | 0 | of the torques [s]
signal | list of tables |  | channels of the `[[sensor]]` tables of the model
reference | list of tables |  | one for each motor: what a drive follows, for `refine`, and to
    find the excited lines
drive | table |  | position and speed control, for `refine`
""",
)
TIME = _rows(
    "`[time]`",
    "The clock, in every file",
    """
name | text | required | name of the array or column
unit | `s`, `ms`, `us`, `ns`, `min` | required | its unit
""",
)
TORQUE = _rows(
    "`[[torque]]`",
    "The torque of a motor",
    """
motor | name | required | of the motor
unit | `N m`, `N cm`, `N mm`, `mN m`, `kN m`, `A`, `mA`, `V`, `mV`; with `side = "arm"` of a
    joint that slides `N`, `kN`, `mN` | required | its unit
constant | number > 0 |  | torque constant [N m/A], required with `A` and `mA`; with `V` and `mV`
    k_t/R [N m/V]
side | `motor`, `arm` | required | of the gear
"""
    + CHANNEL,
)
ANGLE = _rows(
    "`[[angle]]`, `[[reference]]`",
    "The angle of a motor, measured or commanded",
    """
motor | name | required | of the motor
unit | `rad`, `mrad`, `urad`, `deg`, `arcmin`, `rev`; with `side = "arm"` of a joint that slides
    `m`, `mm`, `cm`, `um` | required | its unit
side | `motor`, `arm` | required | of the gear
"""
    + CHANNEL,
)
SIGNAL = _rows(
    "`[[signal]]`",
    "A channel of a sensor of the model",
    """
sensor | name | required | of the channel, such as `acc.x`
unit | text | required | one of the kind of the sensor, as in the model file
"""
    + CHANNEL,
)
RECORDING = _rows(
    "`[[recording]]`",
    "One file, or files that one clock stamps",
    """
file | text |  | `.csv`, `.npz`, `.mat` (version 5) or `.hebilog`, relative to this file
files | list of texts |  | instead of `file`: files with different channels and rates
pose_rad | list of numbers |  | joints, for frequency responses; or `pose_deg`
pose_deg | list of numbers |  | the same in degrees; joints that slide in m
offset | table |  | motor or channel = number: in these files in addition to `offset` of the
    channel
""",
)
DRIVE = _rows(
    "`[drive]`",
    "Position and speed control at the sample time h: u = k_v (w + k_i h sum w), w = "
    "k_p (r - q) + D (r - q), D x = (x_k - x_(k-1))/h; lists have a number for each "
    "motor",
    """
position_gain | list of numbers >= 0 | required | k_p [1/s]
speed_gain | list of numbers > 0 | required | k_v [N m s/rad, motor side]
integral_gain | list of numbers >= 0 | 0 | k_i [1/s]
low_pass | table |  | of the torque: `frequency_hz`, `damping` (0.7)
notch | table |  | of the torque: `frequency_hz`, `zero_damping` (0.1), `pole_damping` (0.7)
encoder_resolution_rad | number >= 0 | 0 | [rad, motor side]
encoder_noise_rad | number >= 0 | 0 | moves the motors in addition to the reference [rad, motor
    side]
torque_noise_Nm | number >= 0 | 0 | [N m, motor side]
""",
)
TABLES = (FILE, TIME, TORQUE, ANGLE, SIGNAL, RECORDING, DRIVE)
