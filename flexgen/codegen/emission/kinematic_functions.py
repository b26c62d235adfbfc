"""Inverse kinematics in the hand-written C: functions, for `flexgen.codegen.emission.c_functions`,
and numbers of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from flexgen.codegen.emission.clib_types import CFunction, Field
from flexgen.model.elements import Dof, RobotModel
from flexgen.runtime.identity import CONFIGURATIONS_MAX, STARTS, STARTS_MAX

USED = ("forward_kinematics", "jacobian")  # functions of one point that it calls
FREE = 6  # joints that it finds

_HEADER = "inverse_kinematics"

KINEMATIC_FUNCTIONS = (
    CFunction(
        "inverse_kinematics_work",
        "inverse_kinematics.c",
        "Length of the workspace of inverse_kinematics, in reals.",
        "",
        (),
        returns="size",
        double=True,
        header=_HEADER,
    ),
    CFunction(
        "inverse_kinematics",
        "inverse_kinematics.c",
        "All joint configurations that bring the tool to a pose, the nearest to a given one "
        "first.",
        "Six coordinates with a motor are found; all others keep their values of q_start, so "
        "that deflections and the spare joints of a redundant arm may have any values. Damped "
        "Gauss-Newton steps go down from q_start, and then from starts that are spread evenly "
        "or made from what was found, until 256 starts in a row find nothing new; a solution "
        "has an error below 1e-12 (rotation in rad, position over half the reach, and the "
        "rounding of a position far from the origin). Nearest: the largest difference of a "
        "coordinate decides. With starts = 1 only q_start is tried, in bounded time: the "
        "solution that continues a motion. Rotations are within half a turn of q_start; limits "
        "of the joints are not checked. Where the arm is singular at a configuration, its "
        "joints are accurate to about 1e-6. Configurations closer than about 1e-5 rad to a "
        "singular one can be missing or found twice, and no status says so. q is written with "
        "OK only. UNREACHABLE: nothing was found. NOT_CONVERGED: more than 16 configurations, "
        "as the arm is singular at the pose. BAD_ARGUMENT also means that R is not a rotation, "
        "that an entry of q_start is larger than 1000, or that free does not list six different "
        "coordinates with a motor.",
        (
            Field("p", "const real *", ("3",), "m", "position of the tool in the world"),
            Field("R", "const real *", ("9",), "1", "its rotation matrix by columns"),
            Field(
                "q_start",
                "const real *",
                ("n_a",),
                "mixed",
                "arm coordinates: the first start, and the values of all coordinates that are "
                "not free",
            ),
            Field(
                "free",
                "const int *",
                ("6",),
                "",
                "indices of the free coordinates in q_a; may be null for an arm with six motors",
            ),
            Field(
                "starts",
                "int",
                (),
                "1",
                f"starts at most, 1 to {STARTS_MAX}; for all configurations {STARTS}",
            ),
            Field(
                "most",
                "int",
                (),
                "1",
                f"configurations to be written at most, 1 to {CONFIGURATIONS_MAX}",
            ),
            Field(
                "q",
                "real *",
                ("most", "n_a"),
                "mixed",
                "arm coordinates of the configurations, the nearest first",
            ),
            Field(
                "count", "int *", ("1",), "1", "configurations found; min(count, most) are in q"
            ),
            Field("work", "real *", ("work_size",), "", "workspace"),
            Field("work_size", "int64_t", (), "1", "its length, at least inverse_kinematics_work"),
        ),
        double=True,
        header=_HEADER,
    ),
)


@dataclass(frozen=True)
class KinematicConstants:
    """Numbers of a model for inverse kinematics.

    Parameters
    ----------
    i_g : tuple of int
        Indices in q_a of the coordinates with a motor.
    is_rotation : tuple of bool
        For each arm coordinate.
    lower, upper : tuple of float
        Interval in which starts are spread, for each arm coordinate: a turn, or the limits of a
        translation.
    around : tuple of bool
        Instead 1 m around the first start: translations without limits.
    """

    i_g: tuple[int, ...]
    is_rotation: tuple[bool, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    around: tuple[bool, ...]


def kinematic_functions(
    model: RobotModel, functions: Sequence[str], precision: str
) -> tuple[CFunction, ...]:
    """The functions of a library with these functions of one point; none for an arm with fewer
    than six motors.
    """
    fits = model.n_g >= FREE and set(USED) <= set(functions) and precision == "double"
    return KINEMATIC_FUNCTIONS if fits else ()


def kinematic_constants(model: RobotModel) -> KinematicConstants:
    """The `KinematicConstants` of a model."""

    def interval(k: int) -> tuple[float, float]:
        """Where starts are spread."""
        coordinate = model.coordinates[k]
        if coordinate.unit == "rad":
            return -math.pi, math.pi
        lower, upper = _limits(coordinate.dof)
        if lower is None:
            lower = -1.0 if upper is None else upper - 2.0
        return lower, lower + 2.0 if upper is None else upper

    lengths = [coordinate.unit != "rad" for coordinate in model.coordinates]
    intervals = [interval(k) for k in range(model.n_a)]
    return KinematicConstants(
        i_g=tuple(int(i) for i in model.i_g),
        is_rotation=tuple(coordinate.unit == "rad" for coordinate in model.coordinates),
        lower=tuple(lower for lower, _ in intervals),
        upper=tuple(upper for _, upper in intervals),
        around=tuple(
            is_length and _limits(coordinate.dof) == (None, None)
            for is_length, coordinate in zip(lengths, model.coordinates, strict=True)
        ),
    )


def _limits(dof: Dof | None) -> tuple[float | None, float | None]:
    """Lower and upper limit of a coordinate; None where it has none."""
    return (None, None) if dof is None else (dof.lower, dof.upper)
