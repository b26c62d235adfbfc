"""Solvability of the inverse dynamics at a pose and along a path, and controllability of the
linearization.
"""

from __future__ import annotations

import json
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from planar_family import planar_arm

import flexgen
from flexgen.analysis.linear import LinearModel, linearize, modes, poles
from flexgen.analysis.zero_dynamics.solvability import (
    controllability,
    solvability,
    solvability_path,
)
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.model.elements import BacklashSpring
from flexgen.model.reader import model_names, read
from flexgen.paths.path import Path

SAME = 1e-9  # relative; two ways to the same matrix
FLAT = ("abb_arm", "manutec_r3_efjm", "planar5_family")


def at_pose(equations: Equations, pose: tuple[float, ...]):
    rest = hold_joints(equations, np.array(pose))
    return solvability(equations, rest, linearize(equations, rest))


def effect_of_the_drives(equations: Equations, pose: tuple[float, ...]) -> np.ndarray:
    """P from the state-space linearization: how motor speeds, angles or torques accelerate the
    output.
    """
    model = equations.model
    rest = hold_joints(equations, np.array(pose))
    A, B = linearize(equations, rest).state_space()
    n = model.dof
    W = np.zeros((model.output.size, n))
    W[:, : model.n_a] = linearize(equations, rest).W[:, : model.n_a]
    out = np.zeros((model.output.size, model.n_g))
    kinds = {
        c.name: c.dof.gear
        for c in model.coordinates
        if c.dof is not None and c.dof.gear is not None
    }
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    stiff = [k for k, i in enumerate(model.i_g) if kinds[model.coordinates[i].name].rigid]
    for k, j in zip(stiff, rigid, strict=True):
        out[:, k] = W @ B[n:, j]
    for k, i in enumerate(model.i_g):
        gear = kinds[model.coordinates[i].name]
        if gear.rigid:
            continue
        # eta^-1 q_m of this gear alone turns by one
        turning = model.eta[:, k][list(model.i_m)]
        block = A[n:, n + model.n_a :] if gear.damping > 0 else A[n:, model.n_a : n]
        out[:, k] = W @ (block @ turning)
    return out


@pytest.mark.parametrize("name", [*model_names(), "planar5_nmp@undamped", "elbow@rigid"])
def test_the_matrix_of_every_model(name: str) -> None:
    equations = flexgen.derive(name)
    found = at_pose(equations, equations.model.home)
    assert found.matrix is not None
    expected = effect_of_the_drives(equations, equations.model.home)
    assert np.abs(found.matrix - expected).max() < SAME * np.abs(expected).max()
    assert found.regular == (name not in FLAT)
    assert found.controllability > 1e-4
    for degree, gear in zip(
        found.relative_degree,
        (c.dof.gear for c in equations.model.coordinates if c.actuated),
        strict=True,
    ):
        assert degree == (2 if gear.rigid else 3 if gear.damping > 0 else 4)


def test_coupled_rigid_and_elastic_gears() -> None:
    """Rigid gears whose motors stand in another order than their joints."""
    model = read("urdf_arm")
    first, second, third = model.motors
    equations = Equations(replace(model, motors=(third, second, first)))
    found = at_pose(equations, model.home)
    assert found.matrix is not None
    expected = effect_of_the_drives(equations, model.home)
    assert np.abs(found.matrix - expected).max() < SAME * np.abs(expected).max()
    assert found.regular


def test_the_determinant_explains_the_verdict() -> None:
    """det(W M^-1 S_g) = +-det(W_g) det(A) / det(M): the regular matrix fails with either
    factor.
    """
    for distance in (0.3, -0.3, 1e-3):
        arm = planar_arm(np.random.default_rng(8), distance)
        equations = Equations(arm.model)
        rest = hold_joints(equations, np.array(arm.pose))
        linear = linearize(equations, rest)
        M = linear.M[:3, :3]
        W = linear.W[:, :3]
        A = arm.i_eff / arm.kappa
        expected = np.linalg.det(W[:, :2]) * A / np.linalg.det(M)
        found = solvability(equations, rest, linear)
        assert found.matrix is not None
        D = np.diag([400.0, 250.0])
        # gravity deflects the passive joint a little, which the closed form leaves out
        assert abs(np.linalg.det(found.matrix @ np.linalg.inv(D))) == pytest.approx(
            abs(expected), rel=2e-2
        )


