"""Optimal control of a robot with costs, constraints and bounds of the user: the transcription as
an object.

    minimize    sum of integrals of costs + costs at the ends
    subject to  the equations of motion at the collocation points, constraints and bounds of the
                user

The states are polynomials on the intervals of a mesh: Gauss (3 points, order 6), Radau IIA (3
points, order 5) or Hermite-Simpson (Lobatto, order 4). IPOPT solves the sparse program with exact
derivatives. The result is simulated with an integrator and equations that share no code with it.

Source: J. Betts, Practical Methods for Optimal Control and Estimation Using Nonlinear Programming,
2010, ch. 4; L. Biegler, Nonlinear Programming, 2010, ch. 10.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Literal, get_args

import casadi as ca
import numpy as np

from flexgen.base.calls.deadline import running
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.type_checks import checked_class, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.nlp import NlpResult, solve_nlp
from flexgen.base.numerics.tableaus import Tableau, gauss, lobatto, radau
from flexgen.base.numerics.transcription import Transcription
from flexgen.base.spec.arguments import check_positive
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.dynamics.mechanics.quasistatic import targets
from flexgen.inversion.solution import Solution
from flexgen.model.abilities import check_ability
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.path import Path, find_move
from flexgen.planning.optimal import guesses, reference_curve
from flexgen.planning.optimal.arguments import (
    HessianName,
    check_parameter,
    check_solve,
    mesh_nodes,
)
from flexgen.planning.optimal.blocks import Program, check_finite, program
from flexgen.planning.optimal.force import PlanForce, make_plan_force
from flexgen.planning.optimal.model_limits import apply_limits
from flexgen.planning.optimal.nodal import general_part
from flexgen.planning.optimal.obstacles import Obstacle, Sphere, distance_rows
from flexgen.planning.optimal.phase import Phase, check_phase
from flexgen.planning.optimal.result import make_solution
from flexgen.planning.optimal.start import Parameter, check_rest, scales, start_of
from flexgen.planning.optimal.transcribe import Layout, blocks_of, links

SchemeName = Literal["gauss3", "radau", "hermite-simpson"]
SCHEMES: dict[SchemeName, Callable[[], Tableau]] = {
    "gauss3": lambda: gauss(3), "radau": lambda: radau(3), "hermite-simpson": lobatto,
}  # fmt: skip
# phase, end, coordinates, path parameter where it is known
Rest = tuple[int, str, np.ndarray, float | None]
TimingName = Literal["given", "free"]
TIMINGS: tuple[TimingName, ...] = get_args(TimingName)
INTERVALS = 50
# degrees of freedom: above it the curvature of the constraints costs more than it saves
EXACT_UP_TO = 8
# rad, and m for each meter of reach: largest error of the simulation of a solved problem
ACCURACY = 1e-5
TOLERANCE = 1e-9  # of IPOPT, on scaled constraints
OPTIMALITY = 1e-7  # of the conditions of a minimum, scaled
ITERATIONS = 500
# m, and of a ball's radius: deepest contact between the collocation points
TOUCH = 1e-3
EXCESS = 1e-2
SAME = 1e-9  # rad or m: ends of two phases that are as close are one
# of the tolerance of a path: left for what the output does between the collocation points
BETWEEN = 0.1


@checked_class
class PlanProblem(Phase):
    """An optimal control problem of a robot; made by `flexgen.plan_problem`.

    The problem is its own first phase: signals, costs, constraints and bounds are those of
    `Phase`.

    Attributes
    ----------
    phases : list of Phase
    path : Path
        Of the move: its ends, and the reference of the output.

    Examples
    --------
    >>> problem = flexgen.plan_problem("four_mass", mesh=40)
    >>> problem.names()[:4]
    ('q_a', 'v_a', 'a_a', 'q_m')
    >>> problem.add_cost(problem["tau_m"] ** 2)
    >>> problem.bound("v_m", -30, 30)  # rad/s, motor side
    >>> print(problem.solve().status)
    solved
    """

    def __init__(
        self,
        equations: Equations,
        path: Path,
        mesh: np.ndarray,
        table: Tableau,
        timing: str,
        limits: Limits | None,
        model_limits: bool,
        push: PlanForce | None = None,
    ) -> None:
        """``mesh``: relative nodes from 0 to 1; ``table``: collocation scheme; ``timing``:
        ``"given"`` or ``"free"``, with which the path parameter is a coordinate; ``push``: force
        on the tool.
        """
        check_ability(equations.model, "plan_problem")
        self.path = path
        self.timing = timing
        self._table = table
        self._limits = limits
        self._model_limits = model_limits
        self._n = equations.model.dof + (timing == "free")
        with_path = timing == "free"
        super().__init__(
            equations,
            Transcription(mesh, table, self._n, equations.model.n_m),
            path.duration,
            number=0,
            tracked=not with_path,
            with_path=with_path,
        )
        self.push = push
        self.y_start, self.y_end = guesses.ends_of(equations, path, push)
        self.parameters: list[Parameter] = []
        # what holds in the phases added afterwards as well
        self._everywhere: list[Callable[[Phase], None]] = []
        self._periodic = False
        self._warm: NlpResult | None = None
        self._warm_x = np.zeros(0)
        apply_limits(self, limits, model_limits)

    # --- phases, parameters, path ----------------------------------------------------------------
    def then(self, duration: float, mesh: int | float | Sequence[float] = INTERVALS) -> Phase:
        """Add a phase after the last one; the state is continuous, the torque may jump.

        The end of the problem moves to the end of the new phase; `avoid` and `follow` hold there
        as well.
        """
        check_positive("duration", duration)
        nodes = mesh_nodes(mesh, float(duration))
        transcription = Transcription(nodes, self._table, self._n, self.equations.model.n_m)
        last = self.phases[-1]
        phase = Phase(
            self.equations,
            transcription,
            float(duration),
            number=len(self.phases),
            tracked=self.timing != "free",
            with_path=self.timing == "free",
        )
        phase.phases = self.phases
        phase.unknowns = self.unknowns
        phase.y_end = last.y_end
        last.y_end = None
        phase.torque_continuous = self.torque_continuous
        phase.push = self.push
        self.phases.append(phase)
        apply_limits(phase, self._limits, self._model_limits)
        for state in self._everywhere:
            state(phase)
        return phase

    @checked_types(own=("lower", "upper", "guess"))
    def parameter(
        self, name: str, lower: float = -np.inf, upper: float = np.inf, guess: float = 0.0
    ) -> ca.SX:
        """An unknown number within bounds, for costs and constraints."""
        known = [unknown.name().removeprefix("p:") for unknown in self.unknowns]
        check_parameter(name, known, lower, upper, guess)
        symbol = ca.SX.sym(f"p:{name}")
        self.unknowns.append(symbol)
        self.parameters.append(Parameter(symbol, float(lower), float(upper), float(guess)))
        return symbol

    @property
    def keeps_model_limits(self) -> bool:
        """Whether the limits of the model file are bounds."""
        return self._model_limits

    @property
    def tracks(self) -> bool:
        """Whether a cost or a constraint depends on the reference, or the path parameter is
        free.
        """
        if self.timing == "free":
            return True
        for phase in self.phases:
            content = phase.content
            used = [row.value for rows in content.rows.values() for row in rows] + content.squares
            used += [cost for costs in content.costs.values() for cost in costs]
            if ca.depends_on(ca.veccat(ca.SX(0), *used), phase.signals.reference):
                return True
        return False

    @property
    def output_error(self) -> ca.SX:
        """Output less target (n_y,), of the first phase; of a pose the sine of the angle times the
        axis comes last.
        """
        return self.error_of(self)

    @checked_types
    def error_of(self, phase: Phase) -> ca.SX:
        """Output less target (n_y,) at an instant of a phase."""
        check_phase(phase)
        out = output_map(self.equations)
        target = phase.signals.reference
        if self.timing == "free":
            target = reference_curve.curve(self.path, phase["s"])
        symbols = ca.vertcat(self.equations.lagrangian.chain.q_a, out.target)
        return ca.substitute(out.error, symbols, ca.vertcat(phase["q_a"], target))

    def follow(self, tolerance: float = ACCURACY) -> None:
        """Keep the output within ``tolerance`` [m, rad] of the path in all phases, each row by
        itself.

        Phases that are added afterwards count as well.
        """
        check_positive("tolerance", tolerance)
        inner = (1 - BETWEEN) * tolerance

        def state(phase: Phase) -> None:
            error = self.error_of(phase)
            phase.subject_to(
                error, -inner, inner, name="distance from the path", slack=BETWEEN * tolerance
            )

        self._in_all_phases(state)

    def avoid(self, *obstacles: Obstacle, margin: float = 0.0, samples: int = 2) -> None:
        """Keep the arm out of obstacles in all phases, those that are added afterwards included.

        Parameters
        ----------
        *obstacles : Sphere or HalfSpace
        margin : float [m]
            Distance to keep: the radius of the links.
        samples : int
            Points on each link; the corners of the chain count as well.
        """

        def state(phase: Phase) -> None:
            """State the rows of all obstacles in a phase; contact within a small slack counts as
            none.
            """
            stated = [
                distance_rows(self.equations, phase["q_a"], x, margin, samples) for x in obstacles
            ]
            for k, (obstacle, rows) in enumerate(zip(obstacles, stated, strict=True)):
                kind = "sphere" if isinstance(obstacle, Sphere) else "half-space"
                name = obstacle.name or f"{kind} {k + 1}"
                slack = TOUCH
                if isinstance(obstacle, Sphere):
                    slack = min(TOUCH, EXCESS * (obstacle.radius + margin))
                phase.subject_to(rows, 0.0, np.inf, name=name, slack=slack)

        self._in_all_phases(state)

    def _in_all_phases(self, state: Callable[[Phase], None]) -> None:
        for phase in self.phases:
            state(phase)
        self._everywhere.append(state)

    def periodic(self) -> None:
        """Let the motion end in the state in which it starts; both ends become free."""
        self._periodic = True
        self.y_start = self.phases[-1].y_end = None

    # --- solution --------------------------------------------------------------------------------
    @reported("plan")
    @checked_types(
        own=("guess", "hessian", "accuracy", "max_iterations", "time_limit", "compiled")
    )
    def solve(
        self,
        *,
        guess: str | Solution | Trajectory | None = None,
        warm: bool = False,
        hessian: HessianName = "auto",
        verify: bool = True,
        accuracy: float = ACCURACY,
        compiled: bool | None = None,
        max_iterations: int = ITERATIONS,
        time_limit: float | None = None,
        progress: Choice = None,
    ) -> Solution:
        """Solve the problem and simulate the solution.

        Parameters
        ----------
        guess : str, Solution or Trajectory, optional
            ``"rest"``: a slow motion between the ends; ``"lq"``: the inversion of the move, the
            default where the path parameter is free.
        warm : bool
            Start from the last solution of this problem, with its multipliers; sizes must be the
            same.
        hessian : str
            ``"exact"``, ``"gauss-newton"`` (no curvature of constraints), ``"auto"``: exact up to
            8 degrees of freedom.
        verify : bool
            Simulate the full model under the planned torque.
        accuracy : float [rad, and m for each meter of reach, at most m]
            Largest distance of the simulated output from the planned one.
        compiled : bool, optional
            Whether compiled C evaluates the program; default: where it pays, see `COMPILE_FROM`.
        max_iterations : int
            Of IPOPT.
        time_limit : float, optional [s]
            None or 0: no limit.
        progress : callable or bool, optional

        Returns
        -------
        Solution
            "solved" where IPOPT converged and the simulation agrees, else "tolerance not met";
            ``verdict`` has the largest violated constraint.

        Raises
        ------
        ArgumentError
            An argument is out of range.
        SolverError
            A constraint does not hold at rest at an end, or IPOPT ends with numbers that are not
            finite.
        """
        check_solve(hessian, accuracy, max_iterations, time_limit, compiled)
        began = time.perf_counter(), time.process_time()
        told = progress if callable(progress) else None
        layout = Layout(
            tuple(self.phases), tuple(parameter.symbol for parameter in self.parameters)
        )
        exact = hessian == "exact" or (
            hessian == "auto" and self.equations.model.dof <= EXACT_UP_TO
        )
        rests = self._rests()
        for number, where, rest, s in rests:
            check_rest(self.phases[number], rest, where, s)
        with running(time_limit or None):
            start = self._start(layout, guess)
            multipliers = None
            if warm:
                if self._warm is None or len(self._warm.x) != layout.size:
                    raise ArgumentError(
                        "warm: there is no solution of a problem of this size, expected solve() "
                        "before"
                    )
                start = self._warm_x
            scale = scales(layout, self.parameters, start)
            made = self._program(layout, scale, start, exact, compiled)
            check_finite(made, start / scale)
            if (
                warm
                and self._warm is not None
                and len(self._warm.multipliers[1]) == len(made.lower)
            ):
                multipliers = self._warm.multipliers
            bounds = self._bounds(layout, scale, rests)
            found = solve_nlp(
                made, start / scale, multipliers=multipliers, bounds_x=bounds, progress=told,
                max_iterations=max_iterations, tolerance=TOLERANCE, optimality=OPTIMALITY,
            )  # fmt: skip
            x = found.x * scale
            if found.success:
                self._warm = found
                self._warm_x = x
            solution = make_solution(self, layout, made, found, x, accuracy, verify, told)
            wall = time.perf_counter() - began[0]
            cpu = time.process_time() - began[1]
            return replace(solution, wall_s=wall, cpu_s=cpu)

    @checked_types
    def reference_at(self, phase: Phase) -> Callable[[np.ndarray], np.ndarray]:
        """Targets (k, n_t) of the output at relative times of a phase, by its given duration."""
        check_phase(phase)
        if not phase.signals.reference.numel():
            return lambda sigma: np.zeros((len(sigma), 0))
        start = sum(other.given_duration for other in self.phases[: phase.number])
        return lambda sigma: targets(
            self.path.sample(start + phase.given_duration * np.asarray(sigma))
        )

    def _program(
        self,
        layout: Layout,
        scale: np.ndarray,
        start: np.ndarray,
        exact: bool,
        compiled: bool | None,
    ) -> Program:
        """The nonlinear program: blocks of the phases, their connections, costs and rows at nodes.

        ``scale``: sizes of the unknowns, ``start``: their first values; ``exact``: with the
        curvature of constraints; ``compiled``: None where a block is long enough.
        """
        blocks = [
            b
            for phase in self.phases
            for b in blocks_of(layout, phase, self.reference_at(phase), exact)
        ]
        joined, matrix, names = links(layout, self._periodic)
        size = np.maximum(abs(matrix) @ scale, 1e-300) if len(names) else np.zeros(0)
        nodal = [item for phase in self.phases for item in phase.content.nodal]
        general, bounds = (None, None) if not nodal else general_part(layout, nodal)
        limit = {None: COMPILE_FROM, True: 0.0, False: np.inf}[compiled]
        return program(
            layout.size,
            [*blocks, *joined],
            (matrix, names, 1 / size),
            scale,
            start,
            general,
            bounds,
            limit,
        )

    def _start(self, layout: Layout, guess: str | Solution | Trajectory | None) -> np.ndarray:
        """The unknowns where the search starts."""
        ends = guesses.ends_of(self.equations, self.path, self.push)
        ends = _or(self.y_start, ends[0]), _or(self.phases[-1].y_end, ends[1])
        free = self.timing == "free"
        return start_of(layout, self.path, ends, guess, self.parameters, free=free, push=self.push)

    def _rests(self) -> list[Rest]:
        """Positions at rest: phase, end, coordinates, and the path parameter at both ends of the
        problem.
        """
        out: list[Rest] = []
        free = self.timing == "free"
        last = len(self.phases) - 1
        for number, phase in enumerate(self.phases):
            before = self.phases[number - 1].y_end if number else None
            if phase.y_start is not None and before is not None:
                if np.abs(phase.y_start - before).max() > SAME:
                    raise ArgumentError(
                        f"start_at: given another start of phase {number} than the end of phase "
                        f"{number - 1}; state one"
                    )
            elif phase.y_start is not None:
                out.append((number, "start", phase.y_start, 0.0 if free and number == 0 else None))
            if phase.y_end is not None:
                out.append((number, "end", phase.y_end, 1.0 if free and number == last else None))
        return out

    def _bounds(
        self, layout: Layout, scale: np.ndarray, rests: list[Rest]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the scaled unknowns: rest at the ends, durations, parameters.

        ``rests``: phase, ``"start"`` or ``"end"``, coordinates and path parameter (None: free
        there).
        """
        lower = np.full(layout.size, -np.inf)
        upper = np.full(layout.size, np.inf)
        for number, where, rest, s in rests:
            y, dy = layout.node(number, 0 if where == "start" else -1).reshape(2, self._n)
            # within the problem the path parameter is free
            known = len(rest) if s is None else self._n
            lower[y[:known]] = upper[y[:known]] = rest if s is None else np.r_[rest, s]
            lower[dy[:known]] = upper[dy[:known]] = 0.0
        limits = [phase.duration_bounds for phase in self.phases] + [
            (p.lower, p.upper) for p in self.parameters
        ]
        lower[layout.theta], upper[layout.theta] = np.array(limits, float).T
        return lower / scale, upper / scale


