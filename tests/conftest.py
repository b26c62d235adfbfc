"""Every run of the tests has a cache of compiled objects of its own, which its workers share."""

from __future__ import annotations

import os

import pytest


@pytest.fixture(scope="session", autouse=True)
def cache_of_this_run(tmp_path_factory):
    """Neither the user's cache is used nor are the tests' objects left there."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "objects"
    os.environ["FLEXGEN_CACHE"] = str(folder)
    return folder
