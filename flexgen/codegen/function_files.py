"""The C files of the library: checks and entry points around the mathematics, the facade, the example."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flexgen.codegen.c_text import batch_head, batch_prototype, count_of, macro, prototype, quoted, size_macro
from flexgen.codegen.header import tile
from flexgen.codegen.interface import ABI_VERSION, STATUSES
from flexgen.codegen.spec import FunctionSpec, LibrarySpec
from flexgen.expressions.function_text import FunctionText
from flexgen.expressions.literals import literal
from flexgen.ports import Port

PAST_CACHE = 2**23  # bytes of results that are written past the cache
WAYS = 24  # lines that a set of the first cache may hold, about; more results at once push each other out


def facade(spec: LibrarySpec) -> str:
    """Text of ``<name>.c``: identity and sizes of the library."""
    cases = "".join(f"    case {macro(spec, s.name)}:\n        return {quoted(s.text)};\n" for s in STATUSES)
    values = {
        "abi_version": str(ABI_VERSION),
        "sizeof_real": f"(int)sizeof({spec.name}_real)",
        "sizeof_int": "(int)sizeof(int)",
        "work": macro(spec, "WORK"),
        **{name: size_macro(spec, name) for name in spec.sizes},
    }
    functions = "\n".join(
        f"int {spec.name}_{name}(void)\n{{\n    return {value};\n}}\n" for name, value in values.items()
    )
    parameters = ""
    if spec.parameters:
        lines = "".join(
            f"    parameters[{k}] = {literal(p.value, spec.precision)}; /* {p.name} */\n"
            for k, p in enumerate(spec.parameters)
        )
        parameters = f"void {spec.name}_parameters({spec.name}_real *parameters)\n{{\n{lines}}}\n\n"
    return f"""\
/* {spec.name}: identity and sizes of the library. Written by flexgen; see {spec.name}.h. */
#include "{spec.name}_batch.h"

#ifdef _OPENMP
#include <omp.h>
#endif

const char *{spec.name}_status_text(int status)
{{
    switch (status) {{
{cases}    default:
        return "unknown status";
    }}
}}

const char *{spec.name}_digest(void)
{{
    return {quoted(spec.digest)};
}}

const char *{spec.name}_interface(void)
{{
    return "{spec.interface}";
}}

{parameters}{functions}
int {spec.name}_batch_work(void)
{{
#ifdef _OPENMP
    return {macro(spec, "BATCH_WORK")} * omp_get_max_threads();
#else
    return {macro(spec, "BATCH_WORK")};
#endif
}}
"""


def body(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """Text of ``<name>_<function>_body.h``: the mathematics, without a guard, as it is included twice."""
    return (
        f"/* {spec.name}: {f.name}, the mathematics; included for T a real and for T lanes of reals. "
        f"Written by flexgen. */\n{written.text}"
    )


def source(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """Text of ``<name>_<function>.c``: the checks around the mathematics, for one point and for many."""
    name = f"{spec.name}_{f.name}"
    return f"""\
/* {spec.name}: {f.name}. Written by flexgen; see {spec.name}.h. */
#include "{spec.name}_batch.h"

#include "{spec.name}_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "{spec.name}_point.h"
#include "{name}_body.h"

#include "{spec.name}_lanes.h"
#include "{name}_body.h"

{_failed(spec, f, _counts(spec, f))}
{_one_point(spec, f, written)}
{_many_points(spec, f, written)}
#include "{spec.name}_undefine.h"
"""


def _counts(spec: LibrarySpec, f: FunctionSpec) -> dict[str, str]:
    """Number of entries of each port, in C."""
    return {port.name: count_of(spec, f, port) for port in (*f.inputs, *f.outputs)}


def _null(names: Sequence[str]) -> str:
    """The condition that one of the pointers is null."""
    return " || ".join(f"{name} == NULL" for name in names)


def _one_point(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """The function for one point."""
    names = [port.name for port in (*f.inputs, *f.outputs)]
    work = ["work"] if written.work else []
    return f"""\
{prototype(spec, f, written.work)}
{{
    if ({_null([*names, *work])}) {{
        return {macro(spec, "NULL_ARGUMENT")};
    }}
    if ({f.name}_evaluate_1({", ".join([*names, *work])}) == 0) {{
        return {macro(spec, "OK")};
    }}
    return {f.name}_failed({", ".join(names)}, 1, 1);
}}
"""


def _many_points(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """The functions for many points."""
    ports = (*f.inputs, *f.outputs)
    given = ", ".join([*(port.name for port in ports), "work"])
    names, sizes = [port.name for port in ports], _counts(spec, f)
    stored = [port for port in ports if not _shared(spec, port)]  # one for each point
    points = tile(f, spec.precision)
    arguments = [f"at_{port.name} + k" if port in stored else port.name for port in ports]
    arguments += ["(lanes *)space"] if written.work else []
    return f"""\
