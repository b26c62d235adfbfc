"""Wrong moves and programs in files: each mistake is reported with the file, the line and the
key.
"""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, FlexgenError, ModelError
from flexgen.paths.path import Path

ARC = """\
[[move]]
name = "arc"
type = "tool_circle"
start_deg = [0, 20, 70, 0, 60, 0]
center = [0.05, 0.0, 0.0]
axis = [0, 0, 1]
angle_deg = 90
rotation_deg = [0, 0, 10]
profile = [0.5, 5.0, 100.0]
"""
CORNER = """\
[[move]]
name = "corner"
type = "tool_polyline"
start_deg = [0, 20, 70, 0, 60, 0]
radius = 0.2
legs = [
    { displacement = [0.1, 0, 0], zone = 0.04 },
    { displacement = [0, 0.1, 0], via = [0.05, 0.05, 0], zone = 0.03, rotation_deg = [0, 0, 5] },
    { displacement = [-0.1, 0, 0] },
]
duration = 1.0
smoothness = 5
"""
FILE = """\
[[move]]
name = "track"
type = "sampled"
start_deg = [0, 20, 70, 0, 60, 0]
file = "track.csv"
degree = 7
duration = 1.0
smoothness = 5
"""
PROGRAM = """\
[[program]]
name = "tour"
start_deg = [0, 20, 70, 0, 60, 0]
profile = [0.5, 5.0, 100.0]
joint_profile_deg = [100, 500, 8000]
smoothness = 4

[[program.step]]
type = "MoveJ"
end_deg = [3, 22, 72, 0, 60, 0]
zone_deg = 1
speed_deg = 50

[[program.step]]
type = "MoveJ"
end_deg = [5, 22, 70, 0, 60, 0]
pause = 0.1

[[program.step]]
type = "MoveL"
displacement = [0.05, 0, 0]
rotation_deg = [0, 0, 5]
zone = 0.01
speed = 0.2

[[program.step]]
type = "MoveC"
via = [0.02, 0.03, 0]
displacement = [0.0, 0.06, 0]
"""
TEXTS = {"arc": ARC, "corner": CORNER, "track": FILE, "tour": PROGRAM}

