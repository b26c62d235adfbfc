"""Libraries for other kinds of computers, by the package ziglang: the same bits under Wine and
QEMU.
"""

from __future__ import annotations

import json
import struct
import subprocess
import zipfile
from pathlib import Path

import clients
import pytest
from emitted import random_states
from toolchain import needs_compiler, tool, wine

import flexgen
from flexgen.cli.main import main
from flexgen.codegen.build.compiler import Compiler, find_compiler
from flexgen.runtime.inversion.targets import TARGETS, refuse_other_computer

pytest.importorskip("ziglang", reason="the package ziglang is not installed (extra compiler)")
SUPPORT = Path(__file__).resolve().parents[1] / "support" / "programs"
FEW = ("mass_matrix", "inverse_dynamics")
SEVERAL = (*FEW, "forward_dynamics", "inverse_dynamics_derivatives", "tool_motion")
slow = pytest.mark.slow
# What libraries and FMUs call of the runtime of Windows, which the package ziglang compiles for
# two minutes when it is first linked. Files that are looked at and not run are linked with these;
# `make test-full` links the real one.
RUNTIME = (
    "DllMainCRTStartup memcpy memmove memset memcmp strcmp calloc free malloc realloc ceil "
    "__fpclassify"
)


def made(target: str, folder: Path, model: str = "elbow", **options) -> Path:
    return flexgen.generate(model, folder / target, target=target, **options).directory


def linked(target: str, library: Path | None, source: Path, out: Path) -> Path:
    """A program for a target; for Linux with a C library in it, so that QEMU needs none."""
    compiler = find_compiler(target=target)
    flags = [flag.replace("linux-gnu.2.17", "linux-musl") for flag in compiler.flags]
    more = [] if library is None else [f"-I{library}", *map(str, library.glob("lib*.a"))]
    words = [*compiler.command, *flags, "-static", "-s", str(source), *more, "-lm", "-o", str(out)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:3000]
    return out


def machine_of(data: bytes) -> str:
    """The kind of computer that a shared library is for, by its first bytes."""
    if data[:4] == b"\x7fELF":
        return {62: "x86_64-linux", 183: "aarch64-linux"}[struct.unpack_from("<H", data, 18)[0]]
    if data[:2] == b"MZ":
        at = struct.unpack_from("<I", data, 60)[0]
        assert data[at : at + 4] == b"PE\0\0"
        return {0x8664: "x86_64-windows"}[struct.unpack_from("<H", data, at + 4)[0]]
    magic, kind = struct.unpack_from("<II", data)
    assert magic == 0xFEEDFACF
    return {0x01000007: "x86_64-macos", 0x0100000C: "aarch64-macos"}[kind]


