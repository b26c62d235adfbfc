"""Linear models at rest: derivatives in the parameters, poses of rest, friction of the same mean
power.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from gear_friction import loaded, torque
from identification_cases import poses_of
from scipy.integrate import quad
from shipped_models import elastic_models

import flexgen
from flexgen.analysis.linear import linearize
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.rigid.mean_friction import mean_viscous_change
from flexgen.model.elements import Friction

ROBOTS = Path(__file__).parents[1] / "support" / "robots"
W = 2 * np.pi * np.geomspace(1.0, 100.0, 12)
DRIVE = Drive(5e-4, 2e-4, has_images=False)  # derivatives are those without images
ELASTIC = elastic_models()


def worst_slope(
    local: LocalModel,
    q_m: np.ndarray,
    speed_sd: np.ndarray | None,
    deflection_sd: np.ndarray | None = None,
) -> float:
    """Largest difference between derivatives and central differences, over the largest
    derivative.
    """
    values = np.where(local.values == 0, 1e-3, local.values)
    sizes = {"speed_sd": speed_sd, "deflection_sd": deflection_sd}
    exact = local.response(values, q_m, W, DRIVE, **sizes).dG
    assert exact is not None
    worst = 0.0
    for k, value in enumerate(values):
        # The error of a central difference falls with the square of its step; rounding of nearly
        # singular poses of rest rises with its inverse.
        step = 1e-4 * abs(value)
        moved = [
            np.where(np.arange(len(values)) == k, values + s * step, values) for s in (1.0, -1.0)
        ]
        up, down = (local.response(x, q_m, W, DRIVE, **sizes, derivatives=False).G for x in moved)
        difference = np.abs((up - down) / (2 * step) - exact[..., k]).max()
        worst = max(worst, difference / max(np.abs(exact[..., k]).max(), 1e-300))
    return worst


@pytest.mark.parametrize("name", ELASTIC)
def test_derivatives_are_those_of_central_differences(name):
    model = flexgen.read(name)
    speeds = np.full(model.n_m, 0.3)
    names = (
        ["stiffness", "damping", "friction"]
        if any(m.friction.viscous for m in model.motors)
        else ["stiffness"]
    )
    local = LocalModel(model, [*names, *(f"{m.name}.inertia" for m in model.motors)])
    q_m = poses_of(model, 2, spread=0.2) @ model.eta.T
    assert worst_slope(local, q_m, speeds) < 1e-5


def test_a_pose_that_does_not_move_with_the_springs_is_noticed(monkeypatch):
    """Payload and springs move the pose of rest: without that part the derivatives are wrong."""
    model = flexgen.read("manutec_r3_18")
    local = LocalModel(model, ["payload.mass", "t2y.stiffness"])
    q_m = poses_of(model, 1, spread=0.2) @ model.eta.T
    assert worst_slope(local, q_m, None) < 1e-5
    real = LocalModel.rest

    def still(self, values, q_m, *more):
        rest = real(self, values, q_m, *more)
        return type(rest)(rest.y, rest.tau_m, 0 * rest.dy)

    monkeypatch.setattr(LocalModel, "rest", still)
    assert worst_slope(local, q_m, None) > 1e-4


@pytest.mark.parametrize("name", ["planar5_nmp", "elbow", "manutec_r3"])
def test_the_linear_model_is_that_of_the_analysis(name):
    """Matrices of the local model are those of `flexgen.analysis.linear`, whose pose of rest is
    found by other equations.
    """
    equations = flexgen.derive(name)
    model = equations.model
    rest = hold_joints(equations, np.array(model.home))
    linear = linearize(equations, rest)
    local = LocalModel(model, ())
    found = local.rest(local.values, rest.q_m[None])
    assert np.allclose(found.y[0, : model.n_a], rest.q_a, atol=1e-9)
    for a, b in zip(
        local.matrices(local.values, rest.q_m[None]),
        (linear.M, linear.D, linear.K, linear.B),
        strict=True,
    ):
        assert np.allclose(a[0], b, rtol=1e-7, atol=1e-9 * np.abs(b).max())


@pytest.mark.parametrize(("beta", "sd"), [(10.0, 0.01), (10.0, 0.5), (300.0, 0.1), (1e4, 1.0)])
def test_friction_has_the_same_mean_power(beta, sd):
    """Against an adaptive integral; sharp steps included."""
    law = Friction(viscous=0.3, coulomb=2.0, beta=beta, stribeck=0.5, alpha=20.0)
    symbol = ca.SX.sym("sd")
    change = float(ca.Function("f", [symbol], [mean_viscous_change(law, symbol)])(sd))

    def torque(w):
        return 0.3 * w + (2.0 + 0.5 / np.cosh(20.0 * w)) * np.tanh(beta * w)

    def power(w):
        return torque(w) * w * np.exp(-((w / sd) ** 2) / 2) / np.sqrt(2 * np.pi) / sd

    edges = sorted({0.0, min(3 / beta, 8 * sd), min(20 / beta, 8 * sd), 8 * sd})
    mean = 2 * sum(quad(power, a, b, epsabs=0, epsrel=1e-10)[0] for a, b in pairwise(edges))
    at_rest = 0.3 + 2.5 * beta
    assert change + at_rest == pytest.approx(mean / sd**2, rel=1e-5)


@pytest.mark.parametrize(
    ("load", "load_sd"), [(0.0, 0.0), (0.0, 3.0), (-4.0, 0.0), (2.0, 1.5), (0.1, 0.2)]
)
def test_friction_of_the_load_has_the_same_mean_power(load, load_sd):
    """Against sums over a fine grid of speeds and loads, by the equation of the documentation."""
    law = loaded("elbow").motors[0].friction
    sd = 1.3
    x = [ca.SX.sym(name) for name in ("sd", "load", "load_sd")]
    change = ca.Function("f", x, [mean_viscous_change(law, x[0], 20.0, x[1], x[2])])
    t = np.linspace(-8.0, 8.0, 801)
    weight = np.exp(-(t**2) / 2) / np.exp(-(t**2) / 2).sum()
    at_rest = (torque(1e-7, load) - torque(-1e-7, load)) / 2e-7
    for other, agrees in ((load_sd, True), (2 * load_sd + 1.0, False)):
        power = weight @ (torque(sd * t[:, None], load + other * t) * sd * t[:, None]) @ weight
        assert (
            abs(change(sd, load, load_sd) + at_rest - power / sd**2) < 1e-4 * power / sd**2
        ) == agrees


def test_derivatives_with_friction_of_the_load():
    """Of a robot whose gears carry its weight; also where motion is known to load them."""
    model = loaded("elbow")
    local = LocalModel(model, ["stiffness", "m1.load_coulomb", "m2.coulomb"])
    q_m = poses_of(model, 2, spread=0.3) @ model.eta.T
    speeds = np.full(model.n_m, 0.3)
    assert worst_slope(local, q_m, speeds) < 1e-5
    assert worst_slope(local, q_m, speeds, np.full((2, 2), 1e-4)) < 1e-5


def test_a_cubic_spring_is_averaged_in_closed_form():
    """E tau = k d + k3 (d^3 + 3 d sd^2), its slope k + 3 k3 (d^2 + sd^2)."""
    spring = {"type": "cubic", "stiffness": 10.0, "cubic": 1e5}
    model = flexgen.read("four_mass", overrides={"element.mass1.dof.q1.gear.spring": spring})
    local = LocalModel(model, ())
    sd = 3e-3
    q_m = np.zeros((1, 1))
    plain, averaged = (
        local.matrices(local.values, q_m, None, x)[2][0] for x in (None, np.array([[sd]]))
    )
    row = local.deflection_rows[0]
    assert np.allclose(averaged - plain, 3 * 1e5 * sd**2 * np.outer(row, row), rtol=1e-9)


def test_derivatives_with_averaged_springs():
    model = flexgen.read(str(ROBOTS / "two_smooth_gears.toml"))
    local = LocalModel(model, ["stiffness", "damping"])
    q_m = np.array([[1.2, 0.3], [2.0, -0.5]]) @ model.eta.T
    sd = np.array([[2e-5, 1e-5], [1e-4, 5e-5]])
    exact = local.response(local.values, q_m, W, DRIVE, deflection_sd=sd).dG
    assert exact is not None
    for k, value in enumerate(local.values):
        moved = [
            np.where(np.arange(len(local.values)) == k, value * (1 + s * 1e-5), local.values)
            for s in (1, -1)
        ]
        up, down = (
            local.response(x, q_m, W, DRIVE, deflection_sd=sd, derivatives=False).G for x in moved
        )
        difference = (up - down) / (2e-5 * value)
        assert np.abs(difference - exact[..., k]).max() < 1e-4 * np.abs(exact[..., k]).max(), (
            local.names[k]
        )


def test_no_change_at_rest():
    symbol = ca.SX.sym("sd")
    change = ca.Function(
        "f", [symbol], [mean_viscous_change(Friction(coulomb=1.0, beta=50.0), symbol)]
    )
    assert float(change(0.0)) == 0.0


def test_an_equilibrium_that_is_not_found_is_an_error(monkeypatch):
    """A search that is ended too early gives no model."""
    monkeypatch.setattr("flexgen.identification.responses.local_model.NEWTON_STEPS", 1)
    model = flexgen.read("manutec_r3_18")
    local = LocalModel(model, ())
    with pytest.raises(
        SolverError, match=r"equilibrium at pose 1 .*expected below 1e-9; choose another pose"
    ):
        local.rest(local.values, (model.eta @ np.array(model.home))[None])
