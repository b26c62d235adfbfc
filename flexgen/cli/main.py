"""The command line: parse the arguments, run one verb, print its result, set the exit status.

Exit status: 0 success, 1 failure (the reason is on standard error), 2 wrong usage, 3 limits of the
model file exceeded, 130 interrupted, 141 the reader of the output has closed it. With ``--json``,
standard output has exactly one JSON object; after a failure it has the key ``error``.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import shlex
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from datetime import datetime

from flexgen.base.errors import (
    ArgumentError,
    FlexgenError,
    SolverError,
    computation_failed,
    is_numerical,
    message_of,
    printable,
)
from flexgen.base.files.atomic_files import follow_links
from flexgen.base.version import __version__

PACKAGES = ("casadi", "numpy", "scipy", "sympy", "matplotlib")

SUCCESS = 0
FAILURE = 1
USAGE = 2
INTERRUPTED = 130
PIPE_CLOSED = 141


def _print(text: str) -> None:
    """Print and flush, so that a full disk or a closed pipe raises here; names of files may have
    control characters.
    """
    print(printable(text))
    if sys.stdout is not None:
        sys.stdout.flush()


class _Messages:
    """Prints messages on standard error, and writes them with the time to the file of ``--log``.

    Parameters
    ----------
    args : Namespace
        With ``quiet`` (no progress), ``verbose`` (with the time since the start) and ``log`` (a
        path or None).
    words : list of str
        The command line.
    """

    def __init__(self, args: argparse.Namespace, words: list[str]) -> None:
        """Messages of one call with the command line ``words``; ``--log`` opens its file to
        append, OSError where it cannot be written.
        """
        self._began = time.perf_counter()
        self._quiet = args.quiet
        self._verbose = args.verbose
        self._path = args.log
        self._file = (
            None
            if args.log is None
            else follow_links(args.log).open("a", encoding="utf-8", errors="backslashreplace")
        )
        self.record(f"flexgen {__version__}: {shlex.join(words)}")

    def progress(self, text: str) -> None:
        """Print a progress message."""
        if not self._quiet:
            _log(f"[{time.perf_counter() - self._began:7.2f} s] {text}" if self._verbose else text)
        self.record(text)

    def report(self, text: str) -> None:
        """Print a warning or an error."""
        _log(text)
        self.record(text)

    def record(self, text: str) -> None:
        """Write to the log file; a full disk ends the log, not the computation."""
        if self._file is None:
            return
        stamp = datetime.now().astimezone().isoformat(timespec="milliseconds")
        try:
            self._file.write("".join(f"{stamp} {line}\n" for line in text.splitlines()))
            self._file.flush()
        except OSError as error:
            self._file = None
            _log(
                f"flexgen: warning: cannot write to {self._path} ({error.strerror or error}); "
                "the log ends here"
            )

    def close(self) -> None:
        """Close the log file."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()


