"""The steps of the fast path's specialization, each alone: frames, regrouping, rounding, massless
bodies.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from recursion_cases import (
    EXACT,
    arguments,
    check,
    check_tilted,
    dense_chain,
    equations_of,
    largest,
    robot,
    some_states,
    values,
)
from referee import matrix, random_axis, random_body, random_placement
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.codegen.recursion import dh_chain
from flexgen.codegen.recursion.composite_body import mass_matrix
from flexgen.codegen.recursion.dh_chain import KeptInertia, make_chain, regroup, snap
from flexgen.codegen.recursion.functions import fast_function, operations_of
from flexgen.codegen.recursion.kinematics import tool_pose
from flexgen.codegen.recursion.newton_euler import inverse_dynamics
from flexgen.codegen.recursion.tape import Tape
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import Dof, Element, Gear, Motor, Placement, RobotModel


def torques(chain, given, columns=True) -> np.ndarray:
    n = len(chain.joints)
    tape = Tape()
    symbols = [ca.SX.sym(name, n) for name in ("q_a", "v_a", "a_a")]
    tau = inverse_dynamics(tape, chain, *(tape.vector(x) for x in symbols), [columns] * n)
    return values(
        ca.Function(
            "tau", symbols, [ca.vertcat(*tape.build(tau))], ["q_a", "v_a", "a_a"], ["tau"]
        ),
        given,
    )[0]


@pytest.mark.parametrize(
    "name",
    [
        "manutec_r3",
        pytest.param("synthetic_elastic", marks=pytest.mark.slow),
        "dense7",
        "sliding8",
        "six_axes",
    ],
)
def test_regrouping_changes_no_torque(name):
    """Whatever is kept or moved on, torques and mass matrix stay."""
    equations = equations_of(name)
    chain = make_chain(equations.model)
    rng = np.random.default_rng(9)
    n = len(chain.joints)
    for s in some_states(equations.model, 2):
        given = arguments(s, rng)
        for columns in (True, False):
            check(equations, "inverse_dynamics", given, [torques(chain, given, columns)])
        for _ in range(4):
            kept = [
                KeptInertia(
                    str(rng.choice(["none", "all", "balance"])),
                    bool(rng.integers(2)),
                    bool(rng.integers(2)),
                )
                for _ in range(n)
            ]
            grouped = regroup(chain, kept)
            check(equations, "inverse_dynamics", given, [torques(grouped, given)])
            tape = Tape()
            q = ca.SX.sym("q", n)
            M = tape.build([x for row in mass_matrix(tape, grouped, tape.vector(q)) for x in row])
            check(
                equations,
                "mass_matrix",
                given,
                [ca.Function("M", [q], [ca.vertcat(*M)])(s.q_a).full().reshape(n, n)],
            )


def test_regrouping_empties_what_it_can():
    for joint in regroup(make_chain(dense_chain(6, 4)), [KeptInertia()] * 6).joints:
        body = joint.inertia
        assert (body.mass, body.first[2], body.second[2, 2]) == (0.0, 0.0, 0.0)
    balanced = regroup(make_chain(dense_chain(6, 4)), [KeptInertia("balance")] * 6).joints
    for before, joint in pairwise(balanced[1:]):
        assert before.inertia.first[np.argmax(np.abs(joint.place))] == pytest.approx(
            0.0, abs=1e-12
        )


@pytest.mark.parametrize(
    "name", ["manutec_r3_efjm", "synthetic_mixed", "dense7", "sliding8", "six_axes"]
)
def test_frames_are_modified_denavit_hartenberg(name):
    """Modified Denavit-Hartenberg: no way across the axes' normals, one angle about x; the tool is
    where it was.
    """
    equations = equations_of(name)
    chain = make_chain(equations.model)
    for before, joint in pairwise(chain.joints):
        c, s = joint.twist
        assert c * c + s * s == pytest.approx(1.0, abs=1e-15)
        if not before.revolute:
            assert not joint.place.any()
        elif s == 0.0:
            assert joint.place[2] == 0.0 and (joint.place[0] == 0.0 or joint.place[1] == 0.0)
        else:
            # on the plane of the normal and of the joint's axis
            assert joint.place @ np.array([0.0, c, s]) == pytest.approx(0.0, abs=1e-14)
        assert abs(joint.turn) <= np.pi / 4 + 1e-12
    tape = Tape()
    q = ca.SX.sym("q", len(chain.joints))
    p, R = tool_pose(tape, chain, tape.vector(q))
    pose = ca.Function(
        "pose", [q], [ca.vertcat(*tape.build([*p, *(x for row in R for x in row)]))]
    )
    for s in some_states(equations.model):
        expected = values(equations.function("forward_kinematics"), {"q_a": s.q_a})
        found = pose(s.q_a).full().ravel()
        assert largest(found - np.concatenate([x.ravel() for x in expected])) <= EXACT * max(
            1.0, largest(expected[0])
        )


def two_joints(angle: float) -> RobotModel:
    rng = np.random.default_rng(1)
    motors = [Motor(f"m{k}", 1e-3, (f"q{k}",), (1.0,)) for k in range(2)]
    turned = matrix(Rotation.from_euler("x", angle).as_matrix())
    places = (Placement(), Placement((0.3, 0.0, 0.0), turned))
    elements = [
        Element(
            f"b{k}",
            (Dof(f"q{k}", "rotation", (0.0, 0.0, 1.0), gear=Gear(rigid=True)),),
            place,
            body=random_body(rng),
        )
        for k, place in enumerate(places)
    ]
    return robot(elements, motors)


def test_entries_below_rounding_are_set_to_zero():
    """A right angle typed with 15 digits is one; one typed with 8 digits is an angle of its
    own.
    """
    assert make_chain(two_joints(1.57079632679490)).joints[1].twist == (0.0, 1.0)
    assert make_chain(two_joints(-np.pi / 2 + 3e-16)).joints[1].twist == (0.0, 1.0)
    assert make_chain(two_joints(3e-16)).joints[1].twist == (1.0, 0.0)
    c, s = make_chain(two_joints(1.5707963)).joints[1].twist
    assert c == pytest.approx(2.68e-8, rel=1e-2)
    assert s <= 1.0
    for angle in (1.57079632679490, 1.5707963, 1.5707963267, 1e-13, 1e-9):
        equations = derive(two_joints(angle))
        rng = np.random.default_rng(2)
        for s in some_states(equations.model):
            given = arguments(s, rng)
            for name in ("inverse_dynamics", "mass_matrix"):
                check(equations, name, given)


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_rounding_of_ones_and_zeros_is_removed(scale):
    entries = scale * np.array([1 - 1e-16, -1 + 2e-16, 3e-17, 0.5, 2.0])
    assert (snap(entries, scale) / scale).tolist() == [1.0, -1.0, 0.0, 0.5, 2.0]


@pytest.mark.parametrize("distance", [1e-3, 1e-6, 1e-9, 1e-13])
def test_axes_that_nearly_meet(distance):
    """Nothing large is made of a small distance, nor is it lost."""
    elements = [
        replace(element, origin=replace(element.origin, position=(distance, 0.5 * distance, 0.0)))
        for element in dense_chain(4, 5).elements
    ]
    equations = derive(robot(elements, dense_chain(4, 5).motors))
    rng = np.random.default_rng(2)
    for s in some_states(equations.model):
        given = arguments(s, rng)
        for name in ("inverse_dynamics", "mass_matrix", "arm_forward_dynamics"):
            check(equations, name, given)


@pytest.mark.parametrize("against", [False, True])
@pytest.mark.parametrize("digits", range(2, 17))
def test_axes_that_are_nearly_parallel(digits, against):
    """Where their normal is far away, or not to be told from rounding, no digit is lost."""
    check_tilted(np.pi - 10.0**-digits if against else 10.0**-digits)


@pytest.mark.parametrize("tilt", [1e-8, 1e-9, 1e-11, 1e-13, 1e-15])
def test_axes_that_are_nearly_along_a_coordinate_axis(tilt):
    """An entry of an axis may be one to the last bit while the others are not zero."""
    axes = [(0.0, 1.0, 0.0), (-0.5 * tilt, 1.0, tilt), (tilt, 0.3 * tilt, -1.0), (1.0, tilt, 0.0)]
    plain = dense_chain(4, 5)
    elements = [
        replace(
            element,
            dofs=(replace(element.dofs[0], axis=axis),),
            origin=Placement(),
            link=Placement(),
        )
        for element, axis in zip(plain.elements, axes, strict=True)
    ]
    equations = derive(robot(elements, plain.motors))
    rng = np.random.default_rng(2)
    for s in some_states(equations.model, 1):
        given = arguments(s, rng)
        for name in (
            "inverse_dynamics",
            "mass_matrix",
            "arm_residual_jacobians",
            "forward_kinematics",
            "jacobian",
        ):
            check(equations, name, given)


def counts(model: RobotModel) -> list[int]:
    equations = derive(model)
    names = ("inverse_dynamics", "mass_matrix", "arm_forward_dynamics", "gravity")
    return [operations_of(fast_function(equations, name)) for name in names]


def test_massless_bodies_add_no_operations():
    """Massless bodies, bodies in several parts, rigid elements and the payload: all merged."""
    rng = np.random.default_rng(12)
    places = [random_placement(rng) for _ in range(4)]
    body = random_body(rng)
    last = random_body(rng)
    motors = [Motor(f"m{k}", 1e-3, (f"q{k}",), (1.0,)) for k in range(3)]
    dofs = [Dof(f"q{k}", "rotation", random_axis(rng), gear=Gear(rigid=True)) for k in range(3)]
    half = replace(body, mass=body.mass / 2, inertia=matrix(np.array(body.inertia) / 2))
    short = [
        Element("a", (dofs[0], dofs[1]), places[0], places[1], body),
        Element("b", (dofs[2],), places[2], places[3], last),
    ]
    long = [
        Element("a", (dofs[0],), places[0]),
        Element("b", (dofs[1],), Placement(), places[1], half),
        Element("c", (), body=half),
        Element("d", (), places[2]),
        Element("e", (dofs[2],), Placement(), places[3]),
    ]
    assert counts(robot(long, motors, payload=last)) == counts(robot(short, motors))


def rounding_errors(name: str) -> int:
    """Moments of the bodies of a chain that are only rounding: almost zero, or almost alike."""
    found = 0
    for joint in make_chain(flexgen.read(name)).joints:
        mass = joint.inertia.mass
        first = np.abs(joint.inertia.first)
        second = np.abs(joint.inertia.second)
        apart = np.abs(np.subtract.outer(np.diag(second), np.diag(second)))
        for entries, size in (
            (first, max(first.max(), np.sqrt(mass * second.max()))),
            (second, second.max()),
            (apart, second.max()),
        ):
            found += int(np.sum((entries > 0) & (entries <= 1e-14 * size)))
    return found


def test_moments_of_mass_that_rounding_left_are_zero_or_alike(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Planted: no tolerance."""
    assert rounding_errors("manutec_r3") == rounding_errors("manutec_r3_24") == 0
    monkeypatch.setattr(dh_chain, "ROUNDING", 0.0)
    assert rounding_errors("manutec_r3") > 0
