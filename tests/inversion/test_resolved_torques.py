"""`solve` resolves the motor torques; the references are motions by Fourier transforms.

The tool hardly follows a ripple of the torque between the nodes of a mesh, so the verification
does not show it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from clib_planted import plant_in_c
from scipy.interpolate import make_interp_spline
from selection import ROOT

import flexgen
from flexgen.codegen.emission import routines
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.inversion import refinement
from flexgen.inversion.methods import lq
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.paths.path import Path, find_move

LENGTH = 8.0  # s
N = 2**16  # samples: the motion rests long before the path and long after it
# gear and motor of four_mass, motor side
STIFFNESS = 100.0
DAMPING = 0.08
RATIO = 220.0
ROTOR = 5e-3
VISCOUS = 6e-3
J1 = 96.8
J2 = 968.0
J3 = 968.0
DRAG = 48.4
K2 = 5.324e6
D2 = 2904.0
K3 = 3.872e6
D3 = 3872.0
ALLOWED = 5e-3  # of the largest torque: what C `invert` accepts


@pytest.fixture
def robot(tmp_path) -> flexgen.RobotModel:
    """four_mass with a linear gear and a path read from a file, whose torque changes within
    hundredths of a second.
    """
    t = np.linspace(0, 1, 51)
    y = 0.05 * t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3) + 1e-4 * np.sin(
        np.pi * t
    ) ** 8 * np.sin(30 * np.pi * t)
    (tmp_path / "path.csv").write_text(
        "t,y1\n" + "".join(f"{a:.8f},{b:.8f}\n" for a, b in zip(t, y, strict=True))
    )
    move = '[[move]]\nname = "csv"\ntype = "sampled"\nfile = "path.csv"\nstart_rad = [0.0]\n'
    file = tmp_path / "four_mass.toml"
    text = (ROOT / "models/four_mass.toml").read_text()
    head, first, rest = text.partition("[[move]]")
    file.write_text(f"{head}{move}\n{first}{rest}")
    return flexgen.read(file, variant="high")


def torque_of(
    robot: flexgen.RobotModel, move: str, to_motor: Callable[..., np.ndarray]
) -> make_interp_spline:
    """Motor torque [N m] of a move over time [s]; to_motor: its transform, from s and that of the
    output's speed.
    """
    t = np.arange(N) * LENGTH / N - LENGTH / 2
    path = Path(flexgen.derive(robot), find_move(robot, move))
    speed = path.sample(np.clip(t, 0.0, path.duration)).y[:, 0, 1] * (
        (t > 0) & (t < path.duration)
    )
    s = 2j * np.pi * np.fft.rfftfreq(N, LENGTH / N)
    return make_interp_spline(t, np.fft.irfft(to_motor(s, np.fft.rfft(speed)), N), k=5)


def of_four_masses(s: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Torque of the motor of four_mass.

    Ratios of the angles a, b, c of the three masses, of the output 0.02 a + 0.6 b + 1.53 c and of
    the torques are functions of s; differences such as b - c are divided by s, so that the speed
    of the output is enough.
    """
    of_c = J3 * s**2 + DRAG * s + K3 + D3 * s
    # c/b and (1 - c/b)/s
    c = (K3 + D3 * s) / of_c
    lag_c = (J3 * s + DRAG) / of_c
    of_b = J2 * s**2 + DRAG * s + (K3 + D3 * s) * (1 - c) + K2 + D2 * s
    b = (K2 + D2 * s) / of_b
    lag_b = (J2 * s + DRAG + (K3 + D3 * s) * lag_c) / of_b
    v = speed / (0.02 + 0.6 * b + 1.53 * b * c)
    gear = (J1 * s + DRAG + (K2 + D2 * s) * lag_b) * v / RATIO
    v_m = RATIO * v + s * gear / (STIFFNESS + DAMPING * s)
    return ROTOR * s * v_m + VISCOUS * v_m + gear


