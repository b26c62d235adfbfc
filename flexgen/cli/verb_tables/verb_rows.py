"""A row of `flexgen.cli.verb_tables.verbs`: a verb of the command line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from flexgen.base.registry import Option, Sections
from flexgen.cli.verb_tables.signature_source import defaults_of, signature_of
from flexgen.cli.verb_tables.verb_parameters import options_of

# placeholders of paths
PATHS = ("FILE", "DIR", "PATH", "GRID", "TRAJECTORY", "PLAN", "EXPERIMENT", "DATA")


@dataclass(frozen=True)
class Verb:
    """A verb, or a kind of ``export``.

    Attributes
    ----------
    name : str
    action : str
        ``MODULE:FUNCTION`` of `flexgen.cli.verbs`, which prints the result; empty: the public
        function is called and its result printed.
    function : str
        The public function that it calls; its docstring and parameters give the options.
    rows : mapping of str to sequences of str or Option, optional
        By titles of the help, options: names of parameters of the function, and an `Option` with
        what the command line alone has. Positional arguments have the title ``arguments``.
        Default: all parameters.
    model : str
        MODEL is "required", "optional" or "none"; empty: required where the function has a
        parameter ``model``.
    old : str
        Former name.
    summary : str
        What it does; empty: the first line of the docstring of its action.
    """

    name: str
    action: str = ""
    function: str = ""
    rows: Sections | None = None
    model: str = ""
    old: str = ""
    summary: str = ""

    @cached_property
    def sections(self) -> Mapping[str, list[Option]]:
        """The options by the titles of the help; read from the public function when asked for."""
        return options_of(self.function, self.rows)

    @cached_property
    def takes_model(self) -> str:
        """Whether MODEL is "required", "optional" or "none"."""
        if self.model or not self.function:
            return self.model or "none"
        if "model" not in signature_of(self.function).parameters:
            return "none"
        return "optional" if "model" in defaults_of(self.function) else "required"

    def options(self) -> Iterator[Option]:
        """All options and positional arguments."""
        for options in self.sections.values():
            yield from options
