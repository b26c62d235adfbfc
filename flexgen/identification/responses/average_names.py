"""Names of the averages over the realizations of an experiment, see `flexgen.frf`."""

from typing import Literal

AverageName = Literal["arithmetic", "harmonic", "logarithmic", "h1"]
