"""Where the search for a planned motion begins: guesses at the nodes of each phase, and what is
refused there.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.planning.optimal import start
from flexgen.planning.optimal.start import check_rest, start_of


class Motion:
    """A guess of 2 s: y = t^2 and 3 t, torques t."""

    duration = 2.0

    def at(self, t: np.ndarray) -> tuple[np.ndarray, ...]:
        y = np.stack([t**2, 3 * t], axis=1)
        return (
            y,
            np.stack([2 * t, 3 + 0 * t], axis=1),
            np.stack([2 + 0 * t, 0 * t], axis=1),
            t[:, None],
        )


def layout_of(*durations: float) -> Any:
    mesh = Made(
        nodes=np.array([0.0, 0.5, 1.0]), times=np.array([0.25, 0.75]), pack=lambda *parts: parts
    )
    return Made(phases=[Made(mesh=mesh, given_duration=T) for T in durations])


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Which guess is made."""
    calls: list[str] = []
    for name in ("from_solution", "from_inversion", "between"):

        def made(*given: Any, name: str = name) -> Motion:
            calls.append(name)
            return Motion()

        monkeypatch.setattr(start.guesses, name, made)
    return calls


@pytest.mark.parametrize("free", [False, True])
def test_a_guess_is_spread_over_the_phases(free: bool, asked: list[str]) -> None:
    """Phases of 1 and 3 s take the first and the other part of it; derivatives are those in
    relative time.

    With a free path parameter, the time law of the path (s^2 over a length of 5, in 4 s) is one
    more coordinate.
    """
    packed: list[Any] = []

    def pack(*parts: np.ndarray) -> np.ndarray:
        packed.append(parts)
        return np.full(2, float(len(packed)))

    def law(t: np.ndarray, order: int) -> np.ndarray:
        return (
            5
            * np.stack([np.minimum(t, 4.0) ** 2 / 16, t / 8, 1 / 8 + 0 * t], axis=1)[
                :, : order + 1
            ]
        )

    path: Any = Made(equations=None, duration=4.0, segments=[Made(law=law)])
    ends = (np.zeros(2), np.zeros(2))
    layout = layout_of(1.0, 3.0)
    for phase in layout.phases:
        phase.mesh.pack = pack
    found = start_of(layout, path, ends, None, [Made(guess=7.0)], free=free)
    assert found.tolist() == [1.0, 1.0, 2.0, 2.0, 1.0, 3.0, 7.0]
    assert asked == (["from_inversion"] if free else ["between"])
    first, second = packed
    for (nodes, acceleration, torque), begun, T in ((first, 0.0, 1.0), (second, 1.0, 3.0)):
        t = (begun + T * np.array([0.0, 0.5, 1.0])) / 2  # of the guess, which takes half as long
        y = [t**2, 3 * t]
        dy = [2 * t, 3 + 0 * t]
        if free:
            y.append((2 * t) ** 2 / 16)
            dy.append(2 * (2 * t) / 8)
        assert_allclose(nodes, np.stack([*y, *(T / 2 * x for x in dy)], axis=1), rtol=1e-14)
        inner = (begun + T * np.array([0.25, 0.75])) / 2
        ddy = [2 + 0 * inner, 0 * inner] + ([4 / 8 + 0 * inner] if free else [])
        assert_allclose(acceleration, (T / 2) ** 2 * np.stack(ddy, axis=1), rtol=1e-14)
        assert_allclose(torque, inner[:, None], rtol=1e-14)


def test_guesses_by_name(asked: list[str]) -> None:
    path: Any = Made(equations=None, duration=2.0, segments=[])
    ends = (np.zeros(2), np.zeros(2))
    layout = layout_of(2.0)
    layout.phases[0].mesh.pack = lambda *parts: np.zeros(3)
    for guess, name in (("lq", "from_inversion"), ("rest", "between"), (None, "between")):
        assert start_of(layout, path, ends, guess, [], free=False).tolist() == [0.0, 0.0, 0.0, 2.0]
        assert asked.pop() == name
    wrong: Any
    for wrong in ("best", 3.0, True):
        with pytest.raises(ArgumentError) as refused:
            start_of(layout, path, ends, wrong, [], free=False)
        assert (
            str(refused.value)
            == f"guess: given {wrong!r}, expected 'rest', 'lq', a Solution or a Trajectory"
        )
    layout.phases[0].mesh.pack = lambda *parts: np.array([np.nan])
    with pytest.raises(
        ArgumentError, match="given a motion that is not finite, expected finite numbers"
    ):
        start_of(layout, path, ends, "rest", [], free=False)


def test_constraints_hold_at_rest() -> None:
    """By a millionth of their size; those of other signals than coordinates and speeds are not
    known there.
    """
    y = ca.SX.sym("y", 2)
    dy = ca.SX.sym("dy", 2)
    tau = ca.SX.sym("tau")

    def check(
        value: ca.SX, low: float, high: float, band: bool = False, where: str = "end"
    ) -> None:
        row = Made(name="mine", value=value, lower=np.array([low]), upper=np.array([high]))
        rows: dict[str, list[Any]] = {"path": [], "start": [], "end": []}
        if not band:
            rows["end"].append(row)
        content = Made(rows=rows, bands={"mine": row} if band else {})
        phase: Any = Made(signals=Made(y=y, dy=dy), content=content)
        check_rest(phase, np.array([2.0, 100.0]), where)

    check(y[0] + dy[0], 2.0, 2.0)
    check(tau + y[0], 5.0, 6.0)
    check(y[1], 0.0, 100.0 - 0.99e-4)
    check(y[0], 9.0, 10.0, where="start")  # a row of the end alone
    words = "at the end, where the arm is at rest; change the constraint or the move"
    with pytest.raises(SolverError) as refused:
        check(y[1], 0.0, 100.0 - 1.01e-4)
    assert str(refused.value) == f"plan: 'mine' is violated by 0.000101 {words}"
    with pytest.raises(SolverError) as refused:
        check(y[0], 2.5, 3.0, band=True)
    assert str(refused.value) == f"plan: 'bound of mine' is violated by 0.5 {words}"
    with pytest.raises(ArgumentError) as unknown:
        check(1 / dy[0], 0.0, 1.0)
    assert (
        str(unknown.value)
        == "plan: 'mine' is NaN or infinite at the end, expected a finite number"
    )
