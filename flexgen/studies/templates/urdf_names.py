"""Names of a URDF file as identifiers of a model file."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection

from flexgen.base.spec.ports import identifier_problem

LONGEST = 31  # characters of an identifier


def new_names(names: Collection[str], stem: str, refused: Collection[str] = ()) -> dict[str, str]:
    """New names for those that are not identifiers or that are refused, all different.

    Letters lose their accents, other characters become underscores, and a name that is too long
    loses its end.

    Parameters
    ----------
    names : collection of str
        All names of one kind.
    stem : str
        The beginning of a name that would else begin with a digit, or be empty.
    refused : collection of str
        Identifiers that have a meaning of their own.

    Returns
    -------
    dict
        The new names by the old ones, for the names that need one.
    """
    bad = [name for name in names if name in refused or identifier_problem(name) is not None]
    taken = {*names, *refused} - set(bad)
    out: dict[str, str] = {}
    for name in bad:
        out[name] = _free(_identifier(name, stem), taken)
        taken.add(out[name])
    return out


def _identifier(name: str, stem: str) -> str:
    """An identifier that resembles a name."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    words = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")
    if not words[:1].isalpha():
        words = f"{stem}{words}"
    return words[:LONGEST].rstrip("_")


def _free(name: str, taken: Collection[str]) -> str:
    """The name, or the name with the first number that makes it one that is not taken."""
    free = name
    count = 2
    while free in taken:
        end = f"_{count}"
        free = name[: LONGEST - len(end)].rstrip("_") + end
        count = count + 1
    return free
