"""Motions over short segments under recorded torques, each with its own parameters and start state, in C."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from flexgen.errors import SolverError
from flexgen.identification.local_model import LocalModel
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
    """Simulates segments; the equations of motion are those of the definition.

    Parameters
    ----------
    local : LocalModel
        Of the robot, with the names of the parameters.
    rows : array (n_y, dof)
        Outputs from the coordinates ``y = (q_a, q_me)``.
    sample_s : float [s]
    steps : int
        Of the integration from one sample to the next.
    """

    def __init__(self, local: LocalModel, rows: np.ndarray, sample_s: float, steps: int) -> None:
        model = local.model
        self.n, self.n_u, self.n_p = 2 * model.dof, model.n_m, len(local.names)
        self.rows = np.ascontiguousarray(np.hstack([rows, np.zeros_like(rows)]))
        self.steps, self.step = steps, sample_s / steps
        equations, x, u = local.equations, ca.SX.sym("x", self.n), ca.SX.sym("u", self.n_u)
        p = ca.SX.sym("p", self.n_p)
        function = equations.function("state_rate")
        rate = function(x, u, p) if function.n_in() == 3 else function(x, u)
        written = ca.Function("segment_rate", [x, u, p], [ca.cse(rate)])
        self._library = load_module(casadi_module(written))
        self._rate = ctypes.cast(self._library.segment_rate, ctypes.c_void_p).value
        self._work = np.zeros(written.sz_iw() + 1, np.int64), np.zeros(written.sz_w() + 1)
        self._run: Any = c_module(SOURCE).segments_run
        self._run.restype = ctypes.c_int64

    def __call__(
        self, start: np.ndarray, inputs: np.ndarray, sets: np.ndarray, offset: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """Outputs (lanes, samples + 1, n_y).

        Parameters
        ----------
        start : array (lanes, 2 dof)
        inputs : array (sets, samples * steps, 3, n_m)
            Torques at the start, the middle and the end of each step.
        sets : array of int (lanes,)
            Which inputs a lane has.
        offset : array (lanes, n_m)
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
        what = _Segments(
            self._rate, self._work[0].ctypes.data, self._work[1].ctypes.data, self.n, self.n_u, self.n_p,
            len(self.rows), lanes, samples, self.steps, self.step, *(x.ctypes.data for x in arrays.values()),
        )  # fmt: skip
        if self._run(ctypes.byref(what)):
            raise SolverError("segments: the simulated motion is not finite: take start values nearer to the truth")
        return arrays["output"]
