"""The fixed C of the library: files of ``flexgen/codegen/clib/`` with the library's name put in,
and its inversion header.

In these files ``model_`` and ``MODEL_`` are replaced by the library's name; `render` is the only
place that replaces them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from functools import cache
from importlib.resources import files
from operator import eq, gt, ne
from types import MappingProxyType

from flexgen.base.errors import BuildError
from flexgen.codegen.emission.c_text import WIDTH, comment, declaration, macro, size_macro
from flexgen.codegen.emission.clib_types import CFunction, Enum, Field, Struct
from flexgen.codegen.emission.constants_header import (
    constants_header,
    count_elements,
    filter_sizes,
    has_bounds,
    has_growth,
    has_positions,
    is_bristled,
    is_coupled,
    is_curved,
    is_harmonic,
    is_loaded,
    space_of,
)
from flexgen.codegen.emission.interface import LIMITS
from flexgen.codegen.emission.size_terms import Linear
from flexgen.codegen.emission.spec import LibrarySpec
from flexgen.codegen.emission.stream_bounds import CALL, stream_operations
from flexgen.codegen.emission.stream_header import stream_header
from flexgen.codegen.emission.stream_layout import BLOCK, Contents, StreamLayout
from flexgen.codegen.statements.function_text import FunctionText
from flexgen.codegen.statements.literals import literal
from flexgen.dynamics.mechanics.signatures import INVERTING

FOLDER = "flexgen.codegen.clib"
# parts of one source, so that they share their functions
SOLVERS = ("bvp.c", "growth.c", "invert.c", "stream.c")
KERNEL = (
    "kernel.h",
    "kernel_functions.h",
    "private.h",
    "point.h",
    "lanes.h",
    "function.h",
    "undefine.h",
)  # of every library
_PARTS = (
    *(
        "BOUNDS",
        "COUPLED",
        "CURVED",
        "DIRECT",
        "FILTERS",
        "FORCE",
        "FURTHER",
        "HYSTERESIS",
        "HARMONICS",
    ),
    *("LIMITED", "LOAD", "LUGRE", "MEMORY", "POSITION"),
)
_IF = re.compile(r"#if (?:MODEL_)?([A-Z]+)(?: (>|==|!=) (\d+))?\n")
_COMPARE = {">": gt, "==": eq, "!=": ne}
_COMMENT = re.compile(r"(/\*.*?\*/)", re.DOTALL)
_LITERAL = re.compile(r"(?<![\w.])(?:\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+)(?![\w.])")  # of a double


@cache
def read_clib() -> dict[str, str]:
    """The texts of ``flexgen/codegen/clib/`` by file name."""
    folder = files(FOLDER)
    if not folder.is_dir():
        raise BuildError(
            f"{folder}: given no such folder, expected the C files of flexgen; install flexgen "
            "again"
        )
    found = (path for path in folder.iterdir() if path.name.endswith((".c", ".h")))
    return {
        path.name: path.read_text(encoding="ascii")
        for path in sorted(found, key=lambda path: path.name)
    }


def resolve(text: str, values: Mapping[str, int]) -> str:
    """A fixed text without the lines of conditions that these values decide, and without what they
    exclude.

    Parameters
    ----------
    text : str
    values : mapping of str to int
        By name of a macro without ``MODEL_``. Decided is ``#if`` of such a macro, or of one
        compared with a number.
    """
    lines: list[str] = []
    cut = False
    taken: list[bool | None] = []  # of the conditions around a line; None: not decided
    for line in text.splitlines(keepends=True):
        word = line[1:].split()[0] if line.startswith(("#if", "#else", "#endif")) else ""
        if word.startswith("if"):
            found = _IF.match(line)
            decided = found is not None and found[1] in values
            taken.append(
                _COMPARE[found[2] or "!="](values[found[1]], int(found[3] or 0))
                if found and decided
                else None
            )
        of_text = word == "" or taken[-1] is None
        if word == "else" and not of_text:
            taken[-1] = not taken[-1]
        if not of_text or False in taken:
            cut = True
        # no second empty line where a text is left out
        elif not cut or line != "\n" or lines[-1:] != ["\n"]:
            lines.append(line)
            cut = False
        if word == "endif":
            taken.pop()
    return "".join(lines)


def keep_parts(text: str, parts: Collection[str]) -> str:
    """A fixed text with the sections ``#if MODEL_PART`` of these parts, and what is there instead
    of the others.
    """
    return resolve(text, {part: part in parts for part in _PARTS})


def render(
    text: str,
    name: str,
    precision: str = "double",
    parts: Collection[str] = (),
    values: Mapping[str, int] = MappingProxyType({}),
) -> str:
    """A fixed text with the library's name instead of ``model``, and its literals in this
    precision.

    ``parts``: which of the parts of ``flexgen/codegen/clib/README.md`` it has; in files of exports
    also ``MEMORY``: torques with states. ``values``: of further macros, see `resolve`.
    """
    text = resolve(keep_parts(text, parts), values)
    text = re.sub(r"\bmodel(?=[_:.])", name, text)
    text = re.sub(r"\bMODEL_", f"{name.upper()}_", text)
    if precision == "double":
        return text
    parts = _COMMENT.split(text)  # code and comments in turn
    return "".join(
        _LITERAL.sub(r"\g<0>f", part) if i % 2 == 0 else part for i, part in enumerate(parts)
    )


def kernel_files(name: str, precision: str) -> dict[str, str]:
    """The private headers that every library has: numbers, vectors of numbers and their functions.

    Parameters
    ----------
    name : str
        Name of the library, which its header is called.
    precision : str
        ``"double"`` or ``"single"``.

    Returns
    -------
    dict of str to str
        Text by file name; no operation or literal of another precision.
    """
    chosen = {file: file for file in KERNEL} | {f"precision_{precision}.h": "precision.h"}
    if f"precision_{precision}.h" not in read_clib():
        raise BuildError(f"precision: given {precision!r}, expected double or single")
    return {
        f"{name}_{new}": render(read_clib()[file], name) for file, new in sorted(chosen.items())
    }


def inversion_files(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> dict[str, str]:
    """The private files of the inversion, by name; none where the library has no inversion."""
    if not spec.inverts or spec.motor_constants is None:
        return {}
    names = sorted(
        _follow_includes(
            {function.file for function in spec.declared_in("inversion") if function.file}
        )
    )
    has = {
        "BOUNDS": has_bounds(spec),
        "COUPLED": is_coupled(spec),
        "CURVED": is_curved(spec),
        "DIRECT": spec.motor_constants.massless,
        "FILTERS": any(filter_sizes(spec)),
        "FORCE": spec.force,
        "FURTHER": bool(spec.motor_constants.further),
        "HYSTERESIS": count_elements(spec) > 0,
        "HARMONICS": is_harmonic(spec),
        "LIMITED": any(struct.name == "inversion_limits" for struct in spec.structs),
        "LOAD": is_loaded(spec),
        "LUGRE": is_bristled(spec),
        "POSITION": has_positions(spec),
    }
    values = {
        "NE": spec.sizes["n_e"],
        "POSE": spec.motor_constants.pose,
        "PARAMETERS": len(spec.parameters),
        "GROWS": has_growth(spec),
        "BYTES": 8 if spec.precision == "double" else 4,
    }
    parts = [part for part in has if has[part]]
    files = {"hysteresis.h": "HYSTERESIS", "lugre.h": "LUGRE", "servo.h": "POSITION"}
    names = [name for name in names if files.get(name) in (None, *parts)]
    texts = {
        name: render(read_clib()[name], spec.name, spec.precision, parts, values) for name in names
    }
    solvers = {name: texts.pop(name) for name in SOLVERS if name in texts}
    texts |= {"inversion.c": _together(spec, solvers)} if solvers else {}
    texts["motor_constants.h"] = constants_header(spec, spec.motor_constants, written)
    if "limits.h" in texts:
        texts["stream_layout.h"] = stream_header(spec, stream_layout(spec, written))
    return {f"{spec.name}_{name}": text for name, text in sorted(texts.items())}


def _together(spec: LibrarySpec, solvers: Mapping[str, str]) -> str:
    """The source of these solvers, from which a compiler can be told to leave parts out."""
    parts = {
        macro(spec, f"WITHOUT_{name.removesuffix('.c')}"): text for name, text in solvers.items()
    }
    head = comment(
        f"{spec.name}: the solvers of inverse dynamics along paths, in one source, so that they "
        f"share their functions. With {' or '.join(f'-D{flag}' for flag in parts)} it is "
        f"compiled without this part. Written by flexgen; see {spec.name}_inversion.h."
    )
    body = "".join(f"\n#ifndef {flag}\n{text}#endif\n" for flag, text in parts.items())
    return f"/*\n{head} */\n{body}"


def _follow_includes(names: set[str]) -> set[str]:
    """These files and all that they include, without those of `KERNEL`."""
    texts = read_clib()
    more = {
        name for text in names for name in re.findall(r'#include "model_(\w+\.h)"', texts[text])
    }
    both = names | ((more & set(texts)) - set(KERNEL))
    return names if both == names else _follow_includes(both)


def inversion_header(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> str:
    """Text of ``<name>_inversion.h``."""
    name = spec.name
    guard = macro(spec, "INVERSION_H")
    limits = "".join(
        f"#define {macro(spec, row.name)} {row.value} /* {row.doc} */\n" for row in LIMITS
    )
    enums = "\n".join(_enum(spec, enum) for enum in spec.enums)
    structs = "\n".join(_struct(spec, struct) for struct in spec.structs)
    functions = "\n".join(declare(spec, function) for function in spec.declared_in("inversion"))
    return f"""\
