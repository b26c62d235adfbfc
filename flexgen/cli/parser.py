"""The parser of the command line: verbs, arguments, help texts and usage errors.

Only the standard library and light modules are imported, so that help and usage errors appear at once.
"""

from __future__ import annotations

import argparse
import re
import shutil
import textwrap
from collections.abc import Sequence
from typing import Any, NoReturn

from flexgen import __version__
from flexgen.cli import (
    completion,
    control_arguments,
    export_arguments,
    export_exchange,
    identify_arguments,
    path,
    run,
    solve,
    sweep,
    verbs,
)
from flexgen.cli.argument_types import (
    file_path,
    isa,
    names,
    not_negative,
    numbers,
    positive,
    setting,
    trajectory_file,
)
from flexgen.cli.printing import suggestion
from flexgen.inversion.method_table import NAMES as METHOD_NAMES
from flexgen.mechanics.signatures import TABLE
from flexgen.simulation.hold_names import HOLDS

MODEL = "name in models/ or path of a .toml file, optionally with @variant; or FILE.urdf#BASE:TIP"
METHOD = f"method of inverse dynamics: {', '.join(METHOD_NAMES)}; default: auto"
NUMERIC_OPTIONS = (
    "--pose", "--preview", "--mesh", "--accuracy", "--sample-time", "--delay", "--time", "--joints", "--position",
    "--rotation",
)  # fmt: skip
SEVERAL_NUMBERS = ("--pose", "--joints", "--position", "--rotation")
_NUMBERS = re.compile(r"[-+]?\.?\d[-+.,\deE]*\Z")  # one number, or several with commas

EXAMPLES = """\
examples:
  flexgen models                                      list the models
  flexgen analyze planar5_nmp --pose 0.3 -1.1 0       modes, poles, zeros
  flexgen generate planar5_nmp                        C library in generated/planar5_nmp
  flexgen generate arm.toml --native --single         for this processor, in single precision
  flexgen solve planar5_nmp --report reports/arm      motor torques of the first move, with report
  flexgen sweep examples/sweep.toml --out out/sweep   many cases, on all cores
  flexgen identify arm.toml frf.npz --out new.toml    elastic parameters from frequency responses
  flexgen control planar5_nmp --plant soft:stiffness=0.8   the move under a controller
  flexgen score four_mass --controller all            benchmark of controllers
  flexgen run                                         all steps for planar5_nmp

'flexgen VERB --help' describes the options of a verb.
MODEL is a name in models/ or the path of a .toml file, optionally with @variant; or FILE.urdf#BASE:TIP.
Exit status: 0 success, 1 failure, 2 wrong usage, 3 limits of the model exceeded, 130 interrupted."""


class UsageError(Exception):
    """The command line is wrong: message, then the usage line."""


class _Once(argparse.Action):
    """Store a value; refuse a second one."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        if getattr(namespace, self.dest) is not None:
            raise argparse.ArgumentError(
                self,
                f"given twice ({getattr(namespace, self.dest)} and {values}), expected one; 'flexgen solve' takes "
                "several moves, the other verbs one at a time",
            )
        setattr(namespace, self.dest, values)


class _Parser(argparse.ArgumentParser):
    """An argument parser that raises `UsageError` and suggests similar words."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}\n{self.format_usage().strip()}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            names = [str(choice) for choice in action.choices]
            expected = f"expected one of {', '.join(names)}{suggestion(str(value), names)}"
            raise argparse.ArgumentError(action, f"given {value!r}, {expected}")

    def add_once(self, *words: str, **options: Any) -> None:
        """Add an option that may be given once."""
        self.add_argument(*words, action=_Once, **options)

    def options(self) -> list[str]:
        """All option strings."""
        return [word for word in self._option_string_actions if word.startswith("--")]


# --- verbs ------------------------------------------------------------------------------------------------------------


