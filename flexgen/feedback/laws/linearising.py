"""Feedback linearization of arms with elastic joints, and its rigid limit, the computed torque.

    T = spring(eta^-1 q_m - q);  a = M^-1 (T - h);  j = da/dt      from the state
    tau = J_m eta (a + d'') + f(v_m) + eta^-T T
    s = q_d'''' + g_3 (j_d - j) + g_2 (a_d - a) + g_1 (v_d - v) + g_0 (q_d - q)

with ``h = c + g - f_a`` and the deflection d for which the fourth derivative of q is s. Damping of
the gears is left out: see `flexgen.dynamics.mechanics.flexible_joint`.

Sources: M. W. Spong, ASME J. Dyn. Syst. Meas. Control 109, 1987; S. Moberg and S. Hanssen, On
feedback linearization for robust tracking control of flexible joint robots, IFAC World
Congress 2008.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.arguments import is_number
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.signatures import FLEXIBLE_JOINT
from flexgen.feedback.laws.bound import COMPUTED_TORQUE, LINEARISATION, BoundLaw
from flexgen.feedback.laws.chain import FORMS, FormName, stable_gains
from flexgen.feedback.laws.stability import check_pose_loop
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.feedback.loop.model_law import ModelLaw
from flexgen.model.abilities import obstacle

HIGHEST_HZ = 1e5


def check_frequency(value: float, name: str = "frequency_hz") -> None:
    """ArgumentError for a frequency that is not a positive number [Hz]."""
    if not (is_number(value) and 0 < value <= HIGHEST_HZ):
        raise ArgumentError(
            f"controller, {name}: given {value!r}, expected more than 0, up to {HIGHEST_HZ:g} Hz"
        )


@checked_class
@dataclass(frozen=True)
class FeedbackLinearisation(ModelLaw):
    """Feedback linearization of a robot whose arm coordinates are all driven through springs.

    Each arm coordinate becomes a chain of four integrators with all poles at
    ``-2 pi frequency_hz``. The law measures motor and arm angles (sensors of type
    ``link_encoder``; speeds are differences of two samples) or the exact state
    (``flexgen.control(..., exact_state=True)``).

    Parameters
    ----------
    frequency_hz : float [Hz]
    form : str
        ``"continuous"``: gains of ``(p + w)^4``; ``"discrete"``: of the chain that is sampled with
        a hold.
    predict : bool
        The state is predicted over the delay and half a sample, with the torques under way.
    allow_unstable : bool
        No error for poles with which the sampled chain is unstable.

    Raises
    ------
    ArgumentError
        A parameter is out of range; in the loop: the model does not fit, an arm angle is not
        measured, or the sampled chain of integrators is unstable.

    Examples
    --------
    >>> run = flexgen.control(
    ...     "elbow", controller=flexgen.FeedbackLinearisation(frequency_hz=10.0), exact_state=True
    ... )
    >>> f"{1e6 * run.distance(run.nominal).max():.0f} um"
    '79 um'
    """

    frequency_hz: float = 16.0
    form: FormName = "continuous"
    predict: bool = False
    allow_unstable: bool = False

    def __post_init__(self) -> None:
        check_frequency(self.frequency_hz)
        if self.form not in FORMS:
            raise ArgumentError(
                f"controller, form: given {self.form!r}, expected one of {', '.join(FORMS)}"
            )

    @property
    def title(self) -> str:
        """Name in tables."""
        extra = ", predicted" if self.predict else ""
        return f"feedback linearization, {self.form}{extra}, {self.frequency_hz:.3g} Hz"

    def bound(self, motion: LawMotion) -> BoundLaw:
        """The law for a planned motion: gains of a chain of four integrators, and a table with the
        reference ``q v a j s``, with prediction at two instants (after the delay, and half a
        sample later).

        ArgumentError where the robot is not one of elastic joints, a link encoder is missing, or
        the loop is unstable.
        """
        model = motion.model
        reason = obstacle(model, "elastic joints")
        if reason is not None:
            raise ArgumentError(f"controller FeedbackLinearisation: {reason}")
        timing = motion.timing(self.predict)
        gains = stable_gains(self.frequency_hz, 4, self.form, timing, self.allow_unstable)
        uses = ("motion", "torque", "dynamics")
        library = library_with(model, [*FLEXIBLE_JOINT, "forward_dynamics"])
        whole = (timing.delay_s, timing.ahead_s) if self.predict else (0.0,)
        n = len(motion.reference.time)
        table = np.hstack([motion.difference(motion.arm(ahead)).reshape(n, -1) for ahead in whole])
        return BoundLaw(
            LINEARISATION,
            model,
            library,
            uses,
            timing,
            table,
            np.tile(gains[:, None], (1, model.n_m)),
            motion.state_channel,
            motion.link_channels("FeedbackLinearisation"),
            motion.reference.held[0],
            motion.steps_per_s,
        )


@checked_class
@dataclass(frozen=True)
class ComputedTorque(ModelLaw):
    """Computed torque of the rigid robot from the motor angles, the limit of feedback
    linearization for stiff springs.

        a = a_d + 2 w (v_d - v) + w^2 (q_d - q),   q = eta^-1 q_m
        tau = J_m eta a + f(v_m) + eta^-T (M a + c + g - f_a)

    The deflections of the springs are not compensated. ``frequency_hz``: w / (2 pi); speeds are
    differences of two samples, or exact with ``flexgen.control(..., exact_state=True)``.

    Raises
    ------
    ArgumentError
        A parameter is out of range; in the loop: the model has coordinates without motor, or the
        loop is unstable.

    Examples
    --------
    >>> run = flexgen.control(
    ...     "elbow", controller=flexgen.ComputedTorque(frequency_hz=5.0), exact_state=True
    ... )
    >>> f"{1e6 * run.distance(run.nominal).max():.0f} um"
    '965 um'
    """

    frequency_hz: float = 4.0
    allow_unstable: bool = False

    def __post_init__(self) -> None:
        check_frequency(self.frequency_hz)

    @property
    def title(self) -> str:
        """Name in tables."""
        return f"computed torque, {self.frequency_hz:.3g} Hz"

    def bound(self, motion: LawMotion) -> BoundLaw:
        """The law for a planned motion: gains ``w^2, 2 w`` of a double pole at w = 2 pi f, and a
        table with the reference ``q v a``.

        ArgumentError where the law does not take the robot, or the loop is unstable.
        """
        model = motion.model
        timing = motion.timing()
        reason = obstacle(model, "computed torque")
        if reason is not None:
            raise ArgumentError(f"controller ComputedTorque: {reason}")
        w = 2 * np.pi * self.frequency_hz
        gains = np.array([w * w, 2 * w, 0.0, 0.0])
        if not self.allow_unstable:
            self._check(motion, gains)
        library = library_with(model, ["inversion_rows", "motor_friction"])
        table = motion.difference(motion.arm(0.0)[:, :3]).reshape(len(motion.reference.time), -1)
        return BoundLaw(
            COMPUTED_TORQUE,
            model,
            library,
            ("rows", "friction"),
            timing,
            table,
            np.tile(gains[:, None], (1, model.n_m)),
            motion.state_channel,
            None,
            motion.reference.held[0],
            motion.steps_per_s,
        )

    def _check(self, motion: LawMotion, gains: np.ndarray) -> None:
        """Refuse gains (4,) with which the sampled loop of the linearized robot is unstable.

        Rigid gears: the law makes chains of two integrators, which are tested as such. Elastic
        gears: the eigenvalues at poses of the motion are computed.
        """
        model = motion.model
        inverse = np.linalg.inv(motion.model.eta)
        # behind rigid gears the law makes chains of two integrators
        if model.dof < model.n_a + model.n_m:
            stable_gains(self.frequency_hz, 2, "continuous", motion.timing())
        if model.dof == model.n_a:
            return

        def feedback(q_a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Gains (n_m, n_m + n_a columns of the coordinates) on angles and speeds at a pose
            ``q_a`` (n_a,): those of the motors times the inertia that the law assumes.
            """
            M = evaluate(motion.equations.function("mass_matrix"), q_a[None])[0].reshape(
                model.n_a, model.n_a
            )
            per = (
                np.diag([m.inertia for m in model.motors]) @ model.eta + inverse.T @ M
            ) @ inverse
            none = np.zeros((model.n_m, model.n_a))
            return np.hstack([none, gains[0] * per]), np.hstack([none, gains[1] * per])

        check_pose_loop(motion, feedback, f"frequency_hz: given {self.frequency_hz:g} Hz")
