"""Numbers of flexgen/runtime by other routes: headers of shared libraries written by the rules of
ELF.
"""

from __future__ import annotations

import struct
import sys

import pytest

from flexgen.runtime import files

WIDE = sys.maxsize > 2**32
pytestmark = pytest.mark.skipif(
    not files._ELF_SYSTEM or not WIDE, reason="no system with ELF of 64 bits"
)
# kinds of segments
LOAD = 1
DYNAMIC = 2
HERE = files._machine("<", 62)
# bytes
HEADER = 64
ENTRY = 56


def library(*segments: tuple[int, int, int, int], size: int = 400, **fields: int) -> bytes:
    """A file of ``size`` bytes with segments (kind, start, bytes in the file, bytes in memory)."""
    order = "<" if sys.byteorder == "little" else ">"
    given = {
        "kind": 3,
        "machine": HERE,
        "table": HEADER,
        "entry": ENTRY,
        "count": len(segments),
    } | fields
    head = b"\x7fELF" + bytes([2, 1 if order == "<" else 2, 1]) + bytes(9)
    head += struct.pack(
        f"{order}HHIQQQI", given["kind"], given["machine"], 1, 0, given["table"], 0, 0
    )
    head += struct.pack(f"{order}HHHHHH", HEADER, given["entry"], given["count"], 0, 0, 0)
    rows = b"".join(
        struct.pack(f"{order}IIQQQQQQ", kind, 0, at, 0, 0, n, m, 0) for kind, at, n, m in segments
    )
    return (head + rows).ljust(size, b"\0")[:size]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (library((LOAD, 0, 400, 400)), None),  # up to the last byte
        # zeros after it; only loads have memory
        (library((LOAD, 100, 300, 900), (DYNAMIC, 300, 100, 0)), None),
        (library((LOAD, 0, 400, 399)), "segment 0 ends at byte 400 of 400"),
        (library((LOAD, 0, 1, 1), (DYNAMIC, 301, 100, 100)), "segment 1 ends at byte 401 of 400"),
        (library((DYNAMIC, 0, 10, 10)), "nothing in it is to be loaded"),
        (library(), "its table of segments"),
        (library((LOAD, 0, 1, 1), entry=ENTRY + 1), "its table of segments"),
        (library((LOAD, 0, 1, 1), table=400 - ENTRY), "nothing in it is to be loaded"),
        (library((LOAD, 0, 1, 1), table=401 - ENTRY), "its table of segments"),
        (library((LOAD, 0, 1, 1), kind=2), "an ELF file of kind 2"),
        (library((LOAD, 0, 1, 1), machine=HERE + 1), "for another processor"),
        (library((LOAD, 0, 1, 1), size=63), "header is missing or cut"),
        (b"MZ" + library((LOAD, 0, 1, 1))[2:], "header is missing or cut"),
        (b"\x7fELF\x01" + library((LOAD, 0, 1, 1))[5:], "other addresses or byte order"),
    ],
)
def test_a_library_in_elf_has_its_segments_within_the_file(
    content: bytes, problem: str | None
) -> None:
    found = files._elf_problem(content)
    assert found == problem if problem is None else found is not None and problem in found
