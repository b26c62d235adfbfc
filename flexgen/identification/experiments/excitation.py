"""Excitation: multisine references of the motor speeds, orthogonal over the motors, and the plan
of an experiment.

    w_ref,j(t) = sum_l A_lj cos(2 pi f_l t + phi_rlj + 2 pi j e / n_m)
    experiment e of realization r

Lines f_l are odd multiples of 1 over the period, spaced logarithmically; the phases phi are
random. The phases of the n_m experiments of a realization differ by those of a discrete Fourier
transform: with equal drives their inputs are orthogonal, so that the frequency responses of all
motors are measured with all of them moving.

Source: R. Pintelon and J. Schoukens, System Identification, 2nd ed. 2012, ch. 5; T. Dobrowiecki
and J. Schoukens, Automatica 43(9), 2007 (orthogonal random-phase multisines).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.counts import count_of
from flexgen.base.checks.type_checks import checked_result
from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import write_text
from flexgen.base.results import ArrayResult
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.model.elements import RobotModel

MOST_SAMPLES = 10_000_000  # in a period
MOST_PERIODS = 100_000  # of one experiment


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class Plan(ArrayResult):
    """An experiment: poses, references and drives.

    Parameters
    ----------
    model : str
        As `flexgen.read` takes it.
    digest : str
        Of the model's data.
    motors : tuple of str
    poses : array (k, n_m) [rad]
        Motor angles, motor side, about which the robot moves.
    lines : array of int (lines,)
        Excited multiples of ``1 / period_s``.
    period_s : float [s]
    amplitudes : array (lines, n_m) [rad/s]
        Of the motor speeds, motor side.
    phases : array (realizations, lines, n_m) [rad]
    periods, transients : int
        Periods that are measured, and periods before them that are not.
    hardware : DriveHardware
    controller : Cascade
    sensors : tuple of str
        Channels of sensors that are recorded too.
    predicted : dict of str to float
        Expected standard deviation of the logarithm of each parameter, where it was computed.
    ended : str
        Empty; ``"time limit"`` or ``"interrupted"`` where not all candidates of the poses were
        compared.

    Examples
    --------
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    >>> plan.poses.shape, len(plan.lines), plan.hardware.sample_s
    ((1, 2), 10, 0.0005)
    """

    KIND = "plan"
    ARRAYS = "poses lines amplitudes phases position_gain speed_gain integral_gain torque_max"

    model: str
    digest: str
    motors: tuple[str, ...]
    poses: np.ndarray
    lines: np.ndarray
    period_s: float
    amplitudes: np.ndarray
    phases: np.ndarray
    periods: int
    transients: int
    hardware: DriveHardware
    controller: Cascade
    predicted: dict[str, float] = field(default_factory=dict)
    sensors: tuple[str, ...] = ()
    ended: str = ""

    def __repr__(self) -> str:
        return (
            f"<Plan {self.model}: {len(self.poses)} poses, {self.realizations} x "
            f"{self.experiments} experiments of {self.transients} + {self.periods} periods of "
            f"{self.period_s:g} s, {len(self.lines)} lines {self.frequencies[0]:.3g} .. "
            f"{self.frequencies[-1]:.3g} Hz: {self.duration_s:.0f} s>"
        )

    @property
    def experiments(self) -> int:
        """Number of experiments in a realization: one for each motor."""
        return len(self.motors)

    @property
    def realizations(self) -> int:
        """Number of realizations of the random phases."""
        return len(self.phases)

    @property
    def samples(self) -> int:
        """Samples in a period."""
        return round(self.period_s / self.hardware.sample_s)

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies of the lines [Hz], (lines,)."""
        return self.lines / self.period_s

    @property
    def duration_s(self) -> float:
        """Time that the robot moves [s]."""
        runs = len(self.poses) * self.realizations * self.experiments
        return runs * (self.periods + self.transients) * self.period_s

    @property
    def speed_sd(self) -> np.ndarray:
        """Standard deviation of the reference of each motor's speed [rad/s], (n_m,)."""
        return np.sqrt((self.amplitudes**2).sum(axis=0) / 2)

    def joints(self, model: RobotModel) -> np.ndarray:
        """The poses in the actuated coordinates of its robot (k, n_g) [rad or m]."""
        return np.asarray(self.poses @ np.linalg.inv(model.eta).T)

    def reference(self, realization: int, experiment: int) -> np.ndarray:
        """Deviation of the motor angles from the pose over one period [rad], (samples, n_m)."""
        realization = count_of("realization", realization, self.realizations - 1, 0)
        experiment = count_of("experiment", experiment, self.experiments - 1, 0)
        turn = 2 * np.pi * np.arange(len(self.motors)) * experiment / self.experiments
        X = np.zeros((self.samples // 2 + 1, len(self.motors)), complex)
        # angles are integrals of the speeds: sin(w t + phi) A / w
        X[self.lines] = -1j * np.exp(1j * (self.phases[realization] + turn)) * self.amplitudes
        X[self.lines] /= 2 * np.pi * self.frequencies[:, None]
        return np.asarray(self.samples / 2 * np.fft.irfft(X, self.samples, axis=0))

    def write_references(self, folder: str | Path) -> tuple[Path, ...]:
        """Write one period of the references of each experiment, for the drives of a real robot.

        Returns
        -------
        tuple of Path
            CSV files. Columns: ``t`` [s], then ``<motor>_q_ref_rad`` and ``<motor>_v_ref_rad_s``,
            motor side; the period is repeated ``transients + periods`` times.

        Raises
        ------
        ArgumentError
            The folder cannot be made or written.
        """
        target = Path(folder)
        out = []
        names = [
            "t",
            *(f"{motor}_{kind}" for kind in ("q_ref_rad", "v_ref_rad_s") for motor in self.motors),
        ]
        t = np.arange(self.samples) * self.hardware.sample_s
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ArgumentError(
                f"references: the folder {str(target)!r} cannot be made ({error.strerror})"
            ) from None
        w = 2j * np.pi * np.fft.rfftfreq(self.samples, self.hardware.sample_s)[:, None]
        for k, r, e in np.ndindex(len(self.poses), self.realizations, self.experiments):
            q = self.reference(r, e)
            v = np.fft.irfft(w * np.fft.rfft(q, axis=0), self.samples, axis=0)
            rows = np.column_stack([t, self.poses[k] + q, v])
            text = (
                ",".join(names)
                + "\n"
                + "".join(",".join(f"{x:.12g}" for x in row) + "\n" for row in rows.tolist())
            )
            path = target / f"pose{k + 1}_realization{r + 1}_experiment{e + 1}.csv"
            out.append(write_text(path, text))
        return tuple(out)

    def data(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays and other data of a file."""
        arrays = {
            "poses": self.poses,
            "lines": self.lines,
            "amplitudes": self.amplitudes,
            "phases": self.phases,
            "position_gain": self.controller.position_gain,
            "speed_gain": self.controller.speed_gain,
            "integral_gain": self.controller.integral_gain,
        }
        hardware = {
            key: value for key, value in vars(self.hardware).items() if key != "torque_max_Nm"
        }
        arrays["torque_max"] = np.array(self.hardware.torque_max_Nm)
        meta = {
            "model": self.model,
            "digest": self.digest,
            "motors": list(self.motors),
            "period_s": self.period_s,
            "periods": self.periods,
            "transients": self.transients,
            "hardware": hardware,
            "predicted": self.predicted,
            "sensors": list(self.sensors),
        }
        meta |= {"plan_ended": self.ended} if self.ended else {}
        return arrays, meta

    @classmethod
    def from_data(cls, arrays: dict[str, np.ndarray], meta: dict[str, Any]) -> Plan:
        """The plan with these data; the inverse of `data`."""
        gains = [arrays[name] for name in ("position_gain", "speed_gain", "integral_gain")]
        hardware = DriveHardware(
            **meta["hardware"], torque_max_Nm=tuple(arrays["torque_max"].ravel().tolist())
        )
        n = len(meta["motors"])
        lines = arrays["lines"]
        phases = arrays["phases"]
        shapes = {
            "poses": (arrays["poses"], (len(arrays["poses"]), n)),
            "amplitudes": (arrays["amplitudes"], (len(lines), n)),
            "phases": (phases, (len(phases), len(lines), n)),
            **{f"gain {k}": (gain, (n,)) for k, gain in enumerate(gains)},
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape or array.size == 0:
                raise ValueError(f"{name}: given the shape {array.shape}, expected {shape}")
        samples = float(meta["period_s"]) / hardware.sample_s
        if (
            not 2 <= samples <= MOST_SAMPLES
            or lines.ndim != 1
            or not np.all((lines > 0) & (lines < samples / 2))
        ):
            raise ValueError(
                f"lines and period: expected lines below half of 2 to {MOST_SAMPLES} samples in "
                "a period"
            )
        if (
            not 1 <= int(meta["periods"]) <= MOST_PERIODS
            or not 0 <= int(meta["transients"]) <= MOST_PERIODS
        ):
            raise ValueError(f"periods, transients: expected at most {MOST_PERIODS}")
        return cls(
            meta["model"],
            meta["digest"],
            tuple(meta["motors"]),
            arrays["poses"],
            arrays["lines"].astype(int),
            float(meta["period_s"]),
            arrays["amplitudes"],
            arrays["phases"],
            int(meta["periods"]),
            int(meta["transients"]),
            hardware,
            Cascade(gains[0], gains[1], gains[2]),
            dict(meta["predicted"]),
            tuple(map(str, meta.get("sensors", ()))),
            str(meta.get("plan_ended", "")),
        )


def odd_lines(f_min: float, f_max: float, count: int, period_s: float) -> np.ndarray:
    """At most ``count`` odd multiples of ``1 / period_s`` from ``f_min`` to ``f_max`` [Hz], spaced
    logarithmically.

    Raises
    ------
    ArgumentError
        There are none.
    """
    if not (0 < f_min < f_max and math.isfinite(f_max)):
        raise ArgumentError(
            f"f_min, f_max: given {f_min!r}, {f_max!r}, expected 0 < f_min < f_max in Hz"
        )
    least = math.ceil(f_min * period_s - 1e-9)
    most = math.floor(f_max * period_s + 1e-9)
    least = least + (least % 2 == 0)
    most = most - (most % 2 == 0)
    lines = np.zeros(0, int)
    for points in range(count, 10 * count):  # lines that fall together make room for others
        if least > most:
            break
        wanted = np.geomspace(least, most, points)
        found = np.clip(2 * np.round((wanted - 1) / 2).astype(int) + 1, least, most)
        if len(np.unique(found)) > count:
            break
        lines = np.unique(found)
    if len(lines) == 0:
        raise ArgumentError(
            f"period_s: given {period_s} s, which has no odd multiple of {1 / period_s:g} Hz "
            f"between {f_min} and {f_max} Hz; take a longer period"
        )
    return lines


def motor_speeds(model: RobotModel, speed: float | np.ndarray) -> np.ndarray:
    """Motor-side speeds (n_m,) for a speed of each joint, arm side [rad/s or m/s]; one number: the
    same for all.
    """
    given = np.broadcast_to(np.asarray(speed, dtype=float), (model.n_g,))
    if not np.all(np.isfinite(given) & (given > 0)):
        raise ArgumentError(
            f"speed_rms: given {speed!r}, expected a speed > 0 in rad/s or m/s, or one for each "
            "joint"
        )
    return np.sqrt((model.eta**2) @ given**2)


def speed_amplitudes(frequencies: np.ndarray, speed: np.ndarray, exponent: float) -> np.ndarray:
    """Amplitudes (lines, n_m) proportional to ``f^exponent``, with the given rms ``speed``
    (n_m,).
    """
    shape = frequencies**exponent
    shape = shape / np.sqrt((shape**2).sum() / 2)
    return shape[:, None] * speed[None, :]
