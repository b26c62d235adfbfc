"""Uses of limits against numbers by hand, bounds that are refused, and keys of the model file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.emission.digest import model_digest
from flexgen.dynamics.mechanics.limit_use import LimitUse, limit_rows, tool_motion, uses_of_limits
from flexgen.dynamics.mechanics.limits import EACH, Limits
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import exceeded_limits, within_limits

TIME = np.linspace(0.0, 2.0, 2001)  # s
KEYS = {
    "motor.m1.torque_rate_max": 60.0,
    "motor.m2.torque_rms_max": 2.0,
    "motor.m2.thermal_time": 30.0,
    "motor.m1.torque_speed": [[0.0, 40.0], [200.0, 40.0], [500.0, 10.0]],
    "element.upper.dof.q1.gear.torque_max": 3000.0,
    "element.upper.dof.q1.gear.torque_rms_max": 900.0,
    "tool.speed_max": 1.2,
    "tool.acceleration_max": 9.0,
}


def motion(**given: np.ndarray) -> dict[str, np.ndarray]:
    """Channels of the elbow, zero where they are not given."""
    return {
        name: np.zeros((len(TIME), 2)) for name in ("q_a", "v_a", "a_a", "tau_g", "v_m", "tau_m")
    } | given


def parts(limits: Limits, **given: np.ndarray) -> dict[str, float]:
    """The largest part of each limit that is used, by quantity and name."""
    found = uses_of_limits(flexgen.read("elbow"), limits, motion(**given).__getitem__, TIME)
    return {f"{use.quantity} of {use.name}": use.part for use in found}


def of_both(x: np.ndarray) -> np.ndarray:
    return np.stack([x, -2.0 * x], axis=1)


def test_largest_values_over_their_bounds() -> None:
    sine = of_both(np.sin(2 * np.pi * TIME))
    found = parts(
        Limits((4.0, 4.0), (np.inf, 8.0), gear_torque=(10.0, 10.0), reserve=0.2),
        tau_m=sine,
        v_m=sine,
    )
    assert_allclose(found.pop("motor torque of m1"), 1 / 3.2, rtol=1e-6)
    assert_allclose(found.pop("motor torque of m2"), 2 / 3.2, rtol=1e-6)
    assert_allclose(found.pop("motor speed of m2"), 2 / 8, rtol=1e-6)
    assert found == {"gear torque of q1": 0.0, "gear torque of q2": 0.0}
    found = parts(
        Limits(torque_rate=(20.0, 20.0), joint_speed=(4.0, 4.0), joint_acceleration=(5.0, 5.0)),
        tau_m=sine,
    )
    assert_allclose(found["rate of the torque of m2"], 4 * np.pi / 20, rtol=1e-5)


def test_effective_torques_of_the_whole_motion_and_of_a_winding() -> None:
    """A constant torque T heats to T sqrt(1 - exp(-t/30)); a sine of the amplitude 2 has
    2/sqrt(2).
    """
    found = parts(Limits(torque_rms=(1.0, 1.0)), tau_m=of_both(np.sin(2 * np.pi * TIME)))
    assert_allclose(list(found.values()), [np.sqrt(0.5), np.sqrt(2)], rtol=1e-3)
    warm = parts(
        Limits(torque_rms=(2.0, 2.0), thermal_time=(30.0, np.inf)),
        tau_m=of_both(np.full(2001, 3.0)),
    )
    assert_allclose(
        warm["effective torque of m1"], 1.5 * np.sqrt(-np.expm1(-2.0 / 30.0)), rtol=1e-3
    )
    assert_allclose(warm["effective torque of m2"], 3.0, rtol=1e-9)
    found = parts(Limits(gear_torque_rms=(1.0, np.inf)), tau_g=of_both(np.full(2001, 3.0)))
    assert_allclose(found["effective gear torque of q1"], 3.0, rtol=1e-9)


def test_the_rest_after_a_path_is_not_in_an_effective_torque() -> None:
    """2 N m on a path of 1 s, then none for 1 s: 2 N m; with the rest 2/sqrt(2)."""
    limits = Limits(torque_rms=(1.0, np.inf))
    tau_m = of_both(np.where(TIME <= 1.0, 2.0, 0.0))
    values = [
        uses_of_limits(flexgen.read("elbow"), limits, motion(tau_m=tau_m).__getitem__, TIME, end)[
            0
        ].value
        for end in (1.0, np.inf)
    ]
    assert_allclose(values, [2.0, np.sqrt(2.0)], rtol=1e-3)
    robot = flexgen.read("elbow", overrides={"motor.m1.torque_rms_max": 9.0})
    # the rest is a part of these samples
    still = flexgen.solve(robot, verify=False, progress=False).trajectory
    tau = still["tau_m"][(still.time >= 0.0) & (still.time <= 1.0), 0]
    (text,) = exceeded_limits(
        robot, Limits(torque_rms=(0.9 * float(np.sqrt(np.mean(tau**2))), np.inf)), still
    )
    assert f"{np.sqrt(np.mean(tau**2)):.3g}" in text


def test_a_torque_curve_bounds_the_torque_at_each_speed() -> None:
    """At 300 rad/s the curve of m1 allows 30 N m, with a tenth in reserve 27 N m; beyond 500 rad/s
    nothing.
    """
    curves = (((0.0, 40.0), (200.0, 40.0), (500.0, 10.0)), ())
    v = np.stack([np.full(2001, -300.0), np.full(2001, 9e9)], axis=1)
    for torque, reserve, limit in ((30.0, 0.0, 30.0), (-27.0, 0.1, 27.0)):
        tau = np.full((2001, 2), torque)
        (at, speed) = uses_of_limits(
            flexgen.read("elbow"),
            Limits(torque_speed=curves, reserve=reserve),
            motion(tau_m=tau, v_m=v).__getitem__,
            TIME,
        )
        assert_allclose(
            [at.part, at.value, at.bound, speed.part], [1.0, abs(torque), limit, 0.6], rtol=1e-12
        )
    (_, fast) = parts(Limits(torque_speed=curves), v_m=2 * v).items()
    assert fast == ("speed of its torque curve of m1", 1.2)


def test_the_motion_of_the_tool_against_differences() -> None:
    equations = flexgen.derive("planar5_nmp")
    q = np.stack(
        [0.3 + 0.2 * np.sin(3 * TIME), -1.1 + 0.1 * TIME**2, 0.01 * np.cos(20 * TIME)], axis=1
    )
    h = TIME[1]
    v = np.gradient(q, h, axis=0)
    a = np.gradient(np.gradient(q, h, axis=0), h, axis=0)
    p = evaluate(equations.function("forward_kinematics"), q)[0]
    speed, acceleration = tool_motion(equations, q, v, a)
    dp = np.gradient(p, h, axis=0)
    inside = slice(5, -5)
    assert_allclose(speed[inside], np.linalg.norm(dp, axis=1)[inside], rtol=1e-4)
    ddp = np.linalg.norm(np.gradient(dp, h, axis=0), axis=1)
    assert_allclose(acceleration[inside], ddp[inside], rtol=1e-3, atol=1e-3)
    rows = list(
        limit_rows(
            equations.model,
            Limits(tool_speed=2.0, tool_acceleration=4.0),
            {"q_a": q, "v_a": v, "a_a": a}.get,
            TIME,
        )
    )
    assert_allclose(rows[0].parts[:, 0], speed / 2)
    assert_allclose(rows[1].parts[:, 0], acceleration / 4)


def test_keys_of_a_model_file_are_limits_and_warnings() -> None:
    robot = flexgen.read("elbow", overrides=KEYS)
    found = Limits.from_model(robot)
    assert found.torque_rate == (60.0, np.inf) and found.torque_rms == (np.inf, 2.0)
    assert found.thermal_time == (np.inf, 30.0) and found.torque_speed[0][1] == (200.0, 40.0)
    assert (found.gear_torque, found.gear_torque_rms) == ((3000.0, np.inf), (900.0, np.inf))
    assert (found.tool_speed, found.tool_acceleration) == (1.2, 9.0)
    solution = flexgen.solve(robot, verify=False, progress=False)
    names = [text.split(" exceeds")[0] for text in solution.warnings]
    assert solution.status == "limits exceeded" and len(names) == 3
    assert any(text.startswith("m1: rate of the torque") for text in names)
    assert any("gear torque" in text and "N m" in text for text in names)
    again = flexgen.solve(robot, verify=False, ignore_limits=True, progress=False)
    assert again.status == "solved" and again.warnings == solution.warnings


def test_a_path_that_given_limits_changed_exceeds_others_of_the_file() -> None:
    """Which the given ones do not have."""
    robot = flexgen.read(
        "elbow", overrides={"motor.m1.torque_speed": [[0.0, 40.0], [100.0, 10.0]]}
    )
    solution = replace(
        flexgen.solve(robot, verify=False, progress=False), status=Status.LIMITS_ACTIVE
    )
    assert within_limits(solution, Limits(speed=(1e3, 1e3)), False).status == "limits exceeded"
    assert within_limits(solution, Limits(speed=(1e3, 1e3)), True).status == "limits active"
    stopped = replace(solution, status=Status.TOLERANCE_NOT_MET)
    assert within_limits(stopped, None, False).status == "tolerance not met"
    wide = replace(
        solution, model=flexgen.read("elbow", overrides={"element.upper.dof.q1.speed_max": 0.01})
    )
    assert within_limits(wide, None, False).status == "limits active"


def test_given_limits_that_a_method_does_not_keep_are_never_ignored() -> None:
    limits = Limits(torque=(50.0, 50.0), gear_torque_rms=(100.0, 100.0))
    solution = flexgen.solve(
        "elbow", limits=limits, ignore_limits=True, verify=False, progress=False
    )
    assert solution.status == "limits exceeded"
    assert (
        "effective gear torque" in solution.warnings[0] and "limit 100 N m" in solution.warnings[0]
    )
    wide = replace(limits, gear_torque_rms=(1e5, 1e5))
    kept = flexgen.solve("elbow", limits=wide, verify=False, progress=False)
    assert kept.status == "solved"


def test_the_reserve_is_left_of_the_torques() -> None:
    assert Limits((10.0, 20.0), reserve=0.1).arrays(2)[0].tolist() == [9.0, 18.0]
    found = flexgen.solve(
        "planar5_nmp", limits=Limits((22.0 / 0.9, 22.0 / 0.9), reserve=0.1), verify=False
    )
    assert (
        found.status == "limits active" and np.abs(found.trajectory["tau_m"]).max() <= 22.0 * 1.001
    )


def test_digests_of_models_without_these_keys_stay() -> None:
    plain = flexgen.read("elbow")
    assert model_digest(plain) != model_digest(flexgen.read("elbow", overrides=KEYS))
    assert "torque_rate" not in repr(Limits((1.0,)))


CURVES = (
    [[0, 1]],
    [[1, 2], [3, 1]],
    [[0, 1], [1, 2]],
    [[0, 5], [1, 2], [2, 1]],
    [[0, 1], [1, -1]],
    [[0, 0], [1, 0]],
)


@pytest.mark.parametrize("curve", [*CURVES, [[0, 1, 2], [1, 0, 0]], 3, [3, 4], [["a", 1], [1, 1]]])
def test_wrong_curves_are_refused(curve: object, tmp_path: Path) -> None:
    text = (Path(flexgen.__file__).parent / "model" / "shipped" / "elbow.toml").read_text()
    path = tmp_path / "wrong.toml"
    path.write_text(
        text.replace('name = "m1"\n', f'name = "m1"\ntorque_speed = {curve}\n'.replace("'", '"'))
    )
    with pytest.raises(
        ModelError, match=r"motor.*torque_speed: given .*, expected .*the speed rises from 0"
    ):
        flexgen.read(path)
    if curve in CURVES:
        with pytest.raises(
            ArgumentError, match=r"limits: given torque_speed .*, expected two or more points"
        ):
            Limits(torque_speed=(tuple(map(tuple, curve)),))


@pytest.mark.parametrize("count", [1, 3])
def test_each_motor_of_a_library_has_a_curve_or_none(count: int) -> None:
    curve = ((0.0, 20.0), (100.0, 10.0))
    with pytest.raises(
        ArgumentError,
        match=f"given torque_speed of {count} motors, expected a curve .* for each of 2",
    ):
        Limits(torque_speed=(curve,) * count).for_library("planar5_nmp")
    assert Limits(torque_speed=((), curve)).for_library("planar5_nmp")["torque_max"].tolist() == [
        np.inf,
        20.0,
    ]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"tool_speed": 0.0}, "tool_speed 0.0, expected a number > 0 in m/s"),
        ({"tool_acceleration": np.inf}, "tool_acceleration inf, expected a number > 0 in m/s"),
        ({"reserve": 1.0}, "reserve 1.0, expected a number from 0 to below 1"),
        (
            {"gear_torque": "x"},
            "gear_torque 'x', expected a sequence of numbers, one for each gear",
        ),
    ],
)
def test_wrong_limits_are_refused(given: dict[str, object], told: str) -> None:
    with pytest.raises(ArgumentError, match=f"limits: given {told}"):
        Limits(**given)
    with pytest.raises(ModelError, match=r"deflection_max.*a spring whose deflection it limits"):
        flexgen.read("elbow", overrides={"element.upper.dof.q1.deflection_max": 1.0})
    with pytest.raises(ModelError, match=r"thermal_time.*torque_rms_max in addition"):
        flexgen.read("elbow", overrides={"motor.m1.thermal_time": 1.0})
    with pytest.raises(
        ArgumentError,
        match=r"given thermal_time \(1.0, 1.0\) alone, expected torque_rms in addition",
    ):
        flexgen.fastest("elbow", limits=Limits(thermal_time=(1.0, 1.0)))  # was ignored


@pytest.mark.parametrize("name", [*EACH])
@pytest.mark.parametrize("bound", [-1.0, 0.0, float("-inf"), float("nan")])
def test_bounds_that_are_not_positive_are_refused_where_they_are_given(
    name: str, bound: float
) -> None:
    given: dict[str, Any] = {name: (1.0, bound)}
    with pytest.raises(ArgumentError, match=name):
        flexgen.Limits(**given)
    with pytest.raises(ArgumentError, match="deflection"):
        flexgen.Limits.from_model("elbow", deflection=bound)  # which has no such coordinate


def test_the_use_of_a_limit_in_words() -> None:
    use = LimitUse("torque", "m1", "N m", 1.0504, 21.00823, 20.0, 0.12345)
    assert str(use) == "torque of m1: 21.01 N m at 0.123 s, 105.0 % of its limit 20 N m"
    assert use.warning() == "m1: torque 21.01 N m exceeds its limit 20 N m"
    mean = LimitUse("effective torque", "m1", "N m", 0.5, 10.0, 20.0, None)
    assert str(mean) == "effective torque of m1: 10 N m, 50.0 % of its limit 20 N m"


def test_bounds_of_limits_are_one_for_each_part() -> None:
    limits = flexgen.Limits(torque=(4.0, 6.0), reserve=0.25, deflection=(0.1,), tool_speed=2.0)
    assert_allclose(limits.bounds("torque", 2), [4.0, 6.0])
    assert_allclose(limits.bounds("gear_torque", 3), np.full(3, np.inf))
    assert_allclose(limits.deflections(1), [0.1])
    less = limits.without("torque", "tool_speed")
    assert less == flexgen.Limits(reserve=0.25, deflection=(0.1,))
    with pytest.raises(ArgumentError) as caught:
        limits.bounds("tool_speed", 1)
    assert str(caught.value).startswith(
        "limits: given kind 'tool_speed', expected one of torque, speed, "
    )
    with pytest.raises(
        ArgumentError, match=r"^limits: given kinds .*tau.*, expected fields of flexgen\.Limits$"
    ):
        limits.without("torque", "tau")
    for size in (-1, 10**9):
        with pytest.raises(
            ArgumentError, match=r"^limits, number of torque bounds: given .*, expected 0 to \d+$"
        ):
            limits.bounds("torque", size)
    for size in (1, 3):
        with pytest.raises(
            ArgumentError,
            match=rf"^limits: given torque \(4\.0, 6\.0\), expected {size} positive numb",
        ):
            limits.bounds("torque", size)
