"""No result is lost: every verb that fits, times every way to lose its result.

The verbs that fit are those of the verb table that read a measurement; one that is new and not in
`FITS` fails the first test. Each verb has a time limit, or is one of `SHORT`; `PARTS` are those
whose result has parts, such as the rows of a sweep. Each runs as a user runs it, in a separate
process, which counts the steps of its search, or the parts of its result, on standard error.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.cli.main import main
from flexgen.cli.verb_tables.verbs import VERBS
from flexgen.identification.estimator.minimize import minimize
from flexgen.identification.records.recording_writer import RecordingWriter

pytestmark = needs_compiler

# Names of positional arguments that are measurements.
MEASUREMENTS = {"data", "poses", "record", "recordings"}
# The command line in a process that tells of the first step of a search, and then meets with
# `EVENT`.
SCRIPT = """
import os, signal, sys, time, types
import flexgen.base.calls.deadline as deadline
late = 0.0
def told(first):
    def told_first(*given):
        first(*given)
        end()
    return told_first
def end():
    global late
    print("STEP", file=sys.stderr, flush=True)
    event, os.environ["EVENT"] = os.environ["EVENT"], ""
    if event == "interrupt":
        os.kill(os.getpid(), signal.SIGINT)
    if event == "time":
        late = 1e6
deadline.best_known = told(deadline.best_known)
deadline.part_known = told(deadline.part_known)
deadline.time = types.SimpleNamespace(perf_counter=lambda: time.perf_counter() + late)
from flexgen.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


@dataclass(frozen=True)
class Fit:
    """A form of a verb that fits.

    The model, its further words, the ending of its file, the variant it writes.
    """

    verb: str
    model: str
    words: Sequence[str]
    ending: str = ".toml"
    variant: str = ""
    numbers: str = ""  # in the text that is printed
    quick: bool = False


FITS = {
    "identify": Fit(
        "identify", "sampled.toml", ["frf.npz", "--starts", "1"], numbers="q1.stiffness"
    ),
    "identify an overlay": Fit(
        "identify", "overlay.toml", ["frf.npz", "--starts", "1"], numbers="q1.stiffness"
    ),
    "identify --rigid": Fit(
        "identify", "sampled.toml", ["raw/recordings.toml", "--rigid"], numbers="base parameters"
    ),
    "identify --segments": Fit(
        "identify",
        "sampled.toml",
        ["raw/recordings.toml", "--segments", "0.1", "--free", "q1.stiffness"],
        numbers="q1.stiffness",
    ),
    "identify --refine": Fit(
        "identify",
        "sampled.toml",
        ["frf.npz", "--starts", "1", "--refine", "data.npz"],
        numbers="q1.stiffness",
    ),
    "calibrate": Fit(
        "calibrate",
        "overlay.toml",
        ["poses.csv", "--free", "zeros", "--folds", "0"],
        variant="calibrated",
        numbers="q1.zero",
        quick=True,
    ),
    "identify-gears": Fit(
        "identify-gears",
        "overlay.toml",
        ["record.csv", "--no-hysteresis", "--band-hz", "15"],
        variant="identified",
        numbers="q1.stiffness",
    ),
    "identify-load": Fit("identify-load", "sampled.toml", ["record.csv"], ".json", numbers="load"),
    "identify-servo": Fit(
        "identify-servo", "sampled.toml", ["servo.csv"], numbers="position gain"
    ),
}
# Verbs whose result has parts, with the words of the command line (OUT: the file or folder) and a
# number of the parts in their text or JSON.
PARTS = {
    "control": "control sampled.toml --plant soft:stiffness=0.8 --move joints --out OUT.npz",
    "score": "score two_link --report OUT",
    "sweep": "sweep grid.toml --shard-size 1 --workers 0 --out OUT",
    "predict": "predict unsure.toml --move joints --robots 40 --out OUT.json",
    "excite": "excite sampled.toml --poses 2 --period-s 1 --lines 6 --out OUT.npz",
    "measure": "measure sampled.toml plan.npz --out OUT.npz --raw OUT_raw",
    "frf": "frf data.npz --out OUT.npz",
}
# Verbs whose result cannot have parts: the best of a search, or a motion as a whole.
WHOLE = {"solve", "run", "fastest", "learn", "tune", "simulate", "commission", "identify-spring"}
# Verbs without a time limit: they take seconds, or compile, which a limit does not count.
SHORT = {
    "analyze",
    "check",
    "command-positions",
    "compare-record",
    "compare-shapers",
    "completion",
    "derive",
    "describe",
    "generate",
    "kinematics",
    "models",
    "new",
    "plan",
    "schema",
    "sense",
    "view",
}
EVERY = [
    pytest.param(name, marks=() if fit.quick else pytest.mark.slow) for name, fit in FITS.items()
]
# One case of the matrix runs with the quick tests.
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in FITS]


