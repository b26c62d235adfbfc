"""Linear feedback of motors and joint torques: Tomei's PD with gravity compensation, and joint
torque feedback.

Sources: P. Tomei, A simple PD controller for robots with elastic joints, IEEE TAC 36(10), 1991; A.
Albu-Schaeffer and G. Hirzinger, State feedback controller for flexible joint robots, IROS 2000.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.arguments import is_number
from flexgen.codegen.build.model_library import library_with
from flexgen.feedback.laws.bound import JOINT_TORQUE, BoundLaw
from flexgen.feedback.laws.linearising import check_frequency
from flexgen.feedback.laws.stability import check_pose_loop
from flexgen.feedback.loop.gains import motor_inertias
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.feedback.loop.model_law import ModelLaw
from flexgen.model.abilities import obstacle

POSES = 40  # of the motion where Tomei's condition is tested


def _vector(
    given: Sequence[float] | np.ndarray, name: str, n: int, signed: bool = False
) -> np.ndarray:
    """The parameter ``name`` of a law as ``n`` numbers, one for each motor; ``signed``: they may
    be negative. ArgumentError for another length or another kind.
    """
    _check_vector(given, name, signed)
    if len(given) != n:
        what = "finite numbers" if signed else "numbers > 0"
        raise ArgumentError(
            f"controller, {name}: given {given!r}, expected {n} {what}, one for each motor"
        )
    return np.array(given, dtype=float)


def _check_vector(given: Any, name: str, signed: bool = False) -> None:
    """ArgumentError for gains that are not numbers in a row; None means no gains."""
    if given is None:
        return
    row = isinstance(given, list | tuple) or (isinstance(given, np.ndarray) and given.ndim == 1)
    if not row or not all(is_number(x) and (signed or x > 0) for x in given):
        what = "finite numbers" if signed else "numbers > 0"
        raise ArgumentError(
            f"controller, {name}: given {given!r}, expected {what}, one for each motor"
        )


def _refuse(model_reason: str | None, law: str) -> None:
    if model_reason is not None:
        raise ArgumentError(f"controller {law}: {model_reason}")


@checked_class
@dataclass(frozen=True)
class TomeiPD(ModelLaw):
    """Passivity-based PD control of the motors with gravity compensation, stable at every pose for
    elastic joints.

        u = eta^-T g(q_d) + k_p (q_m,d - q_m) + k_d (v_m,d - v_m),
        q_m,d at rest: eta (q_d + K^-1 g(q_d))

    It needs motor angles only, and no model but gravity and stiffness. The gains must be large
    enough that the position is unique (Tomei 1991): the smallest eigenvalue of
    ``[[K, -K], [-K, K + eta' k_p eta]]`` above the largest norm of dg/dq, which is tested on the
    motion.

    Parameters
    ----------
    frequency_hz, damping : float
        ``k_p = w^2 J``, ``k_d = 2 damping w J`` with ``w = 2 pi frequency_hz`` and the inertia J
        of each motor with stiff springs at the start.
    k_p, k_d : sequence (n_m,) [N m/rad, N m s/rad], optional
        The gains themselves, instead.
    feedforward : bool
        The feedforward torque of the motion instead of gravity alone; at rest they are the same.

    Raises
    ------
    ArgumentError
        A parameter is out of range; in the loop: the model does not fit, the gains are too small
        for gravity, or the sampled loop is unstable.

    Examples
    --------
    >>> run = flexgen.control("elbow", controller=flexgen.TomeiPD(frequency_hz=5.0))
    >>> f"{1e6 * run.distance(run.nominal).max():.0f} um"
    '4765 um'
    """

    frequency_hz: float = 6.0
    damping: float = 1.0
    k_p: Sequence[float] | None = None
    k_d: Sequence[float] | None = None
    feedforward: bool = False

    def __post_init__(self) -> None:
        check_frequency(self.frequency_hz)
        check_frequency(self.damping, "damping")
        _check_vector(self.k_p, "k_p")
        _check_vector(self.k_d, "k_d")
        if (self.k_p is None) != (self.k_d is None):
            raise ArgumentError("controller, k_p, k_d: given one of them, expected both or none")

    @property
    def title(self) -> str:
        """Name in tables."""
        return f"Tomei PD, {self.frequency_hz:.3g} Hz" if self.k_p is None else "Tomei PD"

    def _gains(self, motion: LawMotion) -> tuple[np.ndarray, np.ndarray]:
        """``k_p`` [N m/rad] and ``k_d`` [N m s/rad], (n_m,) each: the given ones, or those of
        ``frequency_hz`` and ``damping`` with the inertia J that the motors see at the start, ``k_p
        = w^2 J``, ``k_d = 2 damping w J``.
        """
        n = motion.model.n_m
        if self.k_p is not None and self.k_d is not None:
            return _vector(self.k_p, "k_p", n), _vector(self.k_d, "k_d", n)
        J, _ = motor_inertias(motion.model, motion.reference.points(np.array([0])))
        w = 2 * np.pi * self.frequency_hz
        return w * w * J, 2 * self.damping * w * J

    def bound(self, motion: LawMotion) -> BoundLaw:
        """The law for a planned motion: a PD controller around the feedforward torque, or around
        the torque that carries gravity where ``feedforward`` is False.

        ArgumentError where the robot is not one of elastic joints, Tomei's condition does not
        hold, or the sampled loop is unstable.
        """
        model = motion.model
        n = motion.model.n_m
        _refuse(obstacle(model, "elastic joints"), "TomeiPD")
        k_p, k_d = self._gains(motion)
        _check_gravity(motion, k_p)
        none = np.zeros((n, model.n_a))
        gains = np.hstack([none, np.diag(k_p)]), np.hstack([none, np.diag(k_d)])
        check_pose_loop(motion, lambda q_a: gains, f"k_p, k_d: given {k_p}, {k_d}")
        base = motion.reference.held
        if not self.feedforward:
            g = evaluate(motion.equations.function("gravity"), motion.arm(motion.delay_s)[:, 0])[0]
            base = g.reshape(-1, n) @ np.linalg.inv(model.eta)
        motors = motion.difference(motion.motors())
        table = np.hstack([base, motors.reshape(len(base), -1), np.zeros((len(base), 2 * n))])
        return BoundLaw(
            JOINT_TORQUE,
            model,
            library_with(model, ["forward_dynamics"]),
            (),
            motion.timing(),
            table,
            np.vstack([k_p, k_d, np.zeros((2, n))]),
            motion.state_channel,
            None,
            base[0],
            motion.steps_per_s,
        )


def _check_gravity(motion: LawMotion, k_p: np.ndarray) -> None:
    """Refuse gains ``k_p`` (n_m,) [N m/rad] that violate Tomei's condition at poses of the motion:
    the smallest eigenvalue of the stiffness of springs and gains exceeds alpha, the largest norm
    of ``dg/dq_a`` [N m/rad].
    """
    model = motion.model
    reference = motion.reference
    q = ca.SX.sym("q_a", model.n_a)
    slope = ca.Function(
        "dg", [q], [ca.densify(ca.jacobian(motion.equations.function("gravity").expand()(q), q))]
    )
    at = np.unique(np.linspace(0, len(reference.time) - 1, POSES).astype(int))
    poses = evaluate(slope, reference.motion["q_a"][at])[0].reshape(-1, model.n_a, model.n_a)
    alpha = max(float(np.linalg.norm(x, 2)) for x in poses)
    law = motion.equations.function("gear_law")
    K = np.diag(evaluate(law, np.zeros((1, model.n_a)))[1].ravel())
    eta = np.array(model.eta)
    least = float(
        np.linalg.eigvalsh(np.block([[K, -K], [-K, K + eta.T @ np.diag(k_p) @ eta]])).min()
    )
    if least <= alpha:
        raise ArgumentError(
            f"controller TomeiPD: given k_p = {k_p}, with which the smallest eigenvalue of "
            f"springs and gains is {least:.4g} and gravity changes by {alpha:.4g} N m/rad; "
            "expected the first above the second: larger gains"
        )


@checked_class
@dataclass(frozen=True)
class JointTorqueFeedback(ModelLaw):
    """State feedback of motor angle, motor speed, joint torque and its rate, about the
    feedforward.

        u = u_ff + k_p (q_m,d - q_m) + k_d (v_m,d - v_m) + k_t (T_d - T) + k_s (T_d' - T')
        T = eta^-T spring(eta^-1 q_m - q)

    Parameters
    ----------
    frequency_hz : float [Hz]
        All four poles of each joint alone, with the inertia of the arm at the start, at
        ``-2 pi frequency_hz``.
    k_p, k_d, k_t, k_s : sequence (n_m,), optional
        The gains themselves, motor side [N m/rad, N m s/rad, 1, s]: all four or none.

    Raises
    ------
    ArgumentError
        A parameter is out of range; in the loop: the model does not fit, an arm angle is not
        measured, or the sampled loop is unstable.

    Examples
    --------
    >>> run = flexgen.control(
    ...     "elbow", controller=flexgen.JointTorqueFeedback(frequency_hz=10.0), exact_state=True
    ... )
    >>> f"{1e6 * run.distance(run.nominal).max():.0f} um"
    '1 um'
    """

    frequency_hz: float = 8.0
    k_p: Sequence[float] | None = None
    k_d: Sequence[float] | None = None
    k_t: Sequence[float] | None = None
    k_s: Sequence[float] | None = None

    def __post_init__(self) -> None:
        check_frequency(self.frequency_hz)
        for name in ("k_p", "k_d", "k_t", "k_s"):
            _check_vector(getattr(self, name), name, signed=True)
        if len({x is None for x in (self.k_p, self.k_d, self.k_t, self.k_s)}) != 1:
            raise ArgumentError(
                "controller, k_p, k_d, k_t, k_s: given some of them, expected all four or none"
            )

    @property
    def title(self) -> str:
        """Name in tables."""
        return "joint torque feedback" + (
            f", {self.frequency_hz:.3g} Hz" if self.k_p is None else ""
        )

    def _gains(self, motion: LawMotion, K: np.ndarray) -> np.ndarray:
        """``k_p, k_d, k_t, k_s`` (4, n_m): the given ones, or those that place the four poles of
        each joint at -2 pi f.

        ``K``: stiffness (n_a,) [N m/rad] of the gears at zero; the inertia of a link is its
        diagonal element of the mass matrix at the start.
        """
        model = motion.model
        n = motion.model.n_m
        if self.k_p is not None:
            given = {"k_p": self.k_p, "k_d": self.k_d, "k_t": self.k_t, "k_s": self.k_s}
            return np.array(
                [_vector(x, name, n, signed=True) for name, x in given.items() if x is not None]
            )
        eta = np.array(model.eta)
        if np.any(eta != np.diag(np.diag(eta))):
            raise ArgumentError(
                f"controller JointTorqueFeedback: given the model {model.name} with motors that "
                "drive several joints, expected the gains k_p, k_d, k_t, k_s instead of "
                "frequency_hz"
            )
        ratio = np.diag(eta)
        w = 2 * np.pi * self.frequency_hz
        J = np.array([m.inertia for m in model.motors]) * ratio**2
        pose = motion.reference.motion["q_a"][:1]
        M = np.diag(evaluate(motion.equations.function("mass_matrix"), pose)[0].reshape(n, n))
        # J M/K p^4 + (k_d M/K + k_s M) p^3 + (J + M + k_p M/K + k_t M) p^2 + k_d p + k_p = J M/K
        # (p + w)^4, arm side
        k_p = w**4 * J * M / K
        k_d = 4 * w**3 * J * M / K
        k_t = 6 * w**2 * J / K - J / M - 1 - k_p / K
        k_s = 4 * w * J / K - k_d / K
        return np.array([k_p / ratio**2, k_d / ratio**2, k_t, k_s])

    def bound(self, motion: LawMotion) -> BoundLaw:
        """The law for a planned motion: gains, and a table with torque, motor angle and speed,
        gear torque and its rate along the motion.

        ArgumentError where the robot is not one of elastic joints, a link encoder is missing, or
        the sampled loop is unstable.
        """
        model = motion.model
        n = motion.model.n_m
        _refuse(obstacle(model, "elastic joints"), "JointTorqueFeedback")
        _refuse(obstacle(model, "reduced problem"), "JointTorqueFeedback")
        law = motion.equations.function("gear_law")
        inverse = np.linalg.inv(model.eta)
        K = evaluate(law, np.zeros((1, n)))[1].ravel()
        gains = self._gains(motion, K)
        arms = -inverse.T @ np.diag(K)
        motors = inverse.T @ np.diag(K) @ inverse
        none = np.zeros((n, n))
        feedback = tuple(
            np.hstack([none, np.diag(own)]) + np.diag(of_torque) @ np.hstack([arms, motors])
            for own, of_torque in ((gains[0], gains[2]), (gains[1], gains[3]))
        )
        what = (
            f"frequency_hz: given {self.frequency_hz:g} Hz"
            if self.k_p is None
            else f"k_p to k_s: given {gains.tolist()}"
        )
        check_pose_loop(motion, lambda q_a: (feedback[0], feedback[1]), what)
        arm = motion.difference(motion.arm(0.0)[:, :2])
        turned = motion.difference(motion.motors())
        deflection, rate = (turned[:, k] @ inverse.T - arm[:, k] for k in range(2))
        p, dp = (x.reshape(-1, n) for x in evaluate(law, deflection))
        table = np.hstack(
            [motion.reference.held, turned[:, 0], turned[:, 1], p @ inverse, (rate * dp) @ inverse]
        )
        return BoundLaw(
            JOINT_TORQUE,
            model,
            library_with(model, ["gear_law"]),
            ("gear",),
            motion.timing(),
            table,
            gains,
            motion.state_channel,
            motion.link_channels("JointTorqueFeedback"),
            motion.reference.held[0],
            motion.steps_per_s,
        )
