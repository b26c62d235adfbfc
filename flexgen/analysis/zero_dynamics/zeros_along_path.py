"""Zero dynamics along a path: number and speed of the unstable zeros, changes of that number,
suitable methods.

At each of n static equilibria (or instants of a motion) with the output on the path the zeros are
the roots of ``det(A s^2 + D s + K)`` and ``-K_g/D_g`` for each damped gear. Where ``det A``
changes its sign between two poses, a real zero passes through infinity, from one half plane to the
other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexgen.analysis.arm_linearization import ArmLinearization, arm_linearization
from flexgen.analysis.linear import linearize, sort_roots
from flexgen.analysis.zero_dynamics.zeros import (
    ON_AXIS,
    is_structured,
    pencil_zeros,
    preview,
    transmission_zeros,
)
from flexgen.analysis.zero_dynamics.zeros_in_motion import moving_pencil, quasistatic_motion
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.quasistatic import OutputPath, equilibria_along, poses_along
from flexgen.dynamics.mechanics.statics import gear_damping
from flexgen.model.abilities import obstacle

FLAT = 1e-9  # of its size: an inertia A that is more singular has a zero at infinity
NEAR = 1e-5  # the same: a zero near infinity
POSES = 41
INFINITY = "infinity"
AXIS = "the imaginary axis"


@dataclass(frozen=True)
class Change:
    """A change of the number of unstable zeros at ``t`` [s], ``through`` "infinity" or "the
    imaginary axis".
    """

    t: float
    before: int
    after: int
    through: str


@dataclass(frozen=True)
class ZeroPath:
    """Zeros at n static equilibria along a path.

    Parameters
    ----------
    t : array (n,) [s]
    q : array (n, n_a)
        The poses.
    zeros : array (n, n_z), complex [1/s]
        By distance from the origin; infinite where a pose has fewer than others.
    unstable : array (n,) of int
        Number of zeros in the right half plane.
    sigma_min : array (n,)
        Smallest singular value of A in units of the non-actuated coordinates' own inertia; NaN
        without any, and where the equations do not reduce. Small: a zero near infinity.
    phase : str
        ``"flat"``, ``"minimum phase"`` or ``"non-minimum phase"`` (at one pose or more).
    changes : tuple of Change
    slowest, fastest : float or None [1/s]
        Real part of the slowest and of the fastest unstable zero on the path.
    slowest_stable : float or None [1/s]
        Absolute real part of the slowest stable zero.
    preview_s : float
        `flexgen.analysis.zero_dynamics.zeros.preview` of the slowest unstable zero; 0 without any.
        The length of the path, if that is less and a zero crosses the imaginary axis on it.
    methods : tuple of str
        Methods of `flexgen.solve` that suit, the best first.
    verdict : str
        One sentence with the result.
    """

    t: np.ndarray
    q: np.ndarray
    zeros: np.ndarray
    unstable: np.ndarray
    sigma_min: np.ndarray
    phase: str
    changes: tuple[Change, ...]
    slowest: float | None
    fastest: float | None
    slowest_stable: float | None
    preview_s: float
    methods: tuple[str, ...]
    verdict: str

    def to_dict(self) -> dict[str, Any]:
        """As JSON types; zeros as ``[re, im]``, those at infinity left out."""
        finite = [
            [[float(z.real), float(z.imag)] for z in row[np.isfinite(row)]] for row in self.zeros
        ]
        sigma = [float(x) if np.isfinite(x) else None for x in self.sigma_min]
        return {
            "t": self.t.tolist(),
            "zeros": finite,
            "unstable": self.unstable.tolist(),
            "sigma_min": sigma,
            "phase": self.phase,
            "changes": [vars(change) for change in self.changes],
            "slowest_unstable": self.slowest,
            "fastest_unstable": self.fastest,
            "slowest_stable": self.slowest_stable,
            "preview_s": self.preview_s,
            "methods": list(self.methods),
            "verdict": self.verdict,
        }


def zero_path(
    equations: Equations, path: OutputPath, n: int = POSES, moving: bool = False
) -> ZeroPath:
    """The zeros at n poses along a path, from its start to its end.

    Parameters
    ----------
    equations : Equations
        Of a model with as many outputs as motors.
    path : OutputPath
        Such as `flexgen.paths.path.Path`.
    n : int
        Number of poses, at least 2.
    moving : bool
        At the speeds and accelerations of the quasi-static motion, their coefficients frozen; else
        at rest.

    Raises
    ------
    ArgumentError
        Another number of outputs than of motors, n below 2, or ``moving`` with complete motor
        coupling.
    SolverError
        The path leaves the workspace, or passes a singular pose.
    """
    model = equations.model
    reason = obstacle(model, "full problem")
    if reason is not None:
        raise ArgumentError(f"zeros along a path: {reason}")
    if n < 2:
        raise ArgumentError(f"zeros along a path: given n = {n}, expected 2 poses or more")
    t = np.linspace(0.0, path.duration, n)
    if is_structured(equations):
        if moving and model.n_e:
            q, v, a = quasistatic_motion(equations, path, t)
            pencil = moving_pencil(equations, q, v, a)
        else:
            q = poses_along(equations, path, t)
            pencil = None
        roots, sigma, sign = zeros_at(equations, arm_linearization(equations, q), t, pencil)
    elif moving:
        reason = obstacle(model, "reduced problem") or obstacle(model, "inner zeros")
        raise ArgumentError(f"zeros along a path of a moving robot: {reason}")
    else:
        rests = equilibria_along(equations, path, t)
        q = np.array([rest.q_a for rest in rests])
        roots = []
        sigma = np.full(n, np.nan)
        sign = np.ones(n)
        for k, rest in enumerate(rests):
            linear = linearize(equations, rest)
            A, B = linear.state_space()
            found = transmission_zeros(
                A, B, np.hstack([linear.W, np.zeros_like(linear.W)]), linear.rate
            )
            if found is None:
                raise SolverError(
                    f"zeros: the output leaves a motion undetermined at t = {t[k]:.4g} s"
                )
            roots.append(found)
    return summarize_zeros(model.n_e, t, q, roots, sigma, sign)


def zeros_at(
    equations: Equations,
    arm: ArmLinearization,
    t: np.ndarray,
    pencil: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """At k poses: finite zeros [1/s], and of the relative inertia the smallest singular value and
    the determinant's sign.

    ``t`` (k,) [s]: the instants, to name them in errors; ``pencil``: A, D, K where they are not
    those at rest.
    """
    D_g = gear_damping(equations)
    damped = D_g > 0
    gears = -arm.stiffness[:, damped] / D_g[damped]
    k = len(arm.M)
    if not arm.model.n_e:
        return [sort_roots(row.astype(complex)) for row in gears], np.full(k, np.nan), np.ones(k)
    relative = arm.relative_inertia()
    A, D, K = arm.inner() if pencil is None else pencil
    sigma = np.linalg.svd(relative, compute_uv=False)[:, -1]
    size = np.maximum(np.abs(relative).max(axis=(1, 2)), 1.0)
    sign = np.where(sigma > FLAT * size, np.linalg.slogdet(relative)[0], 0.0)
    roots = []
    for i in range(k):
        inner = pencil_zeros(A[i], D[i], K[i])
        if inner is None:
            raise SolverError(
                f"zeros: the output leaves a motion undetermined at t = {t[i]:.4g} s"
            )
        roots.append(sort_roots(np.concatenate([inner, gears[i]]).astype(complex)))
    return roots, sigma, sign


def is_unstable(zeros: np.ndarray) -> np.ndarray:
    """Which zeros lie in the right half plane; those on the imaginary axis up to rounding do
    not.
    """
    finite = np.isfinite(zeros)
    return finite & (
        np.where(finite, zeros.real, 0.0) > ON_AXIS * np.where(finite, np.abs(zeros), 1.0)
    )


def is_stable(zeros: np.ndarray) -> np.ndarray:
    """Which zeros lie in the left half plane; those on the imaginary axis up to rounding do
    not.
    """
    finite = np.isfinite(zeros)
    return finite & (
        np.where(finite, zeros.real, 0.0) < -ON_AXIS * np.where(finite, np.abs(zeros), 1.0)
    )


def summarize_zeros(
    n_e: int,
    t: np.ndarray,
    q: np.ndarray,
    roots: list[np.ndarray],
    sigma: np.ndarray,
    sign: np.ndarray,
) -> ZeroPath:
    """Phase, changes, rates and methods from the zeros at n poses.

    Parameters
    ----------
    n_e : int
        Number of coordinates without motor.
    t : array (n,) [s]
    q : array (n, n_a) [rad or m]
    roots : list of arrays [1/s]
        Finite zeros at each pose.
    sigma, sign : array (n,)
        Smallest singular value of the relative inertia, and the sign of its determinant, see
        `zeros_at`.
    """
    widest = max(len(row) for row in roots)
    zeros = np.full((len(t), widest), complex(np.inf, 0.0))
    for k, row in enumerate(roots):
        zeros[k, : len(row)] = row
    right = is_unstable(zeros)
    unstable = right.sum(axis=1)
    rates = np.where(right, zeros.real, np.nan)
    slowest = float(np.nanmin(rates)) if right.any() else None
    fastest = float(np.nanmax(rates)) if right.any() else None
    phase = "non-minimum phase" if right.any() else "minimum phase" if widest else "flat"
    changes = _changes(t, unstable, sign * sigma, np.isfinite(zeros).sum(axis=1))
    needed = preview(1.0 / slowest) if slowest else 0.0
    # there the slowest is as slow as the poses are dense
    if any(change.through == AXIS for change in changes):
        needed = min(needed, float(t[-1]))
    near = bool(n_e) and bool((sigma[np.isfinite(sigma)] < NEAR).any())
    if not n_e:
        methods: tuple[str, ...] = ("closed-form",)
    elif changes or near:
        methods = ("lq",)
    else:
        methods = ("lq", "bvp") if right.any() else ("lq", "bvp", "reduced")
    left = is_stable(zeros)
    stable = float(-zeros.real[left].max()) if left.any() else None
    found = ZeroPath(
        t, q, zeros, unstable, sigma, phase, changes, slowest, fastest, stable, needed, methods, ""
    )
    return replace(found, verdict=_sentence(found, np.isfinite(zeros).sum(axis=1), sign))


def _changes(
    t: np.ndarray, unstable: np.ndarray, sigma: np.ndarray, finite: np.ndarray
) -> tuple[Change, ...]:
    """Where the number of unstable zeros, ``unstable`` (n,), changes along the instants ``t`` (n,)
    [s].

    Through infinity where ``sigma`` (n,), the smallest singular value of A with the sign of its
    determinant, changes its sign, or where the number of ``finite`` zeros (n,) changes; else
    through the imaginary axis.
    """
    out = []
    for k in range(len(t) - 1):
        before = int(unstable[k])
        after = int(unstable[k + 1])
        # the zero's inverse passes through zero, in proportion to A
        if sigma[k] * sigma[k + 1] < 0:
            share = abs(sigma[k]) / (abs(sigma[k]) + abs(sigma[k + 1]))
            out.append(Change(float(t[k] + share * (t[k + 1] - t[k])), before, after, INFINITY))
        elif before != after:
            middle = float(t[k] + t[k + 1]) / 2
            out.append(
                Change(middle, before, after, AXIS if finite[k] == finite[k + 1] else INFINITY)
            )
    return tuple(out)


def _sentence(path: ZeroPath, finite: np.ndarray, sign: np.ndarray) -> str:
    """The verdict as a sentence: phase, rates, preview, changes, zeros at infinity, methods.
    ``finite``, ``sign`` (n,): number of finite zeros and sign of det A at each pose.
    """
    if path.phase == "flat":
        return (
            "flat: no zeros; the torque follows from the path and its derivatives alone; use "
            "closed-form"
        )
    parts = []
    total = _range(finite)
    if path.phase == "minimum phase":
        slow = (
            "on the imaginary axis"
            if path.slowest_stable is None
            else f"the slowest {path.slowest_stable:.3g} 1/s"
        )
        parts.append(f"minimum phase: all {total} zeros stable, {slow}")
    else:
        assert path.slowest is not None and path.fastest is not None
        rates = (
            f"{path.slowest:.3g}"
            if path.fastest < 1.005 * path.slowest
            else f"{path.slowest:.3g}..{path.fastest:.3g}"
        )
        parts.append(
            f"non-minimum phase: {_range(path.unstable)} of {total} zeros unstable, {rates} 1/s"
        )
        parts.append(f"preview required for exact tracking {1e3 * path.preview_s:.3g} ms")
    for change in path.changes[:3]:
        parts.append(
            f"{change.before} to {change.after} unstable at t = {change.t:.3g} s, through "
            f"{change.through}"
        )
    if len(path.changes) > 3:
        parts.append(f"{len(path.changes) - 3} more changes")
    if (sign == 0).any():
        where = "at all poses" if (sign == 0).all() else f"at {int((sign == 0).sum())} poses"
        parts.append(f"a zero at infinity {where}")
    elif (path.sigma_min < NEAR).any() and not path.changes:
        parts.append("a zero near infinity")
    return "; ".join([*parts, f"use {' or '.join(path.methods)}"])


def _range(numbers: np.ndarray) -> str:
    low = int(numbers.min())
    high = int(numbers.max())
    return f"{low}" if low == high else f"{low} to {high}"
