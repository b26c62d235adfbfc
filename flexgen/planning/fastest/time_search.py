"""The search of `flexgen.planning.fastest.minimum_time`: sequences of linear programs with a trust
region.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import linprog

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import ArgumentError, FlexgenError, SolverError
from flexgen.dynamics.mechanics.limit_use import ToolMotion, limit_rows, norms, tool_motion
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.feedback.loop.reference import trajectory_of
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.solution import Solution
from flexgen.model.elements import Move
from flexgen.paths.force.place_force import in_time
from flexgen.paths.force.process_force import ProcessForce, make_force
from flexgen.paths.path import Path
from flexgen.paths.reference import PathSample
from flexgen.paths.timing.time_laws import SplineLaw, TimeLaw
from flexgen.planning.fastest.residual_vibration import (
    ResidualVibration,
    has_springs,
    unit_of_vibration,
)
from flexgen.planning.fastest.slowing import KEPT, MEANS, in_words, slow_down
from flexgen.planning.fastest.stated_speeds import StatedSpeeds
from flexgen.runtime.inversion.path_inversion import Inversion

# on the path; in an interval that resolves a force, along the path as it is given
SAMPLES = 300
PER_INTERVAL = 2.0
MESH_S = 5e-3  # longest interval of the inversion
FEWEST = 40  # intervals on the path, at least
AFTER_S = 0.3  # of the motion after the path that counts
SLOWER = 1.02  # of the first law against the given one
PENALTY = 5.0  # of violations in the program and in the merit
EXACT = 2.0  # in units of T
TRUST = 0.08
GROW = 1.5
SHRINK = 1 / 3
SMALLEST = 5e-4
LAZY = 1e-3  # weight of changes of the coefficients
CLOSE = 0.6  # of a limit: samples below it cannot become active within a step
STEP = 1e-5  # of differences
# of the samples in an interval: the same for all durations, also where they are a whole and a half
ROUNDING = 1e-6
FINER = 3  # samples and mesh of the last check
MOST = 60  # programs
HEAVY = (
    # times the penalties of the search from the law as given: of a small excess that only much
    # time takes away
    200.0
)
AGAIN = 1.1  # times the duration that was found, above which the search begins again there
HALVINGS = 8  # of the duration of a first law
NEARLY = 2e-4  # gain of a step below which it hardly helps
# penalty of limits, programs and differences where vibration is reduced
CALM = 30.0
CALMER = 12
CALM_STEP = 1e-4
# times the shortest duration
LONGER = (1.01, 1.02, 1.03, 1.045, 1.06, 1.08, 1.1, 1.13, 1.17, 1.22, 1.3, 1.4, 1.6, 2.0)


class TimeSearch:
    """Constraints of a time law and the sequence of linear programs; x: T and the inner
    coefficients.
    """

    def __init__(
        self,
        path: Path,
        default: Solution,
        limits: Limits,
        vibration: float | None,
        coefficients: int,
        tell: Callable[[str], None],
        speeds: tuple[float | None, ...] = (),
        force: ProcessForce | None = None,
    ) -> None:
        """``default``: solution of the move as given; ``vibration``: largest one after the move
        [m, rad], None: any; ``coefficients``: of the time law; ``speeds``: stated in the parts of
        the path [m/s]; ``force``: on the tool over the place.
        """
        equations = path.equations
        model = path.equations.model
        self.path = path
        self.model = model
        self.tell = tell
        self.n = coefficients
        if default.move.type == "sampled":
            raise ArgumentError(
                f"move {default.move.name}: given a sampled move, expected a line, arc, joint "
                "or program"
            )
        self.limits = limits
        solvers = () if force is None else ("invert", "force")
        self.library = inversion_library(equations, "lq", solvers, memory=True, progress=tell)
        self.force = force
        resolving = np.inf if force is None else in_time(force, path).resolving / path.duration
        self.samples = max(SAMPLES, int(np.ceil(PER_INTERVAL / resolving)))
        self._resolving = resolving
        self._reduction = Reduction(equations)
        problem = InversionProblem(equations, path)
        if np.isfinite(problem.harmonic_step):
            self.samples = max(self.samples, int(np.ceil(path.duration / problem.step)))
        before, after = problem.windows
        self._before = before
        self._after = min(after, AFTER_S)
        self.speeds = StatedSpeeds.of(path.segments[0], speeds, default.move.radius)
        if vibration is not None and not has_springs(model):
            raise ArgumentError(
                f"vibration: given for {model.title}, which has no springs, expected none"
            )
        self.swings = vibration
        self.programs = self.inversions = 0
        self.refused = ""  # why the last time law that was tried has no inversion

    def law(self, x: np.ndarray) -> SplineLaw:
        """The time law."""
        return SplineLaw(
            float(x[0]),
            tuple(map(float, x[1:])),
            self.path.segments[0].law(np.array([1e9]), 0)[0, 0],
        )

    def move(self, x: np.ndarray) -> Move:
        """The move with the time law ``x = [T, c_1, ...]``."""
        return replace(
            self.path.move,
            duration=float(x[0]),
            timing=tuple(map(float, x[1:])),
            profile=(),
            smoothness=5,
        )

    def start(self) -> np.ndarray:
        """The polynomial law of smoothness 5, slightly slower than the given move."""
        spline = SplineLaw(1.0, tuple(np.linspace(0, 1, self.n + 2)[1:-1])).spline
        u = np.linspace(0, 1, 20 * self.n + 1)
        basis = BSpline.design_matrix(u, spline.t, spline.k).toarray()
        ends = SplineLaw.DEGREE - 1
        target = TimeLaw(1.0, 5)(u, 0)[:, 0] - basis[:, -ends:].sum(axis=1)
        inner = np.linalg.lstsq(basis[:, ends:-ends], target, rcond=None)[0]
        return np.concatenate(
            [[SLOWER * self.path.duration], np.maximum.accumulate(np.clip(inner, 0.0, 1.0))]
        )

    def constraints(self, x: np.ndarray, finer: int = 1) -> np.ndarray:
        """All quantities over their limits (k,): torques, speeds, deflections, rates of torques.

        ``finer``: this many times as many samples and intervals of the mesh.
        """
        timed = self.retime(x)
        found, tool = self.invert(
            timed,
            timed.duration / (finer * self.samples),
            self.mesh(timed.duration) / finer,
            self.force,
        )
        every = np.arange(len(found.tau_m))  # the last check looks at all samples
        at = every if finer > 1 else self._instants(len(found.tau_m), found.n_pre)
        values = [self.speeds.parts(timed.segments[0].law)]
        channel = partial(getattr, found)
        for row in limit_rows(self.model, self.limits, channel, found.t, tool, timed.duration):
            finite = np.isfinite(row.bounds).all(axis=0)
            values.append(
                (row.parts if len(row.parts) == 1 else row.parts[at[at < len(row.parts)]])[
                    :, finite
                ].ravel()
            )
        self.found = found
        return np.concatenate(values)

    def mesh(self, duration: float) -> float:
        """Intervals of the inversion [s] in a motion of this duration."""
        return float(min(MESH_S, duration / FEWEST, self._resolving * duration))

    def invert(
        self, timed: Path, period: float, mesh: float, force: ProcessForce | None
    ) -> tuple[Inversion, Callable[[], ToolMotion]]:
        """Motion and torques along a path, sampled with the period [s], on a mesh [s]; and the
        motion of the tool.

        ``force``: over the place.
        """
        self.inversions += 1
        sample = timed.sample_orders(np.arange(round(timed.duration / period) + 1) * period, 3)
        pushing = None
        if force is not None:
            pushing = in_time(force, timed).on_output(
                self.model, np.arange(len(sample.y)) * period
            )
        y = self._reduction.targets(sample), sample.derivative(1), sample.derivative(2)
        found = self.library.invert(
            *(np.ascontiguousarray(a) for a in y),
            period=period,
            q_start=timed.q_start,
            n_pre=int(np.ceil(self._before / period)),
            n_post=int(np.ceil(self._after / period)),
            samples_per_interval=max(1, int(mesh / period + 0.5 - ROUNDING)),
            force=pushing,
        )
        return found, partial(self._tool_motion, found, sample)

    def _tool_motion(self, found: Inversion, sample: PathSample) -> ToolMotion:
        """Speed and acceleration of the tool's origin; where the output has it, those of the
        reference.
        """
        output = self.model.output
        if len(output.tool_rows) != 3:
            return tool_motion(self._reduction.equations, found.q_a, found.v_a, found.a_a)
        around = ((found.n_pre, found.n_post), (0, 0))
        return norms(*(np.pad(sample.y[:, :3, k], around) for k in (1, 2)))

    @cached_property
    def _vibration(self) -> ResidualVibration:
        return ResidualVibration(self._reduction.equations, self.tell, self.force is not None)

    def swing(self, x: np.ndarray) -> np.ndarray:
        """Vibration after the path of the last inversion over the allowed one (k,), of the law
        ``x``; 1000 where it cannot be computed.
        """
        force = None if self.force is None else in_time(self.force, self.retime(x))
        values = self._vibration(
            trajectory_of(self.found, 0.0, self.model.name), float(x[0]), force
        )
        return np.nan_to_num(
            np.linalg.norm(values, axis=2).ravel() / (self.swings or 1.0), nan=1e3
        )

    def retime(self, x: np.ndarray) -> Path:
        """The path with this time law."""
        timed = copy.copy(self.path)
        timed.segments = (replace(self.path.segments[0], law=self.law(x)),)
        timed.duration = float(x[0])
        return timed

    def _instants(self, samples: int, n_pre: int) -> np.ndarray:
        """As many samples for every duration: those of the path, and half as many before and after
        it.
        """
        half = self.samples // 2
        return np.clip(np.arange(n_pre - half, n_pre + self.samples + 1 + half), 0, samples - 2)

    def vibrations(self, solution: Solution) -> dict[str, float]:
        """Largest vibration after the path of robots with less and more stiffness [m]; empty where
        no springs are.
        """
        if not has_springs(self.model):
            return {}
        end = float(solution.move.duration)
        force = None
        if self.force is not None:
            force = make_force(solution.trajectory, self.model, end)
        swings = self._vibration(solution.trajectory, end, force)
        sizes = np.linalg.norm(swings, axis=2).max(axis=1)
        return dict(zip(self._vibration.plants.names, map(float, sizes), strict=True))

    def excess(self, x: np.ndarray) -> float:
        """Largest excess of a limit, relative."""
        return float(np.abs(self.constraints(x, FINER)).max() - 1.0)

    def quick_start(self) -> np.ndarray:
        """The polynomial law of smoothness 5, slowed down or accelerated to the limits."""
        x = self.start()
        low = 0.0
        high = 1.0
        for _ in range(HALVINGS):
            factor = (low + high) / 2
            g = self.try_constraints(np.concatenate([[factor * x[0]], x[1:]]))
            low, high = (
                (low, factor) if g is not None and np.abs(g).max() <= 1.0 else (factor, high)
            )
        return np.concatenate([[high * x[0]], x[1:]])

    def run(self, first: np.ndarray | None = None) -> tuple[np.ndarray, list[float]]:
        """The best time law, and the duration after each step; ``first``: where to begin, default:
        `start`.
        """
        x = self.start() if first is None else first
        g = self.try_constraints(x)
        if g is None:
            advice = (
                'take another move, or, for a joint move, a model with an output of type "joint"'
            )
            raise SolverError(
                f"fastest: the first time law cannot be inverted ({self.refused}); {advice}"
            )
        history = [float(x[0])]
        x = self._improve(x, g, history)
        found, over = self._find_slower(x)
        if found is None or found[0] > AGAIN * x[0]:
            given = self._find_slower(self.start())[0]
            g = None if given is None else self.try_constraints(given)
            if given is not None and g is not None:
                self.tell(f"again from {given[0]:.4f} s")
                better = self._find_slower(self._improve(given, g, history, HEAVY))[0]
                found = min(
                    (one for one in (found, given, better) if one is not None),
                    key=lambda one: float(one[0]),
                )
        if found is None:
            raise self._unable(over)
        return found, history

    def _improve(
        self, x: np.ndarray, g: np.ndarray, history: list[float], weight: float = 1.0
    ) -> np.ndarray:
        """The time law after linear programs, from one with its constraints; ``weight``: times the
        penalties.
        """
        trust = TRUST
        idle = 0
        scale = float(x[0])
        last = self.programs + MOST

        def merit(x: np.ndarray, g: np.ndarray) -> float:
            return float(x[0] / scale + weight * EXACT * max(np.abs(g).max() - 1.0, 0.0))

        G: np.ndarray | None = None
        while self.programs < last and trust > SMALLEST and idle < 3:
            check_time("fastest")
            G = self._slopes(x, g) if G is None else G
            step = self._program(x, g, G, trust, scale, weight * PENALTY)
            self.programs += 1
            if step is None:
                trust *= SHRINK
                continue
            other = x + step
            tried = self.try_constraints(other)
            gain = -np.inf if tried is None else merit(x, g) - merit(other, tried)
            if tried is not None and gain > 0:
                x = other
                g = tried
                G = None
                history.append(float(x[0]))
                trust = min(trust * GROW, 0.5)
                idle = idle + 1 if gain < NEARLY else 0
                self.tell(f"{x[0]:.4f} s, limits exceeded by {max(np.abs(g).max() - 1, 0):.1e}")
            else:
                trust *= SHRINK
        return x

    def _slow_down(self, x: np.ndarray) -> np.ndarray:
        """The time law slowed down until the limits are kept between the samples of the search
        too.
        """
        found, over = self._find_slower(x)
        if found is None:
            raise self._unable(over)
        return found

    def _find_slower(self, x: np.ndarray) -> tuple[np.ndarray | None, list[tuple[float, float]]]:
        """The time law, slowed down until it keeps the limits (None: it cannot), and pairs
        (duration [s], excess) that were tried.
        """

        def excess(x: list[np.ndarray]) -> np.ndarray:
            return np.array([self.excess(x[0])])

        found, over = slow_down([x], excess, lambda x, over: [self.slower(x[0], over)], KEPT)
        return None if found is None else found[0], over

    def _unable(self, over: list[tuple[float, float]]) -> SolverError:
        """The error where no duration keeps the limits; ``over``: pairs (duration [s], excess)
        that were tried.
        """
        means = any(getattr(self.limits, name) for name in MEANS)
        return SolverError(
            f"fastest: the limits cannot be kept on this path {in_words(over, means)}"
        )

    def slower(self, x: np.ndarray, excess: float | np.ndarray) -> np.ndarray:
        """The time law slowed down by a part of an excess of the limits."""
        return np.concatenate([[x[0] * (1 + max(0.3 * np.max(excess), 1e-4))], x[1:]])

    def windows(self, x: np.ndarray) -> list[tuple[float, float]]:
        """Begin and end of the window in which the time law changes the torques [s]."""
        return [(-np.inf, np.inf)]

    def calm(self, x: np.ndarray, history: list[float]) -> np.ndarray:
        """Time laws of increasing duration with minimal vibration, from ``x`` on, until the
        vibration is within its bound.

        ``history``: durations of the search before; the last is the shortest one.
        """
        for longer in LONGER:
            x = np.concatenate([[max(longer * history[-1], x[0])], x[1:]])
            x, worst = self._calmest(x)
            self.tell(f"{x[0]:.4f} s: vibration {worst:.2f} times the allowed one")
            if worst <= 1.0:
                x = self._slow_down(x)
                if np.abs(self.swing(x)).max() <= 1.0 + KEPT:  # of the law that is slower, too
                    return x
        raise SolverError(
            f"fastest: vibration stays above {self.swings:.3g} "
            f"{unit_of_vibration(self.model)} with {LONGER[-1]:g} times the shortest duration; "
            "allow more vibration"
        )

    def _calmest(self, x: np.ndarray) -> tuple[np.ndarray, float]:
        """The time law of equal duration with less vibration, and the ratio of its vibration to
        the bound.
        """
        g = self.constraints(x)
        s = self.swing(x)
        trust = TRUST

        def merit(g: np.ndarray, s: np.ndarray) -> float:
            return float(np.abs(s).max() + CALM * max(np.abs(g).max() - 1.0 - KEPT / 2, 0.0))

        for _ in range(CALMER):
            check_time("fastest")
            if np.abs(s).max() <= 1.0 and np.abs(g).max() <= 1.0 + KEPT:
                break
            columns = []
            for k in range(1, len(x)):
                moved = x + CALM_STEP * (np.arange(len(x)) == k)
                columns.append(
                    np.concatenate([self.constraints(moved) - g, self.swing(moved) - s])
                    / CALM_STEP
                )
            G = np.stack(columns, axis=1)
            better = False
            while trust > SMALLEST and not better:
                step = self._calm_program(x, g, s, G, trust)
                self.programs += 1
                other = x + np.concatenate([[0.0], step])
                tried = self.try_constraints(other)
                if tried is not None:
                    swing = self.swing(other)
                    better = merit(tried, swing) < merit(g, s) - 1e-4
                if better and tried is not None:
                    x = other
                    g = tried
                    s = swing
                    trust = min(trust * GROW, 0.5)
                else:
                    trust *= SHRINK
            if not better:
                break
        kept = np.abs(g).max() <= 1.0 + KEPT
        return x, float(np.abs(s).max()) if kept else float("inf")

    def _calm_program(
        self, x: np.ndarray, g: np.ndarray, s: np.ndarray, G: np.ndarray, trust: float
    ) -> np.ndarray:
        """The step dc of one linear program: unknown dc, the vibration v and the excess sigma of
        limits.

        ``g``: constraints, ``s``: vibration over the allowed one, ``G``: derivatives of both in c;
        ``trust``: largest step.
        """
        n = len(x) - 1
        near = np.abs(g) > CLOSE
        A = G[: len(g)][near]
        B = G[len(g) :]
        one = np.ones((len(A), 1))
        none = np.zeros((len(A), 1))
        rows = [np.hstack([A, none, -one]), np.hstack([-A, none, -one])]
        right = [1 - g[near], 1 + g[near]]
        one = np.ones((len(B), 1))
        none = np.zeros((len(B), 1))
        rows += [np.hstack([B, -one, none]), np.hstack([-B, -one, none])]
        right += [-s, s]
        order = np.zeros((n + 1, n + 2))
        for k in range(n):
            order[k, k] = -1.0
            order[k + 1, k] = 1.0
        rows.append(order)
        right.append(np.diff(np.concatenate([[0.0], x[1:], [1.0]])))
        cost = np.concatenate([np.zeros(n), [1.0, CALM]])
        bounds = [(-trust, trust)] * n + [(0, None)] * 2
        found = linprog(
            cost, A_ub=np.vstack(rows), b_ub=np.concatenate(right), bounds=bounds, method="highs"
        )
        return np.zeros(n) if found.x is None else np.asarray(found.x[:n])

    def try_constraints(self, x: np.ndarray) -> np.ndarray | None:
        """The `constraints`; None where the path with this time law has no finite inversion."""
        self.refused = "a torque is not finite"
        try:
            g = self.constraints(x)
        except FlexgenError as error:
            self.refused = str(error)
            return None
        return g if np.isfinite(g).all() else None

    def _slopes(self, x: np.ndarray, g: np.ndarray) -> np.ndarray:
        """Derivatives of the constraints (k, 1 + n) by differences."""
        columns = [
            np.zeros_like(g) if moved is None else (moved - g) / step
            for _, step, moved in self.differences(x)
        ]
        return np.stack(columns, axis=1)

    def differences(self, x: np.ndarray) -> Iterator[tuple[np.ndarray, float, np.ndarray | None]]:
        """For each unknown the unknowns with this one changed, its step, and the constraints there
        or None.

        `found` is the inversion there.
        """
        for k in range(len(x)):
            h = STEP * (x[0] if k == 0 else 1.0)
            for step in (h, -h):
                other = x + step * (np.arange(len(x)) == k)
                moved = self.try_constraints(other)
                if moved is not None:
                    break
            yield other, step, moved

    def _program(
        self,
        x: np.ndarray,
        g: np.ndarray,
        G: np.ndarray,
        trust: float,
        scale: float,
        penalty: float = PENALTY,
    ) -> np.ndarray | None:
        """The step of one linear program (see `linear_program`), None where it has no solution;
        its first entry is a duration [s].
        """
        cost, rows, right, bounds = linear_program(x, g, G, trust, scale, penalty)
        found = linprog(cost, A_ub=rows, b_ub=right, bounds=bounds, method="highs")
        if found.x is None:
            return None
        step = found.x[: len(x)].copy()
        step[0] *= scale
        return np.asarray(step)


def linear_program(
    x: np.ndarray,
    g: np.ndarray,
    G: np.ndarray,
    trust: float,
    scale: float,
    penalty: float = PENALTY,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[tuple[float, float | None]]]:
    """Cost, rows, their right sides and bounds of the program of a step: unknown dT/scale, dc,
    sigma, |dc|.

    ``x = [T, c_1, ...]``; ``g`` (m,): quantities over their limits, ``G``: their derivatives; only
    those beyond `CLOSE` have rows. ``trust``: largest step, ``penalty``: cost of the excess sigma.
    """
    n = len(x)
    A = G * np.concatenate([[scale], np.ones(len(x) - 1)])
    upper = g > CLOSE
    lower = g < -CLOSE
    A = np.vstack([A[upper], -A[lower]])
    rows = np.hstack([A, -np.ones((len(A), 1))])
    right = np.concatenate([1 - g[upper], 1 + g[lower]])
    order = np.zeros((n, n + 1))  # 0 <= c_1 <= ... <= c_n <= 1
    for k in range(n):
        if k > 0:
            order[k, k] = 1.0
        if k < n - 1:
            order[k, k + 1] = -1.0
    c = np.concatenate([[0.0], x[1:], [1.0]])
    rows = np.vstack([rows, order])
    right = np.concatenate([right, np.diff(c)])
    # Small weights on |dc|: where no limit is near, the law stays as it is.
    size = np.hstack([np.zeros((n - 1, 1)), np.eye(n - 1), np.zeros((n - 1, 1)), -np.eye(n - 1)])
    mirrored = np.hstack([-size[:, : n + 1], -np.eye(n - 1)])
    rows = np.vstack([np.hstack([rows, np.zeros((len(rows), n - 1))]), size, mirrored])
    right = np.concatenate([right, np.zeros(2 * (n - 1))])
    cost = np.concatenate([[1.0], np.zeros(n - 1), [penalty], np.full(n - 1, LAZY)])
    bounds: list[tuple[float, float | None]] = [(-trust, trust)] * n + [(0, None)] * n
    return cost, rows, right, bounds
