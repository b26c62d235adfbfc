"""Files of forces on the tool: tables of numbers over time or over the place on a path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.paths.force import force_files


def read(folder: Path, text: str) -> Any:
    file = folder / "force.csv"
    file.write_text(text, encoding="utf-8")
    return force_files.read_force(file, "s", "a file")


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_columns_are_forces_and_moments(mark: str, tmp_path: Path) -> None:
    found = read(tmp_path, f"{mark}s, fx, fy,fz\n0,1,2,3\n0.5,4,5,6\n")
    assert_allclose(found.time, [0, 0.5])
    assert_allclose(found["force"], [[1, 2, 3], [4, 5, 6]])
    assert found.labels["force"] == ("fx", "fy", "fz")
    both = read(tmp_path, f"{mark}s,fx,fy,fz,mx,my,mz\n0,1,2,3,4,5,6\n1,1,2,3,4,5,7\n")
    assert_allclose(both["force"], [[1, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, 7]])
    assert both.units["force"] == ("N",) * 3 + ("N m",) * 3


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("s,fx,fy\n0,1,2\n1,1,2", "given the columns s, fx, fy in .*, expected the columns s, fx"),
        ("t,fx,fy,fz\n0,1,2,3\n1,1,2,3", "given the columns t, fx, fy, fz in"),
        ("s,fx,fy,fz,mx\n0,1,2,3,4\n1,1,2,3,4", "given the columns s, fx, fy, fz, mx in"),
        ("s,fx,fy,fz\n0,1,2,3", r"given 1 rows in .*, expected two or more of 4 numbers$"),
        ("s,fx,fy,fz\n0,1,2\n1,1,2", r"given 2 rows in .*, expected two or more of 4 numbers$"),
        ("s,fx,fy,fz\n0,1,2,3\n0,1,2,3", "given 0, 1, 2, 3 in row 2 of .*, expected finite numb"),
        ("s,fx,fy,fz\n0,1,nan,3\n1,1,2,3", "given 0, 1, nan, 3 in row 1 of"),
        ("s,fx,fy,fz\n0,1,x,3", "file .* cannot be read .*, expected names in line 1, then numb"),
    ],
)
def test_tables_that_are_refused(text: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=f"^force: {told}"):
        read(tmp_path, f"{text}\n")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"^force: file .* cannot be read .*, expected a file"):
        force_files.read_force(tmp_path / "none.csv", "s", "a file")


@pytest.mark.parametrize(
    ("name", "text", "table"),
    [
        ("a.csv", "s,fx", True),
        ("a.CSV", "\ufeffs,fx", True),
        ("a.csv", "# flexgen", False),
        ("a.csv", "\ufeff# flexgen", False),
        ("a.txt", "s,fx", False),
        ("a.csv", None, False),
    ],
)
def test_tables_have_no_meta_data(
    name: str, text: str | None, table: bool, tmp_path: Path
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert force_files.is_table(tmp_path / name) is table
