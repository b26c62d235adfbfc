"""Function blocks for a PLC: the XML has the structure of PLCopen TC6 2.01, and its variables are
those of the C.

The bodies are driven through a struct that is made from the XML alone. No PLC is tested.
"""

from __future__ import annotations

import ctypes
import re
import subprocess
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from emitted import loaded, random_states
from exports import library_object, without_streams
from remembering import check, compiled, remembering, samples, start
from toolchain import STRICT, needs_compiler, tool

import flexgen
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.cli.main import main
from flexgen.exports.c_code.selftest.motion import targets

NAME = "planar5_nmp"
TC6 = "{http://www.plcopen.org/xml/tc6_0201}"
XHTML = "{http://www.w3.org/1999/xhtml}"

# The part of tc6_xml_v201.xsd that the files use: attributes that an element must have, and its
# children in order: "?" at most one, "*" any number, "+" at least one, nothing: exactly one.
SCHEMA = {
    "project": ("", "fileHeader contentHeader types instances addData? documentation?"),
    "fileHeader": ("companyName productName productVersion creationDateTime", ""),
    "contentHeader": ("name", "Comment? coordinateInfo addDataInfo? addData?"),
    "coordinateInfo": ("", "pageSize? fbd ld sfc"),
    "fbd": ("", "scaling"),
    "ld": ("", "scaling"),
    "sfc": ("", "scaling"),
    "scaling": ("x y", ""),
    "types": ("", "dataTypes pous"),
    "dataTypes": ("", "dataType*"),
    "pous": ("", "pou*"),
    "pou": ("name pouType", "interface? actions? transitions? body* addData? documentation?"),
    "interface": ("", "returnType? inputVars? outputVars? localVars? addData? documentation?"),
    "inputVars": ("", "variable*"),
    "outputVars": ("", "variable*"),
    "localVars": ("", "variable*"),
    "variable": ("name", "type initialValue? addData? documentation?"),
    "type": ("", "LREAL? DINT? BOOL? array?"),
    "array": ("", "dimension+ baseType"),
    "dimension": ("lower upper", ""),
    "baseType": ("", "LREAL? DINT? BOOL?"),
    "body": ("", "ST"),
    "instances": ("", "configurations"),
    "configurations": ("", "configuration*"),
    **{name: ("", "") for name in ("LREAL", "DINT", "BOOL")},
}
TEXTS = {"ST", "documentation"}  # their content is one element of XHTML
KEYWORDS = set(
    """
    abs and any array bool by byte case const date dint do dword else elsif end_case end_for \
end_function_block end_if
    end_repeat end_struct end_type end_var end_while exit false for from function function_block \
if int lint lreal
    lword mod not of on or program read real repeat retain return sint step string struct task \
then time to true type
    udint uint ulint until usint var var_input var_output while with word write xor
    """.split()
)


def structure_errors(element: ElementTree.Element) -> list[str]:
    """Where an element or one below it is not as in `SCHEMA`."""
    name = element.tag.removeprefix(TC6)
    if not element.tag.startswith(TC6):
        return [f"{element.tag}: another namespace"]
    if name in TEXTS:
        good = (
            len(element) == 1
            and element[0].tag.startswith(XHTML)
            and (element[0].text or "").strip()
        )
        return [] if good else [f"{name}: expected one element of XHTML with a text"]
    if name not in SCHEMA:
        return [f"{name}: unknown"]
    attributes, children = SCHEMA[name]
    errors = [
        f"{name}: no attribute {word}" for word in attributes.split() if word not in element.attrib
    ]
    pattern = "".join(
        f"(?:{w.rstrip('?*+')} ){w[-1] if w[-1] in '?*+' else ''}" for w in children.split()
    )
    found = "".join(f"{child.tag.removeprefix(TC6)} " for child in element)
    if not re.fullmatch(pattern, found):
        errors.append(f"{name}: given {found or 'nothing'}, expected {children or 'nothing'}")
    return errors + [error for child in element for error in structure_errors(child)]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plcopen")
    flexgen.export_plcopen(NAME, folder)
    return folder


def declared(folder: Path, name: str = NAME) -> dict[str, list[tuple[str, str, int]]]:
    """Variables (name, type, size) of every block in the XML, in order."""
    out = {}
    for pou in ElementTree.parse(folder / f"{name}.xml").iter(f"{TC6}pou"):
        rows = []
        for v in pou.iter(f"{TC6}variable"):
            (kind,) = v.find(f"{TC6}type")
            size = 0
            if kind.tag == f"{TC6}array":
                size = int(kind.find(f"{TC6}dimension").get("upper")) + 1
                (kind,) = kind.find(f"{TC6}baseType")
            rows.append((v.get("name"), kind.tag.removeprefix(TC6), size))
        out[pou.get("name")] = rows
    return out


