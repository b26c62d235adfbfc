"""Frames that an element of the robot carries, and tools that stand in the room: seen from the
part, the tool is on its path. MuJoCo places tool and part.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import BEARING, START, Seen, cell
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.paths.geometry import element_frames, fixed_tool
from flexgen.paths.path import Path as Planned

EXACT = 1e-9  # m and rad
T = np.linspace(0.0, 1.0, 21)
AT_REST = f"""[[move]]
name = "stay"
type = "joint"
frame = "part"
start_rad = {START}
end_rad = {START}
duration = 1.0
smoothness = 5

"""
GRIND = f"""
[[frame]]
name = "wheel"
{{element}}position = [{{place}}]
rpy_deg = [10, 80, 5]

[[move]]
name = "grind"
type = "{{type}}"
fixed_tool = "wheel"
start_rad = {START}
{{way}}
duration = 1.0
smoothness = 5
posture = {{{{ joints = {{{{ tilt = 0.25, turn = -0.5 }}}} }}}}
"""
LINE = "displacement = [0.08, 0.05, -0.03]\nrotation_rad = [0.2, -0.1, 0.1]"
ARC = "center = [0.0, 0.1, 0.02]\naxis = [0.1, 0.0, 1.0]\nangle_deg = 50"


def grinding(folder: Path, way: str = LINE, element: str = "") -> flexgen.RobotModel:
    """The cell with a wheel in the room, or on an element."""
    carried = f'element = "{element}"\n' if element else ""
    text = GRIND.format(
        type="tool_circle" if way == ARC else "tool_line",
        way=way,
        element=carried,
        place="0.1, 0.0, 0.3" if element else "0.9, -0.1, 0.7",
    )
    return cell(folder, text)


def poses(
    seen: Seen, q_a: np.ndarray, frame: flexgen.WorkFrame
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions and orientations of the tool and of a frame at rows of arm coordinates."""
    found = []
    for q in q_a:
        seen.move(q)
        p = np.array(frame.position)
        R = np.array(frame.rotation)
        if frame.element:
            at, turned = seen.body(frame.element)
            p = at + turned @ p
            R = turned @ R
        found.append((*seen.tool(), p, R))
    tool, tool_R, part, part_R = (np.array(each) for each in zip(*found, strict=True))
    return tool, tool_R, part, part_R


def off_line(p: np.ndarray, R: np.ndarray, way: np.ndarray, turn: np.ndarray) -> float:
    """Largest distance [m, rad] from a line with a rotation in proportion to it, from p[0], R[0]
    on, and from its end where it ends.
    """
    share = (p - p[0]) @ way / (way @ way)
    off = np.abs(p - p[0] - share[:, None] * way).max()
    wanted = Rotation.from_rotvec(share[:, None] * turn) * Rotation.from_matrix(R[0])
    turned = (wanted.inv() * Rotation.from_matrix(R)).magnitude().max()
    missed = abs(share[-1] - 1.0) * np.linalg.norm(way)
    return float(max(off, turned, missed))


def off_seam(model: flexgen.RobotModel, q_a: np.ndarray, folder: Path) -> float:
    """Error of the seam of the cell in the frame of its part."""
    tool, tool_R, part, part_R = poses(Seen(model, folder), q_a, model.frames[0])
    back = part_R.transpose(0, 2, 1)
    p = (back @ (tool - part)[..., None])[..., 0]
    return off_line(p, back @ tool_R, np.array([0.10, -0.05, 0.04]), np.array([0.1, 0.0, -0.1]))


def off_wheel(model: flexgen.RobotModel, q_a: np.ndarray, folder: Path) -> float:
    """Error of the line of the wheel in the frame of the workpiece in the hand."""
    wheel = next(frame for frame in model.frames if frame.name == "wheel")
    tool, tool_R, part, part_R = poses(Seen(model, folder), q_a, wheel)
    back = tool_R.transpose(0, 2, 1)
    p = (back @ (part - tool)[..., None])[..., 0]
    return off_line(p, back @ part_R, np.array([0.08, 0.05, -0.03]), np.array([0.2, -0.1, 0.1]))


def joints_of(path: Planned) -> np.ndarray:
    """Arm coordinates (n, n_a) along a path of an arm without deflections."""
    q_g = path.sample(T).q_g
    assert q_g is not None
    return q_g[:, :, 0]


def simulated(solution: flexgen.Solution, duration: float) -> np.ndarray:
    """Arm coordinates (n, n_a) of the full model along a move and just after it."""
    assert str(solution.status) == "solved" and solution.simulation is not None
    assert solution.tool_error_max_m is not None and solution.tool_error_max_m < 1e-6
    moved = solution.simulation.trajectory
    there = np.flatnonzero((moved.time >= 0.0) & (moved.time <= duration + 0.02))
    return moved["q_a"][there[np.linspace(0, len(there) - 1, 61).astype(int)]]


def test_seen_from_the_table_the_tool_is_on_its_line(tmp_path: Path) -> None:
    model = cell(tmp_path)
    q = joints_of(flexgen.plan(model, "seam"))
    assert q[-1, 6:] - q[0, 6:] == pytest.approx([0.25, -0.5], abs=EXACT)
    assert off_seam(model, q, tmp_path) < EXACT


