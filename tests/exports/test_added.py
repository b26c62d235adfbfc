"""Exporters of other packages: the files that they wrote, or an error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.exports.c_code import added


@pytest.fixture
def export(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[Any], Any]:
    """Export of the elbow by an exporter that returns what is given."""
    for name in ("a.txt", "b.txt"):
        (tmp_path / name).write_text(name)

    def by(answer: Any) -> Any:
        def exporter(model: flexgen.RobotModel, path: Path) -> Any:
            assert (model.name, path) == ("elbow", tmp_path / "arm.my")
            return answer

        monkeypatch.setattr(added, "added_names", lambda group: ("my", "other"))
        monkeypatch.setattr(added, "extension", lambda group, kind: exporter)
        return added.export("my", "elbow", str(tmp_path / "arm.my"))

    return by


@pytest.mark.parametrize("kind", [list, tuple, str, Path])
def test_the_files_of_an_exporter_are_those_that_it_names(
    kind: type, export: Callable[[Any], Any], tmp_path: Path
) -> None:
    """Several in the order of their names, or one."""
    several = kind in (list, tuple)
    written = [tmp_path / "b.txt", tmp_path / "a.txt"] if several else [tmp_path / "a.txt"]
    found = export(kind(written) if several else kind(written[0]))
    assert (found.kind, found.model, found.path) == ("my", "elbow", tmp_path / "arm.my")
    assert found.files == tuple(sorted(written))


@pytest.mark.parametrize("answer", [None, [], ["a.txt", "none"], "none"])
def test_an_exporter_that_wrote_no_files_is_refused(
    answer: Any, export: Callable[[Any], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError) as caught:
        export(answer)
    text = f"exporter my: given {answer!r}, expected the paths of the files that it wrote"
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("names", "expected"),
    [(("my", "other"), "my, other"), ((), "none: no package adds any")],
)
def test_an_unknown_exporter_is_refused_with_the_existing_ones(
    names: tuple[str, ...], expected: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(added, "added_names", lambda group: names)
    with pytest.raises(ArgumentError) as caught:
        added.export("none", "elbow", tmp_path)
    assert str(caught.value) == f"export: given 'none', expected one of {expected}"
