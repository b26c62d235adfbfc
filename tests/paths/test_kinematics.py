"""All configurations at a pose: exact, none lost, as many as known for each kind of arm."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.paths.inverse_kinematics.search import arm_parts, configuration_search

pytestmark = needs_compiler

ROBOTS = Path(__file__).resolve().parents[1] / "support" / "robots"
COUNTS = {  # that these arms can have away from singularities
    str(ROBOTS / "ur5.toml"): {2, 4, 6, 8},
    "kr300": {4, 8},
    "manutec_r3": {4, 8},
    str(ROBOTS / "panda.toml"): {2, 4, 6, 8, 10, 12, 14, 16},
}


def check(model, count: int, counts: set[int] | None, seed: int = 0) -> None:
    """Random poses: every solution exact, the true one among them, an even number of them."""
    rng = np.random.default_rng(seed)
    names = [model.coordinates[i].name for i in model.i_g]
    spare = names[2 : 2 + len(names) - 6]
    for _ in range(count):
        q = rng.uniform(-np.pi, np.pi, len(names))
        fixed = {name: 0.3 for name in spare}
        q[[names.index(name) for name in spare]] = 0.3
        solver = configuration_search(model, tuple(sorted(fixed.items())))
        full = np.zeros(model.n_a)
        full[list(model.i_g)] = q
        p, R = solver.library.forward_kinematics(full)
        found = solver.solve(np.concatenate([p, np.asarray(R).ravel()]))
        assert (
            min(np.abs(np.remainder(x - q + np.pi, 2 * np.pi) - np.pi).max() for x in found) < 1e-6
        )
        for x in found:
            full[list(model.i_g)] = x
            again, turned = solver.library.forward_kinematics(full)
            assert (
                np.abs(again - p).max() < 1e-12 * max(1, solver.length) * 2
                and np.abs(turned - R).max() < 2e-12
            )
        if counts is not None:
            assert len(found) in counts, len(found)


@pytest.mark.parametrize("name", COUNTS)
def test_all_configurations_of_random_poses_are_found(name):
    check(flexgen.read(name), 40, COUNTS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", COUNTS)
def test_all_configurations_of_a_thousand_poses_are_found(name):
    check(flexgen.read(name), 1000, COUNTS[name], seed=1)


def general_arm(seed: int):
    """A six-axis arm with random axes and offsets."""
    rng = np.random.default_rng(seed)
    elements = []
    text = (
        'name = "arm"\n'
        'description = "random axes"\n'
        "gravity = [0.0, 0.0, -9.81]\n"
        "home_rad = [0, 0, 0, 0, 0, 0]\n"
    )
    for k in range(6):
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        origin = rng.uniform(-0.4, 0.4, 3)
        elements.append(
            f'[[element]]\nname = "link{k}"\norigin = {{ position = {origin.tolist()} }}\n'
            "body = { mass = 1.0, inertia = [0.1, 0.1, 0.1] }\n"
            f"[[element.dof]]\n"
            f'name = "q{k}"\n'
            f'type = "rotation"\n'
            f"axis = {axis.tolist()}\n"
            f'gear = {{ type = "rigid" }}\n'
        )
    motors = "".join(
        f'[[motor]]\nname = "m{k}"\ndrives = "q{k}"\nratio = 100\ninertia = 1e-4\n'
        for k in range(6)
    )
    return (
        text
        + "".join(elements)
        + motors
        + '[tool]\nposition = [0.1, 0.05, 0.2]\n[output]\ntype = "tool_pose"\n'
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_all_configurations_of_general_arms_are_found(tmp_path, seed):
    """Twenty poses each: at most sixteen configurations, in pairs."""
    (tmp_path / "arm.toml").write_text(general_arm(seed))
    check(flexgen.read(tmp_path / "arm.toml"), 20, {2, 4, 6, 8, 10, 12, 14, 16}, seed)


def test_configurations_state_limits_branch_and_singularity():
    model = flexgen.read("manutec_r3")
    q = np.array([0.3, -1.1, 1.0, 0.4, 0.8, -0.2])
    library = configuration_search(model, ()).library
    p, R = library.forward_kinematics(q)
    found = flexgen.kinematics(model, p, R)
    assert len(found) == 8 and sorted(c.branch for c in found) == [-1] * 4 + [1] * 4
    assert max(c.error for c in found) < 1e-12 and min(c.distance for c in found) > 1e-3
    near = np.array([0.3, -1.1, 1.0, 0.4, 1e-5, -0.2])  # the wrist is nearly stretched
    p, R = library.forward_kinematics(near)
    closest = min(flexgen.kinematics(model, p, R), key=lambda c: c.distance)
    assert closest.distance < 1e-4 and closest.nearest_singularity == "wrist"
    assert flexgen.kinematics(model, np.array([50.0, 0.0, 0.0]), np.eye(3)) == ()


@pytest.mark.parametrize(
    "name", ["kr300", pytest.param("manutec_r3", marks=pytest.mark.slow), str(ROBOTS / "ur5.toml")]
)
def test_eight_configurations_have_eight_flags(name):
    """Random poses with eight solutions; the Jacobian's determinant is a constant times the
    product of the parts.
    """
    model = flexgen.read(name)
    rng = np.random.default_rng(2)
    solver = configuration_search(model, ())
    eights = 0
    ratios = []
    for _ in range(15):
        full = rng.uniform(-np.pi, np.pi, 6)
        p, R = solver.library.forward_kinematics(full)
        found = flexgen.kinematics(model, p, R)
        for c in found:
            ratios.append(
                np.linalg.det(np.asarray(solver.library.jacobian(c.q)))
                / np.prod(list(c.parts.values()))
            )
        if len(found) == 8:
            eights += 1
            assert len({c.flags for c in found}) == 8
    assert eights > 4 and np.ptp(ratios) < 1e-6 * np.abs(ratios).max()


POSE = (np.array([0.5, 0.6, 1.2]), np.eye(3))


@pytest.mark.parametrize(
    ("degrees", "turn"), [((172.0, 515.0), 2 * np.pi), ((-515.0, -230.0), -2 * np.pi), (None, 0)]
)
def test_configurations_are_turned_into_the_limits(degrees, turn):
    """By a whole turn, where that is within them; others stay, and are outside."""
    low, high = degrees or (-30.0, 90.0)
    key = "element.body6.dof.q6"
    limits = {f"{key}.lower_deg": low, f"{key}.upper_deg": high}
    home = [0, 0, 0, 0, 0, (low + high) / 2]
    given = {**limits, "home_deg": home, "move": []}
    found = flexgen.kinematics(flexgen.read("manutec_r3", overrides=given), *POSE)
    free = flexgen.kinematics("manutec_r3", *POSE)
    assert len(found) == len(free) == 4
    for one in free:
        ends = np.radians([low, high])
        inside = [x for x in (0.0, turn) if ends[0] <= one.q[5] + x <= ends[1]]
        (same,) = (c for c in found if np.abs((c.q - one.q)[:5]).max() < 1e-9)
        assert same.within_limits == bool(inside)
        assert same.q[5] == pytest.approx(one.q[5] + (inside or [0.0])[0])
        assert same.branch == one.branch and same.distance == pytest.approx(one.distance)
    assert {c.within_limits for c in found} == {True, False}


def test_arms_on_soft_gears_reach_the_pose_at_rest():
    """The tool is there with the motors at the found joints, by another solver of the balance."""
    found = flexgen.kinematics("manutec_r3", *POSE, sag=True)
    stiff = flexgen.kinematics("manutec_r3", *POSE)
    assert len(found) == len(stiff)
    for one in found:
        at = flexgen.tracker_positions("manutec_r3", one.q[None])[0, 0]
        assert np.abs(at - POSE[0]).max() < 1e-11 and one.error < 1e-11
    moved = [min(np.abs(c.q - x.q).max() for x in stiff) for c in found]
    assert min(moved) > 1e-6


def test_parts_of_an_arm_are_distances_sines_and_volumes():
    """Axes of an elbow arm in the plane of x and z, turned by a, a + b and a + b + c about y."""
    a = 0.3
    b = 1.1
    c = -0.6

    def along(angle):
        return np.array([np.sin(angle), 0.0, np.cos(angle)])

    y = np.array([0.0, 1.0, 0.0])
    elbow = along(a)
    wrist = elbow + along(a + b)
    points = np.array([np.zeros(3), np.zeros(3), elbow, wrist, wrist, wrist])
    axes = np.array([[0.0, 0.0, 1.0], y, y, along(a + b), y, along(a + b + c)])
    tool = wrist + 0.2 * axes[5]

    def parts(z):
        return arm_parts(np.vstack([np.cross(z, tool - points).T, z.T]))

    found = parts(axes)
    assert found["elbow"] == pytest.approx(np.sin(b))
    assert abs(found["wrist"]) == pytest.approx(abs(np.sin(c)))
    assert abs(found["shoulder"]) == pytest.approx(abs(wrist[0]))
    turned = parts(axes * np.array([[1], [1], [1], [1], [1], [-1]]))
    assert np.sign(turned["wrist"]) == -np.sign(found["wrist"])


@pytest.mark.slow
def test_the_elastic_robot_reaches_the_pose_at_rest():
    """Motors at the found joints: the robot at rest, from its equations of motion, has its tool at
    the pose.
    """
    from flexgen.dynamics.mechanics.equations import derive
    from flexgen.feedback.loop.plants import LocalDynamics

    model = flexgen.read("manutec_r3_18")
    q = np.array([0.3, -1.1, 1.0, 0.4, 0.8, -0.2])
    full = np.zeros(model.n_a)
    full[list(model.i_g)] = q
    library = configuration_search(model, ()).library
    p, R = library.forward_kinematics(full)
    plain = flexgen.kinematics(model, p, R)[0]
    sagging = min(
        flexgen.kinematics(model, p, R, sag=True), key=lambda c: np.abs(c.q - plain.q).max()
    )
    assert 1e-5 < np.abs(sagging.q - plain.q).max() < 0.05
    rest, _ = LocalDynamics(derive(model)).rest(model.eta @ sagging.q, np.zeros(0), full)
    again, turned = library.forward_kinematics(rest)
    assert np.abs(again - p).max() < 1e-9 and np.abs(turned - R).max() < 1e-9


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.zeros(2), np.eye(3)), "pose: given shapes"),
        ((np.zeros(3), 2 * np.eye(3)), "not a rotation"),
        ((np.zeros(3), np.diag([1.0, 1.0, -1.0])), "not a rotation"),
    ],
)
def test_wrong_poses_are_refused(arguments, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.kinematics("manutec_r3", *arguments)


def test_arms_without_six_free_joints_are_refused():
    with pytest.raises(ArgumentError, match="given 2 free joints"):
        flexgen.kinematics("elbow", np.zeros(3), np.eye(3))
    with pytest.raises(ArgumentError, match="given 7 free joints"):
        flexgen.kinematics(str(ROBOTS / "panda.toml"), np.zeros(3), np.eye(3))
    with pytest.raises(ArgumentError, match="fixed: given joint 'q99'"):
        flexgen.kinematics("manutec_r3", np.zeros(3), np.eye(3), fixed={"q99": 0.0})


def test_kinematics_on_the_command_line(capsys):
    assert (
        main(
            [
                "kinematics",
                "manutec_r3",
                "-q",
                "--joints",
                "0.3",
                "-1.1",
                "1",
                "0.4",
                "0.8",
                "-0.2",
                "--json",
            ]
        )
        == 0
    )
    data = json.loads(capsys.readouterr().out)
    assert len(data["configurations"]) == 8
    p = [repr(x) for x in data["position_m"]]
    assert main(["kinematics", "manutec_r3", "-q", "--position", *p]) in (0, 1)
    assert main(["kinematics", "manutec_r3", "-q", "--position", "9", "9", "9"]) == 1
    assert "cannot be reached" in capsys.readouterr().err
    assert main(["kinematics", "manutec_r3", "-q"]) == 1
