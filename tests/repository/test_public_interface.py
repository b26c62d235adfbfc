"""The public interface: nouns and verbs of `flexgen`, resolved on first use, and the verb
`plan`.
"""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.cli.main import main

NOUNS = "Path Move MoveJ MoveL MoveC Program Limits Solution Status Trajectory Grid".split()
VERBS = "models describe read derive analyze plan solve simulate generate load sweep".split()


@pytest.mark.parametrize("name", NOUNS)
def test_nouns_are_classes(name):
    assert name in flexgen.__all__ and name in dir(flexgen)
    noun = getattr(flexgen, name)
    assert inspect.isclass(noun) and noun.__name__ == name and noun.__doc__


@pytest.mark.parametrize("name", VERBS)
def test_verbs_are_functions(name):
    assert name in flexgen.__all__ and name in dir(flexgen)
    verb = getattr(flexgen, name)
    assert inspect.isfunction(verb) and verb.__name__ == name and verb.__doc__


def test_an_unknown_name_raises_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'invert'"):
        _ = flexgen.invert


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp", "beam_arm", "manutec_r3", "four_mass"])
def test_a_plan_is_a_path_that_starts_and_ends_at_rest(name):
    path = flexgen.plan(name)
    assert isinstance(path, flexgen.Path) and path.move.name == flexgen.read(name).move().name
    sample = path.sample(np.linspace(0.0, path.duration, 11))
    size = np.abs(sample.y).max(axis=(0, 1))
    assert np.isfinite(sample.y).all() and size[1] > 0
    assert (np.abs(sample.y[[0, -1], :, 1]) <= 1e-9 * size[1]).all()


def test_a_plan_takes_names_moves_and_equations():
    equations = flexgen.derive("planar5_nmp")
    first = equations.model.move()
    for path in (
        flexgen.plan(equations),
        flexgen.plan(equations.model, first.name),
        flexgen.plan("planar5_nmp", first),
    ):
        assert path.move == first and path.duration == first.duration


def test_a_plan_is_the_path_that_solve_follows():
    path = flexgen.plan("elbow")
    solution = flexgen.solve("elbow", verify=False)
    t = solution.trajectory.time
    assert (
        np.array_equal(path.sample(t).y[:, :, 0], solution.trajectory["y_ref"])
        and path.move == solution.move
    )


def test_a_plan_refuses_what_does_not_exist_or_cannot_be_reached():
    with pytest.raises(
        ArgumentError, match="given 'nosuch', expected one of model planar5_nmp: line"
    ):
        flexgen.plan("planar5_nmp", "nosuch")
    with pytest.raises(
        ArgumentError, match=r"given 3, expected the name of a move or a flexgen\.Move"
    ):
        flexgen.plan("planar5_nmp", 3)
    model = flexgen.read("planar5_nmp")
    far = replace(model.move(), displacement=tuple(100.0 * x for x in model.move().displacement))
    with pytest.raises(SolverError, match=r"workspace|singular pose"):
        flexgen.plan(model, far)


GANTRY = """
name = "gantry"
gravity = [0, 0, -9.81]
home_rad = [0.0]
[[element]]
name = "carriage"
dof = [{ name = "x", type = "translation", axis = [1, 0, 0], lower = -1.0, upper = 1.0, gear = { \
type = "rigid" } }]
body = { mass = 4.0 }
[[motor]]
name = "m1"
drives = "x"
ratio = 50.0
inertia = 1e-4
torque_max = 100.0
[output]
type = "tool_position"
axes = "x"
[[move]]
name = "far"
type = "tool_line"
start_rad = [0.0]
displacement = [61.0, 0, 0]
duration = 2.0
smoothness = 5
[[move]]
name = "back"
type = "tool_line"
start_rad = [0.0]
displacement = [-1.5, 0, 0]
duration = 2.0
smoothness = 5
[[move]]
name = "near"
type = "tool_line"
start_rad = [0.0]
displacement = [0.9, 0, 0]
duration = 2.0
smoothness = 5
"""


@pytest.mark.slow
def test_move_beyond_the_range_of_a_joint_is_refused_and_more_time_is_not_advised(
    tmp_path, capsys
):
    file = tmp_path / "gantry.toml"
    file.write_text(GANTRY)
    for move, far in (("far", "61 m"), ("back", "-1.5 m")):
        with pytest.raises(
            SolverError,
            match=rf"coordinate x goes to {far}, its range is -1 to 1 m; choose another",
        ):
            flexgen.plan(str(file), move)
        assert flexgen.plan(str(file), move, ignore_limits=True).duration == 2.0
        assert main(["plan", str(file), "--move", move]) != 0
        assert "choose another target or path" in capsys.readouterr().err
    assert main(["solve", str(file), "--move", "far"]) == 3
    told = capsys.readouterr().err
    assert "choose another target or path" in told and "give" not in told
    with pytest.raises(SolverError, match="its range is -1 to 1 m"):
        flexgen.fastest(str(file), "far")
    assert flexgen.plan(str(file), "near").duration == 2.0
    weak = ["--set", "motor.m1.torque_max=1e-3"]
    assert main(["solve", str(file), "--move", "near", *weak]) == 3
    told = capsys.readouterr().err
    assert "give the move more time" in told and "another target" not in told
