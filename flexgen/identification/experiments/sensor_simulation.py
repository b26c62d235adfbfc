"""Signals of the sensors of a simulated robot: from its motion at the samples of the drives, with
noise.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.build.casadi_module import in_c
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.sensors import sensor_signals
from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.responses.response_outputs import channels, check_channels, noises
from flexgen.model.elements import RobotModel
from flexgen.runtime.library import Library

WHOLE = 1e-6  # of a sample time: largest difference of whole multiples


class SensorSignals:
    """The chosen channels of a robot in motion.

    Parameters
    ----------
    robot : RobotModel
    plan : Plan
    library : Library
        With ``forward_dynamics``.
    seed : int
        Of the noise.

    Raises
    ------
    ArgumentError
        The robot has no such sensor, or its sample time does not fit the drives or the lines.
    """

    def __init__(self, robot: RobotModel, plan: Plan, library: Library, seed: int) -> None:
        self.robot = robot
        self.library = library
        self.names = check_channels(robot, plan.sensors)
        of = {name: sensor for sensor in robot.sensors for name in sensor.channels}
        sensors = [of[name] for name in self.names]
        self.noise = noises(robot, self.names)
        self.steps = [self._step(name, of[name].sample_s, plan) for name in self.names]
        self.delays = np.array([sensor.delay_s for sensor in sensors])
        self.rng = np.random.default_rng(seed)
        equations = derive(robot)
        signals = sensor_signals(equations)[[channels(robot).index(name) for name in self.names]]
        self._signals = in_c(ca.Function("signals", [*equations.y], [ca.densify(signals)]))

    @staticmethod
    def _step(name: str, sample_s: float | None, plan: Plan) -> int:
        """Samples of the drives from one sample of a sensor to the next."""
        own = plan.hardware.sample_s
        ratio = 1.0 if sample_s is None else sample_s / own
        step = round(ratio)
        if step < 1 or abs(ratio - step) > WHOLE or plan.samples % step:
            raise ArgumentError(
                f"sensor channel {name}: given sample_s = {sample_s} s, expected a multiple of "
                f"{own} s, the sample time of the drives, that divides the period of "
                f"{plan.period_s} s"
            )
        if plan.lines[-1] >= plan.samples / step / 2:
            raise ArgumentError(
                f"sensor channel {name}: given sample_s = {sample_s} s, expected less than half "
                f"a period of the highest frequency, {plan.frequencies[-1]:.4g} Hz"
            )
        return step

    def __call__(self, motion: np.ndarray) -> np.ndarray:
        """Signals (samples, lanes, channels) with noise, of a motion (samples, 2 n_a + 3 n_m,
        lanes).

        Delays are not in them: they turn the phases of the spectra.
        """
        n_a = self.robot.n_a
        n_m = self.robot.n_m
        i_m = list(self.robot.i_m)
        samples, _, lanes = motion.shape
        ends = np.cumsum([n_a, n_a, n_m, n_m])
        flat = motion.transpose(0, 2, 1).reshape(samples * lanes, -1)
        q_a, v_a, q_m, v_m, tau_m = (np.ascontiguousarray(x) for x in np.split(flat, ends, axis=1))
        a_a, a_m = self.library.forward_dynamics(q_a, v_a, q_m, v_m, tau_m)
        y, dy, ddy = (np.hstack([a, b[:, i_m]]) for a, b in ((q_a, q_m), (v_a, v_m), (a_a, a_m)))
        exact = evaluate(self._signals, y, dy, ddy)[0].reshape(samples, lanes, len(self.names))
        return exact + self.noise * self.rng.normal(size=exact.shape)
