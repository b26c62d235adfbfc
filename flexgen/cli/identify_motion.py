"""`identify` from recorded motions: rigid bodies and friction, and fits in the time domain."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

from flexgen.cli.printing import number, paragraph, table
from flexgen.cli.verbs import Progress, VerbResult, read_model, writing
from flexgen.errors import ArgumentError


def rigid(args: Namespace, log: Progress) -> VerbResult:
    """Bodies, rotors and friction from recorded motions, and the stiffness of gears with encoders on both sides."""
    from flexgen.identification.recordings.description import read_description
    from flexgen.identification.recordings.rigid_body import identify_rigid
    from flexgen.identification.recordings.rigid_file import motions_of, write_rigid

    _only(args, "--rigid", "free", "start", "refine", "move", "truth", "structure", "segments")
    model, data = read_model(args), read_description(args.frf)
    held_out = None if args.validate is None else read_description(args.validate)
    log(f"fitting the bodies of {model.name} to {len(data.recordings)} recordings")
    balance = {name: int(count) for name, count in args.counterbalance or ()}
    found = identify_rigid(model, motions_of(data), counterbalance=balance)
    motors = [motor.name for motor in model.motors]
    errors = {"fitted": [found.relative_errors(motion).tolist() for motion in motions_of(data)]}
    if held_out is not None:
        errors["validated"] = [found.relative_errors(motion).tolist() for motion in motions_of(held_out)]
    rows = []
    for j, motor in enumerate(found.model.motors):
        law = motor.friction
        cells: list[Any] = [motor.name, motor.inertia, law.viscous, law.coulomb, law.offset]
        rows.append(cells + [100 * run[j] for runs in errors.values() for run in runs])
    head = ["motor", "inertia, kg m^2", "viscous, N m s/rad", "Coulomb, N m", "constant, N m"]
    head += [f"{name} {k}, error %" for name, runs in errors.items() for k in range(1, len(runs) + 1)]
    lines = [
        f"{model.name}: {found.base_parameters} base parameters of {len(found.pi)} numbers",
        "errors: rms over the standard deviation of the torque, of samples that move",
        "",
        table(rows, tuple(head)),
    ]
    result: dict[str, Any] = {
        "model": model.name,
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
        with writing(args.out):
            result["model_file"] = str(write_rigid(found, args.out, str(args.frf)))
        lines += ["", f"wrote {args.out}"]
    return VerbResult(result, "\n".join(lines))


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

    _only(args, "--segments", "refine", "move", "truth", "structure", "rigid", "counterbalance", "report")
    if args.free is None:
        raise ArgumentError("--segments: given no --free, expected the names of the parameters")
    model = read_model(args)
    found = fit_motion(
        model,
        args.frf,
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
    result: dict[str, Any] = {
        "model": model.name,
        "status": str(found.status),
        "parameters": [{"name": n, "value": values[n], "sd": sd[n]} for n in values],
        "fit_percent": list(found.fit_percent),
        "held_out_percent": list(found.held_out_percent),
        "white": list(found.white),
        "rms": list(found.rms),
    }
    if args.out is not None and found.status != FitStatus.NOT_CONVERGED:
        with writing(args.out):
            result["model_file"] = str(found.write(args.out))
        lines.append(f"wrote {args.out}")
    problem = "" if found.status == FitStatus.FITTED else f"{found.status}: {found.status.sentence}"
    return VerbResult(result, "\n".join(lines), problem=problem)


def _only(args: Namespace, option: str, *others: str) -> None:
    """ArgumentError for options that do not go with this one."""
    given = [f"--{name}" for name in others if getattr(args, name, None)]
    if given:
        raise ArgumentError(f"{option}: given with {', '.join(given)}, expected without")
