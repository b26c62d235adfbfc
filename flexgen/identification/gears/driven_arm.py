"""The arm behind motors that move as recorded, and the torques that these motors need.

Motor angles q_m(t) are given, and with them the joints behind rigid gears. The other coordinates
follow,

    M_FF a_F = forces_F - M_FI a_I - ...,
    z' of each element: see `flexgen.dynamics.hysteresis.hysteresis_law`,

and the rows of the motors give their torques. Springs hold the arm to its motors, so that errors
of the model do not grow over a long record, as they do in a simulation under recorded torques.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.fourier import FourierSum
from flexgen.dynamics.hysteresis.hysteresis_law import element_rate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears as gears_of
from flexgen.dynamics.mechanics.motor_harmonics import gear_angles
from flexgen.dynamics.mechanics.system import solve_symmetric
from flexgen.model.elements import Dof
from flexgen.simulation.integration.hysteretic_rate import deflection_rates, generalized_force
from flexgen.simulation.integration.segments import Segments

ARCMIN = np.pi / 180 / 60  # rad
STABLE = 0.5  # integration step times the fastest eigenvalue, at most
NEWTON_STEPS = 50
AT_REST = 1e-12


@dataclass(frozen=True)
class Element:
    """An element of hysteresis: number of its ``gear``, where the search begins, and the numbers
    of its law.

    ``K_h`` [N m/rad, arm side], ``lost`` motion [rad or m], ``exponent`` and ``gamma``; ``unit``:
    of its lost motion in theta [rad or m].
    """

    gear: int
    K_h: float
    lost: float
    exponent: float = 1.0
    gamma: float = 0.0
    unit: float = ARCMIN


@dataclass(frozen=True)
class Sought:
    """Unknowns of the fit besides the parameters of the equations.

    ``elements``: of hysteresis; ``exponents``: whether theirs are fitted; ``errors``: gears with a
    transmission error, of these ``harmonics``; ``cogging``: harmonics of all motors.
    """

    elements: tuple[Element, ...]
    exponents: bool = False
    errors: tuple[int, ...] = ()
    harmonics: tuple[int, ...] = ()
    cogging: tuple[int, ...] = ()

    @property
    def gears(self) -> tuple[int, ...]:
        """Those with hysteresis."""
        return tuple(dict.fromkeys(element.gear for element in self.elements))


@dataclass(frozen=True)
class MotorMotion:
    """Motor angles as a curve: ``time`` (n,) [s] at equal steps, and a quintic spline through the
    angles.

    ``steps``: of the integration from sample to sample.
    """

    time: np.ndarray
    curve: BSpline
    steps: int

    @classmethod
    def through(cls, time: np.ndarray, q_m: np.ndarray, steps: int) -> MotorMotion:
        """The motion through angles (n, n_m) [rad]."""
        return cls(time, make_interp_spline(time, q_m, k=5), steps)

    @cached_property
    def samples(self) -> np.ndarray:
        """Angles, speeds and accelerations (n, 3 n_m) at the samples."""
        return self._at(self.time)

    @cached_property
    def inputs(self) -> np.ndarray:
        """Angles, speeds and accelerations at start, middle and end of all steps: (steps (n - 1),
        3, 3 n_m).
        """
        count = 2 * self.steps * (len(self.time) - 1)
        rows = self._at(np.linspace(self.time[0], self.time[-1], count + 1))
        return np.stack([rows[:-1:2], rows[1::2], rows[2::2]], axis=1)

    def _at(self, time: np.ndarray) -> np.ndarray:
        return np.hstack([self.curve(time, order) for order in range(3)])


class DrivenArm:
    """Simulates the arm of a model without hysteresis, to some of whose gears hysteresis is added.

    Numbers p of a simulation: the parameters of the equations, then K_h and W of the elements of
    hysteresis, arm side, and their exponents where these are fitted, then the coefficients of
    cosines and of sines of the transmission errors, gear by gear, then the largest rate n K_h
    |d'|/W [1/s] of an element: a faster one, of a narrow loop, is slowed down to it for the
    explicit integration.

    Parameters
    ----------
    equations : Equations
        With the numbers that may change as parameters; without transmission errors where they are
        added.
    elements : sequence of Element
        Of hysteresis.
    fitted : bool
        Exponents are numbers of a simulation.
    errors : sequence of int
        Which gears have a transmission error.
    harmonics : sequence of int
        Of these, of a turn of the motor.

    Notes
    -----
    Functions of state, motor motion and numbers: ``rate`` (n_x,), ``torque`` (n_m,) [N m], motor
    side, ``balance``: moments [N m or N] on the coordinates that no motor sets, zero at rest, and
    ``coordinates`` (n_a,) of the arm.
    """

    def __init__(
        self,
        equations: Equations,
        elements: Sequence[Element],
        fitted: bool = False,
        errors: Sequence[int] = (),
        harmonics: Sequence[int] = (),
    ) -> None:
        coefficients = ca.SX.sym("e", len(errors) * 2 * len(harmonics))
        equations = _with_errors(equations, errors, harmonics, coefficients)
        model = equations.model
        count = len(elements)
        i_g = list(equations.model.i_g)
        lag = equations.lagrangian
        (y, dy, ddy) = equations.y
        inverse = np.linalg.inv(equations.model.eta)
        rigid = [k for k, (gear, _) in enumerate(gears_of(model)) if gear.rigid]
        imposed = [i_g[k] for k in rigid] + [model.n_a + k for k in range(len(model.i_m))]
        of_motors = ca.SX(ca.DM(np.vstack([inverse[rigid], np.eye(model.n_m)[list(model.i_m)]])))
        free = [i for i in range(model.dof) if i not in imposed]
        motors = ca.SX.sym("u", 3 * model.n_m)
        known = ca.SX.sym("z", count)
        q_m, v_m, a_m = ca.vertsplit(motors, model.n_m)
        K_h = ca.SX.sym("K_h", count)
        W = ca.SX.sym("W", count)
        z = ca.SX.zeros(model.n_g)
        for k, element in enumerate(elements):
            z[element.gear] += known[k]

        # motors without a coordinate of their own
        behind_rigid = [j for j in range(model.n_m) if j not in model.i_m]
        symbols = [
            lag.tau_m,
            y[imposed],
            dy[imposed],
            ddy[imposed],
            ddy[free],
            *(lag.q_m[j] for j in behind_rigid),
        ]
        symbols = ca.vertcat(*symbols)
        values = [
            ca.SX.zeros(model.n_m),
            *(ca.mtimes(of_motors, part) for part in (q_m, v_m, a_m)),
        ]
        values = ca.vertcat(*values, ca.SX.zeros(len(free)), *(q_m[j] for j in behind_rigid))
        residual = (
            equations.left - lag.forces - generalized_force(equations.with_symbols, z, lag.q_m)
        )
        B = ca.jacobian(lag.forces, lag.tau_m)[imposed, :]
        rate = deflection_rates(equations)
        deflection = gear_angles(equations.with_symbols, lag.q_m) - y[i_g]
        terms = [ca.densify(term) for term in (residual, equations.mass, B, rate, deflection)]
        residual, mass, B, rate, deflection = ca.substitute(terms, [symbols], [values])
        acceleration = solve_symmetric(mass[free, free], -residual[free])
        need = residual[imposed] + ca.mtimes(mass[imposed, free], acceleration)
        rate = ca.vertcat(ca.SX(0, 1), *(rate[element.gear] for element in elements))
        x = ca.vertcat(y[free], dy[free], known)
        largest = ca.SX.sym("largest")
        shapes = ca.SX.sym("n", count if fitted else 0)
        exponents = ca.vertsplit(shapes) if fitted else [element.exponent for element in elements]
        p = ca.vertcat(equations.symbols, K_h, W, shapes, coefficients, largest)
        slower = (
            largest
            * W
            / ca.fmax(largest * W, ca.vertcat(ca.SX(0, 1), *exponents) * K_h * ca.fabs(rate))
        )
        laws = zip(exponents, elements, strict=True)
        rates = [
            element_rate(rate[k], known[k], W[k], n, each.gamma)
            for k, (n, each) in enumerate(laws)
        ]
        dx = ca.vertcat(dy[free], acceleration, slower * K_h * ca.vertcat(ca.SX(0, 1), *rates))

        (coordinates,) = ca.substitute([ca.densify(y[: model.n_a])], [symbols], [values])

        def function(name: str, output: ca.SX) -> ca.Function:
            return ca.Function(name, [x, motors, p], [ca.cse(ca.densify(output))])

        self.model = model
        self.free = free
        self.n_x = 2 * len(free) + count
        self.rate = function("driven_rate", dx)
        self.torque = function("driven_torque", ca.solve(B, need))
        self.balance = function("driven_balance", residual[free])
        self.coordinates = function("driven_coordinates", coordinates)
        self._rest = function(
            "driven_rest", ca.horzcat(residual[free], ca.jacobian(residual[free], y[free]))
        )
        self._deflections = function("driven_deflections", deflection)
        self._change = function("driven_change", ca.jacobian(dx, x))

    def rest(self, q_m: np.ndarray, p: np.ndarray) -> np.ndarray:
        """State (n_x,) at rest with z = 0 for motor angles (n_m,); SolverError where there is
        none.
        """
        u = np.concatenate([q_m, np.zeros(2 * self.model.n_m)])
        joints = np.zeros(self.model.dof)
        joints[list(self.model.i_g)] = np.linalg.inv(self.model.eta) @ q_m
        x = np.zeros(self.n_x)
        n = len(self.free)
        x[:n] = joints[self.free]
        for _ in range(NEWTON_STEPS):
            found = np.array(self._rest(x, u, p))
            step = np.linalg.solve(found[:, 1:], found[:, 0])
            x[:n] -= step
            if np.abs(step).max() < AT_REST:
                return x
        raise SolverError(
            "the model does not rest at the motor angles of the record: check its stiffness and "
            "gravity"
        )

    def joint_speeds(self, v_m: np.ndarray) -> np.ndarray:
        """Speeds of the free coordinates for motor speeds (n_m,) if the gears were rigid."""
        joints = np.zeros(self.model.dof)
        joints[list(self.model.i_g)] = np.linalg.inv(self.model.eta) @ v_m
        return joints[self.free]

    def deflections(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Deflections (n, n_g) of all gears, arm side, for states (n, n_x) and motor motions (n, 3
        n_m).
        """
        return evaluate(self._deflections, x, u, p)[0].reshape(len(x), -1)

    def fastest(self, poses: np.ndarray, p: np.ndarray) -> float:
        """Largest size of an eigenvalue [1/s] at rest at motor angles (k, n_m)."""
        found = 0.0
        for q_m in poses:
            u = np.concatenate([q_m, np.zeros(2 * self.model.n_m)])
            values = np.linalg.eigvals(np.array(self._change(self.rest(q_m, p), u, p)))
            found = max(found, float(np.abs(values).max()))
        return found

    def steps(self, sample_s: float, rate: float) -> int:
        """Steps from sample to sample that fit to the largest eigenvalue ``rate`` [1/s]."""
        return max(1, int(np.ceil(sample_s * rate / STABLE)))

    def segments(self, sample_s: float, steps: int) -> Segments:
        """The simulation with so many steps from sample to sample; its outputs are the motor
        torques [N m].
        """
        return Segments(self.rate, self.torque, sample_s, steps)


