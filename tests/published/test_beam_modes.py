"""Beams with a body at the tip, torsion, elongation and a constant tension, against finite
elements.

The finite elements are those of textbooks: cubic ones for bending with the consistent mass and the
geometric stiffness of a tension, linear ones for torsion and elongation (K. J. Bathe, Finite
Element Procedures, 1996, ch. 5; J. Przemieniecki, Theory of Matrix Structural Analysis, 1968,
ch. 15).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics import beam as beams
from flexgen.dynamics.mechanics.equations import Equations

ELEMENTS = 60
LENGTH = 0.9
PER_LENGTH = 2.2
TIP_MASS = 3.1
TIP_INERTIA = (0.021, 0.034, 0.045)
EI = {"y": 310.0, "z": 150.0}
GJ = 95.0
POLAR = 4.0e-3
EA = 2.5e5
TENSION = 120.0


def assemble(element: np.ndarray, per_node: int) -> np.ndarray:
    """Matrix of a clamped row of equal elements with two nodes each."""
    total = np.zeros(((ELEMENTS + 1) * per_node,) * 2)
    for k in range(ELEMENTS):
        rows = slice(k * per_node, (k + 2) * per_node)
        total[rows, rows] += element
    return total[per_node:, per_node:]


def bending(direction: str, tension: float) -> np.ndarray:
    """Natural frequencies of bending [rad/s]."""
    h = LENGTH / ELEMENTS
    K = np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, 4 * h * h, -6 * h, 2 * h * h],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, 2 * h * h, -6 * h, 4 * h * h],
        ]
    )
    M = np.array(
        [
            [156, 22 * h, 54, -13 * h],
            [22 * h, 4 * h * h, 13 * h, -3 * h * h],
            [54, 13 * h, 156, -22 * h],
            [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
        ]
    )
    G = np.array(
        [
            [36, 3 * h, -36, 3 * h],
            [3 * h, 4 * h * h, -3 * h, -h * h],
            [-36, -3 * h, 36, -3 * h],
            [3 * h, -h * h, -3 * h, 4 * h * h],
        ]
    )
    stiffness = assemble(EI[direction] / h**3 * K + tension / (30 * h) * G, 2)
    mass = assemble(PER_LENGTH * h / 420 * M, 2)
    mass[-2, -2] += TIP_MASS
    mass[-1, -1] += TIP_INERTIA[2 if direction == "y" else 1]
    return np.sqrt(eigh(stiffness, mass, eigvals_only=True))


def along(stiffness: float, inertia: float, tip: float) -> np.ndarray:
    """Natural frequencies of torsion or elongation [rad/s]."""
    h = LENGTH / ELEMENTS
    K = assemble(stiffness / h * np.array([[1.0, -1.0], [-1.0, 1.0]]), 1)
    M = assemble(inertia * h / 6 * np.array([[2.0, 1.0], [1.0, 2.0]]), 1)
    M[-1, -1] += tip
    return np.sqrt(eigh(K, M, eigvals_only=True))


def arm(tension: float = 0.0, modes: int = 3, **beam: Any) -> flexgen.RobotModel:
    """`beam_arm` with a beam of all kinds of modes, whose tip is its payload."""
    table = {
        "length": LENGTH,
        "mass_per_length": PER_LENGTH,
        "bending": [
            {"direction": d, "stiffness": EI[d], "modes": modes, "damping_ratio": 0.01}
            for d in ("y", "z")
        ],
        "torsion": {"stiffness": GJ, "inertia_per_length": POLAR, "modes": modes},
        "stretch": {"stiffness": EA, "modes": modes},
        "tip": {"mass": TIP_MASS, "inertia": list(TIP_INERTIA)},
        "axial_load": tension,
        **beam,
    }
    payload = {"mass": TIP_MASS, "com": [0.0, 0.0, 0.0], "inertia": list(TIP_INERTIA)}
    changes = {"element.fore.beam": table, "payload": payload, "gravity": [0.0, 0.0, 0.0]}
    return flexgen.read("beam_arm", overrides=changes)


def frequencies(robot: flexgen.RobotModel) -> dict[str, np.ndarray]:
    """Natural frequencies of the beam with a fixed hub, by kind [rad/s]."""
    equations = Equations(robot)
    still = np.zeros(robot.n_a)
    e = list(robot.i_e)
    M = evaluate(equations.function("mass_matrix"), still)[0][0][np.ix_(e, e)]
    steps = np.zeros((len(e), robot.n_a))
    steps[:, e] = np.eye(len(e))
    K = -evaluate(equations.function("elastic_torque"), steps, np.zeros_like(steps))[0].reshape(
        len(e), len(e)
    )
    names = [robot.coordinates[i].name.removeprefix("fore_").rstrip("123456789") for i in e]
    out = {}
    for kind in dict.fromkeys(names):
        rows = [k for k, name in enumerate(names) if name == kind]
        out[kind] = np.sqrt(eigh(K[np.ix_(rows, rows)], M[np.ix_(rows, rows)], eigvals_only=True))
    return out


@pytest.mark.parametrize("tension", [0.0, TENSION, -TENSION])
def test_the_first_three_modes_of_each_kind_are_those_of_finite_elements(tension: float) -> None:
    found = frequencies(arm(tension))
    expected = {
        "y": bending("y", tension),
        "z": bending("z", tension),
        "twist": along(GJ, POLAR, TIP_INERTIA[0]),
        "x": along(EA, PER_LENGTH, TIP_MASS),
    }
    assert list(found) == list(expected)
    for kind, values in found.items():
        np.testing.assert_allclose(values, expected[kind][:3], rtol=2e-3 if tension else 5e-4)


def test_modes_without_the_body_at_the_tip_miss_the_second_one() -> None:
    """The planted error: the modes of a free tip under the same payload."""
    found = frequencies(arm(modes=2, tip={}))
    assert abs(found["y"][1] / bending("y", 0.0)[1] - 1) > 0.01


@pytest.mark.parametrize("seed", range(5))
def test_kinetic_energy_is_that_of_thin_slices(seed: int) -> None:
    """Slices of the beam as points, and as discs that turn about its axis; the second joint turns
    it about itself as well.
    """
    rng = np.random.default_rng(seed)
    tilted = np.array([0.6, 0.0, 0.8])
    bare = {"mass": 0.0}
    changes = {
        "element.upper.body": bare,
        "element.fore.body": bare,
        "element.fore.dof.q2.axis": tilted.tolist(),
        "payload": bare,
    }
    robot = flexgen.read("beam_arm", overrides={**arm(modes=2).overrides, **changes})
    q = 0.3 * rng.standard_normal(robot.n_a)
    v = rng.standard_normal(robot.n_a)
    x, weight = np.polynomial.legendre.leggauss(60)
    x = LENGTH * (x + 1) / 2
    shapes = np.zeros((robot.n_a, len(x), 3))
    twist = np.zeros((robot.n_a, len(x)))
    whole = PER_LENGTH * LENGTH
    for i in robot.i_e:
        ending = robot.coordinates[i].name.removeprefix("fore_")
        k = int(ending[-1])
        axis = "xyz".find(ending[0])
        if ending.startswith("twist"):
            twist[i] = beams.sine_mode(k, LENGTH, x, TIP_INERTIA[0] / (POLAR * LENGTH))[0]
        elif axis == 0:
            shapes[i, :, 0] = beams.sine_mode(k, LENGTH, x, TIP_MASS / whole)[0]
        else:
            turned = TIP_INERTIA[2 if axis == 1 else 1] / (whole * LENGTH**2)
            shapes[i, :, axis] = beams.mode_shape(k, LENGTH, x, (TIP_MASS / whole, turned))[0]

    def points(q: np.ndarray) -> np.ndarray:
        """Positions of the slices (60, 3) [m]."""
        own = np.einsum("i,ikd->kd", q, shapes) + x[:, None] * np.array([1.0, 0.0, 0.0])
        upper = Rotation.from_rotvec([0.0, 0.0, q[0]])
        return upper.apply(
            np.array([0.5, 0.0, 0.0]) + Rotation.from_rotvec(q[1] * tilted).apply(own)
        )

    h = 1e-5
    speed = (points(q + h * v) - points(q - h * v)) / (2 * h)
    carried = Rotation.from_rotvec(-q[1] * tilted).apply([0.0, 0.0, v[0]])
    spin = carried[0] + tilted[0] * v[1] + np.einsum("i,ik->k", v, twist)
    slices = PER_LENGTH * np.sum(speed**2, axis=1) + POLAR * spin**2
    M = evaluate(Equations(robot).function("mass_matrix"), q)[0][0]
    assert v @ M @ v / 2 == pytest.approx(slices @ weight * LENGTH / 4, rel=1e-8)


def test_a_twist_turns_the_tip_and_elongation_moves_it() -> None:
    robot = arm(modes=1)
    names = [coordinate.name for coordinate in robot.coordinates]
    q = np.zeros(robot.n_a)
    q[names.index("fore_x1")] = 0.003
    q[names.index("fore_twist1")] = 0.1
    found = [
        np.array(each) for each in evaluate(Equations(robot).function("forward_kinematics"), q)
    ]
    place = next(each for each in found if each.size == 3).ravel()
    turned = next(each for each in found if each.size == 9).reshape(3, 3)
    assert place == pytest.approx([0.5 + LENGTH + 0.003, 0.0, 0.0], abs=1e-12)
    about_x = Rotation.from_rotvec([0.1, 0.0, 0.0]).as_matrix()
    np.testing.assert_allclose(turned, about_x, atol=1e-12)
    assert [c.unit for c in robot.coordinates if c.name == "fore_twist1"] == ["rad"]


@pytest.mark.parametrize(
    ("beam", "words"),
    [
        ({"axial_load": -5000.0}, r"axial_load: given -5000.0, expected more than -456.9 N"),
        ({"tip": {"inertia": [-1.0, 0.0, 0.0]}}, r"tip.inertia: .*three moments of inertia >= 0"),
        (
            {"torsion": {"stiffness": 1.0, "modes": 1}},
            r"torsion.inertia_per_length: given nothing",
        ),
        ({"stretch": {"stiffness": 0.0, "modes": 1}}, r"stretch.stiffness: given 0.0"),
    ],
)
def test_invalid_beams_are_refused(beam: dict[str, Any], words: str) -> None:
    with pytest.raises(ModelError, match=words):
        arm(**beam)
