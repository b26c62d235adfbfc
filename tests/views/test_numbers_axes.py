"""Quantities that figures take from a motion: windows of time, limits of axes, prefixes, planes of
a robot, and early torques.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.views.plots import canvas, solution
from flexgen.views.plots.stick_figure import _views, spans


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "1"),
        (10.0, "10"),
        (0.001, "10⁻³"),
        (-0.1, "\N{MINUS SIGN}10⁻¹"),
        (-1.0, "\N{MINUS SIGN}1"),
        (1e12, "10¹²"),
        (0, "0"),
        (99.0, "10²"),
    ],
)
def test_labels_of_logarithmic_axes(value: float, text: str) -> None:
    assert canvas.power(value) == text


def test_values_have_prefixes_of_their_units() -> None:
    for value, unit, expected in (
        (1.0, "m", (1.0, "m")),
        (0.9994, "m", (1e3, "mm")),
        (0.9996, "m", (1.0, "m")),
        (1e-3, "rad", (1e3, "mrad")),
        (0.9994e-3, "m", (1e6, "µm")),
        (1e-7, "m", (1e6, "µm")),
        (0.99e-7, "m", (1e9, "nm")),
        (0.0, "m", (1e9, "nm")),
        (-2.0, "rad or m", (1.0, "rad or m")),
        (2e-3, "rad or m", (1e3, "mrad or mm")),
        (2e-3, "N m", (1.0, "N m")),
    ):
        assert canvas.choose_prefix(value, unit) == expected, (value, unit)
    assert canvas.measure(0.01234567, "m") == ("12.3", "mm") and canvas.measure(1234.5, "m") == (
        "1230",
        "m",
    )
    assert canvas.measure(1e-13, "m") == ("< 0.001", "nm") and canvas.measure(0.0, "m") == (
        "0",
        "nm",
    )
    assert canvas.measure(999.6, "N m") == ("1000", "N m") and canvas.measure(1e-3, "s") == (
        "0.001",
        "s",
    )


TIME = np.array([-0.4, -0.2, -0.1, 0.0, 0.5, 1.0, 1.2, 2.0, 9.0])


class Motion(dict[str, Any]):
    """Channels of a motion whose path takes a second."""

    def __init__(self, **channels: Any) -> None:
        super().__init__(channels)
        self.time = TIME
        self.channels = self
        self.meta = {"move": "line"}


def test_windows_of_time_hold_path_and_torques() -> None:
    tau = np.stack([[1.0, 1.0, 1.1, 2.0, 5.0, 3.0, 3.001, 3.0, 3.0], np.full(9, 7.0)], axis=1)
    made: Any = Motion(tau_m=tau)
    away, span = canvas.hold(made)
    # the median of the first half of the time before the path
    assert_allclose(away, np.abs(tau - [1.0, 7.0]))
    assert_allclose(span, [4.0, 0.0])
    assert canvas.begin(made, 1.0) == pytest.approx(-0.1 - 0.06)
    assert canvas.finish(made, 1.0) == pytest.approx(1.0 + 0.1)  # 1e-3 after 1 s is not visible
    assert canvas.longest(2.0) == 8.0
    tau[7] = 3.01
    assert canvas.finish(made, 1.0) == pytest.approx(2.0 + 0.1) and canvas.finish(
        made, 0.3
    ) == pytest.approx(1.2)
    tau[8] = 9.0
    assert canvas.finish(made, 3.0) == pytest.approx(3.3) and canvas.finish(made, 20.0) == 9.0
    tau[:] = 4.0
    assert canvas.begin(made, 1.0) == pytest.approx(-0.06) and canvas.begin(made, 100.0) == -0.4


def test_the_end_of_a_path_is_where_its_reference_rests() -> None:
    y = np.array([0.0, 0, 0, 0, 0.5, 1 - 1e-6, 1.0, 1.0, 1.0])[:, None]
    made: Any = Motion(y_ref=y)

    def end(*moves: tuple[str, float]) -> float:
        equations: Any = Made(model=Made(moves=[Made(name=name, duration=T) for name, T in moves]))
        return canvas.path_end(equations, made)

    assert end() == 1.2 and end(("other", 1.25)) == 1.2 and end(("line", 1.1)) == 1.2
    assert (
        end(("line", 1.25)) == 1.25 and end(("line", 1.33)) == 1.33 and end(("line", 1.4)) == 1.2
    )
    made["R_ref"] = np.stack([[0.0, 0, 0, 0, 0, 0, 0, 0.5, 0.6]] * 9, axis=1)
    assert end() == 9.0
    del made["y_ref"]
    assert end() == 9.0


class Axis:
    """Records what is drawn."""

    def __init__(self, *ends: float) -> None:
        self.lines = [Made(get_xdata=lambda x=x: np.array([0.0, x])) for x in ends]
        self.calls: list[Any] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *given, **named: self.calls.append((name, *given))

    def of(self, name: str) -> list[Any]:
        return [call[1:] for call in self.calls if call[0] == name]


@pytest.mark.parametrize(
    ("first", "end", "last", "until", "label", "shaded"),
    [
        (
            -0.5,
            1.0,
            2.0,
            2.0,
            "time, s   (shaded: before and after the path)",
            [(-0.5, 0.0), (1.0, 2.0)],
        ),
        (0.0, 1.0, 1.0, 1.0, "time, s", []),
        (0.0, 1.0, 1.0, 1.51, "time, s   (the motion ends at 1.51 s)", []),
        (
            0.0,
            1.0,
            1.5,
            9.0,
            "time, s   (shaded: before and after the path; the motion ends at 9 s)",
            [(1.0, 1.5)],
        ),
    ],
)
def test_a_time_axis_says_what_is_outside_of_the_path(
    first: float, end: float, last: float, until: float, label: str, shaded: list[Any]
) -> None:
    ax = Axis(0.5, until)
    canvas.time_axis(ax, first, end, last)
    assert ax.of("set_xlim") == [(first, last)] and ax.of("axvspan") == shaded
    assert ax.of("axvline") == [(0.0,), (end,)] and ax.of("set_xlabel") == [(label,)]
    quiet = Axis(until)
    canvas.time_axis(quiet, first, end, last, label=False)
    assert quiet.of("set_xlabel") == []


@pytest.mark.parametrize(
    ("values", "bound", "lines", "limits", "titles"),
    [
        ([-1.0, 3.0], None, [], (-1.0, 3.0), []),
        ([-1.0, 3.0], np.inf, [], (-1.0, 3.0), []),
        ([-1.0, 3.0], 5.0, [5.0], (-1.0, 5.0), ["limit ±5 N m"]),
        ([-2.1, 3.0], 5.0, [-5.0, 5.0], (-5.0, 5.0), ["limit ±5 N m"]),
        ([-1.0, 3.0], 7.6, [], (-1.0, 3.0), ["limit ±7.6 N m"]),
        ([2.0, 3.0], 7.5, [], (0.0, 3.0), ["limit ±7.5 N m"]),
        ([0.0, 1e-5], None, [], (-10.0, 10.0), []),
        ([0.0, 1.1e-4], None, [], (0.0, 1.1e-4), []),
    ],
)
def test_axes_of_motors_have_their_bounds_where_these_are_near(
    values: list[float],
    bound: float | None,
    lines: list[float],
    limits: tuple[float, float],
    titles: list[str],
) -> None:
    """Within two and a half of the largest value; a line from two fifths of it on; 9 % of
    margin.
    """
    ax = Axis()
    solution._limits(ax, np.array(values), bound, 100.0, "N m")
    assert [y for (y,) in ax.of("axhline")] == lines and [
        text for (text,) in ax.of("set_title")
    ] == titles
    low, high = limits
    assert_allclose(
        ax.of("set_ylim")[0], [low - 0.09 * (high - low), high + 0.09 * (high - low)], rtol=1e-12
    )


def test_torques_before_a_path_are_those_of_unstable_zeros() -> None:
    tau = np.zeros((9, 1))
    tau[4:, 0] = 10.0
    made: Any = Motion(tau_m=tau)
    zeros: Any = Made(zeros=Made(phase="non-minimum phase"))
    assert not solution._acts_early(made, zeros)
    tau[2] = 0.9e-6
    assert not solution._acts_early(made, zeros)
    tau[2] = 1.1e-6
    assert solution._acts_early(made, zeros) and not solution._acts_early(made, None)
    assert not solution._acts_early(made, Made(zeros=Made(phase="minimum phase")))
    made.meta["torque"] = "limited"
    assert not solution._acts_early(made, zeros)


# --- planes of a robot ---------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("extent", "gravity", "views"),
    [
        ((1.0, 2.0, 3.0), (0.0, 0.0, -9.8), ((0, 2), (1, 2), (0, 1))),
        ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), ((0, 2), (1, 2), (0, 1))),
        ((1.0, 2.0, 3.0), (9.8, 0.0, 0.0), ((1, 0), (2, 0), (1, 2))),
        ((1.0, 2.0, 0.0), (0.0, -9.8, 0.0), ((0, 1),)),
        ((1.0, 2.0, 0.0), (-9.8, 0.0, 0.0), ((1, 0),)),
        ((1.0, 2.0, 0.0), (0.0, 0.0, -9.8), ((0, 1),)),
        ((1.0, 0.0, 0.0), (0.0, 0.0, -9.8), ((0, 2),)),
        ((1.0, 0.0, 0.0), (0.0, -9.8, 0.0), ((0, 1),)),
        ((1.0, 2.0, 1e-7), (0.0, -9.8, 0.0), ((0, 1),)),
        ((1e-7, 0.0, 0.0), (0.0, -9.8, 0.0), ()),
    ],
)
def test_a_robot_is_drawn_with_its_gravity_downwards(
    extent: tuple[float, ...], gravity: tuple[float, ...], views: tuple[tuple[int, int], ...]
) -> None:
    """Each of the three planes; of a flat robot its own plane."""
    frames = np.stack([np.zeros(3), np.array(extent)], axis=1)[None]
    model: Any = Made(gravity=gravity)
    assert _views(model, frames) == views


def test_drawings_have_a_margin_of_their_largest_extent() -> None:
    frames = np.array([[[0.0, 1.0], [0.0, -2.0], [0.5, 0.5]]])
    drawn: Any = Made(frames=frames, tool=np.array([[0.0, 2.0, 0.5]]))
    assert_allclose(spans(drawn), [[-0.28, 1.28], [-2.28, 2.28], [0.22, 0.78]], rtol=1e-12)
