"""Outputs with the rotation about one axis, against kinematics written out here by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath

import mujoco
import numpy as np
import pytest
from emitted import paths_library, random_states
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.recursion.functions import fast_function
from flexgen.dynamics.mechanics import tool_angle
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.exports.mujoco.mujoco import mjcf
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Move, MoveC, MoveJ, MoveL, Program
from flexgen.model.reader import read
from flexgen.paths.geometry.segments import WithAngle
from flexgen.paths.path import Path
from flexgen.paths.timing.joint_limits import InverseKinematics
from flexgen.studies.templates.new_model import new_model

SUPPORT = FilePath(__file__).resolve().parents[1] / "support" / "robots"
# Rounding of some hundred operations with lengths of a meter.
ROUNDING = 1e-12
# Central differences with steps of 1e-4 and their halves: h^4 and 1e-16 / h.
DIFFERENCE = 1e-8
FULL_TURN = 2 * np.pi
FOLLOWED = 1e-6  # m and rad: accuracy to which a move is solved


# --- robots, and their kinematics by hand --------------------------------------------------------


def about(axis: int, angle: float) -> np.ndarray:
    """Rotation matrix about x, y or z."""
    c = np.cos(angle)
    s = np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[j, i] = s
    R[i, j] = -s
    return R


def scara(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of tilted_scara.toml: column with tilts and twist, two links, quill and flange."""
    base = about(0, q[0]) @ about(1, q[1]) @ about(2, q[2])
    first = base @ about(2, q[3])
    second = first @ about(2, q[4])
    p = base @ [0, 0, 0.6] + first @ [0.3, 0, 0] + second @ [0.25, 0, q[5] - 0.25 - 0.06]
    return p, second @ about(2, q[6])


def palletizer(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the template: the wrist is level in the frame of the carousel."""
    carousel = about(2, q[0])
    upper = carousel @ about(1, q[1])
    fore = carousel @ about(1, q[1] + q[2])
    p = carousel @ [0.3, 0, 0.7] + upper @ [0, 0, 1.2] + fore @ [1.3, 0, 0]
    return p + carousel @ [0.2, 0, -0.3], carousel @ about(2, q[3])


def planar(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of planar3.toml: all axes are -y."""
    arms = [about(1, -total) for total in np.cumsum(q)]
    return arms[1] @ [0.5, 0, 0] + arms[2] @ [0.4, 0, 0] + arms[3] @ [0.12, 0, 0], arms[3]


def angle_about_z(R: np.ndarray) -> float:
    return float(np.arctan2(R[1, 0], R[0, 0]))


def angle_about_minus_y(R: np.ndarray) -> float:
    return float(np.arctan2(R[2, 0], R[0, 0]))


# file, kinematics, axes of the position, angle of an orientation, angle of the undeflected arm
Robot = tuple[
    str,
    Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    list[int],
    Callable[[np.ndarray], float],
    Callable[[np.ndarray], float],
]
ROBOTS: dict[str, Robot] = {
    "tilted_scara": (
        str(SUPPORT / "tilted_scara.toml"),
        scara,
        [0, 1, 2],
        angle_about_z,
        lambda q: q[3] + q[4] + q[6],
    ),
    "palletizer": ("palletizer", palletizer, [0, 1, 2], angle_about_z, lambda q: q[0] + q[3]),
    "planar3": (str(SUPPORT / "planar3.toml"), planar, [0, 2], angle_about_minus_y, np.sum),
}
QUICK = [
    "tilted_scara",
    *(pytest.param(x, marks=pytest.mark.slow) for x in ("palletizer", "planar3")),
]
EACH = pytest.mark.parametrize("name", QUICK)


@cache
def equations(name: str) -> Equations:
    file = ROBOTS[name][0]
    if file == "palletizer":
        folder = FilePath(__file__).resolve().parents[2] / "build"
        folder.mkdir(exist_ok=True)
        path = folder / "palletizer_of_the_template.toml"
        path.write_text(new_model("palletizer", "palletizer"))
        file = str(path)
    return derive(read(file))


def by_hand(name: str, q: np.ndarray) -> np.ndarray:
    """The output: the angle within half a turn of that of the undeflected arm."""
    _, kinematics, axes, angle, straight = ROBOTS[name]
    p, R = kinematics(q)
    about_it = float(straight(q))
    off = (angle(R) - about_it + np.pi) % FULL_TURN - np.pi
    return np.append(p[axes], about_it + off)


def poses(name: str, count: int = 6) -> np.ndarray:
    """Poses of the arm with large angles, and with deflections of some degrees."""
    model = equations(name).model
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (count, model.n_a)) * 0.05
    q[:, list(model.i_g)] = model.home + rng.uniform(-1.0, 1.0, (count, model.n_g))
    q[0, list(model.i_g)[-1]] += 2 * FULL_TURN
    q[1, list(model.i_g)[-1]] -= FULL_TURN
    return q


