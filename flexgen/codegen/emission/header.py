"""The public headers of the library: the manual of its functions, sizes, units, statuses and
constants.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from flexgen.codegen.emission.c_text import (
    WIDTH,
    batch_prototype,
    comment,
    macro,
    number_names,
    port_table,
    prototype,
    size_macro,
)
from flexgen.codegen.emission.clib_types import Status
from flexgen.codegen.emission.interface import STATUSES
from flexgen.codegen.emission.spec import FunctionSpec, LibrarySpec
from flexgen.codegen.statements.function_text import FunctionText
from flexgen.codegen.statements.literals import literal

SIZES = {
    "n_a": "arm coordinates",
    "n_g": "actuated arm coordinates, driven through gears",
    "n_e": "unactuated arm coordinates, with springs only",
    "n_m": "motors",
    "n_x": "states of the linearization",
    "n_y": "outputs",
    "n_t": "numbers of an output sample",
    "n_s": "channels of the sensors",
    "n_p": "run-time parameters",
    "n_packed": "entries of a triangle of the mass matrix",
}
BYTES = {"double": 8, "single": 4}
LANES = {"double": 8, "single": 16}  # at most

_LIBM = frozenset(
    (
        "sqrt log expm1 log1p erf tan asin acos atan sinh cosh asinh acosh atanh atan2 pow fmod "
        "remainder hypot"
    ).split()
)


def tile(f: FunctionSpec, precision: str) -> int:
    """Points whose arrays a batch copies at a time, where it has to: some 128 KiB of them, at most
    64 points.
    """
    ports = sum(port.size for port in (*f.inputs, *f.outputs))
    points = 64
    while points > LANES[precision] and points * ports * BYTES[precision] > 2**17:
        points //= 2
    return points


def works(f: FunctionSpec, written: FunctionText, precision: str) -> tuple[int, int]:
    """Reals of workspace for one point, and for a batch: lanes of workspace, and copies of some
    points' arrays.
    """
    ports = sum(port.size for port in (*f.inputs, *f.outputs))
    return max(1, written.work), written.work * LANES[precision] + ports * tile(f, precision)


def work_of(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> tuple[int, int]:
    """The largest workspace of all functions, in reals: for one point, and for a batch per
    thread.
    """
    sizes = [works(f, written[f.name], spec.precision) for f in spec.functions]
    return max(one for one, _ in sizes), max(many for _, many in sizes)


def header(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> str:
    """Text of ``<name>.h``."""
    guard = macro(spec, "H")
    api = macro(spec, "API")
    listed = "".join(comment(line) for line in _manual(spec, _list_calls(spec, written.values())))
    sizes = "".join(
        f"#define {size_macro(spec, name)} {size} /* {SIZES.get(name, name)} */\n"
        for name, size in spec.sizes.items()
    )
    statuses = ",\n".join(_status(spec, status) for status in STATUSES)
    functions = "\n".join(_function(spec, f, written[f.name]) for f in spec.functions)
    size_functions = "".join(f"{api} int {spec.name}_{name}(void);\n" for name in spec.sizes)
    parameters = ""
    if spec.parameters:
        parameters = (
            "\n"
            f"/* Fill an array of {size_macro(spec, 'n_p')} with the values of the model file. "
            "*/\n"
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

#ifdef __cplusplus
extern "C" {{
#endif

typedef {"double" if spec.precision == "double" else "float"} {spec.name}_real;

{sizes}#define {macro(spec, "WORK")} {work_of(spec, written)[0]} /* reals of workspace, where a \
function needs one */

/* Status of a call: 0 success, negative an error, positive a result with a warning. */
typedef enum {{
{statuses}
}} {spec.name}_status;

/* What a status means, in words; never a null pointer. */
{api} const char *{spec.name}_status_text({spec.name}_status status);
{parameters}
{_constants(spec)}
{functions}
/* For programs that load the library at run time: check these before the first call. */
{api} int {spec.name}_abi_version(void);
{api} const char *{spec.name}_digest(void); /* SHA-256 of the model */
{api} const char *{spec.name}_interface(void); /* SHA-256 of names and shapes of the functions */
{api} int {spec.name}_sizeof_real(void);
{api} int {spec.name}_sizeof_int(void);
{api} int {spec.name}_work(void); /* {macro(spec, "WORK")} */
{size_functions}
#ifdef __cplusplus
}}
#endif

#endif
"""


