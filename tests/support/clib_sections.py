"""A section of a hand-written C file alone, for tests that compile it by itself."""

from __future__ import annotations

import re

from flexgen.codegen.emission.clib_files import read_clib


def section(file: str, title: str) -> str:
    """The text of a file of ``flexgen/codegen/clib/`` from the comment that begins with
    ``--- title`` to the next such one.
    """
    parts = re.split(r"(?=^/\*(?:\n \*)? --- )", read_clib()[file], flags=re.MULTILINE)
    found = [part for part in parts if re.match(rf"/\*(\n \*)? --- {re.escape(title)}", part)]
    assert len(found) == 1, (file, title)
    return found[0]
