"""Options of a loaded library with the fields and defaults of its C structs: `SolverOptions` of a
whole path, `StreamOptions` of a moving horizon.

Bounds are those of the library: its manifest has them, and C refuses what is out of range.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import number_of, whole_of
from flexgen.runtime.inversion.inversion_arguments import hold_of, tolerance_of
from flexgen.runtime.structs import Interface


@dataclass(frozen=True)
class SolverOptions:
    """Options of a whole path, the C struct ``inversion_options``.

    Attributes
    ----------
    n_pre, n_post, samples_per_interval, tolerance, hold, delay, settled, growth
        As of `Library.invert`.

    Examples
    --------
    >>> from flexgen.runtime.options import SolverOptions
    >>> SolverOptions(n_pre=100).samples_per_interval
    1
    """

    n_pre: int = 0
    n_post: int = 0
    samples_per_interval: int = 1
    tolerance: float | None = None
    hold: str = "spline"
    delay: float = 0.0
    settled: float = 0.0
    growth: bool = False

    @checked_types
    def members(
        self,
        function: str,
        interface: Interface,
        real: np.dtype[Any],
        *,
        settles: bool,
        grows: bool,
    ) -> dict[str, Any]:
        """Members of the C struct, checked.

        Parameters
        ----------
        function : str
            For messages.
        interface : Interface
            Of the library.
        real : dtype
            Of its numbers.
        settles, grows : bool
            Whether the function can end where the motion has settled, and compute the growth.
        """
        counts = {
            name: whole_of(function, name, getattr(self, name))
            for name in ("n_pre", "n_post", "samples_per_interval")
        }
        tolerance = _tolerance(function, self.tolerance, real)
        settled = number_of(function, "settled", self.settled)
        if not (0.0 <= settled < 1.0 if settles else settled == 0.0):
            wanted = (
                "a number from 0 to 1 [m or rad]" if settles else "0: all samples are computed"
            )
            raise ArgumentError(f"{function}, settled: given {settled:g}, expected {wanted}")
        if not isinstance(self.growth, bool) or (self.growth and not grows):
            wanted = (
                "True or False"
                if grows
                else "False: this function, or the library, computes no growth"
            )
            raise ArgumentError(f"{function}, growth: given {self.growth!r}, expected {wanted}")
        return {
            **counts,
            **hold_of(interface, function, self.hold, self.delay),
            "tolerance": tolerance,
            "settled": settled,
            "growth": int(self.growth),
        }


@dataclass(frozen=True)
class StreamOptions:
    """Options of a stream, the C struct ``stream_options``.

    Attributes
    ----------
    intervals, samples_per_interval, period, tolerance, hold, delay
        As of `Library.stream`.

    Examples
    --------
    >>> from flexgen.runtime.options import StreamOptions
    >>> StreamOptions(intervals=20, samples_per_interval=5, period=0.005).sample_time
    0.001
    """

    intervals: int
    samples_per_interval: int
    period: float
    tolerance: float | None = None
    hold: str = "spline"
    delay: float = 0.0

    @property
    def sample_time(self) -> float:
        """Time between two samples of the results [s]."""
        return self.period / max(self.samples_per_interval, 1)

    def resolve(self, real: np.dtype[Any]) -> StreamOptions:
        """The options as C has them: whole numbers, floats, a tolerance; ArgumentError for
        others.
        """
        return StreamOptions(
            whole_of("stream", "intervals", self.intervals),
            whole_of("stream", "samples_per_interval", self.samples_per_interval),
            number_of("stream", "period", self.period),
            _tolerance("stream", self.tolerance, real),
            self.hold,
            self.delay,
        )

    def members(self, interface: Interface) -> dict[str, Any]:
        """Members of the C struct, of checked options."""
        return asdict(self) | hold_of(interface, "stream", self.hold, self.delay)


def _tolerance(function: str, given: Any, real: np.dtype[Any]) -> float:
    """The tolerance of a call, by default that of the precision."""
    return number_of(function, "tolerance", tolerance_of(real) if given is None else given)
