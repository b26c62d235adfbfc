"""Schema of the tables that describe the robot: placements, bodies, springs, degrees of freedom, beams, motors."""

from __future__ import annotations

import dataclasses

from flexgen.exports.schema_types import (
    Schema,
    angle,
    choice,
    const,
    flag,
    name,
    number,
    one_of,
    picked,
    ref,
    string,
    table,
    tables,
    vector,
    whole,
    words,
)
from flexgen.model import component_tables, overlay
from flexgen.model.elements import FRICTION_LAWS

_SPRING_TEXTS = {
    "linear": "torque = stiffness d",
    "cubic": "torque = stiffness d + cubic d^3",
    "smooth": "stiffness low at zero, growing to high at the deflection break_at",
    "piecewise": "stiffness low up to the deflection break_at, high beyond",
    "backlash": "dead band of half width gap, with rounded corners",
}
_SPRING_KEYS = {
    "stiffness": "stiffness [N m/rad or N/m]",
    "cubic": "cubic coefficient [N m/rad^3 or N/m^3]",
    "low": "stiffness at small deflections [N m/rad or N/m]",
    "high": "stiffness at large deflections [N m/rad or N/m]",
    "break_at": "deflection at which the stiffness is the high one [rad or m]",
    "gap": "half width of the dead band [rad or m]",
    "smoothing": "width of the rounded corners [rad or m]",
}
_FRICTION_KEYS = {
    "viscous": "viscous friction [N m s/rad, or N s/m]",
    "coulomb": "Coulomb friction [N m or N], smoothed by tanh(beta speed)",
    "stribeck": "Stribeck friction at low speed [N m or N]: stribeck / cosh(alpha speed)",
    "alpha": "decay of the Stribeck friction with the speed [s/rad or s/m]",
    "beta": "steepness of the Coulomb friction at zero speed [s/rad or s/m]",
    "offset": "constant torque against positive motion [N m or N]",
}
_BODY_KEYS: dict[str, Schema] = {
    "mass": number("mass [kg]", least=0.0),
    "com": vector("center of mass in the body frame [m]", 3),
    "inertia": vector("inertia about the center of mass [kg m^2]: xx, yy, zz, optionally xy, yz, xz", 3, 6),
    "inertia_reduced": flag("the largest principal moment may exceed the sum of the others (regrouped tensors)"),
    "rotational_drag": number("damping of the absolute rotation [N m s/rad]", least=0.0, default=0.0),
}
_PLACEMENT_KEYS: dict[str, Schema] = {
    "position": vector("position [m]", 3),
    "rpy_rad": vector("rotations about the fixed x, y, z axes, in this order [rad]", 3),
    "rpy_deg": vector("rotations about the fixed x, y, z axes, in this order [deg]", 3),
    "rotation": vector("rotation matrix, row by row", 9),
}


def springs(*, zero: bool = False) -> list[Schema]:
    """A table for each type of spring; ``zero``: a linear spring may have the stiffness 0."""
    out = []
    for kind, (_, keys) in component_tables._SPRINGS.items():
        values = {}
        for key in keys:
            may = key in component_tables._MAY_BE_ZERO or (zero and kind == "linear")
            values[key] = number(_SPRING_KEYS[key], **({"least": 0.0} if may else {"above": 0.0}))
        text = _SPRING_TEXTS[kind]
        out.append(table(text, {"type": const(kind, text), **values}, ["type", *keys]))
    return out


def friction() -> Schema:
    """The friction laws."""
    out = []
    for kind, law in FRICTION_LAWS.items():
        keys = {
            key.name: number(
                _FRICTION_KEYS[key.name], **({} if key.metadata["signed"] else {"least": 0.0}), default=0.0
            )
            for key in dataclasses.fields(law)
        }
        out.append(table("friction torque against the speed", {"type": const(kind, "law"), **keys}))
    return out[0] if len(out) == 1 else one_of("friction law", out)


def limits() -> dict[str, Schema]:
    """Limits of speed and acceleration of a degree of freedom."""
    return {
        "speed_max": number("limit of the speed [rad/s or m/s]", above=0.0),
        "acceleration_max": number("limit of the acceleration [rad/s^2 or m/s^2]", above=0.0),
    }


