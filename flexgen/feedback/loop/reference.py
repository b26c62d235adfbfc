"""The planned motion as references of a sampled controller.

Torques are held between samples, so that they are those of `flexgen.simulation.integration.hold`:
the mean over the interval in which each acts, less a twelfth of its second difference. The speed
of the motors is not a reference of the drives: they take the same difference of samples from the
reference as from the measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.motion.torque_curve import read_degree
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.ports import Port
from flexgen.inversion.problem.sampling import time_derivative
from flexgen.paths.path import Path
from flexgen.runtime.inversion.path_inversion import Inversion
from flexgen.runtime.library import Library
from flexgen.simulation.integration.hold import SAME, hold_torque

MOTION = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
TOOL = 6  # entries of a force and a torque on the tool
MOST_SAMPLES = 2_000_000


@dataclass(frozen=True)
class MotionReference:
    """References at the samples of a controller.

    ``time`` (n,) [s], zero where the path begins; motion ``q_a v_a a_a`` (n, n_a), ``q_m v_m a_m``
    (n, n_m), exact torque ``tau_m`` (n, n_m) at the samples, torque to send ``held`` (n, n_m),
    sensors ``y_s`` (n, n_s), output ``y_ref`` (n, n_y), ``R_ref`` (n, 9) or None; ``begin``,
    ``end``: of the motion, ``path_end`` [s].
    """

    time: np.ndarray
    motion: dict[str, np.ndarray]
    held: np.ndarray
    y_s: np.ndarray
    y_ref: np.ndarray
    R_ref: np.ndarray | None
    begin: float
    end: float
    path_end: float

    def points(self, at: np.ndarray) -> tuple[np.ndarray, ...]:
        """The motion ``q_a v_a a_a q_m v_m a_m tau_m`` at some samples."""
        return tuple(self.motion[name][at] for name in MOTION)

    def parts(self, samples: int) -> tuple[np.ndarray, ...]:
        """The motion in the middle of each part of ``samples`` samples."""
        return self.points(
            np.minimum(np.arange(0, len(self.time), samples) + samples // 2, len(self.time) - 1)
        )

    def rows(self, exact_state: bool = False) -> np.ndarray:
        """All references of a sample side by side, (n, n_ref); see
        `flexgen.feedback.loop.interface.Reference`.

        With the exact state among the channels: ``q_a, v_a, q_m, v_m`` after the sensors.
        """
        m = self.motion
        state = [m[name] for name in ("q_a", "v_a", "q_m", "v_m")] if exact_state else []
        return np.hstack([m["q_m"], self.y_s, *state, self.held, m["v_m"], m["q_a"], m["v_a"]])


def time_grid(
    first: float, last: float, sample_s: float, before_s: float, after_s: float
) -> np.ndarray:
    """Instants of the samples of a controller (n,) [s] around a motion from ``first`` to ``last``
    [s], with at least ``before_s`` of rest before it and ``after_s`` after it; one of them is
    ``first``.
    """
    before = int(np.ceil(before_s / sample_s))
    after = int(np.ceil(after_s / sample_s))
    count = before + int(np.ceil((last - first) / sample_s)) + after + 1
    if count > MOST_SAMPLES:
        raise ArgumentError(
            f"sample_time: given {sample_s} s, which makes {count} samples, expected "
            f"{MOST_SAMPLES}"
        )
    return first + sample_s * (np.arange(count) - before)


def motion_reference(
    trajectory: Trajectory,
    path: Path,
    sample_s: float,
    delay_s: float,
    library: Library,
    time: np.ndarray,
    signals: ca.Function | None = None,
) -> MotionReference:
    """References for a controller with a sample time and a delay from the measurement to the
    torque.

    Parameters
    ----------
    trajectory : Trajectory
        Motion ``q_a v_a a_a q_m v_m a_m`` and torques ``tau_m``; at rest before and after it.
    path : Path
        That the output is compared with.
    sample_s, delay_s : float [s]
    library : Library
        With ``sensors`` where the model has any.
    time : array (n,) [s]
        The samples; the first is at rest before the motion.
    signals : casadi.Function, optional
        Signals of the sensors from ``q_a, v_a, a_a, force``, instead of those of the library.
    """
    first = float(trajectory.time[0])
    last = float(trajectory.time[-1])
    motion = trajectory.at(np.clip(time, first, last))
    moving = (time >= first) & (time <= last)
    for name in ("v_a", "a_a", "v_m", "a_m"):
        motion[name] = np.where(moving[:, None], motion[name], 0.0)
    y_s = np.zeros((len(time), library.sizes.get("n_s", 0)))
    if signals is not None:
        force = motion.get("force", np.zeros((len(time), TOOL)))
        y_s = evaluate(signals, *(motion[name] for name in MOTION[:3]), force)[0].reshape(
            len(time), -1
        )
    elif "sensors" in library.functions:
        y_s = np.ascontiguousarray(library.sensors(motion["q_a"], motion["v_a"], motion["a_a"]))
    held = hold_torques(trajectory, time, sample_s, delay_s)
    wanted = path.sample(time)
    R_ref = None if wanted.R is None else wanted.R.reshape(len(time), 9)
    return MotionReference(
        time, motion, held, y_s, wanted.y[:, :, 0], R_ref, first, last, path.duration
    )


def hold_torques(
    trajectory: Trajectory, time: np.ndarray, sample_s: float, delay_s: float
) -> np.ndarray:
    """Torques (n, n_m) [N m] to send at the samples ``time`` (n,) [s], each held for a sample, so
    that they follow the trajectory after a delay of ``delay_s`` [s].

    The trajectory may begin anywhere between two samples; before its begin its first torque is
    sent.
    """
    tau = trajectory["tau_m"]
    first = float(trajectory.time[0])
    limited = trajectory.meta.get("torque") == "limited"
    degree = read_degree(trajectory.meta)
    late = (time[0] - first) / sample_s
    # part of a sample that the samples are behind those from the begin of the trajectory
    late -= np.floor(late + SAME)
    acts = max(delay_s + late * sample_s, 0.0)
    ticks, values = hold_torque(
        trajectory.time, tau, "zoh", sample_s, acts, limited=limited, degree=degree
    )
    begin = round((ticks[0] - first) / sample_s)
    at = np.round((time - first) / sample_s - late).astype(int) - begin
    held = values[at.clip(0, len(values) - 1)]
    return np.asarray(np.where((at < 0)[:, None], tau[0], held))


def trajectory_of(
    found: Inversion, begin: float, name: str, force: np.ndarray | None = None
) -> Trajectory:
    """The motion of an inversion as a trajectory whose path begins at ``begin`` [s]; ``force`` (n,
    6): on the tool.
    """
    channels = {name: getattr(found, name) for name in ("q_a", "v_a", "a_a", "q_m", "v_m")}
    channels |= {"a_m": time_derivative(found.v_m, found.period), "tau_m": found.tau_m}
    channels |= {} if force is None else {"force": force}
    labels = {name: tuple(map(str, range(x.shape[1]))) for name, x in channels.items()}
    ports = {name: Port(name, (x.shape[1],), "", "") for name, x in channels.items()}
    return Trajectory(found.t + begin, channels, ports, labels, {"model": name})
