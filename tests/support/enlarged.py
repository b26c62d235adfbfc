"""Robots of another size, whose answers grow with their dimension."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from flexgen.model.elements import Body, RobotModel

NUMBER = r"-?\d[\d.e+-]*"
# powers of the factor; inertia: of a body and of a rotor
POWERS = {
    "com": 1.0,
    "position": 1.0,
    "displacement": 1.0,
    "mass": 3.0,
    "duration": 0.5,
    "inertia": 5.0,
}
POWERS |= {"stiffness": 4.0, "damping": 4.5, "viscous": 4.5}  # of rotary springs and motors


def enlarged(name: str, factor: float) -> str:
    """The text of the model `name` with lengths `factor` times as large, without its variants;
    rotary springs only.

    Density and gravity are the same: masses grow with the third power of the factor, times with
    its root.
    """
    text = (
        (Path(__file__).parents[2] / "models" / f"{name}.toml")
        .read_text("utf-8")
        .partition("[variant")[0]
    )

    def scaled(found: re.Match[str]) -> str:
        size = factor ** POWERS[found[1]]
        return (
            f"{found[1]} = "
            f"{re.sub(NUMBER, lambda number: repr(size * float(number[0])), found[2])}"
        )

    return re.sub(rf"\b({'|'.join(POWERS)}) = (\[[^\]]*\]|{NUMBER})", scaled, text)


def rescaled(model: RobotModel, length: float, mass: float, time: float) -> RobotModel:
    """A robot with rigid gears in other units of length, mass and time, gravity too."""
    unit = mass * length**2

    def body(of: Body) -> Body:
        com, inertia = (
            np.multiply(x, size).tolist() for x, size in ((of.com, length), (of.inertia, unit))
        )
        return Body(mass * of.mass, tuple(com), tuple(map(tuple, inertia)))

    elements = [
        replace(
            e,
            body=body(e.body),
            origin=replace(e.origin, position=tuple(length * x for x in e.origin.position)),
        )
        for e in model.elements
    ]
    motors = tuple(replace(m, inertia=unit * m.inertia) for m in model.motors)
    gravity = tuple(x * length / time**2 for x in model.gravity)
    return replace(
        model,
        elements=tuple(elements),
        motors=motors,
        gravity=gravity,
        payload=body(model.payload),
    )
