"""Rows of benchmarks/control.md about differing robots: learning, minimum time, collisions and
loads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.control import run_case
from flexgen.feedback.loop.interface import Measurement, Reference
from flexgen.feedback.loop.named_controllers import controller_of

SAMPLE_S = 1e-3
Row = tuple[object, ...]


class PythonCascade:
    """A proportional controller as an object of Python, for the speed of such controllers."""

    def __init__(self, model: flexgen.RobotModel) -> None:
        self.gain = np.full(model.n_m, 1e-3)

    def reset(self) -> None:
        """Nothing is kept."""

    def step(self, k: int, y: Measurement, ref: Reference) -> np.ndarray:
        """Proportional feedback of the angles around the feedforward."""
        return np.asarray(ref.tau_m + self.gain * (ref.q_m - y.q_m))


def halved_steps(names: Iterable[str]) -> Iterator[Row]:
    """Largest change of an arm coordinate when the steps of a sample are halved, and the order of
    it.
    """
    for name in names:
        case = control_case(name, sample_time=SAMPLE_S, plants={"soft": {"stiffness": 0.9}})
        law, _ = controller_of(
            "ppi", case.model, SAMPLE_S, 0.0, case.reference.points(np.array([0]))
        )
        q = [run_case(case, law, "ppi", steps=steps)["soft"].q_a for steps in (2, 4, 8, 16)]
        changes = [np.abs(a - b).max() for a, b in zip(q[1:], q[:-1], strict=True)]
        order = np.log2(changes[0] / changes[1])
        yield name, f"{case.rate:.0f}", *(f"{x:.1e}" for x in changes), f"{order:.2f}"


def learning_settings() -> Iterator[Row]:
    """Other cut-off frequencies and gains of learning than the default; also those that
    diverge.
    """
    name = "manutec_r3_18"
    solution = flexgen.solve(name, progress=False)
    loaded = {"stiffness": 0.8, "payload": 5.0}
    for plant, f, gain in (
        (loaded, 10.0, 1.0),
        (loaded, 5.0, 1.0),
        (loaded, 10.0, 0.5),
        ({"stiffness": 1.2}, 40.0, 1.0),
    ):
        found = flexgen.learn(
            name,
            plant=plant,
            solution=solution,
            iterations=10,
            sample_time=SAMPLE_S,
            encoder_noise=1e-4,
            frequency_hz=f,
            gain=gain,
            progress=False,
        )
        errors = ", ".join(f"{1e3 * e:.4f}" for e in found.errors_m)
        yield (
            name,
            ", ".join(f"{k} {v:g}" for k, v in plant.items()),
            f"{f:g}",
            gain,
            errors,
            found.best,
        )


def time_settings(name: str) -> Iterator[Row]:
    """Minimum time with other numbers of coefficients, bounds of the torque rate, and of the
    vibration.
    """
    default = flexgen.solve(name, progress=False)
    limits = Limits(torque=tuple(np.abs(default.trajectory["tau_m"]).max(axis=0)))
    settings: list[tuple[str, dict[str, float]]] = [
        (f"{n} coefficients", {"coefficients": n}) for n in (4, 10, 16, 24)
    ]
    settings += [
        (f"torque rate {x:g} times that of the given law", {"torque_rate": x}) for x in (2.5, 1.5)
    ]
    free = flexgen.fastest(name, limits=limits, progress=False)
    settings += [("vibration at most a third", {"vibration": free.vibration_m["soft"] / 3})]
    for told, options in settings:
        found = flexgen.fastest(name, limits=limits, progress=False, **options)
        yield (
            name,
            told,
            f"{found.duration_s:.4f}",
            f"{100 * (found.duration_s / found.default_s - 1):.0f} %",
            f"{1e6 * found.vibration_m['soft']:.3g}",
            found.inversions,
            f"{found.cpu_s:.2f}",
        )


def collisions() -> Iterator[Row]:
    """Time until a push at the tool is found [ms], thresholds from 60 other robots; noise 1e-5
    rad.
    """
    name = "manutec_r3_18"
    rng = np.random.default_rng(5)
    model = flexgen.read(name)
    solution = flexgen.solve(name, progress=False)

    def runs(
        count: int, seed: int, pushes: dict[str, list[flexgen.Disturbance]]
    ) -> flexgen.ControlRun:
        draw = np.random.default_rng(seed)
        plants = {
            f"robot {k}": {
                "stiffness": float(draw.uniform(0.9, 1.1)),
                "payload": float(draw.uniform(-1, 1)),
            }
            for k in range(count)
        }
        return flexgen.control(
            name,
            plants=plants,
            disturbances=pushes,
            sample_time=SAMPLE_S,
            encoder_noise=1e-5,
            seed=seed,
            solution=solution,
            progress=False,
        )

    count = 30
    free = runs(60, 1, {})
    quiet = runs(100, 2, {})
    starts = np.round(rng.uniform(0.1, 0.9, count) * free.reference.path_end / SAMPLE_S) * SAMPLE_S
    axes = rng.choice(["tool.x", "tool.y", "tool.z"], count)
    for force in (50.0, 100.0, 200.0):
        pushes = {
            f"robot {k}": [flexgen.Disturbance("step", str(axes[k]), force, float(starts[k]))]
            for k in range(count)
        }
        hit = runs(count, 3, pushes)
        for bandwidth in (5.0, 15.0, 40.0):
            detector = flexgen.CollisionDetector(model, SAMPLE_S, bandwidth)
            detector.calibrate([(r.measured, r.tau_m) for r in free.runs])
            false = sum(
                detector.detect(r.measured, r.tau_m).sample is not None for r in quiet.runs
            )
            late = []
            missed = 0
            for run, start in zip(hit.runs[1:], starts, strict=True):
                sample = detector.detect(run.measured, run.tau_m).sample
                missed += sample is None
                late += [] if sample is None else [1e3 * (hit.reference.time[sample] - start)]
            found = f"{min(late):.0f} to {max(late):.0f}" if late else "-"
            yield f"{force:g}", f"{bandwidth:g}", found, f"{np.median(late):.0f}", missed, false


def loads() -> Iterator[Row]:
    """Load of 20 kg from one move: mass and center of mass, with and without deflections."""
    name = "manutec_r3_18"
    model = flexgen.read(name)
    for stiffness in (0.8, 1.0, 1.2):
        run = flexgen.control(
            name,
            plants={"robot": {"payload": 20.0, "stiffness": stiffness}},
            sample_time=SAMPLE_S,
            encoder_noise=1e-4,
            torque_limits=False,
            progress=False,
        )
        data = run.trajectory("robot")
        found, rigid = (flexgen.identify_load(name, data, rigid=x) for x in (False, True))
        masses = [f"{x.mass:.3f} ({100 * (x.mass / 20 - 1):+.2f} %)" for x in (found, rigid)]
        centers = [f"{1e3 * np.abs(x.com - model.payload.com).max():.1f}" for x in (found, rigid)]
        yield (
            f"{stiffness:g}",
            masses[0],
            centers[0],
            masses[1],
            centers[1],
            f"{found.mass_sd:.3f}",
        )
