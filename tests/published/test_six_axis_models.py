"""The six-axis elastic robots and the planar family: inertia, frequencies, zeros and verdicts as
their files say.
"""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import flexgen
from flexgen.analysis.linear import LinearModel, linearize
from flexgen.analysis.zero_dynamics.zeros import inner_pencil, inner_zeros, zero_report
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import Equilibrium, hold_joints
from flexgen.inversion.judge.status import Status
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.paths.path import Path as ToolPath

# Zeros of the non-actuated elements, unstable and all, at every pose of every move; slowest and
# fastest unstable rate.
ZEROS = {
    "manutec_r3_18": (2, 12, 200.0, 1400.0),
    "manutec_r3_24": (3, 24, 80.0, 1100.0),
    "manutec_r3_30": (3, 36, 50.0, 1100.0),
    "kr300_efjm": (2, 16, 650.0, 1700.0),
}
MANUTEC = tuple(name for name in ZEROS if name.startswith("manutec"))
CONDITION = 1e5  # of the inertia matrix [mixed units]: 11 digits are left in M^-1
FAMILY = "planar5_family"
POSES = 7  # along a move


@cache
def equations_of(name: str) -> Equations:
    return flexgen.derive(name)


def at_rest(equations: Equations, q_g: np.ndarray) -> tuple[Equilibrium, LinearModel]:
    rest = hold_joints(equations, q_g)
    return rest, linearize(equations, rest)


def follow(equations: Equations, path: ToolPath, poses: int) -> np.ndarray:
    """Actuated coordinates (poses, n_g) with the tool on the path and no deflection, by Newton's
    method.
    """
    i_g = list(equations.model.i_g)
    asked = path.sample(np.linspace(0.0, path.duration, poses))
    q = path.q_start.copy()
    found = []
    assert asked.R is not None
    for p_d, R_d in zip(asked.y[:, :3, 0], asked.R, strict=True):
        for _ in range(20):
            p, R = evaluate(equations.function("forward_kinematics"), q)
            turn = R_d @ R[0].T
            skew = 0.5 * (turn - turn.T)
            error = np.concatenate([p_d - p[0], [skew[2, 1], skew[0, 2], skew[1, 0]]])
            if np.abs(error).max() < 1e-10:
                break
            q[i_g] += np.linalg.solve(
                evaluate(equations.function("jacobian"), q)[0][0][:, i_g], error
            )
        assert np.abs(error).max() < 1e-10
        found.append(q[i_g].copy())
    return np.array(found)


def unstable(zeros: np.ndarray) -> np.ndarray:
    return zeros.real[zeros.real > 0]


# --- six axes ------------------------------------------------------------------------------------


def test_the_larger_ones_contain_the_smaller_ones() -> None:
    """The elasticities of the 18 are among those of the 24, and these among those of the 30, value
    for value.
    """
    small, middle, large = ({c.dof for c in read(name).coordinates} for name in MANUTEC)
    assert small < middle < large


@pytest.mark.parametrize("name", ZEROS)
def test_the_inertia_is_positive_definite_in_any_pose(name: str) -> None:
    equations = equations_of(name)
    model = equations.model
    rng = np.random.default_rng(1)
    for _ in range(50):
        q = np.zeros(model.n_a)
        q[list(model.i_g)] = rng.uniform(-np.pi, np.pi, model.n_g)
        q[list(model.i_e)] = rng.normal(scale=0.01, size=model.n_e)
        values = np.linalg.eigvalsh(evaluate(equations.function("mass_matrix"), q)[0][0])
        assert 0 < values[-1] < CONDITION * values[0]


@pytest.mark.parametrize("name", ZEROS)
def test_the_lowest_frequency_with_locked_motors_is_that_of_a_robot(name: str) -> None:
    equations = equations_of(name)
    _, linear = at_rest(equations, np.array(equations.model.home))
    n = equations.model.n_a
    stiffness = 0.5 * (linear.K[:n, :n] + linear.K[:n, :n].T)
    squares = scipy.linalg.eigh(stiffness, linear.M[:n, :n], eigvals_only=True)
    assert 4.95 < np.sqrt(squares[0]) / (2 * np.pi) < 30.0


@pytest.mark.parametrize("name", ZEROS)
def test_zeros_along_the_moves(name: str) -> None:
    equations = equations_of(name)
    model = equations.model
    count, total, slowest, fastest = ZEROS[name]
    assert total == 2 * model.n_e  # no direction is flat
    for move in model.moves:
        assert move.duration == 1.0 and move.smoothness == 5
        for q_g in follow(equations, ToolPath(equations, move), POSES):
            rest, linear = at_rest(equations, q_g)
            zeros = inner_zeros(equations, linear, rest)
            assert len(zeros) == total + model.n_g  # and one of each gear, -K/D
            assert len(unstable(zeros)) == count
            assert slowest < unstable(zeros).min() and unstable(zeros).max() < fastest
            W = linear.W[:, list(model.i_g)]
            assert np.linalg.cond(W) < 30  # away from singular poses


