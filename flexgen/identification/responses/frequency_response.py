"""Frequency responses from spectra: `frf`, with the covariance of noise and of everything that
changes with the input.

They are estimated by `flexgen.identification.responses.response_estimates`. With a reference that
is the same in each period this is the joint input-output method, G_yr G_ur^-1, without bias by
noise in closed loop. For a motion without period there is H1 = S_yu S_uu^-1 over windowed segments
(Welch's method), with bias.

Nonlinear distortion and friction change G from one realization of the random phases to the next;
their scatter is the total covariance.

Source: R. Pintelon and J. Schoukens, System Identification, 2nd ed. 2012, ch. 2, 4; E. Wernholt
and S. Gunnarsson, IFAC 2008 (multivariable frequency responses of robots in closed loop).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from time import perf_counter
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import (
    check_time,
    has_limit,
    is_over,
    keep_best,
    limit_fit,
    part_known,
    reason_of_end,
)
from flexgen.base.checks.bounds import TimeLimit
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.records import (
    TRANSIENT,
    first_period_differs,
    first_period_excess,
    slow_transients,
)
from flexgen.base.results import ArrayResult
from flexgen.base.rows import Data, Part, Prose, Row
from flexgen.feedback.loop.controllers import Cascade
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.responses.average_names import AverageName
from flexgen.identification.responses.response_estimates import estimate
from flexgen.identification.responses.response_outputs import ANGLE
from flexgen.identification.responses.spectra import without_transients

# a period that differs from the others by more than this times their scatter does not repeat
REPEATS = 6.0
UNLIKE = 0.3  # of the signal: periods that differ so much from each other are a warning
LARGEST_DIFFERENCE = 0.1  # of the signal: above it such a period is an error, below it a warning
LARGEST = 1e100  # of a response or a variance in a file
# variance of the mean over half overlapping Hann segments, over that of independent ones
OVERLAP = 1 + 2 / 36
OPTIONAL = ("total", "noise_UU", "noise_YU", "torques", "numbers", "gains")  # arrays of a file
LEAST_TOTAL = 3  # realizations for a total covariance


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class Frf(ArrayResult):
    """Frequency responses from motor torques to accelerations of motors and sensors at k poses,
    motor side.

    Parameters
    ----------
    model : str
        Of the plan.
    motors : tuple of str
        Inputs, and the first outputs.
    poses : array (k, n_m) [rad, of the motors]
    w : array (lines,) [rad/s]
    G : complex array (k, lines, outputs, n_m) [rad/s^2 / (N m) or m/s^2 / (N m)]
    UU : complex array (k, lines, n_m, n_m) [(N m)^2]
        ``U U^H`` over all experiments.
    C : complex array (k, lines, outputs, outputs) [(rad/s^2)^2]
        Covariance of the error of the outputs in one period.
    variance : array (k, lines, outputs, n_m)
        Variance of each element of G by noise.
    total : array (k, lines, outputs, n_m) or None
        Variance of each element of G, distortion included; None with fewer than three
        realizations.
    periods, experiments : int
        Periods averaged, and experiments of all realizations at a pose.
    sample_s, delay_s : float [s]
        Hold of the torques (0: none) and their known delay.
    speed_sd : array (k, n_m) [rad/s]
    warnings : tuple of str
    sensors : tuple of str
        Sensor channels, the outputs after the motors.
    orders : tuple of int
        Time derivatives from the signal of each channel to its acceleration.
    noise_UU, noise_YU : arrays (k, lines, n_m or outputs, n_m), or None
        What noise adds to ``U U^H`` and ``Y U^H``; None: not known.
    torques : complex array (k, realizations, lines, n_m, experiments) or None [N m]
        Mean spectra of the periods, by which `identify` corrects the responses for large motions;
        None: no periods.
    numbers : array of int (lines,) or None
        Of the lines, as multiples of 1 over the period.
    gains : array (3, n_m) or None
        ``position_gain``, ``speed_gain`` and ``integral_gain`` of the drives, see
        `flexgen.Cascade`; zero: not known.
    ended : str
        Empty; ``"time limit"`` or ``"interrupted"`` where poses of the experiment are missing.

    Examples
    --------
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    >>> responses = flexgen.frf(flexgen.measure(plan))
    >>> responses.w.shape, responses.G.shape  # poses, frequencies, accelerations, torques
    ((10,), (1, 10, 2, 2))
    """

    KIND = "frf"
    ARRAYS = "poses w G UU C variance speed_sd"

    model: str
    motors: tuple[str, ...]
    poses: np.ndarray
    w: np.ndarray
    G: np.ndarray
    UU: np.ndarray
    C: np.ndarray
    variance: np.ndarray
    total: np.ndarray | None
    periods: int
    experiments: int
    sample_s: float
    delay_s: float
    speed_sd: np.ndarray
    warnings: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    orders: tuple[int, ...] = ()
    noise_UU: np.ndarray | None = None
    noise_YU: np.ndarray | None = None
    torques: np.ndarray | None = None
    numbers: np.ndarray | None = None
    gains: np.ndarray | None = None
    ended: str = field(default="", kw_only=True)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs: motors, then sensor channels."""
        return self.motors + self.sensors

    def __repr__(self) -> str:
        hz = self.w / (2 * np.pi)
        return (
            f"<Frf {self.model}: {len(self.poses)} poses, {len(self.w)} lines {hz[0]:.3g} .. "
            f"{hz[-1]:.3g} Hz, {len(self.outputs)} x {len(self.motors)}>"
        )

    def relative_sd(self) -> float:
        """Median of the standard deviation by noise over the size of the elements."""
        return float(np.median(np.sqrt(self.variance) / np.maximum(np.abs(self.G), 1e-300)))

    def content(self) -> tuple[Part, ...]:
        """Size and accuracy of the responses, and all fields as data."""
        ends = self.w[[0, -1]] / (2.0 * np.pi)
        size = f"{len(self.outputs)} x {len(self.motors)}"
        noise = 100.0 * self.relative_sd()
        return (
            Prose(f"{self.model}: frequency responses", is_title=True),
            Row("poses", len(self.poses)),
            Row("lines", len(self.w)),
            Row("outputs and motors", size),
            Row("lowest and highest frequency", f"{ends[0]:.4g}, {ends[1]:.4g}", "Hz"),
            Row("periods averaged", self.periods),
            Row("experiments at each pose", self.experiments),
            Row("median standard deviation by noise", noise, "%"),
            *self._data(),
            Data("frequencies_Hz", (self.w / (2.0 * np.pi)).tolist()),
            Data("median_relative_sd", self.relative_sd()),
        )

    def to_control(self, pose: int = 0) -> Any:
        """The responses at one pose, counted from 0, for the package python-control.

        Returns
        -------
        control.FrequencyResponseData
            Inputs ``tau_m[...]`` [N m], outputs ``a_m[...]`` [rad/s^2], motor side, and the sensor
            channels as accelerations.

        Raises
        ------
        ArgumentError
            There is no such pose, or the package control is not installed.
        """
        if not 0 <= pose < len(self.poses):
            raise ArgumentError(f"pose: given {pose!r}, expected 0 to {len(self.poses) - 1}")
        try:
            import control
        except ImportError:
            raise ArgumentError(
                "to_control: the package control is not installed; run: pip install "
                "'flexgen-robotics[control]'"
            ) from None
        return control.frd(
            self.G[pose].transpose(1, 2, 0),
            self.w,
            inputs=[f"tau_m[{name}]" for name in self.motors],
            outputs=[f"a_m[{name}]" for name in self.motors] + list(self.sensors),
        )

    def data(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays and other data of a file."""
        names = ["poses", "w", "G", "UU", "C", "variance", "speed_sd"]
        names += [name for name in OPTIONAL if getattr(self, name) is not None]
        meta = {
            name: getattr(self, name)
            for name in ("model", "periods", "experiments", "sample_s", "delay_s")
        }
        meta |= {
            name: list(getattr(self, name)) for name in ("motors", "warnings", "sensors", "orders")
        }
        meta |= {"ended": self.ended} if self.ended else {}
        meta["units"] = {"G": "rad/s^2 / (N m)", "UU": "(N m)^2", "w": "rad/s", "poses": "rad"}
        return {name: getattr(self, name) for name in names}, {**meta, "side": "motor"}

    @classmethod
    def from_data(cls, arrays: dict[str, np.ndarray], meta: dict[str, Any]) -> Frf:
        """The responses with these data; the inverse of `data`."""
        poses, w, G, UU, C, variance = (
            arrays[name] for name in ("poses", "w", "G", "UU", "C", "variance")
        )
        n = len(meta["motors"])
        shape = (len(poses), len(w))
        sensors = tuple(map(str, meta.get("sensors", ())))
        orders = tuple(map(int, meta.get("orders", ())))
        m = n + len(sensors)
        sizes = ((G, m, n), (variance, m, n), (UU, n, n), (C, m, m))
        wrong = any(x.shape != (*shape, *size) for x, *size in sizes)
        if (
            wrong
            or poses.shape != (shape[0], n)
            or len(orders) != len(sensors)
            or not set(orders) <= {0, 1, 2}
        ):
            raise ValueError("arrays of different sizes")
        if G.size == 0 or np.any(w <= 0) or np.any(np.diff(w) <= 0) or np.any(variance < 0):
            raise ValueError("expected rising frequencies > 0 and variances >= 0")
        for name, x, least in (("UU", UU, 1e-14), ("C", C, -1e-9)):
            size = np.abs(x).max(axis=(-2, -1))
            skew = np.abs(x - x.conj().swapaxes(-1, -2)).max(axis=(-2, -1))
            if np.any(skew > 1e-9 * size) or np.any(np.linalg.eigvalsh(x)[..., 0] < least * size):
                raise ValueError(f"{name}: expected Hermitian matrices, positive definite")
        if (
            not np.all((np.abs(G) > 0) & (np.abs(G) < LARGEST))
            or np.any(np.abs(UU) > LARGEST)
            or np.any(np.abs(C) > LARGEST)
        ):
            raise ValueError(f"G, UU, C: expected numbers between 0 and {LARGEST:g}")
        noise = arrays.get("noise_UU"), arrays.get("noise_YU")
        shapes = [None if x is None else x.shape for x in noise]
        if (
            arrays["speed_sd"].shape != (len(poses), n)
            or arrays.get("total", variance).shape != variance.shape
        ):
            raise ValueError("arrays of different sizes")
        if shapes not in ([None, None], [UU.shape, G.shape]):
            raise ValueError(
                "noise_UU, noise_YU: expected both, of the sizes of UU and G, or none"
            )
        motion = tuple(arrays.get(name) for name in OPTIONAL[3:])
        _check_motion(motion, *shape, n)
        counts = int(meta["periods"]), int(meta["experiments"])
        times = float(meta["sample_s"]), float(meta["delay_s"])
        if min(*counts, 1 + min(times)) < 1 or not np.isfinite(times).all():
            raise ValueError(
                "periods, experiments, sample_s, delay_s: expected numbers > 0 and times >= 0"
            )
        return cls(
            str(meta["model"]),
            tuple(meta["motors"]),
            poses,
            w,
            G,
            UU,
            C,
            variance,
            arrays.get("total"),
            *counts,
            *times,
            arrays["speed_sd"],
            tuple(meta["warnings"]),
            sensors,
            orders,
            *noise,
            *motion,
            ended=str(meta.get("ended", "")),
        )


@checked_types
def frf(
    experiment: Experiment,
    *,
    average: AverageName = "arithmetic",
    transients: bool = False,
    time_limit: TimeLimit | None = None,
) -> Frf:
    """Estimate the frequency responses of an experiment.

    Parameters
    ----------
    experiment : Experiment
    average : str
        Over the realizations: ``"arithmetic"``, ``"harmonic"`` (of the inverses),
        ``"logarithmic"`` (of amplitude and phase of each element), or ``"h1"`` (least squares over
        all periods; noise of the torques makes it too small).
    transients : bool
        The robot need not have come to rest; an error where no spectra beside the lines are
        recorded. Periods may differ then. Wherever the experiment has these spectra, local
        polynomials through them remove transients, since noise leaves some too.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the responses are those of the poses
        that are done, and ``ended`` says so. None or 0: unlimited.

    Returns
    -------
    Frf

    Raises
    ------
    ArgumentError
        Torques were limited, a period does not repeat, or there are no spectra beside the lines.
    OutOfTime
        The time was over before the first pose was done.
    SolverError
        The inputs of the experiments are not independent.

    Examples
    --------
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    >>> responses = flexgen.frf(flexgen.measure(plan))
    >>> responses.G.shape  # poses, frequencies, accelerations, torques
    (1, 10, 2, 2)
    """
    with limit_fit("frf", time_limit, first="pose"):
        return _responses(experiment, average, transients)


def _responses(experiment: Experiment, average: AverageName, transients: bool) -> Frf:
    """The responses at the poses that were done before the end of the time."""
    _check(experiment, average, transients)
    experiment, left_out = _without_transient_period(experiment)
    plan = experiment.plan
    w = 2 * np.pi * plan.frequencies
    n = len(plan.motors)
    U, Y = _inputs_outputs(experiment)
    P = plan.periods
    spread = 1.0
    noise_periods = 1
    if experiment.periodic:
        warnings = () if transients else check_repeats(Y[..., :n, :], experiment.source)
        warnings += left_out + _check_transients(experiment)
    else:
        average = "h1"
        spread = OVERLAP
        warnings = (
            f"the motion is not periodic: estimated from {P} windowed segments; leakage, and "
            "noise of the torques in closed loop, bias the responses: prefer a periodic "
            "excitation",
        )
    if experiment.lines_by_torque:
        warnings = (*warnings, _torque_lines(plan.lines))
    removes = transients or (experiment.beside is not None and average != "h1")
    if removes:
        noise_periods = P
    parts: list[_Part] = []
    whole = len(plan.poses)
    groups = [slice(k, k + 1) for k in range(whole)] if has_limit() else [slice(None)]
    for group in groups:
        with keep_best():
            check_time("frequency responses")
            parts.append(_part(experiment, group, U[group], Y[group], average, removes))
        if len(parts) == len(groups) or is_over():
            break
        part_known("poses", parts[-1].wall_s, len(groups) - len(parts))
    done = whole if len(parts) == len(groups) else len(parts)
    ended = experiment.ended if done == whole else reason_of_end()
    found = _join([part.estimates for part in parts])
    U = np.concatenate([part.U for part in parts])
    spread = parts[0].spread if removes else spread
    hold = plan.hardware.sample_s if experiment.hold == "zoh" else 0.0
    R = U.shape[1]
    E = U.shape[5]
    total = found.total if R >= LEAST_TOTAL else None
    known = average != "h1" and P > 1 and R == 1
    noises = (spread * found.noise_UU, spread * found.noise_YU) if known else (None, None)
    motion = (U.mean(axis=2), plan.lines, gains_of(plan.controller)) if experiment.periodic else ()
    return Frf(
        plan.model, plan.motors, plan.poses[:done], w, found.G, found.UU,
        noise_periods * spread * found.C, spread * found.variance, total, P, E * R, hold,
        plan.hardware.delay_s, experiment.speed_sd[:done], warnings, plan.sensors,
        _orders(experiment)[n:], *noises, *motion, ended=ended,
    )  # fmt: skip


@dataclass(frozen=True)
class _Part:
    """Estimates of some poses, the spectra of their torques, and the time that they took."""

    estimates: Any
    U: np.ndarray
    spread: float
    wall_s: float


def _part(
    experiment: Experiment,
    poses: slice,
    U: np.ndarray,
    Y: np.ndarray,
    average: AverageName,
    removes: bool,
) -> _Part:
    """The estimates of some poses, with their transients removed where ``removes``."""
    began = perf_counter()
    noise = None
    spread = 1.0
    if removes:
        assert experiment.beside is not None
        some = replace(experiment, beside=experiment.beside[poses])
        U, Y, noise, spread = _average_without_transients(some, U, Y)
    try:
        found = estimate(U, Y, average, noise)
    except np.linalg.LinAlgError:
        raise SolverError(
            f"{experiment.source}: the torques of the experiments are not independent: expected "
            f"at least {len(experiment.plan.motors)} experiments at each pose with different "
            "excitation"
        ) from None
    return _Part(found, U, spread, perf_counter() - began)


def _join(parts: list[Any]) -> Any:
    """Estimates of some poses as one."""
    if len(parts) == 1:
        return parts[0]
    names = [one.name for one in fields(parts[0])]
    values = {name: [getattr(part, name) for part in parts] for name in names}
    joined = {k: None if x[0] is None else np.concatenate(x) for k, x in values.items()}
    return replace(parts[0], **joined)


def gains_of(controller: Cascade) -> np.ndarray:
    """The gains of the drives as in `Frf`."""
    return np.array([controller.position_gain, controller.speed_gain, controller.integral_gain])


def _check_motion(motion: Sequence[np.ndarray | None], k: int, lines: int, n: int) -> None:
    """ValueError where ``torques, numbers, gains`` of a file do not fit together; none of them is
    allowed.
    """
    torques, numbers, gains = motion
    if torques is None or numbers is None or gains is None:
        if any(x is not None for x in motion):
            raise ValueError("torques, numbers, gains: expected all of them or none")
        return
    if torques.ndim != 5 or numbers.shape != (lines,) or gains.shape != (3, n):
        raise ValueError("torques, numbers, gains: arrays of different sizes")
    if torques.shape != (k, torques.shape[1], lines, n, torques.shape[4]) or torques.shape[4] < n:
        raise ValueError(
            "torques: expected those of each pose, line and motor, in an experiment for each motor"
        )
    if max(np.abs(x).max() for x in (torques, numbers, gains)) > LARGEST or np.any(
        np.diff(numbers, prepend=0) <= 0
    ):
        raise ValueError(
            f"torques, numbers, gains: expected numbers up to {LARGEST:g}, those of lines "
            "rising from 1"
        )


def _check(experiment: Experiment, average: str, transients: bool) -> None:
    """ArgumentError where an experiment cannot be estimated in this way."""
    if average == "harmonic" and experiment.plan.sensors:
        raise ArgumentError(
            "average: given 'harmonic' with sensors, expected as many outputs as motors; take "
            "another"
        )
    if np.any(experiment.saturated):
        where = ", ".join(str(k + 1) for k in np.flatnonzero(experiment.saturated))
        raise ArgumentError(
            f"{experiment.source}: torques were at their limits at the poses {where}; a "
            "saturated motor is not linear: take less speed_rms"
        )
    if experiment.signals is not None:
        still = np.abs(experiment.signals).max(axis=tuple(range(5))) == 0.0
        if still.any():
            names = ", ".join(np.array(experiment.plan.sensors)[still])
            raise ArgumentError(
                f"{experiment.source}: the sensor channels {names} do not move at all; leave "
                "them out"
            )
    if transients and (experiment.beside is None or not experiment.periodic):
        raise ArgumentError(
            f"transients: {experiment.source} has no spectra beside the lines; keep them with "
            "measure(beside=True) or 'flexgen measure --beside'; recordings of files have them "
            "where they have enough periods"
        )


def _orders(experiment: Experiment) -> tuple[int, ...]:
    """Time derivatives from each output to an acceleration."""
    plan = experiment.plan
    if not plan.sensors:
        return (ANGLE,) * len(plan.motors)
    if experiment.orders is None:
        raise ArgumentError(f"{experiment.source}: the kinds of the sensors are not known")
    return (ANGLE,) * len(plan.motors) + tuple(experiment.orders)


def _inputs_outputs(experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Spectra of torques and accelerations, (k, realizations, periods, lines, channels,
    experiments).
    """
    w = 2 * np.pi * experiment.plan.frequencies
    outputs = (
        [experiment.q_m] if experiment.signals is None else [experiment.q_m, experiment.signals]
    )
    Y = (1j * w[:, None]) ** np.array(_orders(experiment)) * np.concatenate(outputs, axis=-1)
    return experiment.tau_m.transpose(0, 1, 3, 4, 5, 2), Y.transpose(0, 1, 3, 4, 5, 2)


def _average_without_transients(
    experiment: Experiment, U: np.ndarray, Y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray], float]:
    """Mean spectra without transients, as of one period; noise of the record, and the `spread` of
    `SteadySpectra`.
    """
    offsets = experiment.offsets
    beside = experiment.beside
    plan = experiment.plan
    assert offsets is not None and beside is not None
    n = len(plan.motors)
    s = 2j * np.pi * (plan.frequencies + offsets[:, None] / (plan.periods * plan.period_s))
    near = beside.copy()
    near[..., n:] *= s[..., None] ** np.array(_orders(experiment))
    mean = np.concatenate([U.mean(axis=2), Y.mean(axis=2)], axis=-2).transpose(0, 1, 4, 2, 3)
    found = without_transients(mean, near, offsets)
    lines = found.lines.transpose(0, 1, 3, 4, 2)[:, :, None]
    # mean square of the offsets: that of the noise
    noise = found.noise.transpose(0, 1, 3, 4, 5, 2) / np.sqrt(found.freedom)
    return (
        lines[..., :n, :],
        lines[..., n:, :],
        (noise[..., :n, :], noise[..., n:, :]),
        found.spread,
    )


