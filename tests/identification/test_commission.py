"""`flexgen.commission`: one fit of bodies, springs, friction, zeros and lengths to all records.

Robots are drawn within and far beyond the tolerances of the datasheet. Their records come from the
inverse dynamics and the statics of Lagrange's equations, and share no code with the simulation of
the arm behind its motors in the fit.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_fits import small_fit
from toolchain import needs_compiler

import flexgen
from flexgen.identification.commissioning import forms
from flexgen.identification.commissioning.blocks import Block
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.commissioning.motion_block import Motion, MotionBlock
from flexgen.identification.commissioning.poses_block import PosesBlock
from flexgen.identification.commissioning.responses_block import ResponsesBlock
from flexgen.identification.commissioning.unknowns import (
    DatasheetTolerances,
    FormNumbers,
    make_unknowns,
)

pytestmark = needs_compiler

HAND = {"name": "hand", "type": "tracker", "unit": "m", "position": [0.0, 0.0, 0.1]}
SPRINGS = {"upper.dof.q1": 7518900.0, "fore.dof.q2": 4099900.0}  # of elbow, N m/rad
MASSES = {"upper": 339.1, "fore": 190.2}  # kg
NOISE = 2e-5  # m, of the tracker
ROUGH = 2e-3  # of the largest torque: noise of torques


def draw(seed: int) -> dict[str, object]:
    """Overrides of a robot whose springs are up to 1.6 times off, and bodies 5 %."""
    random = np.random.default_rng(seed)
    changes: dict[str, object] = {"sensor": [HAND]}
    for key, stiffness in SPRINGS.items():
        factor = 1.6 ** random.uniform(-1, 1)
        changes[f"element.{key}.gear.spring.stiffness"] = factor * stiffness
    for name, mass in MASSES.items():
        changes[f"element.{name}.body.mass"] = mass * (1 + 0.05 * random.uniform(-1, 1))
    return changes


def program(stops: np.ndarray) -> flexgen.Program:
    """Moves of all joints from stop to stop (k, n) [rad]."""
    steps = tuple(flexgen.MoveJ(tuple(stop), pause=0.1) for stop in stops[1:])
    profile = (1.5, 6.0, 80.0, 1500.0)
    return flexgen.Program(
        "moves", start=tuple(stops[0]), smoothness=5, steps=steps, joint_profile=profile
    )


def record(folder: Path, truth: flexgen.RobotModel, seed: int) -> None:
    """Two motions and forty static poses of a robot."""
    random = np.random.default_rng(seed)
    for k in range(2):
        stops = random.uniform(-1.0, 1.0, (6, truth.n_g))
        motion = flexgen.solve(truth, program(stops), verify=False).trajectory
        torque = motion["tau_m"]
        torque = torque + ROUGH * np.abs(torque).max() * random.normal(size=torque.shape)
        write_motion(folder / f"move{k}.csv", motion.time, motion["q_m"], torque)
    q = random.uniform(-1.2, 1.2, (40, truth.n_g))
    seen = flexgen.tracker_positions(truth, q)[:, 0] + NOISE * random.normal(size=(40, 3))
    header = "q1_rad,q2_rad,hand_x_m,hand_y_m,hand_z_m"
    np.savetxt(folder / "poses.csv", np.column_stack([q, seen]), header=header, **CSV)


CSV = {"delimiter": ",", "comments": "", "fmt": "%.9g"}


def write_motion(file: Path, time: np.ndarray, angles: np.ndarray, torques: np.ndarray) -> None:
    """A log of two motors."""
    header = "time s,q_m[m1] rad,q_m[m2] rad,tau_m[m1] N m,tau_m[m2] N m"
    np.savetxt(file, np.column_stack([time, angles, torques]), header=header, **CSV)


def datasheet() -> flexgen.RobotModel:
    """The model that the user has."""
    return flexgen.read("elbow", overrides={"sensor": [HAND]})


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_determined_numbers_of_drawn_robots_come_back(tmp_path: Path, seed: int) -> None:
    """Springs are found together with bodies that are off; what is not determined stays."""
    changes = draw(seed)
    record(tmp_path, flexgen.read("elbow", overrides=changes), seed)
    found = flexgen.commission(datasheet(), tmp_path, curves=False)
    assert found.status.agrees and not found.problem
    for key in SPRINGS:
        true = changes[f"element.{key}.gear.spring.stiffness"]
        name = f"{key.rpartition('.')[2]}.stiffness"
        number = next(n for n in found.fitted if n.name == name)
        assert number.is_determined and number.sd is not None
        assert abs(np.log(number.value / true)) < max(3.5 * number.sd, 0.01)
    # masses and springs are not exchanged: bodies stay within the tolerance of their CAD
    for name, mass in MASSES.items():
        assert abs(found.values[f"{name}.mass"] / mass - 1) < 0.15
    kept = [n for n in found.fitted if not n.is_determined and n.name.endswith("damping")]
    file = {name: value for name, value in (("q1.damping", 1400.0), ("q2.damping", 600.0))}
    assert kept and all(n.value == file[n.name] for n in kept)
    assert all(row.after < row.before for row in found.held_out)


def hand(q: np.ndarray) -> np.ndarray:
    """Place of the tracker of elbow (N, 3) [m] for joints (N, 2), in closed form."""
    both = q[:, 0] + q[:, 1]
    tool = 1.241  # m
    x = 1.150 * np.sin(q[:, 0]) + tool * np.cos(both) + HAND["position"][2] * np.sin(both)
    z = 1.150 * np.cos(q[:, 0]) - tool * np.sin(both) + HAND["position"][2] * np.cos(both)
    return np.column_stack([x, np.zeros(len(q)), z])


@pytest.mark.parametrize("where", ["joint", "motor"])
def test_friction_is_found_on_its_side_of_the_gear(tmp_path: Path, where: str) -> None:
    """The torque of a motor shows the same friction; that of a joint winds up the gear, which a
    tracker sees. Positions of the records are those of the closed form.
    """
    level = 2000.0  # N m, arm side
    key = "element.upper.dof.q1.friction" if where == "joint" else "motor.m1.friction"
    ratio = 1.0 if where == "joint" else 1872 / 7
    law = {"coulomb": level / ratio, "beta": 60.0 / ratio}
    truth = flexgen.read("elbow", overrides={"sensor": [HAND], key: law})
    random = np.random.default_rng(3)
    run = flexgen.solve(truth, program(random.uniform(-1.0, 1.0, (8, 2))), verify=False).trajectory
    seen = hand(run["q_a"]) + NOISE * random.normal(size=(len(run.time), 3))
    header = (
        "time s,q_m[m1] rad,q_m[m2] rad,tau_m[m1] N m,tau_m[m2] N m,hand_x m,hand_y m,hand_z m"
    )
    table = np.column_stack([run.time, run["q_m"], run["tau_m"], seen])
    np.savetxt(tmp_path / "tracked.csv", table, header=header, **CSV)
    found = flexgen.commission(datasheet(), tmp_path, curves=False, lengths=False)
    joint = found.values["q1.coulomb"]
    motor = found.values["m1.coulomb"] * 1872 / 7
    expected = (level, 0.0) if where == "joint" else (0.0, level)
    np.testing.assert_allclose((joint, motor), expected, atol=0.15 * level)


def test_written_model_has_the_numbers_and_their_deviations(tmp_path: Path) -> None:
    """The variant is read again, has the fitted numbers, and `predict` takes its tolerances."""
    record(tmp_path, flexgen.read("elbow", overrides=draw(4)), 4)
    found = flexgen.commission(datasheet(), tmp_path, curves=False)
    file = found.write(tmp_path / "new.toml")
    again = flexgen.read(f"{file}@commissioned")
    gears = [element.dofs[0].gear for element in again.elements]
    for gear, name in zip(gears, ("q1", "q2"), strict=True):
        assert gear is not None and gear.spring is not None
        assert gear.spring.stiffness == pytest.approx(found.values[f"{name}.stiffness"], rel=1e-12)
    assert again.uncertainty is not None and "q1.stiffness" in again.uncertainty.parameters
    assert flexgen.predict(again, robots=16).error_m > 0.0


def test_exchanged_torques_are_named_and_nothing_is_written(tmp_path: Path) -> None:
    """A record with two columns exchanged is refused with its name and the mistake."""
    truth = flexgen.read("elbow", overrides=draw(5))
    record(tmp_path, truth, 5)
    rows = np.loadtxt(tmp_path / "move1.csv", delimiter=",", skiprows=1)
    write_motion(tmp_path / "move1.csv", rows[:, 0], rows[:, 1:3], rows[:, [4, 3]])
    with pytest.raises(flexgen.ArgumentError, match=r"move1\.csv.*torques of m1 and m2 are exch"):
        flexgen.commission(datasheet(), tmp_path)
    assert not list(tmp_path.glob("*.toml"))


def test_refused_model_is_not_written(tmp_path: Path) -> None:
    """A fit with a reason against it raises, and leaves no file."""
    found = replace(small_fit("commissioning"), problems=("planted",))
    with pytest.raises(flexgen.ArgumentError, match=r"planted.*nothing is written"):
        found.write(tmp_path / "new.toml")
    assert not (tmp_path / "new.toml").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[[record]]\nfile = "no.csv"', "expected a file of the folder"),
        ('[[record]]\nfile = "poses.csv"\nkind = "pose"', "expected one of motion, tracked"),
        ('[[record]]\nfil = "poses.csv"', "expected file"),
        ("[[records]]", "expected only"),
        ("a = ", "not TOML"),
    ],
)
def test_wrong_descriptions_of_a_folder_are_refused(tmp_path: Path, text: str, words: str) -> None:
    """The error names file, row and key."""
    (tmp_path / "poses.csv").write_text("q1_rad\n0\n")
    (tmp_path / "records.toml").write_text(text)
    with pytest.raises(flexgen.ArgumentError, match=words):
        flexgen.commission(datasheet(), tmp_path)


def test_few_different_poses_are_refused(tmp_path: Path) -> None:
    """Twenty equal poses are one, which says nothing about the robot."""
    one = "\n".join(["0.1,0.2,1.0,0.1,0.2"] * 20)
    header = "q1_rad,q2_rad,hand_x_m,hand_y_m,hand_z_m"
    (tmp_path / "poses.csv").write_text(f"{header}\n{one}\n")
    with pytest.raises(flexgen.ArgumentError, match=r"poses\.csv: given 1 different poses, exp"):
        flexgen.commission(datasheet(), tmp_path)


def test_columns_of_an_unknown_tracker_are_noted(tmp_path: Path) -> None:
    """Positions that no tracker of the model has are not read, which the result says; forces and
    columns of the tracker itself are no such columns.
    """
    run = flexgen.solve("elbow", program(STOPS[:3]), verify=False).trajectory
    zeros = np.zeros((len(run.time), 6))
    names = [f"{name}_{axis}_{unit}" for name, unit in (("ball", "mm"), ("force", "N"))
             for axis in "xyz"]  # fmt: skip
    header = "time s,q_m[m1] rad,q_m[m2] rad,tau_m[m1] N m,tau_m[m2] N m," + ",".join(names)
    rows = np.column_stack([run.time, run["q_m"], run["tau_m"], zeros])
    np.savetxt(tmp_path / "moves.csv", rows, header=header, **CSV)
    notes = flexgen.commission(datasheet(), tmp_path, curves=False).notes
    assert [note for note in notes if "ball_x" in note and "(hand)" in note]
    assert not [note for note in notes if "force" in note]


def test_positions_of_a_tracker_that_jumped_are_refused(tmp_path: Path) -> None:
    """Half of a tracked motion 8 mm aside: more than the elastic displacement of all springs."""
    robot = datasheet()
    run = flexgen.solve(robot, program(STOPS), verify=False).trajectory
    gears = {f"element.{key}.gear": {"type": "rigid"} for key in SPRINGS}
    rigid = flexgen.read("elbow", overrides={"sensor": [HAND], **gears})
    tip = flexgen.tracker_positions(rigid, run["q_a"])[:, 0]
    for aside, is_refused in ((0.0, False), (0.008, True)):
        seen = tip + aside * (np.arange(len(tip)) > len(tip) // 2)[:, None]
        header = "time s,q_m[m1] rad,q_m[m2] rad,tau_m[m1] N m,tau_m[m2] N m"
        header += ",hand_x_m,hand_y_m,hand_z_m"
        rows = np.column_stack([run.time, run["q_m"], run["tau_m"], seen])
        np.savetxt(tmp_path / "moves.csv", rows, header=header, **CSV)
        found = flexgen.commission(robot, tmp_path)
        assert ("times the elastic displacement" in found.problem) == is_refused


STOPS = np.array([[0.2, -0.4], [0.9, 0.5], [-0.3, -1.0], [0.6, 0.8], [-0.9, 0.3]])


def test_the_file_of_the_true_robot_is_found_again(tmp_path: Path) -> None:
    """Motions without noise: few steps between samples once cost a fifth of a stiffness."""
    robot = datasheet()
    for k in range(2):
        run = flexgen.solve(robot, program(STOPS[k:]), verify=False).trajectory
        write_motion(tmp_path / f"move{k}.csv", run.time, run["q_m"], run["tau_m"])
    found = flexgen.commission(robot, tmp_path, curves=False)
    for key, stiffness in SPRINGS.items():
        name = key.partition(".dof.")[2]
        assert found.values[f"{name}.stiffness"] == pytest.approx(stiffness, rel=0.03)


def make_blocks() -> tuple[np.ndarray, list[Block]]:
    """Unknowns near those of the file, and a block of each kind: poses, tracked motion,
    responses.
    """
    robot = datasheet()
    random = np.random.default_rng(0)
    stops = np.array([[0.2, -0.4], [0.9, 0.5], [-0.3, -1.0]])
    run = flexgen.solve(robot, program(stops), verify=False).trajectory
    extent = forms.measure_extent(robot, [Motion("run", run)])
    robot = forms.with_joint_friction(robot, extent)
    unknowns = make_unknowns(
        robot, DatasheetTolerances(), bodies=True, positions=True, lengths=True, motions=1,
        levels=1, form=FormNumbers(forms.friction_tolerances(robot, extent)),
    )  # fmt: skip
    arm = ElasticArm(unknowns, unknowns.sensors)
    path = np.column_stack([np.sin(3 * run.time), np.cos(4 * run.time), np.sin(5 * run.time)])
    count = unknowns.parts.lengths.stop - unknowns.parts.lengths.start
    motion = MotionBlock(arm, Motion("run", run, path), 0)
    motion.of_lengths = random.normal(size=(len(motion.time), 3, count))
    q = random.uniform(-1, 1, (6, 2))
    seen = flexgen.tracker_positions(robot, q)
    poses = PosesBlock(
        arm, "poses", flexgen.StaticPoses(q, seen), random.normal(size=(6, 3, count))
    )
    plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=8)
    responses = ResponsesBlock(unknowns, "frf", flexgen.frf(flexgen.measure(plan)), 0)
    x = unknowns.start + 0.02 * np.minimum(unknowns.sd, 0.3) * random.normal(size=len(unknowns.sd))
    for name, sd in forms.friction_tolerances(robot, extent).items():
        x[unknowns.names.index(name)] = 0.3 * sd
    return x, [motion, poses, responses]


def test_derivatives_of_all_blocks_are_those_of_differences() -> None:
    """Every unknown, in every kind of record."""
    x, blocks = make_blocks()
    sd = np.minimum(blocks[0].arm.unknowns.sd, 1.0)  # type: ignore[attr-defined]
    for block in blocks:
        block.relinearize(x)
        channels = block.channels(x, True)
        found = [channel.jacobian for channel in channels]
        for k in np.flatnonzero(sd > 1e-6):
            step = np.zeros(len(x))
            step[k] = 1e-4 * sd[k]
            more = block.channels(x + step, False)
            less = block.channels(x - step, False)
            for a, b, channel, J in zip(more, less, channels, found, strict=True):
                slope = (a.residual - b.residual) / (2 * step[k])
                error = np.abs(slope - J[:, k]).max() * sd[k]
                size = np.abs(slope).max() * sd[k]
                assert error < 0.02 * size + 1e-5 * channel.size, (block.name, k)
