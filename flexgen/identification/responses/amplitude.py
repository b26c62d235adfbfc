"""The amplitude test: which nonlinearity makes frequency responses differ between levels of the
excitation.

A linear robot has the same responses at all levels. Where they differ, the changes of stiffness,
loss, damping and friction of each gear are fitted at each pose and level
(`flexgen.identification.responses.gear_changes`), and their differences between the levels are
compared with those of describing functions. So is the distortion, which no linear element
describes: at a smaller amplitude it is larger for a dead band, and smaller for a cubic spring.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from flexgen.identification.responses.describing_functions import (
    average_coulomb,
    average_hysteresis,
    average_spring,
)
from flexgen.identification.responses.gear_changes import Changes, Linearization, fit_changes

SAME = 2.0  # mean square of a difference over its noise, up to which responses are the same
SMALL = 2e-3  # difference, as a part of the responses, that motions of finite size can have
LEAST_SHARE = 0.5  # of the differences that a cause must explain to be named
INEXACT = 0.05  # error of describing functions, as a part of the changes
LEAST = 2e-3  # changes that are too small to be judged, in the units of `Linearization`
DISTORTION_SD = 0.5  # of the logarithm of a ratio of distortions
# difference of costs, -2 log of the likelihood, of causes that the data do not distinguish
ALIKE = 6.0
SOFTEST = 0.05  # stiffness over that of the model
# sign of the change of the distortion with the amplitude
SPRINGS = {"backlash": -1.0, "cubic": 1.0}
PART = 0.2  # of the largest effect of a cause, below which a gear is not named


@dataclass(frozen=True)
class Level:
    """Measured responses at one level, and the linear model there.

    Parameters
    ----------
    model : Linearization
    G : complex array (k, lines, n_m, n_m)
    variance : array (k, lines, n_m, n_m)
        Of the elements of G by noise.
    mean, sd : arrays (k, g)
        Mean and standard deviation of the torque of the gears, over their stiffness.
    speed_sd : array (k, n_m) [rad/s]
    """

    model: Linearization
    G: np.ndarray
    variance: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    speed_sd: np.ndarray


@dataclass(frozen=True)
class Motion:
    """Motion at the poses of a level, on which a law depends, in units of the first level.

    ``deflection`` (k, g) and ``speed`` (k, n_m): standard deviations; ``torque`` (k, g): mean
    torque of the gears over stiffness and deflection.
    """

    deflection: np.ndarray
    speed: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True)
class Effect:
    """Effect of a law at the poses of one level.

    ``stiffness``, ``loss`` (k, g), ``friction`` (k, n_m): in the units of `Linearization`;
    ``distortion`` (k, g): of the torque over its linear part, None where it is not known.
    """

    stiffness: np.ndarray
    loss: np.ndarray
    friction: np.ndarray
    distortion: np.ndarray | None = None

    def changes(self) -> np.ndarray:
        """Changes of k, h, d, v at all poses (k, 3 g + n_m)."""
        return np.hstack([self.stiffness, self.loss, 0 * self.loss, self.friction])


@dataclass(frozen=True)
class Law:
    """A nonlinearity with numbers (count, g or n_m) for each gear or motor, in units of the first
    level.
    """

    name: str
    effects: Callable[[np.ndarray, Sequence[Motion]], list[Effect]]
    bounds: tuple[tuple[float, float], ...]
    starts: tuple[tuple[float, ...], ...]
    of_motors: bool = False


@dataclass(frozen=True)
class Nonlinearity:
    """A possible cause: its law, the ``share`` of the differences that it explains, and its
    numbers by gear or motor.

    Numbers in units of the first level: ``backlash``: half width over the standard deviation of
    the deflection; ``cubic``: part of the stiffness that it adds; ``hysteresis``: stiffness that
    slips over the whole one, deflection at which it slips over the standard deviation;
    ``Coulomb``: part of the friction in the units of `Linearization`.
    """

    law: str
    share: float
    numbers: dict[int, tuple[float, ...]]
    cost: float


@dataclass(frozen=True)
class Comparison:
    """The result of `compare`.

    Parameters
    ----------
    ratio, size : float
        As of `difference`.
    changes : float
        Mean square of the changes of gears and motors over their accuracy.
    causes : tuple of Nonlinearity
        Those that the data do not distinguish, the most probable first; empty where none explains
        the changes.
    deflection : array (g,)
        Mean of the standard deviations over the poses at the first level.
    friction : array (n_m,) [N m]
        Coulomb friction of 1 in the units of the laws.
    """

    ratio: float
    size: float
    changes: float
    causes: tuple[Nonlinearity, ...]
    deflection: np.ndarray
    friction: np.ndarray

    @property
    def differs(self) -> bool:
        """Whether the responses differ by more than noise."""
        return self.ratio > SAME

    @property
    def changed(self) -> bool:
        """Whether gears or motors differ by more than noise and distortion."""
        return self.differs and self.changes > SAME


@dataclass(frozen=True)
class Differences:
    """The changes of gears and motors from the first level to the others, all poses of the second
    level first.

    ``x`` (n, 3 g + n_m), ``whiten`` (n, ..., ...): L^-1, covariance ``L L^T``; ``distortion``:
    logarithm at each level.
    """

    x: np.ndarray
    whiten: np.ndarray
    distortion: np.ndarray

    def weigh(self, away: np.ndarray) -> np.ndarray:
        """Deviations (n, 3 g + n_m) over their accuracy."""
        return (self.whiten @ away[..., None])[..., 0]


def compare(levels: Sequence[Level]) -> Comparison:
    """Whether responses differ between levels of the excitation, and which nonlinearity explains
    it.
    """
    ratio, size = difference(levels)
    first = levels[0]
    g = len(levels[0].model.stiffness)
    none = Comparison(ratio, size, 0.0, (), np.zeros(g), np.zeros(first.G.shape[-1]))
    if not none.differs or g == 0:
        return none
    fits = _fit_all(levels)
    moved = _differences(fits)
    changes = float((moved.weigh(moved.x) ** 2).mean())
    if changes <= SAME:
        return replace(none, changes=changes)
    motions, deflection, speed = _motions(levels, fits)
    causes = sorted((_rate(law, moved, motions) for law in LAWS), key=lambda cause: cause.cost)
    doubted = contradicted(
        causes[0].law, moved.distortion, np.array([m.deflection.mean() for m in motions])
    )
    near = [c for c in causes if c.cost < causes[0].cost + ALIKE or (doubted and c.law in SPRINGS)]
    likely = tuple(c for c in near if c.share >= LEAST_SHARE)
    return Comparison(ratio, size, changes, likely, deflection, first.model.units[3] * speed)


def contradicted(law: str, distortion: np.ndarray, size: np.ndarray) -> bool:
    """Whether the distortion of the levels changes with their ``size`` as that of the other of
    `SPRINGS` does.

    Both have a smaller stiffness at a smaller amplitude.
    """
    slope = float((distortion - distortion.mean()) @ (size - size.mean()))
    return slope * SPRINGS.get(law, 0.0) < 0.0


def difference(levels: Sequence[Level]) -> tuple[float, float]:
    """Mean square of the differences from the first level over their noise, and their median over
    the responses.

    Differences that the model itself has are subtracted.
    """
    first = levels[0]
    others = levels[1:]
    away = [np.abs(x.G - first.G - (x.model.G - first.model.G)) for x in others]
    own = [INEXACT * np.abs(x.model.G - first.model.G) for x in others]
    noise = first.variance + (SMALL * np.abs(first.G)) ** 2
    ratio = [d**2 / (noise + x.variance + e**2) for d, x, e in zip(away, others, own, strict=True)]
    return float(np.mean(ratio)), float(np.median(np.array(away) / np.abs(first.G)))


def _fit_all(levels: Sequence[Level]) -> list[list[Changes]]:
    """The changes at each level and pose; the search begins at those of the first level."""
    out: list[list[Changes]] = []
    for level in levels:
        start = [x.x for x in out[0]] if out else [np.zeros(len(level.model.prior))] * len(level.G)
        args = enumerate(zip(level.G, level.variance, start, strict=True))
        out.append([fit_changes(level.model, k, G, variance, x) for k, (G, variance, x) in args])
    return out


def _motions(
    levels: Sequence[Level], fits: Sequence[Sequence[Changes]]
) -> tuple[list[Motion], np.ndarray, np.ndarray]:
    """The motions at all levels, and the units of deflections and speeds: their means at the first
    level.
    """
    g = len(levels[0].model.stiffness)
    sizes = []
    for level, changes in zip(levels, fits, strict=True):
        stiffness = 1 + np.array([x.x[:g] for x in changes])
        sizes.append((level.sd / np.maximum(stiffness, SOFTEST), level.speed_sd))
    deflection, speed = (part.mean(axis=0) for part in sizes[0])
    pairs = zip(levels, sizes, strict=True)
    return (
        [Motion(d / deflection, v / speed, level.mean / deflection) for level, (d, v) in pairs],
        deflection,
        speed,
    )


def _differences(fits: Sequence[Sequence[Changes]]) -> Differences:
    """The differences of fits, with the errors of describing functions in their covariances."""
    x = []
    whiten = []
    for level in fits[1:]:
        for a, b in zip(fits[0], level, strict=True):
            x.append(b.x - a.x)
            extra = LEAST**2 + (INEXACT * np.abs(x[-1]).max()) ** 2
            covariance = a.covariance + b.covariance + extra * np.eye(len(a.x))
            whiten.append(np.linalg.inv(np.linalg.cholesky(covariance)))
    sizes = np.array([[c.distortion for c in level] for level in fits]).mean(axis=1)
    return Differences(np.array(x), np.array(whiten), np.log(sizes + LEAST))


def _rate(law: Law, moved: Differences, motions: Sequence[Motion]) -> Nonlinearity:
    """The best numbers of a law, with its cost and the share of the differences that it
    explains.
    """
    g = motions[0].deflection.shape[1]
    n_m = motions[0].speed.shape[1]
    shape = len(law.bounds), n_m if law.of_motors else g

    def residual(z: np.ndarray) -> np.ndarray:
        effects = law.effects(z.reshape(shape), motions)
        changes = [effect.changes() for effect in effects]
        away = moved.weigh(np.concatenate([x - changes[0] for x in changes[1:]]) - moved.x).ravel()
        known = [e.distortion for e in effects if e.distortion is not None]
        if not known:
            return away
        logs = np.log(np.array([x.mean() for x in known]) + LEAST)
        return np.concatenate([away, np.diff(logs - moved.distortion) / DISTORTION_SD])

    low, high = np.repeat(np.array(law.bounds).T, shape[1], axis=1)
    starts = [np.repeat(start, shape[1]) for start in law.starts]
    fits = [least_squares(residual, z, bounds=(low, high), x_scale=z) for z in starts]
    best = min(fits, key=lambda fit: float(fit.cost))
    left = float((best.fun[: moved.x.size] ** 2).sum())
    z = best.x.reshape(shape)
    first, second = (effect.changes() for effect in law.effects(z, motions)[:2])
    size = np.abs(second - first).max(axis=0)
    by = size[3 * g :] if law.of_motors else np.maximum(size[:g], size[g : 2 * g])
    numbers = {j: tuple(z[:, j].tolist()) for j in range(shape[1]) if by[j] > PART * by.max()}
    share = 1 - left / float((moved.weigh(moved.x) ** 2).sum())
    return Nonlinearity(
        law.name, share, numbers, 2 * float(best.cost) + z.size * float(np.log(moved.x.size))
    )


def _spring_effects(
    torque: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Callable[[np.ndarray, Sequence[Motion]], list[Effect]]:
    """The effects of a spring in place of the linear one, whose mean stiffness at the first level
    is 1.

    ``torque``: of the numbers and of the deflection, for a stiffness of 1 in its linear part.
    """

    def effects(z: np.ndarray, motions: Sequence[Motion]) -> list[Effect]:
        unit = np.ones(z.shape[1])
        for _ in range(2):  # the mean torque over the stiffness of the linear part
            found = [
                average_spring(lambda d: torque(z[0][:, None], d), m.torque / unit, m.deflection)
                for m in motions
            ]
            unit = 1 / np.maximum(found[0][0].mean(axis=0), 1e-3)
        zero = np.zeros_like(motions[0].speed)
        return [Effect(unit * N, 0 * N, zero, e) for N, e in found]

    return effects


def _hysteresis_effects(z: np.ndarray, motions: Sequence[Motion]) -> list[Effect]:
    found = [z[0] * average_hysteresis(z[1], m.deflection) for m in motions]
    return [Effect(N.real, N.imag, 0 * m.speed) for N, m in zip(found, motions, strict=True)]


def _coulomb_effects(z: np.ndarray, motions: Sequence[Motion]) -> list[Effect]:
    zeros = [0 * m.deflection for m in motions]
    return [
        Effect(zero, zero, z[0] * average_coulomb(m.speed))
        for m, zero in zip(motions, zeros, strict=True)
    ]


LAWS = (
    Law("Coulomb", _coulomb_effects, ((0.0, 100.0),), ((0.1,),), of_motors=True),
    Law(
        "backlash",
        _spring_effects(lambda gap, d: d - np.clip(d, -gap, gap)),
        ((1e-4, 3.0),),
        ((0.05,), (0.2,), (0.8,)),
    ),
    Law(
        "cubic", _spring_effects(lambda c, d: d + c / 3 * d**3), ((0.0, 30.0),), ((0.05,), (0.5,))
    ),
    Law(
        "hysteresis",
        _hysteresis_effects,
        ((0.0, 5.0), (0.02, 5.0)),
        ((0.3, 0.2), (0.3, 0.6), (0.3, 1.5)),
    ),
)
