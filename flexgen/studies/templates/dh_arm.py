"""Placements, bodies and drives of an arm from a table of Denavit-Hartenberg parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flexgen.studies.templates.dh_table import CENTER, MOMENTS, PRODUCTS, DhTable, Row, inertia_of

DENSITY = 2000.0
"""Mean density [kg/m^3] of an assumed link: aluminium castings with motors, cables and air."""

MASS_TO_PAYLOAD = 6.0
"""Assumed mass of all links for each kg of payload: robots of 5 to 300 kg payload have 4 to 10."""

USUAL_PAYLOAD = 5.0
"""Payload [kg] that the assumed masses are for where the table has none."""

SHORT_LINK = 0.1
"""Least length [m] of a link in the rule of masses: housings and bearings of axes that meet."""

FREQUENCY = 20.0
"""Assumed lowest mode [Hz] of a gear, motor locked, in the pose of the largest inertia."""

DAMPING_RATIO = 0.03
"""Assumed damping ratio of a gear in that pose."""

RATIO = 100.0
"""Assumed ratio of a rotation [rad/rad]."""

LEAD = 0.02
"""Assumed travel [m] of a translation for each turn of its motor."""

LEAST_ROTOR = 1e-6
"""Smallest assumed inertia [kg m^2] of a rotor: that of a motor of 30 W."""

LIGHT = 0.01
"""Smallest inertia behind a gear for its stiffness, as a part of the rotor's times ratio^2."""

SLOWEST_STEP = 0.01
"""1/beta as a part of the largest motor speed, where Coulomb friction has 76 % of its torque."""

USUAL_SPEED = 300.0
"""Motor speed [rad/s] that the steepness of friction is for where the table has no speed."""


BY_LENGTH = "by length"
MIDWAY = "midway"
CYLINDER = "cylinder"
BALL = "ball"
AT_TOOL = "at the tool"
STIFF = f"{FREQUENCY:g} Hz"
DAMPED = f"damping ratio {DAMPING_RATIO:g}"
AS_ARM = "as the arm"
USUAL = "usual"
STEEP = f"{100 * SLOWEST_STEP:g} % of the speed"
RULES = {
    BY_LENGTH: f"links have {MASS_TO_PAYLOAD:g} times the mass of the payload "
    f"({USUAL_PAYLOAD:g} kg without one), each a share by its length and the number of joints "
    "behind it",
    MIDWAY: "center of mass midway between the axes of the link",
    CYLINDER: f"homogeneous cylinder of {DENSITY:g} kg/m^3 between the axes",
    BALL: f"homogeneous ball of {DENSITY:g} kg/m^3",
    AT_TOOL: "center of mass of the payload at the tool",
    STIFF: "lowest mode of the gear with its motor locked, in the pose of largest inertia "
    f"(at least {LIGHT:g} of the rotor's)",
    DAMPED: "of the gear in that pose",
    AS_ARM: "rotor inertia times ratio^2 is the largest inertia of the arm at the joint (at least "
    f"{LEAST_ROTOR:g} kg m^2)",
    USUAL: f"{RATIO:g} for a rotation, 2 pi / {LEAD:g} m for a translation",
    STEEP: "1/beta is this part of the largest speed of the motor",
}
"""Rules by which numbers are assumed, by the words that mark a number."""


@dataclass(frozen=True)
class Value:
    """A number or a vector in SI units.

    ``origin``: empty for a number of the table; one of `RULES` for an assumed one. ``computed``:
    how it follows from other numbers of the table.
    """

    value: float | tuple[float, ...]
    origin: str = ""
    computed: str = ""

    @property
    def number(self) -> float:
        """The value of a number."""
        assert isinstance(self.value, float)
        return self.value


@dataclass(frozen=True)
class Pose:
    """A constant pose: position [m], angles about the fixed axes x, y, z [rad, or deg]."""

    position: tuple[float, ...]
    rpy: tuple[float, ...]
    degrees: bool = True

    @property
    def rotation(self) -> np.ndarray:
        """The rotation matrix (3, 3); exact for multiples of 90 degrees."""
        x, _, z = (_trigonometric(angle, self.degrees) for angle in self.rpy)
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, x[0], -x[1]], [0.0, x[1], x[0]]])
        return np.array([[z[0], -z[1], 0.0], [z[1], z[0], 0.0], [0.0, 0.0, 1.0]]) @ about_x

    @property
    def empty(self) -> bool:
        """Whether it changes nothing."""
        return not any(self.position) and not any(self.rpy)


@dataclass(frozen=True)
class Body:
    """Mass [kg], center [m] and inertia [kg m^2] as (xx, yy, zz) or with (xy, yz, xz)."""

    mass: Value
    center: Value
    inertia: Value


@dataclass(frozen=True)
class Link:
    """A row as an element: placements before and after the joint, and the body."""

    row: Row
    name: str
    origin: Pose
    link: Pose
    body: Body


