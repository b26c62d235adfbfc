"""Controllers that come with a benchmark: those for a later version replace the first ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from flexgen.studies.scenarios import leaderboard


@pytest.mark.parametrize(
    ("version", "expected"),
    [
        (1, {"ppi": "x-ppi"}),
        (2, {"ppi": "x-2-ppi", "new": "x-2-new"}),
        (3, {"ppi": "x-2-ppi", "new": "x-2-new", "newest": "x-3-newest"}),
    ],
)
def test_controllers_are_offered_from_their_version_on(
    version: int, expected: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "controllers").mkdir()
    for name in ("x-ppi", "x-2-ppi", "x-2-new", "x-3-newest", "y-other"):
        (tmp_path / "controllers" / f"{name}.toml").touch()
    monkeypatch.setattr(leaderboard, "FOLDER", tmp_path)
    found = leaderboard.find_shipped_controllers("x", version)
    assert {name: path.stem for name, path in found.items()} == expected
    assert leaderboard.find_shipped_controllers("x").keys() == {"ppi", "new"}
