"""The defect: residuals of the equations of motion, at the output, over the directions that do not
grow.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from claimed_error import largest
from toolchain import needs_compiler
from whole_move import WholeMove

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation.simulate import simulate
from flexgen.simulation.verification import defect as of_defect
from flexgen.simulation.verification.defect import growing_part

pytestmark = needs_compiler
UPRIGHT = Path(__file__).parents[1] / "support" / "robots" / "upright.toml"


def disturbed(t: Trajectory, share: float) -> Trajectory:
    """The trajectory with torques that are wrong by a share of the largest, in a burst in the
    middle.
    """
    burst = np.exp(-0.5 * ((t.time - t.time.mean()) / (0.05 * np.ptp(t.time))) ** 2)
    return replace(
        t,
        channels={
            **t.channels,
            "tau_m": t["tau_m"] + share * np.abs(t["tau_m"]).max() * burst[:, None],
        },
    )


@pytest.mark.parametrize("name", ["planar5_nmp", "elbow"])
def test_the_defect_of_a_robot_that_does_not_fall_is_its_error_in_open_loop(name: str) -> None:
    """A small wrong torque: the deviation of a simulation that shares no code, until the motion is
    at rest.
    """
    equations = derive(name)
    right = flexgen.solve(equations, verify=False).trajectory
    wrong = disturbed(right, 1e-6)
    run = simulate(equations, wrong, held=0.0)
    speed = np.abs(right["v_a"]).max(axis=1)
    rest = right.time[np.flatnonzero(speed > 1e-4 * speed.max())[-1]] - right.time[-1]
    found = largest(WholeMove(equations.model).errors(wrong, (rest, 0.01))[0])
    defect = largest((run.defect_max_m, run.defect_max_rad))
    assert run.feedback is None and defect == pytest.approx(found, rel=0.1) and found > 1e-8
    assert largest((simulate(equations, right).defect_max_m, 0.0)) < 0.02 * found


@pytest.mark.slow
def test_the_defect_of_a_robot_that_falls_does_not_grow_with_it() -> None:
    equations = derive(UPRIGHT)
    wrong = disturbed(flexgen.solve(equations, verify=False).trajectory, 1e-6)
    run = simulate(equations, wrong)
    alone = largest(WholeMove(equations.model).errors(wrong)[0])
    assert run.growth is not None and run.growth > 1e8
    assert run.defect_max_rad is not None and 1e-9 < run.defect_max_rad < 1e-3 * alone


def test_the_growing_part_of_a_saddle_is_that_along_its_unstable_direction() -> None:
    """Eigenvalues 3 and -3 of the saddle, with eigenvectors (1, 3) and (1, -3); none grows faster
    than 4.
    """
    saddle = np.array([[0.0, 1.0], [9.0, 0.0]])
    assert growing_part(saddle, 1.0) @ [1.0, 3.0] == pytest.approx([1.0, 3.0])
    assert growing_part(saddle, 1.0) @ [1.0, -3.0] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert not growing_part(saddle, 4.0).any()


def test_a_defect_that_overflows_does_not_warn(monkeypatch: pytest.MonkeyPatch) -> None:
    """exp(1000) over the motion, as of an upright arm in a slow move."""
    k = 3
    A = np.tile([[0.0, 1.0], [1e4, 0.0]], (k, 1, 1))
    along = SimpleNamespace(
        A=A,
        means=A,
        at=np.arange(k + 1),
        lengths=np.full(k, 10.0),
        force=np.tile([[1.0]], (k, 1, 1)),
    )
    monkeypatch.setattr(of_defect, "output_rows", lambda equations, q_a: np.ones((len(q_a), 1, 1)))
    monkeypatch.setattr(of_defect, "units_of_output", lambda equations: ["m"])
    equations = SimpleNamespace(model=SimpleNamespace(n_a=1))
    motion = SimpleNamespace(q_a=np.zeros((k + 1, 1)))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        in_m, in_rad = of_defect.propagate_residual(
            equations, motion, along, np.ones((k, 1)), False
        )
    assert not np.isfinite(in_m) and in_rad is None
