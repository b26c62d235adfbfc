"""Moves in a frame that moves: seen from the frame, the path is that of a frame at rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.paths.geometry import carried_curve

START = tuple(np.radians([10.0, 40.0, -80.0, 10.0, 70.0, 20.0]).tolist())
WAY = (0.05, -0.08, 0.1)
CARRIER = flexgen.Carrier((0.3, 0.2, 0.1), (0.04, 0.0, -0.02), (0.1, -0.2, 0.3))
TIME = np.linspace(0.0, 1.0, 21)


def robot() -> flexgen.RobotModel:
    """A six-axis arm whose output is the pose of its tool."""
    return flexgen.read("manutec_r3", overrides={"output": {"type": "tool_pose"}})


def moves() -> list[flexgen.Move]:
    """A line, an arc and a polyline in a frame that moves."""
    line = flexgen.Move(
        "line", "tool_line", START, 1.0, 5, WAY, rotation=(0.2, 0.1, 0.0), carrier=CARRIER
    )
    arc = replace(
        line, type="tool_circle", center=(0.0, 0.1, 0.0), axis=(0.0, 0.0, 1.0), angle=1.0
    )
    legs = (flexgen.MoveL(WAY, zone=0.02), flexgen.MoveL((0.0, 0.1, 0.0)))
    return [line, arc, replace(line, type="tool_polyline", legs=legs)]


def seen_from_the_frame(move: flexgen.Move) -> float:
    """Largest deviation [m, rad] of the path in the frame from that of a frame at rest."""
    model = robot()
    moving = flexgen.plan(model, move, ignore_limits=True)
    still = flexgen.plan(model, replace(move, carrier=None), ignore_limits=True)
    a = moving.sample(TIME)
    b = still.sample(TIME)
    assert a.R is not None and b.R is not None and a.w is not None and b.w is not None
    law = still.segments[0].law(TIME, 1)
    share = law[:, 0] / still.segments[0].curve.length
    rate = law[:, 1] / still.segments[0].curve.length
    Q = Rotation.from_rotvec(share[:, None] * CARRIER.rotation)
    arm = a.y[:, :, 0] - CARRIER.origin - share[:, None] * CARRIER.displacement
    own = Q.inv().apply(arm) + CARRIER.origin
    turned = Q.inv().as_matrix() @ a.R
    spin = Q.inv().apply(a.w[:, :, 0] - rate[:, None] * CARRIER.rotation)
    return max(
        float(np.abs(own - b.y[:, :, 0]).max()),
        float(np.abs(turned - b.R).max()),
        float(np.abs(spin - b.w[:, :, 0]).max()),
    )


@pytest.mark.parametrize("move", moves(), ids=lambda move: move.type)
def test_seen_from_the_frame_the_path_is_that_of_a_frame_at_rest(move: flexgen.Move) -> None:
    assert seen_from_the_frame(move) < 1e-11


def test_a_planted_frame_that_turns_about_the_world_is_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    right = carried_curve.multiply
    monkeypatch.setattr(carried_curve, "multiply", lambda Q, x: right(Q.swapaxes(1, 2), x))
    assert seen_from_the_frame(moves()[0]) > 1e-3


@pytest.mark.parametrize("move", moves(), ids=lambda move: move.type)
def test_derivatives_are_those_of_differences(move: flexgen.Move) -> None:
    path = flexgen.plan(robot(), move, ignore_limits=True)
    h = 1e-5
    t = np.linspace(0.1, 0.9, 7) + 0.003
    here = path.sample(t)
    after = path.sample(t + h)
    before = path.sample(t - h)
    for k in range(5):
        slope = (after.y[:, :, k] - before.y[:, :, k]) / (2 * h)
        scale = 1.0 + np.abs(here.y[:, :, k + 1]).max()
        assert np.abs(slope - here.y[:, :, k + 1]).max() < 1e-5 * scale
    assert here.w is not None and after.w is not None and before.w is not None
    for k in range(4):
        slope = (after.w[:, :, k] - before.w[:, :, k]) / (2 * h)
        scale = 1.0 + np.abs(here.w[:, :, k + 1]).max()
        assert np.abs(slope - here.w[:, :, k + 1]).max() < 1e-5 * scale


def test_an_elastic_arm_follows_a_seam_on_a_positioner(tmp_path: Path) -> None:
    text = (
        '[[frame]]\nname = "positioner"\nposition = [0.5, 0.0, 0.1]\n'
        '[[move]]\nname = "seam"\ntype = "tool_line"\nframe = "positioner"\n'
        "start_rad = [0.5, -0.3]\nduration = 1.0\nsmoothness = 5\n"
        "displacement = [-0.05, 0.0, -0.1]\n"
        "carried = { displacement = [0.02, 0.0, 0.0], rotation_deg = [0.0, 20.0, 0.0] }\n"
    )
    file = tmp_path / "moves.toml"
    file.write_text(text)
    (seam,) = flexgen.read_moves(file, flexgen.read("elbow"))
    assert seam.carrier is not None and seam.carrier.origin == (0.5, 0.0, 0.1)
    found = flexgen.solve("elbow", seam)
    assert str(found.status) == "solved"
    assert found.tool_error_max_m is not None and found.tool_error_max_m < 1e-6
    with pytest.raises(ArgumentError, match="a frame that moves"):
        flexgen.plan("elbow", seam).table()
    for old, new, words in (
        ('frame = "positioner"\n', "", "seam.carried: .*a move with a frame"),
        ("duration = 1.0", "profile = [0.1, 1.0]", "seam.carried: given a profile"),
        ("[0.0, 20.0, 0.0]", "[0.0, 20.0]", "seam.carried.rotation_deg"),
    ):
        file.write_text(text.replace(old, new))
        with pytest.raises(ModelError, match=words):
            flexgen.read_moves(file, flexgen.read("elbow"))


def test_a_scara_turns_with_the_frame_about_its_axis_only(tmp_path: Path) -> None:
    from flexgen.studies.templates.new_model import new_model

    file = tmp_path / "scara.toml"
    file.write_text(new_model("scara", "scara"))
    model = flexgen.read(file)
    line = next(move for move in model.moves if move.type == "tool_line")
    turning = flexgen.Carrier((0.3, 0.0, 0.0), rotation=(0.0, 0.0, 0.4))
    moved = flexgen.plan(model, replace(line, carrier=turning), ignore_limits=True)
    still = flexgen.plan(model, line, ignore_limits=True)
    ends = [np.array([0.0]), np.array([line.duration])]
    a, b = ([path.sample(t).y[0, 3, 0] for t in ends] for path in (moved, still))
    assert (a[1] - a[0]) - (b[1] - b[0]) == pytest.approx(0.4, abs=1e-12)
    tilting = flexgen.Carrier((0.3, 0.0, 0.0), rotation=(0.1, 0.0, 0.4))
    with pytest.raises((ArgumentError, ModelError), match="about the axis of the output"):
        flexgen.plan(model, replace(line, carrier=tilting))
