"""Readers of the tables that describe the robot: placements, bodies, springs, degrees of freedom, beams, motors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from flexgen.model.checked_table import LARGEST, Table, closest
from flexgen.model.elements import (
    FRICTION_LAWS,
    IDENTITY,
    NO_FRICTION,
    ZERO,
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
    Matrix,
    Motor,
    PiecewiseSpring,
    Placement,
    SmoothSpring,
    Spring,
    Vector,
)
from flexgen.ports import identifier_problem

HARMONICS = 6  # of a counterbalance
_ROUNDING_ERROR = 1e-15  # of a sine or cosine
COORDINATES_MAX = 64  # of the arm; the effort to derive and compile grows faster than their number
_INERTIA_TOLERANCE = 1e-9  # relative to the largest principal moment

_SPRINGS: dict[str, tuple[type, tuple[str, ...]]] = {
    "linear": (LinearSpring, ("stiffness",)),
    "cubic": (CubicSpring, ("stiffness", "cubic")),
    "smooth": (SmoothSpring, ("low", "high", "break_at")),
    "piecewise": (PiecewiseSpring, ("low", "high", "break_at")),
    "backlash": (BacklashSpring, ("stiffness", "gap", "smoothing")),
}
_MAY_BE_ZERO = ("cubic", "gap")
_BODY = ("mass", "com", "inertia", "inertia_reduced", "rotational_drag")
_PLACEMENT = ("position", "rpy_rad", "rpy_deg", "rotation")
_ROTATION_TOLERANCE = 1e-9  # of a rotation matrix: its columns are orthogonal and of length 1


def _snap(x: float) -> float:
    """The number, rounded to 0, 1 or -1 if it is equal to it within rounding errors."""
    for whole in (0.0, 1.0, -1.0):
        if abs(x - whole) < _ROUNDING_ERROR:
            return whole
    return x


def _cos_sin(angle: float, degrees: bool) -> tuple[float, float]:
    """Cosine and sine of an angle, exact at multiples of 90 degrees."""
    if not degrees:
        return _snap(math.cos(angle)), _snap(math.sin(angle))
    turns = round(angle / 90.0)
    remainder = math.radians(angle - 90.0 * turns)
    c, s = math.cos(remainder), math.sin(remainder)
    return ((c, s), (-s, c), (-c, -s), (s, -c))[turns % 4]


def rotation_matrix(rpy: tuple[float, ...], degrees: bool) -> Matrix:
    """Rotation matrix ``Rz(yaw) Ry(pitch) Rx(roll)``, exact at multiples of 90 degrees."""
    (cr, sr), (cp, sp), (cy, sy) = (_cos_sin(angle, degrees) for angle in rpy)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return tuple(tuple(_snap(x) for x in row) for row in rows)


def read_placement(table: Table) -> Placement:
    """Read a placement: ``position``, and ``rpy_rad``, ``rpy_deg`` or ``rotation``."""
    table.only(*_PLACEMENT)
    position = table.vector("position", 3, ZERO, "m")
    key = table.unit_key("rpy", required=False)
    if "rotation" in table:
        if key is not None:
            raise table.fail("rotation", "one of the two", f"both {key} and rotation")
        matrix = np.array(table.vector("rotation", 9, what="a rotation matrix, row by row")).reshape(3, 3)
        off = np.abs(matrix.T @ matrix - np.eye(3)).max()
        if not off <= _ROTATION_TOLERANCE or np.linalg.det(matrix) < 0.0:
            raise table.fail("rotation", "a rotation matrix: orthogonal columns of length 1, determinant 1")
        return Placement(position, tuple(map(tuple, matrix.tolist())))
    return Placement(
        position,
        IDENTITY if key is None else rotation_matrix(table.vector(key, 3, what="roll, pitch, yaw"), key == "rpy_deg"),
    )


def read_body(table: Table, com: Vector = ZERO) -> Body:
    """Read a rigid body, its center of mass at ``com`` by default; its inertia tensor must be physically possible."""
    table.only(*_BODY)
    mass = table.number("mass", least=0.0)
    entries = table.vector("inertia", (3, 6), (0.0, 0.0, 0.0), "xx, yy, zz, optionally xy, yz, xz")
    xx, yy, zz, xy, yz, xz = entries if len(entries) == 6 else (*entries, 0.0, 0.0, 0.0)
    inertia = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    reduced = table.flag("inertia_reduced")
    if any(entries):
        if mass == 0.0:
            raise table.fail("inertia", "no inertia where the mass is 0")
        largest = max(abs(x) for x in entries)
        low, middle, high = np.linalg.eigvalsh(np.array(inertia) / largest).tolist()
        moments = ", ".join(f"{x * largest:.6g}" for x in (low, middle, high))
        if low < -_INERTIA_TOLERANCE:
            raise table.fail("inertia", "principal moments >= 0", f"a tensor with principal moments {moments}")
        if not reduced and low + middle < high * (1.0 - _INERTIA_TOLERANCE):
            raise table.fail(
                "inertia",
                "no principal moment larger than the sum of the other two (or inertia_reduced = true)",
                f"a tensor with principal moments {moments}",
            )
    return Body(mass, table.vector("com", 3, com, "m"), inertia, table.number("rotational_drag", 0.0, least=0.0))


def read_spring(table: Table, least: float | None = None) -> Spring:
    """Read a spring; stiffnesses must be > 0, or ``>= least`` for a linear spring if ``least`` is given."""
    kind = table.choice("type", tuple(_SPRINGS))
    make, keys = _SPRINGS[kind]
    table.only("type", *keys)
    values = []
    for key in keys:
        if key in _MAY_BE_ZERO:
            values.append(table.number(key, least=0.0))
        elif kind == "linear" and least is not None:
            values.append(table.number(key, least=least))
        else:
            values.append(table.number(key, above=0.0))
    made: Spring = make(*values)
    return made


def read_friction(table: Table) -> Friction:
    """Read a friction law; its keys are the fields of its class in `FRICTION_LAWS`."""
    law = FRICTION_LAWS[table.choice("type", tuple(FRICTION_LAWS)) if "type" in table else next(iter(FRICTION_LAWS))]
    keys = dataclasses.fields(law)
    table.only("type", *(key.name for key in keys))
    values = {key.name: table.number(key.name, 0.0, least=None if key.metadata["signed"] else 0.0) for key in keys}
    for key in keys:
        for needed in key.metadata["needs"].split():
            if values[key.name] and not values[needed]:
                users = [other.name for other in keys if needed in other.metadata["needs"].split()]
                raise table.fail(needed, f"a number > 0 beside {' or '.join(users)}")
    return law(**values)


def read_gear(table: Table) -> Gear:
    """Read a rigid or an elastic gear."""
    table.only("type", "side", "spring", "damping")
    if table.choice("type", ("rigid", "elastic")) == "rigid":
        for key in ("side", "spring", "damping"):
            if key in table:
                raise table.fail(key, f'type = "elastic", or a rigid gear without {key}')
        return Gear(rigid=True)
    side = table.choice("side", ("arm", "motor"))
    made = table.build("spring", read_spring)
    if made is None:
        raise table.fail("spring", "a table: the spring of the elastic gear")
    return Gear(False, side, made, table.number("damping", 0.0, least=0.0))


def read_counterbalance(table: Table) -> tuple[tuple[float, float], ...]:
    """Read the harmonics of a counterbalance; a missing list is zero."""
    table.only("sin", "cos")
    lists = [table.vector(key, range(1, HARMONICS + 1), ()) for key in ("sin", "cos")]
    count = max(map(len, lists))
    if count == 0:
        raise table.fail("sin", "lists sin and cos of torques of the harmonics 1, 2, ... of the angle [N m], or one")
    return tuple(zip(*(row + (0.0,) * (count - len(row)) for row in lists), strict=True))


def read_dof(table: Table, taken: list[str]) -> Dof:
    """Read a degree of freedom; its name must not be in ``taken``."""
    keys = ("name", "type", "axis", "gear", "spring", "damping", "friction", "speed_max", "acceleration_max")
    table.only(*keys, "lower", "upper", "lower_rad", "lower_deg", "upper_rad", "upper_deg", "counterbalance")
    name = table.name(taken=taken)
    kind = table.choice("type", ("rotation", "translation"))
    if kind == "rotation":
        table.only(*keys, "lower_rad", "lower_deg", "upper_rad", "upper_deg", "counterbalance")
        lower, upper = table.angle("lower"), table.angle("upper")
    else:
        table.only(*keys, "lower", "upper")
        lower, upper = table.optional("lower"), table.optional("upper")
    if lower is not None and upper is not None and lower >= upper:
        key = next(key for key in ("lower", "lower_rad", "lower_deg") if key in table)
        raise table.fail(key, "a lower limit below the upper one")
    if "gear" in table and "spring" in table:
        raise table.fail("spring", "either a gear (actuated) or a spring (non-actuated)", "a spring beside a gear")
    if "gear" not in table and "spring" not in table:
        raise table.fail("gear", "either a gear (actuated) or a spring (non-actuated)")
    if "gear" in table and "damping" in table:
        raise table.fail("damping", "the key damping inside the gear", "damping beside a gear")
    return Dof(
        name,
        kind,
        table.axis("axis"),
        gear=table.build("gear", read_gear),
        spring=table.build("spring", lambda inner: read_spring(inner, least=0.0)),
        damping=table.number("damping", 0.0, least=0.0),
        friction=table.build("friction", read_friction, NO_FRICTION),
        lower=lower,
        upper=upper,
        speed_max=table.optional("speed_max", above=0.0),
        acceleration_max=table.optional("acceleration_max", above=0.0),
        counterbalance=table.build("counterbalance", read_counterbalance, ()),
    )


def read_beam(table: Table, element: str, taken: list[str]) -> Beam:
    """Read a beam; appends the names of its modal coordinates to ``taken``."""
    table.only("length", "mass_per_length", "bending")
    length = table.number("length", above=0.0)
    mass_per_length = table.number("mass_per_length", above=0.0)
    bendings: list[Bending] = []
    for item in table.tables("bending"):
        item.only("direction", "stiffness", "modes", "damping_ratio")
        direction = item.choice("direction", ("y", "z"))
        if any(other.direction == direction for other in bendings):
            raise item.fail("direction", "each direction at most once")
        modes = item.whole("modes", 1, 8)
        for k in range(modes):
            name = f"{element}_{direction}{k + 1}"
            problem = "a name that is not taken yet" if name in taken else identifier_problem(name)
            if problem is not None:
                raise item.fail("modes", problem, f"a modal coordinate {name}")
            taken.append(name)
        ratio = item.number("damping_ratio", 0.0, least=0.0)
        if ratio >= 1.0:
            raise item.fail("damping_ratio", "a number >= 0 and below 1")
        bendings.append(Bending(direction, item.number("stiffness", above=0.0), modes, ratio))
    return Beam(length, mass_per_length, tuple(bendings))


def read_elements(root: Table) -> tuple[tuple[Element, ...], dict[str, Table]]:
    """Read the elements of the chain; also returns the table of each degree of freedom by name."""
    chain: list[Element] = []
    taken: list[str] = []  # names of coordinates
    where: dict[str, Table] = {}
    for table in root.tables("element"):
        table.only("name", "origin", "link", "body", "beam", "dof")
        name = table.name(taken=[element.name for element in chain])
        if name == "base":
            raise table.fail("name", "another name (base is the ground)")
        dofs = []
        for item in table.tables("dof", required=False):
            dofs.append(read_dof(item, taken))
            taken.append(dofs[-1].name)
            where[dofs[-1].name] = item
        inner = table.table("beam")
        chain.append(
            Element(
                name,
                tuple(dofs),
                origin=table.build("origin", read_placement, Placement()),
                link=table.build("link", read_placement, Placement()),
                body=table.build("body", read_body, Body()),
                beam=None if inner is None else read_beam(inner, name, taken),
            )
        )
    if len(taken) > COORDINATES_MAX:
        raise root.fail("element", f"at most {COORDINATES_MAX} coordinates", f"{len(taken)} coordinates")
    return tuple(chain), where


def read_motors(root: Table, chain: tuple[Element, ...], where: dict[str, Table], coupling: str) -> tuple[Motor, ...]:
    """Read the motors and check them against the joints that they drive (``where``: tables of the joints by name)."""
    gears = {dof.name: dof.gear for element in chain for dof in element.dofs}
    actuated = [name for name, gear in gears.items() if gear is not None]
    out: list[Motor] = []
    for table in root.tables("motor"):
        table.only("name", "drives", "ratio", "inertia", "friction", "torque_max", "speed_max", "axis", "carrier")
        name = table.name(taken=[motor.name for motor in out])
        drives = table.words("drives")
        for joint in drives:
            if joint not in gears:
                raise table.fail("drives", closest(joint, actuated))
            if joint not in actuated:
                raise table.fail("drives", "degrees of freedom with a gear", f"{joint}, which has none")
        kinds = {gear.rigid for joint in drives if (gear := gears[joint]) is not None}
        if len(kinds) > 1:
            raise table.fail("drives", "driven joints whose gears are all elastic or all rigid")
        inertia = table.number("inertia", least=0.0)
        if inertia == 0.0 and kinds != {True}:
            raise table.fail("inertia", "a number > 0 behind an elastic gear")
        if coupling == "complete":
            for key in ("axis", "carrier"):
                if key not in table:
                    raise table.fail(key, f'{key}, because motor_coupling = "complete"')
        out.append(
            Motor(
                name,
                inertia,
                tuple(drives),
                _ratio(table, len(drives)),
                friction=table.build("friction", read_friction, NO_FRICTION),
                axis=table.axis("axis") if "axis" in table else None,
                carrier=(
                    table.choice("carrier", ["base", *(element.name for element in chain)])
                    if "carrier" in table
                    else None
                ),
                torque_max=table.optional("torque_max", above=0.0),
                speed_max=table.optional("speed_max", above=0.0),
            )
        )
    _check_drives(root, out, gears, actuated, where)
    return tuple(out)


def _ratio(table: Table, count: int) -> tuple[float, ...]:
    value = table.entries["ratio"].value if "ratio" in table else None
    if isinstance(value, list):
        ratio = table.vector("ratio", count, what="one for each driven joint")
    elif count == 1:
        ratio = (table.number("ratio"),)
    else:
        raise table.fail("ratio", f"a list of {count} numbers (one for each driven joint)")
    if min(map(abs, ratio)) < 1.0 / LARGEST:
        raise table.fail("ratio", "a ratio that is not 0")
    return ratio


def _check_drives(
    root: Table, found: list[Motor], gears: dict[str, Gear | None], actuated: list[str], where: dict[str, Table]
) -> None:
    for joint in actuated:
        drivers = [motor for motor in found if joint in motor.drives]
        gear = gears[joint]
        if not drivers:
            raise where[joint].fail("gear", f"a motor that drives {joint}", "a gear that no motor drives")
        if gear is not None and not gear.rigid and gear.side == "motor" and [m.drives for m in drivers] != [(joint,)]:
            raise where[joint].fail(
                "gear", 'side = "arm"', 'side = "motor" on a joint that is not driven by one motor of its own'
            )
    if len(found) != len(actuated):
        raise root.fail(
            "motor", f"as many motors as actuated degrees of freedom, {len(actuated)}", f"{len(found)} motors"
        )
    eta = np.array([[dict(zip(m.drives, m.ratio, strict=True)).get(joint, 0.0) for joint in actuated] for m in found])
    singular = np.linalg.svd(eta / np.abs(eta).max(axis=1, keepdims=True), compute_uv=False)
    if singular[-1] < 1e-9 * singular[0]:
        raise root.fail("motor", "a regular matrix of gear ratios", "a singular matrix of gear ratios")
