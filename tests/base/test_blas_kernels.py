"""The kernels of OpenBLAS that tests of numbers run with: ``make test-kernels`` chooses them."""

from __future__ import annotations

import os
import re

import numpy as np
import pytest
import threadpoolctl
from scipy.linalg import eigvals

CHOSEN = os.environ.get("OPENBLAS_CORETYPE", "")


def openblas() -> list[str]:
    """Names of the kernels of each OpenBLAS of this process, after calls of both packages."""
    np.linalg.svd(np.eye(3))
    eigvals(np.eye(3))
    found = threadpoolctl.threadpool_info()
    return [one["architecture"] for one in found if one.get("internal_api") == "openblas"]


@pytest.mark.skipif(not CHOSEN, reason="OPENBLAS_CORETYPE chooses no kernels")
def test_the_kernels_are_the_chosen_ones() -> None:
    """Otherwise the other tests would run with the same kernels again, and prove nothing."""
    found = openblas()
    if not found:
        pytest.skip("numpy and scipy do not use OpenBLAS here")
    assert {name.lower() for name in found} == {CHOSEN.lower()}


def test_make_runs_the_tests_of_numbers_with_three_kinds_of_kernels() -> None:
    """With 128, 256 and 512 bit vectors; and all files of the list are there."""
    root = os.path.dirname(os.path.dirname(os.path.dirname(__file__)))
    with open(f"{root}/Makefile", encoding="utf-8") as file:
        text = file.read().replace("\\\n", "")
    kernels = re.search(r"^KERNELS := (.*)$", text, re.MULTILINE)
    files = re.search(r"^OF_NUMBERS := (.*)$", text, re.MULTILINE)
    assert kernels is not None
    assert files is not None
    assert all(name in kernels[1] for name in ("Nehalem", "Haswell", "SkylakeX"))
    assert len(files[1].split()) > 10
    assert all(os.path.isfile(f"{root}/{file}") for file in files[1].split())
    with open(f"{root}/.ci/run", encoding="utf-8") as file:
        assert "\ncheck test-kernels\n" in file.read()
