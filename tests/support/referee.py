"""An independent referee of the equations of motion: recursive Newton-Euler in plain numpy.

It shares nothing with ``flexgen.dynamics.mechanics``: accelerations go outward along the chain and
wrenches come back, in world axes and with moments about the world's origin. A beam is a cloud of
point masses on its deflected axis, followed by the two translations and two rotations of its tip,
each of them a linear function of the modal coordinates. A rotor is a body with the angular
momentum ``J (v_m + a.omega) a``, a the axis of the rotor. Mass matrices come from unit
accelerations.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from shipped_models import all_variants

from flexgen.base.numerics.evaluate import Evaluator
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import (
    BacklashSpring,
    Beam,
    Bending,
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
from flexgen.model.reader import model_names, read

# Gauss points along a beam: integrates products of the first ten or so modes to rounding
SLICES = 80


# -------------------------------------------------------------------------------------------------
# forces
# -------------------------------------------------------------------------------------------------


def spring_torque(spring: Spring, d: float) -> float:
    """The torque of a spring at twist d, from the formulas of the model's docstrings."""
    size = abs(d)
    sign = 1.0 if d >= 0 else -1.0
    match spring:
        case LinearSpring(k):
            return k * d
        case CubicSpring(k, k3):
            return k * d + k3 * d**3
        case SmoothSpring(low, high, b):
            inside = min(size, b)
            return sign * (
                low * inside + (high - low) / (3 * b * b) * inside**3 + high * (size - inside)
            )
        case PiecewiseSpring(low, high, b):
            inside = min(size, b)
            return sign * (low * inside + high * (size - inside))
        case BacklashSpring(k, gap, s):
            return k * (d - 0.5 * (np.hypot(d + gap, s) - np.hypot(d - gap, s)))
    raise TypeError(spring)


def friction_torque(f: Friction, w: float) -> float:
    """The friction torque at speed w, from the formula of the model's docstring."""
    return (
        f.viscous * w
        + (f.coulomb + f.stribeck / np.cosh(f.alpha * w)) * np.tanh(f.beta * w)
        + f.offset
    )


# -------------------------------------------------------------------------------------------------
# beams
# -------------------------------------------------------------------------------------------------


