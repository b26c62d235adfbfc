"""The interface of controllers: `reset`, `step(k, y, ref) -> u`, in Python, in C and as a plug-in.

A controller that is written in Python is any object with these two methods:

    class Mine:
        def reset(self): ...
        def step(self, k, y, ref):
            return ref.tau_m + 20.0 * (ref.q_m - y.q_m)

``y`` is a `Measurement`, ``ref`` a `Reference`; the result are the torques of the motors [N m],
one for each. The loop copies the object once for each robot. Plug-ins in C: `flexgen_controller.h`
in this folder.
"""

from __future__ import annotations

import copy
import ctypes
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.runtime.files import load_verified, verify_file

ABI = 1
HEADER = Path(__file__).with_name("flexgen_controller.h")
_ADVICE = "compile it again for this computer"
INTERRUPTED = "interrupted"
SLOWEST = 1.0  # s: a step of a controller in Python that takes longer is refused
MOST_MEMORY = 2**28  # bytes of a controller


@dataclass(frozen=True)
class Setup:
    """Data of the robots for a controller.

    ``q_m`` (lanes, n_m): motor angles at the start, at rest [rad]; ``sample_s`` [s]; ``n_a`` arm
    coordinates; ``n_y`` measured channels, motor angles first; ``n_ref`` entries of the reference
    of one sample.
    """

    q_m: np.ndarray
    sample_s: float
    n_a: int
    n_y: int
    n_ref: int

    @property
    def n_m(self) -> int:
        """Motors."""
        return self.q_m.shape[1]


@checked_result
@dataclass(frozen=True)
class Measurement:
    """Measurements at a sample: ``q_m`` (n_m) [rad] and ``sensors`` (n_s).

    Examples
    --------
    >>> class Mine:
    ...     def reset(self): ...
    ...     def step(self, k, y, ref):  # y: a Measurement
    ...         return ref.tau_m + 20.0 * (ref.q_m - y.q_m)
    >>> flexgen.control("elbow", controller=Mine()).status
    'done'
    """

    q_m: np.ndarray
    sensors: np.ndarray

    __repr__ = short_repr


@checked_result
@dataclass(frozen=True)
class Reference:
    """The planned motion at a sample.

    ``q_m``, ``v_m`` (n_m): motors [rad, rad/s]; ``tau_m`` (n_m): mean of the feedforward torque
    over the interval in which the new torque will act [N m]; ``sensors`` (n_s): sensor signals on
    the planned motion; ``q_a``,
    ``v_a`` (n_a): arm. Arrays of the loop without the planned motion of the arm are empty.

    Examples
    --------
    >>> class Mine:
    ...     def reset(self): ...
    ...     def step(self, k, y, ref):  # ref: a Reference
    ...         return ref.tau_m + 20.0 * (ref.q_m - y.q_m)
    >>> run = flexgen.control("elbow", controller=Mine(), plants={"soft": {"stiffness": 0.8}})
    >>> f"{1e6 * run.distance(run['soft']).max():.0f} um"
    '243 um'
    """

    q_m: np.ndarray
    sensors: np.ndarray
    tau_m: np.ndarray
    v_m: np.ndarray
    q_a: np.ndarray
    v_a: np.ndarray

    __repr__ = short_repr


@dataclass(frozen=True)
class Compiled:
    """A controller as the loop in C calls it.

    ``address`` of the function ``step``; ``memory`` (lanes, bytes); ``fixed``: bytes at its begin
    that do not change; ``errors``: why the controller of a lane failed, by lane; ``keep``: objects
    that must exist as long; ``foreign``: it is compiled code of a user, which may not return.
    ``together``: address of a function that takes the samples of all robots at once, in place of
    ``address``; 0: none.
    """

    address: int
    memory: np.ndarray
    fixed: int
    errors: dict[int, str]
    keep: Any
    foreign: bool = False
    together: int = 0


class Controller(Protocol):
    """Interface of every controller of this package.

    Examples
    --------
    >>> law = flexgen.control("elbow").law
    >>> type(law).__name__, hasattr(law, "compiled")
    ('Cascade', True)
    """

    def compiled(self, setup: Setup) -> Compiled:
        """The controller in C, one for each robot."""
        ...


STEP = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_void_p,
    ctypes.c_int64,
    ctypes.c_void_p,
    ctypes.c_void_p,
    ctypes.c_void_p,
)


def reference_of(x: np.ndarray, setup: Setup) -> Reference:
    """The parts of a reference (n_ref,), as views."""
    n_m = setup.n_m
    n_y = setup.n_y
    n_a = setup.n_a
    ends = np.cumsum([n_m, n_y - n_m, n_m, n_m, n_a])
    return Reference(*np.split(x, ends)[:6])


