"""Content of a calibration: errors on all stages, and the calibrated numbers.

``found`` is a `Calibration`, whose module imports this one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexgen.base.rows import Column, Data, Part, Prose, Row, Table
from flexgen.identification.poses.parameters import FRAME, Unknown
from flexgen.identification.poses.poses import surfaces_of

# Parts of the names of numbers that are printed; those of places, frames and trackers are data.
PRINTED = (".zero", ".compliance", ".mimic.", ".mass")
CAUSES = 3  # that are printed
ERRORS = (
    Column("distance of the trackers from the model", key="stage"),
    Column("mean", "m", "mean_m"),
    Column("sd", "m", "sd_m"),
    Column("largest", "m", "largest_m"),
)
NUMBERS = tuple(map(Column, ("number", "before", "calibrated", "sd", "unit", "")))
SURFACES = tuple(
    map(Column, ("surfaces and gauges, world of the robot", "value", "sd", "unit", ""))
)


def content_of_calibration(found: Any) -> tuple[Part, ...]:
    """Errors on all stages, what changes from pose to pose, and the calibrated numbers with their
    accuracy.
    """
    title = f"{found.nominal.title}: {len(found.poses)} poses of {found.poses.source}"
    touched = [u for u in found.unknowns if u.kind == "surface"]
    shown = [u for u in found.unknowns if any(word in u.name for word in PRINTED)]
    listed = [u for u in shown if u not in touched]
    rest = len(found.unknowns) - len(listed) - len(touched)
    count = sum(found.determined.values())
    return (
        Prose(title, is_title=True),
        Data("model", found.nominal.title),
        Data("poses", len(found.poses)),
        Data("source", found.poses.source),
        _errors(found),
        *_from_pose_to_pose(found),
        _numbers(found, listed),
        _surfaces(found, touched),
        Prose(
            f"{count} of {len(found.unknowns)} numbers are determined by the measurements, "
            f"{len(found.kept)} keep the value of the model file; {rest} of places, frames and "
            "trackers are in --json",
            "count",
        ),
        Prose(_frame(found), "frame"),
        *(Prose(f"possible cause: {cause}", "causes") for cause in found.causes[:CAUSES]),
        *_hidden(found),
        *_data(found),
    )


def _hidden(found: Any) -> list[Part]:
    """Faults that the poses do not show."""
    if not found.not_visible:
        return []
    faults = ", ".join(map(str, found.not_visible))
    return [
        Prose(
            f"not visible in these poses, since compliances do the same: a wrong {faults}; "
            "`identify --rigid` and `commission` test masses with torques",
            "not_visible",
        )
    ]


def _errors(found: Any) -> Table:
    """Mean, deviation and largest of the errors on each stage."""
    errors = (
        ("model file; frame, trackers and unknown places fitted", found.errors_before),
        ("calibrated", found.errors),
        ("calibrated without the pose", found.errors_held_out),
        ("the same, the other trackers of the pose seen", found.errors_seen),
    )
    cells = tuple(
        (label, *(float(f(e)) for f in (np.nanmean, np.nanstd, np.nanmax)))
        for label, e in errors
        if e is not None
    )
    return Table(ERRORS, cells, "Errors", "errors")


def _from_pose_to_pose(found: Any) -> list[Part]:
    """Sag, noise of a point, and a tilt that trackers share."""
    rows: list[Part] = [
        Row("mean sag under gravity", float(np.nanmean(found.sag)), "m", "mean_sag_m")
    ]
    tilt = found.tilt
    if tilt is None:
        return rows
    angles = zip("xyz", tilt.tilt_rad.tolist(), strict=True)
    return [
        *rows,
        Row("noise of a point, one axis, sd", tilt.noise_m, "m"),
        *(
            Row(f"tilt of {tilt.element} about {axis} from pose to pose, sd", x, "rad")
            for axis, x in angles
        ),
    ]


def _numbers(found: Any, listed: list[Unknown]) -> Table:
    """Zeros, compliances, mechanisms and masses before and after."""
    values = found.values
    sd = found.sd
    cells = tuple(
        (u.name, u.start, values[u.name], sd[u.name] or None, u.unit, _mark(found, u))
        for u in listed
    )
    return Table(NUMBERS, cells, "Numbers")


def _mark(found: Any, unknown: Unknown) -> str:
    if found.sd[unknown.name] == 0.0:
        return "rigid: at its lower bound"
    if unknown.name in found.kept:
        return "not measured: value of the file"
    return "" if found.determined[unknown.name] else "not known separately"


def _surfaces(found: Any, touched: list[Unknown]) -> Table:
    """Places of surfaces and zeros of gauges, as far as they are determined."""
    cells: list[tuple[Any, ...]] = []
    for unknown in touched:
        known = found.determined[unknown.name]
        value = found.values[unknown.name] if known else None
        sd = found.sd[unknown.name] if known else None
        note = "" if known else "not determined"
        cells.append((unknown.name, value, sd, unknown.unit, note))
    return Table(SURFACES, tuple(cells), "Surfaces and gauges")


def _frame(found: Any) -> str:
    """Pose of the world in the measurement, or why there is none."""
    if found.poses.is_measured:
        frame = ", ".join(f"{x:.4g}" for x in found.frame.tolist())
        return f"pose of the world in the frame of the measurement ({FRAME}): {frame} (m, rad)"
    points = ["fixed points"] * bool(found.poses.point_names)
    surfaces = ["touches and gauges"] * (surfaces_of(found.poses) is not None)
    kinds = " and ".join([*points, *surfaces])
    return f"{kinds} only: no frame of the measurement, places are those of the robot"


def _data(found: Any) -> tuple[Data, ...]:
    """Entries of JSON."""
    held = found.errors_held_out
    seen = found.errors_seen
    data = {
        "mean_error_before_m": float(np.nanmean(found.errors_before)),
        "mean_error_m": float(np.nanmean(found.errors)),
        "largest_error_m": float(np.nanmax(found.errors)),
        "mean_error_held_out_m": None if held is None else float(np.nanmean(held)),
        "mean_error_seen_m": None if seen is None else float(np.nanmean(seen)),
        "tilt": None if found.tilt is None else found.tilt.to_dict(),
        "values": found.values,
        "sd": found.sd,
        "units": {u.name: u.unit for u in found.unknowns},
        "determined": found.determined,
        "not_measured": list(found.kept),
        "causes": [cause.to_dict() for cause in found.causes],
        "not_visible": [vars(limit) for limit in found.not_visible],
        "warnings": list(found.warnings),
        "ended": found.ended,
    }
    return tuple(Data(name, value) for name, value in data.items())
