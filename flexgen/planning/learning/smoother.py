"""Fixed-interval smoother along a planned motion: deviation of the arm, estimated from a complete
record of motor angles and accelerations.

    x' = A x + B (du + d) + E f,    f' = -f/T + noise,    d' = noise,
    dy = C x + D (du + d) + D_f f + noise

x: state minus reference; d: torques on the motors; f: forces on the coordinates of the arm, the
errors of the model: springs of other stiffness and other loads. A fifth of the change of the arm's
forces along the motion is expected. The filter with stationary gains at each pose runs forwards,
the smoother of Rauch, Tung and Striebel backwards, so that estimates have no delay. Means of the
measurements at rest before the motion are subtracted: accelerometers do not measure the rest
position of the arm, and their bias is unknown.

Source: H. Rauch, F. Tung, C. Striebel, AIAA Journal 3(8), 1965.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from flexgen.base.calls.deadline import check_time
from flexgen.base.numerics.riccati import riccati
from flexgen.codegen.build.model_library import library_with
from flexgen.feedback.loop.channels import Channels
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.reference import MotionReference
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels, elastic_gears
from flexgen.feedback.sampled_plant import hold_effects

PARTS = 40  # of the motion, each with gains of its own
# of the arm's forces: of springs, others; s
MODEL_ERROR = 0.2
LOAD_ERROR = 0.02
MODEL_TIME = 0.3
TORQUE_NOISE = 1e-3  # of the largest torque: noise
DISTURBANCE_RATE = 0.1  # and growth in a second
REST_S = 0.5  # before the motion: where means are taken
LEAST_FORCE = 1e-3  # of the largest one: of a coordinate that feels none


class PathSmoother:
    """Deviation of the arm from a reference by a smoother; see the module.

    Parameters
    ----------
    channels : Channels
        The measured channels.
    reference : MotionReference
    sample_s : float [s]

    Raises
    ------
    SolverError
        No gain exists at a pose.
    """

    def __init__(self, channels: Channels, reference: MotionReference, sample_s: float) -> None:
        self.channels = channels
        self.model = channels.model
        self.sample_s = sample_s
        self.samples = -(-len(reference.time) // PARTS)
        self._begin = int(np.searchsorted(reference.time, reference.begin))
        self._torque = Noises(self.model, TORQUE_NOISE, DISTURBANCE_RATE)
        self._force = self._forces(reference)
        poses = PoseModels(self.model)
        motion = reference.parts(self.samples)
        found = []
        for k in range(len(motion[0])):
            check_time("gains of the smoother")
            found.append(self._gains(poses.at([x[k : k + 1] for x in motion])))
        self._F, self._G, self._C, self._D, self._M, self._J = (
            np.array(x) for x in zip(*found, strict=True)
        )

    def _forces(self, reference: MotionReference) -> np.ndarray:
        """Expected errors of the model (n_a,): a share of the change of the arm's forces along the
        motion.
        """
        m = reference.motion
        tau = np.asarray(
            library_with(self.model, ["inverse_dynamics"]).inverse_dynamics(
                m["q_a"], m["v_a"], m["a_a"]
            )
        )
        change = np.abs(tau - tau[0]).max(axis=0)
        change = np.maximum(change, LEAST_FORCE * max(float(change.max()), 1e-3))
        model = self.model
        geared = elastic_gears(model)
        share = np.full(model.n_a, MODEL_ERROR)
        share[geared] = LOAD_ERROR
        return np.concatenate([share * change, MODEL_ERROR * change[geared]])

    def _gains(self, at: PoseModel) -> tuple[np.ndarray, ...]:
        """Sampled model, gain of the filter, and gain of the smoother at a pose; f in units of its
        expected size.
        """
        n_x = len(at.A)
        n_m = self.model.n_m
        h = self.sample_s
        index = self.channels.index
        G, E = (hold_effects(at.A, x, h, 0.0)[1] for x in (at.B, at.arm * self._force))
        n_a = E.shape[1]
        largest = self._torque.largest
        n_z = n_x + n_m + n_a
        F = np.eye(n_z)
        Q = np.zeros((n_z, n_z))
        F[:n_x, :n_x] = expm(at.A * h)
        F[:n_x, n_x : n_x + n_m] = G * largest
        F[:n_x, n_x + n_m :] = E
        fade = np.exp(-h / MODEL_TIME)
        F[n_x + n_m :, n_x + n_m :] *= fade
        noisy = G * (self._torque.torque * largest)
        Q[:n_x, :n_x] += noisy @ noisy.T
        Q[n_x : n_x + n_m, n_x : n_x + n_m] += np.eye(n_m) * self._torque.rate**2 * h
        Q[n_x + n_m :, n_x + n_m :] += np.eye(n_a) * (1 - fade**2)
        C = np.hstack([at.C, at.D * largest, at.D_arm * self._force])[index]
        R = np.diag(self.channels.noise**2)
        P = riccati(F.T, C.T, Q, R)
        M = np.linalg.solve(C @ P @ C.T + R, C @ P).T
        kept = np.eye(n_z) - M @ C
        filtered = kept @ P @ kept.T + M @ R @ M.T
        scale = 1.0 / np.sqrt(np.diag(P))
        scaled = P * scale[:, None] * scale
        J = np.linalg.solve(scaled, (F @ filtered) * scale[:, None]).T * scale
        return F, np.vstack([G, np.zeros((n_m + n_a, n_m))]), C, at.D[index], M, J

    def deviation(self, dy: np.ndarray, du: np.ndarray) -> np.ndarray:
        """Arm coordinates minus reference (n, n_a).

        Parameters
        ----------
        dy : array (n, n_y)
            Measurements minus those on the reference.
        du : array (n, n_m) [N m]
            Torques that acted since the last sample, minus those of the reference.
        """
        rest = slice(max(0, self._begin - round(REST_S / self.sample_s)), max(1, self._begin))
        dy = dy - dy[rest].mean(axis=0)
        du = du - du[rest].mean(axis=0)
        count = len(dy)
        n_z = self._F.shape[1]
        before = np.zeros((count, n_z))
        after = np.zeros((count, n_z))
        z = np.zeros(n_z)
        part = np.minimum(np.arange(count) // self.samples, len(self._F) - 1)
        for k in range(count):
            p = part[k]
            before[k] = self._F[p] @ z + self._G[p] @ du[k]
            z = before[k] + self._M[p] @ (dy[k] - self._C[p] @ before[k] - self._D[p] @ du[k])
            after[k] = z
        for k in range(count - 2, -1, -1):
            after[k] += self._J[part[k + 1]] @ (after[k + 1] - before[k + 1])
        return after[:, : self.model.n_a]


def acting(torque: np.ndarray, whole: int, rest: float) -> np.ndarray:
    """Means of the acting torques between samples (n, n_m), from the commanded ones, which act
    with a delay of ``whole`` samples and the fraction ``rest`` of one.
    """
    at = np.arange(len(torque)) - 1 - whole
    now, last = (torque[np.maximum(x, 0)] for x in (at, at - 1))
    return np.asarray((1 - rest) * now + rest * last)
