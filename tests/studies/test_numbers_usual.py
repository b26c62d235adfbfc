"""Numbers of a robot against usual ones: each of them by hand, with its place, unit and advice."""

from __future__ import annotations

import math
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest

from flexgen.base.errors import SolverError
from flexgen.base.spec.parts import Friction
from flexgen.studies.check import moves, numbers
from flexgen.studies.check.finding import ERROR, OK, UNUSUAL, Finding, Usual, make_finding


def joint(unit: str = "rad", **more: Any) -> Any:
    dof: dict[str, Any] = {"speed_max": None, "spring": None, "damping": 0.0}
    return Made(name="q1", element="arm", unit=unit, dof=Made(**(dof | more)))


def motor(**more: Any) -> Any:
    fields: dict[str, Any] = {
        "name": "m1",
        "drives": ("q1",),
        "ratio": (100.0,),
        "inertia": 1e-4,
        "speed_max": None,
        "friction": Friction(),
    }
    return Made(**(fields | {"torque_max": None} | more))


def shown(findings: Any) -> list[tuple[str, str, str]]:
    """Mark, value and usual range of each."""
    return [(one.mark, one.value, one.usual) for one in findings]


def test_marks_and_distances_of_numbers() -> None:
    """Powers of ten outside of the usual range; errors beyond the largest one."""
    usual = Usual(0.01, 100.0, 1e-4, 1e4)
    for value, mark, distance in (
        (0.01, OK, 0.0),
        (100.0, OK, 0.0),
        (1.0, OK, 0.0),
        (0.001, UNUSUAL, 1.0),
        (1e-4, UNUSUAL, 2.0),
        (1e4, UNUSUAL, 2.0),
        (0.99e-4, ERROR, 2.0044),
        (1.01e4, ERROR, 2.0043),
        (0.0, ERROR, 99.0),
        (-1.0, ERROR, 99.0),
        (math.inf, ERROR, 99.0),
        (math.nan, ERROR, 99.0),
    ):
        assert usual.mark(value) == mark and usual.distance(value) == pytest.approx(
            distance, abs=1e-4
        )
    small = Usual(0.0, 0.5)
    assert (small.mark(0.0), small.distance(0.0), small.distance(math.inf)) == (OK, 0.0, 99.0)
    assert (str(usual), str(small), str(Usual(1.0, math.inf))) == (
        "0.01 to 100",
        "at most 0.5",
        "at least 1",
    )
    found = make_finding("a.b", "size", 12345.6, "m", Usual(1.0, 2.0), "look")
    assert found == Finding(
        UNUSUAL, "a.b", "size", "1.235e+04 m", "1 to 2 m", "look", math.log10(6172.8)
    )
    assert make_finding("a.b", "size", 1.5, "", Usual(1.0, 2.0), "look") == Finding(
        OK, "a.b", "size", "1.5", "1 to 2"
    )
    assert str(found) == "a.b: size 1.235e+04 m, usual 1 to 2 m; look"


def test_ratios_and_rotors_by_hand() -> None:
    """Of rotations and translations; that number is named which is farther from its range."""
    found = list(numbers._ratio_findings(motor(), joint(), -100.0, 2.0))
    assert shown(found) == [
        (OK, "100 rad/rad", "0.9 to 500 rad/rad"),
        (OK, "0.0001 kg m^2", "1e-07 to 0.1 kg m^2"),
        (OK, "0.5", "0.02 to 500"),
    ]
    assert [one.key for one in found] == ["motor.m1.ratio", "motor.m1.inertia", "motor.m1.ratio"]
    assert [one.quantity for one in found] == [
        "ratio of a rotation",
        "rotor inertia",
        "rotor inertia times ratio^2 to the inertia of the arm at q1",
    ]
    slides = list(numbers._ratio_findings(motor(inertia=2.0), joint("m"), 1.0, 4.0))
    assert shown(slides)[0] == (UNUSUAL, "1 rad/m", "5 to 2e+04 rad/m")
    assert slides[0].quantity == "ratio of a translation" and slides[2].key == "motor.m1.inertia"
    assert slides[0].advice == (
        "the ratio is q_motor / q_joint in rad/m: 2 pi over the lead of a screw, 1 over the "
        "radius of a pinion, times the gear; not a percentage, and not its inverse"
    )
    assert len(list(numbers._ratio_findings(motor(inertia=0.0), joint(), 100.0, 2.0))) == 1
    assert len(list(numbers._ratio_findings(motor(), joint(), 100.0, 0.0))) == 2
    far = list(numbers._ratio_findings(motor(), joint(), 1e5, 2.0))
    assert shown(far)[0][0] == shown(far)[2][0] == ERROR
    assert far[0].advice == "the ratio is q_motor / q_joint; not a percentage, and not its inverse"
    assert (
        far[2].advice
        == "ratio of the motor (it is on the motor side), or the masses and inertias of the arm"
    )


