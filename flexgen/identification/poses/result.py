"""Result of a calibration: numbers with their accuracy, errors before, after and on poses that
were not fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.counts import count_of
from flexgen.base.checks.type_checks import checked_result
from flexgen.base.errors import ArgumentError
from flexgen.base.registry import provides
from flexgen.base.rows import Part
from flexgen.base.spec.arguments import seed_of
from flexgen.base.spec.variants import with_variant
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.score import Limit
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.estimator.validation import WORSE
from flexgen.identification.poses.components import Tilt, tilt_slopes
from flexgen.identification.poses.content import content_of_calibration
from flexgen.identification.poses.fit import MEDIAN_LENGTH
from flexgen.identification.poses.model_file import VARIANT, changes_of
from flexgen.identification.poses.parameters import FRAME, Unknown
from flexgen.identification.poses.poses import LARGEST, StaticPoses
from flexgen.identification.poses.score_test import Suspect
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tree import Tree
from flexgen.model.elements import RobotModel
from flexgen.model.new_file import text_of_model, with_overrides, write_model_text
from flexgen.model.reader import read

CANDIDATES = 300  # random poses from which new ones are chosen
# of the prior's standard deviation: below it, the measurements determine a number
DETERMINED = 0.3


def write_calibrated(
    path: str | Path, model: RobotModel, changes: dict[str, Any], source: str, dry: bool = False
) -> Path:
    """Write the model file with a further variant `VARIANT`; ``dry``: only check.

    Raises
    ------
    ArgumentError
        The model has no file, or one with this variant.
    """
    text, folder = text_of_model(model.file)
    sets = with_overrides(model, changes)
    new = with_variant(text, Path(model.file).name, VARIANT, sets, source, model.variant)
    return write_model_text(path, new, folder, VARIANT, dry=dry)


@provides("Calibration.check_file")
def check_file(path: str | Path, model: RobotModel) -> None:
    """Check before a fit that `Calibration.write` can write the new model file; errors as
    there.
    """
    write_calibrated(path, model, {}, "check", dry=True)


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class Calibration(FitResult):
    """A calibrated model.

    Parameters
    ----------
    nominal : RobotModel
        The model as it was.
    poses : StaticPoses
    unknowns : tuple of Unknown
        The free numbers: names, units, prior means and standard deviations.
    x, covariance : array (p,), (p, p)
        Their values, and the covariance; zero for a compliance that is held at its lower bound.
    errors_before, errors : array (N, k) [m]
        Distances of the trackers from the model's points: of the nominal model, where only the
        frame of the measurement, the trackers and the elements without a known place are fitted,
        and of the calibrated one.
    errors_held_out : array (N, k) [m] or None
        The same of fits without the pose, in turn for each fold.
    errors_seen : array (N, k) [m] or None
        The same as `errors_held_out` where the other trackers of the pose are seen; None: nothing
        is shared.
    sag : array (N, k) [m]
        Distances of the trackers from where they were without deflections.
    tilt : Tilt or None
        What changes from pose to pose and moves several trackers together.
    converged : bool
    warnings : tuple of str
    kept : tuple of str
        Names of the numbers that the poses do not determine, which keep the value of the model
        file; their standard deviations are those of the priors.
    causes : tuple of Suspect
        Numbers of the model that are not free, scales, and gravity, that the poses contradict;
        the one that explains most of the errors first. See the module
        `flexgen.identification.poses.score_test`; and free numbers that are wrong by more than
        tolerances of a data sheet.
    not_visible : tuple of Limit
        A wrong mass or center of mass of the payload and a scale of the positions that the poses
        do not show up to a limit.
    ended : str
        ``"time limit"`` or ``"interrupted"`` where the search was ended from outside: the numbers
        are those of its best step. Else empty.

    Examples
    --------
    >>> import numpy as np
    >>> robot = flexgen.read(
    ...     "elbow", overrides={"sensor": [{"name": "p", "type": "tracker", "unit": "m"}]}
    ... )
    >>> q = np.random.default_rng(0).uniform(-1.5, 1.5, (30, 2))
    >>> points = flexgen.tracker_positions(robot, q)
    >>> found = flexgen.calibrate(robot, flexgen.StaticPoses(q, points), free=["zeros"])
    >>> float(found.errors.max()) < 1e-6, "q1.zero" in found.values
    (True, True)
    """

    nominal: RobotModel
    poses: StaticPoses
    unknowns: tuple[Unknown, ...]
    x: np.ndarray
    covariance: np.ndarray
    errors_before: np.ndarray
    errors: np.ndarray
    errors_held_out: np.ndarray | None
    errors_seen: np.ndarray | None
    sag: np.ndarray
    tilt: Tilt | None
    converged: bool
    warnings: tuple[str, ...]
    ended: str = ""
    kept: tuple[str, ...] = ()
    causes: tuple[Suspect, ...] = ()
    not_visible: tuple[Limit, ...] = ()

    def __repr__(self) -> str:
        return f"<Calibration {self.nominal.title}: {self.sentence}>"

    __str__ = __repr__

    @property
    def sentence(self) -> str:
        """The result in one line."""
        held = self.errors_held_out
        proof = (
            ""
            if held is None
            else f", {1e3 * np.nanmean(held):.3g} mm on poses that were not fitted"
        )
        early = f"{self.ended}, best step of the search: " if self.ended else ""
        return (
            f"{early}{len(self.poses)} poses, {len(self.unknowns)} numbers; "
            f"mean error {1e3 * np.nanmean(self.errors_before):.3g} mm before, "
            f"{1e3 * np.nanmean(self.errors):.3g} mm after{proof}"
        )

    @property
    def problem(self) -> str:
        """Why the result cannot be used; empty where it can."""
        if self.ended:
            return f"{self.ended}: the numbers are those of the best step of the search"
        return (
            ""
            if self.converged
            else "calibration: the search did not end at a minimum; free fewer groups"
        )

    @cached_property
    def fitted(self) -> tuple[FittedNumber, ...]:
        """The numbers with their standard deviations, which are 0 where a bound holds a
        compliance.
        """
        deviations = np.sqrt(np.diag(self.covariance)).tolist()
        return tuple(
            FittedNumber(u.name, float(x), u.unit, sd, is_determined=0.0 < sd < DETERMINED * u.sd)
            for u, x, sd in zip(self.unknowns, self.x, deviations, strict=True)
        )

    @cached_property
    def status(self) -> FitStatus:
        """Of the search, and of the errors on poses that were not fitted, where there are some."""
        if self.ended:
            return FitStatus.of_value(self.ended)
        if not self.converged:
            return FitStatus.NOT_CONVERGED
        if self.errors_held_out is None:
            return FitStatus.NOT_CHECKED
        there = float(np.nanmean(self.errors_held_out))
        is_worse = there > WORSE * float(np.nanmean(self.errors))
        return FitStatus.POORLY_VALIDATED if is_worse else FitStatus.FITTED

    @property
    def sd(self) -> dict[str, float]:
        """Standard deviations by name; 0 where a bound holds a compliance."""
        return {number.name: number.sd or 0.0 for number in self.fitted}

    @property
    def determined(self) -> dict[str, bool]:
        """Whether the measurements determine a number: its standard deviation is below 0.3 of that
        of the prior.
        """
        return {number.name: number.is_determined for number in self.fitted}

    @property
    def changes(self) -> dict[str, Any]:
        """Keys of the model file with their new values."""
        return changes_of(self.nominal, self._numbers) | self._not_measured

    @property
    def _not_measured(self) -> dict[str, Any]:
        """The key of the model file that names the numbers that keep its value, where it
        changes.
        """
        kept = {u.name_in_file for u in self.unknowns if u.name in self.kept}
        measured = {u.name_in_file for u in self.unknowns} - kept
        before = self.nominal.not_measured
        names = [x for x in before if x not in measured]
        names += [u.name_in_file for u in self.unknowns if u.name_in_file in kept - {*before}]
        return {} if tuple(names) == before else {"not_measured": names}

    @property
    def _numbers(self) -> Numbers:
        """All numbers of the calibrated tree."""
        return Numbers.of(Tree(self.nominal), self.unknowns, self.x)

    @property
    def model(self) -> RobotModel:
        """The calibrated model, in the world of the nominal one; `frame` says where the
        measurement sees it.

        Raises
        ------
        ArgumentError
            The model is not from a file with ``[[element]]`` tables.
        """
        if not self.nominal.file:
            raise ArgumentError(
                "calibration: given a model without a file, expected one that was read from a "
                ".toml file"
            )
        changes = with_overrides(self.nominal, self.changes)
        return read(self.nominal.file, self.nominal.variant or None, overrides=changes)

    @property
    def frame(self) -> np.ndarray:
        """Pose (6,) of the world in the frame of the measurement: shift [m], angles about x, new
        y, new z [rad].
        """
        if not self.poses.is_measured:
            return np.zeros(6)  # fixed points are in the world of the robot
        return np.array(
            [self.values[f"{FRAME}.{name}"] for name in ("x", "y", "z", "rx", "ry", "rz")]
        )

    def predict(self, commands: np.ndarray) -> np.ndarray:
        """Positions (N, k, 3) [m] of the trackers in the frame of the measurement, at commands (N,
        n_g) [rad or m].
        """
        return (
            Statics(Tree(self.nominal), np.asarray(commands, dtype=float))
            .rest(self._numbers)
            .measured
        )

    def position_sd(self, commands: np.ndarray, measured: bool = False) -> np.ndarray:
        """Standard deviations of the axes of the positions that `predict` returns.

        ``sqrt(diag(J C J'))`` with the slopes J of the positions and the covariance C of all
        numbers, with that of the numbers that the poses do not determine. 95 % of true positions
        are within 1.96 of these; what the model does not contain counts only as far as it
        scatters the poses that were fitted.

        Parameters
        ----------
        commands : array (N, n_g) [rad or m]
        measured : bool
            Of positions that will be measured: with what changes from pose to pose, the noise of
            a point and the tilt.

        Returns
        -------
        array (N, k, 3) [m]

        Raises
        ------
        ArgumentError
            The commands have another shape.
        SolverError
            A pose has no static equilibrium.
        """
        given = np.asarray(commands, dtype=float)
        if given.ndim != 2 or given.shape[1] != self.nominal.n_g or not np.isfinite(given).all():
            raise ArgumentError(
                f"commands: given shape {given.shape}, expected finite numbers of shape "
                f"(N, {self.nominal.n_g})"
            )
        statics = Statics(Tree(self.nominal), given)
        numbers = self._numbers
        rest = statics.rest(numbers)
        J = statics.slopes(numbers, rest, self.unknowns)[0]
        variance = np.einsum("...i,ij,...j->...", J, self.covariance, J, optimize=True)
        if measured and self.tilt is not None:
            B = tilt_slopes(statics, numbers, rest, [self.tilt.element])[0]
            variance = variance + (B**2 @ self.tilt.tilt_rad**2).reshape(variance.shape)
            variance = variance + self.tilt.noise_m**2
        elif measured:
            errors = self.errors[np.isfinite(self.errors)]
            variance = variance + (np.median(errors) / MEDIAN_LENGTH) ** 2
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def propose_poses(
        self, count: int, candidates: np.ndarray | None = None, seed: int = 0
    ) -> np.ndarray:
        """Commands (count, n_g) of the poses whose measurement tells most: the least determinant
        of the covariance.

        Chosen one after the other among ``candidates`` (m, n_g), default: random ones within the
        range of the measured commands; check them for collisions and for what the sensor can see.

        Raises
        ------
        ArgumentError
            There are fewer candidates than poses to choose.

        Returns
        -------
        array (count, n_g) [rad or m]

        Source: V. V. Fedorov, Theory of Optimal Experiments, 1972 (D-optimal designs).
        """
        if not self.poses.is_measured:
            raise ArgumentError(
                "poses: given fixed points only, expected measured positions: new poses are "
                "chosen for positions that will be measured"
            )
        low = self.poses.commands.min(axis=0)
        high = self.poses.commands.max(axis=0)
        count_of("count", count, LARGEST)
        if candidates is None:
            candidates = np.random.default_rng(seed_of(seed)).uniform(
                low, high, (max(CANDIDATES, 3 * count), len(low))
            )
        if np.ndim(candidates) != 2 or np.shape(candidates)[1] != len(low):
            raise ArgumentError(
                f"candidates: given shape {np.shape(candidates)}, expected (m, {len(low)})"
            )
        if count > len(candidates):
            raise ArgumentError(
                f"count: given {count}, expected 1 to {len(candidates)}, the number of candidates"
            )
        statics = Statics(Tree(self.nominal), np.asarray(candidates, dtype=float))
        numbers = self._numbers
        J = statics.slopes(numbers, statics.rest(numbers), self.unknowns)[0].reshape(
            len(candidates), -1, len(self.x)
        )
        J = J / max(float(np.nanmedian(self.errors)), 1e-9)
        covariance = self.covariance.copy()
        chosen: list[int] = []
        for _ in range(count):
            inner = np.eye(J.shape[1]) + J @ covariance @ np.swapaxes(J, 1, 2)
            gain = np.linalg.slogdet(inner)[1]
            gain[chosen] = -np.inf
            best = int(np.argmax(gain))
            chosen.append(best)
            across = covariance @ J[best].T
            covariance -= across @ np.linalg.solve(inner[best], across.T)
        return np.asarray(candidates, dtype=float)[chosen]

    def write(self, path: str | Path, world: str = "robot") -> Path:
        """Write the model file with a further variant ``calibrated`` that sets the new numbers;
        the rest stays.

        Parameters
        ----------
        path : str or Path
            Read it as ``FILE@calibrated``.
        world : str
            ``"robot"``: the world of the model stays; ``"measurement"``: base and gravity are
            turned such that positions are those of the measurement.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError
            The model is not from a ``.toml`` file, or the file has this variant.
        """
        if world not in ("robot", "measurement"):
            raise ArgumentError(f"world: given {world!r}, expected 'robot' or 'measurement'")
        changes = changes_of(
            self.nominal, self._numbers, self.frame if world == "measurement" else None
        )
        changes |= self._not_measured
        source = f"{self.poses.source}: {self.sentence}"
        return write_calibrated(path, self.nominal, changes, source)

    def content(self) -> tuple[Part, ...]:
        """See `flexgen.identification.poses.content`."""
        return content_of_calibration(self)

    def _entries(self) -> dict[str, Any]:
        return self.to_dict()
