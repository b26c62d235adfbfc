"""Numbers and formulas from the literature, on the models that carry them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from referee import Answers

from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import (
    Beam,
    Bending,
    Body,
    Dof,
    Element,
    Gear,
    Motor,
    Output,
    Placement,
    RobotModel,
)
from flexgen.model.reader import read

CLOSED_FORM = 1e-12  # the same formula by another route: rounding
TABULATED = 1e-6  # roots of cos z cosh z = -1 as tabulated, to seven digits

GRAVITY = 9.81


@dataclass(frozen=True)
class Elbow:
    """Two-link elbow manipulator in a vertical plane: q1 from the vertical, q2 the elbow; inertias
    about the centers.

    Numbers of axes 2 and 3 of a KUKA KR300 R2500 ultra (J. Weigand et al.) seen as such an arm.
    """

    l1: float = 1.150
    m1: float = 339.12
    xi1: float = 0.441
    j1: float = 88.67
    l2: float = 1.241
    m2: float = 190.25
    xi2: float = 0.465
    j2: float = 48.64

    def tool(self, q):
        q1, q2 = q
        return np.array(
            [
                self.l1 * np.sin(q1) + self.l2 * np.cos(q1 + q2),
                0.0,
                self.l1 * np.cos(q1) - self.l2 * np.sin(q1 + q2),
            ]
        )

    def M(self, q):
        q2 = q[1]
        coupling = self.l1 * self.xi2 * np.sin(q2)
        M11 = (
            self.j1
            + self.m1 * self.xi1**2
            + self.j2
            + self.m2 * (self.l1**2 + self.xi2**2 - 2 * coupling)
        )
        M12 = self.j2 + self.m2 * (self.xi2**2 - coupling)
        return np.array([[M11, M12], [M12, self.j2 + self.m2 * self.xi2**2]])

    def c(self, q, v):
        factor = self.m2 * self.l1 * self.xi2 * np.cos(q[1])
        return np.array([-factor * (2 * v[0] * v[1] + v[1] ** 2), factor * v[0] ** 2])

    def g(self, q):
        q1, q2 = q
        fore = self.m2 * self.xi2 * np.cos(q1 + q2)
        return -GRAVITY * np.array(
            [self.m1 * self.xi1 * np.sin(q1) + self.m2 * self.l1 * np.sin(q1) + fore, fore]
        )


ELBOWS = {
    "elbow": Elbow(),
    "elbow@payload": Elbow(m2=340.25, xi2=0.851, j2=112.7),
    "elbow@rigid": Elbow(),
}
ROTORS = np.array([843.9, 751.3])  # kg m^2, on the arm side


def assert_close(found, expected, tolerance: float) -> None:
    found = np.asarray(found)
    expected = np.asarray(expected)
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


@pytest.mark.parametrize("name", ELBOWS)
def test_elbow_is_its_closed_form(name):
    a = Answers(derive(read(name)))
    elbow = ELBOWS[name]
    rng = np.random.default_rng(6)
    for _ in range(20):
        q, v, acc = rng.uniform(-3, 3, (3, 2))
        assert_close(a.forward_kinematics(q)[0].ravel(), elbow.tool(q), CLOSED_FORM)
        assert_close(a.mass_matrix(q), elbow.M(q), CLOSED_FORM)
        assert_close(a.gravity(q), elbow.g(q), CLOSED_FORM)
        assert_close(a.bias(q, v), elbow.c(q, v) + elbow.g(q), CLOSED_FORM)
        # c as a difference: the rounding is that of h
        assert (
            np.abs(a.bias(q, v) - a.gravity(q) - elbow.c(q, v)).max()
            <= CLOSED_FORM * np.abs(a.bias(q, v)).max()
        )
        tau = elbow.M(q) @ acc + elbow.c(q, v) + elbow.g(q)
        assert_close(a.inverse_dynamics(q, v, acc), tau, CLOSED_FORM)


def test_elbow_with_another_sign_of_its_coriolis_term_is_not():
    a = Answers(derive(read("elbow")))
    elbow = ELBOWS["elbow"]
    q = np.array([0.4, -0.8])
    v = np.array([1.0, -0.5])
    with pytest.raises(AssertionError):
        assert_close(2 * a.gravity(q) - a.bias(q, v), elbow.c(q, v) + elbow.g(q), CLOSED_FORM)


def test_rotors_of_the_elbow():
    model = read("elbow")
    assert_close(
        np.diag(model.eta.T @ np.diag([m.inertia for m in model.motors]) @ model.eta), ROTORS, 1e-4
    )


def test_elbow_with_rigid_gears_accelerates_its_rotors():
    model = read("elbow@rigid")
    a = Answers(derive(model))
    elbow = ELBOWS["elbow@rigid"]
    rng = np.random.default_rng(6)
    rotors = model.eta.T @ np.diag([m.inertia for m in model.motors]) @ model.eta
    for _ in range(20):
        q, v, acc = rng.uniform(-3, 3, (3, 2))
        tau = (elbow.M(q) + rotors) @ acc + elbow.c(q, v) + elbow.g(q)
        tau_m = np.linalg.solve(model.eta.T, tau)
        a_a, a_m = a.forward_dynamics(q, v, model.eta @ q, model.eta @ v, tau_m)
        assert (
            np.abs(a_a - acc).max() <= CLOSED_FORM * np.abs(np.linalg.solve(elbow.M(q), tau)).max()
        )
        assert_close(a_m, model.eta @ a_a, CLOSED_FORM)


# --- beams ---------------------------------------------------------------------------------------

# of cos z cosh z = -1; R. D. Blevins, 1979, tab. 8-1
ROOTS = (1.8751041, 4.6940911, 7.8547574, 10.9955407, 14.1371684)
LENGTH = 0.7
MASS = 1.3
STIFFNESS = 210.0


def beam_model(modes: int, directions: str = "y") -> RobotModel:
    """A beam on a joint that turns it about its own axis."""
    joint = Dof("q", "rotation", (1.0, 0.0, 0.0), gear=Gear(rigid=True))
    bendings = tuple(Bending(direction, STIFFNESS, modes, 0.0) for direction in directions)
    return RobotModel(
        name="beam",
        description="",
        source="",
        gravity=(0.0, 0.0, 0.0),
        base=Placement(),
        elements=(Element("beam", (joint,), beam=Beam(LENGTH, MASS, bendings)),),
        motors=(Motor("m", 1e-3, ("q",), (1.0,)),),
        tool=Placement(),
        payload=Body(),
        output=Output("tool_position", axes="y"),
        home=(0.0,),
        moves=(),
    )


def modal_stiffness(a: Answers, n: int) -> np.ndarray:
    still = np.zeros(n + 1)
    return np.array([-a.elastic_torque(e, still) for e in np.eye(n + 1)[1:]])


def test_frequencies_of_a_cantilever():
    """``w_k = z_k^2 sqrt(EI / (m L^4))``."""
    n = len(ROOTS)
    a = Answers(derive(beam_model(n)))
    M = a.mass_matrix(np.zeros(n + 1))[1:, 1:]
    squared = np.sort(np.linalg.eigvals(np.linalg.solve(M, modal_stiffness(a, n))).real)
    found = np.sqrt(np.sqrt(squared) * np.sqrt(MASS * LENGTH**4 / STIFFNESS))
    assert np.all(np.abs(found / ROOTS - 1) < TABULATED)


def test_tip_of_a_cantilever_under_a_force():
    """``F L^3 / (3 EI)``, and of its slope ``F L^2 / (2 EI)``, but for the modes that are left
    out.
    """
    n = 6
    model = beam_model(n)
    a = Answers(derive(model))
    J = a.jacobian(np.zeros(n + 1))[:, 1:]
    force = 5.0
    q = np.linalg.solve(modal_stiffness(a, n), force * J[1])
    left_out = 4 * sum(1 / ((k - 0.5) * np.pi) ** 4 for k in range(n + 1, 200))  # of F L^3 / EI
    deflection = J[1] @ q * STIFFNESS / (force * LENGTH**3)
    assert abs(deflection + left_out - 1 / 3) < 1e-8
    assert abs(J[5] @ q * STIFFNESS / (force * LENGTH**2) - 1 / 2) < 5e-3


def test_beam_turned_about_its_axis_and_bent_back_stands_still():
    """Equal bending in both planes: turning by v and bending by v x q the other way moves no mass
    at all.
    """
    a = Answers(derive(beam_model(1, "yz")))
    q = np.array([0.3, 0.05, -0.08])
    v = np.array([1.0, q[2], -q[1]])
    M = a.mass_matrix(q)
    assert abs(v @ M @ v) < CLOSED_FORM * (np.abs(v) @ np.abs(M) @ np.abs(v))
