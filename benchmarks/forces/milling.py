"""A known force on the tool along a path: tool errors with and without it in the torque, and what
it costs.

    python benchmarks/forces/milling.py [--write]

300 N at 40 Hz, a cutter with four flutes at 600 1/min, on the tool of each robot along its first
move. Errors are those of simulations of the full model with the true force, with the torques of
the file: in open loop, and with the motor feedback of `flexgen.simulate`. ``--write`` writes
``process_force.md``.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.interpolate import PPoly

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.paths.force.process_force import ProcessForce, make_force

ROBOTS = {"planar5_nmp": (0.6, 0.8), "manutec_r3_24": (0.6, 0.48, 0.64)}
HZ = 40.0  # Hz
SIZE = 300.0  # N
RAMP = 0.05  # s
# of the measurement of the cost: rounds, and for each robot time of a sample [s] and samples of an
# interval
ROUNDS = 150
MESHES = {"planar5_nmp": (1e-3, 2), "manutec_r3_24": (5e-4, 1)}
# s of motion before and after the path
BEFORE = 0.1
AFTER = 0.2
FILE = Path(__file__).parents[1] / "process_force.md"
HEAD = """# A known force on the tool

Written by `python benchmarks/forces/milling.py --write`: 300 N at 40 Hz (four flutes at 600 \
1/min) on the tool along
the first move. Largest tool errors [um] of simulations with the true force: with torques that do \
not know it, that know
it, and that assume one that is 20 % too small; in open loop, and with motor feedback. Cost: time \
of `invert` with the
force over that without it, same library, same mesh (2 ms for planar5_nmp, 0.5 ms for \
manutec_r3_24: longer intervals do
not resolve the torques of this force, and `invert` has the status TOLERANCE_NOT_MET), in turns, \
least of 150; and over
that of a library without the part `force`. With the force the six-axis robot needs three steps \
of Gauss and Newton
instead of two. In open loop the Coulomb friction of motors that reverse at other instants makes \
it drift: a wrong force
leaves more there.

| robot | loop | not known | known | 20 % wrong | wrong / not known | cost, same library | cost, \
plain library |
|---|---|---|---|---|---|---|---|
"""


def milling(t: np.ndarray, duration: float, direction: tuple[float, ...]) -> np.ndarray:
    """A sinusoidal force that begins and ends smoothly, (n, 3) or (n, 2) [N]."""
    r = np.clip(np.minimum(t, duration - t) / RAMP, 0.0, 1.0)
    window = r**4 * (35 - 84 * r + 70 * r**2 - 20 * r**3)
    return np.outer(SIZE * np.sin(2 * np.pi * HZ * t) * window, direction)


def with_force(path: Trajectory, values: np.ndarray, like: Trajectory) -> Trajectory:
    """A trajectory under another force."""
    parts = [
        {**getattr(path, name), "force": getattr(like, name)["force"]}
        for name in ("ports", "labels", "units")
    ]
    return Trajectory(
        path.time, {**path.channels, "force": values}, parts[0], parts[1], path.meta, parts[2]
    )


def errors(
    equations: Equations, force: ProcessForce, paths: list[Trajectory], feedback: str
) -> list[float]:
    """Largest tool errors [m] under the force with the torques of each of the paths."""
    cases = [with_force(path, force.at(path.time), paths[-1]) for path in paths]
    found = (flexgen.simulate(equations, case, feedback=feedback) for case in cases)
    return [float(x.tool_error_max_m or 0.0) for x in found]


def cost(equations: Equations, force: ProcessForce) -> tuple[float, float]:
    """Time of an inversion with the force over that without, and over that of a library that takes
    none.
    """
    path = flexgen.plan(equations, ignore_limits=True)
    period, each = MESHES[equations.model.name]
    t = np.arange(round(path.duration / period) + 1) * period
    given = samples(Reduction(equations), path, period, len(t))
    around = {"n_pre": round(BEFORE / period), "n_post": round(AFTER / period)}
    options = {"period": period, "q_start": path.q_start, "samples_per_interval": each, **around}
    F = force.on_output(equations.model, t)
    with tempfile.TemporaryDirectory() as folder:
        pushed, plain = (
            flexgen.load(
                flexgen.generate(
                    equations.model, f"{folder}/{len(parts)}", parts=parts, progress=False
                ).directory
            )
            for parts in (["force"], [])
        )
        calls = [
            lambda: pushed.invert(*given, force=F, **options),
            lambda: pushed.invert(*given, **options),
        ]
        calls.append(lambda: plain.invert(*given, **options))
        least = [np.inf] * 3
        first = [call() for call in calls]
        assert all(found.converged for found in first)
        for _ in range(ROUNDS):
            for k, call in enumerate(calls):
                began = time.perf_counter()
                call()
                least[k] = min(least[k], time.perf_counter() - began)
    print(
        equations.model.name,
        "ms:",
        [round(1e3 * x, 3) for x in least],
        "iterations:",
        *(x.iterations for x in first),
    )
    return least[0] / least[1], least[0] / least[2]


def main() -> None:
    """Print the table, and write it where it is wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--quick", action="store_true", help="one robot; nothing written")
    rows = []
    given = parser.parse_args()
    write = given.write and not given.quick
    for name, direction in list(ROBOTS.items())[: 1 if given.quick else None]:
        equations = flexgen.derive(name)
        duration = flexgen.plan(equations, ignore_limits=True).duration
        force = make_force(
            lambda t, T=duration, d=direction: milling(t, T, d), equations.model, duration
        )
        options = {"accuracy": 1e-6, "ignore_limits": True, "progress": False}
        paths = [flexgen.solve(equations, **options).trajectory]
        for size in (1.0, 0.8):
            assumed = ProcessForce(PPoly(size * force.curve.c, force.curve.x), duration)
            paths.append(
                flexgen.solve(equations, force=lambda t, f=assumed: f.at(t), **options).trajectory
            )
        more = cost(equations, force)
        for loop, feedback in (("open", "none"), ("motor feedback", "ppi")):
            alone, known, wrong = errors(equations, force, paths, feedback)
            figures = [f"{1e6 * x:.3g}" for x in (alone, known, wrong)]
            row = [
                name,
                loop,
                *figures,
                f"{100 * wrong / alone:.0f} %",
                *(f"{x:.2f}" for x in more),
            ]
            rows.append(f"| {' | '.join(row)} |")
            print(rows[-1])
    if write:
        FILE.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
