"""A robot without any spring: predictions, fastest motions, loop and self-test of a slide with a
direct drive.

(m + J n^2) a = n u,     w = v_ref + k_p (q_ref - q) - v,     u = u_ff + k_v (w + k_i int w dt)
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from one_axis import one_axis
from scipy.integrate import solve_ivp
from toolchain import needs_compiler, tool

import flexgen
from flexgen.base.errors import ArgumentError

MASS = 80.0
RATIO = 300.0
ROTOR = 1e-3
SD = 0.03
WAY = 0.3  # m
DURATION = 0.5  # s
LARGEST = 10.0  # N m
RIGID = '{ type = "rigid" }'
SLIDE = one_axis("slide", RIGID, mass=MASS, ratio=RATIO, rotor=ROTOR, way=WAY, duration=DURATION)
SLIDE += f"[uncertainty]\nmasses = {SD}\n"


@pytest.fixture
def slide(tmp_path: Path) -> Path:
    file = tmp_path / "slide.toml"
    file.write_text(SLIDE)
    return file


def acceleration(t: float) -> float:
    """Of the path: its speed is as (s (1 - s))^5."""
    s = min(max(t / DURATION, 0.0), 1.0)
    return WAY * 2772 * 5 * (s - s * s) ** 4 * (1 - 2 * s) / DURATION**2


def largest_error(share: float, k_p: float, k_v: float, k_i: float) -> float:
    """Largest error [m] of a slide that is heavier by this share, under the feedforward of the
    right one.
    """
    inertia = MASS / RATIO + ROTOR * RATIO  # u = inertia a

    def rate(t: float, x: np.ndarray) -> list[float]:
        e, de, total = x  # of the slide, its speed, and the integral of w
        w = -RATIO * (k_p * e + de)
        u = k_v * (w + k_i * total) - share * MASS / RATIO * acceleration(t)
        return [de, u / (inertia + share * MASS / RATIO), w]

    found = solve_ivp(
        rate, (0.0, 3 * DURATION), [0.0, 0.0, 0.0], rtol=1e-9, atol=1e-14, max_step=2e-3
    )
    return float(np.abs(found.y[0]).max())


def test_the_predicted_error_is_that_of_slides_of_other_masses(slide):
    found = flexgen.predict(slide, progress=False)
    gains = (
        float(x[0])
        for x in (
            found.feedback.position_gain,
            found.feedback.speed_gain,
            found.feedback.integral_gain,
        )
    )
    of_one = largest_error(SD, *gains)
    assert 1.5 * of_one < found.error_m < 2.5 * of_one  # 1.96 of very many robots
    assert found.deflection.names == () and found.plot() is not None


def test_the_fastest_motion_keeps_its_torque_and_has_no_vibration(slide):
    limits = flexgen.Limits(torque=(LARGEST,))
    quick = flexgen.fastest(slide, limits=limits, progress=False)
    t = np.linspace(0.0, quick.duration_s, 2001)
    a = flexgen.plan(slide, quick.move).sample(t).y[:, 0, 2]
    torque = (MASS / RATIO + ROTOR * RATIO) * a
    assert np.abs(torque).max() == pytest.approx(LARGEST, rel=2e-3)
    least = 2 * np.sqrt(WAY * (MASS / RATIO + ROTOR * RATIO) / LARGEST)
    assert least < quick.duration_s < 1.25 * least and quick.rigid_s == pytest.approx(
        least, rel=0.01
    )
    assert quick.vibration == {} and "vibration" not in str(quick)
    with pytest.raises(ArgumentError, match="vibration: given for slide, which has no springs"):
        flexgen.fastest(slide, limits=limits, vibration=1e-5)
    left = flexgen.fastest(slide, limits=limits, against="95 %", progress=False)
    assert left.duration_s > quick.duration_s and left.margin[0] > 0.0


def test_a_direct_drive_with_bristles_moves_in_the_loop_as_its_equations(slide):
    """The torques of the loop, held, move a slide with the LuGre law as its own equations do."""
    coulomb = 0.2
    static = 0.3
    speed = 5.0
    stiffness = 300.0
    damping = 0.4
    law = {
        "coulomb": coulomb,
        "static": static,
        "stribeck_speed": speed,
        "stiffness": stiffness,
        "damping": damping,
    }
    robot = flexgen.read(slide, overrides={"motor.m1.lugre": law})
    run = flexgen.control(
        robot, plants={"heavy": {"payload": 2.0}}, sample_time=1e-3, progress=False
    )
    time = run.reference.time
    heavy = run["heavy"]
    assert np.abs(heavy.error).max() > 1e-5 and run.tool_error_max_m < 1e-8
    first, last = np.searchsorted(time, [-0.01, DURATION + 0.1])
    mass = (MASS + 2.0) / RATIO + ROTOR * RATIO

    def rate(t: float, x: np.ndarray, torque: float) -> list[float]:
        v = RATIO * x[1]
        z = x[2]
        sliding = coulomb + (static - coulomb) * np.exp(-((v / speed) ** 2))
        dz = v - stiffness * abs(v) * z / sliding
        return [x[1], (torque - stiffness * z - damping * dz) / mass, dz]

    x = np.array([heavy.q_a[first, 0], 0.0, 0.0])
    found = []
    for k in range(first, last):
        found.append(x[0])
        held = solve_ivp(
            rate, time[k : k + 2], x, "Radau", args=(heavy.tau_m[k, 0],), rtol=1e-8, atol=1e-13
        )
        x = held.y[:, -1]
    np.testing.assert_allclose(found, heavy.q_a[first:last, 0], atol=2e-8)  # m, of 0.3 m


@needs_compiler
def test_the_self_test_of_one_coordinate_is_written_and_passes(slide, tmp_path):
    folder = tmp_path / "selftest"
    flexgen.export_selftest(slide, folder)
    sources = ["slide.c", "slide_selftest.c"]
    subprocess.run([tool("gcc"), "-O1", *sources, "-lm", "-o", "selftest"], cwd=folder, check=True)
    run = subprocess.run(["./selftest"], cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0 and run.stdout.startswith("PASS"), run.stdout


def test_an_excitation_of_a_robot_without_springs_asks_for_parameters(slide: Path) -> None:
    """It named 'stiffness', which was not given; a viscous friction is a number that can be
    found.
    """
    band = {"f_min": 1.0, "f_max": 50.0, "poses": 1, "lines": 5, "progress": False}
    with pytest.raises(
        ArgumentError, match="free: given none, expected names: slide has no springs"
    ):
        flexgen.excite(slide, **band)  # type: ignore[arg-type]
    viscous = flexgen.read(slide, overrides={"motor.m1.friction": {"viscous": 0.01}})
    assert list(flexgen.excite(viscous, **band).predicted) == ["m1.viscous"]
