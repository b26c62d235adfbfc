"""Jets of derivatives against polynomials, quaternions against rotations of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from flexgen.paths.geometry import jets


def jet(p: Polynomial, t: float, size: int = 6) -> np.ndarray:
    return np.array([p.deriv(k)(t) if k else p(t) for k in range(size)])


def test_jets_are_derivatives() -> None:
    f = Polynomial([2.0, -1.0, 0.5, 0.3, 0.2, -0.1])
    g = Polynomial([0.7, 0.4, -0.6, 0.2])
    t = 0.3
    a = jet(f, t)
    b = jet(g, t)
    assert_allclose(jets.product(a, b), jet(f * g, t))
    assert jets.product(a[:3], b).shape == (3,)
    assert_allclose(jets.product(jets.reciprocal(a), a), [1, 0, 0, 0, 0, 0], atol=1e-12)
    assert_allclose(jets.square_root(jets.product(a, a)), a)
    outer = jet(f, float(g(t)))[None, None]
    assert_allclose(jets.compose(outer, b[None])[0, 0], jet(f(g), t))
    whole = Polynomial([0.0, 1.0, 0.2, 0.4, 0.1])  # s(u)
    u = jets.inverse_function(np.array([t]), jet(whole.deriv(), t, 5)[None])
    s = jets.compose(jet(whole, t)[None, None], u)[0, 0]
    assert_allclose(s, [whole(t), 1, 0, 0, 0, 0], atol=1e-10)


def test_quaternions_are_rotations_with_their_rates() -> None:
    first, second = Rotation.random(2, random_state=3)
    p, q = (jets.quaternion(x.as_matrix()) for x in (first, second))
    assert_allclose(np.abs(p), np.abs(np.roll(first.as_quat(), 1)))
    still = jets.quaternion_product(p[None, :, None], q[None, :, None])[:, :, 0]
    assert_allclose(
        jets.matrices_of_quaternions(still)[0], (first * second).as_matrix(), atol=1e-14
    )
    assert_allclose(jets.rotation_vector(p), first.as_rotvec())
    assert_allclose(jets.rotation_vector(-p), first.as_rotvec())
    assert_array_equal(jets.rotation_vector(np.array([1.0, 0, 0, 0])), np.zeros(3))
    # each entry the largest
    for vector in ([3.1, 0, 0], [0, 3.1, 0], [0, 0, 3.1], [0.2, 0.1, -0.3], [-3.0, 0.1, 0.2]):
        R = Rotation.from_rotvec(vector).as_matrix()
        found = jets.quaternion(R)
        assert found[0] >= 0 and np.linalg.norm(found) == pytest.approx(1.0)
        assert_allclose(jets.matrices_of_quaternions(found[None])[0], R, atol=1e-14)
    axis, angle = jets.axis_angle(np.array([0.0, 0.6, 0.8]) * 2.5)
    assert_allclose(axis, [0, 0.6, 0.8])
    assert angle == pytest.approx(2.5) and jets.axis_angle(np.zeros(3))[0].tolist() == [0, 0, 1]
    angles = np.array([0.3, -2.0, 1e-9])
    expected = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    assert_allclose(jets.rotation_matrices(axis, angles), expected, atol=1e-15)
    R = second.as_matrix()
    assert_allclose(jets.multiply_rotations(expected, R), expected @ R, atol=1e-15)
    law = Polynomial([0.4, -1.0, 0.5, 0.2, -0.3, 0.1])
    moving = jets.rotation_quaternion(jet(law, 0.3)[None], axis)
    assert_allclose(
        jets.matrices_of_quaternions(moving[:, :, 0])[0],
        Rotation.from_rotvec(law(0.3) * axis).as_matrix(),
    )
    R, w = jets.attitude(moving)
    assert_allclose(w[0], np.outer(axis, jet(law.deriv(), 0.3, 5)), atol=1e-10)
    turned = jets.quaternion_product(moving, np.pad(q[None, :, None], ((0, 0), (0, 0), (0, 5))))
    # of the same motion from another attitude
    assert_allclose(jets.angular_velocity(turned), w, atol=1e-10)
