"""`identify` from recorded motions: rigid bodies and friction, and fits in the time domain."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

from flexgen.cli.printing import number, paragraph, table
from flexgen.cli.result import Progress, VerbResult, alone, read_model
from flexgen.errors import ArgumentError

OF_RESPONSES = ("residual", "floor", "starts", "refine", "move", "truth")  # options of fits to frequency responses


def rigid(args: Namespace, log: Progress) -> VerbResult:
    """Bodies, rotors and friction from recorded motions, and the stiffness of gears with encoders on both sides."""
    from flexgen.identification.recordings.description import read_description
    from flexgen.identification.recordings.rigid_accuracy import RigidStatus
    from flexgen.identification.recordings.rigid_body import identify_rigid
    from flexgen.identification.recordings.rigid_file import motions_of, rigid_deviations, rigid_numbers, write_rigid

    alone(args, "--rigid", "structure", "segments", *OF_RESPONSES, "free", "fixed", "start", "report")
    model, data = read_model(args), read_description(args.data)
    held_out = None if args.validate is None else read_description(args.validate)
    log(f"fitting the bodies of {model.name} to {len(data.recordings)} recordings")
    balance = {name: int(count) for name, count in args.counterbalance or ()}
    fitted = motions_of(data)
    found = identify_rigid(model, fitted, counterbalance=balance, **({} if held_out is None else {"parts": 0}))
    motors = [motor.name for motor in model.motors]
    errors = {"fitted": [found.relative_errors(motion).tolist() for motion in fitted]}
    if held_out is not None:
        others = motions_of(held_out)
        errors["validated"] = [found.relative_errors(motion).tolist() for motion in others]
        found = found.validated(fitted, others)
    elif found.left_out is not None:
        errors["left out"] = [found.left_out.tolist()]
    numbers, sd = rigid_numbers(found), rigid_deviations(found)
    lines = [
        f"{model.name}: {found.status}, {found.base_parameters} base parameters of {len(found.pi)} numbers",
        paragraph(f"{found.status.sentence} {found.status.advice}"),
        "",
        "errors: rms over the standard deviation of the torque, of samples that move; left out: on quarters of the "
        "recordings, of the fit to the others",
        "",
        *_rigid_tables(found, numbers, sd, errors),
    ]
    result: dict[str, Any] = {
        "model": model.name,
        "status": str(found.status),
        "parameters": [{"name": name, "value": value, "sd": sd.get(name)} for name, value in numbers.items()],
        "base_parameters": found.base_parameters,
        "motors": motors,
        "relative_errors": errors,
        "bodies": {element.name: vars(element.body) for element in found.model.elements},
    }
    springs = _deflections(found, data)
    if springs:
        result["gear_stiffness"] = {
            name: {"stiffness": d.stiffness, "interval": list(d.interval), "skew_s": d.skew_s} for name, d in springs
        }
        lines += ["", "stiffness of the gears from the link encoders, arm side, 90 % interval:", ""]
        lines += [f"  {name}: {deflection.sentence}" for name, deflection in springs]
    if args.out is not None:
        result["model_file"] = str(write_rigid(found, args.out, str(args.data)))
        lines += ["", f"wrote {args.out}"]
    good = found.status in (RigidStatus.FITTED, RigidStatus.NOT_CHECKED)
    return VerbResult(result, "\n".join(lines), problem="" if good else f"{found.status}: {found.status.sentence}")


def _rigid_tables(found: Any, numbers: dict[str, float], sd: dict[str, float], errors: dict[str, Any]) -> list[str]:
    """Frictions and rotors with their standard deviations and errors, and counterbalances."""

    def both(name: str) -> str:
        return f"{number(numbers[name])} +- {sd[name]:.2g}" if name in sd else number(numbers[name])

    kinds = {"inertia": "kg m^2", "viscous": "N m s/rad", "coulomb": "N m", "offset": "N m"}
    rows: list[list[Any]] = []
    for j, motor in enumerate(found.model.motors):
        cells: list[Any] = [motor.name, *(both(f"{motor.name}.{kind}") for kind in kinds)]
        rows.append(cells + [100 * run[j] for runs in errors.values() for run in runs])
    head = ["motor", *(f"{kind}, {unit}" for kind, unit in kinds.items())]
    head += [f"{name} {k}, error %" for name, runs in errors.items() for k in range(1, len(runs) + 1)]
    lines = [table(rows, tuple(head))]
    balance = [[name, both(name)] for name in numbers if ".counterbalance_" in name]
    return [*lines, "", table(balance, ("counterbalance", "N m, arm side"))] if balance else lines


def _deflections(found: Any, data: Any) -> list[tuple[str, Any]]:
    """Gear deflections of the coordinates that have a link encoder in the recordings."""
    import numpy as np

    from flexgen.identification.recordings.gear_deflection import gear_deflection
    from flexgen.identification.recordings.rigid_file import motions_of

    model, out = data.model, []
    names = [model.coordinates[i].name for i in model.i_g]
    of = {name: sensor for sensor in model.sensors for name in sensor.channels}
    motions = motions_of(data)
    torques = np.vstack([found.gear_torques(motion) for motion in motions])
    motor_side = np.vstack([motion.q for motion in motions])
    step = data.recordings[0][1].sample_s
    for c, channel in enumerate(data.sensors):
        sensor = of[channel]
        if sensor.type != "link_encoder" or sensor.place not in names:
            continue
        j = names.index(sensor.place)
        link = np.concatenate([run.signals[:, c] for _, run in data.recordings])
        t = step * np.arange(len(link))
        out.append((sensor.place, gear_deflection(t, motor_side[:, j], link, torques[:, j])))
    return out


def segments(args: Namespace, log: Progress) -> VerbResult:
    """Parameters of the nonlinear model from recorded torques and motions, in short segments."""
    from flexgen.identification.motion_fit import fit_motion
    from flexgen.identification.result import FitStatus, deviation_text

    alone(args, "--segments", "structure", "rigid", *OF_RESPONSES, "counterbalance", "report")
    if args.free is None:
        raise ArgumentError("--segments: given no --free, expected the names of the parameters")
    model = read_model(args)
    found = fit_motion(
        model,
        args.data,
        free=args.free,
        fixed=args.fixed,
        start={key: float(value) for key, value in args.start or ()},
        segment_s=args.segments,
        validate=args.validate,
        progress=log,
    )
    values, sd = found.values, found.sd
    rows = [
        [u.name, values[u.name], u.parameter.unit, deviation_text(sd[u.name], u.scale == "log"), u.start,
         "not determined" if found.is_weak(u.name) else ""]
        for u in found.vector.unknowns
    ]  # fmt: skip
    outputs = [motor.name for motor in model.motors]
    outputs += [f"link encoder {k}" for k in range(1, len(found.rms) - len(outputs) + 1)]
    quality = [
        [name, rms, fit, 100 * white, *([found.held_out_percent[k]] if found.held_out_percent else [])]
        for k, (name, rms, fit, white) in enumerate(
            zip(outputs, found.rms, found.fit_percent, found.white, strict=True)
        )
    ]
    head = ["output", "residual rms", "fit, %", "white lags, %"] + ["held out, %"] * bool(found.held_out_percent)
    lines = [
        f"{model.name}: {found.status}, {found.segments} segments of {number(args.segments)} s, "
        f"{number(found.wall_s)} s",
        paragraph(f"{found.status.sentence} {found.status.advice}"),
        "",
        table(rows, ("parameter", "value", "unit", "sd", "start", "")),
        "",
        table(quality, tuple(head)),
        "",
        *(f"{line}." for line in found.weak),
    ]
    result = found.to_dict()
    if args.out is not None and found.status != FitStatus.NOT_CONVERGED:
        result["model_file"] = str(found.write(args.out))
        lines.append(f"wrote {args.out}")
    problem = "" if found.status == FitStatus.FITTED else f"{found.status}: {found.status.sentence}"
    return VerbResult(result, "\n".join(lines), problem=problem)
