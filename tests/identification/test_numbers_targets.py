"""Targets of poses, plans with several phases, messages of errors, statuses of fits: small rules
by hand.
"""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.files import trajectory_files
from flexgen.base.numerics.records import TRANSIENT
from flexgen.cli import main
from flexgen.exports.c_code.selftest import motion
from flexgen.feedback.observers.constant_gain import ConstantGainObserver
from flexgen.identification.responses import graybox
from flexgen.identification.responses.result import FitStatus
from flexgen.paths.inverse_kinematics import targets
from flexgen.paths.inverse_kinematics.targets import PoseTarget
from flexgen.planning.optimal import result


class Wrong(Exception):
    """Error that refuses a target."""


def wrong(key: str, given: Any, expected: str) -> Wrong:
    return Wrong(f"{key}: {expected}")


# --- poses ---------------------------------------------------------------------------------------
GOOD = PoseTarget(
    (1.0, 0.2, 0.3), tuple(map(tuple, Rotation.from_rotvec([0.1, 2, 3]).as_matrix().tolist()))
)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"position": (1.0, 2.0)}, "position: 3 finite numbers"),
        ({"orientation": ((1.0, 0.0), (0.0, 1.0))}, "orientation: a rotation matrix"),
        (
            {"orientation": tuple(map(tuple, np.diag([1.0, 1.0, -1.0]).tolist()))},
            "orientation: a rotation matrix",
        ),
        (
            {"orientation": tuple(map(tuple, (1.00001 * np.eye(3)).tolist()))},
            "orientation: a rotation matrix",
        ),
        (
            {"configuration": (1, -1)},
            "configuration: 1 or -1 for each of shoulder, elbow and wrist",
        ),
        (
            {"configuration": (1, -1, 0)},
            "configuration: 1 or -1 for each of shoulder, elbow and wrist",
        ),
        ({"turns": (0, 0, 1)}, "turns: 6 whole numbers"),
    ],
)
def test_wrong_targets_are_refused(changes: dict[str, Any], text: str) -> None:
    model = flexgen.read("manutec_r3")
    targets._check(
        model, replace(GOOD, configuration=(1, -1, 1), turns=(0, 1, -2, 0, 0, 0)), wrong
    )
    targets._check(model, GOOD, wrong)
    with pytest.raises(Wrong, match=f"^{text}$"):
        targets._check(model, replace(GOOD, **changes), wrong)
    with pytest.raises(
        Wrong, match=r"^position: end, because the arm has not six actuated coordinates$"
    ):
        targets._check(flexgen.read("elbow"), GOOD, wrong)


def test_poses_of_a_stream_have_their_rotation_by_columns() -> None:
    y = np.arange(12.0).reshape(2, 3, 2)
    R = Rotation.random(2, random_state=1).as_matrix()
    made: Any = Made(y=y, R=R)
    found = motion.targets(made)
    assert_allclose(found, [[*y[k, :, 0], *R[k].T.ravel()] for k in range(2)])
    made.R = None
    assert_allclose(motion.targets(made), y[:, :, 0])


