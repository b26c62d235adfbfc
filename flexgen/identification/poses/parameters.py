"""The numbers that a calibration can change, with the Gaussian prior of each.

| group | what | unit |
|---|---|---|
| frames | pose of the world in the frame of the measurement; positions of the trackers | m, rad |
| zeros | zero of each actuated coordinate | rad or m |
| placements | pose of each element at its parent: three shifts, then three rotations | m, rad |
| compliances | of gears and of axes without a motor | rad/(N m), m/N |
| mechanisms | factors of ``mimic`` | - |
| masses | masses and centers of mass | kg, m |

Measurements at rest determine only products of compliance and mass: the priors fix what remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.sensors import Sensor
from flexgen.base.spec.tables import closest
from flexgen.identification.poses.tree import SHIFTS, Tree
from flexgen.model.elements import Element, RobotModel

GROUPS = ("zeros", "placements", "compliances", "mechanisms", "masses")
AXES = "xyz"
# names of the pose of the world in the frame of the measurement: measurement.x to .rz
FRAME = "measurement"


@checked_class
@dataclass(frozen=True)
class Priors:
    """Standard deviations of the priors about the numbers of the model file.

    Parameters
    ----------
    zero : float [rad or m]
    position, rotation : float [m], [rad]
        Of the placements of elements.
    compliance : float
        Of a compliance, as a multiple of that of the file.
    mass : float
        Of a mass, as a part of that of the file.
    center : float [m]
        Of a center of mass, each direction.
    factor : float
        Of the factors of mechanisms.
    tracker : float [m]
        Of the positions of the trackers.

    Examples
    --------
    >>> flexgen.Priors(position=0.002).rotation
    0.02
    """

    zero: float = 0.05
    position: float = 0.01
    rotation: float = 0.02
    compliance: float = 3.0
    mass: float = 0.3
    center: float = 0.05
    factor: float = 0.3
    tracker: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value < np.inf:
                raise ArgumentError(f"priors.{name}: given {value:g}, expected a number > 0")


# of elements whose place is not known, and of the measurement's frame
UNKNOWN = Priors(position=10.0, rotation=10.0)


@dataclass(frozen=True)
class Unknown:
    """One number: ``kind`` and ``at`` say where it belongs, ``start`` and ``sd`` are mean and
    width of its prior.

    Kinds: ``node`` (index of the node), ``frame`` (0 to 5), ``tracker`` (index, axis),
    ``compliance`` (index), ``factor`` (mechanism, coordinate), ``mass`` (index of the body),
    ``center`` (body, axis),
    ``point`` (index of the fixed point, axis), ``surface`` (index of the surface, number).
    """

    name: str
    unit: str
    kind: str
    at: tuple[int, ...]
    start: float
    sd: float

    @property
    def is_stated(self) -> bool:
        """Whether the model file states the number: not places that the poses alone determine."""
        own = self.kind not in ("frame", "point", "surface")
        return own and self.sd < UNKNOWN.position

    @property
    def name_in_file(self) -> str:
        """Its name as a number of the model file, which has stiffnesses."""
        return self.name.replace(".compliance", ".stiffness")


def trackers_of(model: RobotModel) -> tuple[Sensor, ...]:
    """The trackers of a model; ArgumentError where it has none."""
    found = tuple(sensor for sensor in model.sensors if sensor.type == "tracker")
    if not found:
        raise ArgumentError(
            f'model {model.name}: given no tracker, expected a [[sensor]] with type = "tracker" '
            f"for each point that "
            "is measured, with name, element, position and unit"
        )
    return found


def unknowns_of(  # noqa: C901
    tree: Tree, free: Sequence[str], placed: Sequence[str], priors: Priors
) -> list[Unknown]:
    """The free numbers of a tree; ``placed``: elements whose place at the parent is not known.

    Raises
    ------
    ArgumentError
        A group or an element does not exist.
    """
    model = tree.model
    for group in free:
        if group not in GROUPS:
            raise ArgumentError(f"free: given {group!r}, expected {closest(group, list(GROUPS))}")
    for name in placed:
        if name not in tree.tips:
            raise ArgumentError(
                f"place: given {name!r}, expected {closest(name, list(tree.tips))}"
            )
    out = [
        Unknown(f"{FRAME}.{s}", _unit(s), "frame", (k,), 0.0, _sd(s, UNKNOWN))
        for k, s in enumerate(SHIFTS)
    ]
    for k, sensor in enumerate(trackers_of(model)):
        out += [
            Unknown(
                f"{sensor.name}.{axis}", "m", "tracker", (k, i), sensor.position[i], priors.tracker
            )
            for i, axis in enumerate(AXES)
        ]
    moved = _moving_nodes(tree)
    same = {e.name: _same_as_zero(e) for e in model.elements}
    if "zeros" in free:
        # their pose has the zero
        whole = {e.dofs[0].name for e in model.elements if e.name in placed and same[e.name]}
        for coordinate in model.coordinates:
            if (
                coordinate.actuated
                and tree.index[coordinate.name] in moved
                and coordinate.name not in whole
            ):
                at = (tree.index[coordinate.name],)
                out.append(
                    Unknown(
                        f"{coordinate.name}.zero", coordinate.unit, "node", at, 0.0, priors.zero
                    )
                )
    for element in model.elements:
        if element.name not in placed and "placements" not in free:
            continue
        left_out = same[element.name] if "zeros" in free and element.name not in placed else ""
        for shift in SHIFTS:
            index = tree.index[f"{element.name}.{shift}"]
            if shift != left_out and index in moved:
                sd = _sd(shift, UNKNOWN if element.name in placed else priors)
                out.append(
                    Unknown(f"{element.name}.{shift}", _unit(shift), "node", (index,), 0.0, sd)
                )
    if "compliances" in free:
        for k, (name, value) in enumerate(tree.elastic.items()):
            if tree.index[name] in moved:
                unit = "m/N" if tree.nodes[tree.index[name]].slides else "rad/(N m)"
                out.append(
                    Unknown(
                        f"{name}.compliance",
                        unit,
                        "compliance",
                        (k,),
                        value,
                        priors.compliance * value,
                    )
                )
    if "mechanisms" in free:
        for name, factors in tree.mimics.items():
            for other, value in factors.items():
                both = (tree.index[name], tree.index[other])
                out.append(
                    Unknown(f"{name}.mimic.{other}", "", "factor", both, value, priors.factor)
                )
    if "masses" in free:
        out += _masses(tree, priors)
    return out


def points_of(names: Sequence[str]) -> list[Unknown]:
    """The places of fixed points that trackers touch, in the frame of the measurement."""
    return [
        Unknown(f"point.{name}.{axis}", "m", "point", (k, i), 0.0, UNKNOWN.position)
        for k, name in enumerate(names)
        for i, axis in enumerate(AXES)
    ]


def length_of_scale(tree: Tree) -> str:
    """The name of the number that fixed points do not determine, since all lengths can grow alike.

    The largest coordinate of the place of an element behind a joint, whose length has to be known;
    empty where a joint slides, since its commands are lengths.

    Raises
    ------
    ArgumentError
        No such element has a place that is a length.
    """
    moved = _moving_nodes(tree)
    joints = [tree.index[c.name] for c in tree.model.coordinates if c.actuated]
    joints = [k for k in joints if k in moved]
    if any(tree.nodes[k].slides for k in joints):
        return ""
    longest = 0.0
    name = ""
    for element in tree.model.elements:
        node = tree.index[f"{element.name}.x"]
        if node not in moved or not tree.carries[joints, node].any():
            continue
        lengths = np.abs(np.array(element.origin.rotation).T @ np.array(element.origin.position))
        k = int(np.argmax(lengths))
        if lengths[k] > longest:
            longest = float(lengths[k])
            name = f"{element.name}.{SHIFTS[k]}"
    if not name:
        raise ArgumentError(
            "free: given placements and fixed points only, with a model whose elements have no "
            "place that is a length, expected measured positions too, or no placements"
        )
    return name


def _masses(tree: Tree, priors: Priors) -> list[Unknown]:
    """Masses and centers of the bodies that have a mass and load an elastic coordinate."""
    out = []
    by_mechanism = [
        name for name, factors in tree.mimics.items() if set(factors) & set(tree.elastic)
    ]
    loaded = np.asarray(
        tree.carries[[tree.index[name] for name in (*tree.elastic, *by_mechanism)]].any(axis=0)
    )
    for k, (name, mount, body) in enumerate(tree.bodies):
        if body.mass == 0.0 or not loaded[mount.node]:
            continue
        out.append(Unknown(f"{name}.mass", "kg", "mass", (k,), body.mass, priors.mass * body.mass))
        centers = zip(AXES, body.com, strict=True)
        out += [
            Unknown(f"{name}.com.{a}", "m", "center", (k, i), x, priors.center)
            for i, (a, x) in enumerate(centers)
        ]
    return out


def _moving_nodes(tree: Tree) -> set[int]:
    """Nodes that move a tracker, also by a mechanism; the others have no effect, except through
    their weight.
    """
    nodes = [tree.tip(sensor.place).node for sensor in trackers_of(tree.model)]
    moving = set(np.flatnonzero(tree.carries[:, nodes].any(axis=1)).tolist())
    named = {
        tree.index[other]
        for name, of in tree.mimics.items()
        if tree.index[name] in moving
        for other in of
    }
    return moving | named


def _same_as_zero(element: Element) -> str:
    """The shift of a placement that does what the zero of the element's first, actuated coordinate
    does; or empty.
    """
    first = element.dofs[0] if element.dofs else None
    if first is None or not first.actuated or max(map(abs, first.axis)) < 1.0 - 1e-9:
        return ""
    along = AXES[int(np.argmax(np.abs(first.axis)))]
    return along if first.type == "translation" else f"r{along}"


def _unit(shift: str) -> str:
    return "rad" if shift in SHIFTS[3:] else "m"


def _sd(shift: str, priors: Priors) -> float:
    return priors.rotation if shift in SHIFTS[3:] else priors.position
