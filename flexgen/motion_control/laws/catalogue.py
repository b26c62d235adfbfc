"""Laws by the ``type`` of a table in a TOML file; the keys are the parameters of the classes.

feedback_linearisation   ``frequency_hz``, ``form``, ``predict``
computed_torque          ``frequency_hz``
tomei_pd                 ``frequency_hz``, ``damping``, ``k_p``, ``k_d``, ``feedforward``
joint_torque_feedback    ``frequency_hz``, ``k_p``, ``k_d``, ``k_t``, ``k_s``
lq                       ``rho``
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexgen.errors import ArgumentError
from flexgen.motion_control.laws.law import ModelLaw
from flexgen.motion_control.laws.linearising import ComputedTorque, FeedbackLinearisation
from flexgen.motion_control.laws.motor_laws import JointTorqueFeedback, TomeiPD
from flexgen.motion_control.laws.state_lq import LQ

_NUMBER, _TEXT, _FLAG, _GAINS = "a number", "a text", "true or false", "numbers in brackets, one for each motor"
LAWS: dict[str, tuple[type[ModelLaw], dict[str, str]]] = {
    "feedback_linearisation": (
        FeedbackLinearisation, {"frequency_hz": _NUMBER, "form": _TEXT, "predict": _FLAG},
    ),
    "computed_torque": (ComputedTorque, {"frequency_hz": _NUMBER}),
    "tomei_pd": (
        TomeiPD, {"frequency_hz": _NUMBER, "damping": _NUMBER, "k_p": _GAINS, "k_d": _GAINS, "feedforward": _FLAG},
    ),
    "joint_torque_feedback": (
        JointTorqueFeedback, {"frequency_hz": _NUMBER, **dict.fromkeys(("k_p", "k_d", "k_t", "k_s"), _GAINS)},
    ),
    "lq": (LQ, {"rho": _NUMBER}),
}  # fmt: skip


def law_of_table(table: Mapping[str, Any], path: Path) -> ModelLaw:
    """The law of a table; ArgumentError where a key is unknown or a value is of another kind."""
    made, kinds = LAWS[table["type"]]
    arguments = {}
    for key, value in table.items():
        if key in ("type", "description"):
            continue
        if key not in kinds:
            raise ArgumentError(f"{path}: given the key {key!r}, expected some of {', '.join(kinds)}")
        if not _fits(value, kinds[key]):
            raise ArgumentError(f"{path}, {key}: given {value!r}, expected {kinds[key]}")
        arguments[key] = value
    return made(**arguments)


def _fits(value: Any, kind: str) -> bool:
    if kind == _FLAG:
        return isinstance(value, bool)
    if kind == _TEXT:
        return isinstance(value, str)
    if kind == _GAINS:
        return isinstance(value, list) and all(_fits(x, _NUMBER) for x in value)
    return isinstance(value, int | float) and not isinstance(value, bool)
