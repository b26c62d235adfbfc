"""Logs of a planar arm with two joints as recorders write them, from a closed form that shares no
code with flexgen.

Links along z, rotations about y (bending towards x), absolute angles ``s = q1, r = q1 + q2``:

    tau_1 = (I1 + m1 c1^2 + m L^2) q1'' + m_2 terms ...   of the Lagrangian, see `Arm.arm_torques`
    q_m = N (q + tau / k),    tau_m = tau / N + J q_m'' + d q_m'

The gears have no damping; all derivatives but those of tau are analytic, that one is a central
difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

GRAVITY = 9.81
STEP = 1e-3  # s, of central differences of order 8
STENCIL = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
SLOPE = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])

MODEL = """\
name = "pl"
gravity = [0.0, 0.0, -9.81]
home_deg = [30.0, 60.0]

[[element]]
name = "upper"
body = { mass = 20.0, com = [0, 0, 0.22], inertia = [0.45, 0.45, 0.06] }

[[element.dof]]
name = "q1"
type = "rotation"
axis = [0, 1, 0]
lower_deg = -120
upper_deg = 120
[element.dof.gear]
type = "elastic"
side = "arm"
spring = { type = "linear", stiffness = 1.2e5 }
damping = 1.0

[[element]]
name = "fore"
origin = { position = [0, 0, 0.5] }
body = { mass = 12.0, com = [0, 0, 0.16], inertia = [0.16, 0.16, 0.02] }

[[element.dof]]
name = "q2"
type = "rotation"
axis = [0, 1, 0]
lower_deg = -150
upper_deg = 150
[element.dof.gear]
type = "elastic"
side = "arm"
spring = { type = "linear", stiffness = 1.5e4 }
damping = 0.1

[[motor]]
name = "m1"
drives = "q1"
ratio = 100
inertia = 3e-4
friction = { viscous = 5e-4 }

[[motor]]
name = "m2"
drives = "q2"
ratio = 80
inertia = 1e-4
friction = { viscous = 2e-4 }

[tool]
position = [0, 0, 0.4]

[output]
type = "tool_position"
axes = "xz"

[[move]]
name = "joints"
type = "joint"
start_deg = [0.0, 30.0]
end_deg = [30.0, 60.0]
duration = 0.6
smoothness = 5
"""


@dataclass(frozen=True)
class Arm:
    """The arm of `MODEL` with a point mass [kg] at (x, z) [m] of the fore arm, on a motion of
    sines.

    ``rest`` [s]: the motors stand still so long before the motion begins, and it begins smoothly.
    """

    load: float = 0.0
    x: float = 0.03
    z: float = 0.45
    rest: float = 0.0

    def joints(self, t: np.ndarray) -> np.ndarray:
        """Joint angles (n, 2) [rad]."""
        s = t - self.rest
        grows = 1.0
        if self.rest:
            u = np.clip(s / 3.0, 0.0, 1.0)
            grows = u**5 * (126 - 420 * u + 540 * u**2 - 315 * u**3 + 70 * u**4)
        one = 0.5 * np.sin(2 * np.pi * 0.35 * s) + 0.2 * np.sin(2 * np.pi * 0.8 * s + 0.3)
        two = 0.6 * np.sin(2 * np.pi * 0.45 * s + 1.0) + 0.15 * np.sin(2 * np.pi * 0.95 * s)
        return np.stack([0.2 + grows * one, 0.9 + grows * two], axis=1)

    def differences(self, of: str, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivative of one of the functions below."""
        shifts = STEP * np.arange(-4, 5)
        values = np.array([getattr(self, of)(t + shift) for shift in shifts])
        rate = np.tensordot(SLOPE, values, 1) / STEP
        return rate, np.tensordot(STENCIL, values, 1) / STEP**2

    def arm_torques(self, t: np.ndarray) -> np.ndarray:
        """Gear torques (n, 2) [N m] of two links and the point mass."""
        q = self.joints(t)
        v, a = self.differences("joints", t)
        s = q[:, 0]
        r = q.sum(axis=1)
        vs = v[:, 0]
        vr = v.sum(axis=1)
        dds = a[:, 0]
        ddr = a.sum(axis=1)
        length = 0.5
        tau = np.zeros_like(q)
        # link 1 about its joint: no other coordinate
        tau[:, 0] += (0.45 + 20.0 * 0.22**2) * dds - 20.0 * GRAVITY * 0.22 * np.sin(s)
        parts = [(12.0, 0.0, 0.16, 0.16)]
        parts += [(self.load, self.x, self.z, 0.0)] if self.load else []
        for mass, x, z, inertia in parts:
            # place: length (sin s, cos s) + x (cos r, -sin r) + z (sin r, cos r)
            first = np.stack([length * np.cos(s), -length * np.sin(s)])
            rise = np.stack([-length * np.sin(s), -length * np.cos(s)])
            second = np.stack([-x * np.sin(r) + z * np.cos(r), -x * np.cos(r) - z * np.sin(r)])
            bend = np.stack([-x * np.cos(r) - z * np.sin(r), x * np.sin(r) - z * np.cos(r)])
            push = first * dds + second * ddr + rise * vs**2 + bend * vr**2
            push[1] += GRAVITY
            about_2 = mass * (second * push).sum(axis=0) + inertia * ddr
            tau[:, 1] += about_2
            tau[:, 0] += about_2 + mass * (first * push).sum(axis=0)
        return tau

    def motors(self, t: np.ndarray) -> np.ndarray:
        """Motor angles (n, 2) [rad]: the links and the deflections of the gears."""
        return (self.joints(t) + self.arm_torques(t) / [1.2e5, 1.5e4]) * [100.0, 80.0]

    def torques(self, t: np.ndarray) -> np.ndarray:
        """Motor torques (n, 2) [N m]."""
        speed, rate = self.differences("motors", t)
        own = rate * [3e-4, 1e-4] + speed * [5e-4, 2e-4]
        return own + self.arm_torques(t) / [100.0, 80.0]


