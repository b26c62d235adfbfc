"""The protocol of public results: `to_dict`, `save`, `plot`, `report`, `_repr_html_`; exceptions
have a reason.
"""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

import flexgen
from flexgen.base import registry
from flexgen.base.errors import ArgumentError
from flexgen.base.results import Result

FEW = "a few numbers, which its table has"
FILES = "files, which are listed"
# Results without a picture, with the reason.
NO_PICTURE = {
    "CascadeTuning": "its runs, before and after, have pictures",
    "Check": "numbers of several units next to their usual ranges, which its table has",
    "Commissioning": "numbers of several units, which its tables have",
    "Configuration": FEW,
    "Equilibrium": FEW,
    "FeedforwardComparison": "its runs have pictures",
    "Experiment": "its spectra are drawn as responses, by flexgen.frf",
    "Exported": FILES,
    "GeneratedLibrary": FILES,
    "Load": FEW,
    "Margins": FEW,
    "NextRun": "the errors of a few runs, which its table has",
    "PathAccuracy": FEW,
    "Plan": "its spectra are drawn as responses, after flexgen.measure and flexgen.frf",
    "SweepResult": "cases of different models and moves have no common axis",
}
# Other public data classes, with the reason.
INPUT = "an argument of functions"
NO_RESULT = {
    **dict.fromkeys(
        (
            "Box Cascade ComputedTorque FeedbackLinearisation JointRecord JointTorqueFeedback "
            "Linear LowPass LQ Servo ServoRecord Shaper"
        ).split(),
        INPUT,
    ),
    **dict.fromkeys(
        "LQG LoopShaping Notch PID PPI TomeiPD Move MoveC MoveJ MoveL PoseTarget Program".split(),
        INPUT,
    ),
    **dict.fromkeys(
        "RandomMove Grid HalfSpace Sphere Limits Disturbance DriveHardware RobotModel".split(),
        INPUT,
    ),
    **dict.fromkeys(
        (
            "Impedance Wall Scenario Segment Window Setting Port InversionOptions Priors "
            "StaticPoses DatasheetTolerances WorkFrame Carrier Posture"
        ).split(),
        INPUT,
    ),
    **dict.fromkeys(["Measurement", "Reference"], "one sample of a running controller"),
    **dict.fromkeys(["Finding", "Trial"], "a row of Check.findings, of FeedbackStudy.trials"),
    "LearningOptions": INPUT,
    "LearningRun": "a row of NextRun.runs",
    "Equations": "functions of a robot",
    "TorqueCommand": "a part of Solution; it has save and trajectory",
}


def public() -> dict[str, type]:
    found = {name: getattr(flexgen, name) for name in flexgen.__all__}
    return {name: what for name, what in found.items() if isinstance(what, type)}


def results() -> dict[str, type]:
    return {name: what for name, what in public().items() if issubclass(what, Result)}


def has_viewer(of: type, member: str) -> bool:
    return any(f"{base.__name__}.{member}" in registry.own_names("results") for base in of.__mro__)


def has_only_numbers(of: type) -> bool:
    """Whether all fields are single numbers or texts, which its table shows."""
    plain = {"str", "float", "int", "bool"}
    return is_dataclass(of) and all(
        set(str(f.type).split(" | ")) <= {*plain, "None"} for f in fields(of)
    )


def test_each_public_data_class_is_a_result_or_has_a_reason():
    others = {
        name
        for name, what in public().items()
        if is_dataclass(what) and not issubclass(what, Result)
    }
    assert others == set(NO_RESULT)


def test_each_result_has_a_picture_or_a_reason_and_a_page():
    without = {name for name, what in results().items() if not has_viewer(what, "plot")}
    left = {name for name in without if not has_only_numbers(results()[name])}
    assert left == {name for name in NO_PICTURE if not has_only_numbers(results()[name])}, (
        "add a picture with @provides('CLASS.plot'), or the class with a reason to NO_PICTURE"
    )
    assert all(has_viewer(what, "report") for what in results().values())