def build_parser() -> _Parser:
    """The parser of the command line."""
    parser = _Parser(
        prog="flexgen",
        description="Inverse dynamics of elastic robots, from a model file to C that runs in a controller.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"flexgen {__version__}")
    group = parser.add_subparsers(dest="verb", metavar="VERB")
    _add_verb(group, "models", verbs.models, model=False)
    _add_verb(group, "describe", verbs.describe)
    _add_derive_arguments(_add_verb(group, "derive", verbs.derive))
    _add_analyze_arguments(_add_verb(group, "analyze", verbs.analyze))
    _add_generate_arguments(_add_verb(group, "generate", verbs.generate))
    _add_solve_arguments(_add_verb(group, "solve", solve.solve))
    _add_path_arguments(_add_verb(group, "path", path.path))
    sub = _add_verb(group, "simulate", solve.simulate)
    sub.add_argument("trajectory", metavar="TRAJECTORY", type=file_path, help="file written by 'flexgen solve --out'")
    sub.add_argument("--out", metavar="FILE", type=trajectory_file, help="write the simulated motion to this file")
    sweep.add_arguments(_add_verb(group, "sweep", verbs.sweep, model=False))
    identify_arguments.add_verbs(group, _add_verb)
    control_arguments.add_verbs(group, _add_verb)
    export_arguments.add_verbs(group, _add_verb)
    export_exchange.add_verbs(group, _add_verb)
    _add_run_arguments(_add_verb(group, "run", run.run))
    sub = _add_verb(group, "completion", completion.completion, model=False)
    sub.add_argument("shell", metavar="SHELL", choices=completion.SHELLS, help=", ".join(completion.SHELLS))
    sub.set_defaults(root=parser)
    return parser


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line.

    Raises
    ------
    UsageError
        It is wrong; the message suggests the verb, value or option that was probably meant.
    """
    parser = build_parser()
    args, unknown = parser.parse_known_args(_join_numbers(words))
    if unknown:
        here: _Parser = getattr(args, "parser", parser)
        here.error(f"unknown arguments {' '.join(unknown)}, see '{here.prog} --help'{_similar_option(unknown, here)}")
    return args


def _similar_option(unknown: Sequence[str], parser: _Parser) -> str:
    words = [word.partition("=")[0] for word in unknown if word.startswith("--")]
    return suggestion(words[0], parser.options()) if words else ""


def _join_numbers(words: Sequence[str]) -> list[str]:
    """``--pose -0.3 1`` as ``--pose=-0.3,1``: argparse would take negative numbers for options."""
    out: list[str] = []
    words, k = list(words), 0
    while k < len(words):
        option, k = words[k], k + 1
        values: list[str] = []
        while option in NUMERIC_OPTIONS and k < len(words) and (not values or option in SEVERAL_NUMBERS):
            if not _NUMBERS.match(words[k]):
                break
            values.append(words[k])
            k += 1
        joined = ",".join([*(value.rstrip(",") for value in values[:-1]), *values[-1:]])
        out.append(f"{option}={joined}" if values else option)
    return out


def _add_verb(group: Any, name: str, action: Any, model: bool = True) -> _Parser:
    """Add a verb; the first line of the docstring of its function is its help."""
    summary = (action.__doc__ or "").strip().partition("\n")[0]
    parser: _Parser = group.add_parser(name, help=summary, description=summary, allow_abbrev=False)
    parser.set_defaults(action=action, parser=parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    amount = parser.add_mutually_exclusive_group()
    amount.add_argument("-q", "--quiet", action="store_true", help="no progress messages on standard error")
    amount.add_argument("-v", "--verbose", action="store_true", help="more details, and the time of each message")
    parser.add_argument("--log", metavar="FILE", type=file_path, help="append messages and results to this file")
    if model:
        optional: dict[str, Any] = {"nargs": "?", "default": "planar5_nmp"} if name == "run" else {}
        default = "; default: planar5_nmp" if optional else ""
        parser.add_argument("model", metavar="MODEL", help=MODEL + default, **optional)
        parser.add_argument(
            "--set",
            metavar="KEY=VALUE",
            type=setting,
            action="append",
            help="change a value of the model: dotted path of the key, TOML value; may be repeated",
        )
    return parser


def _add_derive_arguments(parser: _Parser) -> None:
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--text", action="store_true", help="equations as plain text (default for small models)")
    kind.add_argument("--latex", action="store_true", help="equations as a LaTeX document")
    parser.add_argument(
        "--out", metavar="FILE", type=file_path, help="write the equations to this file (.tex: as LaTeX)"
    )


def _add_analyze_arguments(parser: _Parser) -> None:
    parser.add_argument(
        "--pose", metavar="Q", type=numbers, help="arm coordinates [rad or m], such as 0.3 -1.1 0; default: home"
    )
    parser.add_once("--move", metavar="NAME", help="also analyze zeros and solvability along this move")
    parser.add_argument("--report", metavar="DIR", type=file_path, help="write a self-contained HTML page to DIR")


def _add_generate_arguments(parser: _Parser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = f"functions:\n{_function_list()}"
    parser.add_argument("--directory", metavar="DIR", type=file_path, help="output directory; default: generated/MODEL")
    parser.add_argument("--no-build", action="store_true", help="write the sources, do not compile")
    parser.add_argument(
        "--functions",
        metavar="NAME,NAME,...",
        type=names,
        help="only these functions of the list below, without inversion of whole paths; default: all",
    )
    parser.add_argument(
        "--parameters",
        metavar="NAME,NAME,...",
        type=names,
        default=(),
        help="model parameters that become arguments of the functions: payload, stiffness, damping, friction, "
        "q2.stiffness, ...",
    )
    parser.add_argument("--single", action="store_true", help="single precision (float); default: double")
    parser.add_argument(
        "--native", action="store_true", help="contract products and sums: a little faster, results differ by rounding"
    )
    parser.add_argument(
        "--isa",
        metavar="ISA",
        default="native",
        type=isa,
        help="instruction set of the compiled libraries, same results for each: native (this processor, the default), "
        "x86-64, v2, v3 (AVX2) or v4 (AVX-512) for other computers",
    )
    parser.add_argument("--openmp", action="store_true", help="batch functions use all cores")
    parser.add_argument("--amalgamate", action="store_true", help="write one header and one C file")
    parser.add_argument("--force", action="store_true", help="build even if nothing has changed")


def _function_list() -> str:
    """The functions of `flexgen.mechanics.signatures`, one paragraph each."""
    width = max(min(100, shutil.get_terminal_size().columns - 2), 60)
    layout: dict[str, Any] = {"subsequent_indent": " " * 32, "break_on_hyphens": False}
    return "\n".join(textwrap.fill(r.summary, width, initial_indent=f"  {r.name:<30}", **layout) for r in TABLE)


def _add_solve_arguments(parser: _Parser) -> None:
    parser.add_argument(
        "--move",
        metavar="NAME",
        action="append",
        help="a move or program of the model file; default: the first; given several times: all of them, with "
        "FILE_NAME and DIR/NAME as outputs",
    )
    parser.add_argument("--moves", metavar="FILE", type=file_path, help="read moves and programs from this TOML file")
    parser.add_argument("--method", choices=METHOD_NAMES, metavar="NAME", default="auto", help=METHOD)
    parser.add_argument(
        "--out", metavar="FILE", type=trajectory_file, help="write the trajectory to this file (.npz, .csv or .mat)"
    )
    parser.add_argument("--report", metavar="DIR", type=file_path, help="write a self-contained HTML report to DIR")
    parser.add_argument(
        "--robustness",
        action="store_true",
        help="with --report: also simulate robots with stiffness errors of 5 and 20 %% and mass errors of 5 %% (takes "
        "minutes)",
    )
    parser.add_argument("--no-verify", action="store_true", help="skip the verification by forward simulation")
    parser.add_argument(
        "--preview", metavar="S", type=not_negative, help="longest time that the motion may start before the path [s]"
    )
    parser.add_argument("--mesh", metavar="S", type=positive, help="length of the mesh intervals [s]")
    parser.add_argument(
        "--limits",
        action="store_true",
        help="enforce the torque and speed limits of the model (methods lq, collocation, full)",
    )
    parser.add_argument(
        "--fastest",
        action="store_true",
        help="with the fastest time law within the limits; 'flexgen fastest' has further options",
    )
    parser.add_argument("--accuracy", metavar="X", type=positive, help="largest accepted output error [m and rad]")
    parser.add_argument(
        "--fixed-joint",
        metavar="NAME",
        help="of an arm with more motors than outputs: the joint that keeps its value in a move of the tool",
    )
    _add_bounds_arguments(parser)
    parser.add_argument(
        "--hold",
        choices=HOLDS,
        metavar="NAME",
        default="spline",
        help="what the controller does between its ticks: spline (default), linear, or zoh (zero-order hold); the "
        "torques to send are verified with it and written to FILE_command beside --out FILE",
    )
    parser.add_argument(
        "--sample-time", metavar="S", type=positive, help="sample time of the controller [s]; default: 0.001"
    )
    parser.add_argument(
        "--delay",
        metavar="S",
        type=not_negative,
        default=0.0,
        help="time from a tick of the controller until the motor has the torque [s]; default: 0",
    )


def _add_bounds_arguments(parser: _Parser) -> None:
    parser.add_argument(
        "--ignore-limits",
        action="store_true",
        help="report a solution beyond the limits of the model file as solved (for studies); without it the exit "
        "status is 3",
    )
    parser.add_argument(
        "--time",
        metavar="SECONDS",
        type=not_negative,
        default=120.0,
        help="time limit of each solve [s]: then, or after Ctrl-C, it ends with the best solution so far (exit status "
        "1, or 130); default: 120; 0: no limit",
    )


def _add_path_arguments(parser: _Parser) -> None:
    parser.add_once("--move", metavar="NAME", help="a move or program of the model file; default: the first")
    parser.add_argument("--moves", metavar="FILE", type=file_path, help="read moves and programs from this TOML file")
    parser.add_argument(
        "--table",
        metavar="FILE",
        type=file_path,
        help="write the path as a C header for MODEL_path_sample to this file",
    )


def _add_run_arguments(parser: _Parser) -> None:
    parser.add_once("--move", metavar="NAME", help="a move or program of the model file; default: the first")
    parser.add_argument("--method", choices=METHOD_NAMES, metavar="NAME", default="auto", help=METHOD)
    _add_bounds_arguments(parser)
    parser.add_argument("--directory", metavar="DIR", type=file_path, help="of the C library; default: generated/MODEL")
    parser.add_argument("--report", metavar="DIR", type=file_path, help="of the report; default: reports/MODEL")
