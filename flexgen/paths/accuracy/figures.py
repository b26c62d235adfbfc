"""Accuracy and repeatability of a path and its end, in the sense of ISO 9283.

The standard measures n cycles of one robot; here the cycles are robots under the same command.
With d_jk, the offset of robot j where it passes the plane normal to the path at its point k, and
|.| over the axes of the output:

    AT = max_k |mean_j d_jk|,    RT = max_k (mean_j l_jk + 3 s_k),
    l_jk = |d_jk - mean_j d_jk|, s_k its deviation
    AP = |mean_j e_j|,           RP = mean_j l_j + 3 s
    of the last positions, e_j from the end of the path
    AV = mean_j v_j/v_c - 1,     RV = 3 s_v/v_c,     FV = max_j (max (v - v_c) - min (v - v_c))
    of the speeds

Orientations: with the rotation vector a_jk from the command at point k to robot j there, world
axes, whose components are the angles a, b, c about x, y, z, and S_k the deviation of each

    AT_abc = max_k |mean_j a_jk|,   RT_abc = max_k 3 S_k,       AP_abc = mean_j a_j,   RP_abc = 3 S
    at the end

Source: ISO 9283:1998, Manipulating industrial robots - Performance criteria and related test
methods: AP in 7.2.1, RP, with deviations over n - 1, in 7.2.2, stabilization in 7.4, overshoot in
7.5, figures of the path in section 8. Those of section 7 were compared with texts that cite it
(GB/T 12642-2013, GOST R 60.3.3.1-2016), those of section 8 were not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import Scales, choose_scales, figure_rows
from flexgen.base.errors import ArgumentError
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Table
from flexgen.base.spec.arguments import is_number

BAND = 1e-4  # m or rad
# of the largest commanded speed
MOVING = 0.05
CRUISING = 0.95
TURN = np.pi / 3  # rad, of the path within which a robot passes a plane
ITERATIONS = 8
Angles = tuple[float, float, float]  # about the world axes x, y, z [rad]


@checked_result
@dataclass(frozen=True, repr=False)
class PathAccuracy(Result):
    """Figures of robots that follow one path, as data sheets state them.

    A figure is None where it is not defined: repeatabilities of one robot, figures of the path
    where the reference does not move, offsets from the path of an output with one axis, which no
    plane crosses, and a settling time where a robot leaves the band in the later half of the time
    after the path.

    Attributes
    ----------
    robots : tuple of str
    unit : str
        ``"m"``, or ``"rad"`` where the output has no lengths.
    band : float [unit]
        Half width of the band of the settling times.
    path_accuracy, path_repeatability : float or None [unit]
        AT and RT, where the command moves with at least 5 % of its largest speed.
    pose_accuracy, pose_repeatability : float or None [unit]
        AP and RP at the end of the simulation.
    speed_accuracy, speed_repeatability : float or None
        AV and RV, relative, where the command has at least 95 % of its largest speed.
    speed_fluctuation : float or None [unit/s]
        FV, there.
    path_errors : tuple of (float or None) [unit]
        Largest offset of each robot from the path, whatever the time.
    settling_s : tuple of (float or None) [s]
        From the end of the path until each robot stays within the band about its last position.
    overshoots : tuple of float [unit]
        Largest distance of each robot from its last position after the path, once it has entered
        the band; zero where it stays there.
    stabilizations_s : tuple of (float or None) [s]
        From the first instant in the band after the path until each robot stays within it; None
        without settling time.
    drifts : tuple of (float or None) [unit]
        Largest distance of each robot from its last position in the later half of the time after
        the path.
    corner_round_off, corner_round_off_commanded, corner_overshoot : float or None [m]
        Where straight lines of the tool meet, the largest of all corners and robots: CR, the
        distance at which the robots pass the programmed corner; that of the command, which rounds
        it; CO, how far a robot gets beyond the second line.
    orientation_path_accuracy, orientation_path_repeatability : tuple (3) of float, or None [rad]
        AT and RT of the angles about the world axes x, y, z, where the output is a pose.
    orientation_accuracy, orientation_repeatability : tuple (3) of float, or None [rad]
        AP, with its signs, and RP of these angles at the end of the simulation.

    Examples
    --------
    >>> run = flexgen.control(
    ...     "elbow", plants={"soft": {"stiffness": 0.8}, "stiff": {"stiffness": 1.25}}
    ... )
    >>> found = run.accuracy()
    >>> (
    ...     f"AT {1e6 * found.path_accuracy:.0f} um, AP {1e6 * found.pose_accuracy:.0f} um",
    ...     found.settling_s[0] < 0.1,
    ... )
    ('AT 14 um, AP 10 um', True)
    """

    robots: tuple[str, ...]
    unit: str
    band: float
    path_accuracy: float | None
    path_repeatability: float | None
    pose_accuracy: float | None
    pose_repeatability: float | None
    speed_accuracy: float | None
    speed_repeatability: float | None
    speed_fluctuation: float | None
    path_errors: tuple[float | None, ...]
    settling_s: tuple[float | None, ...]
    overshoots: tuple[float, ...]
    stabilizations_s: tuple[float | None, ...]
    drifts: tuple[float | None, ...]
    orientation_path_accuracy: Angles | None = None
    orientation_path_repeatability: Angles | None = None
    orientation_accuracy: Angles | None = None
    orientation_repeatability: Angles | None = None
    corner_round_off: float | None = None
    corner_round_off_commanded: float | None = None
    corner_overshoot: float | None = None

    def __repr__(self) -> str:
        shown = "; ".join(f"{label} {text}" for label, text in self.rows()[:2])
        return f"<PathAccuracy of {len(self.robots)} robots: {shown or 'one robot at rest'}>"

    def content(self) -> tuple[Part, ...]:
        """The figures of all robots together, and a table of those of each."""
        u = self.unit
        columns = (
            Column("robot", "", "robot"),
            Column("from the path", u, f"path_error_{u}"),
            Column("settled into the band after", "s", "settling_s"),
            Column("overshoot", u, f"overshoot_{u}"),
            Column("stabilization", "s", "stabilization_s"),
            Column("drift", u, f"drift_{u}"),
        )
        return (
            Prose(self._title(), is_title=True),
            *self.figures(),
            *(
                Data(f"{key}_rad", angles and list(angles))
                for _, key, angles in self._orientation()
            ),
            Table(columns, tuple(self._each()), "Robots", "robots"),
        )

    def _title(self) -> str:
        count = len(self.robots)
        return f"ISO 9283, over {count} robots" if count > 1 else "ISO 9283, one robot"

    def figures(self) -> tuple[Row, ...]:
        """The figures of all robots together; those of each robot, and angles: the largest."""
        u = self.unit
        return (
            Row("path accuracy AT", self.path_accuracy, u, f"path_accuracy_{u}"),
            Row("path repeatability RT", self.path_repeatability, u, f"path_repeatability_{u}"),
            Row("pose accuracy AP at the end", self.pose_accuracy, u, f"pose_accuracy_{u}"),
            Row(
                "pose repeatability RP at the end",
                self.pose_repeatability,
                u,
                f"pose_repeatability_{u}",
            ),
            Row("speed accuracy AV", self.speed_accuracy, "relative", "speed_accuracy"),
            Row(
                "speed repeatability RV",
                self.speed_repeatability,
                "relative",
                "speed_repeatability",
            ),
            Row(
                "speed fluctuation FV",
                self.speed_fluctuation,
                f"{u}/s",
                f"speed_fluctuation_{u}_s",
            ),
            Row("half width of the band of settling", self.band, u, f"band_{u}"),
            Row(
                "settling time into this band, longest",
                _largest(self.settling_s),
                "s",
                "settling_s",
            ),
            Row("overshoot after the path, largest", max(self.overshoots), u, f"overshoot_{u}"),
            Row(
                "stabilization time, longest",
                _largest(self.stabilizations_s),
                "s",
                "stabilization_s",
            ),
            Row("drift at rest, largest", _largest(self.drifts), u, f"drift_{u}"),
            Row("corner round-off CR, largest", self.corner_round_off, "m", "corner_round_off_m"),
            Row(
                "corner round-off of the command, largest",
                self.corner_round_off_commanded,
                "m",
                "corner_round_off_commanded_m",
            ),
            Row("corner overshoot CO, largest", self.corner_overshoot, "m", "corner_overshoot_m"),
            *(
                Row(
                    f"{label}, largest",
                    _largest(angles and tuple(map(abs, angles))),
                    "rad",
                    f"{key}_max_rad",
                )
                for label, key, angles in self._orientation()
            ),
        )

    def _orientation(self) -> list[tuple[str, str, Angles | None]]:
        """Labels, keys and values of the figures of the orientation."""
        keys = {
            "path accuracy of angles AT_a, AT_b, AT_c": "orientation_path_accuracy",
            "path repeatability of angles RT_a, RT_b, RT_c": "orientation_path_repeatability",
            "angles AP_a, AP_b, AP_c at the end": "orientation_accuracy",
            "repeatability of angles RP_a, RP_b, RP_c at the end": "orientation_repeatability",
        }
        return [(label, key, getattr(self, key)) for label, key in keys.items()]

    def lengths(self) -> list[tuple[float | None, str]]:
        """All lengths and angles with their units, those of each robot too."""
        of_robots = (*self.path_errors, *self.overshoots, *self.drifts)
        known = [(f.value, f.unit) for f in self.figures() if isinstance(f.value, float)]
        return [*known, *((value, self.unit) for value in of_robots)]

    def _scales(self) -> Scales:
        return choose_scales((), *self.lengths())

    def rows(self) -> list[tuple[str, str]]:
        """Labels and values with units of the figures that are known, for tables."""
        return figure_rows(self.figures(), self._scales())

    @property
    def robot_columns(self) -> tuple[str, ...]:
        """Headings of `robot_rows`."""
        return self.robot_table(self._scales())[0]

    def robot_rows(self) -> list[tuple[str, ...]]:
        """The figures of each robot as texts."""
        return self.robot_table(self._scales())[1]

    def robot_table(self, scales: Scales) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headings and rows of the figures of each robot, in the units of a report."""
        scale = scales[self.unit]
        u = scale.unit
        columns = (
            "robot",
            f"from the path, {u}",
            f"settled into {scale.factor * self.band:.4g} {u} after, s",
            f"overshoot, {u}",
            "stabilization, s",
            f"drift, {u}",
        )

        def size(value: float | None) -> str:
            shown = scale.cell(value)
            return shown if isinstance(shown, str) else f"{shown:.4g}"

        def time(value: float | None, otherwise: str = "-") -> str:
            return otherwise if value is None else f"{value:.4g}"

        rows: list[tuple[str, ...]] = [
            (
                name,
                size(error),
                time(settled, "not settled"),
                size(over),
                time(stable),
                size(drift),
            )
            for name, error, settled, over, stable, drift in self._each()
        ]
        return columns, rows

    def _each(self) -> list[tuple[Any, ...]]:
        """For each robot its name, path errors, settling time [s], overshoots, stabilization time
        [s] and drifts.
        """
        rows = (
            self.path_errors,
            self.settling_s,
            self.overshoots,
            self.stabilizations_s,
            self.drifts,
        )
        return list(zip(self.robots, *rows, strict=True))


