"""The public header of the library: the manual of its functions, sizes, units and statuses."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from flexgen.codegen.c_text import batch_prototype, comment, macro, numbered, port_table, prototype, size_macro
from flexgen.codegen.clib_files import core_macros, core_prototypes
from flexgen.codegen.spec import STATUSES, FunctionSpec, LibrarySpec, Status
from flexgen.expressions.function_text import FunctionText

SIZES = {
    "n_a": "arm coordinates",
    "n_g": "arm coordinates that motors drive through gears",
    "n_e": "arm coordinates without a motor: springs only",
    "n_m": "motors",
    "n_x": "states of the linearisation",
    "n_y": "outputs",
    "n_t": "numbers of a target of the output",
    "n_p": "run-time parameters",
}
BYTES = {"double": 8, "single": 4}
LANES = {"double": 8, "single": 16}  # at most

_LIBM = frozenset(
    "sqrt log expm1 log1p erf tan asin acos atan sinh cosh asinh acosh atanh atan2 pow fmod remainder hypot".split()
)


def tile(f: FunctionSpec, precision: str) -> int:
    """Points whose arrays a batch copies at a time, where it has to: some 128 KiB of them, at most 64 points."""
    ports = sum(port.size for port in (*f.inputs, *f.outputs))
    points = 64
    while points > LANES[precision] and points * ports * BYTES[precision] > 2**17:
        points //= 2
    return points


def works(f: FunctionSpec, written: FunctionText, precision: str) -> tuple[int, int]:
    """Reals of workspace for one point, and for a batch: lanes of workspace, and copies of some points' arrays."""
    ports = sum(port.size for port in (*f.inputs, *f.outputs))
    return max(1, written.work), written.work * LANES[precision] + ports * tile(f, precision)


def header(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> str:
    """Text of ``<name>.h``."""
    guard, api = macro(spec, "H"), macro(spec, "API")
    listed = "".join(comment(line) for line in _manual(spec, _called(spec, written.values())))
    sizes = "".join(
        f"#define {size_macro(spec, name)} {size} /* {SIZES.get(name, name)} */\n" for name, size in spec.sizes.items()
    )
    listed_works = ""
    for f in spec.functions:
        one, many = works(f, written[f.name], spec.precision)
        listed_works += f"#define {macro(spec, f.name)}_WORK {one}\n#define {macro(spec, f.name)}_BATCH_WORK {many}\n"
    statuses = ",\n".join(_status(spec, status) for status in STATUSES)
    functions = "\n".join(_function(spec, f, written[f.name]) for f in spec.functions)
    size_functions = "".join(f"{api} int {spec.name}_{name}(void);\n" for name in spec.sizes)
    parameters = ""
    if spec.parameters:
        parameters = (
            f"\n/* Fill an array of {size_macro(spec, 'n_p')} with the values of the model file. */\n"
            f"{api} void {spec.name}_parameters({spec.name}_real *parameters);\n"
        )
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

{"#include <stdint.h>" if spec.cores else ""}

#ifdef __cplusplus
extern "C" {{
#endif

typedef {"double" if spec.precision == "double" else "float"} {spec.name}_real;

{sizes}
/* Workspace in reals: for one point; for many points, per thread. */
{listed_works}{core_macros(spec)}
enum {spec.name}_status {{
{statuses}
}};

/* What a status means, in words; never a null pointer. */
{api} const char *{spec.name}_status_text(int status);
{parameters}
{functions}
{core_prototypes(spec)}
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


def _status(spec: LibrarySpec, status: Status) -> str:
    """A line of the enum, its text behind it or, where that is long, above it."""
    value, text = f"    {macro(spec, status.name)} = {status.code}", f"/* {status.text} */"
    return f"{value} {text}" if len(value) + len(text) < 115 else f"    {text}\n{value}"


def _function(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """The part of the header that describes and declares one function."""
    api = macro(spec, "API")
    cost = (
        f"{written.operations} operations, the longest chain about {written.depth} cycles; stack of one point at most "
        f"{stack_bytes(written, spec.precision)} bytes"
    )
    return (
        f"/*\n{comment(f.summary)} *\n{comment(f.equation, ' *   ')} *\n{port_table(f)}{comment(cost)} */\n"
        f"{api}\n{prototype(spec, f)};\n{api}\n{batch_prototype(spec, f)};\n"
        f"{api} int {spec.name}_{f.name}_work(void);\n"
        f"{api} int {spec.name}_{f.name}_batch_work(void); /* times the threads, with OpenMP */\n"
    )


def stack_bytes(written: FunctionText, precision: str) -> int:
    """Bytes of stack that a call for one point needs at most: its locals, and room for calls and registers."""
    return -(-(written.stack * BYTES[precision] + 1024) // 256) * 256


def _called(spec: LibrarySpec, written: Iterable[FunctionText]) -> str:
    """What the library calls of others."""
    used = sorted(_LIBM & {name for one in written for name in re.findall(r"F\((\w+)\)", one.text)})
    names = ", ".join(f"{name}f" if spec.precision == "single" else name for name in used)
    return f"of the mathematics library the functions call {names}" if names else "no other library is called"


def _manual(spec: LibrarySpec, called: str) -> list[str]:
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
    if spec.parameters:
        lines += ["", "Run-time parameters, with the values of the model file:"]
        for k, p in enumerate(spec.parameters):
            lines.append(f"  {k} {p.name} = {p.value!r} [{p.unit}]{'; ' if p.doc else ''}{p.doc}")
    flags = "-std=c99 -O2 -ffp-contract=off"
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
        "Every function takes its inputs, its outputs and a workspace of <NAME>_<FUNCTION>_WORK reals (at least 1), "
        "whose contents mean nothing before and after. No pointer may be null; arrays must not overlap. It returns 0, "
        "or a negative status: where a result or any entry of an input is not finite all its outputs are NaN, where a "
        "pointer is null nothing is written. Where a system of equations is singular up to rounding, the result counts "
        "as not finite. Angles, and their sums over joints with parallel axes, must stay within the range of the sine "
        f"in {name}_kernel.h; beyond it the result is not finite.",
        "",
        "<function>_batch evaluates n points. Memory is a structure of arrays: entry i of point k of an array x is "
        "x[i * n + k]; of a matrix with r rows entry (row, column) is i = row + column * r. All points are evaluated; "
        "the outputs of a point that fails are NaN, and the status of the first such point is returned. The workspace "
        "has <NAME>_<FUNCTION>_BATCH_WORK reals (with OpenMP: that many per thread; ask "
        "<function>_batch_work, and do not raise the number of threads after that). GCC and clang compute several "
        "points at once in vector registers, with the same bits as one by one where nothing is contracted (see below).",
        "",
        "No function allocates, prints or keeps data: all may be called from several threads, each with its own "
        "arrays. Compile with any C99 compiler:",
        f"  cc {flags} *.c -lm",
        "(-ffp-contract=off: the same bits with every compiler and processor; where GCC compiles for a fused "
        "multiply-add, add -fno-tree-vectorize, as it fuses vectors all the same. -O3 -march=native "
        "-ffp-contract=fast is faster, and differs by rounding. Never -ffast-math: it hides results that are not "
        "finite.) Sine, cosine, exp and tanh are the library's own; "
        f"{called}, but that compilers may make loops into calls of memset, memcpy and memmove. With OpenMP (-fopenmp) "
        "the batches use all cores.",
    ]
