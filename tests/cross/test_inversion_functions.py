"""Functions for inverse dynamics along an output: recursion, Lagrangian and differences; which
models have them.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from shipped_models import shipped

from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.emit import emit
from flexgen.codegen.emission.spec import choose_functions, library_spec
from flexgen.codegen.recursion import inversion_functions as by_recursion
from flexgen.codegen.recursion.functions import fast_function, recursive_function
from flexgen.dynamics.mechanics import inversion_functions
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.signatures import FUNCTIONS, INVERSION, offered_functions
from flexgen.model.elements import RobotModel
from flexgen.model.reader import model_names, read

MADE_OF_TAPES = ("output_constraint", "inversion_jacobians", "inversion_rows")
ROBOTS = ("one", "spatial", "ur5_elastic")
# Of the largest entry of a result: rounding along chains of tens of frames, in another order.
EXACT = 1e-12
# Central differences with a step of 1e-6: 1e-12 of curvature and 1e-16 / 1e-6 of rounding, both of
# numbers that may be a hundred times larger than the result.
DIFFERENCES = 1e-6
STEP = 1e-6


@cache
def equations_of(name: str) -> Equations:
    return derive(
        read(
            Path(__file__).parents[1] / "support" / "robots" / f"{name}.toml"
            if name in ROBOTS
            else name
        )
    )


INVERTING = [
    *(name for name in model_names() if shipped(name).inversion_obstacle() is None),
    "ur5_elastic",
]


def state(model: RobotModel, seed: int = 1) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    out = {name: rng.uniform(-1.0, 1.0, model.n_a) for name in ("q_a", "v_a", "a_a")}
    if model.loops:  # which close around home only
        out["q_a"] *= 0.05
        out["q_a"][list(model.i_g)] += model.home
    return {
        **out,
        "target": rng.uniform(-1.0, 1.0, model.output.target_size),
        "deflection": rng.normal(size=model.n_g),
    }


def values(function, given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    found = function.call([given[name] for name in function.name_in()])
    return {name: x.full() for name, x in zip(function.name_out(), found, strict=True)}


def disagreement(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> float:
    """Largest difference, of the largest entry of each result; the results of both have the same
    names and shapes.
    """
    assert {name: x.shape for name, x in a.items()} == {name: x.shape for name, x in b.items()}
    worst = 0.0
    for name, x in a.items():
        size = np.abs(b[name]).max(initial=0.0)
        worst = max(worst, np.abs(x - b[name]).max(initial=0.0) / (size if size > 0.0 else 1.0))
    return worst


# --- three ways ----------------------------------------------------------------------------------
@pytest.mark.parametrize("name", INVERTING)
def test_the_recursion_is_the_lagrangian(name):
    equations = equations_of(name)
    model = equations.model
    beams = any(element.beam is not None for element in model.elements)
    # the recursion knows rods with mass along closed loops, as particles of these
    beams = beams or (not model.loops and any(line.mass for line in model.lines))
    for function in MADE_OF_TAPES:
        fast = recursive_function(equations, function)
        slow = equations.function(function)
        assert (fast is None) == beams
        if fast is None:
            continue
        assert fast_function(equations, function) is fast
        assert fast.name_in() == slow.name_in() and fast.name_out() == slow.name_out()
        assert all(fast.sparsity_out(i) == slow.sparsity_out(i) for i in range(fast.n_out()))
        for seed in (1, 2, 3):
            given = state(equations.model, seed)
            assert disagreement(values(fast, given), values(slow, given)) <= EXACT, function


@pytest.mark.parametrize("name", INVERTING)
def test_the_lagrangian_agrees_with_central_differences(name):
    equations = equations_of(name)
    given = state(equations.model)
    n_a = equations.model.n_a
    e = list(equations.model.i_e)
    constraint, rows = (equations.function(f) for f in ("output_constraint", "inversion_rows"))

    def rates(x: dict[str, np.ndarray]) -> np.ndarray:
        """``W v``, ``W a + W' v`` and the rows without motor, one below the other."""
        at = values(constraint, x)
        first = at["W"] @ x["v_a"]
        second = at["W"] @ x["a_a"] + at["Wdot_v"][:, 0]
        return np.concatenate([first, second, values(rows, x)["row"][:, 0] if e else []])

    def slope(of: str) -> np.ndarray:
        columns = []
        for i in range(n_a):
            step = STEP * np.eye(n_a)[i]
            ends = [rates({**given, of: given[of] + sign * step}) for sign in (1.0, -1.0)]
            columns.append((ends[0] - ends[1]) / (2 * STEP))
        return np.array(columns).T

    n_y = equations.model.output.size
    found = values(equations.function("inversion_jacobians"), given)
    by_q, by_v, by_a = (slope(of) for of in ("q_a", "v_a", "a_a"))
    expected = {"dy1_dq": by_q[:n_y], "dy2_dq": by_q[n_y : 2 * n_y], "dy2_dv": by_v[n_y : 2 * n_y]}
    assert np.abs(by_v[:n_y] - values(constraint, given)["W"]).max() < DIFFERENCES
    if e:
        expected |= {"row_q": by_q[2 * n_y :], "row_v": by_v[2 * n_y :], "row_a": by_a[2 * n_y :]}
        assert np.array_equal(found["row"], values(rows, given)["row"])
    for port, x in expected.items():
        size = max(1.0, np.abs(found[port]).max(), np.abs(rates(given)).max())
        assert np.abs(found[port] - x).max() < DIFFERENCES * size, port


