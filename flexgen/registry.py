"""Functions of upper rooms that objects of lower rooms call, by name: pictures, reports, searches.

The front room, `flexgen`, hands down a table of names, such as ``Solution.plot``, and of the functions behind them. A
function is imported when it is called for the first time. No room below names a room above.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

_TARGETS: dict[str, tuple[str, str]] = {}


def register(functions: Mapping[str, tuple[str, str]]) -> None:
    """Register functions by name, each as its module and its name there; a later entry replaces an earlier one."""
    _TARGETS.update(functions)


def registered(name: str) -> Any:
    """The function that was registered under a name."""
    module, function = _TARGETS[name]
    return getattr(import_module(module), function)
