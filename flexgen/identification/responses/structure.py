"""Selection of elasticities: springs without motor are added to a model and removed from it, one
at a time.

    criterion = 2 cost + n_p log(N)
    (Bayesian information criterion; N: real residuals, n_p: parameters)

Candidates to add are rotations about the two axes perpendicular to each joint, behind the joint
(bearings and links); candidates to remove are the springs without motor of the model. A change is
kept where the criterion falls, and where the cost also falls at poses that were not used for the
fit.

Source: G. Schwarz, Annals of Statistics 6(2), 1978.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import best_known, is_over, keep_best, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported, silent
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.experiments.plan import default_free
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.graybox import identify
from flexgen.identification.responses.local_model import with_sizes
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.result import FitStatus, IdentificationResult
from flexgen.identification.rigid.missing_springs import additions, without
from flexgen.model.elements import Dof, RobotModel
from flexgen.model.reader import read

LEAST_GAIN = 10.0  # of the criterion: "very strong" by the usual words
MOST_ROUNDS = 20


@dataclass(frozen=True)
class Change:
    """A change that was tried.

    ``kind``: ``"add"`` or ``"remove"``; ``name``: of the coordinate; ``gain``: of the criterion,
    positive where the changed model is better; ``held_out``: ratio of the costs at poses that were
    not fitted, below 1 where the changed model is better, or None where it was not needed;
    ``kept``.
    """

    kind: str
    name: str
    gain: float
    held_out: float | None
    kept: bool


@dataclass(frozen=True)
class Structure:
    """Result of a search: the model with its springs, its fit, and the changes.

    ``changes``: those that were kept, in their order, then those of the last round, none of which
    was better. A change whose fit did not converge is left out.
    """

    model: RobotModel
    identified: IdentificationResult
    changes: tuple[Change, ...]

    @property
    def added(self) -> tuple[str, ...]:
        """Names of the coordinates that were added."""
        return tuple(
            change.name for change in self.changes if change.kept and change.kind == "add"
        )

    @property
    def removed(self) -> tuple[str, ...]:
        """Names of the coordinates that were removed."""
        return tuple(
            change.name for change in self.changes if change.kept and change.kind == "remove"
        )

    def write(self, path: str | Path) -> Path:
        """Write the model file with a further variant ``identified``: the springs of the result,
        and the numbers of its fit.

        Parameters
        ----------
        path : str or Path
            Read it as ``FILE@identified``.

        Raises
        ------
        ArgumentError
            The model is not from a ``.toml`` file with elements.
        """
        vector = copy(self.identified.vector)
        vector.model = _with_structure(vector.model, {*self.added, *self.removed})
        return replace(self.identified, vector=vector).write(path)


def _with_structure(model: RobotModel, names: set[str]) -> RobotModel:
    """The model with overrides of its file: a list of the degrees of freedom of each element where
    some of these names were added or removed.
    """
    if not names:
        return model
    data = json.loads(model.text or "{}")
    if "element" not in data or "urdf" in data:
        raise ArgumentError(
            f"write: given {model.file or 'a model without a file'}, expected a .toml file with "
            "elements; the tables of new springs are in the text: add them to the overlay"
        )
    changes: dict[str, Any] = {}
    tables = {table["name"]: table for table in data["element"]}
    for element in model.elements:
        table = tables[element.name]
        old = {dof["name"]: dof for dof in table.get("dof", [])}
        own = {dof.name: dof for dof in element.dofs}
        if names.intersection(own.keys() ^ old.keys()):
            table["dof"] = [old.get(name) or _table_of(dof) for name, dof in own.items()]
            changes[f"element.{element.name}.dof"] = table["dof"]
    return replace(model, text=json.dumps(data), overrides={**(model.overrides or {}), **changes})


def _table_of(dof: Dof) -> dict[str, Any]:
    """The table of a new spring."""
    stiffness = float(getattr(dof.spring, "stiffness", 0.0))
    return {
        "name": dof.name,
        "type": dof.type,
        "axis": list(dof.axis),
        "spring": {"type": "linear", "stiffness": stiffness},
        "damping": float(dof.damping),
    }


@reported("structure")
def structure(
    model: RobotModel | str | Path,
    data: Frf,
    *,
    fixed: Sequence[str] = (),
    time_limit: float | None = None,
    progress: Choice = None,
) -> Structure:
    """Search the springs without motor that the data ask for.

    Parameters
    ----------
    model : RobotModel, str or Path
        Where the search begins; a model with elastic gears only is allowed.
    data : Frf
        At two poses at least.
    fixed : sequence of str
        Coordinates that are not removed.
    time_limit : float, optional [s]
        Then, or after Ctrl-C, the result is the best structure so far, with the status
        ``time limit`` or ``interrupted``. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    Structure

    Raises
    ------
    ArgumentError
        The data have one pose only, or do not belong to the robot.
    """
    tell = progress if callable(progress) else silent
    robot = model if isinstance(model, RobotModel) else read(model)
    if len(data.poses) < 2:
        raise ArgumentError(
            "structure: given data at one pose, expected two or more: some are held out"
        )
    with limit_fit("structure", time_limit, tell):
        now, changes = _search(robot, data, fixed, tell)
        final = now
        reason = reason_of_end()
        if not reason:
            with keep_best():
                final = identify(now.model, data, starts=1, progress=False)
            reason = reason_of_end()
    final = replace(final, status=FitStatus.of_value(reason)) if reason else final
    return Structure(now.model, final, tuple(changes))


def _search(
    robot: RobotModel, data: Frf, fixed: Sequence[str], tell: Callable[[str], None]
) -> tuple[IdentificationResult, list[Change]]:
    """The best fit, and the changes of the model that were tried."""
    now = _fit(robot, data)
    best_known()
    changes: list[Change] = []
    with keep_best():
        for _ in range(MOST_ROUNDS):
            better, tried = _best_change(robot, now, data, fixed, tell)
            changes += tried
            if better is None:
                break
            now = better
    return now, changes


def _best_change(
    robot: RobotModel,
    now: IdentificationResult,
    data: Frf,
    fixed: Sequence[str],
    tell: Callable[[str], None],
) -> tuple[IdentificationResult | None, list[Change]]:
    """The fit of the best change that is kept, and that change; None, and the rejected ones."""
    tried: list[tuple[Change, IdentificationResult]] = []
    candidates = [("add", dof.name, changed) for dof, changed in additions(now.vector.model)]
    candidates += [
        ("remove", name, without(now.vector.model, name)) for name in _removable(robot, now, fixed)
    ]
    for k, (kind, name, changed) in enumerate(candidates):
        tell(f"{kind} {name}: {k + 1} of {len(candidates)}")
        best = _find_best(changed, name if kind == "add" else None, data)
        if is_over():
            return None, []
        if best is not None:
            gain = criterion(now) - criterion(best)
            tried.append((Change(kind, name, gain, None, False), best))
    rejected = []
    for change, fit in sorted(tried, key=lambda pair: -pair[0].gain):
        if change.gain > LEAST_GAIN and change.kind == "add":
            change = replace(change, held_out=_hold_out(now.vector.model, fit.vector.model, data))
        if change.gain > LEAST_GAIN and (change.held_out is None or change.held_out < 1.0):
            return fit, [replace(change, kept=True)]
        rejected.append(change)
    return None, rejected


def criterion(found: IdentificationResult) -> float:
    """``2 cost + n_p log(N)`` of a fit with the weights of single elements."""
    count = found.data.G.size
    return 2 * found.cost * max(count - len(found.vector) / 2, 1.0) + len(found.vector) * float(
        np.log(2 * count)
    )


def _removable(robot: RobotModel, now: IdentificationResult, fixed: Sequence[str]) -> list[str]:
    """Coordinates without motor of the model that was given, as far as they are still there and
    not fixed.
    """
    there = {
        dof.name for e in now.vector.model.elements for dof in e.dofs if dof.spring is not None
    }
    given = [dof.name for e in robot.elements for dof in e.dofs if dof.spring is not None]
    return [name for name in given if name in there and name not in fixed]


def _find_best(model: RobotModel, new: str | None, data: Frf) -> IdentificationResult | None:
    """The best fit of a changed model; a new spring is searched from several stiffnesses."""
    if new is None:
        return _try(model, data)
    fits = [_try(robot, data) for robot in with_sizes(model, new, data.poses[:1])[:3]]
    found = [fit for fit in fits if fit is not None]
    return min(found, key=lambda fit: fit.cost) if found else None


def _try(model: RobotModel, data: Frf) -> IdentificationResult | None:
    try:
        found = _fit(model, data)
    except (SolverError, np.linalg.LinAlgError):
        return None
    return None if found.status == FitStatus.NOT_CONVERGED else found


def _fit(model: RobotModel, data: Frf) -> IdentificationResult:
    """A fit with the weights of the noise alone, not corrected for large motions: costs of
    different models compare.
    """
    data = replace(data, torques=None)
    return identify(
        model,
        data,
        free=default_free(model),
        starts=1,
        structured=False,
        floor=0.0,
        progress=False,
    )


def _hold_out(before: RobotModel, after: RobotModel, data: Frf) -> float:
    """Cost at the second half of the poses of models fitted at the first, after over before."""
    half = len(data.poses) // 2
    first, second = (_part(data, poses) for poses in (slice(None, half), slice(half, None)))
    costs = []
    for model in (before, after):
        try:
            found = _fit(model, first)
            costs.append(Residuals(found.vector, second).cost(found.x))
        except SolverError:
            costs.append(np.inf)
    return float(costs[1] / costs[0]) if costs[0] > 0 else 1.0


def _part(data: Frf, poses: slice) -> Frf:
    """Some of the poses."""
    arrays = {
        name: getattr(data, name)[poses]
        for name in ("poses", "G", "UU", "C", "variance", "speed_sd")
    }
    return replace(data, **arrays, total=None if data.total is None else data.total[poses])
