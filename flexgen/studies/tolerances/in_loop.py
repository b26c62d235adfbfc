"""Tool error of drawn robots under any controller of `flexgen.control`, by the nonlinear
simulation of the loop.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexgen.base.calls.deadline import OutOfTime
from flexgen.base.calls.progress import Choice
from flexgen.base.rows import Data, Part, Prose, Row
from flexgen.feedback.loop.control import control
from flexgen.feedback.loop.result import UNITS, ControlRun
from flexgen.model.elements import RobotModel
from flexgen.studies.tolerances.prediction import LEVEL
from flexgen.studies.tolerances.sources import PAYLOAD, sources_of

DRAWN = 64  # robots

# Robots of which the error that 95 % keep can be told: one in twenty is above it.
FEWEST = 20


def draw_plants(
    model: RobotModel, robots: int = DRAWN, seed: int = 0
) -> dict[str, dict[str, float]]:
    """Robots drawn from the table ``[uncertainty]`` as `flexgen.control` takes them:
    ``{"drawn_1": {...}, ...}``.

    Their delays are those of the model.
    """
    assert model.uncertainty is not None
    sources = sources_of(model, model.uncertainty)
    errors = sources.errors(
        np.random.default_rng(seed).standard_normal((robots, sources.root.shape[1]))
    )
    added = sources.added[sources.owner]
    out = {}
    for k, error in enumerate(errors[:, sources.owner], 1):
        named = zip(sources.parameters, error, added, strict=True)
        out[f"drawn_{k}"] = {
            "payload" if add and p.name == PAYLOAD else p.name: float(x if add else 1.0 + x)
            for p, x, add in named
        }
    return out


def error_in_loop(run: ControlRun, progress: Choice = None, **options: Any) -> dict[str, Any]:
    """The error that 95 % of the robots keep under the controller of a run; ``options``: of
    `flexgen.control`.

    Returns
    -------
    dict
        ``robots`` that were simulated; ``ended``: why not all were; ``failed``: robots that
        stopped early; ``error_m``, ``error_rad`` [m], [rad]: None where the output has no such
        part, or where more than one in twenty have stopped early; ``without_delay``: where the
        table has a delay, which these robots do not have.

    Raises
    ------
    OutOfTime
        The time was over before the `FEWEST` robots.
    """
    plants = draw_plants(run.model)
    found = control(run.model, plants=plants, solution=run.solution, progress=progress, **options)
    robots = [robot for robot in found.runs if robot.name in plants]
    if found.ended and len(robots) < FEWEST:
        raise OutOfTime("drawn robots")
    out: dict[str, Any] = {
        "robots": len(robots),
        **({"ended": found.ended} if found.ended else {}),
        "failed": sum(bool(robot.failure) for robot in robots),
    }
    if run.model.uncertainty is not None and run.model.uncertainty.delay:
        out["without_delay"] = True
    for unit in UNITS:
        key = f"error_max_{unit}"
        out[f"error_{unit}"] = None
        if found.figures(found.runs[0])[key] is not None:
            sizes = [np.inf if r.failure else found.figures(r)[key] for r in robots]
            value = float(np.quantile(sizes, LEVEL, method="higher"))
            out[f"error_{unit}"] = value if np.isfinite(value) else None
    return out


def content_of_drawn(found: dict[str, Any]) -> tuple[Part, ...]:
    """The content of a result of `error_in_loop`."""
    inside = int(np.ceil(LEVEL * found["robots"]))
    without = "disturbances and delays" if found.get("without_delay") else "disturbances"
    failed = f"; {found['failed']} of them stopped early" if found["failed"] else ""
    ended = f"; then {found['ended']}" if "ended" in found else ""
    errors = [
        Row(f"error of {inside} of {found['robots']} of them, at most", found[key], unit, key)
        for unit in UNITS
        for key in (f"error_{unit}",)
    ]
    kept = [Data(key, value) for key, value in found.items() if not key.startswith("error_")]
    known = any(row.value is not None for row in errors)
    return (
        Prose(f"robots drawn from [uncertainty], without {without}{failed}{ended}", is_title=True),
        *kept,
        *errors,
        *([] if known else [Prose("their error is not known")]),
    )
