"""Stiffness of gears from encoders on both sides: the deflection along a recorded motion over the
torque of the gear.

    q_motor - q_link = tau / k + s v + c
    c: offset of the encoders, s: skew, the time by which one encoder lags

The skew matters: a millisecond at full speed looks like a large deflection. The interval of the
stiffness comes from a bootstrap over blocks of the record, since errors of neighboring samples are
alike. Where it contains an infinite stiffness, the record does not determine the stiffness.

Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993, ch. 8 (blocks).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.errors import ArgumentError

BLOCK_S = 0.5  # s
DRAWS = 2000
INTERVAL = (0.05, 0.95)


@dataclass(frozen=True)
class GearDeflection:
    """Stiffness of one gear, arm side.

    ``stiffness`` [N m/rad or N/m], or None where it is not determined; ``interval``: 90 %
    interval, the upper end infinite where the record allows a rigid gear, or None where the
    torques of the gear are not those of a fit that holds, for the reason ``doubt``; ``skew_s``
    [s]: lag of the link encoder; ``explained``: part of the variance of the deflection that the
    torque explains in addition to skew and offset.
    """

    stiffness: float | None
    interval: tuple[float, float] | None
    skew_s: float
    explained: float
    doubt: str = ""

    def without_interval(self, doubt: str) -> GearDeflection:
        """The stiffness alone, for a reason."""
        return replace(self, interval=None, doubt=doubt)

    @property
    def sentence(self) -> str:
        """The result in words."""
        if self.interval is None and self.stiffness is None:
            return f"not identifiable; torques of a fit that is {self.doubt!r}"
        if self.interval is None:
            return f"{self.stiffness:.3g}, no interval: the fit of the torques is {self.doubt!r}"
        low, high = self.interval
        if self.stiffness is None and np.isinf(low):
            return "not identifiable: no deflection follows the torque"
        if self.stiffness is None:
            return f"not identifiable: the stiffness is above {low:.3g}, a rigid gear is possible"
        return f"{self.stiffness:.3g} ({low:.3g} to {high:.3g}), skew {1e3 * self.skew_s:.2f} ms"


def gear_deflection(
    t: np.ndarray, q_motor: np.ndarray, q_link: np.ndarray, tau: np.ndarray, *, seed: int = 0
) -> GearDeflection:
    """Fit stiffness, skew and offset of one gear.

    Parameters
    ----------
    t : array (n,) [s]
        Equal steps.
    q_motor, q_link : arrays (n,) [rad or m]
        Encoders on the motor and on the link, both on the arm side.
    tau : array (n,) [N m or N]
        Torque through the gear, arm side, such as `RigidFit.gear_torques`.
    seed : int
        Of the bootstrap.

    Raises
    ------
    ArgumentError
        Arrays of different lengths, numbers that are not finite, or a record shorter than ten
        blocks.
    """
    arrays = [np.asarray(x, dtype=float) for x in (t, q_motor, q_link, tau)]
    if any(x.shape != arrays[0].shape or x.ndim != 1 for x in arrays):
        raise ArgumentError(
            f"deflection: given shapes {', '.join(str(x.shape) for x in arrays)}, expected four "
            "(n,)"
        )
    if not all(np.isfinite(x).all() for x in arrays):
        raise ArgumentError("deflection: given numbers that are not finite, expected finite ones")
    step = float(arrays[0][-1] - arrays[0][0]) / max(len(t) - 1, 1)
    length = max(1, round(BLOCK_S / step))
    blocks = len(t) // length
    if blocks < 10:
        raise ArgumentError(
            f"deflection: given {len(t) * step:.3g} s, expected {10 * BLOCK_S} s at least"
        )
    speed = np.gradient(arrays[1], step)
    difference = arrays[1] - arrays[2]
    columns = np.column_stack([arrays[3], speed, np.ones_like(speed)])
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    # normal equations of each block: a draw is a sum of them
    X = (columns / scale)[: blocks * length].reshape(blocks, length, 3)
    y = difference[: blocks * length]
    A = np.einsum("bij,bik->bjk", X, X)
    b = np.einsum("bij,bi->bj", X, y.reshape(blocks, length))
    found = np.linalg.solve(A.sum(axis=0), b.sum(axis=0)) / scale
    drawn = np.random.default_rng(seed).integers(0, blocks, (DRAWS, blocks))
    compliance = (
        np.linalg.solve(A[drawn].sum(axis=1), b[drawn].sum(axis=1)[..., None])[:, 0, 0] / scale[0]
    )
    low, high = np.quantile(compliance, INTERVAL)
    without = np.linalg.lstsq(columns[:, 1:], difference, rcond=None)[0]
    rest = difference - columns @ found
    all_of_it = difference - columns[:, 1:] @ without
    return GearDeflection(
        stiffness=None if low <= 0 or found[0] <= 0 else float(1 / found[0]),
        interval=(
            float(1 / high) if high > 0 else float("inf"),
            float(1 / low) if low > 0 else float("inf"),
        ),
        skew_s=float(found[1]),
        explained=float(1 - np.var(rest) / max(np.var(all_of_it), 1e-300)),
    )
