"""The hand-written C of the library: whole paths and streams inverted by the emitted functions.

The texts lie in ``flexgen/clib/``, real C in which ``model_`` and ``MODEL_`` stand for the library's name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files

from flexgen.codegen.c_text import comment, declaration
from flexgen.codegen.clib_table import Argument, CFunction, Drives
from flexgen.codegen.spec import LibrarySpec
from flexgen.errors import BuildError
from flexgen.expressions.function_text import literal

FOLDER = "flexgen.clib"


@cache
def templates() -> dict[str, str]:
    """The hand-written texts by file name."""
    folder = files(FOLDER)
    if not folder.is_dir():
        raise BuildError(f"{folder}: given no such folder, expected the C files of flexgen; install flexgen again")
    found = (path for path in folder.iterdir() if path.name.endswith((".c", ".h")))
    return {path.name: path.read_text(encoding="ascii") for path in sorted(found, key=lambda path: path.name)}


def core_texts(spec: LibrarySpec) -> dict[str, str]:
    """All files of the library's cores, ``<name>_invert.c`` and others, by name; none where it has no core."""
    if not spec.cores or spec.drives is None:
        return {}
    names = sorted(_included({core.file for core in spec.cores}))
    out = {f"{spec.name}_{name}": _named(templates()[name], spec) for name in names}
    return {f"{spec.name}_drives.h": drives_header(spec, spec.drives), **out}


def _included(names: set[str]) -> set[str]:
    """These texts and all that they include, and so on."""
    texts = templates()
    more = {name for text in names for name in re.findall(r'#include "model_(\w+\.h)"', texts[text])}
    both = names | (more & set(texts))
    return names if both == names else _included(both)


def core_macros(spec: LibrarySpec) -> str:
    """Definitions of the cores' own sizes, for the header."""
    lines = [macro for core in spec.cores for macro in core.macros]
    return "".join(f"#define {spec.name.upper()}_{name} {value} /* {doc} */\n" for name, value, doc in lines)


def core_prototypes(spec: LibrarySpec) -> str:
    """The part of the header that describes and declares the cores."""
    return "\n".join(_described(spec, core) for core in spec.cores)


def _described(spec: LibrarySpec, core: CFunction) -> str:
    rows = [
        (
            a.kind if a.kind != "kept" else "",
            a.name,
            " x ".join(map(_in_brackets, a.extents)),
            f"[{a.unit}]" if a.unit else "",
            a.doc,
        )
        for a in core.arguments
    ]
    width = [max(len(row[i]) for row in rows) for i in range(4)]
    table = "".join(
        comment(" ".join(x.ljust(w) for x, w in zip(row, [*width, 0], strict=True)), " *   ") for row in rows
    )
    words = core.notes
    if core.returns == "status":
        words += f"{' ' * bool(words)}Stack: at most {stack_bytes(spec)} bytes."
    notes = f" *\n{comment(words)}" if words else ""
    arguments = ", ".join(_declared(spec, a) for a in core.arguments)
    returned = "int" if core.returns == "status" else "int64_t"
    prototype = declaration(f"{returned} {spec.name}_{core.name}({arguments})")
    return f"/*\n{comment(core.summary)}{notes} *\n{table} */\n{spec.name.upper()}_API\n{prototype};\n"


def stack_bytes(spec: LibrarySpec) -> int:
    """Bytes of stack that a core needs at most: small matrices for rest and its zeros, and those of its steps."""
    n_a, n_e, n_y = (spec.sizes[key] for key in ("n_a", "n_e", "n_y"))
    at_rest = n_a * (n_a + 4 * n_y + 3 * n_e + 16)
    zeros = 3 * n_e * (n_e + 1) + 40 * n_e  # of A, D, K at an end; or eight rows of a step
    return -(-(8 * (at_rest + zeros) + 10_000) // 1024) * 1024


def _in_brackets(extent: str) -> str:
    return f"({extent})" if " " in extent else extent


def _declared(spec: LibrarySpec, argument: Argument) -> str:
    number = f"{spec.name}_real" if argument.number == "real" else argument.number
    if not argument.extents:
        return f"{number} {argument.name}"
    return f"{'const ' if argument.kind == 'in' else ''}{number} *{argument.name}"


def _named(text: str, spec: LibrarySpec) -> str:
    """A hand-written text with the library's name in the place of ``model``."""
    text = re.sub(r"\bmodel(?=[_:.])", spec.name, text)
    return re.sub(r"\bMODEL_", f"{spec.name.upper()}_", text)


def drives_header(spec: LibrarySpec, drives: Drives) -> str:
    """Text of ``<name>_drives.h``: numbers of the model as constants."""

    def listed(values: Sequence[float]) -> str:
        return f"{{{', '.join(literal(x, spec.precision) for x in values)}}}"

    def integers(name: str, size: str, values: Sequence[int]) -> str:
        return f"static const int {name}[{size}] = {{{', '.join(str(int(x)) for x in values)}}};\n"

    prefix = spec.name.upper()
    ng, nm = f"{prefix}_NG", f"{prefix}_NM"
    text = integers("i_g", ng, drives.i_g)
    text += integers("i_e", f"{prefix}_NE", drives.i_e) if drives.i_e else integers("i_e", "1", [0])  # none is read
    text += integers("gear_is_rigid", ng, [int(x) for x in drives.gear_is_rigid])
    text += integers("gear_is_linear", ng, [int(x) for x in drives.gear_is_linear])
    text += f"static const real gear_damping[{ng}] = {listed(drives.gear_damping)}; /* arm side */\n"
    for name, A, rows, columns in (("eta", drives.eta, nm, ng), ("eta_inverse", drives.eta_inverse, ng, nm)):
        body = ",\n".join(f"    {listed(row)}" for row in A)
        text += f"static const real {name}[{rows}][{columns}] = {{\n{body}}};\n"
    text += f"static const real rotor_inertia[{nm}] = {listed(drives.rotor_inertia)};\n"
    return f"""\
/*
 * {spec.name}: gears, motors and the kind of output, for the inversion; private. Written by flexgen; see {spec.name}.h.
 */
#ifndef {prefix}_DRIVES_H
#define {prefix}_DRIVES_H

#include "{spec.name}_private.h"

#define {prefix}_POSE {int(drives.pose)} /* the output is a pose: position, then rotation */

/* Coordinates with and without motor; q_m = eta q_g where no gear is twisted. */
{text}
#endif
"""
