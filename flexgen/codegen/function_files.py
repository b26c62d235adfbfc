"""The C files of the library: checks and entry points around the mathematics, the facade, the example."""

from __future__ import annotations

from collections.abc import Mapping

from flexgen.codegen.c_text import batch_prototype, count_of, macro, prototype, quoted, size_macro
from flexgen.codegen.header import tile
from flexgen.codegen.spec import ABI_VERSION, STATUSES, FunctionSpec, LibrarySpec
from flexgen.expressions.function_text import FunctionText, literal
from flexgen.ports import Port

WAYS = 24  # lines that a set of the first cache may hold, about; more results at once push each other out


def facade(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> str:
    """Text of ``<name>.c``: what the library says of itself."""
    cases = "".join(f"    case {macro(spec, s.name)}:\n        return {quoted(s.text)};\n" for s in STATUSES)
    values = {
        "abi_version": str(ABI_VERSION),
        "sizeof_real": f"(int)sizeof({spec.name}_real)",
        "sizeof_int": "(int)sizeof(int)",
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
/* {spec.name}: what the library says of itself. Written by flexgen; see {spec.name}.h. */
#include "{spec.name}.h"

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

{parameters}{functions}"""


def private_header(spec: LibrarySpec) -> str:
    """Text of ``<name>_private.h``: what the function files share beside the kernel."""
    guard = macro(spec, "PRIVATE_H")
    zero = literal(0.0, spec.precision)
    return f"""\
/*
 * {spec.name}: shared by the function files, private to them. Written by flexgen; see {spec.name}.h.
 */
#ifndef {guard}
#define {guard}

#include "{spec.name}_kernel.h"

#include <math.h>
#include <stddef.h>

#define ZERO {zero}

#if defined(__GNUC__)
#define RESTRICT __restrict
#define SEPARATE __attribute__((noinline))
#else
#define RESTRICT
#define SEPARATE
#endif

static inline real sum_v(const lanes x)
{{
    real sum = {zero};
    for (int k = 0; k < LANES; ++k) {{
        sum += ((const real *)&x)[k];
    }}
    return sum;
}}

static inline int all_finite(const real *x, int size, ptrdiff_t stride)
{{
    for (int k = 0; k < size; ++k) {{
        if (!isfinite(x[k * stride])) {{
            return 0;
        }}
    }}
    return 1;
}}

static inline void spoil(real *x, int size, ptrdiff_t stride)
{{
    for (int k = 0; k < size; ++k) {{
        x[k * stride] = (real)NAN;
    }}
}}

/* Copy the entries of some points; lanes beyond the last point repeat the first. */
static inline void gather_points(const real *x, int size, int count, ptrdiff_t stride, real *to, ptrdiff_t to_stride)
{{
    for (int i = 0; i < size; ++i) {{
        int k = 0;
        for (; k < count; ++k) {{
            to[i * to_stride + k] = x[i * stride + k];
        }}
        for (; k % LANES != 0; ++k) {{
            to[i * to_stride + k] = x[i * stride];
        }}
    }}
}}

static inline void scatter_points(const real *x, int size, int count, ptrdiff_t stride, real *to, ptrdiff_t to_stride)
{{
    for (int i = 0; i < size; ++i) {{
        for (int k = 0; k < count; ++k) {{
            to[i * to_stride + k] = x[i * stride + k];
        }}
    }}
}}

#endif
"""


_MEANINGS = {  # of the words that the mathematics is written in: for one point, and for lanes of points
    "T": ("real", "lanes"),
    "F(name)": ("name##_1", "name##_v"),
    "IN(x, i)": ("((x)[i])", "load_v((x) + (i) * n)"),
    "OUT(x, i, value)": ("((x)[i] = (value))", "store_v((x) + (i) * n, value)"),
    "P(x, i)": ("((x)[i])", "splat_v((x)[i])"),
    "STRIDE(n)": ("", ", n"),
    "ANGLES(n)": ("PADDED(n)", "(n)"),
    "ROW": ("lanes", "lanes"),
    "ROWS(x)": ("((lanes *)(x))", "(x)"),
    "ROW_COUNT(n)": ("(((n) + LANES - 1) / LANES)", "(n)"),
    "ROW_OF(x)": ("splat_v(x)", "splat_v(x)"),
    "ROW_SUM(x)": ("sum_v(x)", "(x)"),
}


def meanings(spec: LibrarySpec) -> dict[str, str]:
    """Texts of ``<name>_point.h`` and ``<name>_lanes.h``: what the words of the mathematics mean there."""
    files = {}
    for k, (kind, what) in enumerate((("point", "one point"), ("lanes", "lanes of points, entries n apart"))):
        forget = "".join(f"#undef {word.partition('(')[0]}\n" for word in _MEANINGS) if k else ""
        defined = "".join(f"#define {word} {meaning[k]}".rstrip() + "\n" for word, meaning in _MEANINGS.items())
        files[f"{spec.name}_{kind}.h"] = (
            f"/* {spec.name}: the mathematics for {what}; before a <function>_body.h. Written by flexgen. */\n"
            f"{forget}{defined}"
        )
    return files


def body(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """Text of ``<name>_<function>_body.h``: the mathematics, without a guard, as it is included twice."""
    return (
        f"/* {spec.name}: {f.name}, the mathematics; included for T a real and for T lanes of reals. "
        f"Written by flexgen. */\n{written.text}"
    )


def source(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """Text of ``<name>_<function>.c``: the checks around the mathematics, for one point and for many."""
    ports = (*f.inputs, *f.outputs)
    everything = [p.name for p in ports]
    null = " || ".join(f"{name} == NULL" for name in (*everything, "work"))
    sizes = {p.name: count_of(spec, f, p) for p in ports}
    stored = [p for p in ports if not _shared(spec, p)]  # one per point
    name, ok = f"{spec.name}_{f.name}", macro(spec, "OK")
    arguments = ", ".join(everything)
    space = ", work" if written.work else ""
    return f"""\
/* {spec.name}: {f.name}. Written by flexgen; see {spec.name}.h. */
#include "{spec.name}.h"
#include "{spec.name}_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "{spec.name}_point.h"
#include "{name}_body.h"

#include "{spec.name}_lanes.h"
#include "{name}_body.h"

{_failed(spec, f, sizes)}
{prototype(spec, f)}
{{
    if ({null}) {{
        return {macro(spec, "NULL_ARGUMENT")};
    }}
    if (evaluate_1({arguments}{space}) == 0) {{
        return {ok};
    }}
    return failed({arguments}, 1, 1);
}}

{batch_prototype(spec, f)}
{{
    /* Where columns of results meet in the same places of the cache, and for the last points, arrays are copied. */
    const int collide = {_collide(f, spec)};
    const int groups = n < 0 ? 0 : n / {tile(f, spec.precision)} + (n % {tile(f, spec.precision)} != 0);
    int bad = 0;
    if (n < 0) {{
        return {macro(spec, "BAD_COUNT")};
    }}
    if ({null}) {{
        return {macro(spec, "NULL_ARGUMENT")};
    }}
#ifdef _OPENMP
#pragma omp parallel reduction(+ : bad) if (groups > 8 && omp_get_level() == 0)
#endif
    {{
#ifdef _OPENMP
        real *const space = work + omp_get_thread_num() * (ptrdiff_t){macro(spec, f.name)}_BATCH_WORK;
#else
        real *const space = work;
#endif
        lanes zero = splat_v(0);
        int group;
#ifdef _OPENMP
#pragma omp for schedule(static)
#endif
        for (group = 0; group < groups; ++group) {{
            const int first = group * {tile(f, spec.precision)};
            const int count = n - first < {tile(f, spec.precision)} ? n - first : {tile(f, spec.precision)};
            const int copied = collide || count % LANES != 0;
            ptrdiff_t stride = n;
{_pointers(stored, f.outputs)}            if (copied) {{
                real *at = space + {written.work} * LANES;
                stride = {tile(f, spec.precision)};
{_gather(spec, f, sizes)}            }}
            for (int k = 0; k < count; k += LANES) {{
                zero += evaluate_v({", ".join(f"at_{p.name} + k" if p in stored else p.name for p in ports)}{
        ", (lanes *)space" if written.work else ""
    }, stride);
            }}
            if (copied) {{
{_scatter(spec, f, sizes)}            }}
        }}
        bad += sum_v(zero) == 0 ? 0 : 1;
    }}
    return bad == 0 ? {ok} : failed({arguments}, n, n);
}}

int {name}_work(void)
{{
    return {macro(spec, f.name)}_WORK;
}}

int {name}_batch_work(void)
{{
#ifdef _OPENMP
    return {macro(spec, f.name)}_BATCH_WORK * omp_get_max_threads();
#else
    return {macro(spec, f.name)}_BATCH_WORK;
#endif
}}
"""


def _shared(spec: LibrarySpec, port: Port) -> bool:
    """True of the parameters: one array for all points."""
    return bool(spec.parameters) and port.name == "parameters"


def _failed(spec: LibrarySpec, f: FunctionSpec, sizes: Mapping[str, str]) -> str:
    """The function that finds the points that failed, spoils their results and tells the first one's status."""

    def finite(ports: tuple[Port, ...]) -> str:
        return " && ".join(
            f"all_finite({p.name}, {sizes[p.name]}, 1)"
            if _shared(spec, p)
            else f"all_finite({p.name} + k, {sizes[p.name]}, stride)"
            for p in ports
        )

    parameters = [f"const real *{p.name}" for p in f.inputs] + [f"real *{p.name}" for p in f.outputs]
    spoils = "".join(f"        spoil({p.name} + k, {sizes[p.name]}, stride);\n" for p in f.outputs)
    return f"""\
/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE int failed({", ".join(parameters)}, int n, ptrdiff_t stride)
{{
    int first = {macro(spec, "OK")};
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
        return "0"
    return f"n > {tile(f, spec.precision)} && (size_t)n * sizeof(real) % 1024 == 0"


def _pointers(stored: list[Port], outputs: tuple[Port, ...]) -> str:
    return "".join(
        f"            {'' if p in outputs else 'const '}real *at_{p.name} = {p.name} + first;\n" for p in stored
    )


def _gather(spec: LibrarySpec, f: FunctionSpec, sizes: Mapping[str, str]) -> str:
    """Lines that copy the inputs of a group of points, and have the results written beside them."""
    points, indent = tile(f, spec.precision), " " * 16
    stored = [p for p in f.inputs if not _shared(spec, p)]
    lines = [f"{indent}gather_points(at_{p.name}, {sizes[p.name]}, count, n, at, {points});\n" for p in stored]
    places = [f"{indent}at_{p.name} = at;\n{indent}at += {sizes[p.name]} * {points};\n" for p in stored]
    text = "".join(line + place for line, place in zip(lines, places, strict=True))
    text += "".join(f"{indent}at_{p.name} = at;\n{indent}at += {sizes[p.name]} * {points};\n" for p in f.outputs)
    return text[: text.rindex(f"{indent}at +=")]


def _scatter(spec: LibrarySpec, f: FunctionSpec, sizes: Mapping[str, str]) -> str:
    """Lines that copy the results of a group of points where they belong."""
    points, indent = tile(f, spec.precision), " " * 16
    return "".join(
        f"{indent}scatter_points(at_{p.name}, {sizes[p.name]}, count, {points}, {p.name} + first, n);\n"
        for p in f.outputs
    )


def example(spec: LibrarySpec) -> str:
    """A program that calls every function at the home pose, at rest, and prints what it gives."""
    blocks = []
    real = f"{spec.name}_real"
    for f in spec.functions:
        inputs = ""
        for p in f.inputs:
            if _shared(spec, p):
                inputs += f"        {real} parameters[{count_of(spec, f, p)}];\n"
                continue
            values = spec.home.get(p.name, (0.0,) * p.size)
            numbers = ", ".join(literal(x, spec.precision) for x in values)
            inputs += f"        const {real} {p.name}[{count_of(spec, f, p)}] = {{{numbers}}};\n"
        outputs = "".join(f"        {real} {p.name}[{count_of(spec, f, p)}];\n" for p in f.outputs)
        arguments = ", ".join([*(p.name for p in (*f.inputs, *f.outputs)), "work"])
        fill = f"        {spec.name}_parameters(parameters);\n" if any(_shared(spec, p) for p in f.inputs) else ""
        shows = "".join(
            f'            show("{p.name}", {quoted(p.unit)}, {p.name}, {size_macro(spec, f.extents[p.name][0])}, '
            f"{size_macro(spec, f.extents[p.name][1]) if len(p.shape) == 2 else 1});\n"
            for p in f.outputs
        )
        blocks.append(f"""\
    {{
{inputs}{outputs}        {real} work[{macro(spec, f.name)}_WORK];
{fill}        status = {spec.name}_{f.name}({arguments});
        printf("{f.name}: %s\\n", {spec.name}_status_text(status));
        if (status == {macro(spec, "OK")}) {{
{shows}        }} else {{
            failed = 1;
        }}
    }}
""")
    return f"""\
/*
 * {spec.name}: every function once, at rest in the home pose. Written by flexgen; see {spec.name}.h.
 *
 *   cc -std=c99 -O2 -ffp-contract=off *.c -lm -o example && ./example
 */
#include "{spec.name}.h"

#include <stdio.h>

static void show(const char *name, const char *unit, const {real} *x, int rows, int columns)
{{
    printf("  %s [%s]\\n", name, unit);
    for (int i = 0; i < rows; ++i) {{
        for (int j = 0; j < columns; ++j) {{
            printf(" %13.6g", (double)x[i + j * rows]);
        }}
        printf("\\n");
    }}
}}

int main(void)
{{
    int status, failed = 0;
{"".join(blocks)}    return failed;
}}
"""
