"""The head of the memory of a stream: integers and flags, and the measures of the update so far.

Emitted C has it as the struct ``stream_head``, which `flexgen.codegen.emission.stream_header`
writes from these rows; the arrays behind it are in `flexgen.codegen.emission.stream_layout`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

POSITION = "POSITION"  # the part of libraries that give positions to send


@dataclass(frozen=True)
class Member:
    """A member of the head of a stream.

    Parameters
    ----------
    name : str
    kind : str
        ``"real"`` or ``"int32_t"``: flags and counts are integers.
    doc : str
    count : int
        Numbers of it.
    needs : str
        The part without which there is no such member; empty: it is always there.
    """

    name: str
    kind: str
    doc: str
    count: int = 1
    needs: str = ""


HEAD = (
    Member("period", "real", "[s] of an update"),
    Member("tolerance", "real", "largest relative residual of an update"),
    Member("delay", "real", "of a held torque, in samples"),
    Member("residual", "real", "results of the update so far, as in the info"),
    Member("mismatch", "real", "kinematic"),
    Member("torque_step", "real", ""),
    Member("output_step", "real", "[m], then [rad]", 2),
    Member("off", "real", "deviation from the given path [m], then [rad]", 2),
    Member("state", "int32_t", "whether it runs, see stream_update.h"),
    Member("key", "int32_t", "of the library that started it, so that no other one takes it"),
    Member("intervals", "int32_t", "of the horizon"),
    Member("samples_per_interval", "int32_t", ""),
    # before another member: as the higher half of a real, -1 would be NaN
    Member("side", "int32_t", "of singular poses, 1 or -1; 0: not known before the first sample"),
    Member("hold", "int32_t", "of the torques between samples"),
    Member("base", "int32_t", "where the factors begin, see mesh"),
    Member(
        "stale", "int32_t", "1 where the model or the motion changed: no factor holds any more"
    ),
    Member("part", "int32_t", "of an update that has begun, what comes next; see stream.c"),
    Member("at", "int32_t", ""),
    Member("within", "int32_t", ""),
    Member("limited", "int32_t", "whether limits are active in the interval"),
    Member("has_limits", "int32_t", "whether it keeps limits"),
    Member("fixed", "int32_t", "the last node whose deviation must not change"),
    Member("is_predicted", "int32_t", "whether the update before predicted this one"),
    Member("has_servo", "int32_t", "whether it gives commands", needs=POSITION),
)


def members_of(parts: Collection[str]) -> list[Member]:
    """The members of the head in a library with these parts."""
    return [member for member in HEAD if not member.needs or member.needs in parts]


def head_offsets(real: int, parts: Collection[str] = ()) -> tuple[dict[str, int], int]:
    """Position of each member in bytes, and the size of the struct.

    Parameters
    ----------
    real : int
        Bytes of a real: 8 or 4.
    parts : collection of str
        Of the library.

    Examples
    --------
    >>> offsets, size = head_offsets(8)
    >>> offsets["tolerance"], offsets["state"], size
    (8, 80, 144)
    """
    width = {"real": real, "int32_t": 4}
    found = {}
    at = 0
    for member in members_of(parts):
        found[member.name] = at
        at = at + member.count * width[member.kind]
    return found, -(-at // real) * real
