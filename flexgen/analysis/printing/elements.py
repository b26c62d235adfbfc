"""Elements of a model in symbols: a name for each quantity, the steps of the chain, force laws.

Zeros are dropped and quarter turns taken exactly, so that only what matters gets a symbol.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp

from flexgen.analysis.printing.printing import Entry, Name
from flexgen.base.errors import ArgumentError
from flexgen.model.elements import (
    BacklashSpring,
    Body,
    CubicSpring,
    Friction,
    LinearSpring,
    Placement,
    RobotModel,
    SmoothSpring,
    Spring,
    Vector,
)

Expr3 = tuple[sp.Expr, sp.Expr, sp.Expr]
_AXES = "xyz"
_MOMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
_SNAP = 1e-12  # rad: rotations this close to a quarter turn are taken as one
_TINY = 1e-14  # components of a unit axis below are round-off


class Symbols:
    """Hands out one symbol for each quantity; zeros stay zeros."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []

    def new(self, name: Name, unit: str, meaning: str, value: float | None = None) -> sp.Symbol:
        """A new symbol; where its name is taken, a number is added."""
        taken = {entry.symbol.name for entry in self.entries}
        first = name
        k = 1
        while name.text() in taken:
            k += 1
            name = replace(
                first, plain=f"{first.text()}_({k})", subscripts=(*first.subscripts, f"({k})")
            )
        symbol = sp.Symbol(name.text(), real=True)
        self.entries.append(Entry(symbol, name, unit, meaning, value))
        return symbol

    def parameter(
        self, head: str, subscripts: tuple[str, ...], value: float, unit: str, meaning: str
    ) -> sp.Expr:
        """A symbol with a value; 0 where the value is zero."""
        if value == 0.0:
            return sp.Integer(0)
        return self.new(Name(head, subscripts), unit, meaning, float(value))

    def vector(self, heads: str, owner: str, value: Vector, unit: str, meaning: str) -> Expr3:
        """Three parameters: ``heads`` is one letter, with x, y, z as subscripts, or three
        letters.
        """
        owners = (owner,) if owner else ()
        out = []
        for k, axis in enumerate(_AXES):
            head, subscripts = (heads[k], owners) if len(heads) == 3 else (heads, (axis, *owners))
            out.append(self.parameter(head, subscripts, value[k], unit, f"{meaning}, {axis}"))
        return out[0], out[1], out[2]


@dataclass(frozen=True)
class Shift:
    """A constant translation in the current frame."""

    by: Expr3


@dataclass(frozen=True)
class Turn:
    """A constant rotation about an axis of the current frame."""

    axis: int
    angle: sp.Symbol | int  # a number of quarter turns


@dataclass(frozen=True)
class Joint:
    """An arm coordinate: rotation about, or translation along, a unit axis of the current
    frame.
    """

    index: int
    axis: Expr3
    rotation: bool


@dataclass(frozen=True)
class Mass:
    """A rigid body in the current frame."""

    mass: sp.Expr
    com: Expr3
    inertia: dict[tuple[int, int], sp.Expr]
    drag: sp.Expr


@dataclass(frozen=True)
class Rotor:
    """A motor's rotor that turns with the current frame."""

    index: int
    inertia: sp.Expr
    axis: Expr3


@dataclass(frozen=True)
class Tip:
    """The end of an element, on which others may be: the current frame."""

    name: str


@dataclass(frozen=True)
class Return:
    """The next frame is at the tip of this element, or at the base."""

    name: str


Step = Shift | Turn | Joint | Mass | Rotor | Tip | Return


