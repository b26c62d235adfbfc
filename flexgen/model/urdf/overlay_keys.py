"""Keys of the numbers of a robot in its overlay.

The file of a URDF robot states there what a model file states.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from flexgen.model.elements import RobotModel


def overlay_key(overlay: Mapping[str, Any], model: RobotModel, key: str) -> str:
    """The dotted key of a number in an overlay.

    Parameters
    ----------
    overlay : mapping
        The data of the file, as `tomllib` reads them.
    model : RobotModel
        That the overlay and its URDF file describe.
    key : str
        In an ordinary model file: ``element.arm1.dof.q1.gear.damping`` is
        ``joint.q1.gear.damping`` in the overlay, ``element.arm1.body.mass`` is
        ``link.arm1.body.mass``, and the motor of a table ``[joint.q1]`` is there.

    Returns
    -------
    str
        The same key where the overlay has it as an ordinary file, such as ``payload.mass``.
    """
    head, _, rest = key.partition(".")
    if head == "motor":
        name, _, rest = rest.partition(".")
        return _of_motor(overlay, model, name, rest) or key
    if head != "element":
        return key
    element, kind, rest = rest.split(".", 2)
    if any(table.get("name") == element for table in overlay.get("element", ())):
        return key
    if kind == "body":
        return f"link.{_in_urdf(overlay, 'link', element)}.body.{rest}"
    if kind != "dof":
        return key
    joint, _, rest = rest.partition(".")
    return f"joint.{_in_urdf(overlay, 'joint', joint)}.{rest}"


def has_table(overlay: Mapping[str, Any], key: str) -> bool:
    """Whether an overlay has the table, or the list, of a number.

    A table with this number alone would hide others. A motor that the overlay has may get a
    friction: the URDF file states that of joints only.
    """
    here: Any = overlay
    words = key.split(".")
    for word in words[:2] if words[0] == "motor" else words[:-1]:
        if isinstance(here, list):
            here = next(
                (x for x in here if isinstance(x, Mapping) and x.get("name") == word), None
            )
        elif isinstance(here, Mapping):
            here = here.get(word)
        else:
            return False
    return isinstance(here, Mapping | list)


def _of_motor(overlay: Mapping[str, Any], model: RobotModel, name: str, rest: str) -> str:
    """The key of a number of a motor in the table of its joint.

    Empty where it has a table of its own.
    """
    if any(motor.get("name") == name for motor in overlay.get("motor", ())):
        return ""
    row = [motor.name for motor in model.motors].index(name)
    driven = [i for i, ratio in zip(model.i_g, model.eta[row], strict=True) if ratio]
    joint = _in_urdf(overlay, "joint", model.coordinates[driven[0]].name)
    return f"joint.{joint}.motor.{rest}"


def _in_urdf(overlay: Mapping[str, Any], kind: str, name: str) -> str:
    """The name of a joint or link in the URDF file.

    The key ``rename`` of the overlay may have changed it.
    """
    tables = overlay.get(kind, {})
    renamed = [old for old, table in tables.items() if table.get("rename") == name]
    return str(renamed[0]) if renamed else name
