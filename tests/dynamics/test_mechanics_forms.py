"""Force laws, beams, energies and statics of `flexgen.dynamics.mechanics` by integrals,
differences and balances of power.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import flexgen
from flexgen.base.errors import SolverError
from flexgen.base.spec.parts import Beam, Bending
from flexgen.dynamics.mechanics import beam, force_laws, ports, signatures, statics
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.implicit_dae import implicit_dae
from flexgen.dynamics.mechanics.quasistatic import poses_along
from flexgen.model.abilities import is_stiff, obstacle
from flexgen.model.elements import (
    BacklashSpring,
    CubicSpring,
    Friction,
    LinearSpring,
    PiecewiseSpring,
    SmoothSpring,
)
from flexgen.paths.path import Path

SPRINGS = {
    LinearSpring(3.0): lambda d: 3.0 * d,
    CubicSpring(2.0, 50.0): lambda d: 2.0 * d + 50.0 * d**3,
    PiecewiseSpring(2.0, 7.0, 0.3): lambda d: 2.0 * d if d <= 0.3 else 0.6 + 7.0 * (d - 0.3),
    SmoothSpring(2.0, 7.0, 0.3): lambda d: (
        2.0 * d + 5.0 / 0.27 * d**3 if d <= 0.3 else 1.1 + 7.0 * (d - 0.3)
    ),
    BacklashSpring(9.0, 0.2, 0.01): lambda d: (
        9.0 * (d - (np.hypot(d + 0.2, 0.01) - np.hypot(d - 0.2, 0.01)) / 2)
    ),
}


@pytest.mark.parametrize("spring", SPRINGS, ids=lambda spring: type(spring).__name__)
def test_the_torque_of_a_spring_is_its_formula_and_its_energy_the_integral(spring: Any) -> None:
    d = ca.SX.sym("d")
    law = ca.Function(
        "law", [d], [force_laws.spring_torque(spring, d), force_laws.spring_energy(spring, d)]
    )
    for x in (0.0, 0.05, 0.3, 0.31, 0.8):
        torque, energy = (float(value) for value in law(x))
        assert torque == pytest.approx(SPRINGS[spring](x), rel=1e-13, abs=1e-15)
        expected = quad(SPRINGS[spring], 0.0, x, points=[min(0.3, x)], epsabs=1e-13)[0]
        assert energy == pytest.approx(expected, rel=1e-9, abs=1e-13)
        assert [float(value) for value in law(-x)] == pytest.approx([-torque, energy], rel=1e-14)
    h = 1e-6
    assert force_laws.stiffness_at_zero(spring) == pytest.approx(SPRINGS[spring](h) / h, rel=1e-6)


def test_friction_is_the_sum_of_its_parts() -> None:
    w = ca.SX.sym("w")

    def torque(x: float, **values: float) -> float:
        return float(ca.Function("f", [w], [force_laws.friction_torque(Friction(**values), w)])(x))

    for x in (-3.0, -0.01, 0.0, 0.2, 40.0):
        whole = 0.5 * x + (2.0 + 1.5 / np.cosh(4.0 * x)) * np.tanh(10.0 * x) + 0.25
        assert torque(
            x, viscous=0.5, coulomb=2.0, stribeck=1.5, alpha=4.0, beta=10.0, offset=0.25
        ) == pytest.approx(whole)
        assert torque(x, coulomb=2.0, beta=10.0) == pytest.approx(2.0 * np.tanh(10.0 * x))
        assert torque(x, stribeck=1.5, alpha=4.0, beta=10.0) == pytest.approx(
            1.5 / np.cosh(4.0 * x) * np.tanh(10.0 * x)
        )
        assert torque(x, viscous=0.5, offset=0.25) == pytest.approx(0.5 * x + 0.25)


def test_modes_of_a_clamped_beam_are_those_of_the_textbook() -> None:
    roots = (1.875104068711961, 4.694091132974175, 7.854757438237612, 10.995540734875467)
    assert [beam.clamped_free_root(k) for k in (1, 2, 3, 4)] == pytest.approx(roots, rel=1e-14)
    x = np.linspace(0.0, 1.5, 7)
    for k in (1, 2):
        phi, slope, curvature = beam.mode_shape(k, 1.5, x)
        assert [phi[0], slope[0], curvature[-1]] == pytest.approx(
            [0.0, 0.0, 0.0], abs=1e-12
        ) and phi[-1] == pytest.approx(1.0)
        h = 1e-5
        for n, (low, high) in enumerate(
            zip(beam.mode_shape(k, 1.5, x - h), beam.mode_shape(k, 1.5, x + h), strict=True)
        ):
            if n < 2:
                np.testing.assert_allclose(
                    (high - low) / (2 * h), (slope, curvature)[n], atol=1e-7
                )
    bendings = (Bending("y", 30.0, 2, 0.02), Bending("z", 80.0, 1, 0.05))
    made = beam.modal_beam(Beam(length=1.5, mass_per_length=2.0, bendings=bendings))

    def integral(f: Any) -> float:
        return 2.0 * float(quad(lambda s: f(np.array(s)), 0.0, 1.5, epsabs=1e-13)[0])

    def phi(k: int, derivative: int = 0) -> Any:
        return lambda s: beam.mode_shape(k, 1.5, s)[derivative]

    assert (made.mass, made.s0, made.j0) == pytest.approx((3.0, 2.25, 2.25))
    assert made.s1 == pytest.approx([integral(phi(k)) for k in (1, 2, 1)])
    assert made.j1 == pytest.approx([integral(lambda s, k=k: s * phi(k)(s)) for k in (1, 2, 1)])
    own = [integral(lambda s, k=k: phi(k)(s) ** 2) for k in (1, 2, 1)]
    np.testing.assert_allclose(
        made.m2, np.diag(own) + own[0] * np.eye(3)[::-1] * [1, 0, 1], atol=1e-12
    )
    rigid = [
        integral(lambda s, k=k, e=e: e / 2.0 * phi(k, 2)(s) ** 2)
        for k, e in ((1, 30.0), (2, 30.0), (1, 80.0))
    ]
    np.testing.assert_allclose(made.stiffness, np.diag(rigid), rtol=1e-10)
    np.testing.assert_allclose(
        np.diag(made.damping), 2 * np.array([0.02, 0.02, 0.05]) * np.sqrt(np.multiply(rigid, own))
    )
    assert made.slope == pytest.approx([float(phi(k, 1)(np.array(1.5))) for k in (1, 2, 1)])
    assert made.direction.tolist() == [[0, 1, 0], [0, 1, 0], [0, 0, 1]]


def complete() -> Equations:
    """The elbow with rotors that turn with their carriers."""
    model = flexgen.read("elbow")
    carriers = zip(model.motors, ("base", "upper"), strict=True)
    motors = tuple(
        dataclasses.replace(m, axis=(0.0, 1.0, 0.0), carrier=carrier) for m, carrier in carriers
    )
    return Equations(dataclasses.replace(model, motors=motors, motor_coupling="complete"))


@pytest.mark.parametrize("name", ["elbow", "beam_arm", "kr300_efjm", "complete", "four_mass"])
def test_the_energy_changes_by_the_power_of_motors_and_losses(name: str) -> None:
    """At a random state, by differences along the motion; the momentum of a rotor is the
    derivative of the energy.
    """
    equations = complete() if name == "complete" else derive(name)
    lag = equations.lagrangian
    model = equations.model
    random = np.random.default_rng(4)
    state = [lag.chain.q_a, lag.chain.v_a, lag.q_m, lag.v_m]
    kinetic = ca.gradient(lag.kinetic, lag.v_m)
    power = ca.Function(
        "p", [*state, lag.tau_m], [lag.power_motor, lag.power_dissipated, lag.momentum_m, kinetic]
    )
    x = [0.3 * random.standard_normal(n) for n in (model.n_a, model.n_a, model.n_m, model.n_m)]
    if model.i_m != tuple(range(model.n_m)):
        pytest.skip("motors behind rigid gears have no state of their own")
    theta = np.linalg.solve(model.eta, x[2])
    # deflections as those of real gears
    x[0][list(model.i_g)] = theta + 1e-3 * random.standard_normal(model.n_g)
    tau = random.standard_normal(model.n_m)
    a_a, a_m = (np.array(a).ravel() for a in equations.function("forward_dynamics")(*x, tau))
    into, lost, momentum, gradient = (np.array(value).ravel() for value in power(*x, tau))
    np.testing.assert_allclose(momentum[list(model.i_m)], gradient[list(model.i_m)], rtol=1e-10)
    assert lost[0] > 0

    def energy(h: float) -> float:
        moved = [
            x[0] + h * x[1] + h**2 / 2 * a_a,
            x[1] + h * a_a,
            x[2] + h * x[3] + h**2 / 2 * a_m,
            x[3] + h * a_m,
        ]
        return float(sum(float(part) for part in equations.function("energy")(*moved)))

    h = 1e-6 if name != "kr300_efjm" else 2e-7
    rate = (energy(h) - energy(-h)) / (2 * h)
    assert rate == pytest.approx(into[0] - lost[0], rel=2e-4, abs=1e-4 * lost[0])


def test_gears_deflect_until_their_springs_carry_the_torque() -> None:
    equations = derive("kr300_efjm")
    n = equations.model.n_g
    tau = np.array([[0.0] * n, [50.0] * n, [-2e3] * n, [1e5] * n])
    found = statics.gear_deflection(equations, tau)
    law = equations.function("gear_law")
    for row, deflection in zip(tau, found, strict=True):
        torque = np.array(law(deflection)[0]).ravel()
        moved = deflection != 0
        np.testing.assert_allclose(torque[moved], row[moved], rtol=1e-12)
    assert (np.sign(found[1]) >= 0).all() and (np.sign(found[2]) <= 0).all() and not found[0].any()


@pytest.mark.parametrize(
    "spring",
    [
        PiecewiseSpring(2e3, 9e3, 1e-3),
        SmoothSpring(9e3, 2e3, 1e-3),
        BacklashSpring(8e3, 1e-3, 1e-5),
    ],
)
def test_springs_with_a_kink_or_a_gap_are_inverted(spring: Any) -> None:
    robot = flexgen.read("planar5_nmp")
    elements = []
    for element in robot.elements:
        dofs = (
            dataclasses.replace(
                d, gear=d.gear and dataclasses.replace(d.gear, spring=spring, side="arm")
            )
            for d in element.dofs
        )
        elements.append(dataclasses.replace(element, dofs=tuple(dofs)))
    equations = Equations(dataclasses.replace(robot, elements=tuple(elements)))
    d = ca.SX.sym("d")
    law = ca.Function("law", [d], [force_laws.spring_torque(spring, d)])
    tau = np.array([[1e-3, -3.0], [40.0, -1.9], [2.0, 2.1]])
    expected = [
        [brentq(lambda x, t=t: float(law(x)) - t, -1.0, 1.0, xtol=1e-16, rtol=1e-14) for t in row]
        for row in tau
    ]
    np.testing.assert_allclose(statics.gear_deflection(equations, tau), expected, rtol=1e-10)


def test_time_constants_and_reach_of_a_robot() -> None:
    equations = derive("planar5_nmp")
    gears = [
        c.dof.gear
        for c in equations.model.coordinates
        if c.dof is not None and c.dof.gear is not None
    ]
    ratios = [
        m.ratio[0] if g.side == "motor" else 1.0
        for g, m in zip(gears, equations.model.motors, strict=True)
    ]
    damping = [r**2 * g.damping for g, r in zip(gears, ratios, strict=True)]
    assert statics.gear_damping(equations) == pytest.approx(damping)
    assert statics.gear_lag_times(equations) == pytest.approx(
        [g.damping / g.spring.stiffness for g in gears]
    )
    corners = np.array(equations.function("chain_points")(np.r_[equations.model.home, 0.0]))
    assert statics.reach(equations) == pytest.approx(
        np.linalg.norm(np.diff(corners[:, 1:]), axis=0).sum()
    )
    assert statics.reach(derive("four_mass")) == 1.0


def test_newtons_method_halves_its_step_and_says_where_it_fails() -> None:
    x = ca.SX.sym("x", 2)
    root = ca.Function(
        "root", [x], [ca.atan(x[0]) - 0.1 + 0 * x[1], ca.jacobian(ca.atan(x[0]), x[0])]
    )
    # the full steps diverge from here
    found = statics.solve_newton(root, np.array([3.0, 7.0]), [0], "what")
    assert found[0] == pytest.approx(np.tan(0.1), rel=1e-12) and found[1] == 7.0
    # the full step, to 4.83, has a larger sine, and leads on to 4 pi; half of it to pi
    for size in (1e-3, 1.0, 1e3):
        wave = ca.Function("wave", [x], [size * ca.sin(x[0]), ca.densify(size * ca.cos(x[0]))])
        assert statics.solve_newton(wave, np.array([1.9, 0.0]), [0], "what")[0] == pytest.approx(
            np.pi, rel=1e-12
        )
    none = ca.Function("none", [x], [x[0] ** 2 + 1, ca.densify(2 * x[0])])
    with pytest.raises(
        SolverError,
        match=r"what: not found, residual \S+ \(coordinates, scaled\), expected below 1e-9",
    ):
        statics.solve_newton(none, np.array([0.7, 0.0]), [0], "what")
    flat = ca.Function("flat", [x], [ca.SX(1.0) + 0 * x[0], ca.densify(0 * x[0])])
    with pytest.raises(
        SolverError, match=r"what: the equations are singular at q_a = \[0\.7, 0\.0\]"
    ):
        statics.solve_newton(flat, np.array([0.7, 0.0]), [0], "what")


def test_poses_along_a_path_do_not_depend_on_the_instants_between() -> None:
    equations = derive("planar5_nmp")
    path = Path(equations, equations.model.move("line"))
    times = np.array([0.0, 0.1, 0.35, 0.5])
    many = poses_along(equations, path, times)
    for k, t in enumerate(times):
        np.testing.assert_allclose(
            poses_along(equations, path, np.array([t]))[0], many[k], atol=1e-10
        )
    y = np.array([np.array(equations.function("output")(q)).ravel() for q in many])
    np.testing.assert_allclose(y, path.sample(times).y[:, :, 0], atol=1e-12)
    early = poses_along(equations, path, np.array([-0.2, 0.7]))
    np.testing.assert_allclose(early, many[[0, 3]], atol=1e-10)


def test_ports_have_the_units_of_the_robot() -> None:
    robots = {name: flexgen.read(name) for name in ("elbow", "kr300_efjm", "kr300", "four_mass")}
    sizes = {"n_a": 3, "n_y": 2, "n_m": 2, "n_t": 12}
    units = {}
    for name, robot in robots.items():
        units[name] = [
            ports.port(x, robot, sizes | signatures_sizes(x)).unit
            for x in ("q_a", "target", "y_err", "M")
        ]
    assert units["elbow"] == ["rad", "m", "m", "kg m^2"] and units["kr300"] == [
        "rad",
        "mixed",
        "mixed",
        "kg m^2",
    ]
    assert units["kr300_efjm"] == ["mixed", "mixed", "mixed", "mixed"] and units["four_mass"][
        1:3
    ] == ["m", "m"]
    doc = ports.port("q_a", robots["kr300_efjm"], sizes).doc
    assert doc.endswith("; rad for rotations, m for translations")
    assert ports.port("target", robots["kr300"], sizes | signatures_sizes("target")).doc.endswith(
        ": position [m], rotation matrix by columns"
    )


def signatures_sizes(name: str) -> dict[str, int]:
    """A size for each extent of a port."""
    return dict.fromkeys((e for e in signatures.PORTS[name][0] if not e.isdigit()), 2)


def test_the_units_of_the_dae_are_those_of_its_rows() -> None:
    dae = implicit_dae(derive("kr300_efjm"))
    units = dict(zip(dae.rows, dae.row_units, strict=True))
    assert units["equation of motion of q1"] == "N m" and units["equation of motion of b1y"] == "N"
    assert (
        units["rate of q_a[b1y]"] == "m/s"
        and dict(zip(dae.x, dae.x_units, strict=True))["v_a[q1]"] == "rad/s"
    )
    assert dict(zip(dae.z, dae.z_units, strict=True))["tau_g[q1]"] == "N m" and set(
        dae.u_units
    ) == {"N m"}
    assert len(dae.rows) == dae.function.size1_out(0) and len(dae.x) == dae.function.size1_in(1)


def test_obstacles_of_flexible_joints_name_what_is_given() -> None:
    model = flexgen.read("planar5_nmp")
    found = obstacle(model, "elastic joints")
    assert (
        found is not None
        and "given coordinates without motor (q3), expected a motor and a spring" in found
    )
    stiff = {
        LinearSpring(1.0): True,
        LinearSpring(0.0): False,
        CubicSpring(1.0, 0.0): True,
        CubicSpring(1.0, -1.0): False,
        CubicSpring(0.0, 1.0): False,
        PiecewiseSpring(1.0, 2.0, 0.1): True,
        PiecewiseSpring(0.0, 2.0, 0.1): False,
        SmoothSpring(1.0, 0.0, 0.1): False,
        BacklashSpring(1.0, 0.1, 0.1): False,
    }
    assert {spring: is_stiff(spring) for spring in stiff} == stiff