@pytest.mark.parametrize("name", ["planar5_nmp", "manutec_r3_efjm", "four_mass", "beam_arm"])
def test_the_constraint_is_the_output(name):
    """At its own output the error is zero, and W is how it grows; ``W' v`` is how ``W v`` changes
    along v.
    """
    equations = equations_of(name)
    model = equations.model
    given = state(equations.model)
    constraint = equations.function("output_constraint")
    if model.output.type == "tool_pose":
        at = values(equations.function("forward_kinematics"), given)
        target = np.concatenate([at["p"][:, 0], at["R"].T.ravel()])
    else:
        target = values(equations.function("output"), given)["y"][:, 0]
    given["target"] = target
    here = values(constraint, given)
    assert np.abs(here["y_err"]).max() < EXACT
    for i in range(model.n_a):
        step = STEP * np.eye(model.n_a)[i]
        ends = [
            values(constraint, {**given, "q_a": given["q_a"] + sign * step})["y_err"]
            for sign in (1.0, -1.0)
        ]
        assert np.abs((ends[0] - ends[1])[:, 0] / (2 * STEP) - here["W"][:, i]).max() < DIFFERENCES
    ends = [
        values(constraint, {**given, "q_a": given["q_a"] + sign * STEP * given["v_a"]})
        for sign in (1.0, -1.0)
    ]
    change = (ends[0]["W"] - ends[1]["W"]) @ given["v_a"] / (2 * STEP)
    assert np.abs(change - here["Wdot_v"][:, 0]).max() < DIFFERENCES


@pytest.mark.parametrize("name", ["planar5_soft", "manutec_r3_efjm", "beam_arm", "elbow"])
def test_the_rows_are_the_equations_of_motion(name):
    """With the torques of the gears that they ask for, nothing is left of the equations of the
    arm.
    """
    equations = equations_of(name)
    model = equations.model
    given = state(equations.model)
    rng = np.random.default_rng(2)
    given |= {port: rng.normal(size=model.n_m) for port in ("q_m", "v_m", "a_m", "tau_m")}
    rows = values(equations.function("inversion_rows"), given)
    left = values(equations.function("residual"), given)["r_a"][:, 0]
    elastic = np.array([j in model.i_m for j in range(model.n_m)])
    if elastic.all():
        gears = values(equations.function("gear_torque"), given)["tau_g"][:, 0]
        assert np.allclose(
            left[list(model.i_g)],
            rows["tau_g"][:, 0] - gears,
            rtol=0,
            atol=EXACT * np.abs(left).max(),
        )
    if model.n_e:
        assert np.allclose(
            left[list(model.i_e)], rows["row"][:, 0], rtol=0, atol=EXACT * np.abs(left).max()
        )


def test_the_gear_law_is_that_of_the_springs():
    equations = equations_of("planar5_nmp")
    rng = np.random.default_rng(3)
    n_g = equations.model.n_g
    given = {"deflection": 1e-3 * rng.normal(size=n_g)}
    law = values(equations.function("gear_law"), given)
    state_of = {
        "q_a": np.zeros(equations.model.n_a),
        "v_a": np.zeros(equations.model.n_a),
        "v_m": np.zeros(n_g),
    }
    torque = values(
        equations.function("gear_torque"),
        state_of | {"q_m": equations.model.eta @ given["deflection"]},
    )["tau_g"]
    assert np.allclose(law["tau_p"], torque, rtol=1e-13, atol=0)
    step = 1e-7
    sides = [
        values(equations.function("gear_law"), {"deflection": given["deflection"] + h})["tau_p"]
        for h in (step, -step)
    ]
    assert np.allclose(law["dtau_p"], (sides[0] - sides[1]) / (2 * step), rtol=1e-6, atol=0)
    rigid = values(
        equations_of("ur5_elastic").function("gear_law"), state(equations_of("ur5_elastic").model)
    )
    assert not rigid["tau_p"].any() and not rigid["dtau_p"].any()