def verbs_that_fit() -> set[str]:
    """Verbs with a model and a measurement."""
    return {
        name
        for name, verb in VERBS.items()
        if verb.takes_model != "none"
        and any(option.place and option.name in MEASUREMENTS for option in verb.options())
    }


def sources(folder: Path) -> None:
    """An arm as a model file with a sampled move, and as an overlay of a URDF file.

    Paths are relative to both.
    """
    assert main(["new", "pl", "--out", str(folder / "pl.toml"), "-q"]) == 0
    text = (folder / "pl.toml").read_text()
    tracker = '\n[[sensor]]\nname = "p"\ntype = "tracker"\nunit = "m"\n'
    move = '\n[[move]]\nname = "track"\ntype = "sampled"\nfile = "track.csv"\n'
    t = np.linspace(0.0, 1.0, 60)
    law = t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)
    rows = "".join(
        f"{a:.9f},{0.1 * b:.12f},{0.5 + 0.1 * b:.12f}\n" for a, b in zip(t, law, strict=True)
    )
    (folder / "track.csv").write_text("t,q1,q2\n" + rows)
    (folder / "sampled.toml").write_text(text + move)
    flexgen.export_urdf(str(folder / "pl.toml"), folder / "overlay.urdf")
    overlay = (folder / "overlay.toml").read_text()
    assert 'file = "overlay.urdf"' in overlay
    (folder / "overlay.toml").write_text(overlay + tracker + move)


def responses(folder: Path) -> None:
    """An experiment on a robot whose first spring is softer, its responses, and all its
    samples.
    """
    robot = flexgen.read(folder / "sampled.toml")
    softer = {"element.upper.dof.q1.gear.spring.stiffness": 1.1e5}
    truth = flexgen.read(folder / "sampled.toml", overrides=softer)
    plan = flexgen.excite(robot, poses=2, period_s=1.0, lines=12, transients=1, speed_rms=0.05)
    writer = RecordingWriter(folder / "raw", plan, robot)
    experiment = flexgen.measure(plan, truth, raw=writer)
    writer.finish()
    experiment.save(folder / "data.npz")
    flexgen.frf(experiment).save(folder / "frf.npz")


