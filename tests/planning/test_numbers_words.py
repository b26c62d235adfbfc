"""Texts, figures and small numbers of results that are long to compute: from scripted parts,
against written texts.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.causes import levels
from flexgen.identification.load.payload import Load
from flexgen.model.elements import LinearSpring
from flexgen.planning.fastest import minimum_time, rigid_time
from flexgen.planning.learning import learn
from flexgen.planning.learning.commanded import CommandedPath
from flexgen.planning.optimal import arguments, result, signals
from flexgen.planning.optimal.guesses import from_solution
from flexgen.studies.scenarios import bench, draws
from flexgen.studies.scenarios.tune import TuningResult
from flexgen.views.reports.identification_texts import structure_text, verdict_text


class Runs(SimpleNamespace):
    """A run of a closed loop with one robot, `a`."""

    def __getitem__(self, name: str) -> Any:
        assert name == "a"
        return self.lane

    def figures(self, lane: Any) -> dict[str, float]:
        return {"dynamic_error_max_m": lane.dynamic, "dynamic_error_max_rad": lane.dynamic}

    def trajectory(self, name: str) -> str:
        return f"trajectory of {name}, {self.number}"


def learned(monkeypatch: pytest.MonkeyPatch, unit: str, measured_by: str, load: str = "") -> Any:
    sizes = (4e-3, 1e-3, 2e-3)
    lanes = [SimpleNamespace(load=load, dynamic=d) for d in (3e-3, 5e-4, np.nan)]
    solution = SimpleNamespace(move=SimpleNamespace(name="line"))
    runs = tuple(
        Runs(
            unit=unit,
            lane=lane,
            model=SimpleNamespace(name="arm"),
            solution=solution,
            controller="pd",
            number=k,
        )
        for k, lane in enumerate(lanes)
    )
    monkeypatch.setattr(learn, "_largest", lambda run, plant: sizes[run.number])
    made = object.__new__(learn.LearningResult)
    fields = {
        "runs": runs,
        "corrections": (),
        "time": np.zeros(1),
        "best": 1,
        "frequency_hz": 12.5,
        "gain": 0.8,
        "plant": "a",
        "stopped": "the error grows",
        "measured_by": measured_by,
        "measured_errors": (3e-3, 9e-4, 2e-3),
    }
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


def test_learning_is_told_by_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lengths and angles, trackers and accelerometers, the best iteration and why it ended."""
    made = learned(monkeypatch, "m", "tracker")
    assert repr(made) == "<LearningResult arm: 4 mm -> 1 mm>"
    head = "arm, move line: largest error of each iteration, Q 12.5 Hz, gain 0.8"
    assert str(made).splitlines() == [
        head,
        "  0: 4 mm",
        "  1: 1 mm (best)",
        "  2: 2 mm",
        "  the error grows",
    ]
    assert made.errors_m == made.errors == (4e-3, 1e-3, 2e-3) and made.measured_m == (
        3e-3,
        9e-4,
        2e-3,
    )
    assert made.dynamic_errors_m == made.dynamic_errors == (3e-3, 5e-4, np.inf)
    assert made.trajectory == "trajectory of a, 1"
    figures = made.to_dict()
    assert (figures["model"], figures["move"], figures["plant"]) == ("arm", "line", "a")
    assert figures["errors_max_m"] == [4e-3, 1e-3, 2e-3] and figures["measured_errors_max_m"] == [
        3e-3,
        9e-4,
        2e-3,
    ]
    turned = learned(monkeypatch, "rad", "accelerometer", "2 kg")
    assert turned.errors_m == turned.dynamic_errors_m == turned.measured_m == ()
    lines = str(turned).splitlines()
    assert lines[0] == head + ", load 2 kg"
    assert lines[2] == "  1: 1 mrad (best), dynamic 0.5 mrad, estimated 0.9 mrad"


