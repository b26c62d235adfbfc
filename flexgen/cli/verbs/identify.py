"""The verbs of identification: excite, measure, frf, identify."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable
from typing import Any

from flexgen.cli.printing import number, paragraph, table
from flexgen.cli.result import Progress, VerbResult, alone, keywords, read_model
from flexgen.cli.verbs.identify_motion import OF_RESPONSES, rigid, segments
from flexgen.errors import ArgumentError

EVERY = 2.0  # s between progress messages
HARDWARE = {  # options of `excite` and the fields of DriveHardware
    "sample_time": "sample_s",
    "delay": "delay_s",
    "encoder_resolution": "encoder_resolution_rad",
    "encoder_noise": "encoder_noise_rad",
    "torque_noise": "torque_noise_Nm",
}


def throttle(log: Progress) -> Callable[[str], None]:
    """Print a message now and then."""
    last = time.monotonic()

    def tell(text: str) -> None:
        nonlocal last
        if time.monotonic() - last > EVERY:
            last = time.monotonic()
            log(text)

    return tell


def excite(args: Namespace, log: Progress) -> VerbResult:
    """Plan an experiment for identification: poses, multisines, expected accuracy."""
    from flexgen.identification.experiments.plan import excite as plan_experiment
    from flexgen.loop.hardware import DriveHardware

    model = read_model(args)
    hardware = DriveHardware.from_model(model, **{HARDWARE[x]: getattr(args, x) for x in HARDWARE if x in args.given})
    plan = plan_experiment(model, hardware=hardware, **keywords(args), progress=throttle(log))
    plan.save(args.out)
    written = [str(args.out)]
    if args.references is not None:
        written.append(f"{args.references}, {len(plan.write_references(args.references))} files of references")
    joints = (plan.poses @ _inverse(model).T).tolist()
    rows = [[name, 100 * sd] for name, sd in plan.predicted.items()]
    text = "\n".join(
        [
            f"{model.name}: {len(plan.poses)} poses, {plan.realizations * plan.experiments} experiments each, "
            f"{len(plan.lines)} lines from {number(plan.frequencies[0])} to {number(plan.frequencies[-1])} Hz",
            f"time of the robot: {number(plan.duration_s)} s",
            "",
            table(
                [[k, *q] for k, q in enumerate(joints, 1)], ("pose", *(model.coordinates[i].name for i in model.i_g))
            ),
            "",
            table(rows, ("parameter", "expected standard deviation, %")),
            "",
            *(f"wrote {line}" for line in written),
        ]
    )
    data = {
        "model": model.name,
        "plan": str(args.out),
        "duration_s": plan.duration_s,
        "frequencies_Hz": plan.frequencies.tolist(),
        "poses": joints,
        "expected_relative_sd": plan.predicted,
    }
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
    experiment.save(args.out)
    text = (
        f"{robot.name}: {number(plan.duration_s)} s of robot in {number(wall)} s\n\n"
        + table(
            [[k, *speed] for k, speed in enumerate(experiment.speed_sd.tolist(), 1)],
            ("pose", *(f"{name}, rad/s rms" for name in plan.motors)),
        )
        + f"\n\nwrote {args.out}"
    )
    data = {
        "model": robot.name,
        "experiment": str(args.out),
        "duration_s": plan.duration_s,
        "wall_s": wall,
        "speed_rms_rad_s": experiment.speed_sd.tolist(),
        "samples_at_torque_limit": experiment.saturated.tolist(),
    }
    if writer is not None:
        data["recordings"] = str(writer.finish())
        text += f"\nwrote {data['recordings']}, {len(writer.files)} files with all samples"
    warnings = []
    if experiment.saturated.any():
        warnings.append("torques were at their limits: 'flexgen frf' refuses these data; take less --speed-rms")
    return VerbResult(data, text, warnings=warnings)


def frf(args: Namespace, log: Progress) -> VerbResult:
    """Estimate frequency responses and their noise from an experiment."""
    from flexgen.identification.experiments.experiment import Experiment
    from flexgen.identification.frequency_response import frf as estimate
    from flexgen.identification.recordings.description import is_description
    from flexgen.identification.recordings.experiment_file import read_experiment

    if is_description(args.experiment):
        log(f"reading the recordings of {args.experiment}")
        experiment = read_experiment(args.experiment)
    else:
        experiment = Experiment.load(args.experiment)
    found = estimate(experiment, **keywords(args, "experiment"))
    found.save(args.out)
    data: dict[str, Any] = {
        "model": found.model,
        "frf": str(args.out),
        "poses": len(found.poses),
        "lines": len(found.w),
        "outputs": list(found.outputs),
        "median_relative_sd": found.relative_sd(),
    }
    text = (
        f"{found.model}: {len(found.poses)} poses, {len(found.w)} lines, {len(found.outputs)} x {len(found.motors)}\n"
        f"median standard deviation by noise: {number(100 * found.relative_sd())} %\n\nwrote {args.out}"
    )
    if args.report is not None:
        from flexgen.reports.identification_page import write_responses

        page = write_responses(found, args.report)
        data["report"] = str(page)
        text += f"\nwrote {page}"
    return VerbResult(data, text, warnings=list(found.warnings))


def identify(args: Namespace, log: Progress) -> VerbResult:
    """Fit parameters of a model to frequency responses or to recorded motions; write a new model file."""
    if args.rigid or args.segments is not None:
        return rigid(args, log) if args.rigid else segments(args, log)
    if args.validate is not None or args.counterbalance:
        raise ArgumentError("--validate, --counterbalance: given without --rigid or --segments, expected with them")
    if args.truth is not None and args.move is None:
        raise ArgumentError("--truth: given without --move, expected also --move NAME, whose tool error is compared")
    from flexgen.identification.frequency_response import Frf
    from flexgen.identification.graybox import identify as fit
    from flexgen.identification.result import FitStatus, deviation_text

    model, data = read_model(args), Frf.load(args.data)
    if args.structure:
        return _structure(model, data, args, log)
    found = fit(
        model,
        data,
        start=_floats(args.start),
        source=str(args.data),
        **keywords(args, "data", "start"),
        progress=throttle(log),
    )
    validation: tuple[dict[str, Any], list[str]] = ({}, [])
    if args.refine is not None:
        found, validation = _refine(found, args, log)
    result = found.to_dict() | validation[0]
    rows = [
        [
            row["name"], row["value"], row["unit"], deviation_text(row["sd"], row["sd_is_relative"]),
            row["start"], "at its bound" if row["at_bound"] else "not determined" if row["weak"] else "",
        ]
        for row in result["parameters"]
    ]  # fmt: skip
    lines = [
        f"{model.name}: {found.status}, cost {number(found.cost)} (1 expected), reached by {found.agreed} of "
        f"{found.starts} starts, {number(found.wall_s)} s",
        paragraph(f"{found.status.sentence} {found.status.advice}"),
        "",
        table(rows, ("parameter", "value", "unit", "sd", "start", "")),
    ]
    if found.model_error > 0:
        lines.insert(1, f"model error: {number(100 * found.model_error)} % of the responses")
    lines += validation[1]
    lines += ["", *(f"{line}." for line in found.weak)]
    if args.move is not None and found.status != FitStatus.NOT_CONVERGED:
        compared, words = _verdict(found, args, log)
        result["tool_errors"] = compared
        lines += ["", words, ""]
    files = _write(found, args) if found.status != FitStatus.NOT_CONVERGED else []
    result |= dict(files)
    lines += [f"wrote {path}" for _, path in files]
    problem = "" if found.status == FitStatus.FITTED else f"{found.status}: {found.status.sentence}"
    return VerbResult(result, "\n".join(lines), problem=problem)


def _structure(model: Any, data: Any, args: Namespace, log: Progress) -> VerbResult:
    """Which springs without motor the data ask for: a table, and the tables of new springs for the model file."""
    from flexgen.identification.result import FitStatus
    from flexgen.identification.structure import structure

    alone(args, "--structure", *OF_RESPONSES, "free", "start", "out")
    log("adding and removing springs: about a minute for six axes")
    found = structure(model, data, fixed=args.fixed, progress=throttle(log))
    rows = [
        [c.kind, c.name, c.gain, "" if c.held_out is None else c.held_out, "kept" if c.kept else ""]
        for c in found.changes
    ]
    status = found.identified.status
    lines = [
        f"{model.name}: added {', '.join(found.added) or 'nothing'}, removed {', '.join(found.removed) or 'nothing'}",
        f"fit of the result: {status}, cost {number(found.identified.cost)} (1 expected)",
        "",
        table(rows, ("change", "coordinate", "gain of the criterion", "cost at held-out poses, ratio", "")),
    ]
    new = {dof.name: (e.name, dof) for e in found.model.elements for dof in e.dofs if dof.name in found.added}
    for name, (element, dof) in new.items():
        stiffness = getattr(dof.spring, "stiffness", 0.0)
        lines += [
            "",
            f"for the model file, in the element {element} behind the joint {name.rpartition('_')[0]}:",
            "",
            "[[element.dof]]",
            f'name = "{name}"',
            'type = "rotation"',
            f"axis = [{', '.join(f'{x:.6g}' for x in dof.axis)}]",
            f'spring = {{ type = "linear", stiffness = {stiffness:.6g} }}',
            f"damping = {dof.damping:.6g}",
        ]
    result = found.identified.to_dict() | {
        "added": list(found.added),
        "removed": list(found.removed),
        "changes": [vars(change) for change in found.changes],
    }
    problem = "" if status == FitStatus.FITTED else f"{status}: {status.sentence}"
    if args.report is not None:
        page = str(found.identified.report(args.report))
        result["report"] = page
        lines += ["", f"wrote {page}"]
    return VerbResult(result, "\n".join(lines), problem=problem)


def _refine(found: Any, args: Namespace, log: Progress) -> tuple[Any, tuple[dict[str, Any], list[str]]]:
    """The parameters refined by simulation of the experiment, and what other experiments say of them."""
    from flexgen.identification.experiments.experiment import Experiment
    from flexgen.identification.recordings.description import is_description
    from flexgen.identification.recordings.experiment_file import read_experiment
    from flexgen.identification.time_domain import refine, validate, validate_on_others

    experiment = read_experiment(args.refine) if is_description(args.refine) else Experiment.load(args.refine)
    log("refining by simulation: up to two minutes for six axes, seconds for planar arms")
    fine = refine(found, experiment, progress=throttle(log))
    plan = experiment.plan
    if plan.experiments * plan.realizations < 2:
        return fine, ({}, [])
    checked = validate(fine, experiment)
    data = {"fit_percent": list(checked.fit_percent), "cost": checked.cost, "white": list(checked.white)}
    rows = [
        [name, fit, 100 * white]
        for name, fit, white in zip(plan.motors, checked.fit_percent, checked.white, strict=True)
    ]
    lines = [
        "",
        f"simulation of experiments that were not used: cost {number(checked.cost)} (1 expected)",
        "",
        table(rows, ("motor", "fit, %", "white lags, %")),
    ]
    return validate_on_others(fine, checked), ({"validation": data}, lines)


def _verdict(found: Any, args: Namespace, log: Progress) -> tuple[list[dict[str, Any]], str]:
    """Tool errors of feedforward before and after: as data and as text."""
    if found.covariance is None and args.truth is None:
        words = f"no tool errors of the move {args.move}: a result with {found.status} has no covariance to draw robots"
        return [], f"{words} from; give --truth where the robot is known"
    robot = "the robot of --truth" if args.truth else "robots drawn from the covariance"
    log(f"tool errors of the move {args.move}: a few minutes for six axes")
    verdict = found.verdict(args.move, truth=args.truth, progress=throttle(log))
    data: list[dict[str, Any]] = []
    rows: list[list[Any]] = []
    for row in verdict.rows:
        entry: dict[str, Any] = {"model": row.model}
        cells: list[Any] = [row.model]
        for unit, key in (("m", "error_m"), ("rad", "error_rad")):
            if getattr(row, key) is not None:
                entry[key] = list(getattr(row, key))
                cells += [1e6 * row.quantile(0.5, unit), 1e6 * row.quantile(0.95, unit)]
        data.append(entry)
        rows.append(cells)
    head = ["torques of the model"]
    for unit, key in (("um", "error_m"), ("urad", "error_rad")):
        if getattr(verdict.rows[0], key) is not None:
            head += [f"median, {unit}", f"95 %, {unit}"]
    title = f"largest tool error of the move {verdict.move} with motor feedback, {verdict.robots} x {robot}:"
    return data, f"{title}\n\n{table(rows, tuple(head))}"


def _write(found: Any, args: Namespace) -> list[tuple[str, str]]:
    """The new model file and the report, where they are asked for."""
    out = []
    if args.out is not None:
        out.append(("model_file", str(found.write(args.out))))
    if args.report is not None:
        out.append(("report", str(found.report(args.report))))
    return out


def _inverse(model: Any) -> Any:
    import numpy as np

    return np.linalg.inv(model.eta)


def _floats(settings: Any) -> dict[str, float]:
    out = {}
    for key, value in settings or ():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ArgumentError(f"--start {key}: given {value!r}, expected a number")
        out[key] = float(value)
    return out
