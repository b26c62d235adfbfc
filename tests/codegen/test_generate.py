"""From a model to a directory: cached, complete or untouched, and refused by the loader where it
is not right.
"""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from clients import manifest_of
from emitted import ROOT, library_of, made, run
from toolchain import CC, needs_compiler

import flexgen
from flexgen.base import errors
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.codegen.build.compiler import find_compiler
from flexgen.codegen.build.generate import generate
from flexgen.codegen.build.object_cache import Objects, cache_folder, one_at_a_time
from flexgen.codegen.emission.emit import emit
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.reader import read
from flexgen.runtime import load
from flexgen.runtime.identity import FORMAT

X86 = platform.machine().lower() in ("x86_64", "amd64")

pytestmark = needs_compiler


@pytest.mark.slow
def test_a_second_generation_writes_and_compiles_nothing():
    first = made("planar5_nmp")
    times = [path.stat().st_mtime_ns for path in first.files]
    again = generate("planar5_nmp", first.directory)
    assert (
        again.cached
        and not again.written
        and again.digest == first.digest
        and again.files == first.files
    )
    assert [path.stat().st_mtime_ns for path in first.files] == times


@pytest.mark.slow
def test_a_cached_library_needs_no_casadi():
    folder = made("elbow").directory
    program = (
        "import sys, flexgen\n"
        f"made = flexgen.generate('elbow', {str(folder)!r})\n"
        "flexgen.load(made.directory).gravity([0.0, 0.0])\n"
        "assert made.cached and 'casadi' not in sys.modules\n"
    )
    run(sys.executable, "-c", program, folder=ROOT)


def test_the_runtime_imports_neither_casadi_nor_codegen():
    program = (
        "import sys, flexgen.runtime\n"
        "assert not any(m == 'casadi' or m.startswith('flexgen.codegen.emission') for m in "
        "sys.modules), 'floors'\n"
    )
    run(sys.executable, "-c", program, folder=ROOT)


@pytest.fixture
def copy(tmp_path):
    """A library that a test may spoil."""
    return Path(shutil.copytree(made("elbow").directory, tmp_path / "copy"))


def test_tampering_is_detected_and_mended(copy):
    library = library_of(copy)
    library.write_bytes(library.read_bytes() + b"x")
    with pytest.raises(BuildError, match=r"given SHA-256 .* generate it again"):
        load(copy)
    again = generate("elbow", copy)
    assert not again.cached
    load(copy)
    (copy / "src" / "elbow_bias.c").write_text("int x;\n")
    assert not generate("elbow", copy).cached
    assert (copy / "src" / "elbow_bias.c").read_bytes() == (
        made("elbow").directory / "src" / "elbow_bias.c"
    ).read_bytes()
    (copy / "elbow.h").unlink()
    assert not generate("elbow", copy).cached
    assert generate("elbow", copy).cached


def change(folder: Path, **changes) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"format": 99}, f"expected format {FORMAT}"),
        ({"build": None}, "expected a compiled library"),
        ({"model_digest": "0" * 64}, "elbow_digest: given .*, expected 0000"),
        ({"sizes": {"n_a": 3}}, "elbow_n_a: given 2, expected 3"),
        ({"sizes": {"n_z": 3}}, "incomplete manifest"),
        ({"functions": []}, "elbow_interface: given"),
        ({"name": "x y"}, "name of the library: given 'x y'"),
        ({"motors": 5}, "incomplete manifest"),
        (
            {"statuses": [{"code": -1, "text": "", "exception": "sys"}]},
            "expected a class of flexgen.base.errors",
        ),
    ],
)
def test_a_manifest_that_does_not_fit_is_refused(copy, changes, told):
    change(copy, **changes)
    with pytest.raises(BuildError, match=told):
        load(copy)


def test_a_shape_that_the_library_does_not_have_is_refused(copy):
    functions = json.loads((copy / "manifest.json").read_text())["functions"]
    functions[0]["inputs"][0]["shape"] = [1]
    change(copy, functions=functions)
    with pytest.raises(BuildError, match="elbow_interface"):
        load(copy)


