"""Best solution so far when the time limit of a solve ends or Ctrl-C interrupts it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from flexgen.base.calls.deadline import OutOfTime
from flexgen.base.errors import SolverError
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import INTERRUPTED, Solution

ADVICE = (
    "allow more with --time-limit SECONDS (time_limit=), or take a coarser --mesh, a shorter "
    "move or --method lq"
)


@dataclass
class BestSolution:
    """The best solution so far, and what was tried.

    Attributes
    ----------
    solution : Solution or None
        That with the least verified error; before a verification has ended: the first one.
    error : float
        Its verified error; infinite before a verification has ended.
    tried : list of str
        What failed or missed the tolerance.
    accepted : Solution or None
        A verified one, whose torques a finer mesh may still improve.
    """

    solution: Solution | None = None
    error: float = np.inf
    tried: list[str] = field(default_factory=list)
    accepted: Solution | None = None

    def keep(self, solution: Solution, error: float = np.inf) -> None:
        """Keep a solution that is the first one or better than the one before."""
        if self.solution is None or error < self.error:
            self.solution = solution
            self.error = error

    def finish(self, stage: str | None, limit: float | None) -> Solution:
        """The best solution so far, with the reason why it ends here.

        Parameters
        ----------
        stage : str or None
            Stage in which the time limit ended; None: Ctrl-C.
        limit : float or None [s]
            The time limit.

        Raises
        ------
        SolverError
            The time limit has ended, and there is no solution.
        KeyboardInterrupt
            Ctrl-C, and there is no solution.
        """
        if self.accepted is not None and stage is not None:
            return self.accepted
        reason = (
            INTERRUPTED if stage is None else f"the time limit of {limit:g} s ended in: {stage}"
        )
        if self.solution is None:
            if stage is None:
                raise KeyboardInterrupt
            before = f"; tried before: {'; '.join(self.tried)}" if self.tried else ""
            raise SolverError(f"no solution: {reason}{before}; {ADVICE}")
        measured = (
            "its error was not verified"
            if np.isinf(self.error)
            else f"its verified error is {self.error:.3g}"
        )
        warning = f"the solution is the best so far, {measured}: {reason}"
        details = {
            **self.solution.details,
            **({"attempts": list(self.tried)} if self.tried else {}),
        }
        return replace(
            self.solution,
            status=Status.TOLERANCE_NOT_MET,
            stopped=reason,
            warnings=(*self.solution.warnings, warning),
            details=details,
        )


def stage_of(error: BaseException, interrupted: bool) -> str | None:
    """The stage of an error by which a solve ends early, None for Ctrl-C; raises every other error
    again.
    """
    if interrupted or isinstance(error, KeyboardInterrupt):
        return None
    if isinstance(error, OutOfTime):
        return str(error)
    raise error