def _largest(values: tuple[float | None, ...] | None) -> float | None:
    """The largest; None where one is not known."""
    known = [x for x in values or () if x is not None]
    return max(known) if known and len(known) == len(values or ()) else None


def path_accuracy(
    time: np.ndarray,
    reference: np.ndarray,
    attained: np.ndarray,
    path_end: float,
    *,
    robots: tuple[str, ...],
    unit: str = "m",
    band: float = BAND,
    orientations: tuple[np.ndarray, np.ndarray] | None = None,
) -> PathAccuracy:
    """Accuracy and repeatability of attained positions, and of orientations where they are given.

    Parameters
    ----------
    time : array (n,) [s]
        Of the samples, increasing.
    reference : array (n, k) [unit]
        Commanded positions at these times; at rest from ``path_end`` on.
    attained : array (robots, n, k) [unit]
        Positions of the robots at these times.
    path_end : float [s]
    robots : tuple of str
        Their names.
    unit : str
        ``"m"`` or ``"rad"``.
    band : float [unit]
        Half width of the band of the settling times.
    orientations : tuple of array (n, 3, 3), array (robots, n, 3, 3), optional
        Commanded ones, and those of the robots: matrices from the axes of the tool to those of the
        world.

    Raises
    ------
    ArgumentError
        The band is not a positive number.
    """
    if not (is_number(band) and 0.0 < band < np.inf):
        raise ArgumentError(f"band: given {show_value(band)}, expected a number > 0 [{unit}]")
    commanded = np.gradient(reference, time, axis=0)
    speed = np.linalg.norm(commanded, axis=1)
    moving = (
        speed >= MOVING * speed.max() if speed.max() > 0.0 else np.zeros(len(time), dtype=bool)
    )
    at: float | None = None
    rt: float | None = None
    errors: tuple[float | None, ...] = (None,) * len(robots)
    angles: dict[str, Any] = {}
    passing: list[np.ndarray] = []
    if moving.any():
        passing = [_passing(time, reference, commanded, moving, p) for p in attained]
    if passing and reference.shape[1] > 1:  # of one axis every robot is on the path
        d = np.array(
            [
                _offsets(time, reference, commanded, moving, *each)
                for each in zip(attained, passing, strict=True)
            ]
        )
        at, rt = _accuracy_and_repeatability(d)
        errors = tuple(float(x) for x in np.linalg.norm(d, axis=2).max(axis=1))
    if orientations is not None:
        angles = _orientation_figures(time, *orientations, moving, passing)
    ap, rp = _accuracy_and_repeatability(attained[:, -1:] - reference[-1:])
    each = [_settle(time, p, path_end, band) for p in attained]
    settled, over, stable, drift = zip(*each, strict=True)
    return PathAccuracy(
        robots,
        unit,
        float(band),
        at,
        rt,
        ap,
        rp,
        *_speed_figures(time, speed, attained, moving & (speed >= CRUISING * speed.max())),
        errors,
        settled,
        over,
        stable,
        drift,
        **angles,
    )