def struct_of(rows) -> type[ctypes.Structure]:
    """The struct of a block, from its declaration."""
    kinds = {"BOOL": ctypes.c_uint8, "DINT": ctypes.c_int32, "LREAL": ctypes.c_double}
    fields = [(name, kinds[kind] * size if size else kinds[kind]) for name, kind, size in rows]
    return type("Block", (ctypes.Structure,), {"_fields_": fields})


@pytest.fixture(scope="module")
def bodies(made):
    """The bodies, compiled."""
    cc = tool("gcc")
    sources = [made / f"{NAME}_fb.c", made / f"{NAME}_stream_fb.c"]
    command = [
        cc,
        *STRICT,
        "-O0",
        "-shared",
        "-fPIC",
        "-I",
        made,
        *sources,
        library_object(NAME)[1],
    ]
    subprocess.run([*command, "-o", made / "fb.so"], check=True)
    return ctypes.CDLL(str(made / "fb.so"))


def test_the_xml_has_the_structure_of_tc6(made):
    assert structure_errors(ElementTree.parse(made / f"{NAME}.xml").getroot()) == []


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ('companyName=""', "", "fileHeader: no attribute companyName"),
        ("    <dataTypes/>\n", "", "types: given pous"),
        ("<sfc>", '<scaling x="1" y="1"/><sfc>', "coordinateInfo"),
        ('<variable name="y">', "<variable>", "variable: no attribute name"),
        ("tc6_0201", "tc6_0200", "another namespace"),
        ("<baseType><LREAL/></baseType>", "<LREAL/>", "array: given dimension LREAL"),
    ],
)
def test_planted_errors_of_the_structure_are_seen(made, old, new, error):
    text = (made / f"{NAME}.xml").read_text(encoding="ascii")
    assert old in text
    assert any(
        error in found
        for found in structure_errors(ElementTree.fromstring(text.replace(old, new)))
    )


def test_text_and_xml_declare_the_same(made):
    text = (made / f"{NAME}.st").read_text(encoding="ascii")
    plain = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
    found = {}
    for block in re.finditer(r"FUNCTION_BLOCK (\w+)(.*?)END_FUNCTION_BLOCK", plain, re.DOTALL):
        rows = re.findall(r"(\w+) : (?:ARRAY \[0\.\.(\d+)\] OF )?(\w+);", block[2])
        found[block[1]] = [
            (name, kind, int(upper) + 1 if upper else 0) for name, upper, kind in rows
        ]
    assert found == declared(made)
    assert list(found) == [f"FB_{NAME}_inverse_dynamics", f"FB_{NAME}_stream"]
    for block, rows in found.items():
        for name in (block, *(row[0] for row in rows)):
            assert (
                re.fullmatch(r"[A-Za-z]([A-Za-z0-9]|_(?!_|$))*", name)
                and name.lower() not in KEYWORDS
            )
        assert len({row[0].lower() for row in rows}) == len(rows)
    assert text.count("(*") == text.count("*)")


@needs_compiler
@pytest.mark.slow
def test_inverse_dynamics_has_the_bits_of_python(made, bodies):
    block = struct_of(declared(made)[f"FB_{NAME}_inverse_dynamics"])()
    call = bodies[f"fb_{NAME}_inverse_dynamics_call"]
    library = loaded(NAME)
    states = random_states(flexgen.read(NAME), 10)
    for k in range(10):
        given = [states[x][k] for x in ("q_a", "v_a", "a_a")]
        block.q_a[:], block.v_a[:], block.a_a[:] = given
        call(ctypes.byref(block))
        assert np.array_equal(block.tau_a[:], library.inverse_dynamics(*given))
        assert (block.valid, block.error, block.status) == (1, 0, 0)
    last = block.tau_a[:]
    block.q_a[0] = np.nan
    call(ctypes.byref(block))
    assert (block.valid, block.error, block.status) == (0, 1, -2) and block.tau_a[:] == last


@needs_compiler
@pytest.mark.slow
def test_the_stream_has_the_bits_of_python(made, bodies):
    rows = declared(made)[f"FB_{NAME}_stream"]
    block = struct_of(rows)()
    call = bodies[f"fb_{NAME}_stream_call"]
    library = loaded(NAME)
    path = flexgen.plan(NAME)
    sample = path.sample(np.arange(130) * 5e-3)
    y = targets(sample)
    dy = sample.derivative(1)
    ddy = sample.derivative(2)
    for attempt in range(2):  # the second one after enable was FALSE
        stream = library.stream(
            y[0], path.q_start, period=5e-3, intervals=10, samples_per_interval=5, hold="zoh"
        )
        block.enable = 0
        call(ctypes.byref(block))
        assert (block.valid, block.error, block.status) == (0, 0, 0)
        block.enable = 1
        block.start_output[:] = y[0]
        block.q_start[:] = path.q_start
        for k in range(1, 130):
            if k == 60:  # a sample that is refused changes nothing
                block.y[:] = [np.nan, 0.0]
                call(ctypes.byref(block))
                assert (block.valid, block.error, block.status) == (0, 1, -2)
            block.y[:] = y[k]
            block.dy[:] = dy[k]
            block.ddy[:] = ddy[k]
            call(ctypes.byref(block))
            now = stream.update(y[k], dy[k], ddy[k])
            assert block.valid == 1 and block.error == 0, (attempt, k)
            for name in ("tau_m", "q_m", "v_m"):
                assert np.array_equal(getattr(block, name)[:], getattr(now, name).ravel()), (
                    name,
                    k,
                )
    block.enable = 0
    call(ctypes.byref(block))
    block.enable = 1
    block.start_output[:] = [9.0, 9.0]
    for _ in range(2):
        call(ctypes.byref(block))
        assert (block.valid, block.error, block.status) == (0, 1, -7)  # until enable is FALSE


