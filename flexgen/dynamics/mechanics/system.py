"""The system of a model: its symbols, its Lagrangian, and how a CasADi function is built from
them.

    M_y(y) ddy + ... = forces(y, dy, tau_m),      y = (q_a, q_me),
    q_me: the motors behind elastic gears

Each function of the equations of motion has a builder: a function that takes a `System` and
returns the inputs, their names, the outputs and their names (`Built`). Builders:
`flexgen.dynamics.mechanics.dynamics`, `flexgen.dynamics.mechanics.linearization`,
`flexgen.dynamics.mechanics.inversion_functions`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import casadi as ca

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class, checked_result
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.lagrangian import Lagrangian, equations_of, lagrangian
from flexgen.dynamics.mechanics.parameters import Parameter, put_symbols
from flexgen.model.elements import RobotModel

Built = tuple[list[ca.SX], list[str], list[ca.SX], list[str]]


@checked_result
@dataclass(frozen=True)
class ImplicitDae:
    """A DAE with the names and units of its variables and rows.

    Attributes
    ----------
    function : casadi.Function
        ``F(xdot, x, z, u)``, and ``parameters`` as a last argument where the equations have them.
    x, z, u, rows : tuple of str
        Names of the states, algebraic variables, inputs and rows: ``q_a[q1]``.
    x_units, z_units, u_units, row_units : tuple of str
    """

    function: ca.Function
    x: tuple[str, ...]
    z: tuple[str, ...]
    u: tuple[str, ...]
    rows: tuple[str, ...]
    x_units: tuple[str, ...]
    z_units: tuple[str, ...]
    u_units: tuple[str, ...]
    row_units: tuple[str, ...]


@checked_class
@dataclass(frozen=True, init=False, eq=False, repr=False)
class System:
    """A model with symbols for its coordinates, torques and run-time parameters, and its
    Lagrangian.

    It is frozen: what follows from its parts is built once, on the first use.

    Parameters
    ----------
    model : RobotModel
    parameters : sequence of str
        Numbers of the model that stay symbols; names as in
        `flexgen.dynamics.mechanics.parameters`.

    Attributes
    ----------
    model : RobotModel
        With its numbers.
    with_symbols : RobotModel
        With the symbols of the parameters in their place.
    parameters : tuple of Parameter
    symbols : casadi.SX (n_p,)
        The symbols of the parameters, in that order.
    force : casadi.SX (6,) or None
        On the tool at its origin, world axes: force [N], then torque [N m]; symbols or numbers;
        None: nothing.
    memory : casadi.SX or None
        Symbols of torques with states that are among the forces; None: there are none.
    contact : casadi.Function or None
        What a wall adds to ``force`` in a simulation: (6,) from ``q_a`` and ``v_a``; None:
        nothing.
    """

    model: RobotModel
    with_symbols: RobotModel
    parameters: tuple[Parameter, ...]
    symbols: ca.SX
    force: ca.SX | None = None
    memory: ca.SX | None = None
    contact: ca.Function | None = None

    def __init__(self, model: RobotModel, parameters: Sequence[str] = ()) -> None:
        made = put_symbols(model, parameters)
        # a frozen object is filled through its dictionary, as its cached properties are
        vars(self).update(
            model=made.given,
            with_symbols=made.model,
            parameters=made.parameters,
            symbols=made.symbols,
        )

    def _with_parts(self, **parts: Any) -> Self:
        """Copy with other parts; what follows from the parts is built again, unless it is among
        them.
        """
        made = object.__new__(type(self))
        own = {field.name: getattr(self, field.name) for field in fields(System)}
        vars(made).update(own | parts)
        return made

    def build(
        self,
        name: str,
        inputs: list[ca.SX],
        names_in: list[str],
        outputs: list[ca.SX],
        names_out: list[str],
    ) -> ca.Function:
        """A function with dense results; the last arguments are ``f_tool``, ``memory``,
        ``parameters``, if needed.
        """
        outputs = [ca.densify(x) for x in outputs]
        if (
            self.force is not None
            and not self.force.is_constant()
            and ca.depends_on(ca.veccat(*outputs), self.force)
        ):
            inputs = [*inputs, self.force]
            names_in = [*names_in, "f_tool"]
        if self.memory is not None and ca.depends_on(ca.veccat(*outputs), self.memory):
            inputs = [*inputs, self.memory]
            names_in = [*names_in, "memory"]
        if self.parameters and ca.depends_on(ca.veccat(*outputs), self.symbols):
            inputs = [*inputs, self.symbols]
            names_in = [*names_in, "parameters"]
        return ca.Function(name, inputs, outputs, names_in, names_out)

    @cached_property
    def lagrangian(self) -> Lagrangian:
        """The energies and forces that all functions follow from."""
        return lagrangian(self.with_symbols, self.force)

    @cached_property
    def y(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Minimal coordinates ``y = (q_a, q_me)``, their velocities and accelerations, (n,)
        each.
        """
        # (an empty index into a single motor has the wrong shape)
        lag = self.lagrangian
        i_m = self.model.i_m
        return (
            ca.vertcat(lag.chain.q_a, *[lag.q_m[j] for j in i_m]),
            ca.vertcat(lag.chain.v_a, *[lag.v_m[j] for j in i_m]),
            ca.vertcat(lag.a_a, *[lag.a_m[j] for j in i_m]),
        )

    @cached_property
    def left(self) -> ca.SX:
        """Left side of Lagrange's equations of the whole robot (n,), without springs and forces,
        at ``ddy``.
        """
        lag = self.lagrangian
        return equations_of(lag.kinetic, lag.gravity, *self.y)

    @cached_property
    def residual(self) -> ca.SX:
        """Residual of the equations of motion in y (n,): zero where the torques cause the
        accelerations.
        """
        return self.left - self.lagrangian.forces

    @cached_property
    def mass(self) -> ca.SX:
        """Mass matrix of the whole robot in y (n, n)."""
        return ca.hessian(self.lagrangian.kinetic, self.y[1])[0]

    @cached_property
    def acceleration(self) -> ca.SX:
        """Accelerations of y (n,) from the equations of motion."""
        return self.acceleration_under(ca.SX.zeros(self.model.dof))

    def acceleration_under(self, more: ca.SX) -> ca.SX:
        """Accelerations of y (n,) with additional forces (n,) on y."""
        more = _column("more", more, self.model.dof)
        bias = ca.substitute(self.left, self.y[2], ca.SX.zeros(self.y[2].shape))
        return solve_symmetric(self.mass, self.lagrangian.forces + more - bias)

    @cached_property
    def arm_left(self) -> ca.SX:
        """The arm's side of the equations (n_a,): ``M a_a + c + g``."""
        lag = self.lagrangian
        return equations_of(lag.kinetic_arm, lag.gravity, lag.chain.q_a, lag.chain.v_a, lag.a_a)

    def motor_accelerations(self, a_a: ca.SX, a_me: ca.SX) -> ca.SX:
        """Accelerations of all motors (n_m,) from those of the arm and of the motors behind
        elastic gears.
        """
        model = self.model
        a_a = _column("a_a", a_a, model.n_a)
        a_me = _column("a_me", a_me, len(model.i_m))
        geared = ca.mtimes(ca.SX(ca.DM(model.eta)), a_a[list(model.i_g)])
        at = {j: k for k, j in enumerate(model.i_m)}
        return ca.vertcat(*[a_me[at[j]] if j in at else geared[j] for j in range(model.n_m)])


