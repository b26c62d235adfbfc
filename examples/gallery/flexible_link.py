"""A flexible link by assumed modes: how many are needed, and what they do to the tip."""

from typing import Any

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.beam import root_with_tip
from flexgen.dynamics.mechanics.equations import Equations

QUESTION = (
    "How many modes does an elastic link need, and why does its tip begin to move backwards?"
)
LITERATURE = """
A uniform cantilever has w_k = (b_k/l)^2 sqrt(EI/m) with b = 1.8751, 4.6941, 7.8548, roots of cos \
b cosh b = -1 (e.g.
L. Meirovitch, Fundamentals of Vibrations, 2001, ch. 8). The tip of a link that a motor turns at \
its hub is
non-minimum phase (R. Cannon and E. Schmitz, Int. J. Robotics Research 3(3), 1984): zeros on both \
sides.
"""
EXACT = np.array([1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349])
MODES = (1, 2, 3, 4)


def beam(modes: int, more: dict[str, Any] | None = None) -> Equations:
    """The arm with this number of modes, without load and gravity, with ``more`` changes."""
    bending = [{"direction": "y", "stiffness": 200.0, "modes": modes, "damping_ratio": 0.0}]
    changes = {
        "element.fore.beam.bending": bending,
        "payload": {"mass": 0.0},
        "gravity": [0.0, 0.0, 0.0],
        **(more or {}),
    }
    return flexgen.derive(flexgen.read("beam_arm", overrides=changes))


def frequencies(equations: Equations, n: int) -> np.ndarray:
    """Natural frequencies of the beam with a clamped hub (n,) [Hz]."""
    rest = np.zeros(2 + n)
    e = list(equations.model.i_e)
    M = evaluate(equations.function("mass_matrix"), rest)[0][0][np.ix_(e, e)]
    steps = np.zeros((n, 2 + n))
    steps[:, e] = np.eye(n)
    K = -evaluate(equations.function("elastic_torque"), steps, np.zeros((n, 2 + n)))[0].reshape(
        n, n
    )
    return np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)) / (2 * np.pi)


def loads() -> list[list[str]]:
    """Second natural frequency with a load at the tip by both kinds of modes, and exactly."""
    rows = []
    for ratio in (0.0, 0.5, 2.0):
        mass = ratio * 0.8  # kg, of a beam of 0.8 m with 1 kg/m
        found = []
        for tip in ({}, {"mass": mass}):
            changes = {"element.fore.beam.tip": tip, "payload": {"mass": mass}}
            found.append(f"{frequencies(beam(2, changes), 2)[1]:.3f}")
        exact = root_with_tip(2, ratio, 0.0) ** 2 / 0.8**2 * np.sqrt(200.0) / (2 * np.pi)
        rows.append([f"{ratio:g}", *found, f"{exact:.3f}"])
    return rows


def show(page: Page) -> None:
    """Frequencies with a clamped hub compared with the exact ones; zeros from the hub's motor to
    the tip.
    """
    rows = []
    zeros = []
    # length 0.8 m, EI 200 N m^2, 1 kg/m
    exact = EXACT**2 / 0.8**2 * np.sqrt(200.0 / 1.0) / (2 * np.pi)
    for n in MODES:
        equations = beam(n)
        hz = frequencies(equations, n)
        zeros.append(flexgen.analyze(equations).zeros.zeros)
        slowest = min(z for z in zeros[-1].real if z > 0)
        rows.append([n, *(f"{f:.3f}" for f in hz), *("-" for _ in range(4 - n)), f"{slowest:.1f}"])
    rows.append(["exact", *(f"{f:.3f}" for f in exact), "-"])
    page.table(["modes", "clamped, Hz: 1", "2", "3", "4", "slowest unstable zero, 1/s"], rows)

    page.table(["load / beam", "2 modes of a free tip, Hz", "2 modes with tip", "exact"], loads())

    axes = page.figure(2.8).subplots()
    for n, values in zip(MODES, zeros, strict=True):
        text = f"{n} mode" if n == 1 else f"{n} modes"
        axes.plot(values.real, np.full(len(values), n), "o", ms=5, label=text)
    axes.axvline(0.0, color="k", lw=0.7)
    axes.set_xscale("symlog", linthresh=100)
    axes.set_yticks(MODES)
    axes.set_ylabel("modes")
    axes.legend(loc="upper left", fontsize=8)
    axes.set_xlabel("real part of the zeros from the motors to the tip, 1/s")


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
