"""The marker of the slow tests, and the cache of compiled C that the workers of a run share."""

from __future__ import annotations

import contextlib
import dis
import functools
import gc
import importlib
import inspect
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import durations
import pytest
from selection import ROOT, SLOW, full, slow, unoptimized
from toolchain import CC
from undrawn import draw_nothing

from flexgen.base.errors import BuildError
from flexgen.codegen.build.object_cache import cache_folder
from flexgen.dynamics.mechanics import equations

USERS_CC = os.environ.get("CC")
HARMLESS = ("chdir", "setenv", "delenv")


DERIVE = equations.derive


@functools.wraps(DERIVE)
def derive_once(model: Any, parameters: Sequence[str] = ()) -> equations.Equations:
    """The equations of another test where none has changed anything; see `pytest_configure` and
    `pytest_runtest_setup`."""
    made = DERIVE(model, parameters)
    return made if parameters else equations.kept_equations(made.model)


equations.derive = derive_once  # before a test module imports it
equations.KEPT = 8


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option that records how long tests take."""
    parser.addoption(
        "--record-durations",
        action="store_true",
        help="write the durations of slow tests to tests/durations.json",
    )


class DurationsOfRun:
    """Plugin: the time of each test that passes, written to the file of durations at the end."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the time of a phase."""
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if not report.passed:
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write the file."""
        shortest: dict[str, str] = {}
        for test in sorted(self.seconds, key=lambda test: self.seconds[test]):
            shortest.setdefault(test.partition("[")[0], test)
        passed = {x: time for x, time in self.seconds.items() if x not in self.failed}
        durations.write(durations.updated(durations.read(), passed, shortest.values()))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave files that have only slow tests alone where no slow test is asked for."""
    if "not slow" not in config.getoption("markexpr") or not collection_path.is_relative_to(
        ROOT / "tests"
    ):
        return None
    path = collection_path.relative_to(ROOT / "tests").as_posix()
    return True if path in SLOW or f"{path}/" in SLOW else None


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the n-th part of the test files in the n-th worker, not each file in each worker,
    where none is compiled.

    pytest compiles a file when it is imported; an import without builtins stops after that, at the
    first statement. Searches for garbage find nothing while tests are collected.
    """
    gc.disable()
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    count = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if count == 1 or sys.dont_write_bytecode:
        return
    for path in sorted((ROOT / "tests").glob("*/test_*.py"))[
        int(worker.removeprefix("gw")) :: count
    ]:
        if pytest_ignore_collect(path, session.config) or any(
            (path.parent / "__pycache__").glob(f"{path.stem}.*")
        ):
            continue
        spec = next(
            filter(
                None, (finder.find_spec(path.stem, [str(path.parent)]) for finder in sys.meta_path)
            )
        )
        module = importlib.util.module_from_spec(spec)
        module.__dict__["__builtins__"] = {}
        with contextlib.suppress(Exception):  # errors of a file are reported when it is collected
            spec.loader.exec_module(module)


def pytest_configure(config: pytest.Config) -> None:
    """Forget equations where something is changed: those with a planted error are for no other
    test.
    """
    if config.getoption("record_durations") and "PYTEST_XDIST_WORKER" not in os.environ:
        config.pluginmanager.register(DurationsOfRun())

    def forgetting(method: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(method)
        def call(self: pytest.MonkeyPatch, *args: Any, **kwargs: Any) -> Any:
            undone = (
                [*self._setattr, *(item[0] for item in self._setitem)]
                if method.__name__ == "undo"
                else ()
            )
            if any(thing is not os.environ for thing in (*args[:1], *undone)):
                equations._KEPT.clear()
            return method(self, *args, **kwargs)

        return call

    for name in ("setattr", "setitem", "delattr", "delitem", "undo"):
        setattr(pytest.MonkeyPatch, name, forgetting(getattr(pytest.MonkeyPatch, name)))


def plants_errors(test: Callable[..., Any]) -> bool:
    """Whether a test does more with its monkeypatch than choosing a folder or the environment."""
    steps = list(dis.get_instructions(inspect.unwrap(test)))
    return any(
        step.opname.startswith("LOAD")
        and "monkeypatch" in str(step.argval)
        and after.argval not in HARMLESS
        for step, after in pairwise(steps)
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow tests."""
    for item in items:
        path = item.path.relative_to(ROOT / "tests").as_posix()
        case = getattr(item, "callspec", None)
        words = "" if case is None else case.id
        name = getattr(item, "originalname", item.name)
        if slow(path, name, words):
            item.add_marker("slow")
        if full(path, name, words):
            item.add_marker("full")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Choose the compiler of the test, see `unoptimized`; each of the two has its own cache.

    A test that plants an error after it has derived equations gets new ones: nothing is built from
    them before.
    """
    if "monkeypatch" in item.fixturenames and plants_errors(item.function):
        equations._KEPT.clear()
    if USERS_CC is not None or CC is None or "FLEXGEN_CACHE" not in os.environ:
        return
    folder = Path(os.environ["FLEXGEN_CACHE"])
    before = folder.name == "unoptimized"
    path = item.path.relative_to(ROOT / "tests").as_posix()
    case = getattr(item, "callspec", None)
    quick = all(item.get_closest_marker(mark) is None for mark in ("slow", "full", "robots"))
    if (
        unoptimized(
            path, getattr(item, "originalname", ""), "" if case is None else case.id, quick
        )
        == before
    ):
        return
    if before:
        del os.environ["CC"]
    else:
        os.environ["CC"] = f"{shlex.quote(CC)} -O0"
    os.environ["FLEXGEN_CACHE"] = str(folder.parent if before else folder / "unoptimized")
    from flexgen.codegen.build import c_module, model_library
    from flexgen.simulation.integration import compiled_rate
    from flexgen.studies.sweeps.version import code_version

    for kept in (
        model_library.library_holder,
        c_module.c_module,
        compiled_rate.compiled_advance,
        code_version,
    ):
        kept.cache_clear()


def pytest_collection_finish() -> None:
    """Leave what lives until the end, such as modules, out of the searches for garbage: a tenth of
    the time.
    """
    gc.enable()
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.callbacks.clear()  # JAX has one


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures in files are empty frames: a test of the texts of a report takes a fifth of the
    time.
    """
    draw_nothing(monkeypatch.setattr)


@pytest.fixture(scope="session", autouse=True)
def cache_of_this_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of compiled C: ``FLEXGEN_TEST_CACHE``, or one for this run; never the user's
    cache.
    """
    base = tmp_path_factory.getbasetemp()
    own = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "objects"
    for folder in (os.environ.get("FLEXGEN_TEST_CACHE"), str(own)):
        if folder:
            os.environ["FLEXGEN_CACHE"] = folder
            with contextlib.suppress(BuildError):  # others can write to it: the next one
                cache_folder()
                break
    return Path(os.environ["FLEXGEN_CACHE"])
