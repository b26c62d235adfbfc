"""The verbs of identification: excite, measure, frf, identify."""

from __future__ import annotations

import time
from argparse import Namespace
from pathlib import Path
from typing import Any

from flexgen.cli.result import (
    Progress,
    VerbResult,
    alone,
    keywords,
    read_model,
    with_files,
)
from flexgen.errors import ArgumentError
from flexgen.progress import throttle
from flexgen.reports.text_tables import number

HARDWARE = {  # options of `excite` and the fields of DriveHardware
    "sample_time": "sample_s",
    "delay": "delay_s",
    "encoder_resolution": "encoder_resolution_rad",
    "encoder_noise": "encoder_noise_rad",
    "torque_noise": "torque_noise_Nm",
}
# Options of fits to frequency responses.
OF_RESPONSES = ("residual", "floor", "starts", "levels", "refine", "move", "truth")


def excite(args: Namespace, log: Progress) -> VerbResult:
    """Plan an experiment for identification: poses, multisines, expected accuracy."""
    from flexgen.identification.experiments.plan import excite as plan_experiment
    from flexgen.loop.hardware import DriveHardware
    from flexgen.reports.identification_texts import plan_text

    model = read_model(args)
    hardware = DriveHardware.from_model(
        model, **{HARDWARE[x]: getattr(args, x) for x in HARDWARE if x in args.given}
    )
    plan = plan_experiment(model, hardware=hardware, **keywords(args), progress=throttle(log))
    data = {
        "model": model.name,
        "plan": str(plan.save(args.out)),
        "duration_s": plan.duration_s,
        "frequencies_Hz": plan.frequencies.tolist(),
        "poses": plan.joints(model).tolist(),
        "expected_relative_sd": plan.predicted,
    }
    text = f"{plan_text(plan, model)}\n\nwrote {args.out}"
    if args.references is not None:
        text += f"\nwrote {args.references}, {len(plan.write_references(args.references))} files of references"
    return VerbResult(data, text)


def measure(args: Namespace, log: Progress) -> VerbResult:
    """Simulate the experiment of a plan on a robot, with noise and drives."""
    from flexgen.identification.experiments.excitation import Plan
    from flexgen.identification.experiments.experiment import measure as simulate

    plan, robot = Plan.load(args.plan), read_model(args)
    log(f"simulating {plan.duration_s:.0f} s of {robot.name}")
    began = time.perf_counter()
    writer = None
    if args.raw is not None:
        from flexgen.identification.recordings.recording_writer import RecordingWriter

        writer = RecordingWriter(args.raw, plan, robot)
    experiment = simulate(plan, robot, raw=writer, **keywords(args, "raw"), progress=throttle(log))
    wall = time.perf_counter() - began
    data = {
        "model": robot.name,
        "experiment": str(experiment.save(args.out)),
        "duration_s": plan.duration_s,
        "wall_s": wall,
        "speed_rms_rad_s": experiment.speed_sd.tolist(),
        "samples_at_torque_limit": experiment.saturated.tolist(),
    }
    text = f"{robot.name}: {number(plan.duration_s)} s of robot in {number(wall)} s\n\n"
    text += f"{experiment.to_text()}\n\nwrote {args.out}"
    if writer is not None:
        data["recordings"] = str(writer.finish())
        text += f"\nwrote {data['recordings']}, {len(writer.files)} files with all samples"
    limited = (
        "torques were at their limits: 'flexgen frf' refuses these data; take less --speed-rms"
    )
    return VerbResult(data, text, warnings=[limited] if experiment.saturated.any() else [])


def frf(args: Namespace, log: Progress) -> VerbResult:
    """Estimate frequency responses and their noise from an experiment."""
    from flexgen.identification.frequency_response import frf as estimate
    from flexgen.identification.recordings.experiment_file import load_experiment

    found = estimate(load_experiment(args.experiment, log), **keywords(args, "experiment"))
    data = {
        "model": found.model,
        "frf": None,
        "poses": len(found.poses),
        "lines": len(found.w),
        "outputs": list(found.outputs),
        "median_relative_sd": found.relative_sd(),
    }
    files = {"frf": found.save(args.out)} | (
        {} if args.report is None else {"report": found.report(args.report)}
    )
    return with_files(found.to_text(), data, files, warnings=list(found.warnings))


