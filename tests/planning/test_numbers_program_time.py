"""Time laws of a program: effective torques by integrals, windows of its motions, and what slows
them down.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.limit_use import LimitRow
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.planning.fastest import program_time
from flexgen.planning.fastest.program_time import ProgramSearch


def search(**more: Any) -> Any:
    """A search without a robot."""
    made = object.__new__(ProgramSearch)
    vars(made).update({"tell": lambda line: None, "force": None, "programs": 0} | more)
    return made


def motion(T: float, torque: list[float], before: int = 7, after: int = 4) -> Any:
    """An inversion with constant torques on its path, and others before and after it."""
    t = np.linspace(0.0, T, 21)
    h = t[1]
    early = -h * np.arange(before, 0, -1)
    late = T + h * np.arange(1, after + 1)
    tau = np.vstack(
        [np.full((before, 2), 1e3), np.tile(torque, (21, 1)), np.full((after, 2), 1e3)]
    )
    return Made(t=np.concatenate([early, t, late]), n_pre=before, n_post=after, tau_m=tau)


def test_effective_torques_are_integrals_over_all_motions_and_pauses() -> None:
    """Torques are straight lines in a pause; what is inverted before and after a path is none of
    it.
    """
    model = flexgen.read("elbow")
    made = search(
        model=model, connecting=Limits(torque_rms=(2.0, np.inf)), pauses=[0.5, 0.0], legs=[]
    )
    x = [np.array([1.5, 0.4]), np.array([0.8, 0.2]), np.array([0.7, 0.3])]
    a = 3.0
    b = -1.0
    c = 2.0
    found = made._effective(
        x, [motion(1.5, [a, 9.0]), motion(0.8, [b, 9.0]), motion(0.7, [c, 9.0], 0, 1)]
    )
    square = (a**2 * 1.5 + 0.5 * (a**2 + a * b + b**2) / 3 + b**2 * 0.8 + c**2 * 0.7) / 3.5
    assert found.shape == (1,) and found[0] == pytest.approx(np.sqrt(square) / 2.0, rel=2e-3)
    assert made.duration(x) == 3.5
    made.connecting = Limits()
    with pytest.raises(ValueError):
        made._effective(x, [motion(1.5, [a, 9.0])] * 3)


def test_motions_have_windows_around_the_middles_of_their_pauses() -> None:
    made = search(pauses=[0.5, 0.1])
    found = made.windows([np.array([1.0]), np.array([2.0]), np.array([3.0])])
    assert_allclose(found, [(-np.inf, 1.27), (1.23, 3.57), (3.53, np.inf)])
    leg = Made(slower=lambda x, e: x * (1 + e))
    slow = search(legs=[leg] * 3).slower([np.array([1.0])] * 3, np.array([0.5, 0.0, -0.5]))
    assert_allclose(np.concatenate(slow), [1.5, 1.0, 1.0])
    assert_allclose(program_time._slower(np.array([2.0, 0.3]), 1.5), [3.0, 0.3])


def test_the_largest_part_of_a_limit_is_that_of_finite_bounds() -> None:
    parts = np.array([[0.2, 9.0], [-0.7, 9.0], [0.9, 9.0]])
    bounds = np.array([[1.0, np.inf]] * 3)
    row = LimitRow("torque", ("N m",) * 2, ("a", "b"), parts, parts, bounds)
    assert program_time._largest(row, slice(None)) == 0.9
    assert program_time._largest(row, np.array([0, 1])) == 0.7
    assert program_time._largest(row, np.array([], int)) == 0.0


def test_a_program_is_checked_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three times as fine as its finest motion; each motion has the largest limit of its window
    and of its speeds.
    """
    asked: list[Any] = []
    t = np.arange(0.0, 4.01, 0.01)
    parts = np.where(t < 1.4, 0.5, 1.2)[:, None] * np.where(t < 2.0, 1.0, -1.1)[:, None]
    one = LimitRow("torque", ("N m",), ("m1",), parts, parts, np.ones((401, 1)))
    whole = LimitRow(
        "effective torque", ("N m",), ("m1",), np.array([[1.04]]), np.ones((1, 1)), np.ones((1, 1))
    )

    def invert(timed: Any, period: float, mesh: float, force: Any) -> Any:
        asked.append((timed, period, mesh, force))
        return Made(t=t), "tool"

    def rows(
        model: Any,
        limits: Any,
        channel: Any,
        time: np.ndarray,
        tool: Any = None,
        end: float = np.inf,
    ) -> Any:
        assert time is t and (tool, end) == (
            ("tool", np.inf) if limits == "single" else (None, 3.3)
        )
        return [one] if limits == "single" else [whole]

    monkeypatch.setattr(program_time, "limit_rows", rows)
    speeds = [Made(parts=lambda law, v=v: np.array([0.1, v])) for v in (0.9, 0.2)]
    legs = [
        Made(samples=n, mesh=lambda T, m=m: m * T, invert=invert, speeds=s)
        for n, m, s in zip((10, 20), (0.3, 0.1), speeds, strict=True)
    ]
    segments = [Made(law="first"), Made(law="second")]
    made = search(model="model", single="single", connecting="connecting", legs=legs, pauses=[0.3])
    made.retime = lambda x: Made(duration=3.3, segments=segments)
    found = made._excesses([np.array([1.0]), np.array([2.0])])
    assert_allclose(found, [0.04, -0.1, 0.32])
    (timed, period, mesh, force) = asked[0]
    # of 1 / 30 s, at most
    assert timed.duration == 3.3 and period == pytest.approx(3.3 / 99) and force is None
    assert mesh == pytest.approx(0.2 / 3)
    assert made.excess([np.array([1.0]), np.array([2.0])]) == pytest.approx(0.32)
    speeds[0].parts = lambda law: np.zeros(0)
    assert_allclose(made._excesses([np.array([1.0]), np.array([2.0])]), [0.04, -0.5, 0.32])


