"""Random URDF files with the faults of real ones, each with a twin that has none of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

import numpy as np

NAMES = (
    "panda/joint{}",
    "joint-{}",
    "{}_joint",
    "joint {}",
    "Gelenk_\u00e4{}",
    "\u95a2\u7bc0{}",
    "robotiq_85_left_inner_knuckle_joint_{}",
    "a__b{}",
    'q"{}',
    "q{}",
)
LIMITS = (
    {"lower": "-3", "upper": "3", "effort": "10", "velocity": "2"},
    {"lower": "-3", "upper": "3", "effort": "0", "velocity": "0"},
    {"lower": "-3", "upper": "3", "effort": "-1", "velocity": "-1"},
    {"lower": "-inf", "upper": "inf", "effort": "inf", "velocity": "1e309"},
    {"effort": "10", "velocity": "1"},
    {"lower": "0", "upper": "0", "effort": "10", "velocity": "1"},
    {"lower": "2", "upper": "-2", "effort": "10", "velocity": "nan"},
    None,
)


@dataclass
class OddUrdf:
    """A file, its twin, and the number of faults of each kind in it."""

    text: str = ""
    clean: str = ""
    tip: str = ""
    faults: dict[str, int] = field(default_factory=dict)

    def add(self, text: str, clean: str | None = None) -> None:
        """Add to both."""
        self.text += text
        self.clean += text if clean is None else clean

    def count(self, fault: str, there: bool = True) -> None:
        """Count a fault."""
        self.faults[fault] = self.faults.get(fault, 0) + there


def odd_urdf(rng: np.random.Generator, joints: int = 5) -> OddUrdf:
    """A chain with faults, with followers, a branch with a loose finger and its follower."""
    out = OddUrdf()
    out.add('<robot name="odd 1"><link name="base"/>')
    names = [str(rng.choice(NAMES)).format(k) for k in range(joints + 3)]
    links = [str(rng.choice(NAMES)).format(f"{k}_link") for k in range(joints + 3)]
    order = list(range(joints + 3))
    pieces: dict[int, OddUrdf] = {}
    parents = ["base", *links[: joints - 1], links[joints - 1], links[joints - 1], links[0]]
    followers = _followers(rng, joints)
    for k in order:
        piece = pieces[k] = OddUrdf(faults=out.faults)
        _add_link(piece, rng, links[k])
        mimic = ""
        if k in followers:
            leader, factor, offset = followers[k]
            mimic = f"<mimic joint={quoteattr(names[leader])} "
            mimic += f'multiplier="{factor}" offset="{offset}"/>'
            out.count("mimic before its joint", leader > k)
            out.count("mimic of a mimic", leader in followers)
        _add_joint(piece, rng, names[k], parents[k], links[k], mimic)
    rng.shuffle(order)
    for k in order:
        out.add(pieces[k].text, pieces[k].clean)
    out.add("</robot>")
    out.tip = links[joints - 1]
    for kind, group in (("joint", names), ("link", links)):
        out.count(f"name of a {kind}", any(not name.isidentifier() for name in group))
    return out


def _followers(rng: np.random.Generator, joints: int) -> dict[int, tuple[int, float, float]]:
    """Joints that follow others: two of the chain in any order, and a finger the other one."""
    first, second, third = rng.choice(joints, 3, replace=False).tolist()
    draw = rng.uniform(-1.5, 1.5, (3, 2)).round(3).tolist()
    out = {joints: (joints + 1, *draw[0])}
    if rng.integers(2):
        out[second] = (first, *draw[1])
    if rng.integers(2):
        out[third] = (second, *draw[2])
    return out


def _add_link(out: OddUrdf, rng: np.random.Generator, name: str) -> None:
    """A link; its moments may be those of no body, below zero, or without a mass."""
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    a, b = rng.uniform(0.01, 0.05, 2)
    kind = rng.choice(["body", "triangle", "negative", "no mass"], p=[0.55, 0.2, 0.15, 0.1])
    moments = [a, b, 0.8 * (a + b)]
    twin = None
    if kind == "triangle":
        moments[2] = 1.5 * (a + b)
    if kind == "negative":
        moments[2] = -0.1 * a
        twin = [a, b, 0.0]
    out.count(kind)
    mass = 0.0 if kind == "no mass" else rng.uniform(0.5, 3.0)
    com = " ".join(map(repr, rng.uniform(-0.2, 0.2, 3).tolist()))
    texts = []
    for values in (moments, twin or moments):
        tensor = R @ np.diag(values) @ R.T
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = (tensor + tensor.T) / 2.0
        entries = {"ixx": xx, "iyy": yy, "izz": zz, "ixy": xy, "ixz": xz, "iyz": yz}
        inertia = " ".join(f'{key}="{float(x)!r}"' for key, x in entries.items())
        texts.append(
            f'<link name={quoteattr(name)}><inertial><origin xyz="{com}" rpy="0.1 0 0.3"/>'
            f'<mass value="{float(mass)!r}"/><inertia {inertia}/></inertial></link>\n'
        )
    out.add(*texts)


def _add_joint(
    out: OddUrdf, rng: np.random.Generator, name: str, parent: str, child: str, mimic: str
) -> None:
    """A joint; its axis may have any length, its limits and friction may be wrong."""
    kind = rng.choice(["revolute", "continuous", "prismatic"], p=[0.6, 0.2, 0.2])
    axis = rng.normal(size=3) * rng.choice([1.0, 0.01, 100.0])
    unit = axis / np.linalg.norm(axis)
    place = " ".join(map(repr, rng.uniform(-0.5, 0.5, 3).tolist()))
    turn = " ".join(map(repr, rng.uniform(-2.0, 2.0, 3).tolist()))
    limit = LIMITS[int(rng.integers(len(LIMITS)))]
    out.count("axis")
    out.count("limits", limit is None or limit is not LIMITS[0])
    numbers = " ".join(f'{key}="{value}"' for key, value in (limit or {}).items())
    given = "" if limit is None else f"<limit {numbers}/>"
    friction = float(rng.choice([0.0, 0.3]))
    out.count("friction", friction > 0.0)
    dynamics = f'<dynamics damping="0.2" friction="{friction}"/>'
    head = f'<joint name={quoteattr(name)} type="{kind}"><parent link={quoteattr(parent)}/>'
    head += f'<child link={quoteattr(child)}/><origin xyz="{place}" rpy="{turn}"/>'
    fine = '<limit lower="-3" upper="3" effort="10" velocity="2"/>'
    out.add(
        f'{head}<axis xyz="{_text(axis)}"/>{given}{dynamics}{mimic}</joint>\n',
        f'{head}<axis xyz="{_text(unit)}"/>{fine}{mimic}</joint>\n',
    )


def _text(vector: np.ndarray) -> str:
    return " ".join(map(repr, vector.tolist()))
