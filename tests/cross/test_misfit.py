"""The misfit of a model: errors of positions over the elastic displacement, measured on records
and predicted on a path.

Displacements here are differences of positions with and without deflections; the errors of robots
are drawn one by one.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.spec.parts import Tolerances
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.commissioning.misfit import measure_misfit
from flexgen.identification.commissioning.poses_block import PosesBlock
from flexgen.identification.commissioning.unknowns import DatasheetTolerances, make_unknowns
from flexgen.identification.poses.poses import StaticPoses
from flexgen.studies.tolerances import misfit as module
from flexgen.studies.tolerances import prediction

pytestmark = needs_compiler

HAND = {"name": "hand", "type": "tracker", "unit": "m", "position": [0.0, 0.0, 0.1]}


@cache
def solved() -> flexgen.Solution:
    return flexgen.solve("planar5_nmp", progress=False)


def predicted(**given: float) -> flexgen.Prediction:
    """With nothing else uncertain than given."""
    known = Tolerances(**({"stiffness": 1e-9} | given))  # type: ignore[arg-type]
    model = replace(solved().model, uncertainty=known)
    return flexgen.predict(model, solution=replace(solved(), model=model), progress=False)


@pytest.mark.slow
def test_the_stated_error_is_that_of_robots_drawn_one_by_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a planar arm; planted: without one of its components."""
    robot = solved().model
    motion = solved().trajectory
    output = derive(robot).function("output")
    rigid = motion["q_a"].copy()
    rigid[:, list(robot.i_g)] = motion["q_m"] @ np.linalg.inv(robot.eta).T
    rigid[:, list(robot.i_e)] = 0.0
    u = np.array([np.array(output(q)).ravel() for q in motion["q_a"]])
    u = u - np.array([np.array(output(q)).ravel() for q in rigid])
    random = np.random.default_rng(7)
    draws = 0.1 * random.normal(size=(4000, 2, 2)) / np.sqrt(2)
    largest = np.linalg.norm(u @ draws, axis=2).max(axis=1)
    wanted = float(np.quantile(largest, 0.95))
    found = predicted(misfit=0.1)
    assert found.error_m == pytest.approx(wanted, rel=0.04)
    assert found.shares[0].name == "misfit" and found.shares[0].share > 0.999
    assert "what the model lacks" in str(found)
    true = module.elastic_displacement
    monkeypatch.setattr(prediction, "elastic_displacement", lambda m, a: true(m, a) * [1.0, 0.0])
    assert predicted(misfit=0.1).error_m != pytest.approx(wanted, rel=0.04)


@pytest.mark.slow
def test_a_misfit_adds_to_the_errors_of_the_numbers() -> None:
    """Between the larger of both and their sum; shares are 100 %."""
    alone = predicted(stiffness=0.1).error_m
    lacking = predicted(misfit=0.1).error_m
    both = predicted(stiffness=0.1, misfit=0.1)
    assert alone is not None and lacking is not None and both.error_m is not None
    assert max(alone, lacking) < both.error_m < alone + lacking
    assert sum(share.share for share in both.shares) == pytest.approx(1.0)
    assert both.sources[-1] == "misfit" and both.sd[-1] == 0.1


@pytest.mark.parametrize("part", [0.05, 0.3])
def test_measured_misfit_of_poses(part: float) -> None:
    """Positions that move by more than the model's by a part of the displacement."""
    robot = flexgen.read("elbow", overrides={"sensor": [HAND]})
    stiff = {
        "sensor": [HAND],
        "element.upper.dof.q1.gear.spring.stiffness": 1e12,
        "element.fore.dof.q2.gear.spring.stiffness": 1e12,
    }
    q = np.random.default_rng(2).uniform(-1.2, 1.2, (25, 2))
    elastic = flexgen.tracker_positions(robot, q)
    rigid = flexgen.tracker_positions(flexgen.read("elbow", overrides=stiff), q)
    u = elastic - rigid
    seen = elastic + part * (u - u.mean(axis=0))
    unknowns = make_unknowns(
        robot, DatasheetTolerances(), bodies=False, positions=True, lengths=False, motions=0,
        levels=0,
    )  # fmt: skip
    poses = StaticPoses(q, seen)
    block = PosesBlock(
        ElasticArm(unknowns, unknowns.sensors), "poses", poses, np.zeros((len(q), 3, 0))
    )
    found = measure_misfit([block], unknowns.start, lambda c: np.ones(len(c.piece), bool))
    assert found is not None and 0.97 * part < found <= part  # the largest ones count less
    assert measure_misfit([], unknowns.start, lambda c: c.told) is None
