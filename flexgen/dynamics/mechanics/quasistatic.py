"""Static equilibria along a path: at each instant the output is at its target and the robot is in
equilibrium.
"""

from __future__ import annotations

from typing import Protocol

import casadi as ca
import numpy as np

from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import Evaluator
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.dynamics.mechanics.statics import Equilibrium, balance, equilibrium_at

STEPS = 30  # of Newton's method from one instant to the next
# least number of steps in each span of a path, so that Newton's method stays on one branch
STEPS_PER_SPAN = 64
SPANS = 50  # of a program, at most


class OutputSample(Protocol):
    """The target of the output at k instants.

    ``y`` (k, n_y, r): rows of the output that are positions, last axis: derivatives from 0; ``R``
    (k, 3, 3): the orientation where the output is a pose, else None. A sample may also have
    ``q_g`` (k, n_g, r), actuated coordinates near those that reach the output, or None.
    """

    @property
    def y(self) -> np.ndarray:
        """Rows that are positions, with derivatives."""
        ...

    @property
    def R(self) -> np.ndarray | None:
        """Orientation of a pose."""
        ...

    def derivative(self, k: int) -> np.ndarray:
        """k-th derivative (k >= 1) of the output, (n, n_y)."""
        ...


class OutputPath(Protocol):
    """A path of the output, such as `flexgen.paths.path.Path`.

    It may also have ``breaks`` [s]: the ends of its spans, and of the path.
    """

    @property
    def duration(self) -> float:
        """Its length [s]."""
        ...

    @property
    def q_start(self) -> np.ndarray:
        """Coordinates (n_a,) near those at its start."""
        ...

    def sample(self, t: np.ndarray) -> OutputSample:
        """The reference at the instants ``t`` [s]."""
        ...


def targets(sample: OutputSample) -> np.ndarray:
    """Values, (k, n_y) or (k, 12), for the target symbol of
    `flexgen.dynamics.mechanics.outputs.output_map`.
    """
    positions = np.asarray(sample.y)[:, :, 0]
    return (
        positions
        if sample.R is None
        else np.hstack([positions, sample.R.transpose(0, 2, 1).reshape(-1, 9)])
    )


def poses_along(equations: Equations, reference: OutputPath, times: np.ndarray) -> np.ndarray:
    """Coordinates (k, n_a) in equilibrium with the output at the target of the path, at rising
    ``times`` (k,) [s].

    Raises
    ------
    SolverError
        There is no such pose, or it is singular.
    """
    out = output_map(equations)
    symbol = equations.lagrangian.chain.q_a
    rows = ca.vertcat(out.error, balance(equations))
    if rows.numel() != symbol.numel():
        raise SolverError(
            f"path: {out.error.numel()} outputs do not determine the {equations.model.n_g} "
            "actuated coordinates"
        )
    jacobian_of = ca.densify(ca.jacobian(rows, symbol))
    newton = Evaluator(
        ca.Function("equilibrium", [symbol, out.target], [ca.densify(rows), jacobian_of])
    )
    q = np.array(reference.q_start, dtype=float)
    given = np.asarray(times, dtype=float)
    spacing = np.diff(np.clip(given, 0.0, reference.duration), prepend=0.0)
    spans = min(max(1, len(getattr(reference, "breaks", ())) - 1), SPANS)
    counts = np.maximum(
        1, np.ceil(spacing * (STEPS_PER_SPAN * spans / reference.duration) - 1e-9).astype(int)
    )
    starts = np.concatenate([[min(0.0, given[0])], given[:-1]])
    instants = np.concatenate(
        [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(starts, given, counts, strict=True)]
    )
    poses = np.zeros((len(instants), len(q)))
    sample = reference.sample(instants)
    q_g = getattr(sample, "q_g", None)
    for k, target in enumerate(targets(sample)):
        if q_g is not None:
            q[list(equations.model.i_g)] = q_g[k, :, 0]
            # nothing to solve, even where the output does not determine the joints
            if not equations.model.n_e:
                poses[k] = q
                continue
        for _ in range(STEPS):
            residual, jacobian = newton(q, target)
            size = np.maximum(np.abs(jacobian).max(axis=1), 1e-300)
            try:
                step = np.linalg.solve(jacobian / size[:, None], -residual[:, 0] / size)
            except np.linalg.LinAlgError:
                raise SolverError(f"path: singular pose at t = {instants[k]:.4g} s") from None
            q = q + step
            if np.abs(step).max() < 1e-12 * (1 + np.abs(q).max()):
                break
        else:
            raise SolverError(
                f"path: no static equilibrium at t = {instants[k]:.4g} s; "
                "the path leaves the workspace or passes a singular pose"
            )
        poses[k] = q
    return poses[np.cumsum(counts) - 1]


def equilibria_along(
    equations: Equations, reference: OutputPath, times: np.ndarray
) -> list[Equilibrium]:
    """The equilibrium at each of the ``times`` (k,) [s]; see `poses_along`."""
    return [equilibrium_at(equations, q) for q in poses_along(equations, reference, times)]
