"""A planned path as a table of numbers, which the sampler of the emitted C reads: laws and curves,
no samples.

The table is a sequence of blocks in one array. Each begins with its length, so that the sampler
can skip it; "n x" are n numbers.

    path     length, LAYOUT, n_t, n_y, n_a, segments, duration, n_a x q_start, n_y x column of a
             curve of the tool (0 to 2: position, 3: angle) of an output; then the segments
    segment  length, start, duration, space, law, curve
    law      a polynomial, or: length, 2, time_scale, its powers 1 and 2, phases m, (m + 1) x start
             of a phase, (m + 1) x distance there, m x first speed, m x last speed; then m steps
             (a block of length 1: none)
    step     a polynomial, or: length, 1, duration, knots m, derivatives k, m x knot,
             m k x derivatives -1 to k - 2
    polynomial  length, 0, duration, its powers 1 and 2, scale, n, 4 x n coefficients: integral,
             value, two derivatives
    curve    length, dimension d, 1 with an orientation, sections; then the sections
    straight length, 0, arc length at its start, parameter there, d x position, 9 x R, geometry
    corner   length, 1, arc length at its start, first and last parameter, length of the segment
             before, resolution, d x position, 4 x quaternion, knots m (0: no table), m x knot,
             m x arc length there;
             then the polynomial, the geometry before and the geometry after it
    geometry length, kind (0: line, 1: arc), its range, rate of rotation, 3 x rotation, 3 x axis,
             9 x square of the cross-product matrix; line: d x displacement; arc: 3 x radius
             vector, 3 x the same turned by 90 deg, rate, (d - 3) x displacement of an angle, in
             proportion to the parameter

Matrices are stored by rows. Parameters of corners are those of the curve, see
`flexgen.paths.geometry.blended_curve`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.paths.geometry.blended_curve import BUMP, BlendedCurve, Section
from flexgen.paths.geometry.carried_curve import CarriedCurve
from flexgen.paths.geometry.fixed_tool import FixedToolCurve
from flexgen.paths.geometry.jets import quaternion
from flexgen.paths.geometry.segments import Arc, Line, Segment, WithAngle
from flexgen.paths.reference import Reference
from flexgen.paths.timing.speed_planning import SpeedLaw
from flexgen.paths.timing.time_laws import Law, SplineLaw, TimeLaw
from flexgen.paths.timing.timed_segments import TimedSegment
from flexgen.paths.timing.velocity_profiles import SpeedStep, TrapezoidStep

LAYOUT = 1  # changes with the layout of the table
SPACES = {"tool": 0, "output": 1, "joint": 2}
ORDER = 2  # derivatives of a sample


def path_table(
    reference: Reference,
    segments: Sequence[TimedSegment],
    duration: float,
    q_start: np.ndarray,
    name: str,
) -> np.ndarray:
    """The table (n,) of the path ``name`` with these segments.

    Raises
    ------
    ArgumentError
        The path has a part that is a spline through samples, or in a frame that moves.
    """
    model = reference.model
    axes = np.zeros(model.output.size)
    if reference.tool and not reference.pose:
        axes[:] = reference.columns
    head = [
        LAYOUT,
        model.output.target_size,
        model.output.size,
        model.n_a,
        len(segments),
        duration,
        q_start,
        axes,
    ]
    return _block(*head, *(_segment(segment, name) for segment in segments))


def _block(*parts: Any) -> np.ndarray:
    """These numbers and arrays behind the length of the whole."""
    flat = np.concatenate([np.ravel(np.asarray(part, dtype=float)) for part in parts])
    return np.concatenate([[float(len(flat) + 1)], flat])


def _segment(segment: TimedSegment, name: str) -> np.ndarray:
    """Numbers of a timed segment: start, duration, space, law, curve; ArgumentError for a curve
    that the sampler in C does not know.
    """
    if isinstance(segment.curve, CarriedCurve | FixedToolCurve):
        raise ArgumentError(
            f"table: given move {name} in a frame that moves, expected one in a frame at rest; "
            "sample it with Path.sample and store the samples"
        )
    if not isinstance(segment.curve, BlendedCurve):
        raise ArgumentError(
            f"table: given move {name}, a spline through samples, expected lines, arcs, joint "
            "moves or a program; sample it with Path.sample and store the samples"
        )
    return _block(
        segment.start,
        segment.law.duration,
        SPACES[segment.space],
        _law(segment.law),
        _curve(segment.curve),
    )


def _law(law: Law) -> np.ndarray:
    """Numbers of a time law: a polynomial (kind 0), or phases of constant and changing speed (kind
    2); ArgumentError for a spline.
    """
    if isinstance(law, TimeLaw):
        return _polynomial(law)
    if isinstance(law, SplineLaw):
        raise ArgumentError(
            "path table: given a move with a spline as time law (timing), expected a duration "
            "or a profile; the sampler in C has no splines: send samples to the stream"
        )
    assert isinstance(law, SpeedLaw)
    starts, distances = law.starts.T
    first, last = np.array([(phase.first, phase.last) for phase in law.phases]).T
    powers = law.time_scale ** np.arange(1, ORDER + 1)
    steps = [np.ones(1) if phase.step is None else _step(phase.step) for phase in law.phases]
    return _block(2, law.time_scale, powers, len(steps), starts, distances, first, last, *steps)


def _step(step: SpeedStep) -> np.ndarray:
    """Numbers of a change of speed: a polynomial (kind 0), or pieces of it (kind 1)."""
    if isinstance(step, TimeLaw):
        return _polynomial(step)
    assert isinstance(step, TrapezoidStep)
    knots, values = step.polynomials
    return _block(1, step.duration, len(knots), values.shape[1], knots, values)


def _polynomial(law: TimeLaw) -> np.ndarray:
    """Numbers of a polynomial law: duration, its powers, length, and the coefficients of its
    integral, value and derivatives, of equal length.
    """
    value = law.polynomial
    every = [value.integ(), value, *(value.deriv(k) for k in range(1, ORDER + 1))]
    n = len(every[0].coef)
    rows = [np.pad(p.coef, (0, n - len(p.coef))) for p in every]
    powers = [law.duration**k for k in range(1, ORDER + 1)]
    return _block(0, law.duration, powers, law.length, n, *rows)


def _curve(curve: BlendedCurve) -> np.ndarray:
    """Numbers of a curve of lines, arcs and corners: size, whether it has an orientation, and its
    sections.
    """
    lengths = [section.length for section in curve.sections]
    starts = np.concatenate([[0.0], np.cumsum(lengths)])[:-1]
    sections = [
        _section(curve, section, start)
        for section, start in zip(curve.sections, starts, strict=True)
    ]
    return _block(len(curve.start), curve.R_start is not None, len(sections), *sections)


def _section(curve: BlendedCurve, section: Section, start: float) -> np.ndarray:
    """Numbers of a section that begins at the arc length ``start``: a part of a segment (kind 0),
    or a corner (kind 1) with its table of arc lengths, its law and the two segments that it
    blends.
    """
    k = section.segment
    segment = curve.segments[k]
    position, R = curve.poses[k]
    R = np.eye(3) if R is None else R
    if not section.corner:
        first = section.start - (curve.ends[k] - segment.length)
        return _block(0, start, first, position, R, _geometry(segment))
    zone = curve.zones[k]
    table = curve.tables[k]
    arcs: Sequence[Any] = (0,) if table is None else (len(table.knots), table.knots, table.lengths)
    ends = (curve.ends[k] - zone, curve.ends[k] + zone)
    resolution = 0.0 if table is None else table.resolution
    return _block(
        *(1, start, *ends, segment.length, resolution, position, quaternion(R), *arcs),
        *(
            _polynomial(TimeLaw(2 * zone, BUMP)),
            _geometry(segment),
            _geometry(curve.segments[k + 1]),
        ),
    )


def _geometry(segment: Segment) -> np.ndarray:
    """Numbers of a line (kind 0) or an arc (kind 1): length, rotation as axis, rate and the square
    of the axis' cross-product matrix, displacement or arms, and a further angle.
    """
    angle = float(np.linalg.norm(segment.rotation))
    x, y, z = axis = segment.rotation / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = (angle / segment.length, segment.rotation, axis, hat @ hat)
    path, more = (
        (segment.path, [segment.angle]) if isinstance(segment, WithAngle) else (segment, [])
    )
    if isinstance(path, Line):
        return _block(0, segment.length, *rotation, path.total, more)
    assert isinstance(path, Arc)
    return _block(1, segment.length, *rotation, *path.arms, path.angle / path.length, more)
