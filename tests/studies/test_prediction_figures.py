"""Figures of `flexgen.predict` against their definitions, for the robots that were drawn; the text
of a prediction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.studies.tolerances.prediction import quantile_of_robots
from flexgen.studies.tolerances.response import Along, linear_response, linearize, response
from flexgen.studies.tolerances.result import Prediction, Share
from flexgen.studies.tolerances.sources import Sources, sources_of

# Two springs that are soft together, and masses: the first three sources are correlated.
TABLE = {
    "masses": 0.15,
    "payload": 30.0,
    "parameters": ["q1.stiffness", "q2.stiffness"],
    "sd": [0.1, 0.15],
    "correlation": [1.0, 0.7, 0.7, 1.0],
}
ROBOT = flexgen.read("elbow", overrides={"uncertainty": TABLE})


class Case:
    """A prediction, and what it is made of."""

    def __init__(self) -> None:
        equations = derive(ROBOT)
        self.found: Prediction = flexgen.predict(equations, robots=20, seed=4, progress=False)
        self.sources: Sources = sources_of(ROBOT, ROBOT.uncertainty)
        self.along: Along = linearize(equations, self.found.solution.trajectory, self.sources)
        self.first = linear_response(self.along)
        draws = np.random.default_rng(4).standard_normal((4000, self.sources.root.shape[1]))
        self.errors = self.sources.errors(draws)
        self.at = np.unique(np.linspace(0, len(self.along.t) - 1, 200).astype(int))

    def effective(self, robots: int) -> np.ndarray:
        """Errors to first order in the forces: a softer spring bends more."""
        own = self.errors[:robots].copy()
        own[:, self.sources.springs] /= 1 + own[:, self.sources.springs]
        return own

    def largest(self, errors: np.ndarray) -> np.ndarray:
        """Largest error of each robot over time, to first order."""
        sizes = [np.linalg.norm(errors @ rows, axis=1) for rows in self.first.error[self.at]]
        return np.max(sizes, axis=0)


@pytest.fixture(scope="module")
def case() -> Case:
    return Case()


def test_simulated_robots_have_the_largest_error_of_their_response(case: Case) -> None:
    exact = response(case.along, case.errors[:20]).error
    expected = [max(np.linalg.norm(x) for x in exact[:, k]) for k in range(20)]
    assert case.found.errors_m == pytest.approx(expected, rel=1e-12)
    assert case.found.error_rad is None and case.found.errors_rad is None


def test_the_error_that_most_robots_keep(case: Case) -> None:
    """Of many robots to first order, corrected by the line through the simulated ones: near the
    plain quantile of both.
    """
    first = case.largest(case.effective(1000))
    exact = case.found.errors_m
    slope, offset = np.polyfit(np.log(first[:20]), np.log(exact), 1)
    rest = np.log(exact) - slope * np.log(first[:20]) - offset
    line = np.exp(slope * np.log(first) + offset)
    assert case.found.error_m == pytest.approx(np.quantile(line, 0.95), rel=0.05 + np.std(rest))


def test_robots_on_a_line_have_its_quantile() -> None:
    first = np.linspace(1.0, 2.0, 4001)
    assert quantile_of_robots(2 * first[:41] ** 1.5, first, 0) == pytest.approx(2 * 1.95**1.5)
    assert quantile_of_robots(np.array([1.0, np.inf]), first, 0) is None  # one is unstable
    grown = np.append(np.full(31, 2e-4), 1e14)  # and this one only finite at its end
    assert quantile_of_robots(grown, np.full(32, 2e-4), 0) is None
    assert quantile_of_robots(np.full(3, 0.25), np.ones(5), 0) == pytest.approx(0.25)


def test_shares_are_covariances_with_the_whole_error(case: Case) -> None:
    """By many draws of the normal errors, at the instant of the largest variance."""
    z = np.random.default_rng(1).standard_normal((10_000, case.sources.root.shape[1]))
    x = case.sources.sd * (z @ case.sources.root.T)
    wholes = [x @ case.first.error[k] for k in case.at]
    k = int(np.argmax([(whole**2).sum() for whole in wholes]))
    parts = x[:, :, None] * case.first.error[case.at[k]]
    own = (parts * wholes[k][:, None]).sum(axis=(0, 2)) / (wholes[k] ** 2).sum()
    found = {share.name: share.share for share in case.found.shares}
    expected = dict(zip(case.sources.names, own, strict=True))
    assert found == pytest.approx(expected, abs=0.02)
    assert [s.share for s in case.found.shares] == sorted(found.values(), reverse=True)
    kinds = dict(zip(case.sources.names, case.sources.kinds, strict=True))
    assert all(share.kind == kinds[share.name] for share in case.found.shares)


def test_what_to_measure_is_the_shortest_list_that_halves_the_error(case: Case) -> None:
    """Search over all numbers of the largest sources."""
    errors = case.effective(1000)
    half = np.quantile(case.largest(errors), 0.95) / 2
    order = [case.sources.names.index(share.name) for share in case.found.shares]
    halving = []
    for count in range(1, len(order) + 1):
        left = errors.copy()
        left[:, order[:count]] = 0.0
        if np.quantile(case.largest(left), 0.95) <= half:
            halving.append(count)
    names = tuple(share.name for share in case.found.shares[: min(halving)])
    assert case.found.to_halve == names and 1 < len(names) < len(order)


@pytest.mark.parametrize("name", ["torque", "deflection"])
def test_bands_contain_the_middle_of_the_robots(case: Case, name: str) -> None:
    """To first order, around the plan, at three instants."""
    band = getattr(case.found, name)
    rows = case.first.tau_m if name == "torque" else case.first.deflection
    planned = case.along.motion["tau_m" if name == "torque" else "deflection"]
    assert band.names == (("m1", "m2") if name == "torque" else ("q1", "q2"))
    for i in (20, 90, 150):
        k = case.at[i]
        of_robots = [planned[k] + x @ rows[k] for x in case.effective(400)]
        assert band.planned[i] == pytest.approx(planned[k])
        assert band.low[i] == pytest.approx(np.quantile(of_robots, 0.025, axis=0))
        assert band.high[i] == pytest.approx(np.quantile(of_robots, 0.975, axis=0))
    assert case.found.time[20] == case.along.t[case.at[20]]


# --- the text


def changed(case: Case, **changes: Any) -> Prediction:
    shares = (Share("a", "x", 0.75), Share("b", "y", 0.2451), Share("c", "y", 0.004))
    fields: dict[str, Any] = {
        "error_m": 1.5e-4,
        "error_rad": 2e-3,
        "shares": shares,
        "to_halve": ("a", "b"),
    }
    return replace(case.found, **(fields | changes))


def test_the_text_of_a_prediction(case: Case) -> None:
    made = changed(case)
    sentence = "tool error 95 % <= 150 um and <= 2 mrad"
    title = ROBOT.title
    assert str(made).splitlines() == [
        f"{title}, move line",
        f"{sentence} with motor feedback (5 uncertain numbers, 20 robots simulated)",
        made.feedback.title,
        "shares of the variance: a 75 %, b 25 %",
        "to halve the error, measure a, b",
    ]
    assert made.problem == "" and repr(made) == f"<Prediction {title}, line: {sentence}>"
    values = [figure.value for figure in made.figures()]
    assert values == [1.5e-4, 2e-3, made.feedback.title, 5, 20, "75.0", "24.5", "a, b"]


NAMES = tuple("abcdefghij")
LINES: dict[str, tuple[dict[str, Any], int, str]] = {
    "no length": ({"error_m": None}, 0, "tool error 95 % <= 2 mrad with motor feedback"),
    "no angle": ({"error_rad": None}, 0, "tool error 95 % <= 150 um with motor feedback"),
    "nothing": (
        {"error_m": None, "error_rad": None},
        0,
        "tool error 95 % not known: a robot with the motor feedback is unstable with",
    ),
    "ended early": (
        {"ended": "time limit"},
        0,
        "tool error 95 % <= 150 um and <= 2 mrad with motor feedback (5 uncertain numbers, 20 "
        "robots simulated, then time limit)",
    ),
    "many shares": (
        {"shares": tuple(Share(x, "", 0.1) for x in NAMES)},
        2,
        "shares of the variance: " + ", ".join(f"{x} 10 %" for x in NAMES[:8]),
    ),
    "many to measure": (
        {"to_halve": NAMES},
        3,
        "to halve the error, measure a, b, c, d, e, f, g, h and 2 more",
    ),
    "eight to measure": (
        {"to_halve": NAMES[:8]},
        3,
        "to halve the error, measure a, b, c, d, e, f, g, h",
    ),
}


@pytest.mark.parametrize("name", LINES)
def test_lines_of_a_prediction(case: Case, name: str) -> None:
    changes, number, text = LINES[name]
    line = changed(case, **changes).lines()[number]
    assert line == text if number else line.startswith(text)


PROBLEMS: dict[str, dict[str, Any]] = {
    "a robot with the motor feedback is unstable": {"error_m": None, "error_rad": None},
    "time limit: the figures are those of 20 robots": {"ended": "time limit"},
    "": {"error_m": None},
}


@pytest.mark.parametrize("problem", PROBLEMS)
def test_problems_of_a_prediction(case: Case, problem: str) -> None:
    assert changed(case, **PROBLEMS[problem]).problem == problem


def test_an_output_of_coordinates_has_no_tool(case: Case) -> None:
    output = replace(ROBOT.output, type="combination")
    solution = replace(case.found.solution, model=replace(ROBOT, output=output))
    assert changed(case, solution=solution).sentence().startswith("output error 95 % <= 150 um")
