"""Calibration of arms with slides, and where the poses do not separate zeros and places: widths
and convergence.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.poses.parameters import GROUPS, Priors, unknowns_of
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tree import Tree
from flexgen.model.elements import RobotModel

TRACKERS = [
    {"name": "flange", "type": "tracker", "unit": "m", "position": [0.05, 0.02, 0.1]},
    {
        "name": "elbow",
        "type": "tracker",
        "unit": "m",
        "element": "body4",
        "position": [0.1, 0.0, 0.05],
    },
]
SLIDES = (("x", [1, 0, 0], 4e5), ("y", [0, 1, 0], 3e5), ("z", [0, 0, 1], 2e5))
TURNS = (("a", [0, 0, 1], 1e4), ("b", [1, 0, 0], 6e3))


def gantry(folder: Path) -> RobotModel:
    """Three slides and two turning axes with elastic gears, and a bearing that tilts."""
    text = 'name = "gantry"\ngravity = [0, 0, -9.81]\nhome_rad = [0, 0, 0, 0, 0]\n'
    for name, axis, stiffness in (*SLIDES, *TURNS):
        kind = "translation" if name in "xyz" else "rotation"
        spring = f'{{ type = "linear", stiffness = {stiffness} }}'
        text += (
            f'[[element]]\nname = "e{name}"\norigin = {{ position = [0.1, 0.1, -0.2] }}\n'
            f"body = {{ mass = 10, com = [0.1, 0.1, -0.2], inertia = [1, 1, 1] }}\n"
            f'[[element.dof]]\nname = "{name}"\ntype = "{kind}"\naxis = {axis}\n'
            f'gear = {{ type = "elastic", side = "arm", spring = {spring} }}\n'
        )
        if name == "y":
            text += (
                '[[element.dof]]\nname = "bearing"\ntype = "rotation"\naxis = [1, 0, 0]\n'
                'spring = { type = "linear", stiffness = 5e4 }\n'
            )
    for name, _, _ in (*SLIDES, *TURNS):
        text += f'[[motor]]\nname = "m_{name}"\ndrives = "{name}"\nratio = 100\ninertia = 1e-4\n'
    text += '[output]\ntype = "joint"\njoints = ["x", "y", "z", "a", "b"]\n'
    for name, element in (("hand", "eb"), ("car", "ez")):
        text += (
            f'[[sensor]]\nname = "{name}"\ntype = "tracker"\nunit = "m"\nelement = "{element}"\n'
        )
        text += "position = [0.2, 0.1, -0.1]\n"
    (folder / "gantry.toml").write_text(text, encoding="utf-8")
    return flexgen.read(folder / "gantry.toml")


def of_drawn(
    model: RobotModel, q: np.ndarray, noise: float, seed: int
) -> tuple[flexgen.Calibration, np.ndarray]:
    """The calibration of a robot drawn from the priors, and its true numbers."""
    tree = Tree(model)
    unknowns = unknowns_of(tree, GROUPS, (), Priors())
    rng = np.random.default_rng(seed)
    x = np.array([u.start + (0.3 if u.kind == "frame" else u.sd) * rng.normal() for u in unknowns])
    x = np.where([u.kind == "compliance" for u in unknowns], np.abs(x), x)
    seen = Statics(tree, q).rest(Numbers.of(tree, unknowns, x)).measured
    seen += noise * np.random.default_rng(seed).normal(size=seen.shape)
    return flexgen.calibrate(model, flexgen.StaticPoses(q, seen), folds=0), x


@pytest.mark.parametrize("seed", [10, 13])
def test_lengths_across_an_angle_that_is_not_determined_have_their_width(seed: int) -> None:
    """Along the arc of the angle the length changes with its square: 8 and 10 standard deviations
    of the tangent.
    """
    model = flexgen.read("manutec_r3_18", overrides={"sensor": TRACKERS})
    found, true = of_drawn(
        model, np.random.default_rng(seed).uniform(-1.5, 1.5, (60, 6)), 1e-4, seed
    )
    size = [
        abs(x - y) / found.sd[u.name]
        for u, x, y in zip(found.unknowns, found.x, true, strict=True)
        if u.kind != "frame" and found.sd[u.name] > 0.0
    ]
    assert len(size) > 70
    assert max(size) < 4.0
    assert 0.8 < np.sqrt(np.mean(np.square(size))) < 1.2


@pytest.mark.parametrize("seed", [0, 1, 2, 12])
def test_the_search_follows_a_valley_that_bends(seed: int, tmp_path: Path) -> None:
    """All groups of a gantry: without the bend of the valley four of ten searches crawl, and end
    before a minimum.
    """
    q = np.random.default_rng(seed).uniform(-1.0, 1.0, (60, 5)) * [0.5, 0.5, 0.5, 1.4, 1.4]
    found, _ = of_drawn(gantry(tmp_path), q, 5e-5, seed)
    assert found.converged
    assert found.errors.mean() < 1e-4


def test_units_of_slides_are_named_and_what_stays_unexplained_is_warned(tmp_path: Path) -> None:
    """A joint that is commanded relative to the one before leaves a third of the motion: no single
    mistake.
    """
    model = gantry(tmp_path)
    turns = np.array([0, 0, 0, 1, 1])
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 5)) * [0.5, 0.5, 0.5, 1.4, 1.4]
    seen = flexgen.tracker_positions(model, q)
    for words, factor in (("mm, read as m", 1e3), ("m, read as mm", 1e-3)):
        wrong = flexgen.StaticPoses(np.where(turns, q, factor * q), seen)
        with pytest.raises(ArgumentError, match=f"probably slides in {words}"):
            flexgen.calibrate(model, wrong, folds=0)
    assert (
        flexgen.calibrate(model, flexgen.StaticPoses(q, seen), free=["zeros"], folds=0).warnings
        == ()
    )
    q[:, 2] -= q[:, 1]
    found = flexgen.calibrate(model, flexgen.StaticPoses(q, seen), free=["zeros"], folds=0)
    assert "of the motion of the trackers unexplained" in found.warnings[0]
