"""Figures of paths, sweeps and runs by hand: accuracy on straight lines, rows of tables, steps of
texts, defaults.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.analysis.printing.elements import Shift, Symbols, Turn, placement_steps
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.spec.toml_lines import Entry
from flexgen.feedback.loop import robustness
from flexgen.identification.rigid.rigid_body import identify_rigid
from flexgen.model.elements import Placement
from flexgen.model.format.format_robot import HARMONICS
from flexgen.model.urdf.joint_defaults import merge
from flexgen.paths.accuracy.figures import CRUISING, path_accuracy
from flexgen.planning.learning import commanded
from flexgen.studies.sweeps import batches

T = np.linspace(0.0, 2.0, 2001)
PATH_END = 1.0


def line(direction: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """A straight line with a smooth start and end, and a direction across it."""
    d = np.array(direction) / np.linalg.norm(direction)
    s = np.clip(T / PATH_END, 0.0, 1.0)
    way = s**3 * (10 - 15 * s + 6 * s * s)
    normal = np.cross(d, [0.3, -0.5, 0.8])
    return way[:, None] * 2.0 * d, normal / np.linalg.norm(normal)


@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [1.0, -2.0, 0.5]])
def test_offsets_of_robots_are_across_the_path(direction: list[float]) -> None:
    """Two robots beyond and one along it: a lag counts for nothing, a drift to the side does."""
    reference, normal = line(direction)
    sideways = np.array([1e-3, 3e-3, 2e-3])
    late = np.stack([np.interp(T - 0.02, T, x) for x in reference.T], axis=-1)
    attained = np.stack(
        [
            reference + sideways[0] * normal,
            late + sideways[1] * normal,
            reference + sideways[2] * normal,
        ]
    )
    found = path_accuracy(T, reference, attained, PATH_END, robots=("a", "b", "c"))
    assert found.path_accuracy == pytest.approx(2e-3, rel=1e-3)
    assert_allclose(found.path_errors, sideways, rtol=1e-3)  # type: ignore[arg-type]
    spread = np.abs(sideways - 2e-3)
    assert found.path_repeatability == pytest.approx(
        spread.mean() + 3 * spread.std(ddof=1), rel=1e-2
    )
    assert found.pose_accuracy == pytest.approx(2e-3) and found.robots == ("a", "b", "c")
    alone = path_accuracy(T, reference, attained[1:2], PATH_END, robots=("b",))
    assert (
        alone.path_accuracy == pytest.approx(3e-3, rel=1e-3) and alone.path_repeatability is None
    )
    still = path_accuracy(
        T, 0 * reference, 0 * attained + 1e-3 * normal, PATH_END, robots=("a", "b", "c")
    )
    assert (
        still.path_accuracy is None
        and still.path_errors == (None,) * 3
        and still.pose_accuracy == pytest.approx(1e-3)
    )
    for wrong in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ArgumentError, match=r"^band: given .*, expected a number > 0 \[m\]$"):
            path_accuracy(T, reference, attained, PATH_END, robots=("a", "b", "c"), band=wrong)


def test_settling_begins_at_the_end_of_the_path() -> None:
    """A step to the side that dies out, enters the band and stays; one that drifts does not
    settle.
    """
    reference, normal = line([1.0, 0.0, 0.0])
    after = np.clip(T - PATH_END, 0.0, None)
    swing = 1e-2 * np.exp(-5 * after) * (T >= PATH_END)
    found = path_accuracy(
        T,
        reference,
        (reference + swing[:, None] * normal)[None],
        PATH_END,
        robots=("a",),
        band=1e-3,
    )
    rest = 1e-2 * np.exp(-5.0)
    inside = after[(np.abs(swing - rest) <= 1e-3) & (after > 0)][0]
    assert found.settling_s[0] == pytest.approx(inside, abs=2e-3) and found.overshoots == (0.0,)
    assert found.drifts[0] == pytest.approx(1e-2 * np.exp(-2.5) - rest, rel=1e-2)
    late = 5e-3 * after[:, None] * normal
    drifting = path_accuracy(
        T, reference, (reference + late)[None], PATH_END, robots=("a",), band=1e-3
    )
    assert drifting.settling_s == (None,) and drifting.stabilizations_s == (None,)
    calm = path_accuracy(T, reference, reference[None], PATH_END, robots=("a",), band=1e-3)
    assert calm.settling_s == (0.0,) and calm.drifts[0] == pytest.approx(0.0, abs=1e-12)


def test_speeds_and_turns_along_a_path() -> None:
    """A robot that is 2 % faster where the path cruises; turned tools about each axis."""
    s = np.clip(T, 0.0, 1.0)
    reference = np.stack([s, 0 * s, 0 * s], axis=-1)
    attained = np.stack([1.02 * reference, 1.02 * reference])
    R_ref = np.tile(np.eye(3), (len(T), 1, 1))
    turns = np.array([[1e-3, -2e-3, 3e-3], [3e-3, -2e-3, 1e-3]])
    R = np.stack([np.tile(Rotation.from_rotvec(x).as_matrix(), (len(T), 1, 1)) for x in turns])
    found = path_accuracy(T, reference, attained, 1.0, robots=("a", "b"), orientations=(R_ref, R))
    assert found.speed_accuracy == pytest.approx(
        0.02, rel=2e-2
    ) and found.speed_repeatability == pytest.approx(0.0)
    assert CRUISING == 0.95
    assert_allclose(found.orientation_accuracy, [2e-3, -2e-3, 2e-3], atol=1e-9)
    assert_allclose(
        found.orientation_repeatability,
        [3 * np.sqrt(2) * 1e-3, 0.0, 3 * np.sqrt(2) * 1e-3],
        atol=1e-9,
    )  # type: ignore[arg-type]
    assert_allclose(found.orientation_path_accuracy, [2e-3, 2e-3, 2e-3], atol=1e-9)


# --- runs ----------------------------------------------------------------------------------------
def test_figures_of_a_run_of_the_robustness_study(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the start, the largest, against the start, and at the end of the path; infinite where the
    run fails.
    """
    made: Any = object.__new__(robustness._Run)
    made.equations = None
    made.path = SimpleNamespace(duration=0.5)
    t = np.array([0.0, 0.25, 0.5, 0.75])
    error = np.array([[3.0, 4.0], [0.0, 13.0], [6.0, 8.0], [0.0, 1.0]])
    made._integrate = lambda: (t, "q_a", 7.0)
    monkeypatch.setattr(robustness, "output_errors", lambda equations, path, t, q_a: {"m": error})
    found = made.figures()
    assert found == {
        "error_max_m": 13.0,
        "error_max_rad": None,
        "error_start_m": 5.0,
        "error_start_rad": None,
        "error_moved_m": pytest.approx(np.hypot(3.0, 9.0)),
        "error_moved_rad": None,
        "error_end_m": 10.0,
        "error_end_rad": None,
        "torque_max_Nm": 7.0,
    }
    made.path.duration = 2.0  # beyond the run: its last instant
    assert made.figures()["error_end_m"] == 1.0

    def fail() -> Any:
        raise SolverError("no")

    made._integrate = fail
    assert set(made.figures().values()) == {np.inf}


