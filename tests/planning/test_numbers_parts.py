"""Small parts of several rooms by hand: trials of controllers, tables of zeros, states of motors,
chains of joints.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.calls.deadline import OutOfTime
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.records import first_period_excess
from flexgen.dynamics.hysteresis.lugre import MotorBristles
from flexgen.exports.mechanisms import on_one_chain
from flexgen.feedback.loop import margins
from flexgen.feedback.loop.hysteresis import States
from flexgen.identification.poses import result as calibrated
from flexgen.identification.records import experiment_file
from flexgen.paths.geometry import redundancy
from flexgen.planning.fastest import minimum_time
from flexgen.planning.optimal import problem as planned
from flexgen.studies.scenarios import bench
from flexgen.studies.scenarios.bench import Bench
from flexgen.views.reports import html


# --- benchmarks ----------------------------------------------------------------------------------
def trial(draws: int, monkeypatch: pytest.MonkeyPatch, **more: Any) -> Any:
    """Two robots, and the nominal one with another gain and another delay; measures are the
    largest outputs.
    """
    outputs = [Made(name="tool", unit="m"), Made(name="elbow", unit="rad")][
        : more.pop("outputs", 1)
    ]
    accept = Made(gain=1.5, delay_s=2e-3, rest=1e-3, torque_noise_Nm=0.5)
    made: Any = object.__new__(Bench)
    made.scenario = Made(
        plants=Made(names=["nominal", "soft"]), accept=accept, delay_s=1e-3, outputs=outputs
    )
    made.draws = [Made(windows=k) for k in range(draws)]
    monkeypatch.setattr(
        bench, "compute_measures", lambda s, windows, z, u: np.array([z.max(), u.max()])
    )
    monkeypatch.setattr(bench, "at_rest", lambda s, windows, z: np.abs(z[-1]))
    names = [Made(name="tool error"), Made(name="torque, peak to peak")]
    monkeypatch.setattr(bench, "measures_of", lambda s: names)
    asked: list[Any] = []

    def simulate(
        controller: Any, lanes: Any, gains: np.ndarray, delays: np.ndarray, draw: Any, tell: Any
    ) -> Any:
        asked.append((lanes, gains.tolist(), delays.tolist(), draw))
        if tell:
            tell("step")
        z = np.zeros((5, 4, len(outputs)))
        u = np.full((5, 4, 1), 0.4)
        z[2] = 0.1 * np.arange(4)[:, None]
        u[2] = 0.5
        for k, value in more.get("last", {}).items():
            z[-1, k, -1] = value
        u[3, 0] = more.get("noise", 0.0)
        return z, u, more.get("failures", ["", "", "", ""])

    monkeypatch.setattr(made, "simulate", simulate)
    return made, asked


def test_robots_of_a_benchmark_have_margins_of_gain_and_delay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, asked = trial(1, monkeypatch)
    lines: list[str] = []
    found = made.run("controller", lines.append)
    assert asked == [([0, 1, 0, 0], [1.0, 1.0, 1.5, 1.0], [1e-3, 1e-3, 1e-3, 2e-3], made.draws[0])]
    assert_allclose(found.values, [[[0.0, 0.5], [0.1, 0.5]]])
    assert found.refused == () and lines == ["step"]
    made, asked = trial(2, monkeypatch, last={1: 2e-3, 3: np.nan}, noise=0.75)
    found = made.run("controller", lines.append)
    reasons = (
        "soft: not at rest in the end: 0.002 m peak to peak, expected 0.001 m",
        "nominal, delay 2 ms: not at rest in the end: nan m peak to peak, expected 0.001 m",
        "nominal: torque noise of 0.75 N m peak to peak, expected at most 0.5 N m",
    )
    assert found.refused == tuple(f"draw {k} of 2, {reason}" for k in (1, 2) for reason in reasons)
    assert lines == ["step", "draw 1 of 2, step", "draw 2 of 2, step"] and found.values.shape == (
        2,
        2,
        2,
    )
    made, _ = trial(1, monkeypatch, last={2: 5e-3, 0: np.nan}, outputs=2)
    text = (
        "nominal, gain 1.5 times as large: elbow not at rest in the end: 0.005 rad peak to "
        "peak, expected 0.001 rad"
    )
    assert (
        text in made.run("controller").refused
        and "nominal: tool error is not a finite number" in made.run("c").refused
    )
    made, _ = trial(
        1, monkeypatch, last={1: np.nan}, failures=["", "soft fell", "", ""], noise=0.75
    )
    assert made.run("controller").refused == ("soft: soft fell", reasons[-1])


# --- reports -------------------------------------------------------------------------------------
def test_zeros_in_a_page_are_pairs_or_real(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a pair the upper one; rounding of either sign, relative to the size of the zero, is
    none.
    """
    monkeypatch.setattr(
        html,
        "html_table",
        lambda head, rows, *numbers: f"{head[0]}: {[tuple(row) for row in rows]}\n",
    )
    monkeypatch.setattr(html, "_complex", lambda z: f"{z.real:g}")
    monkeypatch.setattr(html.plots, "phase_summary", lambda analysis: "minimum phase")
    zeros = [
        1 + 2j,
        1 - 2j,
        3e4 + 1e-6j,
        4e4 - 1e-6j,
        -5e-3 + 1e-6j,
        -6e-3 - 1e-6j,
        7 + 0j,
        1e-12 + 8j,
    ]
    modes = [(12.5, 0.015), (1e-9, 0.5), (40.0, 0.1)]
    analysis: Any = Made(modes=modes, zeros=Made(zeros=zeros, preview_s=0.0123))
    found = html.dynamics_tables(analysis)
    rows = [("1 and its conjugate", "unstable"), ("30000", "unstable"), ("40000", "unstable")]
    rows += [
        ("-0.005 and its conjugate", "stable"),
        ("7", "unstable"),
        ("1e-12 and its conjugate", "on the imaginary axis"),
    ]
    assert f"zero, 1/s: {rows}\n" in found
    assert "mode: [('1', '12.5', '1.5'), ('2', '40', '10')]\n" in found
    text = (
        "<p>Minimum phase. Preview required for exact tracking (14 time constants): 12.3 ms.</p>\n"
    )
    assert found.endswith(text)
    analysis.modes = []
    analysis.zeros = Made(zeros=[], preview_s=0.0)
    assert "<p>No oscillatory mode.</p>" in html.dynamics_tables(analysis)
    assert html.dynamics_tables(analysis).endswith("<p>Minimum phase.</p>\n")


