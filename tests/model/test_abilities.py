"""The table of abilities is true: functions refuse robots, or take them, as it says."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from robots_with_features import CHANGES, calls, robot_with
from support_page import PAGE, page

import flexgen
from flexgen.base.errors import FlexgenError
from flexgen.base.spec import memory as tables_of_states
from flexgen.base.spec import parts
from flexgen.dynamics.hysteresis import hysteresis, hysteresis_law, hysteretic_gears, lugre
from flexgen.dynamics.mechanics import force_laws, lagrangian, motor_harmonics
from flexgen.model import abilities, elements, friction
from flexgen.model.abilities import (
    FEATURES,
    FUNCTIONS,
    PARTS,
    Feature,
    check_ability,
    needs,
    obstacle,
)
from flexgen.model.format import format_devices, format_robot

ROOT = Path(__file__).resolve().parents[2]
# Rows of which another row, or the robot without a feature, is the example.
SHARED = {
    "complete coupling behind springs",
    "friction with a state and harmonics",
    "loose spring",
    "no elastic coordinates",
    "no complete coupling",
    "no friction by load",
    "no harmonics",
    "no sensors",
    "outputs that lines move",
}
# A fit of the hysteresis itself needs a record of minutes: `tests/cross/test_identify_gears.py`.
ELSEWHERE = {("hysteresis", "identify_gears")}


def features_of(robot: flexgen.RobotModel) -> list[Feature]:
    return [feature for feature in FEATURES if feature.find(robot)]


def refusing(name: str, function: str) -> list[Feature]:
    return [feature for feature in features_of(robot_with(name)) if function in feature.refused]


CELLS = [(name, function) for name in CHANGES for function in FUNCTIONS]
REFUSED = [cell for cell in CELLS if refusing(*cell)]
TAKEN = [cell for cell in CELLS if not refusing(*cell) and cell not in ELSEWHERE]
# Every fifth cell along both sides of the table, so that each function and each feature has some
# with the slow tests; the other cells run with the full ones.
FEATURES_APART = 5


def is_full(name: str, function: str) -> bool:
    """Whether a cell of the table runs with the full tests only."""
    return bool((list(CHANGES).index(name) + list(FUNCTIONS).index(function)) % FEATURES_APART)


def test_each_row_has_a_robot_and_each_function_a_call(tmp_path: Path) -> None:
    assert {feature.name for feature in FEATURES} == CHANGES.keys() - {"none"} | SHARED
    assert calls(tmp_path).keys() == set(FUNCTIONS)
    for name in CHANGES.keys() - {"none"}:
        assert name in [feature.name for feature in features_of(robot_with(name))]
    named = {function for f in FEATURES for function in {*f.refused, *f.without, *f.own}}
    assert named <= set(FUNCTIONS)
    assert {part for feature in FEATURES for part in feature.parts} == PARTS.keys()


@pytest.mark.parametrize(("name", "function"), REFUSED)
def test_a_refused_robot_gets_the_reason_of_the_table(
    name: str, function: str, tmp_path: Path
) -> None:
    robot = robot_with(name)
    with pytest.raises(FlexgenError) as told:
        calls(tmp_path)[function](robot)
    if any(function in feature.own for feature in refusing(name, function)):
        assert re.search("given .*expected|do not determine", str(told.value))
        return
    texts = [feature.refusal(robot, function) for feature in refusing(name, function)]
    assert str(told.value) in texts


def test_each_function_and_each_feature_has_a_slow_cell() -> None:
    slow = [cell for cell in TAKEN if not is_full(*cell)]
    assert {name for name, _ in slow} == {name for name, _ in TAKEN}
    assert {function for _, function in slow} == {function for _, function in TAKEN}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "function"),
    [pytest.param(*cell, marks=pytest.mark.full if is_full(*cell) else ()) for cell in TAKEN],
)
def test_a_robot_that_is_not_refused_is_taken(name: str, function: str, tmp_path: Path) -> None:
    calls(tmp_path)[function](robot_with(name))


def test_the_page_is_that_of_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run: make golden"


def test_a_wrong_row_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Planted: the table says that the export to MuJoCo takes hysteresis."""
    row = next(feature for feature in FEATURES if feature.name == "hysteresis")
    monkeypatch.delitem(row.refused, "export_mujoco")  # type: ignore[arg-type]
    assert not refusing("hysteresis", "export_mujoco")
    calls(tmp_path)["export_mujoco"](robot_with("hysteresis"))
    text = Path(tmp_path, "robot.xml").read_text(encoding="utf-8")
    plain = flexgen.export_mujoco(robot_with("none"), tmp_path / "plain.xml").path
    assert text == plain.read_text(encoding="utf-8"), "the file lost the hysteresis silently"


