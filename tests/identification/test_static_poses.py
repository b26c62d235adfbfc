"""Files of static poses: units, cells that were not seen, and the texts of what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.poses import poses
from flexgen.identification.poses.poses import StaticPoses

TRACKERS = [{"name": name, "type": "tracker", "unit": "m"} for name in ("a", "b")]
HEAD = "note,q2_deg, q1_rad ,a_x_m,a_y_mm,a_z_m,b_x_m,b_y_m,b_z_mm"
LINE = "x,180,0.25,1,2,3,4,5,6"


@pytest.fixture(scope="module")
def model() -> flexgen.RobotModel:
    return flexgen.read("elbow", overrides={"sensor": TRACKERS})


def read(folder: Path, text: str, model: flexgen.RobotModel) -> StaticPoses:
    file = folder / "poses.csv"
    file.write_text(text, encoding="utf-8")
    return StaticPoses.read(file, model)


def test_columns_of_a_file_have_units_and_any_order(
    tmp_path: Path, model: flexgen.RobotModel
) -> None:
    """Degrees and millimeters; an empty line is none, an empty cell of a tracker was not seen."""
    text = "\ufeff" + "\n".join([HEAD, LINE, " ,, ,,,,,,", ", -90 ,-0.5,,,,7, 8 ,-9"]) + "\n"
    found = read(tmp_path, text, model)
    assert_allclose(found.commands, [[0.25, np.pi], [-0.5, -np.pi / 2]], rtol=1e-15)
    assert_allclose(found.positions[0], [[1, 2e-3, 3], [4, 5, 6e-3]], rtol=1e-15)
    assert np.isnan(found.positions[1, 0]).all()
    assert_allclose(found.positions[1, 1], [7, 8, -9e-3], rtol=1e-15)
    assert len(found) == 2 and found.source == str(tmp_path / "poses.csv")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ": given an empty file, expected a line of names and a line for each pose"),
        (f"\n{HEAD}\n\n", ": given a line of names only, expected a line for each pose"),
        (
            HEAD.replace("q2_deg", "q2"),
            ":1: given no column of q2, expected one, q2_rad or q2_deg: the column 'q2' states no "
            "unit",
        ),
        (f"{HEAD},q2_rad", ":1: given two columns of q2, expected one, q2_rad or q2_deg"),
        (
            HEAD.replace("b_z_mm", "b_z_deg"),
            ":1: column 'b_z_deg': given 'deg', an angle, expected a length in m, mm, cm, um",
        ),
        (f"{HEAD}\n\n{LINE},1", ":3: given 10 cells, expected 9, as line 1"),
        (f"{HEAD}\n{LINE[:-2]}", ":2: given 8 cells, expected 9, as line 1"),
        (f"{HEAD}\n{LINE.replace('0.25', '')}", ":2: q1_rad: given '', expected a number"),
        (f"{HEAD}\n{LINE.replace('0.25', 'nan')}", ":2: q1_rad: given 'nan', expected a number"),
        (f"{HEAD}\n{LINE.replace('180', '1e6')}", ":2: q2_deg: given '1e6', expected a number"),
        (f"{HEAD}\n{LINE.replace('6', 'inf')}", ":2: b_z_mm: given 'inf', expected a number"),
        (
            f"{HEAD}\n{LINE.replace('6', 50 * 'x')}",
            f":2: b_z_mm: given '{40 * 'x'}', expected a number",
        ),
    ],
)
def test_files_of_poses_that_are_refused(
    tmp_path: Path, model: flexgen.RobotModel, text: str, said: str
) -> None:
    with pytest.raises(ArgumentError) as refused:
        read(tmp_path, text, model)
    assert str(refused.value) == f"{tmp_path / 'poses.csv'}{said}"


def test_the_largest_numbers_and_counts_of_poses(
    tmp_path: Path, model: flexgen.RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A number is below 1e6 before its unit; a file may have so many poses, and a line of
    names.
    """
    assert (poses.LARGEST, poses.FAR) == (100_000, 1e6)
    found = read(tmp_path, f"{HEAD}\n{LINE.replace('0.25', '-999999')}", model)
    assert found.commands[0, 0] == -999999
    monkeypatch.setattr(poses, "LARGEST", 3)
    assert len(read(tmp_path, "\n".join([HEAD, *[LINE] * 3]), model)) == 3
    with pytest.raises(ArgumentError, match="given more than 3 lines, expected at most 3 poses"):
        read(tmp_path, "\n".join([HEAD, *[LINE] * 4]), model)


def test_arrays_of_poses_that_are_refused() -> None:
    q = np.zeros((2, 2))
    p = np.full((2, 1, 3), np.nan)
    assert_array_equal(StaticPoses(q, p).positions, p)
    assert StaticPoses(q, p).source == "arrays"
    shapes = "expected (N, n_g) and (N, k, 3)"
    for a, b in ((q[0], p), (q, p[0]), (q, p[:, :, :2]), (q[:1], p)):
        with pytest.raises(ArgumentError) as refused:
            StaticPoses(a, b)
        assert (
            str(refused.value)
            == f"poses: given arrays of shapes {a.shape} and {b.shape}, {shapes}"
        )
    said = "poses: given commands or positions that are not finite; nan marks a position not seen"
    for a, b in ((q + np.nan, p), (q - np.inf, p), (q, np.full((2, 1, 3), -np.inf))):
        with pytest.raises(ArgumentError) as refused:
            StaticPoses(a, b)
        assert str(refused.value) == said
