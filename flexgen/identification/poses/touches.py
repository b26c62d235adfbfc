"""Datums of one number in each pose: touches of planes and spheres, readings of dial gauges.

With a tracker at p in the world of the robot, and the number g that was read,

    plane:       r = (p_c - o - s_i p_i - s_j p_j) / sqrt(1 + s_i^2 + s_j^2) - g
    sphere:      r = |p - c| - g
    gauge:       r = u'p - z - g,        tool axes: r = (R u)'(p - c) - g
    coordinate:  r = u'p - g
    level:       r = (R u)'n - z - g

``c``: the axis of the world nearest to the normal of a plane, ``i``, ``j``: the two others; ``u``:
an axis, with its sign; ``R``: axes of the tracker; ``n``: upwards, against gravity. The offset
``o`` and the slopes ``s`` of a plane, centers and places ``c`` and the zero ``z`` of a gauge are
not known, and fitted with the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.tables import closest, show
from flexgen.identification.poses.parameters import AXES, UNKNOWN, Unknown

FORMS = {
    "plane": "plane NAME",
    "sphere": "sphere NAME",
    "gauge": "gauge NAME AXIS",
    "coordinate": "coordinate AXIS",
    "level": "level NAME AXIS",
}
WORLD_AXES = tuple(f"{sign}{axis}" for axis in AXES for sign in ("", "-"))
TOOL_AXES = tuple(f"{sign}tool.{axis}" for axis in AXES for sign in ("", "-"))
# Touches of a surface by kind, from which on one of them tells more than where the surface is.
FEWEST_TOUCHES = {
    "plane": 4,
    "sphere": 4,
    "gauge": 2,
    "tool gauge": 4,
    "coordinate": 1,
    "level": 2,
}
# Kinds that measure along an axis of the tracker.
TURNING = ("tool gauge", "level")
# m: distances of a point from the center of a sphere are divided by no less.
LEAST_DISTANCE = 1e-9
# m: readings of a plane that differ by less do not show the side of its normal.
SAME_READING = 1e-9
ROUNDS = 30  # of the search for the center of a sphere


@dataclass(frozen=True)
class Surface:
    """A surface or gauge: ``kind`` of `FEWEST_TOUCHES`, ``name``, ``axis``.

    ``axis``: of a plane, the axis nearest to its normal; of a gauge, the axis of the world that it
    measures; -1: none. ``sign``: that of the normal, or of the gauge, along the axis.
    """

    kind: str
    name: str
    axis: int = -1
    sign: float = 1.0

    @property
    def title(self) -> str:
        """The beginning of the names of its numbers."""
        if self.kind in ("gauge", "level"):
            return f"{self.kind}.{self.name}.{'-' if self.sign < 0.0 else ''}{AXES[self.axis]}"
        return f"{self.kind.split()[-1]}.{self.name}"

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        """Names and units of its numbers."""
        if self.kind == "coordinate":
            return ()
        if self.kind == "gauge":
            return ((f"{self.title}.zero", "m"),)
        if self.kind == "level":
            return ((f"{self.title}.zero", ""),)
        if self.kind != "plane":
            return tuple((f"{self.title}.{axis}", "m") for axis in AXES)
        slopes = [f"{self.title}.slope_{AXES[k]}" for k in self.others]
        return ((f"{self.title}.{AXES[self.axis]}", "m"), *((slope, "") for slope in slopes))

    @property
    def others(self) -> tuple[int, int]:
        """The axes other than that of the surface."""
        first, second = (k for k in range(3) if k != self.axis)
        return first, second


@dataclass(frozen=True)
class Touches:
    """Contacts of the trackers at N poses.

    ``surfaces``; ``which`` (N, k): index of the surface, -1: none; ``along`` (N, k), ``signs``
    (N, k): index and sign of the axis of a gauge; ``readings`` (N, k) [m], of a level [m/m];
    ``tips``: pairs of a tracker and an axis of its own that a gauge or a level measures; ``up``
    (3,): direction against gravity.
    """

    surfaces: tuple[Surface, ...]
    which: np.ndarray
    along: np.ndarray
    signs: np.ndarray
    readings: np.ndarray
    tips: tuple[tuple[int, int], ...]
    up: tuple[float, ...] = (0.0, 0.0, 1.0)

    @classmethod
    def of(cls, texts: np.ndarray, readings: np.ndarray) -> Touches | None:
        """Those of the texts (N, k) of `StaticPoses.touches`; None: there are none."""
        names = [str(text) for text in np.unique(texts) if text]
        if not names:
            return None
        shape = texts.shape
        which = np.full(shape, -1)
        along = np.full(shape, -1)
        signs = np.ones(shape)
        surfaces: dict[Surface, int] = {}
        for text in names:
            surface, axis, sign = parse_touch(text)
            rows = texts == text
            which[rows] = surfaces.setdefault(surface, len(surfaces))
            along[rows] = axis
            signs[rows] = sign
        tool = np.array([surface.kind in TURNING for surface in surfaces])
        pairs = np.argwhere((which >= 0) & tool[which])
        tips = {(int(k), int(along[row, k])) for row, k in pairs}
        given = np.where(which >= 0, np.nan_to_num(readings), 0.0)
        return cls(tuple(surfaces), which, along, signs, given, tuple(sorted(tips)))

    def among(self, rows: np.ndarray) -> Touches:
        """Copy for some of the poses."""
        return replace(
            self,
            which=self.which[rows],
            along=self.along[rows],
            signs=self.signs[rows],
            readings=self.readings[rows],
        )

    @property
    def touched(self) -> np.ndarray:
        """Whether a tracker touches a surface, (N, k)."""
        return self.which >= 0

    @property
    def levels(self) -> np.ndarray:
        """Whether a tracker reads an inclination, (N, k)."""
        level = np.array([surface.kind == "level" for surface in self.surfaces])
        return self.touched & level[self.which]

    @property
    def has_scale(self) -> bool:
        """Whether the readings state any length."""
        for m, surface in enumerate(self.surfaces):
            of = self.readings[self.which == m]
            if surface.kind == "level":
                continue
            if surface.kind in ("sphere", "coordinate") and of.any():
                return True
            if np.ptp(of) > SAME_READING:
                return True
        return False

    def refuse_few(self) -> None:
        """ArgumentError where a surface has so few touches that they only tell where it is."""
        for m, surface in enumerate(self.surfaces):
            count = int((self.which == m).sum())
            least = FEWEST_TOUCHES[surface.kind]
            if count < least:
                raise ArgumentError(
                    f"poses: given {count} touches of {surface.kind} {surface.name!r}, expected "
                    f"at least {least}: fewer only tell where it is"
                )

    def find_known(self, kept: np.ndarray) -> np.ndarray:
        """Whether the places of the surfaces are known from some of the poses, (N, k)."""
        enough = [
            (self.which[kept] == m).sum() >= FEWEST_TOUCHES[surface.kind]
            for m, surface in enumerate(self.surfaces)
        ]
        return np.where(self.touched, np.array(enough)[self.which], True)

    def unknowns(self) -> list[Unknown]:
        """The numbers of the surfaces."""
        return [
            Unknown(name, unit, "surface", (m, j), 0.0, UNKNOWN.position)
            for m, surface in enumerate(self.surfaces)
            for j, (name, unit) in enumerate(surface.unknowns)
        ]

    def residuals(self, points: np.ndarray, tips: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Differences (N, k) [m] from the readings; zero where nothing is touched.

        Parameters
        ----------
        points : array (N, k, 3) [m]
            Of the trackers in the world.
        tips : array (N, t, 3) [m]
            Ends of the axes `tips` of length 1 m.
        numbers : array (m, 3)
            Of the surfaces.
        """
        return self._terms(points, tips, numbers)[0]

    def slopes(
        self,
        points: np.ndarray,
        tips: np.ndarray,
        numbers: np.ndarray,
        J: np.ndarray,
        J_tips: np.ndarray,
        unknowns: Sequence[Unknown],
    ) -> np.ndarray:
        """Derivatives (N, k, p) of the residuals.

        ``J`` (N, k, 3, p), ``J_tips`` (N, t, 3, p): of the points and the tips.
        """
        _, normals, arms, own = self._terms(points, tips, numbers)
        out = np.einsum("nki,nkip->nkp", normals, J)
        for t, (k, axis) in enumerate(self.tips):
            rows = self._tool_rows(k, axis)
            turned = J_tips[rows, t] - J[rows, k]
            out[rows, k] += np.einsum("ni,nip->np", arms[rows, k], turned)
        for i, unknown in enumerate(unknowns):
            if unknown.kind == "surface":
                m, j = unknown.at
                out[..., i] = np.where(self.which == m, own[..., j], 0.0)
        return out

    def _tool_rows(self, k: int, axis: int) -> np.ndarray:
        """Poses in which a gauge measures along an axis of a tracker."""
        tool = np.array([surface.kind in TURNING for surface in self.surfaces])
        return np.asarray((self.which[:, k] >= 0) & tool[self.which[:, k]]) & (
            self.along[:, k] == axis
        )

    def _terms(
        self, points: np.ndarray, tips: np.ndarray, numbers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (N, k), and their slopes (N, k, 3).

        In the points, in the axes of tools, and in the numbers of the surface.
        """
        residual = np.zeros(self.which.shape)
        normals, arms, own = (np.zeros(points.shape) for _ in range(3))
        for m, surface in enumerate(self.surfaces):
            at = np.nonzero(self.which == m)
            p = points[at]
            if surface.kind == "plane":
                value, normals[at], own[at] = _of_plane(surface, numbers[m], p)
            elif surface.kind == "sphere":
                away = p - numbers[m]
                value = np.linalg.norm(away, axis=1)
                normals[at] = away / np.maximum(value, LEAST_DISTANCE)[:, None]
                own[at] = -normals[at]
            elif surface.kind == "tool gauge":
                away = self.signs[at][:, None] * (p - numbers[m])
                axes = self._axes(points, tips, at)
                value = (axes * away).sum(axis=1)
                arms[at] = away
                normals[at] = self.signs[at][:, None] * axes
                own[at] = -normals[at]
            elif surface.kind == "level":
                arms[at] = self.signs[at][:, None] * np.array(self.up)
                value = (self._axes(points, tips, at) * arms[at]).sum(axis=1) - numbers[m, 0]
                own[(*at, np.zeros(len(p), int))] = -1.0
            else:
                normals[at] = self.signs[at][:, None] * np.eye(3)[self.along[at]]
                value = (normals[at] * p).sum(axis=1) - numbers[m, 0]
                own[(*at, np.zeros(len(p), int))] = -1.0
            residual[at] = value - self.readings[at]
        return residual, normals, arms, own

    def _axes(
        self,
        points: np.ndarray,
        tips: np.ndarray,
        at: tuple[np.ndarray, ...],
    ) -> np.ndarray:
        """Axes (n, 3) of trackers in the world at which gauges measure."""
        index = [self.tips.index((k, axis)) for k, axis in zip(at[1], self.along[at], strict=True)]
        return np.asarray(tips[at[0], index] - points[at])

    def place(self, points: np.ndarray, tips: np.ndarray) -> tuple[Touches, np.ndarray]:
        """Place the surfaces where the points are: with the axes of planes, and numbers (m, 3)."""
        numbers = np.zeros((len(self.surfaces), 3))
        surfaces = list(self.surfaces)
        for m, surface in enumerate(self.surfaces):
            at = np.nonzero(self.which == m)
            p = points[at]
            g = self.readings[at]
            if surface.kind == "plane":
                surfaces[m], numbers[m] = _place_plane(surface, p, g)
            elif surface.kind == "sphere":
                numbers[m] = _place_sphere(p, g)
            elif surface.kind == "tool gauge":
                axes = self.signs[at][:, None] * self._axes(points, tips, at)
                middle = p.mean(axis=0)
                away = (axes * (p - middle)).sum(axis=1) - g
                numbers[m] = middle + np.linalg.lstsq(axes, away, rcond=1e-6)[0]
            elif surface.kind == "level":
                axes = self.signs[at][:, None] * self._axes(points, tips, at)
                numbers[m, 0] = np.mean(axes @ np.array(self.up) - g)
            elif surface.kind == "gauge":
                numbers[m, 0] = np.mean(self.signs[at] * p[:, surface.axis] - g)
        return replace(self, surfaces=tuple(surfaces)), numbers


def parse_touch(text: str) -> tuple[Surface, int, float]:
    """The surface that a text of `StaticPoses.touches` names; index and sign of an axis.

    Raises
    ------
    ArgumentError
        The text is none of `FORMS`.
    """
    kind, *words = text.split()
    if kind not in FORMS:
        raise ArgumentError(f"touch: given {show(text)}, expected {closest(kind, list(FORMS))}")
    if len(words) != len(FORMS[kind].split()) - 1:
        raise ArgumentError(f"touch: given {show(text)}, expected {FORMS[kind]!r}")
    if kind == "plane":
        return Surface(kind, words[0], axis=2), -1, 1.0  # until it is placed
    if kind == "sphere":
        return Surface(kind, words[0]), -1, 1.0
    known = WORLD_AXES + TOOL_AXES if kind == "gauge" else WORLD_AXES
    if words[-1] not in known:
        raise ArgumentError(f"touch: given {show(text)}, expected an axis of {', '.join(known)}")
    axis = AXES.index(words[-1][-1])
    sign = -1.0 if words[-1].startswith("-") else 1.0
    if "tool." in words[-1]:
        return Surface("tool gauge", words[0]), axis, sign
    return Surface(kind, "" if kind == "coordinate" else words[0], axis, sign), axis, sign


def _of_plane(
    surface: Surface, numbers: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (n,), their slopes (n, 3) in the points and in the three numbers of a plane."""
    first, second = surface.others
    offset, *slopes = numbers
    raised = p[:, surface.axis] - offset - slopes[0] * p[:, first] - slopes[1] * p[:, second]
    normal = np.zeros(3)
    normal[[surface.axis, first, second]] = 1.0, -slopes[0], -slopes[1]
    length = float(np.linalg.norm(normal))
    away = surface.sign * raised / length
    own = np.zeros(p.shape)
    own[:, 0] = -surface.sign / length
    for j, (axis, slope) in enumerate(zip((first, second), slopes, strict=True), 1):
        own[:, j] = -surface.sign * p[:, axis] / length - away * slope / length**2
    return away, np.tile(surface.sign * normal / length, (len(p), 1)), own


def _place_plane(surface: Surface, p: np.ndarray, g: np.ndarray) -> tuple[Surface, np.ndarray]:
    """The plane from which points (n, 3) have the distances ``g`` (n,), and its numbers.

    Of the direction of the least scatter, with both signs, and of that in which the distances
    increase, the normal is the one that explains the distances best.
    """
    middle = p.mean(axis=0)
    thin = np.linalg.svd(p - middle, full_matrices=True)[2][2]
    steep = np.linalg.lstsq(p - middle, g - g.mean(), rcond=1e-6)[0]
    steep = steep / max(float(np.linalg.norm(steep)), SAME_READING)
    upward = thin * np.sign(thin[np.argmax(np.abs(thin))])
    tried = [upward, -upward] + [steep] * bool(steep.any())
    errors = [np.abs((p - middle) @ normal - (g - g.mean())).sum() for normal in tried]
    normal = tried[int(np.argmin(errors))]
    axis = int(np.argmax(np.abs(normal)))
    placed = replace(surface, axis=axis, sign=float(np.sign(normal[axis])))
    first, second = placed.others
    height = (normal @ middle - g.mean()) / normal[axis]
    slopes = -normal[[first, second]] / normal[axis]
    return placed, np.array([height, *slopes])


def _place_sphere(p: np.ndarray, g: np.ndarray) -> np.ndarray:
    """The center from which points (n, 3) have the distances ``g`` (n,): the best of three starts.

    Touches of a part of a sphere have a second center on their other side.
    """
    middle = p.mean(axis=0)
    away = p - middle
    normal = np.linalg.svd(away, full_matrices=True)[2][2]
    rows = np.column_stack([2.0 * away, -np.ones(len(p))])
    linear = np.linalg.lstsq(rows, (away**2).sum(axis=1) - g**2, rcond=1e-6)[0][:3]
    found = []
    for start in (linear, g.mean() * normal, -g.mean() * normal):
        center = np.array(start)
        for _ in range(ROUNDS):
            distance = np.linalg.norm(away - center, axis=1)
            slope = (center - away) / np.maximum(distance, LEAST_DISTANCE)[:, None]
            center = center - np.linalg.lstsq(slope, distance - g, rcond=1e-3)[0]
        error = float(np.abs(np.linalg.norm(away - center, axis=1) - g).sum())
        found.append((error, center))
    return np.asarray(middle + min(found, key=lambda one: one[0])[1])
