"""Minimum phase: the inverse dynamics is an initial value problem, and many solvers agree."""

import time

import numpy as np
from exhibit import Page, exhibit

import flexgen

QUESTION = "Where all zeros are stable: do different solvers find the same torques?"
LITERATURE = """
Index reduction by dummy derivatives: S. Mattsson and G. Söderlind, SIAM J. Sci. Comput. 14, \
1993. Regularization: P.
Kunkel and V. Mehrmann, 2006. BDF of high index with constant steps, with a torque that is late \
by a step: K. Brenan,
S. Campbell, L. Petzold, 1996. Stable inversion solves the whole path at once and needs no \
stability: S. Devasia, D.
Chen, B. Paden, IEEE Trans. Automatic Control 41, 1996. lq and bvp have intervals of 9 ms here, \
the others steps of 1
ms and less.
"""
METHODS = {
    "lq": ("lq", None),
    "bvp": ("bvp", None),
    "reduced": ("reduced", None),
    "kunkel-mehrmann": ("kunkel-mehrmann", None),
    "bdf, order 1": ("bdf", {"order": 1, "richardson": False}),
    "bdf, order 3": ("bdf", {"order": 3}),
}


def show(page: Page) -> None:
    """Torques of all methods for a line of planar5_mp, compared with those of bvp, and their tool
    errors.
    """
    found = {}
    t = np.linspace(0.0, 0.5, 501)
    for name, (method, options) in METHODS.items():
        begin = time.perf_counter()
        solution = flexgen.solve("planar5_mp", "line", method, options=options, progress=False)
        found[name] = (
            solution.trajectory.at(t)["tau_m"],
            solution.tool_error_max_m,
            time.perf_counter() - begin,
        )
    best = found["reduced"][0]
    difference = {name: np.abs(tau - best).max(axis=1) for name, (tau, _, _) in found.items()}
    rows = [
        [name, float(difference[name].max()), 1e6 * (error or 0.0), seconds]
        for name, (_, error, seconds) in found.items()
    ]
    page.table(
        [
            "method",
            "torque: difference from reduced, N m",
            "tool error, um",
            "time with verification, s",
        ],
        rows,
    )

    left, right = page.figure(3.6).subplots(1, 2)
    left.plot(t, best)
    left.set_ylabel("motor torques, N m")
    for name, values in difference.items():
        if name != "reduced":
            style = {"ls": "--", "zorder": 3} if name == "lq" else {}
            right.semilogy(t, np.maximum(values, 1e-14), lw=1.0, label=name, **style)
    right.set_ylabel("difference from reduced, N m")
    right.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    left.set_xlabel("time, s")
    right.set_xlabel("time, s")


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