def identify(args: Namespace, log: Progress) -> VerbResult:
    """Fit parameters of a model to frequency responses or to recorded motions; write a new model file."""
    if args.rigid or args.segments is not None:
        return _rigid(args, log) if args.rigid else _segments(args, log)
    if args.validate is not None or args.counterbalance:
        raise ArgumentError(
            "--validate, --counterbalance: given without --rigid or --segments, expected with them"
        )
    if args.truth is not None and args.move is None:
        raise ArgumentError(
            "--truth: given without --move, expected also --move NAME, whose tool error is compared"
        )
    from flexgen.identification.frequency_response import Frf
    from flexgen.identification.graybox import identify as fit
    from flexgen.identification.recordings.experiment_file import load_experiment
    from flexgen.identification.result import FitStatus
    from flexgen.identification.time_domain import refine_and_validate
    from flexgen.reports.identification_texts import text_of_identification, validation_text

    model, data = read_model(args), Frf.load(args.data)
    if args.structure:
        return _structure(model, data, args, log)
    given = {
        "start": _floats(args.start),
        "source": str(args.data),
        **keywords(args, "data", "start", "levels"),
    }
    given["levels"] = [Frf.load(path) for path in args.levels or ()]
    found, validation, tell = fit(model, data, **given, progress=throttle(log)), [], throttle(log)
    checked: dict[str, Any] = {}
    if args.refine is not None:
        experiment = load_experiment(args.refine)
        log("refining by simulation: up to two minutes for six axes, seconds for planar arms")
        found, validated = refine_and_validate(found, experiment, progress=tell)
        if validated is not None:
            checked["validation"] = vars(validated)
            validation.append(validation_text(validated, experiment.plan.motors))
    text, usable = (
        text_of_identification(found, *validation),
        found.status != FitStatus.NOT_CONVERGED,
    )
    if args.move is not None and usable:
        checked["tool_errors"], words = _verdict(found, args, log)
        text += f"\n\n{words}"
    return with_files(
        text, found.to_dict() | checked, _files(found, args, usable), _problem(found.status)
    )


def _structure(model: Any, data: Any, args: Namespace, log: Progress) -> VerbResult:
    """Which springs without motor the data ask for: a table, and the tables of new springs for the model file."""
    from flexgen.identification.structure import structure
    from flexgen.reports.identification_texts import structure_text

    alone(args, "--structure", *OF_RESPONSES, "free", "start", "out")
    log("adding and removing springs: about a minute for six axes")
    found = structure(model, data, fixed=args.fixed, progress=throttle(log))
    result = found.identified.to_dict() | {
        "added": list(found.added),
        "removed": list(found.removed),
        "changes": [vars(change) for change in found.changes],
    }
    files = _files(found.identified, args)
    return with_files(structure_text(found), result, files, _problem(found.identified.status))


def _rigid(args: Namespace, log: Progress) -> VerbResult:
    """Bodies, rotors and friction from recorded motions, and the stiffness of gears with encoders on both sides."""
    from flexgen.identification.recordings.rigid_file import identify_bodies

    alone(
        args, "--rigid", "structure", "segments", *OF_RESPONSES, "free", "fixed", "start", "report"
    )
    balance = {name: int(count) for name, count in args.counterbalance or ()}
    options = {"validate": args.validate, "counterbalance": balance, "progress": log}
    found = identify_bodies(read_model(args), args.data, **options)
    problem = (
        ""
        if found.fit.status.has_deviations
        else f"{found.fit.status}: {found.fit.status.sentence}"
    )
    return with_files(found.to_text(), found.to_dict(), _files(found, args), problem)


def _segments(args: Namespace, log: Progress) -> VerbResult:
    """Parameters of the nonlinear model from recorded torques and motions, in short segments."""
    from flexgen.identification.motion_fit import fit_motion
    from flexgen.identification.result import FitStatus
    from flexgen.reports.identification_texts import text_of_motion_fit

    alone(args, "--segments", "structure", "rigid", *OF_RESPONSES, "counterbalance", "report")
    if args.free is None:
        raise ArgumentError("--segments: given no --free, expected the names of the parameters")
    start = {key: float(value) for key, value in args.start or ()}
    options = {"free": args.free, "fixed": args.fixed, "start": start, "validate": args.validate}
    found = fit_motion(
        read_model(args), args.data, segment_s=args.segments, **options, progress=log
    )
    files = _files(found, args, found.status != FitStatus.NOT_CONVERGED)
    return with_files(
        text_of_motion_fit(found, args.segments), found.to_dict(), files, _problem(found.status)
    )


def _verdict(found: Any, args: Namespace, log: Progress) -> tuple[list[dict[str, Any]], str]:
    """Tool errors of feedforward before and after: as data and as text."""
    from flexgen.reports.identification_texts import verdict_text

    if found.covariance is None and args.truth is None:
        words = f"no tool errors of the move {args.move}: a result with {found.status} has no covariance to draw robots"
        return [], f"{words} from; give --truth where the robot is known"
    log(f"tool errors of the move {args.move}: a few minutes for six axes")
    verdict = found.verdict(args.move, truth=args.truth, progress=throttle(log))
    rows = [{key: x for key, x in vars(row).items() if x is not None} for row in verdict.rows]
    return rows, verdict_text(verdict)


def _files(found: Any, args: Namespace, usable: bool = True) -> dict[str, Path | None]:
    """The new model file and the report, where they are asked for and the result is usable."""
    files = {} if args.out is None or not usable else {"model_file": found.write(args.out)}
    return files | (
        {} if args.report is None or not usable else {"report": found.report(args.report)}
    )


def _problem(status: Any) -> str:
    """Why a fit is a failure; empty where the model agrees with the measurement."""
    return "" if status.agrees else f"{status}: {status.sentence}"


def _floats(settings: Any) -> dict[str, float]:
    out = {}
    for key, value in settings or ():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ArgumentError(f"--start {key}: given {value!r}, expected a number")
        out[key] = float(value)
    return out
