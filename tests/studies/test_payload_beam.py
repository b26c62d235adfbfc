"""The hinge of a beam: Euler and Bernoulli in closed form, finite elements with gravity, and the
files of 'flexgen new --payload'.
"""

from __future__ import annotations

import numpy as np
import pytest
from panda import BEAM, panda_urdf

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.studies.templates import payload_beam
from flexgen.studies.templates.payload_beam import Beam, hinge_of, mode_numbers, read_beam

ELEMENTS = 30  # cubic ones: the first mode is exact to 1e-7
GRAVITY = 9.81  # m/s^2


def beam_of_elements(beam: Beam) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass matrix, stiffness, and stiffness by gravity along the beam (away from the flange), of
    a clamped beam of cubic elements: deflection and slope of each node but the first.
    """
    n = ELEMENTS
    h = beam.length / n
    mu = beam.density * beam.width * beam.height
    bending = beam.modulus * beam.width * beam.height**3 / 12
    M, K, G = (np.zeros((2 * n + 2, 2 * n + 2)) for _ in range(3))
    m = (
        mu
        * h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
            ]
        )
    )
    k = (
        bending
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
    )
    g = (
        1
        / (30 * h)
        * np.array(
            [
                [36, 3 * h, -36, 3 * h],
                [3 * h, 4 * h**2, -3 * h, -(h**2)],
                [-36, -3 * h, 36, -3 * h],
                [3 * h, -(h**2), -3 * h, 4 * h**2],
            ]
        )
    )
    for e in range(n):
        at = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
        tension = mu * GRAVITY * (beam.length - (e + 0.5) * h)
        M[at] += m
        K[at] += k
        G[at] += tension * g
    return M[2:, 2:], K[2:, 2:], G[2:, 2:]


def first_frequency(M: np.ndarray, K: np.ndarray) -> float:
    """Lowest natural frequency [rad/s]."""
    return float(np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.min()))


def planted(monkeypatch) -> None:
    """A hinge at the flange, as the effective mass alone suggests: gravity is 12 % too weak."""
    found = mode_numbers()
    monkeypatch.setattr(payload_beam, "mode_numbers", lambda: (*found[:2], 1 / found[1]))


def test_numbers_of_the_mode_are_those_of_the_closed_form():
    """``int phi = 2 s / l``, ``int x phi = 2 / l^2``, ``int phi^2 = 1``."""
    lam = 1.875104068711961
    assert np.cos(lam) * np.cosh(lam) == pytest.approx(-1.0, abs=1e-12)
    s = (np.sinh(lam) - np.sin(lam)) / (np.cosh(lam) + np.cos(lam))
    mass, center, _ = mode_numbers()
    assert mass == pytest.approx(4 * s**2 / lam**2, rel=1e-10)
    assert center == pytest.approx(1 / (lam * s), rel=1e-10)
    assert (round(mass, 4), round(center, 4)) == (0.6131, 0.7265)


def hinge_frequency(beam: Beam, gravity: float) -> float:
    """Of the pendulum with the spring, gravity along the beam away from the flange [rad/s]."""
    hinge = hinge_of(beam)
    inertia = hinge.mass * hinge.reach**2
    return float(np.sqrt((hinge.stiffness + hinge.mass * gravity * hinge.reach) / inertia))


@pytest.mark.parametrize("direction", [0.0, 1.0, -1.0])
def test_frequency_is_that_of_finite_elements_also_under_gravity(direction):
    beam = Beam(**BEAM)
    M, K, G = beam_of_elements(beam)
    expected = first_frequency(M, K + direction * G)
    assert hinge_frequency(beam, direction * GRAVITY) == pytest.approx(expected, rel=5e-4)


def test_the_planted_hinge_at_the_flange_is_seen(monkeypatch):
    planted(monkeypatch)
    beam = Beam(**BEAM)
    M, K, G = beam_of_elements(beam)
    expected = first_frequency(M, K - G)
    assert abs(hinge_frequency(beam, -GRAVITY) / expected - 1) > 4e-3


def test_force_and_moment_on_the_flange_are_those_of_finite_elements():
    """Flange that accelerates or turns: the first mode of the elements and their rigid rest."""
    beam = Beam(**BEAM)
    M, K, _ = beam_of_elements(beam)
    values, modes = np.linalg.eig(np.linalg.solve(M, K))
    phi = modes[:, int(np.argmin(values.real))].real
    x = np.linspace(0.0, beam.length, ELEMENTS + 1)[1:]
    shift = np.ravel(np.column_stack([np.ones_like(x), np.zeros_like(x)]))
    turn = np.ravel(np.column_stack([x, np.ones_like(x)]))
    power = phi @ M @ phi
    hinge = hinge_of(beam)
    at = hinge.offset + hinge.reach
    assert hinge.mass == pytest.approx((phi @ M @ shift) ** 2 / power, rel=1e-3)
    assert at == pytest.approx(phi @ M @ turn / (phi @ M @ shift), rel=1e-3)


def test_the_whole_has_mass_center_and_inertia_of_the_beam():
    beam = Beam(**BEAM)
    hinge = hinge_of(beam)
    mass = beam.density * beam.length * beam.width * beam.height
    at = hinge.offset + hinge.reach
    assert hinge.mass + hinge.rest_mass == pytest.approx(mass)
    moment = hinge.mass * at + hinge.rest_mass * hinge.rest_com
    assert moment == pytest.approx(mass * beam.length / 2)
    about = hinge.mass * at**2 + hinge.rest_mass * hinge.rest_com**2 + hinge.rest_inertia[1]
    assert about == pytest.approx(mass * beam.length**2 / 3)


def text_of(beam: dict[str, float]) -> str:
    return "beam:" + ",".join(f"{key}={value!r}" for key, value in beam.items())


def test_new_writes_a_robot_with_the_beam_on_its_flange(tmp_path, capsys):
    (tmp_path / "panda.urdf").write_text(panda_urdf(), encoding="utf-8")
    urdf = f"{tmp_path / 'panda.urdf'}#link0:flange"
    out = tmp_path / "arm.toml"
    given = text_of({**BEAM, "angle_deg": 30.0, "damping": 0.015})
    assert main(["new", "arm", "--urdf", urdf, "--payload", given, "--out", str(out)]) == 0
    capsys.readouterr()
    robot = flexgen.read(out)
    assert (robot.n_g, robot.n_e) == (7, 1)
    assert robot.coordinates[-1].name == "payload_bend"
    M, K, _ = beam_of_elements(Beam(**BEAM))
    still = flexgen.read(out, overrides={"gravity": [0.0, 0.0, 0.0]})
    zeros = [z for z in flexgen.analyze(still).zeros.zeros if abs(z.imag) > 1.0]
    w = first_frequency(M, K)
    assert np.abs(zeros) == pytest.approx(w, rel=1e-3)
    assert -np.real(zeros) / w == pytest.approx(0.015, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("plate:length=1", "given 'plate', expected beam:"),
        ("beam", "given no length, width, height, modulus, density"),
        ("beam:length=1,length=2", "once"),
        ("beam:size=1", "given 'size'"),
        (text_of({**BEAM, "width": -1.0}), "width: given '-1.0', expected a number > 0"),
        (text_of({**BEAM, "damping": 2.0}), "damping: given '2.0', expected a number 0 to 1"),
        (text_of({**BEAM, "height": 0.1}), "one that is slender"),
    ],
)
def test_invalid_beams_are_refused(text, words):
    with pytest.raises(ArgumentError, match=words):
        read_beam(text)


def test_a_payload_needs_a_urdf_file(tmp_path, capsys):
    out = str(tmp_path / "arm.toml")
    assert main(["new", "arm", "--payload", text_of(BEAM), "--out", out]) == 1
    assert "--payload: given without --urdf" in capsys.readouterr().err