/*
{comment(f"{name}: inverse dynamics along a path, written by flexgen. Do not edit.")} *
{
        comment(
            "invert takes a whole path. A stream takes one sample of the path per update and "
            "returns the current torques. Both give the motor torques for exact tracking of the "
            "output, also where the zero dynamics is unstable."
        )
    } */
#ifndef {guard}
#define {guard}

#include <stdint.h>

#include "{name}.h"

#ifdef __cplusplus
extern "C" {{
#endif

{limits}#define {macro(spec, "STREAM_START_SAMPLES")}(intervals) \\
    ((intervals) + {macro(spec, "STREAM_MORE_SAMPLES")}) /* of stream_start_moving */

{enums}
{_stream_macros(spec, written)}
{structs}
{functions}
#ifdef __cplusplus
}}
#endif

#endif
"""


def stream_layout(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> StreamLayout:
    """The memory of the library's streams."""
    forces = 3 * spec.sizes["n_y"] * spec.force  # with two derivatives
    own = has_positions(spec), is_bristled(spec), has_bounds(spec), is_harmonic(spec)
    stages = spec.motor_constants.coupling_stages if spec.motor_constants is not None else 0
    parts = *own, filter_sizes(spec), forces, stages * is_coupled(spec)
    has = Contents(count_elements(spec), is_curved(spec), *parts)
    space = space_of(spec, written) + BLOCK[spec.precision] + len(spec.parameters) + forces
    return StreamLayout(spec.sizes, spec.precision, has, space)


