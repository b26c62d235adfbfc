"""Change numbers in the text of a model file; comments, order and layout of all other lines
stay.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

from flexgen.base.checks.counts import is_count
from flexgen.base.errors import ModelError
from flexgen.base.spec.tables import part_of
from flexgen.base.spec.toml_lines import Entry, Path, Scanner, parse

LONGEST = 6  # entries of a list of numbers: an inertia tensor


def with_numbers(
    text: str,
    numbers: Mapping[str, float],
    file: str = "",
    sources: Mapping[str, str] | None = None,
) -> str:
    """The text of a TOML file with some numbers replaced, or added where their table is there.

    Parameters
    ----------
    text : str
        A model file.
    numbers : mapping
        Dotted path -> value; an entry of a list by its name or index:
        ``element.arm1.dof.q1.gear.damping``.
    file : str
        Name of the file, for messages.
    sources : mapping, optional
        Dotted path -> a comment (one line) that is put at the end of the line of the number.

    Raises
    ------
    ModelError
        A path leads to no number, or a number is not finite.
    """
    text = text.replace("\r\n", "\n")
    root = parse(text, file)
    places = Scanner(text)
    edits: list[tuple[int, int, str]] = []
    new: dict[Path, dict[str, Any]] = {}  # what is missing, by the table that it is missing in
    longer: dict[Path, dict[int, float]] = {}  # entries of lists that become longer
    notes: dict[int, list[str]] = {}
    for dotted, value in numbers.items():
        if not math.isfinite(value):
            raise ModelError(file, 0, dotted, repr(value), "a finite number")
        path, missing = _resolve(root, dotted, file)
        if missing and (*path, 0) in places.spans:  # entries after the end of a list of numbers
            longer.setdefault(path, {})[int(missing[0])] = float(value)
            continue
        if missing:
            if path and path not in places.braces and path not in places.headers:
                given = f"no {'.'.join(missing)}"
                raise ModelError(
                    file,
                    places.lines.get(path, 0),
                    dotted,
                    given,
                    "a table of the file that can have it",
                )
            at = places.braces.get(path, places.headers.get(path, len(text)))
            inner = new.setdefault(path, {})
            for word in missing[:-1]:
                inner = inner.setdefault(word, {})
            inner[missing[-1]] = float(value)
        elif path in places.spans:
            at, end = places.spans[path]
            edits.append((at, end, repr(float(value))))
        else:
            raise ModelError(
                file, places.lines.get(path, 0), dotted, "a table or list", "a number"
            )
        if sources and dotted in sources and (path or not missing):
            line_end = text.find("\n", at)
            notes.setdefault(len(text) if line_end < 0 else line_end, []).append(sources[dotted])
    for path, entries in longer.items():
        last = max(
            place[-1]
            for place in places.spans
            if place[:-1] == path and isinstance(place[-1], int)
        )
        at = places.spans[*path, last][1]
        more = [repr(entries.get(k, 0.0)) for k in range(last + 1, max(entries) + 1)]
        edits.append((at, at, "".join(f", {number}" for number in more)))
    for path, tables in new.items():
        edits.append(_addition(text, places, path, tables))
    edits += [(at, at, f"  # {'; '.join(dict.fromkeys(words))}") for at, words in notes.items()]
    # from the end, so that places before an edit stay right; at one place a comment comes before
    # new lines
    for start, end, words in sorted(
        edits, key=lambda edit: (edit[0], not edit[2].startswith("  #")), reverse=True
    ):
        text = text[:start] + words + text[end:]
    return text


def _addition(
    text: str, places: Scanner, path: Path, tables: dict[str, Any]
) -> tuple[int, int, str]:
    """The edit, start, end and new text, that adds the keys ``tables`` to the table of a path: in
    its braces, below its header, or as tables at the end of the file.
    """
    if not path:  # tables of the root, at the end
        rows = [
            f"\n[{name}]\n" + "".join(f"{k} = {_plain(x)}\n" for k, x in keys.items())
            for name, keys in tables.items()
        ]
        return len(text), len(text), "".join(rows)
    pairs = [f"{name} = {_plain(value)}" for name, value in tables.items()]
    if path in places.braces:
        start = len(text[: places.braces[path]].rstrip())
        return start, start, ("" if text[start - 1] in "{," else ",") + " " + ", ".join(pairs)
    return places.headers[path], places.headers[path], "".join(f"\n{pair}" for pair in pairs)


def _plain(value: Any) -> str:
    """A number, vector (keys are indices, missing entries zero, three at least) or table in
    TOML.
    """
    if not isinstance(value, dict):
        return repr(value)
    if all(is_count(key) for key in value):
        count = max(3, *(int(key) + 1 for key in value))
        return f"[{', '.join(repr(value.get(str(k), 0.0)) for k in range(count))}]"
    return f"{{ {', '.join(f'{key} = {_plain(x)}' for key, x in value.items())} }}"


def _resolve(root: Entry, dotted: str, file: str) -> tuple[Path, tuple[str, ...]]:
    """The path of the part of a dotted key that is there, and the keys that are missing below it;
    ModelError where a list or a number has no such part.
    """
    here = root
    path = cast(Path, ())
    words = dotted.split(".")
    for n, word in enumerate(words):
        key, _ = part_of(here, word)
        if key is None and isinstance(here.value, list) and is_count(word):
            if len(here.value) <= int(word) < LONGEST:
                return path, (word,)
            key = int(word) if int(word) < len(here.value) else None
        if key is None:
            if isinstance(here.value, dict):
                return path, tuple(words[n:])
            raise ModelError(
                file,
                here.line,
                ".".join(words[: n + 1]),
                "nothing of this name",
                "a part of the model",
            )
        here = here.value[key]
        path = (*path, key)
    return path, ()
