"""The verbs score and kinematics with the search behind them replaced: what they ask for, print
and refuse.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from verb_arguments import arguments

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.verbs import control as verbs
from flexgen.paths.inverse_kinematics import forward, search
from flexgen.paths.inverse_kinematics.tool_pose import ToolPose
from flexgen.studies.scenarios import leaderboard, scenario_file
from flexgen.views.reports.texts import configurations_text

scoring = importlib.import_module("flexgen.studies.scenarios.score")


SETS = tuple(scenario_file.scenario("four_mass").sets)


class Scored:
    """A score that was made up."""

    def __init__(self, controller: str, total: float, refused: tuple[str, ...] = ()) -> None:
        self.controller = controller
        self.total = total
        self.worst = total + 2
        self.spread = 0.25
        self.parts = {name: 7.0 for name in ("nominal", *SETS)}
        self.rule = ""
        self.refused = refused
        self.accepted = not refused
        self.ended = ""
        self.wall_s = 0.5
        self.table: list[Any] = []

    def to_dict(self) -> dict[str, Any]:
        return {"V": self.total}

    def report(self, path: str) -> str:
        return f"{path}/index.html"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Calls of a replaced `score`; controllers whose names begin with ``no`` are refused."""
    calls: list[Any] = []

    def score(chosen: Any, name: str, *, seed: int, progress: Any) -> Scored:
        calls.append((chosen.name, name, seed))
        return Scored(name, 3.0 - len(calls), ("too slow",) if name.startswith("no") else ())

    monkeypatch.setattr(scoring, "score", score)
    return calls


def test_scores_of_several_controllers(asked: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        leaderboard,
        "find_shipped_controllers",
        lambda name, version: {"a": Path("a"), "b": Path("b")},
    )
    said: list[str] = []
    given = {"scenario": "four_mass", "controller": ["all", "no"], "seed": 5, "time_limit": None}
    answer = verbs.score(arguments("score", **given), said.append)
    assert asked == [("four_mass", name, 5) for name in ("reference", "a", "b", "no")]
    assert said == [f"score: {name}" for name in ("reference", "a", "b", "no")]
    chosen = scenario_file.scenario("four_mass")
    assert answer.problem == "" and answer.data["scores"] == [
        {"V": 2.0},
        {"V": 1.0},
        {"V": 0.0},
        {"V": -1.0},
    ]
    assert [answer.data[key] for key in ("scenario", "version", "hash")] == [
        "four_mass",
        2,
        chosen.digest,
    ]
    lines = [line.split() for line in answer.text.splitlines()]
    first = next(k for k, line in enumerate(lines) if line[:2] == ["controller", "V"])
    assert lines[first][2:5] == ["worst", "draw", "spread"]
    found = [line for line in lines[first:] if line and line[0] in ("reference", "a", "b", "no")]
    assert [line[0] for line in found[:4]] == ["b", "a", "reference", "no"]
    assert found[0][1:5] == ["0", "2", "0.25", "7"] and found[3][1] == "refused"
    assert answer.text.endswith("no is refused: too slow") and "wrote" not in answer.text


def test_refused_controllers_are_a_failure_where_no_other_is_left(asked: list[Any]) -> None:
    given: dict[str, Any] = {
        "scenario": "four_mass",
        "controller": ["no", "nor"],
        "seed": 0,
        "time_limit": None,
    }
    assert verbs.score(arguments("score", **given), print).problem == "refused: no, nor"
    del asked[:]
    given["controller"] = None
    answer = verbs.score(arguments("score", **given, report="r"), print)
    assert asked == [("four_mass", "reference", 0)] and answer.text.endswith(
        "\n\nwrote r/index.html"
    )
    given["controller"] = ["a", "b"]
    with pytest.raises(ArgumentError) as refused:
        verbs.score(arguments("score", **given, report="r"), print)
    assert str(refused.value) == "--report: given 2 controllers, expected one"


