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
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units
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


@dataclass(frozen=True)
class StreamCase:
    """A move that goes to and fro, on a horizon of so many intervals of a period [s]."""

    robot: str = ROBOT
    move: str = MOVE
    period: float = PERIOD
    intervals: int = INTERVALS
    samples_per_interval: int = PARTS


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

    def __init__(self, equations: Equations, move: str, period: float = PERIOD) -> None:
        self.equations = equations
        self.period = period
        self.path = Path(equations, equations.model.move(move))
        self._reduction = Reduction(equations)
        self.way = int(np.ceil(self.path.duration / period - 1e-9))
        self.round = 2 * (self.way + PAUSE)

    def _folded(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Instants on the path and directions at instants of the motion; it is at rest at its end
        for one pause.
        """
        half = (self.way + PAUSE) * self.period
        length = self.round * self.period
        t = np.where(t < 0, 0.0, np.mod(t, length))
        return np.where(t < half, t, self.way * self.period - (t - half)), np.where(
            t < half, 1.0, -1.0
        )

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
        of_output = output_units(model)
        units = {"tau_m": "N m", "q_m": "rad", "q_a": "rad or m", "R_ref": "-"}
        units["y_ref"] = " or ".join(sorted(set(of_output)))
        ports = {
            name: Port(name, (x.shape[1],), units[name], name) for name, x in channels.items()
        }
        of_columns = {"y_ref": of_output} if model.output.is_with_joints else {}
        about = {"model": model.name}
        return simulate(self.equations, Trajectory(t, channels, ports, labels, about, of_columns))


def library_file(library: Library) -> FilePath:
    """The shared library behind a loaded one."""
    return next(x for x in library.directory.iterdir() if x.suffix in (".so", ".dylib"))


def client_program(builds: Builds) -> FilePath:
    """The program that times the updates of a library, compiled."""
    client = builds.text("inversion_stream.c", (HERE / "inversion_stream.c").read_text())
    program = builds.folder / "inversion_stream"
    words = ["-std=c11", "-O2", "-Wall", "-Wextra", str(client), "-ldl", "-o", str(program)]
    subprocess.run([builds.cc, *words], check=True)
    return program


class Updated:
    """The updates of a case: their times, and the motion that they give."""

    def __init__(self, case: StreamCase, there: There, updates: int) -> None:
        self.case = case
        self.there = there
        self.updates = updates
        samples = there.at(case.period * np.arange(1, updates + 1))
        start = there.at(np.zeros(1))[0][0]
        self.given = np.concatenate([start, there.path.q_start, np.hstack(samples).ravel()])
        parts = case.samples_per_interval
        self.t = (
            np.arange(updates * parts) * case.period / parts - (case.intervals - 1) * case.period
        )
        # the first round, and the beginning of the next one
        self.one = (case.intervals + there.round) * parts

    def row(self, program: FilePath, native: bool, simulated: StreamRow | None) -> StreamRow:
        """Time one build; the tool error is simulated unless there is a row with it."""
        case = self.case
        parts = case.samples_per_interval
        library = inversion_library(self.there.equations, "lq", ("stream",), native=native)
        sizes = [library.sizes[key] for key in ("n_t", "n_y", "n_a", "n_g", "n_m")]
        numbers = [case.intervals, parts, case.period, TOLERANCE, self.updates, *sizes]
        prefix = case.robot.replace("@", "_")  # of the names in C
        command = [str(program), str(library_file(library)), prefix, *map(str, numbers)]
        answers = [
            subprocess.run(
                command, input=self.given.tobytes(), capture_output=True, check=True
            ).stdout
            for _ in range(RUNS)
        ]
        n_a = library.sizes["n_a"]
        n_m = library.sizes["n_m"]
        tables = [np.frombuffer(answer).reshape(self.updates, -1) for answer in answers]
        table = tables[0]
        us = 1e-3 * np.min([x[:, 0] for x in tables], axis=0)
        status = table[:, 1]
        assert (status >= 0).all(), f"status {status.min()}"
        motion = np.split(table[:, 3:], [parts * n_m, 2 * parts * n_m], axis=1)
        q_m, tau_m, q_a = (x.reshape(self.updates * parts, -1) for x in motion)
        assert q_a.shape[1] == n_a
        one = self.one
        if simulated is None:
            found = self.there.simulation(self.t[:one], tau_m[:one], q_m[:one], q_a[:one])
            error = found.tool_error_max_m or 0.0, found.tool_error_max_rad
        else:
            error = simulated.error_m, simulated.error_rad
        return StreamRow(
            case.robot,
            case.move,
            "native" if native else "default",
            self.updates,
            *(float(np.percentile(us, p)) for p in (50, 99, 99.9, 100)),
            float(table[:, 2].max()),
            int(np.count_nonzero(status)),
            *error,
            self._repeats(tau_m),
        )

    def _repeats(self, tau_m: np.ndarray) -> float:
        """Largest difference of a torque from that of the first round, relative to the largest."""
        round_ = self.there.round * self.case.samples_per_interval
        one = self.one
        first = tau_m[one - round_ : one]
        later = [
            tau_m[one + k * round_ : one + (k + 1) * round_]
            for k in range((len(tau_m) - one) // round_)
        ]
        most = max((np.abs(x - first).max() for x in later), default=0.0)
        return float(most / np.abs(first).max())


def stream_rows(
    builds: Builds, quick: bool, say: Callable[[str], None], case: StreamCase | None = None
) -> list[StreamRow]:
    """Both builds, the same samples; the torque of the native one is simulated."""
    case = case or StreamCase()
    there = There(derive(case.robot), case.move, case.period)
    updated = Updated(case, there, FEW if quick else UPDATES)
    program = client_program(builds)
    rows: list[StreamRow] = []
    for native in (True, False):
        row = updated.row(program, native, rows[0] if rows else None)
        rows.append(row)
        say(
            f"  {row.build}: median {row.median_us:.0f}, 99 % {row.p99_us:.0f}, 99.9 % "
            f"{row.p999_us:.0f} us, tool {1e6 * row.error_m:.2g} um, rounds differ by "
            f"{row.repeats:.1e}"
        )
    return rows
