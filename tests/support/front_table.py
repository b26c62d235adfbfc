"""The table of the front room: the functions that the decorator `provides` marks, by name.

The table is there so that ``import flexgen`` imports none of them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "flexgen"
FRONT = SOURCE / "__init__.py"
TABLE = re.compile(r"(?<=^_RESULTS = \{\n).*?(?=^\}\n)", re.DOTALL | re.MULTILINE)
# Characters of a line of the source.
WIDTH = 99


def sources() -> dict[str, str]:
    """The text of each module."""
    found = {}
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE.parent).with_suffix("").parts
        found[".".join(parts)] = path.read_text(encoding="utf-8")
    return found


def marked(texts: Mapping[str, str]) -> dict[str, str]:
    """``module:function`` of each name that a decorator gives.

    Raises
    ------
    ValueError
        Two functions have the same name, or a name is not a text in the decorator.
    """
    found: dict[str, str] = {}
    for module, text in texts.items():
        if "@provides(" not in text:
            continue
        for node in ast.parse(text).body:
            for name in _names(node, module):
                if name in found:
                    raise ValueError(f"{name}: given by {found[name]} and {module}, expected one")
                found[name] = f"{module}:{node.name}"  # type: ignore[attr-defined]
    return found


def _names(node: ast.stmt, module: str) -> list[str]:
    """The names that the decorators of a function give."""
    calls = [
        each
        for each in getattr(node, "decorator_list", ())
        if isinstance(each, ast.Call) and getattr(each.func, "id", "") == "provides"
    ]
    names = [argument for call in calls for argument in call.args]
    for name in names:
        if not isinstance(name, ast.Constant) or not isinstance(name.value, str):
            raise ValueError(f"{module}, line {name.lineno}: given no text, expected a name")
    return [name.value for name in names]  # type: ignore[attr-defined]


def recorded() -> dict[str, str]:
    """The table of the front room."""
    found = TABLE.search(FRONT.read_text(encoding="utf-8"))
    assert found
    table: dict[str, str] = ast.literal_eval(f"{{{found.group()}}}")
    return table


def front(_: str = "") -> str:
    """The front room with the table of today."""
    rows = []
    for name, target in sorted(marked(sources()).items()):
        row = f'    "{name}": "{target}",\n'
        rows.append(
            row if len(row) <= WIDTH + 1 else f'    "{name}": (\n        "{target}"\n    ),\n'
        )
    return TABLE.sub(lambda _: "".join(rows), FRONT.read_text(encoding="utf-8"))
