"""Results of closed loops: their channels with names and units, the samples of their poses, and
robots that failed.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop import result
from flexgen.feedback.loop.named_controllers import FeedforwardOnly
from flexgen.feedback.loop.result import ControlRun

FORCE = np.arange(24.0).reshape(4, 6)


def made_run(force: np.ndarray | None = None, **failures: str) -> ControlRun:
    """Two robots, whose numbers are those of the seconds of their samples."""
    time = 0.25 * np.arange(4)
    runs = []
    for k, name in enumerate(("nominal", "soft")):
        at = np.stack([time, time], axis=1) + k
        runs.append(
            Made(
                name=name,
                failure=failures.get(name, ""),
                q_a=at,
                q_m=10 * at,
                tau_m=-at,
                error=at / 100,
            )
        )
    reference = Made(
        time=time,
        begin=0.25,
        end=0.6,
        path_end=0.5,
        held=np.ones((4, 2)),
        y_ref=np.zeros((4, 2)),
        R_ref=None,
    )
    made = object.__new__(ControlRun)
    fields = {
        "model": flexgen.read("elbow"),
        "runs": tuple(runs),
        "reference": reference,
        "controller": "mine",
        "law": FeedforwardOnly(),
    }
    for name, value in (fields | {"force": force}).items():
        object.__setattr__(made, name, value)
    return made


@pytest.mark.parametrize("force", [None, FORCE])
def test_channels_of_a_robot_have_names_and_units(force: np.ndarray | None) -> None:
    run = made_run(force)
    found = run.trajectory("soft")
    names = ["q_a", "q_m", "tau_m", "tau_ff", "error"] + ["force"] * (force is not None)
    assert list(found.channels) == names
    assert_array_equal(found.time, [0.0, 0.25, 0.5, 0.75])
    assert_array_equal(found["q_a"][:, 0], [1.0, 1.25, 1.5, 1.75])
    assert_array_equal(found["q_m"], 10 * found["q_a"])
    assert_array_equal(found["tau_m"], -found["q_a"])
    assert_array_equal(found["tau_ff"], np.ones((4, 2)))
    assert_array_equal(found["error"], found["q_a"] / 100)
    assert {name: port.unit for name, port in found.ports.items()} == {
        "q_a": "rad",
        "q_m": "rad",
        "tau_m": "N m",
        "tau_ff": "N m",
        "error": "m",
    } | ({} if force is None else {"force": "N or N m"})
    assert all(found.ports[name].shape == (x.shape[1],) for name, x in found.channels.items())
    assert found.labels["q_a"] == ("q1", "q2") and found.labels["tau_m"] == ("m1", "m2")
    kept = {
        "model": "elbow",
        "variant": "",
        "kind": "closed loop",
        "controller": "mine",
        "plant": "soft",
    }
    assert {key: found.meta[key] for key in kept} == kept
    if force is not None:
        assert_array_equal(found["force"], FORCE)
        assert found.units["force"] == ("N",) * 3 + ("N m",) * 3
    assert_array_equal(run.trajectory()["q_a"][:, 1], [0.0, 0.25, 0.5, 0.75])


def test_poses_of_a_run_are_its_begin_middle_and_end() -> None:
    """The first samples at or after 0.25, 0.25 and 0.6 s; an end behind the last one is the last
    one.
    """
    run = made_run()
    assert run.pose_samples == {"begin": 1, "middle": 1, "end": 3}
    reference: Any = run.reference
    reference.path_end = 0.9
    reference.end = 5.0
    assert run.pose_samples == {"begin": 1, "middle": 2, "end": 3}


def test_accuracy_is_that_of_robots_which_reached_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(
        result, "path_accuracy", lambda *motion, **named: asked.append(named["robots"])
    )
    monkeypatch.setattr(result, "replace", lambda found, **more: None)
    monkeypatch.setattr(result, "find_corners", lambda *given: None)
    monkeypatch.setattr(result, "corner_figures", lambda *given: {})
    for name, value in (("solution", Made(move="line")), ("unit", "m")):
        monkeypatch.setattr(ControlRun, name, value, raising=False)
    run = made_run(nominal="fell")
    run.accuracy()
    run.accuracy(["soft"])
    assert asked == [("soft",), ("soft",)]
    expected = ", expected names of robots that did not fail"
    for which, given in (
        (["nominal", "soft"], "'nominal', which failed"),
        ([], "no robots that reached the end"),
    ):
        with pytest.raises(ArgumentError) as refused:
            run.accuracy(which)
        assert str(refused.value) == f"robots: given {given}{expected}"
    with pytest.raises(ArgumentError, match=r"^robots: given no robots that reached the end"):
        made_run(nominal="fell", soft="fell").accuracy()
    with pytest.raises(ArgumentError) as refused:
        run.accuracy(["hard"])
    assert str(refused.value) == "plant: given 'hard', expected one of nominal, soft"
    assert (made_run().status, made_run(soft="diverged").status[:22]) == (
        "done",
        "failed: soft: diverged",
    )
