"""The verbs of the command line: one public call and one printed table each.

Nothing heavy is imported before a verb runs, so that help and usage errors are instant.
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.cli.printing import (
    analysis_text,
    description_text,
    figures,
    one_line,
    plain,
    simulation_rows,
    solution_rows,
    table,
)
from flexgen.errors import ArgumentError
from flexgen.inversion.status import Status

if TYPE_CHECKING:
    from flexgen.analysis.analyze import Analysis
    from flexgen.build.generate import Generated
    from flexgen.inversion.solution import Solution
    from flexgen.mechanics.equations import Equations
    from flexgen.model.elements import RobotModel
    from flexgen.simulation.simulate import Simulation

Tell = Callable[[str], None]

FUNCTIONS = (
    "forward_kinematics jacobian jacobian_dot mass_matrix bias gravity inverse_dynamics arm_forces motor_friction "
    "gear_law gear_torque elastic_torque forward_dynamics residual residual_jacobians linearize energy power output"
).split()


@dataclass
class Answer:
    """What a verb found.

    ``data``: the object for ``--json``; ``text``: the same for people; ``problem``: why the job failed all the same
    (exit status 1), empty where it did not; ``warnings``: what else to say on standard error.
    """

    data: dict[str, Any]
    text: str
    problem: str = ""
    warnings: list[str] = field(default_factory=list)


def read_model(args: Namespace) -> RobotModel:
    """The model of the command line, with its changes."""
    from flexgen.model.reader import read

    return read(args.model, overrides=dict(args.set or ()))


def derived(args: Namespace) -> Equations:
    """Its equations of motion."""
    from flexgen.mechanics.equations import derive

    return derive(read_model(args))


def check_writable(path: Path | None, *, folder: bool = False) -> None:
    """Refuse a path that cannot be written before hours are spent on what shall go there.

    Raises
    ------
    ArgumentError
        It is a directory where a file is expected, or a file where a directory is.
    """
    if path is None:
        return
    if not folder and path.is_dir():
        raise ArgumentError(f"output: given {str(path)!r}, which is a directory, expected the name of a file")
    ancestor = path if folder else path.parent
    while not ancestor.exists() and ancestor != ancestor.parent:
        ancestor = ancestor.parent
    if not ancestor.is_dir():
        raise ArgumentError(f"output: given {str(path)!r}, but {str(ancestor)!r} is no directory")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name the path where it cannot be written."""
    try:
        yield
    except OSError as error:
        raise ArgumentError(
            f"output: given {str(path)!r}, which cannot be written ({error.strerror or error})"
        ) from None


def _write(path: Path, text: str) -> None:
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


# --- models, describe -------------------------------------------------------------------------------------------------


def models(args: Namespace, tell: Tell) -> Answer:
    """List the models that can be called by their names."""
    from flexgen.model.catalogue import models as listed

    broken: dict[str, str] = {}
    rows = listed(broken)
    head = ("name", "motors", "actuated", "elastic", "dof", "description")
    text = table([[r["name"], r["n_m"], r["n_g"], r["n_e"], r["dof"], one_line(r["description"])] for r in rows], head)
    variants = [f"{row['name']}@{name}" for row in rows for name in row["variants"]]
    if variants:
        text += "\n\nvariants: " + ", ".join(variants)
    data: dict[str, Any] = {"models": rows}
    if broken:
        data["broken"] = broken
    return Answer(data, text, warnings=[f"left out: {name}: {reason}" for name, reason in broken.items()])


def describe(args: Namespace, tell: Tell) -> Answer:
    """Print what a model file says."""
    from flexgen.model.catalogue import describe as described

    data = described(args.model, overrides=dict(args.set or ()))
    return Answer(data, description_text(data))


def title(robot: RobotModel) -> str:
    """Name and variant."""
    return robot.name + (f"@{robot.variant}" if robot.variant else "")


# --- derive, analyze, generate ----------------------------------------------------------------------------------------


