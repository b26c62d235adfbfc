"""The verbs of identification, control and run with the functions behind them replaced: what is
asked and printed.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from verb_arguments import arguments

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.rows import Data, Prose
from flexgen.cli.result import with_files
from flexgen.cli.verbs import control as controls
from flexgen.cli.verbs import identify as verbs
from flexgen.identification.motions.time_domain import Validation
from flexgen.identification.responses.result import FitStatus

LATER = "flexgen.identification."
NOTHING: dict[str, Any] = dict.fromkeys(
    (
        "validate",
        "segments",
        "truth",
        "move",
        "levels",
        "start",
        "refine",
        "free",
        "counterbalance",
        "fixed",
        "time_limit",
    )
) | {"rigid": False, "structure": False}


def found(status: FitStatus = FitStatus.FITTED, **more: Any) -> Any:
    """A result of a fit that writes nothing."""
    words = {
        "to_dict": lambda: {"status": str(status)},
        "to_text": lambda: "text",
        "status": status,
        "problem": "" if status.agrees else f"{status}: {status.sentence}",
        "covariance": None,
    }
    return Made(**(words | {"write": Path, "report": Path} | more))


def identify(log: Any = print, **given: Any) -> Any:
    """The answer of the verb to some arguments; the others are not given."""
    args = arguments("identify", model="elbow", data="data", **given)
    for name, value in NOTHING.items():
        vars(args).setdefault(name, value)
    return verbs.identify(args, log)


def test_a_plan_is_made_with_the_drives_that_are_given(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def plan(model: Any, hardware: Any, **more: Any) -> Any:
        asked.update(hardware=hardware, **more)
        return Made(
            save=lambda path: Path(f"saved/{path}"),
            duration_s=7.5,
            frequencies=np.array([1.0, 3.0]),
            joints=lambda model: np.array([[0.5, model.n_g]]),
            predicted={"q1.stiffness": 0.01},
            ended="",
            write_references=lambda path: ["a", "b", path],
        )

    monkeypatch.setattr(LATER + "experiments.plan.excite", plan)
    monkeypatch.setattr(
        "flexgen.views.reports.identification_texts.plan_text",
        lambda plan, model: f"plan of {model.name}",
    )
    args = arguments("excite", model="elbow", out="p.npz", delay=1e-4, torque_noise=0.3, lines=20)
    args.references = args.obstacles = args.pose = None
    answer = verbs.excite(args, print)
    assert answer.data == {
        "model": "elbow",
        "status": "done",
        "plan": "saved/p.npz",
        "duration_s": 7.5,
        "frequencies_Hz": [1.0, 3.0],
        "poses": [[0.5, 2.0]],
        "expected_relative_sd": {"q1.stiffness": 0.01},
    }
    assert answer.text == "plan of elbow\n\nwrote saved/p.npz" and asked["lines"] == 20
    drives = asked["hardware"]
    assert (drives.delay_s, drives.torque_noise_Nm) == (1e-4, 0.3)
    assert (drives.encoder_noise_rad, drives.encoder_resolution_rad) == (0.0, 0.0)
    args.references = "folder"
    assert verbs.excite(args, print).text.endswith(
        "\n\nwrote saved/p.npz\nwrote folder, 3 files of references"
    )


@pytest.mark.parametrize("saturated", [0, 3])
def test_a_simulated_experiment_says_where_torques_were_at_their_limits(
    saturated: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}

    def simulate(plan: Any, robot: Any, raw: Any, **more: Any) -> Any:
        asked.update(robot=robot.name, raw=raw, **more)
        sizes = {"speed_sd": np.array([[0.1]]), "saturated": np.array([0, saturated])}
        words = {"to_text": lambda: "experiment", "ended": ""}
        return Made(save=lambda path: path, plan=plan, **words, **sizes)

    planned = Made(duration_s=12.4, poses=[1, 2])
    monkeypatch.setattr(flexgen.Plan, "load", lambda path: planned)
    monkeypatch.setattr(LATER + "experiments.experiment.measure", simulate)
    writer = Made(finish=lambda: Path("raw/recordings.toml"), files=[(0, "a"), (1, "b")])
    monkeypatch.setattr(
        LATER + "records.recording_writer.RecordingWriter", lambda path, plan, robot: writer
    )
    lines: list[str] = []
    answer = verbs.measure(
        arguments("measure", model="elbow", plan="p.npz", out="d.npz", raw=None, seed=4),
        lines.append,
    )
    assert asked["raw"] is None and asked["seed"] == 4 and lines == ["simulating 12 s of elbow"]
    assert answer.text.startswith("elbow: 12.4 s of robot in ") and answer.text.endswith(
        "\n\nexperiment\n\nwrote d.npz"
    )
    assert answer.data["samples_at_torque_limit"] == [0, saturated] and answer.data[
        "speed_rms_rad_s"
    ] == [[0.1]]
    assert 0 <= answer.data["wall_s"] < 60 and "recordings" not in answer.data
    text = "torques were at their limits: 'flexgen frf' refuses these data; take less --speed-rms"
    assert answer.warnings == [text] * (saturated > 0)
    answer = verbs.measure(
        arguments("measure", model="elbow", plan="p.npz", out="d.npz", raw="raw"), print
    )
    assert asked["raw"] is writer and answer.data["recordings"] == "raw/recordings.toml"
    assert answer.text.endswith("\nwrote raw/recordings.toml, 2 files with all samples")


def test_responses_are_counted_and_saved(monkeypatch: pytest.MonkeyPatch) -> None:
    data = {
        "model": "elbow",
        "poses": [1, 2],
        "w": [1, 2, 3],
        "outputs": ("m1",),
        "warnings": ("late",),
        "ended": "",
    }
    made = Made(
        **data, relative_sd=lambda: 0.02, to_text=lambda: "responses", save=Path, report=Path
    )
    monkeypatch.setattr(
        LATER + "responses.frequency_response.frf", lambda experiment, **more: made
    )
    monkeypatch.setattr(
        LATER + "records.experiment_file.load_experiment",
        lambda path, log: Made(plan=Made(poses=[1, 2])),
    )
    unlimited = {"time_limit": None}
    answer = verbs.frf(arguments("frf", experiment="d.npz", out="f.npz", **unlimited), print)
    counts = {"poses": 2, "lines": 3, "outputs": ["m1"], "median_relative_sd": 0.02}
    assert answer.data == {"model": "elbow", "status": "done", "frf": "f.npz", **counts}
    assert (answer.text, answer.warnings) == ("responses\n\nwrote f.npz", ["late"])
    args = arguments("frf", experiment="d.npz", out="f.npz", report="page", **unlimited)
    answer = verbs.frf(args, print)
    assert answer.text.endswith("wrote f.npz\nwrote page") and answer.data["report"] == "page"


def test_a_fit_writes_what_can_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of a search that did not end; a second experiment, and the error of a move."""
    asked: dict[str, Any] = {}
    result = {"made": found()}

    def fit(model: Any, data: Any, **more: Any) -> Any:
        asked.update(model=model.name, data=data, **more)
        return result["made"]

    monkeypatch.setattr(LATER + "responses.graybox.identify", fit)
    monkeypatch.setattr(flexgen.Frf, "load", lambda path: f"responses of {path}")
    texts = "flexgen.views.reports.identification_texts."
    monkeypatch.setattr(
        texts + "text_of_identification", lambda found, *more: " | ".join(["fit", *more])
    )
    monkeypatch.setattr(
        texts + "validation_text",
        lambda checked, motors: f"validated with {motors}: {checked.cost}",
    )
    monkeypatch.setattr(
        LATER + "records.experiment_file.load_experiment",
        lambda path: Made(plan=Made(motors="m1")),
    )
    answer = identify(
        out="new.toml",
        report="page",
        levels=["a.npz"],
        start=[("q1.stiffness", 3)],
        free=["stiffness"],
    )
    assert (
        asked["start"] == {"q1.stiffness": 3.0}
        and asked["source"] == "data"
        and asked["free"] == ["stiffness"]
    )
    assert asked["levels"] == ["responses of a.npz"] and asked["data"] == "responses of data"
    assert (
        answer.data == {"status": "fitted", "model_file": "new.toml", "report": "page"}
        and answer.problem == ""
    )
    assert answer.text == "fit\n\nwrote new.toml\nwrote page"
    for status in (FitStatus.MODEL_ERROR, FitStatus.NOT_CONVERGED):
        result["made"] = found(status)
        answer = identify(out="new.toml", report="page", move="line")
        assert answer.problem == f"{status}: {status.sentence}"
        assert "model_file" in answer.data and "report" in answer.data
        words = (
            "\n"
            "\n"
            "no tool errors of the move line: a result with model error has no covariance to "
            "draw robots from"
        )
        told = f"fit{words}; give --truth where the robot is known\n\nwrote new.toml\nwrote page"
        written = "fit\n\nwrote new.toml\nwrote page"
        assert answer.text == (told if status == FitStatus.MODEL_ERROR else written)
    result["made"] = found()
    lines: list[str] = []
    checked = Validation((99.0,), 1.5, (1.0,))
    monkeypatch.setattr(
        LATER + "motions.time_domain.refine_and_validate",
        lambda found, given, **more: (found, checked),
    )
    answer = identify(lines.append, refine="d.npz")
    assert answer.text == "fit | validated with m1: 1.5" and answer.data["validation"] == vars(
        checked
    )
    assert lines == [
        "refining by simulation: up to two minutes for six axes, seconds for planar arms"
    ]
    monkeypatch.setattr(
        LATER + "motions.time_domain.refine_and_validate",
        lambda found, given, **more: (found, None),
    )
    assert (
        identify(refine="d.npz").text == "fit"
        and "validation" not in identify(refine="d.npz").data
    )
    rows = [Made(model="file", error_m=(1.0,), error_rad=None)]
    result["made"] = found(
        covariance=np.eye(1),
        verdict=lambda move, truth, progress: Made(rows=rows, of=(move, truth)),
    )
    monkeypatch.setattr(texts + "verdict_text", lambda verdict: f"errors of {verdict.of}")
    answer = identify(lines.append, move="line")
    assert answer.data["tool_errors"] == [{"model": "file", "error_m": (1.0,)}]
    assert answer.text == "fit\n\nerrors of ('line', None)"
    assert lines[-1] == "tool errors of the move line: a few minutes for six axes"
    # no covariance, but a robot that is known
    result["made"] = found(verdict=result["made"].verdict)
    assert (
        identify(move="line", truth="robot.toml").text == "fit\n\nerrors of ('line', 'robot.toml')"
    )


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {"validate": "x", "structure": True},
            "--validate: given with --structure, expected without it",
        ),
        (
            {"counterbalance": [("q1", 1)]},
            "--counterbalance: given without --rigid or --segments, expected with them",
        ),
        (
            {"truth": "x"},
            (
                "--truth: given without --move, expected also --move NAME, whose tool error is "
                "compared"
            ),
        ),
        ({"segments": 0.1}, "--segments: given no --free, expected the names of the parameters"),
        (
            {"start": [("q1.stiffness", True)]},
            "--start q1.stiffness: given True, expected a number",
        ),
        ({"start": [("q1.stiffness", "x")]}, "--start q1.stiffness: given 'x', expected a number"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    given: dict[str, Any], text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flexgen.Frf, "load", lambda path: path)
    with pytest.raises(ArgumentError) as caught:
        identify(**given)
    assert str(caught.value) == text


