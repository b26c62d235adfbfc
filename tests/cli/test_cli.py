"""The command line: every verb, its JSON, its exit status and its error messages."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.display import as_json, number, plain, roots
from flexgen.base.motion.trajectory import Trajectory
from flexgen.cli import result
from flexgen.cli.main import main
from flexgen.cli.verbs import robot
from flexgen.dynamics.mechanics.signatures import TABLE, split_product
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.problem_text import problem_of
from flexgen.views.reports.text_tables import figures, table
from flexgen.views.reports.texts import figure_rows

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def run(capfd):
    """Run a command line in this process; (status, standard output, standard error)."""

    def call(*words):
        capfd.readouterr()
        status = main([str(word) for word in words])
        captured = capfd.readouterr()
        assert "Traceback" not in captured.err
        return status, captured.out, captured.err

    return call


@pytest.fixture
def ask(run):
    """Run with --json; (status, the one object, standard error)."""

    def call(*words):
        def refuse(text):
            raise AssertionError(f"{text} is not JSON")

        status, out, err = run(*words, "--json")
        data = json.loads(out, parse_constant=refuse)
        assert isinstance(data, dict)
        assert ("error" in data) == (status != 0)
        return status, data, err

    return call


@pytest.fixture(scope="module")
def trajectory(tmp_path_factory):
    """A solved move of the planar arm."""
    path = tmp_path_factory.mktemp("solved") / "line.npz"
    assert (
        main(["solve", "planar5_nmp", "--out", str(path), "--no-verify", "--quiet", "--json"]) == 0
    )
    return path


# --- models, describe ----------------------------------------------------------------------------
def test_models(ask, run):
    status, data, _ = ask("models")
    assert status == 0 and list(data) == ["models"]
    rows = {row["name"]: row for row in data["models"]}
    assert set(rows) == {path.stem for path in (ROOT / "models").glob("*.toml")}
    for row in rows.values():
        assert set(row) == {
            "name",
            "source",
            "n_m",
            "n_g",
            "n_e",
            "dof",
            "description",
            "variants",
        }
    row = rows["planar5_nmp"]
    assert [row[key] for key in ("n_m", "n_g", "n_e", "dof")] == [2, 2, 1, 5]
    assert row["variants"] == ["undamped", "soft", "coupled"]
    _, text, _ = run("models")
    assert all(name in text for name in rows) and "planar5_nmp@undamped" in text


def test_broken_file_among_the_models_is_named_and_left_out(ask, tmp_path, monkeypatch):
    (tmp_path / "bad.toml").write_text("name = 3\n")
    monkeypatch.setenv("FLEXGEN_MODELS", str(tmp_path))
    status, data, err = ask("models")
    assert status == 0 and len(data["models"]) > 1
    assert "bad.toml:" in data["broken"]["bad"] and "bad.toml:" in err


def test_variants_that_are_not_chosen_are_read_too(ask, tmp_path, monkeypatch):
    text = (ROOT / "models" / "elbow.toml").read_text(encoding="utf-8")
    wrong = '\n[variant.wrong]\nset = { "element.upper.body.mass" = -1 }\n'
    (tmp_path / "arm.toml").write_text(
        text.replace("description =", 'description = """two\nlines"""\n#', 1) + wrong
    )
    for model in (tmp_path / "arm.toml", f"{tmp_path / 'arm.toml'}@rigid"):
        status, data, _ = ask("describe", model)
        assert status == 1 and "element.upper.body.mass: given -1, expected " in data["error"]
        assert data["error"].endswith("(variant wrong)")
    monkeypatch.setenv("FLEXGEN_MODELS", str(tmp_path))
    status, data, err = ask("models")
    assert (
        status == 0
        and list(data["broken"]) == ["arm@wrong"]
        and "warning: model arm@wrong is left out: " in err
    )
    row = next(row for row in data["models"] if row["name"] == "arm")
    assert row["variants"] == ["fjm", "rigid", "payload"] and row["description"] == "two\nlines"


def test_tables_have_one_line_for_each_model(run, tmp_path, monkeypatch):
    monkeypatch.setenv("FLEXGEN_MODELS", str(tmp_path))
    text = (ROOT / "models" / "elbow.toml").read_text(encoding="utf-8")
    (tmp_path / "arm.toml").write_text(
        text.replace("description =", 'description = """two\nlines"""\n#', 1)
    )
    assert next(
        line for line in run("models")[1].splitlines() if line.startswith("arm ")
    ).endswith("  two lines")
    assert run("describe", "arm")[1].splitlines()[0] == "elbow: two lines"


def test_folder_of_models_that_is_not_there(ask, monkeypatch):
    monkeypatch.setenv("FLEXGEN_MODELS", "/nosuch")
    for words in (["models"], ["describe", "elbow"]):
        status, data, _ = ask(*words)
        assert status == 1 and data["error"].startswith("FLEXGEN_MODELS: given '/nosuch'")


def test_describe(ask, run):
    status, data, _ = ask("describe", "planar5_nmp")
    assert status == 0
    assert {
        "name",
        "source",
        "n_m",
        "n_g",
        "n_e",
        "dof",
        "coordinates",
        "motors",
        "moves",
        "variants",
    } <= set(data)
    assert [c["name"] for c in data["coordinates"]] == ["q1", "q2", "q3"]
    assert (
        data["coordinates"][0]["gear"]["damping"] == 400.0
        and data["coordinates"][2]["spring"]["type"] == "linear"
    )
    status, text, _ = run("describe", "planar5_nmp")
    assert status == 0 and "coordinate" in text and "m1" in text
    rows = {line.split()[0]: line for line in text.splitlines() if line}
    assert "elastic gear, linear, arm side  400000 N m/rad  400 N m s/rad" in rows["q1"]
    assert "spring, linear  " in rows["q3"] and "150000 N m/rad" in rows["q3"]
    text = run("describe", "manutec_r3_efjm")[1]
    assert "N/m" in next(line for line in text.splitlines() if line.startswith("b2x "))
    assert "beam bending" in run("describe", "beam_arm")[1]


def test_every_model_can_be_described(ask, run):
    for row in ask("models")[1]["models"]:
        assert ask("describe", row["name"])[0] == 0
        assert run("describe", row["name"])[0] == 0


def test_variant_and_path(ask):
    assert ask("describe", "planar5_nmp@undamped")[1]["coordinates"][0]["gear"]["damping"] == 0.0
    assert ask("describe", ROOT / "models" / "elbow.toml")[1]["name"] == "elbow"
    assert ask("describe", f"{ROOT / 'models' / 'elbow.toml'}@rigid")[1]["variant"] == "rigid"
    status, data, _ = ask("describe", "planar5_nmp@nosuch")
    assert status == 1 and "undamped" in data["error"]


def test_set(ask):
    _, data, _ = ask(
        "describe",
        "planar5_nmp",
        "--set",
        "motor.m1.inertia=0.5",
        "--set",
        'output.axes = "x"',
        "--set",
        "home_rad=[0, 1]",
    )
    assert (
        data["motors"][0]["inertia"] == 0.5
        and data["output"]["axes"] == "x"
        and data["home"] == [0.0, 1.0]
    )
    status, data, _ = ask("describe", "planar5_nmp", "--set", "motor.m9.inertia=0.5")
    assert status == 1 and "motor.m9.inertia" in data["error"]
    status, data, _ = ask("describe", "planar5_nmp", "--set", "motor.m1.inertia=-1")
    assert status == 1 and "inertia" in data["error"]


@pytest.mark.parametrize(
    "text", ["motor.m1.inertia", "=3", "name=elbow", "x=1\ny=2", "x=", "x=[1,"]
)
def test_bad_set_is_a_usage_error(ask, text):
    status, data, err = ask("describe", "planar5_nmp", "--set", text)
    assert status == 2 and "KEY=VALUE" in data["error"] and "usage:" in err


# --- derive --------------------------------------------------------------------------------------
def test_derive(ask, run, tmp_path):
    status, data, _ = ask("derive", "elbow")
    assert (
        status == 0
        and data["functions"]["mass_matrix"] > 0
        and data["seconds"] >= 0
        and "text" not in data
    )
    status, text, _ = run("derive", "elbow")
    assert status == 0 and text.startswith("elbow") and "cos(" in text
    assert ask("derive", "elbow", "--text")[1]["text"].strip() == text.strip()
    file = tmp_path / "new" / "elbow.tex"
    assert ask("derive", "elbow", "--out", file)[1]["out"] == str(file)
    assert "\\documentclass" in file.read_text()


def test_derive_without_a_closed_form(ask, run):
    status, text, err = run("derive", "kr300")
    assert status == 0 and "instructions" in text and "at most" in err
    status, data, _ = ask("derive", "kr300", "--text")
    assert status == 1 and "at most" in data["error"]
    assert run("derive", "kr300", "--text", "--latex")[0] == 2


# --- analyze -------------------------------------------------------------------------------------
def test_analyze(ask, run):
    status, data, _ = ask("analyze", "planar5_nmp")
    assert status == 0
    keys = "n_m n_g n_e dof modes_hz poles zeros phase structural_index preview_s"
    assert set(keys.split()) <= set(data)
    assert data["phase"] == "non-minimum phase" and data["structural_index"] == 4
    assert all(len(pair) == 2 for pair in data["poles"] + data["zeros"])
    status, text, _ = run("analyze", "planar5_nmp")
    assert status == 0 and "non-minimum phase" in text and "Hz" in text


@pytest.mark.parametrize(
    "words",
    [["--pose", "-0.3,1,0"], ["--pose=-0.3,1,0"], ["--pose", "-.3,1"], ["--pose", "-3e-1, 1"]],
)
def test_negative_pose(ask, words):
    status, data, _ = ask("analyze", "planar5_nmp", *words)
    assert status == 0 and data["pose"][:2] == [-0.3, 1.0]


@pytest.mark.parametrize("pose", ["a,b", "", "0.3,", "nan,1", "1,inf", "-x", "1;2"])
def test_a_pose_that_is_not_a_list_of_numbers_is_refused(run, pose):
    status, out, err = run("analyze", "planar5_nmp", "--pose", pose)
    assert status == 2 and out == "" and "--pose" in err


def test_pose_of_the_wrong_length(ask):
    status, data, _ = ask("analyze", "planar5_nmp", "--pose", "1,2,3,4")
    assert status == 1 and "q1, q2, q3" in data["error"]


# --- generate ------------------------------------------------------------------------------------
@needs_compiler
def test_generate(ask, run, tmp_path):
    status, data, err = ask("generate", "elbow", "--out", tmp_path / "c")
    assert status == 0 and {"directory", "files", "functions", "digest", "seconds"} <= set(data)
    assert data["directory"] == str(tmp_path / "c") and all(
        Path(file).is_file() for file in data["files"]
    )
    assert "mass_matrix" in data["functions"] and "compiling" in err
    again = ask("generate", "elbow", "--out", tmp_path / "c")[1]
    assert again["cached"] and again["digest"] == data["digest"]
    status, text, _ = run("generate", "elbow", "--out", tmp_path / "c")
    assert (
        status == 0
        and "nothing has changed" in text
        and "wrote" not in text
        and "mass_matrix" in text
    )
    few = [
        "generate",
        "elbow",
        "--out",
        tmp_path / "few",
        "--functions",
        "motor_friction, inverse_dynamics",
    ]
    data = ask(*few)[1]
    other = ask(*few, "--set", "motor.m1.inertia=0.02")[1]
    assert not other["cached"] and other["digest"] != data["digest"]
    status, text, _ = run("generate", "elbow", "--out", tmp_path / "c", "--force", "--no-build")
    assert status == 0 and "elbow.h" in text


def test_generate_some_functions(ask, tmp_path):
    words = ["generate", "elbow", "--out", tmp_path / "c", "--no-build", "--functions"]
    status, data, _ = ask(*words, "mass_matrix, jacobian")
    assert status == 0 and data["functions"] == ["jacobian", "mass_matrix"]
    status, data, _ = ask(*words, "mass_matrix,nothing")
    assert status == 1 and data["error"].startswith("functions: given 'nothing', expected some of")


@pytest.mark.slow
@needs_compiler
def test_generate_with_options(ask, tmp_path):
    status, data, _ = ask(
        "generate",
        "elbow",
        "--out",
        tmp_path / "c",
        "--single",
        "--native",
        "--parameters",
        "payload, damping",
    )
    manifest = json.loads((tmp_path / "c" / "manifest.json").read_text())
    assert (
        status == 0
        and manifest["precision"] == "single"
        and "-march=native" in manifest["build"]["flags"]
    )
    assert {"payload.mass", "q1.damping"} <= {
        parameter["name"] for parameter in manifest["parameters"]
    }
    assert "payload.mass = " in (tmp_path / "c" / "elbow.h").read_text()
    status, data, _ = ask("generate", "elbow", "--out", tmp_path / "d", "--parameters", "nothing")
    assert status == 1 and "parameters: given 'nothing', expected some of" in data["error"]
    assert not (tmp_path / "d").exists()


def test_generate_without_a_compiler(ask, run, tmp_path, monkeypatch):
    monkeypatch.setattr("flexgen.codegen.build.compiler.packaged_compiler", lambda: None)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    status, data, _ = ask("generate", "elbow", "--out", tmp_path / "c")
    assert status == 1 and "--no-build" in data["error"]
    status, text, _ = run("generate", "elbow", "--out", tmp_path / "c", "--no-build")
    assert status == 0 and "not compiled" in text and "elbow.h" in text
    assert (
        "nothing has changed" in run("generate", "elbow", "--out", tmp_path / "c", "--no-build")[1]
    )


# --- solve, simulate -----------------------------------------------------------------------------
def test_solve(ask, tmp_path):
    status, data, _ = ask(
        "solve", "planar5_nmp", "--move", "joints", "--out", tmp_path / "a" / "joints.csv"
    )
    assert status == 0
    keys = (
        "status method move wall_s cpu_s tool_error_max_m tool_error_max_rad torque_max_Nm "
        "residual_max_Nm iterations trajectory"
    )
    assert set(keys.split()) <= set(data)
    assert (data["status"], data["move"], data["tool_error_max_rad"]) == ("solved", "joints", None)
    assert data["trajectory"] == str(tmp_path / "a" / "joints.csv")
    assert 0 < data["tool_error_max_m"] < 1e-6
    assert Trajectory.load(data["trajectory"])["tau_m"].shape[1] == 2


@needs_compiler
def test_baselines_of_a_model_with_uncertainty_have_no_prediction(ask, tmp_path):
    """Robots are drawn about an exact solution only, as of `closed-form`."""
    file = tmp_path / "unsure.toml"
    text = (ROOT / "models" / "elbow.toml").read_text()
    file.write_text(text + "\n[uncertainty]\nstiffness = 0.1\n")
    words = "solve", file, "--no-verify", "--method"
    status, data, err = ask(*words, "rigid")
    assert (status, "prediction" in data) == (0, False)
    assert "predict" not in err
    assert "prediction" in ask(*words, "closed-form")[1]


def test_solve_writes_nothing_unless_asked(ask, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, data, _ = ask("solve", "elbow", "--no-verify")
    assert status == 0 and data["trajectory"] is None and data["tool_error_max_m"] is None
    assert list(tmp_path.iterdir()) == []


def test_solve_prints_a_table(run):
    status, out, _ = run("solve", "elbow", "--no-verify")
    assert status == 0 and "N m" in out and "solved" in out
    assert run("solve", "elbow", "--no-verify", "--quiet")[2] == ""


def test_a_missed_tolerance_is_a_failure_with_its_figures(ask):
    status, data, err = ask("solve", "planar5_nmp", "--mesh", "0.005", "--accuracy", "1e-30")
    assert status == 1 and data["status"] == "tolerance not met"
    assert data["error"].startswith("tolerance not met: ") and data["tool_error_max_m"] > 0
    assert "flexgen: tolerance not met: " in err


def test_active_limits_are_not_a_missed_tolerance():
    solution = flexgen.solve("planar5_nmp")
    simulation = replace(solution.simulation, tool_error_max_m=3.9e-10)
    rows = figure_rows(replace(solution, simulation=simulation))
    assert ("tool error open loop, largest", "< 0.1", "um") in [
        (label, round(value, 9) if isinstance(value, float) else value, unit)
        for label, value, unit in rows
    ]
    simulation = replace(simulation, tool_error_max_m=0.0125)
    limited = replace(
        solution, status=Status.LIMITS_ACTIVE, simulation=simulation, plan_error_max_m=2e-9
    )
    text = " ".join(figures(figure_rows(limited)).split())
    assert "status limits active" in text
    assert (
        "distance of the tool from the reference at the same time (limits active), largest 12.5 mm"
        in text
    )
    assert "simulated error from the modified path, largest < 0.0001 mm" in text
    strays = SimpleNamespace(
        status=Status.TOLERANCE_NOT_MET,
        stopped="",
        warnings=(),
        details={},
        method="collocation",
        simulation=None,
        tool_error_max_m=0.1,
        tool_error_max_rad=None,
        plan_error_max=3e-3,
        plan_error_max_m=2e-4,
        plan_error_max_rad=3e-3,
    )
    assert (
        "deviates from the plan by 200 um and 3 mrad, more than the accuracy 1e-06"
        in problem_of(strays, 1e-6)
    )
    strays.plan_error_max = None
    assert "deviates from the path by 100 mm, more than the accuracy 1e-06" in problem_of(
        strays, 1e-6
    )


@pytest.mark.parametrize(
    "words",
    [
        ["--move", "nosuch"],
        ["--set", "motor.m1.ratio=0"],
        ["--method", "closed-form", "--limits"],
    ],
)
def test_solve_of_an_impossible_move_fails_with_a_message(ask, words):
    status, data, err = ask("solve", "elbow", *words)
    assert status == 1 and err.strip().endswith(data["error"])


@pytest.mark.parametrize(
    "words",
    [
        ["--method", "magic"],
        ["--out", "torque.txt"],
        ["--mesh", "0"],
        ["--mesh", "-1e-3"],
        ["--mesh", "fine"],
        ["--preview", "-0.1"],
        ["--accuracy", "nan"],
        ["--mov", "line"],
    ],
)
def test_solve_usage(ask, words):
    assert ask("solve", "elbow", *words)[0] == 2


def test_simulate(ask, run, trajectory, tmp_path):
    status, data, _ = ask("simulate", "planar5_nmp", trajectory, "--out", tmp_path / "moved.npz")
    assert status == 0
    keys = (
        "model tool_error_max_m tool_error_max_rad held_s later_error_max_m later_error_max_rad "
        "motor_feedback growth growth_whole open_loop_error_max_m open_loop_error_max_rad "
        "defect_max_m defect_max_rad energy_error torque_max_Nm speed_max_rad_s evaluations "
        "wall_s trajectory"
    )
    assert list(data) == keys.split()
    assert data["tool_error_max_m"] < 1e-6 and data["energy_error"] < 1e-9
    assert Trajectory.load(data["trajectory"])["q_a"].shape[1] == 3
    status, text, _ = run("simulate", "planar5_nmp", trajectory)
    assert status == 0 and "energy error" in text


def test_simulate_with_a_trajectory_of_another_model(ask, trajectory, tmp_path):
    status, data, _ = ask("simulate", "elbow", trajectory)
    assert status == 1 and "take the model that it was written for" in data["error"]
    for name, content in (("a.npz", b"\x00\x01"), ("b.csv", b"1,2\n3\n"), ("c.npz", b"")):
        (tmp_path / name).write_bytes(content)
        status, data, _ = ask("simulate", "elbow", tmp_path / name)
        assert status == 1 and name in data["error"]
    assert ask("simulate", "elbow", tmp_path)[0] == 1
    assert ask("simulate", "elbow", tmp_path / "nosuch.npz")[0] == 1


# --- what is wrong with files --------------------------------------------------------------------
@pytest.mark.parametrize("verb", ["describe", "derive", "analyze", "generate", "solve", "run"])
@pytest.mark.parametrize(
    "content",
    [b"", b"\xff\xfe\x00", b"name = ", b"name = 'a'\n", b"[" * 5000, b'{"name": "json"}'],
    ids=range(6),
)
def test_bad_model_files(ask, tmp_path, verb, content):
    file = tmp_path / "bad.toml"
    file.write_bytes(content)
    status, data, err = ask(verb, file)
    assert (
        status == 1
        and data["error"].startswith(f"{file}:")
        and err == f"flexgen: {data['error']}\n"
    )


@pytest.mark.parametrize(
    "model", ["nosuch", "nosuch.toml", "/", "models/", "a@b@c", "@", "", "..", "x" * 5000, "\0"]
)
def test_models_that_are_not_there(ask, model):
    status, data, _ = ask("describe", model)
    assert status == 1 and data["error"]


def test_paths_that_cannot_be_written(ask, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.npz").mkdir()
    for words in (
        ["solve", "elbow", "--no-verify", "--out", tmp_path / "file" / "a.npz"],
        ["solve", "elbow", "--no-verify", "--out", tmp_path / "folder.npz"],
        ["solve", "elbow", "--no-verify", "--report", tmp_path / "file"],
        ["derive", "elbow", "--out", tmp_path / "file" / "a.txt"],
        ["generate", "elbow", "--out", tmp_path / "file" / "c"],
        ["analyze", "elbow", "--report", tmp_path / "file"],
        ["run", "elbow", "--report", tmp_path / "file" / "report"],
    ):
        status, data, _ = ask(*words)
        assert status == 1 and str(tmp_path) in data["error"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk(ask):
    with open("/dev/full", "w") as full:
        answer = subprocess.run(
            [sys.executable, "-m", "flexgen", "models"],
            cwd=ROOT,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert (
        answer.returncode == 1
        and answer.stderr.startswith("flexgen: cannot write to standard output")
        and answer.stderr.count("\n") == 1
    )


# --- usage, interruption, noise ------------------------------------------------------------------
def test_usage(run):
    for words in (
        ["nosuch"],
        ["describe"],
        ["describe", "a", "b"],
        ["models", "--nosuch"],
        ["solve", "elbow", "--out"],
    ):
        status, out, err = run(*words)
        assert status == 2 and out == "" and err.startswith("usage: ")


def test_help(run):
    status, text, _ = run("--help")
    assert status == 0 and run() == (0, text, "")
    for verb in (
        "models",
        "describe",
        "derive",
        "analyze",
        "generate",
        "solve",
        "plan",
        "simulate",
        "run",
    ):
        assert verb in text
        status, own, _ = run(verb, "--help")
        assert status == 0 and "--json" in own
    assert run("--version")[1].startswith("flexgen ")


def test_help_of_generate_lists_the_functions_and_loads_nothing_heavy():
    code = (
        "import sys; from flexgen.cli.main import main; assert main(['generate', '--help']) == 0\n"
        "print(*{name.partition('.')[0] for name in sys.modules}, file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    listed = done.stdout.partition("functions:\n")[2].splitlines()
    names = [row.name for row in TABLE if not split_product(row.name)[1]]
    assert [line.split()[0] for line in listed if line[:4].strip()] == [
        *names,
        "NAME_jvp",
        "NAME_vjp",
    ]
    assert not {"numpy", "casadi", "scipy", "sympy", "matplotlib"} & set(done.stderr.split())


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["desribe", "elbow"], "'describe'"),
        (["solve", "elbow", "--method", "colocation"], "'collocation'"),
        (["solve", "elbow", "--mov", "line"], "'--move'"),
        (["generate", "elbow", "--precisoin"], "'--precision'"),
        (["analyze", "elbow", "--move", "lin"], "'line'"),
        (["solve", "elbow", "--move", "jonts"], "'joints'"),
        (
            [
                "solve",
                "planar5_nmp",
                "--moves",
                ROOT / "examples" / "program.toml",
                "--move",
                "seem",
            ],
            "'seam'",
        ),
    ],
)
def test_misspelled_words_get_a_suggestion(ask, words, meant):
    status, data, _ = ask(*words)
    assert status in (1, 2) and data["error"].endswith(f"; did you mean {meant}?")


def test_misspelled_models_get_a_suggestion(ask):
    status, data, _ = ask("describe", "planar5_nmpp")
    assert status == 1 and "planar5_nmp (there are: " in data["error"]


def noise(args, log):
    print("from Python")
    os.write(1, b"from C\n")
    log("progress")
    return result.VerbResult(
        {"x": float("nan"), "y": [np.float64("inf"), np.arange(2)]}, "done", warnings=["careful"]
    )


def test_only_the_result_is_on_standard_output(ask, run, monkeypatch):
    monkeypatch.setattr(robot, "models", noise)
    _, data, err = ask("models")
    assert data == {"x": None, "y": [None, [0, 1]]}
    for text in ("from Python", "from C", "progress", "flexgen: warning: careful"):
        assert text in err
    assert run("models")[1] == "done\n"


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (KeyboardInterrupt(), 130),
        (RuntimeError("broken"), 1),
        (MemoryError(), 1),
        (SystemExit(3), 1),
    ],
)
def test_unexpected_ends(ask, monkeypatch, error, expected):
    def fail(args, log):
        raise error

    monkeypatch.setattr(robot, "models", fail)
    status, data, err = ask("models")
    assert status == expected and data["error"] and err.startswith("flexgen: ")


@pytest.mark.parametrize(
    "error",
    [
        np.linalg.LinAlgError("Singular matrix"),
        OverflowError("too large"),
        ZeroDivisionError("division"),
        ArithmeticError(),
        ValueError("array must not contain infs or NaNs"),
        ValueError("Array must not contain infs or nans."),
    ],
)
def test_numerical_failures_name_the_model(ask, monkeypatch, error):
    def fail(args, log):
        warnings.warn("overflow encountered", RuntimeWarning, stacklevel=1)
        raise error

    monkeypatch.setattr(robot, "analyze", fail)
    status, data, err = ask("analyze", "elbow@rigid")
    assert status == 1 and data["error"].startswith("analyze elbow@rigid: the computation failed")
    assert "the numbers of the model" in data["error"] and err == f"flexgen: {data['error']}\n"


def test_absurd_numbers_are_refused(ask):
    for value in ("1e308", "5e-324", "1e15"):
        status, data, _ = ask("solve", "elbow", "--set", f"motor.m1.inertia={value}")
        assert (
            status == 1 and "expected a number of magnitude 1e-18 to 1e12 (or 0)" in data["error"]
        )


def test_interruption_that_a_solver_swallows(ask, monkeypatch):
    def swallow(args, log):
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        return result.VerbResult({"half": 1}, "half")

    monkeypatch.setattr(robot, "models", swallow)
    status, data, _ = ask("models")
    assert status == 130 and data == {"error": "interrupted"}


def test_closed_pipe_is_quiet():
    reader, writer = os.pipe()
    os.close(reader)
    answer = subprocess.run(
        [sys.executable, "cli.py", "models"],
        cwd=ROOT,
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(writer)
    assert answer.stderr == "" and answer.returncode == 141


def test_clone_without_installation(tmp_path):
    """From any directory, without site-packages: an error message instead of an import error."""
    command = [sys.executable, "-S", "-E", str(ROOT / "cli.py")]
    answer = subprocess.run([*command, "--help"], cwd=tmp_path, capture_output=True, text=True)
    assert answer.returncode == 0 and "describe" in answer.stdout
    answer = subprocess.run(
        [*command, "models", "--json"], cwd=tmp_path, capture_output=True, text=True
    )
    assert answer.returncode == 1 and "make setup" in json.loads(answer.stdout)["error"]
    assert "Traceback" not in answer.stderr


def test_output_in_an_ascii_terminal():
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    command = [
        sys.executable,
        "-m",
        "flexgen",
        "describe",
        "elbow",
        "--set",
        'description="Ümlaut"',
    ]
    answer = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True)
    assert (
        answer.returncode == 0 and b"mlaut" in answer.stdout and b"Traceback" not in answer.stderr
    )


# --- printing ------------------------------------------------------------------------------------
def test_tables_are_aligned():
    text = table([["a", 1.0, "m"], ["long", None, ""]], ("what", "value", "unit"))
    assert text.splitlines() == [
        "what  value  unit",
        "----  -----  ----",
        "a         1  m",
        "long      -",
    ]


def test_numbers_as_text():
    given = [0.00012345, 123456.0, 1.5, float("nan"), None, 3, "x", True, -2500.4, 1e-12]
    assert [number(x) for x in given] == [
        "0.0001234",
        "123456",
        "1.5",
        "-",
        "-",
        "3",
        "x",
        "yes",
        "-2500",
        "1e-12",
    ]
    assert roots([[None, 1.0], [1.0, None], [-2.0, 0.0]]) == ["- (2 times)", "-2"]
    assert roots([[-1.0, -2.0], [-1.0, 2.0], [-3.0, 0.0], [-3.0, 0.0]]) == [
        "-1 +/- 2i",
        "-3 (2 times)",
    ]


def test_json_types():
    assert plain({"p": Path("a"), "t": (1, 2.0), "b": True, 3: np.int64(4)}) == {
        "p": "a",
        "t": [1, 2.0],
        "b": True,
        "3": 4,
    }
    assert json.loads(as_json({"x": float("-inf")})) == {"x": None}


# --- the main job --------------------------------------------------------------------------------
@pytest.mark.slow
@needs_compiler
@pytest.mark.usefixtures("undrawn")
def test_run_and_reports(ask, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, data, _ = ask("run", "planar5_nmp")
    assert (
        status == 0
        and data["solve"]["status"] == "solved"
        and data["load"]["difference_Nm"] < 1e-9
    )
    assert data["report"] == str(Path("reports", "planar5_nmp", "index.html"))
    assert "<svg" in Path(data["report"]).read_text(encoding="utf-8")
    assert Trajectory.load(data["solve"]["trajectory"])["tau_m"].shape[1] == 2
    assert Path("generated", "planar5_nmp", "planar5_nmp.h").is_file()
    status, text, _ = run("run", "planar5_nmp")
    assert status == 0 and text.splitlines()[-1] == f"unchanged {Path('generated', 'planar5_nmp')}"
    status, data, _ = ask("solve", "planar5_nmp", "--no-verify", "--report", "r")
    assert status == 0 and Path(data["report"]).is_file()
    status, data, _ = ask("analyze", "planar5_nmp", "--report", "a")
    assert status == 0 and "<svg" in Path(data["report"]).read_text(encoding="utf-8")


@pytest.mark.parametrize("last", [1, 2])
def test_of_several_moves_those_before_an_interruption_are_given(last, monkeypatch, capsys):
    told = []

    def one(args, equations, move, *_):
        told.append(move.name)
        if len(told) == last:
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        return result.VerbResult({"move": move.name}, move.name, interrupted=len(told) == last)

    monkeypatch.setattr("flexgen.cli.verbs.solve.solve_one", one)
    assert main(["solve", "elbow", "--move", "line", "--move", "joints", "--json", "-q"]) == 130
    assert (
        [row["move"] for row in json.loads(capsys.readouterr().out)["solutions"]]
        == told
        == ["line", "joints"][:last]
    )
