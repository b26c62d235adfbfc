"""The fast path against the Lagrangian: every function, on every model and on random robots, to rounding.

Each step of the specialisation is also looked at alone: dust, frames, regrouping, massless bodies. Errors planted in
them are seen. Counts of operations are guarded: they are what the fast path is for.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import casadi as ca
import hypothesis
import numpy as np
import pytest
from random_robots import cases
from referee import ALL_MODELS, State, matrix, model_of, random_axis, random_body, random_placement, random_state
from scipy.spatial.transform import Rotation

from flexgen.errors import ModelError
from flexgen.mechanics import chain as chain_room
from flexgen.mechanics import fast as fast_room
from flexgen.mechanics import recursion, variation
from flexgen.mechanics.chain import Kept, laid, regrouped
from flexgen.mechanics.composite import mass_matrix
from flexgen.mechanics.equations import Equations, derive
from flexgen.mechanics.fast import agrees, cost_of, fast_function, recursive_function
from flexgen.mechanics.plans import plans
from flexgen.mechanics.recursion import inverse_dynamics
from flexgen.mechanics.tape import Tape
from flexgen.mechanics.tool import tool_pose
from flexgen.model.elements import Body, Dof, Element, Gear, Motor, Output, Placement, RobotModel
from flexgen.model.reader import read

# Of the largest entry of what is expected (or of a quantity of the same kind that does not vanish): rounding along
# chains of some tens of frames, in another order. Accelerations are judged by the torques that they take, because a
# mass matrix with a condition number c makes them uncertain by c times the rounding.
EXACT = 1e-12

FUNCTIONS = (
    "mass_matrix",
    "bias",
    "gravity",
    "inverse_dynamics",
    "inverse_dynamics_derivatives",
    "arm_forward_dynamics",
    "arm_slopes",
    "forward_dynamics",
    "slopes",
    "forward_kinematics",
    "jacobian",
)
ROBOTS = tuple(str(path) for path in sorted((Path(__file__).parent / "robots").glob("*.toml")))


def dense_chain(n: int, seed: int, sliding: bool = False) -> RobotModel:
    """A chain of n actuated joints whose axes and placements have no structure at all."""
    rng = np.random.default_rng(seed)
    elements, motors = [], []
    for k in range(n):
        kind = "translation" if sliding and k % 3 == 1 else "rotation"
        dof = Dof(f"q{k}", kind, random_axis(rng), gear=Gear(rigid=True))
        elements.append(Element(f"b{k}", (dof,), random_placement(rng), random_placement(rng), random_body(rng)))
        motors.append(Motor(f"m{k}", 1e-3, (f"q{k}",), (1.0,)))
    return robot(elements, motors, base=random_placement(rng), tool=random_placement(rng), gravity=(1.0, 2.0, -9.0))


def robot(elements, motors, **rest) -> RobotModel:
    """A model of elements and motors; everything else is plain unless it is given."""
    plain = {
        "name": "made",
        "description": "",
        "source": "",
        "gravity": (0.0, 0.0, -9.81),
        "base": Placement(),
        "tool": Placement(),
        "payload": Body(),
        "output": Output("tool_position"),
        "home": tuple([0.0] * len(motors)),
        "moves": (),
    }
    return RobotModel(elements=tuple(elements), motors=tuple(motors), **{**plain, **rest})


def six_axes() -> RobotModel:
    """An arm with the geometry and the masses of a UR5, whose three middle axes are parallel."""
    places = ((0, 0, 0.089159), (0, 0.13585, 0), (0, -0.1197, 0.425), (0, 0, 0.39225), (0, 0.093, 0), (0, 0, 0.09465))
    axes = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0))
    turned = matrix(Rotation.from_euler("y", 90, degrees=True).as_matrix())
    masses = (3.7, 8.393, 2.275, 1.219, 1.219, 0.1879)
    coms = (0.0, 0.28, 0.25, 0.0, 0.0, 0.0)
    inertias = (
        (0.0103, 0.00666),
        (0.2269, 0.0151),
        (0.0494, 0.0041),
        (0.1112, 0.2194),
        (0.1112, 0.2194),
        (0.017, 0.034),
    )
    elements, motors = [], []
    for k, (place, axis, mass, com, (across, along)) in enumerate(
        zip(places, axes, masses, coms, inertias, strict=True)
    ):
        inertia = ((across, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, along))
        origin = Placement(tuple(map(float, place)), turned if k in (1, 3) else Placement().rotation)
        dof = Dof(f"q{k}", "rotation", tuple(map(float, axis)), gear=Gear(rigid=True))
        elements.append(Element(f"b{k}", (dof,), origin, Placement(), Body(mass, (0.0, 0.0, com), inertia)))
        motors.append(Motor(f"m{k}", 1e-4, (f"q{k}",), (100.0,)))
    return robot(elements, motors, tool=Placement((0.0, 0.0823, 0.0)))


MADE = {
    "dense7": lambda: dense_chain(7, 1),
    "dense12": lambda: dense_chain(12, 2),
    "sliding5": lambda: dense_chain(5, 3, sliding=True),
    "sliding8": lambda: dense_chain(8, 3, sliding=True),
    "six_axes": six_axes,
}


@cache
def equations_of(name: str) -> Equations:
    if name in MADE:
        return derive(MADE[name]())
    if not name.endswith(".toml"):
        return derive(model_of(name))
    try:
        return derive(read(name))
    except ModelError as error:
        pytest.skip(f"{Path(name).name} needs a file that is not here: {error}")


@pytest.fixture
def planted(monkeypatch):
    """To plant an error: plans made with it are forgotten afterwards."""
    plans.cache_clear()
    yield monkeypatch
    monkeypatch.undo()
    plans.cache_clear()


def values(function: ca.Function, given: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Results of a function for arguments by their names."""
    return [x.full() for x in function.call([given[function.name_in(i)] for i in range(function.n_in())])]


