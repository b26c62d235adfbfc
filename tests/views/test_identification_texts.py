"""Texts of identifications: new springs as tables of a file, and quantiles of a verdict."""

from __future__ import annotations

import tomllib
from types import SimpleNamespace
from typing import Any

from flexgen.model.elements import LinearSpring
from flexgen.views.reports.identification_texts import structure_text, verdict_text


def test_the_tables_of_new_springs_can_be_read_again() -> None:
    made = SimpleNamespace
    dof = SimpleNamespace(
        name="q2_x", axis=(0.0, 0.6, -0.8), spring=LinearSpring(1.25e6), damping=375.0
    )
    old = SimpleNamespace(name="q2", axis=(1.0, 0.0, 0.0), spring=None, damping=0.0)
    found: Any = made(
        changes=(
            made(kind="add", name="q2_x", gain=52.0, held_out=0.5, kept=True),
            made(kind="remove", name="q1_y", gain=3.0, held_out=None, kept=False),
        ),
        added=("q2_x",),
        removed=(),
        model=made(elements=[made(name="arm1", dofs=(old,)), made(name="arm2", dofs=(old, dof))]),
        identified=made(vector=made(model=made(name="planar")), status="fitted", cost=1.25),
    )
    text = structure_text(found)
    assert text.startswith(
        "planar: added q2_x, removed nothing\nfit of the result: fitted, cost 1.25 (1 expected)"
    )
    rows = [
        line.split() for line in text.splitlines() if line.split()[:1] in (["add"], ["remove"])
    ]
    assert rows == [["add", "q2_x", "52", "0.5", "kept"], ["remove", "q1_y", "3"]]
    assert (
        text.count("[[element.dof]]") == 1 and "in the element arm2 behind the joint q2:" in text
    )
    (table,) = tomllib.loads(text[text.index("[[element.dof]]") :])["element"]["dof"]
    assert table == {
        "name": "q2_x",
        "type": "rotation",
        "axis": [0.0, 0.6, -0.8],
        "spring": {"type": "linear", "stiffness": 1.25e6},
        "damping": 375.0,
    }


def test_a_verdict_in_words_has_its_quantiles_in_one_unit() -> None:
    def row(model: str, median: float | None, high: float) -> Any:
        parts = {0.5: median, 0.95: high}
        return SimpleNamespace(
            model=model, error_m=(high,), error_rad=None, quantile=lambda part, unit: parts[part]
        )

    rows = (row("before", 2e-3, 5e-3), row("after", None, 1e-4))
    made: Any = SimpleNamespace(known=False, rows=rows, move="line", robots=24)
    text = verdict_text(made)
    assert "of the move line with motor feedback, 24 robots drawn from the covariance:" in text
    assert "median, mm" in text and "95 %, mm" in text and "rad" not in text
    assert [line.split() for line in text.splitlines()[-2:]] == [
        ["before", "2", "5"],
        ["after", "-", "0.1"],
    ]
    assert "24 x the robot of --truth:" in verdict_text(
        SimpleNamespace(**{**vars(made), "known": True})
    )  # type: ignore[arg-type]
