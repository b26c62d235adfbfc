"""Confirmation of a solution by Pinocchio and numpy: nothing of the solvers, the verification or
the mechanics is used.

Figures, each a necessary condition, but for ``residual_end``, which is that of the last samples
alone:

* ``kinematic``: speeds and accelerations against differences of the positions, relative to the
  largest.
* ``residual``: equations of motion at samples, each row relative to the largest force in it.
* ``output``: the output of the motion against the reference [m, rad].
* ``windows``: largest error of the output [m, rad] after integrating the whole robot over short
  windows that begin in states of the motion.
"""

from __future__ import annotations

import numpy as np
from pinocchio_referee import PinocchioReferee
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from flexgen.base.motion.trajectory import Trajectory
from flexgen.model.elements import RobotModel

KINEMATIC = 1e-4
RESIDUAL = 1e-4
OUTPUT = 1e-5
GROSS = 1e-2
# LENGTH in s
SAMPLES = 120
WINDOWS = 4
LENGTH = 0.02
EDGE = 5  # samples at either end that the first two figures leave out
SMALLEST = 1e-3  # of the largest force of a kind: rows that carry less are measured by it


def confirm(model: RobotModel, t: Trajectory, windows: int = WINDOWS) -> dict[str, float]:
    """The figures of a solution's trajectory; no windows where sharp friction makes them stiff:
    zero.
    """
    pin = PinocchioReferee(model)
    sharp = any(motor.friction.coulomb for motor in model.motors)
    return {
        "kinematic": kinematic_error(t),
        "residual": residual(
            pin, t, np.unique(np.linspace(EDGE, len(t.time) - 1 - EDGE, SAMPLES).astype(int))
        ),
        "residual_end": residual(pin, t, np.arange(len(t.time) - EDGE, len(t.time))),
        "output": float(output_error(pin, t["q_a"], t["y_ref"], t.channels.get("R_ref")).max()),
        "windows": 0.0 if sharp else windows_error(pin, t, windows),
    }


def holds(figures: dict[str, float]) -> bool:
    """Whether the solution is confirmed."""
    bounds = {"kinematic": KINEMATIC, "residual": RESIDUAL, "output": OUTPUT, "windows": OUTPUT}
    return all(figures[name] <= bound for name, bound in bounds.items())


def is_false(figures: dict[str, float]) -> bool:
    """Whether a tool that is said to follow does not, or motion and torques contradict each other
    by a hundredth.

    What is neither confirmed nor false is coarse: the tool follows, but samples between which a
    torque or an acceleration changes fast differ from their derivatives by more than the bounds.
    """
    bounds = {"kinematic": GROSS, "residual": GROSS, "output": OUTPUT, "windows": OUTPUT}
    return not all(figures[name] <= bound for name, bound in bounds.items())


def kinematic_error(t: Trajectory) -> float:
    """Largest difference of v and a from the derivatives of q, relative to the largest v and a of
    the same kind.
    """
    inside = slice(EDGE, -EDGE)  # a spline is less accurate at its ends
    worst = 0.0
    for part in "am":
        slope = make_interp_spline(t.time, t[f"q_{part}"], k=7).derivative()(t.time)
        slope2 = make_interp_spline(t.time, t[f"v_{part}"], k=7).derivative()(t.time)
        for found, given in ((slope, t[f"v_{part}"]), (slope2, t[f"a_{part}"])):
            worst = max(
                worst, float(np.abs(found - given)[inside].max() / max(np.abs(given).max(), 1e-9))
            )
    return worst


def residual(pin: PinocchioReferee, t: Trajectory, at: np.ndarray) -> float:
    """Largest residual of a row at the samples ``at`` over the largest force in that row along the
    motion.
    """
    model = pin.model
    rows = []
    sizes = []
    for i in np.unique([*at, *np.linspace(0, len(t.time) - 1, SAMPLES).astype(int)]):
        y, dy, ddy = (pin.minimal(t[f"{x}_a"][i], t[f"{x}_m"][i]) for x in "qva")
        inertia = pin.P.T @ pin.machine.inverse_dynamics(pin.P @ y, pin.P @ dy, pin.P @ ddy)
        force = pin.forces(t["q_a"][i], t["v_a"][i], t["q_m"][i], t["v_m"][i], t["tau_m"][i])
        if i in at:
            rows.append(np.abs(inertia - force))
        motor = np.zeros(model.dof)
        motor[model.n_a :] = t["tau_m"][i][list(model.i_m)]
        sizes.append(np.maximum(np.abs(inertia), np.abs(motor)))
    size = np.max(sizes, axis=0)
    for part in (slice(0, model.n_a), slice(model.n_a, None)):
        size[part] = np.maximum(size[part], SMALLEST * size[part].max(initial=1e-12))
    return float((np.max(rows, axis=0) / size).max())


def output_error(
    pin: PinocchioReferee, q_a: np.ndarray, y_ref: np.ndarray, R_ref: np.ndarray | None
) -> np.ndarray:
    """Error of the output at each sample, the larger of distance and angle."""
    output = pin.model.output
    if output.type == "combination":
        return np.linalg.norm(q_a @ np.array(output.weights).T - y_ref, axis=1)
    out = []
    for i, q in enumerate(q_a):
        p, R = pin.forward_kinematics(q)
        axes = [
            "xyz".index(axis)
            for axis in (output.axes if output.type == "tool_position" else "xyz")
        ]
        error = float(np.linalg.norm(p[axes] - y_ref[i]))
        if R_ref is not None:
            error = max(
                error, float(Rotation.from_matrix(R @ R_ref[i].reshape(3, 3).T).magnitude())
            )
        out.append(error)
    return np.array(out)


def windows_error(pin: PinocchioReferee, t: Trajectory, windows: int) -> float:
    """Largest error of the output after short windows; not finite where the integration broke
    down.
    """
    model = pin.model
    n_a = model.n_a
    i_m = list(model.i_m)
    torque = make_interp_spline(t.time, t["tau_m"], k=5)

    def rate(instant: float, x: np.ndarray) -> np.ndarray:
        q_m = np.zeros(model.n_m)
        v_m = np.zeros(model.n_m)
        q_m[i_m] = x[n_a : model.dof]
        v_m[i_m] = x[model.dof + n_a :]
        v_a = x[model.dof : model.dof + n_a]
        a_a, a_m = pin.forward_dynamics(x[:n_a], v_a, q_m, v_m, torque(instant))
        return np.concatenate([x[model.dof :], a_a, a_m[i_m]])

    length = min(LENGTH, (t.time[-1] - t.time[0]) / windows)
    last = int(np.searchsorted(t.time, t.time[-1] - length)) - 1
    worst = 0.0
    for first in np.linspace(0, last, windows).astype(int):
        inside = np.flatnonzero((t.time >= t.time[first]) & (t.time <= t.time[first] + length))
        start = np.concatenate(
            [t["q_a"][first], t["q_m"][first][i_m], t["v_a"][first], t["v_m"][first][i_m]]
        )
        span = (t.time[inside[0]], t.time[inside[-1]])
        found = solve_ivp(
            rate, span, start, method="LSODA", rtol=1e-8, atol=1e-9, t_eval=t.time[inside]
        )
        if not found.success:
            return float("inf")
        R_ref = t["R_ref"][inside] if "R_ref" in t.channels else None
        worst = max(
            worst, float(output_error(pin, found.y[:n_a].T, t["y_ref"][inside], R_ref).max())
        )
    return worst
