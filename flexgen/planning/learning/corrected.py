"""Corrected paths of a move and their inverse dynamics.

    y_cmd = y + d(t)          positions;    R_cmd = exp(d_R) R          orientations

The correction d is constant before and after a window that begins before the path and ends after
it, since the motion of elastic robots does: splines of degree 7 through its samples give the rates
that the inversion needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import grid, time_derivative
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.force.process_force import ProcessForce
from flexgen.paths.path import Path
from flexgen.runtime.inversion.path_inversion import Inversion

# Begin of the window before the path [s].
EARLY_S = 0.15
# End of the window after the path [s]: integral parts have settled under another load.
LATE_S = 1.5
DEGREE = 7  # of the spline through the corrections
FINER = (2, 4, 8, 16)  # samples in a period, at last
MESH_S = 1e-2  # length of the intervals of the inversion [s]


@dataclass(frozen=True, eq=False)
class _Samples:
    """A path without a correction: instants (n,) [s] at equal steps, the period [s], outputs, two
    rates of them, orientations, and the force on the tool.
    """

    time: np.ndarray
    period: float
    y: np.ndarray
    rates: tuple[np.ndarray, np.ndarray]
    R: np.ndarray | None
    force: np.ndarray | None


class CorrectedPath:
    """Corrected paths of a move, and their inverse dynamics with the emitted library.

    Parameters
    ----------
    equations : Equations
        Of springs and dampers, without states of hysteresis.
    move : Move
    model : RobotModel
        The model that is inverted, with all that it has.
    force : ProcessForce or None
        Of a process on the tool.
    tell : callable
        Takes lines of progress.
    early_s : float [s]
        Begin of the window before the path.
    """

    def __init__(
        self,
        equations: Equations,
        move: Move,
        model: RobotModel,
        force: ProcessForce | None,
        tell: Callable[[str], None],
        early_s: float = EARLY_S,
    ) -> None:
        self.equations = equations
        self.outputs = equations.model.output.size
        self.path = Path(equations, move)
        problem = InversionProblem(equations, self.path, force=force)
        _, self.period, self.samples_per_interval, self.n_pre, self.n_post = grid(problem, MESH_S)
        solvers = () if force is None else ("invert", "force")
        self.library = inversion_library(
            Equations(model), "lq", solvers, memory=True, progress=tell
        )
        count = int(np.ceil((self.path.duration + early_s + LATE_S) / self.period)) + 1
        self.time = -early_s + self.period * np.arange(count)
        self._reduction = Reduction(equations)
        self._given_force = force
        self._sampled = {1: self._sample(1)}

    @property
    def span(self) -> tuple[float, float]:
        """Begin and end of the inverted motion [s], with the motion before and after the path."""
        first = self.time[0] - self.n_pre * self.period
        return float(first), float(self.time[-1] + self.n_post * self.period)

    def _sample(self, finer: int) -> _Samples:
        """The path without a correction, with so many samples in a period."""
        period = self.period / finer
        time = self.time[0] + period * np.arange(finer * (len(self.time) - 1) + 1)
        sample = self.path.sample(time)
        force = self._given_force
        return _Samples(
            time,
            period,
            self._reduction.targets(sample),
            (sample.derivative(1), sample.derivative(2)),
            sample.R,
            None if force is None else force.on_output(self.equations.model, time),
        )

    def invert_finely(self, correction: np.ndarray) -> Inversion:
        """`invert` with shorter intervals until it converges, then with shorter periods, which
        reversals of joints with friction need.

        SolverError where it does not with intervals of one sample of the shortest period.
        """
        most = self.samples_per_interval
        parts = sorted({max(1, most // k) for k in (1, 2, 4, 8, most)}, reverse=True)
        for samples, finer in [*((part, 1) for part in parts), *((1, k) for k in FINER)]:
            found = self.invert(correction, samples, finer)
            if found.converged:
                return found
        raise SolverError(
            f"the inverse dynamics of the corrected path did not converge (relative residual "
            f"{found.residual_at_samples:.2g}): learn up to a lower frequency"
        )

    def invert(
        self, correction: np.ndarray, samples: int | None = None, finer: int = 1
    ) -> Inversion:
        """Motion and torques along the corrected path.

        ``correction`` (n, n_y) [m, rad] at ``time``; of a pose a rotation vector after the
        position. ``samples``: of an interval of the mesh; default: those of `MESH_S`.
        ``finer``: samples in a period. SolverError where the corrected path has no inverse.
        """
        if finer not in self._sampled:
            self._sampled[finer] = self._sample(finer)
        given = self._sampled[finer]
        y, dy, ddy = self._correct(correction, given)
        return self.library.invert(
            y,
            dy,
            ddy,
            period=given.period,
            q_start=self.path.q_start,
            n_pre=finer * self.n_pre,
            n_post=finer * self.n_post,
            samples_per_interval=samples or self.samples_per_interval,
            force=given.force,
        )

    def _correct(
        self, correction: np.ndarray, given: _Samples
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Samples of the corrected path and of its rates."""
        zero = [(order, np.zeros(correction.shape[1])) for order in range(1, (DEGREE + 1) // 2)]
        spline = make_interp_spline(self.time, correction, k=DEGREE, bc_type=(zero, zero))
        d, dd, ddd = (np.asarray(spline(given.time, order)) for order in range(3))
        dy, ddy = given.rates
        if given.R is None:
            moved = given.y + d, dy + dd, ddy + ddd
            return tuple(np.ascontiguousarray(x) for x in moved)  # type: ignore[return-value]
        turn = Rotation.from_rotvec(d[:, 3:])
        R = turn.as_matrix() @ given.R
        w = angular_velocity(d[:, 3:], dd[:, 3:]) + turn.apply(dy[:, 3:])
        y = np.hstack([given.y[:, :3] + d[:, :3], R.transpose(0, 2, 1).reshape(len(R), 9)])
        dw = time_derivative(w, given.period)
        return (
            np.ascontiguousarray(y),
            np.ascontiguousarray(np.hstack([dy[:, :3] + dd[:, :3], w])),
            np.ascontiguousarray(np.hstack([ddy[:, :3] + ddd[:, :3], dw])),
        )


def angular_velocity(r: np.ndarray, dr: np.ndarray) -> np.ndarray:
    """Angular velocity (n, 3) in the fixed frame of the rotation with rotation vector r and its
    rate dr (n, 3).
    """
    angle = np.linalg.norm(r, axis=1)[:, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    once = np.cross(r, dr)
    return dr + a * once + b * np.cross(r, once)