# name: (text, what stands there, what is put there, key of the error, part of the message)
BAD = {
    "circle without centre": (ARC, "center = [0.05, 0.0, 0.0]\n", "", "arc.center", "3 numbers"),
    "centre of two numbers": (ARC, "[0.05, 0.0, 0.0]", "[0.05, 0.0]", "arc.center", "3 numbers"),
    "centre on the axis": (
        ARC,
        "[0.05, 0.0, 0.0]",
        "[0.0, 0.0, 0.3]",
        "arc.center",
        "not on the axis",
    ),
    "axis of zeros": (ARC, "axis = [0, 0, 1]", "axis = [0, 0, 0]", "arc.axis", "not zero"),
    "no angle": (ARC, "angle_deg = 90\n", "", "arc.angle_rad", "angle_rad or angle_deg"),
    "angle zero": (ARC, "angle_deg = 90", "angle_deg = 0", "arc.angle_deg", "not 0"),
    "angle without unit": (
        ARC,
        "angle_deg = 90",
        "angle = 90",
        "arc.angle",
        "angle_rad or angle_deg",
    ),
    "angle twice": (
        ARC,
        "angle_deg = 90",
        "angle_deg = 90\nangle_rad = 1",
        "arc.angle_deg",
        "one of the two",
    ),
    "angle as text": (ARC, "angle_deg = 90", 'angle_deg = "90"', "arc.angle_deg", "a number"),
    "via of a circle": (ARC, "angle_deg = 90", "via = [1, 0, 0]", "arc.via", "unknown key"),
    "displacement of a circle": (
        ARC,
        "angle_deg = 90",
        "displacement = [1, 0, 0]",
        "arc.displacement",
        "a key of type =",
    ),
    "no time": (ARC, "profile = [0.5, 5.0, 100.0]\n", "", "arc.duration", "a number > 0"),
    "profile and duration": (
        ARC,
        "profile",
        "duration = 1.0\nprofile",
        "arc.duration",
        "either duration or profile",
    ),
    "profile of one": (
        ARC,
        "[0.5, 5.0, 100.0]",
        "[0.5]",
        "arc.profile",
        "a list of 2 to 8 numbers",
    ),
    "profile of nine": (ARC, "[0.5, 5.0, 100.0]", str([1.0] * 9), "arc.profile", "a list of"),
    "profile with zero": (ARC, "[0.5, 5.0, 100.0]", "[0.5, 0.0, 100.0]", "arc.profile", "> 0"),
    "profile below zero": (ARC, "[0.5, 5.0, 100.0]", "[0.5, -5.0, 100.0]", "arc.profile", "> 0"),
    "profile with text": (ARC, "[0.5, 5.0, 100.0]", '[0.5, "5"]', "arc.profile", "a list of"),
    "profile as number": (ARC, "[0.5, 5.0, 100.0]", "0.5", "arc.profile", "a list of"),
    "profile with nan": (ARC, "[0.5, 5.0, 100.0]", "[0.5, nan]", "arc.profile", "a list of"),
    "smoothness with a profile": (
        ARC,
        "profile",
        "smoothness = 2\nprofile",
        "arc.smoothness",
        "3 to 9",
    ),
    "radius": (ARC, "profile", "radius = 0.0\nprofile", "arc.radius", "> 0"),
    "legs missing": (
        CORNER,
        CORNER[CORNER.index("legs") : CORNER.index("duration")],
        "",
        "corner.legs",
        "not empty",
    ),
    "legs empty": (
        CORNER,
        CORNER[CORNER.index("[\n") : CORNER.index("duration")],
        "[]\n",
        "corner.legs",
        "not empty",
    ),
    "leg without zone": (CORNER, ", zone = 0.04 }", " }", "corner.legs[0].zone", "a number > 0"),
    "leg with zone zero": (CORNER, "zone = 0.04", "zone = 0", "corner.legs[0].zone", "> 0"),
    "zone of the last leg": (
        CORNER,
        "[-0.1, 0, 0] }",
        "[-0.1, 0, 0], zone = 0.1 }",
        "corner.legs[2].zone",
        "no zone",
    ),
    "leg with a speed": (
        CORNER,
        "zone = 0.04",
        "zone = 0.04, speed = 1",
        "corner.legs[0].speed",
        "no speed, or a prof",
    ),
    "leg with an unknown key": (
        CORNER,
        "zone = 0.04",
        "zones = 0.04",
        "corner.legs[0].zones",
        "zone",
    ),
    "leg of two numbers": (
        CORNER,
        "[-0.1, 0, 0]",
        "[-0.1, 0]",
        "corner.legs[2].displacement",
        "3 numbers",
    ),
    "zones that overlap": (
        CORNER,
        "zone = 0.04",
        "zone = 0.11",
        "corner.legs[0].zone",
        "zones that fit",
    ),
    "via on the line": (
        CORNER,
        "[0.05, 0.05, 0]",
        "[0, 0.05, 0]",
        "corner.legs[1].via",
        "not on a line through",
    ),
    "leg that stays": (
        CORNER,
        "[-0.1, 0, 0]",
        "[0, 0, 0]",
        "corner.legs[2].displacement",
        "a displacement or rotation",
    ),
    "no file": (FILE, 'file = "track.csv"\n', "", "track.file", "a string"),
    "file that is not there": (
        FILE,
        "track.csv",
        "trick.csv",
        "track.file",
        "the path of a .csv or .npz file",
    ),
    "file of another kind": (
        FILE,
        "track.csv",
        "track.txt",
        "track.file",
        "the path of a .csv or .npz file",
    ),
    "file with a zero byte": (FILE, "track.csv", "tr\\u0000ck.csv", "track.file", "control"),
    "degree": (FILE, "degree = 7", "degree = 6", "track.degree", "one of 5, 7, 9, 11"),
    "degree as text": (FILE, "degree = 7", 'degree = "7"', "track.degree", "a number"),
    "no start for a tool": (
        FILE,
        "start_deg = [0, 20, 70, 0, 60, 0]\n",
        "",
        "track.start",
        "6 finite numbers",
    ),
    "only duration": (FILE, "smoothness = 5\n", "", "track.smoothness", "3 to 9"),
    "nothing of time": (
        FILE,
        "duration = 1.0\nsmoothness = 5\n",
        "",
        "track.duration",
        "because the file has no column t",
    ),
    "program without name": (PROGRAM, 'name = "tour"\n', "", "program[0].name", "a string"),
    "program without start": (
        PROGRAM,
        "start_deg = [0, 20, 70, 0, 60, 0]\n",
        "",
        "tour.start_rad",
        "start_rad or",
    ),
    "program without steps": (
        PROGRAM,
        PROGRAM[PROGRAM.index("[[program.step") :],
        "",
        "tour.step",
        "not empty",
    ),
    "program without profile": (
        PROGRAM,
        "profile = [0.5, 5.0, 100.0]\n",
        "",
        "tour.profile",
        "steps MoveL",
    ),
    "program without joint profile": (
        PROGRAM,
        "joint_profile_deg = [100, 500, 8000]\n",
        "",
        "tour.joint_profile_rad",
        "MoveJ",
    ),
    "joint profile without unit": (
        PROGRAM,
        "joint_profile_deg",
        "joint_profile",
        "tour.joint_profile",
        "joint_profile_rad",
    ),
    "program with a duration": (
        PROGRAM,
        "smoothness = 4",
        "duration = 4",
        "tour.duration",
        "unknown key",
    ),
    "program too rough": (
        PROGRAM,
        "smoothness = 4",
        "smoothness = 1",
        "tour.smoothness",
        "3 to 9",
    ),
    "step of another kind": (PROGRAM, '"MoveL"', '"MoveX"', "tour.step[2].type", "MoveL"),
    "step without kind": (
        PROGRAM,
        'type = "MoveL"\n',
        "",
        "tour.step[2].type",
        "one of MoveJ, MoveL, MoveC",
    ),
    "MoveJ with a displacement": (
        PROGRAM,
        "speed_deg = 50",
        "displacement = [1, 0, 0]",
        "tour.step[0].displacement",
        'of type = "MoveL"',
    ),
    "MoveJ with a zone in m": (PROGRAM, "zone_deg = 1", "zone = 1", "tour.step[0].zone", "zone"),
    "MoveJ of five": (
        PROGRAM,
        "[3, 22, 72, 0, 60, 0]",
        "[3, 22, 72, 0, 60]",
        "tour.step[0].end_deg",
        "6 numbers",
    ),
    "zone before a tool step": (
        PROGRAM,
        "pause = 0.1",
        "zone_deg = 1",
        "tour.step[1].zone_deg",
        "has to stop there",
    ),
    "negative pause": (PROGRAM, "pause = 0.1", "pause = -0.1", "tour.step[1].pause", ">= 0"),
    "pause in a zone": (
        PROGRAM,
        "speed_deg = 50",
        "pause = 1.0",
        "tour.step[0].pause",
        "no pause",
    ),
    "speed zero": (PROGRAM, "speed = 0.2", "speed = 0", "tour.step[2].speed", "> 0"),
    "negative zone": (PROGRAM, "zone = 0.01", "zone = -0.01", "tour.step[2].zone", ">= 0"),
    "zone at the end": (
        PROGRAM,
        "[0.0, 0.06, 0]",
        "[0.0, 0.06, 0]\nzone = 0.01",
        "tour.step[3].zone",
        "at the end",
    ),
    "zone too large": (
        PROGRAM,
        "zone = 0.01",
        "zone = 0.06",
        "tour.step[2].zone",
        "zones that fit",
    ),
    "zone too large for joints": (
        PROGRAM,
        "zone_deg = 1",
        "zone_deg = 5",
        "tour.step[0].zone_deg",
        "zones that fit",
    ),
    "MoveC without via": (PROGRAM, "via = [0.02, 0.03, 0]\n", "", "tour.step[3].via", "3 numbers"),
    "MoveC on a line": (
        PROGRAM,
        "[0.02, 0.03, 0]",
        "[0.0, 0.03, 0]",
        "tour.step[3].via",
        "not on a line through",
    ),
    "both ends": (
        PROGRAM,
        "zone = 0.01",
        "position = [1, 1, 1]",
        "tour.step[2].position",
        "either displacement or position",
    ),
    "neither end": (
        PROGRAM,
        "displacement = [0.05, 0, 0]\n",
        "",
        "tour.step[2].displacement",
        "3 numbers",
    ),
    "two orientations": (
        PROGRAM,
        "zone = 0.01",
        "rpy_deg = [0, 0, 1]",
        "tour.step[2].rpy_deg",
        "either rotation or rpy",
    ),
    "step that stays": (
        PROGRAM,
        "[5, 22, 70, 0, 60, 0]",
        "[3, 22, 72, 0, 60, 0]",
        "tour.step[1].end_deg",
        "an end different from the start of the step",
    ),
    "name twice": (
        PROGRAM,
        "[[program]]",
        ARC.replace('"arc"', '"tour"') + "[[program]]",
        "program.tour.name",
        "not taken",
    ),
    "another table": (PROGRAM, "[[program]]", "speed = 3\n[[program]]", "speed", "unknown key"),
}


