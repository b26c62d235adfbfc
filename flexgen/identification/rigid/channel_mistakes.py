"""Mistakes in the channels of recorded motions: exchanged motors, signs, sides, degrees.

Their effect is far from linear, so that each is undone in turn, and the torques are explained anew
by bodies near those of the file and any friction:

    min  sum_j |tau_j - Y_j pi - F_j phi_j|^2 / s_j^2 / k + |(pi - pi_0) / sd|^2

s_j: deviation of the torque of motor j; k: samples for one that is independent. A mistake is named
where it leaves a small part of the errors of the record as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from flexgen.base.numerics.polynomial_filter import WINDOW
from flexgen.identification.rigid.rigid_mistakes import Mistake
from flexgen.identification.rigid.rigid_regressor import Motion, Regressor

Record = tuple[np.ndarray, np.ndarray]  # motor angles with two derivatives (3, n, n_m), torques

SAMPLES = 1500  # of all motions
CORRELATED = 10.0  # samples for one that is independent
NAMED = 0.25  # errors that are left, over those of the record as it is
EXPLAINED = 0.1  # unexplained variance of torques, at most, where a mistake is named
STILL = 1e-12  # step of an angle over its range, at most, where it is stuck
LEAST = 0.05  # part of a motion in which it is, at least
WIDTH = 0.01  # of the largest speed: width of the step of Coulomb friction
LATEST = 0.6  # s: lag of the torques
DEGREES = np.pi / 180


class ChannelMistake(Mistake):
    """A mistake without a size."""

    @property
    def sentence(self) -> str:
        """The mistake in words."""
        return f"{self.what}: without this {100 * self.share:.0f} % of the torques are explained."


def find_channel_mistake(
    regressor: Regressor, motions: Sequence[Motion], pi: np.ndarray, sd: np.ndarray
) -> ChannelMistake | None:
    """The mistake without which bodies near the file explain the torques; None: there is none.

    Parameters
    ----------
    regressor : Regressor
    motions : sequence of Motion
    pi, sd : arrays (10 bodies,)
        Numbers of the bodies of the file, and their deviations.
    """
    eta = regressor.model.eta
    every = max(1, sum(len(motion.t) for motion in motions) // SAMPLES)
    states = [np.array(motion.derivatives)[:, ::every] @ eta.T for motion in motions]
    record = (
        np.concatenate(states, axis=1),
        np.vstack([motion.torques[::every] for motion in motions]),
    )
    before = _find_unexplained(regressor, record, pi, sd)
    best: tuple[float, str] = (np.inf, "")
    candidates = (
        *_stuck_angles(regressor, motions, every),
        *_mistakes(regressor, record),
        *_late_torques(regressor, motions, every, (pi, sd)),
    )
    for words, wrong in candidates:
        best = min(best, (_find_unexplained(regressor, wrong, pi, sd), words))
    least, words = best
    if least > min(NAMED * before, EXPLAINED):
        return None
    return ChannelMistake(words, 1.0, 1.0 - least)


def _stuck_angles(
    regressor: Regressor, motions: Sequence[Motion], every: int
) -> Iterator[tuple[str, Record]]:
    """Angles that keep their last value in a part of a motion, and the motions without it."""
    eta = regressor.model.eta
    for k, motor in enumerate(regressor.model.motors):
        states = []
        torques = []
        began = []
        for motion in motions:
            q_m = motion.q @ eta[k]
            still = np.abs(np.diff(q_m, prepend=q_m[0] - 1.0)) <= STILL * max(np.ptp(q_m), 1e-12)
            first, last = find_longest_run(still)
            if last - first < LEAST * len(q_m) or np.ptp(q_m) == 0.0:
                first = last = 0
            else:
                began.append(float(motion.t[first]))
            kept = np.ones(len(q_m), bool)
            # the filter of the derivatives sees the jump of the speed
            kept[max(0, first - WINDOW) : last + WINDOW * (last > first)] = False
            rows = np.flatnonzero(kept)[::every]
            states.append(np.array(motion.derivatives)[:, rows] @ eta.T)
            torques.append(motion.torques[rows])
        if began:
            words = f"the angles of {motor.name} are stuck from t = {began[0]:.4g} s on"
            yield words, (np.concatenate(states, axis=1), np.vstack(torques))


def _late_torques(
    regressor: Regressor,
    motions: Sequence[Motion],
    every: int,
    bodies: tuple[np.ndarray, np.ndarray],
) -> Iterator[tuple[str, Record]]:
    """The lag of the torques that leaves least, and the motions without it."""
    eta = regressor.model.eta

    def shift(lag: float) -> Record:
        states = []
        torques = []
        for motion in motions:
            k = round(lag / motion.step)
            rows = slice(max(0, -k), len(motion.t) - max(0, k), every)
            late = slice(max(0, k), len(motion.t) - max(0, -k), every)
            states.append(np.array(motion.derivatives)[:, rows] @ eta.T)
            torques.append(motion.torques[late])
        return np.concatenate(states, axis=1), np.vstack(torques)

    def left(lag: float) -> float:
        return _find_unexplained(regressor, shift(lag), *bodies)

    most = min(LATEST, 0.25 * min(motion.t[-1] - motion.t[0] for motion in motions))
    best = 0.0
    for step in (LATEST / 30, LATEST / 300):
        near = best + step * np.arange(-30, 31)
        best = min((x for x in near.tolist() if abs(x) <= most), key=left, default=0.0)
    if best:
        when = "late" if best > 0 else "early"
        yield f"all torques are {abs(best):.3g} s {when}", shift(best)


def find_longest_run(given: np.ndarray) -> tuple[int, int]:
    """First and past-the-end index of the longest run of True in an array (n,)."""
    edges = np.diff(np.concatenate([[0], given.astype(int), [0]]))
    first = np.flatnonzero(edges == 1)
    last = np.flatnonzero(edges == -1)
    if not len(first):
        return 0, 0
    k = int(np.argmax(last - first))
    return int(first[k]), int(last[k])


def _mistakes(regressor: Regressor, record: Record) -> Iterator[tuple[str, Record]]:
    """Single mistakes in words, and the record without each of them."""
    motors = [motor.name for motor in regressor.model.motors]
    ratios = np.abs(regressor.model.eta).max(axis=1)
    angles, torques = record
    yield "all torques have the wrong sign", (angles, -torques)
    yield "all torques are on the arm side", (angles, torques / ratios)
    yield "the angles are in degrees, read as radians", (angles * DEGREES, torques)
    yield "the angles are in radians, read as degrees", (angles / DEGREES, torques)
    for j, motor in enumerate(motors):
        turn = np.where(np.arange(len(motors)) == j, -1.0, 1.0)
        side = np.where(np.arange(len(motors)) == j, ratios, 1.0)
        yield f"the sign of the torques of {motor} is wrong", (angles, torques * turn)
        yield f"the sign of the angles of {motor} is wrong", (angles * turn, torques)
        yield (
            f"both signs of {motor}, of angles and torques, are wrong",
            (
                angles * turn,
                torques * turn,
            ),
        )
        yield f"the torques of {motor} are on the arm side", (angles, torques / side)
        yield f"the angles of {motor} are on the arm side", (angles * side, torques)
    for i, j in combinations(range(len(motors)), 2):
        order = list(range(len(motors)))
        order[i] = j
        order[j] = i
        both = f"{motors[i]} and {motors[j]}"
        yield f"the torques of {both} are exchanged", (angles, torques[:, order])
        yield f"the angles of {both} are exchanged", (angles[:, :, order], torques)
        yield f"{both} are exchanged", (angles[:, :, order], torques[:, order])


def _find_unexplained(
    regressor: Regressor, record: Record, pi: np.ndarray, sd: np.ndarray
) -> float:
    """Unexplained part of the variance of the torques, the mean over the motors that move."""
    model = regressor.model
    angles, torques = record
    inverse = np.linalg.inv(model.eta)
    Y = np.einsum("ji,nik->njk", inverse.T, regressor(*(angles @ inverse.T)))
    inertia = np.array([motor.inertia for motor in model.motors])
    target = torques - Y @ pi - inertia * angles[2]
    size = torques.std(axis=0)
    moves = np.flatnonzero((np.ptp(angles[0], axis=0) > 0.0) & (size > 0.0))
    speeds = angles[1]
    steps = np.tanh(speeds / np.maximum(WIDTH * np.abs(speeds).max(axis=0), 1e-12))
    rows = []
    rights = []
    for j in moves.tolist():
        # friction is fitted with any size: the part that it cannot explain
        F = np.column_stack([speeds[:, j], steps[:, j], np.ones(len(speeds))])
        Q = np.linalg.qr(F / np.linalg.norm(F, axis=0))[0]
        weight = 1.0 / (size[j] * np.sqrt(CORRELATED))
        own = Y[:, j] * sd
        rows.append(weight * (own - Q @ (Q.T @ own)))
        rights.append(weight * (target[:, j] - Q @ (Q.T @ target[:, j])))
    if not rows:
        return 0.0
    whole = np.vstack([*rows, np.eye(len(sd))])
    change = np.linalg.lstsq(whole, np.append(np.concatenate(rights), 0.0 * sd), rcond=None)[0]
    left = [
        CORRELATED * float(np.mean((right - row @ change) ** 2))
        for row, right in zip(rows, rights, strict=True)
    ]
    return float(np.mean(np.minimum(left, 1.0)))
