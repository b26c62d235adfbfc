"""Nonlinear gears and friction: the laws, and what they do to the natural frequencies."""

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.base.numerics.evaluate import evaluate

QUESTION = "How do a gear that stiffens with its load, and friction, look in the model?"
LITERATURE = """
Natural frequencies of the benchmark of S. Moberg, J. Oehr and S. Gunnarsson (IEEE Trans. Control \
Systems Technology
17, 2009), linear gears: 8.82, 14.44, 41.61 Hz (low) and 12.40, 19.12, 54.66 Hz (high). Friction \
law and values of the
robot axis: E. Wernholt and S. Gunnarsson, SYSID 2006; the Stribeck effect makes it fall before \
it rises.
"""
PUBLISHED = {"four_mass@low": (8.82, 14.44, 41.61), "four_mass@high": (12.40, 19.12, 54.66)}
RATIO = 220.0  # of the gear of four_mass: the law is given on the motor side


def show(page: Page) -> None:
    """Modes of the linear variants compared with the published ones; gear torque and friction
    torque as curves.
    """
    rows = []
    for name in ("four_mass@low", "four_mass@high", "four_mass"):
        modes = [f for f, _ in flexgen.analyze(name).modes]
        rows.append(
            [
                name,
                *(f"{f:.2f}" for f in modes),
                " ".join(f"{f:.2f}" for f in PUBLISHED.get(name, ())) or "-",
            ]
        )
    page.table(["model", "mode 1, Hz", "mode 2", "mode 3", "published, Hz"], rows)

    gear, friction = page.figure().subplots(1, 2)
    deflection = np.linspace(-0.2, 0.2, 401)  # rad, motor side
    for variant in ("four_mass", "four_mass@piecewise", "four_mass@low", "four_mass@high"):
        law = flexgen.derive(variant).function("gear_law")
        torque = evaluate(law, (deflection / RATIO)[:, None])[0][:, 0] / RATIO
        gear.plot(deflection, torque.ravel(), label=variant.partition("@")[2] or "smooth", lw=1.2)
    gear.set_xlabel("deflection, rad (motor side)")
    gear.set_ylabel("gear torque, N m")
    gear.legend()
    speed = np.linspace(-20, 20, 801)  # rad/s
    torque = evaluate(flexgen.derive("abb_arm").function("motor_friction"), speed[:, None])[0]
    friction.plot(speed, torque.ravel())
    friction.set_xlabel("motor speed, rad/s")
    friction.set_ylabel("friction torque, N m")


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
