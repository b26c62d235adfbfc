"""Numbers of the model that a generated library takes at run time: as good as baked in, at
whatever value.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from emitted import random_states
from toolchain import needs_compiler

from flexgen.base.errors import ArgumentError, BuildError
from flexgen.codegen.build.generate import generate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.parameters import put_symbols, select
from flexgen.model.elements import Dof, Element, Gear, LinearSpring
from flexgen.model.reader import read
from flexgen.runtime import load

# two ways to the same numbers, some hundred operations; accelerations of well conditioned arms
ROUNDING = 1e-11

# model, parameters asked for, changes as overrides of the file and as values of parameters
CASES = [
    (
        "planar5_nmp",
        ["payload", "stiffness", "damping"],
        {
            "payload": {"mass": 7.5, "com": [0.1, -0.05, 0.02]},
            "element.link2.dof.q2.gear.spring.stiffness": 3.1e5,
        },
        {
            "payload.mass": 7.5,
            "payload.com_x": 0.1,
            "payload.com_y": -0.05,
            "payload.com_z": 0.02,
            "q2.stiffness": 3.1e5,
        },
    ),
    (
        "abb_arm",
        ["friction", "stiffness"],
        {"motor.m1.friction.coulomb": 2.5, "motor.m1.friction.viscous": 0.02},
        {"m1.coulomb": 2.5, "m1.viscous": 0.02},
    ),
    (  # terms of a friction law that the file does not have
        "planar5_nmp",
        ["m1.viscous", "m1.coulomb", "m1.beta"],
        {"motor.m1.friction": {"viscous": 0.01, "coulomb": 0.7, "beta": 3.0}},
        {"m1.viscous": 0.01, "m1.coulomb": 0.7, "m1.beta": 3.0},
    ),
]


def key_of(model: str, path: str) -> str:
    """The path of an override with the element's real name."""
    if ".dof." not in path:
        return path
    coordinate = path.split(".dof.")[1].split(".")[0]
    element = next(
        e.name for e in read(model).elements if any(d.name == coordinate for d in e.dofs)
    )
    return f"element.{element}.dof.{path.split('.dof.')[1]}"


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(("name", "names", "overrides", "changes"), CASES)
def test_run_time_values_are_as_good_as_baked_ones(name, names, overrides, changes, tmp_path):
    check_run_time_values(name, names, overrides, changes, tmp_path)


@needs_compiler
@pytest.mark.slow
def test_run_time_values_of_some_functions_are_as_good_as_baked_ones(tmp_path):
    check_run_time_values(
        *CASES[0], tmp_path, functions=["gravity", "forward_dynamics", "mass_matrix"]
    )


@needs_compiler
@pytest.mark.slow
def test_frictions_that_the_file_does_not_have_are_parameters(tmp_path):
    check_run_time_values(*CASES[2], tmp_path, functions=["forward_dynamics", "motor_friction"])


@pytest.mark.parametrize("name", ["m1.inertia", "arm1.mass", "arm2.inertia_zz"])
def test_rotors_and_bodies_are_constants_of_a_library(name, tmp_path):
    with pytest.raises(BuildError, match="expected payload, stiffness, damping or friction"):
        generate("planar5_nmp", tmp_path / "library", parameters=[name])


def check_run_time_values(name, names, overrides, changes, tmp_path, functions=None):
    library = load(
        generate(name, tmp_path / "open", parameters=names, functions=functions).directory
    )
    baked_model = read(
        name, overrides={key_of(name, path): value for path, value in overrides.items()}
    )
    baked = load(generate(baked_model, tmp_path / "baked", functions=functions).directory)
    plain = load(generate(name, tmp_path / "plain", functions=functions).directory)
    parameters = library.parameters.copy()
    for parameter, value in changes.items():
        parameters[library.parameter_names.index(parameter)] = value
    states = random_states(read(name), 20)
    touched = 0
    for f in library.functions.values():
        inputs = {port.name: states[port.name] for port in f.inputs if port.name != "parameters"}
        for other, given in ((plain, {}), (baked, {"parameters": parameters})):
            if not any(port.name == "parameters" for port in f.inputs):
                given = {}
                if other is baked:
                    continue
            made = f(**inputs, **given)
            expected = other.functions[f.name](**inputs)
            pairs = (
                zip(made, expected, strict=True) if isinstance(made, tuple) else [(made, expected)]
            )
            for a, b in pairs:
                assert np.abs(a - b).max() <= ROUNDING * max(np.abs(b).max(), 1e-12), (
                    f.name,
                    other.name,
                )
        if any(port.name == "parameters" for port in f.inputs):
            moved = f(**inputs, parameters=parameters)
            still = f(**inputs)
            pairs = (
                zip(moved, still, strict=True) if isinstance(moved, tuple) else [(moved, still)]
            )
            touched += any(not np.array_equal(a, b) for a, b in pairs)
    assert touched >= 2  # the changes are felt


def test_functions_that_do_not_depend_on_them_do_not_ask_for_them():
    equations = derive("planar5_nmp", ["stiffness"])
    assert "parameters" not in equations.function("mass_matrix").name_in()
    assert equations.function("forward_dynamics").name_in()[-1] == "parameters"


def test_names_units_and_groups():
    made = put_symbols(read("abb_arm"), ["friction", "e1.stiffness", "q1.cubic"])
    listed = {parameter.name: (parameter.value, parameter.unit) for parameter in made.parameters}
    model = read("abb_arm")
    assert (
        set(listed) >= {"q1.cubic", "e1.stiffness", "m1.viscous", "m1.coulomb"}
        and "q1.stiffness" not in listed
    )
    assert listed["m1.viscous"] == (model.motors[0].friction.viscous, "N m s/rad")
    assert listed["q1.cubic"][1] == "N m/rad^3" and made.symbols.numel() == len(listed)
    assert made.given is model or made.given == model  # the model keeps its numbers


