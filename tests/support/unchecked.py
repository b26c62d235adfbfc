"""Objects with values that their constructors refuse, for tests of what stands behind these
checks.
"""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

T = TypeVar("T")


def unchecked(given: T, **changes: Any) -> T:
    """`dataclasses.replace` without the checks of the constructor."""
    made = object.__new__(type(given))
    for field in dataclasses.fields(given):  # type: ignore[arg-type]
        object.__setattr__(made, field.name, changes.pop(field.name, getattr(given, field.name)))
    assert not changes, changes
    return made
