"""Files of trajectories: complete or refused, in their unit, read by other programs, never half
written.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from npz_lies import array_bytes, claiming, packed

from flexgen.base.errors import ArgumentError, ChannelError, ModelError
from flexgen.base.files import npz_files, trajectory_files
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.identification.records import description
from flexgen.model.reader import read
from flexgen.paths.samples import sample_files


@pytest.fixture
def trajectory() -> Trajectory:
    t = np.linspace(0.0, 1.0, 21)
    channels = {"q_a": np.column_stack([np.sin(t), np.cos(t)]), "tau_m": t[:, None] ** 2}
    ports = {
        "q_a": Port("q_a", (2,), "rad or m", "arm"),
        "tau_m": Port("tau_m", (1,), "N m", "torque"),
    }
    return Trajectory(t, channels, ports, {"q_a": ("a", "b"), "tau_m": ("m1",)}, {"model": "none"})


def changed(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


# --- csv -----------------------------------------------------------------------------------------


SIZES = {  # bytes at most, and what is said of a file of zeros
    "trajectory": (
        2**30,
        Trajectory.load,
        "not a trajectory of flexgen",
        "of 1073741825 bytes, expected at most 107374182",
    ),
    "recording": (
        2 * 10**9,
        lambda path: read_arrays(path, description.SIZE_MAX),
        "given what is no .npz file",
        "2000000001 bytes, expected at most 2000",
    ),
    "samples": (
        200_000_000,
        lambda path: sample_files.read_samples(str(path), read("elbow"), 5),
        "given what is no .npz file",
        "given more than 200000000 bytes, expected a shorter file",
    ),
}


@pytest.mark.parametrize("kind", SIZES)
def test_files_have_at_most_the_stated_bytes(kind, tmp_path):
    """Sparse files, which take no space: one of this size is looked into, one with a byte more is
    not.
    """
    most, load, unknown, large = SIZES[kind]
    for size, words in ((most, unknown), (most + 1, large)):
        path = tmp_path / f"{size}.npz"
        with path.open("wb") as stream:
            stream.truncate(size)
        with pytest.raises((ArgumentError, ModelError), match=words):
            load(path)


def test_a_csv_that_was_cut_at_a_line_end_is_refused(tmp_path, trajectory):
    path = trajectory.save(tmp_path / "a.csv")
    lines = path.read_text().splitlines(keepends=True)
    for n in range(1, len(lines)):
        path.write_text("".join(lines[:n]))
        with pytest.raises(ArgumentError, match=r"a\.csv: .*expected"):
            Trajectory.load(path)
    path.write_text("".join(lines[:12]))
    with pytest.raises(
        ArgumentError, match=r"given no last line '# rows: N', .* it was cut or changed"
    ):
        Trajectory.load(path)
    path.write_text("".join([*lines[:12], lines[-1]]))
    with pytest.raises(ArgumentError, match="given 10 rows, where the last line states 21"):
        Trajectory.load(path)
    path.write_text("".join([*lines, lines[-2]]))
    with pytest.raises(ArgumentError, match="line 25: given a row after the last line"):
        Trajectory.load(path)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (
            "time h",
            r"given the first column 'time h', expected 'time s', or time in ms, us, ns, min",
        ),
        ("time", r"given the first column 'time', expected 'time s'"),
        ("q_a[a] rad or m", r"expected 'time s'"),
    ],
)
def test_the_unit_of_the_time_is_checked(tmp_path, trajectory, header, expected):
    path = changed(trajectory.save(tmp_path / "a.csv"), "time s", header)
    with pytest.raises(ArgumentError, match=expected):
        Trajectory.load(path)


@pytest.mark.slow
def test_other_programs_read_the_csv(tmp_path, trajectory):
    path = trajectory.save(tmp_path / "a.csv")
    table = np.genfromtxt(path, delimiter=",", skip_header=2)
    assert np.array_equal(table[:, 0], trajectory.time) and np.array_equal(
        table[:, 3], trajectory["tau_m"][:, 0]
    )
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_csv(path, comment="#")
    assert list(frame) == ["time s", "q_a[a] rad or m", "q_a[b] rad or m", "tau_m[m1] N m"]
    assert np.allclose(
        frame["tau_m[m1] N m"].to_numpy(), trajectory["tau_m"][:, 0], rtol=1e-14, atol=0.0
    )


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("0.05,", "0.0_5,", "line 4: given text, expected numbers"),
        ("0.05,", "0.05," + 200_000 * "9", "line 4: given more than 100000 characters"),
        ("tau_m[m1] N m", "tau_m", r"given the column 'tau_m', expected 'name\[label\] unit'"),
        ("q_a[b] rad or m", "q_a[b] " + "x" * 50_000, "given the column .{60,80}, expected 'name"),
        ('{"model": "none"}', "[" * 50_000, "not a trajectory of flexgen"),
        ('{"model": "none"}', "[1]", "line 1: given list, expected an object of JSON"),
    ],
)
def test_csv_files_that_are_refused(tmp_path, trajectory, old, new, expected):
    path = changed(trajectory.save(tmp_path / "a.csv"), old, new)
    with pytest.raises(ArgumentError, match=rf"a\.csv: .*{expected}") as caught:
        Trajectory.load(path)
    assert len(str(caught.value)) < 1000


# --- npz -----------------------------------------------------------------------------------------


def test_an_array_that_claims_a_billion_rows_is_refused_before_it_is_read(tmp_path, trajectory):
    head = json.dumps({"meta": {}, "ports": {}, "labels": {}})
    path = packed(
        tmp_path / "a.npz",
        {"head": array_bytes(np.array(head)), "time": claiming("(1000000000,)")},
    )
    with pytest.raises(
        ArgumentError,
        match=r"a\.npz: .*'time' of shape \(1000000000,\) and 0 bytes\), expected 80",
    ):
        Trajectory.load(path)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    path = packed(tmp_path / "bomb.npz", {"time": claiming("(6250000,)", bytes(50_000_000))})
    assert path.stat().st_size < 100_000
    monkeypatch.setattr(zipfile.ZipExtFile, "read", None)  # nothing is unpacked
    with pytest.raises(
        npz_files.NpzError, match="arrays of 50000128 bytes, expected at most 10000000"
    ):
        npz_files.read_npz(path, 10_000_000)
    monkeypatch.setattr(trajectory_files, "LARGEST", 10_000_000)
    with pytest.raises(
        ArgumentError, match=r"bomb\.npz: .*arrays of 50000128 bytes\), expected at most 10000000"
    ):
        Trajectory.load(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("field", [20, 24], ids=["packed", "unpacked"])
def test_an_archive_with_wrong_sizes_is_refused(tmp_path, method, field):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("time.npy", array_bytes(np.arange(1000.0)))
    content = path.read_bytes()
    at = content.rfind(b"PK\x01\x02") + field
    size = int.from_bytes(content[at : at + 4], "little")
    for lie in (0, size - 8, 2**30, 2**31):
        path.write_bytes(content[:at] + lie.to_bytes(4, "little") + content[at + 4 :])
        with pytest.raises(npz_files.NpzError):
            npz_files.read_npz(path, 2**32)


@pytest.mark.parametrize(
    "content", [b"", b"PK", b"PK\x03\x04", array_bytes(np.zeros(3)), b"x" * 100_000]
)
def test_other_files_named_npz_are_refused(tmp_path, content):
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(
        ArgumentError, match=r"a\.npz: given a file that is not a trajectory of flexgen \("
    ):
        Trajectory.load(path)


def test_a_table_of_contents_of_millions_of_entries_is_refused(tmp_path):
    entry = b"PK\x01\x02" + bytes(42)
    end = (
        b"PK\x05\x06"
        + bytes(4)
        + b"\xff\xff\xff\xff"
        + (30_000 * 46).to_bytes(4, "little")
        + bytes(6)
    )
    path = tmp_path / "a.npz"
    path.write_bytes(30_000 * entry + end)
    with pytest.raises(npz_files.NpzError, match="a table of contents that is too long"):
        npz_files.read_npz(path, 10**9)


def test_arrays_come_back_as_numpy_reads_them(tmp_path):
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.asfortranarray(np.arange(6).reshape(3, 2)),
        "c": np.array("x"),
    }
    np.savez_compressed(tmp_path / "a.npz", **arrays, empty=np.zeros((0, 4)))
    found = npz_files.read_npz(tmp_path / "a.npz", 10**6)
    with np.load(tmp_path / "a.npz") as data:
        assert list(found) == list(data.files)
        for name in data.files:
            assert (
                np.array_equal(found[name], data[name]) and found[name].dtype == data[name].dtype
            )


# --- channels and writing ------------------------------------------------------------------------


HEAD = {"meta": {}, "ports": {"tau_m": [[1], "N m", "torque"]}, "labels": {"tau_m": ["m1"]}}
TIME = np.array([0.0, 0.5, 1.0])
TORQUE = np.array([[1.0], [2.0], [4.0]])


@pytest.mark.parametrize(
    ("head", "arrays", "text"),
    [
        (
            HEAD,
            {"head": np.array(["a", "b"])},
            r"head: given <U1 of shape \(2,\), expected a text",
        ),
        (HEAD, {"head": np.array(3.0)}, r"head: given float64 of shape \(\), expected a text"),
        (
            HEAD,
            {"tau_m": TORQUE > 0},
            "channel tau_m: given numbers of type bool, expected real numbers",
        ),
        (HEAD, {"time": TORQUE}, r"time: given shape \(3, 1\), expected one column"),
        (HEAD, {"time": None}, "given no array time, expected a trajectory; "),
        (HEAD, {"head": None}, "given no array head, expected a trajectory; "),
        (HEAD, {"tau_m": None}, "channel tau_m: given no array of this name, expected one"),
        (
            {"ports": {"tau_m": [[1], 3, "torque"]}},
            {},
            r"channel tau_m: invalid port description, expected \[shape, ",
        ),
        ({"ports": {"tau_m": [[1], "N m", 3]}}, {}, "channel tau_m: invalid port description"),
        (
            {"ports": {"tau_m": [[1.0], "N m", "torque"]}},
            {},
            "channel tau_m: invalid port description",
        ),
        (
            {"labels": {"tau_m": "m1"}},
            {},
            "channel tau_m: given labels that are not a list of texts, expected one",
        ),
        (
            {"labels": {"tau_m": [1]}},
            {},
            "channel tau_m: given labels that are not a list of texts",
        ),
        (
            {"units": {"tau_m": ["N m", None]}},
            {},
            "channel tau_m: given units that are not a list of texts",
        ),
        (
            {"ports": {f"q{k}": [[1], "rad", ""] for k in range(1001)}},
            {},
            "given 1001 channels, expected at most 1000",
        ),
    ],
)
def test_archives_without_a_trajectory_are_refused(tmp_path, head, arrays, text):
    path = tmp_path / "a.npz"
    parts = {"time": TIME, "tau_m": TORQUE, "head": np.array(json.dumps(HEAD | head))} | arrays
    np.savez(path, **{name: x for name, x in parts.items() if x is not None})
    with pytest.raises(ArgumentError, match=rf"a\.npz: {text}"):
        Trajectory.load(path)


def test_an_archive_of_whole_numbers_is_a_trajectory(tmp_path):
    np.savez(
        tmp_path / "a.npz",
        time=np.arange(3),
        tau_m=TORQUE.astype(np.uint8),
        head=np.array(json.dumps(HEAD)),
    )
    found = Trajectory.load(tmp_path / "a.npz")
    assert found.time.dtype == found["tau_m"].dtype == float
    assert np.array_equal(found["tau_m"], TORQUE) and found.labels["tau_m"] == ("m1",)
    assert found.ports["tau_m"] == Port("tau_m", (1,), "N m", "torque")


def header(text: str, version: int = 1, length: int | None = None) -> bytes:
    """The start of an .npy file."""
    size = len(text) if length is None else length
    return (
        b"\x93NUMPY"
        + bytes([version, 0])
        + size.to_bytes(2 * version, "little")
        + text.encode("latin-1")
    )


INVALID = (
    (
        "{'descr': '<f8', 'fortran_order': False}",
        "without a header that can be read, expected one of numpy",
    ),
    (
        "['descr', 'fortran_order', 'shape']",
        "without a header that can be read, expected one of numpy",
    ),
    ("{'descr': ", "without a header that can be read, expected one of numpy"),
    (" " * 10_001, "without a header that can be read, expected one of numpy"),
    (
        "{'descr': '|O', 'fortran_order': False, 'shape': (2,)}",
        "of type |O, expected numbers or text",
    ),
    (
        "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': ()}",
        "of type [('a', '<f8')], expected numbers or",
    ),
    (
        "{'descr': '|f8x', 'fortran_order': False, 'shape': ()}",
        "of type |f8x, expected numbers or text",
    ),
    (
        "{'descr': '<f8', 'fortran_order': False, 'shape': [2]}",
        "of shape [2], expected whole numbers >= 0",
    ),
    (
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-2,)}",
        "of shape (-2,), expected whole numbers >= 0",
    ),
    (
        "{'descr': '<f8', 'fortran_order': False, 'shape': (2.0,)}",
        "of shape (2.0,), expected whole numbers >= 0",
    ),
    (
        "{'descr': '<f8', 'fortran_order': False, 'shape': (True,)}",
        "of shape (True,), expected whole numbers >= 0",
    ),
    (
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': {(1,) * 33}}}",
        "expected whole numbers >= 0",
    ),
)


def test_arrays_with_invalid_headers_are_refused(tmp_path):
    """So are those with fewer numbers than the header states, and texts of characters that do not
    exist.
    """
    right = "{'descr': '<f8', 'fortran_order': False, 'shape': (2,)}"
    rows = [(header(text), told) for text, told in INVALID]
    rows += [(header(right, version=3), "without a header that can be read")]
    rows += [(header(right) + bytes(15), "of shape (2,) and 15 bytes, expected 16 bytes")]
    beyond = header("{'descr': '<U1', 'fortran_order': False, 'shape': ()}") + b"\0\0\x11\0"
    for content, told in [*rows, (beyond, "with characters that do not exist, expected a text")]:
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            archive.writestr("speed.npy", content)
        with pytest.raises(npz_files.NpzError) as caught:
            npz_files.read_npz(tmp_path / "a.npz", 10**6)
        assert str(caught.value).startswith("given the array 'speed' ") and told in str(
            caught.value
        )


def test_headers_of_both_versions_and_orders_are_read(tmp_path):
    numbers = np.arange(6.0)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for version in (1, 2):
            text = f"{{'descr': '<f8', 'fortran_order': {version == 2}, 'shape': (2, 3)}}"
            archive.writestr(f"v{version}.npy", header(text, version) + numbers.tobytes())
        most = header("{'descr': '<f8', 'fortran_order': False, 'shape': ()}".ljust(10_000))
        archive.writestr("longest.npy", most + numbers[:1].tobytes())
        archive.writestr(
            "last.npy",
            header("{'descr': '<U1', 'fortran_order': False, 'shape': ()}") + b"\xff\xff\x10\0",
        )
    found = npz_files.read_npz(tmp_path / "a.npz", 10**6)
    assert np.array_equal(found["v1"], numbers.reshape(2, 3)) and np.array_equal(
        found["v2"], numbers.reshape(3, 2).T
    )
    assert found["longest"].shape == () and found["last"] == chr(0x10FFFF)


def test_an_unknown_channel_is_explained(trajectory):
    with pytest.raises(
        ArgumentError, match=r"given 'tau', expected tau_m \(there are: q_a, tau_m\)"
    ):
        trajectory["tau"]
    with pytest.raises(ArgumentError, match=r"given 'foo', expected one of q_a, tau_m"):
        trajectory["foo"]
    with pytest.raises(ArgumentError, match=r"the time is the attribute \.time"):
        trajectory["time"]
    with pytest.raises(ArgumentError, match="given 3, expected one of"):
        trajectory[3]
    with pytest.raises(KeyError) as caught:
        trajectory["foo"]
    assert isinstance(caught.value, ChannelError)
    assert str(caught.value) == "trajectory channel: given 'foo', expected one of q_a, tau_m"


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_a_full_disk_leaves_the_old_file(tmp_path, trajectory, suffix):
    path = trajectory.save(tmp_path / f"a.{suffix}")
    before = path.read_bytes()
    program = (
        "import resource, sys\n"
        "import numpy as np\n"
        "from flexgen import ArgumentError, Trajectory\n"
        "t = Trajectory(np.arange(9000.0) ** 1.1, {}, {}, {})\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "try:\n"
        "    t.save(sys.argv[1])\n"
        "except ArgumentError as error:\n"
        "    print(error)\n"
    )
    command = [sys.executable, "-c", program, str(path)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert (
        "which cannot be written (File too large)" in text
        and "a file that was there is unchanged" in text
    )
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_mat_file_has_channels_names_and_units(tmp_path, trajectory):
    from scipy.io import loadmat

    path = trajectory.save(tmp_path / "a.mat")
    data = loadmat(path)
    assert np.array_equal(data["time"][:, 0], trajectory.time)
    for name in trajectory:
        assert np.array_equal(data[name], trajectory[name])
        for key, words in (("labels", trajectory.labels), ("units", trajectory.units)):
            assert [str(cell[0]) for cell in data[key][name][0, 0][0]] == list(words[name])
    assert json.loads(str(data["meta"][0])) == trajectory.meta
    with pytest.raises(ArgumentError, match="not a trajectory of flexgen"):
        type(trajectory).load(path)


@pytest.mark.skipif(
    shutil.which("octave-cli") is None, reason="no octave-cli: install the Debian package octave"
)
@pytest.mark.slow
def test_octave_reads_the_mat_file(tmp_path, trajectory):
    trajectory.save(tmp_path / "a.mat")
    code = (
        "d = load('a.mat'); printf('%.17g %s %s\\n', d.q_a(end, 1), d.labels.q_a{1}, "
        "d.units.q_a{1})"
    )
    done = subprocess.run(
        ["octave-cli", "--eval", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    value, label, unit = done.stdout.strip().split(maxsplit=2)
    assert float(value) == trajectory["q_a"][-1, 0]
    assert (label, unit) == (trajectory.labels["q_a"][0], trajectory.units["q_a"][0])


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_a_table_without_comments_is_read(tmp_path, mark):
    """As a recorder or a spreadsheet writes it, with the mark of UTF-8 or without."""
    path = tmp_path / "record.csv"
    text = "time s,q_m[m1] rad,q_m[m2] rad,tau_m[m1] N m\r\n0.0,1,2,3\r\n0.001,4,5,6\r\n"
    path.write_text(mark + text, encoding="utf-8", newline="")
    found = Trajectory.load(path)
    assert found.time.tolist() == [0.0, 0.001] and found["q_m"].tolist() == [
        [1.0, 2.0],
        [4.0, 5.0],
    ]
    assert (
        found.labels["tau_m"] == ("m1",) and found.units["tau_m"] == ("N m",) and found.meta == {}
    )
    for wrong, words in (
        (
            text.replace("time s", "time h"),
            r"line 1: given the first column 'time h', expected 'time s', or time in ms, us",
        ),
        (
            text.replace("time s", "t"),
            "line 1: given a file that is not .* or the names of the columns",
        ),
        (text.replace(",6\r", "\r"), "line 3: given 3 columns, expected 4"),
        (text.replace("q_m[m2] rad", "angle"), "line 1: given the column 'angle', expected"),
        (text + "# rows: 3\r\n", "given 2 rows, where the last line states 3"),
    ):
        path.write_text(wrong, encoding="utf-8", newline="")
        with pytest.raises(ArgumentError, match=words):
            Trajectory.load(path)
