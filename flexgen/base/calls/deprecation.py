"""Old names of arguments: they work, with a `DeprecationWarning` that says what to write
instead.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

Call = TypeVar("Call", bound=Callable[..., Any])


def warn_of_old(text: str) -> None:
    """Warn in the line of the caller of flexgen, which is the first one outside of it."""
    level = 2
    frame = sys._getframe(1)
    while (
        frame.f_back is not None
        and frame.f_globals.get("__name__", "").partition(".")[0] == "flexgen"
    ):
        frame = frame.f_back
        level = level + 1
    warnings.warn(text, DeprecationWarning, stacklevel=level)


def renamed(**names: str) -> Callable[[Call], Call]:
    """A function whose parameters had other names, ``old="new"``, which work with a
    `DeprecationWarning`.
    """

    def decorate(function: Call) -> Call:
        """The function with former names of its parameters, which give a warning."""

        @wraps(function)
        def call(*arguments: Any, **keywords: Any) -> Any:
            """Call with keywords under their new names, and warn of old ones."""
            for old, new in names.items():
                if old in keywords and new not in keywords:
                    warn_of_old(
                        f"{function.__name__}: given {old}=, expected its new name, {new}="
                    )
                    keywords[new] = keywords.pop(old)
            return function(*arguments, **keywords)

        return cast(Call, call)

    return decorate
