"""The methods of this room, for `flexgen.inversion.methods.method_table`; strings only, quick to
import.
"""

from __future__ import annotations

from flexgen.inversion.methods.method_table import Method

DISCRETIZED = Method(
    "discretized",
    "optimization of the DAE on a uniform grid, smoothest torque",
    "flexgen.inversion.comparison.discretized",
    any_coupling=True,
)
BDF = Method(
    "bdf",
    "BDF with constant steps on the original DAE of high index",
    "flexgen.inversion.comparison.bdf",
)
REDUCED = Method(
    "reduced",
    "index reduction by dummy derivatives, SUNDIALS",
    "flexgen.inversion.comparison.reduced",
    refines=False,
)
KUNKEL_MEHRMANN = Method(
    "kunkel-mehrmann", "regularized DAE, Radau IIA", "flexgen.inversion.comparison.kunkel_mehrmann"
)
