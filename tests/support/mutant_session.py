"""Plugin of pytest that runs the tests of mutants; each mutant in a separate process.

The environment variable ``MUTANTS`` names the file that `mutants` wrote. After the collection,
one process runs all tests and records which of them reach the statement of each mutant. Then,
for each mutant, a process changes the file on the disk and the code of the functions in memory,
and runs these tests until one fails. Where the statement is in no function, a new pytest runs
them.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import pytest
from mutants import QUICK, Mutant

# A mutant may make tests slower: by this factor and, in addition, by this time in seconds.
SLOWER = 10.0
LEAST_S = 30.0
# Most tests of one mutant; the shortest ones.
MOST_TESTS = 40


class Failures:
    """Plugin: the tests that failed, and the time of each [s]."""

    def __init__(self) -> None:
        self.failed: set[str] = set()
        self.seconds: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note one phase of a test."""
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            self.failed.add(report.nodeid)


def quiet(session: pytest.Session) -> Failures:
    """Replace the progress on the terminal by a record of the results."""
    results = Failures()
    session.config.pluginmanager.unregister(name="terminalreporter")
    session.config.pluginmanager.register(results)
    return results


def forked(work: Callable[[], int], limit_s: float) -> int | None:
    """Status of a process that does the work; None where it took longer than the limit [s]."""
    child = os.fork()
    if child == 0:
        status = 70
        try:
            os.setpgid(0, 0)
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            status = work()
        finally:
            os._exit(status)
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def run_items(session: pytest.Session, items: list[pytest.Item], first: bool) -> Failures:
    """Run tests one after the other; with ``first`` only until one fails."""
    results = quiet(session)
    for item, after in zip(items, [*items[1:], None], strict=True):
        session.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
        if first and results.failed:
            break
    return results


def record(session: pytest.Session, mutants: list[Mutant], out: Path) -> int:
    """Run all tests; write which reach each mutant, how long they take, and which fail."""
    lines: dict[str, dict[int, list[int]]] = {}
    for number, mutant in enumerate(mutants):
        of_file = lines.setdefault(str(Path.cwd() / mutant.file), {})
        for line in range(mutant.line, mutant.last + 1):
            of_file.setdefault(line, []).append(number)
    reached: dict[int, dict[str, None]] = {}
    now = ""

    def in_function(frame: FrameType, event: str, _: Any) -> Any:
        if event == "line":
            for number in lines[frame.f_code.co_filename].get(frame.f_lineno, ()):
                reached.setdefault(number, {})[now] = None
        return in_function

    def trace(frame: FrameType, event: str, value: Any) -> Any:
        return in_function if frame.f_code.co_filename in lines else None

    results = quiet(session)
    threading.settrace(trace)
    for item, after in zip(session.items, [*session.items[1:], None], strict=True):
        now = item.nodeid
        sys.settrace(trace)
        session.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
        sys.settrace(None)
    found = {
        "reached": {number: list(tests) for number, tests in reached.items()},
        "seconds": results.seconds,
        "failed": sorted(results.failed),
    }
    out.write_text(json.dumps(found))
    return 0


def codes(code: CodeType) -> list[CodeType]:
    """The code of all functions in a module, in the order of the file."""
    inner = [part for part in code.co_consts if isinstance(part, CodeType)]
    return [found for part in inner for found in (part, *codes(part))]


def change_functions(path: str, before: str, after: str) -> None:
    """Give all functions of a loaded module the code of its changed text."""
    old, new = (codes(compile(x, path, "exec", dont_inherit=True)) for x in (before, after))
    changed = {a: b for a, b in zip(old, new, strict=True) if a != b}
    gc.unfreeze()
    for thing in gc.get_objects():
        if type(thing) is FunctionType and thing.__code__.co_filename == path:
            thing.__code__ = changed.get(thing.__code__, thing.__code__)


def killed(session: pytest.Session, mutant: Mutant, tests: list[str], limit_s: float) -> bool:
    """Whether one of these tests fails with a mutant, or takes too long."""
    path = Path.cwd() / mutant.file
    text = path.read_text(encoding="utf-8")
    kept = path.with_suffix(".kept")
    shutil.copy2(path, kept)

    def work() -> int:
        change_functions(str(path), text, mutant.applied(text))
        items = {item.nodeid: item for item in session.items}
        return int(bool(run_items(session, [items[test] for test in tests], True).failed))

    def anew() -> int:
        command = [sys.executable, "-B", "-m", "pytest", "-q", "-x", "-m", QUICK, *tests]
        command += ["-p", "no:cacheprovider"]
        there = {key: value for key, value in os.environ.items() if key != "MUTANTS"}
        return int(subprocess.run(command, env=there, check=False).returncode not in (0, 5))

    try:
        path.write_text(mutant.applied(text), encoding="utf-8")
        status = forked(work if mutant.function else anew, limit_s)
    finally:
        shutil.move(kept, path)
    return status != 0


def pytest_runtestloop(session: pytest.Session) -> bool:
    """Instead of the tests: one run that records what they reach, then those of each mutant."""
    sys.dont_write_bytecode = True
    mutants = [Mutant(**row) for row in json.loads(Path(os.environ["MUTANTS"]).read_text())]
    out = Path(os.environ["MUTANTS"]).with_suffix(".reached")
    if forked(lambda: record(session, mutants, out), 3600.0) != 0:
        print("ERROR: the tests do not run without a mutant", flush=True)
        return True
    found = json.loads(out.read_text())
    failed = set(found["failed"])
    for test in found["failed"]:
        print(f"FAILS without a mutant: {test}", flush=True)
    every = [item.nodeid for item in session.items]
    for number, mutant in enumerate(mutants):
        tests = found["reached"].get(str(number), []) if mutant.function else every
        tests = [test for test in tests if test not in failed]
        tests = sorted(tests, key=lambda test: found["seconds"][test])[:MOST_TESTS]
        limit_s = LEAST_S + SLOWER * sum(found["seconds"][test] for test in tests)
        dead = bool(tests) and killed(session, mutant, tests, limit_s)
        verdict = "killed" if dead else f"SURVIVES {len(tests)} tests"
        change = f"{mutant.before} -> {mutant.after}".replace("\n", " ")
        print(f"{verdict} {mutant.kind} {mutant.file}:{mutant.line}: {change}", flush=True)
    return True
