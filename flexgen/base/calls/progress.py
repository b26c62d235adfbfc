"""Progress of long calls: one line that is rewritten, on a terminal and in a notebook; nothing
elsewhere.
"""

from __future__ import annotations

import functools
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from threading import Lock
from typing import Any, ParamSpec, TypeVar

from flexgen.base.errors import ArgumentError

Progress = Callable[[str], None]  # takes one line of text
Choice = Progress | bool | None  # what a caller gives: a function, on or off, or the default

QUIET = 0.3  # s; messages before this time are not shown
EVERY = 2.0  # s between progress messages of a loop

P = ParamSpec("P")
R = TypeVar("R")

_inside: ContextVar[bool] = ContextVar("inside", default=False)  # a call that reports is under way
# of `one_blas_thread`
_lock = Lock()
_limits = ExitStack()
_blocks = 0


def silent(line: str) -> None:
    """The progress function that shows nothing."""


def tell_every(seconds: float, tell: Progress) -> Progress:
    """A progress function that passes a line where the last one, or this call, is ``seconds`` [s]
    ago.
    """
    last = time.perf_counter()

    def tell_late(line: str) -> None:
        nonlocal last
        if time.perf_counter() - last >= seconds:
            last = time.perf_counter()
            tell(line)

    return tell_late


def is_interactive() -> bool:
    """Whether messages are seen: standard error is a terminal, or this is a notebook."""
    if _in_notebook():
        return True
    with suppress(AttributeError, ValueError, OSError):  # no stream, or a closed one
        return sys.stderr.isatty()
    return False


def _in_notebook() -> bool:
    shell = sys.modules.get("IPython")
    current: Any = (
        shell.get_ipython() if shell is not None and hasattr(shell, "get_ipython") else None
    )
    return type(current).__name__ == "ZMQInteractiveShell"


def reported(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function with the keyword ``progress``: it gets a function, or None where nothing
    is shown.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            with reporting(kwargs.get("progress"), name) as progress:
                kwargs["progress"] = progress
                return function(*args, **kwargs)

        return call

    return decorate


@contextmanager
def reporting(progress: Any, name: str) -> Iterator[Progress | None]:
    """The function that takes the progress messages of a call; None where nothing is shown. BLAS
    has one thread.

    Parameters
    ----------
    progress : callable, bool or None
        A function gets every message. True: show messages; False: none; None: show them on a
        terminal and in a notebook, except within another call that reports.
    name : str
        Name of the call, written before each message.

    Raises
    ------
    ArgumentError
        Something else was given.
    """
    if not callable(progress) and progress is not None and not isinstance(progress, bool):
        raise ArgumentError(
            f"progress: given {progress!r}, expected a function of one line, True, False or None"
        )
    shown = is_interactive() and not _inside.get() if progress is None else progress
    line = None if callable(progress) or not shown else _Line(name)
    token = _inside.set(True)
    try:
        with one_blas_thread():
            yield progress if callable(progress) else None if line is None else line.show
    finally:
        _inside.reset(token)
        if line is not None:
            line.clear()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Numpy and scipy multiply and factorize on one thread until the last of such blocks, in any
    thread, ends.

    The matrices are small: a second thread saves no time, and doubles it where another program
    works too.
    """
    global _blocks
    with _lock:
        if _blocks == 0:
            _limits.enter_context(
                _blas_libraries(len(sys.modules)).limit(limits=1, user_api="blas")
            )
        _blocks += 1
    try:
        yield
    finally:
        with _lock:
            _blocks -= 1
            if _blocks == 0:
                _limits.close()


@functools.lru_cache(maxsize=1)
def _blas_libraries(modules: int) -> Any:
    """The libraries that are loaded with so many modules: to find them takes a millisecond."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


class _Line:
    """One line that each message replaces, with the time since the start; removed at the end."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._began = time.perf_counter()
        self._shown = 0
        self._stream = sys.stdout if _in_notebook() else sys.stderr

    def show(self, line: str) -> None:
        """Replace the line."""
        spent = time.perf_counter() - self._began
        if spent < QUIET:
            return
        width = shutil.get_terminal_size().columns - 1
        self._write(f"{self._name}: {' '.join(line.split())} ({spent:.0f} s)"[:width])

    def clear(self) -> None:
        """Remove the line."""
        if self._shown:
            self._write("")
            self._write("\r")

    def _write(self, text: str) -> None:
        padded = text.ljust(self._shown)
        self._shown = len(text)
        with suppress(AttributeError, ValueError, OSError):  # a closed stream
            self._stream.write(text if text == "\r" else f"\r{padded}")
            self._stream.flush()


def throttle(log: Progress) -> Progress:
    """The function that passes a message on where the last one is `EVERY` old."""
    last = time.monotonic()

    def tell(text: str) -> None:
        nonlocal last
        if time.monotonic() - last > EVERY:
            last = time.monotonic()
            log(text)

    return tell
