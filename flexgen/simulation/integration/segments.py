"""Motions under recorded inputs, each with its own parameters and start state, in C: classical
Runge-Kutta steps.
"""

from __future__ import annotations

import ctypes
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from os import cpu_count
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from flexgen.base.errors import SolverError
from flexgen.codegen.build.c_module import load_module
from flexgen.codegen.build.lanes_module import lanes_module

SOURCE = Path(__file__).with_name("segments.c")


class _Segments(ctypes.Structure):
    _fields_ = [
        *(
            (name, ctypes.c_int64)
            for name in ("n", "n_u", "n_p", "n_y", "robots", "samples", "steps")
        ),
        *(("step", ctypes.c_double), ("states", ctypes.c_int64)),
        *(
            (name, ctypes.c_void_p)
            for name in ("start", "input", "set", "offset", "parameters", "output", "memory")
        ),
    ]


class Segments:
    """Simulates motions ``x' = rate(x, u, p)`` with outputs ``output(x, u, p)``, several at once
    and on all cores.

    Parameters
    ----------
    rate : casadi.Function
        Of state (n), input (n_u) and parameters (n_p).
    output : casadi.Function, or array (n_y, n)
        Of the same; or of which rows times the state are the outputs.
    sample_s : float [s]
    steps : int
        Of the integration from one sample to the next.
    """

    def __init__(
        self, rate: ca.Function, output: ca.Function | np.ndarray, sample_s: float, steps: int
    ) -> None:
        self.n, self.n_u, self.n_p = (rate.size1_in(k) for k in range(3))
        shown = output if isinstance(output, ca.Function) else _rows(rate, output)
        self.n_y = shown.size1_out(0)
        self.steps = steps
        self.step = sample_s / steps
        text = SOURCE.read_text(encoding="ascii")
        library = load_module(lanes_module(rate.name(), {"RATE": rate, "OUTPUT": shown}, text))
        self._run: Any = library.segments_run
        self._memory: Any = library.segments_memory
        self._run.restype = self._memory.restype = library.segments_lanes.restype = ctypes.c_int64
        self._run.argtypes = ctypes.POINTER(_Segments), ctypes.c_int64, ctypes.c_int64
        self._at_once = int(library.segments_lanes())

    def with_steps(self, steps: int) -> Segments:
        """Copy of the simulation with so many steps from one sample to the next."""
        made = copy(self)
        made.steps = steps
        made.step = self.step * self.steps / steps
        return made

    def __call__(
        self,
        start: np.ndarray,
        inputs: np.ndarray,
        sets: np.ndarray,
        offset: np.ndarray,
        parameters: np.ndarray,
        *,
        states: bool = False,
    ) -> np.ndarray:
        """Outputs (robots, samples + 1, n_y), or the states.

        Parameters
        ----------
        start : array (robots, n)
        inputs : array (sets, samples * steps, 3, n_u)
            At the start, the middle and the end of each step.
        sets : array of int (robots,)
            Which inputs a robot has.
        offset : array (robots, n_u)
            Added to them.
        parameters : array (robots, n_p)
        states : bool

        Raises
        ------
        SolverError
            A state is not finite.
        """
        robots = len(start)
        samples = inputs.shape[1] // self.steps
        n_y = self.n if states else self.n_y
        arrays = [np.ascontiguousarray(x, float) for x in (start, inputs, offset, parameters)]
        arrays.insert(2, np.ascontiguousarray(sets, np.int64))
        found = np.empty((robots, samples + 1, n_y))
        sizes = self.n, self.n_u, self.n_p, n_y, robots, samples, self.steps
        pointers = [x.ctypes.data for x in (*arrays, found)]

        def run(first: int, last: int) -> int:
            what = _Segments(*sizes, self.step, states, *pointers)
            memory = np.empty(self._memory(ctypes.byref(what)))
            what.memory = memory.ctypes.data
            return int(self._run(ctypes.byref(what), first, last))

        groups = -(-robots // self._at_once)
        threads = min(max(1, cpu_count() or 1), groups)
        cuts = [min(robots, groups * k // threads * self._at_once) for k in range(threads + 1)]
        with ThreadPoolExecutor(threads, "segments") as pool:  # of calls of C, which share nothing
            failed = sum(pool.map(run, cuts[:-1], cuts[1:]))
        if failed:
            raise SolverError(
                "segments: the simulated motion is not finite: take start values nearer to the "
                "truth"
            )
        return found


def _rows(rate: ca.Function, rows: np.ndarray) -> ca.Function:
    """Outputs that are rows times the state."""
    given = [ca.SX.sym("x", rate.size1_in(k)) for k in range(3)]
    return ca.Function("rows", given, [ca.mtimes(ca.sparsify(ca.SX(ca.DM(rows))), given[0])])
