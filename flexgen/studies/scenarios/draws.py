"""Random draws of a scenario: order, times, signs and sizes of the disturbances, from a seed.

Every random number is uniform, from the SHA-256 of benchmark, version, seed, draw and its purpose:
the same on every computer. Version 1 has one draw, the times of its file.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from flexgen.simulation.environment.disturbances import Disturbance
from flexgen.studies.scenarios.scenario import Scenario, Window

# the number of the first sample that a controller sees is drawn from FIRST_K to 2 FIRST_K
FIRST_K = 2**20


@dataclass(frozen=True, eq=False)
class Draw:
    """One run of a scenario.

    ``seed`` of the noise; ``disturbances`` with their times; ``windows`` of the measures;
    ``first``: number of the first sample; ``secret``: what the draw is computed from, empty for
    stated times.
    """

    seed: int
    disturbances: tuple[Disturbance, ...]
    windows: tuple[Window, ...]
    first: int = 0
    secret: str = ""

    def order(self, robots: int) -> list[int]:
        """Random assignment of the robots to the lanes of the loop, so that a controller cannot
        identify them by counting.
        """
        if not self.secret:
            return list(range(robots))
        return sorted(range(robots), key=lambda k: _uniform(self.secret, f"place of robot {k}"))


@lru_cache(maxsize=8)
def draws_of(scenario: Scenario, seed: int) -> tuple[Draw, ...]:
    """All draws of a scenario by a seed."""
    if scenario.plan is None:
        return (Draw(seed, scenario.disturbances, scenario.windows),)
    name = f"flexgen {scenario.name} {scenario.version} seed {seed}"
    return tuple(_draw_runs(scenario, f"{name} draw {k}") for k in range(scenario.plan.draws))


def secret_seed() -> int:
    """A seed that is unknown before the run: from the entropy of the operating system."""
    return secrets.randbits(62)


def _draw_runs(scenario: Scenario, secret: str) -> Draw:
    """Order, times and sizes of the segments of a scenario with a plan, all from ``secret``; times
    are multiples of the sample time [s].
    """
    plan = scenario.plan
    assert plan is not None

    def between(span: Sequence[float], purpose: str) -> float:
        return span[0] + (span[1] - span[0]) * _uniform(secret, purpose)

    sample = scenario.sample_s
    now = between(plan.lead_s, "begin")
    disturbances: list[Disturbance] = []
    windows: dict[str, Window] = {}
    for segment in sorted(plan.segments, key=lambda s: _uniform(secret, f"order of {s.name}")):
        now = sample * round((now + between(plan.wait_s, f"wait before {segment.name}")) / sample)
        for k, d in enumerate(segment.disturbances):
            purpose = f"{segment.name} {k}"
            sign = 1.0 if _uniform(secret, f"sign of {purpose}") < 0.5 else -1.0
            size = sign * d.size * between(plan.factor, f"size of {purpose}")
            disturbances.append(replace(d, size=size, start_s=now + d.start_s))
        windows[segment.name] = Window(segment.name, now, now + segment.length_s, segment.weights)
        now += segment.length_s
    ordered = tuple(windows[segment.name] for segment in plan.segments)
    first = FIRST_K + int(FIRST_K * _uniform(secret, "first sample"))
    noise = int(2**62 * _uniform(secret, "noise"))
    return Draw(noise, tuple(disturbances), ordered + scenario.windows, first, secret)


def _uniform(secret: str, purpose: str) -> float:
    """A number from 0 to 1, with 53 bits."""
    digest = hashlib.sha256(f"{secret}: {purpose}".encode()).digest()
    return (int.from_bytes(digest[:8], "big") >> 11) * 2.0**-53
