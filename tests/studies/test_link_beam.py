"""An elastic link from its drawing: numbers of the section, and the template that has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.studies.templates.link_beam import section_of
from flexgen.studies.templates.new_model import new_model
from flexgen.studies.templates.payload_beam import Beam

WIDE = 0.05
HIGH = 0.02
LINK = f"beam:length=0.7,width={WIDE},height={HIGH},modulus=7e10,density=2700,damping=0.02"


def torsion_constant(points: int) -> float:
    """Torsion constant of the rectangle [m^4], from Prandtl's stress function by differences."""
    x = np.linspace(-WIDE / 2, WIDE / 2, 2 * points + 1)
    y = np.linspace(-HIGH / 2, HIGH / 2, points + 1)
    nx = len(x) - 2
    ny = len(y) - 2
    second_x = (np.eye(nx, k=1) - 2 * np.eye(nx) + np.eye(nx, k=-1)) / (x[1] - x[0]) ** 2
    second_y = (np.eye(ny, k=1) - 2 * np.eye(ny) + np.eye(ny, k=-1)) / (y[1] - y[0]) ** 2
    laplace = np.kron(second_x, np.eye(ny)) + np.kron(np.eye(nx), second_y)
    stress = np.linalg.solve(laplace, -2 * np.ones(nx * ny))
    return float(2 * stress.sum() * (x[1] - x[0]) * (y[1] - y[0]))


def test_the_section_has_the_stiffnesses_of_its_drawing() -> None:
    found = section_of(Beam(0.7, WIDE, HIGH, 7e10, 2700.0))
    width = np.linspace(-WIDE / 2, WIDE / 2, 2001)
    height = np.linspace(-HIGH / 2, HIGH / 2, 2001)
    along_height = WIDE * np.trapezoid(height**2, height)
    along_width = HIGH * np.trapezoid(width**2, width)
    assert found.thin == pytest.approx(7e10 * along_height, rel=1e-5)
    assert found.wide == pytest.approx(7e10 * along_width, rel=1e-5)
    assert found.polar == pytest.approx(2700 * (along_height + along_width), rel=1e-5)
    shear = 7e10 / 2.6
    assert found.torsion == pytest.approx(shear * torsion_constant(24), rel=0.02)
    # the planted error: the polar moment of area in place of the torsion constant
    assert found.torsion < 0.6 * shear * (along_height + along_width)


def test_a_link_of_the_command_line_is_in_the_robot(tmp_path: Path) -> None:
    out = tmp_path / "arm.toml"
    assert main(["new", "lab", "--link", LINK, "--out", str(out)]) == 0
    robot = flexgen.read(out)
    beam = next(element.beam for element in robot.elements if element.beam is not None)
    found = section_of(Beam(0.7, WIDE, HIGH, 7e10, 2700.0))
    assert (beam.length, beam.mass_per_length) == pytest.approx((0.7, found.per_length))
    assert [(b.direction, b.modes) for b in beam.bendings] == [("z", 1)]
    assert beam.bendings[0].stiffness == pytest.approx(found.thin, rel=1e-8)
    assert beam.tip is not None and beam.tip.mass == robot.payload.mass


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--link", LINK, "--template", "scara"], "expected --template flexible-link"),
        (["--link", LINK.replace("0.05", "0.01")], "a width that is not below the height"),
        (["--link", "beam:length=1"], "link: given no width"),
    ],
)
def test_links_that_do_not_fit_are_refused(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "arm.toml"
    assert main(["new", "lab", *options, "--out", str(out)]) == 1
    assert words in capsys.readouterr().err
    with pytest.raises(ArgumentError):
        new_model("lab", template="planar", link=LINK)
