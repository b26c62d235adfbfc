"""The facade of the library: its identity, its sizes and the defaults of its options."""

from __future__ import annotations

from flexgen.codegen.emission.c_text import macro, quote, size_macro
from flexgen.codegen.emission.clib_types import CFunction
from flexgen.codegen.emission.interface import ABI_VERSION, POSITION, STATUSES, default_of
from flexgen.codegen.emission.spec import LibrarySpec
from flexgen.codegen.statements.literals import literal
from flexgen.model.position_servo.keys import GAINS


def facade(spec: LibrarySpec) -> str:
    """Text of ``<name>.c``: identity and sizes of the library."""
    cases = "".join(
        f"    case {macro(spec, s.name)}:\n        return {quote(s.text)};\n" for s in STATUSES
    )
    values = {
        "abi_version": str(ABI_VERSION),
        "sizeof_real": f"(int)sizeof({spec.name}_real)",
        "sizeof_int": "(int)sizeof(int)",
        "work": macro(spec, "WORK"),
        **{name: size_macro(spec, name) for name in spec.sizes},
    }
    functions = "\n".join(
        f"int {spec.name}_{name}(void)\n{{\n    return {value};\n}}\n"
        for name, value in values.items()
    )
    include = f'#include "{spec.name}_inversion.h"\n' if spec.inverts else ""
    defaults = "".join(
        _defaults(spec, function) for function in spec.c_functions if not function.file
    )
    parameters = ""
    if spec.parameters:
        lines = "".join(
            f"    parameters[{k}] = {literal(p.value, spec.precision)}; /* {p.name} */\n"
            for k, p in enumerate(spec.parameters)
        )
        parameters = (
            f"void {spec.name}_parameters({spec.name}_real *parameters)\n{{\n{lines}}}\n\n"
        )
    return f"""\
/* {spec.name}: identity and sizes of the library. Written by flexgen; see {spec.name}.h. */
#include "{spec.name}_batch.h"
{include}
#ifdef _OPENMP
#include <omp.h>
#endif

const char *{spec.name}_status_text({spec.name}_status status)
{{
    switch (status) {{
{cases}    default:
        return "unknown status";
    }}
}}

const char *{spec.name}_digest(void)
{{
    return {quote(spec.digest)};
}}

const char *{spec.name}_interface(void)
{{
    return "{spec.interface}";
}}

{parameters}{defaults}{functions}
int {spec.name}_batch_work(void)
{{
#ifdef _OPENMP
    return {macro(spec, "BATCH_WORK")} * omp_get_max_threads();
#else
    return {macro(spec, "BATCH_WORK")};
#endif
}}
"""


def _defaults(spec: LibrarySpec, function: CFunction) -> str:
    """The function that returns options with their defaults; those of a stream are recommended for
    the model.
    """
    if function.part == POSITION:
        return _servo_defaults(spec)
    (struct,) = (struct for struct in spec.structs if struct.name == function.returns)
    lines = ""
    for field in struct.fields:
        value = default_of(field, spec.precision)
        if value.startswith("STREAM_") and spec.stream is None:
            value = "0"
        if value[0].isalpha():
            value = macro(spec, value)
        elif field.kind == "real":
            value = literal(float(value), spec.precision)
        lines += f"    options.{field.name} = {value};\n"
    head = f"{spec.name}_{struct.name} {spec.name}_{function.name}(void)"
    return (
        f"{head}\n{{\n    {spec.name}_{struct.name} options;\n{lines}    return options;\n}}\n\n"
    )


def _servo_defaults(spec: LibrarySpec) -> str:
    """The C function that returns the servo of the model file: gains per motor, then its times
    [s].
    """
    assert spec.motor_constants is not None and spec.motor_constants.servo is not None
    servo = spec.motor_constants.servo
    lines = ""
    for name in GAINS:
        values = ", ".join(literal(x, spec.precision) for x in getattr(servo, name))
        lines += (
            f"    static const {spec.name}_real {name}[{size_macro(spec, 'n_m')}] = "
            f"{{{values}}};\n"
        )
    lines += f"    {spec.name}_servo servo;\n"
    lines += "".join(f"    servo.{name} = {name};\n" for name in GAINS)
    for member, name in (
        ("speed_feedforward", "speed_feedforward"),
        ("reference_filter", "reference_filter_s"),
        ("sample_time", "sample_time"),
        ("delay", "delay"),
    ):
        lines += f"    servo.{member} = {literal(getattr(servo, name), spec.precision)};\n"
    return (
        f"{spec.name}_servo {spec.name}_servo_defaults(void)\n{{\n{lines}    return servo;\n}}\n\n"
    )
