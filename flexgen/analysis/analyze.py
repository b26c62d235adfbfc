"""Analysis of a robot in a static equilibrium: modes, zeros, index and solvability in one
object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.analysis.compliance import ToolCompliance, tool_compliance
from flexgen.analysis.content import content_of_analysis
from flexgen.analysis.linear import LinearModel, linearize, modes, poles
from flexgen.analysis.zero_dynamics.solvability import (
    Solvability,
    SolvabilityPath,
    solvability,
    solvability_path,
)
from flexgen.analysis.zero_dynamics.zeros import ZeroReport, motor_zeros, zero_report
from flexgen.analysis.zero_dynamics.zeros_along_path import ZeroPath, zero_path
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.registry import find_function
from flexgen.base.results import Result
from flexgen.base.rows import Part
from flexgen.dynamics.dae.strangeness_index import KunkelMehrmann, kunkel_mehrmann_at_rest
from flexgen.dynamics.dae.structure import Structure, StructureCheck, check_at_rest
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.quasistatic import OutputPath
from flexgen.dynamics.mechanics.statics import Equilibrium, hold_joints
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel


@checked_result
@dataclass(frozen=True, repr=False)
class Analysis(Result):
    """Analysis of a robot in a static equilibrium.

    ``equilibrium``: the pose; ``poles`` [1/s]; ``modes``: (Hz, damping ratio) rising; ``zeros``:
    report on the declared output; ``zeros_motor`` [1/s]: from motor torques to motor angles;
    ``structural_index`` of the inverse dynamics (None where outputs and motors differ in number);
    ``structure`` and ``structure_check``: what it follows from, and whether it holds at the pose;
    ``kunkel_mehrmann``: strangeness index, a, d, v there; ``solvability``: whether and how well
    the inverse dynamics can be solved there, with warnings; ``compliance``: of the tool with held
    motors, None where they do not hold the arm. Where a path was given also ``zero_path`` and
    ``solvability_path``, the latter None for complete motor coupling.

    Examples
    --------
    >>> found = flexgen.analyze("elbow")
    >>> [f"{frequency:.1f} Hz" for frequency, damping in found.modes[:2]], found.structural_index
    (['0.1 Hz', '22.8 Hz'], 4)
    """

    model: RobotModel
    equilibrium: Equilibrium
    linear: LinearModel
    poles: np.ndarray
    modes: tuple[tuple[float, float], ...]
    zeros: ZeroReport
    zeros_motor: np.ndarray | None
    structural_index: int | None
    structure: Structure
    structure_check: StructureCheck
    kunkel_mehrmann: KunkelMehrmann
    solvability: Solvability
    compliance: ToolCompliance | None
    zero_path: ZeroPath | None = None
    solvability_path: SolvabilityPath | None = None

    def __repr__(self) -> str:
        low = f"lowest mode {self.modes[0][0]:.4g} Hz, " if self.modes else ""
        index = (
            f", structural index {self.structural_index}"
            if self.structural_index is not None
            else ""
        )
        phase = "no verdict on the zeros" if self.zeros.phase == "none" else self.zeros.phase
        return f"<Analysis {self.model.title}: {low}{phase}{index}>"

    def to_control(self, *, units: bool = False) -> Any:
        """The robot linearized about this equilibrium, for the package python-control.

        Inputs are the motor torques ``tau_m[...]`` [N m], outputs the declared output ``y[...]``
        and the motor angles ``q_m[...]``, states the coordinates and their speeds; all are
        deviations from the equilibrium. With ``units`` each name ends in its unit, as the columns
        of a trajectory: ``tau_m[m1] N m``.

        Returns
        -------
        control.StateSpace

        Raises
        ------
        ArgumentError
            The package control is not installed.
        """
        return find_function("Analysis.to_control")(self, units)

    def content(self) -> tuple[Part, ...]:
        """Equilibrium, modes and zeros, verdicts on the inverse dynamics, compliance."""
        return content_of_analysis(self)


@checked_types(own=("pose",))
def analyze(
    model: str | Path | RobotModel | Equations,
    pose: Sequence[float] | None = None,
    path: OutputPath | None = None,
    poses: int = 41,
) -> Analysis:
    """Analyze a robot in a static equilibrium.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    pose : sequence of n_a or n_g numbers [rad or m], optional
        Arm coordinates, such as 0.3 -1.1 0; default: home. Or only the actuated ones. These are
        held, the others follow from the equilibrium.
    path : OutputPath, optional
        Such as `flexgen.paths.path.Path`: zeros and solvability are computed along it, too.
    poses : int
        Number of poses on the path.

    Returns
    -------
    Analysis

    Raises
    ------
    ArgumentError
        The pose has the wrong length or is not finite; a path for another number of outputs than
        of motors.
    SolverError
        There is no static equilibrium nearby, or none along the path.

    Examples
    --------
    >>> f"{flexgen.analyze('elbow').modes[0][0]:.3f} Hz"
    '0.068 Hz'
    """
    if path is not None and not callable(getattr(path, "sample", None)):
        raise ArgumentError(
            f"path: given {path!r}, expected a flexgen.Path, such as flexgen.plan(model, move) "
            "returns"
        )
    equations = model if isinstance(model, Equations) else derive(model)
    robot = equations.model
    try:
        values = np.array(robot.home if pose is None else pose, dtype=float)
    except (TypeError, ValueError):
        raise ArgumentError(f"pose: given {pose!r}, expected a sequence of numbers") from None
    if (
        values.ndim != 1
        or len(values) not in (robot.n_a, robot.n_g)
        or not np.isfinite(values).all()
    ):
        names = ", ".join(c.name for c in robot.coordinates)
        raise ArgumentError(
            f"pose: given {values.tolist()}, expected {robot.n_a} finite numbers ({names}) "
            f"or the {robot.n_g} actuated ones"
        )
    if len(values) == robot.n_a and robot.n_a != robot.n_g:
        equilibrium = hold_joints(equations, values[list(robot.i_g)], values[list(robot.i_e)])
    else:
        equilibrium = hold_joints(equations, values)
    linear = linearize(equations, equilibrium)
    roots = poles(linear)
    simple = obstacle(robot, "simplified coupling") is None
    structure, check = check_at_rest(equations, equilibrium)
    return Analysis(
        model=robot,
        equilibrium=equilibrium,
        linear=linear,
        poles=roots,
        modes=tuple(modes(roots)),
        zeros=zero_report(equations, linear, equilibrium),
        zeros_motor=motor_zeros(linear),
        structural_index=structure.index,
        structure=structure,
        structure_check=check,
        kunkel_mehrmann=kunkel_mehrmann_at_rest(equations, equilibrium),
        solvability=solvability(equations, equilibrium, linear),
        compliance=tool_compliance(equations, equilibrium, linear),
        zero_path=None if path is None else zero_path(equations, path, poses),
        solvability_path=solvability_path(equations, path, poses)
        if path is not None and simple
        else None,
    )
