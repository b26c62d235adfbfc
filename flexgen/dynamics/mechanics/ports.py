"""The arrays of a model's functions: sizes, units and meaning of a row of
`flexgen.dynamics.mechanics.signatures.PORTS`.
"""

from __future__ import annotations

from collections.abc import Sequence

from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.signatures import PORTS
from flexgen.model.elements import RobotModel


def _unit(template: str, units: Sequence[str]) -> tuple[str, str]:
    """Unit of an array, and what to add to its meaning where the coordinates' units differ."""
    kinds = sorted(set(units))
    rad = {"q": "rad", "tau": "N m", "M": "kg m^2"}
    metre = {"q": "m", "tau": "N", "M": "kg"}
    if "{" not in template or kinds == ["rad"]:
        return template.format(**rad), ""
    if kinds == ["m"]:
        return template.format(**metre), ""
    if template == "{M}":
        return "mixed", "; kg m^2, kg m or kg"
    return (
        "mixed",
        f"; {template.format(**rad)} for rotations, {template.format(**metre)} for translations",
    )


def _output_unit(template: str, model: RobotModel) -> tuple[str, str]:
    """Unit of an array of numbers of the output, and a note where its parts differ in unit."""
    output = model.output
    if output.has_angle:
        angle = template.format(y="rad")
        return "mixed", f"; {template.format(y='m')} for the position, then {angle} for the angle"
    if output.type != "tool_pose":
        return template.format(y=output.unit if output.type == "combination" else "m"), ""
    return (
        "mixed",
        (
            f"; {template.format(y='m')} for the position, then {template.format(y='rad')} for "
            "the rotation"
        ),
    )


def port(name: str, model: RobotModel, sizes: dict[str, int]) -> Port:
    """An array of a function of the model's library."""
    extents, template, meaning = PORTS[name]
    if name == "target" and model.output.type == "tool_pose":
        unit = "mixed"
        remark = ": position [m], rotation matrix by columns"
    elif "{y}" in template:
        unit, remark = _output_unit(template, model)
    else:
        unit, remark = _unit(template, [c.unit for c in model.coordinates])
    return Port(
        name,
        tuple(sizes[extent] if extent in sizes else int(extent) for extent in extents),
        unit,
        meaning + remark,
    )
