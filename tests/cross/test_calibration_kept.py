"""Numbers that static poses do not determine keep the value of the model file: the axis of a
vertical joint carries no weight, and robots are drawn with other springs, places and zeros.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ModelError
from flexgen.identification.poses import calibrate as verb
from flexgen.identification.poses.model_file import changes_of
from flexgen.identification.poses.parameters import Priors, unknowns_of
from flexgen.identification.poses.statics import Numbers
from flexgen.identification.poses.tree import Tree
from flexgen.model.elements import RobotModel
from flexgen.model.new_file import with_overrides

TRACKERS = [
    {"name": "flange", "type": "tracker", "unit": "m", "position": [0.05, 0.02, 0.1]},
    {"name": "elbow", "type": "tracker", "unit": "m", "element": "body4"},
]
FREE = ("zeros", "placements", "compliances", "masses")
PRIORS = Priors(compliance=0.4, position=1e-3, rotation=2e-3, zero=5e-3, tracker=0.02, mass=0.05)


def arm() -> RobotModel:
    return flexgen.read("manutec_r3_18", overrides={"sensor": TRACKERS})


def calibrated(seed: int) -> tuple[flexgen.Calibration, dict[str, float]]:
    """Calibration of a robot drawn from the priors, and its numbers; noise 0.1 mm."""
    robot = arm()
    rng = np.random.default_rng(seed)
    tree = Tree(robot)
    unknowns = [u for u in unknowns_of(tree, FREE, (), PRIORS) if u.kind != "frame"]
    draws = np.array([u.start + u.sd * rng.normal() for u in unknowns])
    x = [abs(d) if u.kind == "compliance" else d for u, d in zip(unknowns, draws, strict=True)]
    changes = changes_of(robot, Numbers.of(tree, unknowns, x))
    there = flexgen.read(robot.file, overrides={"sensor": TRACKERS} | changes)
    q = rng.uniform(-1.5, 1.5, (60, 6))
    seen = flexgen.tracker_positions(there, q)  # by CasADi, not by the tree
    poses = flexgen.StaticPoses(q, seen + 1e-4 * rng.normal(size=seen.shape))
    found = flexgen.calibrate(robot, poses, free=FREE, priors=PRIORS, folds=0)
    return found, {u.name: value for u, value in zip(unknowns, x, strict=True)}


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_kept_numbers_are_those_of_the_file_and_the_others_come_back(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kept: to the bit; the others: 90 % or more within two standard deviations. Planted: the
    posterior moves the stiffness of the vertical axis.
    """
    found, truth = calibrated(seed)
    start = {u.name: u.start for u in found.unknowns}
    assert {"q1.compliance", "body1.mass"} & {*found.kept} and not found.problem
    assert all(found.values[name] == start[name] for name in found.kept)
    inside = [
        abs(found.values[name] - true) < 2.0 * found.sd[name]
        for name, true in truth.items()
        if name not in found.kept and found.sd[name] > 0.0
    ]
    assert len(inside) > 30 and np.mean(inside) > 0.9
    assert {"q2.compliance"} <= {k for k, good in found.determined.items() if good}
    if seed == 0:
        monkeypatch.setattr(verb, "find_undetermined", lambda *given: ())
        wrong, _ = calibrated(seed)
        assert sum(wrong.values[name] != start[name] for name in found.kept) > 10


def test_the_written_file_names_them_and_solve_and_predict_say_so(tmp_path: Path) -> None:
    """A key of the variant, kept by the model; identified numbers are no longer named; unknown
    names are refused.
    """
    found, _ = calibrated(0)
    new = found.write(tmp_path / "new.toml")
    robot = flexgen.read(f"{new}@calibrated")
    assert "q1.stiffness" in robot.not_measured
    assert robot.elements[0].dofs[0] == arm().elements[0].dofs[0]
    one = flexgen.read(
        "elbow",
        overrides={"not_measured": ["q1.stiffness"], "uncertainty": {"stiffness": 0.1}},
    )
    solution = flexgen.solve(one)
    sentence = "q1.stiffness is not measured: value of the model file"
    predicted = flexgen.predict(one, solution=solution, robots=16)
    for result in (solution, predicted):
        assert sentence in str(result) and sentence in result.to_text()
        assert result.to_dict()["not_measured"] == ["q1.stiffness"]
    with pytest.raises(ModelError, match=r'not_measured: given "q7.stiffness", expected names'):
        flexgen.read("elbow", overrides={"not_measured": ["q7.stiffness"]})


def test_a_later_fit_takes_its_numbers_off_the_list(tmp_path: Path) -> None:
    """Stiffnesses that responses identify are measured."""
    robot = flexgen.read(
        "planar5_nmp", overrides={"not_measured": ["q1.stiffness", "q2.stiffness", "arm1.mass"]}
    )
    changes = {"element.arm1.dof.q1.gear.spring.stiffness": 1e5, "element.arm1.body.mass": 9.0}
    assert with_overrides(robot, changes)["not_measured"] == ["q2.stiffness"]
