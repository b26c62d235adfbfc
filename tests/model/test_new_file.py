"""New model files from old ones: relative paths, numbers in overlays and of URDF files."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.responses.result import IDENTIFIED, FileWords, write_model
from flexgen.model.new_file import relocate, text_of_model, with_overrides, write_model_text

TEXT = """\
# a comment with file = "x.csv"
name = "arm"  # file = "y.csv"

[urdf]
file = "robots/arm.urdf"   # kept

[[move]]
file = 'track one.csv'
name = "file"

[[move]]
name = "elsewhere"
file = "/data/track.csv"

[variant.other.set]
"move.track.file" = "late.csv"
"motor.m1.inertia" = 1.0
"""


def test_relative_paths_of_all_kinds_are_those_from_the_new_folder(tmp_path: Path) -> None:
    """Absolute paths, names, comments and package addresses stay, byte for byte."""
    old = tmp_path / "a"
    new = tmp_path / "b" / "deep"
    old.mkdir()
    text = relocate(TEXT, old, new)
    expected = TEXT.replace('"robots/arm.urdf"', '"../../a/robots/arm.urdf"')
    expected = expected.replace("'track one.csv'", '"../../a/track one.csv"')
    expected = expected.replace('"late.csv"', '"../../a/late.csv"')
    assert text == expected
    assert relocate(text, new, old) == TEXT.replace("'", '"')
    assert relocate(TEXT, old, tmp_path / "b" / ".." / "a") == TEXT
    package = TEXT.replace("robots/arm.urdf", "package://robots/arm.urdf")
    assert 'file = "package://robots/arm.urdf"' in relocate(package, old, new)


def test_paths_lead_to_their_files_through_a_linked_folder(tmp_path: Path) -> None:
    """``..`` of a linked folder is the parent of the folder that it leads to."""
    old = tmp_path / "a"
    real = tmp_path / "far" / "away" / "real"
    old.mkdir()
    real.mkdir(parents=True)
    (old / "track.csv").write_text("t")
    link = tmp_path / "link"
    link.symlink_to(real)
    text = relocate('[[move]]\nfile = "track.csv"\n', old, link)
    found = tomllib.loads(text)["move"][0]["file"]
    assert (link / found).read_text() == "t"


def test_a_planted_path_of_the_old_folder_is_seen(tmp_path: Path) -> None:
    """Without the change of the paths the new file is refused, and nothing is written."""
    text = (flexgen.model.reader.packaged_models() / "elbow.toml").read_text()
    move = '\n[[move]]\nname = "t"\ntype = "sampled"\nfile = "none.csv"\n'
    move += "duration = 1.0\nsmoothness = 5\n"
    folder = tmp_path / ("a" * 90)
    folder.mkdir()
    with pytest.raises(ModelError, match=r"none\.csv") as caught:
        write_model_text(folder / "new.toml", text + move, tmp_path)
    assert caught.value.file == str(folder / "new.toml")
    assert not (folder / "new.toml").exists()


@pytest.fixture
def overlay(tmp_path: Path) -> Path:
    """An overlay of the planar arm, in a folder of its own."""
    folder = tmp_path / "robots"
    folder.mkdir()
    flexgen.export_urdf("elbow", folder / "arm.urdf")
    return folder / "arm.toml"


def written(robot: flexgen.RobotModel, out: Path, names: list[str]) -> dict[str, float]:
    """Numbers 10 % larger, written into a new file."""
    values = {p.name: 1.1 * p.value for p in select(robot, names)}
    write_model(out, robot, values, {}, FileWords("test", note="time limit"))
    return values


def test_numbers_of_an_overlay_are_under_its_own_keys(overlay: Path, tmp_path: Path) -> None:
    robot = flexgen.read(overlay)
    out = tmp_path / "new" / "arm.toml"
    values = written(robot, out, ["q1.stiffness", "q1.damping", "m1.viscous", "m2.inertia"])
    data = tomllib.loads(out.read_text())
    assert data["urdf"]["file"] == "../robots/arm.urdf" and "variant" not in data
    assert data["joint"]["q1"]["gear"]["spring"]["stiffness"] == values["q1.stiffness"]
    again = {p.name: p.value for p in select(flexgen.read(out), list(values))}
    assert again == values
    assert "time limit" in out.read_text().splitlines()[0]


def test_numbers_without_a_key_of_the_overlay_are_in_a_variant(
    overlay: Path, tmp_path: Path
) -> None:
    """The masses are in the URDF file."""
    robot = flexgen.read(overlay)
    name = f"{robot.elements[0].name}.mass"
    out = tmp_path / "arm.toml"
    values = written(robot, out, [name, "q1.stiffness"])
    found = flexgen.read(out, IDENTIFIED)
    assert {p.name: p.value for p in select(found, list(values))} == values
    assert flexgen.read(out).elements[0].body.mass == robot.elements[0].body.mass
    assert found.elements[0].body.com == robot.elements[0].body.com
    assert found.elements[0].body.inertia == robot.elements[0].body.inertia
    with pytest.raises(ArgumentError, match=IDENTIFIED):
        written(flexgen.read(out), tmp_path / "twice.toml", [name])


def test_numbers_of_a_plain_urdf_file_make_an_overlay(
    overlay: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    data = tomllib.loads(overlay.read_text())["urdf"]
    robot = flexgen.read(f"robots/arm.urdf#{data['base']}:{data['tip']}")
    text, folder = text_of_model(robot.file)
    assert tomllib.loads(text)["urdf"]["file"] == "robots/arm.urdf" and folder == Path()
    name = f"{robot.elements[0].name}.mass"
    out = tmp_path / "other" / "arm.toml"
    values = written(robot, out, [name])
    found = flexgen.read(out, IDENTIFIED)
    assert {p.name: p.value for p in select(found, [name])} == values


def test_models_without_a_file_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"model file: given a model of ''"):
        text_of_model("")


def test_numbers_of_a_table_that_is_not_there_are_this_table() -> None:
    """A motor without friction gets one; numbers of tables that are there stay single keys."""
    robot = flexgen.read("elbow", overrides={"motor.m2.friction": {"viscous": 0.3}})
    numbers = {
        "motor.m1.friction.viscous": 0.1,
        "motor.m1.friction.offset": 0.2,
        "motor.m2.friction.offset": 0.4,
        "motor.m1.inertia": 0.004,
    }
    with pytest.raises(ModelError, match="a path that does not exist"):
        flexgen.read("elbow", overrides=numbers)
    changes = with_overrides(robot, numbers)
    assert changes == {
        "motor.m2.friction": {"viscous": 0.3},
        "motor.m1.friction": {"viscous": 0.1, "offset": 0.2},
        "motor.m2.friction.offset": 0.4,
        "motor.m1.inertia": 0.004,
    }
    one, two = flexgen.read("elbow", overrides=changes).motors
    assert (one.friction.viscous, one.friction.offset, one.inertia) == (0.1, 0.2, 0.004)
    assert (two.friction.viscous, two.friction.offset) == (0.3, 0.4)
