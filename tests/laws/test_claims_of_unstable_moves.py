"""The stated tool error holds for the whole move: in open loop, or under the feedback that is named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.cli.main import main
from flexgen.loop.gains import PPI
from flexgen.mechanics.equations import derive
from flexgen.model.reader import read
from flexgen.simulation.motor_feedback import default_feedback
from flexgen.simulation.result import Simulation
from flexgen.simulation.simulate import UNSTABLE, simulate

pytest.importorskip("pinocchio")
from closed_loop_referee import closed_loop_error
from end_of_move import errors

pytestmark = needs_compiler
ROBOTS = Path(__file__).parents[1] / "support" / "robots"
SHARE, SMALL = 0.05, 1e-9  # of the claimed error; m or rad


def gains(simulation: Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    assert simulation.feedback is not None
    return simulation.feedback.position_gain, simulation.feedback.speed_gain, simulation.feedback.integral_gain


def slow_elbow(duration: float) -> flexgen.Solution:
    """A slow move of the elbow arm, which falls without feedback."""
    model = read("elbow")
    return flexgen.solve(model, replace(model.moves[0], duration=duration))


@pytest.mark.slow
@pytest.mark.parametrize("duration", [16.0, 32.2])
def test_the_error_of_a_falling_robot_is_that_under_the_named_feedback(duration: float) -> None:
    solution = slow_elbow(duration)
    run = solution.simulation
    assert run is not None and run.growth is not None and run.growth > UNSTABLE and run.open_loop is not None
    assert solution.status == flexgen.Status.SOLVED
    claimed = solution.tool_error_max_m
    assert claimed is not None and claimed < 1e-8
    assert closed_loop_error(solution.model, solution.trajectory, gains(run)) < 1.2 * claimed + SMALL
    # without feedback the robot falls, and the print says so
    alone = max(errors(solution.model, solution.trajectory))
    printed = run.open_loop.tool_error_max_m
    assert printed is not None and alone > 1e-3 and printed > 1e-3
    assert run.feedback is not None and run.feedback.title in str(solution) and "without:" in str(solution)


@pytest.mark.slow
def test_an_error_under_feedback_is_that_of_another_simulation() -> None:
    """A torque that is 2 % too large, on the upright arm."""
    equations = derive(ROBOTS / "upright.toml")
    right = flexgen.solve(equations, verify=False).trajectory
    wrong = replace(right, channels={**right.channels, "tau_m": 1.02 * right["tau_m"]})
    run = simulate(equations, wrong)
    found = closed_loop_error(equations.model, wrong, gains(run))
    assert run.tool_error_max_rad == pytest.approx(found, rel=SHARE) and found > 1e-5
    # planted: half of the position gain is another feedback
    other = closed_loop_error(equations.model, wrong, (gains(run)[0] / 2, *gains(run)[1:]))
    assert abs(other - found) > 2 * SHARE * found


def test_the_default_feedback_has_the_gains_of_control() -> None:
    for name in ("elbow", "planar5_nmp"):
        equations = derive(name)
        t = flexgen.solve(equations, verify=False).trajectory
        first = [t[x][:1] for x in ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")]
        drive = PPI().cascade(equations.model, 1e-9, first)
        found = default_feedback(equations, t["q_a"][0], t["q_m"][0], t["tau_m"][0])
        for key in ("position_gain", "speed_gain", "integral_gain"):
            assert getattr(found, key) == pytest.approx(getattr(drive, key), rel=1e-9)


@pytest.mark.parametrize("name", ["elbow", pytest.param(str(ROBOTS / "upright.toml"), marks=pytest.mark.slow)])
def test_a_saved_file_gives_the_stated_error(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`flexgen simulate` of the file that `flexgen solve` wrote: the same figures, growth and feedback."""
    file, told = str(tmp_path / "motion.npz"), []
    for words in (["solve", name, "--out", file], ["simulate", name, file]):
        assert main([*words, "--json"]) == 0
        told.append(json.loads(capsys.readouterr().out))
    keys = [key for key in told[0] if key in told[1] and ("error" in key or key in ("growth", "held_s"))]
    assert {"tool_error_max_m", "later_error_max_m", "growth", "open_loop_error_max_m"} <= set(keys)
    for key in keys:
        a, b = (x[key] for x in told)
        assert a is b or a == pytest.approx(b, rel=1e-2, abs=1e-12), key
    assert told[0]["motor_feedback"] == told[1]["motor_feedback"]
    assert (told[0]["motor_feedback"] is not None) == (name != "elbow")


@pytest.mark.parametrize(
    ("name", "move"),
    [
        ("elbow", "line"),
        *(pytest.param(*pair, marks=pytest.mark.slow) for pair in (("planar5_soft", "line"), ("four_mass", "step"))),
    ],
)
def test_the_error_two_seconds_after_the_end_is_the_simulated_one(name: str, move: str) -> None:
    solution = flexgen.solve(name, move)
    run = solution.simulation
    assert run is not None
    claimed = max(run.later_error_max_m or 0.0, run.later_error_max_rad or 0.0)
    found = max(errors(read(name), solution.trajectory, 2.0))
    assert abs(found - claimed) <= SHARE * claimed + SMALL, (found, claimed)
    assert " until 2 s" in str(solution)