def poses(folder: Path) -> None:
    """Positions of the tracker, of axes with other zeros."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 2))
    seen = flexgen.read(folder / "overlay.toml")
    points = flexgen.tracker_positions(seen, q + np.array([0.01, -0.02]))[:, 0]
    rows = [",".join(f"{x:.9f}" for x in (*a, *b)) for a, b in zip(q, points, strict=True)]
    (folder / "poses.csv").write_text("\n".join(["q1_rad,q2_rad,p_x_m,p_y_m,p_z_m", *rows]) + "\n")


def record(folder: Path) -> None:
    """Motor angles and torques of a move in the closed loop."""
    run = flexgen.control(folder / "sampled.toml", "joints", sample_time=1e-3)
    run.trajectory().save(folder / "record.csv")


def servo(folder: Path) -> None:
    """Commands and angles of the joints."""
    robot = flexgen.read(folder / "sampled.toml")
    sent = flexgen.command_positions(robot, "joints").today
    joints = np.linalg.inv(robot.eta).T
    angles = [sent.reference.motion["q_m"] @ joints, sent.nominal.measured @ joints]
    rows = np.column_stack([sent.reference.time, np.degrees(np.hstack(angles))])
    lines = [",".join(f"{x:.9f}" for x in row) for row in rows]
    head = "time_s,q1_command_deg,q2_command_deg,q1_deg,q2_deg"
    (folder / "servo.csv").write_text("\n".join([head, *lines]) + "\n")


def parts(folder: Path) -> None:
    """A model with tolerances, a grid, and a plan for two poses."""
    sources_of_parts = folder / "unsure.toml"
    tolerances = "\n[uncertainty]\nstiffness = 0.1\n"
    sources_of_parts.write_text((folder / "sampled.toml").read_text() + tolerances)
    grid = 'models = ["elbow"]\nmethods = ["closed-form"]\n[random]\ncount = 3\n'
    (folder / "grid.toml").write_text(grid)
    responses(folder)
    robot = flexgen.read(folder / "sampled.toml")
    plan = flexgen.excite(robot, poses=2, period_s=1.0, lines=6, transients=1, speed_rms=0.05)
    plan.save(folder / "plan.npz")


MAKERS = {
    "frf.npz": responses,
    "raw/recordings.toml": responses,
    "poses.csv": poses,
    "record.csv": record,
    "servo.csv": servo,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("fits")
    sources(made)
    return made


@dataclass(frozen=True)
class Ran:
    """End of a verb: exit status and its texts."""

    code: int
    out: str
    err: str

    @property
    def steps(self) -> int:
        return self.err.count("STEP\n")


def run(folder: Path, fit: Fit, out: Path, *more: str, event: str = "", model: str = "") -> Ran:
    """Run a form of a verb in its folder."""
    if not (folder / fit.words[0]).exists():
        MAKERS[fit.words[0]](folder)
    words = [fit.verb, model or fit.model, *fit.words, "--out", str(out), *more]
    environment = os.environ | {"EVENT": event}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *words], cwd=folder, env=environment, text=True,
        capture_output=True, timeout=300, check=False,
    )  # fmt: skip
    return Ran(done.returncode, done.stdout, done.stderr)


def numbers_in(fit: Fit, file: Path) -> str:
    """The text of a result; a model file can be read again, from its own folder."""
    text = file.read_text()
    if fit.ending == ".toml" and fit.verb != "identify-servo":
        flexgen.read(file, fit.variant or None).move("track")
    return text


def test_the_matrix_has_every_verb_that_fits() -> None:
    assert verbs_that_fit() - SHORT - WHOLE == {fit.verb for fit in FITS.values()}
    for name in verbs_that_fit() - SHORT:
        assert any(option.parameter == "time_limit" for option in VERBS[name].options()), name


def test_a_planted_verb_is_not_in_the_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(VERBS, "identify-hoses", VERBS["identify-servo"])
    known = {fit.verb for fit in FITS.values()} | SHORT | WHOLE
    assert verbs_that_fit() - known == {"identify-hoses"}


def without_a_limit() -> set[str]:
    """Verbs without the option of a time limit; exports write what is there."""
    return {
        name
        for name, verb in VERBS.items()
        if not name.startswith("export ")
        and not any(option.parameter == "time_limit" for option in verb.options())
    }


def test_each_long_verb_has_a_time_limit() -> None:
    """And is one that fits, one whose result has parts, or one whose result is a whole."""
    assert without_a_limit() == SHORT, "add the parameter time_limit, or the verb to SHORT"
    limited = {name for name in VERBS if not name.startswith("export ")} - SHORT
    assert limited == {fit.verb for fit in FITS.values()} | set(PARTS) | WHOLE


def test_a_planted_verb_without_a_limit_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(VERBS, "solve-slowly", VERBS["derive"])
    assert without_a_limit() - SHORT == {"solve-slowly"}
    monkeypatch.setitem(VERBS, "score-slowly", VERBS["score"])
    assert "score-slowly" not in without_a_limit() | set(PARTS) | WHOLE


def run_parts(folder: Path, name: str, out: str, *more: str, event: str = "") -> Ran:
    """Run a verb whose result has parts in its folder."""
    if not (folder / "plan.npz").exists():
        parts(folder)
    words = [*PARTS[name].replace("OUT", out).split(), *more]
    environment = os.environ | {"EVENT": event}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *words], cwd=folder, env=environment, text=True,
        capture_output=True, timeout=300, check=False,
    )  # fmt: skip
    return Ran(done.returncode, done.stdout, done.stderr)


@pytest.mark.slow
@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize(("event", "code"), [("interrupt", 130), ("time", 1)])
def test_a_verb_that_is_ended_writes_the_parts_that_are_done(
    name: str, event: str, code: int, folder: Path
) -> None:
    """With a status that says so, in the text, in JSON and in the exit status."""
    out = f"{event}_{name}"
    done = run_parts(folder, name, out, "--time-limit", "1000", event=event)
    word = {"interrupt": "interrupted", "time": "time limit"}[event]
    assert done.code == code, done.err
    assert done.steps > 0 and word in done.err and "Traceback" not in done.err
    assert f"wrote {out}" in done.out and any(folder.glob(f"{out}*"))
    data = json.loads(
        run_parts(folder, name, f"json_{out}", "--time-limit", "1000", "--json", event=event).out
    )
    assert word in data["error"] and word in json.dumps(
        {k: v for k, v in data.items() if k != "error"}
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", PARTS)
def test_a_limit_that_ends_before_the_first_part_says_so(name: str, folder: Path) -> None:
    done = run_parts(folder, name, f"none_{name}", "--time-limit", "1e-9")
    assert done.code == 1 and "time limit" in done.err and "Traceback" not in done.err
    assert not (folder / f"none_{name}.npz").exists()


@pytest.mark.slow
def test_a_fit_that_has_not_converged_writes_its_best_step(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Marked in the file and in the status: a search whose last step is still too long."""
    if not (folder / "frf.npz").exists():
        responses(folder)

    def unfinished(*given: object, **options: object) -> object:
        return replace(minimize(*given, **options), converged=False)  # type: ignore[arg-type]

    monkeypatch.setattr("flexgen.identification.responses.graybox.minimize", unfinished)
    out = folder / "not_converged.toml"
    words = ["identify", str(folder / "sampled.toml"), str(folder / "frf.npz"), "--out", str(out)]
    assert main([*words, "--starts", "1", "-q"]) == 1
    shown = capsys.readouterr()
    assert "not converged" in shown.err and f"wrote {out}" in shown.out
    assert "not converged" in out.read_text()
    found = re.search(r"^.*stiffness = ([0-9.e+]+).*$", out.read_text(), re.MULTILINE)
    # the spring of the robot that was measured
    assert found is not None and float(found[1]) == pytest.approx(1.1e5, rel=0.05)


