"""Files that claim to be npz files: each lie is refused as such, in bounded time and memory."""

from __future__ import annotations

import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from npz_lies import packed

from flexgen.base.files import npz_files
from flexgen.base.files.npz_files import NpzError, read_npz

LARGEST = 10_000_000  # bytes


def header(descr: str, shape: str) -> bytes:
    """An npy file without numbers."""
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}}}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


@pytest.mark.parametrize("shape", ["(0,)", "(3,)", "(1000000000000,)"])
def test_texts_without_characters_are_refused(shape: str, tmp_path: Path) -> None:
    """Their arrays have no bytes, whatever their shape is."""
    file = packed(tmp_path / "texts.npz", {"a": header("<U0", shape)})
    with pytest.raises(NpzError, match="of type <U0, expected numbers or text"):
        read_npz(file, LARGEST)


@pytest.mark.parametrize("start", [-1, -70, 2**31, 2**32 - 2])
def test_offsets_outside_of_the_file_are_damage(start: int, tmp_path: Path) -> None:
    """The table of contents is moved, so that arrays begin before or behind the file."""
    file = tmp_path / "moved.npz"
    np.savez(file, a=np.arange(3.0), b=np.arange(2))
    content = bytearray(file.read_bytes())
    first = content.find(b"PK\x01\x02")
    content[first + 42 : first + 46] = struct.pack("<I", start % 2**32)
    file.write_bytes(content)
    with pytest.raises(NpzError, match=r"expected one that numpy\.savez wrote"):
        read_npz(file, LARGEST)
    # the table itself is stated to begin further back than the file is long
    end = content.rfind(b"PK\x05\x06")
    content[end + 16 : end + 20] = struct.pack("<I", 2**32 - 2)
    file.write_bytes(content)
    with pytest.raises(NpzError, match="expected"):
        read_npz(file, LARGEST)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(NpzError, match="given a pipe or a device, expected a file"):
        read_npz(tmp_path / "pipe.npz", LARGEST)


def test_an_error_of_the_caller_stays_what_it_is(tmp_path: Path) -> None:
    """Also where it is a ValueError, as of damaged archives."""
    np.savez(tmp_path / "good.npz", a=np.arange(3.0))

    def refuse(name: str, shape: tuple[int, ...], dtype: object) -> None:
        raise ValueError(f"no {name} here")

    with pytest.raises(ValueError, match="no a here"):
        read_npz(tmp_path / "good.npz", LARGEST, refuse)
    assert list(read_npz(tmp_path / "good.npz", LARGEST)) == ["a"]


def test_a_file_of_arrays_has_at_most_a_thousand_of_them(tmp_path: Path) -> None:
    """And as many bytes as are allowed, packed and unpacked."""
    for count in (1000, 1001):
        file = tmp_path / f"{count}.npz"
        np.savez(file, **{f"a{k}": np.zeros(1, np.int8) for k in range(count)})
    assert len(read_npz(tmp_path / "1000.npz", 10**9)) == 1000
    with pytest.raises(NpzError, match=r"^given 1001 arrays, expected at most 1000$"):
        read_npz(tmp_path / "1001.npz", 10**9)
    file = tmp_path / "zeros.npz"
    np.savez_compressed(file, a=np.zeros(10_000, np.int8))
    with zipfile.ZipFile(file) as archive:
        size = archive.infolist()[0].file_size
    assert read_npz(file, size)["a"].shape == (10_000,)
    with pytest.raises(
        NpzError, match=rf"^given arrays of {size} bytes, expected at most {size - 1}$"
    ):
        read_npz(file, size - 1)
    packed = file.stat().st_size
    with pytest.raises(
        NpzError, match=rf"^given a file of {packed} bytes, expected at most {packed - 1}$"
    ):
        read_npz(file, packed - 1)
    assert (npz_files.MEMBERS, npz_files.DIRECTORY, npz_files.HEADER) == (1000, 10**6, 10**4)