def write_csv(path: Path, columns: dict[str, np.ndarray], digits: int = 10) -> Path:
    """A CSV file with these names in its first line; nan: an empty cell."""
    rows = np.stack(list(columns.values()), axis=1)
    lines = [",".join(columns)]
    lines += [",".join("" if np.isnan(x) else f"{x:.{digits}g}" for x in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


QUIRKS = (
    "as it is",
    "jitter of 20 us",
    "stamps that are late",
    "unequal steps",
    "two rates",
    "repeated angles",
    "repeated torques",
    "degrees",
    "other units",
    "rpm",
    "currents",
    "currents with constants",
    "gap",
    "rest",
    "order",
    "labels",
    "no header",
    "names by option",
)
# The constants of the currents of a log [N m/A].
CONSTANTS = (0.12, 0.08)


@dataclass(frozen=True)
class Log:
    """Columns of a log as a recorder writes them: the time, motor angles, motor torques, with
    their units.

    ``names``: of the columns of the angles, then of the torques; ``units``: of the time, the
    angles and the torques; ``values``: (n, 5), time first; ``order``: of the columns in the file;
    ``constants`` [N m/A] are stated or not.
    """

    values: np.ndarray
    units: tuple[str, str, str] = ("s", "rad", "N m")
    motors: tuple[str, str] = ("m1", "m2")
    order: tuple[int, ...] = (0, 1, 2, 3, 4)
    header: bool = True
    constants: bool = True


def instants(quirk: str, end: float, rng: np.random.Generator) -> np.ndarray:
    """When the samples of a log are taken (n,) [s]."""
    if quirk == "jitter of 20 us":
        t = 1e-3 * np.arange(round(end / 1e-3))
        return t + rng.uniform(-4e-5, 4e-5, len(t))
    if quirk == "unequal steps":
        return np.cumsum(rng.choice([0.010, 0.012], size=round(end / 0.011)))
    step = 2e-3 if quirk in ("two rates", "repeated angles", "repeated torques") else 8e-3
    return step * np.arange(round(end / step))


def quirky(quirk: str, arm: Arm, end: float = 20.0) -> Log:
    """A log of an arm with a quirk; the same random numbers in each call."""
    rng = np.random.default_rng(5)
    t = instants(quirk, end, rng)
    values = np.column_stack([t, arm.motors(t), arm.torques(t)])
    if quirk == "stamps that are late":
        values[:, 0] += rng.normal(size=len(t)) * 1e-3
    if quirk == "two rates":
        values[np.arange(len(t)) % 4 != 0, 3:] = np.nan
    if quirk.startswith("repeated"):
        columns = slice(1, 3) if quirk == "repeated angles" else slice(3, 5)
        values[:, columns] = values[np.arange(len(t)) // 4 * 4][:, columns]
    if quirk == "gap":
        values = np.delete(values, slice(500, 620), axis=0)
    if quirk == "rest":
        noise = 0.3 * rng.normal(size=(len(t), 2))
        values[:, 1:3] = COUNT * np.round(values[:, 1:3] / COUNT + noise)
    if quirk.startswith("currents"):
        values[:, 3:] /= CONSTANTS
        return Log(values, ("s", "rad", "A"), constants=quirk != "currents")
    if quirk == "degrees":
        values[:, 1:3] = np.degrees(values[:, 1:3])
        return Log(values, ("s", "deg", "N m"))
    if quirk == "other units":
        values *= [1e3, 0.5 / np.pi, 0.5 / np.pi, 100.0, 100.0]
        return Log(values, ("ms", "rev", "N cm"))
    changes: dict[str, dict[str, Any]] = {
        "rpm": {"units": ("s", "rpm", "N m")},
        "order": {"order": (3, 2, 4, 0, 1)},
        "labels": {"motors": ("m1", "m3")},
        "no header": {"header": False},
        "names by option": {"header": False},
    }
    return Log(values, **changes.get(quirk, {}))


# A count of the encoders [rad, motor side]: 12 bits in a turn.
COUNT = 2 * np.pi / 4096
