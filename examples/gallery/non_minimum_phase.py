"""Non-minimum phase: torques that begin before the path."""

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.base.errors import FlexgenError

QUESTION = (
    "Why must the torque of an elastic arm begin before its tool moves, and how long before?"
)
LITERATURE = """
The zero dynamics has an unstable part, which only decays backwards in time: the bounded solution \
begins before the
path (S. Devasia, D. Chen, B. Paden, IEEE Trans. Automatic Control 41, 1996). Before the path it \
decays by a factor of
e in each time constant of the unstable zero, until it reaches the accuracy of the solver; \
flexgen previews ln(10^6),
about 14 of them.
"""
CONSTANTS = (2.0, 4.0, 6.0, 8.0)  # time constants before the path


def show(page: Page) -> None:
    """The torque before the path, compared with the exponential that the unstable zero
    predicts.
    """
    model = flexgen.read("planar5_nmp@soft")
    report = flexgen.analyze(model, model.move("line").start).zeros
    constant = report.unstable_time_constant_s
    print(
        f"  {report.phase}: zero at +{1 / constant:.1f} 1/s, preview "
        f"{1e3 * report.preview_s:.0f} ms"
    )
    try:
        flexgen.solve(model, "line", "reduced")
    except FlexgenError as error:
        print(f"  an initial value method refuses: {error}\n")
    solution = flexgen.solve(model, "line", progress=False)
    trajectory = solution.trajectory
    t = trajectory.time
    tau = trajectory["tau_m"]
    change = np.abs(tau - tau[0])
    early = [np.abs(trajectory.at(-n * constant)["tau_m"] - tau[0]) for n in (1.0, *CONSTANTS)]
    rows = [
        [
            n,
            -1e3 * n * constant,
            *map(float, found),
            *map(float, found / early[0] * np.exp(n - 1.0)),
        ]
        for n, found in zip(CONSTANTS, early[1:], strict=True)
    ]
    header = ["time constants", "ms", "m1, N m", "m2, N m", "m1 / exponential", "m2 / exponential"]
    page.table(header, rows)
    print(f"  tool error in simulation: {1e9 * (solution.tool_error_max_m or 0.0):.1f} nm\n")

    left, right = page.figure().subplots(1, 2)
    left.plot(1e3 * t, tau - tau[0])
    left.axvline(0.0, color="k", lw=0.7)
    left.set_xlim(-75, 5)
    left.set_ylim(-0.025, 0.025)
    left.set_ylabel("change of the motor torques, N m")
    before = t <= 0
    right.semilogy(1e3 * t[before], change[before])
    right.semilogy(
        1e3 * t[before],
        change[before][-1, 0] * np.exp(t[before] / constant),
        "k--",
        label="exp(zero t)",
    )
    right.set_ylim(1e-8, 10)
    right.legend(["m1", "m2", "exponential of the zero"])
    for axes in (left, right):
        axes.set_xlabel("time, ms (0: the tool begins to move)")


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
