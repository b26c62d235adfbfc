"""Hostile names and flags: none of them reaches a file, C or a shell."""

from __future__ import annotations

from dataclasses import replace

import pytest
from bad_models import GOOD
from emitted import ROOT, run
from toolchain import CC, needs_compiler
from unchecked import unchecked

from flexgen.base.errors import ArgumentError, BuildError, FlexgenError, ModelError
from flexgen.base.spec.sensors import Sensor
from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.path_header import path_header
from flexgen.model.moves import Program
from flexgen.model.reader import read
from flexgen.paths.path import plan
from flexgen.views.reports.view import view

pytestmark = needs_compiler

HOSTILE = [
    "",
    " ",
    "a b",
    "9arm",
    "_arm",
    "a" * 32,
    "two__scores",
    "arm;",
    "x; int evil",
    "x(){}",
    "a,b",
    "arm\\n",
    "arm\\nint evil;",
    "arm\\r",
    "arm\\t",
    "arm\\u0000",
    "arm\\u001b[2J",
    'arm\\"',
    "arm'",
    "*/",
    "arm*/int evil;/*",
    "//",
    "arm\\\\",
    "arm??/",
    "??=define",
    "#include",
    "$(id)",
    "`id`",
    "%s%n",
    "{name}",
    "../arm",
    "../../etc/passwd",
    "/etc/passwd",
    "arm/..",
    ".",
    "..",
    "C:arm",
    "-o",
    "@file",
    "ärm",
    "\u0430rm",  # a Cyrillic letter
    "\uff41rm",  # a wide letter
    "arm\u200b",
    "arm\u202e",
]
RESERVED = [
    "int",
    "while",
    "class",
    "template",
    "sin",
    "malloc",
    "printf",
    "main",
    "errno",
    "NULL",
]
PLACES = {
    "model": 'name = "robot"',
    "coordinate": 'name = "q2"',
    "element": 'name = "second"',
    "motor": 'name = "m1"',
    "move": 'name = "line"',
}


@pytest.mark.parametrize("place", PLACES)
def test_hostile_names_in_a_model_file_are_refused(place, tmp_path):
    path = tmp_path / "hostile.toml"
    assert len(HOSTILE + RESERVED) >= 40
    for name in HOSTILE + RESERVED * (place == "model"):  # the others are not identifiers in C
        path.write_text(GOOD.replace(PLACES[place], f'name = "{name}"', 1), encoding="utf-8")
        with pytest.raises(ModelError) as caught:
            read(path)
        assert "\n" not in str(caught.value) and "\x1b" not in str(caught.value)


def test_hostile_names_of_variants_are_refused(tmp_path):
    path = tmp_path / "hostile.toml"
    for name in HOSTILE:
        path.write_text(
            GOOD.replace("[variant.stiff]", f'[variant."{name}"]', 1), encoding="utf-8"
        )
        with pytest.raises(ModelError):
            read(path)
    path.write_text(GOOD)
    for name in HOSTILE[2:]:  # asked for, as in robot@name
        with pytest.raises(FlexgenError):
            read(path, name.encode().decode("unicode_escape") if name.isascii() else name)


def test_hostile_names_of_objects_made_in_python_are_refused():
    """Exporters, reports and C take names from these objects only."""
    model = read("planar5_nmp")
    plain = Sensor(
        "acc",
        "accelerometer",
        "tool",
        (0.0,) * 3,
        ((1.0, 0.0, 0.0),),
        ("x",),
        0.0,
        None,
        0.0,
        "m/s^2",
    )
    first = model.elements[0]
    dof = model.elements[0].dofs[0]
    makers = (
        lambda name: replace(model, name=name),
        lambda name: replace(model, variant=name or " "),
        lambda name: replace(
            model, motors=(replace(model.motors[0], name=name), *model.motors[1:])
        ),
        lambda name: replace(model, elements=(replace(first, name=name), *model.elements[1:])),
        lambda name: replace(
            model, elements=(replace(first, dofs=(replace(dof, name=name),)), *model.elements[1:])
        ),
        lambda name: replace(model, sensors=(replace(plain, name=name),)),
    )
    for name in [*HOSTILE, "a\nb", "a\0b", "a\x1b[2J", "a\n"]:
        for made in makers:
            with pytest.raises(ArgumentError, match=r"(name|variant): given"):
                made(name)
    assert all(made("fine") for made in makers)


