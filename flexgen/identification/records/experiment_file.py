"""Recordings of periodic excitation, or of motions without period, turned into the spectra of an
experiment.

The files are described by `flexgen.identification.records.description`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.keys import Context, number, read
from flexgen.base.spec.tables import Table
from flexgen.codegen.emission.digest import model_digest
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.experiments.experiment import HOLDS, Experiment
from flexgen.identification.records.description import (
    Description,
    Recording,
    is_description,
    read_description,
)
from flexgen.identification.responses.response_outputs import output_orders
from flexgen.identification.responses.spectra import (
    all_spectra_beside,
    spectrum,
    windowed_spectrum,
)
from flexgen.model.position_servo.filters import LowPass, Notch
from flexgen.model.position_servo.keys import LOW_PASS, NOTCH
from flexgen.paths.timing.joint_limits import beyond_range

LINES = ("excited", "odd", "all")
EXCITED = 0.02  # part of the largest amplitude of the torques
REFERENCE = 1e-3  # the same of the speeds of the references, which have no distortion
GAINS = ("position_gain", "speed_gain", "integral_gain")
NOISES = ("encoder_resolution_rad", "encoder_noise_rad", "torque_noise_Nm")


def read_experiment(path: str | Path, progress: Callable[[str], None] | None = None) -> Experiment:
    """Read the recordings that a TOML file describes.

    Parameters
    ----------
    path : str or Path
        See `flexgen.identification.records.description`.
    progress : callable, optional
        Called with what was done to the files, as sentences.

    Returns
    -------
    Experiment

    Raises
    ------
    ModelError
        The TOML file has an error: file, line, key.
    ArgumentError
        A recording cannot be used: file, channel, time.
    """
    found = read_description(path)
    if progress is not None:
        for note in found.notes:
            progress(note)
    root = found.root
    model = found.model
    periodic = "segment_s" not in root
    if not periodic and ("period_s" in root or "transients" in root):
        raise root.fail("segment_s", "either period_s, or segment_s without transients")
    period = root.number("period_s" if periodic else "segment_s", above=0.0)
    transients = root.whole("transients", 0, 1000) if "transients" in root else 0
    poses: dict[tuple[float, ...], list[tuple[np.ndarray, ...]]] = {}
    has_gaps = any(recording.periods_before is not None for _, recording in found.recordings)
    for table, recording in found.recordings:
        check_time(f"reading {recording.file}")
        joints = table.angles("pose", [model.coordinates[i].unit == "rad" for i in model.i_g])
        if beyond := beyond_range(model, np.array([joints])):
            raise table.fail(
                "pose_deg" if "pose_deg" in table else "pose_rad",
                f"a pose of the robot: {beyond[0]}",
            )
        poses.setdefault(tuple(joints), []).append(_parts(recording, period, transients, periodic))
    if has_gaps:
        poses = _last_periods(poses)
    return _experiment(found, poses)


def _last_periods(
    poses: dict[tuple[float, ...], list[tuple[np.ndarray, ...]]],
) -> dict[tuple[float, ...], list[tuple[np.ndarray, ...]]]:
    """As many of the last periods of each recording as the one with the fewest has."""
    fewest = min(len(run[0]) for runs in poses.values() for run in runs)
    return {q: [tuple(x[-fewest:] for x in run) for run in runs] for q, runs in poses.items()}


def _parts(
    recording: Recording, period_s: float, transients: int, periodic: bool
) -> tuple[np.ndarray, ...]:
    """Torques, angles and signals in whole periods, or in segments that overlap by half: (parts,
    samples, n).
    """
    file = recording.file
    n = len(recording.t)
    whole = period_s / recording.sample_s
    samples = round(whole)
    if samples < 2 or abs(whole - samples) > 1e-3:
        raise ArgumentError(
            f"{file}: given a sample time of {recording.sample_s:.6g} s, expected a whole "
            f"number of samples in period_s = {period_s} s, not {whole:.4f}"
        )
    if recording.periods_before is not None:
        # the part that is read begins after the transient periods
        transients = 0
    periods = n // samples - transients
    if periods < 2:
        raise ArgumentError(
            f"{file}: given {n} samples, expected at least two periods of {samples} samples "
            f"after {transients} transient ones"
        )
    step = samples if periodic else max(samples // 2, 1)
    starts = range(transients * samples, n - samples + 1, step)
    return tuple(
        np.array([x[start : start + samples] for start in starts])
        for x in (recording.tau_m, recording.q_m, recording.signals, recording.references)
    )


def _experiment(
    found: Description, poses: dict[tuple[float, ...], list[tuple[np.ndarray, ...]]]
) -> Experiment:
    """The spectra at the lines, (poses, 1, experiments, periods, lines, n_m)."""
    root = found.root
    model = found.model
    sensors = found.sensors
    sample_s = found.recordings[0][1].sample_s
    counts = {len(runs) for runs in poses.values()}
    lengths = {x.shape[:2] for runs in poses.values() for run in runs for x in run}
    if len(counts) > 1 or len(lengths) > 1:
        raise root.fail(
            "recording",
            "the same number of recordings, and of whole periods in each, at every pose",
        )
    experiments = counts.pop()
    (periods, _) = lengths.pop()
    if experiments < model.n_m:
        raise root.fail(
            "recording", f"at least {model.n_m} recordings at each pose, one for each motor"
        )
    periodic = "segment_s" not in root
    period = root.number("period_s" if periodic else "segment_s", above=0.0)
    # (poses, experiments, periods, samples, n)
    tau, q, signals, references = (
        np.array([[run[k] for run in runs] for runs in poses.values()]) for k in range(4)
    )
    # friction moves the torques at other lines too
    excited = references if references.shape[-1] else tau
    lines = _lines(root, excited, period, REFERENCE if references.shape[-1] else EXCITED)
    transformed = spectrum if periodic else windowed_spectrum
    # (poses, realizations, experiments, periods, lines, n)
    tau_m, q_m, sensed = (
        np.array([[[[transformed(p, lines) for p in run] for run in runs]] for runs in x])
        for x in (tau, q, signals)
    )
    beside = (
        all_spectra_beside(np.concatenate([tau, q, signals], axis=-1), lines) if periodic else {}
    )
    w = 2 * np.pi * lines / period
    speed = np.sqrt((np.abs(w[:, None] * q_m) ** 2).sum(axis=-2).mean(axis=(1, 2, 3)) / 2)
    n = model.n_m
    hardware, controller = _drive(root, sample_s, n)
    plan = Plan(
        model=f"{model.file}@{model.variant}" if model.variant else model.file,
        digest=model_digest(model),
        motors=tuple(motor.name for motor in model.motors),
        poses=np.array(list(poses)) @ model.eta.T,
        lines=lines,
        period_s=period,
        amplitudes=np.zeros((len(lines), n)),
        phases=np.zeros((1, len(lines), n)),
        periods=periods,
        transients=0,
        hardware=hardware,
        controller=controller,
        sensors=sensors,
    )
    hold = root.choice("hold", HOLDS)
    orders = tuple(output_orders(model, sensors)[n:].tolist()) if sensors else None
    return Experiment(
        plan, tau_m, q_m, speed, np.zeros(len(poses), np.int64), str(found.source), hold,
        sensed if sensors else None, orders=orders, periodic=periodic,
        references=references.mean(axis=2)[:, None] if references.shape[-1] else None,
        lines_by_torque=periodic and not references.shape[-1] and "line_numbers" not in root
        and _choice_of_lines(root) == LINES[0], **beside,
    )  # fmt: skip


def _drive(root: Table, sample_s: float, n: int) -> tuple[DriveHardware, Cascade]:
    """The drives of the table ``[drive]``; without it all gains are zero: not known."""
    delay = root.number("delay_s", 0.0, least=0.0)
    table = root.table("drive")
    if table is None:
        return DriveHardware(sample_s, delay), Cascade(*np.zeros((3, n)))
    table.only(*GAINS, *NOISES, "low_pass", "notch")
    position, speed = (np.array(table.vector(key, n)) for key in GAINS[:2])
    integral = np.array(table.vector(GAINS[2], n, (0.0,) * n))
    for key, values in zip(GAINS, (position, speed, integral), strict=True):
        if not (values >= 0).all() or (key == "speed_gain" and not values.all()):
            raise table.fail(key, "numbers > 0" if key == "speed_gain" else "numbers >= 0")
    filters: list[LowPass | Notch] = []
    for name, form in (("low_pass", LOW_PASS), ("notch", NOTCH)):
        inner = table.table(name)
        if inner is not None:
            filters.append(
                read(inner, form.typed(**dict.fromkeys(form.names, number(above=0.0))), Context())
            )
    resolution, encoder, torque = (table.number(key, 0.0, least=0.0) for key in NOISES)
    cascade = Cascade(position, speed, integral, tuple(filters))
    return DriveHardware(sample_s, delay, resolution, encoder, torque), cascade


def load_experiment(path: str | Path, progress: Callable[[str], None] | None = None) -> Experiment:
    """The experiment of a file of `flexgen.measure`, or of a ``.toml`` file that describes
    recordings.
    """
    if not is_description(path):
        return Experiment.load(path)
    if progress is not None:
        progress(f"reading the recordings of {path}")
    return read_experiment(path, progress)


def _choice_of_lines(root: Table) -> str:
    return root.choice("lines", LINES, LINES[0])


def _lines(root: Table, tau: np.ndarray, period: float, least: float) -> np.ndarray:
    """The excited multiples of ``1 / period``: those of torques, or references, with an amplitude
    above ``least``.
    """
    samples = tau.shape[3]
    if "line_numbers" in root:
        if "lines" in root or "f_min" in root or "f_max" in root:
            raise root.fail("line_numbers", "no lines, f_min or f_max in addition to it")
        given = root.entries["line_numbers"].value
        numbers = [entry.value for entry in given] if isinstance(given, list) else []
        if not numbers or not all(isinstance(x, int) and 0 < x < samples / 2 for x in numbers):
            raise root.fail("line_numbers", f"whole numbers from 1 to {(samples - 1) // 2}")
        return np.unique(np.array(numbers))
    which = _choice_of_lines(root)
    low = root.number("f_min", 1.0 / period, above=0.0)
    high = min(root.number("f_max", 0.45 * samples / period, above=low), 0.5 * samples / period)
    lines = np.arange(max(1, int(np.ceil(low * period - 1e-9))), int(high * period + 1e-9) + 1)
    lines = lines[lines < samples / 2]
    if which == "odd":
        lines = lines[lines % 2 == 1]
    if which == "excited" and len(lines):
        size = np.abs(np.fft.rfft(tau.mean(axis=2), axis=2)).max(axis=(0, 1, 3))
        if least == REFERENCE:
            size = size * np.arange(len(size))  # of the speed
        lines = lines[size[lines] > least * size[1:].max()]
    if len(lines) == 0:
        raise root.fail("period_s", "a period that has lines between f_min and f_max")
    return lines
