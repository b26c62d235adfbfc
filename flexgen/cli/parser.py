"""The parser of the command line, from the rows of `flexgen.cli.verb_tables.verbs`: arguments,
help texts and usage errors.

Only the standard library and light modules are imported, and only the module of the verb that is
run, so that help and usage errors appear at once.
"""

from __future__ import annotations

import argparse
import shutil
import textwrap
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from flexgen.base.registry import Option, added_names
from flexgen.base.version import __version__
from flexgen.cli import argument_types
from flexgen.cli.argument_parser import MESSAGES, OldName, Once, Parser, UsageError
from flexgen.cli.verb_tables.signature_source import defaults_of, signature_of
from flexgen.cli.verb_tables.verb_rows import PATHS, Verb
from flexgen.cli.verb_tables.verb_texts import choices_of, help_of
from flexgen.cli.verb_tables.verbs import VERBS, export_row

__all__ = ["EXAMPLES", "UsageError", "build_parser", "parse"]

MODEL = "name in models/ or path of a .toml file, optionally with @variant; or FILE.urdf#BASE:TIP"
EXPORT = (
    "Write the robot for another tool: a simulation program, a controller, a robot description."
)
# The verbs of the help, in five groups in the order of the work; those of other packages come
# last.
GROUPS = {
    "a robot and its equations": "models new describe check derive analyze view schema",
    "inverse dynamics, and the C of it": "run solve generate plan fastest kinematics simulate",
    "robots that differ from their model": (
        "predict control tune score learn command-positions compare-shapers sense"
    ),
    "identification": (
        "excite measure frf identify identify-servo identify-load identify-gears identify-spring "
        "calibrate commission compare-record"
    ),
    "other tools, many cases": "export sweep completion",
}
RUN_MODEL = "planar5_nmp"  # of `flexgen run`, where none is given

EXAMPLES = """\
examples:
  flexgen models                                      list the models
  flexgen new arm --template six-axis                 a model file to start with
  flexgen check arm.toml                              wrong units and implausible numbers
  flexgen analyze planar5_nmp --pose 0.3 -1.1 0       modes, poles, zeros
  flexgen generate planar5_nmp                        C library in generated/planar5_nmp
  flexgen generate arm.toml --native --precision single   for this processor, in single precision
  flexgen solve planar5_nmp --report reports/arm      motor torques of the first move, with report
  flexgen sweep examples/sweep.toml --out out/sweep   many cases, on all cores
  flexgen identify arm.toml frf.npz --out new.toml    elastic parameters from frequency responses
  flexgen control planar5_nmp --plant soft:stiffness=0.8   the move under a controller
  flexgen score four_mass --controller all            benchmark of controllers
  flexgen run                                         all steps for planar5_nmp

'flexgen VERB --help' describes the options of a verb.
MODEL is a name in models/ or the path of a .toml file, optionally with @variant; or \
FILE.urdf#BASE:TIP.
Exit status: 0 success, 1 failure, 2 wrong usage, 3 limits of the model exceeded, 130 \
interrupted."""


class _GroupedHelp(argparse.RawDescriptionHelpFormatter):
    """The help of flexgen: its verbs in `GROUPS`."""

    def _format_action(self, action: argparse.Action) -> str:
        """The list of verbs under the titles of their `GROUPS`, those of other packages last;
        other actions as argparse shows them.
        """
        if not isinstance(action, argparse._SubParsersAction):
            return super()._format_action(action)
        rows = {row.dest: row for row in action._choices_actions}
        names = [(title, group.split()) for title, group in GROUPS.items()]
        others = [name for name in rows if all(name not in group for _, group in names)]
        if others:
            names.append(("of other packages", others))
        parts = []
        for title, group in names:
            indent = " " * self._current_indent
            parts.append(f"{indent}{title}\n")
            self._indent()
            for name in group:
                if name in rows:
                    parts.append(super()._format_action(rows[name]))
            self._dedent()
        return "".join(parts)


