"""The methods of this room, for `flexgen.inversion.method_table`; strings only, quick to
import.
"""

from __future__ import annotations

from flexgen.inversion.method_table import Method

DISCRETIZED = Method(
    "discretized",
    "optimization of the DAE on a uniform grid, smoothest torque",
    "flexgen.lab.discretized",
    any_coupling=True,
)
BDF = Method("bdf", "BDF with constant steps on the original DAE of high index", "flexgen.lab.bdf")
REDUCED = Method(
    "reduced",
    "index reduction by dummy derivatives, SUNDIALS",
    "flexgen.lab.reduced",
    refines=False,
)
KUNKEL_MEHRMANN = Method(
    "kunkel-mehrmann", "regularized DAE, Radau IIA", "flexgen.lab.kunkel_mehrmann"
)