def _log(text: str) -> None:
    """Print a line on standard error; ignore a closed one."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError):
            print(printable(text), file=sys.stderr, flush=True)


def _discard_output() -> None:
    """Redirect standard output to nowhere, so that the interpreter prints no error when it closes
    the stream.
    """
    with contextlib.suppress(OSError, AttributeError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def _output_to_stderr() -> Iterator[None]:
    """Redirect what libraries print, also libraries in C, to standard error."""
    try:
        sys.stdout.flush()
        kept = os.dup(1)
        os.dup2(2, 1)
    except (OSError, AttributeError, ValueError):  # a stream is closed
        with contextlib.redirect_stdout(sys.stderr):
            yield
        return
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


@contextlib.contextmanager
def _warnings_ignored() -> Iterator[None]:
    """Ignore Python warnings of libraries; FLEXGEN_DEBUG=1 shows them."""
    with warnings.catch_warnings():
        if not os.environ.get("FLEXGEN_DEBUG"):
            warnings.simplefilter("ignore")
        yield


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    try:
        return _main(words)
    except BrokenPipeError:
        _discard_output()
        return PIPE_CLOSED
    except OSError as error:
        _log(f"flexgen: cannot write to standard output ({error.strerror or error})")
        _discard_output()
        return FAILURE


def _main(words: list[str]) -> int:
    """Parse the command line; run the verb, or print help or the usage error."""
    if words == ["--version"]:  # without the parser of all verbs
        _print(f"flexgen {__version__}")
        return SUCCESS
    from flexgen.base.display import as_json
    from flexgen.cli.parser import UsageError, build_parser, parse

    try:
        args = parse(words)
    except UsageError as error:
        message, _, usage = str(error).partition("\n")
        message = message_of(message)
        if "--json" in words:
            _print(as_json({"error": message}))
        _log(f"{usage}\nflexgen: {message}")
        return USAGE
    except SystemExit:  # argparse has printed help or version
        if sys.stdout is not None:
            sys.stdout.flush()
        return SUCCESS
    if args.verb is None:
        _print(build_parser("").format_help().rstrip("\n"))
        return SUCCESS
    try:
        messages = _Messages(args, words)
    except (OSError, ArgumentError) as error:
        reason = (error.strerror if isinstance(error, OSError) else "") or error
        problem = f"--log: cannot write {str(args.log)!r} ({reason})"
        if args.json:
            _print(as_json({"error": problem}))
        _log(f"flexgen: {problem}")
        return FAILURE
    with contextlib.closing(messages):
        for note in getattr(args, "notes", ()):
            messages.report(f"flexgen: warning: {note}")
        return _run(args, messages)


def _run(args: argparse.Namespace, messages: _Messages) -> int:
    """Run the verb, print its result, return the exit status."""
    from flexgen.base.calls.deadline import Deadline, interrupts_recorded
    from flexgen.base.display import as_json
    from flexgen.cli.result import check_outputs
    from flexgen.cli.verbs.check import implausible
    from flexgen.views.reports.text_tables import fit_tables, terminal_width

    result = None
    problem = ""
    status = SUCCESS
    unlimited = Deadline(math.inf)
    try:
        with (
            fit_tables(terminal_width()),
            _output_to_stderr(),
            _warnings_ignored(),
            interrupts_recorded(unlimited),
            _ended_like_interrupted(),
        ):
            check_outputs(args)
            result = args.action(args, messages.progress)
        problem = result.problem
        status = result.failure if problem else SUCCESS
        problem += implausible(args, problem) if problem else ""
    except BaseException as error:
        unlimited.interrupted |= isinstance(error, KeyboardInterrupt)
        if os.environ.get("FLEXGEN_DEBUG"):
            raise
        problem = _reason(error, args)
        status = FAILURE
        problem += (
            implausible(args, problem)
            if isinstance(error, SolverError) or is_numerical(error)
            else ""
        )
    interrupted = unlimited.interrupted or (result is not None and result.interrupted)
    if interrupted:
        result = result if result is not None and result.interrupted else None
        reached = "; the result is the best so far" if result is not None else ""
        unwritten = f"; {problem}" if result is not None and result.unwritten else ""
        problem = f"interrupted{reached}{unwritten}"
        status = INTERRUPTED
    for warning in result.warnings if result is not None else ():
        messages.report(f"flexgen: warning: {warning}")
    if result is not None:
        text = result.text + (f"\n\n{result.details}" if args.verbose and result.details else "")
        messages.record(text)
    if args.json:
        data = {} if result is None else result.data
        _print(as_json(data | ({"error": problem} if problem else {})))
    elif result is not None:
        _print(text)
    if problem:
        messages.report(f"flexgen: {problem}")
    messages.record(f"exit status {status}")
    return status


@contextlib.contextmanager
def _ended_like_interrupted() -> Iterator[None]:
    """Within: SIGTERM does what Ctrl-C does: compilers end, temporary files go, the best result
    stays.

    Where Ctrl-C is ignored, as in a background job of a shell, SIGTERM ends the process as always.
    """
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or not callable(signal.getsignal(signal.SIGINT)):
        yield
        return
    before = signal.signal(
        signal.SIGTERM, lambda number, frame: signal.raise_signal(signal.SIGINT)
    )
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _reason(error: BaseException, args: argparse.Namespace) -> str:
    """The error message for the user."""
    if isinstance(error, FlexgenError):
        return str(error)
    if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in PACKAGES:
        return (
            f"the Python package {error.name} is not installed for "
            f"{sys.executable or 'this Python'}; run 'make setup' and use .venv/bin/flexgen"
        )
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}"
    if isinstance(error, MemoryError):
        return "not enough memory"
    if is_numerical(error):
        what = f" {args.model}" if getattr(args, "model", None) else ""
        return computation_failed(f"{args.verb}{what}", error)
    return (
        "internal error, please report it with the output of FLEXGEN_DEBUG=1: "
        f"{type(error).__name__}: {error}"
    )


if __name__ == "__main__":
    sys.exit(main())
