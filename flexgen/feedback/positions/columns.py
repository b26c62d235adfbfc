"""Columns of commanded positions in trajectories."""

from __future__ import annotations

from flexgen.base.spec.ports import Port
from flexgen.model.elements import RobotModel

Names = dict[str, tuple[str, ...]]


def command_columns(model: RobotModel) -> tuple[dict[str, Port], Names, Names]:
    """Ports, labels and units of the columns ``command_m`` and ``command_g``."""
    motors = tuple(motor.name for motor in model.motors)
    joints, units = zip(
        *((c.name, c.unit) for c in (model.coordinates[i] for i in model.i_g)), strict=True
    )
    unit = units[0] if len(set(units)) == 1 else "rad or m"
    ports = {
        "command_m": Port("command_m", (len(motors),), "rad", "commanded positions, motor side"),
        "command_g": Port("command_g", (len(joints),), unit, "commanded positions, joint side"),
    }
    return ports, {"command_m": motors, "command_g": joints}, {"command_g": units}