@pytest.fixture(scope="module")
def robot():
    return flexgen.derive("manutec_r3")


@pytest.fixture
def folder(tmp_path: FilePath, robot) -> FilePath:
    p, _ = Path(robot, robot.model.move("line")).reference.tool_pose(
        robot.model.move("line").start
    )
    u = np.linspace(0, 1, 12)
    rows = np.column_stack([p[0] + 0.1 * u, p[1] - 0.05 * np.sin(2 * u), p[2] + 0 * u])
    (tmp_path / "track.csv").write_text(
        "x,y,z\n" + "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows)
    )
    (tmp_path / "track.txt").write_text("x")
    return tmp_path


@pytest.mark.parametrize("name", TEXTS)
def test_valid_moves_are_read(robot, folder: FilePath, name: str) -> None:
    (folder / "tasks.toml").write_text(TEXTS[name])
    move = flexgen.read_moves(folder / "tasks.toml", robot.model)[0]
    assert move.name == name and Path(robot, move).duration > 0.1


@pytest.mark.parametrize("what", BAD)
def test_invalid_moves_are_refused_with_file_line_and_key(
    robot, folder: FilePath, what: str
) -> None:
    text, old, new, key, message = BAD[what]
    assert old in text
    text = text.replace(old, new, 1)
    file = folder / "tasks.toml"
    file.write_text(text)
    with pytest.raises(ModelError) as caught:
        Path(robot, flexgen.read_moves(file, robot.model)[-1])
    error = caught.value
    assert error.key.endswith(key) and message in str(error)
    assert FilePath(error.file).name == "tasks.toml" and 1 <= error.line <= text.count("\n") + 1
    written = key.rsplit(".", 1)[-1].split("[")[0]
    if written in new:  # the line is the one where the key stands
        assert written in text.split("\n")[error.line - 1]


