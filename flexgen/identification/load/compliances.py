"""Prior standard deviations of the springs of a robot before its load is identified."""

from __future__ import annotations

import numpy as np

from flexgen.base.spec.parts import Tolerances
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.model.elements import RobotModel

# Relative, of a spring for which the model file states none. An assumption, wide on purpose: it
# makes deviations of loads up to twice as large with right springs; intervals hold with springs
# that are 20 to 40 % off (docs/control.md).
STIFFNESS_SD = 0.2
NUMBERS = ("stiffness", "low", "high")  # of springs, that forces are proportional to


def stiffness_deviations(model: RobotModel) -> np.ndarray:
    """Relative standard deviation of the stiffness at each arm coordinate (n_a,); zero if rigid or
    known exactly.

    Of the table ``[uncertainty]``: that of the number by name, else the one of all stiffnesses,
    else `STIFFNESS_SD`.
    """
    given = model.uncertainty or Tolerances()
    named = dict(zip(given.parameters, given.sd, strict=True))
    rigid = {i for i, (gear, _) in zip(model.i_g, gears(model), strict=True) if gear.rigid}
    sd = np.zeros(model.n_a)
    for i, coordinate in enumerate(model.coordinates):
        stated = [
            named[x] for x in (f"{coordinate.name}.{number}" for number in NUMBERS) if x in named
        ]
        if i not in rigid:
            sd[i] = max(stated, default=given.stiffness or STIFFNESS_SD)
    return sd