def test_motions_are_slowed_down_until_the_whole_program_keeps_its_limits() -> None:
    lines: list[str] = []
    made = search(pauses=[1.0], tell=lines.append, connecting=Limits())
    made._excesses = lambda x: [
        1.8 / made.duration(x) - 1.0,
        0.5 / x[0][0] - 1.0,
        0.2 / x[1][0] - 1.0,
    ]
    told: list[np.ndarray] = []

    def slower(x: list[np.ndarray], excess: np.ndarray) -> list[np.ndarray]:
        told.append(excess)
        return [part * (1 + 3 * max(e, 0.0)) for part, e in zip(x, excess, strict=True)]

    made.slower = slower
    x = made._slow_down([np.array([0.4]), np.array([0.2])])
    assert lines[0] == "1.6000 s, limits of the whole program exceeded by 2.5e-01"
    assert_allclose(told[0], [0.25 + 1e-4, 0.125 + 1e-4])
    assert max(made._excesses(x)) <= -1e-4
    made._excesses = lambda x: [0.3, 0.5]
    made.slower = lambda x, excess: x
    with pytest.raises(SolverError) as caught:
        made._slow_down([np.array([0.4])])
    text = (
        "cannot be kept in this program at the speeds that were tried, up to 0.4 s; increase "
        "them: it needs 1.5 of a"
    )
    assert str(caught.value) == f"fastest: the limits {text} limit" and len(lines) > 200
    made.slower = lambda x, excess: [1.3 * part for part in x]
    with pytest.raises(
        SolverError,
        match=r"in this program at any speed; .* holding the robot needs 1\.5 of a limit$",
    ):
        made._slow_down([np.array([0.4])])
    made.connecting = Limits(torque_rms=(1.0, 1.0))  # of other time laws the mean may be smaller
    with pytest.raises(
        SolverError, match=r"at the speeds that were tried, up to .* it needs 1\.5 of a limit$"
    ):
        made._slow_down([np.array([0.4])])

    def lost(x: Any) -> Any:
        raise SolverError("none")

    made._excesses = lost
    with pytest.raises(SolverError, match=r"it needs inf of a limit$"):
        made._slow_down([np.array([0.4])])