def arguments(s: State, rng: np.random.Generator) -> dict[str, np.ndarray]:
    given = {name: getattr(s, name) for name in ("q_a", "v_a", "a_a", "q_m", "v_m", "tau_m")}
    a_m = rng.uniform(-1, 1, len(s.q_m)) * (1 + np.abs(s.v_m))
    return {**given, "a_m": a_m, "tau_a": rng.uniform(-50, 50, len(s.q_a))}


def some_states(model: RobotModel, count: int = 3) -> list[State]:
    """Moderate states, and one that is far out and fast."""
    rng = np.random.default_rng(3)
    out = [random_state(model, rng) for _ in range(count)]
    far = random_state(model, rng, speed=30.0)
    return [*out, replace(far, q_a=40 * far.q_a, a_a=1000 * far.a_a)]


def largest(*arrays: np.ndarray) -> float:
    return max(float(np.max(np.abs(x), initial=0.0)) for x in arrays)


def check(equations: Equations, name: str, given: dict[str, np.ndarray], found: list[np.ndarray] | None = None) -> None:
    """AssertionError where a fast function is not the Lagrangian's."""
    expected = values(equations.function(name), given)
    if found is None:
        function = recursive_function(equations, name)
        assert function is not None
        found = values(function, given)
    assert [x.shape for x in found] == [x.shape for x in expected]
    if name in ("arm_forward_dynamics", "forward_dynamics"):
        arm = name == "arm_forward_dynamics"
        states = {**given, **({} if arm else {"a_a": expected[0].ravel(), "a_m": expected[1].ravel()})}
        M = values(equations.function("mass_matrix" if arm else "slopes"), states)[0]
        n_a, i_m = equations.model.n_a, list(equations.model.i_m)
        a, b = (x[0].ravel() if arm else np.concatenate([x[0].ravel(), x[1].ravel()[i_m]]) for x in (found, expected))
        assert largest(M @ (a - b)) <= EXACT * largest(np.abs(M) @ np.abs(b))
        rigid = [j for j in range(equations.model.n_m) if j not in i_m]
        if not arm and rigid:
            geared = equations.model.eta @ found[0].ravel()[list(equations.model.i_g)]
            assert largest(found[1].ravel()[rigid] - geared[rigid]) <= EXACT * largest(geared)
        assert len(a) == (n_a if arm else equations.model.dof)
        return
    scales = [largest(x) for x in expected]
    if name in ("bias", "gravity", "inverse_dynamics_derivatives"):
        # these may vanish: beside them stand the torques of the same state, and the mass matrix
        torque = values(equations.function("inverse_dynamics"), {**given, "v_a": 0 * given["v_a"]})[0]
        inertia = values(equations.function("mass_matrix"), given)[0]
        besides = [torque, inertia, inertia] if len(expected) == 3 else [torque]
        scales = [max(scale, largest(other)) for scale, other in zip(scales, besides, strict=True)]
    elif name in ("forward_kinematics", "jacobian"):
        scales = [max(1.0, scale) for scale in scales]
    elif name == "slopes":
        n = equations.model.dof
        found, expected = [[x[0], x[1][:, :n], x[1][:, n : 2 * n], x[1][:, 2 * n :]] for x in (found, expected)]
        scales = [max(largest(x), largest(expected[0])) for x in expected]
    elif name == "arm_slopes":
        scales[1] = max(scales)
    for x, y, scale in zip(found, expected, scales, strict=True):
        assert largest(x - y) <= EXACT * scale, f"{name}: error {largest(x - y):.3g} of {scale:.3g}"


