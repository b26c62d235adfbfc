"""The command line on a terminal: width of tables, poses, several moves, details, log file,
completion, failures.
"""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from flexgen.base.errors import SolverError
from flexgen.cli.main import main
from flexgen.cli.parser import build_parser, parse
from flexgen.cli.verb_tables.verb_texts import LISTS
from flexgen.cli.verbs.completion import verbs
from flexgen.codegen.build import compiler
from flexgen.model.catalogue.catalogue import models
from flexgen.studies.sweeps.summary import group_reasons
from flexgen.views.reports.text_tables import fit_tables, table

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def run(capfd):
    """Run a command line in this process; (status, standard output, standard error)."""

    def call(*words):
        capfd.readouterr()
        status = main([str(word) for word in words])
        captured = capfd.readouterr()
        return status, captured.out, captured.err

    return call


# --- width ---------------------------------------------------------------------------------------

ROWS = [
    ["planar5_nmp", 2, "an arm with a very long description, of many words that fill a line", 1.5]
]
HEAD = ("name", "motors", "description", "mass kg")


@pytest.mark.parametrize("width", [40, 50, 60, 80, 100])
def test_tables_fit(width):
    with fit_tables(width):
        text = table(ROWS, HEAD)
    assert max(map(len, text.splitlines())) <= width
    words = set(re.findall(r"\w+", text))
    assert set(ROWS[0][2].replace(",", "").split()) <= words  # wrapped, not cut
    assert ("left out" in text) == ("mass" not in text.splitlines()[0])


def test_columns_that_do_not_fit_are_named():
    with fit_tables(30):
        text = table(
            [["a" * 10, 1.0, 2.0, 3.0]], ("name", "first number", "second number", "third")
        )
    assert "first number" in text.splitlines()[0] and "second number" not in text.splitlines()[0]
    assert "(left out: second number, third;" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 30


def test_without_a_terminal_tables_are_whole():
    assert max(map(len, table(ROWS, HEAD).splitlines())) > 80


