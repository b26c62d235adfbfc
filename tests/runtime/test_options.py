"""Options records have fields, defaults, offsets and sizes of the structs in the C header."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toolchain import CC

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.runtime.inversion.many_inversion import InversionOptions
from flexgen.runtime.library import Library
from flexgen.runtime.options import SolverOptions, StreamOptions

RECORDS = {"inversion_options": SolverOptions, "stream_options": StreamOptions}
# of a record that a library needs
NEEDED = {"intervals": 10, "samples_per_interval": 5, "period": 0.005}


@pytest.fixture(scope="module")
def library() -> Library:
    return flexgen.load(flexgen.generate("elbow", progress=False).directory)


def sizes_in_c(folder: Path, names: Mapping[str, list[str]], out: Path) -> list[list[int]]:
    """Size of each struct, then offset and size of its members, by a program with the header."""
    lines = []
    for struct, members in names.items():
        kind = f"elbow_{struct}"
        lines.append(f'printf("%zu", sizeof({kind}));')
        lines += [
            f'printf(" %zu %zu", offsetof({kind}, {name}), sizeof((({kind} *)0)->{name}));'
            for name in members
        ]
        lines.append('puts("");')
    source = out / "sizes.c"
    head = '#include <stddef.h>\n#include <stdio.h>\n#include "elbow_inversion.h"\n'
    source.write_text(head + "int main(void)\n{\n" + "\n".join(lines) + "\nreturn 0;\n}\n")
    command = [CC, "-std=c99", f"-I{folder}", str(source), "-o", str(out / "sizes")]
    subprocess.run(command, check=True)
    text = subprocess.run([out / "sizes"], check=True, capture_output=True, text=True).stdout
    return [[int(x) for x in line.split()] for line in text.splitlines()]


def sizes_in_python(structs: Mapping[str, Any], names: Mapping[str, list[str]]) -> list[list[int]]:
    """Sizes and offsets of the structures that a loaded library has."""
    found = []
    for struct, members in names.items():
        kind = structs[struct]
        places = [getattr(kind, name) for name in members]
        found.append(
            [ctypes.sizeof(kind), *(x for place in places for x in (place.offset, place.size))]
        )
    return found


def test_offsets_and_sizes_are_those_of_the_header(library: Library, tmp_path: Path) -> None:
    """Planted: two members in the other order."""
    names = {struct: [each.name for each in fields(kind)] for struct, kind in RECORDS.items()}
    structs = library.streams.structs
    for struct, members in names.items():
        assert [name for name, _ in structs[struct]._fields_] == members
    in_c = sizes_in_c(library.directory, names, tmp_path)
    assert sizes_in_python(structs, names) == in_c
    planted = names | {"stream_options": sorted(names["stream_options"])}
    assert sizes_in_python(structs, planted) != in_c


def test_defaults_are_those_of_c(library: Library) -> None:
    structs = library.streams.structs
    given = library.streams.interface, np.dtype(float)
    c = ctypes.CDLL(str(next(library.directory.glob("*.so"))))
    defaults = c.elbow_inversion_defaults
    defaults.restype = structs["inversion_options"]
    in_c = defaults()
    own = SolverOptions().members("invert", *given, settles=True, grows=True)
    assert {name: getattr(in_c, name) for name in own} == own
    defaults = c.elbow_stream_defaults
    defaults.restype = structs["stream_options"]
    in_c = defaults()
    members = StreamOptions(**NEEDED).resolve(np.dtype(float)).members(library.streams.interface)
    assert {name: getattr(in_c, name) for name in ("hold", "delay", "tolerance")} == {
        name: members[name] for name in ("hold", "delay", "tolerance")
    }


def test_options_of_many_problems_begin_with_those_of_one() -> None:
    one = [each.name for each in fields(SolverOptions)]
    assert [each.name for each in fields(InversionOptions)][: len(one)] == one


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_pre": 1.5}, "invert, n_pre: given 1.5, expected a whole number"),
        ({"settled": 1.0}, r"invert, settled: given 1, expected a number from 0 to 1"),
        ({"growth": 1}, "invert, growth: given 1, expected True or False"),
        ({"hold": "foh"}, "invert, hold: given 'foh', expected one of"),
        ({"delay": 4.5}, "invert, delay: given 4.5 samples, expected 0 to 4"),
    ],
)
def test_options_out_of_range_are_refused(
    options: dict[str, Any], message: str, library: Library
) -> None:
    given = library.streams.interface, np.dtype(float)
    with pytest.raises(ArgumentError, match=message):
        SolverOptions(**options).members("invert", *given, settles=True, grows=True)


def test_a_function_without_growth_or_settling_refuses_them(library: Library) -> None:
    given = library.streams.interface, np.dtype(float)
    assert SolverOptions().members("bvp", *given, settles=False, grows=False)["growth"] == 0
    for options in (SolverOptions(settled=1e-6), SolverOptions(growth=True)):
        with pytest.raises(ArgumentError, match=r"expected (0: all|False: this)"):
            options.members("bvp", *given, settles=False, grows=False)