@pytest.mark.parametrize("name", [*ALL_MODELS, *ROBOTS, *MADE], ids=lambda name: Path(name).stem)
def test_agreement(name):
    equations = equations_of(name)
    rng = np.random.default_rng(5)
    states = [arguments(s, rng) for s in some_states(equations.model)]
    for function in FUNCTIONS:
        fast = recursive_function(equations, function)
        if fast is None:
            continue
        slow = equations.function(function)
        assert fast.name_in() == slow.name_in()
        assert fast.name_out() == slow.name_out()
        assert all(fast.sparsity_in(i).is_dense() for i in range(fast.n_in()))
        assert all(fast.sparsity_out(i) == slow.sparsity_out(i) for i in range(fast.n_out()))
        for given in states:
            check(equations, function, given, values(fast, given))


def test_who_has_no_fast_path():
    """Beams; the whole machine where rotors turn with their carriers; everything else has one."""
    for name in ALL_MODELS:
        model = model_of(name)
        straight = all(element.beam is None for element in model.elements)
        assert (fast_function(equations_of(name), "gravity") is not None) == straight
        if model.motor_coupling == "complete":
            assert fast_function(equations_of(name), "forward_dynamics") is None
    assert fast_function(equations_of("elbow"), "energy") is None


@pytest.mark.parametrize("name", [*ALL_MODELS, *ROBOTS, *MADE], ids=lambda name: Path(name).stem)
def test_every_robot_passes_the_test_before_use(name):
    """What `recursive_function` has is handed out, unless it is known to be wrong."""
    equations = equations_of(name)
    if recursive_function(equations, "gravity") is not None:
        assert agrees(equations)
        assert fast_function(equations, "gravity") is recursive_function(equations, "gravity")


def test_the_test_before_use_is_done_once(monkeypatch):
    asked = []
    monkeypatch.setattr(fast_room, "agrees", lambda equations: bool(asked.append(equations)))
    equations = derive(six_axes())
    assert [fast_function(equations, name) for name in FUNCTIONS] == [None] * len(FUNCTIONS)
    assert asked == [equations]


def nothing_resists() -> dict[str, RobotModel]:
    """Robots whose accelerations are not defined, because a motion has no inertia anywhere."""
    full = Body(3.0, (0.1, 0.0, 0.0), ((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)))
    shapes = {
        "alone": ["rotation", Body()],
        "last": ["rotation", full, Body()],
        "on the axis": ["rotation", full, Body(1.0)],
        "slider": ["translation", Body()],
    }
    out = {}
    for name, (kind, *bodies) in shapes.items():
        elements, motors = [], []
        for k, body in enumerate(bodies):
            dof = Dof(f"q{k}", kind, (0.0, 0.0, 1.0), gear=Gear(rigid=True))
            elements.append(Element(f"b{k}", (dof,), Placement((0.3, 0.0, 0.0)), body=body))
            motors.append(Motor(f"m{k}", 1e-4, (f"q{k}",), (100.0,)))
        out[name] = robot(elements, motors)
    return out


