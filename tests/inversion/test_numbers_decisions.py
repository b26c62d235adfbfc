"""Decisions of searches and of ranks, with what they decide on given: gaps, halved steps, costs,
frames at the base.
"""

from __future__ import annotations

import re
from types import SimpleNamespace as Made
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import SolverError
from flexgen.codegen.build import compiler
from flexgen.codegen.recursion import column_functions
from flexgen.identification.poses.tree import Mount, Tree, rotations
from flexgen.inversion.comparison import discretized
from flexgen.inversion.comparison.strangeness_free import StrangenessFree
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods import baselines
from flexgen.inversion.problem import problem_text


def with_array(
    monkeypatch: pytest.MonkeyPatch, M: np.ndarray, N: np.ndarray, corank: int
) -> StrangenessFree:
    """Two unknowns and an array of order one with these Jacobians."""
    made = object.__new__(StrangenessFree)
    made.n = 2
    made.mu = 1
    made.__dict__["_ranks"] = corank, 2 - corank, 1e9
    made._at_rest = np.zeros((2, 3)), np.zeros((1, 2))
    monkeypatch.setattr(StrangenessFree, "_jacobians", lambda self, X, U: (N, M))
    return made


@pytest.mark.parametrize(("small", "clear"), [(0.0, True), (4.97e-2, True), (5.03e-2, False)])
def test_ranks_are_clear_from_a_gap_of_a_hundred_on(
    small: float, clear: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The part of the array that is left has no derivatives; the others are those that it
    reaches.
    """
    rng = np.random.default_rng(4)
    M = np.diag([9.0, 7.0, 5.0, small])[:, [2, 0, 3, 1]]
    N = rng.normal(size=(4, 2))
    made = with_array(monkeypatch, M, N, 1)
    if not clear:
        with pytest.raises(
            SolverError,
            match="the rank of the derivative array changes on the path, at a singular",
        ):
            made.split(np.zeros((2, 3)), np.zeros((1, 2)))
        return
    split = made.split(np.zeros((2, 3)), np.zeros((1, 2)))
    assert split.gap == pytest.approx(5.0 / max(small, 1e-300))
    assert_allclose(split.Z2.T @ M, [[0.0, 0.0, small, 0.0]] * np.sign(split.Z2[3]), atol=1e-12)
    assert_allclose(split.Z2.T @ N @ split.T2, 0.0, atol=1e-12)
    assert_allclose(split.Z1 @ split.Z1.T @ M[:2, :2] @ split.T2, M[:2, :2] @ split.T2, atol=1e-12)
    assert split.T2.shape == split.Z1.shape == (2, 1) and np.linalg.norm(
        split.T2
    ) == pytest.approx(1.0)
    rows = rng.normal(size=4)
    left = split.factors[0].T @ (rows + M @ split.solve(rows))
    assert_allclose(left, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("pivots", "N", "expected"),
    [
        ([9.0, 7.0, 5.0, 4e-9], [0, 0, 0, 1.0], (1, 1, 5.0 / 4e-9)),
        ([9.0, 7.0, 5.0, 5.0], [0, 0, 0, 1.0], (0, 2, np.inf)),
        # above 1e-9 of the largest: no zero
        ([9.0, 7.0, 5.0, 1e-8], [0, 0, 0, 1.0], (0, 2, np.inf)),
        ([9.0, 7.0, 0.8e-6, 8.9e-9], [0, 0, 0, 1.0], None),  # a gap of 90
        ([9.0, 7.0, 0.91e-6, 8.9e-9], [0, 0, 0, 1.0], (1, 1, 0.91e-6 / 8.9e-9)),
        ([9.0, 7.0, 5.0, 0.0], [0, 0, 0, 0.0], None),  # a constraint of nothing
        ([0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0], None),  # more constraints than unknowns
    ],
)
def test_equations_are_counted_at_rest(
    pivots: list[float], N: list[float], expected: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A row of the array without derivatives is an algebraic equation, of the second unknown."""
    made = with_array(monkeypatch, np.diag(pivots), np.outer(N, [0.0, 1.0]), 0)
    del made.__dict__["_ranks"]
    if expected is None:
        words = "the derivative array of order 1 does not make the DAE regular: corank"
        with pytest.raises(SolverError, match=words):
            made.a  # noqa: B018, a property
        return
    assert (made.a, made.d) == expected[:2] and made.gap == pytest.approx(expected[2])


class Steps:
    """Steps of given sizes; the residual of a trial is that of its function."""

    scale_y: ClassVar[np.ndarray] = np.array([2.0])
    tau_0: ClassVar[np.ndarray] = np.array([4.0])

    def __init__(
        self, sizes: list[float], violation: Any = lambda y: 0.0, torque: float = 0.0
    ) -> None:
        self.sizes = sizes
        self.of = violation
        self.torque = torque
        self.trials = list[float]()

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(1), np.zeros(1)

    def violation(self, y: np.ndarray, tau: np.ndarray) -> float:
        self.trials.append(float(y[0]))
        return float(self.of(float(y[0])))

    def step(self, y: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([2.0 * self.sizes.pop(0)]), np.array([self.torque])

    def solution(self, y: np.ndarray, tau: np.ndarray, count: int) -> Any:
        return float(y[0]), float(tau[0]), count


def discretize(system: Steps, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, list[str]]:
    told: list[str] = []
    monkeypatch.setattr(discretized, "_System", lambda *given: system)
    problem: Any = Made(log=told.append)
    return discretized.discretize(problem, 0.1, 4, 0.0, 0.0), told


def test_steps_of_a_discretized_motion_are_halved_where_they_shrink_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From 0.7 of the step before on; then doubled up to whole ones, until a step is below
    1e-9.
    """
    sizes = [1.0, 0.71, 0.72, 0.5, 0.3, 0.2, 0.9e-9]
    lengths = [1.0, 0.5, 0.25, 0.5, 1.0, 1.0, 1.0]
    system = Steps(list(sizes))
    (y, _, count), told = discretize(system, monkeypatch)
    assert_allclose(system.trials, [0.0, *np.cumsum(2.0 * np.array(sizes) * lengths)])
    assert count == 7 and y == system.trials[-1]
    first = "discretized, step 1: coordinates  1.00e+00, torques  0.00e+00, residual  0.00e+00"
    assert told[0] == first and len(told) == 7


def test_a_step_that_makes_the_residual_worse_is_halved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until it has at most twice the residual before, or 1e-4, or is a thousandth of itself."""
    system = Steps([1.0, 1e-9], lambda y: 2e-4 * abs(y))
    assert discretize(system, monkeypatch)[0][0] == pytest.approx(0.5 + 2e-9)
    assert_allclose(system.trials, [0.0, 2.0, 1.0, 0.5, 0.5 + 2e-9], rtol=1e-12)
    system = Steps([1.0, 1e-9], lambda y: 1.0 + 0.9 * abs(y))  # twice 1.0 is allowed
    assert discretize(system, monkeypatch)[0][0] == pytest.approx(1.0)
    system = Steps([1.0, 1e-9], lambda y: 0.0 if y == 0 else 1.0)
    discretize(system, monkeypatch)
    assert system.trials[1:12] == [2.0 / 2**k for k in range(11)]  # 1/1024 is below a thousandth
    assert system.trials[12] == pytest.approx(2.0 / 1024 + 2e-9)


def test_a_discretized_motion_ends_with_small_torques_or_refuses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Steps of torques are over those of the robot: 1e-5 of them ends; what is not finite ends at
    once.
    """
    assert discretize(Steps([1e-9] * 40, torque=4e-5), monkeypatch)[0][2] == 1
    text = (
        "no convergence in 40 steps, the last one 1.0e-09 rad or m and 1.1e-05 of the torque, "
        "residual 0.0e+00; try"
    )
    with pytest.raises(SolverError, match=re.escape(text)):
        discretize(Steps([1e-9] * 40, torque=4.4e-5), monkeypatch)
    with pytest.raises(SolverError, match=r"no convergence in 1 steps, .* residual nan"):
        discretize(Steps([1.0] * 40, lambda y: np.nan), monkeypatch)


def test_loops_are_used_where_they_need_less_than_six_tenths(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the operations of one expression for each entry of the mass matrix."""
    steps = ["steps"]
    at = {"chain": "chain", "direct": "direct", "cost": 59.9}
    monkeypatch.setattr(column_functions, "long_chain", lambda equations: at["chain"])
    monkeypatch.setattr(column_functions, "fast_function", lambda equations, name: at["direct"])
    monkeypatch.setattr(column_functions.columns, "mass_matrix", lambda chain, target: steps)
    monkeypatch.setattr(column_functions, "operations_of", lambda direct: 100)
    monkeypatch.setattr(column_functions, "cost", lambda given: at["cost"])
    shorter: Any = column_functions.shorter_mass_matrix
    assert shorter(None, "M") is steps
    at["cost"] = 60.0
    assert shorter(None, "M") is None
    for name in ("chain", "direct"):
        at.update(chain="chain", direct="direct", cost=1.0)
        at.update({name: None})
        assert shorter(None, "M") is None


def test_points_of_the_base_and_of_the_first_node() -> None:
    """The base stands still; the first node, a shift along x, moves what it carries along x."""
    tree = Tree(flexgen.read("elbow"))
    q = np.zeros((2, len(tree.nodes)))
    q[:, 0] = 0.1, 0.3
    at = tree.posture(q)
    shift = np.array([0.2, 0.0, -0.1])
    point = np.array([0.5, 0.6, 0.7])
    turned = rotations(np.array([0.0, 0.0, 1.0]), np.array([np.pi / 2]))[0]
    moved = shift + np.array([-0.6, 0.5, 0.7])
    fixed = tree.point(at, Mount(-1, shift, turned), point)
    assert_allclose(fixed, [moved, moved], atol=1e-15)
    assert not tree.point_slopes(at, Mount(-1, shift, turned), fixed).any()
    carried = tree.point(at, Mount(0, shift, turned), point)
    assert_allclose(carried, moved + q[:, :1] * [1.0, 0.0, 0.0], atol=1e-15)
    slopes = tree.point_slopes(at, Mount(0, shift, turned), carried)
    assert_allclose(slopes[:, :, 0], [[1.0, 0.0, 0.0]] * 2, atol=1e-15)
    assert not slopes[:, :, 1:].any()


def test_a_baseline_has_the_torques_of_its_gears() -> None:
    """The first of each gear; the later columns are their rates."""
    motion = Made(q="q", v="v", a="a", tau_g=np.arange(24.0).reshape(4, 2, 3))
    motors = Made(tau_m=np.zeros((4, 2)))
    made = baselines._result(np.arange(4.0), motion, motors)  # type: ignore[arg-type]
    assert made.tau_g.tolist() == [[0.0, 3.0], [6.0, 9.0], [12.0, 15.0], [18.0, 21.0]]
    assert (made.q, made.v, made.a, made.status) == ("q", "v", "a", Status.BASELINE)


def test_the_first_errors_of_a_program_are_told() -> None:
    """Five lines with that word, or the first five of any; without lines its status."""
    lines = [f"{k}: Error of {k}" for k in range(7)]
    mixed = "\n".join(["note", "", *lines])
    for stderr, expected in (
        (mixed, lines[:5]),
        ("a\n\nb\n  \nc\nd\ne\nf\n", ["a", "b", "c", "d", "e"]),
        (" \n", ["exit status 3, without a message"]),
    ):
        assert compiler._errors(Made(stderr=stderr, returncode=3)) == "\n  ".join(expected)


def failed(status: Status, **more: Any) -> Any:
    """A solution that cannot be used; by default its simulation deviates."""
    fields: dict[str, Any] = {
        "stopped": "",
        "warnings": (),
        "method": "lq",
        "model": None,
        "trajectory": None,
        "details": {},
    }
    fields |= {"simulation": Made(energy_error=1e-9, feedback=None), "residual_relative": 2e-3}
    fields |= {"tool_error_max_m": 2e-3, "tool_error_max_rad": None}
    fields |= {"plan_error_max": None, "plan_error_max_m": 3e-3, "plan_error_max_rad": None}
    return Made(status=status, **(fields | more))


def test_what_a_solution_misses_is_told_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first reason that holds, of a search that ended, the energy, the equations, and the
    output.
    """
    status = Status.TOLERANCE_NOT_MET
    told = problem_text.problem_of
    monkeypatch.setattr(
        problem_text, "residual_is_small", lambda solution: solution.residual_relative < 1e-3
    )
    assert told(failed(Status.SOLVED), 1e-4) == ""
    end = "; the trajectory is the best so far"
    assert told(failed(status, stopped="time is over"), 1e-4) == f"{status}: time is over{end}"
    warned = failed(
        status, warnings=("a", "b makes the output deviate", "c makes the output deviate")
    )
    assert told(warned, 1e-4) == f"{status}: b makes the output deviate"
    deviates = f"{status}: the simulated output deviates from the "
    of_path = f"{deviates}path by 2 mm, more than the accuracy 0.0001; give the move more time or "
    for more, expected in (
        ({}, f"{of_path}a finer --mesh"),
        ({"simulation": None}, f"{of_path}a finer --mesh"),
        ({"details": {"cause": "it is too stiff"}}, f"{status}: it is too stiff"),
        ({"method": "fjm"}, f"{of_path}take --method auto or lq, or a finer --mesh"),
        (
            {"plan_error_max": 1.0},
            f"{deviates}plan by 3 mm, more than the accuracy 0.0001; loosen the limits, give the",
        ),
        ({"simulation": Made(energy_error=problem_text.ENERGY, feedback=None)}, of_path),
        (
            {"simulation": Made(energy_error=1.01 * problem_text.ENERGY, feedback=None)},
            f"{status}: the energy balance",
        ),
        (
            {"simulation": Made(energy_error=0.0, feedback=1)},
            f"{status}: the torques do not satisfy the equations of",
        ),
        ({"simulation": Made(energy_error=0.0, feedback=1), "residual_relative": 1e-4}, of_path),
    ):
        assert told(failed(status, **more), 1e-4).startswith(expected)


def test_limits_that_a_solution_exceeds_are_told_with_advice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """More time helps where a speed or a torque exceeds its limit, and not where a range is
    left.
    """
    status = Status.LIMITS_EXCEEDED
    lines = ["m1 exceeds its limit", "q1 leaves its range", "q2 leaves its range"]
    time = "give the move more time, or keep torques and speeds with --limits"
    study = "for studies use --ignore-limits"
    other = "choose another target or path: more time does not help beyond a range"
    for shown, warnings, text in (
        (lines[:1], (), f"{lines[0]}; {time}; {study}"),
        (lines[:2], (), f"{lines[0]}, and 1 more (see the warnings); {other}; {time}; {study}"),
        (lines[1:], (), f"{lines[1]}, and 1 more (see the warnings); {other}; {study}"),
        (
            [],
            ("a", "the stream exceeds its limit"),
            f"the stream exceeds its limit; {time}; {study}",
        ),
    ):
        monkeypatch.setattr(
            problem_text, "limit_warnings", lambda model, trajectory, shown=shown: tuple(shown)
        )
        assert (
            problem_text.problem_of(failed(status, warnings=warnings), 1e-4) == f"{status}: {text}"
        )
