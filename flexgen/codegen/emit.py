"""The text of the C library: header, one source per function, facade and example; nothing is compiled here.

The text depends on the specification alone: no time stamp, host or path. Names come from `ports.identifier_problem`'s
gate; text from a model file is never written.
"""

from __future__ import annotations

import re

from flexgen.codegen.mathematics import Mathematics, literal, mathematics
from flexgen.codegen.pieces import (
    batch_prototype,
    comment,
    count_of,
    macro,
    numbered,
    port_table,
    prototype,
    quoted,
    size_macro,
)
from flexgen.codegen.spec import ABI_VERSION, STATUSES, FunctionSpec, LibrarySpec
from flexgen.errors import BuildError
from flexgen.ports import Port, identifier_problem

# Names that the emitted functions use beside their ports.
_INTERNAL = re.compile(r"(t\d+|w|x|n|k|work|status|first|evaluate(_\d+)?|all_finite|spoil)\Z")

_SIZES = {
    "n_a": "arm coordinates",
    "n_g": "arm coordinates that motors drive through gears",
    "n_e": "arm coordinates without a motor: springs only",
    "n_m": "motors",
    "n_x": "states of the linearisation",
}


def emit(spec: LibrarySpec) -> dict[str, str]:
    """Write the library down.

    Parameters
    ----------
    spec : LibrarySpec

    Returns
    -------
    dict of str to str
        Text by file name: ``<name>.h``, ``<name>.c``, ``<name>_<function>.c``, ``example.c``.

    Raises
    ------
    BuildError
        Where a name is not fit for C or an operation cannot be written.
    """
    _check_names(spec)
    written = {f.name: mathematics(f.function) for f in spec.functions}
    files = {f"{spec.name}.h": _header(spec, written), f"{spec.name}.c": _facade(spec)}
    for f in spec.functions:
        files[f"{spec.name}_{f.name}.c"] = _source(spec, f, written[f.name])
    files["example.c"] = _example(spec)
    for name, text in files.items():
        if not text.isascii():
            raise BuildError(f"{name}: given text beyond ASCII, expected ASCII only")
    return files


def symbols(spec: LibrarySpec) -> tuple[str, ...]:
    """Everything that the library exports, sorted."""
    general = ("status_text", "abi_version", "digest", "interface", "sizeof_real", "sizeof_int", *spec.sizes)
    functions = (f"{f.name}{suffix}" for f in spec.functions for suffix in ("", "_batch", "_work"))
    return tuple(sorted(f"{spec.name}_{name}" for name in (*general, *functions)))


def _check_names(spec: LibrarySpec) -> None:
    """Everything that becomes a name, or part of one, passes the gate; BuildError where it does not."""
    driven = [name for gears in spec.gears for name, _ in gears]
    names = [spec.name, *spec.coordinates, *spec.motors, *spec.sizes, *driven]
    names += [f.name for f in spec.functions]
    for name in names:
        problem = identifier_problem(name)
        if problem is not None:
            raise BuildError(f"name for C: given {name!r}, expected {problem}")
    for f in spec.functions:
        for port in (*f.inputs, *f.outputs):
            if _INTERNAL.match(port.name):
                raise BuildError(f"port of {f.name}: given {port.name!r}, which the emitted function uses itself")
    exported = symbols(spec)
    if len(set(exported)) != len(exported):
        raise BuildError(f"functions of {spec.name}: given names that collide, expected {len(exported)} different ones")


# --- header -----------------------------------------------------------------------------------------------------------


