"""Feedback linearization against feedforward, on the same measurements."""

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.feedback.laws.study import FAMILIES, Setting

QUESTION = (
    "Is it better to linearize an elastic arm by feedback, or to put feedback around its "
    "feedforward?"
)
LITERATURE = """
The question is that of S. Moberg and S. Hanssen, On feedback linearization for robust tracking \
control of flexible
joint robots, IFAC World Congress 2008. Linearizing feedback of elastic joints needs the arm's \
state up to its third
derivative: M. Spong, J. Dyn. Sys. Meas. Control 109, 1987. Six robots (other stiffness, other \
load, disturbances),
measured angles with noise, and the best of eight tunings of each law; docs/control.md has the \
table of twenty tunings
and with delay.
"""
SETTING = Setting(sample_s=5e-4, delay_s=0.0, exact=False)
NOISE_NM = 4.0  # peak to peak at rest; tunings with more do not count


def show(page: Page) -> None:
    """Worst error of the six robots at the best tuning of each law; all tunings over their torque
    noise.
    """
    study = flexgen.feedback_study(
        settings=(SETTING,), tunings=8, torque_noise=NOISE_NM, progress=False
    )
    rows = []
    for family in FAMILIES:
        best = study.best(SETTING, family)
        if best is not None:
            rows.append(
                [
                    family,
                    best.tuning,
                    1e3 * best.error_m[0],
                    1e3 * best.worst_m,
                    best.torque_noise_Nm,
                ]
            )
    page.table(
        ["law", "best tuning", "model itself, mm", "worst robot, mm", "torque noise, N m"], rows
    )

    axes = page.figure().subplots()
    for family in FAMILIES:
        good = [t for t in study.of(SETTING, family) if np.isfinite(t.worst_m) and t.worst_m < 0.1]
        noise = [t.torque_noise_Nm for t in good]
        error = [1e3 * t.worst_m for t in good]
        axes.loglog(noise, error, "o", ms=5, label=family)
    axes.axvline(NOISE_NM, color="k", lw=0.7, ls="--")
    axes.set_xlabel("torque noise at rest, peak to peak, N m (dashed: limit of the table)")
    axes.set_ylabel("worst error of six robots, mm")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
