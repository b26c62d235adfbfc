"""Motors that sit on moving links: the tool error of torques that leave the motion of the links
out.
"""

import numpy as np
from exhibit import Page, exhibit

import flexgen

QUESTION = "What does it cost to forget that a motor turns with the link that carries it?"
LITERATURE = """
Most controllers take the rotor's energy as that of its spin alone (M. W. Spong, 1987). \
The complete coupling raises the order of the derivatives of the path that the torques need \
(P. Tomei, 1991; A. De Luca and P. Lucibello, 1998).
"""
ROBOT = "planar5_nmp@coupled"
# kg m^2: of the rotor of the second motor, on the first link
ROTORS = (0.001, 0.0025, 0.01)


def largest(solution: flexgen.Solution) -> float:
    """Largest tool error in simulation [um]."""
    return 1e6 * float(solution.tool_error_max_m or 0.0)


def show(page: Page) -> None:
    """Tool errors with and without the coupling, and the torque that makes the difference."""
    axes = page.figure(3.2).subplots(1, 1)
    rows = []
    for inertia in ROTORS:
        robot = flexgen.read(ROBOT, overrides={"motor.m2.inertia": inertia})
        equations = flexgen.derive(robot)
        exact = flexgen.solve(equations)
        careless = flexgen.solve(equations, method="simplified")
        torques = [x.trajectory["tau_m"] for x in (exact, careless)]
        missing = torques[0] - torques[1]
        rows.append(
            [f"{inertia:g}", largest(careless), largest(exact), float(np.abs(missing).max())]
        )
        axes.plot(exact.trajectory.time, missing[:, 0], label=f"rotor {inertia:g} kg m^2")
    axes.set(xlabel="time, s", ylabel="torque left out, motor 1, N m")
    axes.legend()
    page.table(
        ["rotor, kg m^2", "without the coupling, um", "with it, um", "torque left out, N m"], rows
    )


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