# --- planted errors ------------------------------------------------------------------------------
def test_a_planted_error_in_the_turning_is_seen(monkeypatch):
    """Angular velocities are not derivatives of coordinates: without that term the test must
    fail.
    """
    equations = derive(read("manutec_r3"))
    monkeypatch.setattr(by_recursion, "cross", lambda a, b: [0.0] * 3)
    fast = recursive_function(equations, "inversion_jacobians")
    given = state(equations.model)
    found = values(fast, given)
    expected = values(equations.function("inversion_jacobians"), given)
    assert disagreement(found, expected) > 1e-2
    lines = {name: x[:3] for name, x in found.items()}
    assert disagreement(lines, {name: x[:3] for name, x in expected.items()}) <= EXACT


def test_a_planted_error_in_the_springs_is_seen(monkeypatch):
    """Rows without their springs are not those of the Lagrangian."""
    equations = derive(read("planar5_nmp"))
    expected = values(equations.function("inversion_jacobians"), given := state(equations.model))
    kept = inversion_functions.derivative_ports

    def without(equations, of_output, of_left):
        inputs, names, outputs, ports = kept(equations, of_output, of_left)
        at = ports.index("row")
        outputs[at] = of_left[0]
        outputs[at + 1] = of_left[1]
        return inputs, names, outputs, ports

    monkeypatch.setattr(by_recursion, "derivative_ports", without)
    assert (
        disagreement(values(recursive_function(equations, "inversion_jacobians"), given), expected)
        > 1e-3
    )


# --- where they exist-----------------------------------------------------------------------------
def complete(model: RobotModel) -> RobotModel:
    """The model with complete coupling of its rotors, which turn with their carriers."""
    return dataclasses.replace(model, motor_coupling="complete")


# Beginnings of functions of models with harmonics, frictions by load, and rotors that turn.
SPECIAL = ("motor_harm", "loaded", "rotor_coupl")