def test_motions_are_fitted_rigid_or_in_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def bodies(model: Any, data: Any, **more: Any) -> Any:
        asked.update(model=model.name, data=data, **more)
        status = asked["status"]
        texts = (status.sentence, status.advice)
        return found(status, fit=Made(status=status, texts=texts))

    monkeypatch.setattr(LATER + "rigid.rigid_file.identify_bodies", bodies)
    for status in (FitStatus.FITTED, FitStatus.NOT_CONVERGED):
        asked["status"] = status
        answer = identify(rigid=True, counterbalance=[("q1", "2")], out="new.toml")
        assert (
            asked["counterbalance"] == {"q1": 2}
            and asked["validate"] is None
            and asked["progress"] is print
        )
        assert answer.text == "text\n\nwrote new.toml" and answer.data["model_file"] == "new.toml"
        expected = "" if status.has_deviations else f"{status}: {status.sentence}"
        assert answer.problem == expected
    assert expected

    def motion(model: Any, data: Any, segment_s: float, **more: Any) -> Any:
        asked.update(segment_s=segment_s, **more)
        return found(asked["status"])

    monkeypatch.setattr(LATER + "motions.motion_fit.fit_motion", motion)
    texts = "flexgen.views.reports.identification_texts."
    monkeypatch.setattr(
        texts + "text_of_motion_fit", lambda found, segment: f"motion in {segment} s"
    )
    for status in (FitStatus.FITTED, FitStatus.NOT_CONVERGED):
        asked["status"] = status
        more = {
            "free": ["stiffness"],
            "start": [("a", 2)],
            "validate": "v.toml",
            "out": "new.toml",
        }
        answer = identify(segments=0.2, **more)
        assert (
            asked["segment_s"] == 0.2
            and asked["free"] == ["stiffness"]
            and asked["start"] == {"a": 2.0}
        )
        assert asked["validate"] == "v.toml" and "model_file" in answer.data
        assert (
            answer.text.startswith("motion in 0.2 s") and (answer.problem == "") == status.agrees
        )
    for given, named in ((("rigid", "free"), "--free"), (("segments", "report"), "--report")):
        with pytest.raises(ArgumentError) as caught:
            identify(**dict.fromkeys(given, 1))
        option = f"--{given[0]}"
        words = f"{option}: given with {named}, expected without: with {option} that has no effect"
        assert str(caught.value) == words


