"""The figures of `flexgen run`: analysis, library, comparison and solution of one robot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from emitted import made
from toolchain import needs_compiler

import flexgen
from flexgen.analysis.analyze import Analysis
from flexgen.views.reports.texts import steps_text

CHECKED = {"call_us": 1.5, "difference_Nm": 1e-12}


@pytest.fixture(scope="module")
def solution() -> Any:
    return flexgen.solve("planar5_nmp")


@needs_compiler
@pytest.mark.parametrize("cached", [True, False])
def test_figures_of_the_steps_of_a_robot(cached: bool, solution: Any) -> None:
    """A pole of the zero dynamics is the inverse of its time constant; a library from the cache
    was not built.
    """
    analysis: Analysis = flexgen.analyze("planar5_nmp")
    library = replace(made("elbow"), cached=cached, seconds=12.5)
    text = steps_text(analysis, library, CHECKED, solution, 60.0)
    rows = dict(row.split("  ", 1) for row in text.splitlines() if "  " in row)
    found = {name.strip(): " ".join(value.split()) for name, value in rows.items()}
    facts = analysis.to_dict()
    assert found["motors, degrees of freedom"] == "2, 5"
    assert float(found["lowest mode"].split()[0]) == pytest.approx(facts["modes_hz"][0], rel=1e-3)
    rate = 1 / facts["unstable_time_constant_s"]
    assert float(found["slowest unstable zero"].split()[0]) == pytest.approx(rate, rel=1e-3)
    assert found["C functions generated"] == str(len(library.functions))
    assert ("C library built in" in found) == (not cached)
    assert cached or found["C library built in"] == "12.5 s"
    assert found["C inverse_dynamics, one call from Python"] == "1.5 us"
    assert found["total time, wall"] == "60 s" and found["move"] == solution.move.name
    rigid = flexgen.analyze("elbow@rigid")
    text = steps_text(rigid, library, CHECKED, solution, 60.0)
    assert "slowest unstable zero" not in text
    assert ("lowest mode" in text) == bool(rigid.to_dict()["modes_hz"])
