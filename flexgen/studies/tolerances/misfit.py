"""Errors of positions that no number of the model explains: its misfit, as a commissioning
measures it on parts of records that were not fitted.

The elastic displacement u(t) of the output is that of its gears and springs, to first order. Of a
robot it is (1 + rho A) u, with a matrix A of each kind of unit whose entries are independent,
normal, of variance 1/c for c components: the error has the size rho |u| in any direction, and is
alike along a motion.

    e(t) = rho A u(t),      rho: `Tolerances.misfit`

Each entry of A is a source of uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexgen.model.elements import RobotModel
from flexgen.studies.tolerances.response import Along, Response
from flexgen.studies.tolerances.result import Share
from flexgen.studies.tolerances.sources import Sources

MISFIT = "misfit"


def elastic_displacement(model: RobotModel, along: Along) -> np.ndarray:
    """Displacement (k, rows) of the output by the deflections of gears and springs, to first
    order.
    """
    deflections = np.zeros((len(along.t), model.dof))
    names = [coordinate.name for coordinate in model.coordinates]
    for name, planned in zip(along.springs, along.motion["deflection"].T, strict=True):
        i = names.index(name)
        # a gear that deflects leaves its joint behind its motor
        deflections[:, i] = -planned if i in model.i_g else planned
    return np.asarray(np.einsum("kri,ki->kr", along.W, deflections))


def misfit_rows(displacement: np.ndarray, units: tuple[str, ...], misfit: float) -> np.ndarray:
    """Errors (k, sources, rows) of the output for one unit of each source, for a displacement (k,
    rows) and a relative ``misfit``.
    """
    k, rows = displacement.shape
    out = []
    for unit in dict.fromkeys(units):
        columns = [i for i, own in enumerate(units) if own == unit]
        for of in columns:
            for to in columns:
                error = np.zeros((k, rows))
                error[:, to] = misfit / np.sqrt(len(columns)) * displacement[:, of]
                out.append(error)
    return np.array(out).reshape(len(out), k, rows).transpose(1, 0, 2)


def with_misfit(sources: Sources, count: int) -> Sources:
    """The sources, and so many of the misfit after them."""
    n, m = sources.root.shape
    root = np.zeros((n + count, m + count))
    root[:n, :m] = sources.root
    root[n:, m:] = np.eye(count)
    return replace(
        sources,
        names=(*sources.names, *(f"{MISFIT} {k}" for k in range(1, count + 1))),
        kinds=(*sources.kinds, *([MISFIT] * count)),
        sd=np.append(sources.sd, np.ones(count)),
        root=root,
    )


def add_misfit(found: Response, rows: np.ndarray, errors: np.ndarray) -> Response:
    """Response of robots with errors (robots, sources) of the misfit in addition."""
    robots = found.error.shape[1]
    return replace(
        found, error=found.error + np.einsum("rs,ksj->krj", errors[:robots], rows, optimize=True)
    )


def append_misfit(first: Response, rows: np.ndarray) -> Response:
    """Responses to single sources, and to those of the misfit after them: they move no motor."""

    def still(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x, np.zeros((len(x), rows.shape[1], x.shape[2]))], axis=1)

    return Response(
        np.concatenate([first.error, rows], axis=1), still(first.tau_m), still(first.deflection)
    )


def merge_shares(shares: tuple[Share, ...]) -> tuple[Share, ...]:
    """Shares with one of the whole misfit, the largest first."""
    kept = [share for share in shares if share.kind != MISFIT]
    whole = [share.share for share in shares if share.kind == MISFIT]
    if whole:
        kept.append(Share(MISFIT, MISFIT, float(sum(whole))))
    return tuple(sorted(kept, key=lambda share: -share.share))


def merge_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of sources, with one of the whole misfit where its first one was."""
    return tuple(dict.fromkeys(MISFIT if x.startswith(f"{MISFIT} ") else x for x in names))
