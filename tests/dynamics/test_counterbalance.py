"""A counterbalance: its torque, its energy, its way through files, and who refuses it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.analysis.printing.equations import symbolic
from flexgen.base.errors import ArgumentError, FlexgenError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.recursion.functions import fast_function
from flexgen.dynamics.mechanics.parameters import select
from flexgen.exports.mujoco.mujoco import export_mujoco
from flexgen.model.catalogue.json_schema import schema
from flexgen.model.elements import RobotModel

SINES = (300.0, -120.0, 25.0)
COSINES = (-80.0, 60.0, 0.0)
KEY = "element.upper.dof.q1.counterbalance"


def balanced(name: str = "elbow") -> RobotModel:
    return flexgen.read(name, overrides={KEY: {"sin": list(SINES), "cos": list(COSINES)}})


def torque(q: np.ndarray) -> np.ndarray:
    """The formula of the model file."""
    pairs = enumerate(zip(SINES, COSINES, strict=True), 1)
    return np.asarray(sum(s * np.sin(k * q) + c * np.cos(k * q) for k, (s, c) in pairs))


def test_it_acts_on_its_joint_by_the_angle() -> None:
    """The force on the arm, and what the robot without it needs to move in the same way, by both
    derivations.
    """
    plain = flexgen.read("elbow")
    model = balanced()
    q, v = np.random.default_rng(0).uniform(-1.5, 1.5, (2, 20, model.n_a))
    forces = [evaluate(flexgen.derive(m).function("arm_forces"), q, v)[0] for m in (plain, model)]
    expected = np.stack([torque(q[:, 0]), 0 * q[:, 1]], axis=1)
    assert np.allclose(forces[1] - forces[0], expected, rtol=1e-13, atol=1e-10)
    equations = flexgen.derive(model)
    slow = equations.function("forward_dynamics")
    fast = fast_function(equations, "forward_dynamics")
    arguments = [
        np.random.default_rng(1).uniform(-1, 1, (20, slow.size1_in(k))) for k in range(slow.n_in())
    ]
    for a, b in zip(evaluate(slow, *arguments), evaluate(fast, *arguments), strict=True):
        assert np.allclose(a, b, rtol=1e-9, atol=1e-9)


def test_its_torque_is_the_slope_of_its_energy() -> None:
    """By central differences of the potential energy of the same state with and without it."""
    q0 = np.linspace(-2, 2, 9)
    energy = []
    for model in (flexgen.read("elbow"), balanced()):
        function = flexgen.derive(model).function("energy")
        sizes = [function.size1_in(k) for k in range(function.n_in())]
        at = []
        for step in (-1e-5, 1e-5):
            q = np.zeros((len(q0), sizes[0]))
            q[:, 0] = q0 + step
            at.append(
                evaluate(function, q, *(np.zeros((len(q0), n)) for n in sizes[1:]))[1].ravel()
            )
        energy.append((at[1] - at[0]) / 2e-5)
    assert np.allclose(energy[0] - energy[1], torque(q0), atol=1e-3)


@needs_compiler
def test_inverse_dynamics_with_it_moves_the_tool_as_asked() -> None:
    solution = flexgen.solve(balanced(), progress=False)
    assert solution.status == "solved"


def test_it_is_written_and_read_again(tmp_path: Path) -> None:
    model = balanced()
    names = [p.name for p in select(model, ["q1.counterbalance_sin_1", "q1.counterbalance_cos_2"])]
    assert names == ["q1.counterbalance_sin_1", "q1.counterbalance_cos_2"]
    text = (
        Path(flexgen.read("elbow").file)
        .read_text()
        .replace(
            'name = "q1"',
            'name = "q1"\ncounterbalance = { sin = [300.0, -120.0, 25.0], cos = [-80.0, 60.0] }',
            1,
        )
    )
    (tmp_path / "arm.toml").write_text(text)
    assert flexgen.read(tmp_path / "arm.toml").elements == model.elements
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(tomllib.loads(text), schema())
    for wrong in ("{}", "{ sin = [] }", "{ sin = [1, 2, 3, 4, 5, 6, 7] }", "{ tan = [1.0] }"):
        (tmp_path / "arm.toml").write_text(
            text.replace("{ sin = [300.0, -120.0, 25.0], cos = [-80.0, 60.0] }", wrong)
        )
        with pytest.raises(ModelError, match="counterbalance"):
            flexgen.read(tmp_path / "arm.toml")


def test_joints_that_cannot_have_a_counterbalance_refuse_it(tmp_path: Path) -> None:
    with pytest.raises(FlexgenError, match="counterbalance"):
        export_mujoco(balanced(), tmp_path / "arm.xml")
    with pytest.raises(ArgumentError, match=r"given a counterbalance \(q1\)"):
        symbolic(balanced("elbow@rigid"))
