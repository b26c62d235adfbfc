"""Time limit of a long call, and its interruption by Ctrl-C: the loops of the solvers check both.

`running` begins a time limit; `check_time` within it raises `OutOfTime` when the time is over, and
KeyboardInterrupt after Ctrl-C, also where a library in C++ has caught that exception and reported
a failure. Outside of `running` there is no limit.

`limit_fit` is `running` for a fit, whose best step so far is its result. Until a first step is
known (`best_known`) the end of the time and Ctrl-C end the call. From then on they end the
searches (`keep_best`) only, and what computes the result from the best step runs to its end; a
second Ctrl-C ends the call. `is_over` says that what is left can be left out, `reason_of_end` why
the result is not the end of the search. A call whose result has parts, such as the rows of a
sweep, is limited in the same way: `part_known` states that one more is done.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

from flexgen.base.errors import ArgumentError, FlexgenError, SolverError

T = TypeVar("T")

UNLIMITED = 1e10  # s

# Steps that searches of fits usually take, for an estimate of their time.
FEW_STEPS = 5
MOST_STEPS = 20
# Time [s] of a search from which on an estimate is told.
LONG = 3.0

# Reasons why a fit ended before its search did, as in texts and JSON.
TIME_LIMIT = "time limit"
INTERRUPTED = "interrupted"


class OutOfTime(FlexgenError):
    """The time limit is over; the text names the stage. No SolverError: nothing else is tried."""


class Deadline:
    """End of a time limit.

    Parameters
    ----------
    seconds : float
        From now; infinity: unlimited.
    limit : float, optional
        The time limit as it was given, of this call or of the one around it that ends first.
        Default: ``seconds``.
    """

    def __init__(self, seconds: float, limit: float | None = None) -> None:
        self.seconds = seconds
        self.limit = seconds if limit is None else limit
        self.interrupted = False
        # Of a fit: whether it has a step that can be its result, how many searches are under way,
        # and why they ended.
        self.is_of_fit = False
        self.best_known = False
        self.tell: Callable[[str], None] | None = None
        # The fit within which this one runs: Ctrl-C may have been recorded there.
        self.outer: Deadline | None = None
        self.searches = 0
        self.ended = ""
        self._end = time.perf_counter() + seconds

    @property
    def left(self) -> float:
        """Time left [s], negative when it is over; infinity without a limit."""
        return self._end - time.perf_counter()

    @property
    def is_interrupted(self) -> bool:
        """Whether Ctrl-C was pressed, in this call or in the fit around it."""
        return self.interrupted or (self.outer is not None and self.outer.is_interrupted)

    def extend(self, seconds: float) -> None:
        """Move the end of the time limit."""
        self._end += seconds

    def check(self, stage: str) -> None:
        """Raise OutOfTime or KeyboardInterrupt if the stage has to end."""
        if self.ended or (self.best_known and not self.searches):
            return
        if self.is_interrupted:
            raise KeyboardInterrupt
        if time.perf_counter() > self._end:
            raise OutOfTime(stage)


_current: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


@contextmanager
def running(seconds: float | None) -> Iterator[Deadline]:
    """Within: a time limit [s]; None: unlimited. A limit within another one ends with the outer
    one at the latest.
    """
    outer = _current.get()
    deadline = Deadline(math.inf if seconds is None else seconds)
    if outer is not None and outer.left < deadline.left:
        deadline = Deadline(outer.left, outer.limit)
    if outer is not None and outer.is_of_fit and outer.searches:
        # Ctrl-C, which the fit records, also ends what runs within its search.
        deadline.outer = outer
    token = _current.set(deadline)
    try:
        with interrupts_recorded(deadline):
            yield deadline
    finally:
        _current.reset(token)


def check_limit(seconds: float | None) -> None:
    """ArgumentError where a time limit [s] is negative or no number."""
    if isinstance(seconds, bool) or not (seconds is None or 0.0 <= seconds < math.inf):
        raise ArgumentError(
            f"time_limit: given {seconds!r}, expected a time >= 0 in s; None or 0: no limit"
        )


@contextmanager
def limit_call(name: str, seconds: float | None) -> Iterator[Deadline]:
    """Within: the time limit [s] of a call that has no result before its end; None or 0:
    unlimited.

    Raises
    ------
    ArgumentError
        The time limit is negative or no number.
    OutOfTime
        The time is over; the text names the stage.
    """
    check_limit(seconds)
    deadline = Deadline(math.inf)
    try:
        with running(seconds or None) as deadline:
            yield deadline
    except OutOfTime as error:
        if not seconds or deadline.seconds < seconds:  # the limit of another call
            raise
        raise OutOfTime(
            f"{name}: the time limit of {seconds:g} s is over ({error}); allow more with "
            "--time-limit SECONDS (time_limit=)"
        ) from None


@contextmanager
def limit_fit(
    name: str,
    seconds: float | None,
    tell: Callable[[str], None] | None = None,
    first: str = "step of the search",
) -> Iterator[Deadline]:
    """Limit the time [s] of a fit, whose searches end with their best step.

    None or 0: unlimited. ``tell`` gets a line with an estimate of the time after the first step.
    ``first``: the first thing that can be the result, for the message where there is none.

    Raises
    ------
    ArgumentError
        The time limit is negative or no number.
    OutOfTime
        The time was over before the first step of the search.
    """
    check_limit(seconds)
    deadline = Deadline(math.inf)
    try:
        outer = _current.get()
        with running(seconds or None) as deadline:
            deadline.is_of_fit = True
            deadline.tell = tell
            if outer is not None and outer.is_of_fit:
                deadline.outer = outer
            yield deadline
        if outer is not None and outer.is_of_fit:
            outer.interrupted |= deadline.interrupted
            outer.ended = outer.ended or deadline.ended
    except (OutOfTime, SolverError) as error:
        # A solve that the time ends without a solution raises SolverError.
        if isinstance(error, SolverError) and (deadline.left > 0.0 or deadline.best_known):
            raise
        if not seconds or deadline.seconds < seconds:  # the limit of another call
            raise
        stage = "solving the move" if isinstance(error, SolverError) else str(error)
        raise OutOfTime(
            f"{name}: the time limit of {seconds:g} s was over before the first {first} "
            f"({stage}); allow more with --time-limit SECONDS (time_limit=)"
        ) from None


def best_known(step_s: float = 0.0) -> None:
    """State that the fit under way has a result.

    From then on the end of the time and Ctrl-C end its searches only. ``step_s`` [s]: that the
    first step took, from which the time of a search is estimated.
    """
    deadline = _current.get()
    if deadline is None or not deadline.is_of_fit:
        return
    if not deadline.best_known and deadline.tell is not None and step_s * MOST_STEPS > LONG:
        low = FEW_STEPS * step_s
        high = MOST_STEPS * step_s
        limit = f"; limit {deadline.seconds:g} s" if deadline.seconds < UNLIMITED else ""
        deadline.tell(
            f"a step takes {step_s:.2g} s, a search of {FEW_STEPS} to {MOST_STEPS} steps about "
            f"{low:.2g} to {high:.2g} s{limit}"
        )
    deadline.best_known = True


def part_known(what: str, took_s: float, left: int) -> None:
    """State that a part of the result under way is done, and that as many are left.

    After the first part an estimate of the time of the others is told, from the time [s] that it
    took. ``what``: the parts, in the plural.
    """
    deadline = _current.get()
    if deadline is None or not deadline.is_of_fit:
        return
    rest_s = took_s * left
    if not deadline.best_known and deadline.tell is not None and rest_s > LONG:
        limit = f"; limit {deadline.seconds:g} s" if deadline.seconds < UNLIMITED else ""
        deadline.tell(f"{left} more {what}, about {rest_s:.2g} s{limit}")
    deadline.best_known = True


def has_limit() -> bool:
    """Whether the time of the call under way is limited."""
    deadline = _current.get()
    return deadline is not None and deadline.seconds < UNLIMITED


@contextmanager
def keep_best() -> Iterator[None]:
    """Keep the best step of a search where the end of the time or Ctrl-C ends it.

    Outside of a fit, and before its first step is known, these errors pass.
    """
    deadline = _current.get()
    if deadline is None:
        yield
        return
    deadline.searches += 1
    try:
        yield
    except (OutOfTime, SolverError, KeyboardInterrupt) as error:
        if not deadline.best_known:
            raise
        # A solve that is ended from outside without a solution raises SolverError.
        is_ended = deadline.left < 0.0 or deadline.is_interrupted
        if isinstance(error, SolverError) and not is_ended:
            raise
        is_time = not isinstance(error, KeyboardInterrupt) and not deadline.is_interrupted
        deadline.ended = deadline.ended or (TIME_LIMIT if is_time else INTERRUPTED)
    finally:
        deadline.searches -= 1


def is_over() -> bool:
    """Whether a search ended early, or has to: what a fit can do without is left out."""
    return bool(reason_of_end())


def reason_of_end() -> str:
    """`TIME_LIMIT` or `INTERRUPTED` where the fit under way has to end, or ended; else empty."""
    deadline = _current.get()
    if deadline is None or not deadline.is_of_fit:
        return ""
    if deadline.ended:
        return deadline.ended
    if deadline.is_interrupted:
        return INTERRUPTED
    return TIME_LIMIT if deadline.left < 0.0 else ""


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
    """Raise OutOfTime if the time limit is over, KeyboardInterrupt after Ctrl-C; cheap enough for
    inner loops.
    """
    deadline = _current.get()
    if deadline is not None:
        deadline.check(stage)


def each_in_time(items: Iterable[T], stage: str) -> Iterator[T]:
    """The items; before each of them `check_time`."""
    for item in items:
        check_time(stage)
        yield item


def is_late(stage: str) -> bool:
    """Whether `check_time` raises now: for callbacks of libraries, through which no error
    passes.
    """
    try:
        check_time(stage)
    except (OutOfTime, KeyboardInterrupt):
        return True
    return False


def time_left() -> float:
    """Time left [s] as libraries take it: at least 1 ms, 1e10 s without a limit."""
    deadline = _current.get()
    return UNLIMITED if deadline is None else min(max(deadline.left, 1e-3), UNLIMITED)


@contextmanager
def interrupts_recorded(deadline: Deadline) -> Iterator[None]:
    """Within: Ctrl-C is recorded in the deadline, and its handler is called: C++ may catch what
    that raises.
    """
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return

    def record(number: int, frame: Any) -> None:
        """Handle Ctrl-C, signal ``number``: the first one is only recorded where a search has a
        step that can be its result; otherwise, and at the second one, the former handler raises
        KeyboardInterrupt.
        """
        if deadline.best_known and not deadline.interrupted:  # the searches end at their next step
            deadline.interrupted = True
            return
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
