"""Whether the sampled loop of a linear feedback of angles and speeds is stable at poses of a
motion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flexgen.analysis.second_order import motor_rows
from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws.chain import STABLE
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels
from flexgen.feedback.sampled_plant import sample_model

POSES = 7  # of the motion: its start, its end, and between them
Feedback = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def pose_eigenvalue(
    pose: PoseModel,
    of_angles: np.ndarray,
    of_speeds: np.ndarray,
    sample_s: float,
    delay_s: float,
    differences: bool,
) -> float:
    """Largest size of an eigenvalue of the sampled loop with
    ``u = -(of_angles y + of_speeds y')``.

    ``of_angles``, ``of_speeds`` (n_m, n): of the coordinates y of the linear model;
    ``differences``: y' is the difference of two samples.
    """
    F, G = sample_model(pose.A, pose.B, sample_s, delay_s)
    n = len(pose.A) // 2
    size = len(F)
    K = np.zeros((len(of_angles), size))
    last = np.zeros((len(of_angles), n))
    K[:, :n] = of_angles
    if differences:
        K[:, :n] += of_speeds / sample_s
        last = of_speeds / sample_s
    else:
        K[:, n : 2 * n] = of_speeds
    keep = np.hstack([np.eye(n), np.zeros((n, size - n))])
    loop = np.block([[F - G @ K, G @ last], [keep, np.zeros((n, n))]])
    return float(np.abs(np.linalg.eigvals(loop)).max())


def check_pose_loop(motion: LawMotion, feedback: Feedback, given: str) -> None:
    """ArgumentError where the loop is unstable at the start or the end of the motion, or at a pose
    between them.

    Parameters
    ----------
    motion : LawMotion
    feedback : callable
        Gains of arm and motor angles and of their speeds, (n_m, n_a + n_m) each, at an arm
        position (n_a,).
    given : str
        Which parameter was given, for the message.
    """
    reference = motion.reference
    model = motion.model
    # (q_a, q_m) from the model's coordinates
    rows = np.vstack([np.eye(model.n_a, model.dof), motor_rows(model)])
    poses = PoseModels(model)
    found = []
    for instant in np.linspace(reference.begin, reference.end, POSES):
        k = int(np.abs(reference.time - instant).argmin())
        points = reference.points(np.array([k]))
        of_angles, of_speeds = (gain @ rows for gain in feedback(points[0][0]))
        size = pose_eigenvalue(
            poses.at(points),
            of_angles,
            of_speeds,
            motion.sample_s,
            motion.delay_s,
            not motion.exact_state,
        )
        found.append((size if np.isfinite(size) else np.inf, instant - reference.begin))
    size, instant = max(found)
    if not size < STABLE:
        raise ArgumentError(
            f"controller, {given}, with which the loop is unstable at the pose {instant:.4g} s "
            f"after the begin of the motion, at {1e3 * motion.sample_s:g} ms and a delay of "
            f"{1e3 * motion.delay_s:g} ms (largest eigenvalue {size:.4g}); expected eigenvalues "
            "below 1: change the gains, the sample time or the delay"
        )
