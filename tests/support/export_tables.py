"""The tables of exports in two pages, from the rows in `flexgen/__init__.py`, and a row for each
verb that the page of the command line does not have.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path

import flexgen  # fills registry.EXPORTS
from flexgen.base.registry import EXPORTS, Export
from flexgen.cli.parser import summary_of
from flexgen.cli.verb_tables.verbs import VERBS

ROOT = Path(flexgen.__file__).resolve().parents[1]
README = ROOT / "flexgen" / "exports" / "README.md"
COMMANDS = ROOT / "docs" / "command_line.md"
HEAD = "| `flexgen export` | function | in | what it does | page |\n|---|---|---|---|---|\n"
START = "| `export KIND` | writes the robot for another tool: "


def readme_table(exports: Mapping[str, Export]) -> str:
    """Command, function, file or folder, summary and page of each export."""
    lines = []
    for name, export in exports.items():
        *folders, module = export.module.removeprefix("flexgen.exports.").split(".")
        place = "/".join(folders) + "/" if folders else f"{module}.py"
        what = export.summary.rstrip(".")
        page = export.page.replace("](", "](../../docs/")
        lines.append(f"| `{name}` | `export_{name}` | `{place}` | {what} | {page} |\n")
    return HEAD + "".join(lines)


def command_row(exports: Mapping[str, Export]) -> str:
    """The row of ``export`` in the table of commands: neighbors with the same page share its
    link.
    """
    groups = groupby(exports, key=lambda name: exports[name].page)
    return (
        START
        + ", ".join(f"{' and '.join(f'`{name}`' for name in of)} ({page})" for page, of in groups)
        + " |\n"
    )


def verbs_of_table(page: str) -> list[str]:
    """The verbs in the table of the page of the command line, in its order."""
    table = page.partition("| verb |")[2].partition("\n\n")[0]
    return [
        name
        for line in table.splitlines()[2:]
        for name in re.findall(r"`([-\w]+)[^`]*`", line.split("|")[1])
    ]


def rows_of_new_verbs(page: str) -> str:
    """A row with its help for each verb that the table does not have."""
    missing = {name.partition(" ")[0] for name in VERBS} - set(verbs_of_table(page))
    texts = {name: summary_of(VERBS[name]).rstrip(".") for name in sorted(missing)}
    return "".join(
        f"| `{name}` | {text[:1].lower()}{text[1:]} |\n" for name, text in texts.items()
    )


def pages(exports: Mapping[str, Export] = EXPORTS) -> dict[Path, str]:
    """The texts of both pages, with their tables written anew."""
    readme, commands = (page.read_text(encoding="utf-8") for page in (README, COMMANDS))
    table = re.compile(re.escape(HEAD) + r"(\| .*\n)*")
    row = re.compile(re.escape(START) + r".*\n")
    return {
        README: table.sub(lambda _: readme_table(exports), readme),
        COMMANDS: row.sub(lambda _: rows_of_new_verbs(commands) + command_row(exports), commands),
    }