# --- the output and its derivatives --------------------------------------------------------------


def outputs(name: str, q: np.ndarray) -> np.ndarray:
    return np.asarray(evaluate(equations(name).function("output"), q)[0]).reshape(len(q), -1)


@EACH
def test_position_and_angle_are_those_of_the_kinematics_by_hand(name):
    """Whole turns of the last joint count: the angle is not reduced to half a turn."""
    q = poses(name)
    expected = np.array([by_hand(name, one) for one in q])
    assert np.abs(outputs(name, q) - expected).max() < ROUNDING * 10
    # planted: without the deflections the angle of the tilted robot is another one
    if name == "tilted_scara":
        straight = [ROBOTS[name][4](one) + one[2] for one in q]
        assert np.abs(expected[:, -1] - straight).max() > 1e-4


def gradient(f: Callable[[np.ndarray], np.ndarray], x: np.ndarray, h: float = 1e-3) -> np.ndarray:
    """Jacobian (rows, n) by central differences, extrapolated once."""
    columns = []
    for e in np.eye(len(x)):
        both = [(f(x + s * e) - f(x - s * e)) / (2 * s) for s in (h, h / 2)]
        columns.append((4 * both[1] - both[0]) / 3)
    return np.array(columns).T


@EACH
def test_rates_are_derivatives_of_the_kinematics_by_hand(name):
    """W, W' v, and the derivatives of W v and W a + W' v, by differences; by both derivations."""
    own = equations(name)
    model = equations(name).model
    rng = np.random.default_rng(5)
    q = poses(name)[0]
    v = rng.uniform(-1, 1, model.n_a)
    a = rng.uniform(-1, 1, model.n_a)
    W = gradient(lambda x: by_hand(name, x), q)

    def first(x: np.ndarray, speed: np.ndarray) -> np.ndarray:
        return gradient(lambda y: by_hand(name, y), x) @ speed

    bias = gradient(lambda x: first(x, v), q) @ v
    target = np.zeros(model.output.size)
    for function in (own.function("output_constraint"), fast_function(own, "output_constraint")):
        assert function is not None
        error, rate, curved = (np.squeeze(x) for x in evaluate(function, q, v, target))
        assert np.abs(error - by_hand(name, q)).max() < ROUNDING * 10
        assert np.abs(rate - W).max() < DIFFERENCE and np.abs(curved - bias).max() < 1e-4
    # the two derivations agree to rounding, also in what differences do not resolve
    both = [own.function("inversion_jacobians"), fast_function(own, "inversion_jacobians")]
    found = [evaluate(f, q, v, a) for f in both if f is not None]
    assert len(found) == 2
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() <= 1e-10 * (1.0 + np.abs(one).max())
    by_q = np.squeeze(found[0][0])
    assert np.abs(by_q - gradient(lambda x: first(x, v), q)).max() < 1e-4


