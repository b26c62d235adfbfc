"""Third-party controllers in a separate process: Python files, Python objects, shared libraries.

The process knows neither the scorer's memory nor the draws: it gets the measurements of all robots
of a sample over a pipe and returns their torques. Its answer is checked here: length and finite
numbers. A process that does not answer in time is terminated. This protects the score, not the
computer: third-party code has all rights of its user.

Messages, in the order of bytes of this computer: int64 k, then y (lanes, n_y) and ref (lanes,
n_ref); the answer is int64 n, then u (lanes, n_m), then n bytes of JSON with the robots that
failed. k = BEGIN: int64 n and n bytes of JSON.
"""

from __future__ import annotations

import base64
import ctypes
import importlib
import importlib.util
import json
import os
import pickle
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.interface import INTERRUPTED, Compiled, PlugIn, PythonController, Setup
from flexgen.studies.scenarios import foreign_process
from flexgen.studies.scenarios.foreign_process import BEGIN

INSIDE = "FLEXGEN_CONTROLLER_PROCESS"  # set in the environment of the process
# longest answer for a sample, longest begin, all answers together
STEP_S = 5.0
BEGIN_S = 60.0
TOTAL_S = 1800.0
_TOGETHER = ctypes.CFUNCTYPE(
    None, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p
)


class ForeignController:
    """A controller in a separate process.

    Parameters
    ----------
    given : str, Path or object
        ``file.py``, ``file.py:Class``, a shared library, or an object with ``reset()`` and
        ``step(k, y, ref)``.
    step_s, total_s : float [s]
        Longest time for a sample of all robots, and for all samples together.
    """

    def __init__(self, given: Any, step_s: float = STEP_S, total_s: float = TOTAL_S) -> None:
        """``given``: a file, a `PlugIn` or an object; ``step_s``, ``total_s``: limits for one
        sample of all robots, and for all of them [s]. The process starts later.
        """
        self.step_s = step_s
        self.total_s = total_s
        self.is_object = not isinstance(given, (str, Path, PlugIn))
        if isinstance(given, PlugIn):
            given = str(given.path.resolve())
        if isinstance(given, PythonController):
            given = given.controller
        self.name = type(given).__name__ if self.is_object else Path(str(given)).name
        if self.is_object:
            PythonController(given)  # has it the methods?
            self._load: dict[str, Any] = {
                "object": pickle_object(given),
                "main": program_file(given),
            }
        else:
            self._load = {"file": str(given)}
        self.used_s = 0.0
        self._process: subprocess.Popen[bytes] | None = None
        self._failure = ""
        self._limit = step_s
        self._deadline = float("inf")

    def compiled(self, setup: Setup) -> Compiled:
        """Begin with all robots at rest; the function that takes their samples together."""
        lanes = len(setup.q_m)
        errors: dict[int, str] = {}
        self._begin(setup)
        shapes = (lanes, setup.n_y), (lanes, setup.n_ref), (lanes, setup.n_m)
        sizes = [8 * a * b for a, b in shapes]

        def together(k: int, at_y: int, at_ref: int, at_u: int) -> None:
            """Torques of sample k of all robots; y, ref and u are addresses of C arrays (lanes,
            n). After a failure the torques are NaN.
            """
            try:
                sent = (
                    struct.pack("=q", k)
                    + ctypes.string_at(at_y, sizes[0])
                    + ctypes.string_at(at_ref, sizes[1])
                )
                answer = self._ask(sent, sizes[2], errors)
            except KeyboardInterrupt:  # C cannot pass it on
                errors[0] = INTERRUPTED
                answer = None
            if answer is None:
                for lane in range(lanes):
                    errors.setdefault(lane, self._failure)
                answer = np.full(shapes[2], np.nan).tobytes()
            ctypes.memmove(at_u, answer, sizes[2])

        entry = _TOGETHER(together)
        address = ctypes.cast(entry, ctypes.c_void_p).value
        assert address is not None
        return Compiled(
            address, np.zeros((lanes, 8), np.uint8), 8, errors, entry, together=address
        )

    def close(self) -> None:
        """End the process."""
        process = self._process
        self._process = None
        if process is not None:
            process.kill()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()
            process.wait()

    def _ask(self, sent: bytes, size: int, errors: dict[int, str]) -> bytes | None:
        """Torques of all robots as ``size`` bytes for the message ``sent``; None where the process
        has failed.

        ``errors``: reports by robot, which are added. The time is limited for each sample and for
        all.
        """
        if self._failure:
            return None
        began = time.monotonic()
        self._limit = self.step_s
        self._deadline = began + self.step_s
        answer = self._exchange(sent, 8 + size)
        if answer is not None:
            more = struct.unpack_from("=q", answer)[0]
            if more:
                found = self._exchange(b"", more) if 0 < more < 2**20 else None
                answer = answer if self._store_errors(found, errors, size) else None
        self._deadline = float("inf")
        self.used_s += time.monotonic() - began
        if answer is None:
            self._failure = self._failure or self._describe_end()
        elif self.used_s > self.total_s:
            self._failure = f"the controller took more than {self.total_s:g} s for all samples"
        return None if answer is None else answer[8:]

    def _store_errors(self, found: bytes | None, errors: dict[int, str], size: int) -> bool:
        """Store the reports ``found`` (JSON: text by robot) in ``errors``, the first of each
        robot; False where they cannot be read.
        """
        try:
            told = {int(lane): str(text)[:500] for lane, text in json.loads(found or b"").items()}
        except (ValueError, AttributeError, RecursionError):
            return False
        for lane, text in told.items():
            errors.setdefault(lane, text)
        return True

    def _begin(self, setup: Setup) -> None:
        """Tell the process the robots; start it before, where it does not run."""
        if self._failure:
            return
        self._limit = BEGIN_S
        self._deadline = time.monotonic() + BEGIN_S
        if self._process is None:
            self._start()
        numbers = {
            "n_a": setup.n_a,
            "n_y": setup.n_y,
            "n_ref": setup.n_ref,
            "sample_s": setup.sample_s,
        }
        text = json.dumps(
            self._load | numbers | {"q_m": setup.q_m.tolist(), "path": sys.path}
        ).encode()
        head = self._exchange(struct.pack("=qq", BEGIN, len(text)) + text, 8)
        size = struct.unpack("=q", head)[0] if head is not None else -1
        told = self._exchange(b"", size) if 0 <= size < 2**20 else None
        self._deadline = float("inf")
        if told is None:
            raise ArgumentError(f"controller {self.name}: {self._describe_end()} before it began")
        if told:
            raise ArgumentError(f"controller {self.name}: {told.decode(errors='replace')[:2000]}")

    def _start(self) -> None:
        """Start the process with one thread for linear algebra, and a thread that ends it when the
        time is over.
        """
        package = Path(__file__).resolve().parents[3]
        path = os.pathsep.join(filter(None, [str(package), os.environ.get("PYTHONPATH", "")]))
        own = os.environ | {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", INSIDE: "1"}
        command = [sys.executable, "-m", foreign_process.__name__]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env=own
        )
        threading.Thread(
            target=_watch, args=(self, self._process), name="controller", daemon=True
        ).start()

    def _exchange(self, sent: bytes, size: int) -> bytes | None:
        """Send bytes and receive ``size`` of them; None where the process has ended."""
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            return None
        parts: list[bytes] = []
        try:
            view = memoryview(sent)
            while view:
                view = view[process.stdin.write(view) or 0 :]
            while size > 0:
                got = process.stdout.read(size)
                if not got:
                    return None
                parts.append(got)
                size -= len(got)
        except OSError:
            return None
        return b"".join(parts)

    def _describe_end(self) -> str:
        """Why there is no answer."""
        if self._failure:
            return self._failure
        code = (
            self._process.wait(1.0)
            if self._process is not None and self._process.poll() is not None
            else None
        )
        return "the controller's process ended" + (
            f" with code {code}" if code is not None else ""
        )


