"""Frictions with a state in the closed loop: MuJoCo with a law of the tests, other models, planted
errors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bristled import bristled, error_in_mujoco, tables
from numpy.testing import assert_allclose
from toolchain import needs_compiler

import flexgen
from flexgen.exports.mujoco.mujoco_checks import with_friction
from flexgen.feedback.loop import hysteresis as loop

pytestmark = needs_compiler
OPEN = {"controller": "none", "sample_time": 1e-4, "torque_limits": False, "progress": False}
# s, of MuJoCo; of the error: what the law of the tests leaves with that step
STEP = 2.5e-5
AGREES = 1e-4
NUMBERS = tables("elbow")


@pytest.fixture(scope="module")
def plain() -> flexgen.Solution:
    """The move of a robot whose model lacks the friction."""
    return flexgen.solve(with_friction(flexgen.read("elbow"), "viscous"), progress=False)


def error_of(run: flexgen.ControlRun, name: str = "nominal") -> float:
    """Largest tool error [m] until 0.1 s after the move, as in MuJoCo."""
    time = run.reference.time
    return float(
        run.distance(run[name])[(time >= 0.0) & (time <= run.reference.end + 0.1 + 1e-9)].max()
    )


@pytest.mark.slow
@pytest.mark.parametrize("factor", [pytest.param(1.0, marks=pytest.mark.full), 1.2])
def test_the_loop_has_the_errors_of_mujoco(plain: flexgen.Solution, factor: float) -> None:
    """Of torques that lack the friction, without feedback; where Coulomb and static torque are 20
    % larger.
    """
    pytest.importorskip("mujoco")
    more = {"lugre_coulomb": factor, "lugre_static": factor}
    run = flexgen.control(
        bristled("elbow", NUMBERS), solution=plain, plants={"more": more}, **OPEN
    )
    assert run.status == "done"
    large = {
        m: row | {k: factor * row[k] for k in ("coulomb", "static")} for m, row in NUMBERS.items()
    }
    expected = error_in_mujoco("elbow", plain.trajectory, large, step=STEP, feedback=False)
    assert expected > 1e-3
    assert error_of(run, "more") == pytest.approx(expected, rel=AGREES)


@pytest.fixture(scope="module")
def right(plain: flexgen.Solution) -> flexgen.ControlRun:
    """Before errors are planted."""
    return flexgen.control(bristled("elbow", NUMBERS), solution=plain, **OPEN)


@pytest.mark.parametrize(("planted", "factor"), [("motor_force", -1.0), ("motor_speeds", 0.9)])
def test_planted_errors_of_the_law_are_found(
    planted: str,
    factor: float,
    plain: flexgen.Solution,
    right: flexgen.ControlRun,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The sign of the force, and bristles that deflect 10 % less."""
    own = getattr(loop, planted)
    monkeypatch.setattr(loop, planted, lambda *given: factor * own(*given))
    run = flexgen.control(bristled("elbow", NUMBERS), solution=plain, **OPEN)
    assert run.status != "done" or error_of(run) != pytest.approx(error_of(right), rel=10 * AGREES)


@pytest.mark.slow
def test_feedforward_that_knows_the_friction_leaves_no_error(plain: flexgen.Solution) -> None:
    model = bristled("elbow", NUMBERS)
    unknown = flexgen.control(model, solution=plain, progress=False)
    more = {"more": {"lugre_coulomb": 1.2, "lugre_static": 1.2}}
    known = flexgen.control(model, plants=more, progress=False)
    errors = [float(known.distance(robot).max()) for robot in known.runs]
    assert errors[0] < 5e-8 < 1e-5 < error_of(unknown)
    assert 1e-6 < errors[1] < 0.3 * error_of(unknown)


@pytest.mark.slow
def test_with_hysteresis_both_act(plain: flexgen.Solution) -> None:
    """Robots whose numbers make one of the states vanish are those of models without it."""
    gears = {
        f"element.{x}.gear.hysteresis": {"lost_motion": 3e-4, "stiffness": 1e5}
        for x in ("upper.dof.q1", "fore.dof.q2")
    }
    both = bristled("elbow", NUMBERS, **gears)
    least: dict[str, Any] = {"none": {"lost_motion": 0.0}}
    options = {"solution": plain, "progress": False}
    run = flexgen.control(both, plants=least, **options)
    alone = flexgen.control(bristled("elbow", NUMBERS), controller=run.law, **options)
    assert_allclose(run["none"].q_a, alone.nominal.q_a, rtol=0, atol=1e-8)
    assert np.abs(run.nominal.q_a - alone.nominal.q_a).max() > 1e-6


@pytest.mark.slow
def test_the_loop_of_a_larger_robot() -> None:
    name = "planar5_nmp"
    numbers = tables(name)
    model = bristled(name, numbers)
    base = with_friction(flexgen.read(name), "viscous")
    given = flexgen.solve(base, progress=False)
    unknown = error_of(flexgen.control(model, solution=given, progress=False))
    known = error_of(flexgen.control(model, progress=False))
    assert known < 5e-8 < 1e-4 < unknown
