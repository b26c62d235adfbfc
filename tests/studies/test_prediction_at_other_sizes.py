"""Predicted errors of a robot of another size: all lengths times a power of two and the same
gravity scale them.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from enlarged import enlarged

import flexgen

# a sixteenth of the times; relative: two solutions in other units
FACTOR = 1.0 / 256.0
SAME = 1e-6


@pytest.mark.parametrize("known", ["stiffness = 0.1\nmasses = 0.03", "delay = {}"])
def test_the_error_of_uncertain_robots_grows_with_the_robot(tmp_path: Path, known: str) -> None:
    """The steps in time are those of the robot: no time in seconds may decide."""
    found = []
    for factor in (1.0, FACTOR):
        file = tmp_path / f"planar5_{factor:g}.toml"
        table = known.format(repr(1e-3 * factor**0.5))
        file.write_text(
            f"{enlarged('planar5_nmp', factor)}\n[uncertainty]\n{table}\n", encoding="utf-8"
        )
        found.append(flexgen.predict(file, robots=16, progress=False).error_m)
    assert found[1] == pytest.approx(FACTOR * found[0], rel=SAME)
