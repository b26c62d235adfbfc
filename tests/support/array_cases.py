"""Libraries with derivatives, points, and differences of high order, for the tests of JAX and
PyTorch.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.spec import DIFFERENTIATED
from flexgen.runtime import Library, load

# Central differences of order 8: coefficients of f(x + k h) - f(x - k h), k = 1 to 4.
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
STEP = 0.01
EXACT = 1e-9  # of the largest entry of a Jacobian


@cache
def library(
    model: str, functions, parameters: Sequence[str], precision: str, parts=("derivatives",)
) -> Library:
    folder = Path(tempfile.mkdtemp(prefix="flexgen-arrays-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    made = generate(
        model, folder, functions=functions, parameters=parameters, precision=precision, parts=parts
    )
    return load(made.directory)


def drawn(robot: Library, name: str, count: int | None) -> list[np.ndarray]:
    """Random inputs of a function, parameters near those of the model and the same for all
    points.
    """
    rng = np.random.default_rng(3)
    function = robot.functions[name]
    lead = () if count is None else (count,)
    real = function(*(np.zeros(p.shape) for p in function.inputs if p.name != "parameters"))
    real = (real[0] if isinstance(real, tuple) else real).dtype
    arrays = [
        robot.parameters * rng.uniform(0.9, 1.1, p.shape) + 0.1 * (robot.parameters == 0)
        if p.name == "parameters"
        else rng.uniform(-1.0, 1.0, (*lead, *p.shape)) * (50.0 if p.name == "v_m" else 1.0)
        for p in function.inputs
    ]
    return [x.astype(real) for x in arrays]


def differences(function: Callable[..., np.ndarray], x: list[np.ndarray], i: int) -> np.ndarray:
    """The Jacobian of all results in input i."""
    columns = []
    for k in range(x[i].size):
        step = np.zeros_like(x[i])
        step.flat[k] = STEP * max(1.0, abs(x[i].flat[k]))
        total = 0.0
        for m, weight in enumerate(WEIGHTS, 1):
            ends = [function(*x[:i], x[i] + s * m * step, *x[i + 1 :]) for s in (1, -1)]
            total = total + weight * (ends[0] - ends[1])
        columns.append(total / step.flat[k])
    return np.stack(columns, axis=-1)


def checked_gradients(case, jacobians: Callable, names: Sequence[str] | None = None) -> None:
    """Jacobians of all functions, ``jacobians(case, name, inputs)``, against differences of the
    library.
    """
    robot = library(*case)
    for name in names or [name for name in robot.functions if name in DIFFERENTIATED]:
        function = robot.functions[name]

        def flat(*x: np.ndarray, function=function) -> np.ndarray:
            result = function(*x)
            return np.concatenate(
                [y.ravel() for y in (result if isinstance(result, tuple) else (result,))]
            )

        x = drawn(robot, name, None)
        found = jacobians(case, name, x)
        scale = np.abs(flat(*x)).max()
        for i, J in enumerate(found):
            expected = differences(flat, x, i)
            size = max(np.abs(expected).max(), scale)
            assert np.abs(J.reshape(expected.shape) - expected).max() <= EXACT * size, (
                name,
                function.inputs[i].name,
            )
