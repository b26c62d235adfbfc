"""Numbers of the model that a generated library takes at run time: as good as baked in, at whatever value."""

from __future__ import annotations

import numpy as np
import pytest
from emitted import needs_compiler, random_states

from flexgen.codegen.build import generate
from flexgen.errors import ArgumentError
from flexgen.mechanics.equations import derive
from flexgen.mechanics.parameters import parametrised
from flexgen.model.reader import read
from flexgen.runtime import load

ROUNDING = 1e-11  # two ways to the same numbers, some hundred operations; accelerations of well conditioned arms

# model, parameters asked for, changes as overrides of the file and as values of parameters
CASES = [
    (
        "planar5_nmp",
        ["payload", "stiffness", "damping"],
        {"payload": {"mass": 7.5, "com": [0.1, -0.05, 0.02]}, "element.link2.dof.q2.gear.spring.stiffness": 3.1e5},
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
]


def key_of(model: str, path: str) -> str:
    """The path of an override with the element's real name."""
    if ".dof." not in path:
        return path
    coordinate = path.split(".dof.")[1].split(".")[0]
    element = next(e.name for e in read(model).elements if any(d.name == coordinate for d in e.dofs))
    return f"element.{element}.dof.{path.split('.dof.')[1]}"


@needs_compiler
@pytest.mark.parametrize(("name", "names", "overrides", "changes"), CASES)
def test_run_time_values_are_as_good_as_baked_ones(name, names, overrides, changes, tmp_path):
    library = load(generate(name, tmp_path / "open", parameters=names).directory)
    baked_model = read(name, overrides={key_of(name, path): value for path, value in overrides.items()})
    baked = load(generate(baked_model, tmp_path / "baked").directory)
    plain = load(generate(name, tmp_path / "plain").directory)
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
            made, expected = f(**inputs, **given), other.functions[f.name](**inputs)
            pairs = zip(made, expected, strict=True) if isinstance(made, tuple) else [(made, expected)]
            for a, b in pairs:
                assert np.abs(a - b).max() <= ROUNDING * max(np.abs(b).max(), 1e-12), (f.name, other.name)
        if any(port.name == "parameters" for port in f.inputs):
            moved, still = f(**inputs, parameters=parameters), f(**inputs)
            pairs = zip(moved, still, strict=True) if isinstance(moved, tuple) else [(moved, still)]
            touched += any(not np.array_equal(a, b) for a, b in pairs)
    assert touched >= 2  # the changes are felt


def test_functions_that_do_not_depend_on_them_do_not_ask_for_them():
    equations = derive("planar5_nmp", ["stiffness"])
    assert "parameters" not in equations.function("mass_matrix").name_in()
    assert equations.function("forward_dynamics").name_in()[-1] == "parameters"


def test_names_units_and_groups():
    made = parametrised(read("abb_arm"), ["friction", "e1.stiffness", "q1.cubic"])
    listed = {parameter.name: (parameter.value, parameter.unit) for parameter in made.parameters}
    model = read("abb_arm")
    assert set(listed) >= {"q1.cubic", "e1.stiffness", "m1.viscous", "m1.coulomb"} and "q1.stiffness" not in listed
    assert listed["m1.viscous"] == (model.motors[0].friction.viscous, "N m s/rad")
    assert listed["q1.cubic"][1] == "N m/rad^3" and made.symbols.numel() == len(listed)
    assert made.given is model or made.given == model  # the model keeps its numbers


@pytest.mark.parametrize("names", [["weight"], ["q9.stiffness"], "payload", [""], ["payload.mass", "m1.friktion"]])
def test_unknown_names_are_told_with_those_that_exist(names):
    with pytest.raises(ArgumentError, match=r"parameters: given .*, expected"):
        derive("planar5_nmp", names)