def _passing(
    time: np.ndarray,
    reference: np.ndarray,
    commanded: np.ndarray,
    moving: np.ndarray,
    p: np.ndarray,
) -> np.ndarray:
    """Times (points,) [s] at which a robot passes the planes normal to the path at the samples
    that move.

    Found by Newton's method with the commanded speed as slope, before the path has turned by
    `TURN`: a robot that stops short of a corner does not pass the planes there, and is measured
    where it is nearest to them. ``commanded`` (n, k) [m/s]: speeds; ``moving`` (n,): which samples
    move; ``p`` (n, k) [m]: positions of the robot.
    """
    speed = np.linalg.norm(commanded[moving], axis=1)
    tangent = commanded[moving] / speed[:, None]
    t = time[moving].copy()
    turns = np.arccos(np.clip((tangent[1:] * tangent[:-1]).sum(axis=1), -1.0, 1.0))
    # of the last sample that moves; of the first before it
    at = np.clip(np.cumsum(moving) - 1, 0, None)
    turned = np.concatenate([[0.0], np.cumsum(turns)])
    first = np.searchsorted(turned[at], turned - TURN, "left")
    last = np.searchsorted(turned[at], turned + TURN, "right") - 1
    e = p[moving] - reference[moving]
    for _ in range(ITERATIONS):
        t = np.clip(t - (e * tangent).sum(axis=1) / speed, time[first], time[last])
        e = _between(t, time, p) - reference[moving]
    return t


