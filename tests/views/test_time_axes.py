"""Axes over time of the figures of a motion: their windows, shades, limits and bounds, read back
from matplotlib.

The motion is a solution of the elbow with torques that are planted in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.views.plots import canvas, solution

# Instants of the planted motion [s]: the path is from 0 to 1 s, as that of the elbow.
TIME = np.linspace(-0.5, 12.0, 1251)
VISIBLE = 1e-3  # of the range of a torque


@cache
def solved() -> flexgen.Solution:
    return flexgen.solve("elbow", "line", verify=False)


@cache
def equations() -> Any:
    return derive("elbow")


def planted(law: Callable[[np.ndarray], Any], **meta: Any) -> Trajectory:
    """The motion of the elbow with another torque of its first motor; the second one has none."""
    given = solved().trajectory
    channels = {
        name: np.array([np.interp(TIME, given.time, column) for column in x.T]).T
        for name, x in given.channels.items()
        if x.ndim == 2
    }
    channels["tau_m"] = np.stack([np.asarray(law(TIME), float), 0.0 * TIME], axis=1)
    return replace(given, time=TIME, channels=channels, meta={**given.meta, **meta})


def pulse(first: float, last: float, size: float = 1.0) -> Callable[[np.ndarray], np.ndarray]:
    """A torque that differs from 2 N m between two instants, 10 N m along the path."""
    return lambda t: (
        2.0
        + np.where((t >= first - 1e-9) & (t <= last + 1e-9), size, 0.0)
        + np.where((t > 0.205) & (t < 0.795), 10.0, 0.0)
    )


@pytest.mark.parametrize(
    ("torque", "first", "last"),
    [
        (pulse(-0.3, 2.0), -0.3, 2.0),  # both outside of the path
        (pulse(0.1, 0.5), 0.0, 0.79),  # neither
        (pulse(-0.3, 2.0, 9.9 * VISIBLE), 0.0, 0.79),  # too small to be seen
        (lambda t: 0.0 * t, 0.0, 0.0),  # no torque at all
    ],
)
@pytest.mark.parametrize("end", [1.0, 0.5])
def test_plots_begin_and_end_near_the_first_and_the_last_change_of_torque(
    torque: Any, first: float, last: float, end: float
) -> None:
    """Six hundredths of the path before, a tenth of it after; never beyond the motion, and at
    most four times the path.
    """
    made = planted(torque)
    assert canvas.begin(made, end) == pytest.approx(first - 0.06 * end)
    assert canvas.finish(made, end) == pytest.approx(min(max(last, end) + 0.1 * end, 4.0 * end))
    assert canvas.begin(made, 100.0) == TIME[0] and canvas.finish(made, 100.0) == TIME[-1]
    away, span = canvas.hold(made)
    tau = made["tau_m"]
    assert_allclose(away, np.abs(tau - tau[0]))
    assert_allclose(span, tau.max(axis=0) - tau.min(axis=0))


@pytest.mark.parametrize(
    ("rest", "duration", "name", "end"),
    [
        (0.95, 1.0, "line", 1.0),  # the last changes of a smooth law are rounding
        (0.8, 1.0, "line", 0.8),  # too early for that
        (0.95, 1.0, "other", 0.95),
        (1.05, 1.0, "line", 1.05),  # later than the move
    ],
)
def test_a_path_ends_where_its_reference_rests_or_with_its_move(
    rest: float, duration: float, name: str, end: float
) -> None:
    made = planted(pulse(0.1, 0.5))
    model = equations().model
    moves = tuple(replace(move, duration=duration) for move in model.moves if move.name == "line")
    robot: Any = SimpleNamespace(model=replace(model, moves=moves))
    y = np.minimum(TIME, rest)[:, None] * np.ones(made["y_ref"].shape[1])
    made = replace(made, channels=made.channels | {"y_ref": y}, meta=made.meta | {"move": name})
    assert canvas.path_end(robot, made) == pytest.approx(end, abs=1e-9)
    turn = {"R_ref": np.minimum(TIME, 3.0)[:, None] * np.ones(9)}
    turning = replace(
        made,
        channels=made.channels | turn,
        ports=made.ports | {"R_ref": Port("R_ref", (9,), "1", "turn of the tool")},
        labels=made.labels | {"R_ref": tuple("abcdefghi")},
    )
    assert canvas.path_end(robot, turning) == pytest.approx(3.0)
    parts = {part: dict(getattr(made, part)) for part in ("channels", "ports", "labels")}
    for one in parts.values():
        del one["y_ref"]
    assert canvas.path_end(robot, replace(made, **parts)) == TIME[-1]


@pytest.mark.parametrize(
    ("first", "last", "until", "note", "shaded"),
    [
        (-0.5, 2.0, 2.0, "   (shaded: before and after the path)", [(-0.5, 0.0), (1.0, 2.0)]),
        (0.0, 1.0, 1.0, "", []),
        (0.0, 1.0, 1.51, "   (the motion ends at 1.51 s)", []),
        (
            0.0,
            1.5,
            9.0,
            "   (shaded: before and after the path; the motion ends at 9 s)",
            [(1.0, 1.5)],
        ),
    ],
)
@pytest.mark.parametrize("label", [True, False])
def test_a_time_axis_says_what_is_outside_of_the_path(
    first: float, last: float, until: float, note: str, shaded: list[Any], label: bool
) -> None:
    ax = canvas.new_figure(4.0, 3.0, "").subplots()
    ax.plot([0.0, until], [0.0, 1.0])
    canvas.time_axis(ax, first, 1.0, last, label=label)
    spans = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in ax.patches]
    assert ax.get_xlim() == (first, last) and spans == shaded
    assert [float(line.get_xdata()[0]) for line in ax.lines[1:]] == [0.0, 1.0]
    assert ax.get_xlabel() == (f"time, s{note}" if label else "")


# Torques of a motor [N m], its bound, drawn bounds, ends of its axis without margins, its title.
BOUNDS = [
    ((-1.0, 3.0), np.inf, [], (-1.0, 3.0), ""),
    ((-1.0, 3.0), 5.0, [5.0], (-1.0, 5.0), "limit ±5 N m"),
    ((-2.1, 3.0), 5.0, [-5.0, 5.0], (-5.0, 5.0), "limit ±5 N m"),
    ((-1.0, 3.0), 7.6, [], (-1.0, 3.0), "limit ±7.6 N m"),
    ((2.0, 3.0), 7.5, [], (0.0, 3.0), "limit ±7.5 N m"),
]


@pytest.mark.parametrize(("ends", "bound", "lines", "limits", "title"), BOUNDS)
def test_axes_of_motors_have_their_bounds_where_these_are_near(
    ends: tuple[float, float],
    bound: float,
    lines: list[float],
    limits: tuple[float, float],
    title: str,
) -> None:
    """Within two and a half of the largest value; a line from two fifths of it on; 9 % of
    margin. A motor that rests has an axis of a tenth of the others.
    """
    made = planted(lambda t: np.interp(t, [0.2, 0.8], ends))
    figure = solution.torques(equations(), made, end=1.0, limits=[bound, np.inf])
    ax, other = figure.get_axes()
    assert ax.get_ylabel() == "torque, N m" and ax.get_title(loc="right") == title
    red = [line for line in ax.lines if to_hex(line.get_color()) == canvas.RED.lower()]
    assert [float(line.get_ydata()[0]) for line in red] == lines
    (drawn,) = [line for line in ax.lines if to_hex(line.get_color()) == canvas.BLUE.lower()]
    shown = np.isin(made.time, drawn.get_xdata())
    assert_allclose(drawn.get_ydata(), made["tau_m"][shown, 0])
    margin = 0.09 * (limits[1] - limits[0])
    assert_allclose(ax.get_ylim(), [limits[0] - margin, limits[1] + margin])
    assert_allclose(other.get_ylim(), np.array([-1, 1]) * 0.1 * max(np.abs(ends)) * 1.18)


UNSTABLE: Any = SimpleNamespace(
    zeros=SimpleNamespace(phase="non-minimum phase", unstable_time_constant_s=0.05)
)
STABLE: Any = SimpleNamespace(zeros=SimpleNamespace(phase="minimum phase"))


@pytest.mark.parametrize(
    ("size", "analysis", "meta", "seen"),
    [
        (1.1e-6, UNSTABLE, {}, True),
        (0.9e-6, UNSTABLE, {}, False),  # below 1e-7 of the range of the torque
        (0.0, UNSTABLE, {}, False),
        (1.0, STABLE, {}, False),
        (1.0, None, {}, False),
        (1.0, UNSTABLE, {"torque": "limited"}, False),  # it may start early by its limits
    ],
)
def test_torques_before_a_path_have_a_panel_where_they_are_those_of_unstable_zeros(
    size: float, analysis: Any, meta: dict[str, Any], seen: bool
) -> None:
    made = planted(
        lambda t: np.where(t > 0, 10.0, np.where(t > -0.2, size * np.exp(t / 0.05), 0.0)), **meta
    )
    if size < 1.0:
        made["tau_m"][(TIME > -0.1) & (TIME < 0.0), 0] = size
    figure = solution.torques(equations(), made, end=1.0, analysis=analysis)
    titles = [ax.get_title(loc="left") for ax in figure.get_axes()]
    assert ("torque before the path starts at t = 0" in titles) == seen