def test_a_planted_order_of_the_joints_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = element_frames.stand

    def reverse(*given):
        frame, carriers = right(*given)
        return frame, carriers[::-1]

    monkeypatch.setattr(element_frames, "stand", reverse)
    model = cell(tmp_path)
    assert off_seam(model, joints_of(flexgen.plan(model, "seam")), tmp_path) > 1e-3


@pytest.mark.slow
def test_the_solved_seam_is_on_the_table_but_for_its_bearing(tmp_path: Path) -> None:
    """Deflections of gears are followed; those of a bearing of the table are not in the path."""
    model = cell(tmp_path)
    solution = flexgen.solve(model, "seam", progress=False)
    assert off_seam(model, simulated(solution, 1.0), tmp_path) < EXACT
    soft = cell(tmp_path, bearing=BEARING)
    tilted = simulated(flexgen.solve(soft, "seam", progress=False), 1.0)
    rigid = tilted.copy()
    rigid[:, -1] = 0.0
    assert 1e-6 < off_seam(soft, tilted, tmp_path) < 1e-4
    assert off_seam(soft, rigid, tmp_path) < EXACT


@pytest.mark.slow
def test_a_scara_on_a_track_draws_on_a_turning_table(tmp_path: Path) -> None:
    """Five motors of the arm for position and yaw, and the table; the guide gives way."""
    solution = flexgen.solve("scara_cell", "seam", progress=False)
    model = solution.model
    q_a = simulated(solution, 0.8)
    tool, tool_R, part, part_R = poses(Seen(model, tmp_path), q_a, model.frames[0])
    back = part_R.transpose(0, 2, 1)
    p = (back @ (tool - part)[..., None])[..., 0]
    way = np.array([0.08, 0.06, -0.02])
    turn = np.array([0.0, 0.0, np.radians(30.0)])
    assert off_line(p, back @ tool_R, way, turn) < EXACT
    side = [c.name for c in model.coordinates].index("side")
    assert np.ptp(q_a[:, side]) > 1e-6


def test_an_arm_works_on_what_the_other_arm_holds(tmp_path: Path) -> None:
    output = {"type": "tool_position", "axes": "xy", "joints": ["q0", "l1", "l2"]}
    model = flexgen.read("two_arm", overrides={"output": output})
    hand = flexgen.WorkFrame("hand", (0.4, 0.05, 0.0), element="left2")
    line = flexgen.Move(
        "line", "tool_line", (1.2, 0.3, -0.8, 0.4, 0.7), 0.8, 5, displacement=(0.05, -0.1, 0.0)
    )
    posture = flexgen.Posture(("q0", "l1", "l2"), (0.1, 0.2, -0.3))
    move = replace(hand.place(line), posture=posture)
    q_g = flexgen.plan(model, move).sample(0.8 * T).q_g
    assert q_g is not None
    q_a = np.zeros((len(T), model.n_a))
    q_a[:, list(model.i_g)] = q_g[:, :, 0]
    tool, _, part, part_R = poses(Seen(model, tmp_path), q_a, hand)
    p = (part_R.transpose(0, 2, 1) @ (tool - part)[..., None])[..., 0]
    way = np.array([0.05, -0.1, 0.0])
    assert off_line(p, np.tile(np.eye(3), (len(T), 1, 1)), way, np.zeros(3)) < EXACT
    with pytest.raises(ArgumentError, match="which q0 moves together with the tool"):
        flexgen.plan(model, replace(move, posture=flexgen.Posture(("l1",), (0.2,))))


@pytest.mark.parametrize("element", ["", "cradle"])
def test_seen_from_the_workpiece_the_wheel_is_on_its_line(tmp_path: Path, element: str) -> None:
    """A wheel in the room, and one that the positioner carries."""
    model = grinding(tmp_path, element=element)
    q = joints_of(flexgen.plan(model, "grind", ignore_limits=True))
    assert off_wheel(model, q, tmp_path) < EXACT


def test_a_planted_turn_of_the_workpiece_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = fixed_tool.multiply
    monkeypatch.setattr(fixed_tool, "multiply", lambda Q, x: right(Q.swapaxes(1, 2), x))
    model = grinding(tmp_path)
    alone = replace(model, output=model.output.of_tool)
    sample = Planned(flexgen.derive(alone), replace(model.move("grind"), posture=None)).sample(T)
    assert sample.R is not None and sample.w is not None
    wheel = next(frame for frame in model.frames if frame.name == "wheel")
    seen = np.array(wheel.position) - sample.y[:, :, 0]
    p = (sample.R.transpose(0, 2, 1) @ seen[..., None])[..., 0]
    turned = sample.R.transpose(0, 2, 1) @ np.array(wheel.rotation)
    assert off_line(p, turned, np.array([0.08, 0.05, -0.03]), np.array([0.2, -0.1, 0.1])) > 1e-3