@pytest.mark.parametrize("parameters", [(), ("payload",)])
@pytest.mark.parametrize("name", nothing_resists())
def test_where_nothing_resists_the_lagrangian_tells(name, parameters):
    """No division by the number zero while functions are made; what exists of them is right."""
    equations = derive(nothing_resists()[name], parameters)
    given = arguments(some_states(equations.model, 1)[0], np.random.default_rng(4))
    given["parameters"] = np.array([parameter.value for parameter in equations.parameters])
    for function in FUNCTIONS:
        fast = fast_function(equations, function)
        if function == "arm_forward_dynamics" and not parameters:
            assert fast is None
            assert not np.isfinite(values(equations.function(function), given)[0]).all()
        elif fast is not None and function != "arm_forward_dynamics":
            check(equations, function, given, values(fast, given))


@pytest.mark.parametrize("name", ["manutec_r3", "sliding5"])
def test_parameters(name):
    """Numbers that change at run time are arguments; others than those of the file give what a model with them has."""
    plain, rng = equations_of(name).model, np.random.default_rng(8)
    names = ["payload", *(["stiffness", "friction"] if name.startswith("manutec") else [])]
    equations = Equations(plain, names)
    numbers = np.array([parameter.value for parameter in equations.parameters])
    changed = numbers * rng.uniform(0.5, 2.0, len(numbers)) + rng.uniform(0.0, 0.1, len(numbers))
    for function in FUNCTIONS:
        fast = fast_function(equations, function)
        assert fast is not None  # it passed the test with the values of the file
        assert ("parameters" in fast.name_in()) == ("parameters" in equations.function(function).name_in())
        for s in some_states(plain, 1):
            for value in (numbers, changed):
                given = {**arguments(s, rng), "parameters": value}
                check(equations, function, given, values(fast, given))


def check_all(case) -> None:
    equations, rng = derive(case.model), np.random.default_rng(6)
    states = [arguments(s, rng) for s in case.states]
    for name in FUNCTIONS:
        fast = recursive_function(equations, name)
        for given in states if fast is not None else ():
            check(equations, name, given, values(fast, given))


@hypothesis.given(cases())
@hypothesis.settings(max_examples=3, deadline=None, derandomize=True)
def test_random_robots(case):
    check_all(case)


@pytest.mark.long
@hypothesis.given(cases())
@hypothesis.settings(max_examples=60, deadline=None, derandomize=True)
def test_many_random_robots(case):
    check_all(case)


# --- the steps of the specialisation ---------------------------------------------------------------------------------


def torques(chain, given, columns=True) -> np.ndarray:
    n, tape = len(chain.joints), Tape()
    symbols = [ca.SX.sym(name, n) for name in ("q_a", "v_a", "a_a")]
    tau = inverse_dynamics(tape, chain, *(tape.vector(x) for x in symbols), [columns] * n)
    return values(ca.Function("tau", symbols, [ca.vertcat(*tape.build(tau))], ["q_a", "v_a", "a_a"], ["tau"]), given)[0]


@pytest.mark.parametrize("name", ["manutec_r3", "synthetic_elastic", "dense7", "sliding8", "six_axes"])
def test_regrouping_changes_no_torque(name):
    """Whatever is kept or moved on, torques and mass matrix stay."""
    equations = equations_of(name)
    chain, rng = laid(equations.model), np.random.default_rng(9)
    n = len(chain.joints)
    for s in some_states(equations.model, 2):
        given = arguments(s, rng)
        for columns in (True, False):
            check(equations, "inverse_dynamics", given, [torques(chain, given, columns)])
        for _ in range(4):
            kept = [
                Kept(str(rng.choice(["none", "all", "balance"])), bool(rng.integers(2)), bool(rng.integers(2)))
                for _ in range(n)
            ]
            grouped = regrouped(chain, kept)
            check(equations, "inverse_dynamics", given, [torques(grouped, given)])
            tape, q = Tape(), ca.SX.sym("q", n)
            M = tape.build([x for row in mass_matrix(tape, grouped, tape.vector(q)) for x in row])
            check(
                equations, "mass_matrix", given, [ca.Function("M", [q], [ca.vertcat(*M)])(s.q_a).full().reshape(n, n)]
            )


