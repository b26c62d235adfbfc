"""Private names of flexgen in tests: a list that may only shrink.

    python tests/support/private_names.py

writes the counts of today to `tests/private_names.json`, and refuses where one grew: a test uses
public names, and what it cannot reach through them deserves a module, or is not needed.
"""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Iterable
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
FILE = TESTS / "private_names.json"


def is_private(name: str) -> bool:
    """Whether the last part of a name begins with one underscore."""
    last = name.rpartition(".")[2]
    return last.startswith("_") and not last.startswith("__")


def private_names(text: str) -> set[str]:
    """Private names of flexgen in a file: imported, attributes of what it imports, or replaced."""
    found: set[str] = set()
    imported: set[str] = set()
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "flexgen":
            found |= {alias.name for alias in node.names if is_private(alias.name)}
            imported |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            names = [alias for alias in node.names if alias.name.split(".")[0] == "flexgen"]
            imported |= {(alias.asname or alias.name).split(".")[0] for alias in names}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            if _root(node) in imported:
                found.add(node.attr)
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "setattr":
            texts = [x.value for x in node.args if isinstance(x, ast.Constant)]
            found |= {x.rpartition(".")[2] for x in texts if isinstance(x, str) and is_private(x)}
    return found


def _root(node: ast.Attribute) -> str:
    value = node.value
    while isinstance(value, ast.Attribute):
        value = value.value
    return value.id if isinstance(value, ast.Name) else ""


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
