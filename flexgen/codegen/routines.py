"""Which mathematics a function of the library is written from: the recursion where there is one, else Lagrange's graph.

Linear systems whose elimination would be long are written as loops.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from flexgen.errors import BuildError
from flexgen.expressions.routine import Block, Expressions, Products, Routine, Solve, profile
from flexgen.ports import Port
from flexgen.recursion.functions import cost_of, fast_function

LONG_CHAIN = 12  # coordinates from which a mass matrix may be shorter by products of vectors
SHORTER = 0.9  # the share of operations from which it is
PARAMETERS = "parameters"  # the port with the numbers that may change at run time


def mathematics_of(equations: Any, name: str) -> ca.Function:
    """The cheapest SX function of that name."""
    return fast_function(equations, name) or equations.function(name)


def needs_parameters(program: Routine) -> bool:
    """True where a step depends on the run-time parameters."""
    return any(PARAMETERS in step.function.name_in() for step in program.steps if isinstance(step, Expressions))


def program_of(name: str, equations: Any, inputs: tuple[Port, ...], outputs: tuple[Port, ...]) -> Routine:
    """The program of a function of the library; BuildError where it does not have the ports described."""
    model = equations.model
    if name == "linearize":
        n, n_m = model.dof, model.n_m
        jacobians = expanded("residual_jacobians", mathematics_of(equations, "residual_jacobians"))
        blocks: tuple[Block, ...] = (Block("A", n, 0, 2 * n), Block("B", n, 2 * n, n_m))
        ones = tuple(("A", i, n + i) for i in range(n))
        solve = Solve("M_y", "R_y", n, 2 * n + n_m, False, profile(jacobians, "M_y"), blocks, ones)
        forward = expanded("forward_dynamics", mathematics_of(equations, "forward_dynamics"))
        return Routine((Expressions(forward, pivots=True), Expressions(jacobians), solve))
    if name == "arm_forward_derivatives":
        n = model.n_a
        jacobians = expanded("arm_residual_jacobians", mathematics_of(equations, "arm_residual_jacobians"))
        blocks = (Block("da_dq", 0, 0, n), Block("da_dv", 0, n, n), Block("da_dtau", 0, 2 * n, n))
        solve = Solve("M", "R_a", n, 2 * n, True, profile(jacobians, "M"), blocks)
        forward = expanded("arm_forward_dynamics", mathematics_of(equations, "arm_forward_dynamics"))
        return Routine((Expressions(forward, pivots=True), Expressions(jacobians), solve))
    if name == "mass_matrix" and model.n_a >= LONG_CHAIN:
        vectors, n = fast_function(equations, "mass_vectors"), model.n_a
        if vectors is not None:
            products = Products("S", "F", 6, n, "M")
            direct = cost_of(mathematics_of(equations, name)).operations
            if cost_of(vectors).operations + products.operations < SHORTER * direct:
                return Routine((Expressions(expanded("mass_vectors", vectors)), products))
    function = _packed(equations) if name == "mass_matrix_packed" else mathematics_of(equations, name)
    if PARAMETERS in function.name_in():
        inputs = (*inputs, parameters_port(equations))
    return Routine((Expressions(checked(name, function, inputs, outputs), pivots="forward_dynamics" in name),))


def _packed(equations: Any) -> ca.Function:
    """The lower triangle of the mass matrix by columns."""
    full = expanded("mass_matrix", mathematics_of(equations, "mass_matrix"))
    given = [full.sx_in(i) for i in range(full.n_in())]
    M = full(*given)
    packed = ca.vertcat(*(M[j:, j] for j in range(M.size2())))
    return ca.Function("mass_matrix_packed", given, [packed], full.name_in(), ["M_packed"])


def parameters_port(equations: Any) -> Port:
    """The port of the run-time parameters."""
    return Port(PARAMETERS, (len(equations.parameters),), "mixed", "run-time parameters, listed at the top")


def checked(name: str, function: ca.Function, inputs: tuple[Port, ...], outputs: tuple[Port, ...]) -> ca.Function:
    """The function as an SX function whose arguments are the ports; BuildError where it is not one."""
    if function.has_free():
        raise BuildError(f"function {name}: given free variables {function.get_free()}, expected none")
    for kind, ports, names, sparsity in (
        ("inputs", inputs, function.name_in(), function.sparsity_in),
        ("outputs", outputs, function.name_out(), function.sparsity_out),
    ):
        expected = [port.name for port in ports]
        if list(names) != expected:
            raise BuildError(f"function {name}: given {kind} {', '.join(names)}, expected {', '.join(expected)}")
        for i, port in enumerate(ports):
            shape = port.shape if len(port.shape) == 2 else (port.shape[0], 1)
            given = sparsity(i)
            if given.shape != shape or not given.is_dense():
                kind_of = "dense" if given.is_dense() else "sparse"
                raise BuildError(
                    f"function {name}, {port.name}: given a {kind_of} {given.shape} array, expected dense {shape}"
                )
    return expanded(name, function)


def expanded(name: str, function: ca.Function) -> ca.Function:
    """The function as scalar operations; BuildError where that cannot be."""
    if function.is_a("SXFunction"):
        return function
    try:
        return function.expand()
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise BuildError(
            f"function {name}: given one that cannot be written as scalar operations, expected an SX function: {reason}"
        ) from error
