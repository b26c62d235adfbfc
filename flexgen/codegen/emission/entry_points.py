"""The source of one emitted function: its entry points for one point and for many, and its
mathematics.
"""

from __future__ import annotations

import textwrap

from flexgen.base.errors import BuildError
from flexgen.base.spec.ports import Port
from flexgen.codegen.emission.c_text import (
    WIDTH,
    batch_prototype,
    declaration,
    macro,
    prototype,
)
from flexgen.codegen.emission.header import tile
from flexgen.codegen.emission.spec import FunctionSpec, LibrarySpec
from flexgen.codegen.statements.function_text import FunctionText

# Inputs, and outputs, of a function at most: ``ARRAYS`` of ``clib/function.h``.
ARRAYS = 16


def mathematics(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """Text of ``<name>_<function>_math.h``, without an include guard: it is included for one point
    and for lanes of points.
    """
    return (
        f"/* {spec.name}: mathematics of {f.name}, for T a number and for T lanes of numbers. */\n"
        f"{written.text}"
    )


def source(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """Text of ``<name>_<function>.c``: the functions that a caller finds; loops over points and
    checks of results are those of ``clib/function.h``.
    """
    if max(len(f.inputs), len(f.outputs)) > ARRAYS:
        raise BuildError(
            f"function {f.name}: given {len(f.inputs)} inputs and {len(f.outputs)} outputs, "
            f"expected at most {ARRAYS} of each; join some of them"
        )
    name = spec.name
    return f"""\
/* {name}: {f.name}. Written by flexgen; see {name}.h. */
#include "{name}_function.h"

#include "{name}_point.h"
#include "{name}_{f.name}_math.h"

#include "{name}_lanes.h"
#include "{name}_{f.name}_math.h"

#include "{name}_undefine.h"

{_shape(spec, f, written)}
{_of_lanes(spec, f, written)}
{_of_one(spec, f, written)}
{_for_many(spec, f)}"""


def _shape(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """The C struct with the sizes of a function's arrays: numbers of inputs and outputs, the input
    that all points share (-1: none), reals of workspace, points of a tile, then the length of each
    array.
    """
    ports = (*f.inputs, *f.outputs)
    shared = next((i for i, port in enumerate(f.inputs) if _is_shared(spec, port)), -1)
    sizes = ", ".join(
        " * ".join(str(spec.sizes.get(extent, extent)) for extent in f.extents[port.name])
        for port in ports
    )
    numbers = (len(f.inputs), len(f.outputs), shared, written.work, tile(f, spec.precision))
    start = f"static const function_shape {f.name}_shape = "
    values = declaration(f"    {', '.join(map(str, numbers))}, {{{sizes}}}")
    return f"{start}{{\n{values}}};\n"


def _of_lanes(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """The loop over lanes of points, for `evaluate_points`."""
    arguments = [
        f"{array}{'' if _is_shared(spec, port) else ' + k'}" for array, port in _places(f)
    ]
    arguments += ["work"] * (written.work > 0) + ["n"]
    call = declaration(f"        zero += {f.name}_evaluate_v({', '.join(arguments)})")
    head = declaration(
        f"static lanes {f.name}_lanes(const real *const *in, real *const *out, lanes *work, "
        "int count, ptrdiff_t n)"
    )
    return f"""\
{head}
{{
    lanes zero = splat_v(0);
{_ignore(written)}    for (int k = 0; k < count; k += LANES) {{
{call};
    }}
    return zero;
}}
"""


def _of_one(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """The public function for one point, and its form for `evaluate_points`."""
    ports = (*f.inputs, *f.outputs)
    work = ["work"] * (written.work > 0)
    missing = textwrap.fill(
        " || ".join(f"{given}\0==\0NULL" for given in [*(p.name for p in ports), *work]),
        WIDTH - len("    if () {"),
        subsequent_indent=" " * 8,
    ).replace("\0", " ")
    given = ", ".join([*(port.name for port in ports), *work])
    kept = ", ".join([*(array for array, _ in _places(f)), *work])
    ok = macro(spec, "OK")
    head = declaration(
        f"static int {f.name}_one(const real *const *in, real *const *out, real *work)"
    )
    return f"""\
{prototype(spec, f, written.work)}
{{
    if ({missing}) {{
        return {macro(spec, "NULL_ARGUMENT")};
    }}
{declaration(f"    if ({f.name}_evaluate_1({given}) == 0) {{")}
        return {ok};
    }}
    {{
{_lists(f, "        ")}        return first_failed(&{f.name}_shape, in, out, 1, 1);
    }}
}}

{head}
{{
{_ignore(written)}{declaration(f"    return {spec.name}_{f.name}({kept}) != {ok}")};
}}
"""


def _for_many(spec: LibrarySpec, f: FunctionSpec) -> str:
    """The public functions for many points."""
    given = ", ".join(port.name for port in (*f.inputs, *f.outputs))
    evaluated = declaration(
        f"    return evaluate_points(&{f.name}_shape, {f.name}_one, {f.name}_lanes, in, out, n, "
        "stride, work)"
    )
    batch = declaration(f"    return {spec.name}_{f.name}_batch_strided(n, n, {given}, work)")
    return f"""\
{batch_prototype(spec, f, True)}
{{
{_lists(f, "    ")}{evaluated};
}}

{batch_prototype(spec, f)}
{{
{batch};
}}
"""


def _places(f: FunctionSpec) -> list[tuple[str, Port]]:
    """The arrays in the lists of inputs and outputs, such as ``in[0]``, with their ports."""
    inputs = [(f"in[{i}]", port) for i, port in enumerate(f.inputs)]
    return inputs + [(f"out[{i}]", port) for i, port in enumerate(f.outputs)]


def _lists(f: FunctionSpec, indent: str) -> str:
    """Definitions of the lists of the inputs and of the outputs."""
    inputs = ", ".join(port.name for port in f.inputs)
    outputs = ", ".join(port.name for port in f.outputs)
    return (
        declaration(f"{indent}const real *const in[] = {{{inputs}}}")
        + ";\n"
        + declaration(f"{indent}real *const out[] = {{{outputs}}}")
        + ";\n"
    )


def _ignore(written: FunctionText) -> str:
    """The statement that a function without workspace does not use it."""
    return "" if written.work > 0 else "    (void)work;\n"


def _is_shared(spec: LibrarySpec, port: Port) -> bool:
    """True of the parameters where one array is for all points."""
    return bool(spec.parameters) and not spec.per_point and port.name == "parameters"
