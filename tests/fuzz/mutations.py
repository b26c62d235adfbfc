"""Seeded mutations of valid files: bytes, lines, numbers and words, JSON values, and the insides
of npz archives.

The same generator and the same data always give the same result, so that a case is known by its
number.
"""

from __future__ import annotations

import copy
import io
import json
import random
import re
import warnings
import zipfile
from collections.abc import Callable
from typing import Any

SIZE_MAX = 400_000  # bytes of a mutated file

_NUMBER = re.compile(rb"(?<![A-Za-z_0-9])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z0-9_.]*")
NUMBERS = [
    *(
        b"0 -0.0 1 -1 2 3 0.5 17 64 65 1e-17 1e-18 1e-19 1e-320 1e12 1e13 1e19 1e308 -1e400 nan "
        b"inf -inf 0x10 1_0"
    ).split(),
    *(
        b"1e 1. .5 4294967296 18446744073709551616 2147483647 1000000000 true 2020-01-01 [] {} "
        b"[1,2] - ''"
    ).split(),
    b"9" * 400,
    b"9" * 5000,
    b"1" + b"0" * 300,
    b"",
]
TEXTS = (
    b"\x00",
    b"\xff",
    b"\xef\xbb\xbf",
    "\u202e".encode(),
    "\U0001f916".encode(),
    b"\x1b[31m",
    b"\\u0000",
    b'"""',
    b"'''",
    b"__",
    b"]]",
    b"[[",
    b"<!--",
    b"<!DOCTYPE a [<!ENTITY b 'c'>]>",
    b"&#0;",
    b"${x}",
    b"../../etc/passwd",
    b"nan",
    b",",
    b"\r",
    b"\n\n",
    b"#",
    b"=",
    b" ",
)

Mutation = Callable[[random.Random, bytes], bytes]


# --- bytes ---------------------------------------------------------------------------------------


def _span(rng: random.Random, data: bytes, most: int = 64) -> tuple[int, int]:
    start = rng.randrange(len(data) + 1)
    return start, min(len(data), start + rng.randrange(1, most))


def flip_bit(rng: random.Random, data: bytes) -> bytes:
    """One bit."""
    if not data:
        return data
    k = rng.randrange(len(data))
    return data[:k] + bytes([data[k] ^ (1 << rng.randrange(8))]) + data[k + 1 :]


def set_bytes(rng: random.Random, data: bytes) -> bytes:
    """A few bytes to extreme or random values."""
    start, _ = _span(rng, data)
    new = rng.choice([b"\x00", b"\xff", b"\x7f", b"\x80"]) * rng.choice([1, 2, 4, 8])
    if rng.random() < 0.5:
        new = rng.randbytes(rng.randrange(1, 9))
    return data[:start] + new + data[start + len(new) :]


def cut(rng: random.Random, data: bytes) -> bytes:
    """The end away."""
    return data[: rng.randrange(len(data) + 1)]


def delete(rng: random.Random, data: bytes) -> bytes:
    """A span away."""
    start, end = _span(rng, data, rng.choice([2, 8, 64, 1024]))
    return data[:start] + data[end:]


def repeat(rng: random.Random, data: bytes) -> bytes:
    """A span several times."""
    start, end = _span(rng, data)
    return data[:end] + data[start:end] * rng.choice([1, 2, 10, 1000]) + data[end:]


def insert(rng: random.Random, data: bytes) -> bytes:
    """A text that parsers trip over, sometimes very often."""
    start, _ = _span(rng, data)
    return data[:start] + rng.choice(TEXTS) * rng.choice([1, 1, 1, 3, 100, 60_000]) + data[start:]


def swap(rng: random.Random, data: bytes) -> bytes:
    """Two spans."""
    (a, b), (c, d) = sorted([_span(rng, data), _span(rng, data)])
    return data if c < b else data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


# --- text ----------------------------------------------------------------------------------------


def _replaced(rng: random.Random, data: bytes, pattern: re.Pattern[bytes], new: bytes) -> bytes:
    found = list(pattern.finditer(data))
    if not found:
        return data
    one = rng.choice(found)
    return data[: one.start()] + new + data[one.end() :]


def number(rng: random.Random, data: bytes) -> bytes:
    """Another number, or what is none."""
    return _replaced(rng, data, _NUMBER, rng.choice(NUMBERS))