def test_regrouping_empties_what_it_can():
    for joint in regrouped(laid(dense_chain(6, 4)), [Kept()] * 6).joints:
        body = joint.inertia
        assert (body.mass, body.first[2], body.second[2, 2]) == (0.0, 0.0, 0.0)
    balanced = regrouped(laid(dense_chain(6, 4)), [Kept("balance")] * 6).joints
    for before, joint in pairwise(balanced[1:]):
        assert before.inertia.first[np.argmax(np.abs(joint.place))] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", ["manutec_r3_efjm", "synthetic_mixed", "dense7", "sliding8", "six_axes"])
def test_frames(name):
    """Modified Denavit-Hartenberg: no way across the axes' normals, one angle about x; the tool is where it was."""
    equations = equations_of(name)
    chain = laid(equations.model)
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
    tape, q = Tape(), ca.SX.sym("q", len(chain.joints))
    p, R = tool_pose(tape, chain, tape.vector(q))
    pose = ca.Function("pose", [q], [ca.vertcat(*tape.build([*p, *(x for row in R for x in row)]))])
    for s in some_states(equations.model):
        expected = values(equations.function("forward_kinematics"), {"q_a": s.q_a})
        found = pose(s.q_a).full().ravel()
        assert largest(found - np.concatenate([x.ravel() for x in expected])) <= EXACT * max(1.0, largest(expected[0]))


def two_joints(angle: float) -> RobotModel:
    rng = np.random.default_rng(1)
    motors = [Motor(f"m{k}", 1e-3, (f"q{k}",), (1.0,)) for k in range(2)]
    turned = matrix(Rotation.from_euler("x", angle).as_matrix())
    places = (Placement(), Placement((0.3, 0.0, 0.0), turned))
    elements = [
        Element(
            f"b{k}", (Dof(f"q{k}", "rotation", (0.0, 0.0, 1.0), gear=Gear(rigid=True)),), place, body=random_body(rng)
        )
        for k, place in enumerate(places)
    ]
    return robot(elements, motors)


def test_dust():
    """A right angle typed with 15 digits is one; one typed with 8 digits is an angle of its own."""
    assert laid(two_joints(1.57079632679490)).joints[1].twist == (0.0, 1.0)
    assert laid(two_joints(-np.pi / 2 + 3e-16)).joints[1].twist == (0.0, 1.0)
    assert laid(two_joints(3e-16)).joints[1].twist == (1.0, 0.0)
    c, s = laid(two_joints(1.5707963)).joints[1].twist
    assert c == pytest.approx(2.68e-8, rel=1e-2)
    assert s <= 1.0
    for angle in (1.57079632679490, 1.5707963, 1.5707963267, 1e-13, 1e-9):
        equations = derive(two_joints(angle))
        rng = np.random.default_rng(2)
        for s in some_states(equations.model):
            given = arguments(s, rng)
            for name in ("inverse_dynamics", "mass_matrix"):
                check(equations, name, given)


@pytest.mark.parametrize("distance", [1e-3, 1e-6, 1e-9, 1e-13])
def test_axes_that_nearly_meet(distance):
    """Nothing large is made of a small distance, nor is it lost."""
    elements = [
        replace(element, origin=replace(element.origin, position=(distance, 0.5 * distance, 0.0)))
        for element in dense_chain(4, 5).elements
    ]
    equations, rng = derive(robot(elements, dense_chain(4, 5).motors)), np.random.default_rng(2)
    for s in some_states(equations.model):
        given = arguments(s, rng)
        for name in ("inverse_dynamics", "mass_matrix", "arm_forward_dynamics"):
            check(equations, name, given)


