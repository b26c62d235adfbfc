"""Structural analysis of the inverse dynamics by Pryce's signature method, and its numeric check.

From the signature's offsets c, d: the system Jacobian ``J_ij = d f_i^(c_i) / d x_j^(d_j)``, which
has entries only where ``d_j - c_i = sigma_ij``. Where J is nonsingular at a consistent point,
structural index and degrees of freedom ``sum d - sum c`` are right and the derivatives follow
stage by stage, block by block. Where J is singular the structure is misleading: terms of the
pattern cancel, and index and degrees of freedom are different.

Source: J. D. Pryce, BIT Numerical Mathematics 41(2), 2001.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.dynamics.dae.block_form import BlockForm, block_form
from flexgen.dynamics.dae.signature import ABSENT, signature, structural_index
from flexgen.dynamics.dae.system import InverseDae
from flexgen.dynamics.dae.taylor_array import TaylorArray
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import Equilibrium
from flexgen.model.elements import RobotModel

SINGULAR = 1e-10  # of the largest singular value of a scaled block: terms cancel up to rounding
NEARLY = 1e-6  # below it the structure holds, but the Jacobian is nearly singular
SWEEPS = 30  # of the scaling of a block's rows and columns


@dataclass(frozen=True)
class Structure:
    """The structure of a model's inverse dynamics, by names.

    Parameters
    ----------
    equations, unknowns : tuple of str
        Rows and columns of ``sigma``.
    sigma : array (rows, columns)
        Highest derivative of each unknown in each equation;
        `flexgen.dynamics.dae.signature.ABSENT` where it does not appear.
    c, d : tuple of int
        Offsets: how often each equation has to be differentiated, and the derivative of each
        unknown that then follows. Empty where the system is structurally singular or not square.
    index : int or None
        Structural index.
    dof : int or None
        Degrees of freedom, ``sum d - sum c``.
    form : BlockForm
        Blocks of the system Jacobian's pattern; of the signature's own pattern where there are no
        offsets.
    """

    equations: tuple[str, ...]
    unknowns: tuple[str, ...]
    sigma: np.ndarray
    c: tuple[int, ...]
    d: tuple[int, ...]
    index: int | None
    dof: int | None
    form: BlockForm

    def name_block(self, block: tuple[tuple[int, ...], tuple[int, ...]]) -> dict[str, list[str]]:
        """Names of a block's equations and unknowns."""
        return {
            "equations": [self.equations[i] for i in block[0]],
            "unknowns": [self.unknowns[j] for j in block[1]],
        }


@dataclass(frozen=True)
class StructureCheck:
    """The system Jacobian at a point.

    ``smallest``: for each block the ratio of its smallest to its largest singular value, rows and
    columns scaled; ``sigma_min``: the least of them; ``holds``: whether the structure is correct
    there; ``verdict``: a sentence.
    """

    smallest: tuple[float, ...]
    sigma_min: float | None
    holds: bool | None
    verdict: str


def output_names(model: RobotModel) -> tuple[str, ...]:
    """Names of the rows of the output."""
    if model.output.type != "combination":
        first = model.output.tool_size + 1
        return (
            *(f"tool {axis}" for axis in model.output.axes),
            *["tool angle"] * model.output.has_angle,
            *(f"output {first + k}" for k in range(len(model.output.weights))),
            *(f"tool turn {axis}" for axis in "xyz" if model.output.is_pose),
        )
    return tuple(f"output {k + 1}" for k in range(model.output.size))


def structure(equations: Equations) -> Structure:
    """The `Structure` of a model's inverse dynamics."""
    model = equations.model
    sigma = signature(equations)
    coordinates = [c.name for c in model.coordinates] + [model.motors[j].name for j in model.i_m]
    rows = (*(f"motion {name}" for name in coordinates), *output_names(model))
    unknowns = (*coordinates, *(f"torque {motor.name}" for motor in model.motors))
    found = structural_index(equations)
    if found.index is None:
        return Structure(rows, unknowns, sigma, (), (), None, None, block_form(sigma > ABSENT))
    c = np.array(found.c)
    d = np.array(found.d)
    form = block_form((sigma > ABSENT) & (d[None, :] - c[:, None] == sigma))
    return Structure(
        rows, unknowns, sigma, found.c, found.d, found.index, int(d.sum() - c.sum()), form
    )


