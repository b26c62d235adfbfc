"""Grids of cases for the tests of sweeps."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import pytest

from flexgen.studies.sweeps.cases import Grid, combinations, random_moves
from flexgen.studies.sweeps.version import code_version
from flexgen.studies.sweeps.worker import WrongCode

ROBOTS = Path(__file__).parent / "robots"
ONE = str(ROBOTS / "one.toml")
QUICK = {"verify": False}


def real_grid() -> Grid:
    """Seven cases: six models that are solved, and a key that does not exist."""
    changes = combinations({"motor.m1.inertia": [1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4]})
    quick = Grid([ONE], (None,), ["collocation"], changes, QUICK)
    return replace(quick, parameters=(*changes, {"motor.m1.speed": 1.0}))


@contextlib.contextmanager
def sources_stay():
    """Skip the test where the sources changed while it ran: workers then refuse to start."""
    try:
        yield
    except WrongCode:
        if code_version.__wrapped__() == code_version():
            raise
        pytest.skip("the sources of flexgen changed while the test ran")


def batch_grid(count: int) -> Grid:
    """Quick cases: a hundred take a few milliseconds."""
    return Grid(["elbow"], random_moves(count), ["closed-form"], options=QUICK | {"batch": True})
