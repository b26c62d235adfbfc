"""The DAE solvers: how fast the error of each falls with its step."""

import numpy as np
from exhibit import Page, exhibit

import flexgen

QUESTION = "How does the error of each solver of the inverse dynamics fall with its step?"
LITERATURE = """
BDF of index up to 3, and what is lost beyond it: K. Brenan, S. Campbell, L. Petzold, Numerical \
Solution of Initial-
Value Problems in Differential-Algebraic Equations, 1996. Regularization by the derivative array: \
P. Kunkel, V.
Mehrmann, Differential-Algebraic Equations, 2006. Dummy derivatives, solved here by an explicit \
method with error
control: S. Mattsson, G. Söderlind, SIAM J. Sci. Comput. 14, 1993. The reference is the same \
method with a tolerance
of 1e-11. A DAE of index 4 differentiates rounding three times: with short steps BDF of higher \
order becomes worse.
"""
STEPS = (4e-3, 2e-3, 1e-3)
METHODS = {
    "bdf, order 1": ("bdf", {"order": 1}),
    "bdf, order 2": ("bdf", {"order": 2}),
    "bdf, order 3": ("bdf", {"order": 3}),
    "kunkel-mehrmann": ("kunkel-mehrmann", None),
}
TOLERANCES = (1e-6, 1e-8)


def show(page: Page) -> None:
    """Largest torque error on a line of planar5_mp, away from the ends, and the order between two
    steps.
    """
    t = np.linspace(0.1, 0.4, 301)  # the beginning differs: BDF starts with a lower order

    def torques(
        method: str, options: dict[str, object] | None, mesh: float | None = None
    ) -> np.ndarray:
        solution = flexgen.solve(
            "planar5_mp", "line", method, mesh=mesh, options=options, progress=False
        )
        return np.asarray(solution.trajectory.at(t)["tau_m"])

    exact = torques("reduced", {"rtol": 1e-11})
    axes = page.figure(3.6).subplots()
    rows = []
    for name, (method, options) in METHODS.items():
        errors = [float(np.abs(torques(method, options, step) - exact).max()) for step in STEPS]
        order = float(np.log2(errors[0] / errors[1]))
        rows.append([name, *errors, order])
        axes.loglog(1e3 * np.array(STEPS), errors, "o-", label=name)
    page.table(
        ["method", *(f"{1e3 * step:g} ms: error, N m" for step in STEPS), "order, 4 to 2 ms"], rows
    )
    controlled = [
        float(np.abs(torques("reduced", {"rtol": rtol}) - exact).max()) for rtol in TOLERANCES
    ]
    page.table(
        ["method", *(f"tolerance {rtol:g}: error, N m" for rtol in TOLERANCES)],
        [["reduced", *controlled]],
    )
    axes.set_xlabel("step, ms")
    axes.set_ylabel("largest error of a torque, N m")
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