def _offsets(
    time: np.ndarray,
    reference: np.ndarray,
    commanded: np.ndarray,
    moving: np.ndarray,
    p: np.ndarray,
    t: np.ndarray,
) -> np.ndarray:
    """Offsets (points, k) [m] of a robot from the path, normal to it, where it passes the planes
    of `_passing` at the times ``t`` (points,) [s]; the other arguments are those of `_passing`.
    """
    tangent = commanded[moving] / np.linalg.norm(commanded[moving], axis=1)[:, None]
    e = _between(t, time, p) - reference[moving]
    return np.asarray(e - (e * tangent).sum(axis=1)[:, None] * tangent)


def _between(t: np.ndarray, time: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Columns of x (n, k) at the times ``t``, (points, k)."""
    return np.column_stack([np.interp(t, time, column) for column in x.T])


def _orientation_figures(
    time: np.ndarray,
    R_ref: np.ndarray,
    R: np.ndarray,
    moving: np.ndarray,
    passing: list[np.ndarray],
) -> dict[str, Angles | None]:
    """Figures of the angles [rad] about the world axes, on the planes that robots pass, and at the
    end.

    ``R_ref`` (n, 3, 3), ``R`` (robots, n, 3, 3); ``passing``: times of each robot, from
    `_passing`. Repeatabilities are 3 standard deviations, None for a single robot.
    """

    def angles(R: np.ndarray, R_ref: np.ndarray) -> np.ndarray:
        return np.asarray(Rotation.from_matrix(R @ R_ref.transpose(0, 2, 1)).as_rotvec())

    def of(x: np.ndarray) -> Angles:
        return float(x[0]), float(x[1]), float(x[2])

    last = angles(R[:, -1], R_ref[-1:])
    several = len(R) > 1
    found: dict[str, Angles | None] = {"orientation_accuracy": of(last.mean(axis=0))}
    found["orientation_repeatability"] = of(3.0 * last.std(axis=0, ddof=1)) if several else None
    if passing:
        each = zip(passing, R, strict=True)
        on = np.array(
            [
                angles(_between(t, time, x.reshape(-1, 9)).reshape(-1, 3, 3), R_ref[moving])
                for t, x in each
            ]
        )
        found["orientation_path_accuracy"] = of(np.abs(on.mean(axis=0)).max(axis=0))
        if several:
            found["orientation_path_repeatability"] = of(3.0 * on.std(axis=0, ddof=1).max(axis=0))
    return found


def _accuracy_and_repeatability(d: np.ndarray) -> tuple[float, float | None]:
    """The largest of the points: distance of the mean of the robots, and the radius that contains
    them by 3 sigma.
    """
    mean = d.mean(axis=0)
    accuracy = float(np.linalg.norm(mean, axis=1).max())
    if len(d) < 2:
        return accuracy, None
    radius = np.linalg.norm(d - mean, axis=2)
    return accuracy, float((radius.mean(axis=0) + 3.0 * radius.std(axis=0, ddof=1)).max())


def _speed_figures(
    time: np.ndarray, commanded: np.ndarray, attained: np.ndarray, cruise: np.ndarray
) -> tuple[float | None, float | None, float | None]:
    """Relative speed accuracy AV and repeatability RV, and fluctuation FV [m/s], at the samples
    ``cruise`` (n,) where the command has its constant speed; None where there are none.

    ``commanded`` (n,) [m/s]; ``attained`` (robots, n, k) [m]: positions.
    """
    if not cruise.any():
        return None, None, None
    v = np.linalg.norm(np.gradient(attained, time, axis=1), axis=2)[:, cruise]
    v_c = float(commanded[cruise].mean())
    of_each = v.mean(axis=1)
    spread = 3.0 * float(of_each.std(ddof=1)) / v_c if len(v) > 1 else None
    return (
        float(of_each.mean()) / v_c - 1.0,
        spread,
        float(np.ptp(v - commanded[cruise], axis=1).max()),
    )


def _settle(
    time: np.ndarray, p: np.ndarray, path_end: float, band: float
) -> tuple[float | None, float, float | None, float | None]:
    """Settling time [s], overshoot [m], stabilization time [s] and drift [m] of a robot after
    ``path_end`` [s], from its distance to the last position of ``p`` (n, k).

    A robot has settled when it stays within ``band`` [m]; the times are None where it leaves the
    band in the second half of the record, and the drift is the largest distance in that half.
    """
    after = time >= path_end - 1e-9
    t = time[after]
    away = np.linalg.norm(p[after] - p[-1], axis=1)
    if not len(t):
        return None, 0.0, None, None
    inside = away <= band
    last_outside = int(np.flatnonzero(~inside)[-1]) if not inside.all() else -1
    middle = 0.5 * (t[0] + t[-1])
    first = int(np.argmax(inside))
    late = last_outside >= 0 and t[last_outside] > middle
    settled = 0.0 if last_outside < 0 else float(t[last_outside + 1] - path_end)
    stable = None if late else float(t[last_outside + 1] - t[first])
    largest = float(away[first:].max())
    drift = float(away[t >= middle].max())
    return None if late else settled, largest if largest > band else 0.0, stable, drift