def test_speeds_of_motors_and_joints_by_hand() -> None:
    robot: Any = Made(coordinates=[joint(speed_max=30.0)])
    found = list(numbers._speeds(robot, motor(speed_max=5000.0)))
    assert shown(found) == [
        (UNUSUAL, "5000 rad/s", "10 to 1100 rad/s"),
        (UNUSUAL, "50 rad/s", "0.05 to 20 rad/s"),
        (UNUSUAL, "30 rad/s", "0.05 to 20 rad/s"),
    ]
    assert [one.key for one in found] == [
        *2 * ["motor.m1.speed_max"],
        "element.arm.dof.q1.speed_max",
    ]
    assert found[1].advice == "speed_max in rad/s: 1000 rpm are 105 rad/s; or the ratio"
    assert found[2].advice == "speed_max in rad/s: 180 degrees/s are 3.14 rad/s"
    robot.coordinates = [joint("m", speed_max=11.0)]
    (slides,) = numbers._speeds(robot, motor())
    assert (
        shown([slides]) == [(UNUSUAL, "11 m/s", "0.01 to 10 m/s")]
        and slides.advice == "speed_max in m/s"
    )
    robot.coordinates = [joint()]
    assert list(numbers._speeds(robot, motor())) == []


def test_torques_of_motors_by_hand() -> None:
    """Over those of gravity; nothing where there is none, or no limit."""
    robot: Any = Made(motors=[motor(torque_max=3.0)], i_g=(0,), coordinates=[joint()])
    for torque, expected in (
        (-2.0, [(OK, "1.5", "at least 1")]),
        (6.0, [(UNUSUAL, "0.5", "at least 1")]),
        (3e-9, []),
    ):
        rest: Any = Made(tau_m=np.array([torque]))
        assert shown(numbers.drives(robot, np.eye(1), rest))[3:] == expected
    robot.motors = [motor()]
    assert len(list(numbers.drives(robot, np.eye(1), Made(tau_m=np.ones(1))))) == 3


def test_springs_by_hand() -> None:
    """Frequency, deflection and damping ratio on the arm side, of rotations and translations."""
    found = list(numbers._spring(joint(), "key", "stiffness", (400.0, 2.0, 4.0, 0.02)))
    assert shown(found) == [
        (UNUSUAL, "1.592 Hz", "3 to 300 Hz"),
        (UNUSUAL, "0.02 rad", "at most 0.01 rad"),
        (OK, "0.025", "0.001 to 0.4"),
    ]
    assert [one.key for one in found] == [
        "key.spring.stiffness",
        "key.spring.stiffness",
        "key.damping",
    ]
    assert found[0].advice == (
        "stiffness in N m/rad: 1 N m/deg is 57.3 N m/rad, 1 N m/arcmin is 3438; side of the "
        "gear; masses and inertias"
    )
    slides = list(numbers._spring(joint("m"), "key", "low", (4e6, 2 * math.sqrt(4e6), 1.0, 0.0)))
    assert shown(slides) == [(UNUSUAL, "318.3 Hz", "3 to 300 Hz"), (UNUSUAL, "1", "0.001 to 0.4")]
    assert (
        slides[1].quantity == "damping ratio of the spring, overdamped"
        and slides[0].key == "key.spring.low"
    )
    assert (
        slides[0].advice
        == "stiffness in N/m: 1 N/um is 1e6; side of the gear; masses and inertias"
    )
    assert slides[1].advice == "damping in N s/m on the side of the spring, or the stiffness"
    still = list(numbers._spring(joint(), "key", "stiffness", (4e4, 0.0, 1.0, 0.0)))
    assert still[1] == Finding(
        UNUSUAL,
        "key.damping",
        "damping ratio of the spring",
        "0: no damping",
        "0.001 to 0.4",
        "damping in N m s/rad on the side of the spring, or the stiffness",
    )


