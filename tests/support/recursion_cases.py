"""Robots and states for the tests of the fast path, and the check of one of its functions against
the Lagrangian.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from referee import (
    State,
    matrix,
    model_of,
    random_axis,
    random_body,
    random_placement,
    random_state,
)
from scipy.spatial.transform import Rotation

from flexgen.base.errors import ModelError
from flexgen.codegen.recursion.functions import recursive_function
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.model.elements import Body, Dof, Element, Gear, Motor, Output, Placement, RobotModel
from flexgen.model.reader import read

# Of the largest entry of what is expected (or of a quantity of the same kind that does not
# vanish): rounding along chains of some tens of frames, in another order. Accelerations are judged
# by the torques that they take, because a mass matrix with a condition number c makes them
# uncertain by c times the rounding.
EXACT = 1e-12

FUNCTIONS = (
    "mass_matrix",
    "bias",
    "gravity",
    "inverse_dynamics",
    "inverse_dynamics_derivatives",
    "arm_forward_dynamics",
    "arm_residual_jacobians",
    "forward_dynamics",
    "residual_jacobians",
    "forward_kinematics",
    "jacobian",
)
ROBOTS = tuple(str(path) for path in sorted((Path(__file__).parent / "robots").glob("*.toml")))


def dense_chain(n: int, seed: int, sliding: bool = False) -> RobotModel:
    """A chain of n actuated joints whose axes and placements have no structure at all."""
    rng = np.random.default_rng(seed)
    elements = []
    motors = []
    for k in range(n):
        kind = "translation" if sliding and k % 3 == 1 else "rotation"
        dof = Dof(f"q{k}", kind, random_axis(rng), gear=Gear(rigid=True))
        elements.append(
            Element(
                f"b{k}", (dof,), random_placement(rng), random_placement(rng), random_body(rng)
            )
        )
        motors.append(Motor(f"m{k}", 1e-3, (f"q{k}",), (1.0,)))
    return robot(
        elements,
        motors,
        base=random_placement(rng),
        tool=random_placement(rng),
        gravity=(1.0, 2.0, -9.0),
    )


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
    places = (
        (0, 0, 0.089159),
        (0, 0.13585, 0),
        (0, -0.1197, 0.425),
        (0, 0, 0.39225),
        (0, 0.093, 0),
        (0, 0, 0.09465),
    )
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
    elements = []
    motors = []
    for k, (place, axis, mass, com, (across, along)) in enumerate(
        zip(places, axes, masses, coms, inertias, strict=True)
    ):
        inertia = ((across, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, along))
        origin = Placement(
            tuple(map(float, place)), turned if k in (1, 3) else Placement().rotation
        )
        dof = Dof(f"q{k}", "rotation", tuple(map(float, axis)), gear=Gear(rigid=True))
        elements.append(
            Element(f"b{k}", (dof,), origin, Placement(), Body(mass, (0.0, 0.0, com), inertia))
        )
        motors.append(Motor(f"m{k}", 1e-4, (f"q{k}",), (100.0,)))
    return robot(elements, motors, tool=Placement((0.0, 0.0823, 0.0)))


def fork() -> RobotModel:
    """A first joint that carries two branches, the second one turned and shifted."""
    rng = np.random.default_rng(10)
    elements = list(dense_chain(3, 10).elements)
    elements[2] = replace(elements[2], parent=elements[0].name, origin=random_placement(rng))
    return robot(elements, dense_chain(3, 10).motors)


MADE = {
    "fork": fork,
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


def values(function: ca.Function, given: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Results of a function for arguments by their names."""
    return [
        x.full()
        for x in function.call([given[function.name_in(i)] for i in range(function.n_in())])
    ]


def arguments(s: State, rng: np.random.Generator) -> dict[str, np.ndarray]:
    given = {name: getattr(s, name) for name in ("q_a", "v_a", "a_a", "q_m", "v_m", "tau_m")}
    a_m = rng.uniform(-1, 1, len(s.q_m)) * (1 + np.abs(s.v_m))
    return {**given, "a_m": a_m, "tau_a": rng.uniform(-50, 50, len(s.q_a))}


def some_states(model: RobotModel, count: int = 3) -> list[State]:
    """Moderate states, and one that is far out and fast; where loops close, around home only."""
    rng = np.random.default_rng(3)
    out = [random_state(model, rng) for _ in range(count)]
    far = random_state(model, rng, speed=30.0)
    out.append(far if model.loops else replace(far, q_a=40 * far.q_a, a_a=1000 * far.a_a))
    return out


