"""The verbs of exchange with other tools: robot descriptions, the schema of model files, the robot in the browser."""

from __future__ import annotations

import json
from argparse import Namespace

from flexgen.atomic_files import write_text
from flexgen.cli.result import Progress, VerbResult, check_writable, read_model, writing
from flexgen.errors import ArgumentError


def mujoco(args: Namespace, log: Progress) -> VerbResult:
    """Write the elastic robot as an MJCF file for MuJoCo, with the same accelerations."""
    check_writable(args.out)
    from flexgen.exports.mujoco import export_mujoco

    model = read_model(args)
    with writing(args.out):
        path = export_mujoco(model, args.out, friction=args.friction)
    data = {"model": model.name, "variant": model.variant, "friction": args.friction, "out": str(path)}
    return VerbResult(data, f"wrote {path}: {model.title}, {model.dof} joints, {model.n_m} motors")


def urdf(args: Namespace, log: Progress) -> VerbResult:
    """Write the rigid robot as a URDF file, and an overlay of flexgen with all that URDF cannot contain."""
    check_writable(args.out)
    from flexgen.exports.urdf import export_urdf

    model = read_model(args)
    with writing(args.out):
        paths = [str(path) for path in export_urdf(model, args.out)]
    data = {"model": model.name, "variant": model.variant, "out": paths[0], "overlay": paths[1]}
    return VerbResult(data, f"wrote {paths[0]}: {model.title}, rigid\nwrote {paths[1]}: gears, motors, springs, moves")


def added(args: Namespace, log: Progress) -> VerbResult:
    """Write the robot by an exporter of another package."""
    from flexgen.exports.added import export

    model = read_model(args)
    files = [str(path) for path in export(args.kind, model, args.out).files]
    return VerbResult({"model": model.name, "variant": model.variant, "files": files}, f"wrote {', '.join(files)}")


def schema(args: Namespace, log: Progress) -> VerbResult:
    """Print the JSON schema of model files, for completion and explanations in an editor."""
    check_writable(args.out)
    from flexgen.exports.schema import schema as model_schema

    data = model_schema(args.kind)
    text = json.dumps(data, indent=1)
    if args.out is None:
        return VerbResult(data, text)
    path = write_text(args.out, text + "\n")
    return VerbResult(
        {"kind": args.kind, "out": str(path)}, f"wrote {path}; first line of a model file: #:schema {path}"
    )


def view(args: Namespace, log: Progress) -> VerbResult:
    """Show robot, move and deflections in the browser (one HTML file), or in a video."""
    check_writable(args.out)
    check_writable(args.video)
    from flexgen.reports.view import TRAJECTORIES
    from flexgen.reports.view import view as show

    if args.out is None and args.video is None:
        raise ArgumentError("--out: given neither --out nor --video, expected a file to write")
    of_file = str(args.model).endswith(TRAJECTORIES)
    if args.set and of_file:
        raise ArgumentError("--set: given with a trajectory, expected a model (or --robot MODEL for a trajectory)")
    if args.robot is not None and not of_file:
        raise ArgumentError(
            f"--robot: given {args.robot!r} with the model {str(args.model)!r}, expected it with a trajectory only, "
            "a file that ends in .npz or .csv"
        )
    if args.move is not None and of_file:
        raise ArgumentError(f"--move: given {args.move!r} with a trajectory, expected it with a model only")
    what = args.model if of_file else read_model(args)
    show(what, args.out, model=args.robot, move=args.move, video=args.video, progress=log)
    paths = {key: str(path) for key, path in (("out", args.out), ("video", args.video)) if path is not None}
    return VerbResult(paths, "\n".join(f"wrote {path}" for path in paths.values()))