def _with_errors(
    equations: Equations, gears: Sequence[int], harmonics: Sequence[int], coefficients: ca.SX
) -> Equations:
    """Equations in which gears have transmission errors with symbolic coefficients.

    The error of a gear is a Fourier sum of its motor angle. Code that is generated from these
    equations takes the coefficients as arguments, so that they can be identified.

    Parameters
    ----------
    equations : Equations
        Without transmission errors of these gears; unchanged where there are no coefficients.
    gears : sequence of int
        Numbers of the gears, among the actuated coordinates.
    harmonics : sequence of int
        H whole numbers >= 1: periods of each term in a turn of the motor.
    coefficients : SX (2 H len(gears),) [rad or m at the joint]
        For one gear after the other, H coefficients of cosines, then H of sines.
    """
    if not coefficients.numel():
        return equations
    robot = equations.with_symbols  # the model, with symbols in place of its parameters
    columns = ca.vertsplit(coefficients, len(harmonics))  # cosines, sines, cosines, sines, ...
    of_joint = {
        robot.coordinates[robot.i_g[k]].name: columns[2 * n : 2 * n + 2]
        for n, k in enumerate(gears)
    }

    def change(dof: Dof) -> Dof:
        if dof.name not in of_joint or dof.gear is None:
            return dof
        cosines, sines = (tuple(ca.vertsplit(x)) for x in of_joint[dof.name])
        error = FourierSum(tuple(harmonics), cosines, sines)
        return replace(dof, gear=replace(dof.gear, transmission_error=error))

    elements = [
        replace(element, dofs=tuple(map(change, element.dofs))) for element in robot.elements
    ]
    return equations.with_elements(elements)
