"""Private names of flexgen in tests: a list that may only shrink.

    python tests/support/private_names.py

writes the counts of today to `tests/private_names.json`, and refuses where one grew: a test uses
public names, and what it cannot reach through them deserves a module, or is not needed.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
PACKAGE = TESTS.parent / "flexgen"
FILE = TESTS / "private_names.json"

# Private members that flexgen shares with programs of others: notebooks, ctypes, named tuples,
# argparse.
SHARED = {"_repr_html_", "_repr_svg_", "_fields", "_fields_"}
SHARED |= {"_actions", "_action_groups", "_option_string_actions"}
# As in "def _f(", "self._x" and the field "    _x: int".
_MEMBER = re.compile(r"(?:def |self\.|cls\.|^    )(_[a-z]\w*)\b", re.MULTILINE)


def is_private(name: str) -> bool:
    """Whether the last part of a name begins with one underscore."""
    last = name.rpartition(".")[2]
    return last.startswith("_") and not last.startswith("__")


def private_names(text: str) -> set[str]:
    """Private names of flexgen in a file: imported, attributes of what it imports, or replaced.

    And members of any other object but ``self``, where flexgen has a private member of this name:
    ``made._slow_down()``.
    """
    found: set[str] = set()
    imported: set[str] = set()
    of_others = {"self", "cls", "super"}
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "flexgen":
            found |= {alias.name for alias in node.names if is_private(alias.name)}
            imported |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            of_others |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            names = [alias for alias in node.names if alias.name.split(".")[0] == "flexgen"]
            imported |= {(alias.asname or alias.name).split(".")[0] for alias in names}
            rest = [alias for alias in node.names if alias not in names]
            of_others |= {(alias.asname or alias.name).split(".")[0] for alias in rest}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            root = _root(node)
            if root in imported or (root not in of_others and node.attr in private_members()):
                found.add(node.attr)
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "setattr":
            texts = [x.value for x in node.args if isinstance(x, ast.Constant)]
            found |= {x.rpartition(".")[2] for x in texts if isinstance(x, str) and is_private(x)}
    return found


@cache
def private_members() -> frozenset[str]:
    """Names of all private functions, methods and attributes in flexgen but `SHARED` ones."""
    texts = (path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    return frozenset({name for text in texts for name in _MEMBER.findall(text)} - SHARED)


def _root(node: ast.Attribute) -> str:
    """The first name of ``a.b[0].c(x).d``; empty where it begins with something else."""
    value: ast.expr = node.value
    while not isinstance(value, ast.Name):
        if isinstance(value, ast.Attribute | ast.Subscript):
            value = value.value
        elif isinstance(value, ast.Call):
            value = value.func
        else:
            return ""
    return value.id


def counts(files: Iterable[Path]) -> dict[str, int]:
    """Number of private names of each file that has one, by its name without the folder."""
    found = {path.name: len(private_names(path.read_text(encoding="utf-8"))) for path in files}
    return {name: count for name, count in sorted(found.items()) if count}


def today() -> dict[str, int]:
    """The counts of all tests."""
    return counts(sorted(TESTS.rglob("*.py")))


def recorded() -> dict[str, int]:
    """The counts that the list allows."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def grown(before: dict[str, int], now: dict[str, int]) -> list[str]:
    """Files with more private names than before."""
    return [
        f"{name}: {count} private names, {before.get(name, 0)} in the list"
        for name, count in now.items()
        if count > before.get(name, 0)
    ]


def main() -> None:
    """Write the counts of today."""
    now = today()
    more = grown(recorded(), now) if FILE.exists() else []
    if more:
        sys.exit("\n".join(more))
    FILE.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
    print(f"{sum(now.values())} private names in {len(now)} files")


if __name__ == "__main__":
    main()
