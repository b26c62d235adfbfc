"""Clock and frame of a tracker, found from a record of a known path.

    p_path(t) ~ R p(t + d) + c,         R a rotation, d the offset of the clock

The first estimate of d is where the speeds of record and path correlate most: speeds do not depend
on the frame. For each d the best R and c are those of Procrustes' problem, in closed form by a
singular value decomposition; the d with the smallest sum of squares is found by bounded search.

The errors of a robot are not noise: softer springs, and motors that friction holds back, move the
tool as a later clock does in part. Where the frame is known, `Alignment.refine` therefore fits
the clock together with the errors that the model expects,

    r = v d + G s + c + noise,  v: speed of the path, s: errors of unit size, sd 1, c constant

with a noise that is that of what is left,
and takes only ``v d`` off. A frame that is estimated is that of Procrustes: six more unknowns and
such errors were not told apart on simulated robots.

What is estimated cannot be seen, and not be learned: a constant offset of the tool, a tilt of the
whole path, a delay of the whole motion. `hidden` is the part of a given error along these
directions.

Source: S. Umeyama, IEEE Trans. Pattern Analysis and Machine Intelligence 13(4), 1991 (rigid
transforms and scale); W. Kabsch, Acta Crystallographica A32, 1976.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import correlate
from scipy.spatial.transform import Rotation

from flexgen.base.errors import ArgumentError

# Second singular value of a path over the first: a path with less is a line, about which the
# rotation of a frame in space is not determined.
STRAIGHT = 0.02
# Correlation of the speeds of record and path, at least: with less the record is of another move.
ALIKE = 0.7
# Largest relative difference of the sizes of record and path.
SIZE = 0.05
# Largest distance of a record from its path, over the size of the path.
FAR = 0.2
# Part of the error of the fit that a reflected record has in a frame of the other hand.
MIRRORED = 0.3
# Relative error of a fit from which on the hand of the frame is judged: a flat path shows none.
FLAT = 1e-2
# Width of the search for the clock around the first estimate [s].
SEARCH_S = 0.05
# Units that are confused, by the factor between record and path.
FACTORS = {1e3: "mm given as m", 1e-3: "m given as mm", 10.0: "mm given as cm", 0.1: "cm as mm"}
FACTORS |= {100.0: "cm given as m", 0.01: "m given as cm", 25.4: "inches", 1 / 25.4: "inches"}
# Part of an error in addition to the expected ones, and the least noise of a tracker [m].
UNEXPLAINED = 0.2
SMALLEST_NOISE = 2e-6
ALIKE_NEARBY = 1.5  # noise in the fit over what it leaves, which is not independent
PLACED = 2e-4  # m: standard deviation of a constant error
WEIGHED = 6  # fits, each with the noise that the one before left
NEAR = 0.05  # relative difference from such a factor

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Clock and frame of a record.

    ``clock_s``: reading of the record's clock where the path begins [s]; ``frame`` (6,): pose of
    the tracker in the frame of the path, position [m] and rotation vector [rad];
    ``clock_fitted``, ``frame_fitted``: estimated from the record; ``clock_sd_s``: standard
    deviation of the clock [s], where it was fitted together with expected errors.
    """

    clock_s: float
    frame: np.ndarray
    clock_fitted: bool
    frame_fitted: bool
    clock_sd_s: float | None = None

    def positions(self, measured: np.ndarray) -> np.ndarray:
        """Measured positions (n, d) in the frame of the path."""
        R, c = _transform(self.frame, measured.shape[1])
        return np.asarray(measured @ R.T + c)

    def refine(
        self, residual: np.ndarray, time: np.ndarray, path: Curve, expected: np.ndarray
    ) -> Alignment:
        """The alignment whose clock is fitted together with expected errors; itself where the
        clock is known or the frame is not.

        Parameters
        ----------
        residual : array (n, d) [m]
            Positions in the frame of the path, less the path.
        time : array (n,) [s]
            On the path.
        path : callable
        expected : array (m, n, d) [m]
            Errors that the model expects, each of the size of one standard deviation.
        """
        if self.frame_fitted or not self.clock_fitted:
            return self
        G = expected.reshape(len(expected), -1).T
        d = residual.shape[1]
        still = np.kron(np.ones((len(residual), 1)), PLACED * np.eye(d))
        speed = np.gradient(path(time), time, axis=0).ravel()
        A = np.column_stack([speed, G, still])
        sides = residual.ravel()
        prior = np.eye(A.shape[1])[1:]
        noise = max(UNEXPLAINED * float(np.sqrt((sides**2).mean())), SMALLEST_NOISE)
        for _ in range(WEIGHED):
            rows = np.vstack([A / noise, prior])
            x = np.linalg.lstsq(rows, np.concatenate([sides / noise, np.zeros(len(prior))]))[0]
            left = float(np.sqrt(((sides - A @ x) ** 2).mean()))
            noise = max(ALIKE_NEARBY * left, SMALLEST_NOISE)
        sd = float(np.sqrt(np.linalg.inv(rows.T @ rows)[0, 0]))
        return Alignment(self.clock_s - float(x[0]), self.frame, True, False, sd)

    def hidden(self, error: np.ndarray, time: np.ndarray, path: Curve) -> np.ndarray:
        """The part (n, d) of an error (n, d) [m] along what small errors of clock and frame do, as
        far as these are estimated.
        """
        p = path(time)
        n, d = p.shape
        found = []
        if self.clock_fitted:
            found.append(np.gradient(p, time, axis=0))
        if self.frame_fitted:
            found += [np.broadcast_to(e, (n, d)) for e in np.eye(d)]
            middle = p - p.mean(axis=0)
            for i, j in ((1, 0), (2, 0), (2, 1))[: 2 * d - 3]:
                turned = np.zeros((n, d))
                turned[:, i] = middle[:, j]
                turned[:, j] = -middle[:, i]
                found.append(turned)
        if not found:
            return np.zeros((n, d))
        A = np.stack([x.ravel() for x in found], axis=1)
        A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        weights = np.linalg.lstsq(A, error.ravel(), rcond=1e-9)[0]
        return np.asarray((A @ weights).reshape(n, d))


