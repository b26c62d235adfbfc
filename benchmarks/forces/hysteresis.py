"""Gears with hysteresis and frictions with a state in C: tool errors, agreement with Python, and
what it costs.

    python benchmarks/forces/hysteresis.py [--write]

All gears have 1 arcmin of lost motion and K_h = K, or all motors the LuGre friction of `bristled`.
The C inverts the samples that `flexgen.solve` gives it; errors are those of simulations of the
full model with its states and motor feedback. ``--write`` writes ``hysteresis.md``.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
from flexgen.dynamics.hysteresis.hysteresis import without_hysteresis
from flexgen.dynamics.hysteresis.lugre import without_lugre
from flexgen.inversion.problem.memory import with_memory
from flexgen.inversion.problem.sampling import from_library
from flexgen.runtime.inversion.path_inversion import Inverter

ROBOTS = ("planar5_nmp", "manutec_r3_18")
ARCMIN = np.pi / 180 / 60
ROUNDS = 300
THREE = ((0.2, 0.5), (0.3, 0.3), (0.5, 0.2))
BENT = ((1.0, 1.0, 4.0, 0.2),)
FILE = Path(__file__).parents[1] / "hysteresis.md"
HEAD = """# Gears with hysteresis in C

Written by `python benchmarks/forces/hysteresis.py --write`: 1 arcmin of lost motion in all \
gears, K_h = K. Largest tool
errors [um] of simulations of the robot with hysteresis and motor feedback, under the torques of \
the emitted `invert`:
of a library without hysteresis, with it, and with one that is 20 % too wide. Difference: largest \
one of the motor
torques to those of `flexgen.solve`, over the largest torque, but for the last samples at rest. \
Cost: time of `invert`
over that of the library without hysteresis, same samples, in turns, least of 300.

| robot | not known | known | 20 % too wide | difference to Python | ms without | ms with | cost |
|---|---|---|---|---|---|---|---|
"""
SEVERAL = """
The same of three elements by Dahl's law in each gear, with 0.2, 0.3 and 0.5 of the lost motion \
and 0.5, 0.3 and 0.2 of
K_h.

| robot | not known | known | 20 % too wide | difference to Python | ms without | ms with | cost |
|---|---|---|---|---|---|---|---|"""
OTHER = """
The same of one element in each gear by the law of Bouc and Wen with exponent = 4 and gamma = 0.2.

| robot | not known | known | 20 % too wide | difference to Python | ms without | ms with | cost |
|---|---|---|---|---|---|---|---|"""
FRICTION = """
The same of frictions with a state, the LuGre law in all motors: F_c is 10 % of the standard \
deviation of the motor
torque, F_s = 1.5 F_c, v_s = 4 rad/s, F_s/s0 = 1 mrad; 20 % too large: F_c and F_s.

