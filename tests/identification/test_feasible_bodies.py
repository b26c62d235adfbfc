"""Ten numbers of a body, and bodies that exist: a cuboid, and integrals over its points."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.identification.rigid import feasible_bodies
from flexgen.model.elements import Body

MASS = 6.0
SIDES = np.array([0.2, 0.4, 0.6])
COM = np.array([0.1, -0.3, 0.2])
SECOND = MASS * (np.diag(SIDES**2) / 12 + np.outer(COM, COM))  # int r r' dm


@pytest.fixture
def body() -> Body:
    own = MASS / 12 * np.diag((SIDES**2).sum() - SIDES**2)
    return Body(MASS, tuple(COM.tolist()), tuple(map(tuple, own.tolist())))


def test_numbers_are_moments_about_the_frame_and_have_an_inverse(body: Body) -> None:
    """Steiner's theorem; the pseudo-inertia is the integral of (r, 1)(r, 1)'."""
    numbers = feasible_bodies.numbers_of(body)
    inertia = np.trace(SECOND) * np.eye(3) - SECOND
    entries = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
    assert_allclose(numbers[:4], [MASS, *(MASS * COM)])
    assert_allclose(numbers[4:], [inertia[i, j] for i, j in entries])
    first = MASS * COM[:, None]
    whole = np.block([[SECOND, first], [first.T, np.array([[MASS]])]])
    assert_allclose(feasible_bodies.pseudo_inertia(numbers), whole)
    again = feasible_bodies.body_of(numbers)
    assert again.mass == MASS
    assert_allclose(again.com, COM)
    assert_allclose(again.inertia, body.inertia, atol=1e-12)
    length = np.sqrt(numbers[4:7].sum() / (2 * MASS))
    sizes = [MASS, *[MASS * length] * 3, *[MASS * length**2] * 6]
    assert_allclose(feasible_bodies.scales(numbers), sizes)


def test_parameters_of_feasible_bodies_have_an_inverse_and_a_jacobian(body: Body) -> None:
    """Differences of second order; numbers of no body become those of one."""
    numbers = feasible_bodies.numbers_of(body)
    made = feasible_bodies.Feasible(2)
    both = np.concatenate([numbers, 2 * numbers])
    x = made.x(both)
    assert_allclose(made.pi(x), both, rtol=1e-9, atol=1e-12)
    steps = 1e-6 * np.eye(20)
    slopes = np.stack([(made.pi(x + d) - made.pi(x - d)) / 2e-6 for d in steps], axis=1)
    assert_allclose(made.jacobian(x), slopes, atol=1e-6)
    flat = np.array([1.0, 0, 0, 0, 1.0, 1.0, 2.5, 0, 0, 0])
    near = made.pi(made.x(np.tile(flat, 2)))[:10]
    assert np.linalg.eigvalsh(feasible_bodies.pseudo_inertia(near))[0] > 0
    assert np.linalg.eigvalsh(feasible_bodies.pseudo_inertia(flat))[0] < 0
