"""Scenarios of the benchmarks: one TOML file for each version, frozen by the hash of its content.

A scenario names the model and its changes, the sampled loop, the disturbances, the sets of robots,
the measures with their weights, what a controller is refused for, and the reference controller,
whose measures are the units of score. Version 1 states the times of the disturbances; from version
2 on they are drawn (`draws.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.plants import Plants
from flexgen.model.elements import RobotModel
from flexgen.simulation.environment.disturbances import Disturbance
from flexgen.studies.scenarios.content import content_hash

# What was published never changes: the hash of the content of each version, and the hash that it
# is known by where it is another one (of version 1 that of the file).
FROZEN = {
    ("four_mass", 1): (
        "d649b0d775fd47d157557e2a651fe50ef573dbbd5623676e6b7936edebf47054",
        "6c9c55b8edde74fc673e00a0f28be484eb59e2894330b6203057eca5029c4764",
    ),
    ("two_link", 1): (
        "31418b21fda0daf54107fe27a4a87808833e6c3b28f46b3eb864dad61b6fd2f8",
        "72d3d30b42d2b3340ac1c8328a496844ec1e60e565b1e04aca91556874eedae3",
    ),
    ("four_mass", 2): ("97a708d978e9c73b66b02e71ab02646051de77e85a906d64d315e90015ab8434", ""),
    ("two_link", 2): ("0875b2b0fe1a8ddc2b1b26ccca3372dcf9ff9caac8050545d9febf81b0089519", ""),
}
NAMES = tuple(dict.fromkeys(name for name, _ in FROZEN))
TEXTS = ("title", "published", "ours", "rule")  # they do not enter a score


@dataclass(frozen=True)
class Output:
    """A regulated number: ``weights`` of the arm coordinates, or ``axis`` of the tool's position,
    times ``scale``.
    """

    name: str
    unit: str
    weights: Mapping[str, float]
    axis: str
    scale: float


@checked_class
@dataclass(frozen=True)
class Window:
    """A part of the run [s] and the weights of the measures that are taken in it.

    Examples
    --------
    >>> from flexgen.studies.scenarios.scenario_file import scenario
    >>> window = scenario("four_mass", version=1).windows[0]
    >>> window.name, window.begin, window.end, window.weights
    ('motor step', 1.0, 5.0, {'peak': 1.0, 'settling': 0.5})
    """

    name: str
    begin: float
    end: float
    weights: Mapping[str, float]


@checked_class
@dataclass(frozen=True)
class Segment:
    """A part of a run with its disturbances, whose times count from its begin, and the weights of
    its measures.

    Examples
    --------
    >>> from flexgen.studies.scenarios.scenario_file import scenario
    >>> segment = scenario("four_mass", version=2).plan.segments[0]
    >>> segment.name, segment.length_s, segment.disturbances[0].kind, segment.weights
    ('motor step', 4.0, 'step', {'peak': 1.0, 'settling': 0.5})
    """

    name: str
    length_s: float
    weights: Mapping[str, float]
    disturbances: tuple[Disturbance, ...]


@dataclass(frozen=True)
class Plan:
    """Random numbers: ``draws`` runs; spans of the time before the first segment, of the waits
    between, of the factor of the sizes; rest in the end of the run [s].
    """

    draws: int
    lead_s: tuple[float, float]
    wait_s: tuple[float, float]
    factor: tuple[float, float]
    end_s: float
    segments: tuple[Segment, ...]


@dataclass(frozen=True)
class Accept:
    """Reasons to refuse a controller: motion at rest above ``rest``, also with this delay and
    gain; torque noise.
    """

    delay_s: float
    gain: float
    torque_noise_Nm: float
    rest: float


@checked_class
@dataclass(frozen=True, eq=False)
class Scenario:
    """A benchmark; see the module. Its hash is that of what it holds, also after
    `dataclasses.replace`.

    ``sets``: for each set the numbers of its robots among all; robot 0 is nominal. ``plan``: None
    where the times of ``disturbances`` and ``windows`` are stated; else ``windows`` are those of
    the whole run.

    Raises
    ------
    ArgumentError
        A number is not finite.

    Examples
    --------
    >>> from flexgen.studies.scenarios.scenario_file import scenario
    >>> found = scenario("four_mass", version=1)
    >>> (
    ...     found.sample_s,
    ...     found.torque_max_Nm,
    ...     {name: len(robots) for name, robots in found.sets.items()},
    ... )
    (0.0005, (20.0,), {'set 1': 8, 'set 2': 8})
    """

    name: str
    version: int
    title: str
    published: str
    ours: str
    model: RobotModel
    sample_s: float
    delay_s: float
    steps: int
    duration_s: float
    encoder_noise_rad: float
    torque_max_Nm: tuple[float, ...]
    seed: int
    start: tuple[float, ...]
    outputs: tuple[Output, ...]
    disturbances: tuple[Disturbance, ...]
    windows: tuple[Window, ...]
    tolerance: float
    nominal_weight: float
    set_weights: tuple[float, ...]
    plants: Plants
    sets: Mapping[str, tuple[int, ...]]
    accept: Accept
    reference: Any
    rule: str = ""
    measures_version: int = 1
    plan: Plan | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        _ = self.content  # finite numbers only
        weights = [w for window in self.measured for w in window.weights.values()]
        if not weights or min(weights) < 0 or not sum(weights) > 0:
            raise ArgumentError(
                f"{self.name}, weights: given {weights}, expected numbers >= 0, not all zero"
            )
        scales = (self.nominal_weight, *self.set_weights)
        if min(scales) < 0 or not sum(scales) > 0:
            raise ArgumentError(
                f"{self.name}, weights of the score: given {scales}, expected numbers >= 0"
            )

    @property
    def content(self) -> str:
        """The hash of all that enters a score."""
        kept = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in TEXTS}
        return content_hash(kept, self.name)

    @property
    def digest(self) -> str:
        """The hash by which the scenario is known: of its content, or for version 1 the published
        one.
        """
        content, known = FROZEN.get((self.name, self.version), ("", ""))
        own = self.content
        return known if known and content == own else own

    @property
    def frozen(self) -> bool:
        """Whether it is a published version, without a change."""
        return FROZEN.get((self.name, self.version), ("", ""))[0] == self.content

    @property
    def measured(self) -> tuple[Segment | Window, ...]:
        """Parts of a run with measures, in their order: the segments, then the windows."""
        return (*(self.plan.segments if self.plan is not None else ()), *self.windows)

    @property
    def title_line(self) -> str:
        """Name, version and the begin of the hash."""
        kind = "" if self.frozen else ", not a published version"
        return f"{self.name} version {self.version}, {self.digest[:12]}{kind}: {self.title}"
