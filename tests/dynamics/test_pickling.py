"""Public objects are pickled and come back with the same contents: equations, analyses, models,
paths and solutions.
"""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.analysis.analyze import analyze
from flexgen.base.errors import ArgumentError, ChannelError, ModelError
from flexgen.dynamics.mechanics.equations import BUILDERS, Equations, derive
from flexgen.dynamics.mechanics.signatures import FUNCTIONS, offered_functions
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.runtime.inversion.limited_inversion import LimitsInfeasibleError


def copied(x: Any) -> Any:
    return pickle.loads(pickle.dumps(x))


def same(a: Any, b: Any) -> bool:
    """Equal contents, to the bit, of nested dataclasses, mappings, sequences and arrays."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b) or (a != a and b != b)


def results(equations: Equations, name: str) -> list[np.ndarray]:
    """Results of a function at a fixed random state, parameters at 1.1 times the values of the
    file.
    """
    function = equations.function(name)
    rng = np.random.default_rng(0)
    numbers = 1.1 * np.array([parameter.value for parameter in equations.parameters])
    given = {port: rng.normal(size=function.numel_in(port)) for port in function.name_in()} | {
        "parameters": numbers
    }
    return [np.array(x) for x in function.call([given[port] for port in function.name_in()])]


def test_errors_keep_text_and_fields():
    errors: list[Any] = [ModelError("arm.toml", 3, "motor.m1.ratio", "'x'", "a number")]
    errors += [
        ArgumentError("move: given 1"),
        LimitsInfeasibleError("not kept", 0.3),
        ChannelError("no channel"),
    ]
    for error in errors:
        other = copied(error)
        assert (
            type(other) is type(error) and str(other) == str(error) and vars(other) == vars(error)
        )
    assert copied(errors[0]).line == 3 and copied(errors[2]).excess == 0.3


@pytest.mark.parametrize(
    ("model", "parameters"),
    [("elbow", ()), ("planar5_nmp", ("payload", "stiffness")), ("beam_arm", ())],
)
def test_equations(model: str, parameters: tuple[str, ...]) -> None:
    equations = derive(model, parameters)
    equations.function("bias")  # one that was built before
    back = copied(equations)
    assert back.model == equations.model and back.parameters == equations.parameters
    offered = {*offered_functions(equations.model), *(set(BUILDERS) - set(FUNCTIONS))}
    for name in BUILDERS.keys() & offered:
        assert same(results(equations, name), results(back, name)), name


def test_planted_loss_of_the_parameters_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    equations = derive("planar5_nmp", ("stiffness",))
    monkeypatch.setattr(Equations, "__reduce__", lambda self: (Equations, (self.model, ())))
    assert not same(results(equations, "gear_law"), results(copied(equations), "gear_law"))


@pytest.mark.parametrize("model", ["elbow", "planar5_nmp"])
def test_analysis_along_a_path(model: str) -> None:
    equations = derive(model)
    path = Path(equations, equations.model.move())
    found = analyze(equations, path=path, poses=5)
    back = copied(found)
    assert found.zero_path is not None and found.solvability_path is not None
    assert same(found, back) and found.to_dict() == back.to_dict()
    assert same(
        path.sample(np.linspace(0.0, path.duration, 7)),
        copied(path).sample(np.linspace(0.0, path.duration, 7)),
    )


def test_model_and_equilibrium() -> None:
    model = read("manutec_r3")
    assert copied(model) == model
    rest = hold_joints(derive(model), np.array(model.home))
    assert same(rest, copied(rest))


def test_solution() -> None:
    solution = flexgen.solve("elbow", method="closed-form")
    assert same(solution, copied(solution))


@pytest.mark.parametrize(
    "model", ["planar5_nmp", pytest.param("manutec_r3", marks=pytest.mark.slow)]
)
def test_verified_solution_and_its_simulation(model: str) -> None:
    solution = flexgen.solve(model, mesh=0.01)
    assert solution.simulation is not None
    for x in (solution, solution.simulation, solution.trajectory, solution.figures()):
        assert same(x, copied(x))
    assert copied(solution).to_dict() == solution.to_dict()


@pytest.mark.parametrize(
    "noun",
    [
        flexgen.MoveJ((0.1, 0.2), speed=1.0),
        flexgen.MoveL(displacement=(0.1, 0.0, 0.0), zone=0.01),
        flexgen.MoveC(displacement=(0.2, 0.0, 0.0), via=(0.1, 0.1, 0.0)),
        flexgen.Move("turn", "joint", (0.0, 0.0), 1.0, 5, end=(1.0, 0.5)),
        flexgen.Limits(torque=(1.0, 2.0), deflection=(1e-3,)),
        flexgen.Grid(
            ["elbow"], flexgen.random_moves(3), ["closed-form"], options={"verify": False}
        ),
        *flexgen.Status,
    ],
    ids=lambda noun: type(noun).__name__,
)
def test_public_result_classes_survive_pickling(noun: Any) -> None:
    assert same(noun, copied(noun)) and copied(noun) == noun


def test_program() -> None:
    steps = (flexgen.MoveJ((0.5, -1.0)), flexgen.MoveL(displacement=(0.1, 0.0, 0.0)))
    program = flexgen.Program(
        "both", start=(0.3, -1.1), profile=(0.5, 5.0), joint_profile=(1.0, 10.0), steps=steps
    )
    assert same(program, copied(program)) and copied(program) == program


@pytest.mark.slow
def test_tables_of_a_sweep() -> None:
    grid = flexgen.Grid(
        ["elbow"], flexgen.random_moves(3), ["closed-form"], options={"verify": False}
    )
    found = flexgen.sweep(grid, workers=0)
    back = copied(found)
    assert (
        same(found, back)
        and back.results.digest == found.results.digest
        and copied(grid).digest == grid.digest
    )


def test_planted_differences_are_seen() -> None:
    rest = hold_joints(derive("elbow"), np.array(read("elbow").home))
    other = dataclasses.replace(rest, tau_m=np.nextafter(rest.tau_m, np.inf))
    assert (
        not same(rest, other)
        and not same([rest], [rest, rest])
        and not same({"a": 1.0}, {"b": 1.0})
    )
