"""Laws, referees and refused input of `flexgen.simulation.simulate`."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints


def recorded(
    meta: dict[str, Any] | None = None, **changes: tuple[Any, tuple[str, ...], str] | None
) -> Trajectory:
    """Three samples of the elbow: numbers, labels and unit of each channel; None: without it."""
    numbers = np.arange(6.0).reshape(3, 2)
    rows: dict[str, Any] = {
        "tau_m": (numbers, ("m2", "m1"), "N m"),
        "q_a": (numbers / 8, ("q1", "q2"), "rad"),
        "q_m": (numbers * 8, ("m1", "m2"), "rad"),
        "y_ref": (numbers / 2, ("z", "x"), "m"),
        "v_a": (numbers * [[0], [1], [1]], ("q1", "q2"), "rad/s"),
    }
    rows = {name: row for name, row in (rows | changes).items() if row is not None}
    ports = {
        name: Port(name, (len(labels),), unit, "") for name, (_, labels, unit) in rows.items()
    }
    labels = {name: row[1] for name, row in rows.items()}
    return Trajectory(
        0.1 * np.arange(3),
        {name: np.array(row[0]) for name, row in rows.items()},
        ports,
        labels,
        meta or {},
    )


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"q_m": None},
            "trajectory: channel q_m is missing; write one with 'flexgen solve elbow --out FILE'",
        ),
        (
            {"tau_m": (np.zeros((3, 2)), ("m1", "m3"), "N m")},
            "trajectory channel tau_m: given columns m1, m3, expected m1, m2; take the model that "
            "it was written for",
        ),
        (
            {"q_m": (np.zeros((3, 2)), ("m1", "m2"), "gon")},
            "trajectory channel q_m, column m1: given 'gon', an unknown unit, expected an angle "
            "in rad, mrad, urad, deg, arcmin, rev",
        ),
        (
            {"q_m": (np.zeros((3, 2)), ("m1", "m2"), "rad or m")},
            "trajectory channel q_m, column m1: given 'rad or m', an unknown unit, expected an "
            "angle in rad, mrad, urad, deg, arcmin, rev",
        ),
        (
            {"q_a": (np.full((3, 2), np.inf), ("q1", "q2"), "rad")},
            "trajectory channel q_a: given NaN or infinity, expected finite numbers",
        ),
        (
            {"y_ref": (np.zeros((3, 2)), ("x", "y"), "m")},
            "trajectory channel y_ref: given columns x, y, expected x, z; take the model that it "
            "was written for",
        ),
        (
            {"y_ref": (np.full((3, 2), np.nan), ("x", "z"), "m")},
            "trajectory channel y_ref: given NaN or infinity, expected finite numbers",
        ),
    ],
)
def test_channels_that_are_not_those_of_the_model_are_refused(
    changes: dict[str, Any], text: str
) -> None:
    with pytest.raises(ArgumentError) as caught:
        flexgen.simulate("elbow", recorded(**changes))
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"rtol": 1e-14}, "rtol: given 1e-14, expected a relative tolerance between 1e-14 and"),
        ({"rtol": 1e-2}, "rtol: given 0.01, expected a relative tolerance between 1e-14 and 1e-2"),
        ({"held": -0.1}, "held: given -0.1, expected a time between 0 and 60 s"),
        ({"held": 60.1}, "held: given 60.1, expected a time between 0 and 60 s"),
        ({"feedback": "pid"}, "feedback: given 'pid', expected one of auto, none, ppi"),
    ],
)
def test_arguments_out_of_their_ranges_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        flexgen.simulate("elbow", recorded(), **changes)
    assert str(caught.value).startswith(text)


# A robot near rest, with torques that change by some percent of what holds it.
EQUATIONS = derive("elbow")
REST = hold_joints(EQUATIONS, np.array([0.4, 0.9]))
TIME = np.linspace(0.0, 0.2, 21)
TORQUE = REST.tau_m * (1.0 + 0.1 * np.stack([np.sin(20 * TIME), np.cos(15 * TIME)], axis=1))
SPEED_A = np.array([0.05, -0.02])
SPEED_M = SPEED_A @ EQUATIONS.model.eta.T


def made(hold: str | None, force: bool) -> Trajectory:
    """Torques and the start, with the columns of the motors exchanged."""
    columns = {
        "tau_m": (TORQUE[:, ::-1], ("m2", "m1"), "N m"),
        "q_a": (np.tile(REST.q_a, (21, 1)), ("q1", "q2"), "rad"),
        "q_m": (np.tile(REST.q_m[::-1], (21, 1)), ("m2", "m1"), "rad"),
        "v_a": (np.tile(SPEED_A, (21, 1)), ("q1", "q2"), "rad/s"),
        "v_m": (np.tile(SPEED_M, (21, 1)), ("m1", "m2"), "rad/s"),
    }
    if force:
        columns["force"] = (pushed(TIME), ("fx", "fy", "fz", "mx", "my", "mz"), "N or N m")
    return Trajectory(
        TIME,
        {name: row[0] for name, row in columns.items()},
        {name: Port(name, (len(row[1]),), row[2], "") for name, row in columns.items()},
        {name: row[1] for name, row in columns.items()},
        {} if hold is None else {"hold": hold, "sample_time": 0.01, "delay": 0.004},
        {"force": ("N",) * 3 + ("N m",) * 3} if force else {},
    )


def pushed(t: np.ndarray) -> np.ndarray:
    """A force on the tool that grows with time [N]."""
    return 300.0 * np.asarray(t)[..., None] * np.array([1.0, 0.0, 2.0, 0.0, 0.0, 0.0])


def torque_at(hold: str | None, t: float) -> np.ndarray:
    """The torque of an instant: a quintic spline, or held values that arrive 4 ms late."""
    if hold is None:
        return np.asarray(make_interp_spline(TIME, TORQUE, k=5)(min(t, TIME[-1])))
    place = np.clip((t - 0.004) / 0.01, 0.0, 20.0)
    if hold == "zoh":
        return TORQUE[int(np.floor(place + 1e-9))]
    return np.stack([np.interp(place, np.arange(21.0), column) for column in TORQUE.T])


@pytest.mark.parametrize(
    ("hold", "moving", "held", "force"),
    [
        (None, False, 0.0, False),
        (None, True, 0.05, False),
        ("zoh", False, 0.03, False),
        ("linear", True, 0.0, False),
        (None, False, 0.0, True),
    ],
)
def test_a_simulation_is_that_of_the_equations_of_motion(
    hold: str | None, moving: bool, held: float, force: bool
) -> None:
    """Referee: SciPy integrates the forward dynamics between the instants at which torques
    jump.
    """
    name = "forward_dynamics_tool_force" if force else "forward_dynamics"
    forward = EQUATIONS.function(name)

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        given = [x[:2], x[4:6], x[2:4], x[6:], torque_at(hold, t), *([pushed(t)] if force else [])]
        return np.concatenate([x[4:], *(np.array(a).ravel() for a in forward(*given)[:2])])

    speeds = [*SPEED_A, *SPEED_M] if moving else [0.0] * 4
    x = np.array([*REST.q_a, *REST.q_m, *speeds])
    edges = TIME if hold is None else np.unique(np.r_[0.0, TIME[:-1] + 0.004, 0.2])
    states = [x]
    for begin, end in pairwise(edges):
        middle = 1e-9 if hold == "zoh" else 0.0
        x = solve_ivp(
            lambda t, x, late=middle: rate(t + late, x),
            (begin, end - 2 * middle),
            x,
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
        ).y[:, -1]
        states.append(x)
    found = flexgen.simulate(
        EQUATIONS, made(hold, force), feedback="none", moving=moving, held=held
    )
    at = np.isin(np.round(edges, 9), np.round(TIME, 9))
    rows = np.isin(np.round(TIME, 9), np.round(edges, 9))
    expected = np.array(states)[at]
    assert_allclose(found.trajectory["q_a"][rows], expected[:, :2], atol=1e-7)
    assert_allclose(found.trajectory["q_m"][rows], expected[:, 2:4], atol=1e-5)
    assert len(found.trajectory.time) == 21
