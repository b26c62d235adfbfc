"""Moves and programs in frames of workpieces: the same path as one that is stated in the world."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.cli.main import main

ANGLES = (20.0, -35.0, 110.0)  # deg, about the fixed axes x, y, z
PLACE = np.array([0.7, 0.15, 0.2])  # m
TABLE = f'[[frame]]\nname = "table"\nposition = {PLACE.tolist()}\nrpy_deg = {list(ANGLES)}\n'
R = Rotation.from_euler("xyz", ANGLES, degrees=True).as_matrix()
START = "start_deg = [10, 40, -80, 10, 70, 20]"
TIME = "duration = 1.0\nsmoothness = 5"
SIX = "manutec_r3"


def moves_of(text: str, folder: Path, robot: Any = SIX) -> tuple[flexgen.Move, ...]:
    file = folder / "moves.toml"
    file.write_text(text)
    return flexgen.read_moves(file, flexgen.read(robot) if isinstance(robot, str) else robot)


def own(world: list[float]) -> list[float]:
    """Components in the frame of a vector in world axes."""
    return (R.T @ np.array(world)).tolist()


def posed() -> flexgen.RobotModel:
    """A six-axis arm whose output is the pose of its tool."""
    return flexgen.read(SIX, overrides={"output": {"type": "tool_pose"}})


def test_moves_in_a_frame_are_those_in_the_world(tmp_path: Path) -> None:
    way = [0.05, -0.08, 0.1]
    turn = [0.1, 0.2, -0.05]
    center = [0.0, 0.1, 0.02]
    axis = [0.0, 0.0, 1.0]
    texts = []
    for frame, change in (('frame = "table"\n', own), ("", list)):
        line = f"displacement = {change(way)}\nrotation_rad = {change(turn)}"
        circle = f"center = {change(center)}\naxis = {change(axis)}\nangle_deg = 60"
        legs = (
            f"[[move.legs]]\ndisplacement = {change(way)}\nzone = 0.01\n"
            f"[[move.legs]]\ndisplacement = {change(center)}\nvia = {change([0.03, 0.05, 0.0])}\n"
        )
        text = TABLE if frame else ""
        for name, kind, body in (
            ("line", "tool_line", line),
            ("arc", "tool_circle", circle),
            ("corner", "tool_polyline", legs),
        ):
            text += f'[[move]]\nname = "{name}"\ntype = "{kind}"\n{frame}{START}\n{TIME}\n{body}\n'
        texts.append(text)
    robot = posed()
    for one, other in zip(*(moves_of(text, tmp_path, robot) for text in texts), strict=True):
        for t in (np.array([0.0, 0.3, 0.7, 1.0]),):
            a = flexgen.plan(robot, one, ignore_limits=True).sample(t)
            b = flexgen.plan(robot, other, ignore_limits=True).sample(t)
            np.testing.assert_allclose(a.y, b.y, atol=1e-9)
            assert a.R is not None and b.R is not None
            np.testing.assert_allclose(a.R, b.R, atol=1e-12)


def test_steps_of_a_program_end_where_the_frame_has_them(tmp_path: Path) -> None:
    robot = posed()
    (start,) = moves_of(
        f'[[move]]\nname = "a"\ntype = "tool_line"\n{START}\n{TIME}\ndisplacement = [0.01, 0, 0]',
        tmp_path,
        robot,
    )
    before = flexgen.plan(robot, start, ignore_limits=True).sample(np.zeros(1))
    assert before.R is not None
    end = before.y[0, :, 0] + [0.02, 0.03, -0.04]
    local = (R.T @ (end - PLACE)).tolist()
    angles = Rotation.from_matrix(R.T @ before.R[0]).as_euler("xyz").tolist()
    back = own([-0.02, 0.0, 0.0])
    text = (
        f'{TABLE}[[program]]\nname = "p"\nframe = "table"\n{START}\n'
        "profile = [0.2, 1.0, 10.0]\njoint_profile_rad = [1.0, 5.0, 50.0]\n"
        f'[[program.step]]\ntype = "MoveL"\nposition = {local}\nrpy_rad = {angles}\n'
        f'[[program.step]]\ntype = "MoveL"\ndisplacement = {back}\n'
    )
    (program,) = moves_of(text, tmp_path, robot)
    path = flexgen.plan(robot, program, ignore_limits=True)
    after = path.sample(np.array([path.segments[0].law.duration, path.duration]))
    assert after.R is not None
    np.testing.assert_allclose(after.y[0, :, 0], end, atol=1e-9)
    np.testing.assert_allclose(after.R[0], before.R[0], atol=1e-9)
    np.testing.assert_allclose(after.y[1, :, 0], end + np.array([-0.02, 0.0, 0.0]), atol=1e-9)


def test_frames_of_the_model_serve_its_files_of_moves(tmp_path: Path) -> None:
    frame = {"name": "table", "position": PLACE.tolist(), "rpy_deg": list(ANGLES)}
    robot = flexgen.read(SIX, overrides={"frame": [frame]})
    assert [each.name for each in robot.frames] == ["table"]
    np.testing.assert_allclose(robot.frames[0].rotation, R, atol=1e-12)
    text = f'[[move]]\nname = "a"\ntype = "tool_line"\nframe = "table"\n{START}\n{TIME}\n'
    (line,) = moves_of(text + f"displacement = {own([0.0, 0.0, 0.1])}", tmp_path, robot)
    assert line.displacement == pytest.approx([0.0, 0.0, 0.1], abs=1e-12)
    # the planted error: the transposed rotation
    assert R.T @ own([0.0, 0.0, 0.1]) != pytest.approx([0.0, 0.0, 0.1], abs=1e-2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f'{TABLE}[[move]]\nname = "a"\ntype = "tool_line"\nframe = "tabel"\n', "expected table"),
        ('[[move]]\nname = "a"\ntype = "tool_line"\nframe = "table"\n', "a table .*frame.* with"),
        (f'{TABLE}[[move]]\nname = "a"\ntype = "sampled"\nframe = "table"\n', "move.a.frame"),
        (TABLE + TABLE, "frame.*name"),
    ],
)
def test_frames_that_do_not_fit_are_refused(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=words):
        moves_of(text, tmp_path)


def test_a_frame_that_tilts_the_axis_of_the_output_is_refused(tmp_path: Path) -> None:
    scara = tmp_path / "scara.toml"
    assert main(["new", "scara", "--template", "scara", "--out", str(scara)]) == 0
    robot = flexgen.read(scara)
    line = next(move for move in robot.moves if move.type == "tool_line")
    text = (
        f'[[move]]\nname = "a"\ntype = "tool_line"\nframe = "table"\n{TIME}\n'
        f"start_rad = {list(line.start)}\ndisplacement = [0.05, 0.0, 0.0]\n"
    )
    flat = TABLE.replace(str(list(ANGLES)), "[0.0, 0.0, 90.0]")
    (found,) = moves_of(flat + text, tmp_path, robot)
    assert found.displacement == pytest.approx([0.0, 0.05, 0.0], abs=1e-12)
    with pytest.raises(ModelError, match="not tilted against the output's axis"):
        moves_of(TABLE + text, tmp_path, robot)


def test_frames_of_python_are_checked() -> None:
    with pytest.raises(ArgumentError, match=r"frame bent: .*a rotation matrix"):
        flexgen.WorkFrame("bent", rotation=((1.0, 0.1, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    sampled = flexgen.Move("s", "sampled", (), 0.0, 0, file="x.csv")
    with pytest.raises(ArgumentError, match="given the type sampled"):
        flexgen.WorkFrame("table").place(sampled)
