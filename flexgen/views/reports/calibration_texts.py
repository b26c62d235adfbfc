"""A calibration as text."""

from __future__ import annotations

import numpy as np

from flexgen.base.display import choose_scale
from flexgen.identification.poses.parameters import FRAME, Unknown
from flexgen.identification.poses.poses import surfaces_of
from flexgen.identification.poses.result import Calibration
from flexgen.views.reports.text_tables import number, table

SHOWN = {
    "zeros": ".zero",
    "compliances": ".compliance",
    "mechanisms": ".mimic.",
    "masses": ".mass",
}


def text_of_calibration(found: Calibration) -> str:
    """Errors on all stages, what changes from pose to pose, and the calibrated numbers with their
    accuracy.
    """
    title = f"{found.nominal.title}: {len(found.poses)} poses of {found.poses.source}"
    errors = [
        ("model file; frame, trackers and unknown places fitted", found.errors_before),
        ("calibrated", found.errors),
        ("calibrated without the pose", found.errors_held_out),
        ("the same, the other trackers of the pose seen", found.errors_seen),
    ]
    statistics = [
        (label, [float(f(e)) for f in (np.nanmean, np.nanstd, np.nanmax)])
        for label, e in errors
        if e is not None
    ]
    sag = float(np.nanmean(found.sag))
    noise = 0.0 if found.tilt is None else found.tilt.noise_m
    scale = choose_scale([sag, noise, *(x for _, each in statistics for x in each)], "m")
    rows = [[label, *map(scale.cell, each)] for label, each in statistics]
    head = (f"{what}, {scale.unit}" for what in ("mean", "sd", "largest"))
    parts = [title, table(rows, ("distance of the trackers from the model", *head))]
    parts.append(f"mean sag under gravity {scale.text(sag)}")
    if found.tilt is not None:
        angles = [float(x) for x in found.tilt.tilt_rad]
        turn = choose_scale(angles, "rad")
        turns = ", ".join(number(turn.cell(x), 2) for x in angles)
        parts.append(
            f"from pose to pose: noise of a point {scale.text(noise)} an axis, tilt of "
            f"{found.tilt.element} {turns} {turn.unit} (x, y, z), standard deviations"
        )
    values = found.values
    sd = found.sd
    determined = found.determined
    touched = [u for u in found.unknowns if u.kind == "surface"]
    shown = [u for u in found.unknowns if any(word in u.name for word in SHOWN.values())]
    listed = [u for u in shown if u not in touched]
    lines = [
        [u.name, u.start, values[u.name], sd[u.name] or None, u.unit, _mark(u, sd, determined)]
        for u in listed
    ]
    if lines:
        parts.append(table(lines, ("number", "before", "calibrated", "sd", "unit", "")))
    if touched:
        parts.append(_surfaces(found, touched))
    rest = len(found.unknowns) - len(listed) - len(touched)
    count = sum(determined.values())
    parts.append(
        f"{count} of {len(found.unknowns)} numbers are determined by the measurements, the "
        f"others keep their prior; {rest} of places, frames and trackers are in --json"
    )
    if not found.poses.is_measured:
        parts.append(
            f"{_kinds(found)} only: no frame of the measurement, places are those of the robot"
        )
        return "\n\n".join(parts)
    frame = ", ".join(number(float(x)) for x in found.frame)
    parts.append(f"pose of the world in the frame of the measurement ({FRAME}): {frame} (m, rad)")
    return "\n\n".join(parts)


def _surfaces(found: Calibration, touched: list[Unknown]) -> str:
    """Places of surfaces and zeros of gauges, as far as they are determined."""
    rows = []
    for unknown in touched:
        known = found.determined[unknown.name]
        value = number(found.values[unknown.name]) if known else "not determined"
        sd = number(found.sd[unknown.name]) if known else ""
        rows.append([unknown.name, value, sd, unknown.unit])
    return table(rows, ("surfaces and gauges, world of the robot", "value", "sd", "unit"))


def _kinds(found: Calibration) -> str:
    """Kinds of what is touched."""
    points = ["fixed points"] * bool(found.poses.point_names)
    surfaces = ["touches and gauges"] * (surfaces_of(found.poses) is not None)
    return " and ".join([*points, *surfaces])


def _mark(unknown: Unknown, sd: dict[str, float], determined: dict[str, bool]) -> str:
    if sd[unknown.name] == 0.0:
        return "rigid: at its lower bound"
    return "" if determined[unknown.name] else "prior"