def largest(*arrays: np.ndarray) -> float:
    return max(float(np.max(np.abs(x), initial=0.0)) for x in arrays)


def check(
    equations: Equations,
    name: str,
    given: dict[str, np.ndarray],
    found: list[np.ndarray] | None = None,
) -> None:
    """AssertionError where a fast function is not the Lagrangian's."""
    expected = values(equations.function(name), given)
    if found is None:
        function = recursive_function(equations, name)
        assert function is not None
        found = values(function, given)
    assert [x.shape for x in found] == [x.shape for x in expected]
    if name in ("arm_forward_dynamics", "forward_dynamics"):
        arm = name == "arm_forward_dynamics"
        states = {
            **given,
            **({} if arm else {"a_a": expected[0].ravel(), "a_m": expected[1].ravel()}),
        }
        M = values(equations.function("mass_matrix" if arm else "residual_jacobians"), states)[0]
        n_a = equations.model.n_a
        i_m = list(equations.model.i_m)
        a, b = (
            x[0].ravel() if arm else np.concatenate([x[0].ravel(), x[1].ravel()[i_m]])
            for x in (found, expected)
        )
        assert largest(M @ (a - b)) <= EXACT * largest(np.abs(M) @ np.abs(b))
        rigid = [j for j in range(equations.model.n_m) if j not in i_m]
        if not arm and rigid:
            geared = equations.model.eta @ found[0].ravel()[list(equations.model.i_g)]
            assert largest(found[1].ravel()[rigid] - geared[rigid]) <= EXACT * largest(geared)
        assert len(a) == (n_a if arm else equations.model.dof)
        return
    scales = [largest(x) for x in expected]
    if name in ("bias", "gravity", "inverse_dynamics_derivatives"):
        # these may vanish: compared with the torques of the same state, and the mass matrix
        torque = values(
            equations.function("inverse_dynamics"), {**given, "v_a": 0 * given["v_a"]}
        )[0]
        inertia = values(equations.function("mass_matrix"), given)[0]
        besides = [torque, inertia, inertia] if len(expected) == 3 else [torque]
        scales = [max(scale, largest(other)) for scale, other in zip(scales, besides, strict=True)]
    elif name in ("forward_kinematics", "jacobian"):
        scales = [max(1.0, scale) for scale in scales]
    elif name == "residual_jacobians":
        n = equations.model.dof
        found, expected = [
            [x[0], x[1][:, :n], x[1][:, n : 2 * n], x[1][:, 2 * n :]] for x in (found, expected)
        ]
        scales = [max(largest(x), largest(expected[0])) for x in expected]
    elif name == "arm_residual_jacobians":
        scales[1] = max(scales)
    for x, y, scale in zip(found, expected, scales, strict=True):
        assert largest(x - y) <= EXACT * scale, (
            f"{name}: error {largest(x - y):.3g} of {scale:.3g}"
        )


def tilted_axes(tilt: float, seed: int = 6) -> RobotModel:
    """A chain whose axes stand at that angle to their neighbours, about axes across that have no
    structure.
    """
    rng = np.random.default_rng(seed)
    kinds = ("rotation", "rotation", "translation", "rotation", "rotation")
    elements = []
    motors = []
    to_world = np.eye(3)
    along = np.array(random_axis(rng))
    for k, kind in enumerate(kinds):
        place = random_placement(rng)
        to_world = to_world @ np.array(place.rotation)
        across = np.cross(along, random_axis(rng))
        along = np.cos(tilt) * along + np.sin(tilt) * across / np.linalg.norm(across)
        axis = to_world.T @ along
        dof = Dof(
            f"q{k}", kind, tuple((axis / np.linalg.norm(axis)).tolist()), gear=Gear(rigid=True)
        )
        elements.append(Element(f"b{k}", (dof,), place, Placement(), random_body(rng)))
        motors.append(Motor(f"m{k}", 1e-3, (f"q{k}",), (1.0,)))
    return robot(elements, motors, tool=random_placement(rng))


def check_tilted(tilt: float) -> None:
    equations = derive(tilted_axes(tilt))
    rng = np.random.default_rng(2)
    for s in some_states(equations.model, 1):
        given = arguments(s, rng)
        for name in (
            "inverse_dynamics",
            "mass_matrix",
            "arm_forward_dynamics",
            "forward_kinematics",
            "jacobian",
        ):
            check(equations, name, given)
