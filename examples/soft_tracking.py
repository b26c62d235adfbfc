"""An arm whose motors are too weak for its path: the tool follows as well as the torques allow.

Run: python examples/soft_tracking.py
"""

import casadi as ca
import numpy as np

import flexgen

exact = flexgen.solve("planar5_nmp@soft", "line")
needed = np.abs(exact.trajectory["tau_m"]).max(axis=0)
print("torques of exact tracking:", needed.round(2), "N m")
print("torque limits   tool from its reference   tool from the path   status")
for share in (1.0, 0.9, 0.8):
    limits = flexgen.Limits(torque=tuple(share * needed))
    problem = flexgen.plan_problem("planar5_nmp@soft", "line", mesh=100, limits=limits)
    # 1 mm counts as much as 1 rad of the other terms
    problem.add_squares(1e3 * problem.output_error)
    problem.add_cost(1e-6 * ca.sumsqr(ca.diff(problem.nodes("tau_m").T)))
    solution = problem.solve(guess="lq")
    print(
        f"{share:13.0%} {1e3 * solution.tool_error_max_m:21.3f} mm "
        f"{1e3 * solution.path_distance_max_m:17.3f} mm   {solution.status}"
    )
solution.plot().savefig("soft_tracking.png")