def test_controllers_that_come_with_a_benchmark(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Those for a later version replace the first ones, and are not offered to a version
    before.
    """
    (tmp_path / "controllers").mkdir()
    for name in ("x-ppi", "x-2-ppi", "x-2-new", "x-3-newest", "y-other"):
        (tmp_path / "controllers" / f"{name}.toml").touch()
    monkeypatch.setattr(leaderboard, "FOLDER", tmp_path)
    for version, expected in (
        (1, {"ppi": "x-ppi"}),
        (2, {"ppi": "x-2-ppi", "new": "x-2-new"}),
        (3, {"ppi": "x-2-ppi", "new": "x-2-new", "newest": "x-3-newest"}),
    ):
        found = leaderboard.find_shipped_controllers("x", version)
        assert {name: path.stem for name, path in found.items()} == expected
    assert leaderboard.find_shipped_controllers("x").keys() == {"ppi", "new"}


# --- kinematics ----------------------------------------------------------------------------------
FLAGS = (1, -1, 1)


def configuration(**more: Any) -> Any:
    own = {
        "q": np.array([0.5, -0.25]),
        "flags": FLAGS,
        "distance": 0.01234,
        "nearest_singularity": "elbow",
    }
    own |= {"singular": False, "within_limits": True, "to_dict": lambda: {"q": [0.5, -0.25]}}
    return Made(**(own | more))


def asked_for(
    monkeypatch: pytest.MonkeyPatch, found: list[Any], **given: Any
) -> tuple[Any, list[Any]]:
    """The answer of the verb, and the arguments of the search behind it."""
    calls: list[Any] = []

    def kinematics(model: Any, position: Any, rotation: Any, *, fixed: Any, sag: Any) -> list[Any]:
        calls.append((model.name, np.asarray(position), np.asarray(rotation), fixed, sag))
        return found

    monkeypatch.setattr(search, "kinematics", kinematics)
    names = {
        "command": None,
        "joints": None,
        "position": None,
        "rotation": None,
        "fixed": None,
        "sag": False,
    }
    args = arguments("kinematics", model="elbow", **(names | given))
    args.given = list(given)
    return verbs.kinematics(args, lambda text: None), calls


def test_configurations_of_a_position(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rotation vector along z turns the tool about z; without one the axes of the tool are those
    of the world.
    """
    answer, calls = asked_for(
        monkeypatch,
        [configuration()],
        position=[1.0, 2.0, 3.0],
        rotation=[0, 0, 0.5],
        fixed=[("q3", 0.5)],
        sag=True,
    )
    (name, position, rotation, fixed, sag) = calls[0]
    assert (name, fixed, sag) == ("elbow", {"q3": 0.5}, True)
    assert_allclose(position, [1, 2, 3], rtol=1e-15)
    assert_allclose(
        rotation[:2, :2], [[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]], rtol=1e-14
    )
    assert answer.text.startswith("elbow: 1 configurations at ") and answer.problem == ""
    assert answer.data["model"] == "elbow" and answer.data["configurations"] == [
        {"q": [0.5, -0.25]}
    ]
    answer, calls = asked_for(monkeypatch, [], position=[1.0, 2.0, 3.0])
    assert_allclose(calls[0][2], np.eye(3), atol=1e-15)
    assert calls[0][3:] == ({}, False) and answer.text == ""
    assert (
        answer.problem.startswith("the pose cannot be reached: ")
        and answer.data["configurations"] == []
    )


def test_configurations_at_the_pose_of_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    pose = ToolPose.of_vectors
    monkeypatch.setattr(
        ToolPose, "of_joints", lambda model, q, log: pose([*q, 3.0], [0.0, 0.0, 0.0])
    )
    answer, calls = asked_for(monkeypatch, [configuration()] * 2, joints=[0.5, -0.25])
    assert_allclose(calls[0][1], [0.5, -0.25, 3.0])
    assert answer.text.startswith("elbow: 2 configurations at ")
    both: dict[str, Any] = {"joints": [0.0, 0.0], "position": [1.0, 0.0, 0.0]}
    given: dict[str, Any]
    for given in ({}, both):
        with pytest.raises(ArgumentError) as refused:
            asked_for(monkeypatch, [], **given)
        assert (
            str(refused.value)
            == "kinematics: expected either --joints or --position (and --rotation)"
        )
    for option, given in (
        ("--joints", {"joints": [0.0, 0.0], "rotation": [0.0, 0.0, 1.0]}),
        ("--command", {"command": [0.0, 0.0], "sag": True}),
    ):
        with pytest.raises(
            ArgumentError, match=f"^{option}: given with --(rotation|sag), expected without"
        ):
            asked_for(monkeypatch, [], **given)


@pytest.mark.parametrize("sensors", [(), ("a", "b")])
def test_trackers_at_rest_and_their_sag(
    monkeypatch: pytest.MonkeyPatch, sensors: tuple[str, ...]
) -> None:
    """Positions in meters, the difference from a stiff robot in millimeters."""
    stiff = np.arange(6.0).reshape(2, 3)[: max(len(sensors), 1)]
    sag = np.full_like(stiff, [1e-3, 0.0, -2e-3])
    at = {True: stiff + sag, False: stiff}
    monkeypatch.setattr(forward, "tracker_positions", lambda model, q, sag=True: [at[sag]])
    own: Any = Made(
        name="r",
        title="r@v",
        sensors=[Made(name=n, type="tracker") for n in sensors] + [Made(name="f", type="force")],
    )
    answer = verbs._command(own, [0.5, 0.25])
    names = list(sensors) or ["tool"]
    assert (
        answer.data["names"] == names
        and answer.data["command"] == [0.5, 0.25]
        and answer.data["model"] == "r"
    )
    assert_allclose(answer.data["position_m"], stiff + sag, rtol=1e-15)
    assert_allclose(answer.data["sag_m"], sag, atol=1e-15)
    lines = answer.text.splitlines()
    assert lines[0] == "r@v: at rest under gravity, motors at [0.5, 0.25]"
    assert lines[-len(names)].split() == [names[0], "0.001", "1", "1.998", "1", "0", "-2"]


def test_configurations_as_a_table() -> None:
    robot = flexgen.read("elbow")
    singular = configuration(singular=True, within_limits=False, distance=0.5)
    lines = configurations_text(robot, [configuration(), singular]).splitlines()
    assert lines[0].split("  ")[0].strip() == "q1, rad" and lines[0].endswith(
        "singularity distance"
    )
    assert lines[-2].split() == ["0.5", "-0.25", "yes", "+1", "-1", "+1", "0.0123", "elbow"]
    assert lines[-1].split() == [
        "0.5",
        "-0.25",
        "no",
        "+1",
        "-1",
        "+1",
        "0.5",
        "elbow,",
        "singular",
    ]