def word(rng: random.Random, data: bytes) -> bytes:
    """Another word of the same file, or a strange one."""
    words = _WORD.findall(data)
    strange = [b"double", b"name", b"a" * 32, b"a__b", b"x" * 3000, b"true", b"None", b"__class__"]
    return _replaced(
        rng, data, _WORD, rng.choice(words if words and rng.random() < 0.8 else strange)
    )


def lines(rng: random.Random, data: bytes) -> bytes:
    """Lines away, twice, elsewhere, or the end away at a line end."""
    rows = data.splitlines(keepends=True)
    if len(rows) < 2:
        return data
    a = rng.randrange(len(rows))
    b = rng.randrange(len(rows))
    kind = rng.randrange(5)
    if kind == 0:
        del rows[a]
    elif kind == 1:
        rows.insert(b, rows[a])
    elif kind == 2:
        rows[a], rows[b] = rows[b], rows[a]
    elif kind == 3:
        del rows[a:]
    else:
        rows[a:a] = rows[min(a, b) : max(a, b) + 1] * rng.choice([1, 2, 5])
    return b"".join(rows)


def nest(rng: random.Random, data: bytes) -> bytes:
    """A value that is nested deeply."""
    depth = rng.choice([5, 15, 17, 200, 3000])
    opening, closing = rng.choice(
        [(b"[", b"]"), (b"{a=", b"}"), (b'{"a":', b"}"), (b"<a>", b"</a>"), (b"(", b")")]
    )
    return _replaced(rng, data, _NUMBER, opening * depth + b"1" + closing * rng.choice([depth, 0]))


BYTES: tuple[Mutation, ...] = (flip_bit, set_bytes, cut, delete, repeat, insert, swap)
TEXT: tuple[Mutation, ...] = (
    number,
    number,
    number,
    word,
    word,
    word,
    lines,
    lines,
    nest,
    insert,
    delete,
)


def mutated_text(rng: random.Random, data: bytes) -> bytes:
    """A text file: mostly edits of its words, numbers and lines, sometimes of its bytes."""
    for _ in range(rng.choice([1, 1, 1, 2, 2, 3, 5])):
        data = rng.choice(BYTES if rng.random() < 0.2 else TEXT)(rng, data)
    return data[:SIZE_MAX]


# --- JSON ----------------------------------------------------------------------------------------

VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    1,
    -1,
    2**31,
    2**63,
    10**400,
    0.5,
    1e308,
    "",
    "x",
    "elbow",
    "../x",
    "\0",
    "a" * 5000,
    [],
    {},
    [1],
    [[1]],
    {"a": 1},
    [None],
    ["x", 5],
    {"name": "x"},
    "double",
    "0" * 64,
)


def mutated_json(rng: random.Random, data: bytes) -> bytes:
    """A JSON file: mostly values of other types, keys away or twice, sometimes a mutated text."""
    try:
        value = json.loads(data) if rng.random() < 0.8 else None
    except (ValueError, RecursionError):  # mutated before
        value = None
    if not isinstance(value, dict | list):
        return mutated_text(rng, data)
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        _change(rng, value)
    return json.dumps(value).encode()[:SIZE_MAX]


def _change(rng: random.Random, root: Any) -> None:
    here = root
    steps = 0
    while True:
        inner = [
            v
            for v in (here.values() if isinstance(here, dict) else here)
            if isinstance(v, dict | list) and v
        ]
        if not inner or (steps and rng.random() < 0.35):
            break
        here = rng.choice(inner)
        steps = steps + 1
    keys = list(here) if isinstance(here, dict) else list(range(len(here)))
    if not keys:
        return
    key = rng.choice(keys)
    kind = rng.randrange(6)
    if kind == 0:
        del here[key]
    elif kind == 1:
        here[key] = copy.deepcopy(here[rng.choice(keys)])
    elif kind == 2 and isinstance(here, dict):
        here[rng.choice(["x", "name", "", key + "_"])] = here.pop(key)
    elif kind == 2:
        here.insert(key, copy.deepcopy(here[key]))
    elif isinstance(here[key], int) and kind == 3:
        here[key] += rng.choice([-1, 1, 2**32])
    elif isinstance(here[key], str) and kind == 3:
        here[key] = mutated_text(rng, here[key].encode()).decode(errors="replace")[:10_000]
    else:
        here[key] = copy.deepcopy(rng.choice(VALUES))


