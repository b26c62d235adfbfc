"""The elastic robot as an MJCF file for MuJoCo, with the same accelerations.

Every element of the chain is a body whose joints are the degrees of freedom in their order. A
motor behind an elastic gear is a body of its own with a hinge, ``rotor.NAME``; its gear is a fixed
tendon of length

    L = f (sum_j (eta^-1)_kj q_mj - q_gk),      force -k L - d L'

with f the factor from the arm side to the side of the spring. A motor behind a rigid gear has no
coordinate: its inertia is the armature of the joint (of a tendon where it drives several joints).
Only an axis that a mechanism moves is held by a constraint, which is soft in MuJoCo: else the
equations are those of flexgen, not an approximation.

Sources: MuJoCo documentation, XML reference and chapter Computation; S. Moberg, Modeling and
Control of Flexible Manipulators, 2010; P. Tomei, IEEE TAC 36(10), 1991, for the coupling of the
rotors.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from flexgen.analysis.linear import linearize, poles
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.files.atomic_files import write_text
from flexgen.base.version import __version__
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import Equilibrium, hold_joints, reach
from flexgen.exports.exported import Exported, exported, left_out
from flexgen.exports.mechanisms import mechanisms
from flexgen.exports.mujoco.mujoco_checks import (
    Drive,
    FrictionName,
    check_laws,
    drives,
    refusal,
    with_friction,
)
from flexgen.exports.mujoco.mujoco_forces import (
    FAR,
    add_actuators,
    add_constraints,
    add_sites,
    add_tendons,
)
from flexgen.exports.mujoco.mujoco_inertia import principal, regroup
from flexgen.exports.poses import chain, frame_about, pose_attributes
from flexgen.exports.xml_text import add, document, numbers
from flexgen.model.abilities import check_ability
from flexgen.model.elements import Dof, LinearSpring, RobotModel
from flexgen.model.inertia import mass_matrix
from flexgen.model.reader import read
from flexgen.paths.geometry.jets import quaternion

LEAST = 2e-15  # kg and kg m^2: of a body without mass; MuJoCo takes nothing below 1e-15
SHARE = 1e-10  # that `LEAST` may be of the inertia of the robot
# time step of the file times the fastest pole: the error of a step of RK4 is below 1e-6 of the
# motion
STEP = 0.1
STEP_MAX = 1e-3  # s

NOTES = {
    "viscous": (
        "all friction but viscous is left out: accelerations in MuJoCo differ from those of the "
        "model"
    ),
    "dry": (
        "Coulomb friction is a constraint with stick: accelerations in MuJoCo differ from those "
        "of the model"
    ),
}
MOVED = (
    "axes that mechanisms move are held by constraints of MuJoCo: accelerations differ by 3e-5, "
    "1e-2 at worst"
)
_JOINTS = {"rotation": "hinge", "translation": "slide"}


@checked_types
def export_mujoco(
    model: str | Path | RobotModel, path: str | Path, *, friction: FrictionName = "exact"
) -> Exported:
    """Write a robot as an MJCF file for MuJoCo (3.7 or later for cubic and smooth springs, else
    3.3.5).

    Joints have the names of the arm coordinates, ``rotor.NAME`` are the angles of the motors
    behind elastic gears [rad, motor side], actuators have the names of the motors [N m, motor
    side], the site ``tool`` is the tool frame, and the key frame ``home`` is the equilibrium at
    home. The accelerations that ``mj_forward`` computes are those of the function
    ``forward_dynamics`` of `flexgen.derive` up to rounding. Limits of joints and motors are
    written down and not active, because flexgen's equations have none. The time step is a tenth of
    the shortest time constant, for the integrator RK4.

    Parameters
    ----------
    model : str, Path or RobotModel
        As for `flexgen.derive`.
    path : str or Path
        A name that ends in ``.xml``.
    friction : str
        ``"exact"`` (the default): a model with Coulomb or Stribeck friction is refused;
        ``"viscous"``: these are left out; ``"dry"``: Coulomb friction as MuJoCo has it, with other
        accelerations. MuJoCo has no smooth law of friction and offsets: ``"dry"`` makes them its
        ``frictionloss``, a constraint with stick, and leaves out the others.

    Returns
    -------
    Exported

    Raises
    ------
    ModelError
        MuJoCo cannot express a part of the robot exactly: a beam, the dead band of a backlash, a
        counterbalance, a gas spring, a cable or a line with mass, friction (see there), a drag on
        a body that turns about several directions, complete coupling of a motor with a rigid gear
        on such a body, a rotor behind rigid gears that turns with joints on several branches, an
        axis without inertia that only a mechanism over several branches holds, inertias that no
        real body has, or so small that MuJoCo's least count.
    ArgumentError
        There is no such model or friction, the model has hysteresis, lugre, friction that depends
        on the load or Fourier sums of motor angles, or the file cannot be written.

    Examples
    --------
    >>> print(flexgen.export_mujoco("elbow", "elbow.xml"))
    elbow.xml
    """
    path = Path(path)
    if path.suffix != ".xml":
        raise ArgumentError(f"path: given {path.name!r}, expected a name that ends in .xml")
    robot = model if isinstance(model, RobotModel) else read(model)
    check_ability(robot, "export_mujoco")
    write_text(path, mjcf(robot, friction))
    what = f"{robot.title}, {robot.dof} joints, {robot.n_m} motors"
    notes: tuple[str, ...] = (
        (NOTES[friction],)
        if friction in NOTES and robot != with_friction(robot, "viscous")
        else ()
    )
    notes += ((MOVED,) if mechanisms(robot) else ()) + left_out(robot)
    return exported(robot, "mujoco", (path,), (what,), notes=notes, details={"friction": friction})


def mjcf(model: RobotModel, friction: str = "exact") -> str:
    """The text of the file of `export_mujoco`."""
    return _Writer(with_friction(model, friction), friction).text()


class _Writer:
    """Builds the document of one model."""

    def __init__(self, model: RobotModel, friction: str) -> None:
        """``friction``: ``"dry"`` takes Coulomb friction as MuJoCo has it, and refuses
        other laws.
        """
        check_laws(model, dry=friction == "dry")
        self.model = model
        self.friction = friction
        self.equations = Equations(model)
        self.drives = drives(model)
        self.size = reach(self.equations)
        self.small = 0  # bodies with the least mass or inertia

    def text(self) -> str:
        """The document."""
        model = self.model
        root = ElementTree.Element("mujoco", {"model": model.name})
        chosen = model.title
        note = "" if self.friction == "exact" else f", friction {self.friction}"
        root.append(ElementTree.Comment(f" {chosen}{note}, written by flexgen {__version__} "))
        add(root, "compiler", angle="radian", autolimits="false", inertiafromgeom="false")
        option = add(root, "option", gravity=model.gravity, integrator="RK4")
        world = add(root, "worldbody")
        add(world, "light", pos=(0.0, 0.0, 4 * self.size), castshadow="false")
        for drive in self.drives:
            if drive.elastic and drive.turning is not None:  # turns in the world, not with the arm
                self._rotor(world, drive, np.zeros(3), np.array([0.0, 0.0, 1.0]))
        self._elements(world)
        tendons = ElementTree.Element("tendon")
        add_tendons(model, self.drives, tendons)
        if len(tendons):
            root.append(tendons)
        add_actuators(self.drives, add(root, "actuator"))
        self._check_share()
        rest = self._rest()
        step = _step(self.equations, rest)
        option.set("timestep", numbers(step))
        if mechanisms(model):
            add_constraints(model, step, add(root, "equality"))
        if rest is not None:
            self._home(root, rest)
        return document(root)

    # --- bodies ----------------------------------------------------------------------------------

    def _elements(self, world: Element) -> None:
        """All elements; a MuJoCo body has the frame at ``origin``, moved by the joints of its
        element.
        """
        model = self.model
        places = []
        tensors = []
        tips = {"base": model.base} | {element.name: element.link for element in model.elements}
        for element in model.elements:
            places.append(chain(tips[model.parents[element.name]], element.origin))
            R = np.array(element.link.rotation)
            tensors.append(
                R @ (np.array(element.body.inertia) - self._carried_inertia(element.name)) @ R.T
            )
        tensors = regroup(model, tensors, [np.array(place.rotation) for place in places])
        holders = {"base": world}
        for element, place, tensor in zip(model.elements, places, tensors, strict=True):
            self._capsule(parent := holders[model.parents[element.name]], place.position)
            holder = add(parent, "body", name=_body_name(element.name), **pose_attributes(place))
            holders[element.name] = holder
            for dof in element.dofs:
                self._joint(holder, dof)
            position = np.array(element.link.position)
            R = np.array(element.link.rotation)
            center = position + R @ np.array(element.body.com)
            self._inertial(holder, element.body.mass, center, tensor, moving=bool(element.dofs))
            for drive in self.drives:
                if drive.turning is None and drive.motor.carrier == element.name:
                    self._rotor(holder, drive, center, R @ np.array(drive.motor.axis))
        add_sites(model, holders)
        payload = model.payload
        tip = tips[model.tip]
        holder = holders[model.tip]
        tool = chain(tip, model.tool)
        self._capsule(holder, tool.position)
        if payload.mass > 0.0:
            # no element has this name
            body = add(holder, "body", name="payload.", **pose_attributes(tip))
            self._inertial(
                body, payload.mass, np.array(payload.com), np.array(payload.inertia), moving=False
            )
        add(holder, "site", name="tool", size=0.03 * self.size, **pose_attributes(tool))

    def _joint(self, body: Element, dof: Dof) -> None:
        """A joint with what acts on it alone: friction, linear spring, and the motors behind rigid
        gears.
        """
        damping = dof.friction.viscous
        dry = dof.friction.coulomb
        armature = 0.0
        for drive in self.drives:
            if not drive.elastic and list(drive.ratios) == [dof.name] and not drive.turning:
                ratio = drive.ratios[dof.name]
                motor = drive.motor
                armature += motor.inertia * ratio**2
                damping += motor.friction.viscous * ratio**2
                dry += motor.friction.coulomb * abs(ratio)
        joint = add(body, "joint", name=dof.name, type=_JOINTS[dof.type], axis=dof.axis)
        if isinstance(dof.spring, LinearSpring):
            joint.set("stiffness", numbers(dof.spring.stiffness))
            damping += dof.damping
        _set_positive(joint, damping=damping, armature=armature, frictionloss=dry)
        if (ends := (dof.lower, dof.upper)) != (None, None):
            joint.set("limited", "false")
            joint.set(
                "range",
                numbers(
                    [far if x is None else x for x, far in zip(ends, (-FAR, FAR), strict=True)]
                ),
            )

    def _inertial(
        self, body: Element, mass: float, center: np.ndarray, tensor: np.ndarray, *, moving: bool
    ) -> None:
        """Mass and inertia; a moving body has at least `LEAST` of both."""
        if not moving and mass == 0.0 and not tensor.any():
            return
        moments, axes = principal(tensor)
        if mass < LEAST or moments.min() < LEAST:
            self.small += 1
            mass = max(mass, LEAST)
            moments = moments + LEAST
        add(body, "inertial", mass=mass, pos=center, quat=quaternion(axes), diaginertia=moments)

    def _carried_inertia(self, name: str) -> np.ndarray:
        """The inertia across their axes that rotors on an element have in the file and not in the
        model.
        """
        out = np.zeros((3, 3))
        for drive in self.drives:
            if drive.turning is None and drive.motor.carrier == name:
                axis = np.array(drive.motor.axis)
                out += drive.motor.inertia / 2 * (np.eye(3) - np.outer(axis, axis))
        return out

    def _rotor(self, carrier: Element, drive: Drive, center: np.ndarray, axis: np.ndarray) -> None:
        """A rotor: J about its axis and J/2 across it, the least that a real body can have."""
        motor = drive.motor
        name = f"rotor.{motor.name}"
        body = add(carrier, "body", name=name, pos=center, quat=quaternion(frame_about(axis)))
        joint = add(body, "joint", name=name, type="hinge", axis=(0.0, 0.0, 1.0))
        _set_positive(joint, damping=motor.friction.viscous, frictionloss=motor.friction.coulomb)
        # the mass of a rotor belongs to the body that carries it
        self.small += 1
        moments = motor.inertia * np.array([0.5, 0.5, 1.0])
        add(body, "inertial", mass=LEAST, pos=np.zeros(3), diaginertia=moments)

    def _capsule(self, body: Element, end: Sequence[float] | np.ndarray) -> None:
        """A capsule from the origin of a body to a point, for the eye only: no mass, no
        contact.
        """
        width = 0.02 * self.size
        if np.linalg.norm(end) > width:
            ends = [*np.zeros(3), *end]
            add(
                body, "geom", type="capsule", fromto=ends, size=width, contype="0", conaffinity="0"
            )

    # --- the file as a whole ---------------------------------------------------------------------

    def _rest(self) -> Equilibrium | None:
        """The equilibrium at home; None if there is none."""
        try:
            return hold_joints(self.equations, np.array(self.model.home))
        except SolverError:
            return None

    def _home(self, root: Element, rest: Equilibrium) -> None:
        """Add the keyframe ``home``: positions of all joints in the order of the document, and
        motor torques, of the equilibrium ``rest``.
        """
        values = {c.name: float(x) for c, x in zip(self.model.coordinates, rest.q_a, strict=True)}
        values |= {
            name: sum(x * values[k] for k, x in own.items())
            for name, own in mechanisms(self.model).items()
        }
        values |= {
            f"rotor.{m.name}": float(x) for m, x in zip(self.model.motors, rest.q_m, strict=True)
        }
        frame = add(root, "keyframe")
        # those of bodies
        names = [joint.attrib["name"] for joint in root.iter("joint") if "name" in joint.attrib]
        add(frame, "key", name="home", qpos=[values[name] for name in names], ctrl=rest.tau_m)

    def _check_share(self) -> None:
        """Refuse a robot so light that the least inertia of MuJoCo counts."""
        model = self.model
        q = np.zeros(model.n_a)
        q[list(model.i_g)] = model.home
        added = self.small * LEAST * (1.0 + self.size**2)
        least = float(np.linalg.eigvalsh(mass_matrix(model, q))[0])
        if added > SHARE * least:
            given = (
                f"an inertia of {least:.3g} kg m^2 (least eigenvalue of the mass matrix at home)"
            )
            expected = (
                f"at least {added / SHARE:.3g} kg m^2: MuJoCo's bodies have at least {LEAST:g} "
                "kg m^2 each"
            )
            raise refusal(model, "element", given, expected)


def _body_name(name: str) -> str:
    """The name of an element; MuJoCo reserves ``world``."""
    return name if name != "world" else "world."


def _set_positive(joint: Element, **values: float) -> None:
    """Set attributes that are not zero."""
    for key, value in values.items():
        if value:
            joint.set(key, numbers(value))


def _step(equations: Equations, rest: Equilibrium | None) -> float:
    """A time step for RK4 [s]; without an equilibrium at home its poles are not known."""
    if rest is None:
        return STEP_MAX / 10
    return time_step(float(np.abs(poles(linearize(equations, rest))).max()))


def time_step(fastest: float) -> float:
    """A time step [s] for the fastest pole [1/s], 1, 2 or 5 times a power of ten."""
    longest = min(STEP / fastest, STEP_MAX) if fastest > 0.0 else STEP_MAX
    power = 10.0 ** np.floor(np.log10(longest))
    return float(f"{max(m for m in (1, 2, 5) if m * power <= longest * (1 + 1e-12)) * power:.6g}")
