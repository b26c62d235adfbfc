"""The verbs of identification: excite, measure, frf, identify."""

from __future__ import annotations

import time
from argparse import Namespace
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.base.calls.deadline import OutOfTime, limit_fit
from flexgen.base.calls.progress import throttle
from flexgen.base.errors import ArgumentError
from flexgen.cli.result import (
    Progress,
    VerbResult,
    Writer,
    alone,
    check_model_file,
    is_interrupted,
    keywords,
    read_model,
    with_files,
)
from flexgen.views.reports.text_tables import number

if TYPE_CHECKING:
    from flexgen.model.elements import RobotModel

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
    from flexgen.feedback.loop.hardware import DriveHardware
    from flexgen.identification.experiments.obstacles import Box
    from flexgen.identification.experiments.plan import excite as plan_experiment
    from flexgen.views.reports.identification_texts import plan_text

    model = read_model(args)
    hardware = DriveHardware.from_model(
        model, **{HARDWARE[x]: getattr(args, x) for x in HARDWARE if x in args.given}
    )
    given = keywords(args)
    if args.obstacles is not None:
        given["obstacles"] = [Box(**corners) for corners in args.obstacles]
    if args.pose is not None:
        alone(args, "--pose", "poses", "criterion")
        given["poses"] = poses_of(args.pose, model)
    plan = plan_experiment(model, hardware=hardware, **given, progress=throttle(log))
    data = {
        "model": model.name,
        "duration_s": plan.duration_s,
        "frequencies_Hz": plan.frequencies.tolist(),
        "poses": plan.joints(model).tolist(),
        "expected_relative_sd": plan.predicted,
    }
    files: dict[str, Writer] = {"plan": partial(plan.save, args.out)}
    after: dict[str, str] = {}
    if args.references is not None:
        files["references"] = partial(_write_references, plan, args.references, after)
    known = "" if plan.predicted else "; the accuracy of its parameters is not known"
    early = f"{plan.ended}: the plan is the best so far{known}" if plan.ended else ""
    data["status"] = early or "done"
    interrupted = is_interrupted(plan)
    return with_files(
        plan_text(plan, model), data, files, early, after=after, interrupted=interrupted
    )


def poses_of(given: list[list[float]], model: RobotModel) -> list[list[float]]:
    """Poses (k, n_g) [rad or m] of the command line; ArgumentError where one has another number of
    joints.
    """
    names = ", ".join(model.coordinates[i].name for i in model.i_g)
    for pose in given:
        if len(pose) != model.n_g:
            raise ArgumentError(
                f"--pose: given {len(pose)} numbers, expected {model.n_g}: {names} [rad or m]"
            )
    return given


def _write_references(plan: Any, folder: Path, after: dict[str, str]) -> Path:
    """Write the references of the experiments of a plan; the folder, and their number behind."""
    written = plan.write_references(folder)
    after["references"] = f", {len(written)} files of references"
    return folder


def measure(args: Namespace, log: Progress) -> VerbResult:
    """Simulate the experiment of a plan on a robot, with noise and drives."""
    from flexgen.identification.experiments.excitation import Plan
    from flexgen.identification.experiments.experiment import measure as simulate

    plan = Plan.load(args.plan)
    robot = read_model(args)
    log(f"simulating {plan.duration_s:.0f} s of {robot.name}")
    began = time.perf_counter()
    writer = None
    if args.raw is not None:
        from flexgen.identification.records.recording_writer import RecordingWriter

        writer = RecordingWriter(args.raw, plan, robot)
    experiment = simulate(plan, robot, raw=writer, **keywords(args, "raw"), progress=throttle(log))
    wall = time.perf_counter() - began
    data = {
        "model": robot.name,
        "duration_s": experiment.plan.duration_s,
        "wall_s": wall,
        "speed_rms_rad_s": experiment.speed_sd.tolist(),
        "samples_at_torque_limit": experiment.saturated.tolist(),
    }
    text = f"{robot.name}: {number(experiment.plan.duration_s)} s of robot in {number(wall)} s\n\n"
    text += experiment.to_text()
    files: dict[str, Writer] = {"experiment": partial(experiment.save, args.out)}
    after = {}
    if writer is not None:
        files["recordings"] = writer.finish
        after["recordings"] = f", {len(writer.files)} files with all samples"
    if writer is not None:
        # recordings of a pose that is not whole are not described
        whole = len(experiment.plan.poses)
        writer.files = [file for file in writer.files if file[0] < whole]
    done = f"{len(experiment.plan.poses)} of {len(plan.poses)} poses are measured"
    early = f"{experiment.ended}: {done}" if experiment.ended else ""
    data["status"] = early or "done"
    limited = (
        "torques were at their limits: 'flexgen frf' refuses these data; take less --speed-rms"
    )
    warnings = [limited] if experiment.saturated.any() else []
    interrupted = is_interrupted(experiment)
    return with_files(
        text, data, files, early, after=after, warnings=warnings, interrupted=interrupted
    )