def _column(name: str, value: Any, rows: int) -> ca.SX:
    """A column of ``rows`` expressions; ArgumentError for something else, with the ``name`` of the
    argument.
    """
    try:
        column = ca.SX(value)
    except (TypeError, NotImplementedError, RuntimeError):
        column = ca.SX(0, 0)
    if column.shape != (rows, 1) and (rows or column.numel()):
        raise ArgumentError(
            f"{name}: given {show_value(value)}, expected a column of {rows} expressions"
        )
    return column


Builder = Callable[[System], Built]


def solve_symmetric(A: ca.SX, B: ca.SX) -> ca.SX:  # noqa: C901
    """``X`` (n, m) with ``A X = B``, ``A`` (n, n) symmetric positive definite: L D L' without
    pivots, structural zeros skipped.

    Only the lower triangle of A is read; entries that are structurally zero make no operation in
    the graph.
    """
    n = A.shape[0]
    m = B.shape[1]
    zero = ca.SX(0)
    L: list[list[ca.SX | None]] = [[None] * n for _ in range(n)]
    D: list[ca.SX] = []
    work: list[list[ca.SX | None]] = [[None] * n for _ in range(n)]  # L_ij d_j
    for j in range(n):
        d = A[j, j]
        for k in range(j):
            left = L[j][k]
            right = work[j][k]
            if left is not None and right is not None:
                d = d - left * right
        D.append(1 / d)
        for i in range(j + 1, n):
            x = A[i, j]
            for k in range(j):
                left = L[i][k]
                right = work[j][k]
                if left is not None and right is not None:
                    x = x - left * right
            if not x.is_zero():
                work[i][j] = x
                L[i][j] = x * D[j]
    columns = []
    for c in range(m):
        x = [B[i, c] if B[i, c].nnz() else zero for i in range(n)]
        for i in range(n):
            for k in range(i):
                factor = L[i][k]
                if factor is not None:
                    x[i] = x[i] - factor * x[k]
        x = [x[i] * D[i] for i in range(n)]
        for i in reversed(range(n)):
            for k in range(i + 1, n):
                factor = L[k][i]
                if factor is not None:
                    x[i] = x[i] - factor * x[k]
        columns.append(ca.vertcat(*x))
    return ca.horzcat(*columns)
