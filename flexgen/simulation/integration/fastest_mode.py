"""The fastest mode of a robot at a state, which limits the steps of an integrator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.model.elements import RobotModel
from flexgen.model.friction import steepness

# Ratio of the steps of an explicit method to those of an oscillation, which an implicit one needs
# too: at most.
BESIDE = 30.0


@dataclass(frozen=True)
class Mode:
    """A mode of the linearized equations of motion.

    ``value`` [1/s]: its eigenvalue; ``place``: the motor or coordinate whose speed it changes
    most.
    """

    value: complex
    place: str

    @property
    def oscillates(self) -> bool:
        """Whether it turns faster than it decays or grows: implicit methods gain nothing there."""
        return abs(self.value.imag) > abs(self.value.real)


def fastest_mode(model: RobotModel, A: np.ndarray) -> Mode:
    """The mode with the largest eigenvalue of ``A`` (2n, 2n), of q_a, q_me and their speeds.

    An oscillation that is up to `BESIDE` times slower comes first: it keeps the steps of every
    method short.
    """
    n = model.dof
    values, vectors = np.linalg.eig(A[: 2 * n, : 2 * n])
    sizes = np.abs(values)
    turning = np.where(np.abs(values.imag) > np.abs(values.real), sizes, 0.0)
    k = int(np.argmax(turning if BESIDE * turning.max() >= sizes.max() else sizes))
    # arm coordinates on the motor side, so that the sizes of all speeds compare
    scale = np.ones(n)
    scale[list(model.i_g)] = np.abs(model.eta).max(axis=0)
    i = int(np.argmax(np.abs(vectors[n:, k]) * scale))
    if i >= model.n_a:
        return Mode(complex(values[k]), f"motor {model.motors[model.i_m[i - model.n_a]].name}")
    return Mode(complex(values[k]), f"coordinate {model.coordinates[i].name}")


def mode_text(model: RobotModel, mode: Mode) -> str:
    """The fastest mode in words, and the number of the model to change."""
    if mode.oscillates:
        frequency = abs(mode.value) / (2 * np.pi)
        return (
            f"the fastest mode oscillates at {frequency:.3g} Hz ({mode.place}); use a softer "
            'spring, a larger inertia, or a rigid gear: gear = { type = "rigid" }'
        )
    frictions = {f"motor {motor.name}": motor.friction for motor in model.motors}
    for j, i in enumerate(model.i_g):
        dof = model.coordinates[i].dof
        assert dof is not None
        rigid = j if dof.gear is not None and dof.gear.rigid else None
        if steepness(dof.friction) or rigid is None:
            frictions[f"coordinate {dof.name}"] = dof.friction
        else:
            driving = [m for m in model.motors if dof.name in m.drives]
            steepest = max(driving, key=lambda motor: steepness(motor.friction))
            frictions[f"coordinate {dof.name}"] = steepest.friction
    friction = frictions.get(mode.place)
    rate = f"{abs(mode.value):.3g} 1/s"
    if friction is None or not steepness(friction):
        return (
            f"the fastest mode decays with {rate} ({mode.place}); check its damping, friction and "
            "inertia"
        )
    return (
        f"near rest the friction of {mode.place} slows it down with {rate}; use a smaller beta "
        f"(given {friction.beta:.4g}: fully developed above a speed of {2 / friction.beta:.2g}), "
        "or a larger inertia"
    )