def frf(args: Namespace, log: Progress) -> VerbResult:
    """Estimate frequency responses and their noise from an experiment."""
    from flexgen.identification.records.experiment_file import load_experiment
    from flexgen.identification.responses.frequency_response import frf as estimate

    with limit_fit("frf", args.time_limit, throttle(log), first="pose"):
        experiment = load_experiment(args.experiment, log)
        found = estimate(experiment, **keywords(args, "experiment", "time_limit"))
    done = f"{len(found.poses)} of {len(experiment.plan.poses)} poses are estimated"
    short = len(found.poses) < len(experiment.plan.poses)
    early = f"{found.ended}: {done}" if short else ""
    data = {
        "status": early or "done",
        "model": found.model,
        "frf": None,
        "poses": len(found.poses),
        "lines": len(found.w),
        "outputs": list(found.outputs),
        "median_relative_sd": found.relative_sd(),
    }
    files: dict[str, Writer] = {"frf": partial(found.save, args.out)}
    if args.report is not None:
        files["report"] = partial(found.report, args.report)
    warnings = list(found.warnings)
    warnings += [f"the experiment has not all poses of its plan: {found.ended}"] * (
        bool(found.ended) and not short
    )
    interrupted = short and is_interrupted(found)
    return with_files(
        found.to_text(), data, files, early, warnings=warnings, interrupted=interrupted
    )


def identify(args: Namespace, log: Progress) -> VerbResult:
    """Fit parameters of a model to frequency responses or to recorded motions; write a new model
    file.
    """
    if args.rigid or args.segments is not None:
        return _rigid(args, log) if args.rigid else _segments(args, log)
    if args.counterbalance:
        raise ArgumentError(
            "--counterbalance: given without --rigid or --segments, expected with them"
        )
    if args.validate and args.structure:
        raise ArgumentError("--validate: given with --structure, expected without it")
    if args.truth is not None and args.move is None:
        raise ArgumentError(
            "--truth: given without --move, expected also --move NAME, whose tool error is "
            "compared"
        )
    from flexgen.identification.records.experiment_file import load_experiment
    from flexgen.identification.responses.frequency_response import Frf
    from flexgen.identification.responses.graybox import identify as fit
    from flexgen.identification.responses.result import FitStatus
    from flexgen.views.reports.identification_texts import text_of_identification, validation_text

    model = read_model(args)
    data = Frf.load(args.data)
    _check_out(args, model)
    if args.structure:
        return _structure(model, data, args, log)
    given = {
        "start": _floats(args.start),
        "source": str(args.data),
        **keywords(args, "data", "start", "levels", "validate"),
    }
    experiment = None if args.refine is None else load_experiment(args.refine)
    given["levels"] = [Frf.load(path) for path in args.levels or ()]
    given["validate"] = [Frf.load(args.validate)] if args.validate else []
    found = fit(model, data, **given, progress=throttle(log))
    validation = []
    tell = throttle(log)
    checked: dict[str, Any] = {}
    if experiment is not None and not found.status.ended_early:
        log("refining by simulation: up to two minutes for six axes, seconds for planar arms")
        left = None if not args.time_limit else max(args.time_limit - found.wall_s, 1e-3)
        found, validated = _refine(found, experiment, left, tell)
        if validated is not None:
            checked["validation"] = vars(validated)
            validation.append(validation_text(validated, experiment.plan.motors))
    text = text_of_identification(found, *validation)
    usable = found.status != FitStatus.NOT_CONVERGED
    if args.move is not None and usable and not found.status.ended_early:
        checked["tool_errors"], words = _verdict(found, args, log)
        text += f"\n\n{words}"
    return with_files(
        text,
        found.to_dict() | checked,
        _files(found, args),
        found.problem,
        interrupted=is_interrupted(found),
    )


def _refine(found: Any, experiment: Any, time_limit: float | None, tell: Progress) -> Any:
    """The fit refined by simulation and its validation.

    The fit as it was where the time is over before a step.
    """
    from flexgen.identification.estimator.status import FitStatus
    from flexgen.identification.motions.time_domain import refine_and_validate

    try:
        return refine_and_validate(found, experiment, time_limit=time_limit, progress=tell)
    except OutOfTime:
        return replace(found, status=FitStatus.TIME_LIMIT), None
    except KeyboardInterrupt:
        return replace(found, status=FitStatus.INTERRUPTED), None


