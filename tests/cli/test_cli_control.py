"""The verbs control, score and tune on the command line."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from types import SimpleNamespace

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.display import duration
from flexgen.base.rows import Prose
from flexgen.cli.main import main
from flexgen.studies.scenarios.leaderboard import find_shipped_controllers
from flexgen.studies.scenarios.scenario_file import scenario
from flexgen.views.reports.text_tables import number

pytestmark = needs_compiler


@pytest.mark.usefixtures("undrawn")
def test_control_prints_a_table_and_writes_what_is_asked(tmp_path, capsys):
    words = [
        "control",
        "planar5_nmp",
        "--plant",
        "soft:stiffness=0.8",
        "--plant",
        "payload=2",
        "--delay",
        "5e-4",
    ]
    words += [
        "--disturb",
        "pulse:tool.x=100@0.2+0.02",
        "--encoder-noise",
        "1e-5",
        "--out",
        str(tmp_path / "run.csv"),
    ]
    assert main([*words, "--report", str(tmp_path / "page"), "-q"]) == 0
    text = capsys.readouterr().out
    assert "payload=2: load +2 kg at the tool, [0.45, 0, 0] m in the frame of the last tip" in text
    assert "load +2 kg at the tool" in (tmp_path / "page" / "index.html").read_text()
    assert "soft" in text and "payload=2" in text and "gain margin" in text
    assert (tmp_path / "run.csv").exists() and (tmp_path / "page" / "index.html").exists()


@pytest.mark.usefixtures("undrawn")
def test_an_unstable_loop_is_named_where_its_run_ends_before_the_robot_falls(capsys):
    """At a sample time of 50 ms the errors of half a second look small."""
    words = "the loop is unstable (begin, middle, end): errors grow"
    for sample_time, stable in ((0.05, False), (5e-4, True)):
        given = ["control", "planar5_nmp", "--sample-time", str(sample_time), "-q", "--no-compare"]
        assert main(given) == (0 if stable else 1)
        said = capsys.readouterr()
        is_done = re.search(r"status +done", said.out) is not None
        assert is_done == stable == (words not in said.out)
        assert stable or "unstable: nominal: the linear loop at begin, middle, end" in said.err


def test_control_in_json(capsys):
    assert main(["control", "planar5_nmp", "--json", "-q", "--controller", "none"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (
        data["status"] == "done"
        and data["plants"][0]["error_max_m"] < 1e-4
        and data["controller"] == "feedforward only"
    )


WALL = "1.14,-0.147,0:0.2,-0.21,0:1e5:500"  # before the end of the line of planar5_nmp


@pytest.mark.slow
def test_a_wall_and_passivity_are_those_of_python(capsys):
    wall = flexgen.Wall((1.14, -0.147, 0.0), (0.2, -0.21, 0.0), stiffness=1e5, damping=500.0)
    words = [
        "control",
        "planar5_nmp",
        "--wall",
        WALL,
        "--passivity",
        "--sample-time",
        "0.001",
        "-q",
    ]
    assert main([*words, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    run = flexgen.control("planar5_nmp", wall=wall, sample_time=1e-3, progress=False)
    force = float(np.linalg.norm(run.nominal.contact, axis=1).max())
    assert force > 100.0 and data["plants"][0]["contact_max_N"] == force
    assert data["passivity"]["passive"] is False and data["passivity"]["fails_hz"] == 0.1
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "wall, N" in text and "not passive" in text and number(force) in text


def test_a_simulation_with_a_wall_and_what_sensors_read(tmp_path, capsys):
    path = str(tmp_path / "line.npz")
    seen = str(tmp_path / "seen.csv")
    flexgen.solve("planar5_nmp", "line", verify=False, progress=False).trajectory.save(path)
    assert main(["simulate", "planar5_nmp", path, "--wall", WALL, "--json", "-q"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["contact_max_N"] > 100.0
    sensor = 'sensor=[{name="torque1", type="joint_torque", coordinate="q1", unit="N m"}]'
    assert main(["sense", "planar5_nmp", path, "--set", sensor, "--out", seen, "-q"]) == 0
    assert "torque1  N m" in capsys.readouterr().out
    read = flexgen.Trajectory.load(seen)
    assert read.labels["y_s"] == ("torque1",) and read["y_s"][0, 0] == pytest.approx(857, abs=1)
    assert main(["sense", "planar5_nmp", path, "-q"]) != 0
    assert "[[sensor]]" in capsys.readouterr().err


@pytest.mark.parametrize(
    "given", ["1,0,0", "1,0:0,1,0:1e5", "1,0,0:0,1,0", "1,0,0:0,1,0:stiff", "1,0,0:0,1,0:1:2:3:4"]
)
def test_walls_that_cannot_be_read(given, capsys):
    assert main(["control", "planar5_nmp", "--wall", given]) == 2
    assert "expected X,Y,Z:NX,NY,NZ:K[:C[:GAP]]" in capsys.readouterr().err


def test_an_unstable_loop_fails(tmp_path, capsys):
    (tmp_path / "hot.toml").write_text(
        'type = "cascade"\nposition_gain = [900.0, 900.0]\n'
        "speed_gain = [900.0, 900.0]\nintegral_gain = [0.0, 0.0]\n"
    )
    words = [
        "control",
        "planar5_nmp",
        "-q",
        "--no-torque-limits",
        "--controller",
        str(tmp_path / "hot.toml"),
    ]
    assert main([*words, "--encoder-noise", "1e-4"]) == 1
    assert "unstable: nominal" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--plant", "soft"], "given 'soft', expected such as soft:stiffness=0.8"),
        (["--plant", "soft:stiffness"], "expected such as"),
        (["--disturb", "step"], "given 'step', expected such as step:m1=2@0.5"),
        (["--disturb", "step:m1=x@0"], "expected such as"),
        (["--plant", "a:stiffness=1", "--plant", "a:stiffness=2"], "expected different names"),
        (["--controller", "best"], "given 'best', expected one of ppi"),
    ],
)
def test_wrong_words_are_refused_with_a_message(words, said, capsys):
    assert main(["control", "planar5_nmp", "-q", *words]) in (1, 2)
    assert said in capsys.readouterr().err


def test_options_that_are_repeated_are_robots_by_name(monkeypatch, capsys):
    seen = {}
    monkeypatch.setattr(
        flexgen, "command_positions", lambda model, **given: seen.update(given) or {}
    )
    words = ["command-positions", "planar5_nmp", "-q", "--plants", "soft:stiffness=0.8,payload=5"]
    assert main([*words, "--plants", "stiffness=0.9"]) == 0
    assert seen["plants"] == {
        "soft": {"stiffness": 0.8, "payload": 5.0},
        "stiffness=0.9": {"stiffness": 0.9},
    }
    assert main([*words, "--plants", "soft:stiffness=0.7"]) == 1
    assert main([*words, "--out", "positions.txt"]) == 2  # before the computation
    said = capsys.readouterr().err
    assert "plants: given soft, soft, expected different names" in said
    assert (
        "given 'positions.txt', expected a file name ending in .csv, .npz, .mat or .json" in said
    )


@pytest.mark.slow
def test_score_and_its_refusals(tmp_path, capsys):
    assert main(["score", "four_mass", "-q", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (
        data["scores"][0]["score"] == pytest.approx(1.0219, abs=1e-4) and len(data["hash"]) == 64
    )
    (tmp_path / "hot.toml").write_text(
        'type = "cascade"\nposition_gain = [12.0]\nspeed_gain = [25.0]\nintegral_gain = [6.0]\n'
    )
    one = ["score", "four_mass@1", "-q", "--controller"]  # without draws, in a fifth of the time
    assert main([*one, "ppi", "--controller", str(tmp_path / "hot.toml")]) == 0
    text = capsys.readouterr().out
    assert (
        "refused" in text
        and "hot.toml is refused:" in text
        and text.index("ppi ") < text.index("hot.toml ")
    )
    assert main([*one, str(tmp_path / "hot.toml")]) == 1
    capsys.readouterr()
    assert main(["score", "five_mass", "-q"]) == 1
    assert "given 'five_mass', expected four_mass, two_link" in capsys.readouterr().err


@pytest.mark.slow
def test_tune_writes_a_controller(tmp_path, capsys):
    out = tmp_path / "mine.toml"
    assert main(["tune", "four_mass@1", "-q", "--evaluations", "5", "--out", str(out)]) == 0
    assert "evaluations" in capsys.readouterr().out and 'type = "cascade"' in out.read_text()
    assert (
        main(
            [
                "tune",
                "four_mass@1",
                "-q",
                "--evaluations",
                "5",
                "--out",
                str(tmp_path / "mine.json"),
            ]
        )
        == 2
    )


@pytest.fixture
def scored(monkeypatch):
    """Scores that fall from controller to controller, without a simulation; those whose names
    begin with ``no`` are refused.
    """
    calls = []
    names = ["nominal", *scenario("four_mass").sets]

    def score(chosen, name, *, seed, progress):
        calls.append((chosen.name, name, seed))
        total = 3.0 - len(calls)
        refused = ("too slow",) if name.startswith("no") else ()
        found = SimpleNamespace(
            controller=name,
            total=total,
            worst=total + 2.0,
            spread=0.25,
            parts=dict.fromkeys(names, 7.0),
            accepted=not refused,
            refused=refused,
            rule="",
            table=[defaultdict(str)],
            ended="",
            wall_s=0.1,
        )
        found.to_dict = lambda: {"V": total}
        found.content = lambda: (Prose(f"V = {total}"),)
        found.report = lambda folder: folder
        return found

    monkeypatch.setattr("flexgen.studies.scenarios.score.score", score)
    return calls


def test_scores_are_in_their_order_and_refused_ones_last(capsys, scored):
    words = ["score", "four_mass", "-q", "--seed", "5"]
    given = [x for name in ("all", "no") for x in ("--controller", name)]
    assert main([*words, *given, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    names = [name for _, name, _ in scored]
    shipped = sorted(find_shipped_controllers("four_mass"))
    assert names[0] == "reference" and sorted(names[1:-1]) == shipped and names[-1] == "no"
    assert {(chosen, seed) for chosen, _, seed in scored} == {("four_mass", 5)}
    assert [s["V"] for s in data["scores"]] == [2.0 - k for k in range(len(names))]
    scored.clear()
    assert main([*words, *given]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    order = [row[0] for row in rows if row and row[0] in names and len(row) > 3]
    assert order == [*reversed(names[:-1]), "no"]
    (row,) = (row for row in rows if row[:1] == ["reference"])
    assert row[1:5] == ["2", "4", "0.25", "7"]
    assert rows[-1] == ["no", "is", "refused:", "too", "slow"]


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (["no", "nor"], 1, "refused: no, nor"),
        ([], 0, ""),
        (["--report", "page"], 0, "wrote page"),
        (["a", "b", "--report", "page"], 1, "--report: given 2 controllers, expected one"),
    ],
)
def test_pages_and_failures_of_scores(words, status, text, capsys, scored):
    """A page is written where one is asked for; all controllers refused are a failure."""
    names = [x for x in words if x not in ("--report", "page")]
    options = [x for name in names for x in ("--controller", name)]
    report = words[words.index("--report") :] if "--report" in words else []
    assert main(["score", "four_mass", "-q", *options, *report]) == status
    shown = capsys.readouterr()
    assert text in shown.err + shown.out and ("wrote" in shown.out) == (
        report != [] and status == 0
    )


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "1 s"), (4.4, "4 s"), (99.0, "99 s"), (150.0, "2 min"), (7000, "117 min")],
)
def test_durations_are_given_in_seconds_then_in_minutes(seconds, text):
    assert duration(seconds) == text
