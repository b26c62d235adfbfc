"""FMUs of the plant against Lagrange's equations integrated by SciPy: motion, derivatives, order;
a planted bug.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import casadi as ca
import fmpy
import fmus
import numpy as np
import pytest
from gear_friction import loaded
from scipy.integrate import solve_ivp

import flexgen
from flexgen.exports.fmu import plant as plant_module
from flexgen.exports.fmu.variables import INPUT, OUTPUT, RATE, STATE
from flexgen.exports.mujoco.mujoco_checks import with_friction
from flexgen.model.elements import Body

# the first is quick: it compiles in a second
MODELS = [pytest.param("four_mass", id="one axis"), "planar5_nmp", "manutec_r3_24"]
MODELS[1:] = [pytest.param(name, marks=pytest.mark.slow) for name in MODELS[1:]]
VERSIONS = ["2.0", pytest.param("3.0", marks=pytest.mark.slow)]
STEPS = 8  # of a millisecond

CO_SIMULATION = (
    # of the largest value of a channel, at least 1 rad, m: asked of the FMU; Runge-Kutta reaches
    # 1e-10
    1e-8
)
MODEL_EXCHANGE = 1e-7  # the same; the integrator outside has 1e-11
FINE = {"integration.step": 1e-5}  # s


def check_co_simulation(written, model):
    inputs = fmus.inputs_over(written, STEPS)
    definition = fmus.lagrange(model)
    expected = definition.motion(fmus.starts(written, STATE), inputs)
    x, y = fmus.co_simulated(written, inputs, FINE)
    assert fmus.largest_difference(x, expected) <= CO_SIMULATION
    assert (
        fmus.largest_difference(y, np.array([definition.output(state) for state in expected]))
        <= CO_SIMULATION
    )
    assert np.abs(expected[-1] - expected[0]).max() > 1e-5  # (it moved)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", MODELS)
def test_co_simulation_is_the_motion_of_lagranges_equations(model, version):
    check_co_simulation(fmus.exported(model, version), model)


@pytest.mark.slow
def test_friction_by_load_and_temperature_is_in_the_plant(tmp_path):
    model = loaded("elbow", 40.0)
    written = flexgen.export_fmu(model, tmp_path / "arm.fmu", version="2.0")
    check_co_simulation(written, model)
    inputs = fmus.inputs_over(written, STEPS)
    x, _ = fmus.co_simulated(written, inputs, FINE)
    without = fmus.lagrange(with_friction(model, "viscous")).motion(
        fmus.starts(written, STATE), inputs
    )
    assert fmus.largest_difference(x, without) > 1e-3


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", MODELS)
def test_model_exchange_is_the_motion_of_lagranges_equations(model, version):
    written = fmus.exported(model, version)
    inputs = fmus.inputs_over(written, STEPS)
    expected = fmus.lagrange(model).motion(fmus.starts(written, STATE), inputs)
    fmu = fmus.Instance(written, "ModelExchange")
    states = fmus.references(written, STATE)
    rates = fmus.references(written, RATE)

    def rate(t, x):
        fmu.put(states, x)
        return fmu.get(rates)

    x = expected[0]
    for k, u in enumerate(inputs):
        fmu.put(fmus.references(written, INPUT), u)
        found = solve_ivp(rate, (0.0, fmus.COMMUNICATION), x, "DOP853", rtol=1e-11, atol=1e-12)
        x = found.y[:, -1]
        assert fmus.largest_difference(x[None], expected[k + 1][None]) <= MODEL_EXCHANGE
    fmu.close()


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("model", ["four_mass", "planar5_nmp", "manutec_r3_24"])
def test_fmpy_integrates_model_exchange_by_cvode(model, version):
    """With constant inputs: FMPy holds them during a step of its solver."""
    written = fmus.exported(model, version)
    definition = fmus.lagrange(model)
    end = 0.01
    u = np.concatenate([fmus.starts(written, INPUT)[:-6] + 0.5, fmus.FORCE])
    names = [v.name for v in written.details["variables"] if v.kind == INPUT]
    signals = np.array(
        [(0.0, *u), (end, *u)], dtype=[("time", float), *((name, float) for name in names)]
    )
    result = fmpy.simulate_fmu(
        str(written.path),
        stop_time=end,
        fmi_type="ModelExchange",
        solver="CVode",
        relative_tolerance=1e-11,
        input=signals,
        output_interval=end,
        output=[v.name for v in written.details["variables"] if v.kind == STATE],
    )

    x0 = fmus.starts(written, STATE)
    found = solve_ivp(definition.rate, (0.0, end), x0, "DOP853", args=(u,), rtol=1e-12, atol=1e-13)
    x = np.array(list(result[-1])[1:])
    assert result["time"][-1] == pytest.approx(end)
    assert fmus.largest_difference(x[None], found.y[:, -1][None]) <= MODEL_EXCHANGE


@pytest.mark.parametrize("model", MODELS)
def test_the_implicit_step_has_order_four(model):
    written = fmus.exported(model, "2.0")
    inputs = fmus.inputs_over(written, 8)
    expected = fmus.lagrange(model).motion(fmus.starts(written, STATE), inputs)
    errors = []
    steps = {"four_mass": 1e-3, "planar5_nmp": 5e-4, "manutec_r3_24": 5e-4}[
        model
    ] * 0.5 ** np.arange(3)
    for step in steps:
        x, _ = fmus.co_simulated(
            written, inputs, {"integration.method": 2, "integration.step": step}
        )
        errors.append(fmus.largest_difference(x, expected))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    # halving three times: 4.0 but for higher terms
    assert (np.abs(orders - 4.0) < 0.25).all(), (errors, orders)


def stiff(tmp_path):
    """One axis with a gear spring so stiff that its mode is at 5 kHz."""
    model = flexgen.read(
        "four_mass",
        overrides={"element.mass1.dof.q1.gear.spring": {"type": "linear", "stiffness": 1e6}},
    )
    return flexgen.export_fmu(model, tmp_path / "stiff.fmu")


@pytest.mark.slow
def test_a_stiff_spring_needs_the_implicit_step(tmp_path):
    """With a step far beyond the stability limit of Runge-Kutta the implicit step damps the mode
    and keeps the rest.
    """
    written = stiff(tmp_path)
    inputs = fmus.inputs_over(written, STEPS)
    inputs[:, -6:] = 0.0
    inputs[:, 0] = 0.1
    coarse = {"integration.step": 1e-3}
    x, _ = fmus.co_simulated(written, inputs, coarse | {"integration.method": 2})
    fine, _ = fmus.co_simulated(written, inputs, {"integration.step": 2e-6})
    # positions; the fast mode is 1e-7 rad in size
    assert fmus.largest_difference(x[:, :4], fine[:, :4]) < 1e-6
    with pytest.raises(Exception, match=r"doStep|Discard|status"):
        fmus.co_simulated(written, np.tile(inputs, (20, 1)), coarse | {"integration.method": 1})


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", MODELS)
def test_directional_derivatives_are_those_of_lagranges_equations(model, version):
    """Under a force on the tool: Jacobians of the definition by CasADi, and a planted change of
    one column is seen.
    """
    written = fmus.exported(model, version)
    definition = fmus.lagrange(model)
    rng = np.random.default_rng(1)
    x = fmus.starts(written, STATE)
    x = x + 0.01 * rng.standard_normal(len(x))
    u = fmus.inputs_over(written, 3)[2]
    A, B, C = jacobians(definition, x, u)
    fmu = fmus.Instance(written, "ModelExchange")
    fmu.put(fmus.references(written, STATE), x)
    fmu.put(fmus.references(written, INPUT), u)
    unknown = fmus.references(written, RATE) + fmus.references(written, OUTPUT)
    known = fmus.references(written, STATE) + fmus.references(written, INPUT)
    expected = np.block([[A, B], [C, np.zeros((len(C), len(u)))]])
    for _ in range(3):
        seed = rng.standard_normal(len(known))
        found = np.array(fmu.fmu.getDirectionalDerivative(unknown, known, list(seed)))
        size = np.abs(expected) @ np.abs(seed) + 1e-3
        # of the terms of the sum: rounding
        assert (np.abs(found - expected @ seed) / size).max() < 1e-10
        expected_wrong = expected.copy()
        expected_wrong[:, 0] *= -1.0
        assert (np.abs(found - expected_wrong @ seed) / size).max() > 1e-6
    fmu.close()


def jacobians(definition, x, u):
    """A, B, C by CasADi from the definition."""
    m = definition.model
    n_a = m.n_a
    n = m.dof
    i_m = list(m.i_m)
    s = ca.SX.sym("s", len(x))
    w = ca.SX.sym("w", len(u))
    q_m = ca.SX(m.eta) @ s[list(m.i_g)]
    v_m = ca.SX(m.eta) @ s[[n + i for i in m.i_g]]
    for k, j in enumerate(i_m):
        q_m[j] = s[n_a + k]
        v_m[j] = s[n + n_a + k]
    a_a, a_m, _ = definition.function(s[:n_a], s[n : n + n_a], q_m, v_m, w[: m.n_m], w[m.n_m :])
    rate = ca.vertcat(s[n:], a_a, *[a_m[j] for j in i_m])
    p, R = definition.equations.function("forward_kinematics")(s[:n_a])
    v_tool = definition.equations.function("jacobian")(s[:n_a]) @ s[n : n + n_a]
    deflection = ca.SX(s[:n_a])
    gear = ca.SX(np.linalg.inv(m.eta)) @ q_m
    for k, i in enumerate(m.i_g):
        deflection[i] = gear[k] - s[i]
    y = ca.vertcat(q_m, v_m, p, ca.vec(R.T), v_tool, deflection)
    f = ca.Function("f", [s, w], [ca.jacobian(rate, s), ca.jacobian(rate, w), ca.jacobian(y, s)])
    return [np.array(part) for part in f(x, u)]


@pytest.mark.slow
def test_the_payload_is_a_tunable_parameter():
    """With the parameters of another payload the FMU moves as the model file with that payload."""
    written = fmus.exported("planar5_nmp", "2.0")
    payload = Body(7.0, (0.05, -0.02, 0.01))
    model = replace(flexgen.read("planar5_nmp"), payload=payload)
    inputs = fmus.inputs_over(written, 5)
    expected = fmus.Lagrange(model).motion(fmus.starts(written, STATE), inputs)
    start = {"payload.mass": payload.mass} | {
        f"payload.com[{k + 1}]": c for k, c in enumerate(payload.com)
    }
    x, _ = fmus.co_simulated(written, inputs, FINE | start)
    without, _ = fmus.co_simulated(written, inputs, FINE)
    assert fmus.largest_difference(x, expected) <= CO_SIMULATION
    assert fmus.largest_difference(without, expected) > 1e-4


@pytest.mark.slow
def test_the_plant_rests_at_the_start_values():
    """Start values are an equilibrium: the integrator keeps it."""
    written = fmus.exported("planar5_nmp", "2.0")
    inputs = np.tile(fmus.starts(written, INPUT), (20, 1))
    x, _ = fmus.co_simulated(written, inputs)
    assert np.abs(x - x[0]).max() < 1e-10  # rad and rad/s, in 20 ms: rounding of the start values


@pytest.mark.slow
def test_a_wrong_sign_of_the_gear_torque_is_found(monkeypatch, tmp_path):
    """The deflection of the gears is turned around in the exported mathematics: the law must
    fail.
    """
    exact = plant_module.mathematics_of

    def planted(equations, name):
        function = exact(equations, name)
        if name != "forward_dynamics_tool_force":
            return function
        m = equations.model
        given = [ca.SX.sym(key, *function.size_in(key)) for key in function.name_in()]
        values = dict(zip(function.name_in(), given, strict=True))
        straight = ca.SX(m.eta) @ values["q_a"][list(m.i_g)]
        results = function.call(
            [2 * straight - x if key == "q_m" else x for key, x in values.items()]
        )
        return ca.Function(name, given, results, function.name_in(), function.name_out())

    monkeypatch.setattr(plant_module, "mathematics_of", planted)
    written = flexgen.export_fmu("four_mass", tmp_path / "planted.fmu")
    with pytest.raises(AssertionError):
        check_co_simulation(written, "four_mass")


def fnv_1a(data: bytes) -> int:
    """The checksum of Fowler, Noll and Vo, 64 bits."""
    out = 14695981039346656037
    for byte in data:
        out = (out ^ byte) * 1099511628211 % 2**64
    return out


@pytest.mark.parametrize("version", ["2.0", pytest.param("3.0", marks=pytest.mark.slow)])
def test_a_saved_state_of_the_other_interface_or_with_wrong_numbers_is_refused(version):
    """Bytes of a saved state: token (96), sum of the rest, times, x, u, y, p, ..., tick, changed,
    phase, memory.
    """
    written = fmus.exported("four_mass", version)
    kinds = ("CoSimulation", "ModelExchange")
    instances = {kind: fmus.Instance(written, kind) for kind in kinds}
    word = "FMUState" if version == "3.0" else "FMUstate"
    load = "deserializeFMUState" if version == "3.0" else "deSerializeFMUstate"

    def save(kind):
        fmu = instances[kind].fmu
        state = getattr(fmu, f"get{word}")()
        data = bytes(getattr(fmu, f"serialize{word}")(state))
        getattr(fmu, f"free{word}")(state)
        return data

    def restore(kind, data):
        fmu = instances[kind].fmu
        state = getattr(fmu, load)(data)
        try:
            getattr(fmu, f"set{word}")(state)
        finally:
            getattr(fmu, f"free{word}")(state)

    saved = {kind: save(kind) for kind in kinds}
    for kind in kinds:
        restore(kind, saved[kind])
    for kind, other in (kinds, kinds[::-1]):
        with pytest.raises(Exception, match=r"status|rror"):
            restore(kind, saved[other])
    for place, value in ((-16, 7), (-16, -1), (-32, -1), (-48, 3)):  # phase, tick, method
        data = bytearray(saved[kinds[0]])
        end = len(data) + place
        data[end : end + 8] = value.to_bytes(8, sys.byteorder, signed=True)
        data[96:104] = fnv_1a(data[104:]).to_bytes(8, sys.byteorder)
        with pytest.raises(Exception, match=r"status|rror"):
            restore(kinds[0], bytes(data))
    right = saved[kinds[0]]
    assert int.from_bytes(right[96:104], sys.byteorder) == fnv_1a(right[104:])
    for place in np.random.default_rng(4).integers(
        8 * len(right.partition(b"\0")[0]), 8 * len(right), 100
    ):
        data = bytearray(right)
        data[place // 8] ^= 1 << (place % 8)
        if 8 * len(right.partition(b"\0")[0]) + 8 <= place < 96 * 8:
            continue  # unused bytes behind the name
        with pytest.raises(Exception, match=r"status|rror"):
            restore(kinds[0], bytes(data))
    for kind in kinds:
        assert save(kind) == saved[kind]  # nothing has changed
        instances[kind].close()