def test_a_planted_axis_is_seen(monkeypatch):
    """Planted: the angle counts clockwise; the test of the output must fail."""
    right = tool_angle.plane_axes
    monkeypatch.setattr(
        tool_angle, "plane_axes", lambda output: (right(output)[0], -right(output)[1])
    )
    own = derive(equations("tilted_scara").model)
    q = poses("tilted_scara")
    expected = np.array([by_hand("tilted_scara", one) for one in q])
    found = np.asarray(evaluate(own.function("output"), q)[0]).reshape(len(q), -1)
    assert (
        np.abs(found - expected)[:, -1].max() > 0.1
        and np.abs(found - expected)[:, :3].max() < 1e-11
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tilted_scara", "palletizer", "planar3"])
def test_mujoco_has_the_same_position_and_angle(name):
    """The exported robot at its joints; that of a level wrist is set from the others."""
    model = equations(name).model
    machine = mujoco.MjModel.from_xml_string(mjcf(model))
    data = mujoco.MjData(machine)
    at = {machine.joint(j).name: machine.jnt_qposadr[j] for j in range(machine.njnt)}
    q = poses(name)
    for one in q:
        for coordinate, value in zip(model.coordinates, one, strict=True):
            data.qpos[at[coordinate.name]] = value
        if "level" in at:
            data.qpos[at["level"]] = -one[1] - one[2]
        mujoco.mj_kinematics(machine, data)
        tool = machine.site("tool").id
        p = data.site_xpos[tool]
        R = data.site_xmat[tool].reshape(3, 3)
        _, _, axes, angle, _ = ROBOTS[name]
        y = outputs(name, one[None])[0]
        assert np.abs(y[:-1] - p[axes]).max() < ROUNDING * 10
        off = (y[-1] - angle(R) + np.pi) % FULL_TURN - np.pi
        assert abs(off) < ROUNDING * 10


# --- paths ---------------------------------------------------------------------------------------

PROFILE = (0.8, 6.0, 150.0, 8000.0)
TURN = (0.0, 0.0, 1.0)
START = (0.3, 0.9, -0.05, 0.0)
LEGS = (
    MoveL((0.0, 0.0, 0.03), zone=0.01),
    MoveC((-0.06, 0.06, 0.0), via=(-0.05, 0.02, 0.01), rotation=(0.0, 0.0, 0.7), zone=0.02),
    MoveL((-0.05, 0.03, 0.0), rotation=(0.0, 0.0, -1.2), zone=0.01),
    MoveL((0.0, 0.0, -0.03)),
)


def scara_moves() -> dict[str, Move]:
    line = {"displacement": (-0.1, 0.12, -0.05), "rotation": (0.0, 0.0, 2.5)}
    arc = {"center": (-0.08, -0.05, 0.0), "axis": (0.1, 0.0, 1.0), "angle": 1.1, "rotation": TURN}
    joints = {"joint_profile": (2.0, 20.0, 400.0, 2e4)}
    steps = (
        MoveL((-0.05, 0.0, 0.0), rotation=TURN, zone=0.01),
        MoveL((0.0, 0.05, -0.02), rotation=TURN),
        MoveJ((0.5, 0.8, -0.1, 0.3)),
        MoveL((-0.04, 0.02, 0.01), rotation=(0.0, 0.0, -0.5)),
    )
    return {
        "line": Move("line", "tool_line", START, 0.8, 5, **line),
        "bounded line": Move("line", "tool_line", START, 0.0, 0, profile=PROFILE, **line),
        "turn": Move("turn", "tool_line", START, 0.6, 5, displacement=(0, 0, 0), rotation=TURN),
        "arc": Move("arc", "tool_circle", START, 0.8, 5, **arc),
        "polyline": Move("p", "tool_polyline", START, 1.6, 6, legs=LEGS),
        "bounded polyline": Move("p", "tool_polyline", START, 0.0, 5, legs=LEGS, profile=PROFILE),
        "joint": Move("joint", "joint", START, 0.6, 5, end=(0.8, 0.3, -0.1, 0.5)),
        "program": Program("program", start=START, steps=steps, profile=PROFILE, **joints),
    }


def path_of(move: str) -> Path:
    return Path(equations("tilted_scara"), scara_moves()[move])


@pytest.mark.parametrize("move", scara_moves())
def test_joints_along_a_path_have_its_output(move):
    """The joints of the undeflected arm have this output; its derivatives belong to it."""
    path = path_of(move)
    t = np.linspace(0.0, path.duration, 41)
    sample = path.sample(t)
    model = equations("tilted_scara").model
    start = path.q_start[list(model.i_g)]
    if move == "joint":
        q_g = sample.q_g[:, :, 0]
    else:
        q_g = InverseKinematics(path.equations).follow_many(sample, start, t / path.duration)
    q = np.zeros((len(t), model.n_a))
    q[:, list(model.i_g)] = q_g
    found = np.array([by_hand("tilted_scara", one) for one in q])
    assert np.abs(found - sample.y[:, :, 0]).max() < 1e-9
    h = 1e-4 * path.duration
    inside = t[1:-1] + 0.3 * (t[1] - t[0])
    inside = inside[np.abs(inside[:, None] - path.breaks).min(axis=1) > 3 * h]
    before, here, after = (path.sample(inside + s * h).y for s in (-1, 0, 1))
    for order in range(2):
        slope = (after[:, :, order] - before[:, :, order]) / (2 * h)
        size = np.abs(here[:, :, order + 1]).max(axis=0).max()
        assert np.abs(slope - here[:, :, order + 1]).max() < 1e-4 * size


def test_a_rotation_of_more_than_a_turn_is_a_number():
    """A line that turns the tool by 800 deg: the angle grows in proportion to the length."""
    line = Move(
        "l", "tool_line", START, 1.0, 5, displacement=(-0.1, 0.1, 0.0), rotation=(0, 0, 14.0)
    )
    y = Path(equations("tilted_scara"), line).sample(np.linspace(0.0, 1.0, 21)).y[:, :, 0]
    assert y[0, 3] == pytest.approx(1.2, abs=1e-14) and y[-1, 3] - y[0, 3] == pytest.approx(14.0)
    share = (y[:, 0] - y[0, 0]) / -0.1
    assert np.abs(y[:, 3] - y[0, 3] - 14.0 * share).max() < 1e-13


def test_corners_leave_arc_length_to_the_position():
    """A rotation does not bend the path: positions have the same bits with and without it."""
    still = tuple(replace(leg, rotation=(0.0, 0.0, 0.0)) for leg in LEGS)
    own = [
        Path(
            equations("tilted_scara"),
            Move("p", "tool_polyline", START, 0.9, 6, legs=legs, radius=1e-3),
        )
        for legs in (LEGS, still)
    ]
    t = np.linspace(0.0, 0.9, 101)
    turning, plain = (path.sample(t).y for path in own)
    assert np.array_equal(turning[:, :3], plain[:, :3])
    assert np.ptp(turning[:, 3, 0]) > 0.6 and np.ptp(plain[:, 3, 0]) == 0.0


def write_samples(folder: FilePath, columns: dict[str, np.ndarray]) -> str:
    rows = np.column_stack(list(columns.values()))
    text = "\n".join([",".join(columns), *(",".join(map(repr, map(float, r))) for r in rows)])
    (folder / "path.csv").write_text(text + "\n")
    return str(folder / "path.csv")


def sampled_columns(kind: str) -> dict[str, np.ndarray]:
    """A quarter circle of the tool at constant height, its angle from 1.2 to 1.2 + 5 rad."""
    s = np.linspace(0.0, 1.0, 121)
    p, _ = scara(np.array([0.0, 0.0, 0.0, *START]))
    angle = 1.2 + 5.0 * s
    place = {
        "t": s,
        "x": p[0] - 0.08 * np.sin(s * np.pi / 2),
        "y": p[1] + 0.08 * (1.0 - np.cos(s * np.pi / 2)),
        "z": np.full(len(s), p[2]),
    }
    more = {
        "angle": {"angle": angle},
        "wrapped": {"angle": (angle + np.pi) % FULL_TURN - np.pi},
        "quaternion": {
            "qw": np.cos(angle / 2),
            "qx": 0.0 * s,
            "qy": 0.0 * s,
            "qz": np.sin(angle / 2),
        },
        "vector": {"rx": 0.0 * s, "ry": 0.0 * s, "rz": (angle + np.pi) % FULL_TURN - np.pi},
        "none": {},
    }
    return place | more[kind]


@pytest.mark.parametrize("kind", ["angle", "wrapped", "quaternion", "vector", "none"])
def test_a_sampled_path_has_the_angle_of_its_file(kind, tmp_path):
    """As a column, also within half a turn, as quaternions or vectors; without one it is kept."""
    file = write_samples(tmp_path, sampled_columns(kind))
    path = Path(equations("tilted_scara"), Move("s", "sampled", START, 0.0, 0, file=file))
    y = path.sample(np.linspace(0.0, 1.0, 31)).y[:, :, 0]
    expected = 1.2 + 5.0 * np.linspace(0.0, 1.0, 31) * (kind != "none")
    inner = slice(4, -4)  # the spline is at rest at both ends
    assert np.abs(y[inner, 3] - expected[inner]).max() < 1e-3
    assert y[-1, 3] == pytest.approx(expected[-1], abs=1e-9)


def test_sampled_orientations_that_tilt_and_angles_of_other_outputs_are_refused(tmp_path):
    columns = sampled_columns("quaternion")
    columns["qx"] = 0.02 * np.sin(np.linspace(0, 1, 121))
    norm = np.sqrt(sum(columns[k] ** 2 for k in ("qw", "qx", "qy", "qz")))
    columns |= {k: columns[k] / norm for k in ("qw", "qx", "qy", "qz")}
    move = Move("s", "sampled", START, 0.0, 0, file=write_samples(tmp_path, columns))
    with pytest.raises(ArgumentError, match=r"sample \d+ that is tilted by .* deg"):
        Path(equations("tilted_scara"), move)
    model = equations("tilted_scara").model
    other = replace(model, output=replace(model.output, type="tool_position"))
    move = replace(move, file=write_samples(tmp_path, sampled_columns("angle")))
    with pytest.raises(
        ModelError, match='an angle, expected none, or an output of type "tool_pos'
    ):
        Path(derive(other), move)


@needs_compiler
@pytest.mark.parametrize(
    ("name", "most"), [("planar3", 2), ("tilted_scara", 2), ("palletizer", 4)]
)
def test_kinematics_finds_the_joints_of_a_pose(name, most):
    """The joints of poses by hand are among the configurations; all of them reach the pose."""
    model = equations(name).model
    rng = np.random.default_rng(8)
    for _ in range(4):
        q = np.zeros(model.n_a)
        q[list(model.i_g)] = model.home + rng.uniform(-0.4, 0.4, model.n_g)
        p, R = ROBOTS[name][1](q)
        found = flexgen.kinematics(model, p, R)
        assert 1 <= len(found) <= most
        off = [np.abs(one.q - q[list(model.i_g)]).max() for one in found]
        assert min(off) < 1e-7
        for one in found:
            full = np.zeros(model.n_a)
            full[list(model.i_g)] = one.q
            own = ROBOTS[name][1](full)
            assert np.abs(own[0] - p).max() < 1e-8 and np.abs(own[1] - R).max() < 1e-8
    # a tool that tilts, and one out of reach
    assert flexgen.kinematics(model, p, about(0, 0.01) @ R) == ()
    assert flexgen.kinematics(model, p + np.array([9.0, 0.0, 0.0]), R) == ()
    with pytest.raises(ArgumentError, match="sag: given for model"):
        flexgen.kinematics(model, p, R, sag=True)


# --- whole moves ---------------------------------------------------------------------------------


def follows(name: str, move: Move | str, **options: object) -> flexgen.Solution:
    """The solution; its simulated joints and deflections, by hand, follow the path."""
    found = flexgen.solve(equations(name), move, progress=False, **options)
    assert str(found.status) == "solved" and found.simulation is not None
    run = found.simulation.trajectory
    wanted = Path(equations(name), found.move).sample(run.time).y[:, :, 0]
    attained = np.array([by_hand(name, q) for q in run["q_a"]])
    assert np.abs(attained - wanted).max() < FOLLOWED
    assert np.abs(run["error"] - (attained - wanted)).max() < 100 * ROUNDING
    return found


@needs_compiler
@pytest.mark.parametrize(
    "move",
    [x if x == "arc" else pytest.param(x, marks=pytest.mark.slow) for x in scara_moves()],
)
def test_the_tool_of_the_tilted_robot_follows_each_kind_of_path(move):
    found = follows("tilted_scara", scara_moves()[move])
    assert found.tool_error_max_m < 1e-6 and found.tool_error_max_rad < 1e-6
    assert np.abs(found.trajectory["q_a"][:, :2]).max() > 1e-5  # its column tilts


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "move"),
    [("palletizer", "line"), ("palletizer", "over"), ("planar3", "line"), ("planar3", "arc")],
)
def test_palletizer_and_planar_arm_follow_their_paths(name, move):
    follows(name, move)


