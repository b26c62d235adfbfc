"""The references of Python and of C, written from docstrings, from the table of functions and from
emitted headers.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from dataclasses import replace
from pathlib import Path

import flexgen
from flexgen.codegen.emission.kinematic_functions import USED
from flexgen.codegen.emission.kinematics_header import kinematics_header
from flexgen.codegen.emission.spec import library_spec
from flexgen.dynamics.mechanics.signatures import PORTS, TABLE

# Classes of the objects that verbs return and that have no name in `flexgen` itself.
RETURNED = {"flexgen.dynamics.mechanics.implicit_dae": ["ImplicitDae"]}


def _title(text: str, line: str) -> list[str]:
    return [text, line * len(text), ""]


def _entry(name: str, thing: object) -> list[str]:
    """The directive of autodoc for a public name."""
    if not inspect.isclass(thing):
        return [f".. autofunction:: {name}", ""]
    if issubclass(thing, BaseException):
        return [f".. autoexception:: {name}", "   :show-inheritance:", ""]
    return [f".. autoclass:: {name}", "   :members:", ""]


def python_reference() -> str:
    """The page of all public names of Python, in reStructuredText."""
    lines = _title("Reference of Python", "=")
    lines += [f"Version {flexgen.__version__}. All names are attributes of ``flexgen``.", ""]
    groups = {"Functions": [], "Classes": [], "Errors": []}  # type: dict[str, list[str]]
    for name in flexgen.__all__:
        thing = getattr(flexgen, name)
        if name == "__version__":
            continue
        group = (
            "Functions"
            if not inspect.isclass(thing)
            else "Errors"
            if issubclass(thing, Exception)
            else "Classes"
        )
        groups[group] += _entry(f"flexgen.{name}", thing)
    for group, entries in groups.items():
        lines += [*_title(group, "-"), *entries]
    lines += _title("Classes of results", "-")
    lines += ["Objects that the functions return.", ""]
    for module, names in RETURNED.items():
        for name in names:
            lines += [f".. autoclass:: {module}.{name}", "   :members:", ""]
    return "\n".join(lines)


# --- C -------------------------------------------------------------------------------------------
def declarations(header: str) -> dict[str, tuple[str, str]]:
    """The functions of an emitted header: name without prefix -> comment, declaration."""
    found = {}
    for comment, text in re.findall(r"/\*\n((?: \*.*\n)*?) \*/\nELBOW_API\n([^;]*;)", header):
        name = re.search(r"elbow_(\w+)\(", text)
        assert name is not None, text
        found[name[1]] = re.sub(r"^ \* ?", "", comment, flags=re.MULTILINE), text
    return found


def wrapped(declaration: str) -> str:
    """A declaration in lines that fit the page."""
    return "\n".join(
        textwrap.wrap(
            " ".join(declaration.split()), 84, subsequent_indent="    ", break_on_hyphens=False
        )
    )


def any_model(text: str) -> str:
    """Emitted text in which the name of the model is a placeholder."""
    return (
        text.replace("elbow_", "<model>_")
        .replace("ELBOW_", "<MODEL>_")
        .replace("elbow", "<model>")
    )


def _arguments(names: str, direction: str) -> list[str]:
    rows = []
    for name in names.split():
        shape, unit, meaning = PORTS[name]
        for template, word in {
            "{q}": "rad or m",
            "{tau}": "N m or N",
            "{M}": "kg m^2, kg m or kg",
            "{y}": "m or rad",
        }.items():
            unit = unit.replace(template, f"({word})" if unit != template else word)
        rows.append(f"| `{name}` | {direction} | {' x '.join(shape)} | {unit} | {meaning} |")
    return rows


def c_reference(folder: Path) -> str:
    """The page of all functions of an emitted library, in Markdown.

    Parameters
    ----------
    folder : Path
        An emitted library of the model elbow, of which the declarations are taken.
    """
    header = (folder / "elbow.h").read_text(encoding="utf-8")
    poses = _inverse_kinematics()
    inversion = (folder / "elbow_inversion.h").read_text(encoding="utf-8")
    point = declarations(header)
    lines = ["# Reference of the C library", ""]
    lines += [
        (
            "`<model>` is the name of the model file, `<MODEL>` the same in capitals. The "
            "header of a library has the same"
        ),
        (
            "text with the sizes, units and names of its robot. Declarations are those of the "
            "model `elbow`, which has no"
        ),
        (
            "coordinates without motor and no sensors; a function without a declaration here is "
            "in the libraries of models"
        ),
        "that have them, or where `--functions` names it. Matrices are",
        (
            "stored by columns. Pages: [C library](c_library.md), [limits and "
            "streams](limits_and_streams.md)."
        ),
        "",
        "## Functions of one point",
        "",
    ]
    for row in TABLE:
        lines += [f"### `{row.name}`", "", row.summary, ""]
        if row.equation:
            lines += ["```", row.equation, "```", ""]
        if row.name in point:
            lines += ["```c", wrapped(any_model(point[row.name][1])), "```", ""]
        lines += ["| array | | shape | unit | meaning |", "|---|---|---|---|---|"]
        lines += [*_arguments(row.inputs, "in"), *_arguments(row.outputs, "out"), ""]
    named = {row.name for row in TABLE}
    others = (
        {name: both for name, both in point.items() if name not in named}
        | declarations(inversion)
        | declarations(poses)
    )
    lines += ["## Paths, streams and others", ""]
    for name, (comment, text) in others.items():
        lines += [
            f"### `{name}`",
            "",
            "```c",
            wrapped(any_model(text)),
            "```",
            "",
            "```",
            any_model(comment).rstrip(),
            "```",
            "",
        ]
    for title, text in (
        ("the library", header),
        ("paths and streams", inversion),
        ("inverse kinematics", poses),
    ):
        lines += [
            f"## Types and constants of {title}",
            "",
            "```c",
            any_model(_types(text)),
            "```",
            "",
        ]
    return "\n".join(lines)


def _inverse_kinematics() -> str:
    """The header of inverse kinematics, which elbow with its two joints does not have, under the
    name elbow.
    """
    spec = library_spec(flexgen.derive("manutec_r3"), USED)
    return kinematics_header(replace(spec, name="elbow"))


def _types(header: str) -> str:
    """The part of a header before its first function, without guards and includes."""
    start = header.index('extern "C" {\n#endif\n') + 20
    return header[start : header.rindex("/*\n", start, header.index("ELBOW_API\n", start))].strip()
