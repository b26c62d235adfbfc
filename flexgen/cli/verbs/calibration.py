"""The verb ``calibrate``."""

from __future__ import annotations

from argparse import Namespace
from functools import partial

from flexgen.base.calls.progress import throttle
from flexgen.base.errors import ArgumentError
from flexgen.cli.result import (
    Progress,
    VerbResult,
    Writer,
    check_model_file,
    is_interrupted,
    keywords,
    read_model,
    with_files,
)


def calibrate(args: Namespace, log: Progress) -> VerbResult:
    """Calibrate a model with static poses: joint zeros, kinematics, compliances, masses; write a
    new model file.
    """
    import flexgen
    from flexgen.identification.poses.poses import StaticPoses
    from flexgen.views.reports.text_tables import number, table

    model = read_model(args)
    if args.out is not None and (model.variant or not model.file.endswith(".toml")):
        raise ArgumentError(
            f"--out: given {args.model}, expected a .toml model file without @variant"
        )
    check_model_file(args, model)
    priors = flexgen.Priors()
    for name, value in args.prior or ():
        if name not in vars(priors) or not isinstance(value, int | float):
            raise ArgumentError(
                f"--prior: given {name}={value}, expected a number for one of "
                f"{', '.join(vars(priors))}"
            )
        priors = flexgen.Priors(**(vars(priors) | {name: float(value)}))
    poses = StaticPoses.read(args.poses, model, args.columns)
    given = keywords(args, "poses", "priors", "columns")
    found = flexgen.calibrate(model, poses, priors=priors, **given, progress=throttle(log))
    data = found.to_dict()
    text = found.to_text()
    files = dict[str, Writer]()
    if args.add_poses and not found.ended:
        names = [c.name for c in model.coordinates if c.actuated]
        proposed = found.propose_poses(args.add_poses)
        data["proposed_poses"] = [dict(zip(names, row, strict=True)) for row in proposed.tolist()]
        rows = [[number(float(x)) for x in row] for row in proposed]
        text += (
            "\n"
            "\n"
            "poses that tell most, rad or m; check them for collisions:\n"
            "\n"
            f"{table(rows, names)}"
        )
    if args.out is not None:
        files["model_file"] = partial(found.write, args.out, args.world or "robot")
    if args.report is not None:
        files["report"] = partial(found.report, args.report)
    return with_files(
        text,
        data,
        files,
        found.problem,
        warnings=list(found.warnings),
        interrupted=is_interrupted(found),
    )
