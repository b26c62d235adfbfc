"""Trajectories: which parts fit together, channels by name, and tables of other packages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError, ChannelError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port


def made(**changes: Any) -> Trajectory:
    """Two channels, one of them of an angle and a length."""
    given: dict[str, Any] = {
        "time": np.array([0.0, 0.5, 2.0]),
        "channels": {"tau_m": np.arange(6.0).reshape(3, 2), "q_a": np.ones((3, 2))},
        "ports": {
            "tau_m": Port("tau_m", (2,), "N m", "torques"),
            "q_a": Port("q_a", (2,), "rad or m", "coordinates"),
        },
        "labels": {"tau_m": ("m1", "m2"), "q_a": ("q1", "s")},
        "meta": {"model": "arm", "kind": "made up"},
        "units": {"q_a": ("rad", "m")},
    }
    return Trajectory(**(given | changes))


def test_parts_that_do_not_fit_are_refused_with_their_shapes() -> None:
    grid = (
        "trajectory: given a time grid that does not increase, expected at least 2 increasing "
        "instants"
    )
    other = Port("tau_m", (1,), "N m", "torques")
    named = (
        "trajectory: given channels, ports and labels with different names, expected the same "
        "names"
    )
    channels = made().channels
    ports = made().ports
    labels = made().labels
    for changes, text in (
        ({"time": np.array([0.0, 0.5, 0.5])}, grid),
        ({"time": np.array([0.0, np.nan, 1.0])}, grid),
        ({"time": np.array([0.0])}, grid),
        ({"time": np.zeros((3, 1))}, grid),
        ({"channels": {"tau_m": channels["tau_m"]}}, named),
        ({"labels": {"tau_m": ("m1", "m2")}}, named),
        (
            {"labels": {**labels, "tau_m": ("m1",)}},
            "trajectory channel tau_m: given 1 labels, expected 2",
        ),
        (
            {"channels": {**channels, "tau_m": np.zeros((3, 1))}},
            "trajectory channel tau_m: given shape (3, 1), expected (3, 2)",
        ),
        (
            {"time": np.array([0.0, 1.0])},
            "trajectory channel tau_m: given shape (3, 2), expected (2, 2)",
        ),
        (
            {"units": {"q_a": ("rad", "m", "rad")}},
            "trajectory channel q_a: given 3 units, expected 2",
        ),
        (
            {"ports": {**ports, "tau_m": other}},
            "trajectory channel tau_m: given 2 labels, expected 1",
        ),
    ):
        with pytest.raises(ArgumentError) as caught:
            made(**changes)
        assert str(caught.value) == text
    assert made(time=np.array([0.0, 1e-9, 2.0])).time[1] == 1e-9
    assert made(units={}).units["q_a"] == ("rad or m", "rad or m") and made().units["tau_m"] == (
        "N m",
        "N m",
    )
    # of the port, where they differ from it
    assert made(units={"tau_m": ("N", "N")}).units["tau_m"] == ("N m", "N m")


def test_channels_that_are_not_there_are_told_with_those_that_are() -> None:
    trajectory = made()
    for name, text in (
        ("tau", "trajectory channel: given 'tau', expected tau_m (there are: tau_m, q_a)"),
        (
            "time",
            (
                "trajectory channel: given 'time', expected one of tau_m, q_a; the time is the "
                "attribute .time"
            ),
        ),
        (3, "trajectory channel: given 3, expected one of tau_m, q_a"),
        ([1], "trajectory channel: given [1], expected one of tau_m, q_a"),
    ):
        with pytest.raises(ChannelError) as caught:
            trajectory[name]  # type: ignore[index]
        assert caught.value.args[0] == text
    assert (
        list(trajectory) == list(trajectory.keys()) == ["tau_m", "q_a"]
        and "q_a" in trajectory
        and "t" not in trajectory
    )
    assert repr(trajectory) == "<Trajectory arm: 3 samples from 0 to 2 s, tau_m q_a>"
    assert repr(made(meta={})) == "<Trajectory: 3 samples from 0 to 2 s, tau_m q_a>"
    assert trajectory.columns() == ["tau_m[m1] N m", "tau_m[m2] N m", "q_a[q1] rad", "q_a[s] m"]


def test_tables_of_other_packages_have_units_and_labels() -> None:
    """Units that differ between the columns of a channel are a list."""
    pandas = pytest.importorskip("pandas")
    xarray = pytest.importorskip("xarray")
    trajectory = made()
    frame = trajectory.to_dataframe()
    assert isinstance(frame, pandas.DataFrame) and frame.index.name == "time s"
    assert list(frame) == trajectory.columns()
    assert np.array_equal(frame, np.hstack([trajectory["tau_m"], trajectory["q_a"]]))
    data = trajectory.to_xarray()
    assert isinstance(data, xarray.Dataset) and data.attrs == trajectory.meta
    assert data.tau_m.dims == ("time", "tau_m_column") and data.time.attrs == {"units": "s"}
    assert np.array_equal(data.tau_m, trajectory["tau_m"])
    assert data.tau_m.attrs == {"units": "N m", "long_name": "torques"}
    assert data.q_a.attrs["units"] == ["rad", "m"]
    assert list(data.q_a_column.values) == ["q1", "s"]