# --- mechanics -----------------------------------------------------------------------------------
def test_states_of_motors_do_not_divide_by_zero_where_there_are_none() -> None:
    motors = MotorBristles(
        *(np.array(x) for x in ([0.0, 2.0, 3.0], [0.0, 2.5, 1.0], [0.0, 0.1, 0.2])),
        *np.zeros((2, 3)),
    )
    layer: Any = Made(
        stiffness=np.array([6.0, 5.0]), slip=np.array([3.0, 0.0]), present=np.array([True, False])
    )
    found = States((layer,), motors)
    levels = [0.0, 2.5, 3.0, 1.0, 2.0, 3.0, 1.0, 2.5, 1.0]  # the larger one, Coulomb, static
    assert_allclose(found.of_motors()[:12], [*levels, 0.0, 0.1, 0.2])
    assert_allclose(found.numbers(), [3.0, 0.0, 2.0, 0.0])


def test_joints_of_one_chain_are_those_of_an_element_and_its_parents() -> None:
    def element(name: str, *joints: str) -> Any:
        return Made(name=name, dofs=[Made(name=joint) for joint in joints])

    elements = [
        element("trunk", "q0"),
        element("left", "q1", "q2"),
        element("right", "q3"),
        element("hand", "q4"),
    ]
    model: Any = Made(
        elements=elements,
        parents={"trunk": "base", "left": "trunk", "right": "trunk", "hand": "left"},
    )
    for joints in (["q0"], ["q0", "q1", "q2", "q4"], ["q4", "q0"], ["q0", "q3"], []):
        assert on_one_chain(model, joints)
    for joints in (["q1", "q3"], ["q0", "q3", "q4"], ["q9"]):
        assert not on_one_chain(model, joints)
    assert on_one_chain(flexgen.read("manutec_r3"), ["q1", "q2", "q3"])