@needs_compiler
@pytest.mark.slow
def test_two_methods_give_the_same_torques():
    model = equations("tilted_scara")
    one, other = (
        flexgen.solve(model, "line", method=method, progress=False).trajectory
        for method in ("lq", "bvp")
    )
    t = np.linspace(0.0, 0.5, 400)
    tau = [np.array([np.interp(t, x.time, c) for c in x["tau_m"].T]) for x in (one, other)]
    assert np.abs(tau[0] - tau[1]).max() < 1e-4 * np.abs(tau[0]).max()


# --- C -------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name", list(ROBOTS))
def test_c_has_the_output_of_the_definition(name):
    """The constraint and its derivatives, at random states."""
    own = equations(name)
    library = paths_library(own, "invert")
    states = random_states(own.model, 5)
    target = np.zeros(own.model.output.size)
    for q, v, a in zip(states["q_a"], states["v_a"], states["a_a"], strict=True):
        for function, inputs in (
            ("output_constraint", (q, v, target)),
            ("inversion_jacobians", (q, v, a)),
        ):
            if function not in library.functions:  # without elastic coordinates C needs none
                assert not own.model.n_e
                continue
            found = getattr(library, function)(*inputs)
            expected = evaluate(own.function(function), *inputs)
            for x, y in zip(found, expected, strict=True):
                assert np.abs(np.asarray(x) - y[0].reshape(np.shape(x))).max() < 1e-9 * (
                    1 + np.abs(y).max()
                )


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("move", [x for x in scara_moves()])
def test_the_sampler_in_c_has_the_bits_of_python(move):
    """Lines, arcs and corners with an angle; of joint moves to rounding, as for other outputs."""
    path = path_of(move)
    sampler = paths_library(path.equations, "path_sampler").path_sampler(path.table())
    t = np.sort(np.r_[np.linspace(-0.1, path.duration + 0.1, 151), path.breaks])
    sample = path.sample(t)
    targets = Reduction(path.equations).targets(sample)
    expected = [targets, sample.derivative(1), sample.derivative(2)]
    found = [np.array(x) for x in zip(*(sampler(at) for at in t), strict=True)]
    starts = [segment.start for segment in path.segments]
    number = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(starts) - 1)
    of_tool = np.array([path.segments[k].space == "tool" for k in number])
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one[of_tool], other[of_tool])
        assert np.abs(one - other).max() <= 2e-13 * max(1.0, np.abs(other).max())


