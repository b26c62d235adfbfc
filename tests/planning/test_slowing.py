"""Time laws slowed down by steps, growing steps and bisection; words about speeds at which limits
are exceeded.
"""

from __future__ import annotations

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import SolverError
from flexgen.model.moves import MoveJ, MoveL, Program
from flexgen.planning.fastest.slowing import KEPT, SLOWEST, in_words, slow_down


def slower(x: list[np.ndarray], excess: np.ndarray) -> list[np.ndarray]:
    return [part * [1 + max(0.3 * e, 1e-4), 1.0] for part, e in zip(x, excess, strict=True)]


@pytest.mark.parametrize("needed", [1.02, 2.0, 7.3])
def test_small_excesses_that_much_time_takes_away(needed: float) -> None:
    """An excess of a thousandth at most, zero at ``needed`` times the duration."""
    tried: list[float] = []

    def excess(x: list[np.ndarray]) -> np.ndarray:
        tried.append(x[0][0] + x[1][0])
        return np.full(2, 1e-3 * (1.0 - tried[-1] / (3.0 * needed)))

    found, over = slow_down([np.array([1.0, 0.4]), np.array([2.0, 0.6])], excess, slower, 0.0)
    assert found is not None and found[0][1] == 0.4 and found[1][1] == 0.6
    duration = found[0][0] + found[1][0]
    assert (
        3.0 * needed <= duration < 3.0 * needed * (1 + (1e-4 if needed > 1.1 else 5e-3))
        and len(tried) < 75
    )
    assert over[0] == (3.0, pytest.approx(1e-3 * (1 - 1 / needed))) and over[-1][1] <= 0.0


def test_what_no_time_takes_away_and_what_has_no_inversion() -> None:
    found, over = slow_down([np.array([1.0, 0.4])], lambda x: np.array([2e-3]), slower, KEPT)
    assert found is None and SLOWEST < over[-1][0] < 1.3 * SLOWEST and len(over) < 80

    def lost(x: list[np.ndarray]) -> np.ndarray:
        raise SolverError("none")

    assert slow_down([np.array([1.0, 0.4])], lost, slower, KEPT) == (None, [(1.0, np.inf)])
    assert (
        len(slow_down([np.array([1.0, 0.4])], lambda x: np.ones(1), lambda x, e: x, KEPT)[1])
        == 200
    )

    def edge(x: list[np.ndarray]) -> np.ndarray:  # no inversion between the last steps
        if 2.0 < x[0][0] < 2.1:
            raise SolverError("none")
        return np.array([1e-3 if x[0][0] <= 2.0 else -1.0])

    found, _ = slow_down([np.array([1.0, 0.4])], edge, slower, KEPT)
    assert found is None or found[0][0] >= 2.1


def test_any_speed_is_stated_only_where_it_was_shown() -> None:
    """By the excess at rest, extrapolated with 1 / T, of limits that hold at each instant."""
    static = [(1.0, 0.9), (25.0, 0.02 + 0.4 / 25), (32.0, 0.02 + 0.4 / 32)]
    assert (
        in_words(static, False)
        == "at any speed; increase them: holding the robot needs 1.0325 of a limit"
    )
    tried = "at the speeds that were tried, up to 32 s; increase them: it needs"
    assert in_words(static, True) == f"{tried} 1.0325 of a limit"
    falling = [(1.0, 0.9), (25.0, 0.4 / 25), (32.0, 0.4 / 32)]  # zero at rest
    assert in_words(falling, False) == f"{tried} 1.0125 of a limit"
    assert in_words([(1.0, 0.9), (3.0, 0.00051234)], False).endswith(
        "up to 3 s; increase them: it needs 1.00051 of a limit"
    )
    assert in_words([(1.0, np.inf)], False).endswith(
        "up to 1 s; increase them: it needs inf of a limit"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "values", "known"),
    [("torque_rms", (7.923, 1.3397), 4.0), ("gear_torque_rms", (792.1, 136.644), 2.0)],
)
def test_effective_torques_just_above_those_of_a_slow_motion(
    kind: str, values: tuple[float, ...], known: float
) -> None:
    """A thousandth above what the line needs in a known time: they were refused "at any speed"."""
    limits = flexgen.Limits(torque=(25.0, 10.0), **{kind: values})  # type: ignore[arg-type]
    quick = flexgen.fastest("planar5_nmp", "line", limits=limits, progress=False)
    assert 1.0 < quick.duration_s < known and quick.excess <= KEPT


@pytest.mark.slow
def test_effective_torques_of_a_program_just_above_those_as_it_is_given() -> None:
    """The program as it is given needs 139.02 N m in 3.58 s, and much slower 138.80 N m."""
    steps = (
        MoveJ((0.5, -1.3)),
        MoveL((-0.12, 0.0, 0.0), zone=0.03, speed=0.2),
        MoveL((0.0, 0.12, 0.0), pause=0.3),
        MoveL((0.1, 0.0, 0.0)),
    )
    bounds = {"profile": (0.4, 2.0, 30.0, 600.0), "joint_profile": (1.0, 5.0, 60.0, 900.0)}
    program = Program("seam", start=(0.3, -1.1), smoothness=5, steps=steps, **bounds)
    limits = flexgen.Limits(torque=(25.0, 10.0), gear_torque_rms=(3000.0, 140.0))
    quick = flexgen.fastest("planar5_nmp", program, limits=limits, progress=False)
    assert quick.duration_s < 3.0 and quick.excess <= KEPT