def test_every_parameter_has_a_description():
    said = {
        p.name: p.doc
        for p in put_symbols(read("manutec_r3"), ["stiffness", "damping", "friction"]).parameters
    }
    said |= {
        p.name: p.doc for p in put_symbols(read("elbow"), ["stiffness", "payload"]).parameters
    }
    said |= {p.name: p.doc for p in put_symbols(read("abb_arm"), ["stiffness"]).parameters}
    motor = read("manutec_r3").motors[0].name
    joint = read("manutec_r3").coordinates[5].name
    assert said["q1.damping"] == "damping of q1, motor side"
    assert said[f"{motor}.coulomb"] == f"friction of motor {motor}, motor side"
    assert said[f"{joint}.coulomb"] == f"friction of {joint}, arm side"
    assert (
        said["e1.stiffness"] == "spring of e1" and said["q2.stiffness"] == "spring of q2, arm side"
    )
    assert (
        said["payload.mass"] == "payload: mass"
        and "frame that the tool is attached to" in said["payload.com_x"]
    )


def test_numbers_stated_on_the_motor_side_have_units_of_the_motor():
    """A rotor turns, whatever its joint does."""
    model = read("elbow")

    def units(side: str, kind: str) -> dict[str, str]:
        dof = model.elements[0].dofs[0]
        gear = Gear(False, side, LinearSpring(2.0), 0.1)
        first: Element = replace(model.elements[0], dofs=(replace(dof, type=kind, gear=gear),))
        made = put_symbols(
            replace(model, elements=(first, *model.elements[1:])), ["stiffness", "damping"]
        )
        return {p.name: p.unit for p in made.parameters if p.name.startswith(f"{dof.name}.")}

    name = model.elements[0].dofs[0].name
    turning = {f"{name}.stiffness": "N m/rad", f"{name}.damping": "N m s/rad"}
    assert (
        units("motor", "translation")
        == units("motor", "rotation")
        == units("arm", "rotation")
        == turning
    )
    assert units("arm", "translation") == {f"{name}.stiffness": "N/m", f"{name}.damping": "N s/m"}


@pytest.mark.parametrize("model", ["abb_arm", "planar5_nmp", "manutec_r3"])
@pytest.mark.parametrize(
    "name", ["gear_law", "motor_friction", "gear_torque", "elastic_torque", "arm_forces"]
)
def test_force_laws_follow_the_parameters(model, name):
    """Every law takes the numbers given, as a model with these numbers does."""
    equations = derive(model, ["stiffness", "damping", "friction"])
    rng = np.random.default_rng(3)
    numbers = np.array([p.value for p in equations.parameters]) * rng.uniform(
        0.5, 2.0, len(equations.parameters)
    )
    function = equations.function(name)
    changed = changed_model(
        equations.model, dict(zip([p.name for p in equations.parameters], numbers, strict=True))
    )
    plain = derive(changed).function(name)
    inputs = [0.1 * rng.uniform(-1, 1, plain.size_in(k)) for k in range(plain.n_in())]
    given = [*inputs, numbers] if "parameters" in function.name_in() else inputs
    for found, expected in zip(function.call(given), plain.call(inputs), strict=True):
        size = np.abs(expected.full()).max(initial=1e-12)
        assert np.abs(found.full() - expected.full()).max(initial=0.0) <= ROUNDING * size


def changed_model(model, numbers):
    """The model with other numbers, by the names of parameters."""

    def law(owner: str, x):
        return x and replace(x, **{k: numbers.get(f"{owner}.{k}", v) for k, v in vars(x).items()})

    def joint(dof: Dof) -> Dof:
        gear = dof.gear
        damping = numbers.get(f"{dof.name}.damping", dof.damping)
        if gear is not None:
            own = numbers.get(f"{dof.name}.damping", gear.damping)
            gear = replace(gear, spring=law(dof.name, gear.spring), damping=own)
        friction = law(dof.name, dof.friction)
        spring = law(dof.name, dof.spring)
        return replace(dof, gear=gear, spring=spring, friction=friction, damping=damping)

    elements = tuple(replace(e, dofs=tuple(joint(dof) for dof in e.dofs)) for e in model.elements)
    motors = tuple(replace(m, friction=law(m.name, m.friction)) for m in model.motors)
    return replace(model, elements=elements, motors=motors)


@pytest.mark.parametrize(
    "names", [["weight"], ["q9.stiffness"], "payload", [""], ["payload.mass", "m1.friktion"]]
)
def test_an_unknown_name_is_refused_with_the_existing_ones(names):
    with pytest.raises(ArgumentError, match=r"parameters: given .*, expected"):
        derive("planar5_nmp", names)


def test_the_existing_names_are_those_of_groups_in_order():
    """Numbers in no group are too many to list, but may be named; those of bodies are inertias,
    that of the payload is not.
    """
    robot = read("elbow")
    with pytest.raises(ArgumentError) as told:
        select(robot, ["stifness"])
    start, _, names = str(told.value).partition(", expected some of ")
    listed = names.split(", ")
    assert start == "parameters: given 'stifness'" and listed == sorted(listed)
    assert {"stiffness", "payload", "payload.mass"} <= {*listed}
    assert "upper.mass" not in listed
    found = {p.name: (p.unit, p.inertia) for p in select(robot, ["upper.mass", "payload.mass"])}
    assert found == {"upper.mass": ("kg", True), "payload.mass": ("kg", False)}
