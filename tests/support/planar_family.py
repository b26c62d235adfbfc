"""Planar arms with two motors and a passive last joint, whose zero dynamics are known in closed
form.

Links of length l1, l2; body 3 (mass m, centre at xi on its axis, inertia j) beyond the passive
joint, the tool at l on that axis. It may have a constant angle to link 2. With the tool held, body
3 turns about the tool point:

    I_eff s^2 + kappa (D s + K) = 0,    I_eff = j + m xi^2 - m xi l,
    kappa = 1 + l sin(q2 + bend) / (l2 sin q2)

without gravity. The output is minimum phase where I_eff and kappa have the same sign.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from flexgen.model.elements import Body, LinearSpring, Placement, RobotModel
from flexgen.model.reader import read


@dataclass(frozen=True)
class PlanarArm:
    """A robot of the family at a pose (q1, q2), with the numbers of its closed form."""

    model: RobotModel
    pose: tuple[float, float]
    i_eff: float
    kappa: float
    damping: float
    stiffness: float

    @property
    def minimum_phase(self) -> bool:
        """Whether the closed form is minimum phase."""
        return self.i_eff * self.kappa > 0

    def zeros(self) -> np.ndarray:
        """The two zeros of the passive joint [1/s], without gravity."""
        return np.roots([self.i_eff, self.kappa * self.damping, self.kappa * self.stiffness])


def planar_arm(
    rng: np.random.Generator, distance: float, bent: bool = False, gravity: bool = True
) -> PlanarArm:
    """A random arm with ``I_eff = distance (j + m xi^2)``; ``bent``: with a link angle up to 60
    degrees.
    """
    base = read("planar5_nmp")
    l1 = rng.uniform(0.4, 1.2)
    l2 = rng.uniform(0.2, 0.8)
    m = rng.uniform(2.0, 40.0)
    xi = rng.uniform(0.05, 0.4)
    j = m * xi**2 * rng.uniform(0.2, 3.0)
    length = (1 - distance) * (j + m * xi**2) / (m * xi)
    stiffness = m * length**2 * rng.uniform(200.0, 900.0) ** 2
    damping = stiffness * rng.uniform(1e-4, 2e-3)
    while True:
        pose = (
            float(rng.uniform(-2.0, 2.0)),
            float(rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 2.6)),
        )
        bend = float(rng.uniform(-1.0, 1.0)) if bent else 0.0
        kappa = 1 + length * math.sin(pose[1] + bend) / (l2 * math.sin(pose[1]))
        if abs(kappa) > 0.1:
            break
    c = math.cos(bend)
    s = math.sin(bend)
    turn = ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))
    arm1, arm2, arm3 = base.elements

    def slender(mass: float, span: float) -> Body:
        moment = mass * span**2 / 12
        return Body(mass, (span / 2, 0.0, 0.0), ((moment, 0, 0), (0, moment, 0), (0, 0, moment)))

    elements = (
        replace(arm1, body=slender(rng.uniform(5.0, 80.0), l1)),
        replace(arm2, origin=Placement((l1, 0.0, 0.0)), body=slender(rng.uniform(5.0, 60.0), l2)),
        replace(
            arm3,
            origin=Placement((l2, 0.0, 0.0), turn),
            body=Body(m, (xi, 0.0, 0.0), ((j, 0, 0), (0, j, 0), (0, 0, j))),
            dofs=(replace(arm3.dofs[0], spring=LinearSpring(stiffness), damping=damping),),
        ),
    )
    model = replace(
        base,
        elements=elements,
        tool=Placement((length, 0.0, 0.0)),
        gravity=base.gravity if gravity else (0.0, 0.0, 0.0),
        home=pose,
    )
    return PlanarArm(model, pose, j + m * xi**2 - m * xi * length, kappa, damping, stiffness)