def of_three_masses(s: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Torque of the motor of abb_arm with viscous friction: the gear follows the arm, whose spring
    its output gives.
    """
    # kg m^2
    motor = 0.0058957518371728
    gear = 0.020147233212829
    arm = 0.006874013724158
    v = speed + s * (arm * s * speed) / (20.23072060978318 + 0.00987527995798 * s)  # of the gear
    torque = gear * s * v + arm * s * speed
    v_m = v + s * torque / (20.59269827430799 + 0.0624181404729 * s)
    return motor * s * v_m + 0.00986346744839 * v_m + torque


def error_of(
    robot: flexgen.RobotModel,
    move: str = "csv",
    to_motor: Callable[..., np.ndarray] = of_four_masses,
    status: str = "solved",
) -> tuple[float, flexgen.Solution]:
    """Largest error of the torque of `solve`, relative to the largest torque, and the solution."""
    solution = flexgen.solve(robot, move, progress=False)
    assert solution.status == status
    expected = torque_of(robot, move, to_motor)(solution.trajectory.time)
    return float(
        np.abs(solution.trajectory["tau_m"][:, 0] - expected).max() / np.abs(expected).max()
    ), solution


def test_the_mesh_resolves_the_torques_of_a_path_from_a_file(robot, monkeypatch):
    """Planted: the first mesh is kept, on which the tool follows as well; its error refuses it."""
    error, solution = error_of(robot)
    assert error < ALLOWED and solution.details["converged"] and not solution.warnings
    monkeypatch.setattr(lq, "PARTS", ())
    monkeypatch.setattr(refinement, "estimate_ripple", lambda _: 0.0)
    error, solution = error_of(robot, status="tolerance not met")
    assert error > 10 * ALLOWED and not solution.details["converged"]
    assert 0.5 < solution.details["torque_error"] / error < 2.6
    assert any("estimated error" in text for text in solution.warnings)


def test_a_mesh_that_is_given_is_kept(robot):
    assert not flexgen.solve(robot, "csv", mesh=1e-2, progress=False).details["converged"]


@pytest.mark.slow
def test_motions_without_inertia_are_as_accurate(monkeypatch):
    """The zero of abb_arm at -2048 1/s: nothing damps what an interval leaves.

    Planted: positions as of other arms. They need many more intervals, and are worse.
    """
    arm = flexgen.read("abb_arm", variant="viscous")
    error, solution = error_of(arm, "turn", of_three_masses)
    assert error < 5e-4 and solution.intervals < 200 and not solution.warnings
    monkeypatch.setattr(routines, "is_massless", lambda *_: False)
    error, solution = error_of(replace(arm, name="abb_other"), "turn", of_three_masses)
    assert error > 1e-3 and solution.intervals > 300


def test_a_last_element_without_inertia_is_a_motion_without_inertia(tmp_path):
    """Neither mass nor inertia at the end of the chain: no units for the row of its coordinate."""
    text = (ROOT / "models/abb_arm.toml").read_text()
    head, last, rest = text.partition('name = "arm"\n')
    line, _, rest = rest.partition("\n")
    assert line.startswith("body = { mass = 1.0")
    (tmp_path / "abb_end.toml").write_text(f"{head}{last}body = {{ mass = 0.0 }}\n{rest}")
    equations = flexgen.derive(flexgen.read(tmp_path / "abb_end.toml"))
    assert routines.is_massless(equations, ())
    assert not routines.is_massless(flexgen.derive("planar5_nmp"), ())


def torques_by_samples(period: float, folder: Path) -> tuple[np.ndarray, flexgen.Inversion]:
    """Torques of planar5_nmp at each millisecond, on intervals of ten samples or 2 ms, and the
    inversion.
    """
    equations = flexgen.derive("planar5_nmp")
    each = max(1, round(1e-3 / period))
    written = flexgen.generate(equations, folder / str(each), functions=INVERSION, progress=False)
    library = flexgen.load(written.directory)
    path = flexgen.plan(equations)
    given = samples(Reduction(equations), path, period, round(path.duration / period) + 1)
    around = {"n_pre": 100 * each, "n_post": 100 * each, "q_start": path.q_start}
    found = library.invert(
        *given, period=period, samples_per_interval=10 if each > 1 else 2, **around
    )
    return found.tau_m[::each], found


@pytest.mark.slow
def test_a_dense_sampling_leaves_no_noise_in_the_torques(tmp_path, monkeypatch):
    """The difference of two positions has too few digits for accelerations. Planted: these as for
    longer periods.
    """
    expected, _ = torques_by_samples(1e-3, tmp_path)
    torque, found = torques_by_samples(1e-3 / 32, tmp_path)
    assert (
        found.torque_error < 1e-6
        and np.abs(torque - expected).max() < 1e-6 * np.abs(expected).max()
    )
    plant_in_c(monkeypatch, "path.h", "T < 4e-4", "T < 0.0")
    torque, found = torques_by_samples(1e-3 / 32, tmp_path / "planted")
    assert (
        found.torque_error > 1e-5
        and np.abs(torque - expected).max() > 1e-5 * np.abs(expected).max()
    )
