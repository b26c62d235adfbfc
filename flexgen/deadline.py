"""Time limit of a long call, and its interruption by Ctrl-C: the loops of the solvers check both.

`running` begins a time limit; `check_time` within it raises `OutOfTime` when the time is over, and KeyboardInterrupt
after Ctrl-C, also where a library in C++ has caught that exception and reported a failure. Outside of `running` there
is no limit.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from flexgen.errors import FlexgenError

UNLIMITED = 1e10  # s


class OutOfTime(FlexgenError):
    """The time limit is over; the text names the stage. No SolverError: nothing else is tried."""


class Deadline:
    """End of a time limit.

    Parameters
    ----------
    seconds : float
        From now; infinity: unlimited.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds, self.interrupted = seconds, False
        self._end = time.perf_counter() + seconds

    @property
    def left(self) -> float:
        """Time left [s], negative when it is over; infinity without a limit."""
        return self._end - time.perf_counter()

    def extend(self, seconds: float) -> None:
        """Move the end of the time limit."""
        self._end += seconds

    def check(self, stage: str) -> None:
        """Raise OutOfTime or KeyboardInterrupt if the stage has to end."""
        if self.interrupted:
            raise KeyboardInterrupt
        if time.perf_counter() > self._end:
            raise OutOfTime(stage)


_current: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


@contextmanager
def running(seconds: float | None) -> Iterator[Deadline]:
    """Within: a time limit [s]; None: unlimited. A limit within another one ends with the outer one at the latest."""
    outer = _current.get()
    deadline = Deadline(
        min(math.inf if seconds is None else seconds, math.inf if outer is None else outer.left)
    )
    token = _current.set(deadline)
    try:
        with interrupts_recorded(deadline):
            yield deadline
    finally:
        _current.reset(token)


@contextmanager
def pause() -> Iterator[None]:
    """Within: the time does not count."""
    began = time.perf_counter()
    try:
        yield
    finally:
        deadline = _current.get()
        if deadline is not None:
            deadline.extend(time.perf_counter() - began)


def check_time(stage: str) -> None:
    """Raise OutOfTime if the time limit is over, KeyboardInterrupt after Ctrl-C; cheap enough for inner loops."""
    deadline = _current.get()
    if deadline is not None:
        deadline.check(stage)


def time_left() -> float:
    """Time left [s] as libraries take it: at least 1 ms, 1e10 s without a limit."""
    deadline = _current.get()
    return UNLIMITED if deadline is None else min(max(deadline.left, 1e-3), UNLIMITED)


@contextmanager
def interrupts_recorded(deadline: Deadline) -> Iterator[None]:
    """Within: Ctrl-C is recorded in the deadline, and its handler is called: C++ may catch what that raises."""
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return

    def record(number: int, frame: Any) -> None:
        try:
            handler(number, frame)
        except KeyboardInterrupt:
            deadline.interrupted = True
            raise

    signal.signal(signal.SIGINT, record)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