def clamped_free(k: int, s: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Mode k = 1, 2, ... of a clamped-free beam of unit length, scaled to a unit deflection of its
    tip.

    Returns the root b of ``cos b cosh b = -1``, the shape at s and its slope at the tip.
    """
    middle = (k - 0.5) * np.pi
    b = brentq(
        lambda x: np.cos(x) + 1 / np.cosh(x), middle - 0.5, middle + 0.5, xtol=1e-15, rtol=1e-15
    )
    ratio = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))

    def shape(x):
        return np.cosh(b * x) - np.cos(b * x) - ratio * (np.sinh(b * x) - np.sin(b * x))

    slope = b * (np.sinh(b) + np.sin(b) - ratio * (np.cosh(b) - np.cos(b)))
    return b, shape(s) / shape(1.0), slope / shape(1.0)


def bending_modes(beam: Beam, bending: Bending) -> list[tuple[float, float]]:
    """Stiffness and damping of each modal coordinate, the deflection of the tip: ``m w^2``,
    ``2 zeta m w``.

    The modal mass is the integral of ``mass_per_length shape^2``.
    """
    x, weight = np.polynomial.legendre.leggauss(SLICES)
    out = []
    for k in range(1, bending.modes + 1):
        b, shape, _ = clamped_free(k, (x + 1) / 2)
        mass = beam.mass_per_length * beam.length * np.sum(weight / 2 * shape**2)
        w = b**2 * np.sqrt(bending.stiffness / (beam.mass_per_length * beam.length**4))
        out.append((mass * w**2, 2 * bending.damping_ratio * mass * w))
    return out


# -------------------------------------------------------------------------------------------------
# the chain as a list of steps
# -------------------------------------------------------------------------------------------------


@dataclass
class Fixed:
    """A constant change of frame."""

    position: np.ndarray
    rotation: np.ndarray


@dataclass
class Joint:
    """Rotation about or translation along an axis; its value is a linear combination of
    coordinates.
    """

    type: str
    axis: np.ndarray
    weights: dict[int, float]


@dataclass
class Mass:
    """A rigid body in the current frame."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray
    drag: float


@dataclass
class Rotor:
    """The rotor of motor j in the current frame."""

    motor: int
    inertia: float
    axis: np.ndarray


@dataclass
class Cloud:
    """Point masses at ``x + sum_k q_k shape_k`` in the current frame."""

    masses: np.ndarray
    points: np.ndarray
    shapes: dict[int, np.ndarray] = field(default_factory=dict)


@dataclass
class Tip:
    """The end of an element."""

    name: str


@dataclass
class Return:
    """The next step begins at the end of this element, or at the base."""

    name: str


def chain_of(model: RobotModel) -> list:
    """The steps of a model from the world to the tool, branches included."""

    def fixed(placement: Placement) -> Fixed:
        return Fixed(np.array(placement.position), np.array(placement.rotation))

    def mass(body: Body) -> Mass:
        return Mass(body.mass, np.array(body.com), np.array(body.inertia), body.rotational_drag)

    def rotors(carrier: str) -> list[Rotor]:
        if model.motor_coupling != "complete":
            return []
        carried = [(j, m) for j, m in enumerate(model.motors) if m.carrier == carrier]
        return [Rotor(j, m.inertia, np.array(m.axis)) for j, m in carried]

    steps: list = [fixed(model.base), *rotors("base"), Tip("base")]
    i = 0
    for element in model.elements:
        if element.parent is not None:
            steps.append(Return(element.parent))
        steps.append(fixed(element.origin))
        for dof in element.dofs:
            steps.append(Joint(dof.type, np.array(dof.axis), {i: 1.0}))
            i += 1
        steps += [fixed(element.link), mass(element.body), *rotors(element.name)]
        if element.beam is not None:
            cloud, tip = beam_steps(element.beam, i)
            steps += [cloud, *tip]
            i += sum(bending.modes for bending in element.beam.bendings)
        steps.append(Tip(element.name))
    return [*steps, Return(model.tip), mass(model.payload), fixed(model.tool)]


def beam_steps(beam: Beam, i: int) -> tuple[Cloud, list]:
    """The point masses of a beam whose first modal coordinate is number i, and the steps from its
    root to its tip.
    """
    x, weight = np.polynomial.legendre.leggauss(SLICES)
    s = (x + 1) / 2
    axis = {"y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}
    points = beam.length * s[:, None] * np.array([1.0, 0.0, 0.0])
    cloud = Cloud(beam.mass_per_length * beam.length * weight / 2, points)
    deflection: dict[str, dict[int, float]] = {"y": {}, "z": {}}
    slope: dict[str, dict[int, float]] = {"y": {}, "z": {}}
    for bending in beam.bendings:
        for k in range(1, bending.modes + 1):
            _, shape, tip_slope = clamped_free(k, s)
            cloud.shapes[i] = shape[:, None] * axis[bending.direction]
            deflection[bending.direction][i] = 1.0
            slope[bending.direction][i] = tip_slope / beam.length
            i += 1
    tip = [
        Fixed(np.array([beam.length, 0.0, 0.0]), np.eye(3)),
        Joint("translation", axis["y"], deflection["y"]),
        Joint("translation", axis["z"], deflection["z"]),
        Joint("rotation", axis["z"], slope["y"]),
        Joint("rotation", axis["y"], {k: -value for k, value in slope["z"].items()}),
    ]
    return cloud, tip


# -------------------------------------------------------------------------------------------------
# the referee
# -------------------------------------------------------------------------------------------------


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of vectors (3,) or rows (n, 3); `numpy.cross` takes seven times as
    long.
    """
    (x, y, z) = a.T
    (u, v, w) = b.T
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u]).T


class Referee:
    """Newton-Euler answers for one model."""

    def __init__(self, model: RobotModel):
        self.model = model
        self.steps = chain_of(model)
        coordinates = model.coordinates
        self.elastic_gear = np.array(
            [not coordinates[i].dof.gear.rigid for i in model.i_g], dtype=bool
        )
        self.elastic_motor = np.array([j in model.i_m for j in range(model.n_m)], dtype=bool)
        self.inertia = np.array([motor.inertia for motor in model.motors])
        self.modal: dict[str, list[tuple[float, float]]] = {}
        for element in model.elements:
            if element.beam is not None:
                modes = [
                    mode
                    for bending in element.beam.bendings
                    for mode in bending_modes(element.beam, bending)
                ]
                names = [
                    c.name for c in coordinates if c.dof is None and c.element == element.name
                ]
                self.modal.update(zip(names, modes, strict=True))

    def sweep(self, q, v, a, v_m=None, a_m=None, gravity=True, drag=False):  # noqa: C901, PLR0915
        """Out along the chain with accelerations, back with wrenches.

        Returns the generalised forces (n_a), the rotors' axial torques ``J (a_m + a.alpha)`` (n_m;
        without the carrier's part where they are not carried), and the tool's (position, rotation,
        twist, acceleration).
        """
        q, v, a = (np.asarray(x, dtype=float) for x in (q, v, a))
        v_m = np.zeros(self.model.n_m) if v_m is None else v_m
        a_m = np.zeros(self.model.n_m) if a_m is None else a_m
        R = np.eye(3)
        p = np.zeros(3)
        w = np.zeros(3)
        dw = np.zeros(3)
        u = np.zeros(3)
        du = -np.array(self.model.gravity) if gravity else np.zeros(3)
        # one for each step: force, moment about the world's origin, direct generalised forces
        wrenches = []
        frames = []
        # the step before each one; where branches begin
        before = []
        last = -1
        tips = {}
        tau_m = self.inertia * a_m
        for k, step in enumerate(self.steps):
            force = np.zeros(3)
            moment = np.zeros(3)
            direct = {}
            if isinstance(step, Return):
                last, R, p, w, dw, u, du = tips[step.name]
            before.append(last)
            last = k
            match step:
                case Tip(name):
                    tips[name] = k, R, p, w, dw, u, du
                case Fixed(position, rotation):
                    r = R @ position
                    u = u + cross(w, r)
                    du = du + cross(dw, r) + cross(w, cross(w, r))
                    p = p + r
                    R = R @ rotation
                case Joint(type_, axis, weights):
                    x, dx, ddx = (sum(c * y[k] for k, c in weights.items()) for y in (q, v, a))
                    e = R @ axis
                    if type_ == "rotation":
                        R = R @ Rotation.from_rotvec(x * axis).as_matrix()
                        dw = dw + e * ddx + cross(w, e) * dx
                        w = w + e * dx
                    else:
                        r = e * x
                        du = (
                            du
                            + cross(dw, r)
                            + cross(w, cross(w, r))
                            + 2 * cross(w, e) * dx
                            + e * ddx
                        )
                        u = u + cross(w, r) + e * dx
                        p = p + r
                case Mass(mass, com, inertia, damping):
                    r = R @ com
                    force = mass * (du + cross(dw, r) + cross(w, cross(w, r)))
                    world = R @ inertia @ R.T
                    moment = cross(p + r, force) + world @ dw + cross(w, world @ w)
                    if drag:
                        moment = moment + damping * w
                case Rotor(j, inertia, axis):
                    e = R @ axis
                    rate = inertia * (a_m[j] + e @ dw)
                    moment = rate * e + inertia * (v_m[j] + e @ w) * cross(w, e)
                    tau_m[j] = rate
                case Cloud(masses, points, shapes):
                    r = points.copy()
                    dr = np.zeros_like(points)
                    ddr = np.zeros_like(points)
                    for k, shape in shapes.items():
                        r = r + q[k] * shape
                        dr = dr + v[k] * shape
                        ddr = ddr + a[k] * shape
                    r = r @ R.T
                    dr = dr @ R.T
                    ddr = ddr @ R.T
                    acc = du + cross(dw, r) + cross(w, cross(w, r)) + 2 * cross(w, dr) + ddr
                    forces = masses[:, None] * acc
                    force = forces.sum(0)
                    moment = cross(p + r, forces).sum(0)
                    direct = {k: np.sum(forces * (shape @ R.T)) for k, shape in shapes.items()}
            wrenches.append((force, moment, direct))
            frames.append((R, p))
        tau = np.zeros(self.model.n_a)
        # force and moment; the last is of the world
        behind = np.zeros((len(self.steps) + 1, 2, 3))
        for k in reversed(range(len(self.steps))):
            step = self.steps[k]
            (R_k, p_k) = frames[k]
            (f, n, direct) = wrenches[k]
            (force, moment) = behind[k]
            if isinstance(step, Joint):
                e = R_k @ step.axis  # a rotation leaves its own axis where it is
                load = e @ (moment - cross(p_k, force)) if step.type == "rotation" else e @ force
                for i, c in step.weights.items():
                    tau[i] += c * load
            for i, value in direct.items():
                tau[i] += value
            behind[before[k]] += force + f, moment + n
        lift = -np.array(self.model.gravity) if gravity else np.zeros(3)
        return tau, tau_m, (p, R, np.concatenate([u, w]), np.concatenate([du - lift, dw]))

    # the arm -------------------------------------------------------------------------------------

    def tool(self, q):
        """Position and rotation of the tool."""
        zero = np.zeros(self.model.n_a)
        return self.sweep(q, zero, zero)[2][:2]

    def twist(self, q, v):
        """Velocity and angular velocity of the tool."""
        return self.sweep(q, v, np.zeros(self.model.n_a))[2][2]

    def acceleration(self, q, v, a):
        """Acceleration and angular acceleration of the tool."""
        return self.sweep(q, v, a)[2][3]

    def inverse_dynamics(self, q, v, a):
        """Generalised forces of the bodies, ``M a + c + g``."""
        return self.sweep(q, v, a)[0]

    def gravity(self, q):
        """Generalised forces that hold the bodies still."""
        zero = np.zeros(self.model.n_a)
        return self.sweep(q, zero, zero)[0]

    def mass_matrix(self, q):
        """Inertia matrix from unit accelerations."""
        zero = np.zeros(self.model.n_a)
        return np.array(
            [self.sweep(q, zero, e, gravity=False)[0] for e in np.eye(self.model.n_a)]
        ).T

    # the extended flexible joint model -----------------------------------------------------------

    def gear_torque(self, q_a, v_a, q_m, v_m):
        """Torques of the gears on the arm side, shape (n_g,); zero at the rigid ones."""
        model = self.model
        out = np.zeros(model.n_g)
        if not self.elastic_gear.any():
            return out
        eta = model.eta[np.ix_(self.elastic_motor, self.elastic_gear)]
        behind = np.zeros((2, model.n_g))
        behind[0, self.elastic_gear] = np.linalg.solve(eta, np.asarray(q_m)[self.elastic_motor])
        behind[1, self.elastic_gear] = np.linalg.solve(eta, np.asarray(v_m)[self.elastic_motor])
        for k, i in enumerate(model.i_g):
            gear = model.coordinates[i].dof.gear
            if gear.rigid:
                continue
            d = behind[0, k] - q_a[i]
            dd = behind[1, k] - v_a[i]
            if gear.side == "arm":
                out[k] = spring_torque(gear.spring, d) + gear.damping * dd
            else:
                (n,) = (
                    m.ratio[m.drives.index(c)]
                    for m in model.motors
                    for c in m.drives
                    if c == self.name(i)
                )
                out[k] = n * (spring_torque(gear.spring, n * d) + gear.damping * n * dd)
        return out

    def name(self, i: int) -> str:
        """Name of arm coordinate i."""
        return self.model.coordinates[i].name

    def _imbalance(self, q_a, v_a, q_m, v_m, tau_m, a_a, a_m):
        """Residual of (arm rows, rows of the motors behind elastic gears), linear in a."""
        model = self.model
        coordinates = self.model.coordinates
        eta = model.eta
        i_g = list(model.i_g)
        v_m = np.where(self.elastic_motor, v_m, eta @ v_a[i_g])
        a_m = np.where(self.elastic_motor, a_m, eta @ a_a[i_g])
        q_m = np.where(self.elastic_motor, q_m, eta @ q_a[i_g])
        tau_a, rotor, _ = self.sweep(q_a, v_a, a_a, v_m, a_m, drag=True)
        applied = np.zeros(model.n_a)
        for i, coordinate in enumerate(coordinates):
            dof = coordinate.dof
            if dof is None:
                stiffness, damping = self.modal[coordinate.name]
                applied[i] = -stiffness * q_a[i] - damping * v_a[i]
                continue
            applied[i] = -friction_torque(dof.friction, v_a[i])
            if not dof.actuated:
                applied[i] -= spring_torque(dof.spring, q_a[i]) + dof.damping * v_a[i]
        friction = np.array(
            [friction_torque(m.friction, w) for m, w in zip(model.motors, v_m, strict=True)]
        )
        drive = tau_m - rotor - friction  # what the motors give to their gears
        gear = self.gear_torque(q_a, v_a, q_m, v_m)
        rigid = ~self.elastic_motor
        # zero on the elastic columns: motors coupled are all of a kind
        gear_rigid = eta[rigid].T @ drive[rigid]
        applied[i_g] += gear + gear_rigid
        back = np.linalg.solve(eta.T, gear) if model.n_m else np.zeros(0)
        return applied - tau_a, (drive - back)[self.elastic_motor]

    def forward_dynamics(self, q_a, v_a, q_m, v_m, tau_m):
        """Accelerations (a_a, a_m) of the full model, all of a_m."""
        model = self.model
        q_a, v_a, q_m, v_m, tau_m = (
            np.asarray(x, dtype=float).ravel() for x in (q_a, v_a, q_m, v_m, tau_m)
        )
        elastic = list(model.i_m)

        def imbalance(a):
            a_m = np.zeros(model.n_m)
            a_m[elastic] = a[model.n_a :]
            return np.concatenate(self._imbalance(q_a, v_a, q_m, v_m, tau_m, a[: model.n_a], a_m))

        # the part linear in a is swept alone: from the imbalance it would come with the rounding
        # of the stiff springs
        A = np.zeros((model.dof, model.dof))
        i_g = list(model.i_g)
        eta = model.eta
        zero_m = np.zeros(model.n_m)
        rigid = ~self.elastic_motor
        for k, e in enumerate(np.eye(model.dof)):
            a_a = e[: model.n_a]
            a_m = zero_m.copy()
            a_m[elastic] = e[model.n_a :]
            a_m = np.where(self.elastic_motor, a_m, eta @ a_a[i_g])
            tau_a, rotor, _ = self.sweep(q_a, 0 * v_a, a_a, zero_m, a_m, gravity=False)
            tau_a[i_g] += eta[rigid].T @ rotor[rigid]
            A[:, k] = np.concatenate([tau_a, rotor[self.elastic_motor]])
        a = np.linalg.solve(A, imbalance(np.zeros(model.dof)))
        a += np.linalg.solve(A, imbalance(a))  # one refinement
        a_m = eta @ a[: model.n_a][i_g]
        a_m[elastic] = a[model.n_a :]
        return a[: model.n_a], a_m

    def torque_scale(self, q_a, v_a, q_m, v_m, tau_m, a_a, a_m):
        """A size of the torques that balance each other in the full model, for relative errors."""
        gear = self.gear_torque(q_a, v_a, q_m, v_m)
        bodies = np.abs(self.inverse_dynamics(q_a, v_a, a_a))
        return max(
            np.max(np.abs(gear), initial=0.0), bodies.max(), np.max(np.abs(tau_m), initial=0.0)
        )


# -------------------------------------------------------------------------------------------------
# the answers of flexgen, as numpy
# -------------------------------------------------------------------------------------------------


class Answers:
    """The functions of ``Equations`` as plain numpy; any of them can be replaced, to plant a
    bug.
    """

    NAMES = (
        "forward_kinematics jacobian jacobian_dot mass_matrix bias gravity inverse_dynamics "
        "forward_dynamics residual energy power gear_torque elastic_torque arm_forces linearize"
    ).split()

    def __init__(self, equations, **replaced):
        self._equations = equations
        self._made = dict(replaced)

    def __getattr__(self, name):
        if name not in self.NAMES:
            raise AttributeError(name)
        if name not in self._made:
            function = self._equations.function(name)
            evaluator = Evaluator(function)
            vector = {k for k in range(function.n_out()) if function.size2_out(k) == 1}
            # what is a matrix stays one, also where it has a single column
            matrix = {
                "mass_matrix": {0},
                "jacobian": {0},
                "jacobian_dot": {0},
                "linearize": {0, 1},
                "forward_kinematics": {1},
            }.get(name, set())

            def answer(*arguments):
                out = [
                    y.ravel() if k in vector - matrix else y
                    for k, y in enumerate(evaluator(*arguments))
                ]
                if name in ("energy", "power"):
                    out = [float(y[0]) for y in out]
                return out[0] if len(out) == 1 else tuple(out)

            self._made[name] = answer
        return self._made[name]

    def but(self, **replaced) -> Answers:
        """Answers with some of them replaced."""
        return Answers(self._equations, **replaced)


# -------------------------------------------------------------------------------------------------
# states and synthetic models
# -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class State:
    """A state of the full model with accelerations and torques to ask about."""

    q_a: np.ndarray
    v_a: np.ndarray
    a_a: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    tau_m: np.ndarray

    @property
    def x(self) -> tuple[np.ndarray, ...]:
        """The arguments (q_a, v_a, q_m, v_m)."""
        return self.q_a, self.v_a, self.q_m, self.v_m


def twist_size(spring: Spring | None) -> float:
    """A twist at which a spring shows its character."""
    match spring:
        case SmoothSpring(break_at=b) | PiecewiseSpring(break_at=b):
            return 2 * b
        case BacklashSpring(gap=gap, smoothing=smoothing):
            return 2 * (gap + smoothing)
    return 0.005


def random_state(model: RobotModel, rng: np.random.Generator, speed: float = 1.0) -> State:
    """A random state around the home pose; both halves of every spring are visited, motors follow
    their joints.
    """

    def draw(n):
        return rng.uniform(-1, 1, n)

    i_g = list(model.i_g)
    i_e = list(model.i_e)
    q_a = np.zeros(model.n_a)
    v_a = speed * draw(model.n_a)
    a_a = 2 * draw(model.n_a)
    # loops close, and gas springs stay in their strokes, around home only
    spread = 0.1 if model.loops or model.lines else 0.7
    q_a[i_g] = np.array(model.home) + spread * draw(model.n_g)
    q_a[i_e] = [
        0.02 if model.coordinates[i].dof is None else twist_size(model.coordinates[i].dof.spring)
        for i in i_e
    ]
    q_a[i_e] *= draw(model.n_e)
    v_a[i_e] *= 0.3
    twist = np.zeros(model.n_g)
    for k, i in enumerate(i_g):
        gear = model.coordinates[i].dof.gear
        if not gear.rigid:
            twist[k] = twist_size(gear.spring)
            if gear.side == "motor" and not isinstance(gear.spring, LinearSpring | CubicSpring):
                twist[k] /= max(np.abs(model.eta[:, k]))
    q_m = model.eta @ (q_a[i_g] + twist * draw(model.n_g))
    v_m = model.eta @ (v_a[i_g] * (1 + 0.05 * draw(model.n_g)))
    tau_m = np.linalg.solve(model.eta.T, 100 * draw(model.n_g))
    return State(q_a, v_a, a_a, q_m, v_m, tau_m)


def random_body(rng: np.random.Generator, drag: float = 0.0) -> Body:
    """A body made of six random point masses."""
    points = rng.uniform(-0.3, 0.3, (6, 3))
    masses = rng.uniform(0.5, 2.0, 6)
    com = masses @ points / masses.sum()
    r = points - com
    inertia = np.einsum(
        "i,ijk->jk",
        masses,
        np.einsum("ij,ij,kl->ikl", r, r, np.eye(3)) - np.einsum("ij,ik->ijk", r, r),
    )
    return Body(float(masses.sum()), vector(com), matrix((inertia + inertia.T) / 2), drag)


def vector(x) -> tuple[float, ...]:
    """A tuple of plain numbers."""
    return tuple(float(y) for y in x)


def matrix(x) -> tuple[tuple[float, ...], ...]:
    """Rows of plain numbers."""
    return tuple(vector(row) for row in x)


def random_placement(rng: np.random.Generator) -> Placement:
    """A random pose within 0.4 m."""
    return Placement(
        vector(rng.uniform(-0.4, 0.4, 3)), matrix(Rotation.random(rng=rng).as_matrix())
    )


def random_axis(rng: np.random.Generator) -> tuple[float, ...]:
    """A random direction."""
    axis = rng.normal(size=3)
    return vector(axis / np.linalg.norm(axis))


SPRINGS: tuple[Spring, ...] = (
    LinearSpring(800.0),
    CubicSpring(600.0, 5e4),
    SmoothSpring(300.0, 1500.0, 0.02),
    PiecewiseSpring(400.0, 1200.0, 0.015),
    BacklashSpring(900.0, 0.01, 0.003),
)
FRICTIONS: tuple[Friction, ...] = (
    Friction(),
    Friction(viscous=0.7),
    Friction(viscous=0.3, coulomb=1.1, beta=6.0),
    Friction(viscous=0.2, coulomb=0.8, stribeck=1.5, alpha=2.0, beta=5.0, offset=0.4),
)


def random_model(
    seed: int, coupling: str = "simplified", gears: str = "mixed", beam: bool = False
) -> RobotModel:
    """A chain of four elements and nine degrees of freedom with everything the model format knows.

    Five of the coordinates are actuated: two and two of the motors are coupled by their ratios,
    the fifth is alone and has its spring on the motor side. ``gears``: "elastic", "rigid" or
    "mixed" (the second pair rigid).
    """
    rng = np.random.default_rng(seed)

    def spring(k):
        return SPRINGS[(seed + k) % len(SPRINGS)]

    def friction(k):
        return FRICTIONS[(seed + k) % len(FRICTIONS)]

    rigid = {"elastic": (), "rigid": (0, 1, 2, 3, 4), "mixed": (2, 3)}[gears]
    count = {"g": 0, "e": 0}

    def gear_dof(type_):
        k = count["g"]
        count["g"] += 1
        if k in rigid:
            gear = Gear(rigid=True)
        else:
            side = "motor" if k == 4 else "arm"
            soft = SPRINGS[(seed + k) % len(SPRINGS)] if side == "arm" else CubicSpring(0.4, 0.1)
            gear = Gear(
                rigid=False, side=side, spring=soft, damping=1.5 if side == "arm" else 5e-4
            )
        return Dof(f"g{k}", type_, random_axis(rng), gear=gear, friction=friction(k))

    def spring_dof(type_):
        k = count["e"]
        count["e"] += 1
        return Dof(
            f"e{k}",
            type_,
            random_axis(rng),
            spring=spring(k + 1),
            damping=0.9,
            friction=friction(k + 2),
        )

    def element(name, *dofs, body=None, beam=None):
        return Element(
            name,
            dofs,
            random_placement(rng),
            random_placement(rng),
            body or random_body(rng, 0.3),
            beam,
        )

    bendings = (Bending("y", 90.0, 2, 0.02), Bending("z", 60.0, 1, 0.01))
    elements = (
        element("one", gear_dof("rotation"), spring_dof("rotation")),
        element("two", spring_dof("translation"), gear_dof("rotation"), body=Body()),
        element(
            "three",
            gear_dof("translation"),
            gear_dof("rotation"),
            spring_dof("rotation"),
            beam=Beam(0.6, 2.5, bendings) if beam else None,
        ),
        element("four", spring_dof("rotation"), gear_dof("rotation")),
    )
    sign = rng.choice([-1.0, 1.0], 5)
    ratios = (
        (("g0", "g1"), (50.0, 6.0)),
        (("g0", "g1"), (-9.0, 40.0)),
        (("g2", "g3"), (30.0, -4.0)),
        (("g3",), (45.0,)),
        (("g4",), (60.0,)),
    )
    carriers = ("base", "one", "two", "three", "two")
    motors = tuple(
        Motor(
            f"m{j}",
            float(rng.uniform(1e-3, 3e-3)),
            drives,
            vector(sign[j] * np.array(ratio)),
            friction=Friction(viscous=1e-3, coulomb=0.02, beta=0.5)
            if j % 2
            else Friction(viscous=2e-3, offset=1e-3),
            axis=random_axis(rng) if coupling == "complete" else None,
            carrier=carriers[j] if coupling == "complete" else None,
        )
        for j, (drives, ratio) in enumerate(ratios)
    )
    return RobotModel(
        name=f"random{seed}",
        description="synthetic",
        source="random numbers",
        gravity=vector(rng.uniform(-10, 10, 3)),
        base=random_placement(rng),
        elements=elements,
        motors=motors,
        tool=random_placement(rng),
        payload=random_body(rng, 0.2),
        output=Output("tool_position"),
        home=vector(rng.uniform(-1, 1, 5)),
        moves=(),
        motor_coupling=coupling,
    )


SYNTHETIC: dict[str, dict] = {
    "synthetic_elastic": {"seed": 0, "gears": "elastic"},
    "synthetic_mixed": {"seed": 1, "gears": "mixed"},
    "synthetic_rigid": {"seed": 2, "gears": "rigid", "coupling": "complete"},
    "synthetic_complete": {"seed": 3, "gears": "mixed", "coupling": "complete"},
    "synthetic_spinning": {"seed": 4, "gears": "elastic", "coupling": "complete"},
    "synthetic_beam": {"seed": 5, "gears": "mixed", "coupling": "complete", "beam": True},
}


@cache
def model_of(name: str) -> RobotModel:
    """A model of the collection, or a synthetic one, by its name."""
    return random_model(**SYNTHETIC[name]) if name in SYNTHETIC else read(name)


VARIANTS = tuple(name for name in all_variants() if "@" in name)
ALL_MODELS = (*model_names(), *VARIANTS, *SYNTHETIC)


@cache
def answers(name: str) -> Answers:
    return Answers(derive(model_of(name)))


def assert_close(found, expected, tolerance: float, scale: float | None = None) -> None:
    """Largest difference, relative to the size of what is expected unless a scale is given."""
    found = np.asarray(found)
    expected = np.asarray(expected)
    assert found.shape == expected.shape
    scale = np.max(np.abs(expected), initial=0.0) if scale is None else scale
    error = np.max(np.abs(found - expected), initial=0.0)
    assert error <= tolerance * scale, f"error {error:.3g}, allowed {tolerance * scale:.3g}"
