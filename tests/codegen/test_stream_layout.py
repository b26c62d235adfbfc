"""The memory of a stream: the positions that Python computes are those that compiled C reports."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from bristled import bristled
from harmonic import harmonic
from hysteretic import SLIPS, with_elements
from toolchain import CC, needs_compiler

from flexgen.codegen.emission import stream_layout as table
from flexgen.codegen.emission.clib_files import stream_layout
from flexgen.codegen.emission.emit import emit, function_texts
from flexgen.codegen.emission.interface import DELAY_MAX
from flexgen.codegen.emission.size_terms import Linear, Name
from flexgen.codegen.emission.spec import LibrarySpec, library_spec
from flexgen.codegen.emission.stream_layout import LIMIT_ARRAYS, Row, StreamLayout
from flexgen.codegen.statements.function_text import FunctionText
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.model.elements import RobotModel
from flexgen.model.position_servo.filters import LowPass, Notch
from flexgen.model.position_servo.keys import GAINS, ServoTable
from flexgen.model.reader import read
from flexgen.runtime.streams import head
from flexgen.runtime.streams.head import HEAD, members_of

pytestmark = needs_compiler

# Intervals and samples per interval, hold and delay; of streams that are short, usual and long.
OPTIONS = (
    (1, 1, 0, 0.0),
    (10, 5, 1, 0.0),
    (11, 6, 2, 3.7),
    (37, 2, 0, 1.2),
    (400, 1, 2, float(DELAY_MAX)),
    (10_000, 999, 0, 0.0),
)


def with_servo() -> RobotModel:
    """Two motors with filters of the torque."""
    model = read("planar5_nmp")
    gains = {name: (1.0,) * model.n_m for name in GAINS}
    filters = {"low_pass": (LowPass(300.0),), "notch": (Notch(40.0), Notch(60.0))}
    return replace(model, servo=ServoTable("cascade", sample_time=1e-3, **gains, **filters))


# Each part of a stream, by the model and the parts of its library.
CASES = {
    "rigid": (lambda: read("elbow"), ()),
    "elastic": (lambda: read("planar5_nmp"), ()),
    "all limits": (lambda: read("planar5_nmp"), ("limits",)),
    "force": (lambda: read("planar5_nmp"), ("force",)),
    "harmonics": (lambda: harmonic("elbow"), ("limits",)),
    "hysteresis": (lambda: with_elements("elbow", SLIPS), ()),
    "bristles": (lambda: bristled("elbow", {"m1": {"coulomb": 0.5, "stiffness": 800.0}}), ()),
    "servo": (with_servo, ()),
}


@cache
def specified(case: str, precision: str) -> tuple[LibrarySpec, dict[str, FunctionText]]:
    """The library of a case, and its functions."""
    model, parts = CASES[case]
    equations = derive(model())
    names = [name for name in INVERSION if name != "inversion_jacobians" or equations.model.n_e]
    names += ["motor_harmonics"] * (case == "harmonics")
    spec = library_spec(equations, names, precision=precision, parts=parts)
    return spec, function_texts(spec)


def reported(spec: LibrarySpec, files: dict[str, str], layout: StreamLayout, folder: Path):
    """Layout by compiled C: positions in the head in bytes; of each of `OPTIONS` those of the
    limits and of the stream, in reals.
    """
    for file, text in files.items():
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_text(text)
    lines = "".join(
        f'    printf("head {member.name} %d\\n", (int)offsetof(stream_head, {member.name}));\n'
        for member in members_of(layout.parts)
    )
    lines += '    printf("head end %d\\n", (int)HEAD);\n'
    for k, (intervals, samples, hold, delay) in enumerate(OPTIONS):
        arguments = f"{intervals}, {samples}, {hold}, (real){delay}"
        for kind, made, names in (
            ("limits", f"limits_laid_out({intervals})", layout.limit_offsets(1)),
            ("arrays", f"laid_out({arguments})", layout.offsets(1, 1)),
        ):
            lines += "".join(
                f'    printf("{kind}{k} {name} %lld\\n", (long long){made}.{name});\n'
                for name in names
            )
    program = f'#include "src/{spec.name}_stream_update.h"\n#include <stdio.h>\n'
    program += f"int main(void)\n{{\n{lines}    return 0;\n}}\n"
    (folder / "main.c").write_text(program)
    words = [CC, "-std=c99", f"-I{folder}", f"-I{folder / 'src'}", "main.c", "-o", "main", "-lm"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    said = subprocess.run([folder / "main"], capture_output=True, text=True, check=True).stdout
    found: dict[str, dict[str, int]] = {}
    for line in said.splitlines():
        kind, name, number = line.split()
        found.setdefault(kind, {})[name] = int(number)
    return found


def computed(layout: StreamLayout) -> dict[str, dict[str, int]]:
    """Layout from the table, in Python."""
    found = {"head": layout.head | {"end": layout.head_size}}
    for k, (intervals, samples, hold, delay) in enumerate(OPTIONS):
        found[f"limits{k}"] = layout.limit_offsets(intervals)
        found[f"arrays{k}"] = layout.offsets(intervals, samples, hold > 0, delay)
    return found


@pytest.mark.parametrize(
    ("case", "precision"),
    [
        ("rigid", "single"),
        ("servo", "double"),
        *(
            pytest.param(case, precision, marks=pytest.mark.slow)
            for case in CASES
            for precision in ("double", "single")
            if (case, precision) not in (("rigid", "single"), ("servo", "double"))
        ),
    ],
)
def test_positions_are_those_of_the_compiled_c(
    case: str, precision: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And a position that is wrong in Python alone is seen, in each of the tables."""
    spec, written = specified(case, precision)
    layout = stream_layout(spec, written)
    found = reported(spec, emit(spec, written), layout, tmp_path)
    assert found == computed(layout)
    longer = (replace(HEAD[0], count=2), *HEAD[1:])
    wrong = (Row("bound", 9 * Name("BOUNDED")), *LIMIT_ARRAYS[1:])
    wider = tuple(
        replace(row, size=row.size * 3) if row.name == "tau" else row for row in table.ARRAYS
    )
    for module, name, planted in (
        (head, "HEAD", longer),
        (table, "LIMIT_ARRAYS", wrong),
        (table, "ARRAYS", wider),
    ):
        with monkeypatch.context() as planting:
            planting.setattr(module, name, planted)
            assert found != computed(layout), name


