"""Numbers of whole results as they were measured: a net for what has no second route in a quick
test.

`check_numbers` compares every number of a result with ``tests/golden/numbers/NAME.json``; arrays
by their shape and three weighted sums. It does not prove that a number is right: other tests do
that. Where an answer changes on purpose,

    WRITE_NUMBERS=1 make test

writes the files again; look at the difference before you commit it.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.model.elements import RobotModel

FOLDER = Path(__file__).parents[1] / "golden" / "numbers"
ENDLESS = 1e300  # infinity in a file
# times; counts and residuals at the level of rounding, which depend on how BLAS sums on a
# processor
OTHER = (
    "history",
    "residual",
    "wall",
    "cpu",
    "seconds",
    "iterations",
    "programs",
    "inversions",
    "date",
    "version",
)
OTHER += ("simulated_in", "digest", "accuracy")


def _sums(x: np.ndarray) -> list[float]:
    """Sum of sizes, then two weighted sums: any changed entry changes them."""
    flat = np.clip(np.nan_to_num(x.ravel().astype(complex), nan=-7.0), -ENDLESS, ENDLESS)
    weight = np.cos(1.0 + np.arange(flat.size))
    return [
        float(np.abs(flat).sum()),
        float((flat.real * weight).sum()),
        float((flat.imag * weight + flat.real).sum()),
    ]


def _flatten(name: str, value: Any, out: dict[str, Any]) -> None:
    if any(word in name.rpartition(".")[2] for word in OTHER) or isinstance(value, RobotModel):
        return
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif isinstance(value, Mapping):
        parts = {str(key): part for key, part in value.items()}
    elif isinstance(value, np.ndarray | list | tuple):
        try:
            array = np.asarray(value)
        except ValueError:
            array = np.array(None)
        if array.dtype.kind in "bifc":
            if array.size:
                out[name] = {"shape": list(array.shape), "sums": _sums(array)}
            return
        if array.dtype.kind == "U" or isinstance(value, np.ndarray):
            return
        parts = {str(k): part for k, part in enumerate(value)}
    else:
        if isinstance(value, bool | int | float | complex | np.generic) and not isinstance(
            value, np.str_
        ):
            out[name] = {"shape": [], "sums": _sums(np.asarray(value))}
        return
    for key, part in parts.items():
        if not key.startswith("_"):
            _flatten(f"{name}.{key}" if name else key, part, out)


def check_numbers(name: str, rtol: float = 1e-6, **found: Any) -> None:
    """Compare all numbers of ``found`` with those of the file of this name, relative to the size
    of each array.
    """
    now: dict[str, Any] = {}
    _flatten("", found, now)
    file = FOLDER / f"{name}.json"
    if os.environ.get("WRITE_NUMBERS"):
        FOLDER.mkdir(exist_ok=True)
        file.write_text(
            json.dumps(now, indent=0, sort_keys=True).replace("\n", "").replace('},"', '},\n"')
            + "\n"
        )
    expected = json.loads(file.read_text(encoding="utf-8"))
    assert now.keys() == expected.keys()
    for key, part in expected.items():
        assert now[key]["shape"] == part["shape"], key
        # errors of a nanometer are rounding, as is how far a computed motion leaves its path
        size = part["sums"][0]
        least = 1e-8 if "error" in key or "defect" in key else 1e-13
        # what is known up to a standard deviation is compared relative to that
        deviation = expected.get(key.replace(".values.", ".sd."), part)["sums"][0]
        deviation = max(deviation, expected.get(f"{key.removesuffix('.at')}.sd", part)["sums"][0])
        size = max(size, deviation)
        for one, other in zip(now[key]["sums"], part["sums"], strict=True):
            assert abs(one - other) <= rtol * size + least, (
                f"{key}: {now[key]['sums']}, expected {part['sums']}"
            )
