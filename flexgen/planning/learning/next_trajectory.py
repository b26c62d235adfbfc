"""The trajectory of the next run: a corrected path, inverted, with corrections of the motors."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.inversion.problem.sampling import time_derivative
from flexgen.paths.force.process_force import CHANNEL
from flexgen.planning.learning.corrected import DEGREE, CorrectedPath
from flexgen.planning.learning.history import KEY
from flexgen.planning.learning.motor_reaction import LinearisedArm

CORRECTION = "correction"  # channel of the corrections of the path, d
MOTOR_CORRECTION = "motor_correction"  # channel of those of the motors, r
MOTION = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
CHANGED = 1e-2  # of the largest torque: a difference by which the model is another one


def corrections_of(last: Trajectory, corrected: CorrectedPath) -> tuple[np.ndarray, np.ndarray]:
    """Corrections of path (n, n_y) [m, rad] and motors (n, n_m) [rad] of a trajectory, at the
    instants of the corrected path; zero where it has none.
    """
    found = []
    widths = corrected.outputs, last["tau_m"].shape[1]
    for name, width in zip((CORRECTION, MOTOR_CORRECTION), widths, strict=True):
        if name not in last:
            found.append(np.zeros((len(corrected.time), width)))
            continue
        inside = np.clip(corrected.time, last.time[0], last.time[-1])
        found.append(np.asarray(make_interp_spline(last.time, last[name], k=5)(inside)))
    return found[0], found[1]


def make_trajectory(
    corrections: tuple[np.ndarray, np.ndarray],
    corrected: CorrectedPath,
    last: Trajectory,
    iteration: int,
) -> Trajectory:
    """The trajectory of an iteration, with corrections of path (n, n_y) [m, rad] and motors
    (n, n_m) [rad] at the instants of the corrected path.

    ``last``: the trajectory of the last run, whose labels and units it has.
    """
    of_path, of_motors = corrections
    found = corrected.invert_finely(of_path)
    time = found.t + corrected.time[0]
    channels = {name: getattr(found, name) for name in ("q_a", "v_a", "a_a", "q_m", "v_m")}
    channels |= {"a_m": time_derivative(found.v_m, found.period), "tau_m": found.tau_m}
    if of_motors.any():
        moved = _spline(corrected.time, of_motors, time)
        arm = LinearisedArm(corrected.equations, [channels[x] for x in MOTION], found.period)
        channels["tau_m"] = channels["tau_m"] + arm.torque(*moved)
        for name, x in zip(("q_m", "v_m", "a_m"), moved, strict=True):
            channels[name] = channels[name] + x
    channels["tau_g"] = found.tau_g
    # the next run needs no more samples than the periods of the path
    every = round(corrected.period / found.period)
    time = time[::every]
    channels = {name: x[::every] for name, x in channels.items()}
    channels[CORRECTION] = _spline(corrected.time, of_path, time)[0]
    channels[MOTOR_CORRECTION] = _spline(corrected.time, of_motors, time)[0]
    return _with_labels(channels, time, corrected, last, iteration)


def _spline(
    grid: np.ndarray, values: np.ndarray, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (n, k) of a correction at rest at both ends and of its rates, at other instants."""
    zero = [(order, np.zeros(values.shape[1])) for order in range(1, (DEGREE + 1) // 2)]
    spline = make_interp_spline(grid, values, k=DEGREE, bc_type=(zero, zero))
    inside = np.clip(time, grid[0], grid[-1])
    moving = ((time >= grid[0]) & (time <= grid[-1]))[:, None]
    return (
        np.asarray(spline(inside)),
        np.where(moving, spline(inside, 1), 0.0),
        np.where(moving, spline(inside, 2), 0.0),
    )


def _with_labels(
    channels: dict[str, np.ndarray],
    time: np.ndarray,
    corrected: CorrectedPath,
    last: Trajectory,
    iteration: int,
) -> Trajectory:
    """Channels as a trajectory with the labels and units of the last one."""
    sample = corrected.path.sample(time)
    channels["y_ref"] = sample.y[:, :, 0]
    if sample.R is not None:
        channels["R_ref"] = sample.R.reshape(len(time), 9)
    if CHANNEL in last:
        channels[CHANNEL] = last.at(np.clip(time, last.time[0], last.time[-1]))[CHANNEL]
    labels = {}
    ports = {}
    units = {}
    output = "y_ref" if corrected.equations.model.output.type != "tool_pose" else None
    for name, x in channels.items():
        source = {CORRECTION: output, MOTOR_CORRECTION: "q_m"}.get(name, name)
        if source is not None and source in last:
            labels[name] = last.labels[source]
            units[name] = last.units[source]
            unit = last.ports[source].unit
        else:
            labels[name] = tuple(map(str, range(x.shape[1])))
            units[name] = ("m",) * 3 + ("rad",) * 3
            unit = "rad or m"
        doc = "learned correction" if source != name else last.ports[name].doc
        ports[name] = Port(name, (x.shape[1],), unit, doc)
    meta = dict(last.meta) | {"kind": "learned", "torque": "smooth", KEY: iteration}
    meta = {key: meta[key] for key in meta if key not in ("errors", "torque_degree")}
    return Trajectory(time, channels, ports, labels, meta, units)


def note_changed_model(
    corrected: CorrectedPath, given: tuple[np.ndarray, np.ndarray], last: Trajectory
) -> list[str]:
    """A note where the torques of the last run are not those of the model: it was changed."""
    if given[1].any():
        return []
    found = corrected.invert(given[0])
    time = found.t + corrected.time[0]
    inside = (time >= last.time[0]) & (time <= last.time[-1])
    away = float(np.abs(found.tau_m[inside] - last.at(time[inside])["tau_m"]).max())
    if away <= CHANGED * np.abs(last["tau_m"]).max():
        return []
    return [
        f"the torques of the last run differ by up to {away:.3g} N m from those of the model "
        "along its path: the model was changed since; the next run has those of the new model"
    ]


def start_notes(new: Trajectory, last: Trajectory) -> list[str]:
    """A note where the next run begins at other motor angles than the last one."""
    away = np.abs(new["q_m"][0] - last["q_m"][0])
    j = int(np.argmax(away))
    if away[j] < 1e-6:
        return []
    return [
        f"the next run begins at other motor angles, by up to {away[j]:.3g} rad "
        f"({new.labels['q_m'][j]}): move there first"
    ]