COMPILE_FROM = 1e6  # operations times instants: below it the compiler takes longer than it saves


def _or(value: np.ndarray | None, other: np.ndarray) -> np.ndarray:
    return other if value is None else value


@checked_types(own=("force",))
def plan_problem(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    mesh: int | float | Sequence[float] = INTERVALS,
    scheme: SchemeName = "gauss3",
    timing: TimingName = "given",
    limits: Limits | bool | None = None,
    force: np.ndarray | Callable[[np.ndarray], np.ndarray] | str | FilePath | None = None,
) -> PlanProblem:
    """An optimal control problem of a robot, to which costs, constraints and bounds are added.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move of the model file; default: its first. The motion starts and ends at rest in the
        equilibria at its ends, takes its time, and is otherwise free. See `PlanProblem.start_at`,
        `end_at`, `free_time`.
    mesh : int, float or sequence
        Number of intervals, their length [s], or nodes from 0 to 1.
    scheme : str
        ``"gauss3"``, ``"radau"`` or ``"hermite-simpson"``.
    timing : str
        ``"given"``: ``problem.reference`` is the target of the output by the time law of the move.
        ``"free"``: the path parameter ``problem["s"]`` from 0 to 1 is an unknown, and
        `PlanProblem.follow` keeps the output on the path.
    limits : Limits or bool, optional
        Bounds of all kinds but effective torques; default: those of the model file, and those of
        its joints. False: none.
    force : array (3,) or (n, 3), callable or file, optional [N]
        Of a process on the tool: constant, or with ``timing="free"`` over the place on the path as
        `flexgen.fastest` takes it.

    Returns
    -------
    PlanProblem

    Raises
    ------
    ArgumentError, ModelError
        An argument is out of range.
    SolverError
        The ends of the move have no equilibrium.

    Examples
    --------
    >>> problem = flexgen.plan_problem("four_mass", mesh=40)
    >>> problem.add_cost(problem["tau_m"] ** 2)  # its integral over the move
    >>> problem.bound("tau_m", -7, 7)  # N m
    >>> print(problem.solve().status)
    solved
    """
    if scheme not in SCHEMES:
        raise ArgumentError(f"scheme: given {scheme!r}, expected one of {', '.join(SCHEMES)}")
    if timing not in TIMINGS:
        raise ArgumentError(f"timing: given {timing!r}, expected one of {', '.join(TIMINGS)}")
    if limits is not None and not isinstance(limits, bool | Limits):
        raise ArgumentError(
            f"limits: given {limits!r}, expected flexgen.Limits(torque=..., speed=...) or False"
        )
    equations = model if isinstance(model, Equations) else derive(model)
    path = Path(equations, find_move(equations.model, move))
    if timing == "free":
        reference_curve.path_by_parameter(path)
    given = limits if isinstance(limits, Limits) else None
    push = None if force is None else make_plan_force(force, equations, timing == "free")
    problem = PlanProblem(
        equations,
        path,
        mesh_nodes(mesh, path.duration),
        SCHEMES[scheme](),
        timing,
        given,
        limits is not False,
        push,
    )
    problem.torque_continuous |= scheme == "hermite-simpson"
    return problem