def test_a_planted_result_without_a_picture_is_seen():
    assert not has_viewer(type("Planted", (Result,), {}), "plot")
    assert has_viewer(type("Planted", (flexgen.IdentificationResult,), {}), "plot")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Results that take little time."""
    rows = np.random.default_rng(0).normal(size=(20, 2))
    model = flexgen.read("elbow")
    solution = flexgen.solve(model)
    path = flexgen.plan(model)
    analysis = flexgen.analyze(model)
    parts = [
        solution,
        solution.trajectory,
        solution.simulation,
        path,
        path.sample(np.linspace(0, 1, 9)),
        analysis,
    ]
    return [
        *parts,
        analysis.equilibrium,
        solution.accuracy(),
        flexgen.check(model),
        flexgen.PlantRun("soft", rows, rows, rows, rows, None, 3, "", rows, rows),
        flexgen.Detection(rows, None),
        flexgen.Estimate(*[rows] * 8),
        flexgen.Margins(True, 0.9, float("inf"), 1e-3),
        flexgen.Configuration(np.zeros(2), 0.0, True, 1, 0.1, {}),
        flexgen.export_mujoco(model, tmp_path_factory.mktemp("made") / "elbow.xml"),
    ]


def test_each_result_is_json_a_file_and_a_table(made, tmp_path):
    for result in made:
        text = json.dumps(result.to_dict(), allow_nan=False)
        html = result._repr_html_()
        assert "<table" in html and html.count("<tr>") and " at 0x" not in html + text, type(
            result
        )
        if not isinstance(result, flexgen.Trajectory):  # has formats of its own
            assert json.loads(result.save(tmp_path / "a.json").read_text()) == json.loads(text)
    margins = next(result for result in made if isinstance(result, flexgen.Margins))
    assert margins.to_dict() == {
        "stable": True,
        "largest_eigenvalue": 0.9,
        "gain": None,
        "gain_db": None,
        "gain_hz": None,
        "delay_s": 1e-3,
        "phase_deg": None,
        "phase_hz": None,
    }


def test_results_save_their_trajectory_or_their_arrays(made, tmp_path):
    solution = made[0]
    run = next(result for result in made if isinstance(result, flexgen.PlantRun))
    saved = flexgen.Trajectory.load(solution.save(tmp_path / "a.npz"))
    assert (saved["tau_m"] == solution.trajectory["tau_m"]).all()
    with np.load(run.save(tmp_path / "b.npz")) as arrays:
        assert (arrays["q_a"] == run.q_a).all() and json.loads(str(arrays["meta"]))[
            "name"
        ] == "soft"
    with pytest.raises(
        ArgumentError, match=r"given 'a.txt', expected a name that ends in \.json or \.npz"
    ):
        run.save(tmp_path / "a.txt")
    with pytest.raises(
        ArgumentError, match=r"given 'a.npz', expected a name that ends in \.json\Z"
    ):
        next(result for result in made if isinstance(result, flexgen.Check)).save(
            tmp_path / "a.npz"
        )


@pytest.mark.slow
def test_each_result_draws_its_picture_and_writes_its_page(made, tmp_path, request):
    # tests of their own
    others = [each for each in made if not isinstance(each, flexgen.Solution | flexgen.Analysis)]
    for k, result in enumerate(others):
        name = type(result).__name__
        if name in NO_PICTURE:
            with pytest.raises(ArgumentError, match=f"given {name}, which has no picture"):
                result.plot()
        else:
            figure = result.plot(tmp_path / f"{k}.png")
            assert figure.axes and (tmp_path / f"{k}.png").stat().st_size > 5000, name
    request.getfixturevalue("undrawn")
    for k, result in enumerate(others):
        page = result.report(tmp_path / str(k))
        # with the table of notebooks, or the tables of the command
        text = page.read_text(encoding="utf-8")
        assert page.name == "index.html" and ("<table" in text or "<pre" in text), type(
            result
        ).__name__


@pytest.mark.parametrize("verb", ["analyze", "check", "plan"])
def test_the_command_line_prints_the_text_of_the_result(verb, capsys):
    from flexgen.cli.main import main

    assert main([verb, "elbow", "-q"]) == 0
    assert capsys.readouterr().out == getattr(flexgen, verb)("elbow").to_text() + "\n"


def test_text_of_a_result_without_tables_is_that_of_print():
    planted = type("Planted", (Result,), {"__str__": lambda self: "three words"})()
    assert planted.to_text() == "three words"


def test_a_tool_pose_of_joints_is_that_of_the_equations():
    from flexgen.base.numerics.evaluate import evaluate
    from flexgen.paths.inverse_kinematics.tool_pose import ToolPose

    model = flexgen.read("elbow")
    pose = ToolPose.of_joints(model, [0.3, -0.7])
    q = np.zeros(model.n_a)
    q[list(model.i_g)] = 0.3, -0.7
    p, R = evaluate(flexgen.derive(model).function("forward_kinematics"), q[None])
    assert np.allclose(pose.position, np.ravel(p), atol=1e-14) and np.allclose(
        pose.rotation.ravel(), np.ravel(R)
    )
    with pytest.raises(ArgumentError, match="given 3 numbers, expected 2"):
        ToolPose.of_joints(model, [0.3, -0.7, 0.1])
