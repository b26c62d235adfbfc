"""Robots that differ from the model: their numbers, where they rest, and their fastest eigenvalue.

A change is a factor on a number of the model (``q2.stiffness``), or on all numbers of a kind:

=========== =======================================================================================
stiffness   stiffnesses of all springs (not break positions and gaps)
damping     of all gears and springs
friction    all friction torques (not speeds of friction laws)
lost_motion of all gears with hysteresis; 0: none
payload     mass [kg] that is added to the payload, at its center of mass; without one in the model
            at the tool
=========== =======================================================================================

Also ``lugre_coulomb``, ``lugre_static``, ``lugre_stiffness`` ... of all motors with the table
``lugre``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from flexgen.analysis import second_order
from flexgen.base.checks.counts import show_value
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.arguments import check_not_negative, check_positive, is_number, mapping_of
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.linearization import second_order_matrices
from flexgen.dynamics.mechanics.parameters import Parameter, select
from flexgen.model.elements import RobotModel
from flexgen.paths.force.process_force import ProcessForce

PlantChanges = Mapping[str, float]
"""Changes of a robot by name, see above."""

NOMINAL = "nominal"
KINDS = ("stiffness", "damping", "friction", "lost_motion", "payload")
# kg
LARGEST_FACTOR = 100.0
LARGEST_LOAD = 1e5
NEWTON_STEPS = 50
CLOSE = 1e-12
FORCES = (
    "N m",
    "N",
    "N m s/rad",
    "N s/m",
    "N m/rad",
    "N/m",
    "N m/rad^3",
    "N/m^3",
    "N m/N m",
    "N m/K",
)


@dataclass(frozen=True)
class Plants:
    """Robots of one model with other numbers.

    ``names`` (lanes); ``parameters``: the numbers that differ, in the order of the model;
    ``values`` (lanes, n_p); ``loads``: mass and place of the load that is added to each, in words,
    or an empty text.
    """

    names: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    values: np.ndarray
    loads: tuple[str, ...]


def plants_of(model: RobotModel, changes: Mapping[str, Mapping[str, float]]) -> Plants:
    """The robots that are asked for, by name; see the table of this module.

    Raises
    ------
    ArgumentError
        The model does not have such a number, or a factor is out of range.
    """
    numbers = {
        name: _numbers(
            model, name, mapping_of(f"plant {name}", given, "changes such as {'stiffness': 0.8}")
        )
        for name, given in changes.items()
    }
    used = {parameter for values in numbers.values() for parameter in values}
    parameters = tuple(p for p in select(model, sorted(used))) if used else ()
    values = np.array([[own.get(p.name, p.value) for p in parameters] for own in numbers.values()])
    loads = tuple(
        _load(model, given["payload"]) if "payload" in given else "" for given in changes.values()
    )
    return Plants(tuple(numbers), parameters, values.reshape(len(numbers), len(parameters)), loads)


def _load(model: RobotModel, mass: float) -> str:
    """The mass that is added to the payload, and where."""
    place = f"[{', '.join(f'{x:g}' for x in model.payload.com)}] m in the frame of the last tip"
    at = (
        "at the tool"
        if model.payload.com == model.tool.position
        else "at the center of mass of the payload"
    )
    return f"{mass:+g} kg {at}, {place}"


def _numbers(model: RobotModel, plant: str, changes: Mapping[str, Any]) -> dict[str, float]:
    """Values by name of the numbers that a plant changes. ``changes``: factors of kinds or of
    names of numbers, and ``payload``, a mass to add [kg].

    Raises
    ------
    ArgumentError
        A value is not a number or out of range, or the model has no number other than 0 of a kind.
    """
    out: dict[str, float] = {}
    for key, given in changes.items():
        what = f"plant {plant}, {key}"
        if not is_number(given):
            raise ArgumentError(f"{what}: given {given!r}, expected a number")
        if key == "payload":
            mass = select(model, ["payload.mass"])[0]
            if not -mass.value <= given <= LARGEST_LOAD:
                raise ArgumentError(
                    f"{what}: given {given} kg, expected {-mass.value:g} to {LARGEST_LOAD:g} kg "
                    "to add to the payload"
                )
            out["payload.mass"] = mass.value + given
            continue
        if not 0 <= given <= LARGEST_FACTOR:
            raise ArgumentError(
                f"{what}: given the factor {given}, expected 0 to {LARGEST_FACTOR:g}"
            )
        known = _select_known(model, key)
        if not known or (
            len(changes) == 1
            and given != 1
            and key not in KINDS
            and not any(p.value for p in known)
        ):
            raise ArgumentError(
                f"{what}: the model {model.name} has no number of this "
                f"kind{' but 0' * bool(known)}"
            )
        for parameter in known:
            if key not in KINDS or key == "lost_motion" or parameter.unit in FORCES:
                out[parameter.name] = parameter.value * given
    return out


def _select_known(model: RobotModel, key: str) -> tuple[Parameter, ...]:
    """The parameters that ``key`` names; none where it is a kind of number that the model has none
    of. ArgumentError for another text.
    """
    try:
        return select(model, [key])
    except ArgumentError:
        if key in KINDS:
            return ()
        raise


class LocalDynamics:
    """Rest and linearization of a model whose numbers may differ, motor angles given.

    Parameters
    ----------
    equations : Equations
        With the numbers as parameters.
    """

    def __init__(self, equations: Equations) -> None:
        self.equations = equations
        self.model = equations.model
        self._jacobians = equations.function("residual_jacobians")
        self._residual = equations.function("residual")
        self._C = second_order.motor_rows(self.model)

    def under(self, force: ProcessForce | None, t: float) -> LocalDynamics:
        """Dynamics under the force on the tool at the instant ``t`` [s]; the same object without a
        force.
        """
        return (
            self
            if force is None
            else LocalDynamics(self.equations.pushed_by(force.at(np.array([t]))[0]))
        )

    def rest(
        self,
        q_m: np.ndarray,
        values: np.ndarray,
        start: np.ndarray,
        more: np.ndarray | float = 0.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Arm coordinates (n_a,) [rad or m] and holding torques (n_m,) [N m] at rest with held
        motors, by Newton's method.

        Parameters
        ----------
        q_m : array (n_m,) [rad]
            Motor angles.
        values : array (n_p,)
            Run-time parameters of the robot.
        start : array (n_a,)
            Start of the iteration.
        more : array (n,) or float
            Additional forces on the coordinates y, such as a force on the tool.

        Raises
        ------
        SolverError
            There is no equilibrium near the start.
        """
        model = self.model
        n_m = self.model.n_m
        n = self.model.dof
        y = np.concatenate([start, q_m[list(model.i_m)]])
        tau = np.zeros(n_m)
        for _ in range(NEWTON_STEPS):
            arguments = self._motion(y[None], q_m, tau)
            r_a, r_m = evaluate(
                self._residual, *arguments, *self._pass_parameters(self._residual, values)
            )
            R = evaluate(
                self._jacobians, *arguments, *self._pass_parameters(self._jacobians, values)
            )[1].reshape(n, -1)
            r = np.concatenate([r_a.ravel(), r_m.ravel()[list(model.i_m)]]) - more
            A = np.block([[R[:, :n], R[:, 2 * n :]], [self._C, np.zeros((n_m, n_m))]])
            try:
                step = np.linalg.solve(A, np.concatenate([r, self._C @ y - q_m]))
            except np.linalg.LinAlgError:
                break
            y = y - step[:n]
            tau = tau - step[n:]
            if np.abs(step[:n]).max() < CLOSE * (1.0 + np.abs(y).max()):
                return y[: model.n_a], tau
        raise SolverError(
            f"{self.model.name}: no equilibrium found with the motors at "
            f"{np.round(q_m, 4).tolist()} rad; the springs are too soft for the load there"
        )

    def rests(
        self, motion: Mapping[str, np.ndarray], values: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Arm angles (n_a,) and holding torques (n_m,) of robots with the numbers ``values``
        (lanes, n_p) at the start of a motion ``q_a``, ``q_m``.
        """
        return tuple(self.rest(motion["q_m"][0], own, motion["q_a"][0]) for own in values)

    def matrices(
        self, motion: Sequence[np.ndarray], values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """``M, D, K`` (k, n, n) and ``B`` (k, n, n_m) along a motion
        ``q_a v_a a_a q_m v_m a_m tau_m`` (k, ...).
        """
        found = evaluate(self._jacobians, *motion, *self._pass_parameters(self._jacobians, values))
        return second_order_matrices(*found)

    def largest_rate(self, motion: Sequence[np.ndarray], values: np.ndarray) -> float:
        """Largest size of an eigenvalue along a motion [1/s]."""
        return second_order.largest_rate(*self.matrices(motion, values)[:3])

    def _motion(self, y: np.ndarray, q_m: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, ...]:
        """The arguments of the residual for rest at coordinates y (k, n), under torques tau
        (n_m,): ``q_a v_a a_a q_m v_m a_m tau_m``. Angles of motors behind rigid gears are those of
        ``q_m``, of the others those in y.
        """
        k = len(y)
        n_a = self.model.n_a
        n_m = self.model.n_m
        arm = np.zeros((k, n_a))
        motors = np.zeros((k, n_m))
        angles = np.tile(q_m, (k, 1))
        angles[:, list(self.model.i_m)] = y[:, n_a:]
        return y[:, :n_a], arm, arm, angles, motors, motors, np.tile(tau, (k, 1))

    def _pass_parameters(
        self, function: ca.Function, values: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        return (values,) if "parameters" in function.name_in() else ()


def check_design(
    model: RobotModel, sample_s: float, delay_s: float, motion: Sequence[np.ndarray]
) -> None:
    """ArgumentError unless a sampled controller can be designed at points of a motion."""
    check_positive("sample_s", sample_s, "a time > 0 in s")
    check_not_negative("delay_s", delay_s, "a time >= 0 in s")
    check_motion(model, motion)


def check_motion(model: RobotModel, motion: Sequence[np.ndarray]) -> None:
    """ArgumentError unless the arrays are points of a motion of the model, see
    `LocalDynamics.matrices`.
    """
    widths = [*[model.n_a] * 3, *[model.n_m] * 4]
    shapes = [np.shape(x) for x in motion]
    if (
        not shapes
        or [(len(motion[0]), n) for n in widths] != shapes
        or not all(np.isfinite(x).all() for x in motion)
    ):
        raise ArgumentError(
            f"motion: given arrays of shapes {show_value(shapes)}, expected finite q_a, v_a, "
            f"a_a (k, {model.n_a}) and q_m, v_m, a_m, tau_m (k, {model.n_m}) of {model.name}"
        )
