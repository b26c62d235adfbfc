"""Whether the record shows elements of hysteresis that a fit lacks, one at a time.

A loop of another shape changes the torques by less than the noise, and is seen against the noise
of each frequency. So an element more is added to the driven arm, which slips between two of the
gear's or before or after all of them, so weak that the torques are linear in it. One step from the
fit, with the weights of the noise in bands of frequency,

    [theta, a] -= A^-1 G,    cov = A^-1 (2 J'J - A) A^-1

(see `flexgen.identification.gears.fit`), gives its size a, over the stiffness of the gear, and the
lost motion of all elements with it. The standard deviation of a follows from the noise of the
record, with the covariance J'J of G, and from the added noise, J'J - A. A jackknife would contain
the errors of a wrong law, and so hide it.

Source: C. R. Rao, Linear Statistical Inference and Its Applications, 2nd ed. 1973, sec. 6e (score
test).
"""

from __future__ import annotations

from copy import copy

import numpy as np
from scipy.linalg import eigh

from flexgen.dynamics.mechanics.lagrangian import gear_stiffness
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.identification.gears.driven_arm import DrivenArm, Element, MotorMotion
from flexgen.identification.gears.fit import (
    LEAST_LOST,
    LEAST_SIGNAL,
    NO_LOST,
    RANK,
    Estimate,
    GearModel,
    element_entries,
)
from flexgen.identification.gears.whitening import Whitening

# deflections of slip of the first and the last further element over those of the gear's, or its
# inverse
APART = 3.0
SMALL = 1e-3  # stiffness of a further element over that of the gear
NONE = 1e-9  # the same where it is left out
# sizes over their deviations that noise does not make, nor the start of a sliding friction
SEEN = (4.0, 8.0)
PAIRS = 4  # of samples of noise
MOVES = 1.5  # changes of lost motions over their deviations, from which they count


def gears_that_lack_elements(model: GearModel, found: Estimate) -> tuple[int, ...]:
    """Gears of which the record shows one element more, with a lost motion that differs by `MOVES`
    deviations.
    """
    further = FurtherElements(model, found.theta)
    if not further.gears:
        return ()
    white = Whitening.of_bands(*model.noise_power(found.theta, found.error), model)
    A, raw, gradient = further.equations(white)
    free = _free(model, found.theta)
    base = np.flatnonzero(free & (np.diag(raw)[: len(free)] > 0.0))
    lacking = set()
    seen = SEEN[model.friction.sticks]
    for k, (gear, lost) in enumerate(zip(further.gears, further.lost, strict=True)):
        added = len(found.theta) + k
        if not raw[added, added] > 0.0:
            continue
        part = np.append(base, added)
        step, covariance = _step(A[np.ix_(part, part)], raw[np.ix_(part, part)], gradient[part])
        of_gear = np.zeros(len(found.theta))
        at = model.layout.entries(model.layout.lost)[np.equal(model.at, gear)]
        of_gear[at] = model.units[at]
        change = -(np.append(of_gear[base], lost) @ step)
        moves = abs(change) > MOVES * np.sqrt(of_gear @ found.covariance @ of_gear)
        if moves and abs(step[-1]) > seen * np.sqrt(covariance[-1, -1]):
            lacking.add(gear)
    return tuple(gear for gear in model.sought.gears if gear in lacking)


def _free(model: GearModel, theta: np.ndarray) -> np.ndarray:
    """Entries of theta but those of elements that the fit has dropped."""
    free = np.ones(len(theta), bool)
    for k in np.flatnonzero(theta[model.layout.lost] <= LEAST_LOST).tolist():
        for entries in element_entries(model, k):
            free[entries] = False
    return free


def _step(A: np.ndarray, raw: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Step to be subtracted from numbers, and its covariance; directions that are noise stay as
    they are.
    """
    scale = np.sqrt(np.diag(raw))
    both = np.outer(scale, scale)
    values, vectors = eigh(A / both, raw / both + RANK * np.eye(len(raw)))
    known = values > LEAST_SIGNAL
    found = vectors[:, known] / scale[:, None]
    inverse = found / values[known]
    return inverse @ (found.T @ gradient), (inverse * (2 - values[known])) @ inverse.T


class FurtherElements:
    """Further elements of the gears of a fit, in its driven arm.

    ``gears``, ``lost``: gear of each, and its lost motion where it is as stiff as its gear.
    """

    def __init__(self, model: GearModel, theta: np.ndarray) -> None:
        self.model = model
        self.theta = theta
        elements = list[Element]()
        n = len(model.names)
        values, K_h, W, *_ = np.split(
            model.numbers(theta), [n, n + model.count, n + 2 * model.count]
        )
        given = dict(zip(model.names, values.tolist(), strict=True))
        K = gear_stiffness(with_values(model.equations.model, given), np.inf)
        sought = model.sought
        wide = theta[model.layout.lost] > NO_LOST
        for gear in sought.gears:
            s = np.sort((W / K_h)[wide & np.equal(model.at, gear)])
            slips = np.concatenate([s[:1] / APART, np.sqrt(s[1:] * s[:-1]), s[-1:] * APART])
            elements += [Element(gear, float(K[gear]), 2 * slip) for slip in slips.tolist()]
        self.gears = [each.gear for each in elements]
        self.lost = [each.lost for each in elements]
        self.K = K[self.gears]
        if elements:
            self.driven = copy(model)
            laws = (*sought.elements, *elements)
            arm = DrivenArm(
                model.equations, laws, sought.exponents, sought.errors, sought.harmonics
            )
            self.driven.arm = arm
            self.driven.segments = arm.segments(model.signals.sample_s, model.segments.steps)

    def equations(self, white: Whitening) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, J'J and G of the numbers of the fit and the sizes of these elements, see
        `flexgen.identification.gears.fit`.
        """
        model = self.model

        def sums(motion: MotorMotion) -> tuple[np.ndarray, np.ndarray]:
            error, J = model.derivatives(self.theta, motion)
            J = white(np.concatenate([J, self._derivatives(motion)], axis=2)).reshape(
                error.size, -1
            )
            return J.T @ J, J.T @ white(error).ravel()

        raw, own = sums(model.motion)
        noisy = [
            sums(model.more_noise(seed, sign)) for seed in range(PAIRS) for sign in (1.0, -1.0)
        ]
        more, other = (np.mean([found[k] for found in noisy], axis=0) for k in range(2))
        return 2 * raw - more, raw, 2 * own - other

    def _derivatives(self, motion: MotorMotion) -> np.ndarray:
        """Of the torques (k, n_m) in the size of each element."""
        sizes = [SMALL * (np.arange(len(self.K)) == k) for k in range(-1, len(self.K))]
        none, *each = self.driven.arm_torques(
            [self._numbers(size + NONE) for size in sizes], motion
        )
        return np.stack([(x - none) / SMALL for x in each], axis=2)

    def _numbers(self, sizes: np.ndarray) -> np.ndarray:
        """Numbers of the driven arm with these elements."""
        model = self.model
        n = len(self.model.names)
        c = self.model.count
        K_h = sizes * self.K
        shapes = np.ones(len(sizes) * model.sought.exponents)
        own = np.split(
            model.numbers(self.theta), [n + c, n + 2 * c, n + 2 * c + c * model.sought.exponents]
        )
        return np.concatenate(
            [own[0], K_h, own[1], K_h * np.array(self.lost) / 2, own[2], shapes, own[3]]
        )
