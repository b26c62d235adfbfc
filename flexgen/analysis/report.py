"""Everything that is worth knowing about a machine at a pose, in one noun."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.analysis.index import structural_index
from flexgen.analysis.linear import LinearModel, linearise, modes, poles
from flexgen.analysis.zeros import ZeroReport, motor_zeros, zero_report
from flexgen.errors import ArgumentError
from flexgen.mechanics.equations import Equations, derive
from flexgen.mechanics.statics import Equilibrium, hold_joints
from flexgen.model.elements import RobotModel


@dataclass(frozen=True)
class Analysis:
    """A machine at rest at a pose.

    ``rest``: the static equilibrium; ``poles`` [1/s]; ``modes``: (Hz, damping ratio) rising; ``zeros``: report on the
    declared output; ``zeros_motor`` [1/s]: from motor torques to motor angles; ``structural_index`` of the inverse
    dynamics (None where outputs and motors differ in number).
    """

    model: RobotModel
    rest: Equilibrium
    linear: LinearModel
    poles: np.ndarray
    modes: tuple[tuple[float, float], ...]
    zeros: ZeroReport
    zeros_motor: np.ndarray | None
    structural_index: int | None

    def to_dict(self) -> dict[str, Any]:
        """The same as JSON types, SI units; complex numbers as ``[re, im]``."""

        def pairs(values: np.ndarray | None) -> list[list[float]] | None:
            return None if values is None else [[float(z.real), float(z.imag)] for z in values]

        model = self.model
        return {
            "model": model.name,
            "n_m": model.n_m,
            "n_g": model.n_g,
            "n_e": model.n_e,
            "dof": model.dof,
            "pose": self.rest.q_a.tolist(),
            "motor_torque_Nm": self.rest.tau_m.tolist(),
            "modes_hz": [f for f, _ in self.modes],
            "modes_damping": [d for _, d in self.modes],
            "poles": pairs(self.poles),
            "zeros": pairs(self.zeros.zeros),
            "zeros_motor": pairs(self.zeros_motor),
            "phase": self.zeros.phase,
            "structural_index": self.structural_index,
            "unstable_time_constant_s": self.zeros.unstable_time_constant_s,
            "preview_s": self.zeros.preview_s,
        }


def analyze(model: str | Path | RobotModel | Equations, pose: Sequence[float] | None = None) -> Analysis:
    """Analyse a machine at rest at a pose.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    pose : sequence of n_a or n_g numbers [rad or m], optional
        Arm coordinates, or only the actuated ones; default: the model's home pose. The actuated coordinates are held
        there, the others settle under gravity.

    Raises
    ------
    ArgumentError
        The pose has the wrong length or is not finite.
    SolverError
        There is no static equilibrium nearby.
    """
    equations = model if isinstance(model, Equations) else derive(model)
    robot = equations.model
    try:
        values = np.array(robot.home if pose is None else pose, dtype=float)
    except (TypeError, ValueError):
        raise ArgumentError(f"pose: given {pose!r}, expected a sequence of numbers") from None
    if values.ndim != 1 or len(values) not in (robot.n_a, robot.n_g) or not np.isfinite(values).all():
        names = ", ".join(c.name for c in robot.coordinates)
        raise ArgumentError(
            f"pose: given {values.tolist()}, expected {robot.n_a} finite numbers ({names}) "
            f"or the {robot.n_g} actuated ones"
        )
    if len(values) == robot.n_a and robot.n_a != robot.n_g:
        rest = hold_joints(equations, values[list(robot.i_g)], values[list(robot.i_e)])
    else:
        rest = hold_joints(equations, values)
    linear = linearise(equations, rest)
    roots = poles(linear)
    return Analysis(
        model=robot,
        rest=rest,
        linear=linear,
        poles=roots,
        modes=tuple(modes(roots)),
        zeros=zero_report(equations, linear, rest),
        zeros_motor=motor_zeros(linear),
        structural_index=structural_index(equations).index,
    )
