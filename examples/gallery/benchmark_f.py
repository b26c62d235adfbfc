"""Benchmark F: regulation of one robot axis, four masses and a nonlinear gear."""

import numpy as np
from exhibit import Page, exhibit

import flexgen

QUESTION = "How well can one motor regulate four masses behind a nonlinear gear?"
LITERATURE = """
S. Moberg, J. Oehr, S. Gunnarsson, A benchmark problem for robust feedback control of a flexible \
manipulator, IEEE
Trans. Control Systems Technology 17(6), 2009: the model. Windows, sets of robots and weights are \
of this project
(version 1, frozen by its hash), so that scores are not those of the paper. Smaller is better; \
the reference has about
1. No controller is accepted that is unstable on one of 17 robots, with a longer delay, or with a \
larger gain.
"""
CONTROLLERS = ("reference", "ppi", "ppi_notch", "ppi_two_notches")
SHOWN = ("reference", "ppi_two_notches")


def show(page: Page) -> None:
    """Scores of the controllers that come with flexgen; the arm's position under the
    disturbances.
    """
    found = {name: flexgen.score("four_mass", name, progress=False) for name in CONTROLLERS}
    parts = list(found["reference"].parts)
    page.table(
        ["controller", "V", *parts],
        [[n, s.total, *(s.parts[p] for p in parts)] for n, s in found.items()],
    )

    top, bottom = page.figure(4.0).subplots(2, 1, sharex=True)
    for name in SHOWN:
        traces = found[name].traces
        t = np.linspace(0.0, 36.0, len(traces["z"]))  # s
        top.plot(t, traces["z"][:, 0], lw=0.9, label=name)
        bottom.plot(t, traces["u"][:, 0], lw=0.6)
    top.set_ylabel("tool position, mm")
    bottom.set_ylabel("motor torque, N m")
    bottom.set_xlabel("time, s")
    top.legend(loc="lower right", ncols=2)


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
