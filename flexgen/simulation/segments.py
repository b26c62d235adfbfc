"""Motions under recorded inputs, each with its own parameters and start state, in C: classical Runge-Kutta steps."""

from __future__ import annotations

import ctypes
from copy import copy
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from flexgen.errors import SolverError
from flexgen.library.c_module import c_module, load_module
from flexgen.library.casadi_module import casadi_module

SOURCE = Path(__file__).with_name("segments.c")


class _Segments(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("rate", "iw", "w")),
        *((name, ctypes.c_int64) for name in ("n", "n_u", "n_p", "n_y", "lanes", "samples", "steps")),
        ("step", ctypes.c_double),
        *(
            (name, ctypes.c_void_p)
            for name in ("start", "input", "set", "offset", "parameters", "rows", "output", "memory")
        ),
    ]


class Segments:
    """Simulates motions ``x' = rate(x, u, p)`` with outputs ``rows x``; calls from several threads are independent.

    Parameters
    ----------
    rate : casadi.Function
        Of state (n), input (n_u) and parameters (n_p).
    rows : array (n_y, n)
    sample_s : float [s]
    steps : int
        Of the integration from one sample to the next.
    """

    def __init__(self, rate: ca.Function, rows: np.ndarray, sample_s: float, steps: int) -> None:
        self.n, self.n_u, self.n_p = (rate.size1_in(k) for k in range(3))
        self.rows = np.ascontiguousarray(rows, float)
        self.steps, self.step = steps, sample_s / steps
        self._library = load_module(casadi_module(rate))
        self._rate = ctypes.cast(getattr(self._library, rate.name()), ctypes.c_void_p).value
        self._work = rate.sz_iw() + 1, rate.sz_w() + 1
        self._run: Any = c_module(SOURCE).segments_run
        self._run.restype = ctypes.c_int64

    def with_steps(self, steps: int) -> Segments:
        """The same simulation in so many steps from one sample to the next."""
        made = copy(self)
        made.steps, made.step = steps, self.step * self.steps / steps
        return made

    def __call__(
        self, start: np.ndarray, inputs: np.ndarray, sets: np.ndarray, offset: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """Outputs (lanes, samples + 1, n_y).

        Parameters
        ----------
        start : array (lanes, n)
        inputs : array (sets, samples * steps, 3, n_u)
            At the start, the middle and the end of each step.
        sets : array of int (lanes,)
            Which inputs a lane has.
        offset : array (lanes, n_u)
            Added to them.
        parameters : array (lanes, n_p)

        Raises
        ------
        SolverError
            A state is not finite.
        """
        lanes, samples = len(start), inputs.shape[1] // self.steps
        arrays = {
            "start": np.ascontiguousarray(start, float),
            "input": np.ascontiguousarray(inputs, float),
            "set": np.ascontiguousarray(sets, np.int64),
            "offset": np.ascontiguousarray(offset, float),
            "parameters": np.ascontiguousarray(parameters, float),
            "rows": self.rows,
            "output": np.empty((lanes, samples + 1, len(self.rows))),
            "memory": np.zeros(6 * self.n + self.n_u),
        }
        work = np.zeros(self._work[0], np.int64), np.zeros(self._work[1])
        sizes = (self.n, self.n_u, self.n_p, len(self.rows), lanes, samples, self.steps)
        pointers = [x.ctypes.data for x in (*work, *arrays.values())]
        what = _Segments(self._rate, *pointers[:2], *sizes, self.step, *pointers[2:])
        if self._run(ctypes.byref(what)):
            raise SolverError("segments: the simulated motion is not finite: take start values nearer to the truth")
        return arrays["output"]