def placement_steps(
    symbols: Symbols, head: str, owner: str, placement: Placement, meaning: str
) -> list[Step]:
    """A constant pose: a shift, then turns about z, y, x (yaw, pitch, roll), exact where they are
    quarter turns.
    """
    steps: list[Step] = []
    shift = symbols.vector(head, owner, placement.position, "m", meaning)
    if any(shift):
        steps.append(Shift(shift))
    R = np.array(placement.rotation)
    yaw = math.atan2(R[1, 0], R[0, 0]) if math.hypot(R[0, 0], R[1, 0]) > _SNAP else 0.0
    c = math.cos(yaw)
    s = math.sin(yaw)
    rest = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    pitch = math.atan2(-rest[2, 0], rest[0, 0])
    roll = math.atan2(-rest[1, 2], rest[1, 1])
    for axis, angle, greek, word in (
        (2, yaw, "psi", "yaw"),
        (1, pitch, "theta", "pitch"),
        (0, roll, "phi", "roll"),
    ):
        quarters = round(angle / (math.pi / 2))
        if abs(angle - quarters * math.pi / 2) > _SNAP:
            steps.append(
                Turn(
                    axis,
                    symbols.new(Name(greek, (head, owner)), "rad", f"{meaning}, {word}", angle),
                )
            )
        elif quarters % 4:
            steps.append(Turn(axis, quarters % 4))
    return steps


def _axis(symbols: Symbols, head: str, owner: str, axis: Vector) -> Expr3:
    """A unit vector: exact along the axes of the frame, otherwise with symbols for its
    components.
    """
    rounded = tuple(0.0 if abs(x) < _TINY else x for x in axis)
    if sum(x != 0.0 for x in rounded) == 1:
        x, y, z = (sp.Integer(0 if x == 0.0 else int(math.copysign(1, x))) for x in rounded)
        return x, y, z
    return symbols.vector(head, owner, rounded, "1", f"axis of {owner}")


def _body(symbols: Symbols, owner: str, body: Body) -> Mass | None:
    """Mass, center of mass, inertia and drag of a body of ``owner`` as symbols, those that are
    zero as 0; None where all are.
    """
    mass = symbols.parameter("m", (owner,), body.mass, "kg", f"mass of {owner}")
    com = (
        symbols.vector("xyz", owner, body.com, "m", f"center of mass of {owner}")
        if body.mass
        else (sp.Integer(0),) * 3
    )
    inertia = {}
    for i, j in _MOMENTS:
        moment = f"{_AXES[i]}{_AXES[j]}"
        value = symbols.parameter(
            "I",
            (moment, owner),
            body.inertia[i][j],
            "kg m^2",
            f"inertia of {owner} about its center, {moment}",
        )
        inertia[i, j] = inertia[j, i] = value
    drag = symbols.parameter(
        "d", (owner,), body.rotational_drag, "N m s/rad", f"rotational drag of {owner}"
    )
    return (
        Mass(mass, com, inertia, drag) if mass != 0 or drag != 0 or any(inertia.values()) else None
    )


def chain_steps(model: RobotModel, symbols: Symbols, rotor: list[sp.Expr]) -> list[Step]:
    """Constants, joints, bodies and (complete coupling) rotors, of inertias ``rotor``, from the
    base to the tool.

    Branches begin with a `Return` to the tip of their parent.
    """
    rotors: dict[str, list[Step]] = {}
    for j, motor in enumerate(model.motors):
        if model.motor_coupling == "complete" and motor.carrier != "base":
            assert motor.axis is not None and motor.carrier is not None  # checked by the reader
            axis = _axis(symbols, "a", motor.name, motor.axis)
            rotors.setdefault(motor.carrier, []).append(Rotor(j, rotor[j], axis))
    steps: list[Step] = []
    k = 0
    here = "base"
    for element in model.elements:
        if model.parents[element.name] != here:
            steps.append(Return(model.parents[element.name]))
        here = element.name
        steps += placement_steps(
            symbols,
            "o",
            element.name,
            element.origin,
            f"origin of {element.name} from the tip before",
        )
        for dof in element.dofs:
            steps.append(Joint(k, _axis(symbols, "n", dof.name, dof.axis), dof.type == "rotation"))
            k += 1
        steps += placement_steps(
            symbols,
            "l",
            element.name,
            element.link,
            f"frame of {element.name} from its last joint",
        )
        body = _body(symbols, element.name, element.body)
        steps += (
            ([body] if body else [])
            + rotors.pop(element.name, [])
            + [Tip(element.name)] * model.branched
        )
    if model.tip != here:
        steps.append(Return(model.tip))
    payload = _body(symbols, "payload", model.payload)
    steps += [payload] if payload else []
    return steps + placement_steps(
        symbols, "t", "tool", Placement(model.tool.position), "tool from the last tip"
    )


