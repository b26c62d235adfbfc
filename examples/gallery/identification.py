"""Identification: stiffness, damping and friction from frequency responses."""

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.analysis.linear import linearize
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.feedback.loop.robustness import hold_motors

QUESTION = (
    "Are the springs and dampers of a robot found from its motors alone, and how accurately?"
)
LITERATURE = """
E. Wernholt and S. Moberg, Nonlinear gray-box identification using local models applied to \
industrial robots,
Automatica 47(6), 2011: multisines at several poses, frequency responses, one fit over all of \
them. About two of three
errors should be below one standard deviation, and nearly all below two.
"""


def show(page: Page) -> None:
    """Parameters of a robot that differs from its file; responses of file, robot and identified
    model.
    """
    model = flexgen.read("planar5_nmp")
    rng = np.random.default_rng(4)
    changes = {
        p.name: p.value * rng.uniform(0.7, 1.3) for p in select(model, ["stiffness", "damping"])
    }
    robot = with_values(model, changes)
    drives = flexgen.DriveHardware(encoder_noise_rad=1e-4, torque_noise_Nm=0.02)
    plan = flexgen.excite(
        model, poses=3, period_s=2.0, lines=40, speed_rms=0.02, hardware=drives, progress=False
    )
    data = flexgen.frf(flexgen.measure(plan, robot, progress=False))
    found = flexgen.identify(model, data, progress=False)
    rows = []
    for true in select(robot, found.vector.names):
        start = select(model, [true.name])[0].value
        value = found.values[true.name]
        sd = found.sd[true.name]
        error = value / true.value - 1
        rows.append([true.name, start, true.value, value, 100 * error, 100 * sd, error / sd])
    page.table(["parameter", "file", "robot", "found", "error, %", "sd, %", "error / sd"], rows)

    hz = np.geomspace(data.w[0], data.w[-1], 400) / (2 * np.pi)
    for k, axes in enumerate(page.figure().subplots(1, 2)):
        axes.loglog(data.w / (2 * np.pi), np.abs(data.G[0, :, k, k]), "k.", ms=4, label="measured")
        for name, one in (("model file", model), ("robot", robot), ("identified", found.model)):
            equations = flexgen.derive(one)
            linear = linearize(
                equations,
                hold_motors(equations, data.poses[0], np.append(data.poses[0] / 100.0, 0.0)),
            )
            response = linear.response(2 * np.pi * hz, linear.C_m)[:, k, k] * (2 * np.pi * hz) ** 2
            axes.loglog(
                hz, np.abs(response), lw=1.0, ls="--" if name == "identified" else "-", label=name
            )
        axes.set_xlabel("frequency, Hz")
        axes.set_title(f"acceleration of motor {k + 1} / its torque, rad/s² / N m")
    axes.legend()


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