def test_iterations_of_learning_have_other_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True)
    class Case:
        model: Any
        library: Any
        plants: Any
        seed: int
        reference: Any = None
        rests: Any = None
        force: Any = None

    made: Any = object.__new__(commanded.CommandedPath)
    plants = SimpleNamespace(values="values")
    made._case = Case(SimpleNamespace(name="arm"), "library", plants, 40)
    made._correct = lambda correction: (correction, 2 * correction, 3 * correction)
    asked: dict[str, Any] = {}

    def invert(y: Any, dy: Any, ddy: Any, **given: Any) -> str:
        asked.update(given, y=y)
        return SimpleNamespace(t=np.array([-1.0, 2.0]))

    vars(made).update(
        library=SimpleNamespace(invert=invert),
        _force=None,
        _signals="signals",
        period=1e-3,
        path=SimpleNamespace(q_start="start"),
        n_pre=3,
        n_post=4,
        samples_per_interval=2,
        time=np.array([0.25, 1.0]),
        sample_s=1e-3,
        delay_s=0.0,
        _grid="grid",
        _local=SimpleNamespace(rests=lambda motion, values: (motion, values)),
    )
    monkeypatch.setattr(
        commanded, "trajectory_of", lambda found, first, name, force: (force, first, name)
    )
    reference = SimpleNamespace(motion="motion")
    monkeypatch.setattr(
        commanded, "motion_reference", lambda *given: asked.update(given=given) or reference
    )
    case = made.case(np.ones(2), 3)
    assert case.seed == 43 and case.reference is reference and case.rests == ("motion", "values")
    assert (
        asked["given"][0] == (None, 0.25, "arm")
        and asked["n_pre"] == 3
        and asked["samples_per_interval"] == 2
    )
    assert asked["given"][-1] == "signals" and made.case(np.ones(2), 0).seed == 40
    made._case = replace(made._case, force=SimpleNamespace(at=lambda t: 2 * t))
    made._force = "on the output"
    monkeypatch.setattr(
        commanded, "resting", lambda reference, *given: SimpleNamespace(motion=given)
    )
    assert (
        made.case(np.ones(2), 0).rests[0] == (made._local, "v")
        and asked["force"] == "on the output"
    )
    assert_array_equal(asked["given"][0][0], [-1.5, 4.5])


