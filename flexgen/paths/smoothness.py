"""Is a path smooth enough for a robot: where which derivative jumps, and what that costs in torque and at the tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import factorial

import numpy as np
from scipy.linalg import expm

from flexgen.analysis.linear import LinearModel, linearize, poles
from flexgen.dae.signature import structural_index
from flexgen.errors import FlexgenError
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.statics import hold_joints
from flexgen.paths.jets import ORDER
from flexgen.paths.joint_limits import Posture
from flexgen.paths.path import Path

NEAR = 1e-7  # of the duration: how far beside an instant the derivatives are looked at
JUMP = 1e-4  # of the largest size of a derivative on the path: what counts as a jump
STEP, STEPS = 1e-3, 400  # s, and of the duration: at which torques are sampled
ABOVE = 100.0  # times the fastest pole: the frequency at which a jump of the torque is read off
FELT = 1e-7  # m (or the unit of the output): kinks that cost less are not worth a line
TIMES = 200  # at which the tool's drift is looked at


@dataclass(frozen=True)
class Jump:
    """The lowest derivative of the output that jumps at an instant.

    ``time`` [s], ``order`` of the derivative, ``size``: length of the jump of the position rows [their unit/s^order],
    ``turn``: of the rotation [rad/s^order]. ``torque`` [N m, motor side]: what jumps at the worst motor; of an impulse
    (``order`` below the needed smoothness) its height at the sampling step. ``tool`` [m, or the unit of the output] and
    ``tool_turn`` [rad]: how far the tool drifts off, in open loop, until the path ends. None where the jump is not felt
    or no pose is found.
    """

    time: float
    order: int
    size: float
    turn: float
    torque: float | None
    tool: float | None
    tool_turn: float | None


@dataclass(frozen=True)
class SmoothnessReport:
    """What a path's smoothness means for a model.

    ``needed``: continuous derivatives that a continuous torque needs (structural index less one; None where there is no
    index); ``smoothness``: of the path; ``step`` [s]: at which the torque is sampled; ``jumps``: in time.
    """

    needed: int | None
    smoothness: int
    step: float
    jumps: tuple[Jump, ...]

    @property
    def enough(self) -> bool:
        """Whether the torque is continuous."""
        return self.needed is None or all(jump.order > self.needed for jump in self.jumps)

    @property
    def rough(self) -> tuple[Jump, ...]:
        """The jumps that make the torque jump, or worse."""
        return tuple(jump for jump in self.jumps if self.needed is not None and jump.order <= self.needed)

    def lines(self) -> list[str]:
        """The report as text: a line for each jump of the torque, and one for its kinks where they are felt."""
        out = []
        for jump in self.rough:
            text = f"t = {jump.time:.4g} s: derivative {jump.order} of the path jumps by {jump.size:.3g}"
            if jump.torque is not None:
                how = "jumps" if jump.order == self.needed else f"needs an impulse, at steps of {self.step:.2g} s"
                text += f": the torque {how} by about {jump.torque:.2g} N m"
            if jump.tool:
                text += f", and without feedback the tool drifts off by about {jump.tool:.2g} (with lq and bvp by less)"
            out.append(text)
        kinks = [jump for jump in self.jumps if jump not in self.rough and jump.tool]
        drift = sum(jump.tool or 0.0 for jump in kinks)
        if drift > FELT:
            text = (
                f"the torque has kinks at {len(kinks)} instants: sampled every {self.step:.2g} s and without feedback "
            )
            text += f"the tool drifts off by about {drift:.2g} (with lq and bvp by less)"
            out.append(f"{text}; smoothness {kinks[0].order} avoids them")
        return out


def smoothness_report(equations: Equations, path: Path, step: float | None = None) -> SmoothnessReport:
    """Find where the derivatives of a path jump, and estimate what the jumps cost.

    A jump D of the k-th derivative needs the torque ``G(s)^-1 D / s^(k + 1)`` of the machine's linearisation G at that
    pose. What of it is faster than the sampling step cannot be commanded: an area of about ``|G(s)^-1 D s^(-k - 1)|``
    at ``|s| = 2/step``; the tool then moves by the impulse response of G to that area until the path ends. With a
    controller that feeds back it will be less. Found by simulations of torques that are read off at the samples (closed
    form, collocation; planar arms, elbow, kr300): within a factor of three where the torque jumps, and of five (also
    Manutec r3 with Coulomb friction) where it has kinks, derivative ``needed + 1``. Jumps of higher ones are not felt;
    of the speed itself, two below ``needed``, the estimate is a hundred times too large. With lq and bvp, whose
    torques are found by differences over the samples, the tool drifts off by less than a twentieth of it.

    Parameters
    ----------
    equations : Equations
    path : Path
    step : float, optional [s]
        At which the torque is sampled; default: 1 ms, at most a 400th of the path.

    Returns
    -------
    SmoothnessReport
        Derivatives up to the fifth are looked at.
    """
    index = structural_index(equations).index
    needed = None if index is None else index - 1
    dt = min(STEP, path.duration / STEPS) if step is None else float(step)
    found = _jumps(path)
    report = SmoothnessReport(needed, path.smoothness, dt, ())
    if not found:
        return report
    postures = _postures(equations, path, [time for time, _, _ in found])
    jumps = []
    for k, (time, order, jump) in enumerate(found):
        n = 3 if path.pose else len(jump)
        plain = Jump(time, order, float(np.linalg.norm(jump[:n])), float(np.linalg.norm(jump[n:])), None, None, None)
        if postures is not None and (needed is None or order <= needed + 1):
            plain = _cost(equations, plain, jump, postures[k], needed, dt, path.duration - time)
        jumps.append(plain)
    return replace(report, jumps=tuple(jumps))


def _jumps(path: Path) -> list[tuple[float, int, np.ndarray]]:
    """Instant, order and vector (n_y) of the lowest jump at each break."""
    d = NEAR * path.duration
    breaks = path.breaks
    every = path.sample(np.linspace(0.0, path.duration, 1001))
    scale = [float(np.abs(every.rates(k)).max()) for k in range(1, ORDER + 1)]
    left, right = path.sample(breaks - d), path.sample(breaks + d)
    out = []
    for i, time in enumerate(breaks):
        for k in range(1, ORDER + 1):
            # both sides carried to the instant itself by their own higher derivatives
            sides = [
                sum(sample.rates(k + j)[i] * shift**j / factorial(j) for j in range(ORDER - k + 1))
                for sample, shift in ((left, d), (right, -d))
            ]
            jump = np.asarray(sides[1] - sides[0])
            if np.abs(jump).max() > JUMP * scale[k - 1]:
                out.append((float(time), k, jump))
                break
    return out


def _postures(equations: Equations, path: Path, times: list[float]) -> np.ndarray | None:
    """Actuated coordinates (m, n_g) of the rigid arm at instants of a path; None where they are not found."""
    t = np.unique(np.concatenate([np.linspace(0.0, path.duration, 101), times]))
    sample = path.sample(t)
    try:
        if sample.q_g is not None:
            q = sample.q_g[:, :, 0]
        else:
            q = Posture(equations).follow(sample, path.q_start[list(equations.model.i_g)])
    except FlexgenError:
        return None
    return np.array(q[np.searchsorted(t, times)])


def _cost(
    equations: Equations, plain: Jump, jump: np.ndarray, q_g: np.ndarray, needed: int | None, dt: float, rest: float
) -> Jump:
    """The jump with its torque and the tool's drift, from the linearisation at a posture."""
    try:
        linear = linearize(equations, hold_joints(equations, q_g))
        fast = ABOVE * float(np.abs(poles(linear)).max())
        lost = 2 / dt
        high = max(fast, lost) if needed is None or plain.order >= needed else lost
        torque = np.abs(np.linalg.solve(_transfer(linear, high), jump * (1j * high) ** -plain.order)).max()
        area = np.linalg.solve(_transfer(linear, lost), jump * (1j * lost) ** -(plain.order + 1.0))
    except (FlexgenError, np.linalg.LinAlgError):
        return plain
    drift = _drift(linear, np.abs(area) * np.cos(np.angle(area) - np.angle(area[np.argmax(np.abs(area))])), rest)
    n = len(jump) - 3 if plain.turn or len(jump) == 6 else len(jump)
    tool = float(np.linalg.norm(drift[:, :n], axis=1).max())
    turn = float(np.linalg.norm(drift[:, n:], axis=1).max()) if n < len(jump) else 0.0
    return replace(plain, torque=float(torque), tool=tool, tool_turn=turn)


def _transfer(linear: LinearModel, w: float) -> np.ndarray:
    """From the motor torques to the output at an angular frequency [rad/s], (n_y, n_m)."""
    return np.asarray(linear.response(np.array([w]), linear.W)[0])


def _drift(linear: LinearModel, area: np.ndarray, rest: float) -> np.ndarray:
    """The output (n, n_y) over the time ``rest`` [s] after impulses of the torques of an ``area`` (n_m) [N m s]."""
    A, B = linear.state_space()
    n = len(A) // 2
    out = np.zeros((TIMES + 1, len(linear.W)))
    if rest <= 0:
        return out
    step = expm(A * (rest / TIMES))
    x = B @ area
    for k in range(TIMES + 1):
        out[k] = linear.W @ x[:n]
        x = step @ x
    return out
