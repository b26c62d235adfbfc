"""Growth of perturbations of the open loop along a motion.

An upright arm under a given torque is an inverted pendulum: rounding errors of 1e-16 and
tolerances of 1e-12 grow exponentially, and a forward simulation shows their growth instead of the
error of the torque. The variational equation along the motion

    d/dt dx = A(t) dx,     A from M(q) dq'' + D dq' + K dq = 0,     Phi(t, s) its transition matrix

gives the factor: the growth from s to t is the norm of the block of ``Phi`` that takes positions
to positions (motors on the arm side). A force f of a process on the tool adds its stiffness -d(J'
f)/dq to K. ``A`` is constant on each interval of a grid. Samples at rest at the end are left out:
the growth is that of the movement, and of a time after it in which the last torque is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from flexgen.base.calls.deadline import check_time
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.linearization import check_inertia, second_order_matrices
from flexgen.dynamics.mechanics.motor_harmonics import highest_harmonics
from flexgen.model.elements import RobotModel
from flexgen.simulation.result import AFTER

# of the grid: its step [s], intervals
STEP = 1e-2
FEWEST = 50
MOST = 1000
PHASE = 0.4  # rad: between instants of the grid, of the fastest Fourier sum of a motor angle
MOST_HARMONIC = 8000  # intervals that resolve it, at most: some seconds of matrix exponentials
# Matrix exponentials between two looks at the time limit: some 0.1 s of 24 states.
BLOCK = 200
# Part of the duration up to which two instants are the same: rounding of times, far below a
# sample.
SAME = 1e-12
AT_REST = 1e-4  # of the largest speed
AT_REST_ABS = 1e-9  # rad/s or m/s: rounding


@dataclass(frozen=True)
class Motion:
    """Motion and torque at n instants ``t``: arm ``q_a v_a a_a`` (n, n_a), motors
    ``q_m v_m a_m tau_m`` (n, n_m).

    ``force`` (n, 6): force and torque on the tool; ``tau_h`` (n, n_g): torques of the gears'
    hysteresis, ``tau_b`` (n, n_m): of the bristles of the motors; None: nothing.
    """

    t: np.ndarray
    q_a: np.ndarray
    v_a: np.ndarray
    a_a: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    a_m: np.ndarray
    tau_m: np.ndarray
    force: np.ndarray | None = None
    tau_h: np.ndarray | None = None
    tau_b: np.ndarray | None = None


def motion_in(trajectory: Trajectory) -> Motion:
    """The motion of a solution, whose columns are in the order of its model."""
    names = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m", "force", "tau_h", "tau_b")
    channels = trajectory.channels
    return Motion(trajectory.time, **{name: channels[name] for name in names if name in channels})


def motion_of(robot: RobotModel, data: Trajectory, given: dict[str, np.ndarray]) -> Motion | None:
    """The motion of a trajectory, with the channels ``given`` in the order of the model; None
    without speeds or accelerations, and where a number is not finite.
    """
    names = {
        "a": tuple(c.name for c in robot.coordinates),
        "m": tuple(m.name for m in robot.motors),
    }
    found = {"q_a": given["q_a"], "q_m": given["q_m"], "tau_m": given["tau_m"]}
    for name in ("v_a", "a_a", "v_m", "a_m"):
        labels = names[name[-1]]
        if name not in data.channels or sorted(data.labels[name]) != sorted(labels):
            return None
        found[name] = data[name][:, [data.labels[name].index(label) for label in labels]]
    finite = all(np.isfinite(x).all() for x in found.values())
    force = given.get("force")
    (tau_h, tau_b) = map(data.channels.get, ("tau_h", "tau_b"))
    return Motion(data.time, **found, force=force, tau_h=tau_h, tau_b=tau_b) if finite else None


@dataclass(frozen=True)
class Linearized:
    """Linearization at instants of a grid over a movement, with all positions on the arm side.

    ``at`` (k + 1,): its samples; ``lengths`` (k,) [s]: of its intervals; ``A`` (k + 1, 2n, 2n);
    ``force`` (k + 1, n, n): accelerations from the forces in the equations of motion; ``rest``
    [s]: from the grid's end to the last sample.
    """

    at: np.ndarray
    lengths: np.ndarray
    A: np.ndarray
    force: np.ndarray
    rest: float

    @property
    def means(self) -> np.ndarray:
        """``A`` of each interval, (k, 2n, 2n)."""
        return (self.A[:-1] + self.A[1:]) / 2


def linearize_along(equations: Equations, motion: Motion) -> Linearized:
    """The linearization ``x' = A x + force`` at instants of a motion until it is at rest, or along
    all of it where nothing moves.

    Motor coordinates are scaled to the arm side. Instants are samples, dense enough for the
    periods of gear harmonics.
    """
    model = equations.model
    t = motion.t
    last = _last_moving(motion.v_a)
    count = int(np.clip((t[last] - t[0]) / STEP, FEWEST, MOST))
    # an instant of the grid that is a sample up to rounding is that sample, not the next one
    instants = np.linspace(t[0], t[last], count + 1) - SAME * (t[last] - t[0])
    at = np.unique(np.searchsorted(t, instants).clip(0, last))
    at = np.union1d(at, _samples_of_harmonics(model, motion.q_m[: last + 1]))
    arguments = [
        motion.q_a,
        motion.v_a,
        motion.a_a,
        motion.q_m,
        motion.v_m,
        motion.a_m,
        motion.tau_m,
    ]
    n = model.dof
    jacobians = equations.function("residual_jacobians")
    if motion.force is not None:
        # a force of constant direction pushes by J(q)' f: it has a stiffness, -d(J' f)/dq
        jacobians = equations.pushed.function("residual_jacobians")
        # where J is constant, as of a gantry, the force has none and is not an argument
        if "f_tool" in jacobians.name_in():
            arguments.append(motion.force)
    M, D, K, _ = second_order_matrices(*evaluate(jacobians, *(x[at] for x in arguments)))
    check_inertia(model, M)
    side = np.ones(n)
    side[model.n_a :] = np.abs(model.eta).max(axis=1)[list(model.i_m)]
    A = np.zeros((len(at), 2 * n, 2 * n))
    force = np.linalg.inv(M) / side[:, None]
    A[:, :n, n:] = np.eye(n)
    A[:, n:, :n], A[:, n:, n:] = (np.linalg.solve(M, -x) / side[:, None] * side for x in (K, D))
    return Linearized(at, np.diff(t[at]), A, force, float(t[-1] - t[last]))


def _samples_of_harmonics(model: RobotModel, q_m: np.ndarray) -> np.ndarray:
    """Samples between which the fastest Fourier sum of a motor angle turns by at most `PHASE`.

    The stiffness of cogging changes its sign twice in each turn, and a coarser grid has that of
    single instants.
    """
    turned = np.abs(np.diff(q_m, axis=0)) * highest_harmonics(model)
    phase = np.concatenate([[0.0], turned.max(axis=1, initial=0.0).cumsum()])
    count = int(min(np.ceil(phase[-1] / PHASE), MOST_HARMONIC))
    if count < 1:
        return np.zeros(0, int)
    return np.searchsorted(phase, np.linspace(0.0, phase[-1], count + 1)).clip(0, len(q_m) - 1)


def _last_moving(v_a: np.ndarray) -> int:
    """The last sample at which the arm moves; the last one of all where it never does."""
    speed = np.abs(v_a).max(axis=1)
    moving = np.flatnonzero(speed > max(AT_REST_ABS, AT_REST * speed.max()))
    return int(moving[-1]) if len(moving) and moving[-1] else len(speed) - 1


@dataclass(frozen=True)
class Growth:
    """Largest growth of a perturbation from the start of a motion to an instant of it.

    ``movement``: until ``held`` after the arm has come to rest, where it does; ``whole``: until
    ``held`` after the last sample, ``later``: until `AFTER` after it.
    """

    movement: float
    whole: float
    later: float


def growth_along(along: Linearized, held: float = 0.0) -> Growth:
    """The growth along a motion, and with its last torque held for ``held`` [s] after it."""
    steps = _exponentials(along.means * along.lengths[:, None, None])
    n = along.A.shape[-1] // 2
    more = [
        round(seconds / STEP)
        for seconds in (held, along.rest + held, along.rest + max(held, AFTER))
    ]
    steps = np.concatenate([steps, np.repeat(expm(along.A[-1:] * STEP), more[-1], axis=0)])
    sizes = np.exp(np.minimum(np.maximum.accumulate(_log_growth(steps, n)), 700.0))
    at_rest = more[0] if along.rest > 0.0 else 0
    movement, whole, later = (
        max(1.0, float(sizes[len(along.lengths) + k - 1])) for k in (at_rest, *more[1:])
    )
    return Growth(movement, whole, later)


def _exponentials(matrices: np.ndarray) -> np.ndarray:
    """Matrix exponentials (k, m, m); with thousands of matrices a time limit can end in
    between.
    """
    found = np.empty_like(matrices)
    for first in range(0, len(matrices), BLOCK):
        check_time(f"growth of perturbations, interval {first} of {len(matrices)}")
        found[first : first + BLOCK] = expm(matrices[first : first + BLOCK])
    return found


def _log_growth(steps: np.ndarray, n: int) -> np.ndarray:
    """Natural logarithm (k,) of the growth of the coordinates from the start of the first step to
    the end of each. ``steps`` (k, 2 n, 2 n): transition matrices; their product is scaled so that
    it does not overflow.
    """
    product = np.eye(2 * n)
    size = 0.0
    out = np.empty(len(steps))
    for k, step in enumerate(steps):
        product = step @ product
        scale = float(np.linalg.norm(product))
        # growth of any size without overflow
        product = product / scale
        size = size + np.log(scale)
        out[k] = size + np.log(max(float(np.linalg.norm(product[:n, :n], 2)), 1e-300))
    return out
