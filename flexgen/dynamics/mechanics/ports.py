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
    meter = template.format(y="m")
    angle = template.format(y="rad")
    sums = ", then the joints" if output.is_with_joints else ""
    if output.has_angle:
        return "mixed", f"; {meter} for the position, then {angle} for the angle{sums}"
    if output.is_pose:
        return "mixed", f"; {meter} for the position{sums}, then {angle} for the rotation"
    if sums:
        return "mixed", f"; {meter} for the position{sums}"
    return template.format(y=output.unit if output.type == "combination" else "m"), ""


def port(name: str, model: RobotModel, sizes: dict[str, int]) -> Port:
    """An array of a function of the model's library."""
    extents, template, meaning = PORTS[name]
    if name == "target" and model.output.type == "tool_pose":
        unit = "mixed"
        sums = ", the joints [rad or m]" if model.output.weights else ""
        remark = f": position [m]{sums}, rotation matrix by columns"
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
