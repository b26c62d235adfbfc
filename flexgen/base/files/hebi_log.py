"""Logs of HEBI modules (.hebilog) as arrays by name, read by the package of the maker, hebi-py.

The package is imported only here, when such a file is read. Names state quantity, number of the
module from 1, and unit: ``position_1 rad``. Times are seconds since the first sample: ``time s``,
when the computer received the samples of all modules, and ``module_time_1 s``, the clock of a
module, which has less jitter.
"""

from __future__ import annotations

import contextlib
import io
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError

# Quantity of an array -> attribute of a feedback and its unit.
QUANTITIES = {
    "position": ("position", "rad"),
    "velocity": ("velocity", "rad/s"),
    "effort": ("effort", "N m"),
    "deflection": ("deflection", "rad"),
    "deflection_velocity": ("deflection_velocity", "rad/s"),
    "motor_position": ("motor_position", "rad"),
    "motor_velocity": ("motor_velocity", "rad/s"),
    "motor_current": ("motor_current", "A"),
    "winding_current": ("motor_winding_current", "A"),
    "voltage": ("voltage", "V"),
    "position_command": ("position_command", "rad"),
    "velocity_command": ("velocity_command", "rad/s"),
    "effort_command": ("effort_command", "N m"),
}
MICROSECOND = 1e-6  # s


def read_hebi_log(file: Path) -> dict[str, Any]:
    """The arrays (n,) of a log by their names, masked where a module did not send a quantity;
    quantities that none sent are left out.

    Raises
    ------
    ArgumentError
        The package hebi-py is not installed, or the file cannot be read by it.
    """
    load = _package()
    try:
        feedbacks = list(load(str(file)).feedback_iterate)
        count = int(feedbacks[0].size)
        received = np.array([np.min(one.receive_time) for one in feedbacks])
        clocks = np.array([one.hardware_transmit_time_us for one in feedbacks], dtype=float)
        values = {
            name: np.array([getattr(one, attribute) for one in feedbacks], dtype=float)
            for name, (attribute, _) in QUANTITIES.items()
            if hasattr(feedbacks[0], attribute)
        }
    except Exception as error:  # the package raises many kinds for a damaged file
        raise ArgumentError(
            f"{file}: cannot be read as a log of HEBI modules ({error}); expected a .hebilog file"
        ) from None
    out: dict[str, Any] = {"time s": received - received[0]}
    for k in range(count):
        clock = MICROSECOND * (clocks[:, k] - clocks[0, k])
        out[f"module_time_{k + 1} s"] = clock
        for name, rows in values.items():
            if np.isfinite(rows[:, k]).any():
                masked = np.ma.masked_invalid(rows[:, k])
                whole = not np.ma.getmaskarray(masked).any()
                out[f"{name}_{k + 1} {QUANTITIES[name][1]}"] = masked.data if whole else masked
    return out


def _package() -> Any:
    """The function of hebi-py that loads a log; the package prints when it is imported."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            return import_module("hebi").util.load_log
    except ImportError as error:
        raise ArgumentError(
            f".hebilog: needs the package hebi-py ({error}); run: pip install hebi-py"
        ) from None