def batch_header(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> str:
    """Text of ``<name>_batch.h``."""
    guard = macro(spec, "BATCH_H")
    api = macro(spec, "API")
    name = spec.name
    functions = "\n".join(
        (
            "/*\n"
            f"{comment(f.summary)} */\n"
            f"{api}\n"
            f"{batch_prototype(spec, f)};\n"
            f"{api}\n"
            f"{batch_prototype(spec, f, True)};\n"
        )
        for f in spec.functions
    )
    manual = "".join(
        comment(line)
        for line in (
            f"{name}: the functions of {name}.h for many points, written by flexgen. Do not edit.",
            "",
            "<function>_batch evaluates n points. Arrays are structures of arrays: entry i of "
            "point k of an array x is x[i * n + k]; entry (row, column) of a matrix with r rows "
            "is i = row + column * r. All points are evaluated. The outputs of a point that "
            "fails are NaN, and the status of the first such point is returned.",
            "",
            "<function>_batch_strided takes n of the points of larger arrays: entry i of point "
            "k is x[i * stride + k]. Where the columns of large arrays are multiples of 1024 "
            "bytes apart, they meet in the same places of the cache; a stride that is 8 larger "
            "avoids it. BAD_COUNT: the stride is below n.",
            "",
            f"The workspace has {macro(spec, 'BATCH_WORK')} reals. With OpenMP each thread "
            f"needs that many: allocate {name}_batch_work() reals, and do not raise the number "
            "of threads after that. GCC and clang compute several points at once in vector "
            "registers, with the same bits as one by one where nothing is contracted.",
        )
    )
    return f"""\
/*
{manual} */
#ifndef {guard}
#define {guard}

#include "{name}.h"

#ifdef __cplusplus
extern "C" {{
#endif

#define {macro(spec, "BATCH_WORK")} {work_of(spec, written)[1]} /* workspace in reals, per thread \
*/

/* Workspace for the largest number of threads of the moment. */
{api} int {name}_batch_work(void);

{functions}
#ifdef __cplusplus
}}
#endif

#endif
"""


def _constants(spec: LibrarySpec) -> str:
    """Numbers of the model that a controller needs, as constants of the header."""
    nm, ng, na = (size_macro(spec, size) for size in ("n_m", "n_g", "n_a"))
    c = spec.constants
    arrays = [
        (
            "gear ratios: q_m = gear_ratio q_g without deflection",
            f"gear_ratio[{nm}][{ng}]",
            c.gear_ratio,
        ),
        ("[kg m^2] motor side", f"rotor_inertia[{nm}]", c.rotor_inertia),
        (
            "[N m/rad, N/m] arm side, at zero deflection; 0: rigid gear",
            f"gear_stiffness[{ng}]",
            c.gear_stiffness,
        ),
        ("home pose of the arm", f"home_q_a[{na}]", spec.home["q_a"]),
        ("home pose of the motors", f"home_q_m[{nm}]", spec.home["q_m"]),
    ]
    lines = ["/* Constants of the model. */"]
    for text, declared, values in arrays:
        start = f"static const {spec.name}_real {spec.name}_{declared} = "
        lines += [f"/* {text} */", *_break_lines(start, _initializer(values, spec.precision))]
    return "\n".join(lines) + "\n"


def _initializer(values: Sequence[Any], precision: str) -> str:
    """A C initializer of a vector or of a matrix, row by row."""
    inner = (
        _initializer(x, precision) if isinstance(x, Sequence) else literal(float(x), precision)
        for x in values
    )
    return f"{{{', '.join(inner)}}}"


def _break_lines(start: str, values: str) -> list[str]:
    """Lines of a declaration; where they are long they break after a comma."""
    if len(f"{start}{values};") <= WIDTH:
        return [f"{start}{values};"]
    return [
        start.rstrip(),
        *textwrap.wrap(f"{values};", WIDTH, initial_indent="    ", subsequent_indent="    "),
    ]


def _status(spec: LibrarySpec, status: Status) -> str:
    """A line of the enum, its text behind it or, where that is long, above it."""
    value = f"    {macro(spec, status.name)} = {status.code}"
    text = f"/* {status.text} */"
    line = f"{value} {text}"
    return line if len(line) < WIDTH else f"    {text}\n{value}"


def _function(spec: LibrarySpec, f: FunctionSpec, written: FunctionText) -> str:
    """The part of the header that describes and declares one function."""
    api = macro(spec, "API")
    cost = (
        f"{written.operations} operations, critical path about {written.depth} cycles; stack of "
        f"one point at most {stack_bytes(written, spec.precision)} bytes"
    )
    return (
        "/*\n"
        f"{comment(f.summary)} *\n"
        f"{comment(f.equation, ' *   ')} *\n"
        f"{port_table(f)}{comment(cost)} */\n"
        f"{api}\n"
        f"{prototype(spec, f, written.work)};\n"
    )


def stack_bytes(written: FunctionText, precision: str) -> int:
    """Bytes of stack that a call for one point needs at most: its locals, and room for calls and
    registers.
    """
    return -(-(written.stack * BYTES[precision] + 1024) // 256) * 256


def _list_calls(spec: LibrarySpec, written: Iterable[FunctionText]) -> str:
    """Clause on the functions of other libraries that the library calls."""
    used = sorted(
        _LIBM & {name for one in written for name in re.findall(r"F\((\w+)\)", one.text)}
    )
    names = ", ".join(f"{name}f" if spec.precision == "single" else name for name in used)
    return (
        f"of the mathematics library the functions call {names}"
        if names
        else "no other library is called"
    )


def _closure(spec: LibrarySpec) -> list[str]:
    """The paragraph on closed loops, where there are some."""
    if not spec.loops:
        return []
    return [
        f"The loops {', '.join(spec.loops)} are closed at the coordinates given, on the branch of "
        "the home position and step by step from there. Where they cannot be closed, or this "
        "iteration of fixed length has not come to its end, all outputs are NaN, and the status "
        "is RESULT_NOT_FINITE: no torque of an open loop is returned.",
        "",
    ]


def _manual(spec: LibrarySpec, called: str) -> list[str]:
    """The paragraphs at the top of the header."""
    name = spec.name
    half = len(spec.states) // 2
    units = [*spec.coordinate_units, *("rad" for _ in range(half - len(spec.coordinates)))]
    states = number_names(spec.states, [*units, *(f"{unit}/s" for unit in units)])
    lines = [
        f"{name}: equations of motion of an elastic robot, written by flexgen. Do not edit.",
        "",
        "SI units. Matrices are stored by columns. Arm quantities (q_a, v_a, a_a, tau_a) are on "
        "the arm side of the gears and in chain order, motor quantities (q_m, v_m, a_m, tau_m) "
        "on the motor side. Indices from 0:",
        f"  q_a: {number_names(spec.coordinates, spec.coordinate_units)}",
        f"  q_m: {number_names(spec.motors, ['rad'] * len(spec.motors))}",
    ]
    if any(f.name == "linearize" for f in spec.functions):
        lines.append(f"  x: {states}")
    if spec.parameters:
        batches = "; batches take one vector of them for each point" if spec.per_point else ""
        lines += ["", f"Run-time parameters, with the values of the model file{batches}:"]
        for k, p in enumerate(spec.parameters):
            lines.append(f"  {k} {p.name} = {p.value!r} [{p.unit}]{'; ' if p.doc else ''}{p.doc}")
    known = f"Standard deviations of the numbers, from the model file: {', '.join(spec.accuracy)}."
    accuracy = [known, ""] if spec.accuracy else []
    flags = "-std=c99 -O2 -ffp-contract=off"
    unrolled = (
        "-funroll-loops makes streams and whole paths a tenth faster, and their code twice as "
        "long. "
    )
    return [
        *lines,
        "",
        f"Gravity is ({', '.join(map(repr, spec.gravity))}) m/s^2 in world axes. Gear ratios "
        "eta and rotor inertias J_m, motor side:",
        *(
            (
                f"  {motor}: eta {', '.join(f'{ratio!r} ({name})' for name, ratio in gears)}; "
                f"J_m {inertia!r} kg m^2"
            )
            for motor, gears, inertia in zip(
                spec.motors, spec.gears, spec.rotor_inertias, strict=True
            )
        ),
        "",
        *accuracy,
        "Every function takes its inputs, its outputs and, where it needs one, a workspace of "
        f"{macro(spec, 'WORK')} reals, whose contents have no meaning before and after. No "
        "pointer may be null, and arrays must not overlap. It returns a status: 0, or a "
        "negative number. Where an input or a result is not finite, or a system of equations "
        "is singular to rounding, all outputs are NaN. Where a pointer is null, nothing is "
        "written. Angles, and sums of angles of parallel joints, must stay within the range of "
        f"the sine: {'1e6' if spec.precision == 'double' else '1e4'} rad.",
        "",
        *_closure(spec),
        f"{name}_batch.h has the same functions for many points"
        + (
            f", {name}_inversion.h inverse dynamics along whole paths and streams"
            if spec.inverts
            else ""
        )
        + (
            f", {name}_inverse_kinematics.h the joints at a pose"
            if spec.declared_in("inverse_kinematics")
            else ""
        )
        + ".",
        "",
        "No function allocates, prints or keeps data: all may be called from several threads, "
        "each with its own arrays. Compile with any C99 compiler:",
        f"  cc {flags} -c $(find src -name '*.c')",
        "(-ffp-contract=off: the same bits with every compiler and processor. Where GCC "
        "compiles for a fused multiply-add, add -fno-tree-vectorize, because it fuses in "
        "vectors nevertheless. -O3 -march=native -ffp-contract=fast is faster and differs by "
        f"rounding. {unrolled * spec.inverts}Never use -ffast-math: it hides results that are "
        f"not finite.) Sine, cosine, exp and tanh are part of the library; {called}; compilers "
        "may replace loops by calls of memset, memcpy and memmove. With OpenMP (-fopenmp) the "
        "batches use all cores.",
    ]
