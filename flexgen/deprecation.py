"""Old names of arguments: they work, with a `DeprecationWarning` that says what to write instead."""

from __future__ import annotations

import sys
import warnings


def warn_of_old(text: str) -> None:
    """Warn in the line of the caller of flexgen, which is the first one outside of it."""
    level = 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "flexgen":
        frame, level = frame.f_back, level + 1
    warnings.warn(text, DeprecationWarning, stacklevel=level)