def counterbalance() -> Schema:
    """Harmonics of a torque on a rotation."""
    sizes = range(1, component_tables.HARMONICS + 1)
    lists = {key: vector(f"torques of {key}(k q), k = 1, 2, ... [N m]", *sizes) for key in ("sin", "cos")}
    return table("counterbalance: torque on the arm by the angle", lists)


def dof() -> Schema:
    """Degrees of freedom: rotation or translation, with a gear (actuated) or a spring (not)."""
    out = []
    for kind, unit in (("rotation", "rad"), ("translation", "m")):
        ends = {"lower": f"lower limit [{unit}]", "upper": f"upper limit [{unit}]"}
        if kind == "rotation":
            places = angle("lower", "lower limit") | angle("upper", "upper limit")
        else:
            places = {key: number(text) for key, text in ends.items()}
        shared = {
            "name": name("name of the coordinate"),
            "type": const(kind, "rotation about, or translation along, the axis"),
            "axis": vector("direction of the axis, any length", 3),
            "friction": ref("friction", "friction on the arm side"),
            **places,
            **limits(),
            **({"counterbalance": ref("counterbalance", "torque by the angle")} if kind == "rotation" else {}),
        }
        gear = {"gear": ref("gear", "gear between the coordinate and its motor: the coordinate is actuated")}
        spring = {
            "spring": ref("joint_spring", "spring instead of a gear: the coordinate has no motor"),
            "damping": number(
                f"damping in parallel with the spring [{'N m s/rad' if unit == 'rad' else 'N s/m'}]", least=0.0
            ),
        }
        for own, needed in ((gear, "gear"), (spring, "spring")):
            out.append(table(f"a {kind}", shared | own, ["name", "type", "axis", needed]))
    return one_of("degree of freedom", out)


def gear() -> Schema:
    """Rigid and elastic gears."""
    rigid = table("a gear without elasticity", {"type": const("rigid", "no elasticity")}, ["type"])
    keys = {
        "type": const("elastic", "a spring between motor and joint"),
        "side": choice("the side of the gear to which spring and damping refer", ("arm", "motor")),
        "spring": ref("spring", "spring of the gear"),
        "damping": number("damping in parallel with the spring [N m s/rad or N s/m]", least=0.0, default=0.0),
    }
    return one_of("gear", [rigid, table("an elastic gear", keys, ["type", "side", "spring"])])


def element() -> Schema:
    """A link of the chain."""
    bending = {
        "direction": choice("axis of the deflection, across the beam", ("y", "z")),
        "stiffness": number("flexural stiffness EI [N m^2]", above=0.0),
        "modes": whole("number of modes", 1, 8),
        "damping_ratio": number("damping ratio of each mode, below 1", least=0.0, default=0.0),
    }
    beam = {
        "length": number("length along the x axis of the body [m]", above=0.0),
        "mass_per_length": number("mass per length [kg/m]", above=0.0),
        "bending": tables("bending in one direction", table("bending", bending, ["direction", "stiffness", "modes"])),
    }
    keys = {
        "name": name("name of the element"),
        "origin": ref("placement", "from the tip of the previous element"),
        "link": ref("placement", "from the last degree of freedom to the body frame"),
        "body": ref("body", "rigid body, in the body frame"),
        "beam": table(
            "slender elastic link, clamped at the body frame", beam, ["length", "mass_per_length", "bending"]
        ),
        "dof": tables("degrees of freedom, in their order", ref("dof"), least=0),
    }
    return table("a link of the chain, from the base to the tool", keys, ["name"])


