"""The marker of the slow tests, and the cache of compiled C that the workers of a run share."""

from __future__ import annotations

import contextlib
import gc
import os
from pathlib import Path

import pytest
from selection import ROOT, full, slow

from flexgen.errors import BuildError
from flexgen.library.object_cache import cache_folder


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow tests."""
    for item in items:
        path = item.path.relative_to(ROOT / "tests").as_posix()
        case = getattr(item, "callspec", None)
        words = "" if case is None else case.id
        if slow(path, words):
            item.add_marker("slow")
        if full(path, words):
            item.add_marker("full")


def pytest_collection_finish() -> None:
    """Leave what lives until the end, such as modules, out of the searches for garbage: a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def cache_of_this_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of compiled C: ``FLEXGEN_TEST_CACHE``, or one for this run; never the user's cache."""
    base = tmp_path_factory.getbasetemp()
    own = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "objects"
    for folder in (os.environ.get("FLEXGEN_TEST_CACHE"), str(own)):
        if folder:
            os.environ["FLEXGEN_CACHE"] = folder
            with contextlib.suppress(BuildError):  # others can write to it: the next one
                cache_folder()
                break
    return Path(os.environ["FLEXGEN_CACHE"])