@pytest.mark.parametrize("name", ["planar5_nmp", "elbow", "elbow@rigid"])
def test_a_stretched_arm_is_singular(name: str) -> None:
    equations = flexgen.derive(name)
    straight = (0.3, -np.pi / 2) if name.startswith("elbow") else (0.3, 0.0)
    model = read(name, overrides={"gravity": [0.0, 0.0, 0.0]})
    found = at_pose(Equations(model), straight)
    assert found.regular is False
    assert found.tool_singular_values[-1] < 1e-12
    assert any(text.startswith("tool in a singular pose") for text in found.warnings)
    near = at_pose(equations, (straight[0], straight[1] + 0.01))
    assert near.regular
    assert any(text.startswith("tool close to a singular pose") for text in near.warnings)


def test_the_wrist_of_a_six_axis_robot() -> None:
    equations = flexgen.derive("manutec_r3")
    pose = list(equations.model.home)
    pose[4] = 0.0
    found = at_pose(equations, tuple(pose))
    assert found.regular is False
    assert any("singular pose" in text and "turn" in text for text in found.warnings)


def test_a_flat_point_and_distal_elasticity_are_named() -> None:
    equations = Equations(planar_arm(np.random.default_rng(4), 0.0).model)
    found = at_pose(equations, equations.model.home)
    assert found.regular is False
    assert found.inertia_sigma_min is not None
    assert found.inertia_sigma_min < 1e-12
    assert found.distal == ("q3",)
    assert any(
        "flat point" in text and "beyond the last actuator (q3)" in text for text in found.warnings
    )
    far = at_pose(flexgen.derive("planar5_nmp"), (0.3, -1.1))
    assert far.warnings == ()


def test_elasticity_beyond_the_last_of_six_axes() -> None:
    """A pose is prescribed: what bends behind the last joint moves nothing but itself."""
    model = read("manutec_r3")
    last = model.elements[-1]
    spring = read("manutec_r3_efjm").elements[1].dofs[1]
    bent = replace(last, dofs=(*last.dofs, replace(spring, name="flange", axis=(1.0, 0.0, 0.0))))
    equations = Equations(replace(model, elements=(*model.elements[:-1], bent)))
    found = at_pose(equations, model.home)
    assert found.distal == ("flange",)
    assert found.regular is False
    assert any("elasticity beyond the last actuator (flange)" in text for text in found.warnings)


def test_a_dead_band_gear_without_slope_transmits_no_torque() -> None:
    model = read("elbow")
    upper = model.elements[0]
    # without smoothing the dead band has no slope at all at its center, where gravity is off
    gear = replace(upper.dofs[0].gear, spring=BacklashSpring(7.5e6, 1e-3, 1e-9), damping=0.0)
    loose = replace(upper, dofs=(replace(upper.dofs[0], gear=gear),))
    equations = Equations(
        replace(model, elements=(loose, *model.elements[1:]), gravity=(0.0, 0.0, 0.0))
    )
    rest = hold_joints(equations, np.array(model.home))
    slope = evaluate(equations.function("gear_law"), np.zeros(2))[1][0]
    assert slope[0] < 1e-4
    found = solvability(equations, rest, linearize(equations, rest))
    assert any("gear of q1" in text and "transmits no torque" in text for text in found.warnings)
    assert found.regular is False


def test_a_single_rigid_axis_has_no_rate_of_its_own() -> None:
    model = read("elbow@rigid", overrides={"gravity": [0.0, 0.0, 0.0]})
    output = replace(model.output, type="combination", axes="", weights=((1.0,),))
    alone = replace(
        model, elements=model.elements[:1], motors=model.motors[:1], output=output, home=(0.2,)
    )
    analysis = flexgen.analyze(alone)
    assert (analysis.zeros.phase, analysis.kunkel_mehrmann.mu, analysis.solvability.regular) == (
        "flat",
        2,
        True,
    )
    assert np.abs(analysis.poles).max() == 0.0


