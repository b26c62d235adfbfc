"""Features of a model that MuJoCo cannot express exactly, and drives: a motor and its gear in an
MJCF file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec.lines import CableLine, RodLine, SpringLine
from flexgen.exports.mechanisms import on_one_chain
from flexgen.exports.mujoco.mujoco_inertia import PARALLEL
from flexgen.model.elements import BacklashSpring, Friction, Motor, RobotModel

FrictionName = Literal["exact", "viscous", "dry"]
FRICTIONS: tuple[FrictionName, ...] = get_args(FrictionName)


@dataclass(frozen=True)
class Drive:
    """A motor in the file.

    ``elastic``: its gear is elastic, so that it has a joint of its own, ``rotor.NAME``.
    ``ratios``: gear ratio of each joint that it drives. ``turning``: speed of its carrier about
    its axis as a sum over joints (empty in simplified coupling); None where it depends on the
    pose, and the rotor is a body on its carrier.
    """

    motor: Motor
    elastic: bool
    ratios: dict[str, float]
    turning: dict[str, float] | None


def refusal(model: RobotModel, key: str, given: str, expected: str) -> ModelError:
    """The error for a part of a model that MuJoCo does not have."""
    return ModelError(model.file, 0, key, given, f"for MuJoCo {expected}")


def with_friction(model: RobotModel, kind: str) -> RobotModel:
    """The model with the frictions that the file shall have; ``"exact"``: those of the model.

    Raises
    ------
    ArgumentError
        There is no such kind.
    """
    if kind not in FRICTIONS:
        raise ArgumentError(f"friction: given {kind!r}, expected one of {', '.join(FRICTIONS)}")
    if kind == "exact":
        return model

    def less(friction: Friction) -> Friction:
        viscous = friction.viscous_at(model.temperature)
        if kind != "dry" or not friction.coulomb:
            return Friction(viscous)
        return Friction(viscous, friction.coulomb, beta=friction.beta)

    elements = tuple(
        replace(e, dofs=tuple(replace(dof, friction=less(dof.friction)) for dof in e.dofs))
        for e in model.elements
    )
    return replace(
        model,
        elements=elements,
        motors=tuple(replace(m, friction=less(m.friction)) for m in model.motors),
    )


def check_laws(model: RobotModel, dry: bool) -> None:
    """Refuse beams and laws of forces that MuJoCo does not have; ``dry``: Coulomb friction is
    accepted.
    """
    for element in model.elements:
        if element.beam is not None:
            raise refusal(
                model, f"element.{element.name}.beam", "a beam with assumed modes", "rigid bodies"
            )
        for dof in element.dofs:
            here = f"element.{element.name}.dof.{dof.name}"
            spring = dof.spring or (dof.gear.spring if dof.gear is not None else None)
            if isinstance(spring, BacklashSpring):
                key = f"{here}.{'spring' if dof.spring else 'gear.spring'}"
                given = "a spring with a smooth dead band"
                raise refusal(model, key, given, "a linear, cubic, smooth or piecewise spring")
            _check_friction(model, f"{here}.friction", dof.friction, dry)
            if dof.counterbalance:
                raise refusal(model, f"{here}.counterbalance", "a counterbalance", "none")
    for motor in model.motors:
        _check_friction(model, f"motor.{motor.name}.friction", motor.friction, dry)
    check_lines(model)


def check_lines(model: RobotModel) -> None:
    """Refuse lines that a spatial tendon of MuJoCo is not: it has no mass, and its force is linear
    in its length beyond a length >= 0.
    """
    for line in model.lines:
        here = f"line.{line.name}"
        if not isinstance(line, SpringLine | RodLine):
            what = "a cable" if isinstance(line, CableLine) else "a gas spring"
            raise refusal(model, here, what, "a spring or a rod")
        if line.mass:
            raise refusal(model, f"{here}.mass", f"{line.mass:g} kg", "a line without mass")
        if slack_length(line) < 0.0:
            given = f"a spring without force at the length {slack_length(line):.4g} m"
            raise refusal(model, f"{here}.preload", given, "preload <= stiffness length")


def slack_length(line: SpringLine | RodLine) -> float:
    """Length [m] at which a line has no force; below 0 of a spring with a large preload."""
    preload = line.preload if isinstance(line, SpringLine) else 0.0
    if line.stiffness == 0.0:
        return line.length
    return line.length - preload / line.stiffness


def _check_friction(model: RobotModel, key: str, friction: Friction, dry: bool) -> None:
    """Refuse a friction that MuJoCo does not have: another law, or Coulomb, Stribeck and offset
    terms unless Coulomb friction is written as ``dry``. ``key``: its place in the model file.
    """
    other = (
        'or friction = "viscous" (leaves the others out), or "dry" (Coulomb friction as MuJoCo '
        "has it)"
    )
    if type(friction) is not Friction:
        raise refusal(
            model, key, f"the friction law {type(friction).__name__}", f"viscous friction, {other}"
        )
    for name in ("coulomb", "stribeck", "offset"):
        value = getattr(friction, name)
        if value and not dry:
            what = (
                "a constant torque"
                if name == "offset"
                else "which is a function tanh of the speed"
            )
            raise refusal(
                model, f"{key}.{name}", f"{value:g}, {what}", f"viscous friction, {other}"
            )


def drives(model: RobotModel) -> tuple[Drive, ...]:
    """All motors of a model.

    Raises
    ------
    ModelError
        A motor with a rigid gear turns with a body about several directions, or with joints on
        several branches.
    """
    names = [model.coordinates[i].name for i in model.i_g]
    out = []
    for j, motor in enumerate(model.motors):
        ratios = {name: float(x) for name, x in zip(names, model.eta[j], strict=True) if x}
        turning = _turning(model, j)
        joints = {**ratios, **(turning or {})}
        if j not in model.i_m and motor.inertia and not on_one_chain(model, joints):
            given = (
                "a rotor behind rigid gears that turns with joints on several branches "
                f"({', '.join(joints)})"
            )
            raise refusal(
                model, f"motor.{motor.name}.drives", given, "elastic gears, or joints on one chain"
            )
        out.append(Drive(motor, j in model.i_m, ratios, turning))
    return tuple(out)


def _turning(model: RobotModel, j: int) -> dict[str, float] | None:
    """Factors by which speeds of joints turn rotor ``j`` with its carrier; empty where they do
    not, None behind an elastic gear, whose rotor is a body.

    ModelError for a rigid gear on a carrier that turns about several directions.
    """
    motor = model.motors[j]
    if model.motor_coupling != "complete" or motor.carrier == "base" or motor.inertia == 0.0:
        return {}
    if j in model.i_m:
        return None
    assert motor.carrier is not None and motor.axis is not None
    spin = common_axis(model, motor.carrier)
    if spin is None:
        given = (
            f"complete coupling of a motor with a rigid gear on {motor.carrier}, which turns "
            "about several directions"
        )
        expected = 'an elastic gear, or motor_coupling = "simplified"'
        raise refusal(model, f"motor.{motor.name}.carrier", given, expected)
    along = float(spin[0] @ np.array(motor.axis))
    return {name: sign * along for name, sign in spin[1].items() if abs(along) > PARALLEL}


def common_axis(model: RobotModel, name: str) -> tuple[np.ndarray, dict[str, float]] | None:
    """The one direction about which an element turns, in its body frame, and the sign of each
    joint; None if several.

    ``omega = axis sum_k sign_k v_k``: parallel axes stay parallel, wherever the joints are.
    """
    axis: np.ndarray | None = None
    signs: dict[str, float] = {}
    above = [name]
    while above[-1] in model.parents:
        above.append(model.parents[above[-1]])
    for element in (element for element in model.elements if element.name in above):
        axis = None if axis is None else np.array(element.origin.rotation).T @ axis
        for dof in element.dofs:
            if dof.type == "rotation":
                own = np.array(dof.axis)
                axis = own if axis is None else axis
                if np.linalg.norm(np.cross(axis, own)) > PARALLEL:
                    return None
                signs[dof.name] = float(np.sign(axis @ own))
        axis = None if axis is None else np.array(element.link.rotation).T @ axis
    return (np.zeros(3) if axis is None else axis), signs