def test_rows_of_moves_in_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Largest of the motors, work of all; nothing is iterated and nothing begins before the
    path.
    """
    peaks = SimpleNamespace(
        torque_max=np.array([[1.0, 3.0], [5.0, 2.0]]),
        torque_rms=np.array([[0.5, 0.25], [1.0, 2.0]]),
        speed_max=np.array([[7.0, 8.0], [9.0, 6.0]]),
        energy=np.array([[1.0, 2.0], [3.0, 4.0]]),
    )
    monkeypatch.setattr(batches, "_beyond", lambda *given: np.array([False, True]))
    monkeypatch.setattr(
        batches, "_warnings", lambda robot, peaks, starts, ends, k: (f"row {k}", "more")
    )
    mover: Any = SimpleNamespace(peaks=lambda starts, ends: peaks, n=201)
    robot: Any = None
    found = batches.figures(robot, mover, np.zeros((2, 2)), np.ones((2, 2)))
    same = {
        "method_used": "closed-form",
        "verdict": "not verified",
        "iterations": 0,
        "samples": 201,
        "preactuation": 0.0,
    }
    assert found[0] == same | {
        "status": "solved",
        "torque_max": 3.0,
        "torque_rms": 0.5,
        "speed_max": 8.0,
        "energy": 3.0,
        "warnings": "",
    }
    assert found[1] == same | {
        "status": "limits exceeded",
        "torque_max": 5.0,
        "torque_rms": 2.0,
        "speed_max": 9.0,
        "energy": 7.0,
        "warnings": "row 1\nmore",
    }


# --- texts and files -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    "angles", [(0.3, -0.4, 0.5), (np.pi / 2, 0.2, -np.pi / 2), (np.pi, 0.0, 0.7), (0.0, 0.0, 0.0)]
)
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.1, 0.0, -0.2)])
def test_steps_of_a_placement_are_its_rotation(
    angles: tuple[float, ...], shift: tuple[float, float, float]
) -> None:
    """Turns about z, y, x in this order, quarters as whole numbers, others as symbols with their
    values.
    """
    R = Rotation.from_euler("ZYX", angles).as_matrix()
    symbols = Symbols()
    steps = placement_steps(
        symbols, "r", "arm", Placement(shift, tuple(map(tuple, R.tolist()))), "place"
    )  # type: ignore[arg-type]
    assert isinstance(steps[0], Shift) == any(shift) if steps else not any(shift)
    turns = [step for step in steps if isinstance(step, Turn)]
    values = {entry.symbol: entry.value for entry in symbols.entries}
    found = np.eye(3)
    for turn in turns:
        quarter = isinstance(turn.angle, int)
        angle = turn.angle * np.pi / 2 if isinstance(turn.angle, int) else values[turn.angle]
        assert quarter == (abs(angle / (np.pi / 2) - round(angle / (np.pi / 2))) < 1e-9)
        assert quarter or isinstance(turn.angle, sp.Symbol)
        found = found @ Rotation.from_euler("xyz"[turn.axis], angle).as_matrix()
    assert_allclose(found, R, atol=1e-12)
    assert [turn.axis for turn in turns] == sorted((turn.axis for turn in turns), reverse=True)
    assert len(turns) == sum(angle != 0.0 for angle in angles)


def test_defaults_of_joints_fill_what_a_joint_does_not_state() -> None:
    """Tables of the same type are merged, those of another one replace it; a spring excludes gear
    and motor.
    """

    def entry(value: Any, line: int = 1) -> Entry:
        wrapped = (
            {k: entry(v, line) for k, v in value.items()} if isinstance(value, dict) else value
        )
        return Entry(wrapped, line)

    def plain(table: dict[str, Entry]) -> dict[str, Any]:
        return {
            k: plain(e.value) if isinstance(e.value, dict) else e.value for k, e in table.items()
        }

    def merged(default: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
        return plain(merge(entry(default).value, entry(own, 2).value))

    assert merged({"a": 1, "b": 2}, {"b": 3}) == {"a": 1, "b": 3}
    gear = {"gear": {"type": "x", "ratio": 100, "loss": 1}}
    assert merged(gear, {"gear": {"ratio": 50}}) == {"gear": {"type": "x", "ratio": 50, "loss": 1}}
    assert merged(gear, {"gear": {"type": "x", "ratio": 50}}) == {
        "gear": {"type": "x", "ratio": 50, "loss": 1}
    }
    assert merged(gear, {"gear": {"type": "y"}}) == {"gear": {"type": "y"}}
    assert merged({"gear": {"ratio": 100}}, {"gear": {"type": "y"}}) == {"gear": {"type": "y"}}
    assert merged({"gear": {"ratio": 100}}, {"gear": {"loss": 2}}) == {
        "gear": {"ratio": 100, "loss": 2}
    }
    spring = {"spring": {"stiffness": 3}}
    assert merged(gear | {"motor": {"inertia": 1}, "a": 1}, spring) == spring | {"a": 1}
    assert merged(gear, {"gear": 5}) == {"gear": 5}
    found = merge(entry(gear).value, entry({"gear": {"ratio": 50}}, 7).value)
    assert found["gear"].line == 7 and found["gear"].value["loss"].line == 1


def test_harmonics_of_counterbalances_are_counted() -> None:
    model = flexgen.read("elbow")
    words = (
        f"counterbalance: given {HARMONICS} harmonics for 'q1', expected {HARMONICS - 1} at most"
    )
    with pytest.raises(ArgumentError) as caught:
        identify_rigid(model, [], counterbalance={"q1": HARMONICS})
    assert str(caught.value) == words
    for given in ({"q9": 1}, {"q1": 0}, {"q1": 1.5}):
        with pytest.raises(
            ArgumentError, match=r"^counterbalance: given .*, expected one of q1, q2 and >= 1$"
        ):
            identify_rigid(model, [], counterbalance=given)
    with pytest.raises(
        ArgumentError, match=r"^motions, prior: expected at least one motion and a deviation > 0$"
    ):
        identify_rigid(model, [], counterbalance={"q1": HARMONICS - 1})
    motion: Any = SimpleNamespace(q=np.zeros((3, 2)), tau_m=np.zeros((3, 3)))
    with pytest.raises(
        ArgumentError, match=r"^motion: given 2 joints and 3 motors, expected 2, 2$"
    ):
        identify_rigid(model, [motion])
