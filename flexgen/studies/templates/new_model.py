"""New model files with plausible numbers: from a template, or as an overlay on a URDF file."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import c_name_problem
from flexgen.studies.templates.link_beam import with_link
from flexgen.studies.templates.payload_beam import read_beam
from flexgen.studies.templates.template_names import FLEXIBLE_LINK, TEMPLATES
from flexgen.studies.templates.urdf_overlay import Overlay, overlay_of_urdf


def new_model(
    name: str,
    template: str = "planar",
    urdf: str | None = None,
    folder: str | Path = ".",
    payload: str | None = None,
    link: str | None = None,
) -> str:
    """The text of a new model file.

    Parameters
    ----------
    name : str
        Of the robot.
    template : str
        One of `TEMPLATES`.
    urdf : str, optional
        Instead of a template: ``FILE.urdf#BASE:TIP``; without ``#BASE:TIP`` from the root to the
        link behind the most
        moving joints. What the file lacks or has wrong is repaired by keys of the overlay, each
        with a comment.
    folder : path
        Where the file will be, for the path to the URDF file.
    payload : str, optional
        Of a URDF file: an elastic beam on the tip of a robot that takes positions, such as
        ``beam:length=0.52,width=0.08,height=0.001,modulus=190e9,density=7870,angle_deg=30``
        (`flexgen.studies.templates.payload_beam`).
    link : str, optional
        Of the template ``flexible-link``: its elastic link from a drawing, such as
        ``beam:length=0.8,width=0.06,height=0.012,modulus=70e9,density=2700``
        (`flexgen.studies.templates.link_beam`).

    Returns
    -------
    str
        Comments state the unit of each number.

    Raises
    ------
    ArgumentError, ModelError
        The name is not an identifier; there is no such template; the URDF file has errors that no
        overlay repairs.
    """
    return new_overlay(name, template, urdf, folder, payload, link).text


def new_overlay(
    name: str,
    template: str = "planar",
    urdf: str | None = None,
    folder: str | Path = ".",
    payload: str | None = None,
    link: str | None = None,
) -> Overlay:
    """A new model file, and what was repaired for it; the arguments are those of `new_model`."""
    problem = c_name_problem(name)
    if problem is not None:
        stem = Path(name).stem
        if name.endswith(".toml") and c_name_problem(stem) is None:
            problem = f"the name of the robot, {stem}: its file gets .toml; --out states another"
        raise ArgumentError(f"name: given {name!r}, expected {problem}")
    if payload is not None and urdf is None:
        raise ArgumentError("payload: given without a URDF file, expected --urdf FILE as well")
    if link is not None and (urdf is not None or template != FLEXIBLE_LINK):
        raise ArgumentError(
            f"link: given for another robot, expected --template {FLEXIBLE_LINK} as well"
        )
    if urdf is not None:
        beam = None if payload is None else read_beam(payload)
        return overlay_of_urdf(name, urdf, Path(folder), beam)
    if template not in TEMPLATES:
        raise ArgumentError(
            f"template: given {template!r}, expected one of {', '.join(TEMPLATES)}"
        )
    text = (files("flexgen.studies.templates") / f"{template}.toml").read_text(encoding="utf-8")
    if link is not None:
        text = with_link(text, read_beam(link, "link"))
    return Overlay(f'name = "{name}"\n' + text.partition("\n")[2])