def tilted_axes(tilt: float, seed: int = 6) -> RobotModel:
    """A chain whose axes stand at that angle to their neighbours, about axes across that have no structure."""
    rng = np.random.default_rng(seed)
    kinds = ("rotation", "rotation", "translation", "rotation", "rotation")
    elements, motors, to_world, along = [], [], np.eye(3), np.array(random_axis(rng))
    for k, kind in enumerate(kinds):
        place = random_placement(rng)
        to_world = to_world @ np.array(place.rotation)
        across = np.cross(along, random_axis(rng))
        along = np.cos(tilt) * along + np.sin(tilt) * across / np.linalg.norm(across)
        axis = to_world.T @ along
        dof = Dof(f"q{k}", kind, tuple((axis / np.linalg.norm(axis)).tolist()), gear=Gear(rigid=True))
        elements.append(Element(f"b{k}", (dof,), place, Placement(), random_body(rng)))
        motors.append(Motor(f"m{k}", 1e-3, (f"q{k}",), (1.0,)))
    return robot(elements, motors, tool=random_placement(rng))


def check_tilted(tilt: float) -> None:
    equations, rng = derive(tilted_axes(tilt)), np.random.default_rng(2)
    for s in some_states(equations.model, 1):
        given = arguments(s, rng)
        for name in ("inverse_dynamics", "mass_matrix", "arm_forward_dynamics", "forward_kinematics", "jacobian"):
            check(equations, name, given)


@pytest.mark.parametrize("against", [False, True])
@pytest.mark.parametrize("digits", range(2, 17))
def test_axes_that_are_nearly_parallel(digits, against):
    """Where their normal is far away, or not to be told from rounding, no digit is lost."""
    check_tilted(np.pi - 10.0**-digits if against else 10.0**-digits)


@pytest.mark.parametrize("tilt", [1e-7, 1e-11, np.pi - 1e-9])
def test_frames_far_away_are_seen(planted, tilt):
    """The planted error: frames at the normal of axes however far that is."""
    planted.setattr(chain_room, "NEARLY_PARALLEL", 0.0)
    with pytest.raises(AssertionError):
        check_tilted(tilt)


@pytest.mark.parametrize("tilt", [1e-8, 1e-9, 1e-11, 1e-13, 1e-15])
def test_axes_that_are_nearly_along_a_coordinate_axis(tilt):
    """An entry of an axis may be one to the last bit while the others are not zero."""
    axes = [(0.0, 1.0, 0.0), (-0.5 * tilt, 1.0, tilt), (tilt, 0.3 * tilt, -1.0), (1.0, tilt, 0.0)]
    plain = dense_chain(4, 5)
    elements = [
        replace(element, dofs=(replace(element.dofs[0], axis=axis),), origin=Placement(), link=Placement())
        for element, axis in zip(plain.elements, axes, strict=True)
    ]
    equations, rng = derive(robot(elements, plain.motors)), np.random.default_rng(2)
    for s in some_states(equations.model, 1):
        given = arguments(s, rng)
        for name in ("inverse_dynamics", "mass_matrix", "arm_slopes", "forward_kinematics", "jacobian"):
            check(equations, name, given)


def counts(model: RobotModel) -> list[int]:
    equations = derive(model)
    names = ("inverse_dynamics", "mass_matrix", "arm_forward_dynamics", "gravity")
    return [cost_of(fast_function(equations, name)).operations for name in names]


def test_bodies_that_are_not_there_cost_nothing():
    """Massless bodies, bodies in several parts, rigid elements and the payload: all merged."""
    rng = np.random.default_rng(12)
    places = [random_placement(rng) for _ in range(4)]
    body, last = random_body(rng), random_body(rng)
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


# --- planted errors --------------------------------------------------------------------------------------------------


def wrong_sign_in_the_regrouping(monkeypatch):
    monkeypatch.setattr(chain_room.Inertia, "scaled", lambda self, factor: self)


def regrouped_mass_is_lost(monkeypatch):
    moved = chain_room.Inertia.moved
    monkeypatch.setattr(chain_room.Inertia, "moved", lambda self, pose: replace(moved(self, pose), mass=0.0))


