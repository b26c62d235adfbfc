"""The parser of the command line: verbs, arguments, help texts and usage errors.

Only the standard library and light modules are imported, so that help and usage errors appear at once.
"""

from __future__ import annotations

import argparse
import shutil
import textwrap
from collections.abc import Sequence
from typing import Any

from flexgen.cli import (
    completion,
    control_arguments,
    export_arguments,
    export_exchange,
    identify_arguments,
    run,
    solve_arguments,
    sweep,
    verbs,
)
from flexgen.cli.argument_parser import MESSAGES, Once, Parser, UsageError
from flexgen.cli.argument_types import file_path, isa, names, numbers, setting
from flexgen.cli.own_robot import check, new
from flexgen.mechanics.signatures import TABLE
from flexgen.version import __version__

__all__ = ["EXAMPLES", "UsageError", "build_parser", "parse"]

MODEL = "name in models/ or path of a .toml file, optionally with @variant; or FILE.urdf#BASE:TIP"

EXAMPLES = """\
examples:
  flexgen models                                      list the models
  flexgen new arm --template six-axis                 a model file to start with
  flexgen check arm.toml                              wrong units and implausible numbers
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


# --- verbs ------------------------------------------------------------------------------------------------------------


def build_parser() -> Parser:
    """The parser of the command line."""
    parser = Parser(
        prog="flexgen",
        description="Inverse dynamics of elastic robots, from a model file to C that runs in a controller.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("-h", "--help", action="help", help="show this help")
    parser.add_argument("--version", action="version", version=f"flexgen {__version__}")
    group = parser.add_subparsers(dest="verb", metavar="VERB")
    _add_verb(group, "models", verbs.models, model=False)
    new.add_arguments(_add_verb(group, "new", new.new, model=False))
    _add_verb(group, "describe", verbs.describe)
    _add_verb(group, "check", check.check)
    _add_derive_arguments(_add_verb(group, "derive", verbs.derive))
    _add_analyze_arguments(_add_verb(group, "analyze", verbs.analyze))
    _add_generate_arguments(_add_verb(group, "generate", verbs.generate))
    solve_arguments.add_verbs(group, _add_verb)
    sweep.add_arguments(_add_verb(group, "sweep", verbs.sweep, model=False))
    identify_arguments.add_verbs(group, _add_verb)
    control_arguments.add_verbs(group, _add_verb)
    export_arguments.add_verbs(group, _add_verb)
    export_exchange.add_verbs(group, _add_verb)
    solve_arguments.add_run_arguments(_add_verb(group, "run", run.run))
    sub = _add_verb(group, "completion", completion.completion, model=False)
    sub.add_argument("shell", metavar="SHELL", choices=completion.SHELLS, help=", ".join(completion.SHELLS))
    sub.set_defaults(root=parser)
    for verb in parser.verbs():
        _add_message_arguments(verb)
    return parser


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line.

    Raises
    ------
    UsageError
        It is wrong; the message suggests the verb, value or option that was probably meant.
    """
    parser = build_parser()
    args, unknown = parser.parse_known_args(words)
    if unknown:
        here: Parser = getattr(args, "parser", parser)
        hint = here.hint(words, unknown, parser)
        here.error(f"unknown arguments {' '.join(unknown)}, see '{here.prog} --help'{hint}")
    return args


def _add_verb(group: Any, name: str, action: Any, model: bool = True) -> Parser:
    """Add a verb; the first line of the docstring of its function is its help."""
    summary = (action.__doc__ or "").strip().partition("\n")[0]
    parser: Parser = group.add_parser(name, help=summary, description=summary)
    parser.set_defaults(action=action, parser=parser)
    if model:
        optional: dict[str, Any] = {"nargs": "?", "default": "planar5_nmp"} if name == "run" else {}
        default = "; default: planar5_nmp" if optional else ""
        parser.add_argument("model", metavar="MODEL", help=MODEL + default, **optional)
        parser.section("model").add_argument(
            "--set",
            metavar="KEY=VALUE",
            type=setting,
            action="append",
            help="change a value of the model: dotted path of the key, TOML value; may be repeated",
        )
    return parser


def _add_message_arguments(parser: Parser) -> None:
    """Add the options that each verb has, as the last section of its help."""
    section = parser.section(MESSAGES)
    section.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    amount = section.add_mutually_exclusive_group()
    amount.add_argument("-q", "--quiet", action="store_true", help="no progress messages on standard error")
    amount.add_argument("-v", "--verbose", action="store_true", help="more details, and the time of each message")
    section.add_argument("--log", metavar="FILE", type=file_path, help="append messages and results to this file")
    section.add_argument("-h", "--help", action="help", help="show this help")


def _add_derive_arguments(parser: Parser) -> None:
    files = parser.section("files")
    kind = files.add_mutually_exclusive_group()
    kind.add_argument("--text", action="store_true", help="equations as plain text (default for small models)")
    kind.add_argument("--latex", action="store_true", help="equations as a LaTeX document")
    files.add_argument(
        "--out", metavar="FILE", type=file_path, help="write the equations to this file (.tex: as LaTeX)"
    )


def _add_analyze_arguments(parser: Parser) -> None:
    where = parser.section("where")
    where.add_argument(
        "--pose", metavar="Q ...", type=numbers, help="arm coordinates [rad or m], such as 0.3 -1.1 0; default: home"
    )
    where.add_argument("--move", metavar="NAME", action=Once, help="also analyze zeros and solvability along this move")
    parser.section("files").add_argument(
        "--report", metavar="DIR", type=file_path, help="write a self-contained HTML page to DIR"
    )


def _add_generate_arguments(parser: Parser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = f"functions:\n{_function_list()}"
    parser.add_folder("folder of the library; default: generated/MODEL")
    files, content, build = parser.section("files"), parser.section("content"), parser.section("compilation")
    build.add_argument("--no-build", action="store_true", help="write the sources, do not compile")
    content.add_argument(
        "--functions",
        metavar="NAME,NAME,...",
        type=names,
        help="only these functions of the list below, without inversion of whole paths; default: all",
    )
    content.add_argument(
        "--parameters",
        metavar="NAME,NAME,...",
        type=names,
        default=(),
        help="model parameters that become arguments of the functions: payload, stiffness, damping, friction, "
        "q2.stiffness, ...",
    )
    content.add_argument(
        "--with",
        dest="parts",
        metavar="NAME,NAME,...",
        type=names,
        default=(),
        help="optional parts: bvp, another method for whole paths, to check invert",
    )
    content.add_argument("--single", action="store_true", help="single precision (float); default: double")
    build.add_argument(
        "--native", action="store_true", help="contract products and sums: a little faster, results differ by rounding"
    )
    build.add_argument(
        "--isa",
        metavar="ISA",
        default="native",
        type=isa,
        help="instruction set of the compiled libraries, same results for each: native (this processor, the default), "
        "x86-64, v2, v3 (AVX2) or v4 (AVX-512) for other computers",
    )
    build.add_argument("--openmp", action="store_true", help="batch functions use all cores")
    files.add_argument("--amalgamate", action="store_true", help="write one header and one C file")
    files.add_argument("--force", action="store_true", help="build even if nothing has changed")


def _function_list() -> str:
    """The functions of `flexgen.mechanics.signatures`, one paragraph each."""
    width = max(min(100, shutil.get_terminal_size().columns - 2), 60)
    layout: dict[str, Any] = {"subsequent_indent": " " * 32, "break_on_hyphens": False}
    return "\n".join(textwrap.fill(r.summary, width, initial_indent=f"  {r.name:<30}", **layout) for r in TABLE)
