"""Golden numbers of a self-test: states of a model and what the definition, Lagrange's equations,
gives for them.

The emitted library comes from the recursion (`flexgen.codegen.recursion`), so that both share no
derivation; CasADi's virtual machine evaluates the definition, so that they share no compiler
either.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.model.abilities import obstacle

POINTS = 2


@dataclass(frozen=True)
class Rest:
    """The robot at rest in the home pose: output ``y`` (n_t), arm ``q_a`` (n_a), motors ``q_m``,
    ``tau_m`` (n_m).
    """

    y: np.ndarray
    q_a: np.ndarray
    q_m: np.ndarray
    tau_m: np.ndarray


def states(
    equations: Equations, precision: str, functions: Sequence[Mapping[str, Any]] = ()
) -> dict[str, np.ndarray]:
    """Inputs of all ``functions`` at `POINTS` states, (POINTS, size) each, exact in the precision
    of the library.

    Gears are deflected by some mrad, coordinates without motor by up to 0.1, motors move with
    their joints. The numbers come from integers alone, so that they are the same on every
    computer.
    """
    model = equations.model
    random = _Random(20240229)
    i_g = list(model.i_g)
    i_e = list(model.i_e)

    def rows(size: int, most: float) -> np.ndarray:
        return np.array(
            [[random.number(most) for _ in range(size)] for _ in range(POINTS)]
        ).reshape(POINTS, size)

    x = {"q_a": rows(model.n_a, 0.7), "v_a": rows(model.n_a, 1.0), "a_a": rows(model.n_a, 5.0)}
    x["q_a"][:, i_e] *= 0.125
    x["q_a"][:, i_g] += np.round(model.home, 3)
    x["q_m"] = np.round((x["q_a"][:, i_g] + rows(len(i_g), 2e-3)) @ model.eta.T, 6)
    x["v_m"] = np.round((x["v_a"][:, i_g] + rows(len(i_g), 2e-2)) @ model.eta.T, 6)
    x["tau_m"] = rows(model.n_m, 10.0)
    x["tau_a"] = rows(model.n_a, 100.0)
    x["f_tool"] = rows(6, 100.0)
    x["deflection"] = rows(model.n_g, 2e-3)
    if obstacle(model, "reduced problem") is None:
        near = x["q_a"] + rows(model.n_a, 1e-2)
        x["target"] = np.array([np.round(output_at(equations, q), 6) for q in near])
    for port in (port for function in functions for port in function["inputs"]):
        if port["name"] not in x:
            x[port["name"]] = rows(int(np.prod(port["shape"])), 1.0)
    real = np.float64 if precision == "double" else np.float32
    return {name: value.astype(real).astype(float) for name, value in x.items()}


def output_at(equations: Equations, q_a: np.ndarray) -> np.ndarray:
    """The output of a pose of the arm as a target (n_t): for a tool pose its position, then its
    matrix by columns.
    """
    if equations.model.output.type != "tool_pose":
        return np.asarray(evaluate(equations.function("output"), q_a)[0][0], dtype=float)
    y = np.asarray(evaluate(equations.function("output"), q_a)[0][0])
    R = np.asarray(evaluate(equations.function("forward_kinematics"), q_a)[1][0])
    return np.concatenate([y, R.T.ravel()])


def compute_expected(
    equations: Equations, functions: Sequence[Mapping[str, Any]], given: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Expected outputs by the definition: per ``function.port`` an array (POINTS, size), matrices
    by columns.
    """
    out = {}
    for function in functions:
        graph = definition(equations, function["name"])
        values = dict(
            zip(
                graph.name_out(),
                evaluate(graph, *(given[name] for name in graph.name_in())),
                strict=True,
            )
        )
        for port in function["outputs"]:
            value = np.asarray(values[port["name"]])
            value = value.transpose(0, 2, 1) if value.ndim == 3 else value
            out[f"{function['name']}.{port['name']}"] = value.reshape(POINTS, -1)
    return out


def definition(equations: Equations, name: str) -> ca.Function:
    """The function of that name from Lagrange's equations; derivatives of it where the library has
    them as its own.
    """
    if name != "arm_forward_derivatives":
        return equations.function(name)
    forward = equations.function("arm_forward_dynamics")
    inputs = [ca.SX.sym(key, forward.size_in(key)) for key in forward.name_in()]
    acceleration = forward(*inputs)
    outputs = [ca.densify(ca.jacobian(acceleration, x)) for x in inputs]
    return ca.Function(name, inputs, outputs, forward.name_in(), ["da_dq", "da_dv", "da_dtau"])


def at_rest(equations: Equations) -> Rest:
    """The equilibrium at the home pose, from the static rows of the definition; SolverError where
    there is none.
    """
    rest = hold_joints(equations, np.asarray(equations.model.home, dtype=float))
    return Rest(output_at(equations, rest.q_a), rest.q_a, rest.q_m, rest.tau_m)


class _Random:
    """Numbers of a linear congruential generator (Knuth, MMIX), in steps of a millionth of the
    largest.
    """

    def __init__(self, seed: int) -> None:
        self._state = seed

    def number(self, most: float) -> float:
        """A number in (-most, most)."""
        self._state = (6364136223846793005 * self._state + 1442695040888963407) % 2**64
        return most * ((self._state >> 33) % 2_000_001 - 1_000_000) / 1_000_000