def derive(args: Namespace, tell: Tell) -> Answer:
    """Derive the equations of motion; print them where they are small enough to be read."""
    check_writable(args.out)
    asked = "latex" if args.latex else "text" if args.text else ""
    if not asked and args.out is not None:
        asked = "latex" if args.out.suffix == ".tex" else "text"
    began = time.perf_counter()
    equations = derived(args)
    robot = equations.model
    functions = {name: int(equations.function(name).n_instructions()) for name in FUNCTIONS}
    data: dict[str, Any] = {
        "model": robot.name,
        "variant": robot.variant,
        "seconds": time.perf_counter() - began,
        "functions": functions,
    }
    sizes = table([list(row) for row in functions.items()], ("function", "instructions"))
    warnings: list[str] = []
    text = ""
    if asked or not args.json:
        from flexgen.closed_form.equations import symbolic

        try:
            sheet = symbolic(robot)
            text = sheet.latex() if asked == "latex" else sheet.text()
        except ArgumentError as error:
            if asked:
                raise
            warnings.append(f"no closed form to read ({error}); these are the sizes of the functions instead")
    if asked:
        data[asked] = text
    if args.out is not None:
        _write(args.out, text)
        data["out"] = str(args.out)
        text = f"wrote {args.out}"
    return Answer(data, text.rstrip("\n") or sizes, warnings=warnings)


def analyze(args: Namespace, tell: Tell) -> Answer:
    """Analyse a machine at rest at a pose: modes, poles, zeros, phase, index."""
    from flexgen.analysis.analyze import analyze as analysed

    check_writable(args.report, folder=True)
    equations, path = derived(args), None
    if args.move is not None:
        from flexgen.paths.path import Path as ToolPath

        try:
            path = ToolPath(equations, equations.model.move(args.move))
        except KeyError:
            known = ", ".join(move.name for move in (*equations.model.moves, *equations.model.programs)) or "none"
            raise ArgumentError(f"move: given {args.move!r}, model {equations.model.name} has: {known}") from None
    analysis = analysed(equations, args.pose, path)
    data = analysis.to_dict()
    text = title(analysis.model) + " at rest\n\n" + _analysis_text(analysis)
    if args.report is not None:
        from flexgen.reports.html import write_analysis

        with writing(args.report):
            written = write_analysis(analysis, args.report)
        data["report"] = str(args.report)
        data["pictures"] = [str(path) for path in written]
        text += "\n\n" + "\n".join(f"wrote {path}" for path in written)
    return Answer(data, text)


def _analysis_text(analysis: Analysis) -> str:
    coordinates = [(c.name, c.unit) for c in analysis.model.coordinates]
    return analysis_text(plain(analysis.to_dict()), coordinates, [motor.name for motor in analysis.model.motors])


def generate(args: Namespace, tell: Tell) -> Answer:
    """Write and compile the C library."""
    check_writable(args.directory, folder=True)
    from flexgen.build.generate import generate as generated

    robot = read_model(args)
    made = generated(
        robot,
        args.directory,
        build=not args.no_build,
        precision="single" if args.single else "double",
        parameters=args.parameters,
        native=args.native,
        openmp=args.openmp,
        amalgamate=args.amalgamate,
        progress=tell,
        force=args.force,
    )
    done = f"built in {made.seconds:.1f} s" if not made.cached else "written, nothing compiled"
    lines = [f"{title(robot)}: {done if made.written else 'nothing has changed'} in {made.directory}"]
    lines += ["", "functions: " + ", ".join(made.functions)]
    if made.written:
        lines += ["", *_paths(made.files)]
    return Answer(generated_dict(robot, made), "\n".join(lines))


def generated_dict(robot: RobotModel, made: Generated) -> dict[str, Any]:
    """A generated library as JSON types."""
    return {
        "model": robot.name,
        "variant": robot.variant,
        "directory": str(made.directory),
        "files": [str(path) for path in made.files],
        "functions": list(made.functions),
        "digest": made.digest,
        "seconds": made.seconds,
        "cached": made.cached,
    }


def _paths(files: tuple[Path, ...]) -> list[str]:
    """What a user looks for by name, and how many files there are beside it."""
    parts = [
        path for path in files if path.suffix == ".c" or path.name.endswith(("_body.h", "_kernel.h", "_private.h"))
    ]
    shown = [f"wrote {path}" for path in files if path not in parts]
    return [*shown, f"wrote {parts[0].parent} ({len(parts)} sources)"] if parts else shown


# --- solve, simulate --------------------------------------------------------------------------------------------------


