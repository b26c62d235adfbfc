"""The shortest time along a straight line of the tool: the time law is free, torques are limited.

Run: python examples/minimum_time.py
"""

import casadi as ca
import numpy as np

import flexgen

given = flexgen.solve("planar5_nmp", "line")
torque = np.abs(given.trajectory["tau_m"]).max(axis=0)  # the limits that flexgen.fastest takes

problem = flexgen.plan_problem(
    "planar5_nmp", "line", mesh=100, timing="free", limits=flexgen.Limits(tuple(torque))
)
problem.free_time(0.2, 1.0)
problem.add_cost(problem.duration, at="end")
# of several torques the calmest
problem.add_cost(1e-6 * ca.sumsqr(ca.diff(problem.nodes("tau_m").T)))
problem.follow(tolerance=1e-6)
solution = problem.solve(guess=given)
fastest = flexgen.fastest(
    "planar5_nmp", "line", coefficients=40, limits=flexgen.Limits(tuple(torque))
)

print("motion                      duration   from the path")
for name, duration, error in (
    ("as given                ", given.move.duration, given.tool_error_max_m),
    ("fastest, spline time law", fastest.duration_s, fastest.solution.tool_error_max_m),
    ("planned, free time law  ", solution.move.duration, solution.path_distance_max_m),
):
    print(f"{name}  {duration:.4f} s   {1e6 * error:.4f} um")
print(f"rigid robot, at least     {fastest.rigid_s:.4f} s")
print(solution.status)
solution.plot().savefig("minimum_time.png")