@needs_compiler
@pytest.mark.slow
def test_a_planted_angle_of_arcs_is_seen(monkeypatch):
    path = path_of("arc")
    sampler = paths_library(path.equations, "path_sampler").path_sampler(path.table())
    monkeypatch.setattr(
        WithAngle, "angle", property(lambda self: 1.001 * self.rotation @ self.axis)
    )
    y = path_of("arc").sample(np.array([0.3])).y[0, :, 0]
    assert np.array_equal(sampler(0.3)[0][:3], y[:3]) and abs(sampler(0.3)[0][3] - y[3]) > 1e-4


@needs_compiler
@pytest.mark.slow
def test_a_stream_gives_the_torques_of_the_whole_path():
    own = equations("tilted_scara")
    library = paths_library(own, "invert", "stream")
    path = path_of("line")
    period = 2e-3
    ahead = 40
    t = np.arange(round(path.duration / period) + 1) * period
    y, dy, ddy = (path.sample(t).y[:, :, k] for k in range(3))
    whole = library.invert(y, dy, ddy, period=period, q_start=path.q_start, n_pre=40, n_post=40)
    stream = library.stream(y[0], path.q_start, period=period, intervals=ahead)
    still = np.zeros(own.model.output.size)
    told = [stream.update(*x) for x in zip(y[1:], dy[1:], ddy[1:], strict=True)]
    told += [stream.update(y[-1], still, still) for _ in range(ahead)]
    torque = np.vstack([x.tau_m for x in told])[ahead:]
    at = np.searchsorted(whole.t, 1e-9)
    n = min(len(torque), len(whole.tau_m) - at - 1)
    off = min(
        np.abs(torque[: n - 2] - whole.tau_m[at + k : at + k + n - 2]).max() for k in range(3)
    )
    assert off < 2e-3 * np.abs(whole.tau_m).max()


