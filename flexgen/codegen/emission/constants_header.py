"""The private header with the numbers of a model that the hand-written C uses, and what a library
has of it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence

from flexgen.codegen.emission.c_text import size_macro
from flexgen.codegen.emission.header import works
from flexgen.codegen.emission.motor_constants import MotorConstants
from flexgen.codegen.emission.spec import FunctionSpec, LibrarySpec
from flexgen.codegen.emission.stream_layout import layout_text
from flexgen.codegen.statements.function_text import FunctionText
from flexgen.codegen.statements.literals import literal
from flexgen.dynamics.mechanics.signatures import INVERTING
from flexgen.model.position_servo.filters import inverse_taps


def count_elements(spec: LibrarySpec) -> int:
    """The most elements of hysteresis that a gear has, of a model that the library inverts; zero:
    none.
    """
    return (
        0 if spec.motor_constants is None else sum(map(any, spec.motor_constants.hysteresis_slip))
    )


def is_curved(spec: LibrarySpec) -> bool:
    """Whether the library inverts a model with an element of hysteresis by another law than
    Dahl's.
    """
    return spec.motor_constants is not None and bool(spec.motor_constants.curves)


def is_harmonic(spec: LibrarySpec) -> bool:
    """Whether the library inverts a model with Fourier sums of motor angles."""
    return any(f.name == "motor_harmonics" for f in spec.functions)


def is_loaded(spec: LibrarySpec) -> bool:
    """Whether the library inverts a model some of whose motors have a friction that depends on the
    torque of a gear.
    """
    return any(f.name == "loaded_friction" for f in spec.functions)


def is_coupled(spec: LibrarySpec) -> bool:
    """Whether the library inverts a model whose rotors turn with their carriers too."""
    return any(f.name == "rotor_coupling" for f in spec.functions)


def is_bristled(spec: LibrarySpec) -> bool:
    """Whether the library inverts a model some of whose motors have a friction with a state."""
    return spec.motor_constants is not None and any(spec.motor_constants.lugre.get("coulomb", ()))


def has_positions(spec: LibrarySpec) -> bool:
    """Whether the library gives positions to send."""
    return spec.motor_constants is not None and spec.motor_constants.servo is not None


def has_bounds(spec: LibrarySpec) -> bool:
    """Whether the streams of the library keep all limits."""
    return any(f.name == "stream_all_limits" for f in spec.c_functions)


def filter_sizes(spec: LibrarySpec) -> tuple[int, int, int]:
    """Of the filters of a servo: samples before the present one and after it that their inverse
    needs; notches.
    """
    servo = None if spec.motor_constants is None else spec.motor_constants.servo
    if servo is None:
        return 0, 0, 0
    taps, before = inverse_taps(servo.low_pass, servo.sample_time)
    return before, len(taps) - 1 - before, len(servo.notch)


# functions that growth calls, and its names for them
_CALLED_BY_GROWTH = {"linearize": "evaluate_linearize"}
_CALLED_UNDER_FORCE = {
    "inverse_dynamics_derivatives": "evaluate_growth_inertia",
    "output_constraint": "evaluate_growth_constraint",
}


def has_growth(spec: LibrarySpec) -> bool:
    """Whether the library has the function growth."""
    return any(f.file == "growth.c" for f in spec.c_functions)


def space_of(
    spec: LibrarySpec, written: Mapping[str, FunctionText], names: Sequence[str] = INVERTING
) -> int:
    """The largest workspace of the functions with these names, those that the inversion calls, in
    reals.
    """
    used = (f for f in spec.functions if f.name in names)
    return max(max(works(f, written[f.name], spec.precision)) for f in used)


def stream_key(spec: LibrarySpec) -> int:
    """The number by which a library knows the memory of its own streams: of model, interface,
    precision and layout.

    It has 24 bits, so that it is exact in single precision.
    """
    text = f"{spec.digest} {spec.interface} {spec.precision} {layout_text()}"
    return int(hashlib.sha256(text.encode()).hexdigest()[:6], 16)


def curves_text(constants: MotorConstants, ng: str, join: Callable[[Sequence[float]], str]) -> str:
    """C tables of the curves of elements by another law than Dahl's, see
    `flexgen.dynamics.hysteresis.hysteresis_law.Curve.table`.

    ``ng``: macro with the number of gears; ``join``: writes numbers as an initializer.
    """
    index = ", ".join("{" + ", ".join(map(str, row)) + "}" for row in constants.hysteresis_curve)
    bend = ", ".join(map(join, constants.hysteresis_bend))
    parts = []
    rows = []
    first = 0
    for part, table in constants.curves:
        parts.append(f"{{{', '.join(str(first + k) for k in part)}}}")
        rows += [f"    {join(row)}" for row in table]
        first += len(table)
    parts.append(f"{{{first}, {first}, {first}}}")
    body = ",\n".join(rows)
    return f"""\
