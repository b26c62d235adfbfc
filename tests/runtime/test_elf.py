"""Headers of shared libraries by the rules of ELF: a file that is cut is not mapped."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import pytest

from flexgen.base.errors import BuildError
from flexgen.runtime.files import read_library

WIDE_LINUX = sys.platform == "linux" and sys.maxsize > 2**32 and sys.byteorder == "little"
pytestmark = pytest.mark.skipif(not WIDE_LINUX, reason="the files have addresses of 64 bits")

# kinds of segments
LOAD = 1
DYNAMIC = 2
# bytes
HEADER = 64
ENTRY = 56
SIZE = 400


def machine() -> int:
    """ELF machine of the running interpreter."""
    with open("/proc/self/exe", "rb") as file:
        return int(struct.unpack_from("<H", file.read(20), 18)[0])


def library(*segments: tuple[int, int, int, int], size: int = SIZE, **fields: int) -> bytes:
    """A file with segments (kind, start, bytes in the file, bytes in memory)."""
    given = {"kind": 3, "machine": 0, "table": HEADER, "entry": ENTRY, "count": len(segments)}
    given |= fields
    own = machine() + given["machine"] if WIDE_LINUX else 0
    head = b"\x7fELF" + bytes([2, 1, 1]) + bytes(9)
    head += struct.pack("<HHIQQQI", given["kind"], own, 1, 0, given["table"], 0, 0)
    head += struct.pack("<HHHHHH", HEADER, given["entry"], given["count"], 0, 0, 0)
    rows = b"".join(
        struct.pack("<IIQQQQQQ", kind, 0, at, 0, 0, n, m, 0) for kind, at, n, m in segments
    )
    return (head + rows).ljust(size, b"\0")[:size]


ONE = (LOAD, 0, 1, 1)
CUT = "a cut or garbled library"
HEAD = "no shared library (its ELF header is missing or cut)"
OTHER = "a library of other addresses or byte order, expected 64 bits, little-endian"
NONE = "a garbled library (nothing in it is to be loaded)"


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        # up to the last byte; zeros after it; only what is loaded has memory
        (library((LOAD, 0, SIZE, SIZE)), ""),
        (library((LOAD, 100, 300, 900), (DYNAMIC, 300, 100, 0)), ""),
        (library((LOAD, 1, SIZE, SIZE)), f"{CUT} (segment 0 ends at byte 401 of 400)"),
        (library((LOAD, 0, SIZE, SIZE - 1)), f"{CUT} (segment 0 ends at byte 400 of 400)"),
        (library(ONE, (DYNAMIC, 301, 100, 100)), f"{CUT} (segment 1 ends at byte 401 of 400)"),
        (library((DYNAMIC, 0, 10, 10)), NONE),
        (library(), f"{CUT} (its table of segments)"),
        (library(ONE, count=0xFFFF), f"{CUT} (its table of segments)"),
        (library(ONE, entry=ENTRY + 1), f"{CUT} (its table of segments)"),
        (library(ONE, table=SIZE - ENTRY), NONE),
        (library(ONE, table=SIZE - ENTRY + 1), f"{CUT} (its table of segments)"),
        (library(ONE, kind=2), "an ELF file of kind 2, expected a shared library"),
        (library(ONE, machine=1), "a library for another processor (ELF machine "),
        (library(ONE, size=HEADER - 1), HEAD),
        (b"MZ" + library(ONE)[2:], HEAD),
        (b"\x7fELF\x01" + library(ONE)[5:], OTHER),
        (b"\x7fELF\x02\x02" + library(ONE)[6:], OTHER),
        # the header alone: its table would be behind the end
        (library(ONE, size=HEADER), f"{CUT} (its table of segments)"),
    ],
)
def test_a_library_is_mapped_only_if_its_segments_are_whole(
    content: bytes, problem: str, tmp_path: Path
) -> None:
    file = tmp_path / "made.so"
    file.write_bytes(content)
    if not problem:
        assert read_library(file) == content
        return
    with pytest.raises(BuildError) as refused:
        read_library(file)
    assert str(refused.value).startswith(f"{file}: given {problem}")
