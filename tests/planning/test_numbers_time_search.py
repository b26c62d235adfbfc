"""The search of a time law with the inversion replaced: what it is asked, which samples count, and
their vibration.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.model.elements import Output
from flexgen.planning.fastest import time_search
from flexgen.planning.fastest.time_search import TimeSearch


def search(**more: Any) -> Any:
    """A search without a robot."""
    made = object.__new__(TimeSearch)
    vars(made).update(
        {
            "inversions": 0,
            "force": None,
            "samples": 10,
            "swings": None,
            "tell": print,
            "model": "model",
        }
        | more
    )
    return made


@pytest.mark.parametrize(
    ("period", "mesh", "before", "after", "each"), [(0.1, 0.3, 3, 2, 3), (0.07, 0.01, 4, 3, 1)]
)
def test_an_inversion_of_a_search_has_the_samples_of_its_period(
    period: float, mesh: float, before: int, after: int, each: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many before and after the path as its windows need, and intervals of the mesh of whole
    samples.
    """
    asked: list[Any] = []
    force = Made(name="force")
    pushed = Made(on_output=lambda model, t: (model, t))
    monkeypatch.setattr(
        time_search, "in_time", lambda given, timed: pushed if given is force else None
    )
    reduction = Made(targets=lambda sample: sample.y[:, :, 0])

    def inverted(*y: np.ndarray, **more: Any) -> str:
        asked.append((y, more))
        return "found"

    made = search(library=Made(invert=inverted), _reduction=reduction, _before=0.25, _after=0.2)

    def sampled(t: np.ndarray, orders: int) -> Any:
        y = np.stack([t**k for k in range(orders + 1)], axis=1)[:, None]
        return Made(y=y, derivative=lambda k: y[:, :, k])

    timed = Made(duration=0.7, sample_orders=sampled, q_start=np.array([0.5]))
    found, tool = made.invert(timed, period, mesh, force)
    t = period * np.arange(round(0.7 / period) + 1)
    ((values, more),) = asked
    for k, value in enumerate(values):
        assert_allclose(value[:, 0], t**k)
    assert (
        found == "found"
        and made.inversions == 1
        and more["period"] == period
        and more["q_start"][0] == 0.5
    )
    assert (more["n_pre"], more["n_post"], more["samples_per_interval"]) == (before, after, each)
    assert more["force"][0] == "model"
    assert_allclose(more["force"][1], t)
    made.invert(timed, period, mesh, None)
    assert asked[1][1]["force"] is None and made.inversions == 2
    assert callable(tool)


def test_the_motion_of_the_tool_is_that_of_the_reference_where_the_output_has_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With rest before and after the path; of another output from the joints."""
    monkeypatch.setattr(time_search, "norms", lambda speed, acceleration: (speed, acceleration))
    monkeypatch.setattr(time_search, "tool_motion", lambda *given: given)
    found = Made(n_pre=2, n_post=1, q_a="q", v_a="v", a_a="a")
    y = np.arange(24.0).reshape(2, 3, 4)
    for output, own in (
        (Output("tool_pose"), True),
        (Output("tool_position"), True),
        (Output("tool_position", "xz"), False),
        (Output("combination", ""), False),
    ):
        made = search(model=Made(output=output), _reduction=Made(equations="equations"))
        motion = made._tool_motion(found, Made(y=y))
        if own:
            for k in (0, 1):
                expected = np.vstack([np.zeros((2, 3)), y[:, :, k + 1], np.zeros((1, 3))])
                assert_array_equal(motion[k], expected)
        else:
            assert motion == ("equations", "q", "v", "a")


def test_constraints_are_limits_at_the_same_number_of_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last check looks at all samples of a mesh that is three times as fine; infinite bounds
    do not count.
    """
    asked: list[Any] = []
    parts = np.arange(60.0)[:, None] * [1.0, 2.0]
    rows = [
        Made(bounds=np.array([[1.0, np.inf]]), parts=parts),
        Made(bounds=np.array([[1.0, 1.0]]), parts=np.array([[7.0, 8.0]])),
        Made(bounds=np.array([[np.inf, 1.0]]), parts=parts[:-1]),
    ]

    def limit_rows(model: str, limits: str, channel: Any, t: str, tool: str, end: float) -> Any:
        asked.append((model, limits, channel("tau_m").shape, t, tool, end))
        return rows

    monkeypatch.setattr(time_search, "limit_rows", limit_rows)
    found = Made(tau_m=np.zeros((60, 2)), n_pre=12, t="t")
    speeds = Made(parts=lambda law: np.array([0.25]))
    made = search(limits="limits", speeds=speeds, _resolving=np.inf)
    made.retime = lambda x: Made(duration=x[0], segments=[Made(law="law")])

    def invert(timed: Any, period: float, mesh: float, force: Any) -> Any:
        asked.append((timed.duration, period, mesh, force))
        return found, "tool"

    made.invert = invert
    at = np.arange(7, 28)  # ten samples of the path, half as many before and after it
    assert_allclose(made.constraints(np.array([2.0, 0.5])), [0.25, *at, 7.0, 8.0, *(2.0 * at)])
    assert asked[0] == (2.0, 0.2, 5e-3, None) and asked[1] == (
        "model",
        "limits",
        (60, 2),
        "t",
        "tool",
        2.0,
    )
    every = np.arange(60.0)
    assert_allclose(
        made.constraints(np.array([2.0, 0.5]), 3), [0.25, *every, 7.0, 8.0, *(2.0 * every[:-1])]
    )
    assert (
        asked[2][1:3] == (pytest.approx(2.0 / 30), pytest.approx(5e-3 / 3)) and made.found is found
    )
    assert made.excess(np.array([2.0, 0.5])) == 2.0 * 58 - 1.0
    assert (
        search(_resolving=0.002).mesh(2.0) == pytest.approx(4e-3)
        and search(_resolving=0.01).mesh(2.0) == 5e-3
    )


