"""The robots of a scenario in one closed loop, ready for any controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import check_time, is_over, keep_best, part_known
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.closed_loop import ClosedLoop
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.feedback.loop.interface import Controller
from flexgen.feedback.loop.plants import NOMINAL, LocalDynamics
from flexgen.simulation.environment.disturbances import disturbance_table
from flexgen.studies.scenarios.draws import Draw, draws_of
from flexgen.studies.scenarios.measures import at_rest, compute_measures, measures_of
from flexgen.studies.scenarios.scenario import Scenario

CHUNK = 4000  # samples between two progress messages
FUNCTIONS = ("forward_dynamics", "forward_dynamics_tool_force")
Tell = Callable[[str], None] | None


@dataclass(frozen=True)
class Trial:
    """Results of the robots of a scenario under a controller.

    With fewer draws where the time limit or Ctrl-C has ended it.
    ``values`` (draws, robots, measures); ``refused``: why the controller is refused; ``traces``:
    outputs ``z`` (n, outputs) and torques ``u`` (n, n_m) of the nominal robot in the first draw.
    """

    values: np.ndarray
    refused: tuple[str, ...]
    traces: dict[str, np.ndarray]


class Bench:
    """The robots of a scenario, ready for any controller; ``seed`` of the draws, ``steps`` of the
    integrator.
    """

    def __init__(
        self, chosen: Scenario, seed: int | None = None, steps: int | None = None
    ) -> None:
        """``seed`` and ``steps`` (of the integrator in a sample) replace those of the scenario
        where given.
        """
        self.scenario = chosen
        self.seed = chosen.seed if seed is None else seed
        self.steps = steps or chosen.steps
        self.draws = draws_of(chosen, self.seed)
        self._parts = _prepare(chosen)

    @property
    def motion(self) -> tuple[np.ndarray, ...]:
        """The nominal robot at rest: ``q_a v_a a_a q_m v_m a_m tau_m`` (1, ...)."""
        p = self._parts
        model = self.scenario.model
        arm = np.zeros((1, model.n_a))
        motors = np.zeros((1, model.n_m))
        return p.q_a[:1], arm, arm, p.q_m[None], motors, motors, p.tau[:1]

    def run(self, controller: Controller, tell: Tell = None, *, parts: bool = True) -> Trial:
        """All robots in all draws.

        ``parts``: the draws that are done are the result where the time is over; False: the end of
        the time is an error, as for one of many trials.
        """
        s = self.scenario
        accept = self.scenario.accept
        robots = len(s.plants.names)
        gains = np.ones(robots + 2)
        delays = np.full(robots + 2, s.delay_s)
        gains[robots] = accept.gain
        delays[robots + 1] = accept.delay_s
        names = [*s.plants.names, f"{NOMINAL}, gain {accept.gain:g} times as large"]
        names.append(f"{NOMINAL}, delay {1e3 * accept.delay_s:g} ms")
        values = []
        refused = dict[str, None]()
        traces = dict[str, np.ndarray]()
        for number, draw in enumerate(self.draws):
            began = perf_counter()
            label = f"draw {number + 1} of {len(self.draws)}, " if len(self.draws) > 1 else ""
            with keep_best() if parts else nullcontext():
                z, u, failures = self.simulate(
                    controller,
                    [*range(robots), 0, 0],
                    gains,
                    delays,
                    draw,
                    tell and _add_prefix(tell, label),
                )
                own = np.array(
                    [compute_measures(s, draw.windows, z[:, k], u[:, k]) for k in range(robots)]
                )
                values.append(own)
            if len(values) <= number:
                break
            for reason in self._reasons(draw, names, z, own, failures):
                refused[reason if len(self.draws) == 1 else f"{label}{reason}"] = None
            if number == 0:
                traces = {"z": z[:, 0], "u": u[:, 0]}
            if parts:
                part_known("draws", perf_counter() - began, len(self.draws) - number - 1)
                if is_over():
                    break
        return Trial(np.array(values), tuple(refused), traces)

    def _reasons(
        self,
        draw: Draw,
        names: Sequence[str],
        z: np.ndarray,
        values: np.ndarray,
        failures: Sequence[str],
    ) -> list[str]:
        """Why a controller is refused in a draw: a simulation failed, an output is not at rest in
        the end, torques are noisy, or a measure is not a number.

        ``names``: of the robots and the two tests of margins; ``z`` (n, robots, outputs): outputs;
        ``values`` (robots, k): measures; ``failures``: texts of the simulations, empty for none.
        """
        s = self.scenario
        accept = self.scenario.accept
        refused = []
        for k, (name, failure) in enumerate(zip(names, failures, strict=True)):
            if failure:
                refused.append(f"{name}: {failure}")
                continue
            rest = at_rest(s, draw.windows, z[:, k])
            worst = int(np.argmax(np.nan_to_num(rest, nan=np.inf)))
            if not rest[worst] <= accept.rest:
                unit = s.outputs[worst].unit
                of = f"{s.outputs[worst].name} " if len(s.outputs) > 1 else ""
                refused.append(
                    f"{name}: {of}not at rest in the end: {rest[worst]:.3g} {unit} peak to "
                    f"peak, expected {accept.rest:g} {unit}"
                )
        noisy = [
            k for k, m in enumerate(measures_of(s)) if m.name.endswith("torque, peak to peak")
        ]
        if noisy and not failures[0] and values[0, noisy[-1]] > accept.torque_noise_Nm:
            refused.append(
                f"{NOMINAL}: torque noise of {values[0, noisy[-1]]:.3g} N m peak to peak, "
                f"expected at most {accept.torque_noise_Nm:g} N m"
            )
        for k, m in enumerate(measures_of(s)):
            broken = [
                name
                for name, own in zip(names, values[:, k], strict=False)
                if not np.isfinite(own)
            ]
            if broken and not any(failures):
                refused.append(f"{broken[0]}: {m.name} is not a finite number")
        return refused

    def simulate(
        self,
        controller: Controller,
        lanes: list[int],
        gains: np.ndarray,
        delays: np.ndarray,
        draw: Draw,
        tell: Tell = None,
    ) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Outputs (n, lanes, outputs) less those at the start, torques (n, lanes, n_m) [N m] less
        those at rest; failures.

        ``lanes``: numbers of the robots; ``gains``, ``delays`` (lanes,): factors of the torques,
        and their delays [s]. Robots are simulated in an order that the draw decides, and returned
        in that of ``lanes``.
        """
        s = self.scenario
        p = self._parts
        n = round(s.duration_s / s.sample_s)
        order = draw.order(len(lanes))
        at = np.array(lanes)[order]
        hardware = DriveHardware(s.sample_s, 0.0, 0.0, s.encoder_noise_rad, 0.0, s.torque_max_Nm)
        q_a = p.q_a[at]
        tau = p.tau[at]
        q_m = np.tile(p.q_m, (len(at), 1))
        loop = ClosedLoop(
            s.model,
            p.library,
            hardware,
            controller,
            q_a,
            q_m,
            p.rate,
            seed=draw.seed,
            steps=self.steps,
            parameters=s.plants.values[at] if s.plants.parameters else None,
            delay_samples=np.round(delays[order] / s.sample_s).astype(int),
            gain=gains[order],
        )
        loop.hold(tau)
        loop.sample = draw.first
        reference = np.concatenate([q_m, tau], axis=1)[None]
        z = np.empty((n, len(at), len(s.outputs)))
        u = np.empty((n, len(at), s.model.n_m))
        for first in range(0, n, CHUNK):
            check_time("score")
            count = min(CHUNK, n - first)
            table = disturbances_of(s, draw, self.steps, first, count)
            found = loop.run(reference, count, motion=True, disturbances=table, check=False)
            assert found.motion is not None
            z[first : first + count] = p.outputs(found.motion[:, : s.model.n_a])
            u[first : first + count] = found.tau_m - tau
            if tell is not None:
                tell(f"{len(at)} robots, {100 * (first + count) / n:.0f} % of {s.duration_s:g} s")
        back = np.argsort(order)
        failures = loop.failures
        return (z - z[:1])[:, back], u[:, back], tuple(failures[k] for k in back)


