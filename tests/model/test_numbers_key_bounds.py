"""Keys of model files at the edge of their bounds: the largest amplitude, turn or place that is
read, and the next.
"""

from __future__ import annotations

from typing import Any

import pytest

import flexgen
from flexgen.base.errors import ModelError

M1 = "motor.m1"
Q1 = "element.upper.dof.q1"
ELLIPTIC: dict[str, Any] = {
    "harmonics": [1, 3],
    "cos": [0.3, 0.1],
    "sin": [0.4, 0.0],
}  # sums: 0.5 + 0.1; times the harmonics 0.5 + 0.3


def series(scale: float) -> dict[str, Any]:
    return {
        name: [scale * x for x in values] if name != "harmonics" else values
        for name, values in ELLIPTIC.items()
    }


@pytest.mark.parametrize(
    ("key", "most", "text"),
    [
        (f"{M1}.torque_ripple", 1 / 0.6, "amplitudes whose sum is below 1"),
        (f"{M1}.encoder_error", 1 / 0.8, "each times its harmonic, is below 1"),
        (
            f"{Q1}.gear.transmission_error",
            None,
            r"each times its harmonic and the gear ratio, is below 0\.5",
        ),
    ],
)
def test_series_are_less_steep_than_what_they_change(
    key: str, most: float | None, text: str
) -> None:
    most = 0.5 / 0.8 / 267.42857142857144 if most is None else most
    flexgen.read("elbow", overrides={key: series(0.9999 * most)})
    with pytest.raises(ModelError, match=text):
        flexgen.read("elbow", overrides={key: series(1.0001 * most)})


def test_an_rms_limit_belongs_to_its_time() -> None:
    made = flexgen.read(
        "elbow", overrides={f"{M1}.torque_rms_max": 3.0, f"{M1}.thermal_time": 20.0}
    )
    assert (made.motors[0].torque_rms_max, made.motors[0].thermal_time) == (3.0, 20.0)
    assert (
        flexgen.read("elbow", overrides={f"{M1}.torque_rms_max": 3.0}).motors[0].thermal_time
        is None
    )
    with pytest.raises(ModelError, match="expected torque_rms_max in addition to a thermal_time"):
        flexgen.read("elbow", overrides={f"{M1}.thermal_time": 20.0})


@pytest.mark.parametrize(("ratio", "good"), [(-3.0, True), (1e-12, True), (0.0, False)])
def test_a_ratio_may_be_negative_but_not_zero(ratio: float, good: bool) -> None:
    if good:
        assert flexgen.read("elbow", overrides={f"{M1}.ratio": ratio}).motors[0].ratio == (ratio,)
        return
    with pytest.raises(ModelError, match="expected a ratio that is not 0"):
        flexgen.read("elbow", overrides={f"{M1}.ratio": ratio})


@pytest.mark.parametrize(("beyond", "good"), [(0.0, True), (1e-12, True), (1e-9, False)])
def test_poses_are_within_the_limits_of_the_joints_but_for_rounding(
    beyond: float, good: bool
) -> None:
    move = {"name": "p", "type": "joint", "start_rad": [0, 0], "duration": 1.0, "smoothness": 4}
    for value in (0.75 + beyond, -0.5 - beyond):
        changed: Any = {f"{Q1}.lower_rad": -0.5, f"{Q1}.upper_rad": 0.75, "home_deg": [0, 0]}
        changed["move"] = [{**move, "end_rad": [value, -0.3]}]
        if good:
            assert flexgen.read("elbow", overrides=changed).moves[0].end == (value, -0.3)
        else:
            with pytest.raises(
                ModelError, match=r"move\.p\.end_rad: .*q1 within its limits -0\.5\.\.0\.75 rad"
            ):
                flexgen.read("elbow", overrides=changed)


@pytest.mark.parametrize(("count", "good"), [(1, False), (2, True), (8, True), (9, False)])
def test_a_profile_has_two_to_eight_bounds(count: int, good: bool) -> None:
    moves: Any = [
        {
            "name": "p",
            "type": "joint",
            "start_rad": [0, 0],
            "end_rad": [1, 1],
            "profile": [2.0] * count,
        }
    ]
    if good:
        assert flexgen.read("elbow", overrides={"move": moves}).moves[0].profile == (2.0,) * count
        return
    with pytest.raises(ModelError, match="profile"):
        flexgen.read("elbow", overrides={"move": moves})


@pytest.mark.parametrize(
    ("turns", "good"), [(100, True), (-100, True), (101, False), (0.5, False)]
)
def test_turns_are_whole_and_at_most_a_hundred(turns: float, good: bool) -> None:
    given = {"position": [1.2, 0.1, 1.0], "rpy_deg": [0, 90, 0], "turns": [0, 0, 0, 0, 0, turns]}
    moves: Any = [
        {
            "name": "p",
            "type": "joint",
            "start_rad": [0] * 6,
            "duration": 1.0,
            "smoothness": 4,
            **given,
        }
    ]
    if good:
        target = flexgen.read("manutec_r3", overrides={"move": moves}).moves[0].target
        assert target is not None and target.turns == (0, 0, 0, 0, 0, turns)
        return
    with pytest.raises(ModelError, match="expected whole numbers from -100 to 100"):
        flexgen.read("manutec_r3", overrides={"move": moves})


@pytest.mark.parametrize(
    ("move", "text"),
    [
        (
            {"type": "tool_circle", "center": [0, 0, 1.0], "axis": [0, 1, 0], "angle_rad": 0.0},
            "an angle that is not 0",
        ),
        (
            {"type": "tool_circle", "center": [0, 3.0, 0], "axis": [0, 1, 0], "angle_rad": 1.0},
            "not on the axis through",
        ),
        ({"type": "joint", "end_rad": [1, 1], "profile": [1, 1]}, "either duration or profile"),
        ({"type": "joint", "end_rad": [1]}, "end_rad"),
        (
            {"type": "output_line", "displacement": [1, 1]},
            "expected joint or tool_line, because the output is the tool",
        ),
        (
            {"type": "joint", "position": [1, 1, 1], "rpy_deg": [0, 0, 0]},
            "expected end, because the arm has not six",
        ),
    ],
)
def test_moves_that_have_no_meaning_are_refused(move: dict[str, Any], text: str) -> None:
    given: Any = [{"name": "p", "start_rad": [0, 0.1], "duration": 1.0, "smoothness": 4, **move}]
    with pytest.raises(ModelError, match=text):
        flexgen.read("elbow", overrides={"move": given})


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([{"q1": 1.0}, {"q1": 2.0}], "linearly independent rows"),
        ([{"q1": 1.0}, {"q1": 1e6, "q2": 1e-4}], "linearly independent rows"),
        ([{"q1": 0.0}, {"q2": 1.0}], "at least one weight that is not 0"),
    ],
)
def test_rows_of_outputs_are_independent(rows: list[dict[str, float]], text: str) -> None:
    output = {"type": "combination", "unit": "rad", "rows": rows}
    with pytest.raises(ModelError, match=text):
        flexgen.read("elbow", overrides={"output": output, "move": []})
    good = {**output, "rows": [{"q1": 1.0}, {"q1": 1e6, "q2": 1e-2}]}
    made = flexgen.read("elbow", overrides={"output": good, "move": []})
    assert made.output.weights == ((1.0, 0.0), (1e6, 1e-2)) and made.output.unit == "rad"