def test_there_are_at_least_as_many_invalid_moves_as_required() -> None:
    assert len(BAD) >= 60


def test_files_that_are_missing_or_not_readable_are_refused(robot, tmp_path: FilePath) -> None:
    for wrong in (tmp_path / "none.toml", tmp_path, "a\0b.toml"):
        with pytest.raises(ArgumentError, match="which is not a file"):
            flexgen.read_moves(wrong, robot.model)
    empty = tmp_path / "empty.toml"
    empty.write_text("# nothing\n")
    with pytest.raises(ModelError, match=r"one or more \[\[move\]\] or \[\[program\]\] tables"):
        flexgen.read_moves(empty, robot.model)
    empty.write_text("[[program]\n")
    with pytest.raises(ModelError, match=r"empty\.toml:1:file: given text that is not TOML"):
        flexgen.read_moves(empty, robot.model)


@pytest.mark.parametrize("seed", range(60))
def test_mutations_raise_nothing_else(robot, folder: FilePath, seed: int) -> None:
    """A word struck out, doubled or swapped: either a path comes out or an error of flexgen."""
    rng = np.random.default_rng(seed)
    text = list(TEXTS.values())[seed % 4]
    words = text.replace("\n", " \n ").split(" ")
    i, j = rng.integers(len(words), size=2)
    how = rng.integers(4)
    if how == 0:
        del words[i]
    elif how == 1:
        words.insert(i, words[i])
    elif how == 2:
        words[i], words[j] = words[j], words[i]
    else:
        words[i] = str(rng.choice(["-1", "0", "1e9", "nan", '"x"', "[]", "{}", "true", "[[1]]"]))
    file = folder / "tasks.toml"
    file.write_text(" ".join(words))
    try:
        for move in flexgen.read_moves(file, robot.model):
            path = Path(robot, move)
            assert np.isfinite(path.sample(np.linspace(0, path.duration, 11)).y).all()
    except FlexgenError as error:
        assert not isinstance(error, ModelError) or 0 <= error.line <= text.count("\n") + 2
