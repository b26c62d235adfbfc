"""Outputs of frequency responses: motor angles, and the sensors of the model, as accelerations,
torques and forces.

    Y_o(w) = (j w)^m exp(-j w t_o) S_o(w)
    S_o = (s^2 C2 + s C1 + C0) X,    s = j w

S_o: spectrum of the signal, t_o its delay, m = 2 for angles and positions, 1 for rates, 0 for
accelerations, torques and forces; X: spectrum of the coordinates y about rest.

``C2, C1, C0``: derivatives of the signal in the accelerations, velocities and coordinates at rest.
The last one has the tilt of an accelerometer in the gravity field. Those of torques and forces
depend on masses and frictions; a friction of a joint has there the mean slope that it has in the
matrices of the linear model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.sensors import sensor_signals
from flexgen.identification.rigid.mean_friction import is_linear, mean_viscous_change
from flexgen.model.elements import RobotModel

ANGLE = 2  # time derivatives from a motor angle to its acceleration


def channels(model: RobotModel) -> tuple[str, ...]:
    """Names of the channels of all sensors of a model."""
    return tuple(name for sensor in model.sensors for name in sensor.channels)


def output_orders(model: RobotModel, chosen: Sequence[str]) -> np.ndarray:
    """Time derivatives from each output to an acceleration, (n_m + channels,)."""
    known = {name: sensor.order for sensor in model.sensors for name in sensor.channels}
    return np.array([ANGLE] * model.n_m + [known[name] for name in check_channels(model, chosen)])


def check_channels(model: RobotModel, chosen: Sequence[str]) -> tuple[str, ...]:
    """The names of channels; ArgumentError for one that the model does not have."""
    known = channels(model)
    for name in chosen:
        if name not in known:
            listed = (
                f"one of {', '.join(known)}" if known else "none: the model file has no [[sensor]]"
            )
            raise ArgumentError(f"sensor channel: given {name!r}, expected {listed}")
    return tuple(chosen)


def noises(model: RobotModel, chosen: Sequence[str]) -> np.ndarray:
    """Standard deviation of a sample of each channel, SI units."""
    known = {
        c: sd
        for sensor in model.sensors
        for c, sd in zip(sensor.channels, sensor.noises, strict=True)
    }
    return np.array([known[name] for name in chosen])


class OutputRows:
    """The rows of motors and of chosen sensor channels in the linear model at rest.

    Parameters
    ----------
    equations : Equations
    motor_rows : array (n_m, n)
    chosen : sequence of str
        Names of channels.
    """

    def __init__(
        self, equations: Equations, motor_rows: np.ndarray, chosen: Sequence[str]
    ) -> None:
        model = equations.model
        self.motor_rows = motor_rows
        self.names = check_channels(model, chosen)
        self._index = [channels(model).index(name) for name in self.names]
        self.orders = output_orders(model, self.names)
        late = {name: sensor for sensor in model.sensors for name in sensor.channels}
        # of each output
        self.sensors = ("",) * model.n_m + tuple(late[name].name for name in self.names)
        self.delays = np.array([0.0] * model.n_m + [late[name].delay_s for name in self.names])
        self._equations = equations

    def __len__(self) -> int:
        return len(self.orders)

    def transfer(self, w: np.ndarray, delays: Mapping[str, float]) -> np.ndarray:
        """``(j w)^m exp(-j w t_o)`` (lines, outputs); ``delays``: name of a sensor -> t_o instead
        of its own.
        """
        s = 1j * w[:, None]
        late = [delays.get(name, own) for name, own in zip(self.sensors, self.delays, strict=True)]
        return np.asarray(s**self.orders * np.exp(-s * np.array(late)))

    def of(self, sensor: str) -> np.ndarray:
        """Whether each output belongs to a sensor, (outputs,)."""
        return np.array([name == sensor for name in self.sensors])

    @cached_property
    def _function(self) -> ca.Function:
        """y, p, speeds -> C2, C1, C0 (channels, n), and their derivatives in y and p, (3 *
        channels * n, n or n_p).
        """
        e = self._equations
        model = self._equations.model
        y, dy, ddy = e.y
        speed_sd = ca.SX.sym("speed_sd", model.n_a)
        signals = sensor_signals(e)[self._index]
        still = ca.vertcat(dy, ddy)
        zero = ca.SX.zeros(still.numel())
        rows = [
            ca.densify(ca.substitute(ca.jacobian(signals, x), still, zero)) for x in (ddy, dy, y)
        ]
        torques = {
            sensor.name: sensor.place for sensor in model.sensors if sensor.type == "joint_torque"
        }
        for c, name in enumerate(self.names):
            if name in torques:
                i = [coordinate.name for coordinate in model.coordinates].index(torques[name])
                dof = e.with_symbols.coordinates[i].dof
                if dof is not None and not is_linear(dof.friction):
                    rows[1][c, i] += mean_viscous_change(
                        dof.friction, speed_sd[i], model.temperature
                    )
        stacked = ca.vertcat(*[ca.vec(row) for row in rows])
        by = [ca.densify(ca.jacobian(stacked, x)) for x in (y, e.symbols)]
        return ca.Function("rows", [y, e.symbols, speed_sd], [*rows, *by])

    def at(
        self, y: np.ndarray, dy: np.ndarray, values: np.ndarray, speed_sd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows at rest, and their derivatives in the parameters.

        Parameters
        ----------
        y : array (k, n)
            Coordinates at rest.
        dy : array (k, n, n_p)
            Their derivatives.
        values : array (n_p,)
        speed_sd : array (k, n_a)
            Standard deviations of the speeds of the coordinates, for friction that is not viscous.

        Returns
        -------
        rows : array (k, 3, outputs, n)
            C2, C1, C0.
        drows : array (k, 3, outputs, n, n_p)
            Zero rows for the motors.
        """
        k, n = y.shape
        rows = np.zeros((k, 3, len(self), n))
        drows = np.zeros((k, 3, len(self), n, dy.shape[2]))
        n_m = len(self.motor_rows)
        rows[:, 2, :n_m] = self.motor_rows
        if self.names:
            c = len(self.names)
            *found, by_y, by_p = evaluate(self._function, y, values, speed_sd)
            rows[:, :, n_m:] = np.stack([x.reshape(k, c, n) for x in found], axis=1)
            change = by_y.reshape(k, 3 * n * c, n) @ dy + by_p.reshape(k, 3 * n * c, -1)
            # CasADi stacks columns: (3, n, channels)
            drows[:, :, n_m:] = change.reshape(k, 3, n, c, -1).swapaxes(2, 3)
        return rows, drows
