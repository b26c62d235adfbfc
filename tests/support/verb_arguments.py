"""Arguments of the command line as the functions behind the verbs get them."""

from __future__ import annotations

from argparse import Namespace
from types import SimpleNamespace
from typing import Any


def arguments(function: str, **given: Any) -> Namespace:
    """Arguments of the command line, of which only ``given`` are set."""
    names = {
        "set": None,
        "out": None,
        "prior": None,
        "add_poses": None,
        "report": None,
        "world": None,
        "columns": None,
    }
    row = SimpleNamespace(function=function, sections={})
    return Namespace(row=row, given=list(given), **(names | given))
