"""The score of a controller in a scenario: all robots in one closed loop, the measures, and their
weighted sum.

    V_d = w_nominal V_d0 + sum over sets w_s max over its robots V_di,
    V_di = sum_k w_k m_dik / m_dk(reference)
    V = mean over the draws d of V_d

m(reference): of the reference controller on the nominal robot in the same draw. Two more robots
are nominal: one with a larger gain of the feedback, one with a longer delay. A controller is
refused where a robot does not come to rest, or where the torque is too noisy, in any draw. The
draws of controllers that are code of others are new in every score.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Seed, TimeLimit
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Table
from flexgen.base.spec.arguments import is_whole, seed_of
from flexgen.feedback.loop.interface import Controller
from flexgen.feedback.loop.plants import NOMINAL
from flexgen.studies.scenarios.bench import Bench
from flexgen.studies.scenarios.draws import draws_of, secret_seed
from flexgen.studies.scenarios.foreign import INSIDE, ForeignController
from flexgen.studies.scenarios.leaderboard import scenario_controller
from flexgen.studies.scenarios.measures import Measure, compute_measures, measures_of
from flexgen.studies.scenarios.scenario import Scenario
from flexgen.studies.scenarios.scenario_file import scenario


def robot_scores(
    measures: Sequence[Measure], values: np.ndarray, reference: np.ndarray
) -> np.ndarray:
    """Scores of the robots (draws, robots) by measures (draws, robots, k) and those of the
    reference (draws, k).
    """
    return np.asarray(
        (values / reference[:, None]) @ np.array([measure.weight for measure in measures])
    )


def draw_totals(chosen: Scenario, each: np.ndarray) -> np.ndarray:
    """Scores of the draws (draws,) from those of the robots (draws, robots)."""
    total = chosen.nominal_weight * each[:, 0]
    for weight, lanes in zip(chosen.set_weights, chosen.sets.values(), strict=True):
        total = total + weight * each[:, list(lanes)].max(axis=1)
    return np.asarray(total)


@checked_result
@dataclass(frozen=True, repr=False)
class Score(Result):
    """Score of a controller in a scenario.

    Attributes
    ----------
    scenario : Scenario
    controller : str
    seed : int
        Of the draws; `flexgen.score` with it repeats the score.
    rule : str
        Empty, or why the score does not follow the rule of the benchmark.
    measures : tuple of Measure
    values : array (draws, robots, measures)
        Of the nominal robot and of those of the sets, in the units of the measures.
    reference : array (draws, measures)
        Of the reference controller on the nominal robot.
    refused : tuple of str
        Why the controller is refused; empty: it is accepted.
    wall_s : float [s]
    traces : mapping
        ``z`` (n, outputs) and ``u`` (n, n_m) of the nominal robot in the first draw.
    ended : str
        Empty; ``"time limit"`` or ``"interrupted"`` where not all draws were simulated: then the
        score is that of the draws that were.

    Examples
    --------
    >>> result = flexgen.score("four_mass", version=1)
    >>> result.accepted, f"{result.total:.3f}", f"{result.worst:.3f}"
    (True, '1.023', '1.023')
    """

    scenario: Scenario
    controller: str
    seed: int
    rule: str
    measures: tuple[Measure, ...]
    values: np.ndarray
    reference: np.ndarray
    refused: tuple[str, ...]
    wall_s: float
    traces: dict[str, np.ndarray]
    ended: str = ""

    def __repr__(self) -> str:
        text = "refused" if self.refused else f"V = {self.total:.4f}"
        early = f", {self.status}" if self.ended else ""
        return f"<Score {self.scenario.name}, {self.controller}: {text}{early}>"

    @property
    def status(self) -> str:
        """``done``, or why not all draws were simulated, and how many were."""
        if not self.ended:
            return "done"
        plan = self.scenario.plan
        draws = 1 if plan is None else plan.draws
        return f"{self.ended}: the score of {len(self.values)} of {draws} draws"

    @property
    def accepted(self) -> bool:
        """Whether the controller keeps all conditions, and its score is a number."""
        return not self.refused and bool(np.isfinite(self._totals).all())

    @property
    def each(self) -> np.ndarray:
        """Score of every robot, mean over the draws (robots,)."""
        return np.asarray(self.per_draw.mean(axis=0))

    @property
    def totals(self) -> np.ndarray:
        """Score V_d of every draw (draws,); empty where the controller is refused."""
        return self._totals if self.accepted else np.zeros(0)

    @property
    def total(self) -> float:
        """The score V; NaN where the controller is refused. Smaller is better; the reference
        controller has about 1.
        """
        return float(self._totals.mean()) if self.accepted else float("nan")

    @property
    def worst(self) -> float:
        """The largest score of a draw; NaN where the controller is refused."""
        return float(self._totals.max()) if self.accepted else float("nan")

    @property
    def spread(self) -> float:
        """Standard deviation of the scores of the draws; NaN with one draw, or where the
        controller is refused.
        """
        return (
            float(self._totals.std(ddof=1))
            if self.accepted and len(self._totals) > 1
            else float("nan")
        )

    @property
    def per_draw(self) -> np.ndarray:
        """Scores of the robots in each draw (draws, robots)."""
        return robot_scores(self.measures, self.values, self.reference)

    @property
    def _totals(self) -> np.ndarray:
        return draw_totals(self.scenario, self.per_draw)

    @property
    def parts(self) -> dict[str, float]:
        """Score of the nominal robot and the worst of each set, means over the draws; empty where
        it is refused.
        """
        if not self.accepted:
            return {}
        each = self.per_draw
        return {NOMINAL: float(each[:, 0].mean())} | {
            name: float(each[:, list(lanes)].max(axis=1).mean())
            for name, lanes in self.scenario.sets.items()
        }

    @property
    def spread_words(self) -> str:
        """Worst draw and spread in words; empty with one draw."""
        if len(self.totals) < 2:
            return ""
        return (
            f"worst draw {self.worst:.4f}, spread {self.spread:.4f} over {len(self.totals)} draws"
        )

    def __str__(self) -> str:
        """The scenario, the score and its parts; for a controller that is refused the reasons
        only.
        """
        head = f"{self.scenario.title_line}\ncontroller {self.controller}"
        note = [f"  {self.rule}"] if self.rule else []
        note += [f"  {self.status}"] if self.ended else []
        if not self.accepted:
            return "\n".join(
                [f"{head}: refused, no score", *(f"  {reason}" for reason in self.refused), *note]
            )
        parts = ", ".join(f"{name} {value:.4f}" for name, value in self.parts.items())
        words = f"; {self.spread_words}" if self.spread_words else ""
        return "\n".join([f"{head}: V = {self.total:.4f} ({parts}{words})", *note])

    @property
    def table(self) -> list[dict[str, Any]]:
        """A row for each measure: name, unit, weight, reference, nominal robot, worst robot of
        each set; means over the draws.
        """
        rows = []
        for k, measure in enumerate(self.measures):
            row = {
                "measure": measure.name,
                "unit": measure.unit,
                "weight": measure.weight,
                "reference": float(self.reference[:, k].mean()),
                NOMINAL: float(self.values[:, 0, k].mean()),
            }
            for name, lanes in self.scenario.sets.items():
                row[name] = float(self.values[:, list(lanes), k].max(axis=1).mean())
            rows.append(row)
        return rows

    def content(self) -> tuple[Part, ...]:
        """The score and its parts, and a table of the measures; of a controller that is refused
        the reasons only.
        """
        s = self.scenario
        head = (
            Prose(s.title_line, is_title=True),
            Data("scenario", s.name),
            Data("version", s.version),
            Data("hash", s.digest),
            Data("published_version", s.frozen),
            Row("controller", self.controller, "", "controller"),
            Row("seed of the draws", self.seed, "", "seed"),
            Data("rule", self.rule),
            Data("status", self.status),
            Data("draws_done", len(self.values)),
            Data("accepted", self.accepted),
            Data("refused", list(self.refused)),
            Data("wall_s", self.wall_s),
        )
        notes = [Prose(line, "notes") for line in (self.rule, self.ended and self.status) if line]
        if self.accepted:
            return (*head, *self._numbers(), *notes)
        reasons = [Prose(reason, "refused") for reason in self.refused]
        return (*head, Prose("refused, no score", "refused"), *reasons, *notes)

    def _numbers(self) -> tuple[Part, ...]:
        """Score, parts and measures of a controller that is accepted."""
        robots = dict(zip(self.scenario.plants.names, map(float, self.each), strict=True))
        spread: tuple[Part, ...] = ()
        if len(self.totals) > 1:
            spread = (
                Row("worst draw", self.worst, "", "worst"),
                Row("standard deviation of the draws", self.spread, "", "spread"),
                Data("draws", self.totals.tolist()),
            )
        names = (NOMINAL, *self.scenario.sets)
        titles = (NOMINAL, *(f"worst of {name}" for name in self.scenario.sets))
        columns = (
            Column("measure", "", "measure"),
            Column("unit", "", "unit"),
            Column("weight", "", "weight"),
            Column("reference", "", "reference"),
            *(Column(title, "", name) for title, name in zip(titles, names, strict=True)),
        )
        cells = tuple(tuple(row[column.key] for column in columns) for row in self.table)
        return (
            Row("score V", self.total, "", "score", note="about 1 expected, smaller is better"),
            *spread,
            *(Row(f"V of {name}", value) for name, value in self.parts.items()),
            Data("parts", self.parts),
            Data("sets", [*self.scenario.sets]),
            Data("robots", robots),
            Table(columns, cells, "Measures", "measures"),
        )


@checked_types
@reported("score")
def score(
    name: str | Path | Scenario,
    controller: Any = "reference",
    *,
    version: int | None = None,
    seed: Seed | None = None,
    steps: int | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> Score:
    """Score a controller in a benchmark.

    Parameters
    ----------
    name : str, Path or Scenario
        ``four_mass``, ``two_link`` (``four_mass@1``: version 1), or the path of a .toml file like
        theirs. Benchmarks F and G.
    controller : str or object
        ``"reference"`` (the default), the name of a controller of the benchmark. See
        `leaderboard`; or a path of a ``.toml`` or ``.py`` file (``file.py:Class``) or of a shared
        library, or an object as `flexgen.control` takes. Python and shared libraries run in a
        separate process.
    version : int, optional
        Of the benchmark; default: the newest. ``"four_mass@1"`` is version 1 too.
    seed : int, optional
        Of draws and noise; default: that of the benchmark, a new one for code. Code: Python and
        shared libraries.
    steps : int, optional
        Other integration steps in a sample.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the score is that of the draws that
        were simulated, and ``ended`` says so. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    Score

    Raises
    ------
    ArgumentError
        The scenario or the controller cannot be used.
    OutOfTime
        The time was over before the first draw.

    Examples
    --------
    >>> result = flexgen.score("four_mass", version=1)
    >>> f"{result.total:.3f}"  # below 1 is better than the reference of this benchmark
    '1.023'
    """
    tell = progress if callable(progress) else None
    seed = None if seed is None else seed_of(seed)
    if steps is not None and not is_whole(steps, 1, 10_000):
        raise ArgumentError(f"steps: given {steps!r}, expected 1 to 10000")
    if isinstance(name, Scenario) and version is not None:
        raise ArgumentError(
            f"version: given {version!r} with a scenario, expected none: the scenario has its own"
        )
    if os.environ.get(INSIDE):
        raise ArgumentError(
            "score: called in the process of a controller, expected only in a program: put the "
            "call under if __name__ == '__main__':"
        )
    chosen = name if isinstance(name, Scenario) else scenario(name, version)
    made, title = scenario_controller(controller, chosen, Bench(chosen).motion)
    rule = find_broken_rule(chosen, made, seed, steps)
    if seed is None:
        drawn = isinstance(made, ForeignController) and chosen.plan is not None
        seed = secret_seed() if drawn else chosen.seed
    began = time.perf_counter()
    try:
        with limit_fit("score", time_limit, tell, first="draw"):
            units = reference_measures(chosen, seed, steps)
            trial = Bench(chosen, seed, steps).run(made, tell)
            done = len(trial.values)
            ended = reason_of_end() if done < len(units) else ""
    finally:
        if isinstance(made, ForeignController):
            made.close()
    seconds = time.perf_counter() - began
    return Score(
        chosen,
        title,
        seed,
        rule,
        measures_of(chosen),
        trial.values,
        units[:done],
        trial.refused,
        seconds,
        trial.traces,
        ended,
    )


def find_broken_rule(
    chosen: Scenario, made: Controller, seed: int | None, steps: int | None
) -> str:
    """Reason why a score does not follow the rule of its benchmark; empty if it does. ``seed``,
    ``steps``: as given by the user, None for those of the scenario.
    """
    if isinstance(made, ForeignController):
        if chosen.plan is None:
            return (
                f"no fair score: the times of version {chosen.version} are known to the controller"
            )
        if seed is not None:
            return (
                f"no fair score: the seed {seed} was given, and the controller may know its draws"
            )
        if made.is_object:
            return (
                "no published score: the object is part of the program that scores it; give a file"
            )
    elif seed is not None and seed != chosen.seed:
        return f"not the published score: other draws and noise, of the seed {seed}"
    if steps is not None and steps != chosen.steps:
        return f"not the published score: {steps} integration steps in a sample"
    return ""


@lru_cache(maxsize=16)
def reference_measures(chosen: Scenario, seed: int, steps: int | None = None) -> np.ndarray:
    """Measures of the reference controller on the nominal robot (draws, k)."""
    bench = Bench(chosen, seed, steps)
    controller, _ = scenario_controller("reference", chosen, bench.motion)
    out = []
    for draw in draws_of(chosen, seed):
        z, u, failures = bench.simulate(
            controller, [0], np.ones(1), np.array([chosen.delay_s]), draw
        )
        if failures[0]:
            raise ArgumentError(f"{chosen.name}: the reference controller failed: {failures[0]}")
        out.append(compute_measures(chosen, draw.windows, z[:, 0], u[:, 0]))
        for measure, value in zip(measures_of(chosen), out[-1], strict=True):
            if not (np.isfinite(value) and value > 0):
                raise ArgumentError(
                    f"{chosen.name}, {measure.name}: the reference controller has {value} "
                    f"{measure.unit}, expected a number > 0: measures are counted in those of "
                    "the reference"
                )
    units = np.array(out)
    units.setflags(write=False)
    return units