@dataclass(frozen=True)
class Drive:
    """Gear and motor of a joint; what is None is not known and not in the file."""

    ratio: Value
    stiffness: Value
    damping: Value
    inertia: Value
    torque_max: Value | None = None
    speed_max: Value | None = None
    friction: dict[str, Value] = field(default_factory=dict)


def _trigonometric(angle: float, degrees: bool) -> tuple[float, float]:
    """Cosine and sine; exact for multiples of 90 degrees."""
    if degrees and angle % 90.0 == 0.0:
        quarter = int(angle // 90.0) % 4
        return (1.0, 0.0, -1.0, 0.0)[quarter], (0.0, 1.0, 0.0, -1.0)[quarter]
    radians = math.radians(angle) if degrees else angle
    return math.cos(radians), math.sin(radians)


def angle_of(row: Row, name: str, degrees: bool) -> float:
    """An angle of a row in degrees or rad, with the digits that were given."""
    cell = row.cells.get(name)
    if cell is None:
        return 0.0
    if degrees and cell.unit == "deg":
        return float(cell.text)
    return math.degrees(cell.value) if degrees else cell.value


def placements(row: Row, convention: str) -> tuple[Pose, Pose]:
    """The constant poses before and after the motion of a row about, or along, the axis z."""
    degrees = all(row.cells[name].unit == "deg" for name in ("alpha", "theta") if name in row)
    alpha = angle_of(row, "alpha", degrees)
    theta = angle_of(row, "theta", degrees)
    a = row.get("a")
    d = row.get("d")
    nothing = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    if convention == "modified":
        before = Pose((a, 0.0, 0.0), (alpha, 0.0, 0.0), degrees)
        return before, Pose((0.0, 0.0, d), (0.0, 0.0, theta), degrees)
    cosine, sine = _trigonometric(theta, degrees)
    return nothing, Pose((a * cosine, a * sine, d), (alpha, 0.0, theta), degrees)


def transform(row: Row, convention: str) -> tuple[np.ndarray, np.ndarray]:
    """Position (3) [m] and rotation (3, 3) of a row at joint position 0, from its frame before."""
    before, after = placements(row, convention)
    R = before.rotation
    return np.array(before.position) + R @ np.array(after.position), R @ after.rotation


def links(table: DhTable) -> list[Link]:
    """The links of an arm, with assumed bodies where the table has none."""
    spans = [_span(table, k) for k in range(len(table.rows))]
    sizes = [float(np.linalg.norm(start - end)) for start, end in spans]
    masses = _masses(table, sizes)
    found = []
    for k, (row, mass) in enumerate(zip(table.rows, masses, strict=True)):
        before, after = placements(row, table.convention)
        body = _body(row, mass, spans[k])
        found.append(Link(row, f"link{k + 1}", before, after, body))
    return found


def _span(table: DhTable, k: int) -> tuple[np.ndarray, np.ndarray]:
    """The points (3) in the frame of link k where its own joint and the next one are."""
    if table.convention == "standard":
        p, R = transform(table.rows[k], "standard")
        return -R.T @ p, np.zeros(3)
    after = [*table.rows[k + 1 :], *([table.tool] if table.tool else [])]
    return np.zeros(3), transform(after[0], "modified")[0] if after else np.zeros(3)


def _masses(table: DhTable, sizes: Sequence[float]) -> list[Value]:
    """The mass of each link [kg]: of the table, or by the rule that `MASS_TO_PAYLOAD` states;
    ``sizes``: their lengths [m].

    Shares fall linearly towards the tool, in proportion to the length of the link.
    """
    load = table.payload.get("mass") if table.payload else 0.0
    carried = load or USUAL_PAYLOAD
    number = len(sizes)
    shares = np.array([(number - k) * max(size, SHORT_LINK) for k, size in enumerate(sizes)])
    all_links = MASS_TO_PAYLOAD * carried * shares / shares.sum()
    return [
        Value(row.get("mass")) if "mass" in row else Value(float(f"{mass:.3g}"), BY_LENGTH)
        for row, mass in zip(table.rows, all_links, strict=True)
    ]


def _body(row: Row, mass: Value, span: tuple[np.ndarray, np.ndarray]) -> Body:
    """The body of a link; without numbers a homogeneous cylinder between its axes, from and to the
    points ``span`` in its frame [m].
    """
    start, end = span
    if CENTER[0] in row:
        center = Value(tuple(row.get(name) for name in CENTER))
    else:
        middle = 0.5 * (start + end)
        rounded = tuple(float(f"{x:.4g}") if abs(x) > 1e-9 else 0.0 for x in middle)
        center = Value(rounded, MIDWAY)
    return Body(mass, center, _inertia(row, mass.number, end - start))


def _inertia(row: Row, mass: float, along: np.ndarray) -> Value:
    """The inertia about the center of mass [kg m^2], three moments and, where one is not zero,
    three products: of the table, else of a steel cylinder of this mass [kg] from end to end of
    ``along`` [m].

    A link so short that the cylinder would be wider than a ball of this mass is a ball.
    """
    if MOMENTS[0] in row:
        inertia = inertia_of(row)
        moments = tuple(float(x) for x in np.diag(inertia))
        products = tuple(row.get(name) for name in PRODUCTS)
        return Value(moments + products if any(products) else moments)
    if mass == 0.0:
        return Value((0.0, 0.0, 0.0))
    length = float(np.linalg.norm(along))
    ball = (3.0 * mass / (4.0 * math.pi * DENSITY)) ** (1.0 / 3.0)
    thin = math.sqrt(mass / (math.pi * DENSITY * length)) if length > 0.0 else math.inf
    if thin >= ball:
        size = float(f"{0.4 * mass * ball**2:.3g}")
        return Value((size, size, size), BALL)
    axis = along / length
    own = 0.5 * mass * thin**2
    across = mass * (3.0 * thin**2 + length**2) / 12.0
    inertia = across * np.eye(3) + (own - across) * np.outer(axis, axis)
    entries = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
    digits = 5 - math.floor(math.log10(across))
    numbers = tuple(round(float(x), digits) + 0.0 for x in entries)
    return Value(numbers if any(numbers[3:]) else numbers[:3], CYLINDER)


def payload(table: DhTable) -> Body | None:
    """The payload in the frame of the last link; without a center at the tool."""
    row = table.payload
    if row is None or not row.get("mass"):
        return None
    mass = Value(row.get("mass"))
    at = np.zeros(3) if table.tool is None else transform(table.tool, table.convention)[0]
    center = Value(tuple(float(x) for x in at), AT_TOOL)
    if CENTER[0] in row:
        center = Value(tuple(row.get(name) for name in CENTER))
    return Body(mass, center, _inertia(row, mass.number, np.zeros(3)))


def drive(row: Row, inertia: float) -> Drive:
    """Gear and motor of a joint whose arm has at most this inertia [kg m^2 or kg].

    Numbers that the table lacks: a rotor as heavy as the arm, the stiffness for `FREQUENCY` with
    locked motor, `DAMPING_RATIO` of the critical damping.
    """
    ratio = _ratio(row)
    factor = abs(ratio.number)
    rotor = Value(max(_round(inertia / factor**2), LEAST_ROTOR), AS_ARM)
    if "rotor_inertia" in row:
        rotor = Value(row.get("rotor_inertia"))
    behind = max(inertia, LIGHT * rotor.number * factor**2)
    stiffness = Value(_round(behind * (2.0 * math.pi * FREQUENCY) ** 2), STIFF)
    if "gear_stiffness" in row:
        stiffness = Value(row.get("gear_stiffness"))
    critical = 2.0 * math.sqrt(stiffness.number * inertia)
    damping = Value(_round(DAMPING_RATIO * critical), DAMPED)
    if "gear_damping" in row:
        damping = Value(row.get("gear_damping"))
    elif "damping_ratio" in row:
        part = row.get("damping_ratio")
        damping = Value(part * critical, computed=f"damping ratio {part:g}")
    torque = Value(row.get("torque_max")) if "torque_max" in row else None
    speed = _speed(row, factor)
    return Drive(ratio, stiffness, damping, rotor, torque, speed, _friction(row, speed))


def _round(value: float) -> float:
    """An assumed number has two digits."""
    return float(f"{value:.2g}")


def _ratio(row: Row) -> Value:
    """Motor angle over joint coordinate [1, rad/m]: of the table, 2 pi over the lead of a screw,
    or a usual one.
    """
    if "ratio" in row:
        return Value(row.get("ratio"))
    if "lead" in row:
        lead = row.get("lead")
        return Value(2.0 * math.pi / lead, computed=f"2 pi / {lead:g} m of lead")
    if row.rotary:
        return Value(RATIO, USUAL)
    return Value(2.0 * math.pi / LEAD, USUAL)


def _speed(row: Row, factor: float) -> Value | None:
    """Largest speed of the motor [rad/s], of the table or from that of the joint times ``factor``
    (the ratio's size); None where neither is known.
    """
    if "speed_max" in row:
        return Value(row.get("speed_max"))
    if "joint_speed_max" in row:
        unit = "rad/s" if row.rotary else "m/s"
        speed = row.get("joint_speed_max")
        return Value(speed * factor, computed=f"{speed:.4g} {unit} times the ratio")
    return None


def _friction(row: Row, speed: Value | None) -> dict[str, Value]:
    """The friction of a motor, with a steepness that a controller resolves."""
    friction = {name: Value(row.get(name)) for name in ("viscous", "coulomb") if name in row}
    if "beta" in row:
        friction["beta"] = Value(row.get("beta"))
    elif friction.get("coulomb"):
        largest = USUAL_SPEED if speed is None else speed.number
        friction["beta"] = Value(_round(1.0 / (SLOWEST_STEP * largest)), STEEP)
    return friction