def _header(spec: LibrarySpec, written: dict[str, Mathematics]) -> str:
    guard, api = macro(spec, "H"), macro(spec, "API")
    listed = "".join(comment(line) for line in _manual(spec))
    sizes = "".join(
        f"#define {size_macro(spec, name)} {size} /* {_SIZES.get(name, name)} */\n" for name, size in spec.sizes.items()
    )
    works = "".join(f"#define {macro(spec, f.name)}_WORK {max(1, written[f.name].work)}\n" for f in spec.functions)
    statuses = ",\n".join(f"    {macro(spec, s.name)} = {s.code} /* {s.text} */" for s in STATUSES)
    functions = "\n".join(
        f"/*\n{comment(f.summary)} *\n{comment(f.equation, ' *   ')} *\n{port_table(f)}"
        f"{comment(f'{written[f.name].operations} operations')} */\n"
        f"{api}\n{prototype(spec, f)};\n{api}\n{batch_prototype(spec, f)};\n"
        f"{api} int {spec.name}_{f.name}_work(void); /* {macro(spec, f.name)}_WORK */\n"
        for f in spec.functions
    )
    size_functions = "".join(f"{api} int {spec.name}_{name}(void);\n" for name in spec.sizes)
    return f"""\
/*
{listed} */
#ifndef {guard}
#define {guard}

#if defined(_WIN32) && defined({macro(spec, "SHARED")})
#define {api} __declspec(dllexport)
#elif defined(__GNUC__)
#define {api} __attribute__((visibility("default")))
#else
#define {api}
#endif

#ifdef __cplusplus
extern "C" {{
#endif

{sizes}
/* Doubles of workspace. */
{works}
enum {spec.name}_status {{
{statuses}
}};

/* What a status means, in words; never a null pointer. */
{api} const char *{spec.name}_status_text(int status);

{functions}
/* For who loads the library at run time: check these before the first call. */
{api} int {spec.name}_abi_version(void);
{api} const char *{spec.name}_digest(void); /* SHA-256 of the model */
{api} const char *{spec.name}_interface(void); /* SHA-256 of names and shapes of the functions */
{api} int {spec.name}_sizeof_real(void);
{api} int {spec.name}_sizeof_int(void);
{size_functions}
#ifdef __cplusplus
}}
#endif

#endif
"""


def _manual(spec: LibrarySpec) -> list[str]:
    """The paragraphs at the top of the header."""
    name = spec.name
    half = len(spec.states) // 2
    units = [*spec.coordinate_units, *("rad" for _ in range(half - len(spec.coordinates)))]
    states = numbered(spec.states, [*units, *(f"{unit}/s" for unit in units)])
    lines = [
        f"{name}: equations of motion of an elastic robot, written by flexgen. Do not edit.",
        "",
        "SI units. Matrices are stored by columns. Arm quantities (q_a, v_a, a_a, tau_a) are on the arm side of the "
        "gears and in chain order, motor quantities (q_m, v_m, a_m, tau_m) on the motor side. Indices from 0:",
        f"  q_a: {numbered(spec.coordinates, spec.coordinate_units)}",
        f"  q_m: {numbered(spec.motors, ['rad'] * len(spec.motors))}",
    ]
    if any(f.name == "linearize" for f in spec.functions):
        lines.append(f"  x: {states}")
    return [
        *lines,
        "",
        "Numbers of the model that the functions use and a controller may need: gravity "
        f"({', '.join(map(repr, spec.gravity))}) m/s^2 in world axes; the gear ratios eta, with q_m = eta q_a of the "
        "driven coordinates where no gear is twisted; the rotor inertias J_m, motor side:",
        *(
            f"  {motor}: eta {', '.join(f'{ratio!r} ({name})' for name, ratio in gears)}; J_m {inertia!r} kg m^2"
            for motor, gears, inertia in zip(spec.motors, spec.gears, spec.rotor_inertias, strict=True)
        ),
        "",
        "Every function takes its inputs, its outputs and a workspace of <NAME>_<FUNCTION>_WORK doubles (at least 1), "
        "whose contents mean nothing before and after. No pointer may be null; arrays must not overlap. It returns 0, "
        "or a negative status: where a result is not finite all its outputs are NaN, where a pointer is null nothing "
        "is written. An input that is not finite is noticed only where the result depends on it.",
        "",
        "<function>_batch evaluates n points: each array holds point after point. All points are evaluated; the "
        "outputs of a point that fails are NaN, and the status of the first such point is returned. One workspace "
        "serves all.",
        "",
        "No function allocates, prints or keeps data: all may be called from several threads, each with its own "
        "arrays. Compile with any C99 compiler and link the mathematics library:",
        "  cc -std=c99 -O2 -ffp-contract=off *.c -lm",
        "(-ffp-contract=off: the same bits as in Python; never -ffast-math, which hides results that are not finite).",
    ]


# --- sources ----------------------------------------------------------------------------------------------------------