@needs_compiler
@pytest.mark.slow
def test_limits_slow_the_tool_and_count_its_position_only():
    """A bound on the tool speed is one of the position; the deviation is stated in m and rad."""
    own = equations("tilted_scara")
    free = follows("tilted_scara", scara_moves()["line"])
    speeds = np.linalg.norm(np.diff(free.trajectory["y_ref"][:, :3], axis=0), axis=1)
    fastest = float((speeds / np.diff(free.trajectory.time)).max())
    wide = flexgen.Limits(tool_speed=1.05 * fastest)
    found = flexgen.solve(own, scara_moves()["line"], limits=wide, progress=False)
    assert str(found.status) == "solved"  # the rotation would break a bound on all four
    tight = flexgen.solve(
        own, scara_moves()["line"], limits=flexgen.Limits(tool_speed=0.9 * fastest), progress=False
    )
    assert "m and" in tight.verdict and tight.details["deviation_max_m"] > 1e-4


# --- redundant arms ------------------------------------------------------------------------------

TRACK = """
[[element]]
name = "track"
body = { mass = 60.0, com = [0, 0, 0], inertia = [2, 2, 2] }
[[element.dof]]
name = "x"
type = "translation"
axis = [1, 0, 0]
gear.type = "elastic"
gear.side = "arm"
gear.spring = { type = "linear", stiffness = 2e6 }
gear.damping = 600

[[element]]
name = "column"
"""
MOTOR = """
[[motor]]
name = "mx"
drives = "x"
ratio = 250
inertia = 4e-4

[[motor]]
name = "m1"
"""


