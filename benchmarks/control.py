"""Closed loops, benchmarks, learning and minimum time: writes benchmarks/control.md (about six
minutes).

Speeds are the best of several runs in this process; everything else is deterministic.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from control_parts.loops import SIZES, fastest, feedback, learning, loops, programs, table
from control_parts.observers import learned_errors, observer_errors, observer_times
from control_parts.robots import collisions, halved_steps, learning_settings, loads, time_settings

import flexgen
from flexgen.studies.scenarios.leaderboard import find_shipped_controllers

TARGET = Path(__file__).with_suffix(".md")
ROBOTS = ("planar5_nmp", "manutec_r3_18", "manutec_r3_24")
LOOPS = (
    "One robot, P-PI in C at 0.5 ms, no noise; for comparison a proportional controller as an "
    "object of Python."
)


def scores() -> str:
    """The controllers that come with the benchmarks."""
    out = []
    for name in ("four_mass", "two_link"):
        found = [flexgen.score(name, progress=False)]
        for controller in find_shipped_controllers(name):
            found.append(flexgen.score(name, controller, progress=False))
        seconds = min(flexgen.score(name, progress=False).wall_s for _ in range(5))
        rows = []
        for s in sorted(found, key=lambda s: s.total if s.accepted else np.inf):
            numbers = [s.total, s.worst, s.spread, *s.parts.values()] if s.accepted else []
            parts = [f"{value:.4f}" for value in numbers] if s.accepted else ["refused"]
            rows.append((s.controller, *parts, *[""] * (4 + len(s.scenario.sets) - len(parts))))
        head = ("controller", "V", "worst draw", "spread", "nominal", *found[0].scenario.sets)
        out.append(
            f"### {found[0].scenario.title_line}\n"
            "\n"
            f"One score: {seconds:.2f} s.\n"
            "\n"
            f"{table(head, rows)}"
        )
    return "\n".join(out)


def observers(names: Iterable[str]) -> list[str]:
    """The sections of the observers."""
    head = ("model", "states", "outputs", "observer", "us a step", "over one forward dynamics")
    errors = (
        "model",
        "robot",
        "reference",
        "extended",
        "constant gain",
        "extended, acc.",
        "constant gain, acc.",
    )
    learned = (
        "model",
        "measured by",
        "largest error of each iteration",
        "dynamic",
        "measured",
        "best",
    )
    names = list(names)
    return [
        "## Observers\n"
        "\n"
        "C for this processor, one core, the least of 400 rounds of 20 steps; in the last "
        "column over one call of the emitted forward dynamics in the same rounds. Measured on a "
        "busy machine, where the ratio says more than the time.\n"
        "\n" + table(head, observer_times(names)),
        "## What observers see\n"
        "\n"
        "Largest error [mm] of the tool's place: of the reference, and as estimated from motor "
        "angles (noise 1e-4 rad) without and with an accelerometer at the tool (0.05 m/s^2). "
        "P-PI 10/40/0.5 Hz, 1 ms; 300 N on the tool for 20 ms.\n"
        "\n" + table(errors, observer_errors(names)),
        "## Learning from accelerometers\n"
        "\n"
        "Stiffness -20 %, P-PI at 1 ms, the same noises; errors in mm. The accelerometer does "
        "not show the error at rest, and its estimates are noisy.\n"
        "\n" + table(learned, learned_errors(names)),
    ]


def differing(quick: bool) -> list[str]:
    """The sections about settings of learning and of minimum time, collisions and loads."""
    names = list(SIZES)[:2] if quick else list(SIZES)
    sections = [
        "## Halving the steps\n"
        "\n"
        "Stiffness -10 %, P-PI, 1 ms; largest change of an arm coordinate, rad or m, from 2 to "
        "4, 4 to 8 and 8 to 16 steps a sample.\n"
        "\n"
        + table(
            ("model", "largest eigenvalue, 1/s", "2 to 4", "4 to 8", "8 to 16", "order"),
            halved_steps(names),
        ),
    ]
    if quick:
        return sections
    settings = (
        "model",
        "move",
        "time, s",
        "against the given law",
        "vibration, um",
        "inversions",
        "processor, s",
    )
    return [
        *sections,
        "## Settings of learning\n"
        "\n"
        "P-PI at 1 ms. Learning ends where the error grows, and the best iteration is kept.\n"
        "\n"
        + table(
            ("model", "robot", "Q, Hz", "gain", "largest error, mm", "best"), learning_settings()
        ),
        "## Settings of minimum time\n"
        "\n"
        "The first move within the largest torques of its given law; vibration after the end "
        "with stiffness -10 %.\n"
        "\n" + table(settings, time_settings("planar5_nmp")),
        "## Collisions\n"
        "\n"
        "manutec_r3_18, thresholds from 60 robots with stiffness +-10 % and load +-1 kg; 30 "
        "pushes on the tool for each force, 100 runs without.\n"
        "\n"
        + table(
            (
                "force, N",
                "bandwidth, Hz",
                "found after, ms",
                "median, ms",
                "missed",
                "false alarms",
            ),
            collisions(),
        ),
        (
            "## Loads\n"
            "\n"
            "manutec_r3_18 with 20 kg, the first move, noise of the motor angles 1e-4 rad.\n"
            "\n"
        )
        + table(
            (
                "stiffness",
                "mass, kg",
                "center, mm off",
                "rigid model: mass",
                "center, mm off",
                "deviation, kg",
            ),
            loads(),
        ),
    ]


def replaced(text: str, sections: Iterable[str]) -> str:
    """A page with some sections written again, or added at its end."""
    parts = text.split("\n## ")
    found = {part.partition("\n")[0]: part.rstrip("\n") for part in parts[1:]}
    found |= {
        s.removeprefix("## ").partition("\n")[0]: s.removeprefix("## ").rstrip("\n")
        for s in sections
    }
    return parts[0] + "".join(f"\n## {part}\n" for part in found.values())


def main() -> None:
    """Write the page; ``--observers``, ``--robots``: only these sections."""
    parts = {"--observers": lambda: observers(ROBOTS), "--robots": lambda: differing(False)}
    for option, sections in {**parts, "--programs": lambda: [programs()]}.items():
        if option in sys.argv:
            TARGET.write_text(replaced(TARGET.read_text(), sections()))
            return
    quick = "--quick" in sys.argv
    robots = ROBOTS[:1] if quick else ROBOTS
    machine = (
        f"{platform.machine()}, Python {platform.python_version()}, one core, shared machine."
    )
    disturbed = (
        "Largest dynamic error [mm] of six robots at 1 ms, noise of the motor angles 1e-4 rad. "
        "Disturbed: 0.5 N m on every motor from 0.3 s on, 300 N on the tool for 20 ms. The load "
        "is at the tool."
    )
    learned = "P-PI at 1 ms, noise of the motor angles 1e-4 rad; largest error, at rest included."
    names = list(SIZES)[:2] if quick else list(SIZES)
    if "--loops" in sys.argv:
        TARGET.write_text(
            replaced(TARGET.read_text(), [f"## Speed of the loop\n\n{LOOPS}\n\n{loops(names)}"])
        )
        return
    parts = [
        f"# Control\n\nWritten by `python benchmarks/control.py`. {machine}\n",
        f"## Speed of the loop\n\n{LOOPS}\n\n{loops(names)}",
        f"## Feedback around the feedforward\n\n{disturbed}\n\n{feedback(robots)}",
        f"## Benchmarks\n\n{scores()}",
        f"## Learning\n\n{learned}\n\n{learning(robots)}",
        (
            "## Minimum time\n"
            "\n"
            "The first move of each model within the largest torques of its given law.\n"
            "\n"
        )
        + fastest(robots),
        *([] if quick else [programs()]),
        *differing(quick),
        *observers(robots),
    ]
    text = "\n".join(parts)
    if quick:
        print(text)
        return
    TARGET.write_text(text)
    print(f"wrote {TARGET}")


if __name__ == "__main__":
    main()