@pytest.mark.parametrize("case", ["rigid", pytest.param("elastic", marks=pytest.mark.slow)])
def test_a_constant_that_c_does_not_have_is_refused_by_the_compiler(
    case: str, tmp_path: Path
) -> None:
    """Planted: the header was written for a margin of four samples."""
    spec, written = specified(case, "double")
    files = emit(spec, written)
    file = f"src/{spec.name}_stream_layout.h"
    assert files[file].count("(int)MARGIN == 3") == 1
    files[file] = files[file].replace("(int)MARGIN == 3", "(int)MARGIN == 4")
    with pytest.raises(RuntimeError, match="memory_is_that_of_flexgen"):
        reported(spec, files, stream_layout(spec, written), tmp_path)


@pytest.mark.parametrize(
    "case", ["rigid", *(pytest.param(x, marks=pytest.mark.slow) for x in CASES)]
)
def test_the_stated_memory_is_that_of_the_longest_hold(case: str) -> None:
    """Not less than any, and at most a block for each array more."""
    spec, written = specified(case, "double")
    layout = stream_layout(spec, written)
    arrays = len(layout.rows(table.ARRAYS)) + len(layout.rows(LIMIT_ARRAYS))
    bound = layout.bound()
    for intervals, samples, *_ in OPTIONS:
        most = layout.offsets(intervals, samples, True, float(DELAY_MAX))["end"]
        for hold, delay in ((False, 0.0), (True, 0.0), (True, 2.5), (True, float(DELAY_MAX))):
            assert layout.offsets(intervals, samples, hold, delay)["end"] <= most
        kept = 3 * sum(layout.constants().get(x, 0) for x in ("REFERENCE", "STATES", "CONTROLS"))
        assert most <= bound.at(intervals, samples) <= most + arrays * layout.block + 2 * kept


def test_flags_are_integers() -> None:
    """All numbers of the head that are not measured are integers."""
    measured = {"period", "tolerance", "delay", "residual", "mismatch", "torque_step"}
    measured |= {"output_step", "off"}
    assert {member.name for member in HEAD if member.kind == "real"} == measured


def test_terms_are_c_and_numbers() -> None:
    n = Name("n")
    size = (n + 1) * 3 + 2 * n * Name("W")
    assert size.c() == "(n + 1) * 3 + 2 * n * W"
    assert size.value({"n": 4, "W": 5}) == 55
    assert size.value({"n": Linear(0, 1), "W": 5}) == Linear(3, 13, 0)
    with pytest.raises(TypeError, match="product of two variables"):
        size.value({"n": Linear(0, 1), "W": Linear(0, 0, 1)})
    assert Linear(3, 13, 2).at(10, 100) == 333
