"""Line elements: springs, gas springs, rods and cables between two points of a robot.

A line acts along the straight connection of two points, each fixed to a body or to the base. Its
tension F, positive where it pulls its ends together, is a function of the length l and of its
rate; a uniform mass m along the line adds, with v1, v2 the velocities of the two ends,

    T = m/6 (v1.v1 + v1.v2 + v2.v2)

and half of its weight at each end, which is exact, also where the line stretches uniformly. A line
closes no loop: it adds energy and forces to a tree of bodies.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

# Standard atmosphere [Pa], which acts on the outside of the rod of a gas spring.
ATMOSPHERE = 101325.0


@dataclass(frozen=True)
class Anchor:
    """An end of a line: ``position`` (3) [m] in the frame of the body of ``element``, or in that
    of the base for ``"base"``.
    """

    element: str
    position: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Line:
    """Ends, mass and damping that all lines have.

    ``start``, ``end``: the two points. ``mass`` [kg], uniform along the line. ``damping``
    [N s/m]: tension for each m/s at which the line grows. ``length_min``, ``length_max`` [m]:
    limits of the length, which a motion is checked against; None: no limit.
    """

    name: str
    start: Anchor
    end: Anchor
    mass: float = 0.0
    damping: float = 0.0
    length_min: float | None = None
    length_max: float | None = None

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest length [m] that the line may have."""
        low = 0.0 if self.length_min is None else self.length_min
        return low, inf if self.length_max is None else self.length_max


@dataclass(frozen=True, kw_only=True)
class SpringLine(Line):
    """A spring that pulls and pushes, also a spring balancer.

    ``F = preload + stiffness (l - length)``: stiffness [N/m], the preload [N] at ``length`` [m].
    A length of 0 and no preload make the ideal spring that balances a weight in all poses.
    """

    stiffness: float
    length: float
    preload: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RodLine(Line):
    """A rod with the length ``length`` [m] without force: ``F = stiffness (l - length)``.

    Stiffness [N/m], ``E A / length`` of a bar; 0 where a closed loop keeps the length and the rod
    adds its mass alone.
    """

    stiffness: float
    length: float


@dataclass(frozen=True, kw_only=True)
class CableLine(Line):
    """A cable, which pulls and never pushes.

        x = l - length + preload / stiffness
        F = stiffness (x + sqrt(x^2 + smoothing^2)) / 2

    stiffness [N/m], preload [N] at ``length`` [m] but for the rounding. ``smoothing`` [m] rounds
    the change from slack to taut; the damping fades with it, times ``(1 + x / sqrt(...)) / 2``.
    """

    stiffness: float
    length: float
    smoothing: float
    preload: float = 0.0


@dataclass(frozen=True, kw_only=True)
class GasSpringLine(Line):
    """A gas spring or a hydropneumatic balancer, without friction.

    Gas of ``pressure`` [Pa, absolute] and ``volume`` [m^3] at ``length`` [m] obeys
    ``p V^exponent = constant``: exponent 1 for slow, 1.4 for fast motion of a diatomic gas. Its
    pressure above that of the surroundings, ``ambient_pressure`` [Pa], acts on ``area`` [m^2].

    ``acts = "push"``: the cross-section of the rod; the spring pushes, ``length`` is its largest
    length and ``V = volume + area (l - length)``. ``acts = "pull"``: the area around the rod; it
    pulls, ``length`` is its smallest length and ``V = volume - area (l - length)``. ``stroke``
    [m]: the way from there to the other end.
    """

    area: float
    pressure: float
    volume: float
    exponent: float
    length: float
    stroke: float
    acts: str = "push"
    ambient_pressure: float = ATMOSPHERE

    @property
    def sign(self) -> float:
        """1 where its gas pushes the ends apart, -1 where it pulls them together."""
        return 1.0 if self.acts == "push" else -1.0

    @property
    def range(self) -> tuple[float, float]:
        """Ends of the stroke [m], within limits that are stated."""
        ends = sorted((self.length, self.length - self.sign * self.stroke))
        low, high = super().range
        return max(low, ends[0]), min(high, ends[1])
