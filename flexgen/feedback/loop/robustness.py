"""Robustness: tool errors of solutions on plants that differ from the model, with and without
feedback.

Each solution is simulated on plants whose springs or masses differ from the model's, in two ways:

feedforward    the torque alone, open loop; the arm drifts where the torque does not carry it.
feedback       the torque and the P-PI cascade of `flexgen.simulation.motor_feedback` around the
               motor angles, with the reference of the same solution. Its gains are those that
               `flexgen.simulate` and `flexgen.predict` take: by the default frequencies of
               `flexgen.analysis.servo_gains`, for the nominal model at rest at the start of the
               path.

The robot starts in equilibrium with the motors at the first reference; with feedback the
integrator starts with the torque that the feedforward lacks. So rigid and fjm start with the
static deflection as tool error; errors are given against the path and against the position at the
start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from scipy.integrate import DOP853
from scipy.interpolate import make_interp_spline

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import Evaluator, evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.dynamics.mechanics.statics import hold_joints, hold_motors
from flexgen.inversion.solution import Solution
from flexgen.model.elements import (
    BacklashSpring,
    Beam,
    Body,
    CubicSpring,
    Element,
    LinearSpring,
    RobotModel,
    Spring,
)
from flexgen.paths.path import Path
from flexgen.simulation.motor_feedback import MotorFeedback, default_feedback

# Relative and absolute tolerance of the integration [rad or m, and per s]: a tenth of a micrometer
# of the tool, whose errors are millimeters.
RTOL = 1e-8
ATOL = 1e-10
# The same of the torque of the integral part [N m].
ATOL_TORQUE = 1e-6
# Longest sampling interval of the error [s].
SAMPLE = 2e-3
ControlName = Literal["feedforward", "feedback"]
CONTROLS: tuple[ControlName, ...] = get_args(ControlName)


@dataclass(frozen=True)
class Plant:
    """A robot that differs from the model: all springs ``stiffness`` times as stiff, all masses
    ``mass`` times.
    """

    name: str
    stiffness: float = 1.0
    mass: float = 1.0


PLANTS = (
    Plant("nominal"),
    Plant("stiffness +5 %", stiffness=1.05),
    Plant("stiffness -5 %", stiffness=0.95),
    Plant("stiffness +20 %", stiffness=1.2),
    Plant("stiffness -20 %", stiffness=0.8),
    Plant("mass +5 %", mass=1.05),
    Plant("mass -5 %", mass=0.95),
)


def perturb(model: RobotModel, plant: Plant) -> RobotModel:
    """The model with other stiffnesses (gears, joints, beams) and other masses (bodies with
    inertias, payload, beams).

    Dampings, frictions, rotors and geometry are unchanged.
    """
    for name in ("stiffness", "mass"):
        value = getattr(plant, name)
        if not (np.isfinite(value) and value > 0):
            raise ArgumentError(
                f"plant {plant.name}: given {name} {value}, expected a positive factor"
            )
    elements = tuple(_element(element, plant) for element in model.elements)
    return replace(model, elements=elements, payload=_body(model.payload, plant.mass))


def _element(element: Element, plant: Plant) -> Element:
    """An element of a robot whose springs are stiffer and bodies heavier by the factors of
    ``plant``.
    """
    dofs = []
    for dof in element.dofs:
        gear = dof.gear
        spring = dof.spring
        if gear is not None and gear.spring is not None:
            gear = replace(gear, spring=_spring(gear.spring, plant.stiffness))
        dofs.append(
            replace(
                dof, gear=gear, spring=None if spring is None else _spring(spring, plant.stiffness)
            )
        )
    beam = element.beam
    if beam is not None:
        beam = _beam(beam, plant)
    return replace(element, dofs=tuple(dofs), body=_body(element.body, plant.mass), beam=beam)


def _beam(beam: Beam, plant: Plant) -> Beam:
    """A beam that is stiffer and heavier by the factors of ``plant``; the shapes of its modes stay
    those of the model.
    """
    bendings = tuple(replace(b, stiffness=b.stiffness * plant.stiffness) for b in beam.bendings)
    torsion = beam.torsion
    if torsion is not None:
        torsion = replace(
            torsion,
            stiffness=torsion.stiffness * plant.stiffness,
            inertia_per_length=torsion.inertia_per_length * plant.mass,
        )
    stretch = beam.stretch
    if stretch is not None:
        stretch = replace(stretch, stiffness=stretch.stiffness * plant.stiffness)
    return replace(
        beam,
        mass_per_length=beam.mass_per_length * plant.mass,
        bendings=bendings,
        torsion=torsion,
        stretch=stretch,
    )


def _spring(spring: Spring, factor: float) -> Spring:
    """A spring with all its torques multiplied; breaks and gaps are unchanged."""
    if isinstance(spring, LinearSpring | BacklashSpring):
        return replace(spring, stiffness=spring.stiffness * factor)
    if isinstance(spring, CubicSpring):
        return replace(spring, stiffness=spring.stiffness * factor, cubic=spring.cubic * factor)
    return replace(spring, low=spring.low * factor, high=spring.high * factor)


def _body(body: Body, factor: float) -> Body:
    inertia = tuple(tuple(x * factor for x in row) for row in body.inertia)
    return replace(body, mass=body.mass * factor, inertia=inertia)


def compare_plants(
    equations: Equations,
    solutions: Mapping[str, Solution],
    plants: Sequence[Plant] = PLANTS,
    controls: Sequence[str] = CONTROLS,
    *,
    progress: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """Errors of the tool for each plant, control and solution.

    Parameters
    ----------
    equations : Equations
        Of the nominal model.
    solutions : mapping
        Solutions of one and the same move by name, say ``{"rigid": solve(..., "rigid"), ...}``.
    plants, controls
        What to simulate; controls: of ``CONTROLS``.
    progress : callable, optional
        Called with one line of text for each simulation.

    Returns
    -------
    list of dicts, SI units
        ``plant``, ``stiffness``, ``mass`` (factors), ``control``, ``method``; largest errors of
        the tool against the path, ``error_max_m`` and ``error_max_rad``, at the start,
        ``error_start_*``, against the position at the start, ``error_moved_*``, and at the end of
        the path, ``error_end_*`` (None where the output has no such part); ``torque_max_Nm``,
        motor side. A simulation that fails has infinite errors.
    """
    for control in controls:
        if control not in CONTROLS:
            raise ArgumentError(f"controls: given {control!r}, expected {' or '.join(CONTROLS)}")
    moves = {solution.move.name for solution in solutions.values()}
    if len(moves) != 1:
        raise ArgumentError(
            f"solutions: given moves {', '.join(sorted(moves)) or 'none'}, expected solutions "
            "of one move"
        )
    path = Path(equations, next(iter(solutions.values())).move)
    until = max(solution.trajectory.time[-1] for solution in solutions.values())
    feedback = feedback_at_start(equations, path)
    out = []
    for plant in plants:
        same = plant.stiffness == 1.0 and plant.mass == 1.0
        perturbed_robot = equations if same else Equations(perturb(equations.model, plant))
        for control in controls:
            for method, solution in solutions.items():
                if progress is not None:
                    progress(f"robustness: {plant.name}, {control}, {method}")
                run = _Run(
                    perturbed_robot,
                    path,
                    solution.trajectory,
                    until,
                    feedback if control == "feedback" else None,
                )
                row = {"plant": plant.name, "stiffness": plant.stiffness, "mass": plant.mass}
                out.append({**row, "control": control, "method": method, **run.figures()})
    return out


def tool_errors(
    robot: Equations,
    nominal: Equations,
    solution: Solution,
    control: str = "feedback",
) -> dict[str, Any]:
    """Errors of the tool of one robot under the torques of a solution, as in a row of
    `compare_plants`.

    Parameters
    ----------
    robot : Equations
        The robot that moves.
    nominal : Equations
        Of the model that the gains of the motor controllers come from.
    solution : Solution
    control : str
        ``"feedforward"`` or ``"feedback"``.
    """
    if control not in CONTROLS:
        raise ArgumentError(f"control: given {control!r}, expected {' or '.join(CONTROLS)}")
    path = Path(nominal, solution.move)
    feedback = feedback_at_start(nominal, path) if control == "feedback" else None
    until = float(solution.trajectory.time[-1])
    return _Run(robot, path, solution.trajectory, until, feedback).figures()


def feedback_at_start(equations: Equations, path: Path) -> MotorFeedback:
    """The default feedback of a model, by its inertias at rest at the start of a path."""
    model = equations.model
    q = path.q_start
    rest = hold_joints(equations, q[list(model.i_g)], q[list(model.i_e)])
    return default_feedback(equations, rest.q_a, rest.q_m, rest.tau_m)


class _Run:
    """One simulation: a plant under the torque of a trajectory, with or without feedback."""

    def __init__(
        self,
        equations: Equations,
        path: Path,
        trajectory: Trajectory,
        until: float,
        feedback: MotorFeedback | None,
    ) -> None:
        """``until``: instant [s] at which the simulation ends; ``feedback``: of the motors, None:
        open loop. Torque and motor angles become quintic splines.
        """
        self.equations = equations
        self.path = path
        self.feedback = feedback
        t = trajectory.time
        k = min(5, len(trajectory.time) - 1)
        self.first = float(t[0])
        self.last = float(t[-1])
        self.until = float(until)
        self.torque, self.angle = (
            make_interp_spline(t, trajectory[name], k=k) for name in ("tau_m", "q_m")
        )
        self.speed = self.angle.derivative()
        self.q_start = trajectory["q_a"][0]
        self.q_m_start = trajectory["q_m"][0]

    def figures(self) -> dict[str, Any]:
        """The figures of one row."""
        names = [
            f"error_{what}_{unit}"
            for what in ("max", "start", "moved", "end")
            for unit in ("m", "rad")
        ]
        try:
            t, q_a, torque_max = self._integrate()
        except SolverError:
            return {**dict.fromkeys(names, np.inf), "torque_max_Nm": np.inf}
        out: dict[str, Any] = dict.fromkeys(names)
        end = int(np.searchsorted(t, self.path.duration - 1e-12))
        for unit, error in output_errors(self.equations, self.path, t, q_a).items():
            size = np.linalg.norm(error, axis=1)
            out[f"error_max_{unit}"] = float(size.max())
            out[f"error_start_{unit}"] = float(size[0])
            out[f"error_moved_{unit}"] = float(np.linalg.norm(error - error[0], axis=1).max())
            out[f"error_end_{unit}"] = float(size[min(end, len(size) - 1)])
        return {**out, "torque_max_Nm": torque_max}

    def _integrate(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Simulate the robot under the torques of the trajectory and the feedback, from rest.

        Returns
        -------
        t : array (n,) [s]
        q_a : array (n, n_a) [rad or m]
        largest : float [N m]
            The largest motor torque at these instants.
        """
        model = self.equations.model
        n = model.dof
        n_a = model.n_a
        n_m = model.n_m
        feedback = self.feedback
        equilibrium = hold_motors(self.equations, self.q_m_start, self.q_start)
        state_rate = Evaluator(self.equations.function("state_rate"))

        def torque(t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Torque (n_m,) [N m] at the state x and the derivative of the integral of the
            feedback; outside of the trajectory its first or last torque and angle are held.
            """
            inside = min(max(t, self.first), self.last)
            tau = self.torque(inside)
            if feedback is None:
                return tau, np.zeros(n_m)
            v_ref = self.speed(inside) if t == inside else np.zeros(n_m)
            reference = np.concatenate([self.angle(inside), v_ref])
            more, rate_of_total = feedback.torque(x[: 2 * n], x[2 * n :], reference)
            return tau + more, rate_of_total

        def rate(t: float, x: np.ndarray) -> np.ndarray:
            tau, integrator = torque(t, x)
            return np.concatenate([state_rate(x[: 2 * n], tau)[0].ravel(), integrator])

        total = np.zeros(n_m)
        resolved = np.ones(n_m)
        if feedback is not None:
            # torque [N m] for each rad of the integral
            stiffness = feedback.speed_gain * feedback.integral_gain
            total = (equilibrium.tau_m - self.torque(self.first)) / stiffness
            resolved = ATOL_TORQUE / stiffness
        motors = equilibrium.q_m[list(model.i_m)]
        start = np.concatenate([equilibrium.q_a, motors, np.zeros(n), total])
        t = np.linspace(
            self.first, self.until, int(np.ceil((self.until - self.first) / SAMPLE)) + 1
        )
        atol = np.concatenate([np.full(2 * n, ATOL), resolved])
        solver = DOP853(rate, t[0], start, t[-1], rtol=RTOL, atol=atol)
        out = np.empty((len(t), len(start)))
        k = 1
        out[0] = start
        while k < len(t):
            solver.step()
            if (
                solver.status == "failed"
                or not np.isfinite(solver.y).all()
                or solver.nfev > 1_000_000
            ):
                raise SolverError(f"simulation: failed at t = {solver.t:.6g} s")
            dense = solver.dense_output()
            while k < len(t) and t[k] <= solver.t:
                out[k] = dense(t[k])
                k += 1
        # at the samples: trial steps of the integrator have other states, and larger torques
        largest = max(float(np.abs(torque(*row)[0]).max()) for row in zip(t, out, strict=True))
        return t, out[:, :n_a], largest


def output_errors(
    equations: Equations, path: Path, t: np.ndarray, q_a: np.ndarray
) -> dict[str, np.ndarray]:
    """Errors of the output against the path at the instants ``t`` (n,) [s] with arm coordinates
    ``q_a`` (n, n_a): by unit, "m" and "rad", arrays (n, parts).

    Of an orientation: sine of the angle times the axis, in world axes.
    """
    sample = path.sample(t)
    units = np.array(output_units(equations.model))
    error = evaluate(equations.function("output"), q_a)[0].reshape(len(t), -1) - sample.y[:, :, 0]
    out = {unit: error[:, units == unit] for unit in ("m", "rad") if (units == unit).any()}
    if equations.model.output.type == "combination" or sample.R is None:
        return out
    E = evaluate(equations.function("forward_kinematics"), q_a)[1] @ sample.R.transpose(0, 2, 1)
    turn = (
        np.stack(
            [E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]], axis=1
        )
        / 2
    )
    return {**out, "rad": turn}
