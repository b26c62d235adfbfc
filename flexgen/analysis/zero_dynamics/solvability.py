"""Whether and how well the inverse dynamics of a robot can be solved at a pose, with the reason if
not.

The torque follows from the path where the matrix

    P = W M^-1 S_g G,
    G = D_g (damped gears), K_g (undamped ones) or eta' (motors behind rigid gears)

is nonsingular: it maps the inputs of the gears to the third, fourth or second derivative of the
output. M is the arm's inertia with the rotors behind rigid gears, which move with their joints;
S_g picks the actuated rows. As ``det(W M^-1 S_g) = +-det(W_g) det(A) / det(M)``, P fails where the
tool is in a singular pose (W_g), where the inertia A of the zero dynamics is singular (a zero at
infinity), and where a gear transmits no torque.

Source: cf. A. De Luca, ICRA 1988 (decoupling matrix of elastic-joint robots); M. L. J. Hautus,
1969 (controllability).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.analysis.arm_linearization import ArmLinearization, arm_linearization
from flexgen.analysis.linear import LinearModel, poles
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.dae.structure import output_names
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.quasistatic import OutputPath, poses_along
from flexgen.dynamics.mechanics.statics import Equilibrium, gear_damping, reach
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel

SINGULAR = 1e-9  # relative: below it a matrix is singular but for rounding
TOOL = 1e-2  # relative: a tool direction that needs a hundred times the joint motion of others
INERTIA = 1e-5  # of the coordinates' own inertia: a zero near infinity
DISTAL = 1e-2  # the same where elasticity lies beyond the last actuator
ALONE = 0.3  # share of a null vector above which a coordinate is named


@dataclass(frozen=True)
class Solvability:
    """Regularity of the inverse dynamics, and controllability of the linearization, in a static
    equilibrium.

    Parameters
    ----------
    regular : bool or None
        Whether P is nonsingular; None where outputs and motors differ in number, or rotors turn
        with their carriers.
    matrix : array (n_y, n_g) or None
        P, in SI units.
    singular_values : array (n_y,)
        Those of ``W M^-1 S_g`` with rows and columns of length one in the metric of M^-1: free of
        units, at most sqrt(n_g).
    relative_degree : tuple of int
        For each gear: the order of the derivative of the output that its input appears in, 2
        (rigid), 3 (damped) or 4.
    tool_singular_values : array
        Those of W_g, lengths in units of the arm's reach.
    inertia_sigma_min : float or None
        The smallest singular value of A in units of the non-actuated coordinates' own inertia.
    distal : tuple of str
        Non-actuated coordinates beyond the last actuated one.
    controllability : float
        Smallest singular value of ``[s^2 M + s D + K, B]`` over the poles s, scaled; 0: not
        controllable.
    warnings : tuple of str
    """

    regular: bool | None
    matrix: np.ndarray | None
    singular_values: np.ndarray
    relative_degree: tuple[int, ...]
    tool_singular_values: np.ndarray
    inertia_sigma_min: float | None
    distal: tuple[str, ...]
    controllability: float
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """As JSON types."""
        return {
            "regular": self.regular,
            "matrix": None if self.matrix is None else self.matrix.tolist(),
            "singular_values": self.singular_values.tolist(),
            "relative_degree": list(self.relative_degree),
            "tool_singular_values": self.tool_singular_values.tolist(),
            "inertia_sigma_min": self.inertia_sigma_min,
            "distal_coordinates": list(self.distal),
            "controllability": self.controllability,
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True)
class SolvabilityPath:
    """Solvability at n static equilibria along a path: ``t`` (n,) [s] and, at each, the smallest
    singular values.

    ``regular`` (n,): of P without G, scaled as in `Solvability`; ``tool`` (n,): of W_g over its
    largest; ``inertia`` (n,): of A, NaN without non-actuated coordinates; ``warnings``: sentences
    with the time of the worst pose.
    """

    t: np.ndarray
    regular: np.ndarray
    tool: np.ndarray
    inertia: np.ndarray
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """As JSON types."""
        inertia = [float(x) if np.isfinite(x) else None for x in self.inertia]
        return {
            "t": self.t.tolist(),
            "regular_sigma_min": self.regular.tolist(),
            "tool_sigma_ratio": self.tool.tolist(),
            "inertia_sigma_min": inertia,
            "warnings": list(self.warnings),
        }


def solvability(equations: Equations, rest: Equilibrium, linear: LinearModel) -> Solvability:
    """The `Solvability` of a robot in a static equilibrium, from its linearization there.

    The matrix is ``W M^-1 E drive``: how the output follows the motors at the highest order.
    Warned of: gears that carry nothing there, singular poses of the tool, modes that no motor can
    move.
    """
    model = equations.model
    arm = arm_linearization(equations, rest.q_a[None])
    simple = obstacle(model, "simplified coupling") is None
    drive, degree = _drive(equations, arm.stiffness[0])
    i_g = list(model.i_g)
    matrix = (
        arm.W[0] @ np.linalg.solve(arm.M[0], np.eye(model.n_a)[:, i_g] @ drive) if simple else None
    )
    values = np.linalg.svd(_scale_rows_and_columns(arm)[0], compute_uv=False)
    tool = np.linalg.svd(_tool(equations, arm)[0], compute_uv=False)
    warnings = _tool_warnings(equations, arm)
    square = obstacle(model, "full problem") is None
    inertia = None
    if square and model.n_e and tool[-1] > SINGULAR * tool[0]:
        inertia = float(np.linalg.svd(arm.relative_inertia()[0], compute_uv=False)[-1])
        warnings += _inertia_warnings(arm, inertia)
    # slopes when fully wound up
    stiff = evaluate(equations.function("gear_law"), np.ones(model.n_g))[1].ravel()
    loose = arm.stiffness[0] < SINGULAR * stiff
    dead = [model.coordinates[i].name for k, i in enumerate(i_g) if degree[k] == 4 and loose[k]]
    if dead:
        warnings.append(
            f"gear of {', '.join(dead)}: no damping and no spring stiffness in this "
            "equilibrium: it transmits no torque"
        )
    regular = bool(values[-1] > SINGULAR) and not dead if square and simple else None
    reached = controllability(linear)
    if reached < SINGULAR:
        warnings.append("not controllable: the linearized robot has a mode that no motor can move")
    return Solvability(
        regular, matrix, values, degree, tool, inertia, _distal(model), reached, tuple(warnings)
    )


def solvability_path(equations: Equations, path: OutputPath, n: int = 41) -> SolvabilityPath:
    """Solvability at n static equilibria along a path, from its start to its end.

    Raises
    ------
    ArgumentError
        Another number of outputs than of motors, complete motor coupling, or n below 1.
    SolverError
        The path leaves the workspace, or passes a singular pose.
    """
    model = equations.model
    reason = obstacle(model, "reduced problem") or obstacle(model, "simplified coupling")
    if reason is not None:
        raise ArgumentError(f"solvability along a path: {reason}")
    if n < 1:
        raise ArgumentError(f"solvability along a path: given n = {n}, expected 1 pose or more")
    t = np.linspace(0.0, path.duration, n)
    arm = arm_linearization(equations, poses_along(equations, path, t))
    values = np.linalg.svd(_scale_rows_and_columns(arm), compute_uv=False)
    tool = np.linalg.svd(_tool(equations, arm), compute_uv=False)
    ratio = tool[:, -1] / tool[:, 0]
    inertia = np.full(n, np.nan)
    if model.n_e:
        inertia = np.linalg.svd(arm.relative_inertia(), compute_uv=False)[:, -1]
    warnings = []
    worst = int(np.argmin(ratio))
    for text in _tool_warnings(equations, _at(arm, worst)):
        warnings.append(f"t = {t[worst]:.3g} s: {text}")
    if model.n_e:
        worst = int(np.argmin(inertia))
        for text in _inertia_warnings(_at(arm, worst), float(inertia[worst])):
            warnings.append(f"t = {t[worst]:.3g} s: {text}")
    return SolvabilityPath(t, values[:, -1], ratio, inertia, tuple(warnings))


def controllability(linear: LinearModel) -> float:
    """Smallest singular value of ``[s^2 M + s D + K, B]`` over the poles s: by Hautus' test, zero
    if not controllable.

    In coordinates of unit inertia, columns of B of length one, the other block in units of
    ``s^2``.
    """
    half = np.linalg.cholesky(linear.M)
    D, K = (np.linalg.solve(half, np.linalg.solve(half, X).T).T for X in (linear.D, linear.K))
    B = np.linalg.solve(half, linear.B)
    B = B / np.linalg.norm(B, axis=0)
    s = poles(linear)
    fast = np.abs(s)
    slow = fast[fast > 1e-6 * fast.max()].min() if fast.max() > 0 else 1.0
    s = s[s.imag >= 0]
    size = np.maximum(np.abs(s), slow)[:, None, None] ** 2
    z = s[:, None, None]
    block = (z**2 * np.eye(len(K)) + z * D + K) / size
    whole = np.concatenate([block, np.broadcast_to(B, (len(s), *B.shape))], axis=2)
    return float(np.linalg.svd(whole, compute_uv=False)[:, -1].min())


def _drive(equations: Equations, stiffness: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    """G (n_g, n_g) and the relative degree of each gear; ``stiffness`` (n_g,): of the gear
    springs.

    The columns of rigid gears are those of the motors behind them, in their order.
    """
    model = equations.model
    damping = gear_damping(equations)
    G = np.zeros((model.n_g, model.n_g))
    degree = []
    for k, (gear, _) in enumerate(gears(model)):
        if not gear.rigid:
            G[k, k] = damping[k] if damping[k] > 0 else stiffness[k]
        degree.append(2 if gear.rigid else 3 if damping[k] > 0 else 4)
    stiff = [k for k, order in enumerate(degree) if order == 2]
    motors = [j for j in range(model.n_m) if j not in model.i_m]
    G[np.ix_(stiff, stiff)] = model.eta[np.ix_(motors, stiff)].T
    return G, tuple(degree)


def _scale_rows_and_columns(arm: ArmLinearization) -> np.ndarray:
    """``W M^-1 S_g`` (k, n_y, n_g) with rows and columns of length one in the metric of M^-1."""
    half = np.linalg.cholesky(arm.M)
    rows = np.linalg.solve(half, arm.W.transpose(0, 2, 1))
    columns = np.linalg.solve(half, np.broadcast_to(np.eye(arm.model.n_a), arm.M.shape))[
        :, :, list(arm.model.i_g)
    ]
    # an output that nothing moves has a row of zeros
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = rows / np.where(sizes > 0.0, sizes, 1.0)
    columns = columns / np.linalg.norm(columns, axis=1, keepdims=True)
    return rows.transpose(0, 2, 1) @ columns


def _tool(equations: Equations, arm: ArmLinearization) -> np.ndarray:
    """W_g (k, n_y, n_g), rows and columns that are lengths in units of the reach."""
    model = equations.model
    length = reach(equations)
    rows = np.ones(model.output.size)
    if model.output.type != "combination":
        rows[: len(model.output.axes)] = 1 / length
    columns = np.array([length if model.coordinates[i].unit == "m" else 1.0 for i in model.i_g])
    return arm.W_g * rows[:, None] * columns


def _tool_warnings(equations: Equations, arm: ArmLinearization) -> list[str]:
    """Warning where the actuated joints hardly move some output at the first pose.

    By the singular values of W_g, the Jacobian of the output in the actuated joints. An output
    with more rows than there are joints is reported elsewhere.
    """
    left, values, _ = np.linalg.svd(_tool(equations, arm)[0])
    if len(values) < arm.model.output.size or values[-1] > TOOL * values[0]:
        return []
    names = name_largest(left[:, -1], output_names(arm.model))
    kind = (
        "in a singular pose" if values[-1] < SINGULAR * values[0] else "close to a singular pose"
    )
    ratio = values[-1] / values[0]
    return [
        (
            f"tool {kind}: the actuated joints hardly move {names} (ratio of singular values "
            f"{ratio:.1e})"
        )
    ]


def _inertia_warnings(arm: ArmLinearization, smallest: float) -> list[str]:
    """Warnings from the inertia A of the zero dynamics at the first pose, where its ``smallest``
    singular value, relative to the coordinates' own inertia, is near zero: a zero lies at or near
    infinity.
    """
    model = arm.model
    distal = _distal(arm.model)
    if smallest > (DISTAL if distal else INERTIA):
        return []
    i_e = list(model.i_e)
    own = arm.M[0][np.ix_(i_e, i_e)]
    motion = np.linalg.solve(
        np.linalg.cholesky(own).T, np.linalg.svd(arm.relative_inertia()[0])[2][-1]
    )
    names = name_largest(motion * np.sqrt(np.diag(own)), [model.coordinates[i].name for i in i_e])
    how = f"({smallest:.1e} of the coordinates' own)"
    if smallest < SINGULAR:
        text = (
            f"flat point: the inertia of the zero dynamics is singular {how} in {names}, a zero "
            "lies at infinity, and "
        )
        text += "the torque needs a smoother path than the gears alone require"
    else:
        text = (
            f"near a flat point: the inertia of the zero dynamics is nearly singular {how} in "
            f"{names}, "
        )
        text += "a zero is near infinity"
    tool = np.linalg.svd(arm.W_g[0], compute_uv=False)
    # else the singular pose of the tool may be the reason
    if distal and tool[-1] > TOOL * tool[0]:
        text += f"; elasticity beyond the last actuator ({', '.join(distal)}) is the cause"
    return [f"{text}; leave the method at auto, which tries lq and then spline"]


def _distal(model: RobotModel) -> tuple[str, ...]:
    """Names of the non-actuated coordinates beyond the last actuated one."""
    return tuple(model.coordinates[i].name for i in model.i_e if i > max(model.i_g))


def name_largest(vector: np.ndarray, names: tuple[str, ...] | list[str]) -> str:
    """The names of the largest entries of a vector."""
    share = np.abs(vector) / np.abs(vector).max()
    order = [k for k in np.argsort(-share) if share[k] > ALONE]
    return ", ".join(names[k] for k in order[:4])


def _at(arm: ArmLinearization, k: int) -> ArmLinearization:
    """The linearization at one of the poses."""
    one = slice(k, k + 1)
    return ArmLinearization(
        arm.model, arm.M[one], arm.D[one], arm.K[one], arm.W[one], arm.stiffness[one]
    )
