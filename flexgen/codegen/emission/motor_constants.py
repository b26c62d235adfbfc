"""Numbers of the model that the hand-written C uses: gears, motors and the kind of output."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.model.elements import LinearSpring, RobotModel
from flexgen.model.inertia import rotor_stages
from flexgen.model.position_servo.keys import ServoTable

if TYPE_CHECKING:
    from flexgen.dynamics.mechanics.parameters import Parameter


@dataclass(frozen=True)
class MotorConstants:
    """Gears, motors and the kind of output of a model.

    Parameters
    ----------
    i_g, i_e : tuple of int
        Indices in q_a of the actuated and of the unactuated coordinates.
    eta, eta_inverse : tuple of tuple of float
        ``q_m = eta q_g``, rows.
    rotor_inertia : tuple of float
        Motor side [kg m^2].
    gear_damping : tuple of float
        Arm side [N m s/rad, N s/m]; zero for rigid gears.
    damping_factor : tuple of float
        From the damping in the model file to that of the arm side: 1, or the gear ratio squared.
    gears : tuple of str
        Names of the actuated coordinates, which name the gears.
    gear_is_rigid, gear_is_linear : tuple of bool
    hysteresis_stiffness, hysteresis_slip : tuple of tuple of float
        ``K_h`` and ``W`` of the layers of `flexgen.dynamics.hysteresis.hysteresis`, arm side; zero
        for gears without an element.
    hysteresis_curve, hysteresis_bend : tuple of tuple
        The curve of each element, -1 for those by Dahl's law, and the largest second derivative of
        it.
    curves : tuple of tuple
        Of each curve `flexgen.dynamics.hysteresis.hysteresis_law.Curve.table`: where its parts
        begin, and the rows.
    lugre : dict of str to tuple of float
        Numbers of `flexgen.dynamics.hysteresis.lugre.MotorBristles` by their names; empty where no
        motor has any.
    highest_harmonic : int
        Of the Fourier sums of motor angles; zero: none.
    coupling_stages : int
        In which the gears follow from each other in complete motor coupling.
    arm_side : tuple of float
        Of each position in the state of ``linearize``: 1, or the largest gear ratio of a motor
        behind elastic gears.
    servo : ServoTable, optional
        Of libraries with positions to send.
    pose : bool
        Whether the output is a pose.
    positions : int
        Number of outputs that are the position of the tool.
    further : tuple of bool
        Where others follow them, but a pose: of each output, whether it is an angle; else empty.
    massless : bool
        Whether a motion has no inertia, see
        `flexgen.dynamics.mechanics.inversion_functions.lacks_inertia`.
    """

    i_g: tuple[int, ...]
    i_e: tuple[int, ...]
    eta: tuple[tuple[float, ...], ...]
    eta_inverse: tuple[tuple[float, ...], ...]
    rotor_inertia: tuple[float, ...]
    gear_damping: tuple[float, ...]
    damping_factor: tuple[float, ...]
    gears: tuple[str, ...]
    gear_is_rigid: tuple[bool, ...]
    gear_is_linear: tuple[bool, ...]
    hysteresis_stiffness: tuple[tuple[float, ...], ...]
    hysteresis_slip: tuple[tuple[float, ...], ...]
    hysteresis_curve: tuple[tuple[int, ...], ...]
    hysteresis_bend: tuple[tuple[float, ...], ...]
    curves: tuple[tuple[tuple[int, ...], tuple[tuple[float, ...], ...]], ...]
    lugre: dict[str, tuple[float, ...]]
    highest_harmonic: int
    coupling_stages: int
    arm_side: tuple[float, ...]
    servo: ServoTable | None
    pose: bool
    positions: int
    further: tuple[bool, ...]
    massless: bool


def position_obstacle(model: RobotModel) -> str | None:
    """Why a library of a model cannot give the positions that its servo needs; None where it
    can.
    """
    if model.servo is None:
        return f"model {model.name} has no table [servo]"
    if any(one.zero_damping <= 0.0 for one in model.servo.notch):
        return (
            f"a notch filter of the servo of model {model.name} has zeros without damping: its "
            "inverse is unstable"
        )
    return None


def _lugre(model: RobotModel) -> dict[str, tuple[float, ...]]:
    """The numbers of the frictions with a state, by their names in C."""
    from flexgen.dynamics.hysteresis.lugre import motor_bristles

    law = motor_bristles(model)
    if not law.present.any():
        return {}
    numbers = (law.coulomb, law.static, law.stribeck_speed, law.stiffness, law.damping)
    names = ("coulomb", "static", "speed", "stiffness", "damping")
    return {
        name: tuple(float(x) for x in values) for name, values in zip(names, numbers, strict=True)
    }


def _further(model: RobotModel) -> tuple[bool, ...]:
    """Whether each output is an angle, if others follow the position of the tool; else empty."""
    output = model.output
    has_others = output.has_angle or output.is_with_joints
    if not has_others:
        return ()
    units = (*output_units(model), *["rad"] * 3 * output.is_pose)
    return tuple(unit == "rad" for unit in units)


def motor_constants(
    model: RobotModel,
    position: bool = False,
    equations: Any = None,
    parameters: Sequence[Parameter] = (),
) -> MotorConstants:
    """The `MotorConstants` of a model that can be inverted; ``position``: with its servo, where C
    has its inverse.

    equations, parameters: of the library, for `MotorConstants.massless`.
    """
    from flexgen.codegen.emission.routines import is_massless
    from flexgen.dynamics.hysteresis.hysteresis import gear_layers  # here, as these need CasADi
    from flexgen.dynamics.hysteresis.hysteresis_law import curve_of
    from flexgen.dynamics.mechanics.lagrangian import gears
    from flexgen.dynamics.mechanics.motor_harmonics import highest_harmonics

    def rows(A: Iterable[np.ndarray]) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(float(x) for x in row) for row in A)

    made = gears(model)
    layers = gear_layers(model)
    laws = sorted(
        {layer.laws[k] for layer in layers for k in layer.curved},
        key=lambda law: (type(law).__name__, astuple(law)),
    )
    numbers = {law: k for k, law in enumerate(laws)}
    return MotorConstants(
        i_g=model.i_g,
        i_e=model.i_e,
        eta=rows(model.eta),
        eta_inverse=rows(np.linalg.inv(model.eta)),
        rotor_inertia=tuple(float(motor.inertia) for motor in model.motors),
        gear_damping=tuple(
            0.0 if gear.rigid else float(ratio**2 * gear.damping) for gear, ratio in made
        ),
        damping_factor=tuple(0.0 if gear.rigid else float(ratio**2) for gear, ratio in made),
        gears=tuple(model.coordinates[i].name for i in model.i_g),
        gear_is_rigid=tuple(gear.rigid for gear, _ in made),
        gear_is_linear=tuple(isinstance(gear.spring, LinearSpring) for gear, _ in made),
        hysteresis_stiffness=rows([layer.stiffness for layer in layers]),
        hysteresis_slip=rows([layer.slip for layer in layers]),
        hysteresis_curve=tuple(
            tuple(numbers.get(law, -1) for law in layer.laws) for layer in layers
        ),
        hysteresis_bend=rows([layer.bend for layer in layers]),
        curves=tuple(
            (part, rows(table)) for part, table in (curve_of(law).table() for law in laws)
        ),
        lugre=_lugre(model),
        highest_harmonic=int(highest_harmonics(model).max(initial=0)),
        coupling_stages=max(rotor_stages(model), default=0),
        arm_side=(*(1.0,) * model.n_a, *(float(abs(model.eta[i]).max()) for i in model.i_m)),
        servo=model.servo if position and position_obstacle(model) is None else None,
        pose=model.output.type == "tool_pose",
        positions=len(model.output.axes),
        further=_further(model),
        massless=equations is not None and is_massless(equations, parameters),
    )