def test_missing_and_broken_directories_are_explained(tmp_path, copy):
    with pytest.raises(
        BuildError, match=r"no readable manifest.json, expected what flexgen.generate writes"
    ):
        load(tmp_path / "nothing")
    (copy / "manifest.json").write_text("{")
    with pytest.raises(BuildError, match="not JSON"):
        load(copy)
    assert not generate("elbow", copy).cached
    library_of(copy).unlink()
    with pytest.raises(BuildError, match="cannot be loaded"):
        load(copy)
    change(
        copy,
        build={
            **json.loads((copy / "manifest.json").read_text())["build"],
            "library": "../evil.so",
        },
    )
    with pytest.raises(BuildError, match="file name"):
        load(copy)


def test_a_failed_compilation_leaves_everything_as_it_was(copy, monkeypatch, tmp_path):
    before = {path.name: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    real = emit

    def broken(spec, *more):
        return {**real(spec, *more), "src/elbow_bias.c": "int broken(void) { return; oops }\n"}

    monkeypatch.setattr("flexgen.codegen.emission.emit.emit", broken)
    with pytest.raises(
        BuildError, match=r"the C compiler failed; the directory is as it was before:\n.*error"
    ):
        generate("elbow", copy, functions=["bias", "gravity"])
    assert {path.name: path.read_bytes() for path in copy.rglob("*") if path.is_file()} == before
    load(copy)
    with pytest.raises(BuildError, match="compiler failed"):
        generate("elbow", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_compilers_are_found_and_checked(monkeypatch, tmp_path):
    monkeypatch.setattr("flexgen.codegen.build.compiler.packaged_compiler", lambda: None)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(
        BuildError,
        match=r"C compiler: given none, expected cc, .*install one.* build=False .* --no-build",
    ):
        generate("elbow", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    made = generate("elbow", tmp_path / "out", build=False)
    assert made.files and made.cached and made.written
    assert not generate("elbow", tmp_path / "out", build=False).written
    with pytest.raises(BuildError, match="given sources only"):
        load(tmp_path / "out")
    monkeypatch.setenv("CC", "no_such_compiler")
    with pytest.raises(BuildError, match=r"\$CC: given 'no_such_compiler'"):
        generate("elbow", tmp_path / "out")
    for text in (f"{CC} 'x", '"'):
        monkeypatch.setenv("CC", text)
        with pytest.raises(
            BuildError, match=r"\$CC: given .*, expected a command \(no closing quotation\)"
        ):
            generate("elbow", tmp_path / "out")
    broken = tmp_path / "broken"
    broken.write_text("no program")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(BuildError, match="which cannot be run"):
        generate("elbow", tmp_path / "out")
    monkeypatch.setenv("CC", f"{CC} -fplugin=evil.so")
    with pytest.raises(BuildError, match=r"given the flag '-fplugin=evil\.so'"):
        generate("elbow", tmp_path / "out")


def test_the_chosen_compiler_is_used(monkeypatch, tmp_path):
    monkeypatch.setenv("FLEXGEN_CACHE", "")  # objects of an earlier run of the tests are not taken
    monkeypatch.setenv("CC", f"{CC} -O1")
    lines: list[str] = []
    out = generate("elbow", tmp_path / "out", functions=["gravity"], progress=lines.append)
    assert lines == ["deriving elbow", "writing elbow", "compiling 2 files", "linking"]
    levels = [
        flag for flag in manifest_of(out.directory)["build"]["flags"] if flag.startswith("-O")
    ]
    assert levels == ["-O2", "-O1"]  # the last has priority
    monkeypatch.setenv("CC", str(CC))
    lines.clear()
    assert not generate(
        "elbow", out.directory, functions=["gravity"], progress=lines.append
    ).cached
    # the sources are there: nothing is derived
    assert lines[0].startswith("compiling") and lines[-1] == "linking"
    for text in (f"{CC} -g", f"{CC} -O2 -Wl,-rpath,x", f"{CC} -include x.h", f"{CC} @file"):
        monkeypatch.setenv("CC", text)
        with pytest.raises(BuildError, match=r"\$CC: given"):
            generate("elbow", tmp_path / "out")


@pytest.mark.slow
def test_options_of_the_build_are_kept_apart(tmp_path):
    """Each has its flags in the manifest and is compiled anew; the sources of another precision
    are others.
    """
    seen = set()
    for options in (
        {},
        {"native": True},
        {"isa": "x86-64"},
        {"openmp": True},
        {"precision": "single"},
        {"parameters": ["payload"]},
    ):
        if ("openmp" in options and not has_openmp()) or ("isa" in options and not X86):
            continue
        out = generate("elbow", tmp_path, functions=["gravity"], **options)
        assert (
            not out.cached and generate("elbow", tmp_path, functions=["gravity"], **options).cached
        )
        manifest = manifest_of(tmp_path)
        built = manifest["build"]
        assert manifest["precision"] == options.get("precision", "double")
        assert (
            ("-march=native" in built["flags"])
            == (built["isa"] == "native")
            == ("isa" not in options)
        )
        assert built["native"] == options.get("native", False)
        assert ("-fopenmp" in built["flags"]) == built["openmp"] == options.get("openmp", False)
        assert ("-ffp-contract=off" in built["flags"]) != built["native"]
        assert ("-fopenmp" in (tmp_path / "elbow.pc").read_text()) == built["openmp"]
        seen.add((out.digest, built["identity"]))
    assert len(seen) >= 3
    for wrong in ("payload", [3]):
        with pytest.raises(
            ArgumentError, match=r"parameters: given .*, expected a sequence of names"
        ):
            generate("elbow", tmp_path, parameters=wrong)
    with pytest.raises(ArgumentError, match="parameters: given together with equations"):
        generate(derive("elbow"), tmp_path, parameters=["payload"])
    with pytest.raises(
        ArgumentError, match="precision: given 'half', expected one of double, single"
    ):
        generate("elbow", tmp_path, precision="half")


def has_openmp() -> bool:
    try:
        return find_compiler(openmp=True) is not None
    except BuildError:
        return False


def test_sources_only_keep_the_library_that_fits_them(tmp_path):
    first = generate("elbow", tmp_path, functions=["gravity"])
    assert not generate("elbow", tmp_path, functions=["gravity"], build=False).written
    assert library_of(tmp_path) in first.files
    other = generate("elbow", tmp_path, functions=["bias"], build=False)
    assert other.written and not {".so", ".a", ".dylib"} & {
        path.suffix for path in tmp_path.iterdir()
    }


# --- the cache of objects ------------------------------------------------------------------------
@pytest.fixture
def objects(tmp_path, monkeypatch):
    folder = tmp_path / "objects"
    monkeypatch.setenv("FLEXGEN_CACHE", str(folder))
    return folder


def compiled(folder: Path, **options) -> str:
    """The progress line of `generate` about compiling."""
    lines: list[str] = []
    generate("elbow", folder, functions=["gravity"], progress=lines.append, **options)
    return next(line for line in lines if line.startswith("compiling"))


def test_objects_are_compiled_once_for_all_directories(tmp_path, objects):
    assert compiled(tmp_path / "a") == "compiling 2 files"
    assert compiled(tmp_path / "b") == "compiling 0 files, 2 known"
    assert [
        path.read_bytes() for path in sorted((tmp_path / "a").rglob("*")) if path.is_file()
    ] == [path.read_bytes() for path in sorted((tmp_path / "b").rglob("*")) if path.is_file()]
    assert compiled(tmp_path / "b", force=True) == "compiling 2 files"
    assert compiled(tmp_path / "c", native=True) == "compiling 2 files"
    assert compiled(tmp_path / "d", precision="single") == "compiling 2 files"
    assert stat.S_IMODE(objects.stat().st_mode) == 0o700
    assert all(
        len(path.stem) == 64 and path.suffix == ".o"
        for path in objects.iterdir()
        if path.name != "locks"
    )


def test_two_processes_that_need_the_same_library_compile_it_once(tmp_path, objects):
    code = "import sys; from flexgen.codegen.build.generate import generate\n"
    code += "generate('elbow', sys.argv[1], functions=['gravity'], progress=print)"
    with one_at_a_time(cache_folder(), "elbow"):  # until both of them are there
        processes = [
            subprocess.Popen(
                [sys.executable, "-u", "-c", code, str(tmp_path / name)],
                stdout=subprocess.PIPE,
                text=True,
            )
            for name in "ab"
        ]
        waited = [[process.stdout.readline() for _ in range(3)] for process in processes]
    assert all(said[-1] == "waiting for another process that compiles elbow\n" for said in waited)
    said = sorted(process.communicate(timeout=60)[0].splitlines()[0] for process in processes)
    assert said == ["compiling 0 files, 2 known", "compiling 2 files"]


def keys(
    folder: Path, headers: dict[str, bytes], text: str = '#include "a.h"\n  # include "sub/b.h"\n'
) -> str:
    (folder / "one.c").write_text(text)
    return Objects("compiler", headers)._key(folder / "one.c")


def test_an_object_depends_on_what_its_source_includes(tmp_path, objects):
    """Directly or not; a header that it does not include changes nothing, one that is not known
    makes all count.
    """
    headers = {"a.h": b'#include "c.h"\n', "sub/b.h": b"", "c.h": b"int c;\n", "d.h": b"int d;\n"}
    key = keys(tmp_path, headers)
    assert keys(tmp_path, {**headers, "d.h": b"int e;\n"}) == key
    for name in ("a.h", "sub/b.h", "c.h"):
        assert keys(tmp_path, {**headers, name: headers[name] + b"/**/"}) != key
    unknown = '#include "x.h"\n'
    assert keys(tmp_path, {**headers, "d.h": b""}, unknown) != keys(tmp_path, headers, unknown)
    assert Objects("other compiler", headers)._key(tmp_path / "one.c") != keys(
        tmp_path, headers, unknown
    )
    assert Objects("compiler", headers, lambda name: ["-O3"])._key(tmp_path / "one.c") != keys(
        tmp_path, headers, unknown
    )


@pytest.mark.parametrize("spoil", ["cut", "changed", "swapped", "empty"])
def test_corrupted_objects_are_rejected(spoil, tmp_path, objects):
    compiled(tmp_path / "a")
    one, two = sorted(objects.glob("*.o"))
    first = one.read_bytes()
    second = two.read_bytes()
    one.write_bytes(
        {"cut": first[:-9], "changed": first[:-1] + b"\1", "swapped": second, "empty": b""}[spoil]
    )
    assert compiled(tmp_path / "b") == "compiling 1 files, 1 known"
    assert one.read_bytes() == first
    assert library_of(tmp_path / "b").read_bytes() == library_of(tmp_path / "a").read_bytes()


def test_a_cache_that_others_can_write_to_is_refused(tmp_path, objects, monkeypatch):
    objects.mkdir()
    for mode in (0o770, 0o707, 0o777, 0o1777):
        objects.chmod(mode)
        with pytest.raises(
            BuildError,
            match=r"FLEXGEN_CACHE: given .* that you alone can write to \(others can write",
        ):
            compiled(tmp_path / "a")
    below = tmp_path / "open"
    below.mkdir()
    below.chmod(0o777)
    monkeypatch.setenv("FLEXGEN_CACHE", str(below / "objects"))
    with pytest.raises(BuildError, match=r"a folder that every user may write \(mode 777\)"):
        compiled(tmp_path / "a")
    below.chmod(0o700)
    assert compiled(tmp_path / "a") == "compiling 2 files"


def test_without_a_home_there_is_no_cache(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.delenv("FLEXGEN_CACHE")
    for home in (file, file / "below"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(home))
        assert cache_folder() is None
        assert compiled(tmp_path / "a", force=True) == "compiling 2 files"
    monkeypatch.setenv("FLEXGEN_CACHE", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cache_folder() is None and not (tmp_path / "cache").exists()
    monkeypatch.delenv("FLEXGEN_CACHE")
    assert cache_folder() == (tmp_path / "cache" / "flexgen").resolve()


def test_the_size_of_the_cache_is_bounded(tmp_path, objects, monkeypatch):
    compiled(tmp_path / "a")
    size = sum(path.stat().st_size for path in objects.glob("*.o"))
    for path in objects.glob("*.o"):
        os.utime(path, (1e9, 1e9))
    old = set(objects.glob("*.o"))
    monkeypatch.setattr("flexgen.codegen.build.object_cache.LIMIT", size)
    compiled(tmp_path / "b", precision="single")
    kept = set(objects.glob("*.o"))
    assert sum(path.stat().st_size for path in kept) <= size and not kept >= old


def test_folders_in_the_cache_of_objects_stay(tmp_path, objects, monkeypatch):
    """The libraries of the solvers are in there as well; the objects next to them are removed
    nevertheless.
    """
    compiled(tmp_path / "a")
    for path in objects.glob("*.o"):
        os.utime(path, (1e9, 1e9))
    old = set(objects.glob("*.o"))
    library = objects / "libraries" / "elbow"
    library.mkdir(parents=True)
    (library / "manifest.json").write_text("{}")
    os.utime(objects / "libraries", (1e8, 1e8))  # before everything else
    monkeypatch.setattr("flexgen.codegen.build.object_cache.LIMIT", 1)
    compiled(tmp_path / "b", precision="single")
    assert not any(path.exists() for path in old) and (library / "manifest.json").exists()


def test_a_new_choice_of_functions_removes_old_files(tmp_path):
    many = generate("elbow", tmp_path, functions=["gravity", "bias"])
    few = generate("elbow", tmp_path, functions=["gravity"])
    assert many.functions == ("bias", "gravity") and few.functions == ("gravity",)
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == sorted(few.files)
    assert set(load(tmp_path).functions) == {"gravity"}
    for wrong in (["nothing"], "gravity", []):
        with pytest.raises(ArgumentError, match="functions: given"):
            generate("elbow", tmp_path, functions=wrong)


def test_equations_and_models_are_accepted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    equations = derive("elbow")
    first = generate(equations, functions=["gravity"])
    assert first.directory == Path("generated/elbow") and not first.cached
    lines: list[str] = []
    # the same text
    assert generate(equations.model, functions=["gravity"], progress=lines.append).cached
    assert lines and not [line for line in lines if line.startswith("compiling")]
    assert not generate(equations.model, functions=["gravity"], force=True).cached
    with pytest.raises(ArgumentError, match="given int, expected a name"):
        generate(5)
    for wrong in (5, b"folder", "a\0b", ["x"]):
        with pytest.raises(
            ArgumentError, match=r"directory: given .*, expected the path of a folder"
        ):
            generate("elbow", wrong)
    variant = generate("planar5_nmp@undamped", functions=["gravity"], build=False)
    assert variant.directory == Path("generated/planar5_nmp_undamped")


def test_a_changed_field_is_a_changed_model(tmp_path):
    model = read("elbow")
    first = generate(model, tmp_path, functions=["gravity"])
    assert generate(
        dataclasses.replace(model, file="elsewhere.toml"), tmp_path, functions=["gravity"]
    ).cached
    lunar = dataclasses.replace(model, gravity=tuple(x / 6 for x in model.gravity))
    second = generate(lunar, tmp_path, functions=["gravity"])
    assert second.digest != first.digest and not second.cached


def test_the_public_verbs():
    assert flexgen.generate is generate and flexgen.load is load
    for error in (
        errors.FlexgenError,
        errors.ModelError,
        ArgumentError,
        errors.SolverError,
        BuildError,
    ):
        assert getattr(flexgen, error.__name__) is error and error.__name__ in flexgen.__all__