def _torque_lines(lines: np.ndarray) -> str:
    """The warning where torques alone tell which lines were excited."""
    return (
        f"the {len(lines)} lines are those where the torques are large: distortion by friction "
        "cannot be told from excitation by torques alone; state line_numbers, or the "
        "[[reference]] of each motor"
    )


def check_repeats(Y: np.ndarray, source: str) -> tuple[str, ...]:
    """Warnings on periods that are unlike the others: a transient, a drift, or lost samples; an
    error for large ones.

    Compared by the size of all lines together, so that noise of single lines averages out.
    """
    away = (
        Y
        - np.median(Y.real, axis=2, keepdims=True)
        - 1j * np.median(Y.imag, axis=2, keepdims=True)
    )
    size = np.sqrt((np.abs(away) ** 2).sum(axis=(3, 4)))  # (k, realizations, periods, experiments)
    usual = np.median(size, axis=2, keepdims=True)
    scale = np.sqrt((np.abs(Y) ** 2).sum(axis=(3, 4))).mean(axis=2, keepdims=True)
    unlike = float((usual / scale).max())
    warnings = [
        (
            f"the periods differ from each other by {unlike:.2g} of the signal: noise, or "
            "another period than was excited"
        )
    ] * (unlike > UNLIKE)
    if Y.shape[2] < 3:
        return tuple(warnings)
    for k, r, p, e in np.argwhere(size > REPEATS * np.maximum(usual, 1e-3 * scale)).tolist():
        part = size[k, r, p, e] / scale[k, r, 0, e]
        others = usual[k, r, 0, e] / scale[k, r, 0, e]
        line = (
            f"pose {k + 1}, realization {r + 1}, experiment {e + 1}: period {p + 1} differs "
            f"from the others by {part:.2g} of the signal (the others by {others:.2g})"
        )
        if part > LARGEST_DIFFERENCE:
            raise ArgumentError(
                f"{source}: {line}; leave out more transient periods, or look for lost samples"
            )
        warnings.append(line)
    return tuple(warnings)


