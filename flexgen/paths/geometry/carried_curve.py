"""Curves of the tool in a frame that moves with the path: a positioner that turns the workpiece,
or a conveyor that carries it.

With the share u = s / length of the path that is done, the origin o of the frame, and Q(u) the
rotation by u times a rotation vector r, a curve p(s) that is stated with the frame at rest is in
the world

    y = o + u d + Q(u) (p - o),  R = Q(u) R_p,  w = r u' + Q(u) w_p

d: displacement of the frame from the start to the end of the path.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flexgen.model.moves import Carrier
from flexgen.paths.geometry.jets import Attitude, chain_rule, product
from flexgen.paths.geometry.segments import POSITION
from flexgen.paths.geometry.trigonometry import sine_cosine

if TYPE_CHECKING:
    from flexgen.paths.timing.timed_segments import Curve


class MovedCurve:
    """A curve with the parameter of another one, ``curve``, which is seen from a moving frame."""

    curve: Curve

    @property
    def length(self) -> float:
        """Range of the parameter."""
        return self.curve.length

    @property
    def smoothness(self) -> int:
        """Number of continuous derivatives."""
        return self.curve.smoothness

    @property
    def breaks(self) -> np.ndarray:
        """Parameters at which a derivative up to order 5 may jump."""
        return self.curve.breaks


class CarriedCurve(MovedCurve):
    """A curve of the tool that moves with a frame.

    Parameters
    ----------
    curve : Curve
        In the world, with the frame at rest where it starts.
    carrier : Carrier
        Motion of the frame from the start to the end of the curve.
    axis : array (3,), optional
        Of the angle that is the last coordinate of the curve.
    """

    def __init__(self, curve: Curve, carrier: Carrier, axis: np.ndarray | None = None) -> None:
        self.curve = curve
        self.carrier = carrier
        self.turned = 0.0 if axis is None else float(np.asarray(carrier.rotation) @ axis)

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, d, k), and the orientation, from the jet (n, k) of the parameter."""
        x, attitude = self.curve(s)
        share = s / self.length
        rotation = np.asarray(self.carrier.rotation, dtype=float)
        Q = self._rotation(share)
        arm = x[:, :POSITION].copy()
        arm[:, :, 0] -= self.carrier.origin
        moved = x.copy()
        moved[:, :POSITION] = multiply(Q, arm) + _scale(self.carrier.displacement, share)
        moved[:, :POSITION, 0] += self.carrier.origin
        if x.shape[1] > POSITION:
            moved[:, POSITION] += self.turned * share
        if attitude is None:
            return moved, None
        R, w = attitude
        turning = multiply(Q[..., : w.shape[-1]], w) + _scale(rotation, share[:, 1:])
        return moved, (Q[..., 0] @ R, turning)

    def _rotation(self, share: np.ndarray) -> np.ndarray:
        """Jet (n, 3, 3, k) of the rotation of the frame, from that of the share (n, k)."""
        rotation = np.asarray(self.carrier.rotation, dtype=float)
        size = float(np.linalg.norm(rotation))
        n, k = share.shape
        out = np.zeros((n, 3, 3, k))
        out[..., 0] = np.eye(3)
        if size == 0.0:
            return out
        x, y, z = rotation / size
        hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        angle = size * share
        s, c = sine_cosine(angle[:, :1])
        cycle = [np.hstack(pair) for pair in ((s, c), (c, -s), (-s, -c), (-c, s))]
        jets = np.stack(chain_rule([cycle[i % 4] for i in range(k)], angle), axis=-1)
        sine = jets[:, 0, None, None]
        versine = -jets[:, 1, None, None]
        versine[..., 0] += 1.0
        return out + sine * hat[None, :, :, None] + versine * (hat @ hat)[None, :, :, None]


def multiply(Q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Jet (n, 3, k) of the product of a matrix (n, 3, 3, k) and a vector (n, 3, k)."""
    return product(Q, x[:, None]).sum(axis=2)


def _scale(vector: object, share: np.ndarray) -> np.ndarray:
    """Jet (n, 3, k) of a constant vector (3,) times a number (n, k)."""
    return np.asarray(vector, dtype=float)[None, :, None] * share[:, None]
