"""From a model to a directory: cached, complete or untouched, and refused by the loader where it is not right."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
from pathlib import Path

import pytest
from emitted import (
    CC,
    ROOT,
    library_of,
    made,
    needs_compiler,
    run,
)

import flexgen
from flexgen import errors
from flexgen.codegen.build import generate
from flexgen.codegen.emit import emit
from flexgen.errors import ArgumentError, BuildError
from flexgen.mechanics.equations import derive
from flexgen.model.reader import read
from flexgen.runtime import load

pytestmark = needs_compiler


def test_the_second_time_is_instant():
    first = made("planar5_nmp")
    seconds = []
    for _ in range(3):
        again = generate("planar5_nmp", first.directory)
        assert again.cached and again.digest == first.digest and again.files == first.files
        seconds.append(again.seconds)
    assert min(seconds) < 0.05


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
        "assert not any(m == 'casadi' or m.startswith('flexgen.codegen') for m in sys.modules), 'floors'\n"
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
    (copy / "elbow_bias.c").write_text("int x;\n")
    assert not generate("elbow", copy).cached
    assert (copy / "elbow_bias.c").read_bytes() == (made("elbow").directory / "elbow_bias.c").read_bytes()
    (copy / "elbow.h").unlink()
    assert not generate("elbow", copy).cached
    assert generate("elbow", copy).cached


def change(folder: Path, **changes) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"format": 99}, "expected format 1"),
        ({"build": None}, "expected a compiled library"),
        ({"model_digest": "0" * 64}, "elbow_digest: given .*, expected 0000"),
        ({"sizes": {"n_a": 3}}, "elbow_n_a: given 2, expected 3"),
        ({"sizes": {"n_z": 3}}, "incomplete manifest"),
        ({"functions": []}, "elbow_interface: given"),
        ({"name": "x y"}, "name of the library: given 'x y'"),
        ({"motors": 5}, "incomplete manifest"),
        ({"statuses": [{"code": -1, "text": "", "exception": "sys"}]}, "expected a class of flexgen.errors"),
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
    with pytest.raises(BuildError, match=r"no readable manifest.json, expected what flexgen.generate writes"):
        load(tmp_path / "nothing")
    (copy / "manifest.json").write_text("{")
    with pytest.raises(BuildError, match="not JSON"):
        load(copy)
    assert not generate("elbow", copy).cached
    library_of(copy).unlink()
    with pytest.raises(BuildError, match="cannot be loaded"):
        load(copy)
    change(copy, build={**json.loads((copy / "manifest.json").read_text())["build"], "library": "../evil.so"})
    with pytest.raises(BuildError, match="file name"):
        load(copy)


def test_a_failed_compilation_leaves_everything_as_it_was(copy, monkeypatch, tmp_path):
    before = {path.name: path.read_bytes() for path in copy.iterdir()}
    real = emit

    def broken(spec):
        return {**real(spec), "elbow_bias.c": "int broken(void) { return; oops }\n"}

    monkeypatch.setattr("flexgen.codegen.emit.emit", broken)
    with pytest.raises(BuildError, match=r"the C compiler failed; the directory is as it was before:\n.*error"):
        generate("elbow", copy, functions=["bias", "gravity"])
    assert {path.name: path.read_bytes() for path in copy.iterdir()} == before
    load(copy)
    with pytest.raises(BuildError, match="compiler failed"):
        generate("elbow", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_compilers_are_found_and_checked(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(
        BuildError, match=r"C compiler: given none, expected cc, .*install one.* build=False .* --no-build"
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
        with pytest.raises(BuildError, match=r"\$CC: given .*, expected a command \(no closing quotation\)"):
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
    monkeypatch.setenv("CC", f"{CC} -O1")
    lines: list[str] = []
    out = generate("elbow", tmp_path / "out", functions=["gravity"], progress=lines.append)
    assert lines == ["deriving elbow", "writing elbow", "compiling 2 files", "linking"]
    assert json.loads((out.directory / "manifest.json").read_text())["build"]["flags"][0] == "-O1"
    monkeypatch.setenv("CC", str(CC))
    assert not generate("elbow", out.directory, functions=["gravity"]).cached


def test_a_new_choice_of_functions_removes_what_was_left(tmp_path):
    many = generate("elbow", tmp_path, functions=["gravity", "bias"])
    few = generate("elbow", tmp_path, functions=["gravity"])
    assert many.functions == ("bias", "gravity") and few.functions == ("gravity",)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in few.files)
    assert set(load(tmp_path).functions) == {"gravity"}
    for wrong in (["nothing"], "gravity", []):
        with pytest.raises(ArgumentError, match="functions: given"):
            generate("elbow", tmp_path, functions=wrong)


def test_equations_and_models_are_both_welcome(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    equations = derive("elbow")
    first = generate(equations, functions=["gravity"])
    assert first.directory == Path("generated/elbow") and not first.cached
    assert generate(equations.model, functions=["gravity"]).cached  # the same text: nothing to compile
    assert not generate(equations.model, functions=["gravity"], force=True).cached
    with pytest.raises(ArgumentError, match="given int, expected a model's name"):
        generate(5)
    for wrong in (5, b"folder", "a\0b", ["x"]):
        with pytest.raises(ArgumentError, match=r"directory: given .*, expected the path of a folder"):
            generate("elbow", wrong)
    variant = generate("planar5_nmp@undamped", functions=["gravity"], build=False)
    assert variant.directory == Path("generated/planar5_nmp_undamped")


def test_a_changed_field_is_a_changed_model(tmp_path):
    model = read("elbow")
    first = generate(model, tmp_path, functions=["gravity"])
    assert generate(dataclasses.replace(model, file="elsewhere.toml"), tmp_path, functions=["gravity"]).cached
    lunar = dataclasses.replace(model, gravity=tuple(x / 6 for x in model.gravity))
    second = generate(lunar, tmp_path, functions=["gravity"])
    assert second.digest != first.digest and not second.cached


def test_the_public_verbs():
    assert flexgen.generate is generate and flexgen.load is load
    for error in (errors.FlexgenError, errors.ModelError, ArgumentError, errors.SolverError, BuildError):
        assert getattr(flexgen, error.__name__) is error and error.__name__ in flexgen.__all__
