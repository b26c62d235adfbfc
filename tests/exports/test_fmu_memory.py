"""FMUs of plants with hysteresis and bristles: their rates by laws of this test, their motion by
`simulate`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import fmus
import numpy as np
import pytest
from bristled import NUMBERS, bristled
from fmpy.validation import validate_fmu
from hysteretic import ARCMIN, BENT, SLIPS, Element, joint_stiffness, with_elements
from remembering import remembering

import flexgen
from flexgen.dynamics.hysteresis.hysteresis import without_hysteresis
from flexgen.dynamics.hysteresis.lugre import without_lugre
from flexgen.exports.fmu import plant_memory as memory_module
from flexgen.exports.fmu.variables import INPUT, RATE, STATE
from flexgen.inversion.hold import Hold, torque_command

slow = pytest.mark.slow
EXACT = 1e-11  # of the largest rate of its kind: rounding
MOTION = 1e-10  # of the largest value of a channel, at least 1 rad
# of the states: joints, deflections [rad], speeds of joints [rad/s]
STILL = 1e-3
TURN = 3e-4
SPEED = 0.3


class Law:
    """Rates of all states: Lagrange's equations without memory, and forces of own laws by their
    mass matrix.
    """

    def __init__(
        self, model: flexgen.RobotModel, elements: tuple[Element, ...], bristles: bool
    ) -> None:
        self.plain = fmus.Lagrange(without_lugre(without_hysteresis(model)))
        self.m = model
        self.elements = elements
        self.K = joint_stiffness(model) if elements else None
        self.bristles = NUMBERS if bristles else None
        self.jacobians = self.plain.equations.function("residual_jacobians")

    def rate(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        m = self.m
        n = self.m.dof
        n_m = self.m.n_m
        z = x[2 * n :]
        _, v_a, q_m, v_m = self.plain.split(x[: 2 * n])
        out = self.plain.rate(0.0, x[: 2 * n], u)
        forces = np.zeros(n)
        i_g = list(m.i_g)
        i_m = list(m.i_m)
        on_motors = np.zeros(n_m)
        inverse = np.linalg.inv(m.eta)
        more = []
        if self.elements:
            d = inverse @ v_m - v_a[i_g]
            total = np.zeros(m.n_g)
            for k, each in enumerate(self.elements):
                own = z[k * m.n_g : (k + 1) * m.n_g]
                part = own / (0.5 * each.lost * ARCMIN * self.K)
                s = np.sign(d)
                curve = (
                    np.abs(part) ** (each.exponent - 1)
                    * part
                    * (1 - each.gamma + each.gamma * np.sign(s * part))
                )
                more.append(each.stiffness * self.K * d * (1 - s * curve))
                total += own
            forces[i_g] += total
            on_motors -= inverse.T @ total
        if self.bristles:
            c, s, v_s, s0, s1 = (self.bristles[k] for k in NUMBERS)
            y = z[len(z) - n_m :]
            turn = v_m - np.abs(v_m) * y / (c + (s - c) * np.exp(-((v_m / v_s) ** 2)))
            more.append(s0 * turn)
            on_motors -= y + s1 * turn
        forces[m.n_a :] += on_motors[i_m]
        rigid = [j for j in range(n_m) if j not in i_m]
        forces[i_g] += m.eta[rigid].T @ on_motors[rigid]
        a = np.zeros(m.n_a), np.zeros(n_m)
        M = np.array(self.jacobians(x[: m.n_a], v_a, a[0], q_m, v_m, a[1], u[:n_m])[0])
        return np.concatenate([out[:n], out[n:] + np.linalg.solve(M, forces), *more])


def states_of(
    model: flexgen.RobotModel, start: np.ndarray, slips: np.ndarray, seed: int
) -> np.ndarray:
    """A state with deflected gears that move, and torques within their slips."""
    rng = np.random.default_rng(seed)
    m = model
    x = start.copy()
    n = m.dof
    i_g = list(m.i_g)
    i_m = list(m.i_m)
    x[: m.n_a] += STILL * rng.standard_normal(m.n_a)
    x[n : n + m.n_a] = SPEED * rng.standard_normal(m.n_a)
    x[m.n_a : n] = (m.eta @ (x[: m.n_a][i_g] + TURN * rng.standard_normal(m.n_g)))[i_m]
    x[n + m.n_a : 2 * n] = (
        m.eta @ (x[n : n + m.n_a][i_g] + SPEED / 10 * rng.standard_normal(m.n_g))
    )[i_m]
    x[2 * n :] = slips * rng.uniform(-0.9, 0.9, len(slips))
    return x


def case(kind: str) -> tuple[flexgen.RobotModel, tuple[Element, ...], bool]:
    tables = {f"motor.{motor}.lugre": NUMBERS for motor in ("m1", "m2")}
    if kind == "rigid":
        gears = {
            f"element.{arm}.gear": {"type": "rigid"} for arm in ("upper.dof.q1", "fore.dof.q2")
        }
        return bristled("elbow", {motor: NUMBERS for motor in ("m1", "m2")}, **gears), (), True
    if kind == "manutec_r3_18":
        return with_elements(kind, SLIPS), SLIPS, False
    return with_elements(kind, BENT, **tables), BENT, True


def errors_of_rates(written: flexgen.Exported, law: Law) -> float:
    """Largest difference of a rate in Model Exchange, relative to the largest one of its kind, at
    three states.
    """
    fmu = fmus.Instance(written, "ModelExchange")
    worst = 0.0
    states, rates, inputs = (fmus.references(written, kind) for kind in (STATE, RATE, INPUT))
    slips = np.array(
        [v.nominal for v in written.details["variables"] if v.kind == STATE][2 * law.m.dof :]
    )
    for seed in range(3):
        x = states_of(law.m, fmus.starts(written, STATE), slips, seed)
        u = fmus.inputs_over(written, 3)[2]
        fmu.put(states, x)
        fmu.put(inputs, u)
        found = fmu.get(rates)
        expected = law.rate(x, u)
        ends = (0, law.m.dof, law.m.dof + law.m.n_a, 2 * law.m.dof, len(x))
        for first, last in pairwise(ends):
            size = np.abs(expected[first:last]).max(initial=1e-300)
            worst = max(worst, float(np.abs(found - expected)[first:last].max(initial=0.0) / size))
    fmu.close()
    return worst


@pytest.mark.parametrize(
    "kind",
    ["elbow", *(pytest.param(x, marks=slow) for x in ("planar5_nmp", "rigid", "manutec_r3_18"))],
)
def test_rates_are_those_of_the_laws(kind, tmp_path):
    model, elements, bristles = case(kind)
    written = flexgen.export_fmu(model, tmp_path / "arm.fmu")
    assert errors_of_rates(written, Law(model, elements, bristles)) < EXACT


@slow
@pytest.mark.parametrize("part", ["rates", "forces"])
def test_a_wrong_sign_is_found(part, monkeypatch, tmp_path):
    exact = memory_module.memory_of

    def planted(equations):
        made = exact(equations)
        return replace(made, **{part: -getattr(made, part)})

    monkeypatch.setattr(memory_module, "memory_of", planted)
    model, elements, bristles = case("elbow")
    written = flexgen.export_fmu(model, tmp_path / "arm.fmu")
    assert errors_of_rates(written, Law(model, elements, bristles)) > 1e-3


@slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_states_are_described_and_derivatives_are_those_of_the_laws(version, tmp_path):
    model, elements, bristles = case("elbow")
    written = flexgen.export_fmu(model, tmp_path / "arm.fmu", version=version)
    assert validate_fmu(str(written.path)) == []
    added = [v for v in written.details["variables"] if v.kind == STATE][2 * model.dof :]
    gears = [f"gear.{joint}.hysteresis[{k}]" for k in (1, 2, 3) for joint in ("q1", "q2")]
    assert [v.name for v in added] == [*gears, "motor.m1.bristles", "motor.m2.bristles"]
    assert {(v.unit, v.start) for v in added} == {("N.m", 0.0)}
    law = Law(model, elements, bristles)
    slips = np.array([v.nominal for v in added])
    x = states_of(model, fmus.starts(written, STATE), slips, 0)
    u = fmus.inputs_over(written, 3)[2]
    fmu = fmus.Instance(written, "ModelExchange")
    fmu.put(fmus.references(written, STATE), x)
    fmu.put(fmus.references(written, INPUT), u)
    rates = fmus.references(written, RATE)
    states = fmus.references(written, STATE)
    nominal = np.array([v.nominal for v in written.details["variables"] if v.kind == STATE])
    size = 1e-6 * np.where(np.arange(len(x)) < 2 * model.dof, 1.0, nominal)
    for k, state in enumerate(states):
        found = fmu.fmu.getDirectionalDerivative(rates, [state], [1.0])
        step = size[k] * np.eye(len(x))[k]
        expected = (law.rate(x + step, u) - law.rate(x - step, u)) / (2 * size[k])
        assert np.abs(np.array(found) - expected).max() < 1e-6 * (1.0 + np.abs(expected).max()), (
            state
        )
    fmu.close()


@slow
@pytest.mark.parametrize(("method", "n"), [(1, 1000), (2, 60)])
def test_co_simulation_is_the_motion_of_simulate(method, n, tmp_path):
    """Under torques that are held for a millisecond; gears and motors slip on the way."""
    model = remembering()
    written = flexgen.export_fmu(model, tmp_path / "arm.fmu")
    path = flexgen.solve(model, method="closed-form", verify=False, progress=False).trajectory
    held = torque_command(path, Hold("zoh", 1e-3))
    expected = flexgen.simulate(model, path, command=held, feedback="none").trajectory
    u = np.tile(fmus.starts(written, INPUT), (n, 1))
    u[:, : model.n_m] = np.asarray(held.values)[:n]
    x, _ = fmus.co_simulated(written, u, {"integration.method": method})
    motion = np.hstack([expected[name][: n + 1] for name in ("q_a", "q_m", "v_a", "v_m")])
    assert fmus.largest_difference(x[:, : 2 * model.dof], motion) < MOTION
    slips = [v.nominal for v in written.details["variables"] if v.kind == STATE][2 * model.dof :]
    assert n < 1000 or (np.abs(x[:, 2 * model.dof :]).max(axis=0) > 0.3 * np.array(slips)).all()


@slow
def test_bristles_that_are_too_stiff_for_a_step_are_told(tmp_path):
    tables = {motor: NUMBERS | {"stiffness": 8e9} for motor in ("m1", "m2")}
    written = flexgen.export_fmu(bristled("elbow", tables), tmp_path / "arm.fmu", step=1e-3)
    with pytest.raises(Exception, match=r"doStep|Discard|status"):
        fmus.co_simulated(written, fmus.inputs_over(written, 100))
