"""Benchmark G: regulation of an arm with two links, two motors and nonlinear gears."""

import numpy as np
from exhibit import Page, exhibit

import flexgen

QUESTION = "How well do two motors regulate a two-link arm with friction and nonlinear gears?"
LITERATURE = """
S. Moberg, Modeling and Control of Flexible Manipulators, 2010, names a multivariable benchmark \
as the next step after
that for one axis. All numbers of the scenario two_link are of this project (version 1, frozen by \
its hash). Smaller
is better; the reference controller has about 1.
"""


def show(page: Page) -> None:
    """Scores, and the output of the arm under the reference controller and a tuned one."""
    scores = {
        name: flexgen.score("two_link", name, progress=False) for name in ("reference", "ppi")
    }
    parts = list(scores["reference"].parts)
    page.table(
        ["controller", "V", *parts],
        [[n, s.total, *(s.parts[p] for p in parts)] for n, s in scores.items()],
    )
    length = scores["reference"].scenario.duration_s
    for k, axes in enumerate(page.figure(4.0).subplots(2, 1, sharex=True)):
        for name, score in scores.items():
            z = score.traces["z"]
            axes.plot(np.linspace(0.0, length, len(z)), z[:, k] - z[0, k], lw=0.9, label=name)
        axes.set_ylabel(f"tool, {'xz'[k]}, mm")
    axes.set_xlabel("time, s")
    axes.legend(loc="lower right", ncols=2)


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
