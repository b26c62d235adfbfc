"""Single-fault hypotheses for a recording of a rigid arm: the torques of one motor, a gear ratio,
a scale of all angles, the zero of an angle.

Friction that falls with speed is found in the same way.

Each changes the torques by a column z times a number x, to first order. With the residuals e of
the fit, its terms X, the weights W and the information P of its priors,

    z_p = z - X (X' W X + P)^-1 X' W z,      x = z_p' W e / z_p' W z_p,
    share_j = 1 - |e_j - x z_pj|^2 / |e_j|^2

and a mistake is named where it explains half of the residuals of a motor j and is significant by
the block covariance of x.

Source: C. R. Rao, Proceedings of the Cambridge Philosophical Society 44, 1948 (score test).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.numerics.low_pass import LowPass
from flexgen.identification.estimator.score import Limit
from flexgen.identification.rigid.rigid_columns import BLOCK, Columns
from flexgen.identification.rigid.rigid_regressor import Regressor

SHARE = 0.5  # of the residuals of a motor that a mistake explains
FALLS = 0.05  # of the residuals of a motor that friction explains which falls with speed
SURE = 5.0  # deviations from zero
SPEEDS = (0.02, 0.06, 0.2, 0.6)  # over the largest speed, to which friction falls
# Least and largest gravity over that of the model for which the clock is wrong: the gravity of the
# Earth is known, and accelerations scale with the square of the clock.
CLOCKS = (0.5, 1.5)
ALONG = 0.99  # component of gravity over its size, along an axis
CLOCK = "a clock of the recording whose times are longer than true by [%]"
RATIOS = ("a ratio of the gear of", "the angles of all motors")
HIDDEN = 0.01  # scale of angles that is stated where the torques do not show it
NOTHING = 1e-9  # of a column that is left where the fit has others for it


@dataclass(frozen=True)
class Mistake:
    """A mistake that explains the residuals: ``what``, its ``value`` to first order, and the
    largest ``share``.
    """

    what: str
    value: float
    share: float

    @property
    def sentence(self) -> str:
        """The mistake in words."""
        return (
            f"{self.what} about {self.value:.2g} explains {100 * self.share:.0f} % of the "
            "errors of a motor."
        )

    def __str__(self) -> str:
        return self.sentence


@dataclass(frozen=True, eq=False)
class _Scores:
    """Score test of candidate mistakes, each a column z of torque changes; see the module.

    Rows are weighted such that the errors have the unit variance: n samples of the first motor,
    then of the second one, and so on.

    - ``projected`` (n_m n, candidates): z_p, the part of z that the terms of the fit cannot
      represent,
    - ``size`` (candidates,): ``z_p' z_p``, the information on x,
    - ``value`` (candidates,): the estimate ``x = z_p' e / size``, in the unit of the candidate;
      zero where ``size`` is next to none,
    - ``gain`` (candidates,): decrease ``x z_p' e`` of the sum of squared residuals,
    - ``shares`` (n_m, candidates): part of the squared residuals of each motor that x explains,
    - ``error`` (n_m n,): the residuals e of the fit,
    - ``block``: samples in a block; errors of different blocks are taken as independent.
    """

    projected: np.ndarray
    size: np.ndarray
    value: np.ndarray
    gain: np.ndarray
    shares: np.ndarray
    error: np.ndarray
    block: int

    def is_sure(self, k: int) -> bool:
        """Whether the estimate of candidate k exceeds `SURE` of its standard deviations.

        Neighboring samples have correlated errors, so the deviation is that of sums over blocks b
        (a sandwich estimate), where the last block may be shorter than the others:

            sd(x) = sqrt(sum_b s_b^2) / size,    s_b = sum_{i in b} z_pi (e_i - x z_pi)
        """
        z_p = self.projected[:, k]
        products = z_p * (self.error - self.value[k] * z_p)
        by_sample = products.reshape(len(self.shares), -1).sum(axis=0)  # over the motors
        starts = range(0, len(by_sample), self.block)
        by_block = np.array([by_sample[i : i + self.block].sum() for i in starts])
        return bool(abs(self.value[k]) * self.size[k] > SURE * np.sqrt(by_block @ by_block))


def find_causes(
    whole: Columns,
    limit: float,
    numbers: tuple[np.ndarray, np.ndarray],
    terms: list[np.ndarray],
    error: np.ndarray,
    weight: np.ndarray,
    prior: np.ndarray,
) -> tuple[Mistake | None, np.ndarray, tuple[Limit, ...]]:
    """The mistake that explains most of the residuals, or fades of frictions that fall with speed
    and explain more; and the scales of angles that these torques do not show.

    None and zeros (n_m,) [s/rad or s/m, of the joint]: nothing explains a large part of them.

    Parameters
    ----------
    whole : Columns
        Not filtered.
    limit : float [Hz]
        Of the filter of all else.
    numbers : arrays (10 bodies,), (n_m, columns)
        Of the bodies, and frictions.
    terms : list of arrays (n, parameters)
        Terms of the fit, one array for each motor.
    error : array (n, n_m) [N m]
    weight, prior : arrays (n_m,), (parameters,)
        Of the errors, and information.
    """
    names, columns, step = _candidates(whole, limit, *numbers)
    fades, falling = _fade_columns(whole, limit)
    scores = _scores(
        np.concatenate([columns, falling], axis=2),
        terms,
        error,
        weight,
        prior,
        round(BLOCK * whole.period / step),
    )
    motors = len(weight)
    found = np.zeros(len(weight))
    scores.gain[len(names) :][scores.value[len(names) :] <= 0] = 0.0  # it falls
    best = int(np.argmax(scores.gain))
    if best < len(names):
        share = float(scores.shares[:, best].max())
        if share >= SHARE and scores.is_sure(best):
            what, nominal = names[best]
            value = float(scores.value[best])
            clock = _clock_error(whole.regressor.model.gravity, what, value)
            if clock is not None:
                return Mistake(CLOCK, clock, share), found, ()
            return Mistake(what, nominal + value, share), found, ()
    for j in range(motors):
        own = np.arange(len(names) + j, len(scores.gain), motors)
        k = int(own[np.argmax(scores.gain[own])])
        if (
            whole.fades[j] == 0
            and scores.gain[k] > 0
            and scores.shares[j, k] >= FALLS
            and scores.is_sure(k)
        ):
            found[j] = fades[k - len(names)]
    return None, found, tuple(_hidden_scales([what for what, _ in names], scores))


def _hidden_scales(names: list[str], scores: _Scores) -> Iterator[Limit]:
    """Errors of the angles below which they are not named: a scale explains half of the residuals
    of a motor where its column is as large as these, ``x |z_pj| = |e_j|``.
    """
    motors = len(scores.shares)
    residual = np.linalg.norm(scores.error.reshape(motors, -1), axis=1)
    for k, name in enumerate(names):
        if not name.startswith(RATIOS):
            continue
        own = np.linalg.norm(scores.projected[:, k].reshape(motors, -1), axis=1)
        size = float((residual / np.maximum(own, 1e-300)).min())
        if size > HIDDEN:
            joint = name.removesuffix(" times").removeprefix(RATIOS[0]).strip()
            what = (
                "scale of all angles" if joint == RATIOS[1] else f"scale of the angle of {joint}"
            )
            yield Limit(what, size, "")


def _clock_error(gravity: tuple[float, ...], what: str, change: float) -> float | None:
    """Percents by which times are too long, where a change of gravity along itself has this
    effect; None: it is no such change.

    Times that are longer by s have accelerations smaller by s^2: bodies that are larger by s^2
    explain them under the gravity g / s^2.
    """
    size = float(np.linalg.norm(gravity))
    for axis, component in zip("xyz", gravity, strict=True):
        if what.startswith(f"gravity along {axis}") and abs(component) > ALONG * size:
            factor = 1.0 + change / component
            if CLOCKS[0] < factor < CLOCKS[1]:
                return 100.0 * float(1.0 / np.sqrt(factor) - 1.0)
    return None


def _scores(
    columns: np.ndarray,
    terms: list[np.ndarray],
    error: np.ndarray,
    weight: np.ndarray,
    prior: np.ndarray,
    block: int,
) -> _Scores:
    """Score test of candidate ``columns`` (n, n_m, candidates) [N m over the candidate's unit].

    ``terms``, ``error``, ``weight`` and ``prior`` of the fit as in `find_causes`; ``block``:
    samples in a block of independent errors. A candidate of which the terms of the fit leave less
    than `NOTHING` cannot be told from them: its value is zero.
    """
    X = np.vstack([x * w for x, w in zip(terms, weight, strict=True)])
    scale = np.sqrt((X**2).sum(axis=0) + prior)
    scale = np.where(scale > 0, scale, 1.0)
    X = X / scale
    e = (error * weight).T.ravel()
    Z = (columns * weight[:, None]).transpose(1, 0, 2).reshape(len(e), -1)
    A = X.T @ X + np.diag(prior / scale**2)
    projected = Z - X @ np.linalg.lstsq(A, X.T @ Z, rcond=1e-14)[0]
    size = (projected**2).sum(axis=0)
    score = projected.T @ e
    known = size > NOTHING * (Z**2).sum(axis=0)
    value = np.where(known, score / np.where(known, size, 1.0), 0.0)
    better = (e**2)[:, None] - (e[:, None] - projected * value) ** 2
    by_motor = (e**2).reshape(len(weight), -1).sum(axis=1)
    shares = (
        better.reshape(len(weight), -1, Z.shape[1]).sum(axis=1)
        / np.maximum(by_motor, 1e-300)[:, None]
    )
    return _Scores(projected, size, value, value * score, shares, e, max(1, block))


def _fade_columns(whole: Columns, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Fades and columns (n, n_m, candidates) of friction that falls with speed, of each motor at
    several speeds.
    """
    speed = np.maximum(whole.largest_speeds(), 1e-12)
    fades = np.concatenate([1.0 / (part * speed) for part in SPEEDS])
    rows = []
    for part in SPEEDS:
        one = [
            level[:, :, None] * np.eye(len(speed))
            for level, _ in whole.fade_columns(1.0 / (part * speed))
        ]
        rows.append(np.concatenate([whole.slow(k, x, limit) for k, x in enumerate(one)]))
    return fades, np.concatenate(rows, axis=2)


def _candidates(
    whole: Columns, limit: float, pi: np.ndarray, friction: np.ndarray
) -> tuple[list[tuple[str, float]], np.ndarray, float]:
    """Names with the value where nothing is wrong, columns (n, n_m, candidates) of changes from
    it, and the step.
    """
    model = whole.regressor.model
    found = []
    joints = [model.coordinates[i] for i in model.i_g]
    names = [(f"torques of {motor.name} times", 1.0) for motor in model.motors]
    names += [(f"a zero of {c.name} [{c.unit}] off by", 0.0) for c in joints]
    names += [(f"{RATIOS[0]} {c.name} times", 1.0) for c in joints]
    names += [(f"{RATIOS[1]} times", 1.0)]
    names += [(f"gravity along {axis} of the base [m/s^2] more by", 0.0) for axis in "xyz"]
    gravities = [Regressor(replace(model, gravity=tuple(row))) for row in np.eye(3).tolist()]
    motors = np.abs(model.eta).argmax(axis=0)
    every = 1 if np.isinf(limit) else LowPass(whole.step, limit).every
    for k, (Y, total, links) in enumerate(
        zip(whole.Y, whole.torques(pi, friction), whole.links, strict=True)
    ):
        one = np.ones_like(links[0])
        load = Y @ pi
        zeros = whole.regressor.changes(links, pi, [-one, 0 * one, 0 * one])
        gravity = np.stack(
            [weight(links[0], 0 * one, 0 * one) @ pi for weight in gravities], axis=2
        )
        ratios = whole.motor_side(whole.regressor.changes(links, pi, [-x for x in links]))
        for i, j in enumerate(motors):
            ratios[:, j, i] -= load[:, j]
        torques = total[:, :, None] * np.eye(model.n_m)
        changes = np.concatenate(
            [
                torques,
                whole.motor_side(zeros),
                ratios,
                ratios.sum(axis=2, keepdims=True),
                whole.motor_side(gravity),
            ],
            axis=2,
        )
        found.append(whole.slow(k, changes, limit))
    return names, np.concatenate(found), whole.step * every