def motor_keys() -> dict[str, Schema]:
    """Keys of a motor."""
    ratio = {
        "description": "gear ratio, motor speed / joint speed, one for each driven joint; of a translation [rad/m]"
    }
    ratio["anyOf"] = [number(""), vector("")]  # type: ignore[assignment]
    return {
        "name": name("name of the motor"),
        "drives": words("the degree of freedom that it drives, or a list of them (coupled wrist)"),
        "ratio": ratio,
        "inertia": number("rotor inertia, motor side [kg m^2]", least=0.0),
        "friction": ref("friction", "friction on the motor side"),
        "torque_max": number("limit of the torque, motor side [N m]", above=0.0),
        "speed_max": number("limit of the speed, motor side [rad/s]", above=0.0),
        "axis": vector("axis of the rotor in the frame of its carrier (complete coupling)", 3),
        "carrier": string("the element that carries the motor, or base (complete coupling)"),
    }


def definitions() -> dict[str, Schema]:
    """The tables that occur at several places."""
    return {
        "placement": table("constant pose", picked(component_tables._PLACEMENT, _PLACEMENT_KEYS)),
        "body": table("rigid body", picked(component_tables._BODY, _BODY_KEYS), ["mass"]),
        "spring": one_of("spring with a stiffness > 0", springs()),
        "joint_spring": one_of("spring", springs(zero=True)),
        "friction": friction(),
        "counterbalance": counterbalance(),
        "gear": gear(),
        "dof": dof(),
    }


def motors() -> Schema:
    """The list of motors."""
    return tables(
        "motors, as many as actuated coordinates", table("motor", motor_keys(), ["name", "drives", "ratio", "inertia"])
    )


def overlay_tables() -> dict[str, Schema]:
    """The tables ``urdf``, ``joint`` and ``link`` of a model file whose chain is in a URDF file."""
    urdf: dict[str, Schema] = {
        "file": string("path of the URDF file, relative to the folder of this file, or package://NAME/PATH"),
        "base": string("the link that is the ground"),
        "tip": string("the link that carries the tool"),
        "lock": {
            "description": "joints fixed at a position [rad or m], or a list of joints fixed at zero",
            "anyOf": [words(""), {"type": "object", "additionalProperties": number("position [rad or m]")}],
        },
        "drop": words("joints outside the chain, left out with all links behind them"),
        "limits": flag("use the limits of the URDF file") | {"default": True},
        "dynamics": flag("use the friction of the URDF file") | {"default": True},
    }
    motor = {key: value for key, value in motor_keys().items() if key not in ("drives",)}
    joint: dict[str, Schema] = {
        "rename": name("name of the coordinate"),
        "gear": ref("gear", "gear of the joint; default: rigid"),
        "spring": ref("joint_spring", "spring instead of a gear: no motor"),
        "damping": number("damping in parallel with the spring [N m s/rad or N s/m]", least=0.0),
        "friction": ref("friction", "instead of <dynamics>"),
        "counterbalance": ref("counterbalance", "torque by the angle, of a rotation"),
        "limits": flag("use the limits of the URDF file") | {"default": True},
        "motor": table("motor of the joint", motor),
        "before": tables("degrees of freedom before the joint, at the same point", ref("dof"), least=0),
        "after": tables("degrees of freedom after the joint, at the same point", ref("dof"), least=0),
        "lower": number("lower limit [m]"),
        "upper": number("upper limit [m]"),
        **angle("lower", "lower limit"),
        **angle("upper", "upper limit"),
        **limits(),
    }
    link: dict[str, Schema] = {
        "rename": name("name of the element"),
        "body": table(
            "instead of <inertial>",
            {key: _BODY_KEYS[key] for key in ("mass", "com", "inertia", "inertia_reduced")},
            ["mass"],
        ),
        "inertia_reduced": flag("the largest principal moment may exceed the sum of the others"),
    }
    named = {"type": "object", "additionalProperties": True}
    return {
        "urdf": table("the chain is in a URDF file", picked(overlay._URDF, urdf), ["file", "base", "tip"]),
        "joint": named
        | {
            "description": "what a URDF file cannot contain, for each moving joint by its name there",
            "additionalProperties": table("joint of the URDF file", picked(overlay._JOINT, joint)),
        },
        "link": named
        | {
            "description": "changes of links, by their name in the URDF file",
            "additionalProperties": table("link of the URDF file", picked(overlay._LINK, link)),
        },
    }
