"""InversionProblem: robot, path, limits and accuracy of an inverse dynamics problem, with its
meshes and zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.motor_harmonics import highest_harmonics
from flexgen.dynamics.mechanics.statics import Equilibrium, equilibrium_at, gear_lag_times
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.model.abilities import obstacle
from flexgen.paths.path import Path

if TYPE_CHECKING:
    from flexgen.inversion.judge.undamped import UndampedMotion
    from flexgen.paths.force.process_force import ProcessForce
    from flexgen.paths.geometry.smoothness import SmoothnessReport

STEP = 1e-3  # s: longest sampling interval of the torque; a short move has 400 of them
INTERVALS = 20_000  # of a mesh, at most: more do not fit into memory for large robots
# of the estimated error of the torques, at most, is left on a mesh that is worth its time
HELPS = 0.5
# zero times interval up to which three Gauss points resolve a zero; from 4.6 on it alternates in
# sign
RESOLVED = 3.0
GRADING = 1.5  # ratio of adjacent intervals before the path
# time constants after the path; the solution is cut where the motion has decayed, see `settling`
SETTLING = 15.0
# time constants D / K of the slowest gear after the path: its deflection has decayed by 2e-9
LAGS = 20.0
LONGEST_SETTLING = 5.0  # s; where a motion needs more, `settling` extends it
LONGEST_PREVIEW = 60.0  # s before the path
# rad, and m for each meter of reach: largest verified error of a solved move
ACCURACY = 1e-5
HELD = 0.5  # s: how long the last torque is held in the verification
ROUGH = 3  # jumps of a rough path that are reported one by one
SPEEDS = 100  # intervals of a path, from which the speeds of the motors are estimated
# rad: of the fastest harmonic, between samples; parts of the usual interval, at most
PHASE = 0.4
FINEST = 20
# rad: between such samples the torque is a monotone cubic, which errs more at its extrema
PHASE_WITH_LIMITS = 0.1
REVERSALS = 8.0  # samples of the torque in the longest interval that resolves a force
POSES = 5  # along the path, where its zeros are computed
ACCELERATION = 100.0  # rad/s^2 or m/s^2: scale of accelerations


@dataclass(frozen=True, kw_only=True)
class SolveOptions:
    """Options of an inverse dynamics problem; see `flexgen.inversion.solve.solve` for the units.

    Attributes
    ----------
    preview, mesh : float or None [s]
        Time before the path, and length of the intervals; None: chosen from the model.
    limits : Limits or None
        That the motion keeps.
    verify : bool
        Whether a simulation of the full model decides; else the residuals do.
    accuracy : float [rad, and m for each meter of reach]
        Largest error of an accepted solution.
    progress : callable or None
        Gets lines of text.
    options : mapping
        Of single methods, by name; a method refuses names that it does not have.
    """

    preview: float | None = None
    mesh: float | None = None
    limits: Limits | None = None
    verify: bool = True
    accuracy: float = ACCURACY
    progress: Callable[[str], None] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def fields(self) -> dict[str, Any]:
        """The options by name, for a record that has them too."""
        return {option.name: getattr(self, option.name) for option in fields(SolveOptions)}


@dataclass(frozen=True)
class UnstableZero:
    """The zero [1/s] with the largest real part that was found along a path, and when [s]."""

    value: complex
    t: float


@dataclass(frozen=True)
class InversionProblem(SolveOptions):
    """A path of a robot with checked options.

    Attributes
    ----------
    equations : Equations
    path : Path
    force : ProcessForce or None
        On the tool along the path.
    """

    equations: Equations
    path: Path
    force: ProcessForce | None = field(default=None, kw_only=True)

    def at_rest(self, t: float) -> Equations:
        """The equations with the constant force that the process exerts at the instant ``t``
        [s].
        """
        return (
            self.equations
            if self.force is None
            else self.equations.pushed_by(self.force.at(np.array([t]))[0])
        )

    @cached_property
    def windows(self) -> tuple[float, float]:
        """Default durations before and after the path [s]: pre-actuation and settling."""
        from flexgen.analysis.zero_dynamics.zeros import preview, time_constants

        scale = min(self.path.duration, 0.5)
        if self.equations.model.n_e == 0:
            return 0.1 * scale, max(0.1 * scale, self.gear_settling)
        before = 0.0
        after = 0.0
        for _, zeros in self.zeros:
            unstable, stable = time_constants(zeros)
            before = max(before, unstable)
            after = max(after, stable)
        preactuation = np.clip(preview(1.0) * before, 0.04 * scale, LONGEST_PREVIEW)
        settling = np.clip(SETTLING * after, 0.1 * scale, LONGEST_SETTLING)
        return float(preactuation), max(float(settling), self.gear_settling)

    @cached_property
    def gear_settling(self) -> float:
        """`gear_settling` of the model [s]."""
        return gear_settling(self.equations)

    @cached_property
    def unstable_zero(self) -> UnstableZero | None:
        """The fastest unstable zero along the path; None where there is none."""
        from flexgen.analysis.zero_dynamics.zeros import time_constants
        from flexgen.analysis.zero_dynamics.zeros_along_path import zero_path

        if self.equations.model.n_e == 0:
            return None
        along = zero_path(self.equations, self.path)
        found = [
            UnstableZero(complex(zero), float(t))
            for t, zeros in zip(along.t, along.zeros, strict=True)
            for zero in zeros[np.isfinite(zeros)]
            if time_constants(np.array([zero]))[0] > 0
        ]
        return max(found, key=lambda one: one.value.real) if found else None

    @cached_property
    def zeros(self) -> list[tuple[float, np.ndarray]]:
        """Zeros [1/s] at some instants [s] of the path.

        Computed in simplified motor coupling: complete coupling moves the zeros only a little.
        """
        from flexgen.analysis.linear import linearize
        from flexgen.analysis.zero_dynamics.zeros import inner_zeros

        equations = self.equations
        path = self.path
        if equations.model.n_e == 0:
            return []
        if obstacle(equations.model, "simplified coupling") is not None:
            equations = Equations(replace(equations.model, motor_coupling="simplified"))
        reduction = Reduction(equations)
        stride = 16
        times = np.linspace(0.0, path.duration, (POSES - 1) * stride + 1)
        poses = reduction.follow(path, times, reduction.start(path).q_a)
        out = []
        for t, q in zip(times[::stride], poses[::stride], strict=True):
            check_time(f"zeros along the path, at t = {t:.4g} s")
            equilibrium = equilibrium_at(equations, q)
            out.append(
                (float(t), inner_zeros(equations, linearize(equations, equilibrium), equilibrium))
            )
        return out

    @cached_property
    def undamped(self) -> UndampedMotion | None:
        """Internal motion along the path that nothing damps; None where there is none."""
        from flexgen.inversion.judge.undamped import find_undamped

        return find_undamped(self.equations, self.zeros)

    @property
    def swings(self) -> bool:
        """Whether internal oscillations continue after the path without any damping."""
        return self.undamped is not None and bool(self.undamped.frequencies_hz)

    @cached_property
    def smoothness(self) -> SmoothnessReport:
        """The smoothness of the path against that which the model requires."""
        from flexgen.paths.geometry.smoothness import smoothness_report

        return smoothness_report(self.equations, self.path, self.step)

    @property
    def notes(self) -> dict[str, list[str]]:
        """Details of a solution: notes on the path that are not warnings; empty without any."""
        path = self.path
        lines = [line for line in path.notes if line not in path.warnings]
        return {"notes": [f"move {path.move.name}: {line}" for line in lines]} if lines else {}

    @cached_property
    def too_rough(self) -> tuple[str, ...]:
        """Warnings where a path is too rough for a continuous torque, with the error, or its
        samples not at rest.
        """
        report = self.smoothness
        name = self.path.move.name
        moving = tuple(f"move {name}: {line}" for line in self.path.warnings)
        if report.sufficient:
            return moving
        lines = report.lines()
        head = (
            f"move {name}: smoothness {report.smoothness} makes the torque jump; "
            f"a continuous torque needs {report.required} (structural index less one)"
        )
        more = [f"and {len(lines) - ROUGH} more"] if len(lines) > ROUGH else []
        return (*moving, head, *(f"move {name}: {line}" for line in [*lines[:ROUGH], *more]))

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """Equilibrium at the start of the path, by statics alone."""
        equations = self.at_rest(0.0)
        model = self.equations.model
        if self.path.move.type == "joint" and model.n_e == 0:
            return equilibrium_at(equations, self.path.q_start)
        simple = replace(
            self, equations=Equations(replace(model, motor_coupling="simplified"))
        ).at_rest(0.0)
        return equilibrium_at(equations, Reduction(simple).start(self.path).q_a)

    @cached_property
    def step(self) -> float:
        """The sampling interval of the torque [s]; it resolves the harmonics of the motor
        angles.
        """
        longest = min(STEP, self.path.duration / 400)
        return max(min(longest, self.harmonic_step), longest / FINEST)

    @cached_property
    def harmonic_step(self) -> float:
        """Sampling interval [s] that resolves the harmonics of motor angles; infinite: none."""
        robot = self.equations.model
        if not highest_harmonics(robot).any():
            return np.inf
        from flexgen.dynamics.mechanics.quasistatic import poses_along

        t = np.linspace(0.0, self.path.duration, SPEEDS + 1)
        q = poses_along(self.equations, self.path, t)[:, list(robot.i_g)] @ robot.eta.T
        speeds = np.abs(np.diff(q, axis=0)).max(axis=0) / t[1]
        fastest = float((speeds * highest_harmonics(robot)).max())
        phase = PHASE if self.limits is None else PHASE_WITH_LIMITS
        return float(phase / max(fastest, 1e-9))

    @property
    def sampling(self) -> float:
        """Sampling interval [s] that also resolves the force, under which motors reverse and their
        friction jumps.
        """
        return (
            self.step if self.force is None else min(self.step, self.force.resolving / REVERSALS)
        )

    @property
    def resolving(self) -> float:
        """Longest interval [s] that resolves every unstable zero before the path; infinite without
        any.
        """
        from flexgen.analysis.zero_dynamics.zeros import time_constants

        zeros = self.zeros[0][1] if self.zeros else np.zeros(0)
        fastest = max(
            (float(z.real) for z in zeros if time_constants(np.array([z]))[0] > 0), default=0.0
        )
        return RESOLVED / fastest if fastest > 0 else np.inf

    def nodes(self, h: float) -> tuple[float, np.ndarray]:
        """Pre-actuation [s] and nodes of a mesh with intervals of ``h`` [s] on the path."""
        from flexgen.analysis.zero_dynamics.zeros import preview

        preactuation, settling = self.windows
        # two time constants of the unstable zero dynamics
        early = max(2 * preactuation / preview(1.0), h / 5)
        if self.preview is not None:
            preactuation = float(self.preview)
        return preactuation, _mesh(
            preactuation, early, self.path.duration, settling, h, self.resolving
        )

    def check_options(self, method: str, *known: str) -> None:
        """ArgumentError where an option is given that the method does not have."""
        for name in self.options:
            if name not in known:
                expected = f"one of {', '.join(known)}" if known else "none"
                raise ArgumentError(
                    f"options: method {method} was given {name!r}, expected {expected}"
                )

    def log(self, text: str) -> None:
        """Pass a line of text to ``progress``, if there is one."""
        if self.progress is not None:
            self.progress(text)


def gear_settling(equations: Equations) -> float:
    """Time after a path in which the deflections of damped gears decay [s], at most
    ``LONGEST_SETTLING``.
    """
    return min(LAGS * float(gear_lag_times(equations).max(initial=0.0)), LONGEST_SETTLING)


def _mesh(
    preactuation: float, early: float, duration: float, settling: float, h: float, resolving: float
) -> np.ndarray:
    """Nodes [s] from -``preactuation`` to ``duration + settling``, with the ends of the path:
    intervals of h [s] on it and 2 h after it.

    Before it intervals of min(2 h, ``early``); where these are longer than ``resolving`` [s] they
    become shorter towards the path, down to that length.
    """
    spans = [
        (-preactuation, 0.0, min(2 * h, early)),
        (0.0, duration, h),
        (duration, duration + settling, 2 * h),
    ]
    counts = [max(1, int(np.ceil((b - a) / d - 1e-9))) if b > a else 0 for a, b, d in spans]
    if sum(counts) > INTERVALS:
        raise ArgumentError(
            f"mesh: given {h:.3g} s, which makes {sum(counts)} intervals over "
            f"{preactuation + duration + settling:.3g} s, expected at most {INTERVALS}; take a "
            "coarser --mesh, a shorter --preview or a shorter move"
        )
    nodes = [np.linspace(a, b, n + 1) for (a, b, _), n in zip(spans, counts, strict=True) if n]
    before = _graded_nodes(preactuation, spans[0][2], resolving)
    if before is not None:
        nodes[0] = before
    return np.unique(np.concatenate(nodes))


def _graded_nodes(preactuation: float, longest: float, shortest: float) -> np.ndarray | None:
    """Nodes [s] from -``preactuation`` to 0 whose intervals grow away from 0 by `GRADING`, from
    ``shortest`` to ``longest``; None where equal ones are short enough.
    """
    if shortest >= longest or not preactuation > 0:
        return None
    steps = [0.0]
    length = shortest
    while steps[-1] < preactuation:
        steps.append(steps[-1] + length)
        length = min(GRADING * length, longest)
    return -np.array(steps[::-1]) * (preactuation / steps[-1])