def _facade(spec: LibrarySpec) -> str:
    cases = "".join(f"    case {macro(spec, s.name)}:\n        return {quoted(s.text)};\n" for s in STATUSES)
    values = {
        **{f"{f.name}_work": f"{macro(spec, f.name)}_WORK" for f in spec.functions},
        "abi_version": str(ABI_VERSION),
        "sizeof_real": "(int)sizeof(double)",
        "sizeof_int": "(int)sizeof(int)",
        **{name: size_macro(spec, name) for name in spec.sizes},
    }
    functions = "\n".join(
        f"int {spec.name}_{name}(void)\n{{\n    return {value};\n}}\n" for name, value in values.items()
    )
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

{functions}"""


_FINITE = """\
static int all_finite(const double *x, int n)
{
    for (int k = 0; k < n; ++k) {
        if (!isfinite(x[k])) {
            return 0;
        }
    }
    return 1;
}

static void spoil(double *x, int n)
{
    for (int k = 0; k < n; ++k) {
        x[k] = NAN;
    }
}
"""


def _source(spec: LibrarySpec, f: FunctionSpec, written: Mathematics) -> str:
    """The file of one function: its mathematics, the checks around it, and the loop over many points."""
    everything = [p.name for p in (*f.inputs, *f.outputs)]
    null = " || ".join(f"{name} == NULL" for name in (*everything, "work"))
    calls = "".join(f"    {call}\n" for call in written.call)

    def finite(ports: tuple[Port, ...]) -> str:
        return " && ".join(f"all_finite({p.name}, {count_of(spec, f, p)})" for p in ports)

    spoils = "".join(f"    spoil({p.name}, {count_of(spec, f, p)});\n" for p in f.outputs)
    steps = "".join(f"        {p.name} += {count_of(spec, f, p)};\n" for p in (*f.inputs, *f.outputs))
    ok, null_status = macro(spec, "OK"), macro(spec, "NULL_ARGUMENT")
    return f"""\
/* {spec.name}: {f.name}. Written by flexgen; see {spec.name}.h. */
#include "{spec.name}.h"

#include <math.h>
#include <stddef.h>

{written.text}
{_FINITE}
{prototype(spec, f)}
{{
    int status;
    if ({null}) {{
        return {null_status};
    }}
{calls}    if ({finite(f.outputs)}) {{
        return {ok};
    }}
    status = ({finite(f.inputs)}) ? {macro(spec, "RESULT_NOT_FINITE")} : {macro(spec, "INPUT_NOT_FINITE")};
{spoils}    return status;
}}

{batch_prototype(spec, f)}
{{
    int first = {ok};
    if (n < 0) {{
        return {macro(spec, "BAD_COUNT")};
    }}
    if ({null}) {{
        return {null_status};
    }}
    for (int k = 0; k < n; ++k) {{
        const int status = {spec.name}_{f.name}({", ".join([*everything, "work"])});
        if (first == {ok}) {{
            first = status;
        }}
{steps}    }}
    return first;
}}
"""


def _example(spec: LibrarySpec) -> str:
    """A program that calls every function at the home pose, at rest, and prints what it gives."""
    blocks = []
    for f in spec.functions:
        inputs = ""
        for p in f.inputs:
            values = spec.home.get(p.name, (0.0,) * p.size)
            inputs += (
                f"        const double {p.name}[{count_of(spec, f, p)}] = {{{', '.join(map(literal, values))}}};\n"
            )
        outputs = "".join(f"        double {p.name}[{count_of(spec, f, p)}];\n" for p in f.outputs)
        arguments = ", ".join([*(p.name for p in (*f.inputs, *f.outputs)), "work"])
        shows = "".join(
            f'            show("{p.name}", {quoted(p.unit)}, {p.name}, {size_macro(spec, f.extents[p.name][0])}, '
            f"{size_macro(spec, f.extents[p.name][1]) if len(p.shape) == 2 else 1});\n"
            for p in f.outputs
        )
        blocks.append(f"""\
    {{
{inputs}{outputs}        double work[{macro(spec, f.name)}_WORK];
        status = {spec.name}_{f.name}({arguments});
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

static void show(const char *name, const char *unit, const double *x, int rows, int columns)
{{
    printf("  %s [%s]\\n", name, unit);
    for (int i = 0; i < rows; ++i) {{
        for (int j = 0; j < columns; ++j) {{
            printf(" %13.6g", x[i + j * rows]);
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