def test_an_unknown_name_is_an_error_of_the_program() -> None:
    robot = robot_with("none")
    for call in (check_ability, obstacle):
        with pytest.raises(KeyError):
            call(robot, "solv")


def test_needs_reads_a_robot_once_and_passes_it_on() -> None:
    @needs("symbolic")
    def call(model: object, factor: int = 1) -> object:
        return model

    assert isinstance(call("elbow"), flexgen.RobotModel)
    equations = flexgen.derive("elbow")
    assert call(equations) is equations and call(model=equations, factor=2) is equations
    with pytest.raises(flexgen.ArgumentError, match="symbolic: given elbow, whose gear of q1"):
        call(flexgen.derive(robot_with("hysteresis")))


# --- lines that ask for a feature ---------------------------------------------------------------
# Functions and properties that ask a robot, its friction or its motors for a feature.
PREDICATES = {
    "hysteretic_joints",
    "bristled_motors",
    "loaded_motors",
    "harmonic_sums",
    "has_harmonics",
    "has_memory",
    "has_springs",
    "refuse_harmonics",
    "refuse_hysteresis",
    "refuse_load",
    "refuse_lugre",
    "flexible_joint_obstacle",
    "inversion_obstacle",
    "branched",
    "motor_coupling",
}
# Classes of laws of which a robot is asked whether it has one.
CLASSES = {"GearFriction", "LuGre", "HysteresisLaw"}
# The table, the laws themselves, and the reader of their keys.
LAWS = {
    Path(str(module.__file__)).resolve()
    for module in (
        abilities,
        elements,
        friction,
        format_devices,
        format_robot,
        parts,
        tables_of_states,
        hysteresis,
        hysteretic_gears,
        hysteresis_law,
        lugre,
        force_laws,
        lagrangian,
        motor_harmonics,
    )
}
# Lines outside them: translators of a law, and fits of it.
MOST = 20


def questions(text: str) -> Iterator[int]:
    """Numbers of the lines that ask a robot for a feature."""
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Call(func=ast.Name(id="isinstance"), args=[_, kinds]):
                names = {x.id for x in ast.walk(kinds) if isinstance(x, ast.Name)}
                if names & CLASSES:
                    yield node.lineno
            case ast.Call(func=ast.Name(id=name)) if name in PREDICATES:
                yield node.lineno
            case ast.Attribute(attr=name, ctx=ast.Load()) if name in PREDICATES:
                yield node.lineno
            case ast.Attribute(
                attr="loaded", value=ast.Name(id="friction") | ast.Attribute(attr="friction")
            ):
                yield node.lineno


def all_questions() -> list[str]:
    found = []
    for file in sorted((ROOT / "flexgen").rglob("*.py")):
        if file not in LAWS:
            lines = sorted(set(questions(file.read_text(encoding="utf-8"))))
            found += [f"{file.relative_to(ROOT)}:{line}" for line in lines]
    return found


def test_few_lines_ask_a_robot_for_a_feature() -> None:
    found = all_questions()
    assert len(found) <= MOST, "ask flexgen.model.abilities for a function:\n" + "\n".join(found)


@pytest.mark.parametrize(
    "line",
    [
        "if hysteretic_joints(model): pass",
        "x = [f for f in motors if f.friction.loaded]",
        "reason = model.inversion_obstacle()",
        'if robot.motor_coupling == "complete": pass',
        "if isinstance(motor.friction, (Friction, GearFriction)): pass",
    ],
)
def test_a_planted_question_is_seen(line: str) -> None:
    assert list(questions(line)) == [1]