def _check_out(args: Namespace, model: Any) -> None:
    """Check before a fit that the new model file can be written with its numbers."""
    from flexgen.dynamics.mechanics.parameters import has_group

    names = [name for name in args.free or () if has_group(model, name)]
    check_model_file(args, model, names)


def _structure(model: Any, data: Any, args: Namespace, log: Progress) -> VerbResult:
    """Which springs without motor the data ask for: a table, and the tables of new springs for the
    model file.
    """
    from flexgen.identification.responses.structure import structure
    from flexgen.views.reports.identification_texts import structure_text

    alone(args, "--structure", *OF_RESPONSES, "free", "start")
    log("adding and removing springs: about a minute for six axes")
    found = structure(
        model, data, fixed=args.fixed or (), time_limit=args.time_limit, progress=throttle(log)
    )
    result = found.identified.to_dict() | {
        "added": list(found.added),
        "removed": list(found.removed),
        "changes": [vars(change) for change in found.changes],
    }
    files = _files(found.identified, args)
    if args.out is not None:
        files["model_file"] = partial(found.write, args.out)
    return with_files(
        structure_text(found),
        result,
        files,
        found.identified.problem,
        interrupted=is_interrupted(found.identified),
    )


def _rigid(args: Namespace, log: Progress) -> VerbResult:
    """Bodies, rotors and friction from recorded motions, and the stiffness of gears with encoders
    on both sides.
    """
    from flexgen.identification.rigid.rigid_file import identify_bodies

    alone(
        args, "--rigid", "structure", "segments", *OF_RESPONSES, "free", "fixed", "start", "report"
    )
    balance = {name: int(count) for name, count in args.counterbalance or ()}
    model = read_model(args)
    check_model_file(args, model)
    found = identify_bodies(
        model,
        args.data,
        validate=args.validate or None,
        counterbalance=balance,
        time_limit=args.time_limit,
        progress=log,
    )
    problem = (
        "" if found.fit.status.has_deviations else f"{found.fit.status}: {found.fit.texts[0]}"
    )
    return with_files(
        found.to_text(),
        found.to_dict(),
        _files(found, args),
        problem,
        interrupted=is_interrupted(found.fit),
    )


def _segments(args: Namespace, log: Progress) -> VerbResult:
    """Parameters of the nonlinear model from recorded torques and motions, in short segments."""
    from flexgen.identification.motions.motion_fit import fit_motion
    from flexgen.views.reports.identification_texts import text_of_motion_fit

    alone(args, "--segments", "structure", "rigid", *OF_RESPONSES, "counterbalance", "report")
    if args.free is None:
        raise ArgumentError("--segments: given no --free, expected the names of the parameters")
    start = {key: float(value) for key, value in args.start or ()}
    model = read_model(args)
    _check_out(args, model)
    found = fit_motion(
        model,
        args.data,
        segment_s=args.segments,
        free=args.free,
        fixed=args.fixed or (),
        start=start,
        validate=args.validate or None,
        time_limit=args.time_limit,
        progress=log,
    )
    return with_files(
        text_of_motion_fit(found, args.segments),
        found.to_dict(),
        _files(found, args),
        found.problem,
        interrupted=is_interrupted(found),
    )


def _verdict(found: Any, args: Namespace, log: Progress) -> tuple[list[dict[str, Any]], str]:
    """Tool errors of feedforward before and after: as data and as text."""
    from flexgen.views.reports.identification_texts import verdict_text

    if found.covariance is None and args.truth is None:
        words = (
            f"no tool errors of the move {args.move}: a result with {found.status} has no "
            "covariance to draw robots"
        )
        return [], f"{words} from; give --truth where the robot is known"
    log(f"tool errors of the move {args.move}: a few minutes for six axes")
    verdict = found.verdict(args.move, truth=args.truth, progress=throttle(log))
    rows = [{key: x for key, x in vars(row).items() if x is not None} for row in verdict.rows]
    return rows, verdict_text(verdict)


def _files(found: Any, args: Namespace) -> dict[str, Writer]:
    """Functions that write the new model file and the report, where they are asked for.

    Also of a search that did not come to its end: the file states its status.
    """
    files: dict[str, Writer] = {}
    if args.out is not None:
        files["model_file"] = partial(found.write, args.out)
    if args.report is not None:
        files["report"] = partial(found.report, args.report)
    return files


def _floats(settings: Any) -> dict[str, float]:
    """Pairs ``NAME=NUMBER`` of --start as floats; ArgumentError for another value."""
    out = {}
    for key, value in settings or ():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ArgumentError(f"--start {key}: given {value!r}, expected a number")
        out[key] = float(value)
    return out
