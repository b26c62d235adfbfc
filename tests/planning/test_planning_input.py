"""`flexgen.plan_problem`: bad input."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.planning.optimal import problem as problem_module
from flexgen.planning.optimal.transcribe import Layout


@pytest.fixture(scope="module")
def planar():
    return flexgen.derive("planar5_nmp")


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda p: p["tau"], "did you mean 'tau_m'"),
        (lambda p: p["tau_m[m9]"], r"given entry 'm9', expected one of m1, m2"),
        (lambda p: p.nodes("velocity"), "expected one of q_a"),
        (lambda p: p.bound("q_q", 0, 1), "did you mean"),
        (lambda p: p.bound("q_a", [1, 2], 3), "expected a number or 3 numbers"),
        (lambda p: p.bound("q_a", np.nan), "given NaN"),
        (lambda p: p.bound("q_a", 2, 1), "lower bound above the upper one"),
        (lambda p: p.add_cost(p["tau_m"]), "expected a scalar"),
        (lambda p: p.add_cost("tau_m"), "expected an expression of signals"),
        (lambda p: p.add_cost(1.0, at="middle"), "expected one of path, start, end"),
        (lambda p: p.add_cost(ca.SX.sym("x")), "given an expression of x"),
        (lambda p: p.subject_to(p["tau_m"]), "expected a comparison"),
        (lambda p: p.subject_to(True), "expected a comparison"),
        (lambda p: p.free_time(2, 1), "lower bound below the upper one"),
        (lambda p: p.free_time(-1, 1), "positive time"),
        (lambda p: p.follow(0.0), "tolerance: given 0.0"),
        (lambda p: p.avoid("ball"), "expected a flexgen.Sphere or a flexgen.HalfSpace"),
        (lambda p: p.avoid(flexgen.Sphere((0, 0, 0), -1)), "radius"),
        (lambda p: p.start_at([1.0]), "expected 3 finite numbers"),
        (lambda p: p.then(0.0), "duration: given 0.0"),
        (lambda p: p.parameter("k", 0, 1, guess=2), "parameter k: given guess 2"),
        (lambda p: p.parameter("k", guess=None), "parameter k: given guess None"),
        (
            lambda p: (p.parameter("k"), p.parameter("k")),
            "parameter k: there is one of this name already",
        ),
        (
            lambda p: p.add_cost(flexgen.plan_problem(p.equations)["time"]),
            "given an expression of t, expected",
        ),
        (
            lambda p: p.add_cost(flexgen.plan_problem(p.equations).parameter("k")),
            "given an expression of k, expected",
        ),
        (
            lambda p: p.add_cost(flexgen.plan_problem(p.equations).nodes("time")[1]),
            "phases of this problem",
        ),
        (lambda p: p.subject_to(p["tau_m"] <= 1, slack=np.nan), "slack: given nan"),
        (lambda p: p.subject_to(p["tau_m"] <= 1, slack=-1), "slack: given -1"),
        (lambda p: p.add_squares(p["tau_m"], weight="a"), "weight: given 'a'"),
        (lambda p: p.end_at("abc"), "expected 3 finite numbers"),
        (lambda p: p.avoid(flexgen.Sphere((0, 0, 0), "a")), "radius: given 'a'"),
        (lambda p: p.solve(compiled=3), "compiled: given 3"),
        (lambda p: p.then(1.0, mesh="q"), "mesh: given 'q'"),
        (lambda p: p.avoid(flexgen.Sphere(("a", 1, 2), 1)), "expected three finite numbers"),
        (lambda p: p.solve(time_limit="a"), "time_limit: given 'a'"),
        (lambda p: p.solve(time_limit=np.nan), "time_limit: given nan"),
        (lambda p: p.solve(guess=np.zeros(3)), "expected 'rest', 'lq'"),
        (lambda p: p.solve(guess="nosuch"), "expected 'rest', 'lq'"),
        (lambda p: p.solve(warm=True), "no solution of a problem of this size"),
        (lambda p: p.solve(hessian="bfgs"), "expected one of auto, exact, gauss-newton"),
        (lambda p: p.solve(accuracy=0), "accuracy: given 0"),
        (lambda p: p.solve(max_iterations=0), "max_iterations"),
        (lambda p: (p.add_cost(np.nan * p["tau_m"][0]), p.solve()), "'cost' is NaN or infinite"),
        (
            lambda p: (p.subject_to(ca.log(p["q_a"][0] - 9) <= 1, name="log"), p.solve()),
            "'log' is NaN or infinite",
        ),
    ],
)
def test_bad_input_is_refused(planar, call, text):
    with pytest.raises(ArgumentError, match=text):
        call(flexgen.plan_problem(planar, mesh=5))


@pytest.mark.parametrize("more", [-1, 0, 1])
def test_a_warm_start_has_the_size_of_the_problem(planar, more, monkeypatch):
    problem = flexgen.plan_problem(planar, mesh=5)
    size = Layout(tuple(problem.phases), ()).size
    problem._warm = SimpleNamespace(x=np.zeros(size + more))
    problem._warm_x = "where the last one ended"

    def program(layout, scale, start, exact, compiled):
        raise StopIteration(start)

    monkeypatch.setattr(problem_module, "scales", lambda layout, parameters, start: 1.0)
    monkeypatch.setattr(problem, "_program", program)
    if more == 0:
        with pytest.raises(StopIteration, match="where the last one ended"):
            problem.solve(warm=True)
    else:
        with pytest.raises(ArgumentError, match="no solution of a problem of this size"):
            problem.solve(warm=True)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"scheme": "euler"}, "expected one of gauss3, radau, hermite-simpson"),
        ({"mesh": 0}, "expected 1 to 5000"),
        ({"mesh": True}, "mesh: given True"),
        ({"mesh": "abc"}, "mesh: given 'abc'"),
        ({"mesh": [0, "a", 1]}, "increasing relative nodes"),
        ({"mesh": [0.0, 0.5, 0.4, 1.0]}, "increasing relative nodes"),
        ({"timing": "slow"}, "expected one of given, free"),
        ({"limits": 3}, "limits: given 3"),
        ({"move": "lin"}, "did you mean 'line'"),
    ],
)
def test_bad_problems_are_refused(planar, arguments, text):
    with pytest.raises(ArgumentError, match=text):
        flexgen.plan_problem(planar, **arguments)


def test_the_guess_of_another_robot_is_refused(planar):
    other = flexgen.solve("elbow", verify=False)
    with pytest.raises(SolverError, match="expected one of planar5_nmp"):
        flexgen.plan_problem(planar, mesh=5).solve(guess=other)
