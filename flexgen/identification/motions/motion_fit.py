"""`fit_motion`: fit parameters to recorded torques and motions in the time domain (multiple
shooting).

    min over p and z_s:  sum_s |y_s(p, z_s) - y_s|^2 / sd^2,
    z_s = (state at the start, constant torques)

The record is cut into short segments s. In each of them the nonlinear model is simulated under the
recorded torques from a start state of its own: errors cannot grow over a long record, the drive
need not be known, and unstable or badly modeled slow motion does no harm. Start states and
constant torques are eliminated segment by segment; constant torques take effects outside of the
model, such as the offset of a second encoder. What no output shows is held by a wide prior.

Of a periodic motion the mean of the periods is fitted. Deviations are those of blocks, see
`flexgen.identification.estimator.covariance`: a block is a segment.

Source: H. Bock, 1983 (multiple shooting); G. Golub and V. Pereyra, SIAM J. Numer. Anal. 10(2),
1973 (elimination); L. Ljung, System Identification, 2nd ed. 1999, sec. 16.5 (validation,
whiteness).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.calls.deadline import is_over, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.rows import Column, Data, Part, Prose, Row, Table
from flexgen.identification.estimator.covariance import block_covariance
from flexgen.identification.estimator.minimize import Minimum, Search, minimize
from flexgen.identification.estimator.problem import Sums
from flexgen.identification.estimator.residuals import whiteness
from flexgen.identification.estimator.status import status_of_end
from flexgen.identification.estimator.validation import Errors, fails_elsewhere
from flexgen.identification.experiments.experiment import largest_rate
from flexgen.identification.records.description import Description, Recording, read_description
from flexgen.identification.responses.content import parameter_table
from flexgen.identification.responses.graybox import SMALL_ERROR, weak_directions
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.parameters import DELAY, ParameterVector, is_of_sensor
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import Estimated, FitStatus
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.simulation.integration.segments import Segments

STEP = 1e-5  # of differences in the parameters, mostly logarithms
# deviation of a start state from its first value, over its scale: what no output shows stays
FAR = 1e3
RANK = 1e-7  # of singular values of start states that a segment determines, relative
ROUNDS = 3  # of fits with deviations from the residuals of the last one
INNER = 3  # steps for the start states at each set of parameters
STABLE = 0.5  # integration step times the fastest eigenvalue
DISTANCE = 0.01  # standard deviations from the minimum where the search ends
LEAST_SEGMENTS = 4
POORLY_EXPLAINED = 50.0  # %: a fit below it is a model error
# part of the lags of white residuals within the 99 % band: less has a probability below 1e-4
WHITE = 0.85


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class MotionFit(Estimated):
    """Parameters from recorded motions; see also `Estimated`.

    Parameters
    ----------
    rms : tuple of float
        Of the residuals of each output: motor angles [rad, motor side], then link encoders.
    fit_percent : tuple of float
        ``100 (1 - |y - y_model| / |y - line|)`` of each output; line: the best straight line of
        each segment.
    held_out_percent : tuple of float
        The same on recordings that were not fitted; empty: none.
    white : tuple of float
        Part of the autocorrelations of the residuals of each output (20 lags) within the 99 % band
        of white noise.
    weak : tuple of str
        Sentences on directions that the data do not determine.
    segments, iterations : int
    wall_s : float [s]
    notes : tuple of str
        What was done to the recordings, as sentences.

    Examples
    --------
    >>> from pathlib import Path
    >>> from flexgen.identification.records.recording_writer import RecordingWriter
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    >>> # simulated in place of a robot
    >>> writer = RecordingWriter(Path("recorded"), plan, flexgen.read("elbow"))
    >>> experiment = flexgen.measure(plan, raw=writer)
    >>> found = flexgen.fit_motion("elbow", writer.finish(), free=["stiffness"])
    >>> [f"{percent:.0f} %" for percent in found.fit_percent]
    ['100 %', '100 %']
    """

    rms: tuple[float, ...]
    fit_percent: tuple[float, ...]
    held_out_percent: tuple[float, ...]
    white: tuple[float, ...]
    weak: tuple[str, ...] = field()
    segments: int
    iterations: int
    wall_s: float
    notes: tuple[str, ...] = ()

    def content(self) -> tuple[Part, ...]:
        """Status and figures of the fit, the parameters, and how the outputs are explained."""
        status = self.status
        own = ("rms", "fit_percent", "held_out_percent", "white", "weak", "notes")
        return (
            Prose(f"{self.vector.model.name}: {status}", is_title=True),
            Data("model", self.vector.model.name),
            Row("status", str(status), "", "status"),
            Row("segments", self.segments, "", "segments"),
            Row("iterations", self.iterations, "", "iterations"),
            Row("time of the fit", self.wall_s, "s", "wall_s"),
            Prose(f"{status.sentence} {status.advice}", "status"),
            parameter_table(self),
            self._outputs(),
            *(Prose(f"{line}.", "weak") for line in self.weak),
            *(Prose(f"{line}.", "notes") for line in self.notes),
            *(Data(name, getattr(self, name)) for name in own),
        )

    def _outputs(self) -> Table:
        """Residuals of motor angles and link encoders, and the part of them that is explained."""
        columns = [Column("output", key="output"), Column("residual rms"), Column("fit, %")]
        columns += [Column("white lags, %")]
        motors = [motor.name for motor in self.vector.model.motors]
        links = [f"link encoder {k}" for k in range(1, len(self.rms) - len(motors) + 1)]
        white = [100 * part for part in self.white]
        cells = [[*motors, *links], self.rms, self.fit_percent, white]
        if self.held_out_percent:
            columns += [Column("held out, %")]
            cells += [self.held_out_percent]
        return Table(tuple(columns), tuple(zip(*cells, strict=True)), "Outputs")

    def __repr__(self) -> str:
        fit = ", ".join(f"{value:.1f} %" for value in self.fit_percent)
        return (
            f"<MotionFit {self.vector.model.name}: {self.status}, fit {fit}, {self.segments} "
            "segments>"
        )


class MotionRecord:
    """A recording, or the mean of its periods followed by one more of them; names as in
    `Recording`.
    """

    def __init__(self, data: Description, recording: Recording) -> None:
        root = data.root
        self.t = recording.t
        self.tau_m = recording.tau_m
        self.q_m = recording.q_m
        self.signals = recording.signals
        self.own = len(self.t)  # samples at which a segment may begin
        if "period_s" not in root:
            return
        samples = round(root.number("period_s", above=0.0) / recording.sample_s)
        first = samples * (root.whole("transients", 0, 1000) if "transients" in root else 0)
        periods = (len(self.t) - first) // samples
        if samples < 2 or periods < 1:
            raise ArgumentError(
                f"{recording.file}: given {len(self.t)} samples, expected a whole period"
            )

        def mean(x: np.ndarray) -> np.ndarray:
            one = x[first : first + periods * samples].reshape(periods, samples, -1).mean(axis=0)
            return np.vstack([one, one])

        self.tau_m = mean(self.tau_m)
        self.q_m = mean(self.q_m)
        self.signals = mean(self.signals)
        self.t = recording.sample_s * np.arange(2 * samples)
        self.own = samples


class Shooting:
    """Residuals of all segments, and their sums with start states and constants eliminated."""

    def __init__(self, vector: ParameterVector, data: Description, segment_s: float) -> None:
        self.vector = vector
        self.model = vector.model
        self.local = LocalModel(vector.model, vector.of_model)
        recordings = [MotionRecord(data, recording) for _, recording in data.recordings]
        self.sample_s = data.recordings[0][1].sample_s
        self.samples = round(segment_s / self.sample_s)
        if self.samples < 4:
            raise ArgumentError(
                f"segment_s: given {segment_s} s, expected at least 4 samples of "
                f"{self.sample_s:.3g} s"
            )
        hold = data.root.choice("hold", ("zoh", "none"))
        self.zoh = hold == "zoh"
        self.delay = data.root.number("delay_s", 0.0, least=0.0)
        self.rows, self.measured = self._outputs(data, recordings)
        rate = largest_rate(self.local, recordings[0].q_m[:1])
        self.steps = max(1, math.ceil(rate * self.sample_s / STABLE))
        rows = np.hstack([self.rows, np.zeros_like(self.rows)])
        self.simulate = Segments(self.local.rate, rows, self.sample_s, self.steps)
        self.starts = [(r, k) for r, run in enumerate(recordings) for k in self._begins(run)]
        if len(self.starts) < LEAST_SEGMENTS:
            raise ArgumentError(
                f"segment_s: given {segment_s} s, which makes {len(self.starts)} segments, "
                f"expected at least {LEAST_SEGMENTS}: take shorter ones"
            )
        self._curves = [self._curve(run) for run in recordings]
        self._times = [run.t[0] for run in recordings]
        window = np.arange(self.samples + 1)
        # (segments, samples + 1, n_y)
        self.y = np.array([self.measured[r][k + window] for r, k in self.starts])
        self.z = np.hstack([self._start_states(), np.zeros((len(self.starts), self.model.n_m))])
        self.sd = np.maximum(np.std(self.y, axis=(0, 1)), 1e-300)
        self.scale = self._scales()
        self.first = self.z
        # what start states explain, see `parts`
        self.Q = np.zeros((len(self.starts), self.y[0].size, 0))

    def _outputs(
        self, data: Description, recordings: Sequence[MotionRecord]
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Rows of the outputs in y, and their records: motors, then link encoders."""
        names = [c.name for c in self.model.coordinates]
        of = {name: sensor for sensor in self.model.sensors for name in sensor.channels}
        used = [c for c, name in enumerate(data.sensors) if of[name].type == "link_encoder"]
        others = [name for name in data.sensors if of[name].type != "link_encoder"]
        if others:
            raise ArgumentError(
                f"signals: given {', '.join(others)}, expected link encoders only; leave others "
                "out"
            )
        links = np.zeros((len(used), self.model.dof))
        for row, c in zip(links, used, strict=True):
            row[names.index(of[data.sensors[c]].place)] = 1.0
        rows = np.vstack([self.local.motor_rows, links])
        delays = np.array([of[data.sensors[c]].delay_s for c in used])
        # samples that the last segment leaves
        self.late = math.ceil(delays.max(initial=0.0) / self.sample_s - 1e-9)
        return rows, [
            np.hstack([run.q_m, remove_delays(run.t, run.signals[:, used], delays)])
            for run in recordings
        ]

    def _begins(self, run: MotionRecord) -> range:
        return range(0, min(run.own, len(run.t) - self.samples - self.late), self.samples)

    def _curve(self, run: MotionRecord) -> object:
        """The torques between the samples: held, or a quintic spline."""
        return run.tau_m if self.zoh else make_interp_spline(run.t, run.tau_m, k=5)

    def _start_states(self) -> np.ndarray:
        """Joints as the motors, springs at rest; speeds by differences."""
        model = self.model
        out = np.zeros((len(self.starts), 2 * self.model.dof))
        n_m = model.n_m
        q = self.y[:, 0, :n_m]
        v = (-3 * self.y[:, 0, :n_m] + 4 * self.y[:, 1, :n_m] - self.y[:, 2, :n_m]) / (
            2 * self.sample_s
        )
        for at, motors in ((0, q), (model.dof, v)):
            out[:, [at + i for i in model.i_g]] = motors @ np.linalg.inv(model.eta).T
            out[:, at + model.n_a : at + model.dof] = motors[:, list(model.i_m)]
        return out

    def _scales(self) -> np.ndarray:
        """Sizes of the entries of z, for differences: angles, speeds, torques."""
        n = self.model.dof
        angle = np.full(n, max(float(np.std(np.diff(self.y, axis=1))), 1e-9))
        torque = np.maximum(
            np.std(np.vstack([self._torque(0.0)[:, :, 0].reshape(-1, self.model.n_m)]), axis=0),
            1e-9,
        )
        return np.concatenate([angle, angle / self.sample_s, torque])

    def _torque(self, delay: float) -> np.ndarray:
        """Torques of all segments (segments, samples * steps, 3, n_m)."""
        h = self.sample_s / self.steps
        nodes = h * (np.arange(self.samples * self.steps)[:, None] + np.array([0.0, 0.5, 1.0]))
        out = np.empty((len(self.starts), *nodes.shape, self.model.n_m))
        for s, (r, k) in enumerate(self.starts):
            curve = self._curves[r]
            at = k * self.sample_s + nodes - delay
            if isinstance(curve, np.ndarray):
                middle = np.broadcast_to(at[:, 1:2], at.shape)  # one value within a step
                index = np.floor(middle / self.sample_s).astype(int)
                out[s] = curve[np.clip(index, 0, len(curve) - 1)]
            else:
                last = self._times[r] + self.sample_s * (len(self.measured[r]) - 1)
                instants = np.clip(self._times[r] + at, self._times[r], last)
                out[s] = curve(instants)  # type: ignore[operator]
        return out

    def _of(self, x: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """Parameters of the model, delay, and torque constants (n_m,) at x."""
        named = self.vector.named(x)
        drive = self.vector.drive_at(x, Drive(0.0, self.delay))
        constants = np.array(drive.torque_constants or (1.0,) * self.model.n_m)
        return np.array([named[name] for name in self.local.names]), drive.delay_s, constants

    def _run(self, points: Sequence[np.ndarray], z: Sequence[np.ndarray]) -> np.ndarray:
        """Outputs (points, segments, samples + 1, n_y) for parameters x and segment unknowns z of
        each point.
        """
        count = len(self.starts)
        n = 2 * self.model.dof
        found = [self._of(x) for x in points]
        delays = sorted({delay for _, delay, _ in found})
        inputs = np.concatenate([self._torque(delay) for delay in delays])
        constants = {tuple(c.tolist()) for _, _, c in found}
        if len(constants) > 1 or not np.all(np.array(next(iter(constants))) == 1.0):
            inputs = np.concatenate([self._torque(d) * c for _, d, c in found])
            sets = np.arange(len(points) * count)
        else:
            sets = np.concatenate(
                [delays.index(d) * count + np.arange(count) for _, d, _ in found]
            )
        flat = np.concatenate(z)
        parameters = np.repeat([p for p, _, _ in found], count, axis=0)
        out = self.simulate(flat[:, :n], inputs, sets, flat[:, n:], parameters)
        return out.reshape(len(points), count, *out.shape[1:])

    def _weight(self, y: np.ndarray) -> np.ndarray:
        """Residuals (..., segments, (samples + 1) n_y)."""
        r = (y - self.y) / self.sd
        return np.asarray(r.reshape(*r.shape[:-2], -1))

    def _by_z(self, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals at z, with those of its prior, and derivatives in z over its scale (segments,
        residuals, n_z).
        """
        n_z = z.shape[1]
        moved = [z + STEP * self.scale * (np.arange(n_z) == k) for k in range(n_z)]
        found = self._weight(self._run([x] * (n_z + 1), [z, *moved]))
        prior = np.broadcast_to(np.eye(n_z) / FAR, (len(z), n_z, n_z))
        r = np.hstack([found[0], (z - self.first) / (FAR * self.scale)])
        return r, np.concatenate([np.moveaxis(found[1:] - found[0], 0, -1) / STEP, prior], axis=1)

    def errors(self, r: np.ndarray) -> np.ndarray:
        """Residuals of the outputs (segments, samples + 1, n_y), over their deviations."""
        return r[:, : self.y[0].size].reshape(self.y.shape)

    def settle(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals with the best start states, and their derivatives in these."""
        for _ in range(INNER):
            r, Jz = self._by_z(x, self.z)
            size = np.linalg.norm(Jz, axis=1)[:, None, :]
            U, values, Vt = np.linalg.svd(Jz / size, full_matrices=False)
            inverse = np.where(
                values > RANK * values[:, :1], 1.0 / np.maximum(values, 1e-300), 0.0
            )
            along = np.einsum("snk,sn->sk", U, r) * inverse
            self.z = self.z - np.einsum("skj,sk->sj", Vt, along) / size[:, 0] * self.scale
        return self._by_z(x, self.z)

    def cost(self, x: np.ndarray) -> float:
        """Sum of the squares at x."""
        r, _ = self.settle(x)
        return float((r**2).sum())

    def parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (segments, N) and their derivatives in x with z eliminated (segments, N,
        n).
        """
        r, Jz = self.settle(x)
        moved = [x + STEP * (np.arange(len(x)) == k) * self._unit(k) for k in range(len(x))]
        base = self._weight(self._run([x, *moved], [self.z] * (len(x) + 1)))
        J = np.moveaxis(base[1:] - base[0], 0, -1) / (
            STEP * np.array([self._unit(k) for k in range(len(x))])
        )
        self.Q = span_of(Jz)
        J = np.concatenate([J, np.zeros((len(J), Jz.shape[2], J.shape[2]))], axis=1)
        return r, J - self.Q @ (self.Q.swapaxes(-1, -2) @ J)

    def _unit(self, k: int) -> float:
        """Size of a change of a parameter: 1 for logarithms, a sample for the delay."""
        unknown = self.vector.unknowns[k]
        return (
            1.0
            if unknown.scale == "log"
            else self.sample_s
            if unknown.name == DELAY
            else max(abs(unknown.start), 1e-3)
        )

    def sums(self, x: np.ndarray) -> Sums:
        """Sum of the squares and normal equations."""
        r, J = self.parts(x)
        return float((r**2).sum()), np.einsum("snk,sn->k", J, r), np.einsum("snk,snl->kl", J, J)


def remove_delays(t: np.ndarray, signals: np.ndarray, delays: np.ndarray) -> np.ndarray:
    """The signals (samples, channels) at the times of the motion: each is read its delay later."""
    if not delays.any():
        return signals
    later = np.minimum(t[:, None] + delays, t[-1])
    return np.stack(
        [make_interp_spline(t, x, k=3)(at) for x, at in zip(signals.T, later.T, strict=True)],
        axis=1,
    )


def span_of(Jz: np.ndarray) -> np.ndarray:
    """Orthonormal columns (segments, residuals, n_z) that span those of Jz; zero where Jz has less
    rank.
    """
    U, values, _ = np.linalg.svd(
        Jz / np.maximum(np.linalg.norm(Jz, axis=1), 1e-300)[:, None, :], full_matrices=False
    )
    return np.asarray(U * (values > RANK * values[:, :1])[:, None, :])


@checked_types
@reported("fit_motion")
def fit_motion(
    model: RobotModel | str | Path | None,
    recordings: str | Path,
    *,
    free: Sequence[str],
    fixed: Sequence[str] = (),
    segment_s: float = 0.05,
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, float] | None = None,
    validate: str | Path | None = None,
    time_limit: float | None = None,
    progress: Choice = None,
) -> MotionFit:
    """Fit parameters of a model to recorded torques and motions.

    Parameters
    ----------
    model : RobotModel, str, Path or None
        None: that of the description.
    recordings : str or Path
        See `flexgen.identification.records.description`; motors and link encoders are used.
    free, fixed, start, bounds, priors
        See `flexgen.identification.responses.parameters.ParameterVector`; also ``delay`` and
        ``torque_constant``.
    segment_s : float [s]
        Length of the segments: some periods of the lowest resonance.
    validate : str or Path, optional
        A description of recordings that are not fitted.
    time_limit : float, optional [s]
        Then, or after Ctrl-C, the result is the best step so far, with the status ``time limit``
        or ``interrupted``. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    MotionFit

    Raises
    ------
    ArgumentError
        The recordings cannot be used, or a name is unknown.
    SolverError
        The simulation with the start values is not finite.

    Examples
    --------
    >>> from pathlib import Path
    >>> from flexgen.identification.records.recording_writer import RecordingWriter
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    >>> # file: 7.5e6
    >>> robot = flexgen.read(
    ...     "elbow", overrides={"element.upper.dof.q1.gear.spring.stiffness": 6e6}
    ... )
    >>> # simulated in place of a robot
    >>> writer = RecordingWriter(Path("recorded"), plan, flexgen.read("elbow"))
    >>> experiment = flexgen.measure(plan, robot, raw=writer)
    >>> found = flexgen.fit_motion("elbow", writer.finish(), free=["stiffness"])
    >>> f"{found.values['q1.stiffness']:.2e} N m/rad"
    '6.00e+06 N m/rad'
    """
    began = time.perf_counter()
    data = read_description(recordings)
    robot = (
        data.model if model is None else model if isinstance(model, RobotModel) else read(model)
    )
    vector = ParameterVector(robot, free, fixed=fixed, start=start, bounds=bounds, priors=priors)
    if any(is_of_sensor(name) for name in vector.names):
        raise ArgumentError(
            "free: given the delay of a sensor, which frequency responses can show: take "
            "'flexgen frf' and 'identify' without --segments, and state it as delay_s of the "
            "[[sensor]]"
        )
    tell = progress if callable(progress) else None
    with limit_fit("fit_motion", time_limit, tell):
        shooting = Shooting(vector, data, segment_s)
        fit = _minimize(shooting, vector, tell)
        reason = reason_of_end()
    r, J = shooting.parts(fit.x)
    covariance = block_covariance(J, r, range(len(J)), np.diag(vector.prior_sd**-2.0))
    errors = shooting.errors(r) * shooting.sd
    percent = fit_percent_of(shooting.y, errors)
    white = whiteness(errors, shooting.Q[:, : errors[0].size])
    rms = np.sqrt((errors**2).mean(axis=(0, 1)))
    held_out: tuple[float, ...] = ()
    status = status_of_end(motion_status(fit, percent, white), reason)
    if validate is not None and not reason:
        held_out, held_out_rms = _validate(vector, fit.x, validate, segment_s, shooting.sd)
        if status.agrees and fails_on_others(percent, held_out, held_out_rms / rms):
            status = FitStatus.POORLY_VALIDATED
    return MotionFit(
        vector=vector,
        x=fit.x,
        formal_covariance=covariance,
        status=status,
        rms=tuple(rms.tolist()),
        fit_percent=percent,
        held_out_percent=held_out,
        white=white,
        weak=weak_directions(vector, fit.A / 2),
        segments=len(shooting.starts),
        iterations=fit.iterations,
        wall_s=time.perf_counter() - began,
        notes=data.notes,
        source=str(recordings),
    )


def _minimize(
    shooting: Shooting, vector: ParameterVector, tell: Callable[[str], None] | None
) -> Minimum:
    """The fit; the deviations of the outputs follow from the residuals of the last one."""
    x = vector.start
    fit = None
    for k in range(ROUNDS):
        if fit is not None and is_over():
            break
        if tell is not None:
            tell(f"fit {k + 1} of {ROUNDS}: {len(shooting.starts)} segments")
        # residuals are as large as their deviations: the prior holds what they cannot show
        for _ in range(INNER):
            r, _ = shooting.settle(x)
            each = (shooting.errors(r) ** 2).mean(axis=(0, 1))
            shooting.sd = shooting.sd * np.sqrt(np.maximum(each, 1e-300))
        problem = vector.problem(shooting.sums, shooting.cost)
        fit = minimize(problem, x, Search(DISTANCE))
        x = fit.x
    assert fit is not None
    return fit


def motion_status(fit: Minimum, percent: tuple[float, ...], white: tuple[float, ...]) -> FitStatus:
    """By convergence, by the size of the residuals, and by whether they are white, as noise is."""
    if not fit.converged:
        return FitStatus.NOT_CONVERGED
    if fit.at_bound.any():
        return FitStatus.AT_BOUND
    left = [fit_percent for lags, fit_percent in zip(white, percent, strict=True) if lags < WHITE]
    if min(percent) < POORLY_EXPLAINED or min(left, default=100.0) < 100 * (1 - SMALL_ERROR):
        return FitStatus.MODEL_ERROR
    return FitStatus.SMALL_ERROR if left else FitStatus.FITTED


def fails_on_others(
    percent: tuple[float, ...], held_out: tuple[float, ...], ratio: np.ndarray
) -> bool:
    """Whether recordings that were not fitted are explained badly, or much worse than those that
    were.

    Worse by its size and relative to the motion: larger motions have larger errors, smaller ones
    more noise.
    """
    left, left_there = (1 - np.array(x) / 100 for x in (percent, held_out))
    fitted = Errors(np.ones(len(left)), left)
    worse = fails_elsewhere(fitted, Errors(ratio, left_there), SMALL_ERROR)
    return bool(worse.any() or min(held_out) < POORLY_EXPLAINED)


def _validate(
    vector: ParameterVector, x: np.ndarray, path: str | Path, segment_s: float, sd: np.ndarray
) -> tuple[tuple[float, ...], np.ndarray]:
    """Fit in percent and rms of the errors of recordings that were not fitted; their start states
    are free.
    """
    other = Shooting(vector, read_description(path), segment_s)
    other.sd = sd  # of the fit: with larger deviations the prior would hold start states
    other.settle(x)
    r, _ = other.settle(x)
    errors = other.errors(r) * other.sd
    return fit_percent_of(other.y, errors), np.sqrt((errors**2).mean(axis=(0, 1)))


def fit_percent_of(y: np.ndarray, errors: np.ndarray) -> tuple[float, ...]:
    """``100 (1 - |e| / |y - straight line|)`` of each output: slow motion does not count for the
    model.
    """
    n = np.arange(y.shape[1], dtype=float)
    A = np.stack([np.ones_like(n), n], axis=1)
    away = y - np.einsum("ab,sbj->saj", A @ np.linalg.pinv(A), y)
    return tuple(
        (
            100 * (1 - np.linalg.norm(errors, axis=(0, 1)) / np.linalg.norm(away, axis=(0, 1)))
        ).tolist()
    )
