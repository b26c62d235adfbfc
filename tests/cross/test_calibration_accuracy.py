"""Standard deviations of predicted positions: true and measured positions at poses that were not
fitted are inside of 1.96 of them in 95 % of the cases. The truth is from CasADi's statics.
"""

from __future__ import annotations

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.poses.model_file import changes_of
from flexgen.identification.poses.parameters import GROUPS, Priors, unknowns_of
from flexgen.identification.poses.statics import Numbers
from flexgen.identification.poses.tree import Tree

SENSORS = [
    {"name": "flange", "type": "tracker", "unit": "m", "position": [0.05, 0.02, 0.1]},
    {"name": "elbow", "type": "tracker", "unit": "m", "element": "body4"},
]
PRIORS = Priors(compliance=0.4, position=3e-3, rotation=5e-3, zero=5e-3, mass=0.1, center=0.01)
NOISE = 1e-4  # m


def parts_inside(
    free: tuple[str, ...], seeds: range, poses: int = 40
) -> tuple[float, float, float]:
    """Parts of axes inside of 1.96 deviations: true, true within half of these, and measured."""
    robot = flexgen.read("manutec_r3_18", overrides={"sensor": SENSORS})
    tree = Tree(robot)
    unknowns = [
        u for u in unknowns_of(tree, free, (), PRIORS) if u.kind not in ("frame", "tracker")
    ]
    sizes = []
    noisy = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        draws = [u.start + u.sd * rng.normal() for u in unknowns]
        x = [
            abs(d) if u.kind in ("compliance", "mass") else d
            for u, d in zip(unknowns, draws, strict=True)
        ]
        changes = changes_of(robot, Numbers.of(tree, unknowns, x))
        there = flexgen.read(robot.file, overrides={"sensor": SENSORS} | changes)
        q = rng.uniform(-1.5, 1.5, (poses + 30, 6))
        truth = flexgen.tracker_positions(there, q)
        seen = truth + NOISE * rng.normal(size=truth.shape)
        data = flexgen.StaticPoses(q[:poses], seen[:poses])
        found = flexgen.calibrate(robot, data, free=free, priors=PRIORS, folds=0)
        away = np.abs(found.predict(q[poses:]) - truth[poses:])
        sizes.append(away / found.position_sd(q[poses:]))
        far = np.abs(found.predict(q[poses:]) - seen[poses:])
        noisy.append(far / found.position_sd(q[poses:], measured=True))
    inside = [float(np.mean(np.concatenate(x) < 1.96)) for x in (sizes, noisy)]
    return inside[0], float(np.mean(np.concatenate(sizes) < 0.98)), inside[1]


@pytest.mark.parametrize(
    ("free", "seeds"),
    [
        (("compliances",), range(2)),
        pytest.param(("zeros", "compliances"), range(6), marks=pytest.mark.slow),
        pytest.param(GROUPS, range(6), marks=pytest.mark.slow),
    ],
    ids=["compliances", "zeros", "all"],
)
def test_positions_that_were_not_fitted_are_inside(free: tuple[str, ...], seeds: range) -> None:
    """Of true and of measured positions; planted: deviations of half the size hold fewer."""
    true, half, measured = parts_inside(free, seeds)
    assert true > 0.9 and measured > 0.9
    assert half < 0.9


def test_commands_of_another_robot_are_refused() -> None:
    robot = flexgen.read("manutec_r3_18", overrides={"sensor": SENSORS[:1]})
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 6))
    data = flexgen.StaticPoses(q, flexgen.tracker_positions(robot, q))
    found = flexgen.calibrate(robot, data, free=["zeros"], folds=0)
    with pytest.raises(ArgumentError, match=r"commands: given shape \(20, 5\), expected finite"):
        found.position_sd(q[:, :5])