def system_jacobian(series: TaylorArray, structure: Structure, x: np.ndarray) -> np.ndarray:
    """The system Jacobian J of the structural analysis at the point ``x`` (2, n_x), scaled:
    derivatives of each row in the derivatives of the unknowns that lead in it, where offsets d_j -
    c_i equal the signature.

    ``x``: value and first rate of the unknowns of the system of first order.
    """
    dae = series.dae
    F_x, F_dx = (J[0, 0] for J in series.jacobians(np.stack([x[0], x[1]])[None]))
    scales = series.scales(x[0])
    factors = scales.rows[:, None] * scales.x
    dof = dae.model.dof
    F_x = F_x * factors
    F_dx = F_dx * factors / scales.time
    rows = np.concatenate([dae.dynamic, dae.output])
    levels = {0: dae.y, 1: dae.rate}
    J = np.zeros(structure.sigma.shape)
    leads = np.array(structure.d)[None, :] - np.array(structure.c)[:, None] == structure.sigma
    for order in range(3):
        values = F_dx[np.ix_(rows, dae.rate)] if order == 2 else F_x[np.ix_(rows, levels[order])]
        J[:, :dof] = np.where(structure.sigma[:, :dof] == order, values, J[:, :dof])
    J[:, dof:] = F_x[np.ix_(rows, dae.torque)]
    return np.where(leads, J, 0.0)


def check_structure(series: TaylorArray, structure: Structure, x: np.ndarray) -> StructureCheck:
    """Whether the structure holds at a point ``x`` (2, n_x): value and first rate of the unknowns.

    It does where the Jacobian of each diagonal block is regular there: smallest singular value at
    least `SINGULAR` of the largest, in scaled rows and columns. A structurally singular system has
    no blocks: the verdict names its surplus.
    """
    if structure.index is None:
        parts = []
        for what, part in (
            ("too many", structure.form.surplus),
            ("too few", structure.form.deficit),
        ):
            if any(part):
                names = structure.name_block(part)
                parts.append(
                    f"{what} equations ({', '.join(names['equations']) or 'none'}) "
                    f"for {', '.join(names['unknowns']) or 'no unknown'}"
                )
        return StructureCheck((), None, None, f"structurally singular: {'; '.join(parts)}")
    J = system_jacobian(series, structure, x)
    smallest = tuple(
        smallest_ratio(J[np.ix_(rows, columns)]) for rows, columns in structure.form.blocks
    )
    worst = int(np.argmin(smallest))
    sigma_min = smallest[worst]
    names = structure.name_block(structure.form.blocks[worst])
    where = (
        f"the block of {', '.join(names['unknowns'])} (smallest singular value {sigma_min:.1e} "
        "of the largest)"
    )
    if sigma_min < SINGULAR:
        verdict = (
            f"structure misleading: the Jacobian is singular in {where}; "
            f"index {structure.index} is not the true one here"
        )
    elif sigma_min < NEARLY:
        verdict = f"structure holds, but the Jacobian is nearly singular in {where}"
    else:
        verdict = f"structure holds: index {structure.index}, {structure.dof} degrees of freedom"
    return StructureCheck(smallest, sigma_min, sigma_min >= SINGULAR, verdict)


def check_at_rest(equations: Equations, rest: Equilibrium) -> tuple[Structure, StructureCheck]:
    """Structure of a model, and its check in an equilibrium."""
    dae = InverseDae(equations)
    found = structure(equations)
    return found, check_structure(
        TaylorArray(dae), found, np.stack([dae.pack(rest), np.zeros(dae.n_x)])
    )


def smallest_ratio(block: np.ndarray) -> float:
    """Smallest over largest singular value of a square matrix whose rows and columns are first
    scaled to length one; 0 where a row or a column is zero, the entry itself, at most 1, of a
    single one.
    """
    A = np.where(np.abs(block) > 1e-300, block, 0.0)
    if not (A.any(axis=0).all() and A.any(axis=1).all()):
        return 0.0
    if len(A) == 1:
        return min(1.0, abs(float(A[0, 0])))
    for _ in range(SWEEPS):
        A = A / np.sqrt(np.linalg.norm(A, axis=1))[:, None]
        A = A / np.sqrt(np.linalg.norm(A, axis=0))
    values = np.linalg.svd(A, compute_uv=False)
    return float(values[-1] / values[0])


def to_dict(structure: Structure, check: StructureCheck) -> dict[str, Any]:
    """The structure and its check at a pose as JSON types."""
    return {
        "equations": list(structure.equations),
        "unknowns": list(structure.unknowns),
        "equation_offsets": list(structure.c),
        "unknown_offsets": list(structure.d),
        "index": structure.index,
        "dof": structure.dof,
        "blocks": [structure.name_block(block) for block in structure.form.blocks],
        "block_sigma_min": list(check.smallest),
        "sigma_min": check.sigma_min,
        "holds": check.holds,
        "verdict": check.verdict,
    }
