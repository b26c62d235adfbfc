"""Defaults for all joints of an overlay: the table ``[joint."*"]``, merged with that of each
joint.
"""

from __future__ import annotations

from flexgen.base.spec.toml_lines import Entry

EVERY = "*"


def merge(default: dict[str, Entry], own: dict[str, Entry]) -> dict[str, Entry]:
    """The keys of a joint, those that it does not have from the defaults; tables in them likewise.

    A table that states another ``type`` than the default replaces it, and a joint with a spring
    instead of a gear takes neither gear nor motor from the defaults.
    """
    out = dict(own)
    for key, entry in default.items():
        if key in ("gear", "motor") and "spring" in own:
            continue
        if key not in own:
            out[key] = entry
        elif isinstance(entry.value, dict) and isinstance(own[key].value, dict):
            kind, own_kind = (table.value.get("type") for table in (entry, own[key]))
            if own_kind is None or (kind is not None and kind.value == own_kind.value):
                out[key] = Entry(merge(entry.value, own[key].value), own[key].line, own[key].file)
    return out