@pytest.mark.parametrize(("factor", "seen"), [(0.98, False), (1.02, True)])
def test_a_transient_is_one_beyond_six_deviations_of_the_ratio(factor: float, seen: bool) -> None:
    """All lines of the same power: the ratio of two means of ``count`` real numbers scatters by
    sqrt(4 / count).
    """
    lines = 50
    records = 3
    count = 2 * records * lines
    ratio = 1.0 + factor * 6.0 * np.sqrt(4 / count)
    X = (
        np.cumsum(
            np.stack([np.zeros((records, lines, 1)), *[np.ones((records, lines, 1))] * 3], axis=1),
            axis=1,
        )
        + 0j
    )
    X[:, 0] = X[:, 1] - np.sqrt(ratio)
    expected = ratio if seen else 1.0
    assert_allclose(first_period_excess(X), [expected])
    assert_allclose(first_period_excess(X[:, :2]), [1.0])


# --- bounds of arguments -------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"coefficients": 3}, "coefficients: given 3, expected 4 to 60"),
        ({"coefficients": 61}, "coefficients: given 61, expected 4 to 60"),
        ({"torque_rate": 0.0}, "torque_rate: given 0.0, expected a number > 0"),
        (
            {"against": "95 %"},
            "against: given elbow without a table [uncertainty], expected one in its file",
        ),
        (
            {"against": "95 %", "force": np.zeros((5, 3))},
            "against: given with a force, expected one of both: the",
        ),
        (
            {"time_limit": -1.0},
            "time_limit: given -1.0, expected a time >= 0 in s; None or 0: no limit",
        ),
        (
            {"vibration": 0.0},
            (
                "vibration: given 0.0, expected a size > 0 in m, or rad where the output has no "
                "lengths"
            ),
        ),
        ({"against": "90 %"}, "against: given '90 %', expected '95 %' or None"),
    ],
)
def test_arguments_of_fastest_have_bounds(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        flexgen.fastest("elbow", **given)
    assert str(caught.value).startswith(text)


def test_fastest_keeps_a_margin_for_robots_of_a_table_without_curves() -> None:
    """The torques that feedback needs are not known over the speed."""
    table = {"uncertainty": {"stiffness": 0.1}}
    curves = {"motor.m1.torque_speed": [[0.0, 9.0], [300.0, 3.0]]}
    robot = flexgen.read("elbow", overrides=table | curves)
    with pytest.raises(ArgumentError) as caught:
        flexgen.fastest(robot, against="95 %")
    text = "against: given with torque-speed curves, expected none; Limits(reserve=) leaves torque"
    assert str(caught.value) == text


def test_a_search_for_the_fastest_move_ends_with_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def find(robot: Any, move: Any, asked: Any, progress: Any) -> None:
        raise OutOfTime("in the middle")

    monkeypatch.setattr(minimum_time, "_find_fastest", find)
    with pytest.raises(SolverError) as caught:
        flexgen.fastest("elbow", time_limit=2.5)
    assert str(caught.value) == (
        "fastest: the time limit of 2.5 s is over (in the middle); allow more with time_limit= "
        "(--time-limit SECONDS), or take fewer coefficients"
    )


@pytest.mark.parametrize("count", [4, 60])
def test_fastest_takes_the_stated_counts(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(
        minimum_time, "_find_fastest", lambda robot, move, given, progress: asked.append(given)
    )
    flexgen.fastest("elbow", coefficients=count, torque_rate=1e-3, vibration=1e-9, time_limit=0.0)
    assert asked == [minimum_time._Asked(None, 1e-3, 1e-9, count, None)]


@pytest.mark.parametrize(
    ("sample_s", "count", "transients", "parts", "text"),
    [
        (0.01, 100, 0, 5, ""),
        (0.01, 79, 1, 2, ""),
        (0.02 / 3, 90, 0, 3, ""),
        (
            0.01,
            59,
            1,
            0,
            "given 59 samples, expected at least two periods of 20 samples after 1 transient ones",
        ),
        (
            0.0099,
            100,
            0,
            0,
            (
                "given a sample time of 0.0099 s, expected a whole number of samples in "
                "period_s = 0.2 s, "
            ),
        ),
        (
            0.2,
            100,
            0,
            0,
            (
                "given a sample time of 0.2 s, expected a whole number of samples in period_s = "
                "0.2 s, not 1"
            ),
        ),
    ],
)
def test_recordings_are_cut_into_whole_periods(
    sample_s: float, count: int, transients: int, parts: int, text: str
) -> None:
    x = np.arange(float(count))[:, None]
    names = ("tau_m", "q_m", "signals", "references")
    same = dict.fromkeys(names, x)
    recording: Any = Made(
        file="run.npz", t=x[:, 0], sample_s=sample_s, periods_before=None, **same
    )
    if text:
        with pytest.raises(ArgumentError) as caught:
            experiment_file._parts(recording, 0.2, transients, True)
        assert str(caught.value).startswith(f"run.npz: {text}")
        return
    n = round(0.2 / sample_s)
    for found in experiment_file._parts(recording, 0.2, transients, True):
        assert found.shape == (parts, n, 1)
        assert_allclose(found[:, 0, 0], n * (transients + np.arange(parts)))
    halves = experiment_file._parts(recording, 0.2, transients, False)[0]
    assert_allclose(halves[:, 0, 0], np.arange(transients * n, count - n + 1, n // 2))


def test_the_largest_stable_value_is_found_by_halves() -> None:
    asked: list[float] = []

    def stable(value: float) -> bool:
        asked.append(value)
        return value < 2.7

    found = margins._find_largest(stable, 1.0, [2.0, 4.0, 8.0])
    assert (
        2.7 - 2.0 / 2**margins.BISECTIONS <= found < 2.7
        and asked[:2] == [2.0, 4.0]
        and 8.0 not in asked
    )
    assert margins._find_largest(lambda x: True, 1.0, [2.0]) == np.inf
    assert (
        margins._find_largest(lambda x: x <= 1.0, 1.0, np.array([2.0]))
        < 1.0 + 1.1 / 2**margins.BISECTIONS
    )


def test_a_calibrated_model_is_of_the_same_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(
        calibrated,
        "read",
        lambda file, variant, overrides: asked.append((file, variant, overrides)),
    )
    monkeypatch.setattr(calibrated.Calibration, "changes", property(lambda self: {"key": 1.0}))
    for variant, expected in (("stiff", "stiff"), ("", None)):
        made = object.__new__(calibrated.Calibration)
        nominal = Made(file="arm.toml", variant=variant, overrides={}, text="{}")
        object.__setattr__(made, "nominal", nominal)
        assert made.model is None and asked[-1] == ("arm.toml", expected, {"key": 1.0})
    object.__setattr__(made, "nominal", Made(file="", variant=""))
    text = (
        "calibration: given a model without a file, expected one that was read from a .toml file"
    )
    with pytest.raises(ArgumentError) as caught:
        _ = made.model
    assert str(caught.value) == text


def test_a_redundant_arm_moves_its_free_joints_as_little_as_it_can() -> None:
    made: Any = object.__new__(redundancy._Follower)
    made.free = np.array([True, False, True, True])
    jacobian = np.array([[1.0, 9.0, 2.0, 0.0], [0.0, 9.0, 1.0, 1.0]])
    rate = np.array([0.3, -0.2])
    found = made._solve_least_norm(jacobian, rate, 0.25)
    assert_allclose(found[made.free], np.linalg.pinv(jacobian[:, made.free]) @ rate)
    assert found[1] == 0.0
    jacobian[1] = 2 * jacobian[0] + 1e-14
    with pytest.raises(SolverError) as caught:
        made._solve_least_norm(jacobian, rate, 0.256)
    assert str(caught.value) == "redundant arm: a singular pose after 25.6 % of the path"


@pytest.mark.parametrize("timing", planned.TIMINGS)
@pytest.mark.parametrize("scheme", list(planned.SCHEMES))
def test_a_plan_with_free_timing_needs_a_path_over_its_parameter(
    timing: str, scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which is asked for before the problem is made; torques of one scheme are continuous."""
    asked: list[Any] = []
    monkeypatch.setattr(
        planned.reference_curve, "path_by_parameter", lambda path: asked.append(path.duration)
    )
    monkeypatch.setattr(
        planned, "PlanProblem", lambda *given: Made(given=given, torque_continuous=False)
    )
    made: Any = flexgen.plan_problem(
        "elbow", "line", timing=timing, scheme=scheme, mesh=10, limits=False
    )  # type: ignore[arg-type]
    assert asked == [1.0] * (timing == "free") and made.torque_continuous == (
        scheme == "hermite-simpson"
    )
    assert made.given[4:] == (timing, None, False, None) and len(made.given[2]) == 11