def test_a_structure_is_a_table_of_springs(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def structure(model: Any, data: Any, fixed: Any, time_limit: Any, progress: Any) -> Any:
        asked.update(model=model.name, data=data, fixed=fixed)
        return Made(identified=found(), added=("a",), removed=(), changes=[Made(cost=2.0)])

    monkeypatch.setattr(flexgen.Frf, "load", lambda path: path)
    monkeypatch.setattr(LATER + "responses.structure.structure", structure)
    monkeypatch.setattr(
        "flexgen.views.reports.identification_texts.structure_text", lambda found: "springs"
    )
    lines: list[str] = []
    answer = identify(lines.append, structure=True, fixed=["q1"], report="page")
    assert asked == {"model": "elbow", "data": "data", "fixed": ["q1"]}
    assert lines == ["adding and removing springs: about a minute for six axes"]
    changes = {"added": ["a"], "removed": [], "changes": [{"cost": 2.0}]}
    assert (
        answer.data == {"status": "fitted", **changes, "report": "page"} and answer.problem == ""
    )
    assert answer.text == "springs\n\nwrote page"
    with pytest.raises(
        ArgumentError,
        match=r"^--structure: given with --free, expected without: with --structure that",
    ):
        identify(structure=True, free=["stiffness"])


# --- control -------------------------------------------------------------------------------------
@pytest.mark.parametrize("status", ["done", "stopped early"])
@pytest.mark.parametrize("uncertain", [False, True])
def test_a_run_has_its_margins_and_the_robots_of_its_tolerances(
    status: str, uncertain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}
    loop = (Prose("loop"), Data("status", status))
    made = Made(content=lambda: loop, status=status, ended="", wall_s=0.1)

    def simulate(model: Any, **more: Any) -> Any:
        asked.update(more)
        return made

    passive = Made(content=lambda: (Prose("passive"), Data("passive", True)))
    monkeypatch.setattr("flexgen.feedback.loop.control.control", simulate)
    monkeypatch.setattr("flexgen.feedback.laws.passivity.check_passivity", lambda run: passive)
    monkeypatch.setattr(
        controls, "read_model", lambda args: Made(uncertainty=1.0 if uncertain else None)
    )
    drawn = "flexgen.studies.tolerances.in_loop."
    nothing = {"robots": 20, "failed": 0, "error_m": None, "error_rad": None}
    monkeypatch.setattr(
        drawn + "error_in_loop",
        lambda run, **more: nothing | {"options": sorted(k for k in more if k != "progress")},
    )
    args = arguments(
        "control",
        move="line",
        delay=1e-3,
        disturbances=None,
        wall=None,
        passivity=True,
        compare=False,
    )
    args.time_limit = None
    answer = controls.control(args, print)
    assert (
        asked["disturbances"] == []
        and asked["wall"] is None
        and asked["delay"] == 1e-3
        and asked["move"] == "line"
    )
    text = "loop\npassive"
    data = {"status": status, "passivity": {"passive": True}}
    if uncertain and status == "done":  # other options than the move, plants and disturbances
        text += "\n\nrobots drawn from [uncertainty], without disturbances\n\n"
        text += "their error is not known"
        data["drawn"] = nothing | {"options": ["delay", "wall"]}
    assert (answer.text, answer.data, answer.problem) == (
        text,
        data,
        "" if status == "done" else status,
    )
    args.passivity = False
    assert "passivity" not in controls.control(args, print).data


def test_a_fitted_model_file_is_named_with_its_variant(tmp_path: Path) -> None:
    """The file alone is still the robot before the fit."""
    file = tmp_path / "arm.toml"
    file.write_text("[variant.stiff]\n[variant.commissioned]\n[variant.commissioned.set]\n")
    answer = with_files("fit", {}, {"out": file})
    assert answer.text == f"fit\n\nwrote {file}; read it as {file}@commissioned"
    file.write_text("[variant.stiff]\n")
    assert with_files("fit", {}, {"out": file}).text == f"fit\n\nwrote {file}"