def _without_transient_period(experiment: Experiment) -> tuple[Experiment, tuple[str, ...]]:
    """The experiment without its first period where a transient is in it, and a line about it.

    Polynomials leave a part of one that decays within a period, alike in all experiments.
    """
    differs = first_period_differs(experiment.tau_m, experiment.q_m)
    if experiment.beside is None or experiment.beside_later is None or not differs.any():
        return experiment, ()
    plan = experiment.plan
    signals = experiment.signals
    later = replace(
        experiment,
        plan=replace(plan, periods=plan.periods - 1, transients=plan.transients + 1),
        tau_m=experiment.tau_m[:, :, :, 1:],
        q_m=experiment.q_m[:, :, :, 1:],
        signals=None if signals is None else signals[:, :, :, 1:],
        offsets=experiment.offsets_later,
        beside=experiment.beside_later,
        offsets_later=None,
        beside_later=None,
    )
    return later, (f"a transient is in the first of {plan.periods} periods; it is left out",)


def _check_transients(experiment: Experiment) -> tuple[str, ...]:
    """A warning where a transient is in the first period that is used, or in all of them."""
    motors = experiment.plan.motors
    more = "leave out more transient periods"
    if experiment.beside is not None:
        found = np.flatnonzero(
            first_period_differs(experiment.tau_m, experiment.q_m)
            | slow_transients(experiment.q_m)
        )
        return tuple(f"{TRANSIENT}: in the motion of {motors[i]}; {more}" for i in found[:1])
    excess = first_period_excess(experiment.tau_m)
    first = (
        f"the first periods of the torque of {motors[int(excess.argmax())]} differ by "
        f"{excess.max():.2g} times the"
    )
    text = (
        f"{TRANSIENT}: {first} power of later ones; {more}, or remove it (transients=True, "
        "--transients)"
    )
    return () if excess.max() == 1.0 else (text,)


def coherence(experiment: Experiment) -> np.ndarray:
    """Multiple coherence of each output (k, lines, outputs): the part of its power that the
    torques explain.
    """
    estimate = frf(replace(experiment, offsets=None, beside=None))  # the noise of periods
    _, Y = _inputs_outputs(experiment)
    power = (np.abs(Y) ** 2).mean(axis=(1, 2, 5))
    noise = np.real(np.einsum("klaa->kla", estimate.C))
    if not math.isfinite(power.sum()):
        raise SolverError("coherence: the spectra are not finite")
    return np.asarray(1.0 - noise / np.maximum(power, 1e-300))