@pytest.mark.parametrize(("size", "singular"), [(1.1, False), (0.9, True)])
def test_a_move_through_a_singular_pose_has_no_stream(
    size: float, singular: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One pose is enough; columns of coordinates without motor do not count."""
    W = np.array(
        [np.diag([3.0, 2.0, 1.0])[:2], [[3.0, 0.0, 0.0], [0.0, 3.0 * size * motion.SINGULAR, 1.0]]]
    )
    monkeypatch.setattr(motion, "evaluate", lambda function, *given: (None, W))
    model = Made(n_a=3, output=Made(target_size=2), i_g=(0, 1))
    equations: Any = Made(model=model, function=lambda name: name)
    if not singular:
        motion._refuse_singular(equations, np.zeros((2, 3)), "line")
        return
    text = (
        r"^self-test of the stream, move line: given a move through a singular pose, which no "
        r"stream passes; choose"
    )
    with pytest.raises(SolverError, match=text):
        motion._refuse_singular(equations, np.zeros((2, 3)), "line")


# --- plans ---------------------------------------------------------------------------------------
def test_targets_of_a_plan_follow_the_phases() -> None:
    """Relative times in each phase of its own duration; an instant between two belongs to the
    later one.
    """
    phases = [Made(number=0), Made(number=1)]
    problem: Any = Made(
        reference_at=lambda phase: lambda s: np.stack([s, np.full(len(s), phase.number)], axis=1)
    )
    motion: Any = Made(t=np.array([0.0, 1.0, 1.5, 2.0, 2.25, 2.5]), theta=np.array([2.0, 0.5]))
    layout: Any = Made(phases=phases)
    found = result._targets(problem, layout, motion)
    assert_allclose(found, [[0.0, 0], [0.5, 0], [0.75, 0], [0.0, 1], [0.5, 1], [1.0, 1]])


# --- fits ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, "fitted"),
        ({"converged": False, "bound": True}, "not_converged"),
        ({"bound": True, "cost": 3.0}, "at_bound"),
        ({"error": 1.01e-3}, "model_error"),
        ({"error": 0.99e-3, "cost": 1.99}, "fitted"),
        ({"cost": 2.01}, "model_error"),
        ({"cost": 2.01, "error": 0.99e-3}, "small_error"),
        ({"cost": 2.01, "error": 0.99e-3, "stated": True}, "model_error"),
        ({"warnings": (f"a {TRANSIENT} of 3 %",)}, "model_error"),
        ({"cost": 0.49}, "noise_too_large"),
        ({"cost": 0.49, "sd": 0.9e-7}, "fitted"),
        ({"cost": 0.51}, "fitted"),
    ],
)
def test_the_status_of_a_fit_of_responses(changes: dict[str, Any], status: str) -> None:
    given: dict[str, Any] = {
        "converged": True,
        "bound": False,
        "cost": 1.0,
        "error": 0.0,
        "warnings": (),
        "sd": 1e-3,
        "stated": False,
    } | changes
    fit: Any = Made(converged=given["converged"], at_bound=np.array([False, given["bound"]]))
    data: Any = Made(warnings=given["warnings"], relative_sd=lambda: given["sd"])
    found = graybox.fit_status(fit, given["cost"], given["error"], data, given["stated"])
    assert found is FitStatus[status.upper()]


# --- messages ------------------------------------------------------------------------------------
def test_files_that_cannot_be_read_are_named_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "line.npz"
    path.write_bytes(b"x")
    for error, reason in (
        (OSError(5, "Input/output error"), "Input/output error"),
        (OSError("odd"), "odd"),
    ):

        def fail(path: Path, error: OSError = error) -> None:
            raise error

        monkeypatch.setattr(trajectory_files, "_read_npz", fail)
        with pytest.raises(
            ArgumentError,
            match=rf"^trajectory: given '.*line\.npz', which cannot be read \({reason}\)$",
        ):
            flexgen.Trajectory.load(path)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ArgumentError("move: given x"), "move: given x"),
        (OSError(28, "No space left on device", "out.npz"), "out.npz: No space left on device"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (OSError("odd"), "odd"),
        (MemoryError(), "not enough memory"),
        (
            AttributeError("q"),
            (
                "internal error, please report it with the output of FLEXGEN_DEBUG=1: "
                "AttributeError: q"
            ),
        ),
        (
            ModuleNotFoundError("x", name="other.part"),
            "internal error, please report it with the output of .*: x",
        ),
        (
            ModuleNotFoundError("x", name="numpy.linalg"),
            "the Python package numpy.linalg is not installed for .*",
        ),
    ],
)
def test_the_command_line_tells_the_reason_of_an_error(error: BaseException, text: str) -> None:
    found = main._reason(error, Namespace(verb="solve", model="elbow"))
    assert found == text or (".*" in text and found.startswith(text.partition(".*")[0]))


def test_parts_of_an_observer_are_counted() -> None:
    """At least one; the solution is looked at later."""
    nothing = object.__new__(flexgen.Solution)
    for parts in (0, 10001):
        with pytest.raises(ArgumentError, match=rf"^parts: given {parts}, expected 1 to 10000$"):
            ConstantGainObserver(nothing, parts=parts)
    for parts in (1, 10000):
        with pytest.raises(AttributeError):
            ConstantGainObserver(nothing, parts=parts)
