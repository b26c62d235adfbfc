"""Keys of model files at their edges: the last value that is read, and the next one.

The ranges of all keys are in `docs/model_keys.md`, which a test compares with the rows; here are
the bounds that depend on more than one number.
"""

from __future__ import annotations

from typing import Any

import pytest

import flexgen
from flexgen.base.errors import ModelError

M1 = "motor.m1"
Q1 = "element.upper.dof.q1"
RATIO = 267.42857142857144  # of the first gear


def series(scale: float) -> dict[str, Any]:
    """Amplitudes 0.5 and 0.1 of the harmonics 1 and 3, times the scale."""
    return {"harmonics": [1, 3], "cos": [0.3 * scale, 0.1 * scale], "sin": [0.4 * scale, 0.0]}


def move(**changes: Any) -> list[dict[str, Any]]:
    rest = {"type": "joint", "start_rad": [0, 0.1], "duration": 1.0, "smoothness": 4}
    return [{"name": "p", **rest, **changes}]


def profile(count: int) -> list[dict[str, Any]]:
    made = move(end_rad=[1, 1], profile=[2.0] * count)
    return [{k: x for k, x in made[0].items() if k not in ("duration", "smoothness")}]


def to(angle: float) -> dict[str, Any]:
    limits = {f"{Q1}.lower_rad": -0.5, f"{Q1}.upper_rad": 0.75, "home_deg": [0, 0]}
    return {**limits, "move": move(start_rad=[0, 0], end_rad=[angle, -0.3])}


def rows(*weights: dict[str, float]) -> dict[str, Any]:
    output = {"type": "combination", "unit": "rad", "rows": list(weights)}
    return {"output": output, "move": []}


def circle(center: list[float], angle: float) -> dict[str, Any]:
    about = {"center": center, "axis": [0, 1, 0], "angle_rad": angle}
    return {"move": move(type="tool_circle", **about)}


LIMITS = r"move\.p\.end_rad: .*q1 within its limits -0\.5\.\.0\.75 rad"
THERMAL = {f"{M1}.thermal_time": 20.0}
ERROR = f"{Q1}.gear.transmission_error"
STEEP = "each times its harmonic"
ROWS = "linearly independent rows"
CASES: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    # a ripple is less than the torque; an error of the encoder leaves the angle rising
    (
        {f"{M1}.torque_ripple": series(0.9999 / 0.6)},
        {f"{M1}.torque_ripple": series(1.0001 / 0.6)},
        "amplitudes whose sum is below 1",
    ),
    (
        {f"{M1}.encoder_error": series(0.9999 / 0.8)},
        {f"{M1}.encoder_error": series(1.0001 / 0.8)},
        f"{STEEP}, is below 1",
    ),
    (
        {ERROR: series(0.9999 * 0.5 / 0.8 / RATIO)},
        {ERROR: series(1.0001 * 0.5 / 0.8 / RATIO)},
        rf"{STEEP} and the gear ratio, is below 0\.5",
    ),
    (
        {**THERMAL, f"{M1}.torque_rms_max": 3.0},
        THERMAL,
        "expected torque_rms_max in addition to a thermal_time",
    ),
    ({f"{M1}.ratio": -3.0}, {f"{M1}.ratio": 0.0}, "expected a ratio that is not 0"),
    # but for rounding
    (to(0.75 + 1e-12), to(0.75 + 1e-9), LIMITS),
    (to(-0.5 - 1e-12), to(-0.5 - 1e-9), LIMITS),
    ({"move": profile(2)}, {"move": profile(1)}, "profile"),
    ({"move": profile(8)}, {"move": profile(9)}, "profile"),
    (circle([0, 0, 1.0], 1.0), circle([0, 0, 1.0], 0.0), "an angle that is not 0"),
    (circle([0, 3.0, 1.0], 1.0), circle([0, 3.0, 0], 1.0), "not on the axis through"),
    (
        {"move": move(end_rad=[1, 1])},
        {"move": move(end_rad=[1, 1], profile=[1, 1])},
        "either duration or profile",
    ),
    ({"move": move(end_rad=[1, 1])}, {"move": move(end_rad=[1])}, "end_rad"),
    (
        {"move": move(type="tool_line", displacement=[0.1, 0, 0])},
        {"move": move(type="output_line", displacement=[1, 1])},
        "expected joint or tool_line, because the output is the tool",
    ),
    (
        {"move": move(end_rad=[1, 1])},
        {"move": move(position=[1, 1, 1], rpy_deg=[0, 0, 0])},
        "expected end, because the arm has not six",
    ),
    (rows({"q1": 1.0}, {"q1": 1e6, "q2": 1e-2}), rows({"q1": 1.0}, {"q1": 2.0}), ROWS),
    (rows({"q1": 1.0}, {"q2": 1.0}), rows({"q1": 1.0}, {"q1": 1e6, "q2": 1e-4}), ROWS),
    (
        rows({"q1": 1.0}, {"q2": 1.0}),
        rows({"q1": 0.0}, {"q2": 1.0}),
        "at least one weight that is not 0",
    ),
]


@pytest.mark.parametrize(("good", "bad", "text"), CASES)
def test_the_last_value_is_read_and_the_next_is_refused(
    good: dict[str, Any], bad: dict[str, Any], text: str
) -> None:
    flexgen.read("elbow", overrides=good)
    with pytest.raises(ModelError, match=text):
        flexgen.read("elbow", overrides=bad)


@pytest.mark.parametrize(
    ("turns", "good"), [(100, True), (-100, True), (101, False), (0.5, False)]
)
def test_turns_are_whole_and_at_most_a_hundred(turns: float, good: bool) -> None:
    given = {"position": [1.2, 0.1, 1.0], "rpy_deg": [0, 90, 0], "turns": [0, 0, 0, 0, 0, turns]}
    overrides: Any = {"move": move(start_rad=[0] * 6, **given)}
    if good:
        target = flexgen.read("manutec_r3", overrides=overrides).moves[0].target
        assert target is not None and target.turns == (0, 0, 0, 0, 0, turns)
        return
    with pytest.raises(ModelError, match="expected whole numbers from -100 to 100"):
        flexgen.read("manutec_r3", overrides=overrides)
