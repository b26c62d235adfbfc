"""A cart on a slide that carries a mass on a spring: linear, with a closed form."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

import flexgen

STEP = 1e-3  # s
OFFSET = 3.0  # N
CART = 4.0  # kg
TIP = 1.5  # kg
FREQUENCY = 3.0  # Hz
DAMPING = 0.02
SLIDE = f"""
name = "slide"
gravity = [0.0, 0.0, -9.81]
home_rad = [0.0]
[[element]]
name = "cart"
body = {{ mass = {CART} }}
[[element.dof]]
name = "q1"
type = "translation"
axis = [1, 0, 0]
gear = {{ type = "rigid" }}
[[element]]
name = "tip"
body = {{ mass = {TIP} }}
[[element.dof]]
name = "sway"
type = "translation"
axis = [1, 0, 0]
spring = {{ type = "linear", stiffness = {TIP * (2 * np.pi * FREQUENCY) ** 2} }}
damping = {2 * DAMPING * TIP * 2 * np.pi * FREQUENCY}
[[motor]]
name = "m1"
drives = "q1"
ratio = 1.0
inertia = 0.0
[output]
type = "joint"
joints = ["q1"]
[[move]]
name = "across"
type = "joint"
start_rad = [0.0]
end_rad = [0.3]
duration = 0.3
smoothness = 5
"""


def shaken(lag: float = 0.0, noise: float = 0.0) -> flexgen.JointRecord:
    """A record in closed form: the cart accelerates by a, -a (bang-bang, smoothed by a raised
    cosine of 0.1 s), and the oscillator x'' + 2 d w x' + w^2 x = -a is the convolution of its
    impulse response with it.
    """
    t = np.arange(0.0, 4.0, STEP / 4)
    ramp = np.hanning(401)
    a = 2.0 * ((t >= 0.4) & (t < 0.7)) - 2.0 * ((t >= 0.7) & (t < 1.0))
    a = np.convolve(a, ramp / ramp.sum(), mode="same")
    w = 2 * np.pi * FREQUENCY
    damped = w * np.sqrt(1 - DAMPING**2)
    impulse = np.exp(-DAMPING * w * t) * np.sin(damped * t) / damped
    x = -np.convolve(a, impulse)[: len(t)] * STEP / 4
    v = cumulative_trapezoid(a, t, initial=0.0)
    q = cumulative_trapezoid(v, t, initial=0.0)
    acceleration = -a - 2 * DAMPING * w * np.gradient(x, t) - w**2 * x
    force = CART * a + TIP * (a + acceleration)
    force = np.interp(t - lag, t, force)[::4] + OFFSET
    force += noise * np.random.default_rng(1).normal(size=len(force))
    return flexgen.JointRecord(t[::4], q[::4, None], force[:, None], ("q1",))


@cache
def slide_robot() -> flexgen.RobotModel:
    """The robot of `SLIDE`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "slide.toml"
        path.write_text(SLIDE, encoding="utf-8")
        return flexgen.read(path)
