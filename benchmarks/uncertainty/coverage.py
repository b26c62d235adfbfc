"""Do 95 % of robots keep the error that `flexgen.predict` states?

The robots are drawn here, from normal and log-normal distributions of the numbers, and simulated
by `flexgen.control`: the whole nonlinear model in C with a sampled P-PI controller, integrated by
the Runge-Kutta method. Nothing of that is used by the prediction, which linearizes; draws,
simulation and error are computed apart. Run from the repository:

    .venv/bin/python benchmarks/uncertainty/coverage.py [MODEL ...]

It writes coverage.csv to the folder of this file.
"""

from __future__ import annotations

import csv
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.parameters import select

ROBOTS = 600
SEED = 4711
SAMPLE_S = 2.5e-4
REPEATS = 3
TOLERANCES = {
    "stiffness": 0.1,
    "damping": 0.3,
    "friction": 0.2,
    "masses": 0.03,
    "motor_inertia": 0.05,
}
CASES = {"planar5_nmp": 0.2, "manutec_r3_18": 1.0, "manutec_r3_24": 1.0}  # payload [kg]
INERTIA = [f"inertia_{axes}" for axes in ("xx", "yy", "zz", "xy", "yz", "xz")]


def draw_factors(rng: np.random.Generator, sd: float) -> float:
    """A factor of mean or median 1: log-normal where it is weakly known."""
    return float(
        np.exp(rng.normal(0.0, np.sqrt(np.log(1 + sd**2))))
        if sd > 0.2
        else 1 + rng.normal(0.0, sd)
    )


def draw_plants(
    model: flexgen.RobotModel,
    given: dict[str, Any],
    payload: float,
    seed: int = SEED,
    robots: int = ROBOTS,
) -> dict[str, dict[str, float]]:
    """Robots as `flexgen.control` takes them: factors of numbers by name, payload in kg more."""
    rng = np.random.default_rng(seed)
    common = given.get("common", ())
    springs = [p.name for p in select(model, ["stiffness"]) if p.unit in ("N m/rad", "N/m")]
    frictions = [
        p.name
        for p in select(model, ["friction"])
        if p.name.split(".")[1] in ("viscous", "coulomb")
    ]
    single = {
        "stiffness": [[name] for name in springs],
        "damping": [[p.name] for p in select(model, ["damping"]) if p.value],
        "friction": [[name] for name in frictions],
        "masses": [
            [f"{e.name}.{x}" for x in ("mass", *INERTIA)] for e in model.elements if e.body.mass
        ],
        "motor_inertia": [[f"{motor.name}.inertia"] for motor in model.motors],
    }
    out: dict[str, dict[str, float]] = {}
    for k in range(robots):
        robot = {"payload": max(rng.normal(0.0, payload), -model.payload.mass)} if payload else {}
        for kind, groups in single.items():
            one = draw_factors(rng, given.get(kind, 0.0))
            for group in groups:
                factor = one if kind in common else draw_factors(rng, given.get(kind, 0.0))
                robot |= dict.fromkeys(group, factor)
        out[f"r{k}"] = robot
    return out


def simulated_errors(
    found: flexgen.Prediction, plants: dict[str, dict[str, float]], sample_time: float = SAMPLE_S
) -> dict[str, np.ndarray]:
    """Largest errors of the robots over the motion by unit."""
    solution = found.solution
    gains = found.feedback
    controller = flexgen.Cascade(gains.position_gain, gains.speed_gain, gains.integral_gain)
    run = flexgen.control(
        solution.model,
        solution.move,
        controller=controller,
        plants=plants,
        solution=solution,
        torque_limits=False,
        sample_time=sample_time,
        progress=False,
    )
    inside = (run.reference.time >= found.time[0]) & (run.reference.time <= found.time[-1])
    robots = [run[name] for name in plants]
    assert not any(robot.failure for robot in robots)
    out = {"m": np.array([np.linalg.norm(r.error[inside], axis=1).max() for r in robots])}
    turns = [r.turn[inside].max() for r in robots if r.turn is not None]
    return out | ({"rad": np.array(turns)} if turns else {})


def measure(name: str, payload: float) -> list[list[Any]]:
    """Rows of the table for a model."""
    model = flexgen.read(name, overrides={"uncertainty": {**TOLERANCES, "payload": payload}})
    equations = derive(model)
    rows = []
    for move in [move.name for move in model.moves][:2]:
        solution = flexgen.solve(equations, move, progress=False)  # libraries are made
        solve_s = min(
            flexgen.solve(equations, move, progress=False).wall_s for _ in range(REPEATS)
        )
        times = []
        for _ in range(REPEATS):
            began = time.perf_counter()
            found = flexgen.predict(equations, solution=solution, progress=False)
            times.append(time.perf_counter() - began)
        seconds = min(times)
        errors = simulated_errors(found, draw_plants(model, TOLERANCES, payload))
        for unit, stated in (("m", found.error_m), ("rad", found.error_rad)):
            if stated is not None:
                inside = float(np.mean(errors[unit] <= stated))
                true = float(np.quantile(errors[unit], 0.95))
                ratio = f"{seconds / solve_s:.2f}"
                rows.append(
                    [
                        name,
                        move,
                        unit,
                        len(found.sources),
                        f"{stated:.4g}",
                        f"{true:.4g}",
                        f"{100 * inside:.1f}",
                        f"{solve_s:.2f}",
                        f"{seconds:.2f}",
                        ratio,
                    ]
                )
                print(*rows[-1], flush=True)
    return rows


def main() -> None:
    """Write the table; print it where models are named."""
    names = sys.argv[1:] or list(CASES)
    head = (
        "model move unit sources stated_95 simulated_95 inside_percent solve_s predict_s "
        "times_solve"
    ).split()
    rows = [row for name in names for row in measure(name, CASES[name])]
    if sys.argv[1:]:
        csv.writer(sys.stdout, lineterminator="\n").writerows([head, *rows])
        return
    with open(Path(__file__).with_name("coverage.csv"), "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *rows])


if __name__ == "__main__":
    main()
