"""Evaluate CasADi functions over many points at once, numpy in and numpy out."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import casadi as ca
import numpy as np

# The last maps: CasADi finds the map of a function again while something holds it.
_MAPS: deque[ca.Function] = deque(maxlen=8)


class Evaluator:
    """A function of arrays at one point that is called many times: its memory is reserved once.

    Parameters
    ----------
    function : casadi.Function
        Its inputs and outputs are dense; it is called by one thread at a time.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._buffer, self._run = function.buffer()
        self._inputs = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._outputs = [
            np.zeros(function.size_out(k), order="F") for k in range(function.n_out())
        ]
        for i, x in enumerate(self._inputs):
            if x.size:
                self._buffer.set_arg(i, x.data)
        for k, y in enumerate(self._outputs):
            if y.size:
                self._buffer.set_res(k, y.reshape(-1, order="F").data)

    def __call__(self, *given: np.ndarray) -> list[np.ndarray]:
        """Every output as an array (rows, columns); matrices are given by columns."""
        for x, value in zip(self._inputs, given, strict=True):
            x[:] = np.ravel(value, order="F")
        self._run()
        if self._buffer.ret():  # the usual call says why
            self._function(*given)
        return [y.copy() for y in self._outputs]


def _is_dense(function: ca.Function) -> bool:
    """Whether no input and no output has structural zeros."""
    dense = (function.sparsity_in(i).is_dense() for i in range(function.n_in()))
    return all(dense) and all(function.sparsity_out(k).is_dense() for k in range(function.n_out()))


def _call(function: ca.Function, given: Sequence[np.ndarray]) -> Sequence[np.ndarray]:
    """The results of a call; by way of `Evaluator` where that can be, as CasADi converts arrays
    slowly.
    """
    if _is_dense(function):
        return Evaluator(function)(*given)
    results = function(*given)
    return results if isinstance(results, tuple) else (results,)


def evaluate(function: ca.Function, *points: np.ndarray) -> list[np.ndarray]:
    """Values of a function at n points.

    Parameters
    ----------
    function : casadi.Function
    *points : arrays, shape (n, ...) or (...)
        One an input; the first axis counts the points. Inputs without that axis are the same at
        all points.

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
    _MAPS.append(call)
    filled = [
        c if b or n == 1 else np.tile(c, (1, n)) for c, b in zip(columns, batched, strict=True)
    ]
    out = []
    for k, result in enumerate(_call(call, filled)):
        rows, cols = function.size_out(k)
        value = np.array(result, dtype=float).reshape(rows, n, cols).transpose(1, 0, 2)
        out.append(value[:, :, 0] if cols == 1 else value)
    return out