static const int hysteresis_curve[ELEMENTS][{ng}] = {{{index}}}; /* -1: Dahl's law */
static const real hysteresis_bend[ELEMENTS][{ng}] = {{{bend}}}; /* second derivative of a curve, \
at most */
/* rows of curve_piece at which a curve, its dense pieces, and those behind them begin */
static const int curve_part[{len(constants.curves) + 1}][3] = {{{", ".join(parts)}}};
/* path at which a piece begins, one over its length, coefficients of powers of the part of it */
static const real curve_piece[{first}][10] = {{
{body}}};
"""


def constants_header(
    spec: LibrarySpec, constants: MotorConstants, written: Mapping[str, FunctionText]
) -> str:
    """Text of ``<name>_motor_constants.h``: numbers of the model as constants."""

    def join(values: Sequence[float]) -> str:
        return f"{{{', '.join(literal(x, spec.precision) for x in values)}}}"

    def integers(name: str, size: str, values: Sequence[int]) -> str:
        return f"static const int {name}[{size}] = {{{', '.join(str(int(x)) for x in values)}}};\n"

    prefix = spec.name.upper()
    ng = f"{prefix}_NG"
    nm = f"{prefix}_NM"
    text = integers("i_g", ng, constants.i_g)
    # not read
    text += (
        integers("i_e", f"{prefix}_NE", constants.i_e)
        if constants.i_e
        else integers("i_e", "1", [0])
    )
    text += integers("gear_is_rigid", ng, [int(x) for x in constants.gear_is_rigid])
    text += integers("gear_is_linear", ng, [int(x) for x in constants.gear_is_linear])
    text += _damping(spec, constants, join)
    for name, A, rows, columns in (
        ("eta", constants.eta, nm, ng),
        ("eta_inverse", constants.eta_inverse, ng, nm),
    ):
        body = ",\n".join(f"    {join(row)}" for row in A)
        text += f"static const real {name}[{rows}][{columns}] = {{\n{body}}};\n"
    text += f"static const real rotor_inertia[{nm}] = {join(constants.rotor_inertia)};\n"
    if elements := count_elements(spec):
        text += f"enum {{ ELEMENTS = {elements} }}; /* of the hysteresis of a gear */\n"
        for name, layers, note in (
            ("stiffness", constants.hysteresis_stiffness, "arm side"),
            ("slip", constants.hysteresis_slip, "0: none"),
        ):
            body = ", ".join(map(join, layers))
            text += (
                f"static const real hysteresis_{name}[ELEMENTS][{ng}] = {{{body}}}; /* {note} */\n"
            )
        text += curves_text(constants, ng, join) if is_curved(spec) else ""
    if is_bristled(spec):
        for name, values in constants.lugre.items():
            note = " /* 0: none */" * (name == "coulomb")
            text += f"static const real lugre_{name}[{nm}] = {join(values)};{note}\n"
    text += _counts_of_motors(spec, constants)
    if (servo := constants.servo) is not None and servo.filters:
        taps = inverse_taps(servo.low_pass, servo.sample_time)[0]
        h = servo.sample_time
        names = ("FILTER_BEFORE", "FILTER_AHEAD", "NOTCHES")
        sizes = ", ".join(
            f"{name} = {n}" for name, n in zip(names, filter_sizes(spec), strict=True)
        )
        text += f"enum {{ {sizes}, FILTER_TAPS = {len(taps)} }}; /* of the servo */\n"
        text += f"static const real filter_tap[FILTER_TAPS] = {join(taps)};\n"
        sections = [one.section(h) for one in servo.notch] or [(1.0, 0.0, 0.0, 0.0, 0.0)]
        text += (
            f"static const real notch_filter[{len(sections)}][5] = "
            f"{{{', '.join(map(join, sections))}}};\n"
        )
        text += f"static const real filter_sample = {literal(h, spec.precision)}; /* s */\n"
    if constants.further:
        angles = ", ".join(str(int(one)) for one in constants.further)
        text += f"enum {{ TOOL_POSITIONS = {constants.positions} }}; /* of the outputs */\n"
        text += f"static const int output_is_angle[{len(constants.further)}] = {{{angles}}};\n"
    if any(f.name == "stream_update" for f in spec.c_functions):
        text += f"enum {{ STREAM_KEY = {stream_key(spec)} }}; /* in the memory of its streams */\n"
    text += _for_growth(spec, written, join(constants.arm_side))
    used = [f for f in spec.functions if f.name in INVERTING]
    space = space_of(spec, written)
    calls = "".join(_call(spec, f, written[f.name].work) + batch_call(spec, f) for f in used)
    return f"""\
