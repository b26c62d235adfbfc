"""The hand-written C: each file compiles on its own, its README lists every file, its comments are
plain.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from bristled import bristled
from emitted import ROOT, _folder, run
from hysteretic import hysteretic
from toolchain import CC, needs_compiler, tool

from flexgen.codegen.emission.clib_files import SOLVERS, read_clib, resolve
from flexgen.codegen.emission.emit import emit
from flexgen.codegen.emission.interface import PARTS
from flexgen.codegen.emission.spec import library_spec
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.position_servo.keys import GAINS, ServoTable
from flexgen.model.reader import read

CLIB = ROOT / "flexgen" / "codegen" / "clib"
FILES = sorted(path.name for path in CLIB.iterdir() if path.suffix in (".c", ".h"))
# parts of other files
MACROS = {"kernel_functions.h", "precision_double.h", "precision_single.h"}
OF_SERVOS = ("servo.h", "position_samples.c")
PRIVATE_WORDS = re.compile(
    r"\b(twists?|twisted|fades?|fading|bends?|bent|told|tells?|uneven(ness)?|slopes?|felt|dear|"
    r"calm|spoil(s|ed)?|drawn|judged?|referee|crowd|stranger|slow "
    r"motion|non-actuated|metres?|neighbours?|lineari[s]e|minimi[s]e)\b",
    re.IGNORECASE,
)


@cache
def library(name: str, kind: str = "") -> Path:
    """The sources of a library, with what ``kind`` says: the fixed ones, renamed."""
    folder = _folder() / f"{name}_clib_{kind}"
    model = hysteretic(name) if kind == "hysteresis" else read(name)
    if kind == "lugre":
        model = bristled(name, {"m1": {"coulomb": 0.5, "stiffness": 800.0}})
    if kind == "servo":
        gains = {x: (1.0,) * model.n_m for x in GAINS}
        model = replace(model, servo=ServoTable("cascade", **gains))
    for file, text in emit(library_spec(derive(model), parts=PARTS)).items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text, encoding="ascii")
    return folder


@needs_compiler
@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("elbow", ""),
        ("elbow", "hysteresis"),
        ("elbow", "lugre"),
        ("elbow", "servo"),
        ("planar5_nmp", ""),
        ("planar5_nmp", "servo"),
    ],
)
def test_every_file_compiles_on_its_own(name, kind):
    folder = library(name, kind)
    failed = []
    for file in ["inversion.c", *(file for file in FILES if file not in SOLVERS)]:
        path = folder / "src" / f"{name}_{file}"
        if file in MACROS:
            continue
        # of models with unactuated coordinates, six motors, gears with hysteresis, a servo
        if not path.exists():
            assert name == "elbow" or file in (
                "inverse_kinematics.c",
                "hysteresis.h",
                "lugre.h",
                *OF_SERVOS,
            ), file
            assert file != f"{kind}.h" and not (kind == "servo" and file in OF_SERVOS)
            continue
        words = [
            CC,
            "-std=c99",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-fsyntax-only",
            "-x",
            "c",
            f"-I{folder}",
        ]
        text = f'#include "{path}"\n' if path.suffix == ".h" else path.read_text(encoding="ascii")
        done = subprocess.run(
            [*words, "-I", folder / "src", "-"],
            input=text,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            failed.append((file, done.stderr[:600]))
    assert not failed, failed


NESTED = """\
a
#if MODEL_NE > 0
b
#if defined(X)
c
#else
d
#endif
#else /* MODEL_NE */
e
#if MODEL_POSE
f
#endif
#endif
g
"""


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"NE": 2, "POSE": 1}, "a b #if defined(X) c #else d #endif g"),
        ({"NE": 0, "POSE": 1}, "a e f g"),
        ({"NE": 0, "POSE": 0}, "a e g"),
        (
            {"POSE": 0},
            "a #if MODEL_NE > 0 b #if defined(X) c #else d #endif #else /* MODEL_NE */ e #endif g",
        ),
    ],
)
def test_conditions_are_decided_where_their_values_are_known(values, expected):
    assert " ".join(resolve(NESTED, values).split()) == expected


@pytest.mark.parametrize(
    ("text", "BYTES", "kept"), [("== 8", 8, True), ("== 8", 4, False), ("!= 8", 4, True)]
)
def test_conditions_compare(text, BYTES, kept):
    assert resolve(f"#if BYTES {text}\na\n#endif\n", {"BYTES": BYTES}) == "a\n" * kept


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp"])
def test_sources_have_no_condition_that_the_model_decides(name):
    text = "".join(path.read_text(encoding="ascii") for path in (library(name) / "src").iterdir())
    assert re.findall(r"#if (?!LANES|WORK|FLT_EVAL)[A-Z].*", text) == []


@needs_compiler
def test_a_solver_is_left_out_where_a_macro_says_so(tmp_path):
    command = [
        CC,
        "-std=c99",
        "-c",
        "-O0",
        library("elbow") / "src" / "elbow_inversion.c",
        "-o",
        "inversion.o",
    ]
    run(*command, "-DELBOW_WITHOUT_INVERT", folder=tmp_path)
    symbols = set(run(tool("nm"), "-g", "--defined-only", "inversion.o", folder=tmp_path).split())
    assert "elbow_stream_update" in symbols and "elbow_invert" not in symbols


def test_the_readme_names_every_file():
    readme = (CLIB / "README.md").read_text(encoding="utf-8")
    assert sorted(read_clib()) == FILES
    assert not [file for file in FILES if f"`{file}`" not in readme]


@pytest.mark.parametrize("file", FILES)
def test_comments_are_plain(file):
    comments = " ".join(
        re.findall(r"/\*.*?\*/", (CLIB / file).read_text(encoding="ascii"), re.DOTALL)
    )
    found = sorted({match[0].lower() for match in PRIVATE_WORDS.finditer(comments)})
    assert not found


def test_a_private_word_would_be_found():
    assert PRIVATE_WORDS.search("how a gear twists") and not PRIVATE_WORDS.search(
        "deflection of a gear"
    )