def on_a_terminal(columns: int, *words: str) -> str:
    """Standard output of a command line on a terminal with so many columns."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    command = [sys.executable, "-m", "flexgen", *words]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=slave, stderr=subprocess.DEVNULL, env=environment
    ) as process:
        os.close(slave)
        seen = b""
        while True:
            try:
                part = os.read(master, 65536)
            except OSError:
                break
            if not part:
                break
            seen += part
    os.close(master)
    assert process.returncode == 0
    return seen.decode().replace("\r\n", "\n")


@pytest.mark.parametrize(
    "words", [["models"], ["describe", "manutec_r3_efjm"], ["analyze", "planar5_nmp"]]
)
@pytest.mark.parametrize("columns", [60, 100])
def test_no_line_is_wider_than_the_terminal(words, columns):
    text = on_a_terminal(columns, *words)
    assert max(map(len, text.splitlines())) <= columns


# --- arguments -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        "--pose 0.3 -1.1 0",
        "--pose 0.3,-1.1,0",
        "--pose=0.3,-1.1,0",
        "--pose 0.3, -1.1, 0",
        "--pose .3 -11e-1 +0 --json",
    ],
)
def test_poses_with_spaces_or_commas(words):
    for order in (["planar5_nmp", *words.split()], [*words.split(), "planar5_nmp"]):
        args = parse(["analyze", *order])
        assert args.pose == [0.3, -1.1, 0.0] and args.model == "planar5_nmp"


def test_a_second_number_after_other_options_is_refused(run):
    status, _, err = run("solve", "elbow", "--mesh", "0.01", "0.02")
    assert status == 2 and "unknown arguments 0.02" in err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_several_moves_are_solved(run, tmp_path):
    words = ["solve", "manutec_r3", "--no-verify", "--move", "line", "--move", "joints"]
    status, out, _ = run(*words, "--out", tmp_path / "m.csv", "--report", tmp_path / "r")
    assert status == 0 and "manutec_r3, move line" in out and "manutec_r3, move joints" in out
    assert {path.name for path in tmp_path.glob("*.csv")} == {"m_line.csv", "m_joints.csv"}
    assert all((tmp_path / "r" / name / "index.html").is_file() for name in ("line", "joints"))
    status, out, err = run(*words, "--json")
    assert status == 0 and [s["move"] for s in json.loads(out)["solutions"]] == ["line", "joints"]
    assert "move joints (2 of 2)" in err


def test_a_wrong_second_move_is_refused_before_the_first_is_solved(run, monkeypatch):
    monkeypatch.setattr("flexgen.inversion.solve.solve", None)
    status, _, err = run("solve", "planar5_nmp", "--move", "line", "--move", "lines")
    assert status == 1 and "given 'lines', expected one of model planar5_nmp: line" in err


SENT = {
    "--hold zoh": True,
    "--sample-time 1e-3": True,
    "--delay 1e-9": True,
    "--hold spline": False,
}


@pytest.mark.parametrize("words", SENT)
def test_a_file_of_sent_torques_is_checked_before_the_move_is_solved(
    run, monkeypatch, tmp_path, words
):
    """Where the controller does not send the samples of the trajectory, they have a file."""
    (tmp_path / "x_command.csv").mkdir()

    def fail(*arguments, **options):
        raise SolverError("solved")

    monkeypatch.setattr("flexgen.inversion.solve.solve", fail)
    _, _, err = run("solve", "elbow", *words.split(), "--out", tmp_path / "x.csv")
    assert ("x_command.csv" in err) == SENT[words] != ("solved" in err)


@pytest.mark.parametrize(("model", "told"), [("manutec_r3_18", True), ("carried_arm", False)])
def test_minutes_of_the_full_model_are_announced(run, monkeypatch, model, told):
    monkeypatch.setattr("flexgen.inversion.solve.solve", None)
    _, _, err = run("solve", model, "--method", "full", "-v")
    text = "method full with 12 coordinates takes many minutes; --method lq takes seconds"
    assert (text in err) == told


@pytest.mark.parametrize("verb", ["analyze", "run"])
def test_a_second_move_is_refused_elsewhere(run, verb):
    status, _, err = run(verb, "planar5_nmp", "--move", "line", "--move", "arc")
    assert status == 2 and "--move: given twice (line and arc), expected one" in err


# --- details and log -----------------------------------------------------------------------------


@pytest.mark.slow
def test_verbose_shows_times_and_details(run):
    _, plain, short = run("solve", "elbow")
    status, out, err = run("solve", "elbow", "-v")
    assert status == 0 and "integrator of the simulation" in out and "integrator" not in plain
    assert all(re.match(r"\[ +\d+\.\d\d s\] ", line) for line in err.splitlines())
    assert len(err.splitlines()) == len(short.splitlines()) > 0
    assert "poles, 1/s: " in run("analyze", "elbow", "--verbose")[1]
    assert run("models", "-v", "-q")[0] == 2


def test_the_log_has_messages_and_results(run, tmp_path):
    log = tmp_path / "f.log"
    assert run("solve", "elbow", "--quiet", "--log", log)[::2] == (0, "")
    assert run("describe", "nosuch", "--log", log)[0] == 1
    lines = log.read_text(encoding="utf-8").splitlines()
    assert all(re.match(r"\d{4}-\d\d-\d\dT[\d:.]+[-+]\d\d:\d\d ", line) for line in lines)
    texts = [line.partition(" ")[2] for line in lines]
    assert texts[0] == f"flexgen 0.3.0: solve elbow --quiet --log {log}"
    assert any(text.startswith("status") and text.endswith("solved") for text in texts)
    assert "exit status 0" in texts and texts[-1] == "exit status 1"
    assert any(text.startswith("flexgen: ") and "nosuch" in text for text in texts)


def test_a_log_that_cannot_be_written_is_refused(run, tmp_path):
    status, out, err = run("models", "--json", "--log", tmp_path / "no" / "f.log")
    assert (
        status == 1
        and json.loads(out)["error"].startswith("--log: cannot write ")
        and "f.log" in err
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_log_on_a_full_disk_ends_and_the_computation_continues():
    words = [sys.executable, "-m", "flexgen", "models", "--log", "/dev/full"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    told = "flexgen: warning: cannot write to /dev/full (No space left on device); the log ends"
    assert "elbow" in done.stdout and done.stderr.count(told) == 1


def test_messages_have_the_time_since_the_start_where_it_is_asked_for(run, tmp_path):
    log = tmp_path / "f.log"
    err = run("solve", "elbow", "--no-verify", "--log", log)[2]
    assert err and not re.search(r"^\[ *\d+\.\d\d s\] ", err, re.MULTILINE)
    timed = run("solve", "elbow", "--no-verify", "--verbose")[2].splitlines()
    assert timed and all(re.match(r"\[ *\d+\.\d\d s\] ", line) for line in timed)
    texts = {line.partition(" ")[2] for line in log.read_text(encoding="utf-8").splitlines()}
    assert set(err.splitlines()) <= texts


# --- completion ----------------------------------------------------------------------------------


@pytest.mark.parametrize("shell", LISTS["SHELLS"]())
def test_completion_knows_verbs_options_and_models(run, shell):
    status, script, _ = run("completion", shell)
    assert (
        status == 0
        and json.loads(run("completion", shell, "--json")[1])["script"].strip() == script.strip()
    )
    for verb in verbs(build_parser()):
        assert re.search(rf"\b{verb}\b", script)
    words = ["collocation", *(row["name"] for row in models({}))]
    assert all(re.search(rf"\b{word}\b", script) for word in words)
    for option in ("robustness", "amalgamate", "pose"):
        assert (f"-l {option} " if shell == "fish" else f"--{option}") in script
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=script, text=True, check=True)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["so"], ["solve"]),
        (["solve", "planar5_n"], ["planar5_nmp"]),
        (["solve", "x", "--rob"], ["--robustness"]),
        (["solve", "--method", "coll"], ["collocation"]),
        (["solve", "--out", "x"], []),
        (["completion", ""], list(LISTS["SHELLS"]())),
    ],
)
def test_bash_completes(run, words, expected):
    script = run("completion", "bash")[1]
    typed = " ".join(f"'{word}'" for word in words)
    ask = f"COMP_WORDS=(flexgen {typed})\nCOMP_CWORD={len(words)}\n_flexgen\n"
    done = subprocess.run(
        ["bash"],
        input=f'{script}\n{ask}printf "%s\\n" "${{COMPREPLY[@]}}"',
        text=True,
        capture_output=True,
        check=True,
    )
    assert done.stdout.split() == expected and done.stderr == ""


# --- time and failures ---------------------------------------------------------------------------


def test_a_long_compilation_is_announced(tmp_path):
    for name, size in (("a.c", 2_000_000), ("b.c", 100_000_000)):
        with (tmp_path / name).open("wb") as file:
            file.truncate(size)
    assert compiler.expected_time(tmp_path, ["a.c"], 1) == ""
    assert compiler.expected_time(tmp_path, ["a.c"] * 4, 1) == ", about 56 s"
    assert compiler.expected_time(tmp_path, ["b.c"], 8) == ", about 12 min"


def test_a_method_that_takes_minutes_is_announced(run, monkeypatch):
    def stop(*arguments, **options):
        raise MemoryError

    monkeypatch.setattr("flexgen.inversion.solve.solve", stop)
    assert (
        "method full with 12 coordinates takes many minutes"
        in run("solve", "manutec_r3_18", "--method", "full")[2]
    )
    assert "takes many minutes" not in run("solve", "elbow", "--method", "full")[2]


def test_failures_are_grouped_by_reason():
    errors = ["error 1.5e-3 above 1e-5", "no equilibrium", "error 22 above 1e-6"]
    groups = group_reasons([3, 5, 8], errors)
    assert groups == [
        {"reason": errors[0], "cases": [3, 8]},
        {"reason": "no equilibrium", "cases": [5]},
    ]


@pytest.mark.slow
def test_a_sweep_prints_the_reasons(run, tmp_path):
    grid = tmp_path / "grid.toml"
    grid.write_text(
        'models = ["elbow"]\n'
        'moves = ["line", "nosuch"]\n'
        "\n"
        "[parameters]\n"
        '"element.upper.body.mass" = [10.0, 12.0]\n'
        "\n"
        "[options]\nverify = false\n"
    )
    words = ["sweep", grid, "--workers", "0", "--out"]
    status, out, err = run(*words, tmp_path / "a")
    assert status == 0 and "4 cases, 2 failed" in out
    (line,) = [line for line in err.splitlines() if "failed (" in line]
    assert line.startswith("flexgen: warning: 2 cases failed (") and "'nosuch'" in line
    assert "4 cases; the remaining time is printed" in err
    _, out, _ = run(*words, tmp_path / "b", "--json")
    (group,) = json.loads(out)["failures"]
    assert len(group["cases"]) == 2 and "nosuch" in group["reason"]
    _, out, _ = run(*words, tmp_path / "c", "-v")
    assert len(re.findall(r"^case \d: .*nosuch", out, re.MULTILINE)) == 2