# --- controllability -----------------------------------------------------------------------------


def masses(spring: float, coupling: float) -> LinearModel:
    """Two masses with springs to the ground and between them; the motor pushes the first."""
    K = np.array([[1.0 + coupling, -coupling], [-coupling, spring + coupling]])
    return LinearModel(
        np.eye(2), 0.02 * K, K, np.array([[1.0], [0.0]]), np.zeros((1, 2)), np.zeros((1, 2))
    )


def test_controllability_of_two_masses() -> None:
    assert controllability(masses(2.0, 0.5)) > 0.1
    assert controllability(masses(2.0, 0.0)) < 1e-15  # planted: nothing reaches the second mass
    assert 1e-7 < controllability(masses(2.0, 1e-6)) < 1e-5
    pushed = replace(masses(1.0, 0.3), B=np.array([[1.0], [1.0]]))
    # the masses move alike: their difference is out of reach
    assert controllability(pushed) < 1e-15
    free = LinearModel(
        np.eye(1),
        np.zeros((1, 1)),
        np.zeros((1, 1)),
        np.ones((1, 1)),
        np.zeros((1, 1)),
        np.ones((1, 1)),
    )
    assert controllability(free) == pytest.approx(1.0)


def test_an_element_across_the_plane_is_not_controllable() -> None:
    """A bearing that bends across the plane of a planar arm without gravity across it: no motor
    moves it.
    """
    model = read("planar5_nmp")
    last = model.elements[-1]
    across = replace(last.dofs[0], name="across", axis=(0.0, 1.0, 0.0))
    equations = Equations(
        replace(model, elements=(*model.elements[:-1], replace(last, dofs=(*last.dofs, across))))
    )
    found = at_pose(equations, (0.3, -1.1))
    assert found.controllability < 1e-12
    assert any(text.startswith("not controllable") for text in found.warnings)


# --- along a path, and as data -------------------------------------------------------------------


def test_along_a_path() -> None:
    equations = flexgen.derive("planar5_nmp")
    path = Path(equations, equations.model.move())
    found = solvability_path(equations, path, n=5)
    assert found.warnings == ()
    alone = at_pose(equations, (0.3, -1.1))
    # the path starts from the unbent arm's tool, the pose from its joints
    assert found.regular[0] == pytest.approx(alone.singular_values[-1], rel=1e-2)
    assert found.inertia[0] == pytest.approx(alone.inertia_sigma_min, rel=1e-2)
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["t"][-1] == path.duration


def test_a_path_through_a_singular_pose_is_reported() -> None:
    equations = flexgen.derive("manutec_r3")
    joints = next(move for move in equations.model.moves if move.type == "joint")
    found = solvability_path(equations, Path(equations, joints))
    assert found.tool.min() < 1e-9
    assert any(text.startswith("t = 1.7 s: tool in a singular pose") for text in found.warnings)
    assert np.isnan(found.inertia).all()
    json.dumps(found.to_dict(), allow_nan=False)


def test_refusals_along_a_path() -> None:
    equations = flexgen.derive("planar5_nmp")
    path = Path(equations, equations.model.move())
    with pytest.raises(ArgumentError, match="given n = 0, expected 1 pose or more"):
        solvability_path(equations, path, n=0)
    motors = tuple(
        replace(motor, axis=(0.0, 0.0, 1.0), carrier="base") for motor in equations.model.motors
    )
    complete = Equations(replace(equations.model, motors=motors, motor_coupling="complete"))
    with pytest.raises(ArgumentError, match="'simplified'"):
        solvability_path(complete, path)
    assert at_pose(complete, (0.3, -1.1)).regular is None


