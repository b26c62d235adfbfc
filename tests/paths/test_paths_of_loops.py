"""Paths of robots with kinematic loops."""

from __future__ import annotations

from pathlib import Path

import pytest

import flexgen
from tests.support.linkages import FOUR_BAR, read_text


def test_path_beyond_a_dead_center_is_refused(tmp_path: Path) -> None:
    """The rod of the four-bar cannot reach the forearm on this line."""
    far = FOUR_BAR.replace("displacement = [0.15, 0.0, 0.2]", "displacement = [0.9, 0.0, 0.3]")
    with pytest.raises(flexgen.SolverError, match=r"loops cannot be closed .* dead center"):
        flexgen.plan(read_text(tmp_path, far))
