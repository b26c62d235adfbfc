"""Places on a path, and forces over them: the parts of the length of each motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import cumulative_simpson

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.model.moves import MoveL, Program
from flexgen.paths.force import place_force, tool_force
from flexgen.paths.path import Path

START = (0.3, 0.8)


@pytest.fixture(scope="module")
def path() -> Path:
    """Two motions of the elbow, the first one with a rounded corner, and a pause between them."""
    steps = (
        MoveL((-0.1, 0.0, 0.0), zone=0.02),
        MoveL((0.0, 0.0, 0.1), pause=0.5),
        MoveL((0.05, 0.0, 0.0)),
    )
    program = Program("both", start=START, steps=steps, profile=(0.5, 5.0))
    return Path(flexgen.derive("elbow"), program)


def test_places_are_parts_of_the_length_of_each_motion(path: Path) -> None:
    """The length by integration of the speed of the tool; a pause is one place."""
    first, second = path.segments
    pause = (first.start + first.law.duration, second.start)
    assert pause[1] - pause[0] == pytest.approx(0.5)
    for k, segment in enumerate((first, second)):
        t = segment.start + np.linspace(0.0, segment.law.duration, 4001)
        speed = np.linalg.norm(path.sample(t).y[:, :, 1], axis=1)
        length = cumulative_simpson(speed, x=t, initial=0.0)
        assert_allclose(place_force.places(path, t), k + length / length[-1], atol=2e-2)
        straight = place_force.places(path, t)[[0, -1]]
        assert_allclose(straight, [k, k + 1], atol=1e-12)
    at = np.array([-1.0, *pause, sum(pause) / 2, path.duration, 99.0])
    assert_allclose(place_force.places(path, at), [0.0, 1.0, 1.0, 1.0, 2.0, 2.0], atol=1e-12)


def test_a_force_over_the_place_acts_where_the_tool_is(path: Path) -> None:
    """Along the whole path, on one motion of it, and as a function of time."""
    made = place_force.make_place_force(
        lambda s: np.outer(s**2, [1.0, 2.0, 3.0]), path.equations.model, 2
    )
    t = np.linspace(0.0, path.duration, 37)
    s = place_force.places(path, t)
    along = place_force.force_along(made, path)(t)
    assert_allclose(along, np.outer(s**2, [1, 2, 3, 0, 0, 0]), atol=1e-6)
    second = place_force.of_motion(made, 1)
    assert second is not None and place_force.of_motion(None, 1) is None
    inner = np.array([0.0, 0.25, 1.0])
    assert_allclose(second.at(inner), made.at(inner + 1), atol=1e-12)
    assert second.duration == 1.0
    timed = place_force.in_time(made, path)
    assert_allclose(timed.at(t), along, atol=1e-3)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ("0,0,0,0\n2,2,0,0", ""),
        ("-1,0,0,0\n3,2,0,0", ""),
        ("0.1,0,0,0\n2,2,0,0", r"given the places 0\.1 to 2 in .*, expected 0 to 2, the path"),
        ("0,0,0,0\n1.9,2,0,0", r"given the places 0 to 1\.9 in .*, expected 0 to 2, the path"),
    ],
)
def test_a_file_of_places_covers_the_path(rows: str, text: str, path: Path, tmp_path: Any) -> None:
    file = tmp_path / "force.csv"
    file.write_text(f"place,fx,fy,fz\n{rows}\n")
    model = path.equations.model
    if not text:
        made = place_force.make_place_force(file, model, 2)
        assert made.at(np.array([1.0]))[0, 0] == pytest.approx(1.0, abs=1e-9)
        return
    with pytest.raises(ArgumentError, match=f"^force: {text}"):
        place_force.make_place_force(str(file), model, 2)


def trajectory(labels: tuple[str, ...], units: tuple[str, ...]) -> Trajectory:
    samples = np.outer(np.arange(8.0) ** 2, np.ones(6))
    port = Port("force", (6,), " or ".join(dict.fromkeys(units)), "force on the tool")
    data = {"force": samples}
    ports = {"force": port}
    return Trajectory(np.arange(8.0), data, ports, {"force": labels}, {}, {"force": units})


@pytest.mark.parametrize(
    ("labels", "units", "text"),
    [
        (tool_force.LABELS, tool_force.UNITS, ""),
        (tuple("abcdef"), tool_force.UNITS, "given columns a, .* fx, fy"),
        (tool_force.LABELS, ("N",) * 6, "column mx: given 'N', a f"),
    ],
)
def test_the_force_of_a_trajectory_has_its_columns_and_units(
    labels: tuple[str, ...], units: tuple[str, ...], text: str
) -> None:
    data = trajectory(labels, units)
    if not text:
        assert_array_equal(tool_force.read_force(data), data["force"])
        return
    with pytest.raises(ArgumentError, match=f"channel force.*{text}"):
        tool_force.read_force(data)


def test_a_force_between_its_samples_is_smooth_then_constant() -> None:
    """A parabola is met exactly; samples beyond the instants are not read."""
    samples = np.outer(np.arange(8.0) ** 2, np.ones(6))
    held = tool_force.interpolate_force(np.arange(7.0), samples)
    assert_allclose(held([2.5])[0], 6.25)
    assert_allclose(held([6.0, 7.5, 100.0])[:, 0], 36.0)
