"""The fastest time laws of a program: one for each motion from rest to rest, and limits that
connect them.

Each motion is optimized alone, see `time_search.py`. Effective (RMS) torques are means over the
whole program: where a limit of one is exceeded, linear programs over all laws follow,

    min sum dT_k + w sum sigma,   |g_k + G_k dx_k| <= 1 + sigma_k,
    c + sum_k C_k dx_k <= 1 + sigma_0

with the ratios c of effective torques to their limits. Finally the whole program is inverted.
Neighboring motions overlap there; motions whose torques then exceed a limit are slowed down.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import block_diag, csr_matrix, hstack, vstack

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.limit_use import LimitRow, limit_rows
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.solution import Solution
from flexgen.model.moves import Move, Program
from flexgen.paths.force.place_force import of_motion
from flexgen.paths.force.process_force import ProcessForce
from flexgen.paths.path import Path
from flexgen.paths.timing.timed_segments import configuration_at_end
from flexgen.planning.fastest.slowing import MEANS, SLOWEST, in_words, slow_down
from flexgen.planning.fastest.stated_speeds import stated_speeds
from flexgen.planning.fastest.time_search import (
    AGAIN,
    EXACT,
    FINER,
    GROW,
    HEAVY,
    NEARLY,
    PENALTY,
    SHRINK,
    SMALLEST,
    TRUST,
    TimeSearch,
    linear_program,
)
from flexgen.runtime.inversion.path_inversion import Inversion

GRID = 1500  # instants of the effective torques of a program
STEPS = 20  # linear programs over all laws
REACH_S = 0.02  # s: a motion that exceeds a limit so close to its neighbor slows both down
WITHIN = -1e-4  # relative excess of a limit that is left: none, whatever the samples
BISECTIONS = 8  # of the factor of all durations


@dataclass
class _State:
    """Unknowns of all motions, their constraints and inversions, and the effective torques over
    their limits.
    """

    x: list[np.ndarray]
    g: list[np.ndarray]
    found: list[Inversion]
    c: np.ndarray

    @property
    def duration(self) -> float:
        """Of all motions, without pauses [s]."""
        return float(sum(x[0] for x in self.x))

    def excess(self) -> float:
        """Largest excess of a limit, relative."""
        return max(*(float(np.abs(g).max()) for g in self.g), float(self.c.max(initial=0.0))) - 1.0


class ProgramSearch:
    """The search of a program; the interface of `TimeSearch`, with one array of unknowns for each
    motion.
    """

    swings = None

    def __init__(
        self,
        path: Path,
        default: Solution,
        limits: Limits,
        coefficients: int,
        tell: Callable[[str], None],
        force: ProcessForce | None = None,
    ) -> None:
        """``default``: solution of the program as given; ``coefficients``: of each time law;
        ``force``: on the tool over the place. A search for each motion keeps its own limits,
        effective torques connect them.
        """
        self.path = path
        self.limits = limits
        self.tell = tell
        self.force = force
        self.model = path.equations.model
        self.n = coefficients
        self.connecting = Limits(**{name: getattr(limits, name) for name in MEANS})
        self.single = limits.without(*MEANS)
        self._motions = len(path.segments)
        self.legs = [
            TimeSearch(
                leg,
                default,
                self.single,
                None,
                coefficients,
                partial(self._tell_of, k),
                speeds,
                of_motion(force, k),
            )
            for k, (leg, speeds) in enumerate(
                zip(legs_of(path), stated_speeds(path.move), strict=True)
            )
        ]
        ends = [segment.start + segment.law.duration for segment in path.segments]
        self.pauses = [
            later.start - end for later, end in zip(path.segments[1:], ends[:-1], strict=True)
        ]
        self.programs = 0

    def _tell_of(self, k: int, line: str) -> None:
        self.tell(f"motion {k + 1} of {self._motions}: {line}")

    @property
    def inversions(self) -> int:
        """Inversions of motions."""
        return sum(leg.inversions for leg in self.legs)

    def duration(self, x: list[np.ndarray]) -> float:
        """Of the whole program [s]."""
        return float(sum(part[0] for part in x) + sum(self.pauses))

    def run(self) -> tuple[list[np.ndarray], list[float]]:
        """The best time laws, and the duration after each stage."""
        x = [leg.run(leg.quick_start())[0] for leg in self.legs]
        self.programs += sum(leg.programs for leg in self.legs)
        history = [self.duration(x)]
        over: list[tuple[float, float]] = []
        found = None
        reason = None
        try:
            if self.connecting != Limits():
                x = self._connect(x)
                history.append(self.duration(x))
            found, over = self._find_slower(x)
        except SolverError as error:
            reason = error
        if self.connecting != Limits() and (
            found is None or self.duration(found) > AGAIN * self.duration(x)
        ):
            found = self._again(found)
        if found is None:
            raise reason or self._unable(over)
        return found, [*history, self.duration(found)]

    def _again(self, found: list[np.ndarray] | None) -> list[np.ndarray] | None:
        """The shorter of two results: the given time laws, and those of a second search from the
        initial laws with larger penalties.
        """
        given = self._find_slower([leg.start() for leg in self.legs])[0]
        state = None if given is None else self._state(given)
        if given is None or state is None:
            return found
        self.tell(f"again from {self.duration(given):.4f} s")
        better = self._find_slower(self._improve(state, HEAVY))[0]
        return min((one for one in (found, given, better) if one is not None), key=self.duration)

    def move(self, x: list[np.ndarray]) -> Move:
        """The program with these time laws."""
        program = self.path.move
        assert isinstance(program, Program)
        return replace(
            program, laws=tuple(tuple(map(float, part)) for part in x), duration=self.duration(x)
        )

    def vibrations(self, solution: Solution) -> dict[str, float]:
        """Largest vibration after the program of robots with less and more stiffness."""
        return self.legs[-1].vibrations(solution)

    def excess(self, x: list[np.ndarray]) -> float:
        """Largest excess of a limit along the whole program, relative."""
        return max(self._excesses(x))

    # --- effective torques -----------------------------------------------------------------------
    def _connect(self, x: list[np.ndarray]) -> list[np.ndarray]:
        """Time laws that keep the effective torques too."""
        state = self._slow_enough(x)
        if state.x is x:
            return x
        return self._improve(state)

    def _improve(self, state: _State, weight: float = 1.0) -> list[np.ndarray]:
        """The time laws after linear programs over all of them; ``weight``: times the
        penalties.
        """
        trust = TRUST
        idle = 0
        slopes = None
        scale = state.duration

        def merit(state: _State) -> float:
            return state.duration / scale + weight * EXACT * max(state.excess(), 0.0)

        for _ in range(STEPS):
            check_time("fastest")
            if not (trust > SMALLEST and idle < 3):
                break
            slopes = self._slopes(state) if slopes is None else slopes
            step = self._program(state, *slopes, trust, weight * PENALTY)
            self.programs += 1
            other = (
                None
                if step is None
                else self._state([a + b for a, b in zip(state.x, step, strict=True)])
            )
            gain = -np.inf if other is None else merit(state) - merit(other)
            if other is not None and gain > 0:
                idle = idle + 1 if gain < NEARLY else 0
                state = other
                slopes = None
                trust = min(trust * GROW, 0.5)
                self.tell(
                    f"{self.duration(state.x):.4f} s, limits exceeded by "
                    f"{max(state.excess(), 0):.1e}"
                )
            else:
                trust *= SHRINK
        return state.x

    def _slow_enough(self, x: list[np.ndarray]) -> _State:
        """State of the laws ``x`` (each ``[T, c_1, ...]``), all slowed down by the factor that the
        effective torques require, by bisection.

        SolverError where their limits do not hold even `SLOWEST` times slower.
        """
        low = 1.0
        high = 1.0
        found = self._state(x)
        while found is None or found.c.max() > 1.0:
            low = high
            high = 1.3 * high
            if high > SLOWEST:
                most = np.inf if found is None else float(found.c.max())
                raise SolverError(
                    "fastest: the effective torques cannot be kept in this program at the "
                    f"speeds that were tried; raise their limits: {low:.3g} times slower it "
                    f"needs {most:.6g} of one"
                )
            found = self._state([_slower(part, high) for part in x])
        for _ in range(BISECTIONS if high > 1.0 else 0):
            middle = (low + high) / 2
            tried = self._state([_slower(part, middle) for part in x])
            if tried is None or tried.c.max() > 1.0:
                low = middle
            else:
                high = middle
                found = tried
        return found

    def _state(self, x: list[np.ndarray]) -> _State | None:
        """Everything at some time laws; None where one of them cannot be inverted."""
        g = [leg.try_constraints(part) for leg, part in zip(self.legs, x, strict=True)]
        known = [one for one in g if one is not None]
        if len(known) < len(g):
            return None
        found = [leg.found for leg in self.legs]
        return _State(x, known, found, self._effective(x, found))

    def _effective(self, x: list[np.ndarray], found: list[Inversion]) -> np.ndarray:
        """Effective torques of the program over their limits (k,), from the inversions ``found``
        of the motions one after the other, pauses between them, on a grid of `GRID` instants.
        """
        starts = np.cumsum(
            [0.0, *(part[0] + p for part, p in zip(x, [*self.pauses, 0.0], strict=True))]
        )
        inside = [slice(one.n_pre, len(one.t) - one.n_post) for one in found]
        t = np.concatenate(
            [start + one.t[i] for start, one, i in zip(starts, found, inside, strict=False)]
        )
        grid = np.linspace(0.0, self.duration(x), GRID)

        def channel(name: str) -> np.ndarray:
            values = np.concatenate(
                [getattr(one, name)[i] for one, i in zip(found, inside, strict=True)]
            )
            return np.stack([np.interp(grid, t, column) for column in values.T], axis=1)

        rows = limit_rows(self.model, self.connecting, channel, grid)
        return np.concatenate([row.parts.max(axis=0)[np.isfinite(row.bounds[0])] for row in rows])

    def _slopes(self, state: _State) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Derivatives in the unknowns of each motion: of its own constraints (m, unknowns), and of
        the effective torques of all (k, unknowns), by differences.
        """
        own = []
        connecting = []
        for k, leg in enumerate(self.legs):
            columns = []
            means = []
            for moved, step, g in leg.differences(state.x[k]):
                x = list(state.x)
                found = list(state.found)
                if g is not None:
                    x[k] = moved
                    found[k] = leg.found
                columns.append(np.zeros_like(state.g[k]) if g is None else (g - state.g[k]) / step)
                means.append((self._effective(x, found) - state.c) / step)
            own.append(np.stack(columns, axis=1))
            connecting.append(np.stack(means, axis=1))
        return own, connecting

    def _program(
        self,
        state: _State,
        own: list[np.ndarray],
        connecting: list[np.ndarray],
        trust: float,
        penalty: float = PENALTY,
    ) -> list[np.ndarray] | None:
        """The steps of one linear program over all motions; None where it has no solution.

        ``own``, ``connecting``: of `_slopes`; ``trust``: largest relative step; ``penalty``: cost
        of an excess of the limits.
        """
        total = state.duration
        count = len(self.legs)
        costs = []
        blocks = []
        rights = []
        bounds = []
        shared = []
        for x, g, G, C in zip(state.x, state.g, own, connecting, strict=True):
            cost, rows, right, limits = linear_program(x, g, G, trust, float(x[0]), penalty)
            cost[0] = x[0] / total
            cost[len(x) + 1 :] = cost[len(x) + 1 :] / count
            costs.append(cost)
            blocks.append(csr_matrix(rows))
            rights.append(right)
            bounds += limits
            scaled = C * np.concatenate([[x[0]], np.ones(len(x) - 1)])
            shared.append(np.hstack([scaled, np.zeros((len(C), len(cost) - len(x)))]))
        excess = csr_matrix(-np.ones((len(state.c), 1)))
        none = csr_matrix((sum(map(len, rights)), 1))
        A = vstack(
            [hstack([block_diag(blocks), none]), hstack([csr_matrix(np.hstack(shared)), excess])]
        )
        right = np.concatenate([*rights, 1.0 - state.c])
        cost = np.concatenate([*costs, [penalty]])
        found = linprog(
            cost, A_ub=A.tocsr(), b_ub=right, bounds=[*bounds, (0, None)], method="highs"
        )
        if found.x is None:
            return None
        steps = []
        at = 0
        for x, own_cost in zip(state.x, costs, strict=True):
            step = found.x[at : at + len(x)].copy()
            step[0] *= x[0]
            steps.append(step)
            at += len(own_cost)
        return steps

    # --- the whole program -----------------------------------------------------------------------
    def retime(self, x: list[np.ndarray]) -> Path:
        """The path of the program with these time laws."""
        timed = copy.copy(self.path)
        start = 0.0
        segments = []
        for k, (leg, part) in enumerate(zip(self.legs, x, strict=True)):
            segments.append(replace(self.path.segments[k], law=leg.law(part), start=start))
            start += float(part[0]) + (self.pauses[k] if k < len(self.pauses) else 0.0)
        timed.segments = tuple(segments)
        timed.duration = self.duration(x)
        return timed

    def _excesses(self, x: list[np.ndarray]) -> list[float]:
        """Largest excess of an effective torque, then of the other limits of each motion,
        relative, along the whole program with the laws ``x``; on a grid `FINER` than that of the
        search.
        """
        timed = self.retime(x)
        finest = (
            min(float(part[0]) / leg.samples for part, leg in zip(x, self.legs, strict=True))
            / FINER
        )
        count = int(np.ceil(timed.duration / finest))
        mesh = (
            min(leg.mesh(float(part[0])) for part, leg in zip(x, self.legs, strict=True)) / FINER
        )
        found, tool = self.legs[0].invert(timed, timed.duration / count, mesh, self.force)
        channel = partial(getattr, found)
        rows = list(limit_rows(self.model, self.single, channel, found.t, tool))
        whole = limit_rows(self.model, self.connecting, channel, found.t, end=timed.duration)
        out = [max((_largest(row, slice(None)) for row in whole), default=0.0) - 1.0]
        for k, (leg, (low, high)) in enumerate(zip(self.legs, self.windows(x), strict=True)):
            inside = np.flatnonzero((found.t >= low) & (found.t <= high))
            parts = [_largest(row, inside[inside < len(row.parts)]) for row in rows]
            parts.append(float(leg.speeds.parts(timed.segments[k].law).max(initial=0.0)))
            out.append(max(parts) - 1.0)
        return out

    def windows(self, x: list[np.ndarray]) -> list[tuple[float, float]]:
        """Begin and end of each motion with its surroundings, up to a little beyond the middle of
        the pauses [s].
        """
        ends = np.cumsum(
            [part[0] + pause for part, pause in zip(x, [*self.pauses, 0.0], strict=True)]
        )
        between = ends[:-1] - np.array(self.pauses) / 2
        return list(
            zip([-np.inf, *(between - REACH_S)], [*(between + REACH_S), np.inf], strict=True)
        )

    def slower(self, x: list[np.ndarray], excess: np.ndarray) -> list[np.ndarray]:
        """Time laws slowed down by a part of the excess of the limits of each motion, where it is
        positive.
        """
        parts = zip(self.legs, x, excess, strict=True)
        return [leg.slower(part, e) if e > 0 else part for leg, part, e in parts]

    def _slow_down(self, x: list[np.ndarray]) -> list[np.ndarray]:
        """The time laws slowed down where a limit is exceeded along the whole program."""
        found, over = self._find_slower(x)
        if found is None:
            raise self._unable(over)
        return found

    def _find_slower(
        self, x: list[np.ndarray]
    ) -> tuple[list[np.ndarray] | None, list[tuple[float, float]]]:
        """The laws, slowed down until they keep the limits along the whole program (None: they
        cannot), and pairs (duration [s], excess) that were tried.
        """

        def excess(x: list[np.ndarray]) -> np.ndarray:
            """For each motion the larger of its own excess and that of the effective torques, less
            `WITHIN`.
            """
            whole, *each = self._excesses(x)
            worst = max(whole, *each)
            if worst > WITHIN:
                self.tell(
                    f"{self.duration(x):.4f} s, limits of the whole program exceeded by "
                    f"{worst:.1e}"
                )
            return np.maximum(whole, each) - WITHIN

        found, over = slow_down(x, excess, self.slower, 0.0)
        return found, [(duration, worst + WITHIN) for duration, worst in over]

    def _unable(self, over: list[tuple[float, float]]) -> SolverError:
        words = in_words(over, self.connecting != Limits())
        return SolverError(f"fastest: the limits cannot be kept in this program {words}")


def _slower(x: np.ndarray, factor: float) -> np.ndarray:
    return np.concatenate([[factor * x[0]], x[1:]])


def _largest(row: LimitRow, at: slice | np.ndarray) -> float:
    finite = np.isfinite(row.bounds).all(axis=0)
    return float(np.abs(row.parts[at][:, finite]).max(initial=0.0))


def legs_of(path: Path) -> list[Path]:
    """The motions of a path from rest to rest, each as a path that begins at the time 0."""
    out = []
    q_g = path.q_start[list(path.equations.model.i_g)]
    for segment in path.segments:
        leg = copy.copy(path)
        first = replace(segment, start=0.0)
        leg.segments = (first,)
        leg.duration = first.law.duration
        leg.q_start = path.reference.expand(q_g)
        out.append(leg)
        q_g = configuration_at_end(path.reference, first, q_g)
    return out
