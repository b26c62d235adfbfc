"""The search of configurations on a gantry whose wrist is a closed form: distances, families,
turns and limits.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.paths.inverse_kinematics import search

LENGTH = 2.0  # m, of the arm


class Gantry:
    """Three slides along x, y, z and a wrist about z, y, z; the library of a solver, and all
    solutions of a pose.
    """

    def forward_kinematics(self, q: np.ndarray) -> Any:
        R = Rotation.from_euler("ZYZ", np.atleast_2d(q)[:, 3:]).as_matrix()
        p = np.atleast_2d(q)[:, :3]
        one = SimpleNamespace(p=p, R=R) if q.ndim > 1 else SimpleNamespace(p=p[0], R=R[0])
        return Pair(one.p, one.R)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        first = Rotation.from_euler("Z", q[3])
        second = Rotation.from_euler("ZY", q[3:5])
        J = np.zeros((6, 6))
        J[:3, :3] = np.eye(3)
        J[3:, 3] = [0, 0, 1]
        J[3:, 4] = first.apply([0, 1, 0])
        J[3:, 5] = second.apply([0, 0, 1])
        return J

    def inverse_kinematics(
        self, p: np.ndarray, R: np.ndarray, base: np.ndarray, free: list[int]
    ) -> np.ndarray:
        if abs(R[2, 2]) > 1 - 1e-8:
            raise SolverError("more than 16 solutions")
        angles = Rotation.from_matrix(R).as_euler("ZYZ")
        other = angles * [1, -1, 1] + [np.pi, 0, np.pi]
        wrapped = (np.array([angles, other]) + np.pi) % (2 * np.pi) - np.pi
        return np.hstack([np.tile(p, (2, 1)), wrapped])


class Pair(tuple[Any, Any]):
    """A position and a rotation, also by name."""

    p: Any
    R: Any

    def __new__(cls, p: Any, R: Any) -> Pair:
        made = super().__new__(cls, (p, R))
        made.p = p
        made.R = R
        return made


def solver(lower: float | None = None, upper: float | None = None) -> Any:
    """The search for the gantry; limits of its last joint."""
    made = object.__new__(search._Solver)
    dofs = [None] * 5 + [SimpleNamespace(lower=lower, upper=upper)]
    coordinates = [
        SimpleNamespace(unit="m" if k < 3 else "rad", dof=dof) for k, dof in enumerate(dofs)
    ]
    model = SimpleNamespace(name="gantry", coordinates=coordinates, n_a=6)
    rotary = np.array([False] * 3 + [True] * 3)
    vars(made).update(
        model=model,
        i_g=list(range(6)),
        free=list(range(6)),
        base=np.zeros(6),
        rotary=rotary,
        library=Gantry(),
        length=LENGTH,
        _at=list(range(6)),
    )
    return made


def goal_of(q: np.ndarray) -> np.ndarray:
    p, R = Gantry().forward_kinematics(q)
    return np.concatenate([p, R.ravel()])


def test_distances_and_errors_of_a_configuration() -> None:
    made = solver()
    q = np.array([0.2, -0.3, 0.5, 0.4, 0.02, -1.0])
    J = np.diag([0.5, 0.5, 0.5, 1.0, 1.0, 1.0]) @ Gantry().jacobian(q)
    sizes = np.linalg.svd(J, compute_uv=False)
    assert made._distance(q) == pytest.approx(sizes[-1] / sizes[0], rel=1e-9)
    assert_allclose(made._jacobian(q), J)
    null = made._null(q)
    assert (
        np.linalg.norm(null) == pytest.approx(1.0)
        and abs(null[3] + null[5]) < 1e-3
        and abs(null[3]) > 0.7
    )
    goal = goal_of(q)
    assert made._miss(goal, q) < 1e-7 and np.abs(made._error(goal, q)).max() < 1e-12
    away = q + np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    assert made._miss(goal, away) == pytest.approx(0.3 / LENGTH)
    assert_allclose(made._error(goal, away), [0.0, 0.15, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
    turned = q + np.array([0.0, 0.0, 0.0, 0.25, 0.0, 0.0])
    assert made._miss(goal, turned) == pytest.approx(0.25)
    assert_allclose(made._error(goal, turned), [0.0, 0.0, 0.0, 0.0, 0.0, np.sin(0.25)], atol=1e-12)


def test_configurations_are_one_up_to_whole_turns() -> None:
    """Slides do not turn; near a singular wrist along what rounding moves; at it along the whole
    family.
    """
    made = solver()
    q = np.array([0.2, -0.3, 0.5, 0.4, 0.8, -1.0])
    goal = goal_of(q)
    assert made._same(goal, q, q + 5e-6) and not made._same(goal, q, q + 2e-5)
    assert made._same(goal, q, q + np.array([0, 0, 0, 2 * np.pi, 0, -2 * np.pi]))
    assert not made._same(goal, q, q + np.array([2 * np.pi, 0, 0, 0, 0, 0]))
    assert not made._same(goal, q, q + np.array([0, 0, 0, np.pi, 0, np.pi]))
    singular = np.array([0.2, -0.3, 0.5, 0.4, 0.0, -1.0])
    goal = goal_of(singular)
    for turn in (0.7, -2.5, 3.0):
        family = singular + np.array([0, 0, 0, turn, 0, -turn])
        assert made._same(goal, singular, family) and made._same(goal, family, singular)
    near = np.array([0.2, -0.3, 0.5, 0.4, 1e-11, -1.0])
    goal = goal_of(near)
    # rounding over the distance is 2e-3
    assert made._same(goal, near, near + np.array([0, 0, 0, 5e-5, 0, -5e-5]))
    assert not made._same(goal, near, near + np.array([0, 0, 0, 0.1, 0, -0.1]))


def test_a_configuration_is_refined_to_rounding() -> None:
    """Also where the wrist is singular, at the configuration of the family that is nearest to
    home.
    """
    made = solver()
    q = np.array([0.2, -0.3, 0.5, 0.4, 0.8, -1.0])
    home = np.zeros(6)
    found = made._refine(goal_of(q), q + 0.05 * np.cos(np.arange(6)), home)
    assert_allclose(found, q, atol=1e-13)
    singular = np.array([0.2, -0.3, 0.5, 0.4, 0.0, -1.0])
    found = made._refine(goal_of(singular), singular + np.array([0.01, 0, 0, 0.3, 0.0, 0.2]), home)
    assert found is not None and made._miss(goal_of(singular), found) < 1e-11
    assert found[3] + found[5] == pytest.approx(-0.6, abs=1e-9) and found[3] == pytest.approx(
        -0.3, abs=1e-6
    )
    far = made._refine(goal_of(singular), singular, np.array([0, 0, 0, 2.0, 0, 0.0]))
    assert far[3] - far[5] == pytest.approx(2.0, abs=1e-6)


def test_all_configurations_of_a_pose_are_found_once() -> None:
    """Two of a regular wrist, also next to the singular one, and one of the family at it."""
    made = solver()
    home = np.zeros(6)
    for bent in (0.8, 0.01, 1e-3):
        q = np.array([0.2, -0.3, 0.5, 0.4, bent, -1.0])
        found = made.all_at(goal_of(q), home)
        assert len(found) == 2
        for each in found:
            assert made._miss(goal_of(q), each) < 1e-7
        signs = sorted(np.sign(each[4]) for each in found)
        assert signs == [-1.0, 1.0]
    q = np.array([0.2, -0.3, 0.5, 0.4, 0.0, -1.0])
    (found,) = made.all_at(goal_of(q), home)
    assert found[3] == pytest.approx(-0.3, abs=1e-6) and found[5] == pytest.approx(-0.3, abs=1e-6)
    with pytest.raises(SolverError, match=r"^model gantry: more than 16 solutions$"):
        made.solve(goal_of(q))
    assert len(made.solve(goal_of(q + 0.5))) == 2


def test_small_turns_are_across_the_last_axis() -> None:
    made = solver()
    R = Rotation.random(random_state=1).as_matrix()
    found = made._turns(R)
    assert len(found) == search.TURNS
    vectors = np.array([Rotation.from_matrix(x).as_rotvec() for x in found])
    assert_allclose(np.linalg.norm(vectors, axis=1), search.TURNED, rtol=1e-6)
    sixth = R[:, 2]
    assert_allclose(vectors @ sixth, 0.0, atol=1e-9)
    assert_allclose(vectors.sum(axis=0), 0.0, atol=1e-9)  # all around
    assert len({tuple(np.round(v, 8)) for v in vectors}) == search.TURNS


def test_a_configuration_is_turned_into_its_limits() -> None:
    q = np.array([0.2, -0.3, 0.5, 0.4, 0.8, -1.0])
    goal = goal_of(q)
    free = solver().configuration(goal, q, False)
    assert (
        free.within_limits
        and free.parts == {}
        and free.flags == ()
        and free.nearest_singularity == ""
    )
    assert_allclose(free.q, q)
    assert free.error < 1e-7 and free.branch == int(np.sign(np.linalg.det(Gantry().jacobian(q))))
    turned = solver(4.0, 6.0).configuration(goal, q, False)
    assert turned.within_limits and turned.q[5] == pytest.approx(2 * np.pi - 1.0)
    back = solver(-8.0, -7.0).configuration(goal, q, False)
    assert back.within_limits and back.q[5] == pytest.approx(-1.0 - 2 * np.pi)
    out = solver(-0.9, None).configuration(goal, q, False)
    assert not solver(0.0, 1.0).configuration(goal, q, False).within_limits
    assert out.within_limits and out.q[5] == pytest.approx(2 * np.pi - 1.0)
    assert solver(-1.0, -1.0).configuration(goal, q, False).q[5] == -1.0
    J = np.diag([0.5, 0.5, 0.5, 1.0, 1.0, 1.0]) @ Gantry().jacobian(q)
    sizes = np.linalg.svd(J, compute_uv=False)
    assert free.distance == pytest.approx(sizes[-1] / sizes[0]) and not free.singular
    flat = solver().configuration(goal, np.array([0.2, -0.3, 0.5, 0.4, 0.0, -1.0]), False)
    assert flat.singular and flat.distance < 1e-12


def test_parts_of_an_arm_with_six_rotations_by_hand() -> None:
    """Axes of an elbow arm in the plane of x and z: distances over the reach, sines of angles,
    volumes of axes.
    """
    a = 0.3
    b = 1.1
    c = -0.6
    points = np.zeros((6, 3))
    points[1] = points[0]
    points[2] = [np.sin(a), 0.0, np.cos(a)]
    wrist = points[2] + [np.sin(a + b), 0.0, np.cos(a + b)]
    points[3:] = wrist
    fore = np.array([np.sin(a + b), 0.0, np.cos(a + b)])
    axes = np.array(
        [
            [0, 0, 1.0],
            [0, 1.0, 0],
            [0, 1.0, 0],
            fore,
            [0, 1.0, 0],
            Rotation.from_euler("y", a + b + c).apply([0, 0, 1.0]),
        ]
    )
    tool = wrist + 0.2 * axes[5]
    J = np.vstack([np.cross(axes, tool - points).T, axes.T])
    found = search.arm_parts(J)
    assert found["elbow"] == pytest.approx(np.sin(b)) and abs(found["wrist"]) == pytest.approx(
        abs(np.sin(c))
    )
    assert abs(found["shoulder"]) == pytest.approx(abs(wrist[0]))
    other = search.arm_parts(
        np.vstack([np.cross(axes, tool - points).T, (axes * [[1], [1], [1], [1], [1], [-1]]).T])
    )
    assert np.sign(other["wrist"]) == -np.sign(found["wrist"])
    crossing = search._next_to(
        np.zeros(3), np.array([1.0, 0, 0]), np.array([2.0, 5.0, 1.0]), np.array([0, 1.0, 0])
    )
    assert_allclose(crossing, [2.0, 0.0, 0.0])
    parallel = search._next_to(np.array([1.0, 2.0, 3.0]), axes[1], tool, axes[2])
    assert_allclose(parallel, [1.0, 2.0, 3.0])
    vector = np.array([0.3, -0.4, 0.2])
    assert_allclose(
        search._rotation_about(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-14
    )


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp"])
def test_deflections_at_rest_are_those_of_an_equilibrium(name: str) -> None:
    """Motors at known angles: springs hold gravity, by the residual of the equations of motion."""
    equations = (
        derive(name)
        if name == "elbow"
        else derive(flexgen.read(name, overrides={"gravity": [0.0, -9.81, 0.0]}))
    )
    made = solver()
    model = equations.model
    made.model = model
    made.i_g = list(model.i_g)
    q = np.array([0.4, -0.7])
    full = made._solve_deflections(q)
    zero = np.zeros(model.n_a)
    a_a, _ = equations.function("forward_dynamics")(
        full, zero, model.eta @ q, np.zeros(model.n_m), np.zeros(model.n_m)
    )
    still = np.abs(np.array(equations.function("mass_matrix")(full)) @ np.array(a_a)).max()
    size = np.abs(np.array(equations.function("gravity")(full))).max()
    assert still < 1e-6 * size and np.abs(full[list(model.i_g)] - q).max() > 1e-6