def _add_prefix(tell: Callable[[str], None], label: str) -> Callable[[str], None]:
    return lambda line: tell(label + line)


@lru_cache(maxsize=256)
def disturbances_of(
    s: Scenario, draw: Draw, steps: int, first: int, count: int
) -> np.ndarray | None:
    """Disturbances of ``count`` samples from number ``first`` on, in each step of the integrator;
    None without any. Noise is slow to compute, so that they are kept.
    """
    step = s.sample_s / steps
    instants = s.sample_s * first + step * (np.arange(count * steps) + 0.5)
    return disturbance_table(
        {0: draw.disturbances}, [m.name for m in s.model.motors], instants, 1, draw.seed
    )


@dataclass(frozen=True)
class _Prepared:
    """Library and rests (robots, ...) of a scenario, its largest eigenvalue [1/s], and the map to
    the outputs.
    """

    library: Any
    q_a: np.ndarray
    q_m: np.ndarray
    tau: np.ndarray
    rate: float
    outputs: Callable[[np.ndarray], np.ndarray]


@lru_cache(maxsize=8)
def _prepare(s: Scenario) -> _Prepared:
    """Library, rest of every robot at the start pose, and the largest rate of change there, by
    which steps of the integrator are chosen.
    """
    names = tuple(p.name for p in s.plants.parameters)
    functions = [*FUNCTIONS, *(["forward_kinematics"] if any(o.axis for o in s.outputs) else [])]
    library = library_with(s.model, functions, parameters=names, per_point=bool(names))
    local = LocalDynamics(derive(s.model, names))
    q_m = s.model.eta @ np.array(s.start)
    begin = np.zeros(s.model.n_a)
    begin[list(s.model.i_g)] = s.start
    rests = [local.rest(q_m, values, begin) for values in s.plants.values]
    q_a, tau = (np.array(x) for x in zip(*rests, strict=True))
    still_a = np.zeros((1, s.model.n_a))
    still_m = np.zeros((1, s.model.n_m))
    rate = max(
        local.largest_rate(
            (a[None], still_a, still_a, q_m[None], still_m, still_m, t[None]), values
        )
        for a, t, values in zip(q_a, tau, s.plants.values, strict=True)
    )
    return _Prepared(library, q_a, q_m, tau, rate, outputs_of(s, library))


def outputs_of(s: Scenario, library: Any) -> Callable[[np.ndarray], np.ndarray]:
    """The function from arm coordinates (n, n_a, lanes) to outputs (n, lanes, outputs): sums of
    coordinates, or a component of the tool's position times its scale.
    """
    coordinates = [c.name for c in s.model.coordinates]
    weights = np.array([[o.weights.get(name, 0.0) for name in coordinates] for o in s.outputs])

    def of(q_a: np.ndarray) -> np.ndarray:
        """Outputs (n, lanes, outputs), each in its unit."""
        out = (weights @ q_a).transpose(0, 2, 1)
        if any(o.axis for o in s.outputs):
            n, n_a, lanes = q_a.shape
            p = library.forward_kinematics(q_a.transpose(0, 2, 1).reshape(-1, n_a)).p.reshape(
                n, lanes, 3
            )
            for k, o in enumerate(s.outputs):
                if o.axis:
                    out[:, :, k] = o.scale * p[:, :, "xyz".index(o.axis)]
        return out

    return of
