"""Linear quadratic control on the measured state about the feedforward, with gains by pose.

    u = u_ff - K (x - x_ref),   x = (q_a, q_m, v_a, v_m, torques under way less their feedforward)

The cost is that of `flexgen.feedback.laws.lq`. Speeds that are not measured are differences of two
samples, of the measurement as of the reference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import is_number
from flexgen.feedback.laws.lq import regulator, torque_scale
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.feedback.loop.model_law import ModelLaw
from flexgen.feedback.loop.sampled_model import PoseModels
from flexgen.feedback.sampled_plant import sample_model

PARTS = 40  # of the motion with gains of their own


@checked_class
@dataclass(frozen=True)
class LQ(ModelLaw):
    """Linear quadratic control on the state: motor and arm angles with their differences, or the
    exact state.

    Parameters
    ----------
    rho : float
        Weight of the torque, relative to a deviation of the output of 1 mm (angles: 1 mrad) at the
        largest torque of the model file (at 1 N m where it has none).

    Raises
    ------
    ArgumentError
        ``rho`` is out of range; in the loop: a gear is rigid, or an arm angle is not measured.

    Examples
    --------
    >>> run = flexgen.control("elbow", controller=flexgen.LQ(rho=1.0), exact_state=True)
    >>> {pose: margins.stable for pose, margins in run.margins().items()}
    {'begin': True, 'middle': True, 'end': True}
    """

    rho: float = 1.0

    def __post_init__(self) -> None:
        if not (is_number(self.rho) and self.rho > 0):
            raise ArgumentError(f"controller, rho: given {self.rho!r}, expected a number > 0")

    @property
    def title(self) -> str:
        """Name in tables."""
        return f"LQ, rho {self.rho:.3g}"

    def bound(self, motion: LawMotion) -> Linear:
        """The controller for a planned motion: gains of the regulator at up to `PARTS` parts of
        it.

        ArgumentError where the robot has rigid gears, or a coordinate has no link encoder;
        SolverError where a pose has no gain.
        """
        model = motion.model
        n_a = motion.model.n_a
        n_m = motion.model.n_m
        if model.dof != n_a + n_m:
            raise ArgumentError(
                f"controller LQ: given the model {model.name} with rigid gears, expected "
                "elastic ones"
            )
        links = motion.link_channels("LQ")
        samples = -(-len(motion.reference.time) // PARTS)
        points = motion.reference.parts(samples)
        poses = PoseModels(model)
        n_y = (
            n_m
            + sum(len(s.channels) for s in model.sensors)
            + (2 * (n_a + n_m) if motion.exact_state else 0)
        )
        matrices = []
        for k in range(len(points[0])):
            check_time("gains of the controller")
            at = poses.at([x[k : k + 1] for x in points])
            F, G = sample_model(at.A, at.B, motion.sample_s, motion.delay_s)
            K = regulator(at, F, G, self.rho, torque_scale(model))
            matrices.append(self._part(K, motion, links, n_y))
        A, B, C, D = (np.array(x) for x in zip(*matrices, strict=True))
        return Linear(A, B, C, D, samples)

    def _part(
        self, K: np.ndarray, motion: LawMotion, links: np.ndarray | None, n_y: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """``A, B, C, D`` from ``y_ref - y`` to torques for the gain ``K`` (n_m, size) of one pose.

        States: last angles (without an exact state, for speeds by differences), and torques on
        their way. ``links``: channels of the link encoders; ``n_y``: number of channels.
        """
        n_a = motion.model.n_a
        n_m = motion.model.n_m
        h = motion.sample_s
        n = n_a + n_m
        under_way = K.shape[1] - 2 * n
        of_angles = K[:, :n]
        of_speeds = K[:, n : 2 * n]
        of_torques = K[:, 2 * n :]
        angles = np.zeros((n, n_y))
        speeds = np.zeros((n, n_y))
        if motion.exact_state:
            first = motion.state_channel
            arm = np.arange(n_a)
            motors = np.arange(n_m)
            angles[arm, first + arm] = 1.0
            speeds[arm, first + n_a + arm] = 1.0
            angles[n_a + motors, first + 2 * n_a + motors] = 1.0
            speeds[n_a + motors, first + 2 * n_a + n_m + motors] = 1.0
            last = np.zeros((n_m, 0))
        else:
            assert links is not None
            angles[np.arange(n_a), links] = 1.0
            angles[n_a + np.arange(n_m), np.arange(n_m)] = 1.0
            speeds = angles / h
            last = -of_speeds / h
        n_last = last.shape[1]
        C = np.hstack([last, -of_torques])
        D = of_angles @ angles + of_speeds @ speeds
        A = np.zeros((n_last + under_way, n_last + under_way))
        B = np.zeros((n_last + under_way, n_y))
        B[:n_last] = angles if n_last else np.zeros((0, n_y))
        if under_way:
            for k in range(under_way // n_m - 1):
                rows = slice(n_last + k * n_m, n_last + (k + 1) * n_m)
                A[rows, n_last + (k + 1) * n_m : n_last + (k + 2) * n_m] = np.eye(n_m)
            A[n_last + under_way - n_m :] = C
            B[n_last + under_way - n_m :] = D
        return A, B, C, D
