"""Numbers of `flexgen.check`: every one against its definition, computed from the model alone;
moves against limits just inside and just outside of what they reach.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.model.elements import RobotModel
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.studies.check.finding import Check, Usual, make_finding
from flexgen.studies.check.numbers import report_overdamped, sizes

FIRST = "element.upper.dof.q1"
Q1 = f"{FIRST}.gear"


def elbow(**changes: Any) -> RobotModel:
    return flexgen.read("elbow", overrides={k.replace("__", "."): v for k, v in changes.items()})


# --- every number against its definition


def of_motors(robot: RobotModel, M: np.ndarray, load: np.ndarray) -> dict[str, float]:
    """Ratios, rotors, speeds, frictions and torques; ``load``: motor torques at rest."""
    out: dict[str, float] = {}
    place = {c.name: i for i, c in enumerate(robot.coordinates)}
    for motor, torque in zip(robot.motors, load, strict=True):
        key = f"motor.{motor.name}"
        for name, ratio in zip(motor.drives, motor.ratio, strict=True):
            joint = robot.coordinates[place[name]]
            kind = {"rad": "rotation", "m": "translation"}[joint.unit]
            arm = f"rotor inertia times ratio^2 to the inertia of the arm at {name}"
            out[f"{key}.ratio: ratio of a {kind}"] = abs(ratio)
            if motor.inertia:
                reflected = motor.inertia * ratio**2
                out[f"{key}.inertia: rotor inertia"] = motor.inertia
                out[f"{key}.ratio: {arm}"] = reflected / M[place[name], place[name]]
            if motor.speed_max:
                at = f"speed of {name} at the largest motor speed"
                out[f"{key}.speed_max: motor speed"] = motor.speed_max
                out[f"{key}.speed_max: {at}"] = motor.speed_max / abs(ratio)
            if joint.dof.speed_max:
                limit = f"element.{joint.element}.dof.{name}.speed_max"
                out[f"{limit}: joint speed"] = joint.dof.speed_max
        law = motor.friction
        if motor.inertia and law.beta and law.coulomb + law.stribeck:
            decay = "beta coulomb / inertia, the decay of its speed near rest"
            rate = law.beta * (law.coulomb + law.stribeck) / motor.inertia
            out[f"{key}.friction.beta: {decay}"] = rate
        if motor.torque_max and abs(torque) > 1e-12:
            ratio_text = "torque of the motor to that of gravity at home"
            out[f"{key}.torque_max: {ratio_text}"] = motor.torque_max / abs(torque)
    return out


def of_springs(robot: RobotModel, M: np.ndarray, rest: Any) -> dict[str, float]:
    """Frequency, deflection and damping ratio; the deflection of a gear is that of its angles."""
    out: dict[str, float] = {}
    twist = np.linalg.solve(robot.eta, rest.q_m) - rest.q_a[list(robot.i_g)]
    for i, joint in enumerate(robot.coordinates):
        dof = joint.dof
        if dof is None:
            continue
        key = f"element.{joint.element}.dof.{joint.name}"
        k = list(robot.i_g).index(i) if i in robot.i_g else None
        holder = dof if k is None else dof.gear
        key += "" if k is None else ".gear"
        if holder is None or holder.spring is None:
            continue
        side = 1.0 if k is None or dof.gear.side == "arm" else robot.eta[k, k] ** 2
        name = "low" if hasattr(holder.spring, "low") else "stiffness"
        K = side * getattr(holder.spring, name)
        D = side * holder.damping
        deflection = abs(rest.q_a[i] if k is None else twist[k])
        ratio = D / (2 * np.sqrt(K * M[i, i]))
        over = ", overdamped" if ratio >= 1 else ""
        spring = f"{key}.spring.{name}"
        out[f"{spring}: lowest mode of the spring"] = np.sqrt(K / M[i, i]) / (2 * np.pi)
        out[f"{key}.damping: damping ratio of the spring{over}"] = ratio
        if deflection > 1e-12:
            out[f"{spring}: deflection by gravity at home"] = deflection
    return out


def of_bodies(robot: RobotModel) -> dict[str, float]:
    """Each body against a ball of steel, the length of the arm and the other bodies."""
    out: dict[str, float] = {}
    beams = [e.beam for e in robot.elements if e.beam is not None]
    places = [p.position for e in robot.elements for p in (e.origin, e.link)]
    length = sum(np.linalg.norm(p) for p in [*places, robot.tool.position])
    length += sum(beam.length for beam in beams)
    masses = {f"element.{e.name}.body": e.body for e in robot.elements} | {
        "payload": robot.payload
    }
    total = sum(body.mass for body in masses.values())
    total += sum(beam.mass_per_length * beam.length for beam in beams)
    for key, body in masses.items():
        trace = np.trace(np.array(body.inertia))
        if body.mass and trace:
            radius = np.cbrt(body.mass / 7850.0 * 3 / (4 * np.pi))
            ball = 3 * 0.4 * body.mass * radius**2
            out[f"{key}.mass: inertia to that of a steel ball of this mass"] = trace / ball
            size = "inertia to mass times length of the arm squared"
            out[f"{key}.inertia: {size}"] = trace / (2 * body.mass * length**2)
        if 0 < body.mass < total * (1 - 1e-9):
            out[f"{key}.mass: mass to that of all other bodies"] = body.mass / (total - body.mass)
    return out


LIMITED = {
    "motor.m1.torque_max": 50.0,
    "motor.m1.speed_max": 300.0,
    f"{FIRST}.speed_max": 2.0,
    "motor.m1.friction": {"coulomb": 0.3, "stribeck": 0.2, "alpha": 9.0, "beta": 40.0},
    "payload": {"mass": 20.0, "com": [0.2, 0.0, 0.0], "inertia": [0.5, 0.5, 0.4]},
    Q1: {
        "type": "elastic",
        "side": "motor",
        "spring": {"type": "linear", "stiffness": 100.0},
        "damping": 0.02,
    },
    "element.fore.dof.q2.gear.damping": 1e5,
}
ROBOTS = {
    "rotations": ("elbow", {}),
    "limits, friction, payload, springs of motors": ("elbow", LIMITED),
    "rigid gears": ("elbow@rigid", {}),
    "passive springs": ("planar5_nmp", {}),
    "beams": ("beam_arm", {}),
    "coupled motors": ("manutec_r3", {}),
    "translations": ("urdf_arm", {f"motor.m{k}.friction": {} for k in (1, 2, 3)}),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_numbers_are_those_of_their_definitions(name: str) -> None:
    model, changes = ROBOTS[name]
    robot = flexgen.read(model, overrides=changes)
    equations = derive(robot)
    rest = hold_joints(equations, np.array(robot.home))
    M = np.array(equations.function("mass_matrix")(rest.q_a))
    load = np.array(equations.function("gravity")(rest.q_a)).ravel()[list(robot.i_g)]
    expected = of_motors(robot, M, np.linalg.solve(robot.eta.T, load))
    expected |= of_springs(robot, M, rest) | of_bodies(robot)
    found = {
        f"{one.key}: {one.quantity}": float(one.value.split()[0])
        for one in flexgen.check(equations, motions=False).findings
        if one.key != "modes"
    }
    assert set(found) == set(expected)
    for key, value in expected.items():
        assert found[key] == pytest.approx(value, rel=1e-3), key  # four digits are shown


def test_a_wrong_definition_is_seen() -> None:
    """Planted error: the frequency of a spring whose side is not taken into account."""
    robot = elbow(**{Q1: LIMITED[Q1]})
    rest = hold_joints(derive(robot), np.array(robot.home))
    right = of_springs(robot, np.eye(2), rest)[f"{Q1}.spring.stiffness: lowest mode of the spring"]
    wrong = np.sqrt(100.0) / (2 * np.pi)
    assert abs(wrong / right - 1) > 0.9


# --- marks and texts


@pytest.mark.parametrize(
    ("value", "mark", "decades"),
    [
        (2.0, "ok", 0.0),
        (20.0, "ok", 0.0),
        (200.0, "unusual", 1.0),
        (1000.0, "unusual", np.log10(50)),
        (1010.0, "error", np.log10(50.5)),
        (0.02, "unusual", 2.0),
        (0.0199, "error", np.log10(2 / 0.0199)),
        (0.0, "error", 99.0),
        (-1.0, "error", 99.0),
        (np.inf, "error", 99.0),
        (np.nan, "error", 99.0),
    ],
)
def test_marks_and_distances_of_numbers(value: float, mark: str, decades: float) -> None:
    """Powers of ten outside of the usual range; errors beyond the widest one."""
    found = make_finding("a.b", "size", value, "m", Usual(2.0, 20.0, 0.02, 1000.0), "look")
    assert (found.mark, found.distance) == (mark, pytest.approx(decades))
    assert found.advice == ("" if mark == "ok" else "look")
    assert found.value == f"{value:.4g} m" and found.usual == "2 to 20 m"


def test_ranges_with_one_end() -> None:
    small = Usual(0.0, 3.0)
    assert (str(small), str(Usual(3.0, np.inf))) == ("at most 3", "at least 3")
    assert (small.mark(0.0), small.distance(0.0), small.distance(np.inf)) == ("ok", 0.0, 99.0)
    assert Usual(2.0, 3.0).mark(1e9) == "unusual"  # no number is too large


TEXTS: dict[str, tuple[str, dict[str, Any], str]] = {
    "ratio of a translation": (
        "urdf_arm",
        {"motor.m3.ratio": 0.0025},
        "motor.m3.ratio: ratio of a translation 0.0025 rad/m, usual 5 to 2e+04 rad/m; the ratio "
        "is q_motor / q_joint in rad/m: 2 pi over the lead of a screw, 1 over the radius of a "
        "pinion, times the gear; not a percentage, and not its inverse",
    ),
    "ratio of a rotation": (
        "elbow",
        {"motor.m1.ratio": 1e3},
        "motor.m1.ratio: ratio of a rotation 1000 rad/rad, usual 0.9 to 500 rad/rad; the ratio is "
        "q_motor / q_joint; not a percentage, and not its inverse",
    ),
    "the ratio is farther from its range": (
        "elbow",
        {"motor.m1.ratio": 1e5},
        "motor.m1.ratio: rotor inertia times ratio^2 to the inertia of the arm at q1 {}, usual "
        "0.02 to 500; ratio of the motor (it is on the motor side), or the masses and inertias of "
        "the arm",
    ),
    "the rotor is farther from its range": (
        "elbow",
        {"motor.m1.inertia": 5.0},
        "motor.m1.inertia: rotor inertia times ratio^2 to the inertia of the arm at q1 {}, usual "
        "0.02 to 500; inertia of the motor (it is on the motor side), or the masses and inertias "
        "of the arm",
    ),
    "speed of a motor": (
        "elbow",
        {"motor.m1.speed_max": 1e5},
        "motor.m1.speed_max: motor speed 1e+05 rad/s, usual 10 to 1100 rad/s; speed_max in rad/s: "
        "1000 rpm are 105 rad/s",
    ),
    "speed of its joint": (
        "elbow",
        {"motor.m1.speed_max": 1e5},
        "motor.m1.speed_max: speed of q1 at the largest motor speed {} rad/s, usual 0.05 to 20 "
        "rad/s; speed_max in rad/s: 1000 rpm are 105 rad/s; or the ratio",
    ),
    "speed of a rotation": (
        "elbow",
        {f"{FIRST}.speed_max": 180.0},
        f"{FIRST}.speed_max: joint speed 180 rad/s, usual 0.05 to 20 rad/s; speed_max in rad/s: "
        "180 degrees/s are 3.14 rad/s",
    ),
    "speed of a translation": (
        "urdf_arm",
        {"element.ram.dof.slide.speed_max": 50.0},
        "element.ram.dof.slide.speed_max: joint speed 50 m/s, usual 0.01 to 10 m/s; speed_max in "
        "m/s",
    ),
    "torque": (
        "elbow",
        {"motor.m1.torque_max": 0.5},
        "motor.m1.torque_max: torque of the motor to that of gravity at home {}, usual at least "
        "1; torque_max is at the motor, not at the joint; or ratio, masses, gravity",
    ),
    "spring": (
        "elbow",
        {f"{Q1}.spring.stiffness": 100.0},
        f"{Q1}.spring.stiffness: lowest mode of the spring {{}} Hz, usual 3 to 300 Hz; stiffness "
        "in N m/rad: 1 N m/deg is 57.3 N m/rad, 1 N m/arcmin is 3438; side of the gear; masses "
        "and inertias",
    ),
    "no damping": (
        "elbow",
        {f"{Q1}.damping": 0.0},
        f"{Q1}.damping: damping ratio of the spring 0: no damping, usual 0.001 to 0.4; damping in "
        "N m s/rad on the side of the spring, or the stiffness",
    ),
    "gravity": (
        "elbow",
        {"gravity": [0.0, -18.1, -24.0]},
        "gravity: gravity 30.06 m/s^2, usual at most 30 m/s^2; gravity in m/s^2: 9.81 on the "
        "Earth",
    ),
    "length by centers of mass": (
        "elbow",
        {"element.upper.body.com": [0.0, 0.0, 60.0]},
        "element: length of the chain 120 m, usual 0.001 to 100 m; positions of origin, link, com "
        "and tool in m: 1 mm is 1e-3",
    ),
}


@pytest.mark.parametrize("name", TEXTS)
def test_texts_of_unusual_numbers(name: str) -> None:
    model, changes, text = TEXTS[name]
    found = flexgen.check(flexgen.read(model, overrides=changes), motions=False)
    before, _, after = text.partition("{}")
    said = [str(one) for one in (*found.errors, *found.warnings)]
    assert any(one.startswith(before) and one.endswith(after) for one in said), said


def test_gravity_and_lengths_are_told_only_where_they_are_unusual() -> None:
    assert list(sizes(elbow())) == []


def test_rotors_without_inertia_have_no_numbers_of_it() -> None:
    robot = flexgen.read("elbow@rigid", overrides={"motor.m1.inertia": 0.0})
    keys = [one.key for one in flexgen.check(robot, motions=False).findings]
    assert "motor.m1.inertia" not in keys and keys.count("motor.m1.ratio") == 1


def test_fast_real_poles_are_listed() -> None:
    """Pairs of poles and slow ones are not; six are shown."""
    swinging = np.array([-60.0 + 2.0j, -60.0 - 2.0j, -70.0 + 1e-3j])
    others = np.array([-5.0, 80.0])
    real = -np.arange(50.0, 57.0) + 1e-6j
    six = "-50, -51, -52, -53, -54, -55"
    for count, text in ((0, "none"), (6, f"{six} 1/s"), (7, f"{six}, ... 1/s")):
        found = report_overdamped(np.concatenate([swinging, others, real[:count]]), 20.0)
        assert (found.mark, found.value) == ("ok", text)


# --- moves

START = np.radians([0.0, 0.0])
END = np.radians([45.0, -30.0])
# the move "joints" of the elbow: largest speeds of its joints
SPEED = np.abs(END - START) * TimeLaw(1.2, 5)(np.linspace(0.0, 1.2, 2001), 1)[:, 1].max()
RATIO = np.array([1872 / 7, 757 / 3])
REACHED = {
    "q1.upper": (END[0], "range of the joints", "q1 reaches 0.7854 rad, limit {} rad"),
    "q2.lower": (
        END[1],
        "range of the joints",
        "q2 reaches -0.5236 rad, limit {} rad",
    ),
    "q1.speed_max": (SPEED[0], "speeds", f"q1 {SPEED[0]:.4g} rad/s, limit {{}}"),
    "m2.speed_max": (
        SPEED[1] * RATIO[1],
        "speeds",
        f"m2 {SPEED[1] * RATIO[1]:.4g} rad/s, limit {{}}",
    ),
}


def limited(robot: RobotModel, key: str, limit: float) -> RobotModel:
    """A robot with a limit that the reader of files would refuse for its moves."""
    name, _, field = key.partition(".")
    motors = [replace(m, **{field: limit}) if m.name == name else m for m in robot.motors]
    elements = [
        replace(
            e, dofs=tuple(replace(d, **{field: limit}) if d.name == name else d for d in e.dofs)
        )
        for e in robot.elements
    ]
    return replace(robot, motors=tuple(motors), elements=tuple(elements))


@pytest.mark.parametrize("beyond", [False, True])
@pytest.mark.parametrize("key", REACHED)
def test_limits_of_moves(key: str, beyond: bool) -> None:
    """A limit 1 % inside of what a joint move reaches is told, one 1 % outside is not."""
    reached, quantity, text = REACHED[key]
    limit = reached * (0.99 if beyond else 1.01)
    robot = limited(elbow(), key, limit)
    every = flexgen.check(robot).findings
    found = [one for one in every if one.key == "move.joints" and one.quantity == quantity]
    expected = text.format(f"{limit:.4g}") if beyond else "within the limits"
    if not beyond and quantity == "speeds":
        assert found == []
        return
    (one,) = found
    assert one.value == expected
    worst = "error" if "range" in quantity else "unusual"
    assert one.mark == (worst if beyond else "ok")


def test_the_fastest_joint_of_each_unit_is_shown() -> None:
    """A joint move of rotations and of a slide: the largest way over its duration."""
    robot = flexgen.read("urdf_arm")
    move = robot.move("joints")
    law = TimeLaw(move.duration, move.smoothness)
    peak = law(np.linspace(0.0, move.duration, 2001), 1)[:, 1].max()
    ways = np.abs(np.subtract(move.end, move.start))
    units = [robot.coordinates[i].unit for i in robot.i_g]
    found = flexgen.check(robot).findings
    shown = [one.value for one in found if one.key == "move.joints" and "speed" in one.quantity]
    expected = [
        (peak * max(w for w, u in zip(ways, units, strict=True) if u == unit), f"{unit}/s")
        for unit in ("rad", "m")
    ]
    for text, (value, unit) in zip(shown, expected, strict=True):
        assert float(text.split()[0]) == pytest.approx(value, rel=1e-3)
        assert text.split()[1] == unit


def test_a_motor_that_holds_home_but_not_a_move_is_told_at_the_worst_of_five_poses() -> None:
    """Torques of gravity along the move "joints", whose first pose needs the least."""
    plain = derive(elbow(move=[]))
    law = TimeLaw(1.2, 5)
    joints = START + (END - START) * law(np.linspace(0.0, 1.2, 2001), 0)
    loads = [
        abs(float(hold_joints(plain, q).tau_m[0])) for q in joints[[0, 500, 1000, 1500, 2000]]
    ]
    home = abs(float(hold_joints(plain, np.array(plain.model.home)).tau_m[0]))
    limit = 1.05 * home
    assert max(loads) > limit
    robot = elbow(motor__m1__torque_max=limit)
    found = [one for one in flexgen.check(robot).findings if one.key == "motor.m1.torque_max"]
    last = found[-1]
    assert [one.mark for one in found] == ["ok", "unusual"]
    assert last.quantity.startswith("torque of the motor to that of gravity in the move")
    if last.quantity.endswith("joints"):
        assert float(last.value) == pytest.approx(limit / max(loads), rel=1e-3)


def test_steep_frictions_are_held_against_the_reversals_of_a_move() -> None:
    """The change of a motor's speed in a sample, by differences of the rigid solution: past the
    base the elbow bends, then stretches.
    """
    beta = 3.0
    move = {
        "name": "past",
        "type": "tool_line",
        "start_deg": [30.0, -20.0],
        "displacement": [0.0, 0.0, -1.3],
        "duration": 2.0,
        "smoothness": 5,
    }
    law = {"coulomb": 0.1, "beta": beta}
    robot = elbow(move=[move], **{f"motor.{name}.friction": law for name in ("m1", "m2")})
    path = flexgen.solve(robot, "past", "rigid", verify=False, progress=False).trajectory
    v = path["v_m"][:, 1]
    turns = np.flatnonzero(v[:-1] * v[1:] < 0)
    rates = np.abs(np.diff(v)[turns]) / np.diff(path.time)[turns]
    every = flexgen.check(robot).findings
    (found,) = [one for one in every if "reversal" in one.quantity]  # the first does not turn back
    assert found.key == "motor.m2.friction.beta" and len(turns) == 1
    assert float(found.value) == pytest.approx(beta * 1e-3 * rates[0], rel=0.03)


def test_a_move_without_path_is_an_error() -> None:
    move = {
        "name": "a",
        "type": "tool_line",
        "start_deg": [30.0, -20.0],
        "displacement": [9.0, 0.0, 0.0],
        "duration": 1.0,
        "smoothness": 5,
    }
    (found,) = flexgen.check(elbow(move=[move])).errors
    assert (found.key, found.quantity) == ("move.a", "path of the arm without deflections")
    assert (found.distance, found.usual) == (99.0, "a path")
    assert found.advice == "start, displacement or end of the move; lengths of the arm in m"


def test_the_worst_finding_comes_first() -> None:
    found = flexgen.check(elbow(motor__m1__inertia=1e3, motor__m2__inertia=1e4), motions=False)
    assert isinstance(found, Check)
    distances = [one.distance for one in found.errors]
    assert distances == sorted(distances, reverse=True)
    assert found.worst is not None and found.worst.key == "motor.m2.inertia"
    assert_allclose(found.to_dict()["errors"], len(found.errors))
