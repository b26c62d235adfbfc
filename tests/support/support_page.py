"""The page of features and functions, rendered from the table of abilities.

``python tests/support/support_page.py`` writes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from flexgen.model.abilities import FEATURES, FUNCTIONS, PARTS, Feature

PAGE = Path(__file__).resolve().parents[2] / "docs" / "support_matrix.md"
TOP = """# Features of robots and functions

Which function takes which feature of a robot into account. The page is written from the table in
`flexgen/model/abilities.py`, which also gives the errors; tests call each function with a robot
of each feature.

- **yes**: the function takes the feature into account, or its result does not depend on it.
- **without**: the function computes the robot as if it did not have the feature, see the notes.
- **no**: the function refuses the robot with an error that states the reason and what to do.
"""
YES = "yes"
WITHOUT = "without"
NO = "**no**"


def cell(feature: Feature, function: str) -> str:
    """Whether a function takes a feature into account."""
    if function in feature.refused:
        return NO
    return WITHOUT if function in feature.without else YES


def matrix(features: tuple[Feature, ...]) -> Iterator[str]:
    """A row for each function, a column for each feature."""
    yield "| function | " + " | ".join(feature.name for feature in features) + " |"
    yield "|---" * (len(features) + 1) + "|"
    for function in FUNCTIONS:
        cells = " | ".join(cell(feature, function) for feature in features)
        yield f"| `{function}` | {cells} |"


def notes(feature: Feature) -> Iterator[str]:
    """Section of a feature: its meaning, why functions refuse it, and what else a robot with it
    lacks.
    """
    yield from (f"## {feature.name[0].upper()}{feature.name[1:]}", "", feature.meaning, "")
    reasons: dict[str, list[str]] = {}
    for function, reason in feature.refused.items():
        reasons.setdefault(f"refused, since {reason}", []).append(function)
    for function, reason in feature.without.items():
        reasons.setdefault(f"computed without it: {reason}", []).append(function)
    for reason, functions in reasons.items():
        yield f"- {', '.join(f'`{name}`' for name in functions)}: {reason}."
    if feature.remedy and feature.refused:
        yield f"- To use these functions: {feature.remedy}."
    if feature.parts:
        lacking = "; ".join(PARTS[part] for part in feature.parts)
        yield f"- Not available: {lacking}."
    if reasons or feature.parts:
        yield ""


def page() -> str:
    """The text of the page."""
    shown = tuple(feature for feature in FEATURES if feature.refused or feature.without)
    half = (len(shown) + 1) // 2
    lines = [TOP, *matrix(shown[:half]), "", *matrix(shown[half:]), ""]
    always = [f.name for f in FEATURES if not (f.refused or f.without or f.parts)]
    lines += [f"Each function takes these into account: {', '.join(always)}.", ""]
    for feature in FEATURES:
        if feature.refused or feature.without or feature.parts:
            lines += notes(feature)
    return "\n".join(lines).rstrip() + "\n"