@pytest.mark.parametrize("name", SLOW)
def test_relative_paths_lead_to_the_same_files_from_another_folder(
    name: str, folder: Path
) -> None:
    fit = FITS[name]
    out = folder / "other" / "deep" / f"{name.replace(' ', '_')}{fit.ending}"
    done = run(folder, fit, out)
    assert done.code in (0, 1), done.err
    assert fit.numbers in done.out and f"wrote {out}" in done.out
    assert numbers_in(fit, out)


@pytest.mark.parametrize("name", EVERY)
def test_a_file_that_cannot_be_written_is_refused_before_the_search(
    name: str, folder: Path
) -> None:
    fit = FITS[name]
    done = run(folder, fit, Path(f"/proc/flexgen{fit.ending}"))
    assert done.code == 1 and done.steps == 0 and "cannot be written" in done.err
    done = run(folder, fit, folder / "x.wrong")
    assert done.code in (1, 2) and done.steps == 0 and "x.wrong" in done.err


@pytest.mark.parametrize("name", SLOW)
def test_a_file_with_the_numbers_already_is_refused_before_the_search_or_replaced(
    name: str, folder: Path
) -> None:
    """A variant of the name is refused, before; another file is replaced."""
    fit = FITS[name]
    out = folder / f"there{fit.ending}"
    out.write_text("")
    if not fit.variant:
        done = run(folder, fit, out)
        assert done.steps > 0 and numbers_in(fit, out)
        return
    again = folder / f"again_{fit.variant}.toml"
    text = (folder / fit.model).read_text()
    again.write_text(f'{text}\n[variant.{fit.variant}]\nset = {{ "gravity" = [0, 0, -9.8] }}\n')
    done = run(folder, fit, out, model=again.name)
    assert done.code == 1 and done.steps == 0 and fit.variant in done.err
    assert out.read_text() == ""


