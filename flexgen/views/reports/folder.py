"""The folder of a report: files of another program are not replaced.

Files of flexgen are known by a mark: the last line of a page, the second line of an svg picture,
the field Software of a png picture. Pictures in the folder of a page of flexgen are also of
flexgen.
"""

from __future__ import annotations

import html
import os
from collections.abc import Iterable
from pathlib import Path

from flexgen.base.errors import ArgumentError
from flexgen.base.version import __version__

PAGE = "index.html"

_MARKS = {  # by the ending of the name; where in the file it is searched
    ".html": (b"<footer><p>flexgen ", 0),
    ".svg": (b"<!-- flexgen -->", 200),
    ".png": (b"Software\0flexgen", 200),
}


def foot() -> str:
    """End of a page, with the mark by which flexgen knows its own pages."""
    return f"<footer><p>flexgen {html.escape(__version__)}</p></footer>\n</body>\n</html>\n"


def check_folder(directory: str | Path | None, names: Iterable[str] = (PAGE,)) -> None:
    """Refuse a folder in which files of these names are not of flexgen; nothing for None.

    Raises
    ------
    ArgumentError
        With the names of the files.
    """
    if directory is None:
        return
    folder = Path(directory)
    page = _is_marked(folder / PAGE)
    foreign = [
        name
        for name in names
        if os.path.lexists(folder / name)
        and not _is_marked(folder / name)
        and not (page and name.endswith((".svg", ".png")))
    ]
    if foreign:
        raise ArgumentError(
            f"report: given {str(folder)!r}, where {', '.join(foreign)} is of another program, "
            "expected a new folder or one with a report of flexgen; choose another folder or "
            "remove that file"
        )


def _is_marked(path: Path) -> bool:
    """Whether a file has the mark that flexgen writes in files of this kind, at the begin or the
    end; False where it cannot be read.
    """
    mark, size = _MARKS[path.suffix]
    try:
        with path.open("rb") as stream:
            if not size:  # at the end
                stream.seek(max(0, path.stat().st_size - 200))
            return mark in stream.read(size or 200)
    except OSError:
        return False
