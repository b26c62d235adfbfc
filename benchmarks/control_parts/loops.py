"""Sections of benchmarks/control.md: the loop, feedback around the feedforward, learning, minimum
time.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from control_parts.observers import ACCELEROMETER
from control_parts.robots import PythonCascade

import flexgen
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.control import run_case
from flexgen.feedback.loop.named_controllers import controller_of

SIZES = {"four_mass": 4, "planar5_nmp": 5, "manutec_r3_18": 18, "manutec_r3_24": 24}


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
        slow, _ = controller_of(
            PythonCascade(case.model), case.model, 5e-4, 0.0, case.reference.points(np.array([0]))
        )
        by_python = [run_case(case, slow, "python") for _ in range(3)]
        assert not by_python[0].runs[0].failure and by_python[0].tool_error_max_m < 1e-4
        python = min(run.wall_s for run in by_python)
        error = 1e6 * runs[0].tool_error_max_m
        times = f"{simulated / seconds:.0f}", f"{simulated / python:.0f}"
        rows.append((name, SIZES[name], f"{case.rate:.0f}", runs[0].steps, *times, f"{error:.2g}"))
    head = (
        "model",
        "degrees of freedom",
        "largest eigenvalue, 1/s",
        "steps a sample",
        "times real time",
        "with a controller in Python",
        "nominal error, um",
    )
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
        laws += [
            (plain, f"P-PI {p}/{v}/0.5 Hz", flexgen.PPI(p, v, 0.5))
            for p, v in ((3, 12), (6, 24), (10, 40))
        ]
        laws += [(plain, f"LQG, rho {rho:g}", flexgen.LQG(rho)) for rho in (1000.0, 100.0, 10.0)]
        laws += [
            (sensing, f"LQG with accelerometer, rho {rho:g}", flexgen.LQG(rho))
            for rho in (1000.0, 100.0)
        ]
        laws += [
            (plain, f"LQ, exact state, rho {rho:g}", flexgen.LQ(rho)) for rho in (1.0, 1e-2, 1e-4)
        ]
        rows = []
        for model, title, law in laws:
            run = flexgen.control(
                model,
                controller=law,
                sample_time=1e-3,
                plants=plants,
                disturbances=pushes,
                encoder_noise=1e-4,
                exact_state=isinstance(law, flexgen.LQ),
                solution=solution,
                progress=False,
            )
            values = [1e3 * run.figures(r)["dynamic_error_max_m"] for r in run.runs]
            rows.append((title, *(f"{x:.3f}" if np.isfinite(x) else "unstable" for x in values)))
        out.append(f"### {name}\n\n" + table(("controller", "nominal", *plants), rows))
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
                name,
                plant=plant,
                solution=solution,
                iterations=6,
                sample_time=1e-3,
                encoder_noise=1e-4,
                progress=False,
            )
            each = (time.perf_counter() - began) / len(found.runs)
            errors = ", ".join(f"{1e3 * e:.4f}" for e in found.errors_m)
            told = ", ".join(f"{key} {value:g}" for key, value in plant.items())
            rows.append(
                (name, told, f"{found.frequency_hz:.1f}", errors, found.best, f"{each:.2f}")
            )
    return table(
        (
            "model",
            "robot",
            "Q, Hz",
            "largest error of iterations 0, 1, ..., mm",
            "best",
            "s an iteration",
        ),
        rows,
    )


PROGRAM = (
    "Ten motions with limits of torque, its rate, root mean square and curve over the speed, of "
    "gears, bearings and the tool; a tenth of the torques is left for feedback. The whole "
    "includes the verification by simulation."
)


def programs() -> str:
    """The fastest time laws of a program of ten motions with limits of every kind and a tenth of
    the torques left.
    """
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))
    from programs_of_moves import ten_motions

    model, move = ten_motions()
    began = time.perf_counter()
    found = flexgen.fastest(model, move, limits=Limits(reserve=0.1), progress=False)
    seconds = time.perf_counter() - began
    times = [f"{found.default_s:.3f}", f"{found.duration_s:.3f}", f"{found.rigid_s:.3f}"]
    row = (
        model.name,
        len(found.move.laws),
        *times,
        f"{found.excess:.0e}",
        found.inversions,
        f"{found.cpu_s:.0f}",
    )
    head = (
        "model",
        "motions",
        "given, s",
        "fastest, s",
        "rigid bound, s",
        "excess",
        "inversions",
        "search, processor s",
    )
    found_table = table((*head, "all, s"), [(*row, f"{seconds:.0f}")])
    return f"## Minimum time of a program\n\n{PROGRAM}\n\n{found_table}"


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
        "model",
        "given, s",
        "fastest, s",
        "rigid bound, s",
        "excess",
        "inversions",
        "processor, s",
        "vibration at K -10 % as given, um",
        "fastest, um",
    )
    return table(head, rows)
