"""Paths of moves, programs and samples are what they were: laws, breaks, samples with derivatives,
jumps, tables.

A net, not a proof (`tests/support/exact_paths.py` has the proof for some of them): ``make golden``
writes `path_texts.txt` again; read the difference before you commit it.

Of `flexgen.paths.geometry.arc_length`, `flexgen.paths.geometry.blended_curve`,
`flexgen.paths.geometry.jets`, `flexgen.paths.timing.joint_limits`,
`flexgen.paths.timing.move_planner`, `flexgen.paths.path`, `flexgen.paths.geometry.path_distance`,
`flexgen.paths.path_table`, `flexgen.paths.geometry.redundancy`, `flexgen.paths.reference`,
`flexgen.paths.samples.sample_files`, `flexgen.paths.geometry.segments`,
`flexgen.paths.geometry.smoothness`, `flexgen.paths.timing.speed_planning`,
`flexgen.paths.geometry.spline`, `flexgen.paths.timing.time_laws`,
`flexgen.paths.timing.timed_segments`, `flexgen.paths.geometry.trigonometry`,
`flexgen.paths.timing.velocity_profiles`, `flexgen.analysis.linear`.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import flexgen
from flexgen.base.errors import FlexgenError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.model.moves import Move, MoveC, MoveJ, MoveL, Program
from flexgen.paths.geometry.redundancy import joint_problem
from flexgen.paths.geometry.smoothness import Jump, SmoothnessReport, smoothness_report
from flexgen.paths.path import Path
from flexgen.paths.path_table import path_table

TOOL = (0.5, 5.0, 100.0, 4000.0)
JOINTS = (2.0, 10.0, 200.0)
derived = functools.cache(flexgen.derive)


def digits(values: Any, count: int = 5) -> str:
    """Numbers of a few digits; what is below a millionth of the largest is rounding or nothing."""
    x = np.ravel(np.asarray(values, dtype=float))
    tiny = 1e-6 * np.abs(x).max(initial=0.0)
    return " ".join(f"{0.0 if abs(v) <= tiny else v:.{count}g}" for v in x)


def path_lines(path: Path) -> Iterator[str]:
    """Figures of the path and of its segments; its output and all derivatives at instants on it
    and beside it.
    """
    yield repr(path)
    yield f"breaks {digits(path.breaks)} start {digits(path.q_start)}"
    yield f"move {path.move.duration:.9g} {digits(path.move.start)}"
    for segment in path.segments:
        law = segment.law
        curve = segment.curve
        names = f"{segment.space} {type(law).__name__} {type(curve).__name__}"
        yield (
            f"segment {names} {segment.start:.9g} {law.duration:.9g} {curve.length:.9g} "
            f"{segment.smoothness}"
        )
        yield f"its breaks {digits(segment.breaks)}"
    t = np.concatenate(
        [[-0.1], np.array([0.0, 0.07, 0.31, 0.5, 0.83, 0.99, 1.0, 1.2]) * path.duration]
    )
    sample = path.sample(t)
    for k in range(6):
        yield f"y{k} {digits(sample.y[:, :, k])}"
    for name in ("R", "w", "q_g"):
        values = getattr(sample, name)
        if values is not None:
            yield (
                f"{name} {digits(values.reshape(len(t), -1) @ np.cos(np.arange(values[0].size)))}"
            )
    try:
        table = path_table(path.reference, path.segments, path.duration, path.q_start, "name")
    except FlexgenError as error:
        yield str(error)
    else:
        yield (
            f"table {len(table)} "
            f"{digits([table.sum(), np.abs(table).sum(), table @ np.cos(np.arange(len(table)))])}"
        )


def rough_lines(path: Path) -> Iterator[str]:
    """The jumps of a path and what is written about them."""
    report = smoothness_report(path.equations, path)
    yield (
        f"{report.required} {report.smoothness} {report.step:.3g} {report.sufficient} "
        f"{report.has_kinks}"
    )
    for jump in report.jumps:
        sizes = (jump.size, jump.rotation, jump.torque, jump.tool, jump.tool_rotation)
        yield f"{jump.time:.6g} {jump.order} " + " ".join(
            "-" if x is None else f"{x:.2e}" for x in sizes
        )
    yield from report.lines()


def written_reports() -> Iterator[str]:
    """Reports of made-up jumps."""
    jumps = (
        Jump(0.25, 2, 0.5, 0.0, 12.345, 2e-3, None),
        Jump(0.5, 4, 30.0, 0.0, 0.5, 3e-4, None),
        Jump(0.6, 3, 1.0, 0.0, None, None, None),
    )
    kinks = (
        Jump(0.1, 5, 9.0, 0.0, None, 4e-4, None),
        Jump(0.2, 5, 9.0, 0.0, None, 5e-4, None),
        Jump(0.3, 6, 9.0, 0.0, None, 0.0, None),
    )
    for required in (4, 3, 1, None):
        for some in (jumps, kinks, jumps + kinks, ()):
            report = SmoothnessReport(required, 3, 1e-3, some)
            yield f"{required} {report.sufficient} {report.has_kinks} {len(report.torque_jumps)}"
            yield from report.lines()


def moves() -> Iterator[tuple[str, str, Move]]:
    """Case, model and move."""
    for name in (
        "planar5_nmp",
        "manutec_r3",
        "four_mass",
        "beam_arm",
        "kr300_efjm",
        "urdf_arm",
        "abb_arm",
    ):
        for move in derived(name).model.moves:
            yield f"{name} {move.name}", name, move
    arm = derived("planar5_nmp").model
    line, joints = (arm.move(x) for x in ("line", "joints"))
    for smoothness in (0, 2, 5, 9):
        yield (
            f"profile {smoothness}",
            "planar5_nmp",
            replace(line, duration=0.0, smoothness=smoothness, profile=TOOL),
        )
    for n in (2, 3):
        yield (
            f"{n} bounds",
            "planar5_nmp",
            replace(joints, duration=0.0, smoothness=4, profile=JOINTS[:n]),
        )
    for smoothness in (3, 4, 7):
        yield f"smoothness {smoothness}", "planar5_nmp", replace(line, smoothness=smoothness)
    legs = (
        MoveL(displacement=(0.1, 0.0, 0.0), zone=0.02),
        MoveL(displacement=(0.0, -0.12, 0.0), zone=0.03, speed=0.2),
        MoveC(displacement=(0.05, -0.05, 0.0), via=(0.04, -0.01, 0.0)),
    )
    corner = replace(line, type="tool_polyline", displacement=(), legs=legs)
    yield (
        "polyline",
        "planar5_nmp",
        replace(corner, legs=tuple(replace(x, speed=None) for x in legs)),
    )
    yield (
        "polyline of a profile",
        "planar5_nmp",
        replace(corner, duration=0.0, smoothness=4, profile=TOOL),
    )
    robot = derived("manutec_r3").model
    start = robot.move("line").start
    turning = (
        MoveL(displacement=(0.0, 0.1, 0.05), rotation=(0.3, 0.0, 0.1), zone=0.02),
        MoveL(displacement=(0.1, 0.0, 0.0), rotation=(0.0, -0.2, 0.0)),
    )
    yield (
        "turning polyline",
        "manutec_r3",
        Move("turn", "tool_polyline", start, 1.0, 5, legs=turning),
    )
    yield (
        "only a turn",
        "manutec_r3",
        Move(
            "turn", "tool_line", start, 1.0, 5, displacement=(0, 0, 0), rotation=(0.1, 0.2, -0.3)
        ),
    )
    steps = (
        MoveJ(end=(0.6, -1.2)),
        MoveL(displacement=(0.05, 0.02, 0.0), zone=0.01),
        MoveL(displacement=(0.0, 0.05, 0.0), pause=0.2),
        MoveJ(end=(0.7, -1.0), zone=0.05),
        MoveJ(end=(0.5, -0.9)),
    )
    program = Program(
        "tour", start=(0.5, -1.1), smoothness=3, profile=TOOL, steps=steps, joint_profile=JOINTS
    )
    yield "program", "planar5_nmp", program
    yield "program of trapezoids", "planar5_nmp", replace(program, smoothness=0)


def wrong_moves() -> Iterator[tuple[str, Callable[[], Move]]]:
    """Moves of planar5_nmp that are refused, and some at their limits."""
    line = derived("planar5_nmp").model.move("line")
    leg = MoveL(displacement=(0.1, 0.0, 0.0), zone=0.05)
    last = MoveL(displacement=(0.0, -0.1, 0.0))
    polyline = replace(line, type="tool_polyline", displacement=())
    yield "type", partial(replace, line, type="spiral")
    yield "start", partial(replace, line, start=(0.1,))
    yield "not finite", partial(replace, line, displacement=(np.nan, 0.0, 0.0))
    yield "out of plane", partial(replace, line, displacement=(0.1, 0.0, 0.01))
    yield "rotation", partial(replace, line, rotation=(0.0, 0.0, 0.1))
    for bounds in ((0.5,), (0.5, 0.0), (0.5, np.inf)):
        yield (
            f"profile {bounds}",
            partial(replace, line, profile=bounds, duration=0.0, smoothness=4),
        )
    for smoothness in (1, 10):
        yield (
            f"profile, smoothness {smoothness}",
            partial(replace, line, profile=TOOL, duration=0.0, smoothness=smoothness),
        )
    yield (
        "no way",
        partial(
            replace, line, profile=TOOL, displacement=(0.0, 0.0, 0.0), duration=0.0, smoothness=4
        ),
    )
    circle = replace(
        line,
        type="tool_circle",
        displacement=(),
        center=(0.1, 0.0, 0.0),
        axis=(0, 0, 2.0),
        angle=0.4,
    )
    yield "circle", partial(replace, circle)
    yield "no axis", partial(replace, circle, axis=(0.0, 0.0, 0.0))
    yield "no angle", partial(replace, circle, angle=0.0)
    yield "tilted circle", partial(replace, circle, axis=(0.0, 0.1, 1.0))
    yield "no legs", partial(replace, polyline, legs=())
    yield (
        "zones that just fit",
        partial(replace, polyline, legs=(leg, replace(last, zone=0.05), last)),
    )
    yield (
        "zones that overlap",
        partial(replace, polyline, legs=(leg, replace(last, zone=0.0501), last)),
    )
    yield "no zone", partial(replace, polyline, legs=(replace(leg, zone=0.0), last))
    yield "zone at the end", partial(replace, polyline, legs=(leg, replace(last, zone=0.01)))
    yield "reversing", partial(replace, polyline, legs=(leg, MoveL(displacement=(-0.1, 0.0, 0.0))))
    yield "speed without profile", partial(replace, polyline, legs=(replace(leg, speed=0.1), last))
    yield (
        "both ends",
        partial(replace, polyline, legs=(replace(leg, position=(1.0, 0.0, 0.0)), last)),
    )
    yield (
        "leg without way",
        partial(replace, polyline, legs=(leg, MoveL(displacement=(0.0, 0.0, 0.0)))),
    )
    yield (
        "straight circle",
        partial(replace, polyline, legs=(leg, MoveC(displacement=(0.1, 0, 0), via=(0.05, 0, 0)))),
    )
    yield "far away", partial(replace, line, displacement=(9.0, 0.0, 0.0))
    program = Program(
        "tour",
        start=line.start,
        smoothness=3,
        profile=TOOL,
        steps=(leg, last),
        joint_profile=JOINTS,
    )
    yield "no steps", partial(replace, program, steps=())
    yield "zone and pause", partial(replace, program, steps=(replace(leg, pause=0.1), last))
    yield "blended spaces", partial(replace, program, steps=(leg, MoveJ(end=(0.1, 0.2))))
    yield (
        "no joint profile",
        partial(replace, program, steps=(MoveJ(end=(0.1, 0.2)),), joint_profile=()),
    )
    yield "program with a zone at the end", partial(replace, program, steps=(last, leg))
    yield "still", partial(replace, program, steps=(MoveJ(end=line.start),))


def outcome(make: Callable[[], Move]) -> str:
    """The figures of a path, or why it is refused."""
    try:
        path = Path(derived("planar5_nmp"), make())
    except FlexgenError as error:
        return f"{type(error).__name__}: " + re.sub(r"\S*models/", "models/", str(error))
    return f"{path!r} {digits(path.breaks)}"


def redundant() -> Iterator[str]:
    """The joints of an arm with more motors than outputs along a line of its tool."""
    model = derived("elbow").model
    only = replace(model, output=replace(model.output, axes="x"))
    equations = Equations(only)
    move = Move(
        "slide", "tool_line", model.move("line").start, 0.5, 5, displacement=(-0.08, 0.0, 0.0)
    )
    for joint in (None, model.coordinates[0].name):
        _, path = joint_problem(equations, move, joint)
        yield f"{path.move.rule} {len(path.segments)}"
        yield from (
            line for line in path_lines(path) if line.startswith(("y0", "y2", "y4", "segment"))
        )


@functools.cache
def cases() -> dict[str, Callable[[], Any]]:
    """All texts by name."""
    found: dict[str, Callable[[], Any]] = {
        case: partial(lambda name, move: path_lines(Path(derived(name), move)), name, move)
        for case, name, move in moves()
    }
    rough = {
        case: move
        for case, _, move in moves()
        if case in ("profile 0", "smoothness 3", "2 bounds", "program")
    }
    found |= {
        f"jumps, {case}": partial(lambda m: rough_lines(Path(derived("planar5_nmp"), m)), move)
        for case, move in rough.items()
    }
    found |= {
        f"move, {name}": partial(lambda move: [outcome(move)], move)
        for name, move in wrong_moves()
    }
    return found | {"reports": written_reports, "redundant arm": redundant}


def lines(name: str) -> list[str]:
    """The lines of a text."""
    return list(cases()[name]())


ROBOTS = (
    "planar5_nmp",
    "manutec_r3",
    "four_mass",
    "beam_arm",
    "kr300_efjm",
    "urdf_arm",
    "abb_arm",
)
