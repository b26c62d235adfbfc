"""The argument parser of the command line: numbers, options that were renamed, sections of the
help, suggestions.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

from flexgen.base.errors import suggestion
from flexgen.cli.argument_types import integers, numbers

_NEGATIVE = re.compile(r"-(\.?\d|inf|nan)", re.IGNORECASE)  # no option begins like a number
_NUMBERS = re.compile(r"[-+]?\.?\d[-+.,\deE]*\Z")  # one number, or several with commas
FILES = "files"
MESSAGES = "messages"


class UsageError(Exception):
    """The command line is wrong: message, then the usage line."""


class Once(argparse.Action):
    """Store a value; refuse a second one."""

    def __call__(
        self, parser: Any, namespace: Any, values: Any, option_string: str | None = None
    ) -> None:
        """Store the value."""
        given = getattr(namespace, self.dest)
        if given is not None:
            hint = "; 'flexgen solve' takes several moves, the other verbs one at a time" * (
                self.dest == "move"
            )
            raise argparse.ArgumentError(
                self, f"given twice ({given} and {values}), expected one{hint}"
            )
        setattr(namespace, self.dest, values)


class OldName(Once):
    """Store a value given by the old name of an option, and note the new one, ``metavar``, as a
    warning.
    """

    def __call__(
        self, parser: Any, namespace: Any, values: Any, option_string: str | None = None
    ) -> None:
        """Store the value and the note."""
        super().__call__(
            parser, namespace, self.const if self.nargs == 0 else values, option_string
        )
        note = f"{option_string} is the old name of {self.metavar}, please use the new one"
        namespace.notes = [*getattr(namespace, "notes", ()), note]


class Parser(argparse.ArgumentParser):
    """An argument parser that raises `UsageError`, suggests similar words, and takes each number
    for a value.

    ``argparse`` takes ``-1e-3`` for an option. Here whatever begins like a negative number is a
    value, and an option whose type is `numbers` or `integers` takes all numbers that follow it.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        # help is in the section of the messages
        options |= {"allow_abbrev": False, "add_help": False}
        super().__init__(*arguments, **options)
        self._negative_number_matcher = _NEGATIVE

    def error(self, message: str) -> NoReturn:
        """Raise `UsageError`."""
        raise UsageError(f"{message}\n{self.format_usage().strip()}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """argparse's own check of ``choices``, with the nearest choice in the message of its
        ArgumentError.
        """
        if action.choices is not None and value not in action.choices:
            names = [str(choice) for choice in action.choices]
            expected = f"expected one of {', '.join(names)}{suggestion(str(value), names)}"
            raise argparse.ArgumentError(action, f"given {value!r}, {expected}")

    def _parse_known_args(self, arg_strings: list[str], *rest: Any) -> Any:
        return super()._parse_known_args(self._join_numbers(arg_strings), *rest)

    def _join_numbers(self, words: Sequence[str]) -> list[str]:
        """The words with ``--pose -0.3 1`` as ``--pose=-0.3,1``, for each option of type `numbers`
        or `integers`: argparse would read -0.3 as an option.
        """
        out: list[str] = []
        words = list(words)
        k = 0
        while k < len(words):
            option, equals, first = words[k].partition("=")
            k += 1
            action = self._option_string_actions.get(option)
            values = [first] if equals else []
            while (
                action is not None
                and action.type in (numbers, integers)
                and k < len(words)
                and _NUMBERS.match(words[k])
            ):
                values.append(words[k])
                k += 1
            joined = ",".join([*(value.rstrip(",") for value in values[:-1]), *values[-1:]])
            out.append(f"{option}={joined}" if values else option)
        return out

    def section(self, title: str) -> argparse._ArgumentGroup:
        """A section of the help, made where there is none of this title; files and messages are
        the last ones.
        """
        found = [group for group in self._action_groups if group.title == title]
        section = found[0] if found else self.add_argument_group(title)
        self._action_groups.sort(key=lambda group: (group.title == MESSAGES, group.title == FILES))
        return section

    def options(self) -> list[str]:
        """All option strings that the help shows."""
        return [
            word
            for word, action in self._option_string_actions.items()
            if word.startswith("--") and action.help != argparse.SUPPRESS
        ]

    def verbs(self) -> Iterator[Parser]:
        """The parsers that run something: of verbs, and of their kinds."""
        groups = [
            action for action in self._actions if isinstance(action, argparse._SubParsersAction)
        ]
        for parser in groups[0].choices.values() if groups else ():
            yield from parser.verbs()
        if not groups:
            yield self

    def hint(self, words: Sequence[str], unknown: Sequence[str], root: Parser) -> str:
        """Suggestion for arguments that the parser does not know, to be appended to a message;
        empty: none.

        ``words``: the command line; ``unknown``: those of them that are left over; ``root``: the
        parser of all verbs, for options of other verbs.
        """
        options = [word.partition("=")[0] for word in unknown if word.startswith("--")]
        if options:
            others = [verb.prog for verb in root.verbs() if options[0] in verb.options()]
            if others:
                return f"; {options[0]} is an option of {_some(others)}"
            return suggestion(options[0], self.options())
        k = next((k for k in range(len(words)) if words[k] == unknown[0]), 0)
        before = [word for word in words[:k] if not _NUMBERS.match(word)][-1:]
        if _NUMBERS.match(unknown[0]) and before and before[0] in self.options():
            return f"; {before[0]} takes one number"
        return ""


def _some(names: list[str]) -> str:
    """At most four names, in quotes."""
    return ", ".join(f"'{name}'" for name in names[:4]) + (", ..." if len(names) > 4 else "")
