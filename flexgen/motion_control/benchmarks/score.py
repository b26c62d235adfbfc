"""The score of a controller in a scenario: all robots in one closed loop, the measures, and their weighted sum.

    V = w_nominal V_0 + sum over sets w_s max over its robots V_i,    V_i = sum_k w_k m_k / m_k(reference controller)

Two more robots are nominal: one with a larger gain of the feedback, one with a longer delay. A controller
is refused where a robot does not come to rest in the end of the run, or where the torque is too noisy.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from flexgen import implementation
from flexgen.arguments import is_whole, seed_of
from flexgen.build.model_library import library_with
from flexgen.deadline import check_time
from flexgen.errors import ArgumentError
from flexgen.loop.closed_loop import ClosedLoop
from flexgen.loop.hardware import DriveHardware
from flexgen.loop.interface import Controller
from flexgen.mechanics.equations import derive
from flexgen.motion_control.benchmarks.leaderboard import scenario_controller
from flexgen.motion_control.benchmarks.measures import Measure, at_rest, measured, measures_of
from flexgen.motion_control.benchmarks.scenario import Scenario, scenario
from flexgen.motion_control.disturbances import disturbance_table
from flexgen.motion_control.plants import NOMINAL, LocalDynamics
from flexgen.progress import Choice, reported

CHUNK = 4000  # samples between two progress messages
FUNCTIONS = ("forward_dynamics", "forward_dynamics_tool_force")


@dataclass(frozen=True, repr=False)
class Score:
    """What a controller reaches in a scenario.

    Attributes
    ----------
    scenario : Scenario
    controller : str
    measures : tuple of Measure
    values : array (robots, measures)
        Of the nominal robot and of those of the sets, in the units of the measures.
    reference : array (measures,)
        Of the reference controller on the nominal robot.
    refused : tuple of str
        Why the controller is refused; empty: it is accepted.
    wall_s : float [s]
    traces : mapping
        ``z`` (n, outputs) and ``u`` (n, n_m) of the nominal robot.
    """

    scenario: Scenario
    controller: str
    measures: tuple[Measure, ...]
    values: np.ndarray
    reference: np.ndarray
    refused: tuple[str, ...]
    wall_s: float
    traces: dict[str, np.ndarray]

    def __repr__(self) -> str:
        text = "refused" if self.refused else f"V = {self.total:.4f}"
        return f"<Score {self.scenario.name}, {self.controller}: {text}>"

    @property
    def accepted(self) -> bool:
        """Whether the controller keeps all conditions."""
        return not self.refused

    @property
    def each(self) -> np.ndarray:
        """Score of every robot (robots,)."""
        weights = np.array([measure.weight for measure in self.measures])
        return np.asarray((self.values / self.reference) @ weights)

    @property
    def total(self) -> float:
        """The score V; NaN where the controller is refused. Smaller is better; the reference controller has about 1."""
        return self._total if self.accepted else float("nan")

    @property
    def _total(self) -> float:
        s, each = self.scenario, self.each
        worst = [max(each[k] for k in lanes) for lanes in s.sets.values()]
        return float(s.nominal_weight * each[0] + np.dot(s.set_weights, worst))

    @property
    def parts(self) -> dict[str, float]:
        """Score of the nominal robot and the worst of each set; empty where the controller is refused."""
        if not self.accepted:
            return {}
        each = self.each
        return {NOMINAL: float(each[0])} | {
            name: float(max(each[k] for k in lanes)) for name, lanes in self.scenario.sets.items()
        }

    def __str__(self) -> str:
        """The scenario, the score and its parts; for a controller that is refused the reasons only."""
        head = f"{self.scenario.title_line}\ncontroller {self.controller}"
        if not self.accepted:
            return "\n".join([f"{head}: refused, no score", *(f"  {reason}" for reason in self.refused)])
        parts = ", ".join(f"{name} {value:.4f}" for name, value in self.parts.items())
        return f"{head}: V = {self.total:.4f} ({parts})"

    @property
    def table(self) -> list[dict[str, Any]]:
        """A row for each measure: name, unit, weight, reference, nominal robot, worst robot of each set."""
        rows = []
        for k, measure in enumerate(self.measures):
            row = {
                "measure": measure.name,
                "unit": measure.unit,
                "weight": measure.weight,
                "reference": float(self.reference[k]),
                NOMINAL: float(self.values[0, k]),
            }
            for name, lanes in self.scenario.sets.items():
                row[name] = float(max(self.values[lane, k] for lane in lanes))
            rows.append(row)
        return rows

    def to_dict(self) -> dict[str, Any]:
        """The score as JSON types; without numbers of the score where the controller is refused."""
        s = self.scenario
        head = {
            "scenario": s.name,
            "version": s.version,
            "hash": s.digest,
            "published_version": s.frozen,
            "controller": self.controller,
            "accepted": self.accepted,
            "refused": list(self.refused),
            "wall_s": self.wall_s,
        }
        if not self.accepted:
            return head
        robots = dict(zip(s.plants.names, map(float, self.each), strict=True))
        return head | {"score": self.total, "parts": self.parts, "robots": robots, "measures": self.table}

    def plot(self) -> Any:
        """A matplotlib Figure: the nominal run, the measures against the reference, the scores of all robots."""
        return implementation("Score.plot")(self)

    def report(self, folder: str | Path) -> Path:
        """Write a page with tables and pictures to a folder; return its path."""
        page: Path = implementation("Score.report")(self, folder)
        return page


@reported("score")
def score(
    name: str | Path | Scenario,
    controller: Any = "reference",
    *,
    seed: int | None = None,
    steps: int | None = None,
    progress: Choice = None,
) -> Score:
    """Score a controller in a benchmark.

    Parameters
    ----------
    name : str, Path or Scenario
        ``"four_mass"`` (benchmark F), ``"two_link"`` (benchmark G) or the path of a scenario.
    controller : str or object
        ``"reference"``, the name of a controller of the benchmark (see `leaderboard`), a path of a ``.toml`` or ``.py``
        file (``file.py:Class``) or of a shared library, or an object as `flexgen.control` takes.
    seed, steps : int, optional
        Other noise, other integration steps in a sample; scores are compared with those of the scenario.
    progress : callable or bool, optional

    Raises
    ------
    ArgumentError
        The scenario or the controller cannot be used.
    """
    tell = progress if callable(progress) else None
    seed = None if seed is None else seed_of(seed)
    if steps is not None and not is_whole(steps, 1, 10_000):
        raise ArgumentError(f"steps: given {steps!r}, expected 1 to 10000")
    chosen = name if isinstance(name, Scenario) else scenario(name)
    bench = Bench(chosen, seed, steps)
    made, title = scenario_controller(controller, chosen, bench.motion)
    began = time.perf_counter()
    units = reference_measures(chosen, seed, steps)
    values, refused, traces = bench.run(made, tell)
    return Score(chosen, title, measures_of(chosen), values, units, tuple(refused), time.perf_counter() - began, traces)


@lru_cache(maxsize=16)
def reference_measures(chosen: Scenario, seed: int | None = None, steps: int | None = None) -> np.ndarray:
    """Measures of the reference controller on the nominal robot (k,)."""
    bench = Bench(chosen, seed, steps)
    controller, _ = scenario_controller("reference", chosen, bench.motion)
    z, u, failures = bench.simulate(controller, [0], np.ones(1), np.array([chosen.delay_s]), None)
    if failures[0]:
        raise ArgumentError(f"{chosen.name}: the reference controller failed: {failures[0]}")
    return measured(chosen, z[:, 0], u[:, 0])


class Bench:
    """The robots of a scenario, ready for any controller."""

    def __init__(self, chosen: Scenario, seed: int | None = None, steps: int | None = None) -> None:
        self.scenario, self.seed, self.steps = chosen, chosen.seed if seed is None else seed, steps or chosen.steps
        self._parts = _prepared(chosen)

    @property
    def motion(self) -> tuple[np.ndarray, ...]:
        """The nominal robot at rest: ``q_a v_a a_a q_m v_m a_m tau_m`` (1, ...)."""
        p, model = self._parts, self.scenario.model
        arm, motors = np.zeros((1, model.n_a)), np.zeros((1, model.n_m))
        return p.q_a[:1], arm, arm, p.q_m[None], motors, motors, p.tau[:1]

    def run(
        self, controller: Controller, tell: Callable[[str], None] | None
    ) -> tuple[np.ndarray, list[str], dict[str, np.ndarray]]:
        """Measures of all robots (robots, k), why the controller is refused, and the traces of the nominal robot."""
        s, accept = self.scenario, self.scenario.accept
        robots = len(s.plants.names)
        gains, delays = np.ones(robots + 2), np.full(robots + 2, s.delay_s)
        gains[robots], delays[robots + 1] = accept.gain, accept.delay_s
        z, u, failures = self.simulate(controller, [*range(robots), 0, 0], gains, delays, tell)
        names = [*s.plants.names, f"{NOMINAL}, gain {accept.gain:g} times as large"]
        names.append(f"{NOMINAL}, delay {1e3 * accept.delay_s:g} ms")
        refused = []
        for k, (name, failure) in enumerate(zip(names, failures, strict=True)):
            rest = float(at_rest(s, z[:, k])[0])
            if failure:
                refused.append(f"{name}: {failure}")
            elif not rest <= accept.rest:
                unit = s.outputs[0].unit
                refused.append(
                    f"{name}: not at rest in the end: {rest:.3g} {unit} peak to peak, expected {accept.rest:g} {unit}"
                )
        values = np.array([measured(s, z[:, k], u[:, k]) for k in range(robots)])
        noisy = [k for k, m in enumerate(measures_of(s)) if m.name.endswith("torque, peak to peak")]
        if noisy and not failures[0] and values[0, noisy[-1]] > accept.torque_noise_Nm:
            refused.append(
                f"{NOMINAL}: torque noise of {values[0, noisy[-1]]:.3g} N m peak to peak, expected at most "
                f"{accept.torque_noise_Nm:g} N m"
            )
        return values, refused, {"z": z[:, 0], "u": u[:, 0]}

    def simulate(
        self,
        controller: Controller,
        lanes: list[int],
        gains: np.ndarray,
        delays: np.ndarray,
        tell: Callable[[str], None] | None,
    ) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Outputs (n, lanes, outputs) less those at the start, torques (n, lanes, n_m) less those at rest; failures."""
        s, p = self.scenario, self._parts
        n, late = round(s.duration_s / s.sample_s), np.round(delays / s.sample_s).astype(int)
        hardware = DriveHardware(s.sample_s, 0.0, 0.0, s.encoder_noise_rad, 0.0, s.torque_max_Nm)
        q_a, tau = p.q_a[lanes], p.tau[lanes]
        q_m = np.tile(p.q_m, (len(lanes), 1))
        loop = ClosedLoop(
            s.model, p.library, hardware, controller, q_a, q_m, p.rate, seed=self.seed, steps=self.steps,
            parameters=s.plants.values[lanes] if s.plants.parameters else None, delay_samples=late, gain=gains,
        )  # fmt: skip
        loop.hold(tau)
        reference = np.concatenate([q_m, tau], axis=1)[None]
        z, u = np.empty((n, len(lanes), len(s.outputs))), np.empty((n, len(lanes), s.model.n_m))
        step = s.sample_s / self.steps
        motors = [m.name for m in s.model.motors]
        for first in range(0, n, CHUNK):
            check_time("score")
            count = min(CHUNK, n - first)
            instants = s.sample_s * first + step * (np.arange(count * self.steps) + 0.5)
            table = disturbance_table({0: s.disturbances}, motors, instants, 1, self.seed)
            found = loop.run(reference, count, motion=True, disturbances=table, check=False)
            assert found.motion is not None
            z[first : first + count] = p.outputs(found.motion[:, : s.model.n_a])
            u[first : first + count] = found.tau_m - tau
            if tell is not None:
                tell(f"{len(lanes)} robots, {100 * (first + count) / n:.0f} % of {s.duration_s:g} s")
        return z - z[:1], u, loop.failures