def build_parser(only: str | None = None) -> Parser:
    """The parser of the command line; ``only``: with the arguments of this verb alone; empty: of
    none.
    """
    parser = Parser(
        prog="flexgen",
        description="Inverse dynamics of elastic robots, from a model file to C that runs in a "
        "controller.",
        epilog=EXAMPLES,
        formatter_class=_GroupedHelp,
    )
    parser.add_argument("-h", "--help", action="help", help="show this help")
    parser.add_argument("--version", action="version", version=f"flexgen {__version__}")
    group = parser.add_subparsers(dest="verb", metavar="VERB", title="verbs")
    kinds: Any = None
    all_of_them = only != "" and only not in {name.partition(" ")[0] for name in VERBS}
    of_others = added_names("exports") if all_of_them or only == "export" else ()
    rows = [*VERBS.values()]
    at = 1 + max(k for k, verb in enumerate(rows) if verb.name.startswith("export "))
    for verb in [*rows[:at], *(export_row(name) for name in of_others), *rows[at:]]:
        name, _, kind = verb.name.partition(" ")
        if kind and kinds is None:
            kinds = _add_export(group)
        if all_of_them or name == only:
            _add_verb(kinds if kind else group, kind or name, verb, parser)
        elif not kind:
            helped: dict[str, Any] = {"help": summary_of(verb)} if only == "" else {}
            group.add_parser(name, **helped)
    return parser


