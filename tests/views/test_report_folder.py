"""The folder of a report: files of other programs stay, those of flexgen are replaced, whole or
not at all.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.views.reports.analysis_page import write_analysis
from flexgen.views.reports.folder import check_folder
from flexgen.views.reports.html import write_report


@pytest.fixture(scope="module")
def solved():
    equations = flexgen.derive("elbow")
    return equations, flexgen.solve(equations, verify=False)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["index.html", "robot.svg"])
@pytest.mark.usefixtures("undrawn")
def test_files_of_others_are_not_replaced(tmp_path, solved, name):
    (tmp_path / name).write_text("<html>mine</html>\n")
    (tmp_path / "notes.txt").write_text("mine, too\n")
    before = contents(tmp_path)
    with pytest.raises(
        ArgumentError, match=rf"where {name} is of another program, .* choose another folder"
    ):
        write_report(*solved, tmp_path)
    assert contents(tmp_path) == before
    (tmp_path / name).unlink()
    write_report(*solved, tmp_path)
    again = contents(tmp_path)
    write_report(*solved, tmp_path)
    assert contents(tmp_path) == again and again["notes.txt"] == b"mine, too\n"


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_pictures_of_an_analysis_are_accepted_in_the_folder_of_a_report(tmp_path, solved):
    analysis = flexgen.analyze(solved[0])
    write_analysis(analysis, tmp_path)
    write_report(*solved, tmp_path)
    write_analysis(analysis, tmp_path)
    (tmp_path / "index.html").unlink()
    write_report(*solved, tmp_path)  # the pictures say that they are of flexgen
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "pole_zero_map.png").write_bytes(b"\x89PNG mine")
    with pytest.raises(ArgumentError, match=r"where pole_zero_map\.png is of another program"):
        write_analysis(analysis, tmp_path / "a")


def test_the_folder_is_checked_before_the_work(tmp_path, monkeypatch, capsys):
    (tmp_path / "index.html").write_text("mine")
    monkeypatch.setattr("flexgen.inversion.solve.solve", None)
    for words in (
        ["solve", "elbow", "--report", str(tmp_path)],
        ["run", "elbow", "--report", str(tmp_path)],
    ):
        assert main(words) == 1
        assert "index.html is of another program" in capsys.readouterr().err
    assert (tmp_path / "index.html").read_text() == "mine"
    check_folder(None)
    check_folder(tmp_path / "new")


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_full_disk_leaves_the_old_page(tmp_path, solved, monkeypatch):
    write_report(*solved, tmp_path)
    before = contents(tmp_path)

    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ArgumentError, match=r"cannot be written \(No space left on device\)"):
        write_report(*solved, tmp_path)
    assert contents(tmp_path) == before
