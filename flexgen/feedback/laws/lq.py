"""Linear quadratic control about a reference: gains by pose, with or without an observer.

    dx' = A dx + B (du + d),    dx = (dy, dy'),  y = (q_a, motors behind elastic gears),
    d' = white noise

    LQ   sum |W dq|^2 + (0.01 s)^2 |W dv|^2 + rho sum (du / u_max)^2 in units of the output, W its
         Jacobian
    LQG  du = -K dx^ - d^, dx^ and d^ by the stationary Kalman filter of motor angles and sensors

Everything is sampled with the hold and the delay of the controller; the torques under way are
states. The filter's noises: torques of a twentieth of the largest, disturbances that grow by the
largest torque in a second, a force on the tool of 50 N (of 1 m/s^2 times the mass of the robot,
where that is smaller), the noise of the encoders, and ten times the noise of the sensors (low
accelerometer noise makes the filter sensitive to stiffness errors).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.riccati import riccati
from flexgen.base.spec.arguments import check_positive
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.model_law import LinearDesign
from flexgen.feedback.loop.plants import check_design
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels
from flexgen.feedback.sampled_plant import hold_effects, sample_model
from flexgen.model.elements import RobotModel

OUTPUT_SCALE = 1e-3  # m or rad: unit of the output in the cost
SPEED_WEIGHT_S = 0.01
TOOL_FORCE = 50.0  # N, at most
TOOL_ACCELERATION = 1.0  # over the mass of the robot [m/s^2]
SENSOR_NOISE = 10.0  # times that of the model file
# of a channel without noise, and of one that is not used; its units
LEAST_NOISE = 1e-6
NOT_USED = 1e9
REGULAR = 1e-12  # weight of states that the cost does not see, relative


@checked_class
@dataclass(frozen=True)
class LQG(LinearDesign):
    """Linear quadratic control with a Kalman filter, by pose; see the module.

    Parameters
    ----------
    rho : float
        Weight of the torque, relative to a deviation of the output of 1 mm (angles: 1 mrad) at the
        largest torque of the model file (at 1 N m where it has none).
    encoder_noise : float [rad]
        Of the motor angles, that the filter expects.
    sensors : bool
        The filter uses the sensors of the model file too.
    torque_noise, disturbance_rate : float
        Noise model of the filter: noise of the torques relative to the largest one, and growth of
        disturbances, the largest torque in a second.
    model : RobotModel, optional
        That the gains are computed for; default: the model of the robot. For springs that are not
        linear one with linear springs in between.

    Examples
    --------
    >>> run = flexgen.control("elbow", controller=flexgen.LQG(rho=1.0))
    >>> {pose: f"{margins.gain:.1f}" for pose, margins in run.margins().items()}
    {'begin': '3.5', 'middle': '3.6', 'end': '3.6'}
    """

    rho: float = 100.0
    encoder_noise: float = 1e-4
    sensors: bool = True
    torque_noise: float = 0.05
    disturbance_rate: float = 1.0
    model: RobotModel | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("rho", "encoder_noise", "torque_noise", "disturbance_rate"):
            value = getattr(self, name)
            check_positive(f"controller, {name}", value)

    @property
    def title(self) -> str:
        """Name in tables."""
        return type(self).__name__.lower()

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

        SolverError where no gain exists at a pose.
        """
        check_design(self.model or model, sample_s, delay_s, motion)
        if late := [x for x in (self.model or model).sensors if self.sensors and x.delay_s > 0.0]:
            raise ArgumentError(
                f"controller lqg, sensor {late[0].name}: given delay_s = {late[0].delay_s:g} s, "
                "expected ones without delay, or sensors=False"
            )
        design = _Design(self.model or model, sample_s, delay_s, self)
        parts = [design.part([x[k : k + 1] for x in motion]) for k in range(len(motion[0]))]
        A, B, C, D = (np.array(x) for x in zip(*parts, strict=True))
        return Linear(A, B, C, D, samples)