def track_robot(tmp_path: FilePath) -> RobotModel:
    """The SCARA with its tilting column on a track with a fifth motor."""
    text = FilePath(ROBOTS["tilted_scara"][0]).read_text()
    text = text.replace('\n[[element]]\nname = "column"\n', TRACK).replace(
        '\n[[motor]]\nname = "m1"\n', MOTOR
    )
    text = text.replace("_rad = [0.3,", "_rad = [0.0, 0.3,").replace(
        "end_rad = [0.9,", "end_rad = [0.2, 0.9,"
    )
    (tmp_path / "track.toml").write_text(text)
    return read(tmp_path / "track.toml")


@needs_compiler
@pytest.mark.parametrize("fixed", [None, pytest.param("x", marks=pytest.mark.slow)])
def test_a_robot_on_an_elastic_track_follows_a_path_of_its_tool(fixed, tmp_path):
    """Five motors, four outputs, three coordinates without motor: the tool is exact."""
    robot = track_robot(tmp_path)
    found = flexgen.solve(robot, "line", fixed_joint=fixed, progress=False)
    assert str(found.status) == "solved" and found.simulation is not None
    q = found.simulation.trajectory["q_a"]
    y = np.array([by_hand("tilted_scara", one[1:]) for one in q])
    y[:, 0] += q[:, 0]
    displacement = np.array([-0.12, 0.15, -0.06, np.radians(60)])
    share = (y - y[0]) @ displacement / (displacement @ displacement)
    assert share[-1] == pytest.approx(1.0, abs=1e-6)
    assert np.abs(y - y[0] - share[:, None] * displacement).max() < 1e-6
    assert np.abs(q[:, 1:4]).max() > 1e-5
    if fixed:
        assert np.ptp(q[:, 0]) < 1e-3  # the deflection of its gear is left