# --- npz -----------------------------------------------------------------------------------------

_SHAPE = re.compile(rb"'shape': \([^)]*\)")
_TYPE = re.compile(rb"'descr': '[^']*'")
_SHAPES = [
    "()",
    "(0,)",
    "(1,)",
    "(-1,)",
    "(1000000000,)",
    "(2, 3)",
    "(99999999999999999999, 9)",
    "(1.5,)",
    "5",
    "('a',)",
]
_TYPES = [
    "<f4",
    ">f8",
    "<i8",
    "|b1",
    "|O",
    "<U9",
    "<c16",
    "|S3",
    "|V8",
    "<M8[s]",
    "<f2",
    "<U1000000000",
    "x",
    "<f8, <f8",
]


def _header(rng: random.Random, content: bytes) -> bytes:
    """Another shape, type or order in the header of an array, whose length stays as it was."""
    length = int.from_bytes(content[8:10], "little")
    head = content[10 : 10 + length]
    kind = rng.randrange(4)
    if kind == 0:
        head = _SHAPE.sub(f"'shape': {rng.choice(_SHAPES)}".encode(), head)
    elif kind == 1:
        head = _TYPE.sub(f"'descr': '{rng.choice(_TYPES)}'".encode(), head)
    elif kind == 2:
        head = head.replace(b"False", b"True")
    else:
        head = mutated_text(rng, head)
    head = head.rstrip()[: length - 1].ljust(length - 1) + b"\n"
    return content[:8] + length.to_bytes(2, "little") + head + content[10 + length :]


def _text_array(rng: random.Random, content: bytes) -> bytes:
    """A text in an array, mutated."""
    length = int.from_bytes(content[8:10], "little")
    text = content[10 + length :].decode("utf-32-le", errors="replace")
    new = mutated_json(rng, text.encode("utf-8", errors="replace"))
    words = new.decode(errors="replace")
    head = _TYPE.sub(f"'descr': '<U{len(words)}'".encode(), content[10 : 10 + length])
    head = head.rstrip().ljust(length - 1) + b"\n"
    return (
        content[:8]
        + len(head).to_bytes(2, "little")
        + head
        + words.encode("utf-32-le", errors="replace")
    )


def mutated_npz(rng: random.Random, data: bytes) -> bytes:
    """An npz file: its bytes, or what is in the archive, packed again with right checksums."""
    if rng.random() < 0.3:
        for _ in range(rng.choice([1, 1, 2, 4])):
            data = rng.choice(BYTES)(rng, data)
        return data[:SIZE_MAX]
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(member.filename, archive.read(member)) for member in archive.infolist()]
    for _ in range(rng.choice([1, 1, 2, 3])):
        if not members:
            break
        k = rng.randrange(len(members))
        kind = rng.randrange(7)
        name, content = members[k]
        if kind == 0:
            del members[k]
        elif kind == 1:
            members[k] = (
                rng.choice(
                    ["x.npy", "time", "", "../time.npy", "a" * 200 + ".npy", members[0][0]]
                ),
                content,
            )
        elif kind == 2:
            members[k] = (name, rng.choice(BYTES)(rng, content)[:SIZE_MAX])
        elif kind == 3 and b"'<U" in content[:128]:
            members[k] = (name, _text_array(rng, content))
        elif kind == 4:
            members.append((f"{rng.choice('xyt')}.npy", content))
        elif kind == 5 and len(content) > 200:
            members[k] = (name, content[: -rng.choice([1, 8, 16, 80])])
        else:
            members[k] = (name, _header(rng, content))
    out = io.BytesIO()
    method = rng.choice(
        [zipfile.ZIP_DEFLATED] * 6 + [zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]
    )
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", method) as archive:
        warnings.simplefilter("ignore")  # names that are there twice
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name or "x"), content, method)
    return out.getvalue()


def mutate(rng: random.Random, suffix: str, data: bytes) -> bytes:
    """The mutation of a file of this kind."""
    return {".npz": mutated_npz, ".json": mutated_json}.get(suffix, mutated_text)(rng, data)
