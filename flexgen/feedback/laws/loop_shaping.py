"""H-infinity control of the motor angles by loop shaping at one pose.

The plant from motor torques to motor angles, with the delay, gets the shape that the loop shall
have,

    P_s = P W,    W = J w_c^2 (s + w_i)/s  w_l^2/(s^2 + sqrt(2) w_l s + w_l^2)

and K is the controller that keeps P_s stable under the largest perturbation of its normalized
coprime factors. With

    A'X + XA - XBB'X + C'C = 0,    AZ + ZA' - ZC'CZ + BB' = 0,    gamma_min^2 = 1 + max eig(XZ)

no search for gamma is needed. u = tau_ff + W K (q_ref - q), sampled by the bilinear transform.

Source: D. McFarlane, K. Glover, IEEE Trans. Automatic Control 37(6), 1992; delay by a Pade
approximation of order two.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgWarning, block_diag, solve_continuous_are
from scipy.signal import cont2discrete

from flexgen.analysis.second_order import motor_rows
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.spec.arguments import is_number
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.gains import motor_inertias
from flexgen.feedback.loop.margins import LoopAtPose
from flexgen.feedback.loop.model_law import LinearDesign
from flexgen.feedback.loop.plants import LocalDynamics, check_design
from flexgen.feedback.loop.sampled_model import PoseModels
from flexgen.model.elements import RobotModel

# factors of the crossover frequency that are tried where a loop is unstable
LOWER = 0.8
LOWERINGS = 30
System = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # A, B, C, D


@checked_class
@dataclass(frozen=True)
class LoopShaping(LinearDesign):
    """H-infinity loop shaping for the motors of a model; see the module.

    Parameters
    ----------
    crossover_hz, integral_hz, low_pass_hz : float [Hz]
        w_c: where the loop of the rigid robot would cross one; w_i, w_l: of the shape W.
    factor : float
        gamma over gamma_min, more than 1.
    model : RobotModel, optional
        That the controller is computed for; default: the model of the robot. For springs that are
        not linear one with linear springs in between.

    Examples
    --------
    >>> run = flexgen.control(
    ...     "elbow", controller=flexgen.LoopShaping(crossover_hz=2.0, integral_hz=0.2)
    ... )
    >>> {pose: f"{margins.gain:.2f}" for pose, margins in run.margins().items()}
    {'begin': '4.75', 'middle': '3.97', 'end': '4.80'}
    """

    crossover_hz: float = 2.0
    integral_hz: float = 0.3
    low_pass_hz: float = 50.0
    factor: float = 1.1
    model: RobotModel | None = None

    def __post_init__(self) -> None:
        for name in ("crossover_hz", "integral_hz", "low_pass_hz"):
            value = getattr(self, name)
            if not (is_number(value) and 0 < value <= 1e5):
                raise ArgumentError(
                    f"controller, {name}: given {value!r}, expected more than 0, at most 1e5 Hz"
                )
        if not (is_number(self.factor) and self.factor > 1):
            raise ArgumentError(
                f"controller, factor: given {self.factor!r}, expected a number > 1"
            )

    def design(
        self, model: RobotModel, sample_s: float, delay_s: float, motion: Sequence[np.ndarray]
    ) -> tuple[Linear, float]:
        """The controller, and the margin 1/gamma: the largest perturbation that it tolerates, at
        most 1.

        ``motion``: ``q_a v_a a_a q_m v_m a_m tau_m`` (1, ...) of the pose. SolverError where there
        is no controller.
        """
        robot = self.model or model
        check_design(robot, sample_s, delay_s, motion)
        shape = self._shape(motor_inertias(robot, motion)[0])
        plant = series(
            series(shape, pade(delay_s + sample_s / 2, robot.n_m)), linear_plant(robot, motion)
        )
        central, gamma = coprime_controller(plant, self.factor)
        # the tested loop shows whether a matrix was too ill-conditioned
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)
            A, B, C, D, _ = cont2discrete(series(central, shape), sample_s, method="bilinear")
        return Linear(A, B, C, D), 1.0 / gamma

    def linear(
        self,
        model: RobotModel,
        sample_s: float,
        delay_s: float,
        motion: Sequence[np.ndarray],
        samples: int = 1,
    ) -> Linear:
        """The controller for the first pose; ArgumentError where the sampled loop with it is
        unstable there.

        The design knows the hold and the delay by an approximation, the tested loop exactly.
        """
        robot = self.model or model
        check_design(robot, sample_s, delay_s, motion)
        motion = [x[:1] for x in motion]
        pose = PoseModels(robot).at(motion)
        pose = replace(pose, C=pose.C[: robot.n_m])  # motor angles

        def attempt(law: LoopShaping) -> tuple[Linear, float]:
            made = law.design(model, sample_s, delay_s, motion)[0]
            if not all(np.isfinite(x).all() for x in made.matrices):
                return made, np.inf
            return made, LoopAtPose(pose, made, sample_s, delay_s).largest_eigenvalue()

        made, largest = attempt(self)
        if not largest < 1.0:
            raise ArgumentError(
                f"controller LoopShaping, crossover_hz: given {self.crossover_hz:g} Hz, with "
                f"which the sampled loop is unstable at {1e3 * sample_s:g} ms and a delay of "
                f"{1e3 * delay_s:g} ms (largest eigenvalue {largest:.4g}); expected "
                f"{self._find_stable(attempt)}"
            )
        A, B, C, D = made.matrices
        # only the motor angles are fed back
        unused = sum(len(sensor.channels) for sensor in model.sensors)
        B, D = (np.pad(x, ((0, 0), (0, 0), (0, unused))) for x in (B, D))
        return Linear(A, B, C, D)

    def _find_stable(self, attempt: Callable[[LoopShaping], tuple[Linear, float]]) -> str:
        """A lower frequency with which the loop is stable, for the message."""
        for k in range(1, LOWERINGS + 1):
            frequency = float(f"{self.crossover_hz * LOWER**k:.2g}")
            try:
                if attempt(replace(self, crossover_hz=frequency))[1] < 1.0:
                    return f"a lower one, such as {frequency:g} Hz, or a shorter sample time"
            except SolverError:
                continue
        return "a shorter sample time or delay, or another low_pass_hz"

    def _shape(self, inertias: np.ndarray) -> System:
        """The weight W of all motors, ``A, B, C, D``, from angle errors to torques:

            W = w_c^2 J (1 + w_i/s) w_l^2/(s^2 + sqrt(2) w_l s + w_l^2)

        ``inertias`` J (n_m,) [kg m^2]: seen by the motors, with which the loop gain is about 1 at
        w_c.
        """
        w_c, w_i, w_l = (
            2 * np.pi * x for x in (self.crossover_hz, self.integral_hz, self.low_pass_hz)
        )
        integral = (np.zeros((1, 1)), np.ones((1, 1)), np.full((1, 1), w_i), np.ones((1, 1)))
        low_pass = (
            np.array([[0.0, 1.0], [-(w_l**2), -np.sqrt(2) * w_l]]),
            np.array([[0.0], [1.0]]),
            np.array([[w_l**2, 0.0]]),
            np.zeros((1, 1)),
        )
        A, B, C, D = series(integral, low_pass)
        n_m = len(inertias)
        gain = np.diag(w_c**2 * inertias)
        parts = (block_diag(*[x] * n_m) for x in (A, B, C, D))
        A, B, C, D = parts
        return A, B, gain @ C, gain @ D


def linear_plant(model: RobotModel, motion: Sequence[np.ndarray]) -> System:
    """State space ``A, B, C, D`` from motor torques [N m] to motor angles [rad] of the robot
    linearized at the first point of ``motion``,
    `flexgen.feedback.loop.plants.LocalDynamics.matrices`.
    """
    M, D, K, B = (x[0] for x in LocalDynamics(derive(model)).matrices(motion, np.zeros(0)))
    n = len(M)
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ D]])
    rows = motor_rows(model)
    C = np.hstack([rows, np.zeros_like(rows)])
    return A, np.vstack([np.zeros_like(B), inverse @ B]), C, np.zeros((len(rows), B.shape[1]))


def pade(delay_s: float, inputs: int) -> System:
    """State space of a delay T = ``delay_s`` in each of ``inputs`` signals, by Padé's formula of
    second order:

        exp(-s T) = (12 - 6 s T + (s T)^2)/(12 + 6 s T + (s T)^2)

    Without a delay it has no states.
    """
    if delay_s <= 0:
        return np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((inputs, 0)), np.eye(inputs)
    a = 12.0 / delay_s**2
    b = 6.0 / delay_s
    one = np.eye(inputs)
    A = np.kron(one, np.array([[0.0, 1.0], [-a, -b]]))
    return A, np.kron(one, np.array([[0.0], [1.0]])), np.kron(one, np.array([[0.0, -2 * b]])), one


def series(first: System, second: System) -> System:
    """The second system driven by the first."""
    A1, B1, C1, D1 = first
    A2, B2, C2, D2 = second
    A = np.block([[A1, np.zeros((len(A1), len(A2)))], [B2 @ C1, A2]])
    return A, np.vstack([B1, B2 @ D1]), np.hstack([D2 @ C1, C2]), D2 @ D1


def coprime_controller(plant: System, factor: float) -> tuple[System, float]:
    """Controller of ``y_ref - y`` for a strictly proper plant that is robust against perturbations
    of its normalized coprime factors, as ``A, B, C, D``, and gamma.

    ``factor``: gamma over its smallest possible value; 1/gamma is the perturbation that is
    tolerated.

    Raises
    ------
    SolverError
        One of the two Riccati equations has no stabilizing solution.
    """
    A, B, C, _ = plant
    n = len(A)
    try:
        X = solve_continuous_are(A, B, C.T @ C, np.eye(B.shape[1]))
        Z = solve_continuous_are(A.T, C.T, B @ B.T, np.eye(len(C)))
        gamma = factor * float(np.sqrt(1.0 + np.abs(np.linalg.eigvals(X @ Z)).max()))
        L = (1.0 - gamma**2) * np.eye(n) + X @ Z
        G = gamma**2 * np.linalg.solve(L.T, Z @ C.T)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise SolverError(
            "H-infinity controller: the Riccati equations have no solution at the pose "
            f"({error}); use lower frequencies"
        ) from error
    F = -B.T @ X
    return (A + B @ F + G @ C, G, F, np.zeros((B.shape[1], len(C)))), gamma