def test_stages_of_the_search_of_a_program() -> None:
    """Each motion alone, then the effective torques where there are limits of them, then the whole
    program.
    """
    legs = [
        Made(
            quick_start=lambda k=k: k,
            run=lambda k: (np.array([k]), []),
            programs=3 + k,
            inversions=k,
        )
        for k in (1.0, 2.0)
    ]
    made = search(legs=legs, pauses=[0.5], connecting=Limits())
    made._connect = lambda x: [2 * part for part in x]
    made._find_slower = lambda x: ([part + 1 for part in x], [])
    x, history = made.run()
    assert [part[0] for part in x] == [2.0, 3.0] and history == [3.5, 5.5] and made.programs == 9
    assert made.inversions == 3.0
    made.connecting = Limits(torque_rms=(1.0, 1.0))
    made._find_slower = lambda x: ([part + 0.1 for part in x], [])
    assert made.run()[1] == pytest.approx([3.5, 6.5, 6.7])  # less than a tenth slower


def test_a_program_is_searched_again_from_the_laws_as_given() -> None:
    """Where only much time takes an excess away, or none: the shortest of all laws that keep the
    limits.
    """
    given = [np.array([5.0]), np.array([6.0])]
    legs = [
        Made(
            quick_start=lambda: 0,
            run=lambda k: (np.array([1.0]), []),
            programs=0,
            start=lambda x=x: x,
        )
        for x in given
    ]
    made = search(
        legs=legs, pauses=[0.5], connecting=Limits(torque_rms=(1.0, 1.0)), tell=lambda line: None
    )
    made._connect = lambda x: x
    made._state = lambda x: Made(x=x)
    weights: list[float] = []

    def improve(state: Any, weight: float) -> list[np.ndarray]:
        weights.append(weight)
        return [0.5 * part for part in state.x]

    made._improve = improve
    slower: dict[float, Any] = {
        2.5: [np.array([9.0]), np.array([9.0])],
        11.5: given,
        6.0: [0.6 * x for x in given],
    }
    made._find_slower = lambda x: (slower[made.duration(x)], [(2.5, 0.3)])
    assert made.run()[1] == pytest.approx([2.5, 2.5, 7.1]) and weights == [200.0]
    slower.update({2.5: None, 6.0: None})
    assert made.run()[1] == pytest.approx([2.5, 2.5, 11.5])
    slower.update({11.5: None})
    with pytest.raises(
        SolverError, match=r"tried, up to 2\.5 s; increase them: it needs 1\.3 of a limit$"
    ):
        made.run()

    def unable(x: Any) -> Any:
        raise SolverError("torques cannot be kept")

    made._connect = unable
    with pytest.raises(SolverError, match=r"^torques cannot be kept$"):
        made.run()
    slower.update({11.5: given})
    assert made.run()[1] == pytest.approx([2.5, 11.5])


def test_the_path_of_a_program_has_its_motions_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(program_time, "replace", lambda segment, law, start: (segment, law, start))
    legs = [Made(law=lambda part, k=k: (k, float(part[0]))) for k in range(3)]
    made = search(legs=legs, pauses=[0.5, 0.25], path=Made(segments=("a", "b", "c")))
    timed = made.retime([np.array([1.0]), np.array([2.0]), np.array([4.0])])
    assert timed.segments == (("a", (0, 1.0), 0.0), ("b", (1, 2.0), 1.5), ("c", (2, 4.0), 3.75))
    assert timed.duration == 7.75 and made.path.segments == ("a", "b", "c")
