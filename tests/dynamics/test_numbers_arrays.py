"""Arrays of the runtime, figures of linear robots and curves of torques: rules by hand, limits at
their edges.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import eigh

import flexgen
from flexgen.analysis import second_order
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.curve import checked_curves, is_torque_speed
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.linearization import check_inertia, second_order_matrices
from flexgen.feedback.loop import comparison
from flexgen.runtime import arguments

PORTS = [
    Port("q", (2,), "rad", "angles"),
    Port("R", (3, 3), "1", "rotation"),
    Port("p", (4,), "1", "parameters"),
]
DOUBLE = np.dtype(float)
SINGLE = np.dtype(np.float32)


# --- arguments of functions in C -----------------------------------------------------------------
def test_arguments_are_bound_by_place_and_name() -> None:
    ports = [*PORTS[:2], Port("parameters", (4,), "1", "of the model")]
    assert arguments.bind("f", ports, (1, 2), {}, 9) == [1, 2, 9]
    assert arguments.bind("f", ports, (1,), {"parameters": 3, "R": 2}, 9) == [1, 2, 3]
    for args, named, default, told in (
        ((1,), {}, 9, "1 arguments"),
        ((1, 2), {}, None, "2 arguments"),
        ((1, 2, 3, 4), {}, None, "4 arguments"),
        ((1, 2), {"q": 1}, 9, "2 arguments and q"),
        ((1, 2), {"x": 1, "y": 2}, 9, "2 arguments and x, y"),
    ):
        with pytest.raises(ArgumentError, match=f"^f: given {told}, expected q, R, parameters$"):
            arguments.bind("f", ports, args, named, default)


def test_points_of_arguments_are_counted() -> None:
    ports = [PORTS[0], PORTS[1], Port("p", (4,), "1", "shared")]
    p = np.zeros(4)
    assert (
        arguments.count_of_points("f", ports, [np.zeros(2), np.zeros((3, 3)), p], 9, "p") is None
    )
    assert (
        arguments.count_of_points("f", ports, [np.zeros((9, 2)), np.zeros((3, 3)), p], 9, "p") == 9
    )
    assert (
        arguments.count_of_points("f", ports, [np.zeros(2), np.zeros((0, 3, 3)), p], 9, "p") == 0
    )
    for shapes, text in (
        (
            ((10, 2), (3, 3), (4,)),
            r"^f: given 10 points, expected at most 9; call it for parts of them$",
        ),
        (((5, 2), (4, 3, 3), (4,)), "^f, R: given 4 points, expected 5 as in the inputs before$"),
        (
            ((5, 2), (3, 3), (5, 4)),
            r"^f, p: given shape \(5, 4\), expected \(4,\): one vector for all points$",
        ),
        (
            ((5, 3), (3, 3), (4,)),
            r"^f, q: given shape \(5, 3\), expected \(2,\) or \(N, 2\) \[rad\]$",
        ),
        (
            ((2,), (1, 2, 3, 3), (4,)),
            r"^f, R: given shape \(1, 2, 3, 3\), expected \(3, 3\) or \(N, 3, 3\) \[1\]$",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            arguments.count_of_points("f", ports, [np.zeros(shape) for shape in shapes], 9, "p")


def test_arrays_are_stored_with_the_points_side_by_side() -> None:
    port = PORTS[0]
    x = np.arange(10.0).reshape(5, 2)
    found = arguments.store(port, x, 5, DOUBLE)
    assert found.flags.f_contiguous and found.dtype == DOUBLE
    assert_array_equal(found, x)
    ready = np.asfortranarray(x)
    assert arguments.store(port, ready, 5, DOUBLE) is ready
    assert_array_equal(arguments.store(port, np.array([1.0, 2.0]), 3, SINGLE), [[1, 2]] * 3)
    assert arguments.store(port, np.array([1.0, 2.0]), 3, SINGLE).dtype == SINGLE
    shared = arguments.store(PORTS[2], np.arange(4.0), 3, DOUBLE, "p")
    assert shared.shape == (4,)
    assert np.isinf(arguments.convert(np.array([1e39]), SINGLE)).all()
    assert arguments.convert(x, DOUBLE) is x and arguments.convert(x, DOUBLE, "F") is not x


def test_arrays_for_results_are_checked() -> None:
    ports = PORTS[:2]
    one, two = arguments.results("f", ports, None, None, DOUBLE)
    assert (one.shape, two.shape) == ((2,), (3, 3))
    one, two = arguments.results("f", ports, None, 7, SINGLE)
    assert (one.shape, two.shape, two.dtype) == (
        (7, 2),
        (7, 3, 3),
        SINGLE,
    ) and two.flags.f_contiguous
    good = [np.empty((7, 2), order="F"), np.empty((7, 3, 3), order="F")]
    found = arguments.results("f", ports, tuple(good), 7, DOUBLE)
    assert found[0] is good[0] and found[1] is good[1]
    assert arguments.results("f", ports[:1], np.empty(4)[::2], None, DOUBLE)[0].shape == (2,)
    locked = np.empty((7, 2), order="F")
    locked.flags.writeable = False
    for out, text in (
        (good[:1], "^f, out: given 1 arrays, expected 2: q, R$"),
        ([good[0], [1.0]], "^f, out for R: given list, expected a numpy array$"),
        (
            [good[0], np.empty((7, 3, 2))],
            r"R: given shape \(7, 3, 2\) of float64, expected \(7, 3, 3\) of float64$",
        ),
        (
            [good[0].astype(SINGLE), good[1]],
            r"q: given shape \(7, 2\) of float32, expected \(7, 2\) of float64$",
        ),
        ([locked, good[1]], "q: given an array that is read-only, expected one to write$"),
        (
            [np.empty((7, 2)), good[1]],
            r"another order, expected points side by side: np\.empty\(\(7, 2\), order='F'\)$",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            arguments.results("f", ports, out, 7, DOUBLE)


@pytest.mark.parametrize(
    ("written", "read", "wrong"),
    [
        ([(0, 16), (16, 8)], [(24, 8)], None),
        ([(0, 16), (15, 8)], [(24, 8)], "R"),
        ([(8, 16), (0, 9)], [(24, 8)], "R"),
        ([(0, 17), (32, 8)], [(16, 8)], "q"),
        ([(16, 8), (32, 8)], [(0, 16)], None),
        ([(16, 8), (32, 8)], [(0, 17)], "q"),
        ([(16, 8), (32, 8)], [(0, 99)], "q"),
    ],
)
def test_results_may_not_share_memory(
    written: list[tuple[int, int]], read: list[tuple[int, int]], wrong: str | None
) -> None:
    if wrong is None:
        arguments.refuse_overlap("f", PORTS[:2], written, read)
        return
    text = f"^f, out for {wrong}: given memory that another argument uses too, expected its own$"
    with pytest.raises(ArgumentError, match=text):
        arguments.refuse_overlap("f", PORTS[:2], written, read)


def test_the_first_point_that_is_not_finite_is_told() -> None:
    q = np.zeros((5, 2))
    R = np.zeros((5, 3, 3))
    arguments.refuse_not_finite("f", PORTS[:2], [q, R], DOUBLE)
    q[3, 1] = np.nan
    R[2, 0, 2] = np.inf
    with pytest.raises(
        ArgumentError, match=r"^f, R\[2, 0, 2\]: given inf, expected finite numbers$"
    ):
        arguments.refuse_not_finite("f", PORTS[:2], [q, R], DOUBLE)
    R[:] = 1e39
    with pytest.raises(
        ArgumentError,
        match=r"^f, R\[0, 0, 0\]: given 1e\+39, expected finite numbers of single prec",
    ):
        arguments.refuse_not_finite("f", PORTS[:2], [q, R], SINGLE)
    with pytest.raises(ArgumentError, match=r"^f, R\[0, 1\]: given nan"):  # of all points
        arguments.refuse_not_finite("f", PORTS[:2], [q, np.array([[0, np.nan], [0, 0]])], DOUBLE)


def test_numbers_for_c_are_numbers() -> None:
    assert (
        arguments.whole_of("f", "n", np.int64(2**31 - 1)) == 2**31 - 1
        and arguments.whole_of("f", "n", -(2**31)) < 0
    )
    for bad in (2**31, -(2**31) - 1, 1.0, True, "1"):
        with pytest.raises(ArgumentError, match=r"^f, n: given .*, expected a whole number$"):
            arguments.whole_of("f", "n", bad)
    assert (
        arguments.number_of("f", "x", np.float32(0.5)) == 0.5
        and arguments.number_of("f", "x", 3) == 3.0
    )
    for wrong in (True, "1", None, 10**400):
        with pytest.raises(ArgumentError, match=r"^f, x: given .*, expected a number$"):
            arguments.number_of("f", "x", wrong)
    x = np.array([1, 2], SINGLE)
    assert arguments.numbers("f", PORTS[0], x) is x
    for odd, text in (
        ([[1], [1, 2]], "expected real"),
        (["a", "b"], "entries of type"),
        ([1j, 0], "entries of type"),
    ):
        with pytest.raises(ArgumentError, match=f"^f, q: given .*{text}"):
            arguments.numbers("f", PORTS[0], odd)
    with pytest.raises(
        ArgumentError, match=r"^f, q: given an array with masked entries, expected real numbers$"
    ):
        arguments.numbers("f", PORTS[0], np.ma.masked_array([1, 2], [False, True]))


# --- linear robots -------------------------------------------------------------------------------
def test_figures_of_two_masses_and_a_spring() -> None:
    """``w^2 = k (1/m1 + 1/m2)`` free, ``k/m1`` with the motor locked; inertias with the spring
    stiff and soft.
    """
    made: Any = Made(dof=2, n_a=1, n_m=1, i_g=(0,), i_m=(0,), eta=np.array([[1.0]]))
    m1 = 3.0
    m2 = 0.5
    k = 200.0
    M = np.diag([m1, m2])
    K = k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    B = np.array([[0.0], [1.0]])
    rows = second_order.motor_rows(made)
    assert_array_equal(rows, [[0.0, 1.0]])
    stiff, soft = second_order.motor_inertias(made, M, B, rows)
    assert_allclose([stiff[0], soft[0]], [m1 + m2, m2])
    assert second_order.with_motors_locked(made) == [0]
    assert second_order.lowest_locked_hz(made, M, K) == pytest.approx(
        np.sqrt(k / m1) / (2 * np.pi)
    )
    fast = np.zeros((2, 2))
    slow = np.diag([1e4, 1.0])
    rate = second_order.largest_rate(
        np.stack([M, M]), np.stack([fast, fast]), np.stack([K, 4 * K])
    )
    assert rate == pytest.approx(2 * np.sqrt(k * (1 / m1 + 1 / m2)))
    assert second_order.largest_rate(M[None], slow[None], K[None]) == pytest.approx(
        1e4 / m1, rel=1e-2
    )
    rigid: Any = Made(dof=1, n_a=1, n_m=1, i_g=(0,), i_m=(), eta=np.array([[5.0]]))
    assert_array_equal(second_order.motor_rows(rigid), [[5.0]])
    assert (
        second_order.with_motors_locked(rigid) == []
        and second_order.lowest_locked_hz(rigid, M, K) == 0.0
    )


def test_matrices_of_a_robot_at_rest() -> None:
    """Modes of the elbow from its mass matrix and stiffness, motors and arm, without gravity."""
    equations = derive(flexgen.read("elbow", overrides={"gravity": [0.0, 0.0, 0.0]}))
    model = equations.model
    q = np.array([[0.2, 0.7]])
    zero = np.zeros((1, 2))
    found = evaluate(
        equations.function("residual_jacobians"), q, zero, zero, q @ model.eta.T, zero, zero, zero
    )
    M, D, K, B = (x[0] for x in second_order_matrices(*found))
    springs: list[Any] = [element.dofs[0].gear for element in model.elements]
    k, d = (
        np.diag([float(getattr(x, name)) for x in values])
        for name, values in (
            ("stiffness", [gear.spring for gear in springs]),
            ("damping", springs),
        )
    )
    back = np.linalg.inv(model.eta)
    T = np.hstack([-np.eye(2), back])
    assert_allclose(K, T.T @ k @ T, atol=1e-6)
    viscous = np.diag(
        [
            *(e.dofs[0].friction.viscous for e in model.elements),
            *(m.friction.viscous for m in model.motors),
        ]
    )
    assert_allclose(D, T.T @ d @ T + viscous, atol=1e-9)
    arm = np.array(equations.function("mass_matrix")(q[0]))
    assert_allclose(
        M,
        np.block(
            [
                [arm, np.zeros((2, 2))],
                [np.zeros((2, 2)), np.diag([m.inertia for m in model.motors])],
            ]
        ),
    )
    assert_allclose(B, np.vstack([np.zeros((2, 2)), np.eye(2)]))
    assert not np.signbit(B).any()
    locked = np.sqrt(eigh(k, arm, eigvals_only=True)[0]) / (2 * np.pi)
    assert second_order.lowest_locked_hz(model, M, K) == pytest.approx(locked)


def test_a_coordinate_without_inertia_is_named() -> None:
    model: Any = Made(
        file="arm.toml",
        i_m=(1,),
        coordinates=[Made(element="upper", name="q1")],
        motors=[Made(name="a"), Made(name="b")],
    )
    check_inertia(model, np.array([np.eye(2), np.diag([1e-12, 1e6])]))
    with pytest.raises(
        ModelError, match=r"arm\.toml.*motor\.b.*singular: b moves no inertia of its own"
    ):
        check_inertia(model, np.array([np.eye(2), np.diag([1.0, 0.0])]))
    with pytest.raises(ModelError, match=r"element\.upper.*: q1 moves no inertia"):
        check_inertia(model, np.diag([0.0, 1.0]))
    check_inertia(model, np.array([[1.0, 1.0 - 1e-13], [1.0 - 1e-13, 1.0]]))
    with pytest.raises(ModelError, match="singular"):
        check_inertia(model, np.array([[1.0, 1.0 - 1e-15], [1.0 - 1e-15, 1.0]]))


# --- curves --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("points", "good"),
    [
        ([[0, 5], [10, 5], [20, 3], [30, 0]], True),
        ([[0, 5], [10, 4], [20, 3]], True),
        ([[0, 5], [10, 5]], True),
        ([[0, 5]], False),
        ([[1, 5], [10, 4]], False),
        ([[0, 0], [10, 0]], False),
        ([[0, 5], [10, -1]], False),
        ([[0, 5], [10, 5.1]], False),
        ([[0, 5], [10, 3], [20, 2]], False),  # falls slower
        ([[0, 5], [10, 4], [10, 3]], False),
        ([[0, 5, 1], [10, 4, 1]], False),
        ([[0, 5], [10, np.nan]], False),
    ],
)
def test_a_curve_of_torques_bounds_a_convex_region(points: list[list[float]], good: bool) -> None:
    assert is_torque_speed(np.array(points, dtype=float)) is good
    if good:
        assert checked_curves("m", [points, []]) == (tuple(map(tuple, points)), ())
    else:
        with pytest.raises(
            ArgumentError, match=r"^m: given .*, expected two or more points \[speed, torque\]"
        ):
            checked_curves("m", [[], points])
    assert checked_curves("m", [[], ()]) == ()


# --- comparison ----------------------------------------------------------------------------------
def test_a_comparison_tells_how_long_its_simulations_take(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the verification each."""
    told: list[str] = []
    made: list[Any] = [Made(method="rigid"), Made(method="lq")]
    monkeypatch.setattr(comparison, "derive", lambda model: model)
    monkeypatch.setattr(
        comparison, "compare_methods", lambda equations, solution, log: tuple(made)
    )
    monkeypatch.setattr(
        comparison, "compare_plants", lambda equations, named, progress: [{"named": sorted(named)}]
    )
    monkeypatch.setattr(comparison, "duration", lambda seconds: f"{seconds:g} s")
    monkeypatch.setattr(comparison, "error_rows", lambda solutions: len(solutions))
    compare: Any = comparison.compare
    while hasattr(compare, "__wrapped__"):
        compare = compare.__wrapped__
    solution: Any = Made(interrupted=False, model="arm", simulation=Made(wall_s=8.0), method="lq")
    monkeypatch.setattr(
        comparison, "Comparison", lambda solution, solutions, rows=None: (len(solutions), rows)
    )
    assert compare(solution, progress=told.append) == (2, None) and told == []
    assert compare(solution, robustness=True, progress=told.append) == (
        2,
        [{"named": ["lq", "rigid"]}],
    )
    runs = 2 * len(comparison.PLANTS) * len(comparison.CONTROLS)
    assert told == [f"robustness: {runs} simulations, about {2.0 * runs:g} s"]
    solution.simulation = None
    assert compare(solution, robustness=True, progress=told.append) == (0, [{"named": ["lq"]}])
    assert told[1:] == [f"robustness: {runs // 2} simulations"]
    solution.interrupted = True
    with pytest.raises(
        ArgumentError,
        match=r"^solution: given one that was interrupted, expected a solution of the whole",
    ):
        compare(solution)
