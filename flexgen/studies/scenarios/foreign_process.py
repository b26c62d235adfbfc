"""The process in which a third-party controller runs; see `foreign.py` for the messages."""

from __future__ import annotations

import base64
import ctypes
import json
import os
import pickle
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from flexgen.base.errors import FlexgenError
from flexgen.feedback.loop.interface import (
    STEP,
    Measurement,
    PlugIn,
    PythonController,
    Setup,
    check_step,
    reference_of,
)
from flexgen.feedback.loop.python_files import is_python, module_of_file, object_of_file

BEGIN = -1  # in the place of the number of a sample: the controller and the robots follow

# from the number of a sample: what is wrong with robots, by their number
Steps = Callable[[int], dict[int, str]]


def main() -> None:
    """Answer until the pipe is closed. Output that the controller prints goes to the standard
    error.
    """
    take = os.fdopen(os.dup(0), "rb")
    give = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.argv = sys.argv[:1]
    answer_messages(take, give)


def answer_messages(take: BinaryIO, give: BinaryIO) -> None:
    """Answer the messages of `take` to `give` until there are no more; see `foreign.py`."""
    loaded: PlugIn | PythonController | None = None
    robots: _Robots | None = None
    while len(head := take.read(8)) == 8:
        k = struct.unpack("=q", head)[0]
        if k == BEGIN:
            told = json.loads(take.read(struct.unpack("=q", take.read(8))[0]))
            try:
                loaded = loaded or _load_controller(told)
                robots = _Robots(loaded, told)
                text = b""
            except (FlexgenError, OSError, ValueError, TypeError) as error:
                text = str(error).encode() or type(error).__name__.encode()
            give.write(struct.pack("=q", len(text)) + text)
        elif robots is not None:
            give.write(robots.answer(k, take))


def _load_controller(told: dict[str, Any]) -> PlugIn | PythonController:
    """The controller of a file or an object."""
    sys.path[:] = told["path"]
    if "file" in told:
        file = told["file"]
        return PythonController(object_of_file(file)) if is_python(file) else PlugIn(file)
    if told["main"]:
        sys.modules["__main__"] = module_of_file("__mp_main__", Path(told["main"]))
    try:
        return PythonController(pickle.loads(base64.b64decode(told["object"])))
    except Exception as error:
        raise ValueError(
            f"its class cannot be found in a separate process ({type(error).__name__}: "
            f"{error}): put it into a file and give 'file.py:Class'"
        ) from error


class _Robots:
    """Controllers of all robots of a run, and their memory."""

    def __init__(self, loaded: PlugIn | PythonController, told: dict[str, Any]) -> None:
        """``told``: motor angles at rest ``q_m`` (lanes, n_m) [rad], sample time [s] and sizes, as
        the program sends them.
        """
        q_m = np.array(told["q_m"], dtype=float)
        setup = Setup(q_m, told["sample_s"], told["n_a"], told["n_y"], told["n_ref"])
        lanes = len(q_m)
        self.y = np.zeros((lanes, setup.n_y))
        self.ref = np.zeros((lanes, setup.n_ref))
        self.u = np.zeros((lanes, setup.n_m))
        self.count = 0
        self.failed = set[int]()
        of_kind = self._of_library if isinstance(loaded, PlugIn) else self._of_python
        self.step: Steps = of_kind(loaded, setup)  # type: ignore[arg-type]

    def answer(self, k: int, take: BinaryIO) -> bytes:
        """Read measurements and reference of sample k from ``take``; the message with the torques:
        length of the reports, torques (lanes, n_m) [N m], reports. A robot that failed once has
        NaN from then on.
        """
        for array in (self.y, self.ref):
            array[:] = np.frombuffer(take.read(array.nbytes)).reshape(array.shape)
        errors = self.step(k)
        for lane in errors:
            self.failed.add(lane)
        for lane in self.failed:
            self.u[lane] = np.nan
        self.count += 1
        text = json.dumps(errors).encode() if errors else b""
        return struct.pack("=q", len(text)) + self.u.tobytes() + text

    def _of_python(self, loaded: PythonController, setup: Setup) -> Steps:
        """The function of a sample: a copy of the Python controller for each robot; reports of
        those that fail, by robot.
        """
        own = loaded.copies(len(self.y))
        seen = [Measurement(*np.split(y, [setup.n_m])) for y in self.y]
        planned = [reference_of(ref, setup) for ref in self.ref]

        def step(k: int) -> dict[int, str]:
            """One sample of each robot that has not failed; reports of those that fail now."""
            errors = {}
            for lane, controller in enumerate(own):
                if lane in self.failed:
                    continue
                u = check_step(controller, k, seen[lane], planned[lane], setup.n_m)
                if isinstance(u, str):
                    errors[lane] = f"step {self.count} {u}"[:500]
                else:
                    self.u[lane] = u
            return errors

        return step

    def _of_library(self, loaded: PlugIn, setup: Setup) -> Steps:
        """The function of a sample: the C function of the library with memory of each robot;
        reports of those that fail, by robot.
        """
        made = loaded.compiled(setup)
        entry = STEP(made.address)
        keep = made
        at = [
            tuple(
                ctypes.c_void_p(x[lane].ctypes.data)
                for x in (keep.memory, self.y, self.ref, self.u)
            )
            for lane in range(len(self.y))
        ]

        def step(k: int) -> dict[int, str]:
            errors = {}
            for lane, (memory, y, ref, u) in enumerate(at):
                if lane not in self.failed and entry(memory, k, y, ref, u) != 0:
                    errors[lane] = f"step {self.count}: controller failed"
            return errors

        return step


if __name__ == "__main__":
    main()
