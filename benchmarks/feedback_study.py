"""Feedforward or feedback linearization: writes benchmarks/feedback_study.md and a picture of docs
(three minutes).

The times of a step are the best of several runs in this process; everything else is deterministic.
"""

from __future__ import annotations

import platform
import sys
from pathlib import Path

import numpy as np

import flexgen
from flexgen.feedback.laws.chain import largest_frequency
from flexgen.feedback.laws.study import ARM, FAMILIES, FeedbackStudy, feedback_study
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.control import case_controller, run_case
from flexgen.feedback.loop.timing import Timing

TARGET = Path(__file__).with_suffix(".md")
PICTURE = Path(__file__).resolve().parent.parent / "docs" / "pictures" / "feedback_study.svg"
ROUNDS = 40
RESOLUTION_US = 0.2  # differences below it are those of the machine


def robots(study: FeedbackStudy) -> str:
    """Errors of all robots at the best tunings [mm]."""
    out = []
    for setting in study.settings:
        how = "state exact" if setting.exact else "measured angles"
        lines = [
            "| feedback | tuning | " + " | ".join(study.plants) + " |",
            "|" + "---|" * (len(study.plants) + 2),
        ]
        for family in FAMILIES:
            best = study.best(setting, family)
            if best is not None:
                errors = " | ".join(f"{1e3 * x:.3f}" for x in best.error_m)
                lines.append(f"| {family} | {best.tuning} | {errors} |")
        out.append(f"### {setting}, {how}\n\n" + "\n".join(lines) + "\n")
    return "\n".join(out)


def bounds() -> str:
    """Largest w h of the chain of four integrators."""
    lines = ["| gains, delay | without prediction | predicted |", "|---|---|---|"]
    for form in ("continuous", "discrete"):
        for delay in (0.0, 1.0):
            found = [
                2 * np.pi * largest_frequency(4, form, Timing(1.0, delay, p))
                for p in (False, True)
            ]
            cells = " | ".join(f"{x:.4f}" if x < np.pi else "all" for x in found)
            lines.append(f"| {form}, {'one sample' if delay else 'none'} | {cells} |")
    return "\n".join(lines) + "\n"


def steps() -> str:
    """Time of one step of each law in C, less that of feedforward alone [us]."""
    solution = flexgen.solve(ARM, progress=False)
    case = control_case(ARM, sample_time=1e-3, delay=1e-3, solution=solution)
    laws = (
        flexgen.FeedbackLinearisation(16.0),
        flexgen.FeedbackLinearisation(16.0, predict=True),
        flexgen.ComputedTorque(2.0),
        flexgen.JointTorqueFeedback(),
        flexgen.TomeiPD(),
        flexgen.LQ(),
    )
    made = [case_controller(case, law) for law in ("none", *laws)]
    seconds = [min(run_case(case, *one).wall_s for _ in range(ROUNDS)) for one in made]
    lines = ["| law | us a step |", "|---|---|"]
    for (_, name), time in zip(made[1:], seconds[1:], strict=True):
        own = 1e6 * (time - seconds[0]) / len(case.reference.time)
        lines.append(
            f"| {name} | {f'{own:.1f}' if own >= RESOLUTION_US else f'< {RESOLUTION_US}'} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the page and the picture; ``--quick``: print two tunings of two feedbacks."""
    if "--quick" in sys.argv:
        study = feedback_study(families=("motor PD", "FL"), tunings=2, progress=False)
        print(study.table)
        return
    study = feedback_study(progress=False)
    study.plot().savefig(PICTURE)
    ratios = ", ".join(f"{study.ratio(s):.2f} ({s})" for s in study.settings if not s.exact)
    parts = [
        "# Feedforward or feedback linearization\n",
        f"Written by `python benchmarks/feedback_study.py`. {platform.machine()}, Python "
        f"{platform.python_version()}, one core, shared machine.\n",
        (
            "Worst error [mm] of six robots at the best tuning of each feedback; static errors "
            "included.\n"
        ),
        study.table,
        (
            "Worst error of feedback linearization over that of LQ about the feedforward, "
            f"measured angles: {ratios}.\n"
        ),
        f"## Errors of the robots, mm\n\n{robots(study)}",
        f"## Largest w h of the chain of four integrators\n\n{bounds()}",
        (
            "## Time of a step in C\n"
            "\n"
            "Three axes, measured angles, 1 ms and a delay of one sample.\n"
            "\n"
            f"{steps()}"
        ),
    ]
    TARGET.write_text("\n".join(parts))
    print(f"wrote {TARGET} and {PICTURE}")


if __name__ == "__main__":
    main()
