"""Growth of perturbations along a motion by the C of a loaded library: `Growth`, the type of
`Library.growth`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Event
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.runtime.inversion.inversion_arguments import (
    NO_FORCE,
    array_of,
    parameters_of,
    pointer,
    pointers,
)
from flexgen.runtime.inversion.path_inversion import Inversion
from flexgen.runtime.structs import Failures, closed_error, failure_of, interface_of, struct_of

_WIDTHS = {"q_a": "n_a", "v_a": "n_a", "q_m": "n_m", "v_m": "n_m", "tau_m": "n_m"}


@dataclass(frozen=True, repr=False)
class Growth:
    """``library.growth(motion)``: largest growth of a perturbation under the motor torques of a
    motion alone.

    ``takes_force``: of a library with the part ``"force"``.
    ``closed``: set when the library is closed.
    """

    name: str
    sizes: Mapping[str, int]
    motion: type[ctypes.Structure]
    entry: Callable[..., int]
    work: int
    model_parameters: np.ndarray
    failures: Failures
    again: tuple[Callable[..., Any], tuple[Any, ...]]
    takes_force: bool = False
    closed: Event = field(default_factory=Event)

    def __repr__(self) -> str:
        options = ["parameters=None"] * bool(self.model_parameters.size)
        options += ["force=None"] * self.takes_force
        return f"growth({', '.join(['motion', *['*'] * bool(options), *options])})"

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        self._refuse_closed()
        return self.again

    def _refuse_closed(self) -> None:
        if self.closed.is_set():
            raise closed_error(self.name)

    def __call__(self, motion: Inversion, *, parameters: Any = None, force: Any = None) -> float:
        """The largest growth from the start of a motion to an instant of it.

        A force of constant direction on the output has a stiffness, -d(W' f)/dq with the map W
        from speeds to rates of the output: a push along an outstretched arm acts like a weight on
        an upright one.

        Parameters
        ----------
        motion : Inversion
            What `Library.invert` returned.
        parameters : array (n_p,), optional
            Run-time parameters, where the library has any; default: those of the model file.
        force : array (n, 3 n_y), optional
            Force on the output at the n samples of the path, as `Library.invert` took it for this
            motion; before the path and after it the force stays as it is at its ends. Of a library
            with the part ``"force"``; default: none.

        Returns
        -------
        float
            At least 1; where it is above about 100, only feedback keeps the robot on its path.
        """
        self._refuse_closed()
        if not isinstance(motion, Inversion):
            raise ArgumentError(
                f"growth, motion: given {type(motion).__name__}, expected what invert returned"
            )
        n = len(motion.q_a)
        real = self.model_parameters.dtype
        shapes = {key: (n, self.sizes[width]) for key, width in _WIDTHS.items()}
        arrays = {
            key: array_of("growth", key, getattr(motion, key), shape, real)
            for key, shape in shapes.items()
        }
        values = parameters_of("growth", parameters, self.model_parameters)
        found = np.empty(1, real)
        work = np.empty(self.work, real)
        forced = self._force_of(force, motion)
        status = self.entry(
            ctypes.byref(struct_of(self.motion, **arrays)),
            ctypes.c_int(n),
            (ctypes.c_double if real == np.float64 else ctypes.c_float)(motion.period),
            *_arguments_of(forced, motion.n_pre) * self.takes_force,
            *pointers(values),
            pointer(found),
            pointer(work),
            ctypes.c_int64(work.size),
        )
        if status < 0:
            exception, text = failure_of(self.failures, status)
            raise exception(f"growth: {text}")
        return float(found[0])

    def _force_of(self, force: Any, motion: Inversion) -> np.ndarray | None:
        """The checked force on the path; ArgumentError in a library without the part."""
        if force is None:
            return None
        if not self.takes_force:
            raise ArgumentError(NO_FORCE.format("growth"))
        real = self.model_parameters.dtype
        width = 3 * self.sizes["n_y"]
        most = len(motion.q_a) - motion.n_pre
        given = array_of("growth", "force", force, None, real)
        if given.ndim != 2 or given.shape[1] != width or not 1 <= len(given) <= most:
            raise ArgumentError(
                f"growth, force: given shape {given.shape}, expected (n, {width}) with n of the "
                f"path that invert took, at most {most}"
            )
        return given


def _arguments_of(force: np.ndarray | None, n_pre: int) -> tuple[Any, ...]:
    """The force in C: its samples, how many there are, and samples of the motion before them."""
    count = 0 if force is None else len(force)
    address = ctypes.c_void_p() if force is None else pointer(force)
    return address, ctypes.c_int(count), ctypes.c_int(n_pre)


def growth_of(
    manifest: Mapping[str, Any],
    found: Callable[[str], Any],
    failures: Failures,
    again: tuple[Callable[..., Any], tuple[Any, ...]],
    parameters: np.ndarray,
) -> Growth | None:
    """The `Growth` of a library; None where the manifest lists none."""
    name = manifest["name"]
    if not {"growth", "growth_work"} <= {row["name"] for row in manifest.get("c_functions", ())}:
        return None
    structs = interface_of(manifest).structs
    work = found(f"{name}_growth_work")
    motion = structs["motion"]
    work.restype = ctypes.c_int64
    return Growth(
        name,
        manifest["sizes"],
        motion,
        found(f"{name}_growth"),
        int(work()),
        parameters,
        failures,
        again,
        any(member == "force" for member, *_ in structs["samples"]._fields_),
    )
