"""The verbs calibrate, tune, fastest, derive and measure with the functions behind them replaced:
what is asked and printed.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from verb_arguments import arguments

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.verbs import calibration, control, identify, robot
from flexgen.identification.experiments import excitation, experiment
from flexgen.identification.poses.poses import StaticPoses
from flexgen.planning.fastest import minimum_time
from flexgen.studies.scenarios import tune as tuning


def clock(*instants: float) -> SimpleNamespace:
    """The module `time` whose clock shows these numbers in turn."""
    rest = iter(instants)
    return SimpleNamespace(perf_counter=lambda: next(rest))


class Found:
    """A calibration that was made up."""

    problem = "not good"
    warnings = ("beware",)
    ended = ""

    def __init__(self) -> None:
        self.asked: list[Any] = []

    def to_dict(self) -> dict[str, Any]:
        return {"error_m": 1e-4}

    def to_text(self) -> str:
        return "calibrated"

    def propose_poses(self, count: int) -> np.ndarray:
        return np.arange(2.0 * count).reshape(count, 2) / 8

    def write(self, path: str, world: str) -> Path:
        self.asked += [path, world]
        return Path(path)

    def report(self, path: str) -> Path:
        return Path(path)


def test_the_verb_calibrate(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Found()
    given = {}
    monkeypatch.setattr(
        StaticPoses, "read", lambda path, model, columns: (path, model.name, columns)
    )

    def calibrate(model: Any, poses: Any, **more: Any) -> Found:
        given.update(model=model.name, poses=poses, **more)
        return found

    monkeypatch.setattr(flexgen, "calibrate", calibrate)
    args = arguments("calibrate", model="elbow", poses="poses.csv", free=["zeros"])
    answer = calibration.calibrate(args, print)
    assert (answer.text, answer.data, answer.problem) == (
        "calibrated",
        {"error_m": 1e-4},
        "not good",
    )
    assert answer.warnings == ["beware"]
    assert (
        given["poses"] == ("poses.csv", "elbow", None)
        and given["free"] == ["zeros"]
        and given["model"] == "elbow"
    )
    assert given["priors"] == flexgen.Priors()
    more = {
        "add_poses": 2,
        "out": "new.toml",
        "report": "page.html",
        "prior": [("zero", 1), ("mass", 0.5)],
    }
    answer = calibration.calibrate(arguments("calibrate", model="elbow", poses="p", **more), print)
    assert given["priors"].zero == 1.0 and given["priors"].mass == 0.5
    assert answer.data["proposed_poses"] == [{"q1": 0.0, "q2": 0.125}, {"q1": 0.25, "q2": 0.375}]
    assert answer.data["model_file"] == "new.toml" and answer.data["report"] == "page.html"
    lines = answer.text.splitlines()
    assert lines[:3] == [
        "calibrated",
        "",
        "poses that tell most, rad or m; check them for collisions:",
    ]
    assert "0.125" in answer.text and lines[-2:] == ["wrote new.toml", "wrote page.html"]
    assert found.asked == ["new.toml", "robot"]
    calibration.calibrate(
        arguments("calibrate", model="elbow", poses="p", out="b.toml", world="measurement"), print
    )
    assert found.asked[2:] == ["b.toml", "measurement"]
    for name, value in (("none", 1.0), ("zero", "x")):
        with pytest.raises(ArgumentError) as caught:
            calibration.calibrate(
                arguments("calibrate", model="elbow", poses="p", prior=[(name, value)]), print
            )
        start = (
            f"--prior: given {name}={value}, expected a number for one of zero, position, "
            "rotation, compliance"
        )
        assert str(caught.value).startswith(start)
    text = r"^--out: given manutec_r3@planar, expected a \.toml model file without @variant$"
    monkeypatch.setattr(
        calibration, "read_model", lambda args: SimpleNamespace(variant="planar", file="x.toml")
    )
    with pytest.raises(ArgumentError, match=text):
        calibration.calibrate(
            arguments("calibrate", model="manutec_r3@planar", poses="p", out="c.toml"), print
        )


def test_the_verbs_tune_and_fastest(monkeypatch: pytest.MonkeyPatch) -> None:
    class Tuned:
        ended = ""

        score = SimpleNamespace(accepted=True)

        def __str__(self) -> str:
            return "tuned"

        def save(self, path: str) -> str:
            return path

        def to_dict(self) -> dict[str, Any]:
            return {"score": 2.0}

    lines: list[str] = []
    monkeypatch.setattr(tuning, "tune", lambda scenario, **given: Tuned())
    monkeypatch.setattr(control, "time", clock(1000.0, 1001.5, 2000.0, 2000.25))
    args = arguments("tune", scenario="four_mass", starts=3, evaluations=40, out="c.toml")
    answer = control.tune(args, lines.append)
    assert lines[0] == "tune: 120 evaluations, about two seconds each"
    assert answer.text == "tuned\n  1.5 s\n\nwrote c.toml" and answer.problem == ""
    assert answer.data == {"score": 2.0, "controller": "c.toml"}
    Tuned.score = SimpleNamespace(accepted=False)
    assert control.tune(args, lines.append).problem == "the tuned controller is refused"
    asked: dict[str, Any] = {}

    class Fast:
        solution = SimpleNamespace(status=flexgen.Status.SOLVED)

        def __str__(self) -> str:
            return "fast"

        def to_dict(self) -> dict[str, Any]:
            return {"duration_s": 1.0}

    def fastest(model: Any, **given: Any) -> Fast:
        asked.update(given)
        return Fast()

    monkeypatch.setattr(minimum_time, "fastest", fastest)
    monkeypatch.setattr(control, "written", lambda args, solution: {"csv": Path("a.csv")})
    given = {"model": "elbow", "torque": [3.0, 4.0], "speed": [5.0], "reserve": 0.1}
    answer = control.fastest(arguments("fastest", **given), print)
    assert (answer.text, answer.problem) == ("fast\n\nwrote a.csv", "")
    assert answer.data == {"duration_s": 1.0, "csv": "a.csv"}
    limits = asked["limits"]
    assert (limits.torque, limits.reserve) == ((3.0, 4.0), 0.1) and limits.speed in (
        5.0,
        (5.0, 5.0),
    )
    none = {"model": "elbow", "torque": None, "speed": None, "reserve": None}
    control.fastest(arguments("fastest", **none), print)
    assert asked["limits"] == flexgen.Limits()
    for status, problem in (
        ("LIMITS_EXCEEDED", ""),
        ("TOLERANCE_NOT_MET", "the fastest move is tolerance not met"),
    ):
        Fast.solution = SimpleNamespace(status=flexgen.Status[status])
        assert control.fastest(arguments("fastest", **none), print).problem == problem


def test_the_verbs_derive_and_measure_say_how_long_they_took(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = SimpleNamespace(name="arm", variant="stiff", title="arm@stiff")
    equations = SimpleNamespace(
        model=made, sizes=lambda log: {"mass_matrix": 12, "forward_dynamics": 345}
    )
    monkeypatch.setattr(robot, "time", clock(100.0, 102.5))
    monkeypatch.setattr(robot, "derive_model", lambda args: equations)
    answer = robot.derive(arguments("derive", latex=False, text=False, json=True), print)
    sizes = {"mass_matrix": 12, "forward_dynamics": 345}
    assert answer.data == {"model": "arm", "variant": "stiff", "seconds": 2.5, "functions": sizes}
    assert [row.split() for row in answer.text.splitlines()[:1]] == [["function", "instructions"]]
    assert [row.split() for row in answer.text.splitlines()[-2:]] == [
        ["mass_matrix", "12"],
        ["forward_dynamics", "345"],
    ]

    planned = SimpleNamespace(duration_s=12.25, poses=[1, 2])

    class Run:
        plan = planned
        ended = ""
        speed_sd = np.array([0.25, 0.5])
        saturated = np.array([0, 3])

        def save(self, path: str) -> str:
            return path

        def to_text(self) -> str:
            return "measured"

    lines: list[str] = []
    monkeypatch.setattr(excitation.Plan, "load", lambda path: planned)
    monkeypatch.setattr(identify, "read_model", lambda args: made)
    monkeypatch.setattr(identify, "time", clock(7.0, 7.75, 8.0, 12.0))
    monkeypatch.setattr(experiment, "measure", lambda plan, robot, **given: Run())
    answer = identify.measure(
        arguments("measure", plan="p", raw=None, out="run.npz"), lines.append
    )
    assert lines == ["simulating 12 s of arm"]
    assert answer.data == {
        **{
            "model": "arm",
            "status": "done",
            "experiment": "run.npz",
            "duration_s": 12.25,
            "wall_s": 0.75,
        },
        **{"speed_rms_rad_s": [0.25, 0.5], "samples_at_torque_limit": [0, 3]},
    }
    assert answer.text == "arm: 12.25 s of robot in 0.75 s\n\nmeasured\n\nwrote run.npz"
    (warning,) = answer.warnings
    assert warning.startswith("torques were at their limits: 'flexgen frf' refuses these data")
    monkeypatch.setattr(Run, "saturated", np.array([0, 0]))
    answer = identify.measure(
        arguments("measure", plan="p", raw=None, out="run.npz"), lines.append
    )
    assert answer.data["wall_s"] == 4.0 and not answer.warnings
