"""The verbs ``solve`` and ``simulate`` of the command line."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.cli.printing import duration, figure_rows, figures, paragraph, suggestion
from flexgen.cli.result import Progress, VerbResult, alone, check_report, check_writable, derive_model, keywords
from flexgen.display import plain
from flexgen.errors import ArgumentError
from flexgen.inversion.status import Status

if TYPE_CHECKING:
    from flexgen.inversion.bounds import Limits
    from flexgen.inversion.solution import Solution
    from flexgen.mechanics.equations import Equations
    from flexgen.model.elements import RobotModel

EXCEEDED = 3  # exit status of a solution beyond the limits of the model file
COMMAND = "command"  # ending of the file with the torques that the controller sends
RUN = 0.25  # time of a simulation of another robot, relative to the verification, whose tolerance is tighter


def solve(args: Namespace, log: Progress) -> VerbResult:
    """Compute the motor torques that make the output follow a move, and verify them by simulation."""
    if args.robustness and args.report is None:
        raise ArgumentError(
            "--robustness: given without --report, expected also --report DIR, because the table is part of the report"
        )
    if not args.verify:
        alone(args, "--no-verify", "accuracy", "robustness")
    several = len(args.move or ()) > 1
    outputs = [(_insert_name(args.out, name), _below(args.report, name)) for name in args.move] if several else []
    for out, report in outputs or [(args.out, args.report)]:
        check_writable(out)
        if _sends(args):
            check_writable(_insert_name(out, COMMAND))
        check_report(report)
    equations = derive_model(args, log)
    limits = None
    if args.limits:
        from flexgen.inversion.bounds import Limits

        limits = Limits.from_model(equations.model)
    moves = [choose_move(args.moves, name, equations.model) for name in args.move or [None]]
    _announce(args, equations.model, log)
    if not several:
        return _solve_one(args, equations, moves[0], limits, (args.out, args.report), log)
    found = []
    for k, (move, paths) in enumerate(zip(moves, outputs, strict=True), 1):
        log(f"move {move.name} ({k} of {len(moves)})")
        found.append(_solve_one(args, equations, move, limits, paths, log))
        if found[-1].interrupted:
            break
    return VerbResult(
        {"model": equations.model.name, "solutions": [result.data for result in found]},
        "\n\n".join(result.text for result in found),
        "; ".join(f"move {m.name}: {r.problem}" for m, r in zip(moves, found, strict=False) if r.problem),
        [f"move {m.name}: {line}" for m, r in zip(moves, found, strict=False) for line in r.warnings],
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
        log(f"method full with {robot.n_a} coordinates takes many minutes; --method lq takes seconds")


def _solve_one(
    args: Namespace,
    equations: Equations,
    move: Any,
    limits: Limits | None,
    outputs: tuple[Path | None, Path | None],
    log: Progress,
) -> VerbResult:
    """Solve one move; write trajectory and report to the two paths, where given."""
    from flexgen.inversion.solve import solve as solve_move

    out, report = outputs
    if args.fastest:
        from flexgen.performance.minimum_time import fastest

        move, limits = fastest(equations, move, limits=limits, time_limit=args.time_limit, progress=log).move, None
    solution = solve_move(
        equations,
        move,
        limits=limits,
        ignore_limits=args.ignore_limits or args.fastest,
        **keywords(args, "move", "limits", "ignore_limits", "fastest"),
        progress=log,
    )
    if solution.model.output != equations.model.output:  # all joints, of an arm with more motors than outputs
        from flexgen.mechanics.equations import derive

        equations = derive(solution.model)
    data = solution.to_dict()
    lines = [f"{equations.model.title}, move {solution.move.name}\n\n{figures(figure_rows(solution))}\n"]
    lines += [f"tried before: {text}" for text in solution.details.get("attempts", ())]
    if out is not None:
        data["trajectory"] = str(solution.trajectory.save(out))
        lines.append(f"wrote {out}")
        if solution.torque_command is not None:
            command = _insert_name(out, COMMAND)
            assert command is not None
            data["torque_command"] = str(solution.torque_command.save(command))
            lines.append(f"wrote {command}")
    if report is not None and not solution.interrupted:
        data |= _report(args, equations, solution, report, log)
        lines.append(f"wrote {data['report']}")
    text = "\n".join(lines).rstrip("\n")
    problem, failure = problem_of(solution, args.accuracy)
    return VerbResult(data, text, problem, list(solution.warnings), _details(solution), solution.interrupted, failure)


def _report(
    args: Namespace, equations: Equations, solution: Solution, directory: Path, log: Progress
) -> dict[str, Any]:
    """Write the report with its comparisons; the data of both."""
    from flexgen.inversion.comparison import compare_methods, error_rows
    from flexgen.reports.html import write_report

    compared = () if not args.verify else compare_methods(equations, solution, log)
    data: dict[str, Any] = {"comparison": error_rows(compared)}
    rows = None
    if args.robustness:
        from flexgen.loop.robustness import CONTROLS, PLANTS, compare_plants

        named = {one.method: one for one in (compared or (solution,))}
        runs = len(PLANTS) * len(CONTROLS) * len(named)
        took = "" if solution.simulation is None else f", about {duration(RUN * runs * solution.simulation.wall_s)}"
        log(f"robustness: {runs} simulations{took}")
        rows = data["robustness"] = compare_plants(equations, named, progress=log)
    data["report"] = str(write_report(equations, solution, directory, compared=compared, robustness=rows))
    return data


def _details(solution: Solution) -> str:
    """Further figures of the method and of the simulation."""
    rows: list[tuple[str, Any, str]] = [
        (key.replace("_", " "), value if isinstance(value, int | float) else str(value), "")
        for key, value in plain(dict(solution.details)).items()
        if value not in (None, [], {}, "")
    ]
    if solution.simulation is not None:
        run = solution.simulation
        rows += [
            ("integrator of the simulation", run.integrator, ""),
            ("evaluations of the equations of motion", run.evaluations, ""),
            ("wall time of the simulation", run.wall_s, "s"),
        ]
    meaning = paragraph(f"{solution.status}: {solution.status.sentence} {solution.status.advice}")
    return f"{figures(rows)}\n\n{meaning}" if rows else meaning


def choose_move(file: Path | None, name: str | None, robot: RobotModel) -> Any:
    """The move or program with this name in a file of moves, or else in the model; None: the first."""
    if file is None:
        return robot.move(name)
    from flexgen.model.task_files import read_moves

    found = read_moves(file, robot)
    for move in found:
        if name is None or move.name == name:
            return move
    names = [move.name for move in found]
    raise ArgumentError(
        f"move: given {name!r}, expected one of {file}: {', '.join(names)}{suggestion(name or '', names)}"
    )


def problem_of(solution: Solution, accuracy: float) -> tuple[str, int]:
    """Why the solution cannot be used, empty if it can, and the exit status that this has."""
    if solution.status != Status.LIMITS_EXCEEDED:
        return inaccuracy(solution, accuracy), 1
    from flexgen.inversion.solution import limit_warnings

    lines = limit_warnings(solution.model, solution.trajectory)
    more = f", and {len(lines) - 1} more (see the warnings)" if len(lines) > 1 else ""
    slower = ["exceeds its limit" in line for line in lines]  # not a range: more time helps
    advice = [] if all(slower) else ["choose another target or path: more time does not help beyond a range"]
    if any(slower):
        advice.append("give the move more time, or keep torques and speeds with --limits")
    advice.append("for studies use --ignore-limits")
    return f"{solution.status}: {lines[0]}{more}; {'; '.join(advice)}", EXCEEDED


def inaccuracy(solution: Solution, accuracy: float) -> str:
    """Why the solution does not meet the tolerance; empty if it does."""
    from flexgen.display import both_measured
    from flexgen.inversion.solve import ENERGY, residual_is_small

    if solution.status != Status.TOLERANCE_NOT_MET:
        return ""
    if solution.stopped:
        return f"{solution.status}: {solution.stopped}; the trajectory is the best so far"
    simulation = solution.simulation
    if simulation is not None and simulation.energy_error > ENERGY:
        return (
            f"{solution.status}: the energy balance of the simulation has an error of {simulation.energy_error:.1e}, "
            "so it verifies nothing; check whether the model is too stiff"
        )
    if simulation is not None and simulation.feedback is not None and not residual_is_small(solution):
        return (
            f"{solution.status}: the torques do not satisfy the equations of motion: relative residual "
            f"{solution.residual_relative:.1e}; try a finer --mesh or a smoother move"
        )
    # with active limits the plan itself deviates from the path
    aim, errors = "path", both_measured(solution.tool_error_max_m, solution.tool_error_max_rad)
    if solution.plan_error_max is not None:
        aim, errors = "plan", both_measured(solution.plan_error_max_m, solution.plan_error_max_rad)
    return (
        f"{solution.status}: the simulated output deviates from the {aim} by {errors}, more than the accuracy "
        f"{accuracy:.3g}; "
        + ("give the move more time or " if aim == "path" else "loosen the limits, give the move more time or ")
        + ("" if solution.method == "lq" else "take --method auto or lq, or ")
        + "a finer --mesh"
    )


def simulate(args: Namespace, log: Progress) -> VerbResult:
    """Simulate the robot under the motor torques of a trajectory."""
    from flexgen.simulation.simulate import simulate as simulate_model

    equations = derive_model(args, log)
    simulation = simulate_model(equations, args.trajectory, progress=log)
    shown = {figure.key: figure.value for figure in simulation.figures()}
    data: dict[str, Any] = {"model": equations.model.name, **shown, "trajectory": None}
    text = f"{equations.model.title} under the motor torques of {args.trajectory}\n\n" + figures(
        figure_rows(simulation)
    )
    if args.out is not None:
        data["trajectory"] = str(simulation.trajectory.save(args.out))
        text += f"\n\nwrote {args.out}"
    return VerbResult(data, text, warnings=list(simulation.warnings))