def solve(args: Namespace, tell: Tell) -> Answer:
    """Find the motor torques that make the output follow a move."""
    check_writable(args.out)
    check_writable(args.report, folder=True)
    if args.robustness and args.report is None:
        raise ArgumentError("--robustness: the table is part of the report; give --report DIR, too")
    from flexgen.inversion.solve import ACCURACY
    from flexgen.inversion.solve import solve as solved

    equations = derived(args)
    accuracy = ACCURACY if args.accuracy is None else args.accuracy
    limits = None
    if args.limits:
        from flexgen.inversion.bounds import limits_from_model

        limits = limits_from_model(equations.model)
    solution = solved(
        equations,
        args.move if args.moves is None else _move_of_file(args.moves, args.move, equations.model),
        args.method,
        preview=args.preview,
        mesh=args.mesh,
        limits=limits,
        verify=not args.no_verify,
        accuracy=accuracy,
        progress=tell,
    )
    data = solution.to_dict()
    text = f"{title(equations.model)}, move {solution.move.name}\n\n"
    text += figures(solution_rows(solution))
    problem = inaccuracy(solution, accuracy)
    if args.out is not None:
        with writing(args.out):
            data["trajectory"] = str(solution.trajectory.save(args.out))
        text += f"\n\nwrote {args.out}"
    if args.report is not None:
        from flexgen.inversion.comparison import compare_methods, error_rows
        from flexgen.reports.html import write_report

        beside = () if args.no_verify else compare_methods(equations, solution, tell)
        data["comparison"] = error_rows(beside)
        rows = None
        if args.robustness:
            from flexgen.inversion.robustness import compare_plants

            named = {one.method: one for one in (beside or (solution,))}
            rows = data["robustness"] = compare_plants(equations, named, progress=tell)
        with writing(args.report):
            page = write_report(equations, solution, args.report, beside=beside, robustness=rows)
            data["report"] = str(page)
        text += ("\n" if args.out else "\n\n") + f"wrote {data['report']}"
    return Answer(data, text, problem, list(solution.warnings))


def _move_of_file(file: Path, name: str | None, robot: RobotModel) -> Any:
    """The move or program of that name in a file of moves; its first one for None."""
    from flexgen.model.task_files import read_moves

    found = read_moves(file, robot)
    for move in found:
        if name is None or move.name == name:
            return move
    raise ArgumentError(f"move: given {name!r}, {file} has: {', '.join(move.name for move in found) or 'none'}")


def sweep(args: Namespace, tell: Tell) -> Answer:
    """Solve all cases of a grid of models, parameters, moves and methods."""
    from flexgen.cli.sweep import run

    return Answer(*run(args, tell))


def inaccuracy(solution: Solution, accuracy: float) -> str:
    """Why the solution is not good enough; empty where it is."""
    from flexgen.inversion.solve import ENERGY

    if solution.status != Status.TOLERANCE_NOT_MET:
        return ""
    simulation = solution.simulation
    if simulation is not None and simulation.energy_error > ENERGY:
        return (
            f"{solution.status}: the energy balance of the simulation has an error of {simulation.energy_error:.1e}, "
            "so it verifies nothing; check whether the model is too stiff"
        )
    planned = solution.plan_error_max  # with active limits the plan itself deviates from the path
    worst = max(solution.tool_error_max_m or 0.0, solution.tool_error_max_rad or 0.0) if planned is None else planned
    aim = "path" if planned is None else "plan"
    return (
        f"{solution.status}: the simulated output deviates from the {aim} by {worst:.3g} m or rad, more than "
        f"{accuracy:.3g}; "
        + ("loosen the limits, give the move more time or " if solution.method == "full" else "try --method full or ")
        + "try a finer --mesh"
    )


def simulate(args: Namespace, tell: Tell) -> Answer:
    """Simulate the machine under the torque of a trajectory."""
    check_writable(args.out)
    from flexgen.simulation.simulate import simulate as simulated

    equations = derived(args)
    simulation = simulated(equations, args.trajectory, progress=tell)
    data = _simulation_dict(equations.model, simulation)
    text = f"{title(equations.model)} under the torque of {args.trajectory}\n\n" + figures(simulation_rows(plain(data)))
    if args.out is not None:
        with writing(args.out):
            data["trajectory"] = str(simulation.trajectory.save(args.out))
        text += f"\n\nwrote {args.out}"
    return Answer(data, text, warnings=list(simulation.warnings))


def _simulation_dict(robot: RobotModel, simulation: Simulation) -> dict[str, Any]:
    return {
        "model": robot.name,
        "tool_error_max_m": simulation.tool_error_max_m,
        "tool_error_max_rad": simulation.tool_error_max_rad,
        "energy_error": simulation.energy_error,
        "torque_max_Nm": simulation.torque_max_Nm,
        "speed_max_rad_s": simulation.speed_max_rad_s,
        "evaluations": simulation.evaluations,
        "wall_s": simulation.wall_s,
        "trajectory": None,
    }