def test_vibrations_are_norms_over_the_allowed_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an inversion without finite torques: far too large."""
    values = np.array([[[3.0, 4.0], [0.0, 0.0]], [[6.0, 8.0], [np.nan, 1.0]]])
    asked: list[Any] = []

    class Vibration:
        plants = Made(names=["less", "more"])

        def __call__(self, trajectory: Any, end: float, force: Any) -> np.ndarray:
            asked.append((trajectory, end, force))
            return np.nan_to_num(values) if trajectory == "solved" else values

    monkeypatch.setattr(
        time_search, "trajectory_of", lambda found, begin, name: (found, begin, name)
    )
    monkeypatch.setattr(time_search, "in_time", lambda force, timed: f"{force} along {timed}")
    monkeypatch.setattr(
        time_search,
        "make_force",
        lambda trajectory, model, end: f"force of {trajectory} until {end}",
    )
    monkeypatch.setattr(time_search, "has_springs", lambda model: True)
    made = search(model=Made(name="arm"), found="found", swings=2.0)
    vars(made)["_vibration"] = Vibration()
    assert_allclose(made.swing(np.array([1.5, 0.2])), [2.5, 0.0, 5.0, 1e3])
    made.swings = None
    assert_allclose(made.swing(np.array([1.5, 0.2])), [5.0, 0.0, 10.0, 1e3])
    assert asked[0] == (("found", 0.0, "arm"), 1.5, None)
    solution = Made(move=Made(duration=2), trajectory="solved")
    assert made.vibrations(solution) == {"less": 5.0, "more": 10.0} and asked[-1] == (
        "solved",
        2.0,
        None,
    )
    made.force = "push"
    made.retime = lambda x: f"T = {x[0]}"
    made.swing(np.array([1.5, 0.2]))
    assert asked[-1][2] == "push along T = 1.5"
    made.vibrations(solution)
    assert asked[-1][2] == "force of solved until 2.0"


def test_a_search_begins_as_fast_as_the_limits_allow() -> None:
    """By halves, eight times: the duration at which the limits are kept, within 2^-8 of that of
    the first law.
    """
    made = search()
    made.start = lambda: np.array([4.0, 0.3])
    made.try_constraints = lambda x: (
        None if x[0] < 0.5 else np.array([-0.9 * 1.7 / x[0], 1.7 / x[0]])
    )
    found = made.quick_start()
    assert found[1] == 0.3 and 1.7 <= found[0] < 1.7 + 4.0 / 256
    made.try_constraints = lambda x: np.array([9.0])
    assert made.quick_start()[0] == 4.0
    slow = made.slower(np.array([2.0, 0.3]), np.array([0.1, 0.5]))
    assert_allclose(slow, [2.3, 0.3])
    assert made.slower(np.array([2.0, 0.3]), 0.0)[0] == pytest.approx(2.0 * (1 + 1e-4))
    assert made.windows(slow) == [(-np.inf, np.inf)]
