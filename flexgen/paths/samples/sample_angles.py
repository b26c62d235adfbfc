"""Samples of a tool path with the angle of the tool about one axis as a fourth column.

The angle of a sample is that of its column ``angle``, or follows from its orientation, which must
be that of the tool at the start of the move rotated about the axis of the output; without either
it is that at the start. Whole turns are counted: from row to row less than half a turn, and the
first row is within half a turn of the start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.model.elements import RobotModel
from flexgen.paths.geometry.jets import quaternion, quaternion_product
from flexgen.paths.geometry.segments import POSITION
from flexgen.paths.samples.sample_files import Samples

# rad: tilt of a sampled orientation from that of the tool that is rounding of the file, as of the
# length of a quaternion
SAME_TILT = 1e-3


def with_angles(samples: Samples, model: RobotModel, start: np.ndarray, R: np.ndarray) -> Samples:
    """The samples with the angle after their position, without orientations.

    Parameters
    ----------
    samples : Samples
        Of the tool.
    model : RobotModel
        Its output has an angle.
    start : array (4,)
        Position [m] and angle [rad] of the tool at the start of the move.
    R : array (3, 3)
        Its orientation there.

    Raises
    ------
    ArgumentError
        An orientation has another tilt.
    """
    n = len(samples.values)
    if samples.angles is not None:
        angles = samples.angles
    elif samples.quaternions is not None:
        angles = start[POSITION] + _rotations(samples.quaternions, model, R)
    else:
        angles = np.full(n, start[POSITION])
    angles = np.unwrap(angles)
    angles = angles - 2 * np.pi * np.round((angles[0] - start[POSITION]) / (2 * np.pi))
    values = np.column_stack([samples.values, angles])
    return replace(samples, values=values, names=(*samples.names, "angle"), quaternions=None)


def _rotations(q: np.ndarray, model: RobotModel, R: np.ndarray) -> np.ndarray:
    """Angles (n,) [rad] about the axis of the output from R to the orientations q (n, 4)."""
    back = quaternion(R.T)
    turned = quaternion_product(q[:, :, None], np.broadcast_to(back, q.shape)[:, :, None])[:, :, 0]
    axis = np.array(model.output.rotation_axis)
    along = turned[:, 1:] @ axis
    across = np.linalg.norm(turned[:, 1:] - along[:, None] * axis, axis=1)
    off = 2 * np.arcsin(np.minimum(across, 1.0))
    worst = int(np.argmax(off))
    if off[worst] > SAME_TILT:
        raise ArgumentError(
            f"samples: given an orientation in sample {worst + 1} that is tilted by "
            f"{np.degrees(off[worst]):.3g} deg from that of the tool at the start of the move, "
            f"expected rotations about the axis of the output {model.output.axis_text} only, or a "
            "column angle [rad]"
        )
    return 2 * np.arctan2(along, turned[:, 0])