def align(
    source: str,
    time: np.ndarray,
    measured: np.ndarray,
    path: Curve,
    duration: float,
    *,
    clock_s: float | None = None,
    frame: np.ndarray | None = None,
) -> Alignment:
    """Clock and frame of a record of a path.

    Parameters
    ----------
    source : str
        Name of the record, for errors.
    time : array (n,) [s]
        At equal steps, by the clock of the record.
    measured : array (n, d) [m]
        Positions in the frame of the tracker; d is 2 or 3.
    path : callable
        Positions (k, d) [m] of the path at instants (k,) [s], zero where it begins.
    duration : float [s]
        Of the path.
    clock_s : float, optional [s]
        Reading of the clock where the path begins; default: estimated.
    frame : array (6,), optional
        Pose of the tracker: position [m], rotation vector [rad]; default: estimated.

    Raises
    ------
    ArgumentError
        The record is not one of this path, does not cover it, or has another unit or a frame of
        the other hand; the path is a line, and a frame in space cannot be estimated from it.
    """
    inside = path(np.linspace(0.0, duration, 201))
    if frame is None:
        _check_shape(source, inside)
    guess = _first_clock(source, time, measured, path, duration)
    if clock_s is not None and abs(clock_s - guess) > max(SEARCH_S, 2 * (time[1] - time[0])):
        raise ArgumentError(
            f"{source}: given the clock {clock_s:.6g} s at the begin of the path, but the motion "
            f"of the record begins at about {guess:.6g} s, expected the reading of its clock "
            "there; leave the clock out, and it is estimated"
        )

    near = (time >= guess - SEARCH_S) & (time <= guess + duration + SEARCH_S)

    def fit(clock: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Rotation, translation and sum of squares [m^2] with this offset of the clock."""
        target = path(time[near] - clock)
        if frame is not None:
            R, c = _transform(frame, measured.shape[1])
        else:
            R, c = procrustes(measured[near], target)
        left = measured[near] @ R.T + c - target
        return R, c, float((left**2).mean())

    clock = guess if clock_s is None else clock_s
    if clock_s is None:
        found = minimize_scalar(
            lambda x: fit(float(x))[2],
            bounds=(guess - SEARCH_S, guess + SEARCH_S),
            method="bounded",
            options={"xatol": 1e-7},
        )
        clock = float(found.x)
    _check_span(source, time, clock, duration)
    used = (time >= clock) & (time <= clock + duration)
    _check_size(source, measured[used], path(time - clock)[used], frame is None)
    R, c, _ = fit(clock)
    size = float(np.ptp(inside, axis=0).max())
    worst = np.linalg.norm(measured[used] @ R.T + c - path(time - clock)[used], axis=1).max()
    if worst > FAR * size:
        raise ArgumentError(
            f"{source}: given a record that is up to {worst:.3g} m away from the path, which is "
            f"{size:.3g} m large, expected one of this move, in the stated frame: "
            + (
                "another move, or another point than the tool"
                if frame is None
                else "check the frame of the tracker, or leave it out, and it is estimated"
            )
        )
    pose = np.array(frame) if frame is not None else pose_of(R, c)
    return Alignment(clock, pose, clock_s is None, frame is None)


def procrustes(measured: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation R (d, d) and translation c (d,) with the least sum of ``|R p + c - y|^2`` over the
    points ``p`` (n, d) and ``y`` (n, d).
    """
    p_mean = measured.mean(axis=0)
    y_mean = target.mean(axis=0)
    U, _, Vt = np.linalg.svd((target - y_mean).T @ (measured - p_mean))
    signs = np.ones(len(U))
    signs[-1] = np.sign(np.linalg.det(U @ Vt))
    R = U * signs @ Vt
    return R, y_mean - R @ p_mean


def _transform(frame: np.ndarray, d: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (d, d) and translation (d,) [m] of a pose (6,), position and rotation vector."""
    R = Rotation.from_rotvec(frame[3:]).as_matrix()
    return R[:d, :d], np.asarray(frame[:d])


def pose_of(R: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Pose (6,) of a rotation (d, d) and a translation (d,) [m]; d is 2 or 3."""
    d = len(c)
    full = np.eye(3)
    full[:d, :d] = R
    return np.concatenate([c, np.zeros(3 - d), Rotation.from_matrix(full).as_rotvec()])


def _check_shape(source: str, inside: np.ndarray) -> None:
    """ArgumentError where the frame is not determined by a path (k, d) [m]."""
    sizes = np.linalg.svd(inside - inside.mean(axis=0), compute_uv=False)
    if inside.shape[1] == 3 and sizes[1] < STRAIGHT * sizes[0]:
        raise ArgumentError(
            f"{source}: the path is a line, about which the rotation of the tracker cannot be "
            "estimated from its record: state its frame, six numbers, position and rotation "
            "vector in the base of the robot, six zeros where it measures in the base; the record "
            "of a curved path gives it"
        )


def _first_clock(
    source: str, time: np.ndarray, measured: np.ndarray, path: Curve, duration: float
) -> float:
    """Reading of the clock [s] where the speeds of record and path correlate most."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    count = max(int(np.ceil(duration / step)), 2)
    near = step * np.arange(count + 1)
    width = max(1, round(0.02 / step))
    box = np.ones(width) / width

    def speeds(p: np.ndarray) -> np.ndarray:
        """Smoothed speeds (n - 1,) of positions (n, d)."""
        smooth = np.stack([np.convolve(x - x[0], box, mode="same") for x in p.T], axis=1)
        smooth = smooth + p[0]
        edge = width // 2 + 1
        found = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
        found[:edge] = found[-edge:] = 0.0
        return found

    v_path = np.linalg.norm(np.diff(path(near), axis=0), axis=1)
    v = speeds(measured)
    full = correlate(v, v_path, mode="full")
    squares = np.concatenate([[0.0], np.cumsum(v**2)])
    shifts = np.arange(-len(v_path) + 1, len(v))
    begin = np.clip(shifts, 0, len(v))
    end = np.clip(shifts + len(v_path), 0, len(v))
    # The part of the record that overlaps the path, but for what little noise it has at rest.
    energy = np.maximum(squares[end] - squares[begin], 0.5 * squares[-1])
    score = full / np.sqrt(np.maximum(energy * (v_path**2).sum(), 1e-30))
    best = int(np.argmax(score))
    if score[best] < ALIKE:
        raise ArgumentError(
            f"{source}: given a record whose speed correlates by {score[best]:.2f} with that of "
            f"the path, expected at least {ALIKE}: it is of another move, or does not cover it"
        )
    return float(time[0] + step * shifts[best])


def _check_span(source: str, time: np.ndarray, clock: float, duration: float) -> None:
    """ArgumentError where the record does not cover the path."""
    slack = 2.0 * float(time[1] - time[0])
    if time[0] > clock + slack or time[-1] < clock + duration - slack:
        raise ArgumentError(
            f"{source}: given a record from {time[0] - clock:.4g} to {time[-1] - clock:.4g} s of "
            f"the path, which begins at {clock:.6g} s of its clock, expected one of all of it, 0 "
            f"to {duration:.4g} s: start the record before the robot moves"
        )


def _check_size(source: str, p: np.ndarray, y: np.ndarray, is_fitted: bool) -> None:
    """ArgumentError where a record ``p`` (n, d) has another size than the path ``y`` (n, d) [m],
    or, with a frame that is fitted, another hand.
    """
    p = p - p.mean(axis=0)
    y = y - y.mean(axis=0)
    U, s, Vt = np.linalg.svd(y.T @ p)
    hand = np.sign(np.linalg.det(U @ Vt))
    if not (p**2).sum() > 0.0:
        raise ArgumentError(
            f"{source}: given a record of a tracker at rest, expected one that moves"
        )
    factor = float(np.sqrt((p**2).sum() / (y**2).sum()))
    if abs(factor - 1.0) > SIZE:
        known = [text for x, text in FACTORS.items() if abs(factor / x - 1.0) < NEAR]
        cause = known[0] if known else "another move, or a wrong unit in the name of a column"
        raise ArgumentError(
            f"{source}: given a record {factor:.4g} times as large as the path, expected the same "
            f"size: {cause}"
        )
    size = float((y**2).sum())
    mirrored = size + float((p**2).sum()) - 2.0 * float(s.sum())
    proper = size + float((p**2).sum()) - 2.0 * float(s[:-1].sum() + hand * s[-1])
    if is_fitted and mirrored < MIRRORED * proper and proper > FLAT**2 * size:
        raise ArgumentError(
            f"{source}: given positions that fit the path only after a reflection, expected axes "
            "of a right-handed frame: two axes are swapped, or one has the other sign"
        )