def spring_law(
    symbols: Symbols, spring: Spring, d: sp.Expr, owner: str, units: tuple[str, str]
) -> sp.Expr:
    """Torque of a spring at the deflection ``d``, with symbols for its numbers; ``owner``: the
    joint; ``units`` of torque and deflection.
    """
    torque, deflection = units

    def stiffness(head: str, value: float, meaning: str, power: str = "") -> sp.Expr:
        """A stiffness as symbol; ``head``: its letter, and words for subscripts; ``power``: of the
        deflection in its unit.
        """
        unit = f"{torque}/{deflection}{power}"
        return symbols.parameter(
            head[0], (*head[1:].split(), owner), value, unit, f"{meaning} of {owner}"
        )

    if isinstance(spring, LinearSpring):
        return stiffness("K", spring.stiffness, "stiffness") * d
    if isinstance(spring, CubicSpring):
        cubic = stiffness("K 3", spring.cubic, "cubic stiffness", "^3")
        return stiffness("K", spring.stiffness, "stiffness") * d + cubic * d**3
    if isinstance(spring, BacklashSpring):
        gap = symbols.parameter("b", (owner,), spring.gap, deflection, f"half backlash of {owner}")
        smooth = symbols.parameter(
            "epsilon",
            (owner,),
            spring.smoothing,
            deflection,
            f"rounding of the backlash of {owner}",
        )
        clipped = (sp.sqrt((d + gap) ** 2 + smooth**2) - sp.sqrt((d - gap) ** 2 + smooth**2)) / 2
        return stiffness("K", spring.stiffness, "stiffness") * (d - clipped)
    low = stiffness("K low", spring.low, "low stiffness")
    high = stiffness("K high", spring.high, "high stiffness")
    at = symbols.new(
        Name("psi", (owner,)), deflection, f"break of the stiffness of {owner}", spring.break_at
    )
    if isinstance(spring, SmoothSpring):
        inside = low * d + (high - low) * d**3 / (3 * at**2)
        offset = 2 * (high - low) * at / 3
    else:
        inside = low * d
        offset = (high - low) * at
    return sp.Piecewise((inside, sp.Abs(d) <= at), (high * d - offset * sp.sign(d), True))


def friction_law(
    symbols: Symbols, friction: Friction, w: sp.Symbol, owner: str, units: tuple[str, str]
) -> sp.Expr:
    """Friction torque at the speed ``w``, with symbols for its numbers: viscous and offset, and
    Coulomb with Stribeck part times ``tanh(beta w)``.

    ``owner``: joint or motor; ``units`` of torque and coordinate. ArgumentError for another law
    than the smooth one.
    """
    if type(friction) is not Friction:
        raise ArgumentError(
            f"friction of {owner}: given the law {type(friction).__name__}, which has no closed "
            "form here; expected the law 'smooth'"
        )
    torque, deflection = units

    def parameter(head: str, value: float, unit: str, meaning: str) -> sp.Expr:
        first, *rest = head.split()
        return symbols.parameter(first, (*rest, owner), value, unit, f"{meaning} of {owner}")

    viscous = parameter("F v", friction.viscous, f"{torque} s/{deflection}", "viscous friction")
    force = viscous * w + parameter("F o", friction.offset, torque, "friction offset")
    if friction.coulomb == 0.0 and friction.stribeck == 0.0:
        return force
    level = parameter("F c", friction.coulomb, torque, "Coulomb friction")
    if friction.stribeck != 0.0:
        alpha = parameter(
            "alpha", friction.alpha, f"s/{deflection}", "slope of the Stribeck friction"
        )
        level = level + parameter("F s", friction.stribeck, torque, "Stribeck friction") / sp.cosh(
            alpha * w
        )
    return force + level * sp.tanh(
        parameter("beta", friction.beta, f"s/{deflection}", "slope of the friction") * w
    )