def test_springs_of_gears_are_on_their_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gear whose spring is at the motor counts with the square of its factor; a passive one with
    its own numbers.
    """
    spring = Made(stiffness=10.0)
    passive = Made(low=5.0, stiffness=7.0)
    gear = Made(spring=spring, damping=0.2)
    robot: Any = Made(
        coordinates=[joint(), joint(spring=passive, damping=0.3), Made(dof=None)], i_g=(0,)
    )
    monkeypatch.setattr(numbers, "gears", lambda robot: [(gear, 3.0)])
    seen: list[Any] = []

    def spring_of(joint: Any, *given: Any) -> list[Any]:
        seen.append(given)
        return []

    monkeypatch.setattr(numbers, "_spring", spring_of)
    rest: Any = Made(tau_g=np.array([-45.0]), q_a=np.array([0.0, -0.25, 0.0]))
    list(numbers.springs(robot, np.diag([2.0, 3.0, 4.0]), rest))
    assert seen == [
        (
            "element.arm.dof.q1.gear",
            "stiffness",
            (90.0, pytest.approx(1.8), 2.0, 0.5),
            numbers.HOME,
        ),
        ("element.arm.dof.q1", "low", (5.0, 0.3, 3.0, 0.25), numbers.HOME),
    ]
    seen.clear()
    list(numbers.springs(robot, np.diag([0.0, -1.0, 4.0]), rest))
    gear.spring = None
    list(numbers.springs(robot, np.diag([2.0, 0.0, 4.0]), rest))
    assert seen == []


def element(mass: float, inertia: float = 0.0, **more: Any) -> Any:
    place = Made(position=(0.3, 0.4, 0.0))
    body = Made(mass=mass, inertia=inertia * np.eye(3), com=(0.0, 0.0, 0.1))
    return Made(
        **({"name": "arm", "body": body, "origin": place, "link": place, "beam": None} | more)
    )


def test_bodies_by_hand() -> None:
    """Against a ball of steel, the length of the arm and the other bodies."""
    ball = 4 / 3 * math.pi * 0.1**3 * 7850.0
    other = Made(mass=0.0, inertia=np.zeros((3, 3)), com=(0.0, 0.0, 0.0))
    robot: Any = Made(
        elements=[element(ball, 0.4004 * ball * 0.01)],
        payload=other,
        tool=Made(position=(0.0, 0.0, 1.0)),
    )
    assert shown(numbers.bodies(robot)) == [
        (OK, "1.001", "at least 1"),
        (OK, "0.001501", "at most 1"),
    ]
    beam = Made(mass_per_length=2.0, length=0.5)
    robot.elements = [element(ball, 0.0), element(1.0, beam=beam)]
    assert shown(numbers.bodies(robot)) == [
        (UNUSUAL, "16.44", "at most 5"),
        (OK, "0.02951", "at most 5"),
    ]
    robot.payload = Made(mass=1.0, inertia=2.0 * np.eye(3), com=(0.0, 0.0, 0.0))
    found = list(numbers.bodies(robot))
    assert [one.key for one in found] == [
        *2 * ["element.arm.body.mass"],
        "payload.mass",
        "payload.inertia",
        "payload.mass",
    ]
    # five places of half a meter and more, and the beam
    assert found[3].value == f"{6.0 / (2 * 3.5**2):.4g}"


def test_lengths_and_gravity_by_hand() -> None:
    robot: Any = Made(
        elements=[element(1.0)], tool=Made(position=(0.0, 0.0, 0.0)), gravity=(0.0, 18.0, -24.0)
    )
    assert numbers._length(robot) == 1.0 and list(numbers.sizes(robot)) == []
    robot.elements[0].body.com = (0.0, 60.0, 0.0)
    robot.gravity = (0.0, 18.1, -24.0)
    assert shown(numbers.sizes(robot)) == [
        (UNUSUAL, "30.06 m/s^2", "at most 30 m/s^2"),
        (UNUSUAL, "120 m", "0.001 to 100 m"),
    ]
    robot.elements = []
    robot.gravity = (0.0, 0.0, -9.81)
    assert numbers._length(robot) == 0.0 and list(numbers.sizes(robot)) == []


def test_overdamped_modes_are_listed() -> None:
    """Real poles, faster than a bound; six of them."""
    none = Finding(OK, "modes", "overdamped modes", "none", "none, or by friction at rest")
    assert (
        numbers.report_overdamped(np.array([-1 + 2j, -1 - 2j, -5.0, 20.0, -10 + 1e-4j]), 6.0)
        == none
    )
    poles = np.array([-7.0, -8.0 + 7e-6j, -1 + 1j])
    found = numbers.report_overdamped(poles, 6.0)
    assert (found.mark, found.value, found.quantity) == (
        OK,
        "-7, -8 1/s",
        "overdamped modes (real poles)",
    )
    many = numbers.report_overdamped(-np.arange(10.0, 17.0), 6.0).value
    assert many == "-10, -11, -12, -13, -14, -15, ... 1/s"
    assert (
        numbers.report_overdamped(-np.arange(10.0, 16.0), 6.0).value
        == "-10, -11, -12, -13, -14, -15 1/s"
    )


def test_ranges_and_speeds_of_moves_by_hand() -> None:
    """Each joint beyond a limit is named; the fastest joint of each unit; motors beyond their
    limits.
    """
    first = Made(name="q1", unit="rad", dof=Made(lower=-1.0, upper=2.0, speed_max=3.0))
    second = Made(name="q2", unit="m", dof=Made(lower=None, upper=0.5, speed_max=None))
    motors = [Made(name="m1", speed_max=300.0), Made(name="m2", speed_max=None)]
    robot: Any = Made(
        i_g=(0, 1),
        coordinates=[first, second],
        motors=motors,
        eta=np.array([[100.0, 0.0], [0.0, -1e3]]),
    )
    inside = np.array([[-1.0 - 1e-10, 0.0], [2.0 + 1e-10, 0.5]])
    assert moves._range(robot, "move.a", inside) == Finding(
        OK, "move.a", "range of the joints", "within the limits", "within the limits"
    )
    found = moves._range(robot, "move.a", np.array([[-1.5, -9.0], [2.5, 0.75]]))
    assert (found.mark, found.distance) == (ERROR, 1.0)
    assert found.value == (
        "q1 reaches -1.5 rad, limit -1 rad; q1 reaches 2.5 rad, limit 2 rad; q2 reaches 0.75 m, "
        "limit 0.5 m"
    )
    rates = np.array([[1.0, 20.0], [-3.0, 5.0], [2.0, 0.0]])
    assert shown(moves._speeds(robot, "move.a", rates)) == [
        (OK, "3 rad/s", "at most 50 rad/s"),
        (UNUSUAL, "20 m/s", "at most 10 m/s"),
    ]
    *_, beyond = moves._speeds(robot, "move.a", 1.5 * rates)
    assert (
        beyond.value == "q1 4.5 rad/s, limit 3; m1 450 rad/s, limit 300" and beyond.distance == 0.5
    )
    assert beyond.advice.startswith("speed_max (rad/s, not rpm); duration of the move in s")
    robot.i_g = (0,)
    robot.eta = np.array([[100.0]])
    robot.motors = motors[:1]
    assert [one.value for one in moves._speeds(robot, "move.a", rates[:, :1])] == ["3 rad/s"]


def test_moves_that_have_no_path_are_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs too; where more joints than outputs move, ranges are not checked."""
    a = Made(name="a")
    b = Made(name="b")
    c = Made(name="c")
    equations: Any = Made(model=Made(moves=(a, b), programs=(c,), output=Made(size=2), n_m=2))

    def joints(equations: Any, move: Any) -> Any:
        if move is a:
            raise SolverError("out of reach")
        return None if move is b else ("angles", "speeds", np.array([0.25, 0.5]))

    monkeypatch.setattr(moves, "_joints", joints)
    monkeypatch.setattr(moves, "_range", lambda robot, key, q_g: (key, q_g))
    monkeypatch.setattr(moves, "_speeds", lambda robot, key, v_g: [(key, v_g)])
    still = Made(findings=lambda key, q_g: [(key, "at poses")])
    monkeypatch.setattr(moves, "_Still", lambda equations, known: still)
    monkeypatch.setattr(moves, "_reversals", lambda robot, changes: [changes.tolist()])
    advice = "start, displacement or end of the move; lengths of the arm in m"
    assert list(moves.moves(equations)) == [
        Finding(
            ERROR,
            "move.a",
            "path of the arm without deflections",
            "out of reach",
            "a path",
            advice,
            99.0,
        ),
        Finding(OK, "move.b", "range of the joints", "not checked: more joints than outputs", "-"),
        ("program.c", "angles"),
        ("program.c", "speeds"),
        ("program.c", "at poses"),
        [0.25, 0.5],
    ]
