"""Variables of an FMU: names, value references, units, and which other variables they depend
on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

# Kinds of variables in flexgen_fmu_core.h; the value reference is 1000 times the kind, plus the
# index.
TIME, STATE, RATE, INPUT, OUTPUT, PARAMETER, SETTING, STATUS = range(8)

# Unit -> powers of the SI base units kg, m, s and of rad.
UNITS: dict[str, dict[str, int]] = {
    "1": {},
    "s": {"s": 1},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "1/s": {"s": -1},
    "N/s": {"kg": 1, "m": 1, "s": -3},
    "N.m/s": {"kg": 1, "m": 2, "s": -3},
    "N.m.s/rad": {"kg": 1, "m": 2, "s": -1, "rad": -1},
}


@dataclass(frozen=True)
class Variable:
    """One scalar variable.

    Parameters
    ----------
    name : str
        Structured, such as ``motor.m1.torque`` or ``tool.position[1]``.
    kind, index : int
        One of the constants of this module, and the index in the array of this kind in C.
    unit : str
        A key of `UNITS`; empty for whole numbers.
    text : str
        What it is.
    start : float or int, optional
        Where it is set at the start; None where it is computed.
    sampled : bool
        True: it changes at samples only.
    fixed : bool
        Of a parameter: it cannot change after the initialization.
    nominal : float, optional
    depends : tuple of int, optional
        Value references it depends on; None: on all states and inputs.
    """

    name: str
    kind: int
    index: int
    unit: str
    text: str
    start: float | int | None = None
    sampled: bool = False
    fixed: bool = False
    nominal: float | None = None
    depends: tuple[int, ...] | None = None

    @property
    def reference(self) -> int:
        """Value reference."""
        return 1000 * self.kind + self.index

    def to_dict(self) -> dict[str, Any]:
        """Data of the variable, as printed by `flexgen export fmu --json`."""
        names = ("name", "reference", "causality", "unit", "start", "text")
        return {name: getattr(self, name) for name in names}

    @property
    def whole(self) -> bool:
        """Whether it is a whole number."""
        return self.kind in (SETTING, STATUS)

    @property
    def causality(self) -> str:
        """In the words of FMI."""
        return {
            TIME: "independent",
            INPUT: "input",
            OUTPUT: "output",
            STATUS: "output",
            PARAMETER: "parameter",
            SETTING: "parameter",
        }.get(self.kind, "local")

    @property
    def variability(self) -> str:
        """In the words of FMI."""
        if self.kind in (PARAMETER, SETTING):
            return "fixed" if self.fixed or self.whole else "tunable"
        return "discrete" if self.sampled or self.whole else "continuous"

    @property
    def initial(self) -> str | None:
        """In the words of FMI; None for inputs and the time, which have none."""
        if self.kind in (TIME, INPUT):
            return None
        return "calculated" if self.start is None else "exact"


def array(
    name: str, kind: int, first: int, unit: str, texts: Sequence[str], starts: Sequence[float]
) -> list[Variable]:
    """Variables ``name[1]``, ``name[2]`` ... with indices from ``first``."""
    return [
        Variable(f"{name}[{k + 1}]", kind, first + k, unit, text, float(starts[k]))
        for k, text in enumerate(texts)
    ]
