"""The example program of the library: every function once, one whole path, ten updates of a
stream.
"""

from __future__ import annotations

from collections.abc import Mapping

from flexgen.codegen.emission.c_text import count_of, macro, quote, size_macro
from flexgen.codegen.emission.spec import FunctionSpec, LibrarySpec
from flexgen.codegen.statements.function_text import FunctionText
from flexgen.codegen.statements.literals import literal


def example(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> str:
    """Text of ``example.c``."""
    real = f"{spec.name}_real"
    blocks = "".join(_block(spec, f, written[f.name].work > 0) for f in spec.functions)
    inverts = spec.inverts
    called = "    failed |= invert_path();\n    failed |= run_stream();\n" if inverts else ""
    headers = f'#include "{spec.name}_inversion.h"' if inverts else f'#include "{spec.name}.h"'
    what = "every function once, at rest in the home pose" + (
        "; then a path on which the output stays where it is, inverted as a whole and by a stream"
        if inverts
        else ""
    )
    return f"""\
/*
 * {spec.name}: {what}.
 * Written by flexgen; see {spec.name}.h.
 *
 *   cc -std=c99 -O2 -ffp-contract=off example.c $(find src -name '*.c') -lm -o example && \
./example
 */
{headers}

#include <stdio.h>
{"#include <stdlib.h>" + chr(10) if inverts else ""}
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

{_inversion(spec) if inverts else ""}int main(void)
{{
    {spec.name}_status status;
    int failed = 0;
{blocks}{called}    return failed;
}}
"""


def _block(spec: LibrarySpec, f: FunctionSpec, needs_work: bool) -> str:
    """The C block that calls one function at the home pose and prints its results; ``needs_work``:
    with a workspace.
    """
    real = f"{spec.name}_real"
    lines = ""
    shared = False
    for p in f.inputs:
        if spec.parameters and p.name == "parameters":
            lines += f"        {real} parameters[{count_of(spec, f, p)}];\n"
            shared = True
            continue
        numbers = ", ".join(
            literal(x, spec.precision) for x in spec.home.get(p.name, (0.0,) * p.size)
        )
        lines += f"        const {real} {p.name}[{count_of(spec, f, p)}] = {{{numbers}}};\n"
    lines += "".join(f"        {real} {p.name}[{count_of(spec, f, p)}];\n" for p in f.outputs)
    if needs_work:
        lines += f"        {real} work[{macro(spec, 'WORK')}];\n"
    if shared:
        lines += f"        {spec.name}_parameters(parameters);\n"
    arguments = ", ".join(
        [*(p.name for p in (*f.inputs, *f.outputs)), *(["work"] if needs_work else [])]
    )
    shows = "".join(
        f'            show("{p.name}", {quote(p.unit)}, {p.name}, '
        f"{size_macro(spec, f.extents[p.name][0])}, "
        f"{size_macro(spec, f.extents[p.name][1]) if len(p.shape) == 2 else 1});\n"
        for p in f.outputs
    )
    return f"""\
    {{
{lines}        status = {spec.name}_{f.name}({arguments});
        printf("{f.name}: %s\\n", {spec.name}_status_text(status));
        if (status == {macro(spec, "OK")}) {{
{shows}        }} else {{
            failed = 1;
        }}
    }}
"""


def _inversion(spec: LibrarySpec) -> str:
    """The functions of the example that invert a path and run a stream; the output stays at its
    home position.
    """
    sampling, update = (literal(x, spec.precision) for x in (0.001, 0.005))
    name = spec.name
    real = f"{spec.name}_real"
    ny, nt, nm = (size_macro(spec, size) for size in ("n_y", "n_t", "n_m"))
    home = _home_output(spec)
    declared = f"    {real} parameters[{size_macro(spec, 'n_p')}];\n" if spec.parameters else ""
    fill, given = (
        (f"    {name}_parameters(parameters);\n", "parameters, ") if spec.parameters else ("", "")
    )
    return f"""\
enum {{ SAMPLES = 21, UPDATES = 10 }};

{home}
/* The motor torques for a whole path: here the output stays where it is. */
static int invert_path(void)
{{
    {real} y[SAMPLES * {nt}], zero[SAMPLES * {ny}] = {{0}}, tau_m[SAMPLES * {nm}];
    static {name}_samples path; /* static: members that are not set are zero */
    static {name}_motion motion; /* no other results are wanted */
    {name}_inversion_options options = {name}_inversion_defaults();
    {name}_invert_info info;
{declared}    {name}_status status = home_output(y);
    const int64_t size = {name}_invert_work(SAMPLES, &options);
    {real} *work = ({real} *)malloc((size_t)size * sizeof({real}));
    if (work == NULL || status != {macro(spec, "OK")}) {{
        free(work);
        return 1;
    }}
    for (int i = {nt}; i < SAMPLES * {nt}; ++i) {{
        y[i] = y[i - {nt}];
    }}
    path.n = SAMPLES;
    path.period = {sampling};
    path.y = y;
    path.dy = zero;
    path.ddy = zero;
    motion.tau_m = tau_m;
{fill}    status = {name}_invert(&path, {given}{name}_home_q_a, &options, &motion, &info, work, \
size);
    printf("invert: %s\\n", {name}_status_text(status));
    if (status == {macro(spec, "OK")}) {{
        show("tau_m", "N m", tau_m, {nm}, 1);
    }}
    free(work);
    return status < 0;
}}

/* The same torques from a stream: memory is allocated once, an update allocates nothing. */
static int run_stream(void)
{{
    {real} y[{nt}], zero[{ny}] = {{0}}, tau_m[{nm}];
    static {name}_motion motion; /* no other results are wanted */
    {name}_stream_options options = {name}_stream_defaults();
    {name}_stream stream;
    {name}_stream_info info;
{declared}    {name}_status status = home_output(y);
    options.intervals = 10;
    options.samples_per_interval = 1;
    options.period = {update};
    stream.size = {name}_stream_work(&options);
    stream.memory = ({real} *)malloc((size_t)stream.size * sizeof({real}));
    if (stream.memory == NULL || status != {macro(spec, "OK")}) {{
        free(stream.memory);
        return 1;
    }}
    motion.tau_m = tau_m;
{fill}    status = {name}_stream_start(&stream, &options, y, {given}{name}_home_q_a);
    for (int k = 0; k < UPDATES && status >= 0; ++k) {{
        status = {name}_stream_update(&stream, y, zero, zero, &motion, &info);
    }}
    printf("stream: %s\\n", {name}_status_text(status));
    if (status >= 0) {{
        show("tau_m", "N m", tau_m, {nm}, 1);
    }}
    free(stream.memory);
    return status < 0;
}}

"""


def _home_output(spec: LibrarySpec) -> str:
    """A C function that gives the output at the home pose: of a pose from the kinematics, else
    from the constraint.
    """
    name = spec.name
    real = f"{spec.name}_real"
    na, ny, nt = (size_macro(spec, size) for size in ("n_a", "n_y", "n_t"))
    constants = spec.motor_constants
    pose = constants is not None and constants.pose
    if pose and constants is not None and constants.further:
        return f"""\
/* Position of the tool and joints, and rotation matrix of the tool, at the home pose. */
static {name}_status home_output({real} y[{nt}])
{{
    const {real} zero_velocity[{na}] = {{0}}, zero[{nt}] = {{0}};
    {real} W[{ny} * {na}], Wdot_v[{ny}], error[{ny}], p[3];
    {name}_status status = {name}_output_constraint({name}_home_q_a, zero_velocity, zero, error, \
W, Wdot_v);
    if (status == {macro(spec, "OK")}) {{
        status = {name}_forward_kinematics({name}_home_q_a, p, y + {ny} - 3);
    }}
    for (int i = 0; i < {ny} - 3; ++i) {{
        y[i] = error[i];
    }}
    return status;
}}
"""
    if pose:
        return f"""\
/* Position and rotation matrix of the tool at the home pose. */
static {name}_status home_output({real} y[{nt}])
{{
    return {name}_forward_kinematics({name}_home_q_a, y, y + 3);
}}
"""
    return f"""\
/* The output at the home pose: how far it is from zero. */
static {name}_status home_output({real} y[{nt}])
{{
    const {real} zero_velocity[{na}] = {{0}}, zero[{nt}] = {{0}};
    {real} W[{ny} * {na}], Wdot_v[{ny}];
    return {name}_output_constraint({name}_home_q_a, zero_velocity, zero, y, W, Wdot_v);
}}
"""