@needs_compiler
@pytest.mark.slow
def test_a_planted_error_of_the_struct_is_seen(made, tmp_path):
    """Two outputs that are swapped in the header only."""
    for path in made.iterdir():
        if path.suffix in (".c", ".h"):
            (tmp_path / path.name).write_bytes(path.read_bytes())
    header = tmp_path / f"{NAME}_fb.h"
    text = header.read_text(encoding="ascii")
    header.write_text(
        text.replace("double q_m[10];", "double X[10];")
        .replace("double tau_m[10];", "double q_m[10];")
        .replace("double X[10];", "double tau_m[10];"),
        encoding="ascii",
    )
    command = [
        tool("gcc"),
        "-std=c99",
        "-shared",
        "-fPIC",
        tmp_path / f"{NAME}_stream_fb.c",
        library_object(NAME)[1],
    ]
    subprocess.run([*command, "-o", tmp_path / "fb.so"], check=True)
    block = struct_of(declared(made)[f"FB_{NAME}_stream"])()
    path = flexgen.plan(NAME)
    y = targets(path.sample(np.zeros(1)))[0]
    block.enable = 1
    block.y[:] = y
    block.start_output[:] = y
    block.q_start[:] = path.q_start
    ctypes.CDLL(str(tmp_path / "fb.so"))[f"fb_{NAME}_stream_call"](ctypes.byref(block))
    now = loaded(NAME).stream(
        y, path.q_start, period=5e-3, intervals=10, samples_per_interval=5, hold="zoh"
    )
    assert not np.array_equal(block.tau_m[:], now.update(y, y * 0, y * 0).tau_m.ravel())


def torques_with_memory(folder: Path, forgets: str = "") -> np.ndarray:
    """Of the stream of a robot with memory, which starts twice (2, n, n_m)."""
    command = [
        tool("gcc"),
        *STRICT,
        "-O0",
        "-shared",
        "-fPIC",
        "-I",
        folder,
        folder / "elbow_stream_fb.c",
    ]
    made = folder / f"{forgets}fb.so"
    subprocess.run([*command, compiled(forgets), "-o", made], check=True)
    block = struct_of(declared(folder, "elbow")["FB_elbow_stream"])()
    call = ctypes.CDLL(str(made)).fb_elbow_stream_call
    block.start_output[:], block.q_start[:] = start()
    found = []
    for _ in range(2):
        block.enable = 0
        call(ctypes.byref(block))
        block.enable = 1
        for y, dy, ddy in zip(*samples(), strict=True):
            block.y[:] = y
            block.dy[:] = dy
            block.ddy[:] = ddy
            call(ctypes.byref(block))
            assert block.valid == 1
            found.append(block.tau_m[:])
    return np.reshape(found, (2, -1, 2))


@pytest.mark.slow
@needs_compiler
def test_gears_and_motors_with_memory_have_the_torques_of_solve(tmp_path):
    """Each start begins without torques of hysteresis and bristles; what an update forgets is
    seen.
    """
    flexgen.export_plcopen(remembering(), tmp_path)
    first, again = torques_with_memory(tmp_path)
    assert np.array_equal(first, again)
    check(lambda forgets: torques_with_memory(tmp_path, forgets)[0], "zoh")


def test_models_without_streams_and_names(tmp_path):
    with pytest.raises(ArgumentError, match="a robot without streams, because"):
        flexgen.export_plcopen(without_streams(), tmp_path)
    model = replace(flexgen.read(NAME), name="arm_")
    with pytest.raises(BuildError, match="without an underscore at its end"):
        flexgen.export_plcopen(model, tmp_path)
    assert not list(tmp_path.iterdir())
    flexgen.export_plcopen(without_streams(), tmp_path, stream=False)
    assert (
        not (tmp_path / "elbow_stream_fb.c").exists()
        and "stream" not in (tmp_path / "elbow.st").read_text().lower()
    )


def test_the_bytes_are_the_same(tmp_path):
    first, second = (flexgen.export_plcopen(NAME, tmp_path / name) for name in "ab")
    assert [p.read_bytes() for p in first.files] == [p.read_bytes() for p in second.files]


def test_the_command_line(tmp_path, capsys):
    assert main(["export", "plcopen", NAME, "--out", str(tmp_path), "-q"]) == 0
    assert f"{NAME}.xml" in capsys.readouterr().out
