"""A phase of a planned motion: signals of an instant, costs, constraints and bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.transcription import Transcription
from flexgen.base.spec.arguments import check_not_negative, is_number
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.planning.optimal.arguments import numbers_of
from flexgen.planning.optimal.force import PlanForce
from flexgen.planning.optimal.signals import Signals, split_comparison

WHERE = ("path", "start", "end")
DURATIONS = (1e-3, 1e3)  # s: bounds of a free duration where none are given
Expression = Any  # a casadi SX or MX


@dataclass
class Rows:
    """Rows of constraints at instants: ``value`` (k,) between ``lower`` and ``upper``, with a
    name.

    ``slack``: by how much they may be exceeded between the collocation points; None: see
    `flexgen.planning.optimal.result`.
    """

    name: str
    value: ca.SX
    lower: np.ndarray
    upper: np.ndarray
    slack: float | None = None


@dataclass
class Band:
    """Bounds of one signal by name."""

    name: str
    value: ca.SX
    lower: np.ndarray
    upper: np.ndarray


@dataclass
class Nodal:
    """A cost (``lower`` None) or rows of constraints in the expressions of the nodes."""

    name: str
    value: ca.MX
    lower: np.ndarray | None = None
    upper: np.ndarray | None = None


@dataclass
class Content:
    """Statements of the user: by place ``"path"``, ``"start"``, ``"end"``, and in the expressions
    of the nodes.
    """

    rows: dict[str, list[Rows]] = field(default_factory=lambda: {where: [] for where in WHERE})
    costs: dict[str, list[ca.SX]] = field(default_factory=lambda: {where: [] for where in WHERE})
    squares: list[ca.SX] = field(default_factory=list)
    bands: dict[str, Band] = field(default_factory=dict)
    nodal: list[Nodal] = field(default_factory=list)


@checked_class
class Phase:
    """A part of a planned motion with a mesh and a duration of its own.

    ``phase["tau_m"]`` is a signal at any instant, ``phase.nodes("tau_m")`` holds a signal at all
    nodes.

    Attributes
    ----------
    equations : Equations
    mesh : Transcription
        In the time relative to the duration, 0 to 1.
    signals : Signals
    duration : SX
        Of the phase [s].
    phases : list of Phase
        All phases of the problem.
    unknowns : list of SX
        Further unknown numbers of the problem.

    Examples
    --------
    >>> problem = flexgen.plan_problem("elbow", mesh=20)
    >>> second = problem.then(0.5, mesh=10)
    >>> second.add_cost(second["tau_m[m1]"] ** 2)
    >>> second.bound("tau_m", -20, 20)  # N m
    >>> second
    <Phase elbow, number 1: 0.5 s, 10 intervals>
    """

    def __init__(
        self,
        equations: Equations,
        mesh: Transcription,
        duration: float,
        *,
        number: int,
        tracked: bool,
        with_path: bool,
    ) -> None:
        """``duration``: as given [s], fixed until `free_time`; ``number``: of the phase, from 0;
        ``tracked``: its signals have a reference in time; ``with_path``: the path parameter is the
        last coordinate.
        """
        suffix = f"_{number}" if number else ""
        self.equations = equations
        self.mesh = mesh
        self.number = number
        self.signals = Signals(equations, with_path=with_path, tracked=tracked, name=suffix)
        self.duration = ca.SX.sym(f"T{suffix}")
        self.given_duration = float(duration)
        self.duration_bounds = (float(duration), float(duration))
        self.content = Content()
        self.phases: list[Phase] = [self]
        self.unknowns: list[ca.SX] = []
        self.y_start: np.ndarray | None = None  # at rest there
        self.y_end: np.ndarray | None = None
        self.torque_continuous = False
        self.push: PlanForce | None = None  # on the tool
        n_m = equations.model.n_m
        count = mesh.N + 1
        self._nodes = [ca.MX.sym(f"{x}{suffix}", mesh.n, count) for x in ("y", "dy")]
        self._stages = [ca.MX.sym(f"ddy{suffix}", mesh.n, mesh.N * mesh.s)]
        self._stages.append(ca.MX.sym(f"tau{suffix}", n_m, mesh.N * mesh.s))
        self._duration_mx = ca.MX.sym(f"T{suffix}")
        self._start_mx = ca.MX.sym(f"t_start{suffix}")

    def __repr__(self) -> str:
        of = f"{self.equations.model.title}, number {self.number}"
        return (
            f"<{type(self).__name__} {of}: {self.given_duration:.4g} s, {self.mesh.N} intervals>"
        )

    # --- what the user reads ---------------------------------------------------------------------
    def __getitem__(self, name: str) -> ca.SX:
        """A signal at any instant of the phase by name; ``"tau_m[m1]"`` is one entry."""
        return self.signals[name]

    def names(self) -> tuple[str, ...]:
        """Names of all signals."""
        return tuple(self.signals)

    @property
    def reference(self) -> ca.SX:
        """Target of the output: its positions, and for a pose the columns of its rotation matrix
        after them.
        """
        if not self.signals.reference.numel():
            raise ArgumentError(
                "reference: there is none where the path parameter is free; use "
                "problem.follow(tolerance=...)"
            )
        return self.signals.reference

    @property
    def node_symbols(self) -> list[ca.MX]:
        """Symbols of the expressions of the nodes: states, accelerations and torques, duration,
        start.
        """
        return [*self._nodes, *self._stages, self._duration_mx, self._start_mx]

    def nodes(self, name: str) -> ca.MX:
        """A signal at all nodes (k, N + 1), for costs and constraints that connect several
        instants.

        Accelerations and torques are at the collocation points instead, (k, N s).
        """
        signals = self.signals
        signal, entries = signals.find(name)
        value = ca.densify(signal.value[entries])
        tau = signals.tau
        if ca.depends_on(value, signals.reference):
            raise ArgumentError(
                f"nodes: given {name!r}, expected a signal of the robot or the time"
            )
        at_stages = ca.depends_on(value, ca.veccat(signals.ddy, tau))
        if at_stages and ca.depends_on(value, ca.veccat(signals.y, signals.dy, signals.time)):
            raise ArgumentError(
                f"nodes: given {name!r}, which connects states and torques; use problem[{name!r}]"
            )
        if at_stages:
            function = ca.Function("at_points", [signals.ddy, tau], [value])
            return function.map(self.mesh.N * self.mesh.s)(
                self._stages[0] / self._duration_mx**2, self._stages[1]
            )
        function = ca.Function("at_nodes", [signals.y, signals.dy, signals.time], [value])
        times = self._start_mx + self._duration_mx * ca.DM(self.mesh.nodes).T
        return function.map(self.mesh.N + 1)(
            self._nodes[0], self._nodes[1] / self._duration_mx, times
        )

    # --- what the user states --------------------------------------------------------------------
    def add_cost(self, cost: Expression, at: str = "path") -> None:
        """Add a term to the cost.

        Parameters
        ----------
        cost : SX or MX
            Of the signals of an instant (SX): its integral over time is minimized; with ``at`` its
            value at the start or the end of the phase. Of the expressions of the nodes (MX): a
            number.
        at : str
            ``"path"``, ``"start"`` or ``"end"``.
        """
        if isinstance(cost, ca.MX):
            self._check_scalar(cost)
            self._check_nodal(cost, "cost")
            self.content.nodal.append(Nodal("cost", cost))
            return
        value = _expression(cost, "cost")
        self._check_scalar(value)
        self._check_symbols(value, "cost")
        self.content.costs[_place(at)].append(value)

    def add_squares(self, residual: Expression, weight: float = 1.0) -> None:
        """Add ``weight`` times the integral of the sum of the squares of ``residual``, with a
        Gauss-Newton Hessian.
        """
        check_not_negative("weight", weight)
        value = ca.vec(_expression(residual, "residual"))
        self._check_symbols(value, "residual")
        self.content.squares.append(float(np.sqrt(weight)) * value)

    def subject_to(
        self,
        expression: Expression,
        lower: Any = None,
        upper: Any = None,
        *,
        at: str = "path",
        name: str | None = None,
        slack: float | None = None,
    ) -> None:
        """Add a constraint: a comparison such as ``problem["v_m"] <= 10``, or an expression with
        bounds.

        Parameters
        ----------
        expression : SX or MX
            Of the signals of an instant, or of the expressions of the nodes; the latter hold at
            the nodes only.
        lower, upper : float or array, optional
            Without them the expression has to be a comparison.
        at : str
            ``"path"`` (all collocation points and nodes), ``"start"`` or ``"end"``.
        name : str, optional
            For messages.
        slack : float, optional
            By how much it may be violated between the collocation points; default: 1 % of its
            bounds or 0.1 % of its range.
        """
        if slack is not None:
            check_not_negative("slack", slack)
        place = _place(at)
        count = sum(map(len, self.content.rows.values())) + len(self.content.nodal)
        label = name or f"constraint {count + 1}"
        if lower is None and upper is None:
            value, equal = split_comparison(expression, label)
            low = np.where(equal, 0.0, -np.inf)
            high = np.zeros(value.numel())
        else:
            value = expression if isinstance(expression, ca.MX) else _expression(expression, label)
            value = ca.vec(ca.densify(value))
            low, high = _bounds(lower, upper, value.numel(), label)
        if isinstance(value, ca.MX):
            self._check_nodal(value, label)
            self.content.nodal.append(Nodal(label, value, low, high))
            return
        self._check_symbols(value, label)
        self.content.rows[place].append(Rows(label, value, low, high, slack))

    def bound(self, name: str, lower: Any = None, upper: Any = None) -> None:
        """Bound a signal by name at all instants; the last bounds of a name count.

        Bounds of coordinates, speeds and torques hold everywhere: they bound the Bernstein
        coefficients of the polynomials of each interval. Others hold at collocation points and
        nodes.

        Parameters
        ----------
        name : str
            Of a signal, or of one entry: ``"tau_m[m1]"``.
        lower, upper : float or array, optional
        """
        signal, entries = self.signals.find(name)
        low, high = _bounds(lower, upper, len(entries), f"bound of {name}")
        self.content.bands[name] = Band(name, signal.value[entries], low, high)

    def free_time(
        self, lower: float = DURATIONS[0], upper: float = DURATIONS[1], guess: float | None = None
    ) -> None:
        """Make the duration of the phase an unknown within bounds [s]."""
        for value in (lower, upper, 1.0 if guess is None else guess):
            if not is_number(value) or value <= 0:
                raise ArgumentError(f"free_time: given {value!r}, expected a positive time in s")
        if lower > upper:
            raise ArgumentError(
                f"free_time: given {lower} to {upper} s, expected a lower bound below the upper "
                "one"
            )
        self.duration_bounds = (float(lower), float(upper))
        self.given_duration = float(
            np.clip(self.given_duration if guess is None else guess, lower, upper)
        )

    @checked_types(own=("q_a",))
    def start_at(self, q_a: Sequence[float] | None) -> None:
        """Start at rest in the equilibrium at ``q_a`` (n_a); None: the start is free."""
        self.y_start = None if q_a is None else self._rest(q_a, "start_at")

    @checked_types(own=("q_a",))
    def end_at(self, q_a: Sequence[float] | None) -> None:
        """End at rest in the equilibrium at ``q_a`` (n_a); None: the end is free."""
        self.y_end = None if q_a is None else self._rest(q_a, "end_at")

    def continuous_torque(self) -> None:
        """Let the torque not jump between the intervals of the mesh."""
        self.torque_continuous = True

    # --- checks ----------------------------------------------------------------------------------
    def _rest(self, q_a: Sequence[float], what: str) -> np.ndarray:
        """Coordinates (dof,) of the robot at rest with the arm at ``q_a`` (n_a,) under the force
        of the problem; ``what``: the call, for errors.

        Of coordinates without motor q_a is the first guess only.
        """
        from flexgen.dynamics.mechanics.statics import hold_joints

        model = self.equations.model
        text = f"{what}: given {q_a!r}, expected {model.n_a} finite numbers, the arm coordinates"
        q = numbers_of(q_a, text)
        if q.shape != (model.n_a,):
            raise ArgumentError(text)
        equations = self.equations
        if self.push is not None:
            last = what == "end_at" and self is self.phases[-1]
            known = last or (what == "start_at" and self.number == 0)
            equations = self.push.pushing(equations, float(last) if known else None, what)
        found = hold_joints(equations, q[list(model.i_g)], q[list(model.i_e)])
        return np.concatenate([found.q_a, found.q_m[list(model.i_m)]])

    def _check_scalar(self, value: Expression) -> None:
        if value.numel() != 1:
            raise ArgumentError(
                f"cost: given an expression of shape {value.shape}, expected a scalar; "
                "ca.sumsqr(x)?"
            )

    def _check_symbols(self, value: ca.SX, what: str) -> None:
        """ArgumentError, with ``what`` in it, where an expression has symbols of another phase or
        problem.
        """
        known = ca.symvar(ca.veccat(*self.signals.symbols, self.duration, *self.unknowns))
        keys = {x.element_hash() for x in known}  # symbols of another problem have the same names
        strange = [
            x.name().removeprefix("p:") for x in ca.symvar(value) if x.element_hash() not in keys
        ]
        if strange:
            raise ArgumentError(
                f"{what}: given an expression of {', '.join(strange)}, expected parameters of "
                f"this problem and signals of this phase: {', '.join(self.signals)}"
            )

    def _check_nodal(self, value: ca.MX, what: str) -> None:
        """ArgumentError, with ``what`` in it, where an expression of nodes has symbols of another
        problem.
        """
        keys = {hash(x) for phase in self.phases for x in phase.node_symbols}
        strange = [x.name() for x in ca.symvar(value) if hash(x) not in keys]
        if strange:
            raise ArgumentError(
                f"{what}: given an expression of {', '.join(strange)}, expected nodes(...) of "
                "phases of this problem"
            )


def _expression(value: Any, what: str) -> ca.SX:
    """``value`` as a dense expression; ArgumentError, with ``what`` in it, for another type or a
    number that is not finite.
    """
    try:
        made = ca.densify(ca.SX(None if isinstance(value, bool | np.bool_) else value))
    except (NotImplementedError, TypeError, RuntimeError):
        raise ArgumentError(
            f"{what}: given {type(value).__name__}, expected an expression of signals"
        ) from None
    numbers = [x for x in ca.vertsplit(ca.vec(made)) if x.is_constant()]
    if any(not np.isfinite(float(x)) for x in numbers):
        raise ArgumentError(
            f"{what}: given NaN or infinity, expected an expression of finite numbers"
        )
    return made


def _place(at: str) -> str:
    if at not in WHERE:
        raise ArgumentError(f"at: given {at!r}, expected one of {', '.join(WHERE)}")
    return at


def _bounds(lower: Any, upper: Any, count: int, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds (count,) from numbers, arrays or None for no bound; ArgumentError,
    with ``what`` in it, where they do not fit or cross.
    """
    out = []
    for value, none in ((lower, -np.inf), (upper, np.inf)):
        try:
            array = np.asarray(none if value is None else value, float)
            array = np.broadcast_to(array.ravel() if array.ndim else array, count).copy()
        except (TypeError, ValueError, OverflowError):
            raise ArgumentError(
                f"{what}: given {show_value(value)}, expected a number or {count} numbers"
            ) from None
        if np.isnan(array).any():
            raise ArgumentError(f"{what}: given NaN, expected a number or {count} numbers")
        out.append(array)
    if (out[0] > out[1]).any():
        raise ArgumentError(
            f"{what}: given a lower bound above the upper one: {out[0].tolist()}, "
            f"{out[1].tolist()}"
        )
    return out[0], out[1]


def check_phase(value: Any) -> None:
    """ArgumentError unless the value is a phase."""
    if not isinstance(value, Phase):
        raise ArgumentError(
            f"phase: given {show_value(value)}, expected a flexgen.Phase, such as "
            "problem.phases[0]"
        )
