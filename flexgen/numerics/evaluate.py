"""Evaluate CasADi functions over many points at once, numpy in and numpy out."""

from __future__ import annotations

import casadi as ca
import numpy as np


def evaluate(function: ca.Function, *points: np.ndarray) -> list[np.ndarray]:
    """Values of a function at n points.

    Parameters
    ----------
    function : casadi.Function
    *points : arrays, shape (n, ...) or (...)
        One an input; the first axis counts the points. Inputs without that axis are the same at all points.

    Returns
    -------
    list of arrays
        One an output, shape (n,) + the output's shape with a trailing axis of length one removed.
    """
    sizes = [function.size_in(i) for i in range(function.n_in())]
    arrays = [np.asarray(p, dtype=float) for p in points]
    n = 1
    columns: list[np.ndarray] = []
    batched = []
    for array, (rows, cols) in zip(arrays, sizes, strict=True):
        plain = 1 if cols == 1 else 2
        if rows * cols == 0 or array.ndim == plain:
            columns.append(array.reshape(rows, cols, order="F"))
            batched.append(False)
            continue
        n = max(n, len(array))
        shaped = array.reshape(len(array), rows, cols)
        columns.append(shaped.transpose(1, 0, 2).reshape(rows, len(array) * cols))
        batched.append(True)
    call = function if n == 1 else function.map(n)
    filled = [c if b or n == 1 else np.tile(c, (1, n)) for c, b in zip(columns, batched, strict=True)]
    results = call(*filled)
    results = results if isinstance(results, tuple) else (results,)
    out = []
    for k, result in enumerate(results):
        rows, cols = function.size_out(k)
        value = np.array(result, dtype=float).reshape(rows, n, cols).transpose(1, 0, 2)
        out.append(value[:, :, 0] if cols == 1 else value)
    return out
