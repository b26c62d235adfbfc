"""Smoothness of a path: where its derivatives jump, and the estimated effect on the torque and the
tool.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import factorial
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm

from flexgen.base.errors import FlexgenError
from flexgen.dynamics.dae.signature import structural_index
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.paths.geometry.jets import ORDER
from flexgen.paths.path import Path
from flexgen.paths.timing.joint_limits import InverseKinematics

if TYPE_CHECKING:
    from flexgen.analysis.linear import LinearModel

NEAR = 1e-7  # of the duration; distance from an instant at which the derivatives are evaluated
JUMP = 1e-4  # of the largest value of a derivative on the path; a larger change is a jump
STEP = 1e-3  # sampling step of the torque: 1 ms
STEPS = 400  # at most a 400th of the duration
ABOVE = 100.0  # times the fastest pole: frequency at which a jump of the torque is evaluated
DRIFT_MIN = 1e-7  # m (or the unit of the output); kinks with a smaller drift are not reported
LESS = "less with methods lq, bvp and closed-form"
TIMES = 200  # instants at which the drift of the tool is evaluated


@dataclass(frozen=True)
class Jump:
    """The lowest derivative of the output that jumps at an instant.

    ``time`` [s], ``order`` of the derivative, ``size``: length of the jump of the position rows
    [their unit/s^order], ``rotation``: jump of the rotation [rad/s^order]. ``torque`` [N m, motor
    side]: largest jump of a motor torque, or height of an impulse at the sampling step (``order``
    below the required smoothness). ``tool`` [m, or the unit of the output] and ``tool_rotation``
    [rad]: drift of the tool in open loop until the path ends. None if the jump has no effect or
    the inverse kinematics has no solution.
    """

    time: float
    order: int
    size: float
    rotation: float
    torque: float | None
    tool: float | None
    tool_rotation: float | None


@dataclass(frozen=True)
class SmoothnessReport:
    """The smoothness of a path, compared with the smoothness that the model requires.

    ``required``: continuous derivatives that a continuous torque requires (structural index minus
    one; None if there is no index); ``smoothness``: of the path; ``step`` [s]: sampling step of
    the torque; ``jumps``: in order of time.
    """

    required: int | None
    smoothness: int
    step: float
    jumps: tuple[Jump, ...]

    @property
    def sufficient(self) -> bool:
        """True if the torque is continuous."""
        return self.required is None or all(jump.order > self.required for jump in self.jumps)

    @property
    def has_kinks(self) -> bool:
        """True if the torque jumps or has kinks: derivative ``required + 1`` of the path, or a
        lower one, jumps.
        """
        return self.required is not None and any(
            jump.order <= self.required + 1 for jump in self.jumps
        )

    @property
    def torque_jumps(self) -> tuple[Jump, ...]:
        """The jumps that make the torque discontinuous."""
        return tuple(
            jump
            for jump in self.jumps
            if self.required is not None and jump.order <= self.required
        )

    def lines(self) -> list[str]:
        """The report as text: a line for each jump of the torque, and one for its kinks if they
        have an effect.
        """
        out = []
        for jump in self.torque_jumps:
            text = (
                f"t = {jump.time:.4g} s: derivative {jump.order} of the path jumps by "
                f"{jump.size:.3g}"
            )
            if jump.torque is not None:
                how = (
                    "jumps by"
                    if jump.order == self.required
                    else f"needs an impulse (sampled at {self.step:.2g} s) of"
                )
                text += f"; the torque {how} about {jump.torque:.2g} N m"
            if jump.tool:
                text += f"; without feedback the tool drifts by about {jump.tool:.2g} ({LESS})"
            out.append(text)
        kinks = [jump for jump in self.jumps if jump not in self.torque_jumps and jump.tool]
        drift = sum(jump.tool or 0.0 for jump in kinks)
        if drift > DRIFT_MIN:
            out.append(
                f"the torque has kinks at {len(kinks)} instants; sampled every {self.step:.2g} "
                f"s and without feedback, the tool drifts by about {drift:.2g} ({LESS}); "
                f"smoothness {kinks[0].order} avoids them"
            )
        return out


def smoothness_report(
    equations: Equations, path: Path, step: float | None = None
) -> SmoothnessReport:
    """Find where the derivatives of a path jump, and estimate the effect on the torque and the
    tool.

    A jump D of the k-th derivative requires the torque ``G(s)^-1 D / s^(k + 1)``, with G the
    linearization of the robot at that pose. The part faster than the sampling step cannot be
    commanded: an impulse of about ``|G(s)^-1 D s^(-k - 1)|`` at ``|s| = 2/step``. The tool drifts
    by the impulse response of G until the path ends; a feedback controller reduces the drift.

    Accuracy, from simulations with sampled torques (collocation; planar arms, elbow, kr300): a
    factor of 3 if the torque jumps, a factor of 5 (also Manutec r3 with Coulomb friction) if it
    has kinks (derivative ``required + 1`` jumps). Jumps of higher derivatives have no effect. For
    jumps of derivative ``required - 2`` the estimate is 100 times too large. With lq, bvp and
    closed-form, which compute torques by differences over the samples, the drift is below a
    twentieth of the estimate.

    Parameters
    ----------
    equations : Equations
    path : Path
    step : float, optional [s]
        Sampling step of the torque; default: 1 ms, at most a 400th of the duration.

    Returns
    -------
    SmoothnessReport
        For derivatives up to order 5.
    """
    index = structural_index(equations).index
    required = None if index is None else index - 1
    dt = min(STEP, path.duration / STEPS) if step is None else float(step)
    found = _jumps(path)
    report = SmoothnessReport(required, path.smoothness, dt, ())
    if not found:
        return report
    configurations = _configurations(equations, path, [time for time, _, _ in found])
    jumps = []
    for k, (time, order, jump) in enumerate(found):
        n = path.equations.model.output.first_turn if path.pose else len(jump)
        entry = Jump(
            time,
            order,
            float(np.linalg.norm(jump[:n])),
            float(np.linalg.norm(jump[n:])),
            None,
            None,
            None,
        )
        if configurations is not None and (required is None or order <= required + 1):
            entry = _with_effect(
                equations, entry, jump, configurations[k], required, dt, path.duration - time
            )
        jumps.append(entry)
    return replace(report, jumps=tuple(jumps))


def _jumps(path: Path) -> list[tuple[float, int, np.ndarray]]:
    """Instant [s], order and vector (n_y,) of the lowest derivative that jumps at each break of a
    path.

    Both sides are expanded from samples next to the break to the break itself; a jump counts from
    `JUMP` of the largest derivative on.
    """
    d = NEAR * path.duration
    breaks = path.breaks
    samples = path.sample(np.linspace(0.0, path.duration, 1001))
    scale = [float(np.abs(samples.derivative(k)).max()) for k in range(1, ORDER + 1)]
    left = path.sample(breaks - d)
    right = path.sample(breaks + d)
    out = []
    for i, time in enumerate(breaks):
        for k in range(1, ORDER + 1):
            # Taylor expansion of both sides to the instant
            sides = [
                sum(
                    sample.derivative(k + j)[i] * shift**j / factorial(j)
                    for j in range(ORDER - k + 1)
                )
                for sample, shift in ((left, d), (right, -d))
            ]
            jump = np.asarray(sides[1] - sides[0])
            if np.abs(jump).max() > JUMP * scale[k - 1]:
                out.append((float(time), k, jump))
                break
    return out


def _configurations(equations: Equations, path: Path, times: list[float]) -> np.ndarray | None:
    """Actuated coordinates (m, n_g) [rad or m] of the undeflected arm at the ``times`` (m,) [s] of
    a path; None where inverse kinematics has no solution.
    """
    t = np.unique(np.concatenate([np.linspace(0.0, path.duration, 101), times]))
    sample = path.sample(t)
    try:
        if sample.q_g is not None:
            q = sample.q_g[:, :, 0]
        else:
            q = InverseKinematics(equations).follow(
                sample, path.q_start[list(equations.model.i_g)]
            )
    except FlexgenError:
        return None
    return np.array(q[np.searchsorted(t, times)])


def _with_effect(
    equations: Equations,
    entry: Jump,
    jump: np.ndarray,
    q_g: np.ndarray,
    required: int | None,
    dt: float,
    remaining: float,
) -> Jump:
    """The jump with its torque [N m] and the drift of the tool [m, rad], from the linearization at
    a joint configuration; unchanged where that does not exist.

    Parameters
    ----------
    entry : Jump
    jump : array (n_y,)
        Of the derivative.
    q_g : array (n_g,) [rad or m]
    required : int or None
        Order of the derivative from which the torque jumps; a lower one needs an impulse.
    dt : float [s]
        Sampling interval of the torque.
    remaining : float [s]
        Time after the jump, in which the tool drifts.
    """
    from flexgen.analysis.linear import linearize, poles

    try:
        linear = linearize(equations, hold_joints(equations, q_g))
        fast = ABOVE * float(np.abs(poles(linear)).max())
        sampled = 2 / dt
        high = max(fast, sampled) if required is None or entry.order >= required else sampled
        torque = np.abs(
            np.linalg.solve(_transfer(linear, high), jump * (1j * high) ** -entry.order)
        ).max()
        area = np.linalg.solve(
            _transfer(linear, sampled), jump * (1j * sampled) ** -(entry.order + 1.0)
        )
    except (FlexgenError, np.linalg.LinAlgError):
        return entry
    drift = _drift(
        linear,
        np.abs(area) * np.cos(np.angle(area) - np.angle(area[np.argmax(np.abs(area))])),
        remaining,
    )
    n = len(jump) - 3 if entry.rotation or len(jump) == 6 else len(jump)
    tool = float(np.linalg.norm(drift[:, :n], axis=1).max())
    rotation = float(np.linalg.norm(drift[:, n:], axis=1).max()) if n < len(jump) else 0.0
    return replace(entry, torque=float(torque), tool=tool, tool_rotation=rotation)


def _transfer(linear: LinearModel, w: float) -> np.ndarray:
    """From the motor torques to the output at an angular frequency [rad/s], (n_y, n_m)."""
    return np.asarray(linear.response(np.array([w]), linear.W)[0])


def _drift(linear: LinearModel, area: np.ndarray, duration: float) -> np.ndarray:
    """The output (n, n_y) during ``duration`` [s] after torque impulses ``area`` (n_m) [N m s]."""
    A, B = linear.state_space()
    n = len(A) // 2
    out = np.zeros((TIMES + 1, len(linear.W)))
    if duration <= 0:
        return out
    step = expm(A * (duration / TIMES))
    x = B @ area
    for k in range(TIMES + 1):
        out[k] = linear.W @ x[:n]
        x = step @ x
    return out
