"""Texts of public objects on the terminal and in a notebook: short, without addresses; tables are
escaped.
"""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
import pytest
from unchecked import unchecked

import flexgen
from flexgen.studies.scenarios.scenario_file import scenario

PROTOCOLS = ("Controller",)  # have no objects
MANY = np.random.default_rng(0).normal(size=(400, 2, 6))


@pytest.fixture(scope="module")
def robot():
    return flexgen.read("elbow")


@pytest.fixture(scope="module")
def solution(robot):
    return flexgen.solve(robot)


@pytest.fixture(scope="module")
def objects(robot, solution, tmp_path_factory):
    """Results that need little time, and large objects where the size depends on the user."""
    folder = tmp_path_factory.mktemp("texts")
    path = flexgen.plan(robot)
    problem = flexgen.plan_problem(robot)
    rows = MANY[:, 0]
    steps = tuple(flexgen.MoveJ(end=(0.01 * k, 0.02 * k)) for k in range(80))
    return [
        robot,
        flexgen.derive(robot),
        flexgen.derive(robot, ["payload.mass"]),
        flexgen.analyze(robot),
        flexgen.check(robot),
        path,
        path.sample(np.linspace(0.0, path.duration, 400)),
        problem,
        problem.then(0.5),
        solution,
        solution.trajectory,
        solution.simulation,
        flexgen.export_fmu(robot, folder / "elbow.fmu", binary=False, progress=False),
        flexgen.export_ros2(robot, folder / "ros2"),
        flexgen.GeneratedLibrary(
            folder, (folder,) * 100, ("gravity",) * 100, "0" * 64, 1.0, False, True
        ),
        flexgen.Program(name="long", type="program", start=(0.0, 0.0), steps=steps),
        flexgen.Configuration(np.zeros(100), 0.0, True, 1, 0.1, {}),
        flexgen.Detection(rows, None),
        flexgen.Estimate(*[rows] * 8),
        flexgen.Linear(*[MANY] * 4),
        flexgen.Cascade(*[np.ones(100)] * 3),
        flexgen.LQG(model=robot),
        flexgen.Grid([robot] * 100, parameters=[{"payload.mass": float(k)} for k in range(500)]),
        flexgen.Limits(torque=tuple(range(1, 900))),
        flexgen.PlantRun("soft", rows, rows, rows, rows, None, 3, "", rows, rows),
        scenario("four_mass"),
    ]


def test_texts_of_public_objects_are_short_and_have_no_addresses(objects):
    for shown in objects:
        for text in (repr(shown), str(shown)):
            assert len(text.splitlines()) < 25 and len(text) < 2500, (
                type(shown).__name__,
                len(text),
            )
            assert " at 0x" not in text and type(shown).__name__ in repr(shown), text


def test_a_run_of_many_robots_prints_twenty(robot, solution):
    run = flexgen.control(
        robot, solution=solution, plants={"soft": {"stiffness": 0.9}}, progress=False
    )
    assert str(run).count("\n") == len(run.runs) and "more robots" not in str(run)
    many = str(replace(run, runs=run.runs * 50)).splitlines()
    assert len(many) == 22 and many[-1] == f"  and {50 * len(run.runs) - 20} more robots in .runs"


def test_every_public_class_has_its_own_text():
    named = [getattr(flexgen, name) for name in flexgen.__all__ if name not in PROTOCOLS]
    classes = [c for c in named if inspect.isclass(c) and not issubclass(c, Exception)]
    plain = [c.__name__ for c in classes if c.__repr__ is object.__repr__]
    assert not plain


def test_a_text_says_what_the_object_is(robot):
    assert repr(flexgen.derive(robot)) == "<Equations elbow: 4 degrees of freedom>"
    assert repr(flexgen.plan(robot)).startswith(f"<Path elbow, move {robot.moves[0].name}: 1 s, ")
    assert repr(flexgen.Program(name="p", start=(1.0,))) == "Program(name='p', start=(1.0,))"
    assert repr(flexgen.Limits(torque=(3.0, 4.0))) == "Limits(torque=(3.0, 4.0))"
    assert (
        repr(flexgen.Detection(MANY[:, 0], 7)) == "Detection(residual=<array 400 x 6>, sample=7)"
    )


def test_the_tables_for_notebooks_show_and_escape_the_names(robot, solution):
    motors = tuple(unchecked(motor, name=f"<i>{motor.name}") for motor in robot.motors)
    named = unchecked(robot, name="<b>", description="<script>", motors=motors)
    analysis = replace(flexgen.analyze(robot), model=named)
    for shown in (named, analysis, replace(solution, model=named)):
        text = shown._repr_html_()
        assert "&lt;b&gt;" in text and "<table>" in text
        assert not any(tag in text for tag in ("<b>", "<i>", "<script>"))
    assert "&lt;script&gt;" in named._repr_html_() and "&lt;i&gt;m1" in named._repr_html_()
    assert "&lt;i&gt;m1" in analysis._repr_html_() and "22.77" in analysis._repr_html_()
