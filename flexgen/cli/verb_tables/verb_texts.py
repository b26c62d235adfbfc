"""Lists of words that options of the command line take, and the help texts of options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

from flexgen.base.registry import Option, names
from flexgen.identification.responses.average_names import AverageName
from flexgen.inversion.methods.method_table import method_names
from flexgen.runtime.inversion.targets import TARGET_NAMES
from flexgen.simulation.integration.hold_names import HOLDS
from flexgen.studies.templates.template_names import TEMPLATES

LISTS: dict[str, Callable[[], tuple[str, ...]]] = {  # called when a help or an error needs them
    "METHODS": method_names,
    "HOLDS": lambda: tuple(HOLDS),
    "LAWS": lambda: names("laws"),
    "AVERAGES": lambda: get_args(AverageName),
    "TARGETS": lambda: TARGET_NAMES,
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
    text = option.help.replace(
        "{default}", f"{default:g}" if isinstance(default, float) else str(default)
    )
    for name, phrase in PHRASES.items():
        text = text.replace(f"{{{name}}}", phrase)
    for name, words in LISTS.items():
        if f"{{{name}}}" in text:
            text = text.replace(f"{{{name}}}", ", ".join(words()))
    return text
