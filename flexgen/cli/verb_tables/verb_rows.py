"""Rows of `flexgen.cli.verb_tables.verbs`: verbs of the command line and their options, read from
a text.

    NAME [MODEL | MODEL?] | MODULE:FUNCTION of flexgen.cli.verbs | public function | former name
        TITLE OF A SECTION OF THE HELP (arguments: positional arguments)
            NAME [PLACEHOLDER] [words]: help, of several lines where needed

Words: a type of `flexgen.cli.argument_types` (``whole_1``: an integer that is at least 1),
``in=a/b`` or ``in=LIST``, ``several``, ``once``, ``required``, ``group=G`` (options that exclude
each other), ``--WORD`` (another name than that of the parameter), ``old=--WORD`` (a former name,
which works with a warning) or, of a switch that selected a value, ``old=--WORD=VALUE``. ``<NAME>``
is a positional argument. In a help, ``{default}`` is the default of the function; lists and
phrases of `flexgen.cli.verb_tables.verbs` are inserted by name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

# placeholders of paths
PATHS = ("FILE", "DIR", "PATH", "GRID", "TRAJECTORY", "PLAN", "EXPERIMENT", "DATA")
SWITCHES = ("several", "once", "required")


@dataclass(frozen=True)
class Option:
    """An option, or with ``place`` a positional argument; ``metavar`` is empty for a switch."""

    name: str
    help: str
    metavar: str = ""
    kind: str = ""
    choices: str = ""
    several: bool = False
    once: bool = False
    required: bool = False
    place: bool = False
    group: str = ""
    word: str = ""
    old: tuple[str, ...] = ()

    @property
    def takes_value(self) -> bool:
        """Whether it takes a value; False for a switch."""
        return bool(self.metavar or self.choices)

    @property
    def parameter(self) -> str:
        """The parameter of the public function."""
        return self.name if self.takes_value else self.name.removeprefix("no_")

    @property
    def option(self) -> str:
        """As it is written on the command line."""
        return self.word or f"--{self.name.replace('_', '-')}"


@dataclass(frozen=True)
class Verb:
    """A verb, or a kind of ``export``; ``model``: "required", "optional" or "none".

    ``summary``: what it does; empty: the first line of the docstring of its function in
    `flexgen.cli.verbs`.
    """

    name: str
    action: str
    function: str
    model: str
    old: str = ""
    summary: str = ""
    sections: dict[str, list[Option]] = field(default_factory=dict)

    def options(self) -> Iterator[Option]:
        """All options and positional arguments."""
        for options in self.sections.values():
            yield from options


def verbs_of(rows: str, shared: str) -> dict[str, Verb]:
    """The verbs of a text by name; ``shared``: options of several verbs, lines ``@NAME``, then
    their rows.

    Raises
    ------
    ValueError
        A row has a word without a meaning.
    """
    common: dict[str, list[Option]] = {}
    for line in _join_lines(shared):
        if line.startswith("@"):
            common[line[1:]] = []
        else:
            common[next(reversed(common))].append(_option(line))
    verbs: dict[str, Verb] = {}
    for line in _join_lines(rows):
        verb = next(reversed(verbs.values()), None)
        if not line.startswith(" "):
            head, action, function, old = [*(part.strip() for part in line.split("|")), "", ""][:4]
            name, _, model = head.partition(" MODEL")
            kind = {"?": "optional", "": "required" if " MODEL" in head else "none"}[model]
            verbs[name] = Verb(name, action, function, kind, old)
        elif verb is not None and not line.startswith(8 * " "):
            verb.sections[line.strip()] = []
        elif verb is not None:
            section = next(reversed(verb.sections.values()))
            text = line.strip()
            section += common[text[1:]] if text.startswith("@") else [_option(line)]
    return verbs


def _join_lines(text: str) -> Iterable[str]:
    """The lines of a text, with lines that continue a help, which are indented more than a row."""
    lines: list[str] = []
    for line in filter(None, text.split("\n")):
        deeper = len(line) - len(line.lstrip())
        if lines and ": " in lines[-1] and deeper > len(lines[-1]) - len(lines[-1].lstrip()):
            lines[-1] += f" {line.strip()}"
        else:
            lines.append(line)
    return lines


def _option(line: str) -> Option:
    """The option of a row."""
    head, _, help_text = line.strip().partition(": ")
    name, *words = head.split()
    found: dict[str, object] = {}
    old: list[str] = []
    for word in words:
        key, equals, value = word.partition("=")
        if word in SWITCHES:
            found[word] = True
        elif key == "in":
            found["choices"] = value
        elif key == "old":
            old.append(value)
        elif key == "group":
            found["group"] = value
        elif word.startswith("--"):
            found["word"] = word
        elif word == words[0] and (word[0].isupper() or "," in word):
            found["metavar"] = word.replace("_", " ")
        elif not equals and word.replace("_", "").isalnum() and word.islower():
            found["kind"] = word.replace("_", " ") if word.startswith("whole") else word
        else:
            raise ValueError(
                f"row of an option: given the word {word!r} in {line.strip()!r}, which means "
                "nothing"
            )
    if name.startswith("<"):
        name = name.strip("<>")
        found["place"] = True
    return Option(name, help_text, old=tuple(old), **found)  # type: ignore[arg-type]
