"""Which mathematics a function of the library is written from: the recursion where there is one,
else Lagrange's graph.

Linear systems whose elimination would be long, and functions of long arms, are written as loops.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca

from flexgen.base.errors import BuildError
from flexgen.base.spec.ports import Port
from flexgen.codegen.recursion import columns
from flexgen.codegen.recursion.column_functions import (
    around_the_arm,
    long_chain,
    shorter_mass_matrix,
)
from flexgen.codegen.recursion.functions import fast_function
from flexgen.codegen.statements.routine import (
    Block,
    Expressions,
    Factor,
    Routine,
    Solve,
    Zeros,
    profile,
)
from flexgen.dynamics.mechanics.inversion_functions import lacks_inertia

if TYPE_CHECKING:
    from flexgen.dynamics.mechanics.parameters import Parameter

PARAMETERS = "parameters"  # the port with the numbers that may change at run time


def mathematics_of(equations: Any, name: str) -> ca.Function:
    """The cheapest SX function of that name."""
    return fast_function(equations, name) or equations.function(name)


def needs_parameters(program: Routine) -> bool:
    """True where a step depends on the run-time parameters."""
    return any(
        PARAMETERS in step.function.name_in()
        for step in program.steps
        if isinstance(step, Expressions)
    )


def is_massless(equations: Any, parameters: Sequence[Parameter]) -> bool:
    """`lacks_inertia` of a model that can be inverted, with the run-time parameters of the model
    file.
    """
    jacobians, constraint = (
        mathematics_of(equations, name) for name in ("inversion_jacobians", "output_constraint")
    )
    return lacks_inertia(
        equations.model, jacobians, constraint, {PARAMETERS: [p.value for p in parameters]}
    )


def program_of(
    name: str, equations: Any, inputs: tuple[Port, ...], outputs: tuple[Port, ...]
) -> Routine:
    """The program of a function of the library; BuildError where it does not have the ports
    described.
    """
    if name == "linearize":
        return _linearize(equations)
    if name == "arm_forward_derivatives":
        return _arm_forward_derivatives(equations)
    if name == "inverse_dynamics_derivatives":
        chain = long_chain(equations)
        if chain is not None:
            return Routine(
                tuple(columns.derivatives(chain, ("dtau_dq", 0), ("dtau_dv", 0), "dtau_da"))
            )
    if name == "mass_matrix":
        steps = shorter_mass_matrix(equations, "M")
        if steps is not None:
            return Routine(tuple(steps))
    function = (
        _pack_mass_matrix(equations)
        if name == "mass_matrix_packed"
        else mathematics_of(equations, name)
    )
    if PARAMETERS in function.name_in():
        inputs = (*inputs, parameters_port(equations))
    return Routine(
        (
            Expressions(
                check_ports(name, function, inputs, outputs), pivots="forward_dynamics" in name
            ),
        )
    )


def _linearize(equations: Any) -> Routine:
    """Derivatives of the accelerations of the whole robot: ``M_y X = -R_y``."""
    model = equations.model
    n = model.dof
    n_m = model.n_m
    n_a = model.n_a
    blocks: tuple[Block, ...] = (Block("A", n, 0, 2 * n), Block("B", n, 2 * n, n_m))
    ones = tuple(("A", i, n + i) for i in range(n))
    chain = (
        long_chain(equations) if fast_function(equations, "forward_dynamics") is not None else None
    )
    if chain is None:
        jacobians = expand("residual_jacobians", mathematics_of(equations, "residual_jacobians"))
        solve = Solve("M_y", "R_y", n, 2 * n + n_m, False, profile(jacobians, "M_y"), blocks, ones)
        forward = expand("forward_dynamics", mathematics_of(equations, "forward_dynamics"))
        return Routine((Expressions(forward, pivots=True), Expressions(jacobians), solve))
    # (lanes beyond the last joint of the accelerations are those of motors; axes are zero there)
    around = around_the_arm(equations)
    first = tuple(0 if i < n_a else i for i in range(n))
    return Routine(
        (
            Zeros("M_y", n, n),
            Zeros("R_y", n, 2 * n + n_m),
            *columns.bias(chain, "M_y"),
            around.left,
            around.rotors,
            Factor("M_y", "row_left", "row_a_a", n, first),
            *columns.derivatives_after(chain, ("R_y", 0), ("R_y", n)),
            around.changes,
            Solve("M_y", "R_y", n, 2 * n + n_m, False, first, blocks, ones, factored=True),
        )
    )


def _arm_forward_derivatives(equations: Any) -> Routine:
    """Derivatives of the accelerations of the arm: ``M X = -R_a``."""
    n = equations.model.n_a
    blocks = (Block("da_dq", 0, 0, n), Block("da_dv", 0, n, n), Block("da_dtau", 0, 2 * n, n))
    chain = (
        long_chain(equations)
        if fast_function(equations, "arm_forward_dynamics") is not None
        else None
    )
    if chain is None:
        jacobians = expand(
            "arm_residual_jacobians", mathematics_of(equations, "arm_residual_jacobians")
        )
        solve = Solve("M", "R_a", n, 2 * n, True, profile(jacobians, "M"), blocks)
        forward = expand("arm_forward_dynamics", mathematics_of(equations, "arm_forward_dynamics"))
        return Routine((Expressions(forward, pivots=True), Expressions(jacobians), solve))
    tau = ca.SX.sym("tau_a", n)
    felt = ca.SX.sym("bias", 1, n)
    left = ca.Function("left", [tau, felt], [tau.T - felt], ["tau_a", "bias"], ["row_left"])
    return Routine(
        (
            *columns.bias(chain, "M"),
            Expressions(left),
            Factor("M", "row_left", "row_a_a", n, (0,) * n),
            *columns.derivatives_after(chain, ("R_a", 0), ("R_a", n)),
            Solve("M", "R_a", n, 2 * n, True, (0,) * n, blocks, factored=True),
        )
    )


def _pack_mass_matrix(equations: Any) -> ca.Function:
    """The lower triangle of the mass matrix by columns."""
    full = expand("mass_matrix", mathematics_of(equations, "mass_matrix"))
    given = [full.sx_in(i) for i in range(full.n_in())]
    M = full(*given)
    packed = ca.vertcat(*(M[j:, j] for j in range(M.size2())))
    return ca.Function("mass_matrix_packed", given, [packed], full.name_in(), ["M_packed"])


def parameters_port(equations: Any) -> Port:
    """The port of the run-time parameters."""
    return Port(
        PARAMETERS, (len(equations.parameters),), "mixed", "run-time parameters, listed at the top"
    )


def check_ports(
    name: str, function: ca.Function, inputs: tuple[Port, ...], outputs: tuple[Port, ...]
) -> ca.Function:
    """The function as an SX function whose arguments are the ports; BuildError where it is not
    one.
    """
    if function.has_free():
        raise BuildError(
            f"function {name}: given free variables {function.get_free()}, expected none"
        )
    for kind, ports, names, sparsity in (
        ("inputs", inputs, function.name_in(), function.sparsity_in),
        ("outputs", outputs, function.name_out(), function.sparsity_out),
    ):
        expected = [port.name for port in ports]
        if list(names) != expected:
            raise BuildError(
                f"function {name}: given {kind} {', '.join(names)}, expected {', '.join(expected)}"
            )
        for i, port in enumerate(ports):
            shape = port.shape if len(port.shape) == 2 else (port.shape[0], 1)
            given = sparsity(i)
            if given.shape != shape or not given.is_dense():
                kind_of = "dense" if given.is_dense() else "sparse"
                raise BuildError(
                    f"function {name}, {port.name}: given a {kind_of} {given.shape} array, "
                    f"expected dense {shape}"
                )
    return expand(name, function)


def expand(name: str, function: ca.Function) -> ca.Function:
    """The function as scalar operations; BuildError where that cannot be."""
    if function.is_a("SXFunction"):
        return function
    try:
        return function.expand()
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise BuildError(
            f"function {name}: given one that cannot be written as scalar operations, expected "
            f"an SX function: {reason}"
        ) from error