def _stream_macros(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> str:
    """Macros of the public header: recommended options of a stream, its memory, the operations of
    an update.
    """
    used = [f for f in spec.functions if f.name in INVERTING]
    layout = stream_layout(spec, written)
    more = layout.has.forces
    n_a = spec.sizes["n_a"]
    sizes = {**spec.sizes, "n_t": spec.sizes["n_t"] + more}
    arithmetic = {}
    for f in used:
        text = written[f.name]
        entries = sum(port.size for port in (*f.inputs, *f.outputs))
        arithmetic[f.name] = text.operations + (CALL - 1) * text.calls + 2 * entries + more * n_a
    most = stream_operations(sizes, arithmetic, layout.block, layout.has)

    def linear(name: str, bound: Linear) -> str:
        """A C macro ``name`` of intervals and samples per interval."""
        arguments = "intervals, samples_per_interval"
        constant, interval, sample = (
            f"INT64_C({x})" for x in (bound.constant, bound.per_interval, bound.per_sample)
        )
        value = f"{constant} + {interval} * (intervals) + {sample} * (samples_per_interval)"
        return f"#define {macro(spec, name)}({arguments}) \\\n    ({value})\n"

    lines = [
        comment(
            "Memory of a stream in reals, as a constant expression: at least stream_work.", "/* "
        ).rstrip()
        + " */\n",
        linear("STREAM_SIZE", layout.bound()),
        "/*\n",
        comment(
            "Operations of one stream_update, at most: additions, multiplications, divisions "
            "and comparisons of reals, with every iteration at its limit. A usual update needs "
            "a small part of them."
        ),
        " */\n",
        linear("STREAM_OPERATIONS", most),
    ]
    if spec.stream is not None:
        d = spec.stream
        values = (
            (
                "SLOWEST_UNSTABLE_ZERO",
                literal(d.slowest_unstable_zero, spec.precision),
                "[1/s] real part, home pose; 0: none",
            ),
            (
                "LOOK_AHEAD",
                literal(d.look_ahead, spec.precision),
                "[s] of a stream: time from a sample to the output that reaches it",
            ),
            ("STREAM_PERIOD", literal(d.period, spec.precision), "[s] from update to update"),
            ("STREAM_INTERVALS", str(d.intervals), "LOOK_AHEAD / STREAM_PERIOD"),
            (
                "STREAM_SAMPLES_PER_INTERVAL",
                str(d.samples_per_interval),
                "samples of the results per update",
            ),
            (
                "STREAM_TOLERANCE",
                literal(d.tolerance, spec.precision),
                "largest relative residual",
            ),
        )
        lines += [
            "\n/*\n",
            comment(
                f"Recommended options of a stream. The look-ahead is ln(1 / {d.share:g}) time "
                "constants of the slowest unstable zero at the home pose, and at least 10 "
                "intervals. For limits of the motors take twice as many intervals, and the "
                "time to brake."
            ),
            " */\n",
            *(f"#define {macro(spec, name)} {value} /* {doc} */\n" for name, value, doc in values),
        ]
    return "".join(lines)


def _enum(spec: LibrarySpec, enum: Enum) -> str:
    """An enumeration of the public header."""
    members = ",\n".join(
        f"    {macro(spec, f'{enum.name}_{name}')} = {k} /* {doc} */"
        for k, (name, doc) in enumerate(enum.members)
    )
    return f"/*\n{comment(enum.doc)} */\ntypedef enum {{\n{members}\n}} {spec.name}_{enum.name};\n"


def _struct(spec: LibrarySpec, struct: Struct) -> str:
    """A struct of the public header, each member with shape, unit and meaning."""
    lines = []
    for field in struct.fields:
        shape = f"{' x '.join(map(_in_brackets, field.extents))} " if field.extents else ""
        unit = f"[{field.unit}] " if field.unit not in ("", "1") else ""
        text = f"{shape}{unit}{field.doc}".strip()
        member = f"    {_declare_field(spec, field)};"
        if len(f"{member} /* {text} */") <= WIDTH:
            lines.append(f"{member} /* {text} */\n")
        else:
            wrapped = comment(text, "     * ")
            lines.append(f"    /*{wrapped[6:].rstrip()} */\n{member}\n")
    return (
        f"/* {struct.doc} */\ntypedef struct {{\n{''.join(lines)}}} {spec.name}_{struct.name};\n"
    )


def declare(spec: LibrarySpec, function: CFunction) -> str:
    """The description and the declaration of a function."""
    rows = [
        (
            a.name,
            " x ".join(map(_in_brackets, a.extents)),
            f"[{a.unit}]" if a.unit else "",
            a.doc or f"see {spec.name}_{a.base}",
        )
        for a in function.arguments
    ]
    width = [max((len(row[i]) for row in rows), default=0) for i in range(3)]
    table = "".join(
        comment(" ".join(x.ljust(w) for x, w in zip(row, [*width, 0], strict=True)), " *   ")
        for row in rows
    )
    words = function.notes
    if function.returns == "status":
        words += f"{' ' * bool(words)}Stack: at most {stack_bytes(spec)} bytes."
    notes = f" *\n{comment(words)}" if words else ""
    arguments = (
        ", ".join(_declare_field(spec, a, sized=True) for a in function.arguments) or "void"
    )
    returned = "int64_t" if function.returns == "size" else f"{spec.name}_{function.returns}"
    prototype = declaration(f"{returned} {spec.name}_{function.name}({arguments})")
    table = f" *\n{table}" if table else ""
    return (
        f"/*\n{comment(function.summary)}{notes}{table} */\n{macro(spec, 'API')}\n{prototype};\n"
    )


def stack_bytes(spec: LibrarySpec) -> int:
    """Bytes of stack that a hand-written function needs at most."""
    n_a, n_e, n_y, n_g = (spec.sizes.get(key, 0) for key in ("n_a", "n_e", "n_y", "n_g"))
    at_rest = n_a * (n_a + 4 * n_y + 3 * n_e + 16)
    zeros = 3 * n_e * (n_e + 1) + 40 * n_e  # of A, D, K at an end; or eight rows of a step
    servo = has_positions(spec) * (11 * n_g + 3 + 4 * n_g * filter_sizes(spec)[2])
    elements = count_elements(spec)  # of gears with hysteresis: arrays of lanes
    branches = (elements > 0) * (80 * (n_g + 8) + 16 * n_g) + 3 * max(0, elements - 1) * (n_g + 8)
    branches += is_curved(spec) * (elements * (n_g + 8) + 60)
    # of motors with Fourier sums: motion and factors, in points
    waves = is_harmonic(spec) * 160 * spec.sizes["n_m"]
    bristles = is_bristled(spec) * (10 * spec.sizes["n_m"] + 80)
    return (
        -(-(8 * (at_rest + zeros + branches + waves + bristles + servo) + 10_000) // 1024) * 1024
    )


def _in_brackets(extent: str) -> str:
    return f"({extent})" if " " in extent else extent


def _declare_field(spec: LibrarySpec, field: Field, sized: bool = False) -> str:
    """A member or an argument in C; ``sized``: with the size of an array where it is a
    constant.
    """
    const = "const " * field.kind.startswith("const ")
    kind = field.kind.removeprefix("const ")
    kind = const + (kind if kind.split()[0] in ("int", "int64_t") else f"{spec.name}_{kind}")
    fixed = sized and len(field.extents) == 1 and field.extents[0] in spec.sizes
    if fixed:
        return f"{kind.removesuffix(' *')} {field.name}[{size_macro(spec, field.extents[0])}]"
    return f"{kind}{field.name}" if kind.endswith("*") else f"{kind} {field.name}"
