"""Collocation of motions: exact for polynomials, its Jacobian against differentiation."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.testing import assert_allclose

from flexgen.base.numerics.tableaus import gauss
from flexgen.base.numerics.transcription import Transcription, motion_at

MESH = np.array([0.0, 0.2, 0.5, 0.9])


def mesh(n: int = 2, n_w: int = 2) -> Transcription:
    return Transcription(MESH, gauss(3), n, n_w)


def test_collocation_is_exact_for_polynomials_of_its_degree() -> None:
    """y = t^4 and -2 t^3: continuity, motion at all instants, places in the vector of unknowns."""
    of = mesh()
    assert (of.N, of.s, of.n_nodes, of.n_inner, of.size) == (3, 3, 16, 12, 16 + 36)
    t = MESH[:, None]
    u = of.times[:, None]
    states = np.hstack([t**4, -2 * t**3, 4 * t**3, -6 * t**2])
    accelerations = np.hstack([12 * u**2, -12 * u])
    w = np.hstack([np.sin(u), np.exp(u)])
    x = of.pack(states, accelerations, w)
    assert x.shape == (of.size,)
    y, dy, ddy, back = of.unpack(x)
    assert_allclose(np.hstack([y, dy]), states)
    assert_allclose(ddy.reshape(-1, 2), accelerations)
    assert_allclose(back.reshape(-1, 2), w)
    assert_allclose(of.continuity @ x, 0.0, atol=1e-13)
    assert of.continuity.shape == (12, of.size)
    assert abs(of.continuity @ (x + 0.1 * np.arange(of.size))).min() > 1e-3
    z, row, h, motion, own = of.instant()
    at = ca.Function("at", [z, row, h], [*motion, own])
    rows, lengths = of.parameters
    own_a, own_w = of.own
    assert_allclose(x[own_a], accelerations)
    assert_allclose(x[own_w], w)
    for k in range(9):
        found = [np.array(v).ravel() for v in at(x[of.where[k]], rows[:, k], lengths[:, k])]
        s = u[k, 0]
        expected = [
            [s**4, -2 * s**3],
            [4 * s**3, -6 * s**2],
            [12 * s**2, -12 * s],
            [np.sin(s), np.exp(s)],
        ]
        for one, other in zip(found, expected, strict=True):
            assert_allclose(one, other, atol=1e-13)


def test_the_assembled_jacobian_is_that_of_the_assembled_constraints() -> None:
    """Also: every row of the instants is scaled by the largest scaled entry among five
    instants.
    """
    of = mesh(1, 1)
    z, row, h, (y, dy, ddy), w = of.instant()
    p = ca.SX.sym("p")
    rows = ca.vertcat(ddy + p * y**2 - w, dy * w)
    x = ca.MX.sym("x", of.size)
    chance = np.random.default_rng(2)
    scale_x = chance.uniform(0.5, 2.0, of.size)
    x0 = chance.normal(size=of.size)
    extra = np.arange(1.0, 10.0)[None]
    g, jacobian, scale = of.constraints(
        x, rows, [z, row, h, p], [*of.parameters, extra], scale_x, x0
    )
    at = ca.Function("at", [x], [g, jacobian, ca.jacobian(g, x)])
    point = chance.normal(size=of.size)
    values, assembled, differentiated = (np.array(v) for v in at(point))
    assert_allclose(assembled, differentiated, atol=1e-12)
    true = scale_x * point
    here = ca.Function("rows", [z, row, h, p], [rows])
    local = [
        np.array(here(true[of.where[k]], *[v[:, k] for v in [*of.parameters, extra]])).ravel()
        for k in range(9)
    ]
    between = of.continuity @ true / np.tile(scale_x[:2], of.N)
    assert_allclose(
        values.ravel(), np.r_[(np.array(local) * scale).ravel(), between], rtol=1e-11, atol=1e-13
    )
    slope = ca.Function("slope", [z, row, h, p], [ca.jacobian(rows, z)])
    sizes = []
    for k in (0, 2, 4, 6, 8):
        block = np.array(slope(x0[of.where[k]], *[v[:, k] for v in [*of.parameters, extra]]))
        sizes.append(np.abs(block * scale_x[of.where[k]]).max(axis=1))
    assert_allclose(scale, 1 / np.max(sizes, axis=0), rtol=1e-13)


def test_motion_at_an_instant_is_the_taylor_polynomial_for_constant_acceleration() -> None:
    z = ca.SX([2.0, -1.0, 0.5, 3.0, 4.0, -6.0, 4.0, -6.0])
    h = ca.SX(0.5)
    table = gauss(2)
    i = 1
    row = ca.SX(np.r_[table.c[i], table.A[i], table.AA[i], np.eye(2)[i]])
    y, dy, ddy = (np.array(ca.DM(v)).ravel() for v in motion_at(z, row, h, 2, 2))
    t = 0.5 * table.c[i]
    assert_allclose(ddy, [4.0, -6.0])
    assert_allclose(dy, [0.5 + 4 * t, 3.0 - 6 * t])
    assert_allclose(y, [2.0 + 0.5 * t + 2 * t**2, -1.0 + 3 * t - 3 * t**2])