class Forces:
    """Springs, dampers, frictions and gears of a model in symbols; arguments as in
    `SymbolicEquations`.

    ``torques``: on the arm, None behind a rigid gear. ``deflections``: of nonlinear gear springs.
    ``friction``: of the joints. ``on_motors``: friction of the motors and the torques that the
    gears need. ``gear_equations``: of rigid gears.
    """

    def __init__(
        self,
        model: RobotModel,
        symbols: Symbols,
        q_a: tuple[sp.Symbol, ...],
        v_a: tuple[sp.Symbol, ...],
        tau: tuple[sp.Symbol, ...],
        q_m: tuple[sp.Symbol, ...],
        v_m: tuple[sp.Symbol, ...],
        units: list[tuple[str, str]],
    ) -> None:
        self.deflections: dict[sp.Symbol, sp.Expr] = {}
        self.torques: list[sp.Expr | None] = []
        self.friction: list[sp.Expr] = []
        eta = sp.zeros(model.n_m, model.n_g)
        place = {model.coordinates[i].name: (k, units[i]) for k, i in enumerate(model.i_g)}
        for j, motor in enumerate(model.motors):
            for name, ratio in zip(motor.drives, motor.ratio, strict=True):
                k, (_, unit) = place[name]
                owner = (motor.name,) if len(motor.drives) == 1 else (motor.name, name)
                meaning = f"gear ratio, {motor.name} to {name}"
                exact = abs(ratio) == 1.0 and unit == "rad"
                eta[j, k] = (
                    sp.Integer(int(ratio))
                    if exact
                    else symbols.parameter("r", owner, ratio, f"rad/{unit}", meaning)
                )
        inverse = eta.inv().applyfunc(sp.factor) if model.n_g else eta
        # motors from the arm side
        seen = inverse * sp.Matrix(q_m)
        rate = inverse * sp.Matrix(v_m)
        for i, coordinate in enumerate(model.coordinates):
            dof = coordinate.dof
            name = coordinate.name
            assert dof is not None  # beams have been refused
            self.friction.append(friction_law(symbols, dof.friction, v_a[i], name, units[i]))
            damping_unit = f"{units[i][0]} s/{units[i][1]}"
            if dof.gear is None:
                assert dof.spring is not None
                spring = spring_law(symbols, dof.spring, q_a[i], name, units[i])
                damping = symbols.parameter(
                    "D", (name,), dof.damping, damping_unit, f"damping of {name}"
                )
                self.torques.append(-spring - damping * v_a[i])
                continue
            if dof.gear.rigid:
                self.torques.append(None)
                continue
            assert dof.gear.spring is not None
            k = place[name][0]
            ratio = sp.Integer(1)
            side_units = units[i]
            side = f"{name}, arm side"
            if dof.gear.side == "motor":
                ratio = next(
                    eta[j, k] for j, motor in enumerate(model.motors) if motor.drives == (name,)
                )
                side_units = ("N m", "rad")
                damping_unit = "N m s/rad"
                side = f"{name}, motor side"
            deflection = sp.cancel(ratio * seen[k]) - ratio * q_a[i]
            slip = sp.cancel(ratio * rate[k]) - ratio * v_a[i]
            if not isinstance(dof.gear.spring, LinearSpring):
                symbol = symbols.new(
                    Name("delta", (name,)), side_units[1], f"deflection of the gear of {side}"
                )
                self.deflections[symbol] = deflection
                deflection = symbol
            torque = spring_law(symbols, dof.gear.spring, deflection, name, side_units)
            damping = symbols.parameter(
                "D", (name,), dof.gear.damping, damping_unit, f"damping of {side}"
            )
            self.torques.append(ratio * (torque + damping * slip))
        asked = (inverse.T * sp.Matrix([tau[i] for i in model.i_g])).applyfunc(sp.together)
        self.on_motors = [
            friction_law(symbols, motor.friction, v_m[j], motor.name, ("N m", "rad")) + asked[j]
            for j, motor in enumerate(model.motors)
        ]
        geared = eta * sp.Matrix([q_a[i] for i in model.i_g])
        self.gear_equations = [(q_m[j], geared[j]) for j in range(model.n_m) if j not in model.i_m]
