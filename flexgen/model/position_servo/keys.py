"""The keys of a position servo in files, and what the table ``[servo]`` of a model file holds."""

from __future__ import annotations

from dataclasses import dataclass, replace

from flexgen.base.spec.keys import Context, Format, Key, Kinds, Type, listed, number, vector
from flexgen.base.spec.tables import Table
from flexgen.model.position_servo.filters import Filter, LowPass, Notch

SAMPLE_S = 5e-4
SLOWEST = 1.0  # s: sample time, delay and time constant of the reference filter, at most
MOST_FEEDFORWARD = 2.0
MOST_HZ = 1e5
GAINS = ("position_gain", "speed_gain", "integral_gain")
FREQUENCIES = ("position_hz", "speed_hz", "integral_hz")


@dataclass(frozen=True)
class ServoTable:
    """The servo of a model file, see `flexgen.Servo`: ``"ppi"``, by frequencies, or ``"cascade"``,
    gains of each motor.

    ``position_hz``, ``speed_hz``, ``integral_hz`` [Hz] of a servo by frequencies, None: proposed;
    ``position_gain`` [1/s], ``speed_gain`` [N m s/rad], ``integral_gain`` [1/s] (n_m,) of the
    other; ``low_pass``, ``notch``: filters of the torque.
    """

    type: str
    position_hz: float | None = None
    speed_hz: float | None = None
    integral_hz: float | None = None
    position_gain: tuple[float, ...] = ()
    speed_gain: tuple[float, ...] = ()
    integral_gain: tuple[float, ...] = ()
    low_pass: tuple[LowPass, ...] = ()
    notch: tuple[Notch, ...] = ()
    speed_feedforward: float = 1.0
    reference_filter_s: float = 0.0
    sample_time: float = SAMPLE_S
    delay: float = 0.0

    @property
    def filters(self) -> tuple[Filter, ...]:
        """All filters of the torque."""
        return (*self.low_pass, *self.notch)


def _filter(doc: str, made: type[Filter], **damping: tuple[str, float]) -> Format:
    """The table of a filter: its frequency and its damping ratios, each with what it is of and a
    default.
    """
    rows = [
        Key(name, number(), f"damping ratio{of}", default=value)
        for name, (of, value) in damping.items()
    ]
    return Format(doc, (Key("frequency_hz", number(above=0.0), "frequency", "Hz"), *rows), made)


LOW_PASS = _filter("low-pass filter", LowPass, damping=("", 0.7))
NOTCH = _filter(
    "notch filter", Notch, zero_damping=(" of the zeros", 0.1), pole_damping=(" of the poles", 0.7)
)
FILTER_KEYS = tuple(
    Key(
        name,
        listed(form, least=0, plural=False),
        f"{form.doc}s of the feedback torque",
        default=(),
    )
    for name, form in (("low_pass", LOW_PASS), ("notch", NOTCH))
)
OWN_KEYS = (
    Key(
        "speed_feedforward",
        number(least=0.0, most=MOST_FEEDFORWARD),
        "part of the speed of the reference",
        default=1.0,
    ),
    Key(
        "reference_filter_s",
        number(least=0.0, most=SLOWEST),
        "filter of the reference, time constant",
        "s",
        0.0,
    ),
    Key("sample_time", number(least=1e-6, most=SLOWEST), "sample time", "s", SAMPLE_S),
    Key("delay", number(least=0.0, most=SLOWEST), "from the measurement to the torque", "s", 0.0),
)


# The third parameter of a cascade, in gains as in frequencies.
_CORNER = "corner of the integral part"


def gain_keys(kind: Type) -> tuple[Key, ...]:
    """The gains of each motor, which are read as this type."""
    rows = (
        ("gain of the position control", "1/s"),
        ("gain of the speed control", "N m s/rad"),
        (_CORNER, "1/s"),
    )
    return tuple(Key(name, kind, doc, unit) for name, (doc, unit) in zip(GAINS, rows, strict=True))


def _check_gains(table: Table, here: Context) -> None:
    """The error of gains with which the servo follows no reference, or has no stable inverse."""
    for name in GAINS[:2]:
        if min(here.values[name]) <= 0.0:
            raise table.fail(name, "numbers > 0: else the servo follows no reference")
    if min(here.values[GAINS[2]]) < 0.0:
        raise table.fail(
            GAINS[2],
            "numbers >= 0: else the servo has a zero 1/(1 + k_i h) > 1, and its inverse is "
            "unstable",
        )


_OF_MOTORS = vector(size=lambda here: len(here.of_file("motor")))
_POSITION, _SPEED, _INTEGRAL = gain_keys(Type(_OF_MOTORS.read, vector().schema))
_CASCADE = (_POSITION, _SPEED, replace(_INTEGRAL, check=_check_gains))
_HZ = tuple(
    Key(
        name,
        number(least=0.0 if name == "integral_hz" else 1e-6, most=MOST_HZ),
        f"{doc} []; default: proposed",
        "Hz",
        None,
    )
    for name, doc in zip(
        FREQUENCIES,
        (
            "bandwidth of the position control",
            "bandwidth of the speed control",
            _CORNER,
        ),
        strict=True,
    )
)
SERVO_TABLE = Kinds(
    "position servo of the motors",
    {
        "ppi": Format("P-PI cascade, by frequencies", (*_HZ, *FILTER_KEYS, *OWN_KEYS), ServoTable),
        "cascade": Format(
            "P-PI cascade, by gains of each motor",
            (*_CASCADE, *FILTER_KEYS, *OWN_KEYS),
            ServoTable,
        ),
    },
    typed=True,
)