def test_a_margin_for_the_feedback_grows_by_what_torques_exceed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of both signs, of the worst instant of each motor; up to a thousandth of the limit is
    accepted.
    """
    limits = np.array([10.0, 4.0])
    margins = []

    @dataclass(frozen=True)
    class Move:
        solution: np.ndarray
        limits: Any
        margin: tuple[float, ...] = ()

    def find(margin: np.ndarray | None = None) -> Move:
        margins.append(None if margin is None else margin.tolist())
        return Move(
            np.zeros(2) if margin is None else margin, SimpleNamespace(torque=limits.tolist())
        )

    def torques(excess: list[float]) -> Any:
        def of(margin: np.ndarray, progress: Any) -> tuple[np.ndarray, np.ndarray]:
            top = limits + excess - margin
            return np.array([-top, 0 * top]), np.array([0 * top, top * [1.0, 0.2]])

        return lambda name: of

    for excess, expected in (
        ([0.0, 0.0], [None]),
        ([0.0099, 0.0039], [None]),
        ([0.0101, 0.0], [None, [0.0101, 0.0]]),
        ([-5.0, 0.0041], [None, [0.0, 0.0041]]),
        ([2.0, 1.0], [None, [2.0, 1.0]]),
    ):
        margins.clear()
        monkeypatch.setattr(minimum_time, "find_function", torques(excess))
        found = minimum_time._with_margin(find, None)
        assert len(margins) == len(expected) and all(
            a == b or a == pytest.approx(b, abs=1e-12)
            for a, b in zip(margins, expected, strict=True)
        )
        assert found.margin == pytest.approx(expected[-1] or (0.0, 0.0))
    monkeypatch.setattr(minimum_time, "find_function", torques([0.0, 4.0]))
    with pytest.raises(
        SolverError,
        match=r"95 % of the robots needs \[0.0, 4.0\] N m or more of the torque limits",
    ):
        minimum_time._with_margin(find, None)
    monkeypatch.setattr(
        minimum_time, "find_function", lambda name: lambda *_, **__: 2 * [limits[None] + 0.5]
    )
    margins.clear()
    with pytest.raises(SolverError, match=r"95 % of the robots needs \[2.5, 2.5\] N m or more"):
        minimum_time._with_margin(find, None)
    assert len(margins) == 1 + 5  # rounds


def test_causes_of_nonlinear_responses_are_told_with_their_sizes() -> None:
    """A dead band and a slip over the deflection of the gear, both in its unit; a growth in
    percent.
    """
    assert levels._size("backlash", [0.25], 0.8, "mrad") == "+-0.2 mrad"
    assert levels._size("cubic", [0.375], 0.8, "mm") == "38 % more at 0.8 mm rms"
    assert (
        levels._size("hysteresis", [0.125, 1.5], 0.8, "mrad")
        == "12 % of the stiffness slips at 1.2 mrad"
    )


def test_an_error_of_a_pose_has_its_rotation_vector() -> None:
    """Position as it is, rotation from the reference to the tool, both at the samples of the
    path.
    """
    equations = flexgen.derive("elbow")
    q = np.array([[0.1, 0.3], [0.2, 0.5], [0.3, 0.6]])
    R = np.array([np.array(equations.function("forward_kinematics")(x)[1]) for x in q])
    turns = np.array([[0.01, -0.02, 0.03], [0.0, 0.1, 0.0], [0.2, 0.0, 0.1]])
    wanted = np.array(
        [Rotation.from_rotvec(-d).as_matrix() @ r for d, r in zip(turns, R, strict=True)]
    )
    columns = wanted.reshape(3, 9)
    e = np.arange(9.0).reshape(3, 3)
    run: Any = Runs(
        lane=SimpleNamespace(error=e, q_a=q),
        reference=SimpleNamespace(R_ref=columns, time=np.arange(3.0)),
    )
    commanded: Any = SimpleNamespace(equations=equations, time=np.array([0.0, 1.0, 1.5]))
    found = CommandedPath.error(commanded, run, "a")
    assert_allclose(found[:2, :3], e[:2])
    assert_allclose(found[2, :3], (e[1] + e[2]) / 2)
    assert_allclose(found[:2, 3:], turns[:2], atol=1e-9)
    run.reference.R_ref = None
    assert CommandedPath.error(commanded, run, "a").shape == (3, 3)


def test_a_fast_move_and_a_load_are_told_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    class Solved(SimpleNamespace):
        def __str__(self) -> str:
            return "first\n   effort 3\nlast"

    made = object.__new__(minimum_time.FastestMove)
    motors = [SimpleNamespace(name=name) for name in ("m1", "m2")]
    solution = Solved(
        model=SimpleNamespace(name="arm", motors=motors), move=SimpleNamespace(name="line")
    )
    fields = {
        "solution": solution,
        "default": SimpleNamespace(trajectory={"tau_m": np.array([[0.5, 1.0], [-2.5, 0.0]])}),
        "limits": SimpleNamespace(torque=(2.5, 4.0)),
        "default_s": 2.0,
        "duration_s": 1.5,
        "rigid_s": 1.25,
        "excess": 2e-6,
        "programs": 7,
        "inversions": 9,
        "cpu_s": 0.5,
        "vibration": {"as in file": 1e-3},
        "default_vibration": {"as in file": 2e-3},
    }
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    unit = {"of": "m"}
    monkeypatch.setattr(minimum_time, "unit_of", lambda model: unit["of"])
    assert repr(made) == "<FastestMove arm: 2 -> 1.5 s>"
    assert str(made).splitlines() == [
        "arm, move line: 1.5000 s instead of 2.0000 s (25 % less)",
        "  torque limits as of the largest torques of the move as given: m1 2.5 N m",
        "  a rigid robot whose torques may jump needs 1.2500 s",
        "  limits kept to 2.0e-06, 7 programs, 9 inversions, 0.5 s of processor time",
        "  vibration after the path, as in file: 1 mm (2 mm as given)",
        "  effort 3",
    ]
    object.__setattr__(made, "duration_s", 2.44)
    assert "2.4400 s instead of 2.0000 s (22 % more)" in str(made)
    assert made.vibration_m == {"as in file": 1e-3} and made.default_vibration_m == {
        "as in file": 2e-3
    }
    unit["of"] = "rad"
    assert made.vibration_m == made.default_vibration_m == {}
    load = Load(
        1.5,
        0.25,
        np.array([0.01, 0.02, -0.03]),
        np.array([1e-3, 2e-3, 3e-3]),
        2.0,
        np.zeros(3),
        np.zeros(2),
        0.0,
        np.array([[0.7, 1.0], [1.204, 0.95]]),
        file_mass=0.5,
        total_com_sd=np.array([1e-3, 1e-3, 0.4]),
    )
    words = (
        "load 1.500 +- 0.250 kg, center of mass x 10.0 +- 1.0 mm, y 20.0 +- 2.0 mm, z -30.0 +- "
        "3.0 mm in the frame of the last tip\n"
        "this is the difference from the payload of the model file, 0.500 kg; total at the tool "
        "2.000 +- 0.250 kg, center of mass x 0.0 +- 1.0 mm, y 0.0 +- 1.0 mm, z 0.0 +- 400.0 mm "
        "in the frame of the last tip\n"
        "inertia is not identified: the load is taken for a point mass, the inertia of the "
        "payload of the file stays, 0 kg m^2; of both together 0 kg m^2\n"
        "friction of the motors over that of the model: viscous 0.70, 1.00; other 1.20, 0.95"
    )
    assert str(load) == words
    assert str(load.to_dict()["mass"]) == "1.5"


def test_the_time_of_a_mass_between_two_rests_is_that_of_two_parabolas() -> None:
    """Force F on a mass: ``2 sqrt(L m / F)``; with a speed limit v: ``L / v + m v / F``."""
    s = np.linspace(0.0, 2.0, 201)
    column = np.ones((201, 1))
    free = rigid_time._time(
        s, 3.0 * column, 0.0 * column, 0.0 * column, np.array([6.0]), np.full(201, np.inf)
    )
    assert free == pytest.approx(2 * np.sqrt(2.0 * 3.0 / 6.0), rel=5e-3)
    slow = rigid_time._time(
        s, 3.0 * column, 0.0 * column, 0.0 * column, np.array([6.0]), np.full(201, 0.25)
    )
    assert slow == pytest.approx(2.0 / 0.5 + 3.0 * 0.5 / 6.0, rel=5e-3)
    held = rigid_time._time(
        s, 3.0 * column, 0.0 * column, 2.0 * column, np.array([6.0]), np.full(201, np.inf)
    )
    v = np.sqrt(2 * 2.0 / (1 / (4 / 3) + 1 / (8 / 3)))  # 4 N to accelerate, 8 N to brake
    assert held == pytest.approx(v / (4 / 3) + v / (8 / 3), rel=5e-3)


def test_a_tuned_controller_tells_where_it_began() -> None:
    class Scored(SimpleNamespace):
        def __str__(self) -> str:
            return "score of it"

    score = Scored(total=1.25, accepted=True, scenario=SimpleNamespace(name="two_link-1"))
    made = object.__new__(TuningResult)
    for name, value in {
        "score": score,
        "start": Scored(total=2.5, accepted=True),
        "evaluations": 40,
    }.items():
        object.__setattr__(made, name, value)
    assert repr(made) == "<TuningResult two_link-1: 40 evaluations, score 1.2500>"
    assert str(made) == "score of it\n  from 2.5000 in 40 evaluations"
    made.start.accepted = False
    assert str(made) == "score of it\n  from refused in 40 evaluations"
    said: list[str] = []
    bench._add_prefix(said.append, "start 1: ")("half")
    assert said == ["start 1: half"]
    seeds = {draws.secret_seed() for _ in range(40)}
    assert len(seeds) == 40 and all(0 <= x < 2**62 for x in seeds) and max(seeds) > 2**57


def test_meshes_are_counts_lengths_or_nodes() -> None:
    for mesh, nodes in (
        (4, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (1, [0.0, 1.0]),
        (0.5, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (0.6, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (2.0, [0.0, 1.0]),
        ([0, 0.3, 1], [0.0, 0.3, 1.0]),
        ([1e-10, 0.3, 1 + 1e-10], [0.0, 0.3, 1.0]),
    ):
        found = arguments.mesh_nodes(mesh, 2.0)
        assert_allclose(found, nodes)
        assert found[0] == 0.0 and found[-1] == 1.0
    assert len(arguments.mesh_nodes(arguments.MOST, 2.0)) == arguments.MOST + 1
    for bad in (None, True, "8", b"8"):
        with pytest.raises(
            ArgumentError,
            match=r"mesh: given .*, expected a number of intervals, a length in s or relat",
        ):
            arguments.mesh_nodes(bad, 2.0)
    for wrong in (
        [0.0],
        [[0.0, 1.0]],
        [0.0, 0.5, 0.5, 1.0],
        [0.0, 0.6, 0.5, 1.0],
        [0.0, "x"],
        [0.0, np.nan, 1.0],
    ):
        with pytest.raises(ArgumentError, match="expected increasing relative nodes from 0 to 1"):
            arguments.mesh_nodes(wrong, 2.0)
    for off in ([0.1, 1.0], [0.0, 0.9], 0, -1, arguments.MOST + 1, 1e-9, 0.0, -0.5):
        with pytest.raises(ArgumentError, match="mesh"):
            arguments.mesh_nodes(off, 2.0)
    ok = ("p", ["a"], 0.0, 2.0)
    arguments.check_parameter(*ok, 0.0)
    arguments.check_parameter("p", [], -np.inf, np.inf, 1.0)
    for name, known, low, high, guess in (
        (*ok, 2.1),
        (*ok, -0.1),
        (*ok, np.nan),
        ("p", ["p"], 0.0, 1.0, 0.5),
        ("", [], 0.0, 1.0, 0.5),
        (3, [], 0.0, 1.0, 0.5),
        ("p", [], "0", 1.0, 0.5),
        ("p", [], np.nan, 1.0, 0.5),
    ):
        with pytest.raises(ArgumentError, match="parameter"):
            arguments.check_parameter(name, known, low, high, guess)


def test_comparisons_become_expressions_below_zero() -> None:
    for kind in (ca.SX, ca.MX):
        x = kind.sym("x")
        y = kind.sym("y")
        value, equal = signals.split_comparison(x <= 2 * y, "rule")
        assert ca.Function("f", [x, y], [value])(5.0, 2.0) == 1.0 and equal == [False]
        value, equal = signals.split_comparison(x == y, "rule")
        assert ca.Function("f", [x, y], [value])(5.0, 2.0) == 3.0 and equal == [True]
        for bad in (x + y, x, ca.sin(x)):
            with pytest.raises(
                ArgumentError,
                match=r"rule: given .*, expected a comparison such as problem\['v_m'\] <= ",
            ):
                signals.split_comparison(bad, "rule")
    x = ca.SX.sym("x", 2)
    value, equal = signals.split_comparison(ca.vertcat(x[0] < 3, x[1] == 4), "rule")
    assert np.array(ca.Function("f", [x], [value])([5.0, 6.0])).ravel().tolist() == [
        2.0,
        2.0,
    ] and equal == [
        False,
        True,
    ]
    for bad in (3, "x", ca.vertcat(x[0] < 3, x[1])):
        with pytest.raises(ArgumentError, match="expected a comparison"):
            signals.split_comparison(bad, "rule")
    known = ["tau_m", "q_a"]
    assert signals._suggest("tau", known) == "one of tau_m, q_a; did you mean 'tau_m'?"
    assert signals._suggest("zzz", known) == "one of tau_m, q_a"


def test_the_worst_constraint_is_named_with_its_instant() -> None:
    """Excess above or below a bound, in the unit of the row; the instant adds the durations of
    earlier phases.
    """
    made: Any = SimpleNamespace(
        lower=np.array([0.0, -1.0, -np.inf]),
        upper=np.array([0.0, 1.0, 5.0]),
        names=["a", "b", "c"],
        scale=np.array([1.0, 4.0, 1.0]),
        times=np.array([[np.nan, 0.0], [1.0, 0.5], [0.0, 0.25]]),
    )
    layout: Any = SimpleNamespace(theta=slice(1, 3))
    x = np.array([9.0, 2.0, 3.0])

    def words(*g: float) -> str:
        return result.describe_worst(made, SimpleNamespace(g=np.array(g)), x, layout)

    assert words(0.0, 1.0, 4.0).startswith(
        "all constraints hold, the cost is not at its minimum; raise max_iterations"
    )
    assert words(1e-10, 0.0, 0.0).startswith("all constraints hold")
    assert words(0.1, 0.0, 0.0) == "the largest violated constraint is 'a', by 0.1"
    assert words(0.1, -3.0, 0.0) == "the largest violated constraint is 'b', by 0.5 at t = 3.5 s"
    assert words(0.1, 3.0, 9.0) == "the largest violated constraint is 'c', by 4 at t = 0.5 s"
    assert words(np.nan, 3.0, 9.0) == "the largest violated constraint is 'a', by nan"
    phase: Any = SimpleNamespace(number=1, mesh=SimpleNamespace(h=np.array([0.2, 0.5])))
    count = int(np.clip(np.ceil(4.0 * 0.5 / result.CLOSE), result.SAMPLES, result.MOST))
    assert_allclose(result._between(phase, np.array([1.0, 4.0])), (np.arange(count) + 0.5) / count)
    for length, most in ((1e-9, result.SAMPLES), (1e9, result.MOST)):
        assert len(result._between(phase, np.array([1.0, length]))) == most
    equations = flexgen.derive("elbow")
    other: Any = SimpleNamespace(labels={"q_a": ("x",)}, channels={}, meta={"model": "other"})
    with pytest.raises(
        flexgen.SolverError,
        match="guess: given a trajectory of other, expected one of elbow with the",
    ):
        from_solution(equations, other)


def test_the_tables_of_new_springs_can_be_read_again() -> None:
    made = SimpleNamespace
    dof = SimpleNamespace(
        name="q2_x", axis=(0.0, 0.6, -0.8), spring=LinearSpring(1.25e6), damping=375.0
    )
    old = SimpleNamespace(name="q2", axis=(1.0, 0.0, 0.0), spring=None, damping=0.0)
    found: Any = made(
        changes=(
            made(kind="add", name="q2_x", gain=52.0, held_out=0.5, kept=True),
            made(kind="remove", name="q1_y", gain=3.0, held_out=None, kept=False),
        ),
        added=("q2_x",),
        removed=(),
        model=made(elements=[made(name="arm1", dofs=(old,)), made(name="arm2", dofs=(old, dof))]),
        identified=made(vector=made(model=made(name="planar")), status="fitted", cost=1.25),
    )
    text = structure_text(found)
    assert text.startswith(
        "planar: added q2_x, removed nothing\nfit of the result: fitted, cost 1.25 (1 expected)"
    )
    rows = [
        line.split() for line in text.splitlines() if line.split()[:1] in (["add"], ["remove"])
    ]
    assert rows == [["add", "q2_x", "52", "0.5", "kept"], ["remove", "q1_y", "3"]]
    assert (
        text.count("[[element.dof]]") == 1 and "in the element arm2 behind the joint q2:" in text
    )
    (table,) = tomllib.loads(text[text.index("[[element.dof]]") :])["element"]["dof"]
    assert table == {
        "name": "q2_x",
        "type": "rotation",
        "axis": [0.0, 0.6, -0.8],
        "spring": {"type": "linear", "stiffness": 1.25e6},
        "damping": 375.0,
    }


def test_a_verdict_in_words_has_its_quantiles_in_one_unit() -> None:
    def row(model: str, median: float | None, high: float) -> Any:
        parts = {0.5: median, 0.95: high}
        return SimpleNamespace(
            model=model, error_m=(high,), error_rad=None, quantile=lambda part, unit: parts[part]
        )

    rows = (row("before", 2e-3, 5e-3), row("after", None, 1e-4))
    made: Any = SimpleNamespace(known=False, rows=rows, move="line", robots=24)
    text = verdict_text(made)
    assert "of the move line with motor feedback, 24 robots drawn from the covariance:" in text
    assert "median, mm" in text and "95 %, mm" in text and "rad" not in text
    assert [line.split() for line in text.splitlines()[-2:]] == [
        ["before", "2", "5"],
        ["after", "-", "0.1"],
    ]
    assert "24 x the robot of --truth:" in verdict_text(
        SimpleNamespace(**{**vars(made), "known": True})
    )  # type: ignore[arg-type]
