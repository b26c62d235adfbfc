"""Elements of gears that a record does not show, delays of laws, and noises that filters
expect.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.timing import Timing
from flexgen.identification.gears import fit
from flexgen.identification.responses.parameters import DELAY
from flexgen.identification.responses.result import Estimated

# two springs, two elements with exponents, their lost motions, one more number; as in
# `flexgen.identification.gears.fit.GearModel`
MODEL: Any = Made(
    start=np.ones(9),
    units=np.array([1.0, 1.0, 1.0, 1.0, 2.0, 4.0, 1.0, 1.0, 1.0]),
    count=2,
    layout=fit.Numbers.of(
        parameters=2,
        stiffness=2,
        exponents=2,
        lost=2,
        errors=1,
        viscous=0,
        coulomb=0,
        constant=0,
        cogging=0,
        delay=0,
    ),
    sought=Made(exponents=1),
)


def test_bounds_of_the_numbers_of_gears() -> None:
    """Springs and elements within a factor, exponents from 1 on, lost motions in parts of their
    units, others free.
    """
    lower, upper = fit.bounds_of(MODEL)
    assert_allclose(
        lower,
        [1 / fit.REACH] * 2
        + [fit.STIFF] * 2
        + [0.5, 0.25, fit.LEAST_LOST, fit.LEAST_LOST, -np.inf],
    )
    assert_allclose(
        upper,
        [fit.REACH] * 4
        + [fit.SHARPEST / 2, fit.SHARPEST / 4, fit.MOST_LOST, fit.MOST_LOST, np.inf],
    )


@pytest.mark.parametrize(
    ("stiffness", "lost", "dropped"),
    [
        (1.0, 1.0, False),
        (fit.REACH / fit.NEAR * 1.01, 1.0, True),
        (fit.STIFF * fit.NEAR * 0.99, 1.0, True),
        (fit.REACH / fit.NEAR * 0.99, 1.0, False),
        (1.0, fit.NO_LOST * 0.99, True),
        (1.0, fit.NO_LOST * 1.01, False),
    ],
)
def test_an_element_without_a_loop_is_fixed_at_none(
    stiffness: float, lost: float, dropped: bool
) -> None:
    """The second one: it becomes a part of its spring, once."""
    lower, upper = fit.bounds_of(MODEL)
    theta = np.array([1.1, 1.2, 1.3, stiffness, 0.9, 0.8, 1.0, lost, 5.0])
    before = theta.copy()
    assert fit.drop_elements(MODEL, theta, lower, upper) is dropped
    assert_allclose(theta[[0, 1, 2, 4, 6, 8]], before[[0, 1, 2, 4, 6, 8]])
    if not dropped:
        assert (theta == before).all() and (lower < upper).all()
        return
    fixed = {3: 1.0, 5: 1.0, 7: fit.LEAST_LOST}
    assert [k for k in range(9) if lower[k] == upper[k]] == list(fixed)
    for k, value in fixed.items():
        assert theta[k] == lower[k] == value
    assert not fit.drop_elements(MODEL, theta, lower, upper)


# --- laws and filters ----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("delay", "whole", "rest", "segments"),
    [
        (0.0, 0, 0.0, []),
        (0.3e-3, 0, 0.3e-3, [(1, 0.3e-3)]),
        (1e-3, 1, 0.0, [(1, 1e-3)]),
        (2.4e-3, 2, 0.4e-3, [(3, 0.4e-3), (2, 1e-3), (1, 1e-3)]),
        (3e-3 - 1e-15, 3, 0.0, [(3, 1e-3), (2, 1e-3), (1, 1e-3)]),
    ],
)
def test_torques_under_way_add_up_to_the_delay(
    delay: float, whole: int, rest: float, segments: list[tuple[int, float]]
) -> None:
    timing = Timing(1e-3, delay, predicted=True)
    assert timing.whole == whole and timing.rest_s == pytest.approx(rest, abs=1e-18)
    found = timing.segments()
    assert [k for k, _ in found] == [k for k, _ in segments]
    assert_allclose([x for _, x in found], [x for _, x in segments], rtol=1e-12)
    assert sum(x for _, x in found) == pytest.approx(delay, abs=1e-14)
    assert timing.ahead_s == pytest.approx(delay + 0.5e-3)
    assert Timing(1e-3, delay).segments() == [] and Timing(1e-3, delay).ahead_s == 0.0


def test_noises_are_parts_of_the_largest_torques() -> None:
    """A motor without a limit has the largest of the others, and 1 N m where there is none."""
    for limits, expected in (
        ([3.0, None], [3.0, 3.0]),
        ([None, None], [1.0, 1.0]),
        ([0.2, None], [0.2, 1.0]),
    ):
        model: Any = Made(motors=[Made(torque_max=x) for x in limits])
        assert_allclose(Noises(model).largest, expected)
    robot = flexgen.read("elbow")
    found = Noises(robot)
    assert (found.torque, found.rate, found.tool_force) == (0.05, 1.0, 50.0)
    for name, given in (("torque_noise", {"torque": 0.0}), ("disturbance_rate", {"rate": -1.0})):
        with pytest.raises(ArgumentError, match=f"^{name}: given"):
            Noises(robot, **given)
    with pytest.raises(ArgumentError, match=r"^tool_force: given -1\.0, expected a number >= 0"):
        Noises(robot, tool_force=-1.0)
    assert Noises(robot, tool_force=0.0).tool_force == 0.0


# --- identified numbers --------------------------------------------------------------------------
def test_relative_errors_of_numbers_are_those_of_their_logarithms() -> None:
    """Of others over their values; tied numbers as theirs; numbers of the drives and those that
    are zero left out.
    """
    unknowns = [
        Made(name="a.stiffness", tied=("b.stiffness",), scale="log"),
        Made(name="m.coulomb", tied=(), scale="linear"),
        Made(name="m.offset", tied=(), scale="linear"),
        Made(name=DELAY, tied=(), scale="linear"),
    ]
    values = {
        "a.stiffness": 5.0,
        "b.stiffness": 7.0,
        "m.coulomb": 0.25,
        "m.offset": 0.0,
        DELAY: 1e-3,
    }
    own: Any = Made(vector=Made(unknowns=unknowns, named=lambda x: values), x=None)
    C = np.array(
        [[4.0, 0.5, 9.0, 9.0], [0.5, 2.0, 9.0, 9.0], [9.0, 9.0, 9.0, 9.0], [9.0, 9.0, 9.0, 9.0]]
    )
    names, found = Estimated._relative_covariance(own, C)
    assert names == ["a.stiffness", "b.stiffness", "m.coulomb"]
    assert_allclose(found, [[4.0, 4.0, 2.0], [4.0, 4.0, 2.0], [2.0, 2.0, 32.0]])
