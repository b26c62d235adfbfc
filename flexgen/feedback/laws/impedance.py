"""Springs and dampers between the planned motion and the robot, about the feedforward of the
elastic robot.

    u = u_ff + (1 + k_t) A' (K A e + D A e') + k_t eta^-T (tau_d - tau),    e = q_m,d - q_m
    A = J_g eta^-1 at the tool,  eta^-1 at the joints

e': difference of two samples; tau: measured torques of the gears; J_g: columns of the Jacobian of
the actuated coordinates on the planned motion. The feedback of torques makes the inertias of the
rotors, and their friction, smaller by 1 + k_t, and leaves stiffness and damping as they are.
Errors are seen by the motors: deflections of gears and links are in series with the springs of the
law.

Sources: N. Hogan, Impedance control, ASME J. Dyn. Syst. Meas. Control 107, 1985; A.
Albu-Schaeffer, C. Ott,
G. Hirzinger, A unified passivity-based control framework for position, torque and impedance
control of flexible joint robots, Int. J. Robotics Research 26(1), 2007.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import sqrtm

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.arguments import is_number
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.margins import LoopAtPose
from flexgen.feedback.loop.model_law import LinearDesign
from flexgen.feedback.loop.plants import LocalDynamics, check_design
from flexgen.feedback.loop.sampled_model import PoseModels
from flexgen.model.elements import RobotModel

POSES = 7  # of the motion where the loop is tested
UNSTABLE = 1.0 + 1e-9  # eigenvalue; springs that are soft for the friction creep
FREE = 1e-9  # of the largest stiffness of the motors: a motion that no spring holds


@checked_class
@dataclass(frozen=True)
class Impedance(LinearDesign):
    """Stiffness and damping at the tool or at the joints, with feedback of measured joint torques;
    see the module.

    Parameters
    ----------
    tool_stiffness : sequence (3,) or (6,), optional [N/m], then [N m/rad]
        Along the axes of the world, then about them.
    joint_stiffness : sequence (n_g,), optional [N m/rad or N/m]
        Of the actuated coordinates, instead. Default: ``(2 pi frequency_hz)^2`` times the inertia
        at each of them.
    damping : sequence, optional [N s/m, N m s/rad]
        As many numbers as of the stiffness; default: by ``damping_ratio``.
    damping_ratio : float
        ``A' D A = 2 damping_ratio S (S^-1 A' K A S^-1)^(1/2) S``, S^2: inertia that the motors
        move.
    frequency_hz : float [Hz]
        Where no stiffness is given.
    torque_gain : float
        k_t, at least 0; above it the model has a sensor of type ``joint_torque`` at each gear.

    Raises
    ------
    ArgumentError
        A parameter is out of range; in the loop: a motion of the motors has no spring, a torque is
        not measured, or the sampled loop is unstable.

    Examples
    --------
    >>> soft = flexgen.Impedance(tool_stiffness=(2e4, 2e4, 2e4))  # N/m
    >>> run = flexgen.control(
    ...     "planar5_nmp", controller=soft, sample_time=1e-3, plants={"soft": {"stiffness": 0.8}}
    ... )
    >>> (
    ...     f"{1e6 * run.distance(run.nominal).max():.1f} um",
    ...     f"{1e3 * run.distance(run['soft']).max():.1f} mm",
    ... )
    ('0.0 um', '1.7 mm')
    """

    tool_stiffness: Sequence[float] | None = None
    joint_stiffness: Sequence[float] | None = None
    damping: Sequence[float] | None = None
    damping_ratio: float = 0.7
    frequency_hz: float = 4.0
    torque_gain: float = 0.0

    def __post_init__(self) -> None:
        for name in ("damping_ratio", "frequency_hz"):
            value = getattr(self, name)
            if not (is_number(value) and 0 < value <= 1e5):
                raise ArgumentError(
                    f"controller, {name}: given {value!r}, expected more than 0, at most 1e5"
                )
        if not (is_number(self.torque_gain) and 0 <= self.torque_gain <= 100):
            raise ArgumentError(
                f"controller, torque_gain: given {self.torque_gain!r}, expected 0 to 100"
            )
        for name in ("tool_stiffness", "joint_stiffness", "damping"):
            given = getattr(self, name)
            if given is not None and not all(is_number(x) and x >= 0 for x in given):
                raise ArgumentError(f"controller, {name}: given {given!r}, expected numbers >= 0")
        if self.tool_stiffness is not None and self.joint_stiffness is not None:
            raise ArgumentError(
                "controller, joint_stiffness: given with tool_stiffness, expected one of them"
            )
        if self.tool_stiffness is not None and len(self.tool_stiffness) not in (3, 6):
            raise ArgumentError(
                f"controller, tool_stiffness: given {len(self.tool_stiffness)} numbers, "
                "expected 3 (along x, y, z) or 6 (about them too)"
            )
        stiffness = self.joint_stiffness if self.tool_stiffness is None else self.tool_stiffness
        if self.damping is not None and (stiffness is None or len(self.damping) != len(stiffness)):
            expected = (
                "none without a stiffness"
                if stiffness is None
                else f"{len(stiffness)} numbers, as of it"
            )
            raise ArgumentError(
                f"controller, damping: given {len(self.damping)} numbers, expected {expected}"
            )

    @property
    def title(self) -> str:
        """Name in tables."""
        where = "at the joints" if self.tool_stiffness is None else "at the tool"
        return f"impedance {where}" + (
            f", torque feedback {self.torque_gain:g}" if self.torque_gain else ""
        )

    @property
    def _given(self) -> tuple[str, object]:
        """The parameter that the stiffness comes from, and its value."""
        names = ("tool_stiffness", "joint_stiffness", "frequency_hz")
        return next(
            (name, getattr(self, name)) for name in names if getattr(self, name) is not None
        )

    def linear(
        self,
        model: RobotModel,
        sample_s: float,
        delay_s: float,
        motion: Sequence[np.ndarray],
        samples: int = 1,
    ) -> Linear:
        """The controller for parts of a motion, of ``samples`` samples each; ``motion``: one point
        for each part.

        Motor angles have stiffness and, by differences over ``sample_s`` [s], damping; with a
        torque gain both are larger by 1 + gain, and measured gear torques are fed back.
        ArgumentError where the sampled loop is unstable at one of `POSES` points, with the delay
        [s].
        """
        check_design(model, sample_s, delay_s, motion)
        n_m = model.n_m
        n_y = n_m + sum(len(sensor.channels) for sensor in model.sensors)
        channels = self._torque_channels(model)
        inverse = np.linalg.inv(model.eta)
        stiffness, damping = self._of_motors(model, motion)
        parts = len(stiffness)
        D = np.zeros((parts, n_m, n_y))
        C = -(1 + self.torque_gain) * damping / sample_s
        D[:, :, :n_m] = (1 + self.torque_gain) * stiffness - C
        if self.torque_gain:
            D[:, :, channels] += self.torque_gain * inverse.T
        A = np.zeros((parts, n_m, n_m))
        B = np.tile(np.eye(n_m, n_y), (parts, 1, 1))
        poses = PoseModels(model)
        for k in np.unique(np.linspace(0, parts - 1, POSES).astype(int)):
            own = Linear(A[k], B[k], C[k], D[k])
            at = poses.at([x[k : k + 1] for x in motion])
            largest = LoopAtPose(at, own, sample_s, delay_s).largest_eigenvalue()
            if not largest < UNSTABLE:
                name, value = self._given
                raise ArgumentError(
                    f"controller, {name}: given {value!r}, with which the sampled loop is "
                    f"unstable at {1e3 * sample_s:g} ms and a delay of {1e3 * delay_s:g} ms "
                    f"(largest eigenvalue {largest:.6g}); expected eigenvalues below 1: less "
                    "stiffness, damping or torque_gain, a shorter sample time, or more "
                    "stiffness than gravity takes"
                )
        return Linear(A, B, C, D, samples)

    def _of_motors(
        self, model: RobotModel, motion: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and damping (parts, n_m, n_m) [N m/rad, N m s/rad] between motors and their
        references at the poses of a motion.

        ``A^T K A`` with the given stiffness K at the tool or at the joints; A: velocities there
        over those of the motors with rigid springs. Without a given damping each mode has
        ``damping_ratio`` with the inertia of the rigid robot, of which torque feedback hides a
        part of the rotors.

        Raises
        ------
        ArgumentError
            The numbers do not fit the joints, or leave a motion of the motors without stiffness.
        """
        inverse = np.linalg.inv(model.eta)
        parts = len(motion[0])
        equations = derive(model)
        M = LocalDynamics(equations).matrices(motion, np.zeros(0))[0]
        rigid = np.zeros((model.dof, model.n_m))  # motions of the robot with stiff springs
        rigid[list(model.i_g)] = inverse
        rigid[model.n_a + np.arange(len(model.i_m)), list(model.i_m)] = 1.0
        inertia = rigid.T @ M @ rigid
        A = np.tile(inverse, (parts, 1, 1))
        K = self.joint_stiffness
        if self.tool_stiffness is not None:
            K = self.tool_stiffness
            jacobians = evaluate(equations.function("jacobian"), motion[0])[0].reshape(
                parts, 6, model.n_a
            )
            A = jacobians[:, : len(K), list(model.i_g)] @ inverse
        elif K is None:
            at_joints = model.eta.T @ inertia[0] @ model.eta
            K = ((2 * np.pi * self.frequency_hz) ** 2 * np.diag(at_joints)).tolist()
        if len(K) != A.shape[1]:
            raise ArgumentError(
                f"controller, joint_stiffness: given {len(K)} numbers, expected {model.n_g}"
            )
        stiffness = A.transpose(0, 2, 1) @ np.diag(K) @ A
        least, most = np.linalg.eigvalsh(stiffness)[:, [0, -1]].T
        if not (least > FREE * most).all():
            name, value = self._given
            raise ArgumentError(
                f"controller, {name}: given {value!r}, which leaves a motion of the motors free "
                "at a pose of the path, expected a spring for each: tool_stiffness with 6 "
                "numbers above 0, or joint_stiffness"
            )
        if self.damping is not None:
            return stiffness, A.transpose(0, 2, 1) @ np.diag(self.damping) @ A
        own = [motor.inertia * self.torque_gain / (1 + self.torque_gain) for motor in model.motors]
        pairs = zip(stiffness, inertia - np.diag(own), strict=True)
        return stiffness, np.array([2 * self.damping_ratio * _critical(K, M) for K, M in pairs])

    def _torque_channels(self, model: RobotModel) -> list[int]:
        """The measured channels of the torques of the gears; ArgumentError where one is missing,
        late or not usable.
        """
        if not self.torque_gain:
            return []
        found = dict[str, int]()
        at = model.n_m
        for sensor in model.sensors:
            if sensor.type == "joint_torque" and sensor.delay_s == 0:
                found.setdefault(sensor.place, at)
            at += len(sensor.channels)
        names = [model.coordinates[i].name for i in model.i_g]
        missing = [name for name in names if name not in found]
        if missing:
            raise ArgumentError(
                f"controller, torque_gain: given {self.torque_gain:g} and the model "
                f"{model.name} without a sensor of type joint_torque, with delay_s = 0, at "
                f"{', '.join(missing)}, expected one at each gear"
            )
        if len(model.i_m) < model.n_m:
            raise ArgumentError(
                f"controller, torque_gain: given {self.torque_gain:g} and the model "
                f"{model.name} with rigid gears, whose torques follow the motors at once, "
                "expected 0"
            )
        return [found[name] for name in names]


def _critical(K: np.ndarray, M: np.ndarray) -> np.ndarray:
    """``M^(1/2) (M^(-1/2) K M^(-1/2))^(1/2) M^(1/2)``: half the damping without overshoot of all
    modes.
    """
    root = np.real(sqrtm(M))
    back = np.linalg.inv(root)
    inner = back @ K @ back
    return np.asarray(root @ np.real(sqrtm((inner + inner.T) / 2)) @ root)
