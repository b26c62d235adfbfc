"""Inverse kinematics of the library: its public header and its private files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flexgen.codegen.emission.c_text import comment, macro
from flexgen.codegen.emission.clib_files import declare, read_clib, render
from flexgen.codegen.emission.constants_header import batch_call, space_of
from flexgen.codegen.emission.kinematic_functions import USED
from flexgen.codegen.emission.spec import LibrarySpec
from flexgen.codegen.statements.function_text import FunctionText
from flexgen.codegen.statements.literals import literal
from flexgen.runtime.identity import CONFIGURATIONS_MAX, STARTS, STARTS_MAX

HEADER = "inverse_kinematics"


def kinematics_header(spec: LibrarySpec) -> str:
    """Text of ``<name>_inverse_kinematics.h``."""
    name = spec.name
    guard = macro(spec, "INVERSE_KINEMATICS_H")
    functions = "\n".join(declare(spec, function) for function in spec.declared_in(HEADER))
    return f"""\
/*
{comment(f"{name}: the joints at a pose of the tool, written by flexgen. Do not edit.")} */
#ifndef {guard}
#define {guard}

#include <stdint.h>

#include "{name}.h"

#ifdef __cplusplus
extern "C" {{
#endif

#define {macro(spec, "CONFIGURATIONS_MAX")} {CONFIGURATIONS_MAX} /* of a pose, away from \
singularities */
#define {macro(spec, "STARTS")} {STARTS} /* recommended, for all configurations */
#define {macro(spec, "STARTS_MAX")} {STARTS_MAX} /* at most */

{functions}
#ifdef __cplusplus
}}
#endif

#endif
"""


def kinematics_files(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> dict[str, str]:
    """The private files of inverse kinematics, by name; none where the library has none."""
    files = sorted({function.file for function in spec.declared_in(HEADER)})
    out = {
        f"{spec.name}_{file}": render(read_clib()[file], spec.name, spec.precision)
        for file in files
    }
    return {f"{spec.name}_kinematic_constants.h": _constants(spec, written), **out} if out else {}


def _constants(spec: LibrarySpec, written: Mapping[str, FunctionText]) -> str:
    """Text of ``<name>_kinematic_constants.h``: numbers of the model, and the functions that the
    search calls.
    """
    constants = spec.kinematic_constants
    prefix = spec.name.upper()
    assert constants is not None

    def define(kind: str, name: str, size: str, values: Sequence[str]) -> str:
        return f"static const {kind} {name}[{prefix}_{size}] = {{{', '.join(values)}}};\n"

    text = define("int", "actuated", "NG", [str(i) for i in constants.i_g])
    text += define("int", "is_angle", "NA", [str(int(x)) for x in constants.is_rotation])
    text += define("int", "spread_around", "NA", [str(int(x)) for x in constants.around])
    for name, values in (("spread_lower", constants.lower), ("spread_upper", constants.upper)):
        text += define("real", name, "NA", [literal(x, spec.precision) for x in values])
    calls = "".join(batch_call(spec, f) for f in spec.functions if f.name in USED)
    return f"""\
/*
 * {spec.name}: joints, for inverse kinematics; private. Written by flexgen; see {spec.name}.h.
 */
#ifndef {prefix}_KINEMATIC_CONSTANTS_H
#define {prefix}_KINEMATIC_CONSTANTS_H

#include "{spec.name}_private.h"

#define {prefix}_KINEMATIC_SPACE {space_of(spec, written, USED)} /* reals of workspace for the \
functions below */

/* Coordinates with a motor; of all coordinates, whether they are rotations; where starts are \
spread: 1 m around
   q_start, or in an interval. */
{text}
/* The functions that the search calls. */
{calls}
#endif
"""
