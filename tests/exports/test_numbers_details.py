"""Details of exports and fits by hand: time steps, inertias, names, ranks, delays, legs of
programs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hysteretic import SLIPS, with_elements
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ModelError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.exports.fmu import plant
from flexgen.exports.mujoco import mujoco, mujoco_inertia
from flexgen.exports.urdf import urdf


@pytest.mark.parametrize(
    ("rate", "step"),
    [
        (0.0, None),
        (1e-9, None),
        (260.0, 2e-3),
        (410.0, 1e-3),
        (999.0, 5e-4),
        (1.0, None),
        (4e6, 1e-7),
    ],
)
def test_a_time_step_is_a_round_number_below_the_bound(
    rate: float, step: float | None, monkeypatch: Any
) -> None:
    """1, 2 or 5 times a power of ten, as large as it can be; slow robots have the largest one."""
    monkeypatch.setattr(mujoco, "linearize", lambda equations, rest: None)
    monkeypatch.setattr(mujoco, "poles", lambda found: np.array([-rate + 0j, 1j * rate / 2]))
    found = mujoco._step(None, "rest")  # type: ignore[arg-type]
    longest = mujoco.STEP_MAX if rate == 0.0 else min(mujoco.STEP / rate, mujoco.STEP_MAX)
    rounds = [m * 10.0**k for k in range(-9, 1) for m in (1, 2, 5)]
    assert found == pytest.approx(max(x for x in rounds if x <= longest * (1 + 1e-9)), rel=1e-12)
    assert mujoco._step(None, None) == mujoco.STEP_MAX / 10  # type: ignore[arg-type]
    for exact in (1e-3, 2e-3, 5e-4):  # of a bound that is a round number itself
        monkeypatch.setattr(
            mujoco, "poles", lambda found, exact=exact: np.array([mujoco.STEP / exact])
        )
        assert mujoco._step(None, "rest") == pytest.approx(min(exact, mujoco.STEP_MAX))
    assert step is None or found <= mujoco.STEP_MAX


def test_an_inertia_lacks_what_its_largest_moment_exceeds() -> None:
    R = Rotation.random(random_state=2).as_matrix()
    for moments, lacks in (
        ((1.0, 2.0, 3.5), 0.5),
        ((1.0, 2.0, 2.5), -0.5),
        ((-0.25, 1.0, 1.0), 0.25),
    ):
        assert mujoco_inertia.missing(R @ np.diag(moments) @ R.T) == pytest.approx(lacks)
    axis = np.array([0.6, 0.0, 0.8])
    assert_allclose(
        mujoco_inertia.free_directions([axis, -axis]), np.eye(3) - np.outer(axis, axis)
    )
    assert_allclose(mujoco_inertia.free_directions([]), np.eye(3))
    assert mujoco_inertia.free_directions([axis, np.array([1.0, 0.0, 0.0])]) is None


def test_the_least_change_of_an_inertia_makes_it_valid() -> None:
    """By a search on a line; None where no change across the joint helps."""
    R = Rotation.random(random_state=5).as_matrix()
    inertia = R @ np.diag([0.2, 0.3, 1.1]) @ R.T
    free = np.eye(3)
    found = mujoco_inertia._find_least(inertia, free)
    assert found == pytest.approx(0.6, rel=1e-9)  # 1.1 + c = 0.5 + 2 c
    assert mujoco_inertia.missing(inertia + found * free) <= 0.0
    along = np.eye(3) - np.outer(R[:, 2], R[:, 2])
    found = mujoco_inertia._find_least(inertia, along)
    best = minimize_scalar(
        lambda c: c + 1e6 * max(mujoco_inertia.missing(inertia + c * along), 0.0),
        bounds=(0.0, 2.0),
        method="bounded",
        options={"xatol": 1e-10},
    )
    assert found == pytest.approx(best.x, rel=1e-5) and found == pytest.approx(0.3, rel=1e-6)
    large = R @ np.diag([0.0, 0.0, 1.0]) @ R.T
    assert mujoco_inertia._find_least(large, np.eye(3) - np.outer(R[:, 0], R[:, 0])) is None
    far = mujoco_inertia._find_least(np.diag([0.0, 0.0, 1.0]), np.diag([1e-2, 1e-2, 0.0]))
    assert far == pytest.approx(50.0, rel=1e-6)


def test_principal_axes_are_a_rotation_far_from_the_identity() -> None:
    R = Rotation.from_rotvec([1e-7, -2e-7, 1e-7]).as_matrix()
    for turn in (R, Rotation.random(random_state=1).as_matrix()):
        tensor = turn @ np.diag([1.0, 2.0, 2.5]) @ turn.T
        moments, axes = mujoco_inertia.principal(tensor)
        assert np.linalg.det(axes) == pytest.approx(1.0) and np.abs(axes - np.eye(3)).max() > 0.1
        assert_allclose(axes @ np.diag(moments) @ axes.T, tensor, atol=1e-12)
    moments, axes = mujoco_inertia.principal(np.diag([3.0, 2.0, 1.0]))
    assert moments.tolist() == [3.0, 2.0, 1.0] and np.array_equal(axes, np.eye(3))


def test_names_that_urdf_cannot_have_are_named_with_their_table(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of elements, then of their degrees of freedom and of motors."""
    model = flexgen.read("elbow")
    for name, key in (("upper", "element.name"), ("q2", "dof.name"), ("m2", "motor.name")):
        monkeypatch.setattr(
            urdf, "identifier_problem", lambda given, name=name: "another" if given == name else ""
        )
        with pytest.raises(
            ModelError, match=rf"{key}: given .*{name}.*, expected another"
        ) as caught:
            urdf._steps(model)
        assert (caught.value.line, caught.value.key) == (0, key)
    monkeypatch.setattr(urdf, "identifier_problem", lambda given: "")
    assert [step.dof.name for step in urdf._steps(model) if step.dof is not None] == ["q1", "q2"]


