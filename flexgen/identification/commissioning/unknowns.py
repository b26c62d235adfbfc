"""The numbers of a robot that records can change, with their accuracy in a datasheet.

| part | numbers | scale | standard deviation of the prior |
|---|---|---|---|
| model | springs and dampings | logarithm | a factor of 3 |
| | masses, inertias, rotors | logarithm | tolerance of the CAD, 7 % |
| | centers of mass, products of inertia | linear | the same part of the size of the body |
| | viscous and Coulomb friction of the joints, >= 0 | linear | 1 % of the largest torque |
| zeros | zero of each joint | rad or m | 0.01 |
| lengths | places of the elements | m, rad | 2 mm, 3 mrad |
| friction | viscous, Coulomb and constant torque, added to those of the file | linear | wide |
| frame | pose of the world in the frame of the tracker | m, rad | wide |
| trackers | places of the trackers on their bodies | m | 5 mm |
| delays | of the torques of each record | s | 3 ms |
| clocks | of the tracker of each record: offset and drift | s, - | 50 ms, 1e-4 |
| responses | viscous friction of motors and joints, delay, at each level | logarithm, s | wide |

The tolerance of the bodies is small on purpose. Torques determine base parameters only: with free
bodies the split of a base parameter is arbitrary, and springs then make up for it. An inertia that
is four times too large came with a gear that was a hundred times too soft.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.sensors import Sensor
from flexgen.dynamics.mechanics.lagrangian import gear_stiffness
from flexgen.dynamics.mechanics.parameters import (
    names_of_numbers,
    select,
    with_values,
)
from flexgen.identification.estimator.layout import Layout
from flexgen.identification.estimator.problem import Prior
from flexgen.identification.poses.parameters import Priors, Unknown, unknowns_of
from flexgen.identification.poses.tree import Tree
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.model.elements import Body, Dof, LinearSpring, RobotModel
from flexgen.model.friction import Friction

BODY = ("mass", "com_x", "com_y", "com_z", "inertia_xx", "inertia_yy", "inertia_zz")
PRODUCTS = ("inertia_xy", "inertia_yz", "inertia_xz")
# Standard deviations of frictions over the torque of the record, of the frame and of the viscous
# friction of responses: so wide that only numbers without any information feel them.
WIDE = 1e3
FRAME_SD = 10.0
RESPONSE_SD = 3.0
# Of the clock of a tracker: its offset [s] and its drift, relative.
CLOCK_SD = (0.05, 1e-4)
# Least second moment of mass of a body over the largest one, where records ask for a negative one.
THIN = 1e-4
# Numbers of each motor: viscous, Coulomb and constant friction.
FRICTIONS = ("viscous", "coulomb", "offset")
# Speed over the largest one at which Coulomb friction is fully there, where the file has none.
COULOMB_WIDTH = 0.01
# Viscous friction of a motor at first, where the file has none: with its rotor it decays with this
# time constant [s].
SLOW = 1.0


@checked_class
@dataclass(frozen=True)
class DatasheetTolerances:
    """Standard deviations of the numbers of a model file that was written from a datasheet.

    Parameters
    ----------
    bodies : float
        Of masses, inertias and rotors, as a part; of centers of mass as a part of the size.
    spring : float
        Factor by which stiffness and damping may be wrong.
    zero : float [rad or m]
    position, rotation : float [m], [rad]
        Of the places of elements.
    tracker : float [m]
        Of the places of trackers on their bodies.
    delay : float [s]
        Of torques.

    Examples
    --------
    >>> flexgen.DatasheetTolerances(bodies=0.1).spring
    3.0
    """

    bodies: float = 0.07
    spring: float = 3.0
    zero: float = 0.01
    position: float = 0.002
    rotation: float = 0.003
    tracker: float = 0.005
    delay: float = 0.003

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value < np.inf:
                raise ArgumentError(f"tolerances.{name}: given {value:g}, expected a number > 0")
        if self.spring <= 1.0:
            raise ArgumentError(
                f"tolerances.spring: given {self.spring:g}, expected a factor > 1, such as 3"
            )


@dataclass(frozen=True)
class Parts(Layout):
    """Parts of the vector of unknowns, see the head of this module."""

    model: slice
    zeros: slice
    lengths: slice
    friction: slice
    frame: slice
    trackers: slice
    delays: slice
    clocks: slice
    responses: slice


@dataclass(frozen=True, eq=False)
class Unknowns:
    """All unknowns of a joint fit.

    ``vector``: of the numbers of the model; ``places``: zeros, then lengths, as those of a
    calibration; ``sensors``: trackers, at least one; ``sd`` (n,): of the prior; ``units`` (n,) and
    ``names`` (n,) of all; ``rubbing``: joints with friction behind their gears.
    """

    robot: RobotModel
    vector: ParameterVector
    parts: Parts
    places: tuple[Unknown, ...]
    sensors: tuple[Sensor, ...]
    sd: np.ndarray
    start: np.ndarray
    names: tuple[str, ...]
    rubbing: tuple[str, ...] = ()

    @property
    def prior(self) -> Prior:
        """Gaussian prior about the numbers of the file."""
        return Prior.of_sd(self.start, self.sd)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds (n,)."""
        lower = np.full(self.parts.size, -np.inf)
        upper = np.full(self.parts.size, np.inf)
        lower[self.parts.model], upper[self.parts.model] = self.vector.bounds
        return lower, upper

    @property
    def has_friction(self) -> tuple[bool, ...]:
        """Motors whose law of friction has viscous and Coulomb friction (n_m,)."""
        return tuple(type(motor.friction) is Friction for motor in self.robot.motors)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Numbers of the model at x, in the order of ``vector``; those that did not change are
        exactly those of the file.
        """
        same = x[self.parts.model] == self.start[self.parts.model]
        file = np.array([unknown.start for unknown in self.vector.unknowns])
        return np.where(same, file, self.vector.values(x[self.parts.model]))

    def zeros(self, x: np.ndarray) -> np.ndarray:
        """Zeros of all actuated coordinates (n_g,)."""
        return x[self.parts.zeros]


def linear_geometry(robot: RobotModel) -> RobotModel:
    """The robot with linear springs, of the stiffness at a large deflection: for the derivatives
    of its positions in lengths and zeros.
    """
    stiff = gear_stiffness(robot, np.inf)
    of_gear = {robot.coordinates[i].name: float(k) for i, k in zip(robot.i_g, stiff, strict=True)}

    def change(dof: Dof) -> Dof:
        if dof.gear is not None and dof.gear.spring is not None:
            spring = LinearSpring(of_gear[dof.name])
            return replace(dof, gear=replace(dof.gear, spring=spring, side="arm"))
        if dof.spring is not None and not isinstance(dof.spring, LinearSpring):
            high = getattr(dof.spring, "high", getattr(dof.spring, "stiffness", 1.0))
            return replace(dof, spring=LinearSpring(high))
        return dof

    elements = (
        replace(element, dofs=tuple(change(dof) for dof in element.dofs))
        for element in robot.elements
    )
    return replace(robot, elements=tuple(elements))


@dataclass(frozen=True)
class FormNumbers:
    """Numbers of a form of the robot that are not in its file.

    Parameters
    ----------
    rubbing : mapping
        Numbers of the friction of joints, ``<joint>.viscous`` and ``.coulomb``, zero at first, and
        their standard deviations; their friction at each level of responses is another one.
    halves : tuple of str
        Elements whose places are not free: the outer half of a link of the file.
    """

    rubbing: Mapping[str, float] = field(default_factory=dict)
    halves: tuple[str, ...] = ()


def make_unknowns(
    robot: RobotModel,
    tolerances: DatasheetTolerances,
    *,
    bodies: bool,
    positions: bool,
    lengths: bool,
    motions: int,
    levels: int,
    form: FormNumbers | None = None,
) -> Unknowns:
    """The unknowns of a robot for records of these kinds.

    Parameters
    ----------
    robot : RobotModel
        With a tracker where positions were measured.
    tolerances : DatasheetTolerances
    bodies : bool
        Records show torques or responses: bodies, rotors and dampings are free.
    positions, lengths : bool
        Positions were measured: frame and trackers are free; and zeros and lengths too.
    motions, levels : int
        Records of motions, and of responses.
    form : FormNumbers, optional
        Numbers that the file does not have.
    """
    chosen = _numbers_of_model(robot, bodies)
    scale = np.log(tolerances.spring)
    priors = {name: _sd_of(robot, name, tolerances, scale) for name in chosen}
    added = FormNumbers() if form is None else form
    own_friction = dict(added.rubbing)
    vector = ParameterVector(
        robot,
        [*chosen, *own_friction],
        priors=priors | own_friction,
        bounds=dict.fromkeys(own_friction, (0.0, np.inf)),
    )
    joints_rubbing = tuple(dict.fromkeys(name.rpartition(".")[0] for name in own_friction))
    places: list[Unknown] = []
    sensors = tuple(s for s in robot.sensors if s.type == "tracker")
    if positions:
        given = Priors(
            zero=tolerances.zero, position=tolerances.position, rotation=tolerances.rotation
        )
        groups = ("zeros", "placements") if lengths else ("zeros",)
        found = unknowns_of(Tree(linear_geometry(robot)), groups, (), given)
        places = [unknown for unknown in found if unknown.kind == "node"]
    zeros = {u.name.removesuffix(".zero"): u for u in places if u.name.endswith(".zero")}
    joints = [robot.coordinates[i] for i in robot.i_g]
    # the place of the base is the frame of the measurement, which is free
    bases = tuple(f"{name}." for name, parent in robot.parents.items() if parent == "base")
    bases += tuple(f"{name}." for name in added.halves)
    places = [u for u in places if u.name.endswith(".zero") or not u.name.startswith(bases)]
    of_lengths = [u for u in places if not u.name.endswith(".zero")]
    own = robot.n_m + len(joints_rubbing) + 1
    parts = Parts.of(
        model=len(vector),
        zeros=len(joints),
        lengths=len(of_lengths),
        friction=3 * robot.n_m if motions else 0,
        frame=6 if positions else 0,
        trackers=3 * len(sensors) if positions else 0,
        delays=motions,
        clocks=2 * motions,
        responses=own * levels,
    )
    # A zero that no position shows stays: so small a deviation is none.
    fixed = 1e-9
    motors = [motor.name for motor in robot.motors]
    viscous = [motor.friction.viscous if hasattr(motor.friction, "viscous") else 0.0
               for motor in robot.motors]  # fmt: skip
    first = [
        np.log(value or motor.inertia / SLOW or 1e-9)
        for value, motor in zip(viscous, robot.motors, strict=True)
    ]
    start = parts.join(
        model=vector.start,
        trackers=np.ravel([s.position for s in sensors]) if positions else 0.0,
        responses=np.tile([*first, *_first_of_joints(robot, joints_rubbing, first), 0.0], levels),
    )
    sd = parts.join(
        model=vector.prior_sd,
        zeros=np.array([zeros[c.name].sd if c.name in zeros else fixed for c in joints]),
        lengths=np.array([u.sd for u in of_lengths]),
        friction=WIDE,
        frame=FRAME_SD,
        trackers=tolerances.tracker,
        delays=tolerances.delay,
        clocks=np.tile(CLOCK_SD, motions),
        responses=np.tile([RESPONSE_SD] * (own - 1) + [tolerances.delay], levels),
    )
    names = (
        *vector.names,
        *(f"{c.name}.zero" for c in joints),
        *(u.name for u in of_lengths),
        *(f"{m}.{kind}" for m in motors if parts.friction.stop > parts.friction.start
          for kind in FRICTIONS),
        *(f"measurement.{k}" for k in (("x", "y", "z", "rx", "ry", "rz") if positions else ())),
        *(f"{s.name}.{axis}" for s in sensors if positions for axis in "xyz"),
        *(f"record {k + 1}.delay" for k in range(motions)),
        *(f"record {k + 1}.{kind}" for k in range(motions) for kind in ("clock", "drift")),
        *(f"responses {k + 1}.{name}" for k in range(levels)
          for name in (*(f"{m}.viscous" for m in (*motors, *joints_rubbing)), "delay")),
    )  # fmt: skip
    ordered = (*(zeros[c.name] for c in joints if c.name in zeros), *of_lengths)
    return Unknowns(robot, vector, parts, ordered, sensors, sd, start, names, joints_rubbing)


def _first_of_joints(
    robot: RobotModel, joints: Sequence[str], motors: Sequence[float]
) -> list[float]:
    """Logarithms of the viscous frictions of joints at first: of their motors, on the arm side."""
    arm = np.log(np.exp(motors) @ robot.eta**2)
    of_joint = {robot.coordinates[i].name: float(x) for i, x in zip(robot.i_g, arm, strict=True)}
    return [of_joint[name] for name in joints]


def _numbers_of_model(robot: RobotModel, bodies: bool) -> tuple[str, ...]:
    """Names of the numbers of the model that are free, in its order."""
    known = set(names_of_numbers(robot))
    springs = [p.name for p in select(robot, ["stiffness"]) if p.value > 0.0]
    out = [name for name in springs if not name.endswith(("smoothing", "cubic"))]
    if not bodies:
        return tuple(out)
    out += [f"{m.name}.inertia" for m in robot.motors if m.inertia > 0.0]
    if any(name.endswith(".damping") for name in known):
        out += [p.name for p in select(robot, ["damping"]) if p.value > 0.0]
    for element in robot.elements:
        out += [f"{element.name}.{kind}" for kind in _free_of_body(element.body)]
    if robot.payload.mass > 0.0:
        out += ["payload.mass", "payload.com_x", "payload.com_y", "payload.com_z"]
    return tuple(p.name for p in select(robot, out))


def _free_of_body(body: Body) -> tuple[str, ...]:
    """Numbers of a body that it has: none of one without mass, no inertias of a point."""
    if body.mass <= 0.0:
        return ()
    diagonal = np.diag(body.inertia)
    kinds = [k for k in BODY if not k.startswith("inertia")]
    kinds += [f"inertia_{a}{a}" for a, x in zip("xyz", diagonal, strict=True) if x > 0.0]
    return (*kinds, *(PRODUCTS if (diagonal > 0.0).all() else ()))


def _sd_of(robot: RobotModel, name: str, tolerances: DatasheetTolerances, spring: float) -> float:
    """Standard deviation of the prior of a number of the model."""
    part, _, kind = name.partition(".")
    bodies = {element.name: element.body for element in robot.elements}
    bodies["payload"] = robot.payload
    if part in bodies and kind.startswith(("com_", "inertia_", "mass")):
        body = bodies[part]
        if kind.startswith("com_"):
            return tolerances.bodies * size_of(body)
        if kind in PRODUCTS:
            return tolerances.bodies * float(np.trace(body.inertia)) / 3
        return tolerances.bodies
    return tolerances.bodies if kind == "inertia" else spring


def size_of(body: Body) -> float:
    """Length of a body [m]: distance of its center of mass from its frame, and its radius of
    gyration.
    """
    gyration = float(np.trace(body.inertia)) / 2 / body.mass
    return float(np.sqrt(np.dot(body.com, body.com) + gyration)) or 0.05


def is_physical(body: Body) -> bool:
    """Whether the inertia about the center of mass is that of some distribution of mass."""
    values = np.linalg.eigvalsh(np.array(body.inertia, float))
    return bool(body.mass >= 0.0 and values[0] >= 0.0 and values[:2].sum() >= values[2])


def is_positive(body: Body) -> bool:
    """Whether mass and inertia are not negative, which is less than `is_physical`."""
    return bool(body.mass >= 0.0 and np.linalg.eigvalsh(np.array(body.inertia, float))[0] >= 0.0)


def make_physical(unknowns: Unknowns, x: np.ndarray) -> np.ndarray:
    """The numbers with the nearest inertias of physically consistent bodies.

    Second moments of mass S = tr(I) E / 2 - I of a body are positive; those that are not are set
    to `THIN` of the largest one, and I = tr(S) E - S.
    """
    out = x.copy()
    model = unknowns.parts.model
    robot = with_values(unknowns.robot, unknowns.vector.named(x[model]))
    places = {name: k for k, name in enumerate(unknowns.names[model])}
    for element in robot.elements:
        if element.body.mass <= 0.0 or is_physical(element.body):
            continue
        inertia = np.array(element.body.inertia, float)
        values, vectors = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
        clipped = np.maximum(values, THIN * values.max())
        moments = (vectors * clipped) @ vectors.T
        new = np.trace(moments) * np.eye(3) - moments
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)):
            k = places.get(f"{element.name}.inertia_{'xyz'[i]}{'xyz'[j]}")
            if k is not None:
                at = model.start + k
                out[at] = np.log(new[i, j]) if i == j else new[i, j]
    return out