@pytest.mark.parametrize("way", [LINE, ARC])
def test_derivatives_of_the_workpiece_are_those_of_differences(tmp_path: Path, way: str) -> None:
    model = grinding(tmp_path, way)
    alone = replace(model, output=model.output.of_tool)
    move = replace(model.move("grind"), posture=None)
    path = Planned(flexgen.derive(alone), move)
    h = 1e-5
    t = np.linspace(0.1, 0.9, 7) + 0.003
    here, after, before = (path.sample(t + shift) for shift in (0.0, h, -h))
    for k in range(5):
        slope = (after.y[:, :, k] - before.y[:, :, k]) / (2 * h)
        scale = 1.0 + np.abs(here.y[:, :, k + 1]).max()
        assert np.abs(slope - here.y[:, :, k + 1]).max() < 1e-5 * scale
    assert here.w is not None and after.w is not None and before.w is not None
    assert after.R is not None and before.R is not None and here.R is not None
    spin = Rotation.from_matrix(after.R @ before.R.transpose(0, 2, 1)).as_rotvec() / (2 * h)
    assert np.abs(spin - here.w[:, :, 0]).max() < 1e-6
    for k in range(4):
        slope = (after.w[:, :, k] - before.w[:, :, k]) / (2 * h)
        scale = 1.0 + np.abs(here.w[:, :, k + 1]).max()
        assert np.abs(slope - here.w[:, :, k + 1]).max() < 1e-5 * scale


@pytest.mark.slow
def test_a_ground_workpiece_is_solved(tmp_path: Path) -> None:
    model = grinding(tmp_path)
    solution = flexgen.solve(model, "grind", progress=False)
    assert off_wheel(model, simulated(solution, 1.0), tmp_path) < EXACT


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('element = "table"\n', 'element = "tabel"\n', "part.element: given .tabel."),
        ("[[move]]\n", f"{AT_REST}[[move]]\n", "stay.frame: .*only the moves tool_line"),
        ('frame = "part"\n', 'frame = "part"\nfixed_tool = "part"\n', "fixed_tool: .*no frame"),
        ('frame = "part"\n', 'frame = "part"\ncarried = {}\n', "carried: .*an element carries"),
        ("duration = 1.0\nsmoothness = 5", "profile = [0.1, 1.0]", "seam.frame: .*a duration"),
    ],
)
def test_frames_of_elements_that_do_not_fit_are_refused(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    cell(tmp_path)
    file = tmp_path / "cell.toml"
    text = file.read_text()
    head, tail = text.split("[[frame]]")
    assert old in tail
    file.write_text(f"{head}[[frame]]{tail.replace(old, new)}")
    with pytest.raises(ModelError, match=words):
        flexgen.read(file)


def test_moves_in_frames_of_elements_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    model = cell(tmp_path)
    seam = model.move("seam")
    part = model.frames[0]
    assert seam.frame == part
    for change, words in (
        ({"profile": (0.1, 1.0), "duration": 0.0}, "a duration and a smoothness"),
        ({"frame": replace(part, element="wagon")}, "'wagon', expected one of carousel"),
        ({"frame": replace(part, element="wrist")}, "which q1 moves together with the tool"),
        ({"fixed_tool": part}, "one of them"),
        ({"type": "joint", "end": seam.start}, "a move of the tool"),
    ):
        with pytest.raises((ArgumentError, ModelError), match=words):
            flexgen.plan(model, replace(seam, **change))
    elbow = flexgen.read("elbow")
    line = replace(elbow.move("line"), fixed_tool=flexgen.WorkFrame("wheel"))
    with pytest.raises((ArgumentError, ModelError), match="pose of the workpiece"):
        flexgen.plan(elbow, line)
    with pytest.raises(ArgumentError, match=r"a frame that moves|a spline"):
        flexgen.plan(model, "seam").table()
    joint = replace(elbow.move("joints"))
    with pytest.raises(ArgumentError, match="which element table carries"):
        part.place(joint)


def test_an_overlay_has_the_frame_where_the_model_has_it(tmp_path: Path) -> None:
    """The frame of a link is at its joint, the tip of an element behind its body frame."""
    grinding(tmp_path, element="cradle")
    file = tmp_path / "cell.toml"
    text = file.read_text()
    at = "origin = { position = [0.95, 0.1, 0.35], rpy_deg = [0, 0, 20] }\n"
    assert at in text
    file.write_text(text.replace(at, f"{at}link = {{ position = [0.02, 0.0, 0.05] }}\n"))
    model = flexgen.read(file)
    written = flexgen.export_urdf(model, tmp_path / "robot.urdf")
    again = flexgen.read(written.details["overlay"])
    t = np.array([0.0, 0.4, 1.0])
    ours, theirs = (
        flexgen.plan(robot, "grind", ignore_limits=True).sample(t) for robot in (model, again)
    )
    assert np.abs(ours.y - theirs.y).max() < 1e-8
    # a planted frame: where it would be without its distance from the joint
    (wheel,) = (frame for frame in again.frames if frame.name == "wheel")
    moved = replace(again.move("grind"), fixed_tool=replace(wheel, position=(0.1, 0.0, 0.3)))
    other = flexgen.plan(again, moved, ignore_limits=True).sample(t)
    assert np.abs(other.y - ours.y).max() > 1e-4
