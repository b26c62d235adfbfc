"""A model, a library of it, a sampled path, and what the full model does under the torques that
the library gives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from emitted import paths_library

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.model.elements import RobotModel
from flexgen.paths.path import Path
from flexgen.runtime.library import Library
from flexgen.runtime.streams.stream import Interval, Stream
from flexgen.simulation.integration.hold import TorqueCommand
from flexgen.simulation.result import Simulation
from flexgen.simulation.simulate import simulate

UPDATE = 5e-3  # s
AHEAD = 20  # intervals
PARTS = 5  # samples in each
AFTER = 0.1  # s: how long a stream continues after the end of its path
DIFFERENCES = 6  # samples beyond an interval that derivatives need


class Machine:
    """A model, its library, a path, and what they make of each other."""

    def __init__(
        self, name: str | RobotModel, move: str | None, library: Library | None = None
    ) -> None:
        self.equations: Equations = derive(name)
        self.path = Path(self.equations, self.equations.model.move(move))
        self.library: Library = library or paths_library(self.equations, "invert", "stream")
        self._reduction = Reduction(self.equations)

    def samples(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Place, dy and its dy at instants."""
        sample = self.path.sample(t)
        return self._reduction.targets(sample), sample.derivative(1), sample.derivative(2)

    def begun(self, ahead: int = AHEAD, samples_per_interval: int = PARTS, **hold: Any) -> Stream:
        y = self.samples(np.zeros(1))[0][0]
        return self.library.stream(
            y,
            self.path.q_start,
            period=UPDATE,
            intervals=ahead,
            samples_per_interval=samples_per_interval,
            **hold,
        )

    def simulation(
        self, t: np.ndarray, results: dict[str, np.ndarray], hold: str = "", delay: float = 0.0
    ) -> Simulation:
        """Simulation of the full model under the torques, from rest; ``delay`` in samples."""
        model = self.equations.model
        sample = self.path.sample(t)
        arm = tuple(c.name for c in model.coordinates)
        motors = tuple(m.name for m in model.motors)
        labels = {"tau_m": motors, "q_a": arm, "q_m": motors, **output_labels(model)}
        channels = {name: results[name] for name in ("tau_m", "q_a", "q_m")} | {
            "y_ref": sample.y[:, :, 0]
        }
        if sample.R is not None:
            channels["R_ref"] = sample.R.reshape(len(t), 9)
        of_output = output_units(model)
        units = {"tau_m": "N m", "q_a": "rad or m", "q_m": "rad", "R_ref": "-"}
        units["y_ref"] = " or ".join(sorted(set(of_output)))
        ports = {
            name: Port(name, (x.shape[1],), units[name], name) for name, x in channels.items()
        }
        of_columns = {"y_ref": of_output} if model.output.is_with_joints else {}
        trajectory = Trajectory(t, channels, ports, labels, {"model": model.name}, of_columns)
        if not hold:
            return simulate(self.equations, trajectory)
        sample_time = (t[-1] - t[0]) / (len(t) - 1)
        command = TorqueCommand(
            t, results["tau_m"], motors, hold, sample_time, delay * sample_time, {}
        )
        return simulate(self.equations, trajectory, command=command)

    def updates(
        self, ahead: int = AHEAD, samples_per_interval: int = PARTS, **hold: Any
    ) -> list[Interval]:
        """The intervals of a stream along the path, and some time behind it."""
        stream = self.begun(ahead, samples_per_interval, **hold)
        n = int(np.ceil((self.path.duration + AFTER) / UPDATE)) + ahead
        return [
            stream.update(*sample)
            for sample in zip(*self.samples(UPDATE * np.arange(1, n + 1)), strict=True)
        ]

    def followed(
        self,
        ahead: int = AHEAD,
        samples_per_interval: int = PARTS,
        checked: bool = True,
        **hold: Any,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Instants and results of a stream along the path, and some time behind it."""
        intervals = self.updates(ahead, samples_per_interval, **hold)
        n = len(intervals)
        few = (ahead - 1) * samples_per_interval < DIFFERENCES
        assert not checked or few or all(interval.converged for interval in intervals)
        names = ("q_a", "v_a", "tau_g", "q_m", "v_m", "tau_m")
        t = (
            np.arange(n * samples_per_interval) * UPDATE / samples_per_interval
            - (ahead - 1) * UPDATE
        )
        return t, {name: np.vstack([getattr(x, name) for x in intervals]) for name in names}


def error(simulation: Simulation) -> float:
    """Of the tool, in metres or rad, whichever is more."""
    return max(simulation.tool_error_max_m or 0.0, simulation.tool_error_max_rad or 0.0)
