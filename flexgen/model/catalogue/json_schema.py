"""JSON schema of model files, for completion, hover and checks in an editor.

It cannot express everything that the reader checks: relations between numbers, names that refer to
each other, key paths of variants. The reader has the last word.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.schema import table_schema
from flexgen.base.version import __version__
from flexgen.model.format.format import PROGRAMS, model_schema

Kind = Literal["model", "program"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@checked_types
def schema(kind: Kind = "model") -> dict[str, Any]:
    """The JSON schema (draft 7) of model files.

    The editor extension Even Better TOML completes and explains keys in a file whose first line is
    ``#:schema ./flexgen.schema.json``.

    Parameters
    ----------
    kind : str
        ``"model"`` (the default), or ``"program"``: files of moves and programs. Model files and
        overlays of URDF files, or those that `flexgen.read_moves` reads.

    Returns
    -------
    dict
        JSON types only.

    Raises
    ------
    ArgumentError
        There is no such kind.

    Examples
    --------
    >>> flexgen.schema()["$schema"]
    'http://json-schema.org/draft-07/schema#'
    """
    if kind not in KINDS:
        raise ArgumentError(f"schema: given {kind!r}, expected one of {', '.join(KINDS)}")
    head = {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": f"flexgen {kind} file, version {__version__}",
    }
    return head | (model_schema() if kind == "model" else table_schema(PROGRAMS))
