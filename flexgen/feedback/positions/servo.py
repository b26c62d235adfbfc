"""The position servo of a robot: a P-PI cascade with speed feedforward and a filter of its
reference; its file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import is_number
from flexgen.base.spec.keys import Context, Format, Kinds, read
from flexgen.base.spec.tables import file_bytes, file_table
from flexgen.feedback.loop.controller_files import CONTROLLER
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import PPI
from flexgen.model.elements import RobotModel
from flexgen.model.position_servo.keys import (
    FREQUENCIES,
    GAINS,
    MOST_FEEDFORWARD,
    OWN_KEYS,
    SAMPLE_S,
    SLOWEST,
    ServoTable,
)


@checked_class
@dataclass(frozen=True)
class Servo:
    """Position servo: the torque from its reference r at each sample, motor side.

        r_f <- r_f + (1 - exp(-h/T)) (r - r_f)                      filter of the reference
        w = f D r_f + k_p (r_f - q) - D q,    D x = (x_k - x_(k-1))/h
        u = F(z) k_v (w + k_i h sum w)
        torque, which acts after the delay

    Its integral holds the robot at rest where the motion begins.

    Parameters
    ----------
    feedback : Cascade or PPI
        Gains k_p [1/s], k_v [N m s/rad] and k_i [1/s] of the motors, and the filters F of the
        torque; `PPI` states them by frequencies.
    speed_feedforward : float
        f: part of the speed of the reference that the speed controller is given, 0 to 2.
    reference_filter_s : float [s]
        T: time constant of the filter of the reference; 0: none.
    sample_time : float [s]
        h.
    delay : float [s]
        From the measurement to the torque.

    Examples
    --------
    >>> servo = flexgen.Servo(flexgen.PPI(position_hz=5.0, speed_hz=30.0), speed_feedforward=0.0)
    >>> found = flexgen.command_positions("planar5_nmp", servo=servo)
    >>> found.tool_error_max_m < 1e-6 < 1e-3 < found.today_error_max_m
    True
    """

    feedback: Cascade | PPI
    speed_feedforward: float = 1.0
    reference_filter_s: float = 0.0
    sample_time: float = SAMPLE_S
    delay: float = 0.0

    def __post_init__(self) -> None:
        limits = {
            "speed_feedforward": (0.0, MOST_FEEDFORWARD),
            "reference_filter_s": (0.0, SLOWEST),
            "sample_time": (1e-6, SLOWEST),
            "delay": (0.0, SLOWEST),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not (is_number(value) and low <= value <= high):
                raise ArgumentError(
                    f"servo, {name}: given {show_value(value)}, expected {low:g} to {high:g}"
                )

    @classmethod
    def read(cls, path: str | Path) -> Servo:
        """The servo of a TOML file: keys of a controller of type ppi or cascade, and the
        parameters of this class.
        """
        file = Path(path)
        found: Servo = read(file_table(file_bytes(file, "servo"), file), SERVO, Context())
        return found

    @property
    def part_per_sample(self) -> float:
        """Part of a step that passes the filter of the reference within a sample."""
        T = self.reference_filter_s
        return 1.0 if T == 0.0 else float(-np.expm1(-self.sample_time / T))


def filter_reference(servo: Servo, r: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Reference with which a cascade with full speed feedforward reproduces this servo with r (n,
    n_m).

    ``gain`` (n_m,) [1/s]: k_p. At rest before the first sample.
    """
    h = servo.sample_time
    x = r - r[0]
    if servo.reference_filter_s > 0.0:
        a = servo.part_per_sample
        x = lfilter([a], [1.0, a - 1.0], x, axis=0)
    f = servo.speed_feedforward
    out = np.empty_like(x)
    for j, k_p in enumerate(gain):
        out[:, j] = lfilter([k_p + f / h, -f / h], [k_p + 1 / h, -1 / h], x[:, j])
    return out + r[0]


def servo_of(given: Any, model: RobotModel) -> Servo:
    """The servo from what a user gives: a `Servo`, a `Cascade` or `PPI`, ``"ppi"`` or a file;
    None: of the model.
    """
    if given is None:
        return Servo(PPI()) if model.servo is None else _servo_of_table(model.servo)
    if isinstance(given, Servo):
        return given
    if isinstance(given, Cascade | PPI):
        return Servo(given)
    if given == "ppi":
        return Servo(PPI())
    if isinstance(given, str | Path) and str(given).endswith(".toml"):
        return Servo.read(given)
    raise ArgumentError(
        f"servo: given {show_value(given)}, expected a flexgen.Servo, Cascade or PPI, the name "
        "'ppi', or a file .toml"
    )


def _servo_of_table(table: ServoTable) -> Servo:
    """The servo of a model file."""
    hz: dict[str, Any] = {name: getattr(table, name) for name in FREQUENCIES}
    gains: dict[str, Any] = {name: np.array(getattr(table, name)) for name in GAINS}
    feedback = (
        PPI(**hz, filters=table.filters)
        if table.type == "ppi"
        else Cascade(**gains, filters=table.filters)
    )
    return Servo(feedback, **{key.name: getattr(table, key.name) for key in OWN_KEYS})


def _maker(form: Format) -> Any:
    """Makes a servo of the values of its table."""
    own = {key.name for key in OWN_KEYS}

    def make(**values: Any) -> Servo:
        feedback = form.make(**{name: value for name, value in values.items() if name not in own})
        return Servo(feedback, **{name: value for name, value in values.items() if name in own})

    return make


SERVO = Kinds(
    "position servo",
    {
        kind: Format(form.doc, (*form.keys, *OWN_KEYS), _maker(form))
        for kind, form in CONTROLLER.kinds.items()
        if kind != "linear"
    },
    shared=CONTROLLER.shared,
)