@pytest.mark.parametrize(
    "name", [None, 1, b"arm", ["arm"], "", "a\nb", "a\0b", "a\x1b[2J", "a\u202e", "a" * 101]
)
def test_names_of_moves_are_printable_texts(name):
    with pytest.raises(ArgumentError, match=r"move.name: given .* expected a printable text"):
        replace(read("elbow").moves[0], name=name)
    with pytest.raises(ArgumentError, match=r"move.name: given .* expected a printable text"):
        Program(name=name, start=(0.0, 0.0))
    assert replace(read("elbow").moves[0], name="two words, 1/2").name


@pytest.mark.parametrize(
    "name",
    ["*/ int evil; /*", '"><script>evil()</script>', "--><script>evil()</script>", "a\\", "??/"],
)
def test_names_of_moves_are_escaped_in_c_and_pages(name, tmp_path):
    model = read("elbow")
    path = plan(model, replace(model.moves[0], name=name))
    (tmp_path / "path.h").write_text(
        path_header(model, path.move.name, path.table(), path.duration)
    )
    (tmp_path / "use.c").write_text('#include "path.h"\nint main(void) { return 0; }\n')
    words = [
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-Wno-unused",
        "-trigraphs",
        f"-I{ROOT / 'generated' / 'elbow'}",
    ]
    run(CC, *words, "use.c", folder=tmp_path)
    view(model, tmp_path / "page.html", move=path.move)
    assert "<script>evil" not in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize(
    "name",
    [
        "math",
        "stdio",
        "string",
        "Math",
        "omp",
        "m",
        "c",
        "pthread",
        "gcc",
        "example",
        "con",
        "aux",
        "nul",
    ],
)
def test_a_model_with_the_name_of_an_emitted_file_is_refused(name, tmp_path):
    """Its header or its library would be found instead of the system's, its file would be
    another's.
    """
    path = tmp_path / "model.toml"
    path.write_text(
        (ROOT / "models" / "elbow.toml")
        .read_text()
        .replace('name = "elbow"', f'name = "{name}"', 1)
    )
    with pytest.raises((BuildError, ModelError), match="expected a name that"):
        generate(path, tmp_path / "out", functions=["gravity"], build=False)
    assert not (tmp_path / "out").exists()


def test_a_name_with_its_variant_is_not_too_long(tmp_path):
    path = tmp_path / "model.toml"
    text = (ROOT / "models" / "elbow.toml").read_text()
    name = "a" * 20
    variant = "b" * 20
    path.write_text(
        f"{text.replace('elbow', name, 1)}\n"
        f"[variant.{variant}]\n"
        'set = { "motor.m1.inertia" = 0.02 }\n'
    )
    with pytest.raises((BuildError, ModelError, ArgumentError), match="at most 30"):
        generate(read(path, variant), tmp_path / "out", functions=["gravity"], build=False)


def test_names_reach_file_names_only_after_the_check(tmp_path):
    """A model made in Python with a path for its name, past the constructor's check, writes
    nothing anywhere.
    """
    model = read("elbow")
    for name in ("../evil", "/evil", "a/b", "..", "a\0b"):
        with pytest.raises(BuildError, match="name of the model"):
            generate(
                unchecked(model, name=name), tmp_path / "out", functions=["gravity"], build=False
            )
    assert list(tmp_path.iterdir()) == []


def test_flags_from_outside_do_not_reach_a_shell(tmp_path, monkeypatch):
    witness = tmp_path / "witness"
    for text in (
        f"{CC} -wrapper touch,{witness}",
        f"{CC};touch {witness}",
        f"{CC} $(touch {witness})",
    ):
        monkeypatch.setenv("CC", text)
        with pytest.raises(BuildError, match=r"\$CC: given"):
            generate("elbow", tmp_path / "out", functions=["gravity"])
    assert not witness.exists()
