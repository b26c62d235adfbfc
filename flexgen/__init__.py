"""flexgen: inverse dynamics of elastic robots, from a model file to C that runs in a controller.

The public verbs, the nouns they take and the errors they raise are resolved on first use: ``import flexgen`` is quick.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_VERBS = {
    "models": "flexgen.catalogue",
    "describe": "flexgen.catalogue",
    "read": "flexgen.model.reader",
    "derive": "flexgen.mechanics.equations",
    "analyze": "flexgen.analysis.report",
    "solve": "flexgen.solvers.solve",
    "simulate": "flexgen.simulation",
    "generate": "flexgen.codegen.build",
    "load": "flexgen.runtime",
}
_NOUNS = {
    "Limits": "flexgen.solvers.full",
    "Move": "flexgen.model.elements",
    "Trajectory": "flexgen.trajectory",
}
_ERRORS = dict.fromkeys(["FlexgenError", "ModelError", "ArgumentError", "SolverError", "BuildError"], "flexgen.errors")
_PUBLIC = _VERBS | _NOUNS | _ERRORS

__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'flexgen' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
