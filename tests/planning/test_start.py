"""Where the search for a planned motion begins: guesses at the nodes of each phase, and what is
refused there.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.planning.optimal.start import check_rest, start_of
from flexgen.planning.optimal.transcribe import Layout

RATES = np.array([0.3, -0.2, 40.0, -60.0])  # of both arm joints and both motors


def guess() -> Trajectory:
    """Angles that are t^2 and t^3 in 2 s, torques in proportion to t."""
    t = np.linspace(0.0, 2.0, 201)[:, None]
    rows = {"q": t**2 + t**3, "v": 2 * t + 3 * t**2, "a": 2 + 6 * t}
    channels = {f"{x}_a": y * RATES[:2] for x, y in rows.items()}
    channels |= {f"{x}_m": y * RATES[2:] for x, y in rows.items()}
    channels["tau_m"] = t * [1.0, -2.0]
    ports = {name: Port(name, (2,), "", "") for name in channels}
    labels = {name: ("q1", "q2") if name.endswith("a") else ("m1", "m2") for name in channels}
    labels["tau_m"] = ("m1", "m2")
    return Trajectory(t[:, 0], channels, ports, labels, {"model": "elbow"})


def start(problem: Any, given: Any) -> tuple[Layout, np.ndarray]:
    layout = Layout(tuple(problem.phases), tuple(p.symbol for p in problem.parameters))
    free = problem.timing == "free"
    ends = (problem.y_start, problem.y_end)
    return layout, start_of(layout, problem.path, ends, given, problem.parameters, free=free)


@pytest.mark.parametrize("timing", ["given", "free"])
def test_a_guess_is_spread_over_the_phases(timing: Any) -> None:
    """Two phases take their parts of it, stretched to their durations; derivatives are those in
    relative time. A free path parameter is one more coordinate, with the law of the path.
    """
    problem = flexgen.plan_problem("elbow", "line", mesh=3, timing=timing, limits=False)
    later = problem.then(0.5, mesh=[0.0, 0.4, 1.0])
    problem.parameter("mass", 1.0, 3.0, 2.5)
    layout, x = start(problem, guess())
    first = problem.given_duration
    assert_allclose(x[layout.theta], [first, 0.5, 2.5])
    scale = 2.0 / (first + 0.5)  # of time: the guess takes 2 s
    path = problem.path
    length = path.segments[0].law(np.array([1e9]), 0)[0, 0]
    for phase, begin, T in ((problem, 0.0, first), (later, first, 0.5)):
        mesh = phase.mesh
        at = layout.first[phase.number]
        found = mesh.unpack(x[at : at + mesh.size])
        for sigma, parts in ((mesh.nodes, found[:2]), (mesh.times, found[2:])):
            t = (begin + T * sigma)[:, None] * scale
            rows = [t**2 + t**3, (2 * t + 3 * t**2) * scale * T, (2 + 6 * t) * (scale * T) ** 2]
            wanted = [row * RATES for row in rows]
            if timing == "free":
                u = path.duration / 2.0
                s = path.segments[0].law(np.clip(t[:, 0] * u, 0.0, path.duration), 2) / length
                wanted = [
                    np.c_[row, s[:, k] * (u * scale * T) ** k] for k, row in enumerate(wanted)
                ]
            if sigma is mesh.nodes:
                assert_allclose(parts[0], wanted[0], atol=1e-6)
                assert_allclose(parts[1], wanted[1], atol=1e-5)
                continue
            assert_allclose(parts[0].reshape(wanted[2].shape), wanted[2], atol=1e-3)
            assert_allclose(parts[1].reshape(-1, 2), t * [1.0, -2.0], atol=1e-8)


def test_guesses_by_name() -> None:
    """At rest to rest, or by an inversion of the path, which is the default of a free path."""
    given, free = (
        flexgen.plan_problem("elbow", "line", mesh=3, timing=timing)
        for timing in ("given", "free")
    )
    for problem, default, other in ((given, "rest", "lq"), (free, "lq", "rest")):
        _, x = start(problem, None)
        assert np.array_equal(x, start(problem, default)[1])
        assert not np.array_equal(x, start(problem, other)[1])


@pytest.mark.parametrize("wrong", ["best", 3.0, True])
def test_other_guesses_are_refused(wrong: Any) -> None:
    problem = flexgen.plan_problem("elbow", "line", mesh=3)
    text = f"guess: given {wrong!r}, expected 'rest', 'lq', a Solution or a Trajectory"
    with pytest.raises(ArgumentError, match=text):
        start(problem, wrong)


@pytest.mark.parametrize(
    ("low", "high", "band", "error"),
    [
        (0.0, 100.0 - 0.99e-4, False, None),
        (0.0, 100.0 - 1.01e-4, False, "plan: 'mine' is violated by 0.000101 at the end, where"),
        (100.5, 200.0, True, "plan: 'bound of q_m' is violated by 0.5 at the end, where the arm"),
    ],
)
def test_constraints_hold_at_rest(low: float, high: float, band: bool, error: str | None) -> None:
    """By a millionth of their size; here of motors at 100 rad."""
    problem = flexgen.plan_problem("elbow", "line", mesh=3, limits=False)
    q_m = problem["q_m"][0]
    y = np.array([2.0, 1.0, 100.0, 200.0])
    if band:
        problem.bound("q_m", low, 1e3)
    else:
        problem.subject_to(q_m, low, high, name="mine")
    if error is None:
        check_rest(problem, y, "end")
        return
    with pytest.raises(SolverError, match=error):
        check_rest(problem, y, "end")


def test_what_is_not_known_at_rest_is_not_checked() -> None:
    """Torques, and rows of the other end; what is not finite is an error."""
    problem = flexgen.plan_problem("elbow", "line", mesh=3, limits=False)
    y = np.array([2.0, 1.0, 100.0, 200.0])
    problem.subject_to(problem["tau_m"][0] + problem["q_a"][0], 500.0, 600.0)
    problem.subject_to(problem["q_a"][0] <= 1.0, at="end")
    problem.subject_to(ca.sumsqr(problem["v_a"]), 0.0, 0.0)
    check_rest(problem, y, "start")
    problem.subject_to(1 / problem["v_a"][0], 0.0, 1.0, name="mine")
    with pytest.raises(ArgumentError, match="plan: 'mine' is NaN or infinite at the start"):
        check_rest(problem, y, "start")
