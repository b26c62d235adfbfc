"""Internal motion that nothing damps: hanging loads, springs without damping, flat outputs.

With the output held, the non-actuated coordinates move with the zeros of the output. Zeros on the
imaginary axis are oscillations that never decay, such as a load that swings below a trolley. A
zero at infinity means that the output determines the coordinate without its acceleration: near the
pose the output is flat. Neither delays the torque nor advances it, but a path that excites such an
oscillation leaves it there, and where its frequency is as low as those of the path no bounded
torque of a useful size exists.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import gear_damping
from flexgen.model.elements import RobotModel

if TYPE_CHECKING:
    from flexgen.runtime.inversion.path_inversion import Inversion

# Oscillations of a lower frequency [1/s] are motions of a coordinate that no spring and no weight
# holds, not oscillations.
SLOWEST = 1e-3

# Part of the reason, by which the sentence for the user finds it among the warnings.
UNDAMPED = "no bounded motion was found"


@dataclass(frozen=True)
class UndampedMotion:
    """Internal oscillations without damping, and coordinates of a flat output, along a path.

    Parameters
    ----------
    frequencies_hz : tuple of float
        Of the zeros on the imaginary axis, lowest and highest along the path; empty: none.
    flat : bool
        Whether a zero lies at infinity somewhere along the path.
    coordinates : tuple of str
        The non-actuated coordinates, in which the oscillations and the flat motion take place.
    """

    frequencies_hz: tuple[float, ...]
    flat: bool
    coordinates: tuple[str, ...]

    def describe(self) -> str:
        """The motion as part of a sentence, such as "swing oscillates undamped at 0.498 Hz"."""
        names = ", ".join(self.coordinates)
        if not self.frequencies_hz:
            return f"the output is flat in {names} (a zero at infinity)"
        low = f"{self.frequencies_hz[0]:.3g}"
        high = f"{self.frequencies_hz[-1]:.3g}"
        band = low if low == high else f"{low} to {high}"
        flat = ", and at other poses the output is flat (a zero at infinity)" if self.flat else ""
        return (
            f"with the output held, {names} can oscillate undamped at {band} Hz (zeros on the "
            f"imaginary axis){flat}"
        )


def find_undamped(
    equations: Equations, along: Iterable[tuple[float, np.ndarray]]
) -> UndampedMotion | None:
    """Undamped internal motion by the zeros [1/s] at instants [s] of a path, if there is any."""
    from flexgen.analysis.zero_dynamics.zeros import ON_AXIS

    model = equations.model
    if model.n_e == 0:
        return None
    count = 2 * model.n_e + int(np.sum(gear_damping(equations) > 0))
    frequencies: list[float] = []
    flat = False
    for _, zeros in along:
        finite = zeros[np.isfinite(zeros)]
        flat |= len(finite) < count
        on_axis = np.abs(finite.real) <= ON_AXIS * np.abs(finite)
        found = np.abs(finite.imag[on_axis])
        frequencies += (found[found > SLOWEST] / (2 * np.pi)).tolist()
    if not frequencies and not flat:
        return None
    names = tuple(model.coordinates[i].name for i in model.i_e)
    bounds = (min(frequencies), max(frequencies)) if frequencies else ()
    return UndampedMotion(bounds, flat, names)


def describe_swing(undamped: UndampedMotion, model: RobotModel, found: Inversion) -> str:
    """Warning of a motion that continues after the path: its size, and what can be done.

    Parameters
    ----------
    undamped : UndampedMotion
    model : RobotModel
    found : Inversion
        Its samples after the path have the motion.
    """
    after = found.q_a[len(found.q_a) - found.n_post - 1 :]
    sizes = []
    for i in model.i_e:
        half = (after[:, i].max() - after[:, i].min()) / 2
        sizes.append(f"{model.coordinates[i].name} {half:.3g} {model.coordinates[i].unit}")
    return (
        f"{undamped.describe()}: it continues after the path, within the computed "
        f"{found.n_post * found.period:.3g} s by +-{', +-'.join(sizes)}; the torques follow it to "
        "the last sample and must not be held then. Let a position controller take over; a slower "
        "or smoother move, or the moving mass as the output, leaves less of it"
    )


def advise_undamped(undamped: UndampedMotion, duration: float) -> str:
    """Reason and advice where no method finds the torques of a path of a duration [s]."""
    return (
        f"{undamped.describe()}: {UNDAMPED} for a path of "
        f"{duration:.3g} s; such a motion comes into resonance where the path is not "
        "slow against it. Give the move more time or a higher smoothness, damp the coordinate, or "
        "choose the actuated joint as output"
    )
