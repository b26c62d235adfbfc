"""Lists of words that options of the command line take, and the help texts of options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flexgen.base.registry import Option, names
from flexgen.cli.verb_tables.verb_parameters import show_default
from flexgen.inversion.methods.method_table import method_names
from flexgen.studies.templates.template_names import TEMPLATES

LISTS: dict[str, Callable[[], tuple[str, ...]]] = {  # called when a help or an error needs them
    "METHODS": method_names,
    "LAWS": lambda: names("laws"),
    "SHELLS": lambda: ("bash", "zsh", "fish"),
    "TEMPLATES": lambda: TEMPLATES,
}
PHRASES = {
    "CONTROLLERS": "a file .toml, .py (or file.py:Class) or a shared library",
    "FACTORS": (
        "factors of stiffness, damping, friction, lost_motion or a single number, payload in kg "
        "more"
    ),
}


def choices_of(option: Option) -> tuple[str, ...]:
    """The words that the value of an option may be; empty: any."""
    if len(option.choices) == 1 and option.choices[0] in LISTS:
        return LISTS[option.choices[0]]()
    return option.choices


def help_of(option: Option, default: Any) -> str:
    """The help of an option with the default of the public function, the lists and the phrases in
    it.
    """
    text = option.help.replace("{default}", show_default(default))
    for name, phrase in PHRASES.items():
        text = text.replace(f"{{{name}}}", phrase)
    for name, words in LISTS.items():
        if f"{{{name}}}" in text:
            text = text.replace(f"{{{name}}}", ", ".join(words()))
    return text