@slow
@needs_compiler
@pytest.mark.parametrize(
    "functions", [SEVERAL, pytest.param(None, marks=pytest.mark.full, id="all")]
)
@pytest.mark.parametrize("target", ["x86_64-windows", "aarch64-linux"])
def test_a_program_of_another_computer_has_the_same_bits(target, functions, tmp_path):
    """Functions at random states, one by one and in batches, linked with the static library of the
    target.
    """
    runner, environment = (
        wine(tmp_path) if target == "x86_64-windows" else (tool("qemu-aarch64"), None)
    )
    model = flexgen.read("planar5_nmp")
    library = made(target, tmp_path, "planar5_nmp", functions=functions)
    manifest = clients.manifest_of(library)
    given = clients.inputs_of(manifest, random_states(model, clients.POINTS))
    (tmp_path / "client.c").write_text(clients.program(manifest), encoding="ascii")
    program = linked(target, library, tmp_path / "client.c", tmp_path / "client.exe")
    done = subprocess.run(
        [runner, str(program)], input=given, capture_output=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")[-2000:]
    own = flexgen.generate(model, tmp_path / "here", functions=functions, build=False).directory
    here = clients.built(own, tmp_path / "work", "cc", "-O2", "-ffp-contract=off")
    expected = clients.answer([str(here)], given, tmp_path)
    assert done.stdout == expected and len(expected) > 1000
    # planted: products and sums contracted, which this computer's functions then have
    if target == "x86_64-windows" and "fma" in find_compiler(native=True).instruction_sets:
        fast = clients.built(
            library,
            tmp_path / "fast",
            "cc",
            "-O2",
            "-march=native",
            "-ffp-contract=fast",
            counts=(),
        )
        assert clients.answer([str(fast)], given, tmp_path) != expected


@slow
def test_wine_loads_the_dll_and_that_of_an_fmu(tmp_path):
    runner, environment = wine(tmp_path)
    library = made("x86_64-windows", tmp_path, functions=FEW)
    loader = linked("x86_64-windows", None, SUPPORT / "load_library.c", tmp_path / "load.exe")

    def load(dll: Path, *symbols: str) -> str:
        words = [runner, str(loader), str(dll), *symbols]
        return subprocess.run(
            words, capture_output=True, text=True, env=environment, check=False
        ).stdout.strip()

    (dll,) = library.glob("*.dll")
    assert load(dll, "elbow_inverse_dynamics", "elbow_mass_matrix_batch") == "loaded"
    assert load(dll, "elbow_of_nobody") == "missing: elbow_of_nobody"
    written = flexgen.export_fmu("four_mass", tmp_path / "robot.fmu", platforms="win64")
    with zipfile.ZipFile(written.path) as archive:
        inside = Path(archive.extract("binaries/win64/four_mass.dll", tmp_path))
    assert load(inside, "fmi2Instantiate", "fmi2DoStep", "fmi2GetDerivatives") == "loaded"


@pytest.fixture
def without_runtime(monkeypatch, tmp_path):
    """Libraries for Windows are linked with functions that do nothing, named in `RUNTIME`."""
    link_command = Compiler.link_command
    found = find_compiler(target="x86_64-windows")
    source = tmp_path / "stubs.c"
    stubs = tmp_path / "stubs.obj"
    source.write_text("".join(f"int {name}(void) {{ return 1; }}\n" for name in RUNTIME.split()))
    words = [*found.command, *found.flags, "-fno-builtin", "-c", str(source), "-o", str(stubs)]
    subprocess.run(words, check=True, capture_output=True)

    def link(compiler, *words, **options):
        more = ["-nostdlib", str(stubs)] if compiler.suffix == "dll" else []
        return [
            word
            for word in link_command(compiler, *words, *more, **options)
            if not (more and word == "-lm")
        ]

    monkeypatch.setattr(Compiler, "link_command", link)


@slow
@pytest.mark.parametrize("target", TARGETS)
def test_every_target_has_a_static_and_a_shared_library(target, without_runtime, tmp_path):
    check_libraries(target, tmp_path)


@pytest.mark.full
def test_a_library_for_windows_is_linked_with_its_runtime(tmp_path):
    check_libraries("x86_64-windows", tmp_path)


def check_libraries(target, tmp_path):
    written = flexgen.generate("elbow", tmp_path / "made", target=target, functions=FEW)
    manifest = json.loads((written.directory / "manifest.json").read_text("utf-8"))["build"]
    assert manifest["target"] == target
    library = written.directory / manifest["library"]
    static = written.directory / manifest["static"]
    assert (
        library.suffix == f".{TARGETS[target].suffix}"
        and machine_of(library.read_bytes()) == target
    )
    assert static.read_bytes().startswith(b"!<arch>\n") and {library, static} <= set(written.files)
    assert str(tmp_path).encode() not in library.read_bytes()
    assert flexgen.generate("elbow", tmp_path / "made", target=target, functions=FEW).cached
    again = flexgen.generate("elbow", tmp_path / "again", target=target, functions=FEW, force=True)
    assert (again.directory / manifest["library"]).read_bytes() == library.read_bytes()


@slow
def test_an_fmu_has_binaries_for_all_platforms(without_runtime, tmp_path):
    check_platforms("3.0", tmp_path)


@pytest.mark.full
def test_an_fmu_for_windows_is_linked_with_its_runtime(tmp_path):
    check_platforms("2.0", tmp_path)


def check_platforms(version, tmp_path):
    import fmpy
    from fmpy.validation import validate_fmu

    path = tmp_path / "robot.fmu"
    words = [
        "export",
        "fmu",
        "four_mass",
        "--fmi",
        version,
        "--platforms",
        "all",
        "--out",
        str(path),
        "-q",
    ]
    assert main(words) == 0
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        found = {
            name: machine_of(archive.read(name))
            for name in archive.namelist()
            if name.startswith("binaries/")
        }
    assert found == {
        f"binaries/{target.fmi_name(version)}/four_mass.{target.suffix}": name
        for name, target in TARGETS.items()
    }
    result = fmpy.simulate_fmu(
        str(path), fmi_type="CoSimulation", stop_time=0.01, output=["motor.m1.angle"]
    )
    alone = flexgen.export_fmu("four_mass", tmp_path / "alone.fmu", version=version)
    expected = fmpy.simulate_fmu(
        str(alone.path), fmi_type="CoSimulation", stop_time=0.01, output=["motor.m1.angle"]
    )
    assert result.tobytes() == expected.tobytes() and len(result) > 2


def test_a_library_of_another_computer_is_refused():
    with pytest.raises(
        flexgen.BuildError,
        match=r"given a library for aarch64-macos, expected one for this computer",
    ):
        refuse_other_computer({"target": "aarch64-macos"})
    refuse_other_computer({"target": None})
