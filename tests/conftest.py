"""The selection of the slow tests, and the cache of compiled C that the workers of a run share.

`make test` runs what is not slow. A test is slow where

- its folder or file stands in ``SLOW``,
- it runs on a model that is not in ``QUICK_MODELS``, by the words of its id; files in ``ANY_MODEL`` are excepted,
- its case stands in ``SLOW_CASES``,
- it has ``@pytest.mark.slow``: for what the folder and the model do not say.
"""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

import pytest

from flexgen.build.object_cache import cache_folder
from flexgen.errors import BuildError

ROOT = Path(__file__).resolve().parents[1]
QUICK_MODELS = {"elbow", "planar5_nmp", "beam_arm", "manutec_r3"}
# Folders (with a slash at the end) and files: convergence orders, cross compilers, sanitizers, the wheel.
SLOW = (
    "order/",
    "client/test_cross_compile.py",
    "client/test_hostile_inversion.py",
    "client/test_hostile_sanitizers.py",
    "client/test_kernel_compilers.py",
    "client/test_wheel.py",
)
# Files that read or analyze each model in some milliseconds.
ANY_MODEL = (
    "published/test_analysis.py",
    "unit/test_reader.py",
    "unit/test_solvability.py",
    "unit/test_structure.py",
    "unit/test_zero_path.py",
)
# Cases whose robot or method takes long, by a word of the id or the whole id.
SLOW_CASES = {
    "client/test_product.py": {"planar5_nmp-gcc--O0", "planar5_nmp-gcc--O2"},
    "cross/test_recursion.py": {
        "dense7",
        "dense12",
        "sliding8",
        "ur5_elastic",
        "panda",
        "synthetic_complete",
        "synthetic_mixed",
        "synthetic_spinning",
    },
    "cross/test_bvp.py": {"undamped", "zeros change"},
    "cross/test_comparison.py": {"joints of both units"},
    "cross/test_referees.py": {"any-simplified", "linear-complete", "linear-simplified"},
    "cross/test_symbolic.py": {"skew", "arm-complete-rigid"},
    "laws/test_paths_smoothness.py": {"lq-3", "bvp-2"},
    "laws/test_solve.py": {"manutec_r3-joints", "beam_arm-joints"},
    "unit/test_report.py": {"beam_arm-line", "manutec_r3-line"},
    "unit/test_solve_stages.py": {"1.0", "0.01"},
}
OTHER_MODELS = {path.stem for path in (ROOT / "models").glob("*.toml")} - QUICK_MODELS


def slow(path: str, words: str) -> bool:
    """Whether folder or model make a test slow.

    Parameters
    ----------
    path : str
        The file, relative to ``tests``.
    words : str
        The id of the case, such as ``planar5_nmp@undamped-lq``; empty without parameters.
    """
    if any(path == entry or (entry.endswith("/") and path.startswith(entry)) for entry in SLOW):
        return True
    names = {words, *re.split(r"[-@]", words)}
    if not names.isdisjoint(SLOW_CASES.get(path, ())):
        return True
    return path not in ANY_MODEL and not names.isdisjoint(OTHER_MODELS)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow tests."""
    for item in items:
        path = item.path.relative_to(ROOT / "tests").as_posix()
        case = getattr(item, "callspec", None)
        if slow(path, "" if case is None else case.id):
            item.add_marker("slow")


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
