"""The compliance of the tool against MuJoCo, whose equations share no code with these, and closed
forms.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexgen
from flexgen.analysis.analyze import Analysis
from flexgen.analysis.compliance import ToolCompliance, tool_compliance
from flexgen.dynamics.mechanics.equations import derive

mujoco = pytest.importorskip("mujoco")
MODELS = ["planar5_nmp", "carried_arm", "manutec_r3_24"]
STEP = 1e-6  # rad or m, of differences


def machine(found: Analysis) -> ToolCompliance:
    """``M D K J`` by differences of MuJoCo's forces; all gears of these models are elastic."""
    from mujoco_referee import MujocoMachine

    model = found.model
    rest = found.equilibrium
    plant = MujocoMachine(model)
    n = model.n_a

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        x = plant.P @ np.concatenate([q, rest.q_m])
        dx = plant.P @ np.concatenate([v, np.zeros(model.n_m)])
        plant.set_state(x, dx)
        return np.array(plant.d.qfrc_smooth[plant.at_v[:n]])

    def slopes(at, step: float) -> np.ndarray:
        return np.stack([(at(step * e) - at(-step * e)) / (2 * step) for e in np.eye(n)], axis=1)

    still = np.zeros(n)
    K = -slopes(lambda d: force(rest.q_a + d, still), STEP)
    D = -slopes(lambda d: force(rest.q_a, d), STEP)
    force(rest.q_a, still)
    M = plant.minimal_mass(rest.q_a)[:n, :n]
    J_p = np.zeros((3, plant.m.nv))
    J_r = np.zeros((3, plant.m.nv))
    mujoco.mj_jacSite(plant.m, plant.d, J_p, J_r, plant.m.site("tool").id)
    return ToolCompliance(M, D, K, np.vstack([J_p, J_r])[:, plant.at_v[:n]])


@pytest.mark.parametrize("name", MODELS)
def test_static_and_dynamic_compliance_agree_with_mujoco(name: str) -> None:
    found = flexgen.analyze(name)
    assert found.compliance is not None
    ours = found.compliance
    theirs = machine(found)
    largest = np.abs(ours.matrix).max()
    np.testing.assert_allclose(ours.matrix, theirs.matrix, atol=1e-6 * largest)
    f = ours.frequencies[:: len(ours.frequencies) // 12]
    a = ours.response(f)
    b = theirs.response(f)
    assert np.abs(a - b).max() < 1e-5 * np.abs(a).max()
    # a planted bug is seen
    wrong = replace(ours, K=ours.K + np.diag(np.eye(len(ours.K))[0]) * 1e-3 * ours.K[0, 0])
    assert np.abs(wrong.matrix - theirs.matrix).max() > 1e-6 * largest


def test_a_beam_of_one_spring() -> None:
    """One rotation about z with a spring k, a tool at distance r: r^2/k across, 0 along, and 1/k
    in rotation.
    """
    k = 2.0e4
    r = 0.5
    m = 3.0
    one = ToolCompliance(
        *(np.array([[x]]) for x in (m * r * r, 4.0, k)), np.array([[0, r, 0, 0, 0, 1.0]]).T
    )
    values, directions = one.principal()
    np.testing.assert_allclose(values, [r * r / k, 0, 0], atol=1e-18)
    np.testing.assert_allclose(directions[0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(one.principal(rotation=True)[0], [1 / k, 0, 0], atol=1e-18)
    peak = one.resonance()
    assert peak is not None
    w = np.sqrt(k / (m * r * r))
    zeta = 4.0 / (2 * np.sqrt(k * m * r * r))
    assert peak[0] == pytest.approx(w * np.sqrt(1 - 2 * zeta**2) / (2 * np.pi), rel=1e-2)
    assert peak[1] == pytest.approx(r * r / k / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-3)


def test_an_arm_that_no_spring_holds_has_none() -> None:
    found = flexgen.analyze("planar5_nmp")
    assert found.compliance is not None and "compliance" in found.to_text()
    falling = replace(found.linear, K=-found.linear.K)
    assert tool_compliance(derive(found.model), found.equilibrium, falling) is None
    none = replace(found, compliance=None)
    assert "compliance" not in none.to_text() and none.to_dict()["compliance"] is None


def test_a_rigid_robot_moves_nowhere() -> None:
    found = flexgen.analyze("elbow@rigid")
    assert found.compliance is not None and not found.compliance.matrix.any()
    assert found.compliance.resonance() is None and "compliance" not in found.to_text()
