"""A small robot for each row of the table of abilities, and a short call of each function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
from flexgen.analysis.printing.equations import symbolic
from flexgen.identification.rigid.rigid_regressor import Regressor
from flexgen.model.abilities import obstacle

GEAR_1 = "element.upper.dof.q1.gear"
STIFFNESS = 7.5189e6  # N m/rad, of gear 1 of elbow
# An elastic axis behind the second joint of elbow, with the mass of its link.
BENT = """
[[element]]
name = "tip"
origin = { position = [0.6, 0, 0] }
body = { mass = 20.0, com = [0.3, 0, 0], inertia = [0.5, 0.5, 0.5] }
[[element.dof]]
name = "q3"
type = "rotation"
axis = [0, 1, 0]
"""
SPRING = 'spring = { type = "linear", stiffness = 1e6 }\ndamping = 2000.0\n'
BEAM = """
[element.beam]
length = 0.6
mass_per_length = 10.0
bending = [{ direction = "z", stiffness = 1e5, modes = 1, damping_ratio = 0.02 }]
"""
BRANCH = (
    '\n[[element]]\nname = "weight"\nparent = "upper"\nbody = { mass = 10.0, com = [0, 0, 0.2] }\n'
)
# A gas spring from the base to the upper arm of elbow, and its forearm.
GAS = {
    "name": "balancer",
    "type": "gas_spring",
    "from": {"element": "base", "position": [-0.4, 0.0, -0.1]},
    "to": {"element": "upper", "position": [0.0, 0.0, 0.5]},
    "acts": "pull",
    "area": 1e-3,
    "pressure": 6e6,
    "volume": 4e-3,
    "exponent": 1.4,
    "length": 0.3,
    "stroke": 0.9,
}
# A four-bar of the two links of elbow, a rocker on the first and a coupler on the second.
LINKAGE = """
[[element]]
name = "rocker"
parent = "upper"
origin = { position = [0, 0, 0.65] }
body = { mass = 10.0, com = [0.2, 0, 0], inertia = [0.1, 0.2, 0.2] }
[[element.dof]]
name = "p1"
type = "rotation"
axis = [0, 1, 0]
passive = { near_deg = -20.0 }

[[element]]
name = "coupler"
parent = "fore"
origin = { position = [0.4, 0, 0] }
body = { mass = 8.0, com = [0, 0, -0.25], inertia = [0.2, 0.2, 0.1] }
[[element.dof]]
name = "p2"
type = "rotation"
axis = [0, 1, 0]
passive = { near_deg = 20.0 }

