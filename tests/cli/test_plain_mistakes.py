"""Plain mistakes of a user: each one gets an error that says what to do."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from bad_models import GOOD
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, BuildError, ModelError
from flexgen.base.spec.ports import Port, c_name_problem, identifier_problem
from flexgen.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
URDF = f"{ROOT / 'tests/support/urdf/two_link.urdf'}#ground:tip"


# --- arguments -----------------------------------------------------------------------------------


@pytest.mark.parametrize("overrides", [[1], "payload.mass=2", 3, [("payload.mass", 2)]])
def test_overrides_are_a_mapping(overrides):
    for read in (flexgen.read, flexgen.describe):
        with pytest.raises(
            ArgumentError,
            match=r"overrides: given .*, expected a mapping of dotted paths to values",
        ):
            read("elbow", overrides=overrides)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ["describe", "delta@heavy"],
            "given 'heavy', expected no variant: the file has no table [variant.heavy]",
        ),
        (["describe", "elbow@nope"], "given 'nope', expected one of fjm, payload, rigid"),
        (
            ["describe", "elbow@payload@rigid"],
            "given 'elbow@payload@rigid', which has two variants, expected one, MODEL@VARIANT",
        ),
        (
            ["new", "arm.toml", "--template", "scara"],
            "given 'arm.toml', expected the name of the robot, arm: its file gets .toml",
        ),
        (["new", "my/arm", "--template", "scara"], "given 'my/arm', expected a letter followed"),
        (
            ["-q", "describe", "elbow"],
            "given -q before the verb describe, expected options after it: 'flexgen describe ...",
        ),
        (["--set", "payload.mass=1", "check", "elbow"], "--set payload.mass=1 before the verb"),
    ],
)
def test_words_at_another_place_are_named(words, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        assert main(words) != 0
    except SystemExit as ended:
        assert ended.code == 2
    assert expected in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


def test_a_path_is_not_the_name_of_a_move():
    with pytest.raises(
        ArgumentError,
        match=r"path: given 'line', expected a flexgen\.Path, such as flexgen\.plan\(",
    ):
        flexgen.analyze("elbow", path="line")


def test_a_model_without_moves_says_how_to_get_some(tmp_path, capsys):
    expected = (
        r"has no moves; write \[\[move\]\] tables into a TOML file and give it with --moves FILE"
    )
    for verb in (flexgen.solve, flexgen.plan):
        with pytest.raises(ArgumentError, match=expected):
            verb(URDF)
    with pytest.raises(ArgumentError, match=expected):
        flexgen.solve(URDF, "line")
    for words in (["solve", URDF], ["analyze", URDF, "--move", "line"]):
        assert main(words) == 1
        assert "has no moves; write [[move]] tables" in capsys.readouterr().err


# --- compilers -----------------------------------------------------------------------------------


@pytest.mark.skipif(shutil.which("true") is None, reason="needs the program true")
def test_a_compiler_that_does_nothing_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "true")
    with pytest.raises(
        BuildError,
        match=r"C compiler: given 'true', which does not preprocess C, .* change CC or unset",
    ):
        flexgen.generate("elbow", tmp_path / "out", functions=["gravity"])
    assert not (tmp_path / "out").exists()


@needs_compiler
def test_a_compiler_that_writes_no_object_is_refused(tmp_path, monkeypatch):
    wrapper = tmp_path / "cc"
    wrapper.write_text(
        f"#!{sys.executable}\n"
        "import os, sys\n"
        '"-c" in sys.argv or os.execvp("cc", ["cc", *sys.argv[1:]])\n'
    )
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", str(wrapper))
    with pytest.raises(
        BuildError,
        match=r"reported success but wrote no \S+\.o; the directory is as it was before",
    ):
        flexgen.generate("elbow", tmp_path / "out", functions=["gravity"], force=True)
    assert not (tmp_path / "out").exists()


# --- names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["j1", "y0", "gamma", "time", "double", "index", "while"])
def test_names_of_the_c_library_are_fine_names_of_joints(tmp_path, name):
    path = tmp_path / "model.toml"
    path.write_text(GOOD.replace('"q1"', f'"{name}"').replace("q1", name))
    assert flexgen.read(path).coordinates[0].name == name
    assert identifier_problem(name) is None and c_name_problem(name) is not None
    with pytest.raises(ArgumentError, match="reserved"):
        Port(name, (1,), "1", "")


@needs_compiler
def test_such_names_make_the_same_library(tmp_path):
    """Joints and motors that are called like keywords of C and functions of libm: they are never
    identifiers.
    """
    text = Path(flexgen.read("elbow").file).read_text()
    names = {
        "q1": "j1",
        "q2": "y0",
        "m1": "double",
        "m2": "main",
        "upper": "printf",
        "fore": "NULL",
    }
    for old, new in names.items():
        text = text.replace(f'"{old}"', f'"{new}"')
    text = text[: text.index("[variant.fjm]")]
    (tmp_path / "elbow.toml").write_text(text)
    made = flexgen.generate(
        tmp_path / "elbow.toml", tmp_path / "out", functions=["gravity", "linearize"]
    )
    library = flexgen.load(made.directory)
    assert library.coordinates == ("j1", "y0") and library.motors == ("double", "main")
    usual = flexgen.load(
        flexgen.generate("elbow", tmp_path / "usual", functions=["gravity", "linearize"]).directory
    )
    q = np.array([0.3, -0.7])
    assert np.array_equal(library.gravity(q), usual.gravity(q))


def test_reserved_words_of_c_are_refused_as_names_of_robots(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(GOOD.replace('"robot"', '"double"'))
    with pytest.raises(
        ModelError, match='name: given "double", expected a name that is not reserved by C'
    ):
        flexgen.read(path)


# --- magnitudes ----------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [1e-300, 5e-324, -1e-19, 1e13, -1e300])
def test_each_number_of_a_list_has_the_documented_magnitude(number):
    for overrides in ({"gravity": [0.0, number, -9.81]}, {"tool.position": [0.1, 0.0, number]}):
        with pytest.raises(ModelError, match="expected numbers of magnitude 1e-18 to 1e12"):
            flexgen.read("elbow", overrides=overrides)
