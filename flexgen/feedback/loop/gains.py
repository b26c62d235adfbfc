"""Controllers by frequencies: gains of a P-PI cascade as of `flexgen.analysis.servo_gains`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.analysis import second_order
from flexgen.analysis.servo_gains import cascade_gains, chosen_frequencies
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.spec.arguments import is_number
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.plants import LocalDynamics, check_motion
from flexgen.model.elements import RobotModel
from flexgen.model.position_servo.filters import Filter
from flexgen.model.position_servo.keys import FREQUENCIES

LATE = 2e-3  # s: sample time and delay of proposed gains, one update of 1 ms each


@checked_class
@dataclass(frozen=True)
class PPI:
    """A P-PI cascade for every motor of a model, by frequencies.

    Parameters
    ----------
    position_hz, speed_hz, integral_hz : float or None [Hz]
        Bandwidths of position and speed control, corner of the integral part; None: 0.5, 3 and 0.1
        times the lowest natural frequency with locked motors.
    filters : tuple of LowPass and Notch
        Of the feedback torque.

    Examples
    --------
    >>> law = flexgen.PPI(
    ...     position_hz=6.0, speed_hz=40.0, integral_hz=1.0, filters=(flexgen.Notch(25.0),)
    ... )
    >>> run = flexgen.control("elbow", controller=law, plants={"soft": {"stiffness": 0.8}})
    >>> f"{1e6 * run.distance(run['soft']).max():.0f} um"
    '242 um'
    """

    position_hz: float | None = None
    speed_hz: float | None = None
    integral_hz: float | None = None
    filters: tuple[Filter, ...] = ()

    def __post_init__(self) -> None:
        for name in FREQUENCIES:
            value = getattr(self, name)
            if value is not None and not (is_number(value) and 0 <= value <= 1e5):
                raise ArgumentError(f"controller, {name}: given {value!r}, expected 0 to 1e5 Hz")
        if not isinstance(self.filters, Sequence) or not all(
            hasattr(each, "section") for each in self.filters
        ):
            raise ArgumentError(
                f"controller, filters: given {self.filters!r}, expected filters such as "
                "flexgen.Notch"
            )

    def frequencies(self, model: RobotModel, motion: Sequence[np.ndarray]) -> dict[str, float]:
        """Frequencies of position, speed and integral part [Hz] for a model at a pose.

        Frequencies of None follow from the lowest natural frequency with locked motors at the
        pose ``motion``, see `cascade`; it is not used where all three are given.
        """
        given = {name: getattr(self, name) for name in FREQUENCIES}
        if None not in given.values():
            return given
        check_motion(model, motion)
        return chosen_frequencies(given, lowest_locked_hz(model, motion))

    def speeds_in_use(
        self, model: RobotModel, late_s: float, motion: Sequence[np.ndarray]
    ) -> np.ndarray:
        """Bandwidths (n_m,) of the speed control [Hz] in use, which sample time and delay cut.

        ``speed_gain / (2 pi J)`` with the inertia J that a motor moves while all springs are
        stiff; parameters as of `cascade`.
        """
        # `cascade` checks the motion, on which the inertias depend.
        gain = self.cascade(model, late_s, motion).speed_gain
        stiff, _ = motor_inertias(model, motion)
        return np.asarray(gain / (2.0 * np.pi * stiff))

    def cascade(self, model: RobotModel, late_s: float, motion: Sequence[np.ndarray]) -> Cascade:
        """The gains for a model.

        Parameters
        ----------
        model : RobotModel
        late_s : float [s]
            Sample time and delay together: they limit the speed gain.
        motion : sequence of arrays (1, ...)
            ``q_a v_a a_a q_m v_m a_m tau_m`` of the pose that the inertias are taken at.

        Returns
        -------
        Cascade
            With the torque limits of the model.
        """
        check_motion(model, motion)
        gains = cascade_gains(
            self.frequencies(model, motion), *motor_inertias(model, motion), late_s
        )
        return Cascade(
            *gains, self.filters, np.array([motor.torque_max or 0.0 for motor in model.motors])
        )


@checked_class
@dataclass(frozen=True)
class PID:
    """A PID controller for every motor: the same feedback as `PPI`, stated by its gains.

        u = tau_ff + k_p e + k_i int e dt + k_d (v_ref - v),    e = q_ref - q

    Parameters
    ----------
    k_p, k_i, k_d : array (n_m,) [N m/rad, N m/(rad s), N m s/rad]
    filters : tuple of LowPass and Notch

    Examples
    --------
    >>> law = flexgen.PID(k_p=[200.0, 100.0], k_i=[0.0, 0.0], k_d=[5.0, 2.0])
    >>> flexgen.control("elbow", controller=law.cascade()).status
    'done'
    """

    k_p: np.ndarray
    k_i: np.ndarray
    k_d: np.ndarray
    filters: tuple[Filter, ...] = ()

    __repr__ = short_repr

    def cascade(self) -> Cascade:
        """Position and integral gain w_p, w_i with ``w_p + w_i = k_p/k_d``, ``w_p w_i = k_i/k_d``.

        ArgumentError where they are not real: the integral part is too large for a cascade.
        """
        k_p, k_i, k_d = (np.asarray(x, dtype=float) for x in (self.k_p, self.k_i, self.k_d))
        if not np.all(k_d > 0):
            raise ArgumentError(f"controller, k_d: given {k_d}, expected gains > 0")
        half = k_p / k_d / 2
        product = k_i / k_d
        root = half**2 - product
        if np.any(root < 0):
            raise ArgumentError(
                f"controller, k_i: given {k_i}, expected at most k_p^2/(4 k_d) = "
                f"{k_p**2 / (4 * k_d)}: with more the zeros of the controller are complex"
            )
        return Cascade(half + np.sqrt(root), k_d, half - np.sqrt(root), self.filters)


def motor_inertias(
    model: RobotModel, motion: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Inertias that the motors move at a pose: with all springs stiff, and soft, (n_m,) each [kg
    m^2].
    """
    M, _, _, B = (x[0] for x in LocalDynamics(derive(model)).matrices(motion, np.zeros(0)))
    return second_order.motor_inertias(model, M, B, second_order.motor_rows(model))


def lowest_locked_hz(model: RobotModel, motion: Sequence[np.ndarray]) -> float:
    """Lowest natural frequency with the motors locked at a pose [Hz]; 0 where nothing is elastic
    then.
    """
    M, _, K, _ = (x[0] for x in LocalDynamics(derive(model)).matrices(motion, np.zeros(0)))
    return second_order.lowest_locked_hz(model, M, K)


def propose_gains(equations: Equations) -> Cascade | None:
    """Gains of a P-PI cascade at home, by the rule of `flexgen.control`; None where the pose has
    none.
    """
    robot = equations.model
    try:
        rest = hold_joints(equations, np.asarray(robot.home, dtype=float))
    except SolverError:
        return None
    zero_a = np.zeros((1, robot.n_a))
    zero_m = np.zeros((1, robot.n_m))
    motion = (rest.q_a[None], zero_a, zero_a, rest.q_m[None], zero_m, zero_m, rest.tau_m[None])
    return PPI().cascade(robot, LATE, motion)
