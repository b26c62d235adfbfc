"""`export_mex`: the emitted library as functions of MATLAB and GNU Octave, with their help."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping
from typing import Any

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import BuildError
from flexgen.codegen.build.template_files import template
from flexgen.codegen.emission.c_text import comment, quote
from flexgen.codegen.emission.interface import TOLERANCES
from flexgen.exports.c_code.emitted import Emitted, ModelLike, emit
from flexgen.exports.exported import Exported

PACKAGE = "flexgen.exports.c_code.mex"
WIDTH = 92  # of the help
# Words that neither language takes as a name.
KEYWORDS = frozenset(
    """
    arguments case catch classdef continue do else elseif end end_try_catch end_unwind_protect \
endclassdef
    endenumeration endevents endfor endfunction endif endmethods endparfor endproperties endspmd \
endswitch endwhile
    enumeration events for function global if methods otherwise parfor persistent properties \
return spmd switch try
    until unwind_protect unwind_protect_cleanup while
    """.split()
)


@checked_types(own=("model", "directory"))
def export_mex(
    model: ModelLike, directory: str | os.PathLike[str] | None = None, *, force: bool = False
) -> Exported:
    """Write the emitted library as a package of functions for MATLAB and GNU Octave.

    ``addpath(folder); build_<name>`` compiles it. Then ``<name>.inverse_dynamics(q_a, v_a, a_a)``
    and all other functions of one point take matrices with a column for each point;
    ``<name>.invert`` inverts a whole path, and ``<name>.Stream`` is a stream as an object.
    ``help <name>.inverse_dynamics`` shows equation, sizes and units. The results have the bits of
    the library in Python.

    Parameters
    ----------
    model : str, Path, RobotModel or Equations
    directory : str or Path, optional
        Where to write; default: ``exports/<name>_mex``.
    force : bool
        Also replace files that were changed since the export.

    Returns
    -------
    Exported

    Raises
    ------
    ModelError, ArgumentError, BuildError
        The model cannot be read, or its name is a keyword; the folder holds other files.

    Examples
    --------
    >>> print(flexgen.export_mex("elbow"))
    exports/elbow_mex
    """
    library = emit(model, parts=("limits",))
    name = library.name
    if name in KEYWORDS:
        raise BuildError(
            f"name of the model, with its variant: given {name!r}, a keyword of MATLAB or "
            "Octave, expected another name"
        )
    words = _words(library)
    texts = library.texts() | {
        f"{name}_mex.c": template(PACKAGE, "gateway.c", name),
        f"{name}_mex_table.h": _table(library),
        f"build_{name}.m": template(PACKAGE, "build.template.m", name, words),
    }
    texts |= {f"+{name}/{f['name']}.m": _function(name, f) for f in library.functions}
    if library.streams:
        texts |= {
            f"+{name}/{file}.m": template(PACKAGE, f"{source}.template.m", name, words)
            for file, source in (
                ("invert", "invert"),
                ("Stream", "stream"),
                ("options_", "options"),
            )
        }
    return library.write("mex", directory, texts, force=force)


def _words(library: Emitted) -> dict[str, str]:
    """Names and numbers of the templates; a home pose without recommended options gets those of a
    short horizon.
    """
    sizes = library.sizes
    options = library.stream
    return {
        "NAME": library.name,
        "NAMECAPITAL": library.name.upper(),
        **{
            key: str(sizes.get(f"n_{key[1].lower()}", 0))
            for key in ("NA", "NE", "NG", "NM", "NT", "NY")
        },
        "TOLERANCE": repr(TOLERANCES["double"]),
        "PERIOD": repr(options.period if options else 5e-3),
        "INTERVALS": str(options.intervals if options else 10),
        "SAMPLES": str(options.samples_per_interval if options else 5),
    }


def _function(name: str, f: Mapping[str, Any]) -> str:
    """A function of one point, with its help."""
    inputs = [p["name"] for p in f["inputs"]]
    outputs = [p["name"] for p in f["outputs"]]
    left = outputs[0] if len(outputs) == 1 else f"[{', '.join(outputs)}]"
    call = f"{left} = {name}.{f['name']} ({', '.join(inputs)})"
    lines = [f"{f['name'].upper()}  {f['summary']}", "", *_wrap(call, "  ", "      ")]
    lines += ["", *_wrap(f["equation"], "    ", "    ")] if f["equation"] else []
    rows = [(kind, p) for kind in ("inputs", "outputs") for p in f[kind]]
    wide = max(len(p["name"]) for _, p in rows)
    lines += ["", "  SI units; a matrix has a column for each of n points."]
    for kind, p in rows:
        lines += [""] * (p is f["outputs"][0])
        shape = " x ".join(map(str, (*p["shape"], "n")))
        head = (
            f"  {'in ' if kind == 'inputs' else 'out'} {p['name'].ljust(wide)}  {shape}  "
            f"[{p['unit']}]  "
        )
        lines += _wrap(head + p["doc"], "", "        ")
    text = "".join(f"%{line}".rstrip() + "\n" for line in [*_wrap(lines[0], "", "  "), *lines[1:]])
    call = f"{left} = {name}_mex ('{f['name']}', {', '.join(inputs)});"
    return (
        f"function {left} = {f['name']} ({', '.join(inputs)})\n"
        f"{text}%   Written by flexgen.\n"
        "\n"
        f"  {call}\n"
        "end\n"
    )


def _wrap(text: str, first: str, rest: str) -> list[str]:
    """Lines of a text of at most `WIDTH` characters; ``first``, ``rest``: indentation of the first
    and the other lines.
    """
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=rest,
        break_on_hyphens=False,
        drop_whitespace=True,
    )


def _table(library: Emitted) -> str:
    """The header with the functions of one point and the names of the statuses."""
    name = library.name
    text = ""
    rows = []
    for f in library.functions:
        inputs = f["inputs"]
        outputs = f["outputs"]
        names = ", ".join(quote(p["name"]) for p in inputs)
        sizes = ", ".join(str(p["shape"][0]) for p in inputs)
        heights = ", ".join(str(p["shape"][0]) for p in outputs)
        widths = ", ".join(str(p["shape"][1]) if len(p["shape"]) == 2 else "0" for p in outputs)
        arguments = [f"in[{i}]" for i in range(len(inputs))] + [
            f"out[{i}]" for i in range(len(outputs))
        ]
        arguments += ["work"] if f["work"] else []
        own = f["name"]
        text += f"""\
static const char *const {own}_in[] = {{{names}}};
static const int {own}_size[] = {{{sizes}}}, {own}_rows[] = {{{heights}}}, {own}_columns[] = \
{{{widths}}};
static {name}_status call_{own}(const double *const *in, double *const *out, double *work)
{{
    (void)work;
    return {name}_{own}({", ".join(arguments)});
}}

"""
        rows.append(
            f"    {{{quote(own)}, {len(inputs)}, {len(outputs)}, {own}_in, {own}_size, "
            f"{own}_rows, {own}_columns, call_{own}}},\n"
        )
    statuses = "".join(
        f"    {{{s['code']}, {quote(s['name'])}}},\n" for s in library.manifest["statuses"]
    )
    head = comment(
        f"{name}: functions of one point. Written by flexgen; included by {name}_mex.c."
    )
    return (
        "/*\n"
        f"{head} */\n"
        f"{text}static const point_function POINT_FUNCTIONS[] = {{\n"
        f"{''.join(rows)}}};\n"
        "\n"
        "static const status_name STATUS_NAMES[] = {\n"
        f"{statuses}}};\n"
    )