/*
 * {spec.name}: gears, motors and the kind of output, for the inversion; private. Written by \
flexgen; see {spec.name}.h.
 */
#ifndef {prefix}_MOTOR_CONSTANTS_H
#define {prefix}_MOTOR_CONSTANTS_H

#include "{spec.name}_private.h"

#define {prefix}_POSE {int(constants.pose)} /* the output is a pose: position, then rotation */
#define {prefix}_PARAMETERS {len(spec.parameters)} /* run-time parameters, stored behind the \
workspace */
#define {prefix}_INVERSION_SPACE {space} /* reals of workspace for the functions below */
#define PARAMETERS_OF(space) ((space) + {prefix}_INVERSION_SPACE + BLOCK)

/* Indices of the coordinates with and without motor; q_m = eta q_g where no gear is deflected. */
{text}
/* The functions that the inversion uses, with a workspace that some of them do not need. */
{_parameter_macros(spec)}{calls}
#endif
"""


def _counts_of_motors(spec: LibrarySpec, constants: MotorConstants) -> str:
    """C of the stages of motors in complete coupling, and of the angles that Fourier sums need."""
    text = ""
    if is_coupled(spec):
        text += (
            f"enum {{ COUPLING_STAGES = {constants.coupling_stages} }}; /* of motors, from the "
            "last joint on */\n"
        )
    if constants.highest_harmonic:  # sixteen angles in the shortest period
        text += (
            f"enum {{ HARMONIC_ANGLES = {16 * constants.highest_harmonic} }}; /* of a turn of a "
            "motor */\n"
        )
    return text


def _call(spec: LibrarySpec, f: FunctionSpec, work: int) -> str:
    """A macro that calls function ``f`` with a workspace, whether it needs one (``work`` > 0
    reals) or not.
    """
    ports, given = _ports_of_call(spec, f)
    call = f"{spec.name}_{f.name}({given}{', work' if work else ''})"
    needed = work or ports != given
    return (
        f"#define evaluate_{f.name}({ports}, work) "
        f"{call if needed else f'((void)(work), {call})'}\n"
    )


def batch_call(spec: LibrarySpec, f: FunctionSpec) -> str:
    """A macro that calls a function for many points."""
    ports, given = _ports_of_call(spec, f)
    name = f"{f.name}_batch"
    if ports == given:
        return f"#define evaluate_{name} {spec.name}_{name}\n"
    return f"#define evaluate_{name}(n, {ports}, work) {spec.name}_{name}(n, {given}, work)\n"


def _ports_of_call(spec: LibrarySpec, f: FunctionSpec) -> tuple[str, str]:
    """The arguments of a macro, and those of the function: the run-time parameters are in the
    workspace.
    """
    names = [p.name for p in (*f.inputs, *f.outputs)]
    held = {"parameters": "PARAMETERS_OF(work)"} if spec.parameters else {}
    return ", ".join(name for name in names if name not in held), ", ".join(
        held.get(name, name) for name in names
    )


def _for_growth(spec: LibrarySpec, written: Mapping[str, FunctionText], arm_side: str) -> str:
    """Macros of the function growth: scales of positions (``arm_side``, written as an
    initializer), and the linearization with a workspace of its own.
    """
    prefix = spec.name.upper()
    grows = has_growth(spec)
    flag = f"#define {prefix}_GROWS {int(grows)} /* the library has the function growth */\n"
    if not grows:
        return flag
    called = _CALLED_BY_GROWTH | (_CALLED_UNDER_FORCE if spec.force else {})
    text = (
        f"{flag}static const real arm_side[{prefix}_NX / 2] = {arm_side}; /* factors of the "
        "positions in a state */\n"
        f"#define {prefix}_LINEARIZE_SPACE {space_of(spec, written, tuple(called))}\n"
    )
    for f in spec.functions:
        if f.name in called:
            text += _call_with_parameters(spec, f, called[f.name], written[f.name].work)
    return text


def _call_with_parameters(spec: LibrarySpec, f: FunctionSpec, named: str, work: int) -> str:
    """A macro that calls a function with parameters and a workspace that it may not need."""
    ports = [p.name for p in (*f.inputs, *f.outputs)]
    macros = ", ".join([*(name for name in ports if name != "parameters"), "parameters", "work"])
    given = ", ".join([*ports, *["work"] * (work > 0)])
    call = f"((void)(parameters), (void)(work), {spec.name}_{f.name}({given}))"
    return f"#define {named}({macros}) {call}\n"


def _damping(
    spec: LibrarySpec, constants: MotorConstants, listed: Callable[[Sequence[float]], str]
) -> str:
    """C of the damping of each gear on the arm side [N m s/rad, N s/m]; one may be a run-time
    parameter times a factor. ``listed``: writes numbers as an initializer.
    """
    ng = f"{spec.name.upper()}_NG"
    at = {
        p.name.removesuffix(".damping"): k
        for k, p in enumerate(spec.parameters)
        if p.name.endswith(".damping")
    }
    index = [at.get(name, -1) for name in constants.gears]
    given = zip(index, constants.damping_factor, constants.gear_damping, strict=True)
    values = [factor if k >= 0 else damping for k, factor, damping in given]
    text = f"static const real gear_damping[{ng}] = {listed(values)}; /* arm side */\n"
    if max(index) < 0:
        body = "    (void)space;\n    return gear_damping[gear];\n"
    else:
        numbers = ", ".join(map(str, index))
        text += "/* run-time parameter that the damping is proportional to; -1: none */\n"
        text += f"static const int damping_parameter[{ng}] = {{{numbers}}};\n"
        body = (
            "    const int k = damping_parameter[gear];\n"
            "    return k < 0 ? gear_damping[gear] : gear_damping[gear] * "
            "PARAMETERS_OF(space)[k];\n"
        )
    return f"{text}static inline real damping_of(int gear, const real *space)\n{{\n{body}}}\n"


def _parameter_macros(spec: LibrarySpec) -> str:
    """Macros of the run-time parameters, which become an argument of the functions where there are
    any.
    """
    count = len(spec.parameters)
    argument = f" const real parameters[{size_macro(spec, 'n_p')}]," if count else ""
    given = "parameters" if count else "no_parameters"
    passed = " parameters," if count else ""
    empty = "" if count else "static const real no_parameters[1] = {0};\n"
    macros = {
        "PARAMETERS_ARGUMENT": argument,
        "GIVEN_PARAMETERS": f" {given}",
        "PASSED_PARAMETERS": passed,
    }
    return empty + "".join(f"#define {name}{text}\n" for name, text in macros.items())
