"""Six axes with 18 degrees of freedom move around a ball in the way of the tool.

Run: python examples/obstacle_avoidance.py
"""

import time

import numpy as np

import flexgen

began = time.perf_counter()
robot = flexgen.derive("manutec_r3_18")
problem = flexgen.plan_problem(robot, "line", mesh=100)
straight = problem.path.sample(np.linspace(0.0, problem.path.duration, 201)).y[:, :, 0]
center = straight[100] - [0.0, 0.05, 0.0]
radius = 0.1
problem.add_squares(problem["a_m"] / 100)  # smooth motors
problem.avoid(flexgen.Sphere(tuple(center), radius), samples=1)
solution = problem.solve(accuracy=5e-5)


def clearance(points) -> float:
    """Least distance of the tool from the ball [m]."""
    return float(np.linalg.norm(points - center, axis=1).min() - radius)


tool = np.array([robot.function("output")(q) for q in solution.trajectory["q_a"]])[:, :, 0]
print("motion          clearance of the tool")
print(f"straight line {1e3 * clearance(straight):10.1f} mm")
print(f"planned       {1e3 * clearance(tool):10.1f} mm")
print(
    f"simulated {1e6 * solution.plan_error_max_m:.1f} um, "
    f"{1e6 * solution.plan_error_max_rad:.1f} urad from the plan"
)
print(f"{solution.iterations} iterations")
print(f"{solution.status}, {time.perf_counter() - began:.1f} s in all")
solution.plot().savefig("obstacle_avoidance.png")
