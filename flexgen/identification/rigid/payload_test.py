"""Whether the torques of a recorded motion contradict the payload of the model file, or its bodies
have a common scale.

The payload is a constant of a fit of bodies: a wrong one is hidden in the last body, and shows
when the payload is changed. With the tolerance of CAD as prior of the bodies pi, about mu,

    c(mu) = min |e - X d|^2 + |(pi + d - mu) / sd|^2,

mu(p): of bodies of which one has other numbers p, its mass or its center of mass. p minimizes c;
what c loses is chi-square with the size of p for a payload that is right, and c over its value
with a wide prior is what the tolerances leave. The payload is named where it explains most of it,
and no body explains more. Torques that are all too large by a
factor are bodies that all are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from flexgen.identification.estimator.score import LEAST_TAIL, Explanation, Limit
from flexgen.identification.rigid.feasible_bodies import numbers_of, scales
from flexgen.identification.rigid.rigid_regressor import payload_in
from flexgen.model.elements import Body, RobotModel

CAD = 0.07  # relative tolerance of bodies from CAD
WIDE = 1.0  # the same of bodies of which little is known
SURE = 4.0  # standard deviations
SHARE = 0.5  # of what the tolerances leave that a number explains
CLEAR = 0.9  # from which on other mistakes, which the payload looks like, are not tried
AS_GOOD = 6.0  # loss of c by which one number is more likely than another
INFLATED = 2.0  # variance of the errors of a model over that of noise
STEPS = 8
STEP = 1e-4  # of differences: part of a mass, length [m]
FARTHEST = 2.0  # m: of a center of mass, and deviation of its prior
# Limits below which a wrong payload is not visible are stated: parts of a mass, of `FARTHEST` and
# of a scale.
LONG = 0.5  # parts of these above which motions do not show a fault in any case
STATED = {"mass": 0.25, "com": 0.05, "scale": 0.1}
ALL = "the scale of all torques"


@dataclass(frozen=True)
class Normal:
    """Normal equations of a fit: ``matrix`` X'X and ``slope`` X'e of weighted terms and errors at
    the bodies ``pi`` (10 bodies,), the first numbers, and ``information`` of the priors of the
    others, which are at ``away`` from their centers.
    """

    matrix: np.ndarray
    slope: np.ndarray
    pi: np.ndarray
    information: np.ndarray
    away: np.ndarray


@dataclass(frozen=True)
class PayloadTest:
    """``faults``, the best first, and ``limits`` below which a wrong payload is not visible."""

    faults: tuple[Explanation, ...] = ()
    limits: tuple[Limit, ...] = ()

    @property
    def is_clear(self) -> bool:
        """Whether the payload explains so much that no other mistake is looked for."""
        return bool(self.faults) and self.faults[0].share > CLEAR


NOT_TESTED = PayloadTest()


@dataclass(frozen=True)
class _Number:
    """Mass or center of mass of a body, or a scale: ``start``, its value in the file, and the
    change (10 bodies,) of the bodies with another value.
    """

    name: str
    kind: str
    start: np.ndarray
    change: Callable[[np.ndarray], np.ndarray]

    @property
    def unit(self) -> str:
        """Of the value."""
        return {"mass": "kg", "com": "m", "scale": ""}[self.kind]

    @property
    def size(self) -> float:
        """Of a change of the value that would be large."""
        return FARTHEST if self.kind == "com" else float(self.start[0])

    @property
    def is_reported(self) -> bool:
        """Whether the fit keeps the number: not of bodies, which are fitted."""
        return self.name == ALL or self.name.startswith("payload.")


class _Cost:
    """c as a function of the bodies of the file mu, with a tolerance of these."""

    def __init__(self, normal: Normal, sd: np.ndarray) -> None:
        self.normal = normal
        self.count = len(sd)
        self.information = np.concatenate([sd**-2.0, normal.information])
        matrix = normal.matrix + np.diag(self.information)
        size = np.sqrt(np.diag(matrix))
        scale = 1.0 / np.where(size > 0.0, size, 1.0)
        # friction has no prior, and its columns may depend on each other
        self.inverse = (
            scale[:, None]
            * np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-13, hermitian=True)
            * scale
        )

    def _away(self, mu: np.ndarray) -> np.ndarray:
        return self.information * np.concatenate([self.normal.pi - mu, self.normal.away])

    def value(self, mu: np.ndarray) -> float:
        """The minimum c without a constant."""
        pull = self._away(mu)
        left = self.normal.slope - pull
        whole = np.concatenate([self.normal.pi - mu, self.normal.away])
        return float(whole @ pull - left @ self.inverse @ left)

    def slope(self, mu: np.ndarray) -> np.ndarray:
        """Half of the derivatives of c in mu."""
        pull = self._away(mu)
        rest = pull + self.information * (self.inverse @ (self.normal.slope - pull))
        return -rest[: self.count]

    def curvature(self) -> np.ndarray:
        """Half of the second derivatives of c in mu."""
        P = self.information[: self.count]
        return np.diag(P) - P[:, None] * self.inverse[: self.count, : self.count] * P


def check_payload(robot: RobotModel, file: np.ndarray, normal: Normal) -> PayloadTest:
    """Test the payload of a robot.

    Parameters
    ----------
    robot : RobotModel
    file : array (10 bodies,)
        Numbers of its bodies with the payload in the last one.
    normal : Normal
    """
    if robot.payload.mass <= 0.0:
        return PayloadTest()
    size = scales(file - payload_in(robot))
    cost = _Cost(normal, CAD * size)
    before = cost.value(file)
    wide = _Cost(normal, WIDE * size)
    excess = before - wide.value(file)
    found = []
    limits = []
    for one in _numbers(robot, file):
        value, sd = _fit(cost, file, one)
        gain = before - cost.value(file + one.change(value))
        found.append((gain, one, value))
        limit = SURE * float(sd.max())
        if one.is_reported and limit > STATED[one.kind] * one.size:
            most = float("inf") if limit > LONG * one.size else limit
            limits.append(Limit(one.name, most, one.unit))
    best = max(gain for gain, _, _ in found)
    faults = []
    for gain, one, value in sorted(found, key=lambda row: -row[0]):
        tail = chi2.sf(max(gain, 0.0) / INFLATED, len(value)) / 2
        z = float(norm.isf(max(tail, LEAST_TAIL)))
        share = min(gain / max(excess, 1e-300), 1.0)
        is_best = one.is_reported and gain > best - AS_GOOD
        if is_best and z > SURE and share > SHARE and _is_plausible(one, value):
            start = tuple(one.start.tolist())
            new = tuple(value.tolist())
            left = "tolerances of CAD leave"
            faults.append(Explanation(one.name, start, new, one.unit, z, share, left))
    named = [fault.name for fault in faults]
    return PayloadTest(tuple(faults), tuple(one for one in limits if one.name not in named))


def _is_plausible(one: _Number, value: np.ndarray) -> bool:
    if one.kind != "com":
        return bool(0.0 <= value[0] < 10.0 * one.start[0])
    return bool(np.linalg.norm(value - one.start) < FARTHEST)


def _numbers(robot: RobotModel, file: np.ndarray) -> Iterator[_Number]:
    """Masses and centers of mass of the payload and the bodies, and all torques."""
    last = len(robot.elements) - 1
    bodies = [(e.name, k, e.body) for k, e in enumerate(robot.elements)]
    yield _Number(ALL, "scale", np.ones(1), lambda value: file * (value[0] - 1.0))
    for name, k, body in [("payload", last, robot.payload), *bodies]:
        if body.mass <= 0.0:
            continue
        mass = np.array([body.mass])
        center = np.array(body.com, float)
        yield _Number(f"{name}.mass", "mass", mass, _change_of(len(file), k, body, _with_mass))
        yield _Number(f"{name}.com", "com", center, _change_of(len(file), k, body, _with_center))


def _with_mass(body: Body, value: np.ndarray) -> np.ndarray:
    """The ten numbers with another mass, whose inertia is as the mass."""
    return numbers_of(body) * (value[0] / body.mass)


def _with_center(body: Body, value: np.ndarray) -> np.ndarray:
    return numbers_of(replace(body, com=tuple(value.tolist())))


def _change_of(
    count: int, k: int, body: Body, numbers: Callable[[Body, np.ndarray], np.ndarray]
) -> Callable[[np.ndarray], np.ndarray]:
    """The change of the bodies of the file with other numbers of body k."""

    def change(value: np.ndarray) -> np.ndarray:
        out = np.zeros(count)
        out[10 * k : 10 * k + 10] = numbers(body, value) - numbers_of(body)
        return out

    return change


def _fit(cost: _Cost, file: np.ndarray, one: _Number) -> tuple[np.ndarray, np.ndarray]:
    """The numbers that minimize c, with a wide prior, by Gauss-Newton steps, and their standard
    deviations.
    """
    weak = one.size**-2.0
    value = one.start.copy()
    M = cost.curvature()
    step = STEP * one.size
    for _ in range(STEPS):
        columns = []
        for axis in np.eye(len(value)):
            ends = [file + one.change(value + sign * step * axis) for sign in (1.0, -1.0)]
            columns.append((ends[0] - ends[1]) / (2 * step))
        J = np.transpose(columns)
        H = J.T @ M @ J
        H = H + weak * np.eye(len(value))
        slope = J.T @ cost.slope(file + one.change(value)) + weak * (value - one.start)
        change = np.linalg.solve(H, -slope)
        value = value + change
        if np.abs(change).max() < STEP * step:
            break
    return value, np.sqrt(np.diag(np.linalg.inv(H)))
