"""The header ``<name>_selftest_cases.h`` of a self-test: states, expected results and the calls of
the library.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexgen.codegen.emission.c_text import comment
from flexgen.exports.c_code.emitted import Emitted, StreamOptions
from flexgen.exports.c_code.selftest.golden import POINTS, Rest
from flexgen.exports.c_code.selftest.motion import Motion

# of the expected results: the last bits depend on the mathematics library of the computer that
# exports
DIGITS = 14
# Largest errors and the part of the largest entry that an entry counts at least. Double: an error
# of 1e-9 is a wrong formula or a wrong argument, rounding is below 1e-11. Single: deflections of
# stiff gears are differences of large angles, whose rounding the stiffness multiplies.
LIMITS = {"double": (1e-9, 1e-3), "single": (2e-2, 1e-1)}
# Of streams: their residual is 1e-6 of a torque, and the horizon is finite; the reference has
# another mesh.
STREAM_LIMITS = {"double": 1e-4, "single": 5e-2}
REST_LIMITS = {"double": 1e-6, "single": 1e-2}


def cases(
    library: Emitted,
    given: Mapping[str, np.ndarray],
    results: Mapping[str, np.ndarray],
    rest: Rest | None,
    motion: Motion | None,
) -> str:
    """The text of the header.

    Parameters
    ----------
    library : Emitted
    given, results : mapping of str to array
        States and what the definition gives for them, see
        `flexgen.exports.c_code.selftest.golden`.
    rest, motion : Rest and Motion, optional
        The tests of a stream; None where the library has none, or not this one.
    """
    name = library.name
    precision = library.manifest["precision"]
    tolerance, part = LIMITS[precision]
    functions = library.functions
    end = "f" if precision == "single" else ""
    used = [x for x in given if any(p["name"] == x for f in functions for p in f["inputs"])]
    tables = "".join(_table(f"given_{x}", given[x], f"const {name}_real", 9, end) for x in used)
    tables += "".join(
        _table(f"expected_{key.replace('.', '_')}", results[key], "const double")
        for key in results
    )
    text = f"""\
{_head(name)}
{tables}
static void selftest_points(selftest_result *result)
{{
    for (int k = 0; k < {POINTS}; ++k) {{
{"".join(_call(name, f, tolerance, part) for f in functions)}    }}
}}

"""
    options = library.stream
    text += (
        _at_rest(name, options, rest, REST_LIMITS[precision], end)
        if rest and options
        else _empty("at_rest")
    )
    text += "\n"
    text += (
        _in_motion(name, motion, STREAM_LIMITS[precision], end) if motion else _empty("in_motion")
    )
    return text


def _head(name: str) -> str:
    text = (
        f"{name}: states and expected results of the self-test, from Lagrange's equations of "
        f"the model. Written by flexgen; included by {name}_selftest.c."
    )
    return "/*\n" + comment(text) + " */\n"


def _number(x: float, digits: int = DIGITS, end: str = "") -> str:
    """A literal, rounded to so many digits; ``end``: "f" for single precision."""
    assert np.isfinite(x)
    text = f"{x:.{digits}g}"
    return (text if "." in text or "e" in text else f"{text}.0") + end


def _table(name: str, rows: np.ndarray, kind: str, digits: int = DIGITS, end: str = "") -> str:
    """A static array in C of the numbers ``rows`` (rows, columns), of the type ``kind``, with
    ``digits`` each and the suffix ``end``.
    """
    lines = []
    for row in np.atleast_2d(rows):
        words = [_number(x, digits, end) for x in row]
        line = ""
        out = []
        for word in words:
            if len(line) + len(word) > 108:
                out.append(line)
                line = ""
            line += f"{word}, "
        out.append(line)
        lines.append(
            "    {" + "\n     ".join(piece.rstrip() for piece in out).rstrip(",") + "},\n"
        )
    return (
        f"static {kind} {name}[{len(lines)}][{np.atleast_2d(rows).shape[1]}] = {{\n"
        f"{''.join(lines)}}};\n"
    )


def _call(name: str, function: Mapping[str, Any], tolerance: float, part: float) -> str:
    """The call of a function of the library ``name`` at state k, and the comparison of its
    results: absolute ``tolerance``, and ``part`` of the expected value.
    """
    f = function["name"]
    ports: Sequence[Mapping[str, Any]] = function["outputs"]
    sizes = {port["name"]: int(np.prod(port["shape"])) for port in ports}
    lines = [f"{name}_real {port}[{size}];" for port, size in sizes.items()]
    lines += [f"static {name}_real work[{name.upper()}_WORK];"] * bool(function["work"])
    words = (
        [f"given_{port['name']}[k]" for port in function["inputs"]]
        + list(sizes)
        + ["work"] * function["work"]
    )
    lines += [f'check_status(result, "{f}", {name}_{f}({", ".join(words)}));']
    lines += [
        (
            f'compare(result, "{f}.{port}", {port}, expected_{f}_{port}[k], {size}, '
            f"{tolerance!r}, {part!r});"
        )
        for port, size in sizes.items()
    ]
    return "        {\n" + "".join(f"            {line}\n" for line in lines) + "        }\n"


def _empty(what: str) -> str:
    body = "    (void)result; /* not in this program */\n    (void)compare_rows;\n"
    return f"static void selftest_{what}(selftest_result *result)\n{{\n{body}}}\n"


def _options(name: str, options: StreamOptions, end: str) -> str:
    counts = (
        f".intervals = {options.intervals}, .samples_per_interval = {options.samples_per_interval}"
    )
    numbers = f".period = {options.period!r}{end}, .tolerance = {options.tolerance!r}{end}"
    return f"const {name}_stream_options options = {{{counts}, {numbers}}};"


def _stream(name: str, options: StreamOptions, end: str) -> str:
    """The declarations of a stream with static memory; ``end``: suffix of numbers."""
    NAME = name.upper()
    return f"""\
    static {name}_real memory[{NAME}_STREAM_SIZE({options.intervals}, \
{options.samples_per_interval})];
    static {name}_real q_m[{options.samples_per_interval} * {NAME}_NM];
    static {name}_real tau_m[{options.samples_per_interval} * {NAME}_NM];
    const {name}_stream stream = {{.memory = memory, .size = (int64_t)(sizeof memory / sizeof \
memory[0])}};
    {_options(name, options, end)}
    {name}_motion motion = {{.q_m = q_m, .tau_m = tau_m}};
    {name}_stream_info info;
