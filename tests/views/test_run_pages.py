"""Figures and the page of a closed loop, and errors of methods, read back from figure and page.

The loop is a run of the elbow in which errors, forces and failures are planted.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import Port
from flexgen.feedback.loop.result import ControlRun
from flexgen.views.plots import along_path, control


@cache
def run() -> ControlRun:
    plants = {name: {"stiffness": x} for name, x in (("soft", 0.8), ("stiff", 1.2))}
    return flexgen.control("elbow", controller="none", sample_time=2e-3, plants=plants)


def planted(moments: bool = False, failure: str = "") -> ControlRun:
    """The run with waves of errors, with a wall at two robots, and with forces along y."""
    given = run()
    wave = np.sin(given.reference.time)
    force = np.zeros((len(wave), 6))
    force[:, 1] = wave
    force[:, 4] = moments * wave
    error = np.stack([1e-3 * wave, 0.0 * wave], axis=1)
    contact = np.outer(wave, [3.0, 0.0, -4.0])
    nominal, soft, stiff = given.runs
    runs = (
        replace(nominal, error=error, contact=contact),
        replace(soft, error=3.0 * error, contact=contact, failure=failure),
        replace(stiff, error=2.0 * error),
    )
    motion = {**given.reference.motion, "force": 0.5 * force}
    reference = replace(given.reference, motion=motion)
    return replace(given, runs=runs, force=force, reference=reference)


def lines_of(ax: Any) -> dict[str, np.ndarray]:
    return {str(line.get_label()): np.asarray(line.get_ydata()) for line in ax.lines}


@needs_compiler
@pytest.mark.parametrize("failure", ["", "unstable at 1 s"])
def test_a_run_is_drawn_with_its_errors_torques_and_forces(failure: str) -> None:
    """Robots that fail are named, without a line and outside of the range of the others."""
    given = planted(failure=failure)
    top, bottom, force, wall = control.plot_control(given).axes
    time = given.reference.time
    wave = np.abs(np.sin(time))
    expected = {"nominal": wave, "soft": 3 * wave, "stiff": 2 * wave}
    if failure:
        del expected["soft"]
        assert len(lines_of(top)[f"soft: {failure}"]) == 0
    found = {name: x for name, x in lines_of(top).items() if len(x)}
    assert list(found) == list(expected) and top.get_ylabel() == "output error, mm"
    for name, values in expected.items():
        assert_allclose(found[name], values, atol=1e-12)
    (band,) = top.collections
    assert band.get_paths()[0].vertices[:, 1].max() == pytest.approx(
        (2 if failure else 3) * wave.max()
    )
    for j, motor in enumerate(given.model.motors):
        assert_allclose(lines_of(bottom)[motor.name], given.nominal.tau_m[:, j])
    assert bottom.get_ylabel() == "torque of the model, N m"
    assert list(lines_of(force)) == ["fy", "fy, assumed"]
    for line, share in zip(force.lines, (1.0, 0.5), strict=True):
        assert_allclose(line.get_ydata(), share * np.sin(time))
    assert force.get_ylabel() == "force, N" and wall.get_ylabel() == "force of the wall, N"
    assert list(lines_of(wall)) == ["nominal", "soft"][: 1 if failure else 2]
    assert_allclose(lines_of(wall)["nominal"], 5.0 * wave)
    first = max(time[0], given.reference.begin - 0.2)
    assert top.get_xlim() == pytest.approx((first, time[-1]))
    assert wall.get_xlabel() == "time, s (grey: path)"


@needs_compiler
def test_a_run_without_forces_has_two_axes_and_of_one_robot_no_range() -> None:
    given = run()
    alone = control.plot_control(replace(given, runs=given.runs[:1]))
    assert len(alone.axes) == 2 and not alone.axes[0].collections
    more = control.plot_control(planted(moments=True))
    assert more.axes[2].get_ylabel() == "force, N; moment, N m"
    assert more.get_size_inches()[1] - alone.get_size_inches()[1] == pytest.approx(2 * 1.8)


@needs_compiler
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("moments", [False, True])
def test_the_page_of_a_run_has_the_forces_of_its_process(moments: bool, tmp_path: Path) -> None:
    given = planted(moments)
    page = given.report(tmp_path).read_text(encoding="utf-8").replace(' class="n"', "")
    largest = np.abs(given.force).max()
    for part, unit in (("force", "N"), ("moment", "N m"))[: 1 + moments]:
        for words, share in (
            ("of the process on the tool", 1.0),
            ("that the feedforward assumes", 0.5),
            ("of the feedforward less that of the process", 0.5),
        ):
            row = f"<td>{part} {words}, largest</td><td>{share * largest:.4g} {unit}</td>"
            assert row in page
    assert ("moment of" in page) == moments


@cache
def solutions() -> tuple[flexgen.Solution, ...]:
    """A method that is exact, and one that is not."""
    return tuple(flexgen.solve("elbow", "line", method=x) for x in ("closed-form", "rigid"))


def test_errors_of_methods_begin_shortly_before_the_path() -> None:
    """Six hundredths of its time; zeros are shown at half of the floor, a thousandth of the least
    error.
    """
    exact, rigid = solutions()
    (ax,) = along_path.errors_of_methods(exact.model, (exact, rigid)).axes
    sizes = [np.linalg.norm(x.simulation.trajectory["error"], axis=1) for x in (exact, rigid)]
    word, unit = ax.get_ylabel().split(", ")
    factor = {"mm": 1e3, "µm": 1e6}[unit]
    assert word == "distance" and 1.0 <= factor * sizes[1].max() < 1000.0
    floor = 1e-3 * sizes[0].max()
    lines = lines_of(ax)
    for name, size in zip(("closed-form", "rigid"), sizes, strict=True):
        (drawn,) = [x for label, x in lines.items() if label.startswith(f"{name}: ")]
        assert_allclose(drawn, factor * np.maximum(size, 0.5 * floor))
    assert f"rigid: {factor * sizes[1].max():.3g} {unit}" in lines
    start = max(exact.trajectory.time[0], -0.06 * exact.move.duration)
    last = max(one.trajectory.time[-1] for one in (exact, rigid))
    assert ax.get_xlim() == pytest.approx((start, last))
    assert_allclose(ax.get_ylim(), [factor * floor, 4 * factor * sizes[1].max()])
    assert ax.get_yscale() == "log"


def test_angles_have_axes_of_their_own_and_a_motion_without_errors_is_refused() -> None:
    exact, rigid = solutions()
    done = rigid.simulation.trajectory
    turn = 2e-5 * np.sin(done.time)[:, None]
    turned = replace(
        done,
        channels={**done.channels, "turn": turn},
        ports={**done.ports, "turn": Port("turn", (1,), "rad", "turn of the tool")},
        labels={**done.labels, "turn": ("angle",)},
    )
    other = replace(rigid, simulation=replace(rigid.simulation, trajectory=turned))
    _, ax = along_path.errors_of_methods(exact.model, (exact, other)).axes
    assert ax.get_ylabel() == "angle, µrad"
    (drawn,) = [x for name, x in lines_of(ax).items() if name.startswith("rigid: ")]
    size = 1e6 * np.abs(turn[:, 0])
    assert_allclose(drawn, np.maximum(size, 0.5e-3 * size.max()))
    bare = replace(exact, simulation=None)
    with pytest.raises(ArgumentError, match="given only solutions without verification, expected"):
        along_path.errors_of_methods(exact.model, (bare,))
