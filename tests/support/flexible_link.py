"""A rotary flexible link with a geared motor whose voltage is recorded: model, description, and an
independent simulation.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

MODEL = """\
name = "flexible_link"
gravity = [0.0, 0.0, 0.0]
home_rad = [0.0]

[[element]]
name = "hub"
body = { mass = 0.1, inertia = [2e-3, 2e-3, 2e-3] }

[[element.dof]]
name = "theta"
type = "rotation"
axis = [0, 0, 1]
gear = { type = "rigid" }

[[element]]
name = "link"
body = { mass = 0.065, inertia = [3.8e-3, 3.8e-3, 3.8e-3] }

[[element.dof]]
name = "alpha"
type = "rotation"
axis = [0, 0, 1]
spring = { type = "linear", stiffness = 1.4 }
damping = 0.005

[[motor]]
name = "m1"
drives = "theta"
ratio = 1
inertia = 1e-4
friction = { viscous = 7e-2, coulomb = 1e-2, beta = 10.0 }

[[sensor]]
name = "tip"
type = "link_encoder"
coordinate = "alpha"
unit = "rad"

[output]
type = "joint"
joints = ["theta"]
"""
DESCRIPTION = """\
model = "link.toml"
hold = "zoh"

[time]
name = "t"
unit = "s"

[[torque]]
motor = "m1"
name = "vm"
unit = "V"
constant = 0.128
side = "motor"

[[angle]]
motor = "m1"
name = "theta"
unit = "deg"
side = "motor"

[[signal]]
sensor = "tip"
name = "alpha"
unit = "deg"

[[recording]]
file = "NAME.npz"
"""
# Torque per volt of the standing motor, k_t/R with gear and efficiency [N m/V].
CONSTANT = 0.128
FREE = (
    "alpha.stiffness",
    "alpha.damping",
    "m1.viscous",
    "m1.coulomb",
    "hub.inertia_zz",
    "link.inertia_zz",
)
ROTOR = 1e-4  # kg m^2


def write_link(folder: Path, name: str, arrays: dict[str, np.ndarray]) -> Path:
    """The description of a recording with arrays t [s], vm [V], theta and alpha [deg]."""
    (folder / "link.toml").write_text(MODEL)
    np.savez(folder / f"{name}.npz", **arrays)
    path = folder / f"{name}.toml"
    path.write_text(DESCRIPTION.replace("NAME", name))
    return path


def simulate_link(
    values: dict[str, float],
    t: np.ndarray,
    volts: np.ndarray,
    start: np.ndarray,
    back_emf: float = 0.0,
) -> np.ndarray:
    """States (n, 4) theta, alpha [rad] and their rates, by Runge and Kutta's method of order four
    with held volts; ``back_emf`` k_e [V s/rad].
    """
    hub = values["hub.inertia_zz"] + ROTOR
    link = values["link.inertia_zz"]
    mass = np.linalg.inv(np.array([[hub + link, link], [link, link]]))

    def rate(y: np.ndarray, u: float) -> np.ndarray:
        drive = CONSTANT * (u - back_emf * y[2])
        slip = values["m1.viscous"] * y[2] + values["m1.coulomb"] * np.tanh(10.0 * y[2])
        spring = values["alpha.stiffness"] * y[1] + values["alpha.damping"] * y[3]
        return np.concatenate([y[2:], mass @ [drive - slip, -spring]])

    out = [np.asarray(start, float)]
    for h, u in zip(np.diff(t), volts, strict=False):
        y = out[-1]
        a = rate(y, u)
        b = rate(y + h / 2 * a, u)
        c = rate(y + h / 2 * b, u)
        d = rate(y + h * c, u)
        out.append(y + h / 6 * (a + 2 * b + 2 * c + d))
    return np.array(out)
