"""The index of inverse dynamics, by ranks (Kunkel and Mehrmann) and by structure (Pryce)."""

from exhibit import Page, exhibit

import flexgen

QUESTION = "How often must the equations be differentiated before the torques can be computed?"
LITERATURE = """
The hypothesis of P. Kunkel and V. Mehrmann, Differential-Algebraic Equations, 2006, sec. 4.3: a \
algebraic and d
differential equations after mu differentiations; the differential index is mu + 1. J. Pryce's \
structural analysis
(BIT 41, 2001) finds it from the pattern. With n_m motors, n_g gears, n_e coordinates without \
motor: a = 4 n_m and d =
n_g + 2 n_e with damped gears, a = 5 n_m and d = 2 n_e without damping. A continuous torque needs \
index - 1 continuous
derivatives of the path.
"""
MODELS = (
    "elbow@rigid",
    "elbow",
    "planar5_mp",
    "planar5_nmp",
    "planar5_nmp@undamped",
    "beam_arm",
    "four_mass",
)
SHOWN = ("planar5_nmp", "planar5_nmp@undamped")


def show(page: Page) -> None:
    """Table of all models; the signature matrices of two: orders of derivatives in each
    equation.
    """
    rows = []
    found = {name: flexgen.analyze(name) for name in MODELS}
    for name, analysis in found.items():
        k = analysis.kunkel_mehrmann
        model = analysis.model
        rows.append(
            [name, f"{model.n_m}/{model.n_g}/{model.n_e}", k.mu, k.a, k.d, k.differential_index]
        )
        rows[-1] += [analysis.structural_index, f"C{k.path_smoothness}", f"{k.gap:.0e}"]
    page.table(
        [
            "model",
            "n_m/n_g/n_e",
            "mu",
            "a",
            "d",
            "index",
            "by structure",
            "path",
            "gap of the ranks",
        ],
        rows,
    )

    for axes, name in zip(page.figure(4.2).subplots(1, 2), SHOWN, strict=True):
        s = found[name].structure
        for i, row in enumerate(s.sigma):
            for j, order in enumerate(row):
                if order > -1:
                    axes.text(j, i, str(int(order)), ha="center", va="center", fontsize=9)
        axes.set_xlim(-0.5, len(s.unknowns) - 0.5)
        axes.set_ylim(len(s.equations) - 0.5, -0.5)
        axes.set_xticks(range(len(s.unknowns)), s.unknowns, rotation=90)
        axes.set_yticks(range(len(s.equations)), s.equations)
        axes.set_title(f"{name}: index {s.index}")
        axes.set_xlabel("number: highest derivative of an unknown in an equation")


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
