"""Result of an export: a path of its main file, lines that are printed, entries for JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import flexgen
from flexgen.exports.exported import Exported, exported, left_out

ELBOW = flexgen.read("elbow")


def made(folder: Path) -> Exported:
    files = (folder / "a.xml", folder / "b.toml")
    more: dict[str, Any] = {"notes": ("one", "two"), "details": {"friction": "exact"}}
    return exported(ELBOW, "kind", files, ("bodies", "rest"), **more)


def test_what_an_export_returns(tmp_path: Path) -> None:
    found = made(tmp_path)
    main, second = found.files
    assert str(found) == str(main) == found.__fspath__() and found.directory == tmp_path
    lines = [f"wrote {main}: bodies", f"wrote {second}: rest", "note: one", "note: two"]
    assert found.summary().splitlines() == lines
    data = found.to_dict()
    assert data["directory"] == str(tmp_path) and data["friction"] == "exact"
    assert "details" not in data
    assert (found.model, found.variant, found.kind) == ("elbow", "", "kind")
    assert found == made(tmp_path) and hash(found) == hash(made(tmp_path))
    folder = Exported("kind", "elbow", tmp_path, found.files)
    assert folder.summary() == f"wrote {main}\nwrote {second}" and folder.directory == tmp_path


def test_what_a_file_does_not_have_is_told() -> None:
    assert left_out(ELBOW) == ()
    tracker = {"name": "p", "type": "tracker", "unit": "m"}
    error = {"harmonics": [1], "cos": [1e-3], "sin": [0.0]}
    more = flexgen.read("elbow", overrides={"sensor": [tracker], "motor.m1.encoder_error": error})
    assert left_out(more) == ("not in the file: sensor, encoder_error",)


OLD = {
    ("ros2", "name"): ("r_v", "model"),
    ("ros2", "token"): ("t", "details['token']"),
    ("mujoco", "stem"): ("a", "path.stem"),
    ("mujoco", "name"): ("a.xml", "path.name"),
}


@pytest.mark.parametrize(("kind", "name"), OLD)
def test_old_names_are_their_new_places_with_a_warning(
    kind: str, name: str, tmp_path: Path
) -> None:
    value, place = OLD[kind, name]
    file = tmp_path / "a.xml"
    found = Exported(kind, "r", file, (file,), "v", details={"token": "t"})
    text = rf"result of export_{kind}: given \.{name}, expected its new place, \."
    with pytest.warns(DeprecationWarning, match=text) as seen:
        assert getattr(found, name) == value
    assert f", .{place}" in str(seen[0].message)
    with pytest.raises(AttributeError, match=r"^Exported has no attribute 'other'$"):
        _ = found.other  # type: ignore[attr-defined]
    with pytest.raises(TypeError, match=rf"^the result of export_{kind} is not a sequence; its"):
        _ = found[0]  # type: ignore[index]


def test_the_pair_of_files_of_urdf_has_a_warning(tmp_path: Path) -> None:
    files = (tmp_path / "a.urdf", tmp_path / "a.toml")
    pair = Exported("urdf", "r", files[0], files)
    with pytest.warns(DeprecationWarning, match="given a pair of paths, expected .files"):
        assert pair[1] == files[1]  # type: ignore[index]