class PythonController:
    """A controller that is an object of Python.

    Parameters
    ----------
    controller : object
        With ``reset()`` and ``step(k, y, ref) -> u``; it is copied for each robot.

    Raises
    ------
    ArgumentError
        It has not these methods, or cannot be copied.
    """

    def __init__(self, controller: Any) -> None:
        for name in ("reset", "step"):
            if not callable(getattr(controller, name, None)):
                raise ArgumentError(
                    f"controller: given {type(controller).__name__} without {name}(), expected "
                    "an object with reset() and step(k, y, ref) -> torques"
                )
        self.controller = controller

    def copies(self, count: int) -> list[Any]:
        """An object for each robot, ready to begin; ArgumentError where it cannot be copied or
        does not begin.
        """
        try:
            own = [copy.deepcopy(self.controller) for _ in range(count)]
            for controller in own:
                controller.reset()
        except Exception as error:
            raise ArgumentError(
                f"controller: reset() failed: {type(error).__name__}: {error}"
            ) from error
        return own

    def compiled(self, setup: Setup) -> Compiled:
        """The object's methods as a function that C calls, with a copy of the object for each
        robot.

        Errors cannot pass through C: a robot that fails returns 1, and the text is kept.
        """
        lanes = len(setup.q_m)
        n_m = setup.n_m
        n_y = setup.n_y
        own = self.copies(lanes)
        errors: dict[int, str] = {}
        y = np.zeros(n_y)
        ref = np.zeros(setup.n_ref)
        measurement = Measurement(*np.split(y, [n_m]))
        reference = reference_of(ref, setup)

        def step(memory: int, k: int, at_y: int, at_ref: int, at_u: int) -> int:
            """Step of a robot as C calls it with the addresses of its memory, measurement,
            reference and torque; the memory has its number. Returns 1 after an error, whose text
            is kept in ``errors``.
            """
            lane = ctypes.c_int64.from_address(memory).value
            ctypes.memmove(y.ctypes.data, at_y, y.nbytes)
            ctypes.memmove(ref.ctypes.data, at_ref, ref.nbytes)
            try:
                u = check_step(own[lane], k, measurement, reference, n_m)
            except KeyboardInterrupt:  # C cannot pass it on
                errors[lane] = INTERRUPTED
                return 1
            if isinstance(u, str):
                errors[lane] = f"step {k} {u}"
                return 1
            ctypes.memmove(at_u, u.ctypes.data, u.nbytes)
            return 0

        entry = STEP(step)
        address = ctypes.cast(entry, ctypes.c_void_p).value
        assert address is not None
        return Compiled(
            address,
            np.arange(lanes, dtype=np.int64)[:, None].copy().view(np.uint8),
            8,
            errors,
            (entry, own),
        )


def check_step(own: Any, k: int, y: Measurement, ref: Reference, n_m: int) -> np.ndarray | str:
    """The torques (n_m,) [N m] of sample ``k`` of a Python controller ``own``, or the error of its
    step as a text: an exception, another shape, numbers that are not finite, or more than
    `SLOWEST` seconds.
    """
    begin = time.perf_counter()
    try:
        u = np.asarray(own.step(k, y, ref), dtype=float)
    except Exception as error:
        return f"raised {type(error).__name__}: {error}"
    seconds = time.perf_counter() - begin
    if u.shape != (n_m,):
        return f"returned shape {u.shape}, expected ({n_m},)"
    if not np.isfinite(u).all():
        return f"returned {u}, expected finite torques"
    if seconds > SLOWEST:
        return f"took {seconds:.2f} s, expected less than {SLOWEST} s"
    return np.ascontiguousarray(u)


class _CSetup(ctypes.Structure):
    """``flexgen_controller_setup``."""

    _fields_ = [
        *[(name, ctypes.c_int32) for name in ("n_a", "n_m", "n_y", "n_ref")],
        ("sample_s", ctypes.c_double),
        ("q_m", ctypes.c_void_p),
    ]


class PlugIn:
    """A controller in a shared library; see `flexgen_controller.h`.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    BuildError
        The library cannot be loaded, could be changed by others, lacks a function, or is for
        another version of the interface.
    """

    def __init__(self, path: str | Path) -> None:
        """Load a shared library with the functions of the controller interface.

        Raises
        ------
        BuildError
            It is not a shared library of this computer, lacks a function, or has another version
            of the interface.
        """
        self.path = Path(path)
        try:
            self._library = load_verified(verify_file(self.path), advice=_ADVICE)
        except OSError as error:
            raise BuildError(f"{path}: not a shared library of this computer: {error}") from error
        found = {}
        for name in ("abi", "size", "reset", "step"):
            symbol = f"flexgen_controller_{name}"
            try:
                found[name] = self._library[symbol]
            except AttributeError:
                raise BuildError(
                    f"{path}: given no function {symbol}, expected those of {HEADER.name}"
                ) from None
        abi = int(found["abi"]())
        if abi != ABI:
            raise BuildError(
                f"{path}: given version {abi} of the interface of controllers, expected {ABI}; "
                "recompile it"
            )
        found["size"].restype = ctypes.c_size_t
        self._size = found["size"]
        self._reset = found["reset"]
        self._step = found["step"]

    def compiled(self, setup: Setup) -> Compiled:
        """The functions of the library, each robot with its own memory, which its reset has
        initialized. ArgumentError where it asks for too much memory or refuses the robot.
        """

        def of(lane: int) -> _CSetup:
            """The C struct of one robot: sizes, sample time [s], and the address of its motor
            angles at rest.
            """
            return _CSetup(
                setup.n_a,
                setup.n_m,
                setup.n_y,
                setup.n_ref,
                setup.sample_s,
                angles[lane].ctypes.data,
            )

        angles = np.ascontiguousarray(setup.q_m, dtype=float)
        size = int(self._size(ctypes.byref(of(0))))
        if size > MOST_MEMORY:
            raise ArgumentError(
                f"{self.path}: given {size} bytes of memory, expected at most {MOST_MEMORY}"
            )
        memory = np.zeros((len(angles), -(-max(size, 8) // 16) * 2)).view(np.uint8)
        for lane, own in enumerate(memory):
            status = int(self._reset(ctypes.c_void_p(own.ctypes.data), ctypes.byref(of(lane))))
            if status != 0:
                raise ArgumentError(
                    f"{self.path}: its reset refused the robot with status {status} "
                    f"({setup.n_m} motors, {setup.n_y} measured channels, {setup.sample_s} s)"
                )
        address = ctypes.cast(self._step, ctypes.c_void_p).value
        assert address is not None
        return Compiled(address, memory, 0, {}, self._library, foreign=True)
