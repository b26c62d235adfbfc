"""The right-hand side of the definition's equations of motion in C, and the explicit integrator in
C around it.

CasADi writes the C of the Lagrange equations, so that nothing here is shared with the recursion,
with the emitted library or with the solvers. It is compiled once for each model and kept in the
user's cache.

Source: E. Hairer, S. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 1993, sec.
II.5 (DOP853).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import DOP853
from scipy.interpolate import PPoly

from flexgen.base.errors import BuildError
from flexgen.simulation.motor_feedback import MotorFeedback

SOURCE = Path(__file__).with_name("dop853.c")
DONE, MORE, STEP_TOO_SMALL, NOT_FINITE = range(4)
STAGES = 16
DENSE = 7


class _Problem(ctypes.Structure):
    _fields_ = [
        ("rate", ctypes.c_void_p),
        ("iw", ctypes.c_void_p),
        ("w", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("n", "n_u", "pieces", "k")),
        *((name, ctypes.c_void_p) for name in ("breaks", "coefficients")),
        ("rtol", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("atol", "A", "B", "C", "E3", "E5", "dense")),
        *((name, ctypes.c_int64) for name in ("n_m", "dof")),
        *((name, ctypes.c_void_p) for name in ("rows", "gains")),
    ]


class _Position(ctypes.Structure):
    _fields_ = [
        ("t", ctypes.c_double),
        ("step", ctypes.c_double),
        *((name, ctypes.c_int64) for name in ("evaluations", "piece", "begun")),
        ("memory", ctypes.c_void_p),
    ]


@dataclass(frozen=True)
class CompiledRate:
    """The function ``rate(x, u) -> x'`` in C.

    ``function``: for calls from Python; ``address`` of the C function; ``integers``, ``reals``:
    sizes of its workspace; ``library``: loaded as long as this exists.
    """

    function: ca.Function
    address: int
    integers: int
    reals: int
    library: ctypes.CDLL


def compiled_rate(
    rate: ca.Function, progress: Callable[[str], None] | None
) -> CompiledRate | None:
    """A CasADi function with the name ``rate`` in C; None where there is no C compiler that
    works.
    """
    from flexgen.codegen.build.c_module import load_module
    from flexgen.codegen.build.casadi_module import casadi_module, external
    from flexgen.codegen.build.compiler import find_compiler

    try:
        if find_compiler() is None:
            return None
        path = casadi_module(
            rate, None if progress is None else lambda line: progress(f"simulation: {line}")
        )
        library = load_module(path)
        function = external("rate", path)
    except BuildError:  # the results without C are the same
        return None
    address = ctypes.cast(library.rate, ctypes.c_void_p).value
    assert address is not None
    return CompiledRate(function, address, rate.sz_iw(), rate.sz_w(), library)


class CompiledDop853:
    """The explicit integrator in C: ``advance`` fills results block by block.

    Parameters
    ----------
    rate : CompiledRate
    given : PPoly
        The input, a piecewise polynomial: torques, with feedback also the motors' reference angles
        and speeds.
    t : array (n,) [s]
        Instants of the results; the first is the start.
    start : array (n_x,)
    rtol : float
    atol : array (n_x,)
    feedback : MotorFeedback or None
        With it the state ends with the integrals of the feedback.

    Attributes
    ----------
    y : array (n_x,)
        The state at ``t``.
    failure : str
        Reason why it stopped early, or empty.
    """

    def __init__(
        self,
        rate: CompiledRate,
        given: PPoly,
        t: np.ndarray,
        start: np.ndarray,
        rtol: float,
        atol: np.ndarray,
        feedback: MotorFeedback | None = None,
    ) -> None:
        n = len(start)
        n_u = given.c.shape[2]
        extra = np.zeros((STAGES, STAGES))
        extra[:12, :12] = DOP853.A
        extra[13:, :] = DOP853.A_EXTRA
        nodes = np.concatenate([DOP853.C, [1.0], DOP853.C_EXTRA])
        arrays = {
            "breaks": given.x,
            "coefficients": given.c.transpose(1, 0, 2),
            "atol": atol,
            "A": extra,
            "B": DOP853.B,
            "C": nodes,
            "E3": DOP853.E3,
            "E5": DOP853.E5,
            "dense": DOP853.D,
            "rows": np.zeros((0, 0)) if feedback is None else feedback.rows,
            "gains": []
            if feedback is None
            else [feedback.position_gain, feedback.speed_gain, feedback.integral_gain],
        }
        self._arrays = {name: np.ascontiguousarray(x, float) for name, x in arrays.items()}
        self._instants = np.ascontiguousarray(t[1:], float)
        self._memory = np.zeros((STAGES + 4 + DENSE) * n + n_u)
        self._memory[:n] = start
        self.y = self._memory[:n]
        self._rate = rate
        self.failure = ""
        self._written = ctypes.c_int64(0)
        self._work = np.zeros(rate.integers + 1, np.int64), np.zeros(rate.reals + 1)
        self._problem = _Problem(
            rate=rate.address,
            iw=self._work[0].ctypes.data,
            w=self._work[1].ctypes.data,
            n=n,
            n_u=n_u,
            pieces=given.c.shape[1],
            k=given.c.shape[0],
            rtol=rtol,
            n_m=self._arrays["rows"].shape[0],
            dof=self._arrays["rows"].shape[1],
            **{name: x.ctypes.data for name, x in self._arrays.items()},
        )
        self._position = _Position(t=t[0], memory=self._memory.ctypes.data)
        self._advance = compiled_advance()

    @property
    def t(self) -> float:
        """Current time of the integration [s]."""
        return float(self._position.t)

    @property
    def nfev(self) -> int:
        """Evaluations of the rate."""
        return int(self._position.evaluations)

    def advance(self, out: np.ndarray, k: int, most: int) -> int:
        """Fill ``out`` (instants, n) from row ``k`` on, for about ``most`` evaluations; returns
        the first row that is not filled yet. A failure is kept as a text.
        """
        assert out.flags.c_contiguous and k == self._written.value + 1
        status = self._advance(
            ctypes.byref(self._problem),
            ctypes.byref(self._position),
            len(self._instants),
            self._instants.ctypes.data,
            out[1:].ctypes.data,
            ctypes.byref(self._written),
            most,
        )
        if status == STEP_TOO_SMALL:
            self.failure = "Required step size is less than spacing between numbers."
        elif status == NOT_FINITE:
            self.failure = "not finite"
        return int(self._written.value) + 1


@lru_cache(maxsize=1)
def compiled_advance() -> Any:
    """The function in C that advances an integration by some steps, compiled once."""
    from flexgen.codegen.build.c_module import c_module

    function = c_module(SOURCE).simulation_advance
    function.restype = ctypes.c_int
    pointer = ctypes.c_void_p
    integer = ctypes.c_int64
    function.argtypes = [pointer, pointer, integer, pointer, pointer, pointer, integer]
    return function