/* Points of arrays whose entries are `stride` apart. */
static SEPARATE {batch_head(spec, f, f"{f.name}_many", True)}
{{
    /* Arrays are copied where columns of results share the same cache lines or do not fit the cache, and for the last
       points. */
    const int past = (size_t)n * sizeof(real) > {PAST_CACHE // sum(port.size for port in f.outputs)};
    const int collide = {_collide(f, spec)};
    const int groups = n < 0 ? 0 : n / {points} + (n % {points} != 0);
    int bad = 0;
    if (n < 0) {{
        return {macro(spec, "BAD_COUNT")};
    }}
    if ({_null([*names, "work"])}) {{
        return {macro(spec, "NULL_ARGUMENT")};
    }}
#ifdef _OPENMP
#pragma omp parallel reduction(+ : bad) if (groups > 8 && omp_get_level() == 0)
#endif
    {{
#ifdef _OPENMP
        real *const space = work + omp_get_thread_num() * (ptrdiff_t){macro(spec, "BATCH_WORK")};
#else
        real *const space = work;
#endif
        lanes zero = splat_v(0);
        int group;
#ifdef _OPENMP
#pragma omp for schedule(static)
#endif
        for (group = 0; group < groups; ++group) {{
            const int first = group * {points};
            const int count = n - first < {points} ? n - first : {points};
            const int copied = collide || count % LANES != 0;
            ptrdiff_t apart = stride;
{_pointers(stored, f.outputs)}            if (copied) {{
                real *at = space + {written.work} * LANES;
                apart = {points};
{_gather(spec, f, sizes)}            }}
            for (int k = 0; k < count; k += LANES) {{
                zero += {f.name}_evaluate_v({", ".join(arguments)}, apart);
            }}
            if (copied) {{
{_scatter(spec, f, sizes)}            }}
        }}
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }}
    return bad == 0 ? {macro(spec, "OK")} : {f.name}_failed({", ".join(names)}, n, stride);
}}

{batch_prototype(spec, f)}
{{
    return {f.name}_many(n, n, {given});
}}

{batch_prototype(spec, f, True)}
{{
    return stride < n ? {macro(spec, "BAD_COUNT")} : {f.name}_many(n, stride, {given});
}}
"""


def _shared(spec: LibrarySpec, port: Port) -> bool:
    """True of the parameters where one array is for all points."""
    return bool(spec.parameters) and not spec.per_point and port.name == "parameters"


def _failed(spec: LibrarySpec, f: FunctionSpec, sizes: Mapping[str, str]) -> str:
    """The function that finds the points that failed, sets their results to NaN and returns the first status."""

    def finite(ports: tuple[Port, ...]) -> str:
        return " && ".join(
            f"all_finite({p.name}, {sizes[p.name]}, 1)"
            if _shared(spec, p)
            else f"all_finite({p.name} + k, {sizes[p.name]}, stride)"
            for p in ports
        )

    parameters = [f"const real *{p.name}" for p in f.inputs] + [f"real *{p.name}" for p in f.outputs]
    spoils = "".join(f"        set_nan({p.name} + k, {sizes[p.name]}, stride);\n" for p in f.outputs)
    return f"""\
/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE {spec.name}_status {f.name}_failed({", ".join(parameters)}, int n, ptrdiff_t stride)
{{
    {spec.name}_status first = {macro(spec, "OK")};
    for (int k = 0; k < n; ++k) {{
        const int known = {finite(f.inputs)};
        if (known && {finite(f.outputs)}) {{
            continue;
        }}
        if (first == {macro(spec, "OK")}) {{
            first = known ? {macro(spec, "RESULT_NOT_FINITE")} : {macro(spec, "INPUT_NOT_FINITE")};
        }}
{spoils}    }}
    return first;
}}
"""


def _collide(f: FunctionSpec, spec: LibrarySpec) -> str:
    """When to copy: a power of two of points, and more columns of results than a set of the first cache has ways."""
    if sum(port.size for port in f.outputs) <= WAYS:
        return "past"
    return f"past || (n > {tile(f, spec.precision)} && (size_t)stride * sizeof(real) % 1024 == 0)"


def _pointers(stored: list[Port], outputs: tuple[Port, ...]) -> str:
    return "".join(
        f"            {'' if p in outputs else 'const '}real *at_{p.name} = {p.name} + first;\n" for p in stored
    )


def _gather(spec: LibrarySpec, f: FunctionSpec, sizes: Mapping[str, str]) -> str:
    """Lines that copy the inputs of a group of points, and have the results written beside them."""
    points, indent = tile(f, spec.precision), " " * 16
    stored = [p for p in f.inputs if not _shared(spec, p)]
    lines = [f"{indent}gather_points(at_{p.name}, {sizes[p.name]}, count, stride, at, {points});\n" for p in stored]
    places = [f"{indent}at_{p.name} = at;\n{indent}at += {sizes[p.name]} * {points};\n" for p in stored]
    text = "".join(line + place for line, place in zip(lines, places, strict=True))
    text += "".join(f"{indent}at_{p.name} = at;\n{indent}at += {sizes[p.name]} * {points};\n" for p in f.outputs)
    return text[: text.rindex(f"{indent}at +=")]


def _scatter(spec: LibrarySpec, f: FunctionSpec, sizes: Mapping[str, str]) -> str:
    """Lines that copy the results of a group of points where they belong."""
    points, indent = tile(f, spec.precision), " " * 16
    return "".join(
        f"{indent}scatter_points(at_{p.name}, {sizes[p.name]}, count, {points}, {p.name} + first, stride, past);\n"
        for p in f.outputs
    )