"""


def _at_rest(name: str, options: StreamOptions, rest: Rest, tolerance: float, end: str) -> str:
    """The C test of a stream that stays at the home pose: its motors hold the robot as the static
    equations say, within ``tolerance``.
    """
    NAME = name.upper()
    tables = _table("rest_y", rest.y, f"const {name}_real", 17, end) + _table(
        "rest_q_a", rest.q_a, f"const {name}_real", 17, end
    )
    tables += _table("rest_q_m", rest.q_m, "const double") + _table(
        "rest_tau_m", rest.tau_m, "const double"
    )
    return f"""\
{tables}
static void selftest_at_rest(selftest_result *result)
{{
{_stream(name, options, end)}    const {name}_real zero[{NAME}_NY] = {{0}};
    check_status(result, "stream_start, at rest", {name}_stream_start(&stream, &options, \
rest_y[0], rest_q_a[0]));
    for (int k = 0; k < {options.intervals + 2}; ++k) {{
        const {name}_status status = {name}_stream_update(&stream, rest_y[0], zero, zero, \
&motion, &info);
        check_status(result, "stream_update, at rest", status);
        compare(result, "stream_update.q_m, at rest", q_m, rest_q_m[0], {NAME}_NM, {tolerance!r}, \
1e-3);
        compare(result, "stream_update.tau_m, at rest", tau_m, rest_tau_m[0], {NAME}_NM, \
{tolerance!r}, 1e-3);
    }}
}}
"""


def _in_motion(name: str, motion: Motion, tolerance: float, end: str) -> str:
    """A stream along a move: torques as another method found them. The error is relative to the
    largest torque.
    """
    NAME = name.upper()
    options = motion.options
    tables = "".join(
        _table(f"move_{key}", getattr(motion, key), f"const {name}_real", 17, end)
        for key in ("y", "dy", "ddy", "q_start")
    ) + _table("move_tau_m", motion.tau_m, "const double")
    return f"""\
{tables}
static void selftest_in_motion(selftest_result *result)
{{
{_stream(name, options, end)}    static {name}_real found[{len(motion.tau_m)} * {NAME}_NM];
    check_status(result, "stream_start", {name}_stream_start(&stream, &options, move_y[0], \
move_q_start[0]));
    for (int k = 0; k < {len(motion.tau_m)}; ++k) {{
        const {name}_status status =
            {name}_stream_update(&stream, move_y[k + 1], move_dy[k + 1], move_ddy[k + 1], \
&motion, &info);
        if (status < 0) {{
            check_status(result, "stream_update", status);
            return;
        }}
        for (int j = 0; j < {NAME}_NM; ++j) {{
            found[k * {NAME}_NM + j] = tau_m[j];
        }}
    }}
    compare_rows(result, "stream_update.tau_m", found, move_tau_m[0], {len(motion.tau_m)}, \
{NAME}_NM, {tolerance!r});
}}
"""
