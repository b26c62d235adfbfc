"""A cart on a slide that carries a mass on a spring: linear, with a closed form."""

from __future__ import annotations

import numpy as np

CART, TIP = 4.0, 1.5  # kg
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