def test_models_have_the_functions_that_their_structure_allows():
    plain = tuple(
        name
        for name in FUNCTIONS[: -len(INVERSION)]
        if not name.startswith(("sensor", "flexible", *SPECIAL))
    )
    elastic = [
        name for name in FUNCTIONS if not name.startswith(("sensor", *SPECIAL))
    ]  # of arms with elastic joints
    assert offered_functions(read("planar5_nmp")) == (*plain, *INVERSION)
    assert offered_functions(read("elbow")) == tuple(
        name for name in elastic if name != "inversion_jacobians"
    )
    sensor = {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2"}
    measured = tuple(name for name in FUNCTIONS if not name.startswith(("flexible", *SPECIAL)))
    assert offered_functions(read("planar5_nmp", overrides={"sensor": [sensor]})) == measured
    coupled = [*plain, "rotor_coupling", *INVERSION]
    assert set(offered_functions(read("planar5_nmp@coupled"))) == set(coupled)
    circle = read("planar5_nmp@coupled", overrides={"motor.m2.carrier": "arm2"})
    assert offered_functions(circle) == plain
    one = read("planar5_nmp")
    fewer = dataclasses.replace(one, output=dataclasses.replace(one.output, axes="x"))
    assert fewer.inversion_obstacle() == fewer.inversion_obstacle(any_coupling=True) is not None
    assert (
        complete(one).inversion_obstacle(any_coupling=True) is None
        and one.inversion_obstacle() is None
    )
    assert (
        "given motor_coupling 'complete', expected 'simplified'"
        in complete(one).inversion_obstacle()
    )
    assert offered_functions(fewer) == plain
    with pytest.raises(
        ArgumentError, match=r"gear_law.*given outputs 1, motors 2, expected as many"
    ):
        choose_functions(["gear_law"], fewer)
    with pytest.raises(ArgumentError, match="coordinates without motor"):
        choose_functions(["inversion_jacobians"], read("elbow"))
    with pytest.raises(ArgumentError, match="as many outputs as motors"):
        derive(fewer).function("inversion_rows")
    assert recursive_function(derive(fewer), "inversion_rows") is None


def test_sizes_and_units():
    spec = library_spec(derive("planar5_nmp"))
    assert (spec.sizes["n_y"], spec.sizes["n_t"]) == (2, 2)
    ports = {p.name: p for f in spec.functions for p in (*f.inputs, *f.outputs)}
    assert ports["target"].unit == ports["y_err"].unit == "m" and ports["Wdot_v"].unit == "m/s^2"
    pose = library_spec(equations_of("manutec_r3"), ["output_constraint", "inversion_rows"])
    assert (pose.sizes["n_y"], pose.sizes["n_t"]) == (6, 12)
    ports = {p.name: p for f in pose.functions for p in (*f.inputs, *f.outputs)}
    assert ports["target"].shape == (12,) and "rotation matrix by columns" in ports["target"].doc
    assert "row" not in ports  # there is no coordinate without motor
    text = emit(pose)["manutec_r3.h"]
    assert "#define MANUTEC_R3_NT 12 /* numbers of an output sample */" in text


@pytest.mark.parametrize("names", [["payload", "stiffness"], ["friction", "damping"]])
def test_run_time_parameters_are_arguments(names):
    equations = derive("planar5_nmp", names)
    spec = library_spec(equations)
    assert "parameters" in [
        a.name for f in spec.c_functions if f.name == "invert" for a in f.arguments
    ]
    numbers = np.array([parameter.value for parameter in equations.parameters])
    given = {**state(equations.model), "parameters": 1.3 * numbers, "v_m": np.ones(2)}
    for name in (*MADE_OF_TAPES, "gear_law", "motor_friction"):
        slow = equations.function(name)
        fast = fast_function(equations, name)
        if fast is not None:
            assert disagreement(values(fast, given), values(slow, given)) <= EXACT, name
    takes = {f.name for f in spec.functions if any(p.name == "parameters" for p in f.inputs)}
    expected = {
        "payload": {"inversion_jacobians", "inversion_rows", "gear_law"},
        "friction": {"inversion_jacobians"},
    }
    assert expected[names[0]] <= takes


# --- the hand-written functions ------------------------------------------------------------------
def test_hand_written_c_has_the_librarys_name():
    spec = library_spec(derive("planar5_nmp"))
    texts = emit(spec)
    constants = texts["src/planar5_nmp_motor_constants.h"].splitlines()
    assert {"src/planar5_nmp_inversion.c", "planar5_nmp_inversion.h"} <= set(texts)
    for name, text in texts.items():
        assert "model_" not in text and "MODEL_" not in text, name
    for line in (
        "static const int i_g[PLANAR5_NMP_NG] = {0, 1};",
        "static const int i_e[PLANAR5_NMP_NE] = {2};",
        "static const real gear_damping[PLANAR5_NMP_NG] = {400.0, 250.0}; /* arm side */",
        "static const real rotor_inertia[PLANAR5_NMP_NM] = {0.004, 0.0025};",
        "#define PLANAR5_NMP_POSE 0 /* the output is a pose: position, then rotation */",
    ):
        assert line in constants
    assert "planar5_nmp_status planar5_nmp_invert(" in texts["planar5_nmp_inversion.h"]


@pytest.mark.slow
def test_motor_constants_are_those_of_the_model():
    constants = library_spec(equations_of("four_mass")).motor_constants
    model = equations_of("four_mass").model
    assert np.array_equal(constants.eta, model.eta) and np.allclose(
        np.array(constants.eta_inverse) @ model.eta, np.eye(1)
    )
    pose = library_spec(equations_of("ur5_elastic"), INVERSION).motor_constants
    assert pose.pose and all(pose.gear_is_rigid) and not any(pose.gear_damping)


def test_models_have_the_hand_written_functions_of_their_structure(tmp_path):
    equations = derive("planar5_nmp")
    named = [function.name for function in library_spec(equations).c_functions]
    assert {
        "inversion_defaults",
        "invert_work",
        "invert",
        "stream_defaults",
        "stream_update",
    } <= set(named)
    assert library_spec(equations, INVERSION).c_functions
    assert not library_spec(equations, ["gravity"]).c_functions
    single = [
        function.name for function in library_spec(equations, precision="single").c_functions
    ]
    assert {"invert", "stream_update"} <= set(single) and not {"bvp", "bvp_work"} & set(single)
    few = generate(equations, tmp_path / "few", functions=["gravity"], build=False)
    assert not any("invert" in path.name for path in few.files)