def _refuse_options_before_verb(words: Sequence[str]) -> None:
    """Raise an error for options such as ``-q`` that stand before a verb."""
    verbs = {name.partition(" ")[0] for name in VERBS}
    at = next((k for k, word in enumerate(words) if word in verbs), 0)
    before = words[:at]
    if at and before[0].startswith("-") and not {"-h", "--help", "--version"} & {*before}:
        given = " ".join(before)
        build_parser("").error(
            f"given {given} before the verb {words[at]}, expected options after it: "
            f"'flexgen {words[at]} ... {given}'"
        )


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line.

    ``given`` of the result has the names of the arguments that were given; the others have the
    defaults of the public function of the verb.

    Raises
    ------
    UsageError
        It is wrong; the message suggests the verb, value or option that was probably meant.
    """
    former = {verb.old: verb.name for verb in VERBS.values() if verb.old}
    new = former.get(words[0], "") if words else ""
    words = [new, *words[1:]] if new else words
    _refuse_options_before_verb(words)
    if not words or words[0] in ("-h", "--help"):
        only: str | None = ""
    else:
        only = words[0] if words[0] != "completion" else None  # completion is a text of all verbs
    args, unknown = build_parser(only).parse_known_args(words)
    if unknown:
        parser = build_parser()
        here: Parser = getattr(args, "parser", parser)
        hint = here.hint(words, unknown, parser)
        here.error(f"unknown arguments {' '.join(unknown)}, see '{here.prog} --help'{hint}")
    row: Verb | None = getattr(args, "row", None)
    if new:
        note = (
            f"{next(old for old in former if former[old] == new)} is the old name of {new}, "
            "please use the new one"
        )
        args.notes = [*getattr(args, "notes", ()), note]
    if row is not None:
        defaults = defaults_of(row.function) if row.function else {}
        names = {option.parameter: option for option in row.options()}
        args.given = frozenset(name for name in names if getattr(args, name) is not None)
        for name in names.keys() - args.given:
            switched = None if names[name].takes_value else names[name].name.startswith("no_")
            setattr(args, name, None if names[name].several else defaults.get(name, switched))
    return args


def _add_export(group: Any) -> Any:
    """The verb export, whose kinds are parsers of their own."""
    parser = group.add_parser("export", help=EXPORT, description=EXPORT)
    parser.add_argument("-h", "--help", action="help", help="show this help")
    return parser.add_subparsers(dest="kind", metavar="KIND", required=True)


def _action(verb: Verb) -> Any:
    """The function that runs a verb."""
    module, _, function = (verb.action or "plain:plain").partition(":")
    return getattr(import_module(f"flexgen.cli.verbs.{module}"), function)


def summary_of(verb: Verb) -> str:
    """Summary of a verb: of its row, or the first paragraph of the docstring of its function."""
    if not (verb.summary or verb.action):
        return signature_of(verb.function).summary
    paragraph = (_action(verb).__doc__ or "").strip().partition("\n\n")[0]
    return verb.summary or " ".join(paragraph.split())


def _add_verb(group: Any, name: str, verb: Verb, root: Parser) -> None:
    """Add a verb; the first paragraph of the docstring of its function is its help."""
    action = _action(verb)
    summary = summary_of(verb)
    parser: Parser = group.add_parser(name, help=summary, description=summary)
    parser.set_defaults(action=action, parser=parser, row=verb, root=root)
    if verb.takes_model != "none":
        optional: dict[str, Any] = (
            {"nargs": "?", "default": RUN_MODEL} if verb.takes_model == "optional" else {}
        )
        default = f"; default: {RUN_MODEL}" if optional else ""
        parser.add_argument("model", metavar="MODEL", help=MODEL + default, **optional)
        parser.section("model").add_argument(
            "--set",
            metavar="KEY=VALUE",
            type=argument_types.setting,
            action="append",
            help="change a value of the model: dotted path of the key, TOML value; may be "
            "repeated",
        )
    if name == "generate":
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
        parser.epilog = f"functions:\n{_function_list()}"
    defaults = defaults_of(verb.function) if verb.function else {}
    for title, options in verb.sections.items():
        exclusive: dict[str, Any] = {}
        for option in options:
            section: Any = parser if option.place else parser.section(title)
            if option.group:
                if option.group not in exclusive:
                    exclusive[option.group] = section.add_mutually_exclusive_group()
                section = exclusive[option.group]
            _add_option(parser, section, option, defaults.get(option.parameter))
    _add_message_arguments(parser)


def _add_option(parser: Parser, section: Any, option: Option, default: Any) -> None:
    """Add an option, and its former names, which do not appear in the help."""
    kind: Any = {"type": _type(option)} if option.takes_value else {"nargs": 0}
    shown: dict[str, Any] = {"help": help_of(option, default).replace("%", "%%")}
    choices = choices_of(option)
    if choices:
        kind["choices"] = choices
    if option.metavar:
        shown["metavar"] = option.metavar
    if option.place:
        more = {"nargs": "?"} if default is not None else {}
        section.add_argument(option.name, **kind, **shown, **more)
        return
    if not option.takes_value:
        constant = not option.name.startswith("no_")
        kind["const"] = constant
        how: dict[str, Any] = {"action": "store_const", "const": constant}
        section.add_argument(option.option, dest=option.parameter, **how, **shown)
    else:
        how = {
            "action": "append" if option.several else Once if option.once else "store",
            "required": option.required,
        }
        section.add_argument(option.option, dest=option.parameter, **kind, **how, **shown)
    for former in option.old:
        old, _, value = former.partition("=")
        if value:
            kind = {"nargs": 0, "const": value}
        new = f"{option.option} {value}".rstrip()
        parser.add_argument(
            old, dest=option.parameter, action=OldName, metavar=new, help=argparse.SUPPRESS, **kind
        )


def _type(option: Option) -> Any:
    """The function that turns a text into the value of an option."""
    name, _, least = option.kind.partition(" ")
    if least:
        return argument_types.whole(int(least))
    if name:
        return getattr(argument_types, name)
    return argument_types.file_path if option.metavar in PATHS else None


def _add_message_arguments(parser: Parser) -> None:
    """Add the options that each verb has, as the last section of its help."""
    section = parser.section(MESSAGES)
    section.add_argument(
        "--json", action="store_true", help="print one JSON object instead of text"
    )
    amount = section.add_mutually_exclusive_group()
    amount.add_argument(
        "-q", "--quiet", action="store_true", help="no progress messages on standard error"
    )
    amount.add_argument(
        "-v", "--verbose", action="store_true", help="more details, and the time of each message"
    )
    help_log = "append messages and results to this file"
    section.add_argument("--log", metavar="FILE", type=argument_types.file_path, help=help_log)
    section.add_argument("-h", "--help", action="help", help="show this help")


def _function_list() -> str:
    """The functions of `flexgen.dynamics.mechanics.signatures`, one paragraph each."""
    from flexgen.dynamics.mechanics.signatures import PRODUCTS, TABLE, split_product

    width = max(min(100, shutil.get_terminal_size().columns - 2), 60)
    layout: dict[str, Any] = {"subsequent_indent": " " * 32, "break_on_hyphens": False}
    rows = [(row.name, row.summary) for row in TABLE if not split_product(row.name)[1]] + list(
        PRODUCTS
    )
    return "\n".join(
        textwrap.fill(summary, width, initial_indent=f"  {name:<30}", **layout)
        for name, summary in rows
    )
