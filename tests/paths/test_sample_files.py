"""Files of path samples: refused before memory is taken where they are not what they claim to
be.
"""

from __future__ import annotations

import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest
from npz_lies import array_bytes, claiming, packed

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.paths.samples import sample_files
from flexgen.paths.samples.sample_files import read_samples

Q = np.linspace([0.3, -1.1], [0.7, -1.4], 12)


@pytest.fixture(scope="module")
def robot():
    return flexgen.read("planar5_nmp")


def refused(file, robot, expected: str) -> None:
    with pytest.raises((ModelError, ArgumentError), match=expected) as caught:
        read_samples(str(file), robot, 2)
    assert str(file) in str(caught.value)


@pytest.fixture
def joints(tmp_path, robot):
    """A good csv file."""
    names = [robot.coordinates[i].name for i in robot.i_g]
    file = tmp_path / "joints.csv"
    file.write_text(",".join(names) + "\n" + "".join(f"{a!r},{b!r}\n" for a, b in Q.tolist()))
    return file


def test_a_good_file_is_read(joints, robot):
    assert np.array_equal(read_samples(str(joints), robot, 2).values, Q)
    text = joints.read_text().replace("\n", " # a comment\r\n\r\n")
    joints.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert np.array_equal(read_samples(str(joints), robot, 2).values, Q)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("0.3,", "0.3" + 140_000 * "0" + ",", r"csv:2:row: given more than 20000 characters"),
        ("0.3,", "0_3,", '"0_3"'),
        ("\n", "," * 3000 + "\n", "an empty or repeated column name"),
        (
            "\n",
            "," + ",".join(f"c{k}" for k in range(50)) + "\n",
            "given 52 columns, expected at most",
        ),
        ("\n", "\n" * 400_001, "given more than 400000 lines, expected at most 200000 rows"),
    ],
    ids=range(5),
)
def test_csv_files_that_are_refused(joints, robot, old, new, expected):
    joints.write_text(joints.read_text().replace(old, new, 1))
    refused(joints, robot, expected)


def test_too_many_rows_are_refused(joints, robot, monkeypatch):
    monkeypatch.setattr(sample_files, "ROWS_MAX", 11)
    refused(joints, robot, "csv:13:file: given more than 11 rows")


def test_bytes_that_are_not_text_are_refused(joints, robot):
    joints.write_bytes(joints.read_bytes() + b"\xff\n")
    refused(joints, robot, "text that is not UTF-8")


def test_npz_files_with_wrong_sizes_are_refused(tmp_path, robot, monkeypatch):
    monkeypatch.setattr(zipfile.ZipExtFile, "readinto", None, raising=False)
    file = packed(tmp_path / "a.npz", {"q_g": claiming("(1000000000, 2)")})
    refused(
        file, robot, r"'q_g' of shape \(1000000000, 2\) and 0 bytes, expected 16000000000 bytes"
    )
    file = packed(tmp_path / "b.npz", {"q_g": claiming("(3000000, 2)", bytes(48_000_000))})
    assert file.stat().st_size < 100_000
    refused(file, robot, "q_g: given 3000000 rows, expected at most 200000")
    monkeypatch.setattr(sample_files, "SIZE_MAX", 10_000_000)
    refused(file, robot, "arrays of 48000128 bytes, expected at most 10000000")
    file = tmp_path / "c.npz"
    file.write_bytes(array_bytes(Q))
    refused(
        file,
        robot,
        "given a .npy file under the name of an .npz file, expected one that numpy.savez wrote",
    )
    file.write_bytes(b"x" * 1000)
    refused(file, robot, "given what is no .npz file")
    for name, values, expected in (
        ("q_g", np.array(["a", "b"]), "an array of <U1"),
        ("q_g", np.zeros(5), r"shape \(5,\), expected shape \(n, 2\)"),
        ("q_h", Q, "an unknown array, expected q_g"),
        ("q_g", np.full((3, 2), np.nan), "not finite"),
    ):
        refused(packed(file, {name: array_bytes(values)}), robot, expected)


@pytest.mark.slow
def test_the_memory_of_a_process_is_not_used_up(tmp_path, robot):
    """500 MB of zeros in a file of 0.5 MB: the largest size of this process stays where it was."""
    file = packed(tmp_path / "bomb.npz", {"q_g": claiming("(31250000, 2)")})
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("q_g.npy", "w") as stream,
    ):
        stream.write(claiming("(31250000, 2)"))
        for _ in range(50):
            stream.write(bytes(10_000_000))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused(file, robot, "arrays of 500000128 bytes, expected at most 200000000")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000  # KiB


def test_a_column_that_is_a_joint_and_an_output_is_refused(tmp_path):
    text = Path(flexgen.read("four_mass").file).read_text()
    (tmp_path / "model.toml").write_text(text.replace('"q1"', '"y1"').replace("q1", "y1"))
    file = tmp_path / "a.csv"
    file.write_text("y1\n0.0\n0.5\n1.0\n")
    assert read_samples(str(file), flexgen.read("four_mass"), 2).space == "output"
    refused(
        file,
        flexgen.read(tmp_path / "model.toml"),
        "csv:1:y1: given a column that is a joint and an output",
    )
