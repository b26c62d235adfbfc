"""The stub `flexgen/__init__.pyi`, from the tables of public names."""

from __future__ import annotations

from pathlib import Path

import flexgen

STUB = Path(flexgen.__file__).with_suffix(".pyi")
HEAD = '''"""The public names for type checkers; `make golden` writes this from `__init__.py`."""

'''
WIDTH = 100  # characters with the end of the line, as of Ruff
END = """
__version__: str
"""


def imported(name: str, module: str) -> str:
    """The import of a name, in several lines where it is too long for one."""
    line = f"from {module} import {name} as {name}\n"
    if len(line) <= WIDTH:
        return line
    return f"from {module} import (\n    {name} as {name},\n)\n"


def stub() -> str:
    """The text of the stub: each public name is imported from its module, in the order of Ruff."""

    def order(entry: tuple[str, str]) -> tuple[str, int, str]:
        name, module = entry
        return module, 0 if name.isupper() else 1 if name[0].isupper() else 2, name.lower()

    rows = sorted(flexgen._PUBLIC.items(), key=order)
    lines = [*(imported(name, module) for name, module in rows), END]
    return HEAD + "".join([*lines, *(f"{old} = {new}\n" for old, new in flexgen._FORMER.items())])