@pytest.mark.parametrize("name", SLOW)
def test_numbers_are_printed_where_writing_fails_after_the_search(name: str, folder: Path) -> None:
    """A disk that is full when the file is written."""
    fit = FITS[name]
    full = folder / f"full_{name.replace(' ', '_')}{fit.ending}"
    full.symlink_to("/dev/full")
    done = run(folder, fit, full)
    assert done.code == 1 and done.steps > 0
    assert fit.numbers in done.out and "not written" in done.err and "No space left" in done.err
    data = json.loads(run(folder, fit, full, "--json").out)
    assert "not written" in data["error"] and len(data) > 3


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize(("event", "code"), [("interrupt", 130), ("time", 1)])
def test_a_search_that_is_ended_writes_its_best_step(
    name: str, event: str, code: int, folder: Path
) -> None:
    """With a status that says so, in the text, in the exit status and in the file."""
    fit = FITS[name]
    out = folder / f"{event}_{name.replace(' ', '_')}{fit.ending}"
    done = run(folder, fit, out, "--time-limit", "1000", event=event)
    word = {"interrupt": "interrupted", "time": "time limit"}[event]
    assert done.code == code, done.err
    assert fit.numbers in done.out and f"wrote {out}" in done.out
    assert word in done.err and "Traceback" not in done.err
    assert word in numbers_in(fit, out)


@pytest.mark.parametrize("name", SLOW)
def test_a_time_limit_that_ends_before_the_first_step_says_so(name: str, folder: Path) -> None:
    """No file is written, or one of the start values that says so."""
    out = folder / f"none_{name.replace(' ', '_')}{FITS[name].ending}"
    done = run(folder, FITS[name], out, "--time-limit", "1e-9")
    assert done.code == 1 and "time limit" in done.err and "Traceback" not in done.err
    assert not out.exists() or "time limit" in numbers_in(FITS[name], out)


@pytest.mark.parametrize("name", EVERY)
def test_changes_of_the_command_line_are_in_the_new_model_file(name: str, folder: Path) -> None:
    """The number that ``--set`` states, and the fitted numbers, are in the same variant."""
    fit = FITS[name]
    if fit.ending != ".toml" or fit.verb == "identify-servo":
        pytest.skip("no model file is written")
    out = folder / "changed" / f"{name.replace(' ', '_')}.toml"
    done = run(folder, fit, out, "--set", "gravity=[0, 0, -9.7]")
    assert done.code in (0, 1), done.err
    robot = flexgen.read(out, fit.variant or "identified")
    assert robot.gravity == (0.0, 0.0, -9.7)
    assert robot.overrides == {} and flexgen.read(out).gravity == (0.0, 0.0, -9.81)
    sets = tomllib.loads(out.read_text())["variant"][fit.variant or "identified"]["set"]
    assert len(sets) > 1