@dataclass(frozen=True)
class _Prepared:
    """Library and rests (robots, ...) of a scenario, its largest eigenvalue [1/s], and the map to the outputs."""

    library: Any
    q_a: np.ndarray
    q_m: np.ndarray
    tau: np.ndarray
    rate: float
    outputs: Callable[[np.ndarray], np.ndarray]


@lru_cache(maxsize=8)
def _prepared(s: Scenario) -> _Prepared:
    names = tuple(p.name for p in s.plants.parameters)
    functions = [*FUNCTIONS, *(["forward_kinematics"] if any(o.axis for o in s.outputs) else [])]
    library = library_with(s.model, functions, parameters=names, per_point=bool(names))
    local = LocalDynamics(derive(s.model, names))
    q_m = s.model.eta @ np.array(s.start)
    begin = np.zeros(s.model.n_a)
    begin[list(s.model.i_g)] = s.start
    rests = [local.rest(q_m, values, begin) for values in s.plants.values]
    q_a, tau = (np.array(x) for x in zip(*rests, strict=True))
    still_a, still_m = np.zeros((1, s.model.n_a)), np.zeros((1, s.model.n_m))
    rate = max(
        local.largest_rate((a[None], still_a, still_a, q_m[None], still_m, still_m, t[None]), values)
        for a, t, values in zip(q_a, tau, s.plants.values, strict=True)
    )
    return _Prepared(library, q_a, q_m, tau, rate, _outputs(s, library))


def _outputs(s: Scenario, library: Any) -> Callable[[np.ndarray], np.ndarray]:
    """From arm coordinates (n, n_a, lanes) to outputs (n, lanes, outputs)."""
    coordinates = [c.name for c in s.model.coordinates]
    weights = np.array([[o.weights.get(name, 0.0) for name in coordinates] for o in s.outputs])

    def of(q_a: np.ndarray) -> np.ndarray:
        out = (weights @ q_a).transpose(0, 2, 1)
        if any(o.axis for o in s.outputs):
            n, n_a, lanes = q_a.shape
            p = library.forward_kinematics(q_a.transpose(0, 2, 1).reshape(-1, n_a)).p.reshape(n, lanes, 3)
            for k, o in enumerate(s.outputs):
                if o.axis:
                    out[:, :, k] = o.scale * p[:, :, "xyz".index(o.axis)]
        return out

    return of
