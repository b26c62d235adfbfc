"""Arrays of ``.npz`` files, whose sizes are checked before memory is taken for them.

An npz file is a zip archive of npy files. Neither the sizes in the archive nor the shapes in the
headers of the arrays are trusted: an array is read only where its header, its size in the archive
and the limits of the caller agree, and nothing is unpickled.
"""

from __future__ import annotations

import ast
import errno
import math
import re
import stat
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

MEMBERS = 1000  # arrays in a file, at most
DIRECTORY = 1_000_000  # bytes of the table of contents, at most
_PART = 2**20  # bytes of an array that are unpacked at once
HEADER = 10_000  # bytes of the header of an array, at most

# of the table of contents
_END = b"PK\x05\x06"
_END_64 = b"PK\x06\x07"
_END_SIZE = 22
_COMMENT = 2**16
_TYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f(2|4|8|16)|U[1-9]\d{0,8})")
# those of numpy; others unpack without a bound
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


class NpzError(ValueError):
    """The file is not an npz file, or larger than allowed: what was given and what was
    expected.
    """

    def __init__(self, given: str, expected: str) -> None:
        self.given = given
        self.expected = expected
        super().__init__(f"given {given}, expected {expected}")


def read_npz(
    path: Path,
    size_max: int,
    check: Callable[[str, tuple[int, ...], np.dtype[Any]], None] | None = None,
) -> dict[str, np.ndarray]:
    """The arrays of an npz file by name.

    Parameters
    ----------
    path : Path
    size_max : int
        Bytes that the file, and that all its arrays together, may have.
    check : callable, optional
        Called with name, shape and type of each array before any of them is read; it raises where
        one is not wanted.

    Returns
    -------
    dict of str to array

    Raises
    ------
    NpzError
        Not an npz file, a damaged one, or one that is too large.
    OSError
        The file cannot be read.
    """
    with _damage_named():
        _check_directory(path, size_max)
        archive = zipfile.ZipFile(path)
    with archive:
        with _damage_named():
            _check_sizes(archive, path.stat().st_size)
            headers = _headers(archive, size_max)
        for name, (shape, _, dtype, _) in headers.items():
            if check is not None:
                check(name, shape, dtype)
        with _damage_named():
            return {name: _array(archive, name, *header) for name, header in headers.items()}


@contextmanager
def _damage_named() -> Iterator[None]:
    """NpzError for what the modules of zip archives raise where a file is damaged.

    ValueError, of which NpzError is one, comes from offsets that lie before the file.
    """
    try:
        yield
    except NpzError:
        raise
    except OSError as error:
        # a negative offset: other errors are those of reading a file
        if error.errno != errno.EINVAL:
            raise
        raise NpzError("a damaged .npz file (offsets)", "one that numpy.savez wrote") from None
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        OverflowError,
        RuntimeError,
        ValueError,
    ) as error:
        reason = str(error) or type(error).__name__
        raise NpzError(f"a damaged .npz file ({reason})", "one that numpy.savez wrote") from None


def _check_directory(path: Path, size_max: int) -> None:
    """Refuse what is not a zip archive, or one whose table of contents is too long to be read."""
    facts = path.stat()
    # a pipe would be waited for; a folder is refused by opening it
    if not (stat.S_ISREG(facts.st_mode) or stat.S_ISDIR(facts.st_mode)):
        raise NpzError("a pipe or a device", "a file")
    size = facts.st_size
    if size > size_max:
        raise NpzError(f"a file of {size} bytes", f"at most {size_max}")
    with path.open("rb") as stream:
        first = stream.read(6)
        stream.seek(max(0, size - _END_SIZE - _COMMENT))
        tail = stream.read(_END_SIZE + _COMMENT)
    if first == b"\x93NUMPY":
        raise NpzError("a .npy file under the name of an .npz file", "one that numpy.savez wrote")
    if first[:2] != b"PK":
        raise NpzError("what is no .npz file", "one that numpy.savez wrote")
    end = tail.rfind(_END)
    if end < 0 or len(tail) < end + _END_SIZE:
        raise NpzError("an .npz file without its end", "a complete one; write or copy it again")
    length = int.from_bytes(tail[end + 12 : end + 16], "little")
    if length > DIRECTORY or tail[max(0, end - 20) : end].startswith(_END_64):
        raise NpzError(
            "an .npz file with a table of contents that is too long", f"at most {MEMBERS} arrays"
        )


def _check_sizes(archive: zipfile.ZipFile, size: int) -> None:
    """Refuse an archive that states more packed bytes than the file has: room for all of them
    would be taken.
    """
    for member in archive.infolist():
        stored = member.compress_type == zipfile.ZIP_STORED
        if member.compress_size > size or (stored and member.compress_size != member.file_size):
            raise NpzError(
                f"the member {member.filename[:80]!r} of {member.compress_size} packed bytes in "
                f"a file of {size}",
                "sizes that agree",
            )


