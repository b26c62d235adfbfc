"""The servo of a loaded library, which is sent positions: an option of `Inverter` and `Stream`."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import number_of
from flexgen.runtime.inversion.inversion_arguments import array_of, pointer
from flexgen.runtime.structs import Failures, Interface, failure_of, interface_of

GAINS = ("position_gain", "speed_gain", "integral_gain")
NUMBERS = ("speed_feedforward", "reference_filter", "sample_time", "delay")
SAME = 1e-6  # relative difference of sample times that are equal


@dataclass(frozen=True)
class ServoEntry:
    """The servo of the model file in C, and what the options of an inversion need of it."""

    interface: Interface
    defaults: Callable[[], ctypes.Structure]
    motors: int
    real: np.dtype[Any]
    fit: Callable[..., int]
    fit_work: Callable[..., int]
    failures: Failures

    def options(
        self, function: str, given: Any, period: float, hold: Any, delay: Any
    ) -> dict[str, Any]:
        """The options ``hold``, ``delay`` and ``servo`` of a call.

        Parameters
        ----------
        function : str
            For messages.
        given : True or mapping
            Members of the servo that are others than in the model file.
        period : float [s]
            Of the samples of the results.
        hold, delay
            As given; the servo has its own.

        Raises
        ------
        ArgumentError
            A member is unknown or out of range, or the samples are not those of the servo.
        """
        if hold not in ("spline", "zoh") or delay:
            raise ArgumentError(
                f"{function}, hold: given {hold!r} and a delay of {delay} with a servo, "
                "expected its own"
            )
        if given is not True and not isinstance(given, Mapping):
            raise ArgumentError(
                f"{function}, servo: given {given!r}, expected True or a mapping of its members"
            )
        servo: Any = self.defaults()
        kept: list[np.ndarray] = []
        for name, value in ({} if given is True else given).items():
            if name in GAINS:
                kept.append(array_of(function, f"servo {name}", value, (self.motors,), self.real))
                setattr(servo, name, kept[-1].ctypes.data)
            elif name in NUMBERS:
                setattr(servo, name, number_of(function, f"servo {name}", value))
            else:
                raise ArgumentError(
                    f"{function}, servo: given {name!r}, expected one of "
                    f"{', '.join((*GAINS, *NUMBERS))}"
                )
        h = float(servo.sample_time)
        if not abs(period - h) <= SAME * h:
            raise ArgumentError(
                f"{function}, period: given samples of the results {period:g} s apart, expected "
                f"{h:g} s, the sample time of the servo"
            )
        servo.kept = kept
        late = float(servo.delay) / h
        return {"hold": self.interface.enums["hold"].index("zoh"), "delay": late, "servo": servo}

    @property
    def sample_time(self) -> float:
        """That of the model file [s]."""
        return float(self.defaults().sample_time)

    def samples(
        self, function: str, command_g: np.ndarray, each: int, interpolation: str
    ) -> np.ndarray:
        """Positions (m, n_g), one every ``each`` samples of the commands (n, n_g), see the C
        function.
        """
        known = self.interface.enums["interpolation"]
        if interpolation not in known:
            raise ArgumentError(
                f"{function}: given the interpolation {interpolation!r}, expected "
                f"{', '.join(known)}"
            )
        robot = self.interface.structs["robot_interface"](
            samples_per_position=each, interpolation=known.index(interpolation)
        )
        n, joints = command_g.shape
        size = int(self.fit_work(ctypes.c_int(n), ctypes.byref(robot)))
        work = np.empty(max(size, 0), self.real)
        out = np.empty(((n - 1) // each + 1, joints), self.real)
        arrays = [pointer(x) for x in (command_g, out, work)]
        status = self.fit(
            arrays[0], ctypes.c_int(n), ctypes.byref(robot), *arrays[1:], ctypes.c_int64(size)
        )
        if status < 0:
            exception, text = failure_of(self.failures, status)
            raise exception(f"{function}: {text}")
        return out


def servo_entry(
    manifest: Mapping[str, Any],
    found: Callable[[str], Any],
    failures: Failures,
    real: np.dtype[Any],
) -> ServoEntry | None:
    """The servo of a library; None where it gives no positions to send."""
    if "servo_defaults" not in {row["name"] for row in manifest.get("c_functions", ())}:
        return None
    interface = interface_of(manifest)
    defaults = found(f"{manifest['name']}_servo_defaults")
    defaults.restype = interface.structs["servo"]
    fit, work = (found(f"{manifest['name']}_position_samples{end}") for end in ("", "_work"))
    work.restype = ctypes.c_int64
    return ServoEntry(interface, defaults, manifest["sizes"]["n_m"], real, fit, work, failures)


def servo_options(
    entry: ServoEntry | None, function: str, given: Any, period: float, hold: Any, delay: Any
) -> dict[str, Any]:
    """`ServoEntry.options`; none where no servo is given. ArgumentError where the library has no
    positions.
    """
    if given is None:
        return {}
    if entry is None:
        raise ArgumentError(
            f"{function}, servo: given to a library without positions, expected one that was "
            "generated with parts=['position'] (--with position)"
        )
    return entry.options(function, given, period, hold, delay)
