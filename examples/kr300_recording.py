"""Motor torques of a KUKA KR300 along a recorded motion: those of the model compared with the
measured ones.

    python examples/kr300_recording.py RECORDING.npz [PICTURE.svg]

The rigid-body torque is computed from the encoder angles and the model file. Friction is fitted by
least squares: for each axis a viscous coefficient, a Coulomb coefficient and one constant,

    tau_m = J_m eta a + eta^-T (M a + c + g) + F_v v + F_c tanh(v / v_0) + F_0.

The recorded angles are relative to the first pose, which is assumed to be the usual home of the
robot. Payload and counterbalance are unknown and not modeled, so axes 2 and 3 cannot fit
perfectly. This is a plausibility check: friction and constant alone, without the rigid-body
torque, are fitted too, to show how much of the torque they explain.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.signal import savgol_filter

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.model.elements import RobotModel

HOME_DEG = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
# samples and degree of the smoothing polynomial: 0.12 s, below the lowest resonance of the arm
WINDOW = 31
ORDER = 5
V_0 = 0.01  # rad/s, arm side: width of the Coulomb step


@dataclass(frozen=True)
class Comparison:
    """Measured and computed motor torques of a recording.

    ``t`` (n,) [s]; ``measured``, ``model`` (n, 6) [N m, motor side]; ``r2``, ``r2_friction`` (6,):
    coefficients of determination of the model, and of friction and constant alone;
    ``coefficients`` (6, 3): F_v, F_c, F_0 of each axis.
    """

    t: np.ndarray
    measured: np.ndarray
    model: np.ndarray
    coefficients: np.ndarray
    r2: np.ndarray
    r2_friction: np.ndarray


def compare(recording: str | Path, robot: str | RobotModel = "kr300") -> Comparison:
    """Compute the torques of the model along a recording and fit the friction coefficients."""
    data = np.load(recording, allow_pickle=False)
    t = data["t"]
    measured = data["tau_motor_Nm"].T
    equations = flexgen.derive(robot)
    model = equations.model
    angle = np.deg2rad(data["q_mot_deg"] + np.array(HOME_DEG)[:, None])
    q, v, a = (
        savgol_filter(angle, WINDOW, ORDER, deriv=k, delta=t[1] - t[0], axis=1).T for k in range(3)
    )
    arm = evaluate(equations.function("inverse_dynamics"), q, v, a)[0]
    inertia = np.array([motor.inertia for motor in model.motors])
    body = np.linalg.solve(model.eta.T, arm.T).T + inertia * (a @ model.eta.T)
    found = np.empty_like(body)
    coefficients = np.empty((6, 3))
    r2 = np.empty(6)
    alone = np.empty(6)
    for i in range(6):
        friction = np.column_stack([v[:, i], np.tanh(v[:, i] / V_0), np.ones(len(t))])
        coefficients[i] = np.linalg.lstsq(friction, measured[:, i] - body[:, i], rcond=None)[0]
        found[:, i] = body[:, i] + friction @ coefficients[i]
        r2[i] = 1 - np.var(measured[:, i] - found[:, i]) / np.var(measured[:, i])
        without = friction @ np.linalg.lstsq(friction, measured[:, i], rcond=None)[0]
        alone[i] = 1 - np.var(measured[:, i] - without) / np.var(measured[:, i])
    return Comparison(t, measured, found, coefficients, r2, alone)


def draw(comparison: Comparison, path: str | Path) -> None:
    """Plot the measured and the computed motor torque of each axis."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    FigureCanvasAgg(figure)
    for i, axes in enumerate(figure.subplots(3, 2, sharex=True).T.ravel()):
        axes.plot(comparison.t, comparison.measured[:, i], color="0.6", lw=0.8, label="measured")
        axes.plot(
            comparison.t,
            comparison.model[:, i],
            color="#0072B2",
            lw=1.1,
            label="model + fitted friction",
        )
        axes.set_title(f"axis {i + 1}: R² = {comparison.r2[i]:.3f}", loc="left", fontsize=10)
        axes.set_ylabel("motor torque in N m")
        axes.grid(alpha=0.3)
        if i % 3 == 2:
            axes.set_xlabel("time in s")
    figure.axes[0].legend(fontsize=8)
    figure.savefig(path)


def main() -> int:
    """Compare, print the table, plot."""
    if len(sys.argv) not in (2, 3):
        print(
            "usage: python examples/kr300_recording.py RECORDING.npz [PICTURE.svg]",
            file=sys.stderr,
        )
        return 2
    comparison = compare(sys.argv[1])
    print("R2: of the model with fitted friction, and of friction and constant alone")
    print("F_v: arm-side speed; torques: motor side")
    print("axis   R2 model   R2 friction alone   F_v in N m s/rad   F_c in N m   F_0 in N m")
    for i, (f_v, f_c, f_0) in enumerate(comparison.coefficients):
        r2 = comparison.r2[i]
        alone = comparison.r2_friction[i]
        print(f"{i + 1:4d}   {r2:8.3f}   {alone:17.3f}   {f_v:16.3f}   {f_c:10.3f}   {f_0:10.3f}")
    if len(sys.argv) == 3:
        draw(comparison, sys.argv[2])
        print(f"wrote {sys.argv[2]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