| robot | not known | known | 20 % too large | difference to Python | ms without | ms with | cost |
|---|---|---|---|---|---|---|---|"""


def hysteretic(
    name: str, lost_motion: float, parts: Sequence[tuple[float, ...]] = ((1.0, 1.0),)
) -> flexgen.RobotModel:
    """The model with this lost motion [rad] in all elastic gears, in elements with these parts of
    it and of K_h.

    A part may have an exponent and gamma too.
    """
    found = {}
    for element in flexgen.read(name).elements:
        for dof in element.dofs:
            if dof.gear is not None and dof.gear.spring is not None:
                found[f"element.{element.name}.dof.{dof.name}.gear.hysteresis"] = [
                    {
                        "lost_motion": lost * lost_motion,
                        "stiffness": steep * dof.gear.spring.stiffness,
                    }
                    | dict(zip(("exponent", "gamma"), law, strict=False))
                    for lost, steep, *law in parts
                ]
    return flexgen.read(name, overrides=found)


def bristled(name: str, factor: float) -> flexgen.RobotModel:
    """The model with LuGre friction: F_c a tenth of the standard deviation of each motor torque
    times a factor.
    """
    model = flexgen.read(name)
    found = {}
    typical = flexgen.solve(model, verify=False, progress=False).trajectory["tau_m"].std(axis=0)
    for motor, torque in zip(model.motors, typical, strict=True):
        static = 0.15 * float(torque)
        stiffness = 150.0 * float(torque)
        found[f"motor.{motor.name}.lugre"] = {
            "coulomb": factor * static / 1.5,
            "static": factor * static,
            "stribeck_speed": 4.0,
            "stiffness": stiffness,
            "damping": 0.6 * float(np.sqrt(stiffness * motor.inertia)),
        }
    return flexgen.read(name, overrides=found)


def asked(model: flexgen.RobotModel) -> tuple[flexgen.Solution, Any, dict[str, Any]]:
    """The solution, and the samples and options that `solve` gives to the C."""
    calls = []
    own = Inverter.__call__

    def noted(self: Inverter, *samples: Any, **options: Any) -> Any:
        calls.append((samples, options))
        return own(self, *samples, **options)

    Inverter.__call__ = noted  # type: ignore[method-assign]
    try:
        solution = flexgen.solve(model, verify=False, progress=False)
    finally:
        Inverter.__call__ = own  # type: ignore[method-assign]
    return solution, *calls[-1]


def row_of(name: str, folder: str, models: Sequence[flexgen.RobotModel]) -> str:
    """A row of the table of a robot: without the state, with it, with numbers that are 20 % too
    large.
    """
    true = models[1]
    made = [
        flexgen.generate(model, f"{folder}/{name}{k}", progress=False)
        for k, model in enumerate(models)
    ]
    plain, known, wide = (flexgen.load(each.directory) for each in made)
    solution, samples, options = asked(true)
    path = solution.trajectory
    errors = []
    for library in (plain, known, wide):
        found = library.invert(*samples, **options)
        channels = {key: getattr(found, key)[: len(path.time)] for key in ("q_m", "v_m", "tau_m")}
        moved = flexgen.Trajectory(
            path.time, {**path.channels, **channels}, path.ports, path.labels, path.meta
        )
        errors.append(flexgen.simulate(true, moved, feedback="ppi").tool_error_max_m)
    python = with_memory(
        flexgen.derive(true), from_library(plain.invert(*samples, **options))
    ).motors.tau_m
    c = known.invert(*samples, **options).tau_m
    difference = np.abs(c - python)[:-8].max() / np.abs(python).max()
    least = [np.inf, np.inf]
    for _ in range(ROUNDS):
        for k, library in enumerate((plain, known)):
            began = time.perf_counter()
            library.invert(*samples, **options)
            least[k] = min(least[k], time.perf_counter() - began)
    cells = [
        name,
        *(f"{1e6 * x:.3g}" for x in errors),
        f"{difference:.0e}",
        *(f"{1e3 * x:.3f}" for x in least),
    ]
    return f"| {' | '.join(cells)} | {least[1] / least[0]:.2f} |"


def main() -> None:
    """Print the table, and write it where it is wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--quick", action="store_true", help="one robot; nothing written")
    given = parser.parse_args()
    write = given.write and not given.quick
    robots = ROBOTS[: 1 if given.quick else None]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in robots:
            true = hysteretic(name, ARCMIN)
            rows.append(
                row_of(
                    name, folder, [without_hysteresis(true), true, hysteretic(name, 1.2 * ARCMIN)]
                )
            )
            print(rows[-1], flush=True)
        for head, parts in ((SEVERAL, THREE), (OTHER, BENT)):
            rows.append(head)
            for name in robots:
                true, wide = (hysteretic(name, factor * ARCMIN, parts) for factor in (1.0, 1.2))
                rows.append(
                    row_of(name, f"{folder}/{len(parts)}", [without_hysteresis(true), true, wide])
                )
                print(rows[-1], flush=True)
        rows.append(FRICTION)
        for name in robots:
            true = bristled(name, 1.0)
            rows.append(
                row_of(name, f"{folder}/f", [without_lugre(true), true, bristled(name, 1.2)])
            )
            print(rows[-1], flush=True)
    if write:
        FILE.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
