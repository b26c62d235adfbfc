"""The move of an elastic arm between two poses with the least energy lost in its motors, in a
given time.

Run: python examples/minimum_energy.py
"""

import casadi as ca

import flexgen

problem = flexgen.plan_problem("planar5_nmp", "line", mesh=60)
problem.add_cost(ca.sumsqr(problem["tau_m"]))  # copper losses grow with the square of the torque
solution = problem.solve()
line = flexgen.solve("planar5_nmp", "line")


def losses(trajectory) -> float:
    """Integral of the squared torques [N^2 m^2 s]."""
    tau = trajectory["tau_m"]
    t = trajectory.time
    return float((((tau[1:] ** 2 + tau[:-1] ** 2) / 2).sum(axis=1) * (t[1:] - t[:-1])).sum())


print("motion           integral of torque^2   largest torque   simulated error")
for name, found, error in (
    ("straight line", line, line.tool_error_max_m),
    ("least losses", solution, solution.plan_error_max_m),
):
    largest = abs(found.trajectory["tau_m"]).max()
    print(
        f"{name:15s} {losses(found.trajectory):18.2f} {largest:16.2f} N m {1e6 * error:14.3f} um"
    )
print(solution.status)
solution.plot().savefig("minimum_energy.png")
