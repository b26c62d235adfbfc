"""Three arms: what their makers state, and a true robot of each, drawn from a seed.

`stated(name)` is the arm of the data sheet: bodies of CAD, stiffnesses of the catalogue, guessed
bearings. `draw(name, seed)` is a real one: bodies up to 5 % off, gears that are soft at no load,
other bearings, an elastic upper arm, friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.commissioning.chains import Axis, Body, Chain, Friction, Gear, Link

X = (1.0, 0.0, 0.0)
Y = (0.0, 1.0, 0.0)
Z = (0.0, 0.0, 1.0)
STIFFNESS_TO_DAMPING = 5e-4  # s: damper over spring, 1.5 % of critical at 10 Hz
NAMES = ("three_axes", "six_axes", "six_axes_on_column")


@dataclass(frozen=True)
class Traits:
    """Distance of a true robot from its data sheet."""

    body: float = 0.05  # largest relative error of the masses, centers and inertias of CAD
    gear: tuple[float, float] = (0.75, 1.0)  # true stiffness over that of the catalogue
    soft: tuple[float, float] = (0.55, 0.75)  # stiffness at no load over that under load
    bearing: float = 1.8  # largest factor between true and guessed stiffness of bearings
    friction: float = 1.0  # factor of all Coulomb and viscous torques
    elastic_link: bool = True  # the upper arm bends and twists in its middle
    relaxing: float = 0.0  # share of the Maxwell element in the stiffness of a gear
    error: float = 1.0  # factor of the transmission errors


def body(mass: float, com: list[float], inertia: list[float]) -> Body:
    """A body with principal moments along its axes."""
    return Body(mass, np.array(com), np.diag(inertia))


def spring(name: str, axis: tuple[float, float, float], stiffness: float) -> Axis:
    """A bearing or a column with its damper."""
    return Axis(name, axis, stiffness=stiffness, damping=STIFFNESS_TO_DAMPING * stiffness)


def gear(
    ratio: float, rotor: float, stiffness: float, torque_max: float, drive: tuple[float, ...]
) -> Gear:
    """As in the catalogue: linear, with a usual damper."""
    k_p, k_v, k_i = drive
    return Gear(
        ratio=ratio,
        rotor=rotor,
        stiffness=stiffness,
        damping=STIFFNESS_TO_DAMPING * stiffness,
        torque_max=torque_max,
        drive=(k_p, k_v, k_i),
    )


def shoulder() -> tuple[Link, ...]:
    """The first two links, which all three arms have."""
    one = gear(150.0, 2.0e-3, 6.0e5, 60.0, (25.0, 0.6, 8.0))
    two = gear(150.0, 2.0e-3, 6.0e5, 60.0, (25.0, 0.6, 8.0))
    return (
        Link(
            "turret",
            np.array([0.0, 0.0, 0.3]),
            (
                Axis("q1", Z, one, range=(-2.5, 2.5)),
                spring("t1x", X, 3.0e6),
                spring("t1y", Y, 3.0e6),
            ),
            body(60.0, [0.06, 0.0, 0.15], [1.5, 1.6, 1.4]),
        ),
        Link(
            "upper",
            np.array([0.15, 0.0, 0.35]),
            (
                Axis("q2", Y, two, range=(-1.8, 0.4)),
                spring("t2x", X, 1.5e6),
                spring("t2z", Z, 1.5e6),
            ),
            body(66.0, [0.42, 0.02, 0.0], [1.0, 6.6, 6.4]),
        ),
    )


def three_axes() -> Chain:
    """Turret, upper arm, forearm; 20 kg at its end; 184 kg in all."""
    three = gear(120.0, 1.2e-3, 3.0e5, 40.0, (25.0, 0.3, 8.0))
    forearm = Link(
        "fore",
        np.array([0.9, 0.0, 0.0]),
        (
            Axis("q3", Y, three, range=(0.3, 2.4)),
            spring("t3x", X, 5.0e5),
            spring("t3z", Z, 7.0e5),
        ),
        body(38.0, [0.32, 0.0, 0.02], [0.35, 2.9, 2.8]),
    )
    return Chain(
        "three_axes",
        (*shoulder(), forearm),
        tool=np.array([0.85, 0.0, 0.05]),
        payload=body(20.0, [0.80, 0.0, 0.03], [0.12, 0.15, 0.15]),
        ball=np.array([0.88, 0.06, 0.10]),
        home=(0.0, -0.8, 1.4),
    )


def wrist() -> tuple[Link, ...]:
    """Forearm and hand of the arms with six axes."""
    three = gear(120.0, 1.2e-3, 3.0e5, 40.0, (25.0, 0.3, 8.0))
    four = gear(100.0, 4.0e-4, 8.0e4, 12.0, (25.0, 0.08, 8.0))
    five = gear(100.0, 3.0e-4, 6.0e4, 10.0, (25.0, 0.06, 8.0))
    six = gear(80.0, 2.0e-4, 3.0e4, 6.0, (25.0, 0.03, 8.0))
    return (
        Link(
            "fore",
            np.array([0.9, 0.0, 0.0]),
            (
                Axis("q3", Y, three, range=(0.3, 2.4)),
                spring("t3x", X, 5.0e5),
                spring("t3z", Z, 7.0e5),
            ),
            body(26.0, [0.12, 0.0, 0.03], [0.35, 0.6, 0.6]),
        ),
        Link(
            "tube",
            np.array([0.4, 0.0, 0.05]),
            (Axis("q4", X, four, range=(-2.5, 2.5)),),
            body(14.0, [0.15, 0.0, 0.0], [0.08, 0.35, 0.35]),
        ),
        Link(
            "hand",
            np.array([0.4, 0.0, 0.0]),
            (Axis("q5", Y, five, range=(-1.8, 1.8)),),
            body(6.0, [0.05, 0.0, 0.0], [0.02, 0.03, 0.03]),
        ),
        Link(
            "flange",
            np.array([0.1, 0.0, 0.0]),
            (Axis("q6", X, six, range=(-2.8, 2.8)),),
            body(2.5, [0.02, 0.0, 0.0], [0.006, 0.005, 0.005]),
        ),
    )


def six_axes() -> Chain:
    """Shoulder of the arm with three axes and a wrist; 15 kg at the flange; 190 kg in all."""
    return Chain(
        "six_axes",
        (*shoulder(), *wrist()),
        tool=np.array([0.15, 0.0, 0.06]),
        payload=body(15.0, [0.10, 0.0, 0.04], [0.10, 0.12, 0.12]),
        ball=np.array([0.15, 0.08, 0.12]),
        home=(0.0, -0.8, 1.4, 0.3, -0.6, 0.0),
    )


def six_axes_on_column() -> Chain:
    """The arm with six axes on a column of 1 m that bends and twists below axis 1."""
    column = Link(
        "column",
        np.zeros(3),
        (
            spring("cx", X, 5.0e6),
            spring("cy", Y, 5.0e6),
            spring("cz", Z, 3.0e6),
        ),
        body(180.0, [0.0, 0.0, 0.5], [18.0, 18.0, 6.0]),
    )
    arm = six_axes()
    first = replace(arm.links[0], origin=np.array([0.0, 0.0, 1.0]))
    return replace(arm, name="six_axes_on_column", links=(column, first, *arm.links[1:]))


def drawn_body(stated: Body, share: float, random: np.random.Generator) -> Body:
    """Body with errors of mass, center and inertia up to this share of their size."""
    width = np.sqrt(np.diag(stated.inertia).max() / stated.mass)  # m: radius of gyration
    half = np.diag(np.sqrt(1.0 + share * random.uniform(-1, 1, 3)))
    return Body(
        stated.mass * (1.0 + share * random.uniform(-1, 1)),
        stated.com + share * width * random.uniform(-1, 1, 3),
        half @ stated.inertia @ half,
    )


def drawn_gear(stated: Gear, traits: Traits, random: np.random.Generator) -> Gear:
    """A true gear of this type with friction at motor and joint."""
    stiffness = stated.stiffness * random.uniform(*traits.gear)
    size = traits.friction * random.uniform(0.6, 1.4, 4)
    rated = 0.4 * stated.torque_max  # N m, motor side
    return replace(
        stated,
        stiffness=stiffness,
        damping=STIFFNESS_TO_DAMPING * stiffness * random.uniform(0.6, 1.6),
        soft=random.uniform(*traits.soft),
        width=0.08 * rated * stated.ratio / stiffness * random.uniform(0.7, 1.4),
        relaxing=traits.relaxing * stiffness,
        relaxation=random.uniform(0.05, 0.2),
        error=traits.error * random.uniform(0.5, 1.5) * 2e-5,
        motor_friction=Friction(2e-4 * rated * size[0], 0.025 * rated * size[1], 0.8),
        joint_friction=Friction(
            4e-3 * rated * stated.ratio * size[2], 5e-3 * rated * stated.ratio * size[3], 0.02
        ),
    )


def halves(link: Link, stated: Link, random: np.random.Generator) -> tuple[Link, Link]:
    """The link cut at half its length; between the halves bending and torsion.

    Mass, center and inertia of both together are those of the link.
    """
    length = 2.0 * stated.body.com[0]
    offset = np.array([0.25 * length, 0.0, 0.0])
    spread = link.body.mass * offset[0] ** 2 * np.diag([0.0, 1.0, 1.0])
    inertia = 0.5 * (link.body.inertia - spread)
    middle = np.array([0.5 * length, 0.0, 0.0])
    bending = 1.6e6 * random.uniform(0.7, 1.4, 3)
    axes = tuple(
        spring(f"{link.name}_{name}", axis, value)
        for name, axis, value in zip(
            ("twist", "bend_y", "bend_z"), (X, Y, Z), bending, strict=True
        )
    )
    inner = replace(link, body=Body(0.5 * link.body.mass, link.body.com - offset, inertia))
    outer = Link(
        f"{link.name}_tip",
        middle,
        axes,
        Body(0.5 * link.body.mass, link.body.com + offset - middle, inertia),
    )
    return inner, outer


def stated(name: str) -> Chain:
    """The arm of the data sheet."""
    makers = {
        "three_axes": three_axes,
        "six_axes": six_axes,
        "six_axes_on_column": six_axes_on_column,
    }
    return makers[name]()


def draw(name: str, seed: int, traits: Traits | None = None) -> Chain:
    """A true robot of this type."""
    traits = traits or Traits()
    random = np.random.default_rng(seed)
    arm = stated(name)
    links: list[Link] = []
    moved = np.zeros(3)  # m: from the frame of the link before to that of its outer half
    for link in arm.links:
        axes = []
        for axis in link.axes:
            if axis.gear is not None:
                axes.append(replace(axis, gear=drawn_gear(axis.gear, traits, random)))
            else:
                factor = traits.bearing ** random.uniform(-1, 1)
                axes.append(spring(axis.name, axis.axis, factor * axis.stiffness))
        true = Link(
            link.name, link.origin - moved, tuple(axes), drawn_body(link.body, traits.body, random)
        )
        moved = np.zeros(3)
        if link.name == "upper" and traits.elastic_link:
            pair = halves(true, link, random)
            links.extend(pair)
            moved = pair[1].origin
        else:
            links.append(true)
    return replace(
        arm,
        links=tuple(links),
        payload=drawn_body(arm.payload, min(traits.body, 0.01), random),
        ball=arm.ball + 2e-3 * random.uniform(-1, 1, 3),
    )
