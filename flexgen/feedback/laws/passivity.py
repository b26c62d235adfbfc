"""Passivity of a robot in its sampled loop at the tool: whether it can supply energy to its
environment.

    mu(w) = min Re(f^* v) / |v|^2 over all forces f at the frequencies w + k w_s, k whole,
    w_s: of the samples

f: force on the tool, v: its speed. A force at one frequency makes speeds at all of these, since
the controller samples and holds:

    v_k = G_vf(j w_k) f_k
          - G_vu(j w_k) H(j w_k) exp(-j w_k t_d) (1 + C P)^-1 C  1/T sum_m G_yf(j w_m) f_m

H: hold, t_d: delay, T: sample time, P: sampled robot, C: controller. The loop is passive where
mu >= 0 at all frequencies up to half of w_s; then no passive surrounding makes it unstable.
``-mu`` [N s/m] is the damping between tool and ground that would make it passive. For one mass
with friction b and the law K, B (difference of two samples) at the sample time T this is the bound
b > K T/2 + B.

Source: J. E. Colgate, G. G. Schenkel, Passivity of a class of sampled-data systems, J. Robotic
Systems 14(1), 1997.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import lines_of
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Table
from flexgen.base.spec.arguments import is_number
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.sensors import sensor_signals
from flexgen.feedback.loop.margins import LoopAtPose, loops_at
from flexgen.feedback.loop.result import ControlRun
from flexgen.feedback.sampled_plant import sample_model
from flexgen.model.elements import Friction, RobotModel

ALIASES = 20  # frequencies on each side of 0
FREQUENCIES = 200
# of the largest speed of the tool per joint speed: a direction in which the tool does not move
STILL = 1e-6
UNSTABLE = 1.0 + 1e-9  # eigenvalue; springs that are soft for the friction creep
AT_ONCE = 1e-9  # of the largest entry: a signal that a force changes at once


@checked_result
@dataclass(frozen=True)
class Passivity(Result):
    """Passivity of a loop at poses of its motion, by `flexgen.check_passivity`.

    Attributes
    ----------
    model, controller : str
    poses : tuple of str
    hz : array (n,) [Hz]
        Up to half the sample rate.
    margins : array (poses, n) [N s/m]
        ``mu`` at each frequency: damping that the loop has at least; negative: that it lacks.

    Examples
    --------
    >>> soft = flexgen.Impedance(tool_stiffness=(2e4, 2e4, 2e4))  # N/m
    >>> found = flexgen.check_passivity(flexgen.control("elbow", controller=soft))
    >>> found.passive, found.pose in found.poses
    (True, True)
    """

    model: str
    controller: str
    poses: tuple[str, ...]
    hz: np.ndarray
    margins: np.ndarray

    @property
    def passive(self) -> bool:
        """Whether the loop is passive at all poses and frequencies."""
        return self.margin >= 0.0

    @property
    def margin(self) -> float:
        """The smallest of ``margins`` [N s/m]."""
        return float(self.margins.min())

    @property
    def pose(self) -> str:
        """Where it is."""
        return self.poses[int(self.margins.min(axis=1).argmin())]

    @property
    def fails_hz(self) -> float | None:
        """The lowest frequency at which the loop is not passive; None where it is passive."""
        wrong = np.flatnonzero((self.margins < 0.0).any(axis=0))
        return float(self.hz[wrong[0]]) if len(wrong) else None

    def content(self) -> tuple[Part, ...]:
        """The verdict, and the smallest damping at each pose."""
        found = "passive" if self.passive else "not passive"
        columns = (
            Column("pose"),
            Column("damping at the tool, at least", "N s/m"),
            Column("at", "Hz"),
        )
        lowest = self.margins.argmin(axis=1)
        cells = tuple(
            (name, float(margins[k]), float(self.hz[k]))
            for name, margins, k in zip(self.poses, self.margins, lowest, strict=True)
        )
        return (
            Prose(f"{self.model}, controller {self.controller}: {found}", is_title=True),
            *self._data(),
            Data("passive", self.passive),
            Data("margin", self.margin),
            Row("not passive from", self.fails_hz, "Hz", "fails_hz"),
            Table(columns, cells, "Damping at the tool"),
        )

    def __str__(self) -> str:
        """The verdict, and where the loop begins to be not passive."""
        return lines_of(self.content())


@checked_types
def check_passivity(run: ControlRun, *, low_hz: float = 0.1) -> Passivity:
    """Find the frequencies at which the loop could supply energy to the environment of the tool;
    see the module.

    ``run``'s loop is linearized at the start, middle and end of its motion: a robot with the
    delay, the hold and the sampled controller, between force on the tool and speed of the tool, in
    the directions in which the tool can move. Frictions count by their viscous part only: the
    others damp more, but by less and less in larger motions.

    Parameters
    ----------
    run : ControlRun
        Under a linear controller: `Impedance`, `PPI`, `LQG`, matrices.
    low_hz : float [Hz]
        Lowest frequency.

    Returns
    -------
    Passivity

    Raises
    ------
    ArgumentError
        The law is not linear, the loop is unstable at a pose, or the controller uses a signal that
        a force changes at once, such as an accelerometer.

    Examples
    --------
    >>> found = flexgen.check_passivity(
    ...     flexgen.control("elbow", controller="ppi", sample_time=1e-3)
    ... )
    >>> found.passive  # an integral part is not
    False
    """
    h = run.hardware.sample_s
    poses = run.pose_samples
    model = with_viscous_friction(run.model)
    at = np.array(list(poses.values()))
    loops = loops_at(model, run.law, h, run.delay_s, run.reference.points(at), at)
    if not loops:
        raise ArgumentError(f"run: given the controller {run.controller}, expected a linear one")
    if not (is_number(low_hz) and 1e-6 <= low_hz < 0.4 / h):
        raise ArgumentError(f"low_hz: given {low_hz!r}, expected 1e-6 to {0.4 / h:.4g} Hz")
    hz = np.geomspace(low_hz, 0.5 / h, FREQUENCIES)
    equations = derive(model)
    margins = []
    for (name, k), loop in zip(poses.items(), loops, strict=True):
        largest = loop.largest_eigenvalue()
        if not largest < UNSTABLE:
            raise ArgumentError(
                f"run: given a loop that is unstable at the pose {name} (largest eigenvalue "
                f"{largest:.4g}), expected a stable one; change the controller first"
            )
        margins.append(
            _margins(loop, equations, {key: x[k] for key, x in run.reference.motion.items()}, hz)
        )
    return Passivity(run.model.name, run.controller, tuple(poses), hz, np.array(margins))


def with_viscous_friction(model: RobotModel) -> RobotModel:
    """Model whose joints and motors have viscous friction only, at the model's temperature.

    Coulomb, Stribeck and load-dependent friction are removed: linearized at rest they damp
    strongly, but this damping decreases with the amplitude of the motion. Passivity must not
    depend on it. Viscous friction damps motions of any amplitude alike.
    """

    def viscous(friction: Friction) -> Friction:
        return Friction(viscous=friction.viscous_at(model.temperature))

    elements = tuple(
        replace(
            element,
            dofs=tuple(replace(dof, friction=viscous(dof.friction)) for dof in element.dofs),
        )
        for element in model.elements
    )
    motors = tuple(replace(motor, friction=viscous(motor.friction)) for motor in model.motors)
    return replace(model, elements=elements, motors=motors)


def _margins(
    loop: LoopAtPose, equations: Equations, point: Mapping[str, np.ndarray], hz: np.ndarray
) -> np.ndarray:
    """``mu`` (len(hz),) [N s/m] of the loop at a pose, at frequencies ``hz`` [Hz].

    A sampled controller couples a frequency with its aliases, so the mobility from force to speed
    is a matrix over aliases and directions. mu is computed with `ALIASES` and with half of them,
    and extrapolated. ``point``: ``q_a``, ``v_a``, ``a_a`` there.

    Raises
    ------
    ArgumentError
        No joint moves the tool, or the controller uses a sensor for which mu does not exist.
    """
    m = loop.model
    T = loop.sample_s
    n_a = equations.model.n_a
    n = len(m.A) // 2
    J = evaluate(equations.function("jacobian"), point["q_a"][None])[0].reshape(6, n_a)[:3]
    U, sizes, _ = np.linalg.svd(J, full_matrices=False)
    U = U[:, sizes > STILL * sizes[0]]
    if not U.size:
        raise ArgumentError(
            "run: given a robot whose tool no joint moves, expected a [tool] on a link that moves"
        )
    _check_signals(loop, equations, point)
    out = np.zeros((U.shape[1], 2 * n))
    k = U.shape[1]
    out[:, n : n + n_a] = U.T @ J
    forces = np.hstack([m.push @ U, m.B])[n:].astype(complex)
    F, G = sample_model(m.A, m.B, T, loop.delay_s)
    Y = np.zeros((len(m.C), len(F)))
    Y[:, : 2 * n] = m.C
    A, B, C, D = (x[0] for x in loop.controller.matrices)
    found = []
    for w in 2 * np.pi * hz:
        z = np.exp(1j * w * T)
        plant = Y @ np.linalg.solve(z * np.eye(len(F)) - F, G)
        law = D + C @ np.linalg.solve(z * np.eye(len(A)) - A, B) if len(A) else D
        feedback = np.linalg.solve(np.eye(len(law)) + law @ plant, law)
        s = 1j * (w + 2 * np.pi / T * np.arange(-ALIASES, ALIASES))[:, None, None]
        angles = np.linalg.solve(s * s * np.eye(n) - s * m.A[n:, n:] - m.A[n:, :n], forces)
        state = np.concatenate([angles, s * angles], axis=1)
        free = out @ state[:, :, :k]
        held = out @ state[:, :, k:] * ((1 - np.exp(-s * T)) / s * np.exp(-s * loop.delay_s))
        seen = m.C @ state[:, :, :k] / T
        Q = -held.reshape(-1, len(law)) @ feedback @ seen.transpose(1, 0, 2).reshape(len(m.C), -1)
        for i, own in enumerate(free):
            Q[i * k : (i + 1) * k, i * k : (i + 1) * k] += own
        fewer = slice(ALIASES // 2 * k, 3 * ALIASES // 2 * k)
        # (its error falls with the number of frequencies)
        found.append(2 * _least(Q) - _least(Q[fewer, fewer]))
    return np.array(found)


def _least(Q: np.ndarray) -> float:
    """``min Re(f^* v) / |v|^2`` with ``v = Q f``: the smallest eigenvalue of the Hermitian part of
    the inverse of Q.
    """
    scale = 1 / np.abs(np.diag(Q))
    Z = np.linalg.solve(scale[:, None] * Q, np.diag(scale).astype(complex))
    return float(np.linalg.eigvalsh((Z + Z.conj().T) / 2)[0])


def _check_signals(
    loop: LoopAtPose, equations: Equations, point: Mapping[str, np.ndarray]
) -> None:
    """Refuse a controller that uses a sensor which a force on the tool changes at once: the
    sampled loop has no passivity there, and its model with held signals does not apply.

    ``point``: ``q_a``, ``v_a``, ``a_a`` of the pose. Also refused: signals that follow such a
    force as fast as a speed, and late ones.
    """
    model = equations.model
    pushed = equations.pushed
    if not model.sensors:
        return
    channels = [(sensor, name) for sensor in model.sensors for name in sensor.channels]
    signals = sensor_signals(pushed)
    lag = pushed.lagrangian
    f = pushed.force
    assert f is not None
    motion = [lag.chain.q_a, lag.chain.v_a, lag.a_a]
    function = ca.Function(
        "at_once", [*motion, f], [ca.densify(ca.jacobian(signals, x)) for x in (lag.a_a, f)]
    )
    of_a, of_f = (
        np.array(x)
        for x in function(*(point[name] for name in ("q_a", "v_a", "a_a")), np.zeros(6))
    )
    n = len(loop.model.A) // 2
    n_m = model.n_m
    by_a = of_a @ loop.model.push[n : n + model.n_a]
    jump = np.abs(by_a + of_f[:, :3]).max(axis=1)
    size = np.abs(by_a).max(axis=1) + np.abs(of_f[:, :3]).max(axis=1)
    used = np.abs(np.vstack([loop.controller.matrices[1][0], loop.controller.matrices[3][0]])).max(
        axis=0
    )
    m = loop.model
    # Changes by the speed after a force, and by the angles a sample later: a signal of angles
    # alone has speed terms of rounding size.
    rates = np.abs(m.C) @ np.abs(m.push)
    rates += loop.sample_s * np.abs(m.C[:, :n]) @ np.abs(m.push[n:])
    for k, (sensor, name) in enumerate(channels, n_m):
        if used[k] == 0.0:
            continue
        reason = ""
        if jump[k - n_m] > AT_ONCE * size[k - n_m]:
            reason = "which a force on the tool changes at once"
        elif (np.abs(m.C[k] @ m.push) > AT_ONCE * rates[k]).any():
            reason = (
                "which a force on the tool changes as fast as a speed: sampled, it is never "
                "passive"
            )
        elif sensor.delay_s > 0.0:
            reason = f"which has a delay of {sensor.delay_s:g} s"
        if reason:
            raise ArgumentError(
                f"run: given a controller that uses {name}, {reason}, expected one of motor "
                "angles, positions, and torques of springs without damping"
            )