[[loop]]
name = "linkage"
from = { element = "rocker", position = [0.45, 0, 0] }
to = { element = "coupler", position = [0, 0, -0.5] }
"""
JOINTS = {
    "name": "joints",
    "type": "joint",
    "start_deg": [0.0, 0.0],
    "end_deg": [45.0, -30.0],
    "duration": 1.2,
    "smoothness": 5,
}
MOTOR = '\n[[motor]]\nname = "m1"'
# Changes of elbow by the name of the row: keys, or a text that is put in before the first motor.
CHANGES: dict[str, dict[str, Any] | str] = {
    "none": {},
    "hysteresis": {f"{GEAR_1}.hysteresis": {"lost_motion": 3e-4, "stiffness": STIFFNESS}},
    "friction with a state": {
        "motor.m1.lugre": {
            "coulomb": 1.0,
            "static": 1.5,
            "stribeck_speed": 1.0,
            "stiffness": 1e3,
            "damping": 1.0,
        }
    },
    "friction by load": {
        "motor.m1.friction": {
            "type": "gear",
            "viscous": 0.01,
            "coulomb": 0.5,
            "beta": 1.0,
            "load_coulomb": 0.1,
            "load_smoothing": 1.0,
        }
    },
    "harmonics": {"motor.m1.cogging": {"harmonics": [6], "sin": [0.03]}},
    "complete coupling": {
        "motor_coupling": "complete",
        "motor.m1.axis": [0, 1, 0],
        "motor.m1.carrier": "base",
        "motor.m2.axis": [0, 1, 0],
        "motor.m2.carrier": "upper",
    },
    "complete coupling in a circle": {
        "motor_coupling": "complete",
        "motor.m1.axis": [0, 1, 0],
        "motor.m1.carrier": "base",
        "motor.m2.axis": [0, 1, 0],
        "motor.m2.carrier": "fore",
    },
    "elastic coordinates": BENT + SPRING,
    "beam": BEAM,
    "mechanism": BENT + "mimic = { q2 = -1.0 }\n",
    "kinematic loops": LINKAGE,
    "branches": BRANCH,
    "counterbalance": {"element.upper.dof.q1.counterbalance": {"sin": [1000.0]}},
    "lines": {"line": [GAS]},
    "lines with mass": {"line": [GAS | {"mass": 8.0}]},
    "drag": {"element.fore.body.rotational_drag": 10.0},
    "kinked spring": {
        f"{GEAR_1}.spring": {"type": "piecewise", "low": 4e6, "high": STIFFNESS, "break_at": 1e-4}
    },
    "backlash": {
        f"{GEAR_1}.spring": {
            "type": "backlash",
            "stiffness": STIFFNESS,
            "gap": 1e-5,
            "smoothing": 1e-5,
        }
    },
    "nonlinear spring": {
        f"{GEAR_1}.spring": {"type": "cubic", "stiffness": STIFFNESS, "cubic": 1e9}
    },
    "rigid gear": {GEAR_1: {"type": "rigid"}},
    "coupled motors": {"motor.m2.drives": ["q1", "q2"], "motor.m2.ratio": [10.0, 252.3]},
    "other outputs than motors": {"output": {"type": "tool_pose"}, "move": [JOINTS]},
    "fewer outputs than motors": {
        "output": {"type": "joint", "joints": ["q1"]},
        "move": [JOINTS],
    },
}
UNCERTAIN = {"uncertainty": {"stiffness": 0.1, "masses": 0.03}}
TRACKER = {"name": "p", "type": "tracker", "unit": "m", "element": "tool"}
SERVO = {
    "type": "cascade",
    "position_gain": [20, 20],
    "speed_gain": [1, 1],
    "integral_gain": [1, 1],
}


@cache
def robot_with(feature: str) -> flexgen.RobotModel:
    """The robot elbow with a feature of the table, by its name; "none": as it is."""
    change = CHANGES[feature]
    more = {"servo": SERVO} | UNCERTAIN
    if isinstance(change, dict):
        return flexgen.read("elbow", overrides=more | change)
    text = Path(flexgen.read("elbow").file).read_text(encoding="utf-8")
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "elbow.toml")
        file.write_text(text.replace(MOTOR, change + MOTOR, 1), encoding="utf-8")
        if feature in ("branches", "kinematic loops"):
            more["tool.element"] = "fore"
        return flexgen.read(file, overrides=more)


def motion_of(robot: flexgen.RobotModel) -> Any:
    """A trajectory of a robot; where outputs and motors differ in number, torques of elbow."""
    if obstacle(robot, "full problem") is None:
        return flexgen.solve(robot).trajectory
    made = flexgen.solve(robot_with("none")).trajectory

    def without_reference(of_channels: dict[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in of_channels.items() if name != "y_ref"}

    parts = ("channels", "ports", "labels")
    return replace(made, **{part: without_reference(getattr(made, part)) for part in parts})


def record_of(robot: flexgen.RobotModel) -> Any:
    """Motor angles and torques of a robot under control."""
    if obstacle(robot, "full problem"):
        robot = robot_with("none")
    return flexgen.control(robot, sample_time=1e-3).trajectory()


def joints_of(robot: flexgen.RobotModel) -> flexgen.JointRecord:
    """A record of its joints, which move once and have no torques."""
    time = 1e-3 * np.arange(800)
    swing = 0.1 * np.sin(np.pi * np.clip((time - 0.2) / 0.3, 0.0, 1.0)) ** 4
    names = tuple(robot.coordinates[i].name for i in robot.i_g)
    angle = np.array(robot.home) + np.outer(swing, np.ones(robot.n_g))
    return flexgen.JointRecord(time, angle, np.zeros_like(angle), names)


@cache
def responses_of_elbow() -> Any:
    robot = robot_with("none")
    return flexgen.frf(flexgen.measure(flexgen.excite(robot, poses=3), robot))


def poses_of_elbow() -> Any:
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2))
    return flexgen.StaticPoses(q, flexgen.tracker_positions(measured(robot_with("none")), q))


def measured(robot: flexgen.RobotModel) -> flexgen.RobotModel:
    """A robot whose tool a tracker measures."""
    return replace(robot, sensors=flexgen.read("elbow", overrides={"sensor": [TRACKER]}).sensors)


def calls(folder: Path) -> dict[str, Callable[[flexgen.RobotModel], Any]]:
    """A short call of each function of the table, which may write to a folder."""
    brief = [flexgen.Setting(sample_s=0.5e-3, delay_s=0.0, exact=True)]
    return {
        "analyze": flexgen.analyze,
        "check": flexgen.check,
        "plan": flexgen.plan,
        "solve": flexgen.solve,
        "simulate": lambda robot: flexgen.simulate(robot, motion_of(robot)),
        "control": flexgen.control,
        "learn": lambda robot: flexgen.learn(robot, iterations=1),
        "predict": lambda robot: flexgen.predict(robot, robots=16),
        "fastest": lambda robot: flexgen.fastest(robot, coefficients=8),
        "plan_problem": lambda robot: flexgen.plan_problem(robot, mesh=4),
        "command_positions": flexgen.command_positions,
        "compare_shapers": lambda robot: flexgen.compare_shapers(robot, detuning=[1.0]),
        "feedback_study": lambda robot: flexgen.feedback_study(
            robot, settings=brief, families=["motor PD", "FL"], tunings=2
        ),
        "excite": lambda robot: flexgen.excite(robot, poses=3),
        "measure": lambda robot: flexgen.measure(
            flexgen.excite(robot_with("none"), poses=3), robot
        ),
        "identify": lambda robot: flexgen.identify(robot, responses_of_elbow()),
        "identify_rigid": lambda robot: Regressor(robot),
        "identify_load": lambda robot: flexgen.identify_load(robot, record_of(robot)),
        "identify_gears": lambda robot: flexgen.identify_gears(
            robot, record_of(robot), hysteresis=False, harmonics=[1]
        ),
        "compare_record": lambda robot: flexgen.compare_record(robot, joints_of(robot)),
        "calibrate": lambda robot: flexgen.calibrate(
            measured(robot), poses_of_elbow(), free=["zeros"], folds=2
        ),
        "ExtendedKalmanFilter": lambda robot: flexgen.ExtendedKalmanFilter(robot),
        "CollisionDetector": lambda robot: flexgen.CollisionDetector(robot, 1e-3),
        "generate": lambda robot: flexgen.generate(robot, folder / "c", build=False, force=True),
        "symbolic": lambda robot: symbolic(robot),
        "export_mujoco": lambda robot: flexgen.export_mujoco(robot, folder / "robot.xml"),
        "export_urdf": lambda robot: flexgen.export_urdf(robot, folder / "robot.urdf"),
    }
