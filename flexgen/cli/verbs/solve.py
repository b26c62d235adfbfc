"""The verbs ``solve``, ``simulate`` and ``sense`` of the command line."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import check_writable
from flexgen.cli.result import (
    Progress,
    VerbResult,
    alone,
    check_report,
    derive_model,
    keywords,
    wall_of,
    with_files,
)
from flexgen.inversion.judge.status import Status
from flexgen.views.reports.text_tables import table

if TYPE_CHECKING:
    from flexgen.dynamics.mechanics.equations import Equations
    from flexgen.inversion.solution import Solution
    from flexgen.model.elements import RobotModel

EXCEEDED = 3  # exit status of a solution beyond the limits of the model file
COMMAND = "command"  # ending of the file with the torques that the controller sends


def solve(args: Namespace, log: Progress) -> VerbResult:
    """Compute the motor torques that make the output follow a move, and verify them by
    simulation.
    """
    if args.robustness and args.report is None:
        raise ArgumentError(
            "--robustness: given without --report, expected also --report DIR, because the "
            "table is part of the report"
        )
    if not args.verify:
        alone(args, "--no-verify", "accuracy", "robustness")
    outputs = [(args.out, args.report)]
    if len(args.move or ()) > 1:
        outputs = [(_insert_name(args.out, name), _below(args.report, name)) for name in args.move]
    for out, report in outputs:
        check_report(report)
        check_writable(out)
        if _sends(args):
            check_writable(_insert_name(out, COMMAND))
    equations = derive_model(args, log)
    from flexgen.paths.move_files import find_move_in

    moves = [find_move_in(args.moves, name, equations.model) for name in args.move or [None]]
    _announce(args, equations.model, log)
    found = []
    for k, (move, paths) in enumerate(zip(moves, outputs, strict=True), 1):
        if len(moves) > 1:
            log(f"move {move.name} ({k} of {len(moves)})")
        found.append(solve_one(args, equations, move, paths, log))
        if found[-1].interrupted:
            break
    if len(moves) == 1:
        return found[0]
    return VerbResult(
        {"model": equations.model.name, "solutions": [result.data for result in found]},
        "\n\n".join(result.text for result in found),
        "; ".join(
            f"move {m.name}: {r.problem}" for m, r in zip(moves, found, strict=False) if r.problem
        ),
        [
            f"move {m.name}: {line}"
            for m, r in zip(moves, found, strict=False)
            for line in r.warnings
        ],
        "\n\n".join(result.details for result in found),
        found[-1].interrupted,
        min((r.failure for r in found if r.problem), default=1),
    )


def _sends(args: Namespace) -> bool:
    """Whether the torques that the controller sends differ from the samples of the trajectory."""
    return bool(args.hold != "spline" or args.sample_time is not None or args.delay > 0)


def _insert_name(path: Path | None, name: str) -> Path | None:
    """``line.npz`` as ``line_NAME.npz``."""
    return None if path is None else path.with_name(f"{path.stem}_{name}{path.suffix}")


def _below(directory: Path | None, name: str) -> Path | None:
    """``DIR/NAME``."""
    return None if directory is None else directory / name


def _announce(args: Namespace, robot: RobotModel, log: Progress) -> None:
    """Report before a computation that takes minutes that it does."""
    from flexgen.inversion.choice import FULL_LARGEST

    if args.method == "full" and robot.n_a > FULL_LARGEST:
        log(
            f"method full with {robot.n_a} coordinates takes many minutes; --method lq takes "
            "seconds"
        )


def solve_one(
    args: Namespace,
    equations: Equations,
    move: Any,
    outputs: tuple[Path | None, Path | None],
    log: Progress,
) -> VerbResult:
    """Solve one move; write trajectory and report to the two paths, where given."""
    from flexgen.dynamics.mechanics.limits import Limits
    from flexgen.inversion.problem.problem_text import problem_of
    from flexgen.inversion.solve import solve as solve_move
    from flexgen.views.reports.texts import solution_details, summary_of_solution

    out, report = outputs
    given = keywords(args, "move", "limits", "ignore_limits", "fastest")
    limits = Limits.from_model(equations.model) if args.limits else None
    if args.fastest:
        from flexgen.planning.fastest.minimum_time import fastest

        move = fastest(
            equations, move, limits=limits, time_limit=args.time_limit, progress=log
        ).move
        limits = None
    solution = solve_move(
        equations,
        move,
        limits=limits,
        ignore_limits=args.ignore_limits or args.fastest,
        **given,
        progress=log,
    )
    data = solution.to_dict()
    files = {}
    if out is not None:
        files["trajectory"] = solution.trajectory.save(out)
        if solution.torque_command is not None:
            files["torque_command"] = solution.torque_command.save(
                out.with_name(f"{out.stem}_{COMMAND}{out.suffix}")
            )
    if report is not None and not solution.interrupted:
        from flexgen.feedback.loop.comparison import compare

        comparison = compare(solution, robustness=args.robustness, progress=log)
        data |= comparison.to_dict()
        files["report"] = comparison.report(report)
    text = solution.to_text() if args.details else summary_of_solution(solution)
    is_exact = solution.status != Status.BASELINE and not problem_of(solution, args.accuracy)
    if equations.model.uncertainty is not None and is_exact:
        from flexgen.studies.tolerances.prediction import predict

        prediction = predict(equations, solution=solution, progress=log)
        data["prediction"] = prediction.to_dict()
        text = "\n\n".join([text, "\n".join(prediction.lines())])
    more: dict[str, Any] = {
        "warnings": list(solution.warnings),
        "details": solution_details(solution),
    }
    more |= {"interrupted": solution.interrupted, "failure": failure_of(solution)}
    return with_files(text, data, files, problem_of(solution, args.accuracy), **more)


def failure_of(solution: Solution) -> int:
    """The exit status of a solution that cannot be used."""
    return EXCEEDED if solution.status == Status.LIMITS_EXCEEDED else 1


def simulate(args: Namespace, log: Progress) -> VerbResult:
    """Simulate the robot under the motor torques of a trajectory."""
    from flexgen.simulation.simulate import simulate as simulate_model

    equations = derive_model(args, log)
    simulation = simulate_model(
        equations,
        args.trajectory,
        wall=wall_of(args),
        time_limit=args.time_limit,
        progress=log,
    )
    data = {"model": equations.model.name, **simulation.to_dict()}
    warnings = data.pop("warnings")
    files = {"trajectory": None if args.out is None else simulation.save(args.out)}
    text = (
        f"{equations.model.title} under the motor torques of {args.trajectory}\n"
        "\n"
        f"{simulation.to_text()}"
    )
    return with_files(text, data, files, warnings=warnings)


def sense(args: Namespace, log: Progress) -> VerbResult:
    """Compute what the sensors of a model read along a motion."""
    from flexgen.base.motion.trajectory import Trajectory
    from flexgen.simulation.environment.sense import sense as sense_motion

    equations = derive_model(args, log)
    seen = sense_motion(equations, Trajectory.load(args.motion))
    rows = []
    ranges = {}
    for name in seen.channels:
        for label, unit, x in zip(seen.labels[name], seen.units[name], seen[name].T, strict=True):
            rows.append([label, unit, float(x.min()), float(x.max()), float((x**2).mean() ** 0.5)])
            ranges[label] = {
                "unit": unit,
                "least": rows[-1][2],
                "largest": rows[-1][3],
                "rms": rows[-1][4],
            }
    data = {"model": equations.model.name, "sensors": ranges}
    text = f"{equations.model.title}: sensors along {args.motion}\n\n"
    text += table(rows, ("", "unit", "least", "largest", "effective"))
    return with_files(
        text, data, {"trajectory": None if args.out is None else seen.save(args.out)}
    )
