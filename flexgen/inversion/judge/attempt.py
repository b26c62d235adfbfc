"""Attempt: figures of one method on one mesh; `judge` accepts it, asks for a finer mesh, or stops.

The loop that makes attempts is `flexgen.inversion.refinement.refine`. A record has figures only,
so that its verdict can be tested without a robot. Its solution is a payload that `judge` does not
read.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from flexgen.inversion.problem.problem import ACCURACY, HELPS

# Meshes of a method, each with intervals half as long as the one before.
ATTEMPTS = 3
# Further meshes, where only the residual between the samples is too large, or where "lq" has
# nearly converged.
RETRIES = 1
# Times the accuracy: up to this error of "lq" a finer mesh may still reach the accuracy.
NEAR = 100.0
# Relative: largest error of the energy balance of a simulation that verifies a solution. An
# integration in double precision stays below it unless the model is too stiff.
ENERGY = 1e-7


class Verdict(Enum):
    """Consequence of an attempt.

    ``ACCEPT``: its solution is the result. ``REFINE``: the next mesh, with intervals half as long.
    ``STOP``: the best attempt so far is the result, if there is one.
    """

    ACCEPT = "accept"
    REFINE = "refine"
    STOP = "stop"


@dataclass(frozen=True)
class Measured:
    """Figures of the simulation that verifies a solution.

    Attributes
    ----------
    error : float [rad, and m for each meter of reach]
        Largest error of the output.
    energy_error : float
        Relative error of the energy balance.
    unguided_error : float or None [as error]
        The error without a feedback, or that which the residuals between the samples cause without
        it, whichever is smaller; infinite: not known. None where the simulation has no feedback.
    """

    error: float
    energy_error: float = 0.0
    unguided_error: float | None = None


@dataclass(frozen=True)
class Attempt:
    """One method on one mesh, and the attempts before it.

    Attributes
    ----------
    number, planned : int
        Of this mesh, from 0; meshes that the method is given, 1 where a finer one is of no use.
    accuracy : float [rad, and m for each meter of reach]
        Largest error of an accepted solution.
    verified : bool
        Whether a simulation decides; else the residual does.
    converging : bool
        Whether an error up to ``NEAR`` times the accuracy promises convergence on a finer mesh.
    failure : Exception or None
        Why the method found no solution on this mesh.
    small_residual : bool
        Whether the equations of motion hold between the samples.
    residual : float
        The relative residual between the samples.
    slow : bool
        Whether the simulation takes much longer than the method.
    baseline : bool
        Whether the method solves a simplified model, so that its error is not judged.
    ripple : float
        Estimated error of torques that the mesh does not resolve, of the largest torque; 0: none.
    measured : Measured or None
        None: not simulated.
    cause : str
        Why no mesh resolves the motion; empty: not known.
    solution : object
        Payload: the solution that the figures describe.
    before : Attempt or None
        The attempt on the mesh before.

    Examples
    --------
    >>> from flexgen.inversion.judge.attempt import Attempt, Measured, judge
    >>> rough = Attempt(measured=Measured(error=3e-5))  # accuracy 1e-5
    >>> judge(rough).value
    'refine'
    >>> judge(Attempt(number=1, measured=Measured(error=4e-6), before=rough)).value
    'accept'
    """

    number: int = 0
    planned: int = ATTEMPTS
    accuracy: float = ACCURACY
    verified: bool = True
    converging: bool = False
    failure: Exception | None = None
    small_residual: bool = True
    residual: float = 0.0
    slow: bool = False
    baseline: bool = False
    ripple: float = 0.0
    measured: Measured | None = None
    cause: str = ""
    solution: Any = field(default=None, repr=False)
    before: Attempt | None = field(default=None, repr=False)

    @property
    def within(self) -> bool:
        """Whether the simulated error is within the accuracy, and the simulation can be
        trusted.
        """
        run = self.measured
        return run is not None and run.error <= self.accuracy and run.energy_error <= ENERGY

    @property
    def hidden(self) -> bool:
        """Whether the feedback of the simulation may hide an error of the torques.

        A feedback reduces all errors. Residuals over a short time, at corners of a derivative of
        the path, move the output little also without it.
        """
        run = self.measured
        if run is None or run.unguided_error is None or not self.within or self.small_residual:
            return False
        return not run.unguided_error <= self.accuracy

    @property
    def near(self) -> bool:
        """Whether a converging method is so near the accuracy that one more mesh may reach it."""
        run = self.measured
        return self.converging and run is not None and run.error <= NEAR * self.accuracy

    @property
    def accepted(self) -> bool:
        """Whether the simulation confirms the torques, although they may ripple."""
        return self.within and not self.hidden

    @property
    def rank(self) -> tuple[bool, float]:
        """Order of simulated attempts: confirmed ones by their ripple, then others by their
        error.
        """
        assert self.measured is not None
        return (not self.accepted, self.ripple if self.accepted else self.measured.error)

    @property
    def last_measured(self) -> Attempt | None:
        """The last simulated attempt, up to this one."""
        if self.measured is not None or self.before is None:
            return self if self.measured is not None else None
        return self.before.last_measured

    @property
    def fallback(self) -> Attempt | None:
        """The best attempt before this one, if it was accepted."""
        earlier = None if self.before is None else self.before.best
        return earlier if earlier is not None and earlier.accepted else None

    @property
    def idle(self) -> bool:
        """Whether the mesh gained too little over the fallback for a further one."""
        fallback = self.fallback
        if fallback is None or self.measured is None:
            return False
        return self.rank[1] > HELPS * fallback.rank[1]

    @property
    def best(self) -> Attempt | None:
        """The best simulated attempt up to this one; rounding may be larger on a finer mesh."""
        earlier = None if self.before is None else self.before.best
        if self.measured is None or self.idle:
            return earlier
        return self if earlier is None or self.rank < earlier.rank else earlier

    @property
    def missed(self) -> str:
        """Why the attempt is not accepted, as a sentence without an end."""
        run = self.measured
        if run is None:
            return f"relative residual {self.residual:.1e}"
        if self.accepted:
            return f"torques are off by about {self.ripple:.0e} of the largest"
        if run.error <= self.accuracy and run.energy_error > ENERGY:
            return (
                f"the energy balance of the simulation is off by {run.energy_error:.1e}, allowed "
                f"are {ENERGY:.0e}"
            )
        more = f"; {self.cause}" if self.cause else ""
        if run.error <= self.accuracy:
            return (
                "the equations of motion do not hold between the samples, and the feedback hides "
                f"how far the tool is off{more}"
            )
        return (
            f"verified error {run.error:.2e} is above {self.accuracy:.0e} "
            f"[rad, and m for each meter of reach]{more}"
        )


def judge(attempt: Attempt) -> Verdict:
    """The verdict on an attempt.

    Parameters
    ----------
    attempt : Attempt
        With ``verified``, but not ``measured``: one that `is_worth_a_simulation` has left out.

    Returns
    -------
    Verdict
    """
    further = Verdict.REFINE if _has_further_mesh(attempt) else Verdict.STOP
    if attempt.failure is not None:
        return further if attempt.fallback is None else Verdict.STOP
    if not attempt.verified:
        return Verdict.ACCEPT if attempt.small_residual else further
    if attempt.measured is None:
        return further
    if attempt.baseline or (attempt.accepted and attempt.ripple == 0.0):
        return Verdict.ACCEPT
    return Verdict.STOP if attempt.idle else further


def is_worth_a_simulation(attempt: Attempt) -> bool:
    """Whether a solution is simulated, or the next mesh is taken at once.

    The simulation of a long motion takes much longer than the method, and a feedback has hidden
    errors of the mesh before. Both wait for a small residual, while a finer mesh is left.
    """
    if attempt.small_residual:
        return True
    last = None if attempt.before is None else attempt.before.last_measured
    if last is not None and last.hidden:
        return attempt.number >= attempt.planned
    return not attempt.slow or attempt.number + 1 >= attempt.planned


def _has_further_mesh(attempt: Attempt) -> bool:
    """Whether a finer mesh is left: a planned one, or one more where that promises a solution."""
    following = attempt.number + 1
    if following < attempt.planned:
        return True
    if attempt.planned == 1 or following >= attempt.planned + RETRIES:
        return False
    last = attempt.last_measured
    promising = last is not None and (last.hidden or last.near)
    return promising and (attempt.best is None or not attempt.best.accepted)