def wrong_sign_of_a_frames_angle(monkeypatch):
    split = chain_room._split
    monkeypatch.setattr(chain_room, "_split", lambda rotation: (-split(rotation)[0], *split(rotation)[1:]))


def missing_coriolis_term(monkeypatch):
    entry = recursion.Motion.U

    def wrong(self, i, k):
        return self.dw[2] if (i, k) == (1, 0) else entry(self, i, k)

    monkeypatch.setattr(recursion.Motion, "U", wrong)


def missing_momentum_of_changes(monkeypatch):
    monkeypatch.setattr(variation, "_carried", lambda beyond, w, s, S: beyond)


@pytest.mark.parametrize(
    ("bug", "name"),
    [
        (wrong_sign_in_the_regrouping, "inverse_dynamics"),
        (regrouped_mass_is_lost, "mass_matrix"),
        (wrong_sign_of_a_frames_angle, "inverse_dynamics"),
        (wrong_sign_of_a_frames_angle, "forward_kinematics"),
        (missing_coriolis_term, "bias"),
        (missing_coriolis_term, "forward_dynamics"),
        (missing_momentum_of_changes, "inverse_dynamics_derivatives"),
    ],
)
def test_planted_errors_are_seen(planted, bug, name):
    # more coordinates than what is differentiated: the recursion for derivatives is asked
    equations = equations_of("dense12")
    given = arguments(some_states(equations.model, 1)[0], np.random.default_rng(4))
    check(equations, name, given)
    plans.cache_clear()
    bug(planted)
    with pytest.raises(AssertionError):
        check(derive(equations.model), name, given)


def frames_far_away(monkeypatch):
    monkeypatch.setattr(chain_room, "NEARLY_PARALLEL", 0.0)


@pytest.mark.parametrize(
    ("bug", "model"),
    [
        (frames_far_away, tilted_axes(1e-11)),
        (wrong_sign_in_the_regrouping, dense_chain(4, 1)),
        (regrouped_mass_is_lost, dense_chain(4, 1)),
        (wrong_sign_of_a_frames_angle, dense_chain(4, 1)),
    ],
)
def test_robots_that_fail_before_use_have_no_fast_path(planted, bug, model):
    equations = derive(model)
    assert all(fast_function(equations, name) is not None for name in FUNCTIONS)
    plans.cache_clear()
    bug(planted)
    equations = derive(model)
    assert recursive_function(equations, "inverse_dynamics") is not None
    assert all(fast_function(equations, name) is None for name in FUNCTIONS)


# --- what it is for --------------------------------------------------------------------------------------------------

# Operations at most; a change that makes them more has to say why.
GUARDED = {
    ("six_axes", "inverse_dynamics"): 257,
    ("six_axes", "mass_matrix"): 104,
    ("six_axes", "arm_forward_dynamics"): 436,
    ("six_axes", "inverse_dynamics_derivatives"): 1203,
    ("six_axes", "forward_kinematics"): 68,
    ("manutec_r3", "inverse_dynamics"): 332,
    ("manutec_r3_efjm", "inverse_dynamics"): 877,
    ("manutec_r3_efjm", "mass_matrix"): 1784,
    ("manutec_r3_efjm", "arm_forward_dynamics"): 2243,
    ("manutec_r3_efjm", "inverse_dynamics_derivatives"): 11736,
}


@pytest.mark.parametrize(("name", "function"), GUARDED)
def test_counts_of_operations(name, function):
    fast = fast_function(equations_of(name), function)
    assert fast is not None
    assert cost_of(fast).operations <= GUARDED[name, function]


@pytest.mark.parametrize("name", ["six_axes", "manutec_r3", "manutec_r3_efjm", "kr300", "dense7"])
def test_fewer_operations_than_the_lagrangian(name):
    equations = equations_of(name)
    for function in ("inverse_dynamics", "mass_matrix", "arm_forward_dynamics"):
        fast = fast_function(equations, function)
        assert fast is not None
        assert 2 * cost_of(fast).operations < cost_of(equations.function(function)).operations