# --- refusals ------------------------------------------------------------------------------------


def changed(tmp_path: FilePath, *changes: tuple[str, str]) -> str:
    text = FilePath(ROBOTS["tilted_scara"][0]).read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "robot.toml"
    file.write_text(text)
    return str(file)


ROTATION = "rotation_deg = [0, 0, 60]"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            ROTATION,
            "rotation_deg = [0, 10, 60]",
            r"rotation_deg.*about the axis of the output, \[0, 0, 1\]",
        ),
        ("rotation_axis = [0, 0, 1] ", "rotation_axis = [0, 0, 0] ", "direction that is not zero"),
        ("rotation_axis = [0, 0, 1] ", 'reference = "w"\nrotation_axis = [0, 0, 1]', "reference"),
        ("rotation_axis = [0, 0, 1] ", "# rotation_axis", "rotation_axis: given nothing"),
    ],
)
def test_errors_of_a_file_name_the_key(old, new, message, tmp_path):
    with pytest.raises(ModelError, match=message):
        read(changed(tmp_path, (old, new)))


def test_a_reference_along_the_axis_is_refused(tmp_path):
    file = changed(
        tmp_path, ("rotation_axis = [0, 0, 1] ", 'reference = "z"\nrotation_axis = [0, 0, 1]')
    )
    with pytest.raises(ArgumentError, match=r"given output\.reference 'z', which is along"):
        flexgen.plan(file)


def test_an_orientation_with_another_tilt_is_refused():
    tilted = about(0, 0.1) @ about(2, 1.5)
    level = about(2, 1.5)
    for orientation, fits in ((level, True), (tilted, False)):
        matrix = tuple(tuple(map(float, row)) for row in orientation)
        steps = (MoveL((-0.05, 0.02, 0.0), orientation=matrix),)
        program = Program("p", start=START, steps=steps, profile=PROFILE)
        if fits:
            y = Path(equations("tilted_scara"), program).sample(np.array([0.0, 10.0])).y[:, 3, 0]
            assert y == pytest.approx([1.2, 1.5])
            continue
        with pytest.raises(ArgumentError, match=r"tilt of the tool.* off by 5.73 deg"):
            Path(equations("tilted_scara"), program)


def test_too_many_outputs_are_told_without_a_method_that_refuses_them(tmp_path):
    file = changed(
        tmp_path,
        ('type = "tool_position_angle"', 'type = "tool_pose"'),
        ("rotation_axis = [0, 0, 1] ", "# "),
    )
    with pytest.raises(
        ArgumentError, match='such as an output of type "tool_position_angle"'
    ) as told:
        flexgen.solve(file, progress=False)
    assert "--method full" not in str(told.value)
    with pytest.raises(ArgumentError):
        flexgen.solve(file, method="full", progress=False)
    assert [one.key for one in flexgen.check(file).errors] == ["output"]
    assert flexgen.analyze(file).modes  # rows of zeros end in no NaN


def test_a_file_with_the_output_is_written_and_read_again(tmp_path):
    """The overlay of an exported URDF file has the same output."""
    robot = equations("tilted_scara").model
    flexgen.export_urdf(robot, tmp_path / "robot.urdf")
    again = read(tmp_path / "robot.toml")
    assert again.output == robot.output
    x = {"q_a": poses("tilted_scara")}
    one, other = (evaluate(derive(m).function("output"), x["q_a"])[0] for m in (robot, again))
    assert np.abs(one - other).max() < 1e-9