def test_the_analysis_contains_the_verdict_and_its_matrix() -> None:
    equations = flexgen.derive("planar5_nmp")
    plain = flexgen.analyze(equations, (0.3, -1.1)).to_dict()
    assert plain["zeros_along_path"] is None
    assert plain["structure"]["index"] == plain["structural_index"] == 4
    assert plain["kunkel_mehrmann"]["mu"] == 3
    assert plain["solvability"]["regular"] is True
    along = flexgen.analyze(
        equations, path=Path(equations, equations.model.move()), poses=5
    ).to_dict()
    assert along["zeros_along_path"]["unstable"] == [1] * 5
    assert len(along["solvability_along_path"]["t"]) == 5
    json.dumps(along, allow_nan=False)


@pytest.mark.parametrize("light", [1e-3, 1e-6, 1e-9, 1e-12])
def test_slow_poles_are_those_without_a_light_mass_on_a_stiff_spring(light: float) -> None:
    """Two masses on a spring and a stiffer one in series; its pole is up to 5e16 1/s, theirs are
    0.5 and 146 1/s.
    """
    k = 4e4
    d = 5.0
    stiff = 1e4

    def chain(spring: np.ndarray, masses: list[float]) -> LinearModel:
        n = len(masses)
        ground = np.zeros((n, n))
        ground[-1, -1] = 2.0
        return LinearModel(
            np.diag(masses),
            d * spring,
            k * spring + ground,
            *[np.eye(n)[:, :1]] * 2,
            np.eye(n)[:1],
        )

    three = np.array([[stiff, -stiff, 0.0], [-stiff, stiff + 1.0, -1.0], [0.0, -1.0, 1.0]])
    two = np.array([[1.0, -1.0], [-1.0, 1.0]]) / (1.0 + 1.0 / stiff)
    found, expected = (poles(chain(*x)) for x in ((three, [3.0, light, 5.0]), (two, [3.0, 5.0])))
    assert np.abs(np.abs(found[:4]) / np.abs(expected) - 1.0).max() < 1e-6 + light
    assert np.abs(found[:4].real / expected.real - 1.0)[2:].max() < 1e-6 + light
    assert found[4:].real == pytest.approx([-k / d, -d * stiff / light], rel=0.01)
    assert np.allclose(modes(found), modes(expected), rtol=1e-6 + light, atol=1e-8)


@pytest.mark.parametrize("light", [1e-3, 1e-6, 1e-9, 1e-12])
def test_poles_next_to_a_much_faster_one_are_exact(light: float) -> None:
    """Against the roots of the characteristic polynomial in 60 digits, up to the rounding of K.

    The stiff spring k is a sum of entries of K; its rounding eps k moves w = sqrt(c / m) of the
    mode on the soft spring c by eps k / (2 c) of w. An eigenvalue solver for all poles at once is
    off by eps times the fastest one.
    """
    masses = np.diag([3.0, light, 5.0])
    k = 4e8
    soft = 2.0
    spring = np.array([[k, -k, 0.0], [-k, k + 4e4, -4e4], [0.0, -4e4, 4e4 + soft]])
    damping = np.array([[5e4, -5e4, 0.0], [-5e4, 5e4 + 5.0, -5.0], [0.0, -5.0, 5.0]])
    unit = np.eye(3)[:, :1]
    found = poles(LinearModel(masses, damping, spring, unit, unit, unit.T))
    with mpmath.workdps(60):
        M, D, K = (mpmath.matrix(x.tolist()) for x in (masses, damping, spring))
        points = [mpmath.mpf(10 * p) for p in range(7)]
        powers = mpmath.matrix([[p ** (6 - j) for j in range(7)] for p in points])
        values = mpmath.matrix([mpmath.det(M * p**2 + D * p + K) for p in points])
        roots = mpmath.polyroots(list(mpmath.lu_solve(powers, values)), 1000, extraprec=1000)
    exact = np.array(sorted((complex(r) for r in roots), key=lambda z: (abs(z), z.imag)))
    rounding = np.finfo(float).eps * k / (2 * soft)
    error = np.abs(np.array(sorted(found, key=lambda z: (abs(z), z.imag))) / exact - 1.0)
    # a few roundings for the sums of three terms and the scaling of rows and columns
    assert error[:2].max() < 8 * rounding
    assert error[2:].max() < 1e-10
    assert list(found[1::2][:2]) == list(np.conj(found[::2][:2]))
