"""Derivatives of products, roots, inverses and compositions up to a fixed order (jets).

A *jet* is an array whose last axis is the order of the derivative: ``x[..., k]`` is the k-th one,
k = 0 ... n.
"""

from __future__ import annotations

from math import comb

import numpy as np

from flexgen.paths.geometry.trigonometry import root, sine_cosine

ORDER = 5  # highest derivative of the reference
JET = ORDER + 1


def chain_rule(f: list[np.ndarray], s: np.ndarray) -> list[np.ndarray]:
    """Time derivatives of ``f(s(t))`` by Faa di Bruno's formula.

    ``f``: derivatives with respect to s, each (n, m), from order 0; ``s`` (n, k): s and its time
    derivatives.
    """
    n = len(f) - 1
    bell = [[np.zeros(len(s)) for _ in range(n + 1)] for _ in range(n + 1)]
    bell[0][0] = np.ones(len(s))
    for i in range(1, n + 1):
        for k in range(1, i + 1):
            bell[i][k] = sum(
                (comb(i - 1, j - 1) * s[:, j] * bell[i - j][k - 1] for j in range(1, i - k + 2)),
                np.zeros(len(s)),
            )
    later = (
        sum((f[k] * bell[i][k][:, None] for k in range(1, i + 1)), np.zeros_like(f[0]))
        for i in range(1, n + 1)
    )
    return [f[0], *later]


def compose(f: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Jet of ``f(s(t))`` (n, m, k) from the jet ``f`` (n, m, k) in s and the jet ``s`` (n, k) in
    time.
    """
    return np.stack(chain_rule([f[:, :, k] for k in range(f.shape[2])], s), axis=-1)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Jet of the product of two jets, by Leibniz' rule; other axes broadcast, the shorter jet
    decides the order.
    """
    size = min(a.shape[-1], b.shape[-1])
    return np.stack(
        [sum(comb(k, i) * a[..., i] * b[..., k - i] for i in range(k + 1)) for k in range(size)],
        axis=-1,
    )


def reciprocal(a: np.ndarray) -> np.ndarray:
    """Jet of ``1/a``."""
    out = np.zeros_like(a)
    out[..., 0] = 1.0 / a[..., 0]
    for k in range(1, a.shape[-1]):
        out[..., k] = -out[..., 0] * sum(
            comb(k, i) * a[..., i] * out[..., k - i] for i in range(1, k + 1)
        )
    return out


def square_root(a: np.ndarray) -> np.ndarray:
    """Jet of the square root of a positive quantity."""
    out = np.zeros_like(a)
    out[..., 0] = root(a[..., 0])
    for k in range(1, a.shape[-1]):
        inner = sum(
            (comb(k, i) * out[..., i] * out[..., k - i] for i in range(1, k)),
            np.zeros_like(a[..., 0]),
        )
        out[..., k] = (a[..., k] - inner) / (2 * out[..., 0])
    return out


def inverse_function(u: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Jet (n, k + 1) of the inverse function u(s) from the jet ``slope`` (n, k) of ``ds/du`` in
    u.
    """
    du_ds = reciprocal(slope)
    out = [u, du_ds[..., 0]]
    term = du_ds
    while term.shape[-1] > 1:
        term = product(du_ds, term[..., 1:])  # d/ds = 1/(ds/du) d/du
        out.append(term[..., 0])
    return np.stack(out, axis=-1)


def rotation_quaternion(angle: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Jet (n, 4, k) of the unit quaternion (w, x, y, z) of a rotation by ``angle`` (n, k) about a
    fixed axis.
    """
    half = angle / 2
    s, c = sine_cosine(half[:, 0])
    cycle = [np.stack(pair, axis=1) for pair in ((c, s), (-s, c), (-c, -s), (s, -c))]
    cosine_sine = np.stack(
        chain_rule([cycle[k % 4] for k in range(angle.shape[1])], half), axis=-1
    )
    return np.concatenate([cosine_sine[:, :1], cosine_sine[:, 1:] * axis[None, :, None]], axis=1)


def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Jet (n, 4, k) of the product a b of two quaternions (n, 4, k), scalar part first."""
    w, x, y, z = (a[:, i] for i in range(4))
    p, q, r, s = (b[:, i] for i in range(4))
    return np.stack(
        [
            product(w, p) - product(x, q) - product(y, r) - product(z, s),
            product(w, q) + product(x, p) + product(y, s) - product(z, r),
            product(w, r) - product(x, s) + product(y, p) + product(z, q),
            product(w, s) + product(x, r) - product(y, q) + product(z, p),
        ],
        axis=1,
    )


def conjugate(q: np.ndarray) -> np.ndarray:
    """The inverse of a unit quaternion, (n, 4, ...)."""
    out = -q
    out[:, 0] = q[:, 0]
    return out


def angular_velocity(q: np.ndarray) -> np.ndarray:
    """Angular velocity in world axes and its derivatives (n, 3, k - 1) of the jet (n, 4, k) of a
    unit quaternion.
    """
    return 2 * quaternion_product(q[:, :, 1:], conjugate(q[:, :, :-1]))[:, 1:]


def matrices_of_quaternions(q: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    w, x, y, z = (q[:, i] for i in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


Attitude = tuple[np.ndarray, np.ndarray]
"""Orientation (n, 3, 3), and the angular velocity (n, 3, k - 1) with its derivatives, both in
world axes.
"""


def attitude(q: np.ndarray) -> Attitude:
    """The `Attitude` of the jet (n, 4, k) of a unit quaternion."""
    return matrices_of_quaternions(q[:, :, 0]), angular_velocity(q)


def rotation_matrices(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) about one unit axis."""
    x, y, z = axis
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine = sine_cosine(angles)[0][:, None, None]
    half = sine_cosine(angles / 2)[0][:, None, None]
    versine = 2 * half**2
    return np.eye(3) + sine * hat + versine * (hat @ hat)


def multiply_rotations(E: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Products (n, 3, 3) of the matrices ``E`` (n, 3, 3) and ``R`` (3, 3), with one order of
    operations everywhere.
    """
    return E[:, :, 0, None] * R[0] + E[:, :, 1, None] * R[1] + E[:, :, 2, None] * R[2]


def quaternion(R: np.ndarray) -> np.ndarray:
    """The unit quaternion (4) of a rotation matrix (3, 3), its first entry not negative.

    Source: S. W. Shepperd, Journal of Guidance and Control 1(3), 1978.
    """
    squares = np.array([1 + np.trace(R), *(1 - np.trace(R) + 2 * np.diag(R))])
    k = int(np.argmax(squares))
    axial = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    out = np.zeros(4)
    if k == 0:
        out[:] = squares[0], *axial
    else:
        i = k - 1
        out[0] = axial[i]
        out[1:] = R[i] + R[:, i]
        out[k] = squares[k]
    out /= np.linalg.norm(out)
    return out if out[0] >= 0 else -out


def axis_angle(vector: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit axis and angle [rad] of a rotation vector; axis z for a zero vector."""
    angle = float(np.linalg.norm(vector))
    return (np.asarray(vector) / angle if angle > 0 else np.array([0.0, 0.0, 1.0])), angle


def rotation_vector(q: np.ndarray) -> np.ndarray:
    """Rotation vector [rad] of a unit quaternion (4), of at most pi."""
    q = q if q[0] >= 0 else -q
    size = float(np.linalg.norm(q[1:]))
    return np.zeros(3) if size == 0 else q[1:] / size * (2 * np.arctan2(size, q[0]))
