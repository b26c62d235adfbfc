"""Inputs of a model-based law: the planned motion of the arm up to its fourth derivative, and
measurements.

Jerk and fourth derivative are those of the quintic spline through the accelerations of the
trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.sensors import Sensor
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.feedback.loop.reference import MotionReference
from flexgen.feedback.loop.timing import Timing
from flexgen.model.elements import RobotModel

STEP_TIMES_RATE = 1.0  # of the prediction's Runge-Kutta method, which is stable below 2.78


@dataclass(frozen=True)
class LawMotion:
    """The planned motion, the timing of the loop and its channels.

    Attributes
    ----------
    model : RobotModel
    equations : Equations
    trajectory : Trajectory
        At rest before and after it.
    reference : MotionReference
        At the samples of the loop.
    sample_s, delay_s : float [s]
    exact_state : bool
        The loop measures ``q_a, v_a, q_m, v_m`` exactly, after the sensors.
    rate : float [1/s]
        Largest size of an eigenvalue of the model.
    """

    model: RobotModel
    equations: Equations
    trajectory: Trajectory
    reference: MotionReference
    sample_s: float
    delay_s: float
    exact_state: bool
    rate: float

    def timing(self, predicted: bool = False) -> Timing:
        """When a law measures and acts; speeds that are not measured are differences."""
        return Timing(self.sample_s, self.delay_s, predicted, not self.exact_state)

    @property
    def steps_per_s(self) -> float:
        """Integration steps of a prediction [1/s]."""
        return self.rate / STEP_TIMES_RATE

    @property
    def state_channel(self) -> int:
        """First channel of the exact state; -1: it is not measured."""
        return self.model.n_m + self._sensor_channels if self.exact_state else -1

    @property
    def _sensor_channels(self) -> int:
        return sum(len(sensor.channels) for sensor in self.model.sensors)

    def link_channels(self, law: str) -> np.ndarray | None:
        """Channels (n_a,) of the link encoders of the arm coordinates; None where the exact state
        is measured. ``law``: its name, for the error.

        Raises
        ------
        ArgumentError
            A coordinate has no encoder, or one with a delay only: the laws take all angles at one
            instant.
        """
        if self.exact_state:
            return None
        found: dict[str, int] = {}
        late: dict[str, Sensor] = {}
        at = self.model.n_m
        for sensor in self.model.sensors:
            if sensor.type == "link_encoder":
                if sensor.delay_s > 0:
                    late.setdefault(sensor.place, sensor)
                else:
                    found.setdefault(sensor.place, at)
            at += len(sensor.channels)
        missing = [c.name for c in self.model.coordinates if c.name not in found]
        for sensor in (late[name] for name in missing if name in late):
            raise ArgumentError(
                f"controller {law}, sensor {sensor.name}: given delay_s = {sensor.delay_s:g} s, "
                "expected 0 s for a link encoder that the controller uses (or exact_state=True)"
            )
        if missing:
            raise ArgumentError(
                f"controller {law}: given the model {self.model.name} without a sensor of type "
                f"link_encoder for {', '.join(missing)}, expected one for each arm coordinate "
                "(or exact_state=True)"
            )
        return np.array([found[c.name] for c in self.model.coordinates])

    @cached_property
    def _acceleration(self) -> BSpline:
        return make_interp_spline(self.trajectory.time, self.trajectory["a_a"], k=5)

    def _clip(self, ahead_s: float) -> tuple[np.ndarray, np.ndarray]:
        """The samples of the loop, ``ahead_s`` later, within the trajectory (n,), and whether they
        were (n, 1).
        """
        time = self.reference.time + ahead_s
        inside = np.clip(time, *self.trajectory.time[[0, -1]])
        return inside, (inside == time)[:, None]

    def arm(self, ahead_s: float) -> np.ndarray:
        """``q, v, a, j, s`` (n, 5, n_a) of the planned arm at the samples of the loop, ``ahead_s``
        later.
        """
        inside, moving = self._clip(ahead_s)
        found = self.trajectory.at(inside)
        spline = self._acceleration
        rates = [found["v_a"], found["a_a"], spline(inside, 1), spline(inside, 2)]
        return np.stack([found["q_a"], *(np.where(moving, x, 0.0) for x in rates)], axis=1)

    def motors(self, ahead_s: float = 0.0) -> np.ndarray:
        """``q_m, v_m`` (n, 2, n_m) of the planned motion at the samples."""
        inside, moving = self._clip(ahead_s)
        found = self.trajectory.at(inside)
        return np.stack([found["q_m"], np.where(moving, found["v_m"], 0.0)], axis=1)

    def difference(self, x: np.ndarray) -> np.ndarray:
        """The odd derivatives of references (n, k, m) as the measurement has them: differences of
        two samples.
        """
        if self.exact_state:
            return x
        out = x.copy()
        out[1:, 1::2] = np.diff(x[:, ::2], axis=0)[:, : x.shape[1] // 2] / self.sample_s
        out[0, 1::2] = 0.0
        return out
