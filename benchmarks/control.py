"""Closed loops, benchmarks, learning and minimum time: writes benchmarks/control.md (about six minutes).

Speeds are the best of several runs in this process; everything else is deterministic.
"""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from control_parts.observers import learned_errors, observer_errors, observer_times
from control_parts.robots import PythonCascade, collisions, halved_steps, learning_settings, loads, time_settings

import flexgen
from flexgen.inversion.bounds import Limits
from flexgen.motion_control.benchmarks.leaderboard import shipped
from flexgen.motion_control.control import control_case, run_case
from flexgen.motion_control.controllers import controller_of

TARGET = Path(__file__).with_suffix(".md")
SIZES = {"four_mass": 4, "planar5_nmp": 5, "manutec_r3_18": 18, "manutec_r3_24": 24}
ROBOTS = ("planar5_nmp", "manutec_r3_18", "manutec_r3_24")
LOOPS = "One robot, P-PI in C at 0.5 ms, no noise; beside it a proportional controller as an object of Python."
ACCELEROMETER = {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2", "noise": 0.05}


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table in Markdown."""
    head = list(head)
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def loops(names: Iterable[str]) -> str:
    """Speed and nominal error of one robot under P-PI, 0.5 ms."""
    rows = []
    for name in names:
        case = control_case(name, sample_time=5e-4)
        law, _ = controller_of("ppi", case.model, 5e-4, 0.0, case.reference.points(np.array([0])))
        runs = [run_case(case, law, "ppi") for _ in range(9)]
        seconds = min(run.wall_s for run in runs)
        simulated = float(np.ptp(case.reference.time))
        slow, _ = controller_of(PythonCascade(case.model), case.model, 5e-4, 0.0, case.reference.points(np.array([0])))
        by_python = [run_case(case, slow, "python") for _ in range(3)]
        assert not by_python[0].runs[0].failure and by_python[0].tool_error_max_m < 1e-4
        python = min(run.wall_s for run in by_python)
        error = 1e6 * runs[0].tool_error_max_m
        times = f"{simulated / seconds:.0f}", f"{simulated / python:.0f}"
        rows.append((name, SIZES[name], f"{case.rate:.0f}", runs[0].steps, *times, f"{error:.2g}"))
    head = (
        "model", "degrees of freedom", "largest eigenvalue, 1/s", "steps a sample", "times real time",
        "with a controller in Python", "nominal error, um",
    )  # fmt: skip
    return table(head, rows)


def cases(name: str) -> tuple[dict, dict]:
    """Six robots: stiffness, load, and disturbances on motors and tool."""
    load = 3.0 if name.startswith("planar") else 5.0
    plants = {
        "K -20 %": {"stiffness": 0.8},
        "K +20 %": {"stiffness": 1.2},
        f"load +{load:g} kg": {"payload": load},
        "K -20 %, load": {"stiffness": 0.8, "payload": load},
        "disturbed": {},
    }
    motors = [motor.name for motor in flexgen.read(name).motors]
    pushes = [flexgen.Disturbance("step", motor, 0.5, 0.3) for motor in motors]
    pushes.append(flexgen.Disturbance("pulse", "tool.x", 300.0, 0.4, 0.02))
    return plants, {"disturbed": pushes}


def feedback(names: Iterable[str]) -> str:
    """Largest dynamic error of the six robots under several controllers, 1 ms, noise 1e-4 rad."""
    out = []
    for name in names:
        plain = flexgen.read(name)
        sensing = flexgen.read(name, overrides={"sensor": [ACCELEROMETER]})
        solution = flexgen.solve(plain, progress=False)
        plants, pushes = cases(name)
        laws = [(plain, "P-PI, default", "ppi"), (plain, "P-PI with a notch", "ppi_notch")]
        laws += [(plain, f"P-PI {p}/{v}/0.5 Hz", flexgen.PPI(p, v, 0.5)) for p, v in ((3, 12), (6, 24), (10, 40))]
        laws += [(plain, f"LQG, rho {rho:g}", flexgen.LQG(rho)) for rho in (1000.0, 100.0, 10.0)]
        laws += [(sensing, f"LQG with accelerometer, rho {rho:g}", flexgen.LQG(rho)) for rho in (1000.0, 100.0)]
        laws += [(plain, f"LQ, exact state, rho {rho:g}", flexgen.LQ(rho)) for rho in (1.0, 1e-2, 1e-4)]
        rows = []
        for model, title, law in laws:
            run = flexgen.control(
                model, controller=law, sample_time=1e-3, plants=plants, disturbances=pushes, encoder_noise=1e-4,
                exact_state=isinstance(law, flexgen.LQ), solution=solution, progress=False,
            )  # fmt: skip
            values = [1e3 * run.figures(r)["dynamic_error_max_m"] for r in run.runs]
            rows.append((title, *(f"{x:.3f}" if np.isfinite(x) else "unstable" for x in values)))
        out.append(f"### {name}\n\n" + table(("controller", "nominal", *plants), rows))
    return "\n".join(out)


def scores() -> str:
    """The controllers that come with the benchmarks."""
    out = []
    for name in ("four_mass", "two_link"):
        found = [flexgen.score(name, progress=False)]
        for path in shipped(name):
            found.append(flexgen.score(name, path.stem.removeprefix(f"{name}-"), progress=False))
        seconds = min(flexgen.score(name, progress=False).wall_s for _ in range(5))
        rows = []
        for s in sorted(found, key=lambda s: s.total if s.accepted else np.inf):
            parts = [f"{value:.4f}" for value in s.parts.values()] if s.accepted else ["refused"]
            parts += [""] * (1 + len(s.scenario.sets) - len(parts))
            rows.append((s.controller, f"{s.total:.4f}" if s.accepted else "-", *parts))
        head = ("controller", "V", "nominal", *found[0].scenario.sets)
        out.append(f"### {found[0].scenario.title_line}\n\nOne score: {seconds:.2f} s.\n\n{table(head, rows)}")
    return "\n".join(out)


def learning(names: Iterable[str]) -> str:
    """Largest error of each iteration."""
    rows = []
    for name in names:
        solution = flexgen.solve(name, progress=False)
        load = 3.0 if name.startswith("planar") else 5.0
        for plant in ({"stiffness": 0.8}, {"stiffness": 1.2}, {"stiffness": 0.8, "payload": load}):
            began = time.perf_counter()
            found = flexgen.learn(
                name, plant=plant, solution=solution, iterations=6, sample_time=1e-3, encoder_noise=1e-4, progress=False
            )
            each = (time.perf_counter() - began) / len(found.runs)
            errors = ", ".join(f"{1e3 * e:.4f}" for e in found.errors_m)
            told = ", ".join(f"{key} {value:g}" for key, value in plant.items())
            rows.append((name, told, f"{found.frequency_hz:.1f}", errors, found.best, f"{each:.2f}"))
    return table(
        ("model", "robot", "Q, Hz", "largest error of iterations 0, 1, ..., mm", "best", "s an iteration"), rows
    )


def fastest(names: Iterable[str]) -> str:
    """Minimum time within the largest torques of the given law."""
    rows = []
    for name in names:
        default = flexgen.solve(name, progress=False)
        limits = Limits(torque=tuple(np.abs(default.trajectory["tau_m"]).max(axis=0)))
        found = flexgen.fastest(name, limits=limits, progress=False)
        times = [f"{found.default_s:.3f}", f"{found.duration_s:.4f}", f"{found.rigid_s:.4f}"]
        swings = [1e6 * x["soft"] for x in (found.default_vibration_m, found.vibration_m)]
        effort = [f"{found.excess:.0e}", found.inversions, f"{found.cpu_s:.2f}"]
        rows.append((name, *times, *effort, *(f"{x:.3g}" for x in swings)))
    head = (
        "model", "given, s", "fastest, s", "rigid bound, s", "excess", "inversions", "processor, s",
        "vibration at K -10 % as given, um", "fastest, um",
    )  # fmt: skip
    return table(head, rows)


def observers(names: Iterable[str]) -> list[str]:
    """The sections of the observers."""
    head = ("model", "states", "outputs", "observer", "us a step", "over one forward dynamics")
    errors = ("model", "robot", "reference", "extended", "constant gain", "extended, acc.", "constant gain, acc.")
    learned = ("model", "measured by", "largest error of each iteration", "dynamic", "measured", "best")
    names = list(names)
    return [
        "## Observers\n\nC for this processor, one core, the least of 400 rounds of 20 steps; in the last column over "
        "one call of the emitted forward dynamics in the same rounds.\n\n" + table(head, observer_times(names)),
        "## What observers see\n\nLargest error [mm] of the tool's place: of the reference, and as estimated from "
        "motor angles (noise 1e-4 rad) without and with an accelerometer at the tool (0.05 m/s^2). P-PI 10/40/0.5 Hz, "
        "1 ms; 300 N on the tool for 20 ms.\n\n" + table(errors, observer_errors(names)),
        "## Learning from accelerometers\n\nStiffness -20 %, P-PI at 1 ms, the same noises; errors in mm. The "
        "accelerometer does not show the error at rest, and its estimates are noisy.\n\n"
        + table(learned, learned_errors(names)),
    ]


def differing(quick: bool) -> list[str]:
    """The sections about settings of learning and of minimum time, collisions and loads."""
    names = list(SIZES)[:2] if quick else list(SIZES)
    sections = [
        "## Halving the steps\n\nStiffness -10 %, P-PI, 1 ms; largest change of an arm coordinate, rad or m, from 2 to "
        "4, 4 to 8 and 8 to 16 steps a sample.\n\n"
        + table(("model", "largest eigenvalue, 1/s", "2 to 4", "4 to 8", "8 to 16", "order"), halved_steps(names)),
    ]
    if quick:
        return sections
    settings = ("model", "move", "time, s", "against the given law", "vibration, um", "inversions", "processor, s")
    return [
        *sections,
        "## Settings of learning\n\nP-PI at 1 ms. Learning ends where the error grows, and the best iteration is kept."
        "\n\n" + table(("model", "robot", "Q, Hz", "gain", "largest error, mm", "best"), learning_settings()),
        "## Settings of minimum time\n\nThe first move within the largest torques of its given law; vibration after "
        "the end with stiffness -10 %.\n\n" + table(settings, time_settings("planar5_nmp")),
        "## Collisions\n\nmanutec_r3_18, thresholds from 60 robots with stiffness +-10 % and load +-1 kg; 30 pushes on "
        "the tool for each force, 100 runs without.\n\n"
        + table(("force, N", "bandwidth, Hz", "found after, ms", "median, ms", "missed", "false alarms"), collisions()),
        "## Loads\n\nmanutec_r3_18 with 20 kg, the first move, noise of the motor angles 1e-4 rad.\n\n"
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
    found |= {s.removeprefix("## ").partition("\n")[0]: s.removeprefix("## ").rstrip("\n") for s in sections}
    return parts[0] + "".join(f"\n## {part}\n" for part in found.values())


def main() -> None:
    """Write the page; ``--observers``, ``--robots``: only these sections."""
    for option, sections in (("--observers", lambda: observers(ROBOTS)), ("--robots", lambda: differing(False))):
        if option in sys.argv:
            TARGET.write_text(replaced(TARGET.read_text(), sections()))
            return
    quick = "--quick" in sys.argv
    robots = ROBOTS[:1] if quick else ROBOTS
    machine = f"{platform.machine()}, Python {platform.python_version()}, one core, shared machine."
    disturbed = (
        "Largest dynamic error [mm] of six robots at 1 ms, noise of the motor angles 1e-4 rad. Disturbed: 0.5 N m on "
        "every motor from 0.3 s on, 300 N on the tool for 20 ms."
    )
    learned = "P-PI at 1 ms, noise of the motor angles 1e-4 rad; largest error, at rest included."
    names = list(SIZES)[:2] if quick else list(SIZES)
    if "--loops" in sys.argv:
        TARGET.write_text(replaced(TARGET.read_text(), [f"## Speed of the loop\n\n{LOOPS}\n\n{loops(names)}"]))
        return
    parts = [
        f"# Control\n\nWritten by `python benchmarks/control.py`. {machine}\n",
        f"## Speed of the loop\n\n{LOOPS}\n\n{loops(names)}",
        f"## Feedback around the feedforward\n\n{disturbed}\n\n{feedback(robots)}",
        f"## Benchmarks\n\n{scores()}",
        f"## Learning\n\n{learned}\n\n{learning(robots)}",
        "## Minimum time\n\nThe first move of each model within the largest torques of its given law.\n\n"
        + fastest(robots),
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
