"""Rigid, flexible joint and extended flexible joint model: what a simpler model costs."""

from dataclasses import replace

from exhibit import Page, exhibit

import flexgen

QUESTION = "How far off the path is an elastic arm under the torques of a simpler model?"
LITERATURE = """
The flexible joint model has springs in the joints about the motors' axes only (M. Spong, J. Dyn. \
Sys. Meas. Control
109, 1987). Real arms also bend across these axes; the extended model adds springs without motor, \
and its inverse
dynamics is a differential-algebraic equation (S. Moberg and S. Hanssen, ICRA 2007). There is no \
feedback here: an arm
that nothing holds drifts, so that a static deflection that a simple model does not know costs \
more in a slow move.
"""
METHODS = {
    "rigid": "rigid",
    "fjm": "flexible joints",
    "quasistatic": "and static deflections",
    "lq": "extended",
}
DURATIONS = (0.3, 0.6, 1.2)  # s


def show(page: Page) -> None:
    """Tool error of four models over the duration of a line, simulated without feedback."""
    model = flexgen.read("planar5_nmp")
    errors = {method: [] for method in METHODS}
    for duration in DURATIONS:
        move = replace(model.move("line"), duration=duration)
        for method, found in errors.items():
            solution = flexgen.solve(model, move, method, progress=False)
            found.append(1e6 * (solution.tool_error_max_m or 0.0))
    header = ["torques from the model", *(f"{d} s, um" for d in DURATIONS)]
    page.table(header, [[name, *errors[method]] for method, name in METHODS.items()])

    axes = page.figure().subplots()
    for method, name in METHODS.items():
        axes.semilogy(DURATIONS, errors[method], "o-", label=name)
    axes.set_xlabel("duration of the line, s")
    axes.set_ylabel("largest tool error, µm")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