@pytest.mark.parametrize("elements", [SLIPS[:1], SLIPS])
def test_states_of_a_plant_are_numbered_one_after_the_other(elements: Any) -> None:
    """Coordinates, their speeds, then the torques of the elements of hysteresis; each has a
    derivative.
    """
    model = with_elements("elbow", elements)
    equations = derive(model, ("payload",))
    found = plant._states(model, plant._graphs(equations), np.arange(20.0))
    states = [v for v in found if not v.name.startswith("der(")]
    rates = [v for v in found if v.name.startswith("der(")]
    assert (
        [v.index for v in states] == list(range(8 + 2 * len(elements))) == [v.index for v in rates]
    )
    names = ["arm.q1.position", "arm.q2.position", "rotor.m1.angle", "rotor.m2.angle"]
    assert [v.name for v in states[:4]] == names and [v.start for v in states[:4]] == [
        0.0,
        1.0,
        2.0,
        3.0,
    ]
    speeds = ["arm.q1.speed", "arm.q2.speed", "rotor.m1.speed", "rotor.m2.speed"]
    assert [v.name for v in states[4:8]] == speeds
    number = ["[1]", "[2]", "[3]"] if len(elements) > 1 else [""]
    assert [v.name for v in states[8:]] == [
        f"gear.{q}.hysteresis{k}" for k in number for q in ("q1", "q2")
    ]
    assert [v.name for v in rates] == [f"der({v.name})" for v in states]
    assert [v.unit for v in rates[3:5]] == ["rad/s", "rad/s2"] and rates[8].unit == "N.m/s"


# --- legs of programs ----------------------------------------------------------------------------
def test_the_last_leg_of_a_program_of_lines_has_no_zone() -> None:
    """It counts as 0; the others state one."""
    legs = [{"displacement": [0.1, 0.0, 0.0], "zone": 0.02}, {"displacement": [0.0, 0.1, 0.0]}]
    base = {
        "name": "two",
        "type": "tool_polyline",
        "start_rad": [0.3, -1.1],
        "smoothness": 5,
        "profile": [0.4, 2.0, 30.0, 600.0],
    }

    def read(*given: dict[str, Any]) -> Any:
        robot = flexgen.read("planar5_nmp", overrides={"move": [base | {"legs": list(given)}]})
        return robot.moves[0]

    move = read(*legs)
    assert [leg.zone for leg in move.legs] == [0.02, 0.0]
    with pytest.raises(ModelError, match="zone"):
        read(legs[0], legs[1] | {"zone": 0.01})
    with pytest.raises(ModelError, match="zone"):
        read({"displacement": [0.1, 0.0, 0.0]}, legs[1])
