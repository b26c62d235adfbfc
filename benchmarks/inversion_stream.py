"""Streaming: thread time of samples_per_interval update in C while a robot moves back and forth,
and the tool error.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from peers_builds import HERE, Builds

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import output_labels
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.paths.path import Path
from flexgen.runtime.library import Library
from flexgen.simulation.simulate import Simulation, simulate

ROBOT = "manutec_r3_24"
MOVE = "line"
# s; 100 ms ahead
PERIOD = 5e-3
INTERVALS = 20
PARTS = 5
TOLERANCE = 1e-4
PAUSE = 20  # updates at rest at either end
UPDATES = 10_000
FEW = 1_000
# of the same updates, each counts with its least time: what it takes, not what others on the
# machine do
RUNS = 3
WANTED_US = {"native": 160.0, "default": 190.0}  # 99.9th percentile
WANTED_M = 5e-6  # tool error


@dataclass
class StreamRow:
    """One build: percentiles [us], largest residual, statuses, and tool error in simulation."""

    robot: str
    move: str
    build: str
    updates: int
    median_us: float
    p99_us: float
    p999_us: float
    largest_us: float
    residual: float
    inexact: int
    error_m: float
    error_rad: float | None
    repeats: float  # largest difference of the torque from round to round, relative


class There:
    """A move there and back again with pauses, as samples for a stream."""

    def __init__(self, equations: Equations, move: str) -> None:
        self.equations = equations
        self.path = Path(equations, equations.model.move(move))
        self._reduction = Reduction(equations)
        self.way = int(np.ceil(self.path.duration / PERIOD - 1e-9))
        self.round = 2 * (self.way + PAUSE)

    def _folded(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Instants on the path and directions at instants of the motion; it is at rest at its end
        for one pause.
        """
        half = (self.way + PAUSE) * PERIOD
        length = self.round * PERIOD
        t = np.where(t < 0, 0.0, np.mod(t, length))
        return np.where(t < half, t, self.way * PERIOD - (t - half)), np.where(t < half, 1.0, -1.0)

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Place, dy and its dy."""
        on_path, direction = self._folded(t)
        sample = self.path.sample(on_path)
        return (
            self._reduction.targets(sample),
            direction[:, None] * sample.derivative(1),
            sample.derivative(2),
        )

    def simulation(
        self, t: np.ndarray, tau_m: np.ndarray, q_m: np.ndarray, q_a: np.ndarray
    ) -> Simulation:
        """Simulation of the full model under the given torques, from rest."""
        model = self.equations.model
        sample = self.path.sample(self._folded(t)[0])
        arm = tuple(c.name for c in model.coordinates)
        motors = tuple(m.name for m in model.motors)
        labels = {"tau_m": motors, "q_m": motors, "q_a": arm, **output_labels(model)}
        channels = {"tau_m": tau_m, "q_m": q_m, "q_a": q_a, "y_ref": sample.y[:, :, 0]}
        if sample.R is not None:
            channels["R_ref"] = sample.R.reshape(len(t), 9)
        units = {"tau_m": "N m", "q_m": "rad", "q_a": "rad or m", "y_ref": "m", "R_ref": "-"}
        ports = {
            name: Port(name, (x.shape[1],), units[name], name) for name, x in channels.items()
        }
        return simulate(
            self.equations, Trajectory(t, channels, ports, labels, {"model": model.name})
        )


def library_file(library: Library) -> FilePath:
    """The shared library behind a loaded one."""
    return next(x for x in library.directory.iterdir() if x.suffix in (".so", ".dylib"))


def stream_rows(builds: Builds, quick: bool, say: Callable[[str], None]) -> list[StreamRow]:
    """Both builds, the same samples; the second one's torque is compared with the first one's,
    which is simulated.
    """
    equations = derive(ROBOT)
    there = There(equations, MOVE)
    updates = FEW if quick else UPDATES
    client = builds.text("inversion_stream.c", (HERE / "inversion_stream.c").read_text())
    program = builds.folder / "inversion_stream"
    words = [
        builds.cc,
        "-std=c11",
        "-O2",
        "-Wall",
        "-Wextra",
        str(client),
        "-ldl",
        "-o",
        str(program),
    ]
    subprocess.run(words, check=True)
    samples = there.at(PERIOD * np.arange(1, updates + 1))
    start = there.at(np.zeros(1))[0][0]
    given = np.concatenate([start, there.path.q_start, np.hstack(samples).ravel()]).tobytes()
    rows: list[StreamRow] = []
    for native in (True, False):
        library = inversion_library(equations, "lq", ("stream",), native=native)
        sizes = [library.sizes[key] for key in ("n_t", "n_y", "n_a", "n_g", "n_m")]
        numbers = [INTERVALS, PARTS, PERIOD, TOLERANCE, updates, *sizes]
        command = [str(program), str(library_file(library)), ROBOT, *map(str, numbers)]
        answers = [
            subprocess.run(command, input=given, capture_output=True, check=True).stdout
            for _ in range(RUNS)
        ]
        n_a = library.sizes["n_a"]
        n_m = library.sizes["n_m"]
        tables = [np.frombuffer(answer).reshape(updates, -1) for answer in answers]
        table = tables[0]
        us = 1e-3 * np.min([x[:, 0] for x in tables], axis=0)
        status = table[:, 1]
        residual = table[:, 2]
        assert (status >= 0).all(), f"status {status.min()}"
        samples_per_interval = np.split(table[:, 3:], [PARTS * n_m, 2 * PARTS * n_m], axis=1)
        q_m, tau_m, q_a = (x.reshape(updates * PARTS, -1) for x in samples_per_interval)
        assert q_a.shape[1] == n_a
        t = np.arange(updates * PARTS) * PERIOD / PARTS - (INTERVALS - 1) * PERIOD
        # the first round, and the beginning of the next one
        one = (INTERVALS + there.round) * PARTS
        if rows:
            error = rows[0].error_m, rows[0].error_rad
        else:
            found = there.simulation(t[:one], tau_m[:one], q_m[:one], q_a[:one])
            error = found.tool_error_max_m or 0.0, found.tool_error_max_rad
        round_ = there.round * PARTS
        rounds = (len(t) - one) // round_
        first = tau_m[one - round_ : one]
        later = [tau_m[one + k * round_ : one + (k + 1) * round_] for k in range(rounds)]
        repeats = max((np.abs(x - first).max() for x in later), default=0.0) / np.abs(first).max()
        rows.append(
            StreamRow(
                ROBOT,
                MOVE,
                "native" if native else "default",
                updates,
                *(float(np.percentile(us, p)) for p in (50, 99, 99.9, 100)),
                float(residual.max()),
                int(np.count_nonzero(status)),
                *error,
                float(repeats),
            )
        )
        row = rows[-1]
        say(
            f"  {row.build}: median {row.median_us:.0f}, 99 % {row.p99_us:.0f}, 99.9 % "
            f"{row.p999_us:.0f} us, tool {1e6 * row.error_m:.2g} um, rounds differ by "
            f"{row.repeats:.1e}"
        )
    return rows