@pytest.mark.parametrize(
    ("name", "change"),
    [
        # a tilt of joint 5: body 5 has nowhere to go
        ("manutec_r3_24", {"element.body5.dof.t5y.axis": [0, 0, 1]}),
        ("manutec_r3_18", {"element.body5.dof.t5y.type": "translation"}),
        ("kr300_efjm", {"element.link5.dof.t5y.type": "translation"}),
    ],
)
def test_another_direction_behind_joint_5_is_flat(name: str, change: dict[str, object]) -> None:
    """With the tool held, body 5 can only turn about joint 6: any other elasticity there has no
    inertia of its own.
    """
    equations = flexgen.derive(read(name, overrides=change))
    rest, linear = at_rest(equations, np.array(equations.model.home))
    A, _, _ = inner_pencil(equations, linear)
    ranks = np.linalg.svd(A, compute_uv=False)
    plain = inner_pencil(
        equations_of(name), at_rest(equations_of(name), np.array(equations.model.home))[1]
    )[0]
    usual = np.linalg.svd(plain, compute_uv=False)
    assert ranks[-1] < 1e-12 * ranks[0] and usual[-1] > 1e-6 * usual[0]
    assert len(inner_zeros(equations, linear, rest)) < ZEROS[name][1] + equations.model.n_g


@pytest.mark.full
def test_eighteen_degrees_of_freedom_by_collocation() -> None:
    solution = flexgen.solve("manutec_r3_18", "line", method="collocation")
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 1) < 1e-7


# --- the planar family ---------------------------------------------------------------------------


def effective_inertia(model: RobotModel) -> float:
    """``j + m xi^2 - m xi l`` [kg m^2] of the third body."""
    body = model.elements[2].body
    length = model.tool.position[0]
    xi = body.com[0]
    return body.inertia[2][2] + body.mass * xi**2 - body.mass * xi * length


def expected_phase(inertia: float) -> str:
    return "non-minimum phase" if inertia < 0 else "minimum phase"


@pytest.mark.parametrize("variant", ["", *read(FAMILY).variants])
def test_variants_have_the_zeros_of_their_descriptions(variant: str) -> None:
    model = read(FAMILY, variant or None)
    equations = flexgen.derive(model)
    rest, linear = at_rest(equations, np.array(model.home))
    inertia = effective_inertia(model)
    report = zero_report(equations, linear, rest)
    assert report.phase == expected_phase(inertia)
    if not variant:
        assert inertia == 0.0 and len(report.zeros) == 3  # one of joint 3, two of the gears
    else:
        file = tomllib.loads(Path(model.file).read_text())
        assert file["variant"][variant]["description"].endswith(f"I_eff = {inertia:.4g} kg m^2")
        assert len(report.zeros) == 4


def wrong_verdicts(arms: int, planted: float = 0.0) -> int:
    """Arms whose verdict is not that of the closed form; ``planted`` is added to the tool's length
    in the form.
    """
    rng = np.random.default_rng(4)
    wrong = 0
    for k in range(arms):
        mass = rng.uniform(5.0, 60.0)
        xi = rng.uniform(0.05, 0.4)
        length = rng.uniform(0.2, 1.2)
        inertia = 10.0 ** rng.uniform(-3, 0) * (1 if k % 2 else -1)
        moment = inertia - mass * xi * (xi - length)
        if moment < 0.01:  # the tool is too short for this one: lengthen it
            length = xi + (0.01 - inertia) / (mass * xi) + rng.uniform(0.1, 0.5)
            moment = inertia - mass * xi * (xi - length)
        changes: dict[str, object] = {
            "element.arm3.body": {"mass": mass, "com": [xi, 0, 0], "inertia": [moment] * 3},
            "tool.position": [length, 0, 0],
            "element.arm3.dof.q3.spring.stiffness": 10.0 ** rng.uniform(4.5, 6),
            "element.arm3.dof.q3.damping": 10.0 ** rng.uniform(1, 3),
        }
        model = read(FAMILY, overrides=changes)
        pose = np.array([rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 2.8) * rng.choice([-1, 1])])
        equations = flexgen.derive(model)
        rest, linear = at_rest(equations, pose)
        phase = zero_report(equations, linear, rest).phase
        wrong += phase != expected_phase(effective_inertia(model) - planted * mass * xi)
    return wrong


@pytest.mark.slow
def test_no_verdict_is_wrong_on_either_side_of_the_flat_point() -> None:
    assert wrong_verdicts(100) == 0


def test_the_study_sees_a_wrong_length() -> None:
    assert wrong_verdicts(20, planted=0.1) > 0