class _Design:
    """Controllers at poses of a robot."""

    def __init__(self, model: RobotModel, sample_s: float, delay_s: float, options: LQG) -> None:
        self.model = model
        self.sample_s = sample_s
        self.delay_s = delay_s
        self.options = options
        self.poses = PoseModels(model)
        self.u_max = torque_scale(model)
        self.tool_force = _expected_force(model)
        own = [SENSOR_NOISE * noise for s in model.sensors for noise in s.noises]
        used = [max(x, LEAST_NOISE) if options.sensors else NOT_USED for x in own]
        self.noise = np.array([options.encoder_noise] * model.n_m + used) ** 2

    def part(self, motion: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
        """``A, B, C, D`` of the sampled controller at one point of a motion, from ``y_ref - y`` to
        torques.

        A Kalman filter of the state, the torques on their way and a disturbance torque of each
        motor; its estimate is fed back by the gain of the regulator, and the disturbance is
        compensated.
        """
        check_time("gains of the controller")
        at = self.poses.at(motion)
        h = self.sample_s
        options = self.options
        if options.sensors and at.D.any():
            names = [name for sensor in self.model.sensors for name in sensor.channels]
            name = names[int(np.flatnonzero(at.D.any(axis=1))[0]) - self.model.n_m]
            raise ArgumentError(
                f"controller lqg: given the signal {name}, which a motor torque changes at "
                "once, expected ones behind elastic gears, or sensors=False"
            )
        F, G = sample_model(at.A, at.B, h, self.delay_s)
        n = len(at.A)
        n_m = self.model.n_m
        size = len(F)
        gain = regulator(at, F, G, options.rho, self.u_max)
        whole = size + n_m  # and the disturbances
        full = np.zeros((whole, whole))
        full[:size, :size] = F
        full[size:, size:] = np.eye(n_m)
        full[:n, size:] = hold_effects(at.A, at.B, h, 0.0)[1]
        drive = np.vstack([G, np.zeros((n_m, n_m))])
        process = 1e-18 * np.eye(whole)
        torque = full[:n, size:] * (options.torque_noise * self.u_max)
        pushed = hold_effects(at.A, at.push, h, 0.0)[1] * self.tool_force
        process[:n, :n] += torque @ torque.T + pushed @ pushed.T
        process[size:, size:] += np.diag((options.disturbance_rate * self.u_max) ** 2 * h)
        rows = np.hstack([at.C, np.zeros((len(at.C), whole - n))])
        P = riccati(full.T, rows.T, process, np.diag(self.noise))
        M = P @ rows.T @ np.linalg.inv(rows @ P @ rows.T + np.diag(self.noise))
        feedback = np.hstack([gain, np.eye(n_m)])
        kept = np.eye(whole) - M @ rows
        closed = full - drive @ feedback
        return closed @ kept, -closed @ M, -feedback @ kept, feedback @ M


def _expected_force(model: RobotModel) -> float:
    """Force on the tool that the filter expects [N]."""
    beams = [element.beam for element in model.elements if element.beam is not None]
    mass = model.payload.mass + sum(element.body.mass for element in model.elements)
    mass += sum(beam.length * beam.mass_per_length for beam in beams)
    return min(TOOL_FORCE, TOOL_ACCELERATION * mass)


def regulator(
    at: PoseModel, F: np.ndarray, G: np.ndarray, rho: float, u_max: np.ndarray
) -> np.ndarray:
    """Gain (n_m, size) of the regulator on the state with the torques on their way, see the text
    of this module.

    Parameters
    ----------
    at : PoseModel
        Its W gives the weighted outputs.
    F, G : array
        Sampled model, from `sample_model`.
    rho : float
        Weight of the torques.
    u_max : array (n_m,) [N m]
        Scale of the torques.
    """
    n = len(at.A)
    size = len(F)
    weight = at.W.T @ at.W / OUTPUT_SCALE**2
    Q = np.zeros((size, size))
    Q[: n // 2, : n // 2] = weight
    Q[n // 2 : n, n // 2 : n] = weight * SPEED_WEIGHT_S**2
    Q += REGULAR * np.trace(Q) / size * np.eye(size)
    R = rho * np.diag(1.0 / u_max**2)
    P = riccati(F, G, Q, R)
    return np.asarray(np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F))


def torque_scale(model: RobotModel) -> np.ndarray:
    """Largest torques of the motors (n_m,) [N m]; 1 N m where the model file has none."""
    limits = np.array([m.torque_max or 0.0 for m in model.motors])
    return np.where(limits > 0, limits, max(limits.max(initial=0.0), 1.0))
