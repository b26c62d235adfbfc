"""Friction laws: the default law, and those of other packages by their ``type`` in a model file.

The torque of a law is in `flexgen.mechanics.force_laws`; a law of another package has a method ``torque(w)``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flexgen.errors import ArgumentError
from flexgen.registry import extension


def friction_key(unit: str, doc: str = "", *, signed: bool = False, needs: str = "") -> Any:
    """A number of a friction law, which is also a key of the model file, 0 by default.

    ``unit`` is that of a rotation; ``[]`` in the text is replaced by it. A number that is not ``signed`` must be >= 0.
    ``needs`` names another number that must be > 0 where this one is not 0.
    """
    return field(default=0.0, metadata={"unit": unit, "doc": doc, "signed": signed, "needs": needs})


@dataclass(frozen=True)
class Friction:
    """The default friction law, ``type = "smooth"``: torque against the speed w.

    ``f(w) = viscous w + (coulomb + stribeck / cosh(alpha w)) tanh(beta w) + offset``. The offset makes it asymmetric.
    The base of all friction laws.
    """

    viscous: float = friction_key("N m s/rad", "viscous friction")
    coulomb: float = friction_key("N m", "Coulomb friction [], smoothed by tanh(beta speed)", needs="beta")
    stribeck: float = friction_key(
        "N m", "Stribeck friction at low speed []: stribeck / cosh(alpha speed)", needs="beta alpha"
    )
    alpha: float = friction_key("s/rad", "decay of the Stribeck friction with the speed")
    beta: float = friction_key("s/rad", "steepness of the Coulomb friction at zero speed")
    offset: float = friction_key("N m", "constant torque against positive motion", signed=True)


NO_FRICTION = Friction()

# Value of the key ``type`` in the model file -> law. A new law is a subclass of Friction with its own numbers, one
# entry here, and its torque in `flexgen.mechanics.force_laws`; the first entry is the default.
FRICTION_LAWS: dict[str, type[Friction]] = {"smooth": Friction}


def friction_law(name: str) -> type[Friction]:
    """The law that another package has added under a name; ArgumentError where it is none."""
    law = extension("frictions", name)
    if not (isinstance(law, type) and issubclass(law, Friction) and hasattr(law, "torque")):
        what = f"given {law!r}, expected a subclass of Friction with a method torque"
        raise ArgumentError(f"entry point {name} of flexgen.frictions: {what}")
    return law


def added_sources(laws: Iterable[Friction]) -> list[Path]:
    """The files with those of these laws that other packages have added."""
    modules = [sys.modules.get(type(law).__module__) for law in laws if type(law) not in FRICTION_LAWS.values()]
    return sorted({Path(file) for module in modules if (file := getattr(module, "__file__", None))})
