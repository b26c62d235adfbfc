"""Random robots: hypothesis draws what a robot is made of, a seeded generator its numbers.

Robots are `RobotModel` objects inside what the model format allows: chains of one to seven
actuated axes, each with up to three elastic degrees of freedom around it. The special cases in
which simplifications go wrong are as likely as the general ones: exact quarter turns, zero
offsets, concentric and parallel axes, massless bodies, point masses, thin rods, poses at multiples
of 90 degrees; some axes and quarter turns are tilted a little. `text_of` writes such a robot as a
model file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st
from referee import Referee, State, matrix, twist_size, vector
from scipy.spatial.transform import Rotation

from flexgen.model.elements import (
    IDENTITY,
    ZERO,
    BacklashSpring,
    Body,
    CubicSpring,
    Dof,
    Element,
    Friction,
    Gear,
    LinearSpring,
    Motor,
    Output,
    PiecewiseSpring,
    Placement,
    RobotModel,
    SmoothSpring,
    Spring,
)

# least eigenvalue of the mass matrix scaled to a unit diagonal: coordinates that can be told apart
POSED = 1e-6
POSES = ("anywhere", "anywhere", "square")
PLACEMENTS = ("none", "quarter", "shifted", "general")
TILTED = 0.1  # share of the axes and quarter turns that are off by a small angle
BODIES = ("full", "full", "centred", "rod", "point", "massless")


@dataclass(frozen=True)
class Case:
    """A random robot with some states of it; ``linear``: every spring and friction is linear, no
    drag.
    """

    model: RobotModel
    states: tuple[State, ...]
    linear: bool


# --- numbers -------------------------------------------------------------------------------------


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between low and high whose order of magnitude is random."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def quarter_turns(rng: np.random.Generator) -> np.ndarray:
    """One of the 24 rotations that take axes to axes, without rounding."""
    out = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    return out * np.linalg.det(out).round() + 0.0


def tilt(rng: np.random.Generator) -> np.ndarray:
    """Mostly none; a rotation by 1e-15 to 1e-2 about any axis now and then."""
    direction = rng.normal(size=3)
    digits = rng.uniform(2, 15)
    share = rng.uniform()
    if share > TILTED:
        return np.eye(3)
    return Rotation.from_rotvec(10.0**-digits * direction / np.linalg.norm(direction)).as_matrix()


def placement(rng: np.random.Generator, kind: str) -> Placement:
    """A pose of a kind: with offsets of 0.05 m to 1.5 m along axes, or general."""
    along = (
        np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 0.0, 1.0]) * spread(rng, 0.05, 1.5) + 0.0
    )
    if kind == "none":
        return Placement()
    if kind == "shifted":
        return Placement(vector(along))
    if kind == "quarter":
        return Placement(vector(along), matrix(quarter_turns(rng) @ tilt(rng)))
    offset = rng.normal(size=3)
    offset *= spread(rng, 0.05, 1.5) / np.linalg.norm(offset)
    return Placement(vector(offset), matrix(Rotation.random(rng=rng).as_matrix()))


def axis(rng: np.random.Generator, general: bool) -> tuple[float, ...]:
    """A coordinate axis of either sign, sometimes tilted a little; or any direction."""
    if not general:
        direction = tilt(rng) @ np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0]) + 0.0
        return vector(direction / np.linalg.norm(direction))
    direction = rng.normal(size=3)
    return vector(direction / np.linalg.norm(direction))


def body(rng: np.random.Generator, kind: str, drag: float = 0.0) -> Body:
    """A body of 0.1 kg to 100 kg of a kind; full ones are made of eight point masses."""
    if kind == "massless":
        return Body()
    mass = spread(rng, 0.1, 100.0)
    size = spread(rng, 0.05, 0.5)
    com = vector(rng.uniform(-size, size, 3))
    if kind == "point":
        return Body(mass, com, rotational_drag=drag)
    if kind == "rod":
        moment = mass * size**2 / 3
        return Body(mass, (size, 0.0, 0.0), matrix(np.diag([0.0, moment, moment])), drag)
    points = rng.uniform(-size, size, (8, 3))
    parts = rng.dirichlet(np.ones(8)) * mass
    points = points - parts @ points / mass
    inertia = np.einsum("i,ij,ij->", parts, points, points) * np.eye(3) - np.einsum(
        "i,ij,ik->jk", parts, points, points
    )
    if kind == "centred":
        com = ZERO
        inertia = np.diag(np.diag(inertia))
    return Body(mass, com, matrix((inertia + inertia.T) / 2), drag)


def spring(rng: np.random.Generator, stiffness: float, linear: bool) -> Spring:
    """A spring of about that stiffness."""
    if linear:
        return LinearSpring(stiffness)
    kinds = (
        CubicSpring(stiffness, 3e3 * stiffness),
        SmoothSpring(0.3 * stiffness, stiffness, 0.01),
        PiecewiseSpring(0.3 * stiffness, stiffness, 0.01),
        BacklashSpring(stiffness, 0.005, 0.002),
    )
    return kinds[rng.integers(len(kinds))]


def friction(rng: np.random.Generator, size: float, linear: bool, rate: float = 5.0) -> Friction:
    """No friction, viscous friction, or all that there is; it bends at speeds of ``1 / rate``."""
    kind = rng.integers(2 if linear else 3)
    if kind == 0:
        return Friction()
    viscous = size * rng.uniform(0.1, 1.0)
    if kind == 1:
        return Friction(viscous=viscous)
    return Friction(viscous, 2 * size, 1.5 * size, 0.4 * rate, rate, 0.3 * size)


# --- the chain -----------------------------------------------------------------------------------


@dataclass
class _Chain:
    """A chain under construction."""

    rng: np.random.Generator
    linear: bool
    rigid: tuple[bool, ...]
    # axes with a motor of their own: only there the spring may be stated on the motor side
    alone: tuple[bool, ...]
    ratios: list[float]
    elements: list[Element]
    dofs: list[Dof]

    def axis(self, kind: str, general: bool) -> tuple[float, ...]:
        """An axis that the degree of freedom just before has not."""
        for _ in range(20):
            new = axis(self.rng, general)
            if (
                not self.dofs
                or self.dofs[-1].type != kind
                or abs(np.dot(self.dofs[-1].axis, new)) < 0.99
            ):
                break
        return new

    def actuated(self, k: int, kind: str, general: bool, on_motor: bool) -> None:
        """The geared degree of freedom of axis k."""
        rng = self.rng
        arm = spread(self.rng, 1e3, 1e6) * (1.0 if kind == "rotation" else 10.0)
        if self.rigid[k]:
            gear = Gear(rigid=True)
        else:
            side = "motor" if on_motor and self.alone[k] else "arm"
            shrink = self.ratios[k] ** 2 if side == "motor" else 1.0
            damping = float(rng.choice([0.0, 1.0]) * arm * spread(rng, 1e-4, 1e-2))
            gear = Gear(False, side, spring(rng, arm / shrink, self.linear), damping / shrink)
        rub = friction(rng, 5.0, self.linear)
        self.dofs.append(Dof(f"g{k}", kind, self.axis(kind, general), gear=gear, friction=rub))

    def elastic(self, name: str, kind: str, general: bool) -> None:
        """A degree of freedom with a spring and perhaps a damper."""
        rng = self.rng
        stiffness = spread(rng, 1e3, 1e6) * (1.0 if kind == "rotation" else 10.0)
        damping = float(rng.choice([0.0, 1.0]) * stiffness * spread(rng, 1e-4, 1e-2))
        made = spring(rng, stiffness, self.linear)
        rub = friction(rng, 2.0, self.linear)
        self.dofs.append(
            Dof(name, kind, self.axis(kind, general), spring=made, damping=damping, friction=rub)
        )

    def close(self, origin: str, link: str, kind: str) -> None:
        """End the element: what was added since the last one moves a body of a kind."""
        rng = self.rng
        drag = 0.0 if self.linear else float(rng.choice([0.0, 0.3]))
        made = body(rng, kind, drag)
        name = f"b{len(self.elements)}"
        self.elements.append(
            Element(name, tuple(self.dofs), placement(rng, origin), placement(rng, link), made)
        )
        self.dofs = []


@st.composite
def robots(
    draw: st.DrawFn,
    linear: bool | None = None,
    coupling: str | None = None,
    gears: str | None = None,
) -> RobotModel:
    """Robots; ``linear``, ``coupling`` and ``gears`` ("elastic", "rigid", "mixed") where they are
    not left open.
    """
    linear = draw(st.booleans()) if linear is None else linear
    coupling = (
        draw(st.sampled_from(["simplified", "simplified", "complete"]))
        if coupling is None
        else coupling
    )
    gears = (
        draw(st.sampled_from(["elastic", "elastic", "rigid", "mixed"])) if gears is None else gears
    )
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 7))
    # this axis and the one before it have coupled motors; 0: there is none
    wrist = draw(st.integers(0, n - 1))
    rigid = [gears == "rigid" or (gears == "mixed" and draw(st.booleans())) for _ in range(n)]
    if wrist:
        rigid[wrist] = rigid[wrist - 1]
    types = [draw(st.sampled_from(["rotation"] * 4 + ["translation"])) for _ in range(n)]
    ratios = [
        float(rng.choice([-1, 1])) * spread(rng, 10.0, 200.0) * (1 if t == "rotation" else 5)
        for t in types
    ]
    alone = tuple(k not in (wrist, wrist - 1) or not wrist for k in range(n))
    chain = _Chain(rng, linear, tuple(rigid), alone, ratios, [], [])
    places = st.sampled_from(PLACEMENTS)
    bodies = st.sampled_from(BODIES)
    left = 18 - n

    if draw(st.booleans()):
        chain.close(draw(places), draw(places), draw(bodies))  # a pedestal: nothing moves it
    for k in range(n):
        count = min(left, draw(st.sampled_from([0, 0, 1, 1, 2, 3])))
        left -= count
        at = draw(st.integers(0, count))  # elastic degrees of freedom before the actuated one
        for i in range(count + 1):
            if i == at:
                chain.actuated(k, types[k], draw(st.booleans()), draw(st.booleans()))
            else:
                kind = draw(st.sampled_from(["rotation", "rotation", "translation"]))
                chain.elastic(f"e{k}{i}", kind, draw(st.booleans()))
            if i < count and draw(st.booleans()):
                chain.close(draw(places), draw(places), draw(bodies))
        chain.close(draw(places), draw(places), "full" if k == n - 1 else draw(bodies))

    names = [f"g{k}" for k in range(n)]
    elements = tuple(chain.elements)
    carriers = ["base", *(element.name for element in elements)]
    motors = []
    for k in range(n):
        drives = (names[k],)
        ratio = (ratios[k],)
        if wrist and k in (wrist, wrist - 1):
            drives = (names[wrist - 1], names[wrist])
            ratio = (ratios[wrist - 1], ratios[wrist])
            if k == wrist:
                ratio = (-0.4 * ratio[0], ratio[1])
        motors.append(
            Motor(
                f"m{k}",
                0.0 if rigid[k] and draw(st.booleans()) else spread(rng, 1e-5, 1e-2),
                drives,
                vector(ratio),
                friction=friction(rng, 0.01, linear, 0.05),
                axis=axis(rng, draw(st.booleans())) if coupling == "complete" else None,
                carrier=draw(st.sampled_from(carriers)) if coupling == "complete" else None,
            )
        )
    return RobotModel(
        name="drawn",
        description="made for tests",
        source="random numbers",
        gravity=vector(
            draw(
                st.sampled_from([np.array([0.0, 0.0, -9.81]), np.zeros(3), rng.normal(size=3) * 6])
            )
        ),
        base=placement(rng, draw(places)),
        elements=elements,
        motors=tuple(motors),
        tool=placement(rng, draw(places)),
        payload=body(rng, draw(st.sampled_from(["massless", "full", "point"]))),
        output=Output("tool_position"),
        home=vector(np.zeros(n)),
        moves=(),
        motor_coupling=coupling,
    )


def state(model: RobotModel, rng: np.random.Generator, pose: str) -> State:
    """A state: rotations anywhere or at multiples of 90 degrees, springs strained, motors near
    their joints.
    """
    n_a = model.n_a
    i_g = list(model.i_g)

    def draw(n: int) -> np.ndarray:
        return rng.uniform(-1, 1, n)

    q_a = np.zeros(n_a)
    v_a = 2 * draw(n_a)
    a_a = 3 * draw(n_a)
    twist = np.zeros(model.n_g)
    for i, coordinate in enumerate(model.coordinates):
        dof = coordinate.dof
        assert dof is not None
        if dof.spring is not None:
            q_a[i] = 0.0 if pose == "square" else twist_size(dof.spring) * rng.uniform(-1, 1)
            v_a[i] *= 0.3
        elif dof.type == "rotation":
            q_a[i] = (
                rng.integers(-2, 3) * np.pi / 2 if pose == "square" else rng.uniform(-np.pi, np.pi)
            )
        else:
            q_a[i] = rng.integers(-1, 2) * 0.5 if pose == "square" else 0.8 * rng.uniform(-1, 1)
    for k, i in enumerate(i_g):
        gear = model.coordinates[i].dof.gear
        if not gear.rigid:
            on_motor = gear.side == "motor" and not isinstance(
                gear.spring, LinearSpring | CubicSpring
            )
            twist[k] = twist_size(gear.spring) / (
                np.abs(model.eta[:, k]).max() if on_motor else 1.0
            )
    q_m = model.eta @ (q_a[i_g] + twist * draw(model.n_g))
    v_m = model.eta @ (v_a[i_g] * (1 + 0.05 * draw(model.n_g)))
    tau_m = np.linalg.solve(model.eta.T, 100 * draw(model.n_g))
    return State(q_a, v_a, a_a, q_m, v_m, tau_m)


def well_posed(model: RobotModel, states: tuple[State, ...]) -> bool:
    """Whether no motion of the arm is (nearly) without inertia, at zero and in the states.

    Asked of the recursion, not of flexgen; at zero, because MuJoCo looks there before it is asked
    anything; without the rotors, because those that the arm carries do not hold it while they are
    free to turn.
    """
    judge = Referee(replace(model, motor_coupling="simplified"))
    for q_a in (np.zeros(model.n_a), *(s.q_a for s in states)):
        M = judge.mass_matrix(q_a)
        size = np.sqrt(np.abs(np.diag(M)))
        if not size.all() or np.linalg.eigvalsh(M / np.outer(size, size))[0] < POSED:
            return False
    return True


@st.composite
def cases(draw: st.DrawFn, **fixed) -> Case:
    """A random robot and three states; ``fixed``: see `robots`."""
    model = draw(robots(**fixed))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    states = tuple(state(model, rng, pose) for pose in POSES)
    assume(well_posed(model, states))
    return Case(model, states, is_linear(model))


def is_linear(model: RobotModel) -> bool:
    """Whether every spring is linear, every friction viscous, and no body has a drag."""
    dofs = [c.dof for c in model.coordinates]
    springs = [dof.spring or dof.gear.spring for dof in dofs]
    frictions = [x.friction for x in (*dofs, *model.motors)]
    drags = [body.rotational_drag for body in (*(e.body for e in model.elements), model.payload)]
    return (
        all(spring is None or isinstance(spring, LinearSpring) for spring in springs)
        and not any(f.coulomb or f.stribeck or f.offset for f in frictions)
        and not any(drags)
    )


# --- the same as a model file --------------------------------------------------------------------


def roll_pitch_yaw(rotation) -> tuple[float, float, float]:
    """Angles of ``Rz(yaw) Ry(pitch) Rx(roll)``; the roll is what yaw leaves: near right angles it
    holds all digits.
    """
    R = np.array(rotation)
    yaw = math.atan2(R[1, 0], R[0, 0])
    c = math.cos(yaw)
    s = math.sin(yaw)
    pitch = math.atan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    return math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1]), pitch, yaw


def text_of(model: RobotModel) -> str:  # noqa: C901
    """The model as the text of a model file."""

    def row(values) -> str:
        return "[" + ", ".join(repr(float(x)) for x in values) + "]"

    def pose(p: Placement) -> str:
        turn = "" if p.rotation == IDENTITY else f", rpy_rad = {row(roll_pitch_yaw(p.rotation))}"
        return f"{{ position = {row(p.position)}{turn} }}"

    def solid(b: Body) -> str:
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = b.inertia
        inertia = row((xx, yy, zz, xy, yz, xz))
        return (
            f"{{ mass = {b.mass!r}, com = {row(b.com)}, inertia = {inertia}, rotational_drag = "
            f"{b.rotational_drag!r} }}"
        )

    def law(s: Spring) -> str:
        kind = type(s).__name__.removesuffix("Spring").lower()
        return (
            f'{{ type = "{kind}", ' + ", ".join(f"{k} = {v!r}" for k, v in vars(s).items()) + " }"
        )

    def rub(f: Friction) -> str:
        return "{ " + ", ".join(f"{k} = {v!r}" for k, v in vars(f).items()) + " }"

    def drive(g: Gear) -> str:
        if g.spring is None:
            return '{ type = "rigid" }'
        return (
            f'{{ type = "elastic", side = "{g.side}", spring = {law(g.spring)}, damping = '
            f"{g.damping!r} }}"
        )

    lines = [
        f'name = "{model.name}"',
        f"gravity = {row(model.gravity)}",
        f"home_rad = {row(model.home)}",
        f'motor_coupling = "{model.motor_coupling}"',
        f"base = {pose(model.base)}",
        f"tool = {pose(model.tool)}",
        f"payload = {solid(model.payload)}",
        'output = { type = "tool_position", axes = "xyz" }',
    ]
    for element in model.elements:
        lines += ["[[element]]", f'name = "{element.name}"', f"origin = {pose(element.origin)}"]
        lines += [f"link = {pose(element.link)}", f"body = {solid(element.body)}"]
        for dof in element.dofs:
            lines += [
                "[[element.dof]]",
                f'name = "{dof.name}"',
                f'type = "{dof.type}"',
                f"axis = {row(dof.axis)}",
            ]
            lines.append(f"friction = {rub(dof.friction)}")
            if dof.gear is not None:
                lines.append(f"gear = {drive(dof.gear)}")
            if dof.spring is not None:
                lines += [f"spring = {law(dof.spring)}", f"damping = {dof.damping!r}"]
    for motor in model.motors:
        names = ", ".join(f'"{name}"' for name in motor.drives)
        lines += [
            "[[motor]]",
            f'name = "{motor.name}"',
            f"drives = [{names}]",
            f"ratio = {row(motor.ratio)}",
        ]
        lines += [f"inertia = {motor.inertia!r}", f"friction = {rub(motor.friction)}"]
        if motor.axis is not None:
            lines += [f"axis = {row(motor.axis)}", f'carrier = "{motor.carrier}"']
    return "\n".join(lines) + "\n"