def _watch(controller: ForeignController, process: subprocess.Popen[bytes]) -> None:
    """End a process that does not answer in time."""
    while process.poll() is None:
        if time.monotonic() > controller._deadline:
            controller._failure = (
                f"the controller did not answer within {controller._limit:g} s; its process was "
                "ended"
            )
            process.kill()
            return
        time.sleep(0.1)


def pickle_object(given: Any) -> str:
    """An object as text, its class by name; by cloudpickle, where that is installed, without a
    file that has it.
    """
    kind = type(given)
    dumps: Callable[[Any], bytes] = pickle.dumps
    if kind.__module__ == "__main__" and not program_file(given):
        if importlib.util.find_spec("cloudpickle") is None:
            raise ArgumentError(
                f"controller: given an object of {kind.__name__}, which no file has, expected a "
                "class in a file: controllers run in a separate process; give "
                f"'file.py:{kind.__name__}'"
            )
        dumps = importlib.import_module("cloudpickle").dumps
    try:
        return base64.b64encode(dumps(given)).decode("ascii")
    except Exception as error:
        raise ArgumentError(
            f"controller: given an object of {kind.__name__} that cannot be sent to a separate "
            f"process ({type(error).__name__}: {error}), expected one that pickle takes, or "
            f"'file.py:{kind.__name__}'"
        ) from error


def program_file(given: Any) -> str:
    """The program's file where it has the class of the object, or nothing."""
    file = getattr(sys.modules.get("__main__"), "__file__", None)
    return (
        str(Path(file).resolve())
        if type(given).__module__ == "__main__" and file and Path(file).is_file()
        else ""
    )