def _headers(
    archive: zipfile.ZipFile, size_max: int
) -> dict[str, tuple[tuple[int, ...], bool, np.dtype[Any], int]]:
    """Shape, order, type and start of the numbers of each array by name, consistent with its size
    in the archive.
    """
    members = archive.infolist()
    if len(members) > MEMBERS:
        raise NpzError(f"{len(members)} arrays", f"at most {MEMBERS}")
    total = sum(member.file_size for member in members)
    if total > size_max:
        raise NpzError(f"arrays of {total} bytes", f"at most {size_max}")
    out: dict[str, tuple[tuple[int, ...], bool, np.dtype[Any], int]] = {}
    for member in members:
        name = member.filename.removesuffix(".npy")
        if not member.filename.endswith(".npy") or name in out:
            raise NpzError(f"the member {member.filename[:80]!r}", "arrays with different names")
        if member.compress_type not in _METHODS or member.flag_bits & 1:
            raise NpzError(
                f"the array {name[:80]!r} packed in an unknown way", "one that numpy.savez wrote"
            )
        with archive.open(member) as stream:
            shape, by_columns, dtype = _header(stream, name)
            start = stream.tell()
        size = math.prod(shape) * dtype.itemsize
        if size != member.file_size - start:
            raise NpzError(
                f"the array {name[:80]!r} of shape {_shorten(shape)} and "
                f"{member.file_size - start} bytes",
                f"{_shorten(size)} bytes",
            )
        out[name] = shape, by_columns, dtype, start
    return out


def _header(stream: IO[bytes], name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type that the header of an array states."""
    magic = stream.read(8)
    width = {b"\x93NUMPY\x01\x00": 2, b"\x93NUMPY\x02\x00": 4}.get(magic, 0)
    length = int.from_bytes(stream.read(width), "little")
    head: Any = None
    if width and length <= HEADER:
        try:
            head = ast.literal_eval(stream.read(length).decode("latin-1").strip())
        # the text is short
        except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError, Warning):
            head = None
    if not isinstance(head, dict) or head.keys() != {"descr", "fortran_order", "shape"}:
        raise NpzError(
            f"the array {name[:80]!r} without a header that can be read", "one of numpy"
        )
    descr = head["descr"]
    shape = head["shape"]
    by_columns = head["fortran_order"]
    if not (isinstance(descr, str) and _TYPE.fullmatch(descr)):
        raise NpzError(f"the array {name[:80]!r} of type {_shorten(descr)}", "numbers or text")
    if not (
        isinstance(shape, tuple)
        and len(shape) <= 32
        and all(type(n) is int and n >= 0 for n in shape)
    ):
        raise NpzError(f"the array {name[:80]!r} of shape {_shorten(shape)}", "whole numbers >= 0")
    try:
        return shape, bool(by_columns), np.dtype(descr)
    except (TypeError, ValueError):
        raise NpzError(f"the array {name[:80]!r} of type {descr}", "numbers or text") from None


def _array(
    archive: zipfile.ZipFile,
    name: str,
    shape: tuple[int, ...],
    by_columns: bool,
    dtype: np.dtype[Any],
    start: int,
) -> np.ndarray:
    """An array of an archive, read in parts and checked against the size that its header states.

    ``start``: bytes before its numbers; ``by_columns``: they are in the order of Fortran.
    """
    count = math.prod(shape)
    numbers = np.empty(count, dtype)
    # a part at a time, into the array: a file would take its size three times
    bytes_of = numbers.view(np.uint8).data if numbers.nbytes else memoryview(b"")
    found = 0
    with archive.open(f"{name}.npy") as stream:
        stream.read(start)
        while part := stream.read(min(_PART, numbers.nbytes - found) or 1):
            if found + len(part) > numbers.nbytes:
                break
            bytes_of[found : found + len(part)] = part
            found += len(part)
            # at its end: the checksum is compared there
    if part or found != numbers.nbytes:
        raise NpzError(
            f"the array {name[:80]!r} with {start + found + len(part)} bytes",
            "as many as the archive states",
        )
    if dtype.kind == "U" and numbers.nbytes:
        codes = numbers.view(np.dtype("u4").newbyteorder(dtype.byteorder))
        if codes.max() > sys.maxunicode:
            raise NpzError(f"the array {name[:80]!r} with characters that do not exist", "a text")
    if by_columns and len(shape) > 1:
        return np.ascontiguousarray(numbers.reshape(shape, order="F"))
    return numbers.reshape(shape)


def _shorten(value: Any) -> str:
    try:
        text = str(value)
    except ValueError:  # an integer of thousands of digits
        return "a huge number"
    return text if len(text) <= 60 else text[:57] + "..."
