"""A function of one robot that CasADi writes, as the closed loop in C calls it for each robot."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from copy import copy

import casadi as ca
import numpy as np

from flexgen.codegen.build.c_module import load_module
from flexgen.codegen.build.casadi_module import casadi_module

MOST_INPUTS = 5  # of a function, see closed_loop.c


class LoopFunction(ctypes.Structure):
    """``loop_function`` of closed_loop.c."""

    _fields_ = [
        *[(name, ctypes.c_void_p) for name in "function arg res iw w numbers".split()],
        ("n_numbers", ctypes.c_int64),
        ("point", ctypes.c_void_p),
    ]


class RobotFunction:
    """A function in C, and the numbers (lanes, n) that one of its inputs takes, a row for each
    robot.

    BuildError where there is no compiler that works.
    """

    def __init__(
        self, function: ca.Function, numbers: np.ndarray, progress: Callable[[str], None]
    ) -> None:
        """``numbers`` (robots, k): parameters of each robot; ``progress``: takes a line while the
        function is compiled.
        """
        self.function = function
        self.numbers = np.ascontiguousarray(numbers, dtype=float)
        self._library = load_module(casadi_module(function, progress))
        self._kept: list[dict[str, np.ndarray]] = []

    def of_robots(self, group: slice) -> RobotFunction:
        """Copy with the numbers of some robots."""
        some = copy(self)
        some.numbers = np.ascontiguousarray(self.numbers[group])
        some._kept = []
        return some

    def in_loop(self, lanes: int) -> LoopFunction:
        """The structure for C, with arguments, work arrays of CasADi and the numbers of ``lanes``
        robots; the memory that it points to lives as long as this object.
        """
        assert len(self.numbers) == lanes
        f = self.function
        size = sum(f.nnz_in(i) for i in range(f.n_in())) + sum(
            f.nnz_out(i) for i in range(f.n_out())
        )
        memory = {
            "arg": np.zeros(f.sz_arg() + MOST_INPUTS, np.uintp),
            "res": np.zeros(f.sz_res() + 1, np.uintp),
            "iw": np.zeros(f.sz_iw() + 1, np.int64),
            "w": np.zeros(f.sz_w() + 1),
            "numbers": self.numbers,
            "point": np.zeros(size + MOST_INPUTS),
        }
        self._kept.append(memory)
        address = ctypes.cast(getattr(self._library, f.name()), ctypes.c_void_p)
        at = {name: array.ctypes.data for name, array in memory.items()}
        return LoopFunction(function=address, n_numbers=self.numbers.shape[1], **at)
