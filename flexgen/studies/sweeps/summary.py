"""Summary of a sweep: its cases by model, method and status, and the reasons of those that
failed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexgen.studies.sweeps.table import Table

_NUMBER = re.compile(r"\d[\d.]*(?:[eE][-+]?\d+)?")


def group_reasons(cases: Sequence[int], errors: Sequence[str]) -> list[dict[str, Any]]:
    """Group failed cases by their reason, the most frequent first; reasons that differ in numbers
    only are equal.

    Each group has the ``reason`` of its first case and its ``cases``.
    """
    groups: dict[str, dict[str, Any]] = {}
    for case, error in zip(cases, errors, strict=True):
        group = groups.setdefault(_NUMBER.sub("#", error), {"reason": error, "cases": []})
        group["cases"].append(case)
    return sorted(groups.values(), key=lambda group: -len(group["cases"]))


def summarize(results: Table, times: Table) -> list[dict[str, Any]]:
    """Summary of the cases by model, method and status."""
    out = []
    names = np.stack([results["model"], results["method"], results["status"]], axis=1)
    for model, method, status in np.unique(names, axis=0):
        rows = (names == (model, method, status)).all(axis=1)
        figures = {
            name: max((float(x) for x in results[name][rows] if np.isfinite(x)), default=None)
            for name in ("tool_error_max", "turn_error_max", "torque_max")
        }
        figures["cpu"] = float(np.nansum(times["cpu"][rows]))
        out.append(
            {
                "model": str(model),
                "method": str(method),
                "status": str(status),
                "cases": int(rows.sum()),
            }
            | figures
        )
    return out
