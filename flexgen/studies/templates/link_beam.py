"""An elastic link from its drawing: length, rectangular section and material.

With width w >= height h, modulus E, shear modulus G = E / (2 (1 + nu)) and density rho:

    bending in the direction of the height   E I = E w h^3 / 12
    bending across it                        E I = E h w^3 / 12
    torsion                                  G J = G w h^3 (1/3 - 0.21 h/w (1 - h^4 / (12 w^4)))
    per length                               rho w h  and  rho (w h^3 + h w^3) / 12

Source: W. Young and R. Budynas, Roark's Formulas for Stress and Strain, 2002, table 10.1 (torsion
of rectangles, at most 4 % off).
"""

from __future__ import annotations

from dataclasses import dataclass

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.toml_text import toml
from flexgen.studies.templates.payload_beam import Beam

POISSON = 0.3  # ratio of steel, aluminium and most fiber composites across their fibers
# lines of the template between which its beam is written
FIRST = "[element.beam]"
LAST = "# end of the beam"


@dataclass(frozen=True)
class Section:
    """Numbers of a beam with a rectangular section.

    ``per_length`` [kg/m]; ``thin``, ``wide``: flexural stiffness in the direction of the height
    and of the width [N m^2]; ``torsion`` [N m^2]; ``polar``: moment of inertia per length [kg m].
    """

    per_length: float
    thin: float
    wide: float
    torsion: float
    polar: float


def section_of(beam: Beam) -> Section:
    """Numbers of a beam from its drawing; see the head of this module.

    Raises
    ------
    ArgumentError
        The height is above the width.
    """
    w = beam.width
    h = beam.height
    if h > w:
        raise ArgumentError(
            f"link: given a height of {h:g} m and a width of {w:g} m, expected a width that is "
            "not below the height: the link bends in the direction of its height"
        )
    shear = beam.modulus / (2.0 * (1.0 + POISSON))
    torsion = w * h**3 * (1.0 / 3.0 - 0.21 * h / w * (1.0 - (h / w) ** 4 / 12.0))
    return Section(
        per_length=beam.density * w * h,
        thin=beam.modulus * w * h**3 / 12.0,
        wide=beam.modulus * h * w**3 / 12.0,
        torsion=shear * torsion,
        polar=beam.density * (w * h**3 + h * w**3) / 12.0,
    )


def with_link(text: str, beam: Beam) -> str:
    """The template ``flexible-link`` with another beam."""
    before, _, rest = text.partition(FIRST)
    old, _, after = rest.partition(LAST)
    tip = next(line for line in old.splitlines() if line.startswith("tip ="))
    return before + "\n".join([*text_of_link(beam), tip, LAST]) + after


def text_of_link(beam: Beam) -> list[str]:
    """The lines of ``[element.beam]``: one mode in the plane, and those that a spatial arm has as
    comments.
    """
    found = section_of(beam)
    ratio = toml(beam.damping)
    return [
        FIRST,
        f"# {beam.length:g} x {beam.width:g} x {beam.height:g} m, modulus {beam.modulus:g} Pa, "
        f"{beam.density:g} kg/m^3",
        f"length = {_short(beam.length)}                   # m",
        f"mass_per_length = {_short(found.per_length)}     # kg/m",
        "# N m^2; the damping ratio is a guess unless it was measured",
        f'bending = [{{ direction = "z", stiffness = {_short(found.thin)}, modes = 1, '
        f"damping_ratio = {ratio} }}]",
        "# out of the plane, for an arm that moves in space:",
        f'#   {{ direction = "y", stiffness = {_short(found.wide)}, modes = 1, '
        f"damping_ratio = {ratio} }}",
        f"# torsion = {{ stiffness = {_short(found.torsion)}, inertia_per_length = "
        f"{_short(found.polar)}, modes = 1, damping_ratio = {ratio} }}",
    ]


def _short(value: float) -> str:
    """A number with nine digits."""
    return toml(float(f"{value:.9g}"))
