"""The verbs of the command line: one public call and one printed table each.

Nothing heavy is imported before a verb runs, so that help and usage errors are instant.
"""

from __future__ import annotations

import math
import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.errors import ArgumentError
from flexgen.printing import figures, number, plain, roots, table

if TYPE_CHECKING:
    from flexgen.analysis.report import Analysis
    from flexgen.codegen.build import Generated
    from flexgen.mechanics.equations import Equations
    from flexgen.model.elements import RobotModel
    from flexgen.simulation import Simulation
    from flexgen.solvers.solution import Solution

Tell = Callable[[str], None]

FUNCTIONS = (
    "forward_kinematics jacobian jacobian_dot mass_matrix bias gravity inverse_dynamics arm_forces motor_friction "
    "gear_spring gear_torque elastic_torque forward_dynamics residual linearize second_order energy power output"
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
    from flexgen.catalogue import models as listed

    broken: dict[str, str] = {}
    rows = listed(broken)
    head = ("name", "motors", "actuated", "elastic", "dof", "description")
    text = table([[r["name"], r["n_m"], r["n_g"], r["n_e"], r["dof"], r["description"]] for r in rows], head)
    variants = [f"{row['name']}@{name}" for row in rows for name in row["variants"]]
    if variants:
        text += "\n\nvariants: " + ", ".join(variants)
    data: dict[str, Any] = {"models": rows}
    if broken:
        data["broken"] = broken
    return Answer(data, text, warnings=[f"left out: {reason}" for reason in broken.values()])


def describe(args: Namespace, tell: Tell) -> Answer:
    """Print what a model file says."""
    from flexgen.catalogue import describe as described

    robot = read_model(args)
    data = described(robot)
    parts = [
        title(robot) + f": {robot.description}",
        figures(
            [
                ("file", data["file"], ""),
                ("motors n_m", data["n_m"], ""),
                ("actuated arm coordinates n_g", data["n_g"], ""),
                ("non-actuated arm coordinates n_e", data["n_e"], ""),
                ("degrees of freedom", data["dof"], ""),
                ("mass of the arm", sum(body["mass"] for body in data["bodies"]), "kg"),
                ("motor coupling", data["motor_coupling"], ""),
                ("output", _output_text(data["output"]), ""),
            ]
        ),
        table(
            [[c["name"], c["unit"], c["element"], c["type"], _drive(c), *_stiffness(c)] for c in data["coordinates"]],
            ("coordinate", "unit", "element", "type", "drive", "stiffness", "damping"),
        ),
        table(
            [
                [m["name"], ", ".join(m["drives"]), _ratios(m["ratio"]), m["inertia"], m["torque_max"], m["speed_max"]]
                for m in data["motors"]
            ],
            ("motor", "drives", "ratio", "inertia kg m^2", "torque max N m", "speed max rad/s"),
        ),
    ]
    if data["moves"]:
        rows = [[m["name"], m["type"], float(m["duration"]), m["smoothness"]] for m in data["moves"]]
        parts.append(table(rows, ("move", "type", "duration s", "smoothness")))
    if data["variants"]:
        parts.append("variants: " + ", ".join(f"{robot.name}@{name}" for name in data["variants"]))
    if data["source"]:
        parts.append(f"source: {data['source']}")
    return Answer(data, "\n\n".join(parts))


def title(robot: RobotModel) -> str:
    """Name and variant."""
    return robot.name + (f"@{robot.variant}" if robot.variant else "")


def _ratios(values: list[float]) -> str:
    return ", ".join(number(float(value)) for value in values)


def _output_text(output: dict[str, Any]) -> str:
    axes = f" {output['axes']}" if output["axes"] else ""
    return f"{output['type']}{axes} ({output['size']} scalars)"


def _drive(coordinate: dict[str, Any]) -> str:
    if not coordinate["actuated"]:
        return "none"
    gear = coordinate["gear"]
    return "rigid gear" if gear["type"] == "rigid" else f"elastic gear, {gear['spring']['type']}, {gear['side']} side"


def _stiffness(coordinate: dict[str, Any]) -> tuple[float | None, float | None]:
    """Stiffness (the low one of a nonlinear spring) and damping, on the side that the file states them."""
    holder = coordinate.get("gear") or coordinate
    spring = holder.get("spring")
    if spring is None:
        return None, None
    return float(spring.get("stiffness", spring.get("low"))), float(holder.get("damping") or 0.0)


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
        from flexgen.mechanics.symbolic import symbolic

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
    from flexgen.analysis.report import analyze as analysed

    check_writable(args.report, folder=True)
    analysis = analysed(derived(args), args.pose)
    data = analysis.to_dict()
    text = title(analysis.model) + " at rest\n\n" + _analysis_text(analysis, plain(data))
    if args.report is not None:
        from flexgen.report import write_analysis

        with writing(args.report):
            written = write_analysis(analysis, args.report)
        data["report"] = str(args.report)
        data["pictures"] = [str(path) for path in written]
        text += "\n\n" + "\n".join(f"wrote {path}" for path in written)
    return Answer(data, text)


def _analysis_text(analysis: Analysis, data: dict[str, Any]) -> str:
    robot = analysis.model
    rest = table(
        [[c.name, float(q), c.unit] for c, q in zip(robot.coordinates, data["pose"], strict=True)],
        ("coordinate", "at rest", "unit"),
    )
    motors = table(
        [[m.name, float(tau), "N m"] for m, tau in zip(robot.motors, data["motor_torque_Nm"], strict=True)],
        ("motor", "torque", "unit"),
    )
    modes = table(
        [
            [k + 1, f, d]
            for k, (f, d) in enumerate(zip(data["modes_hz"] or [], data.get("modes_damping") or [], strict=True))
        ],
        ("mode", "Hz", "damping ratio"),
    )
    zeros, inner = roots(data["zeros"] or []), data["zeros_motor"] or []
    notches = sorted(math.hypot(*root) / (2 * math.pi) for root in inner if root[1] > 0)
    verdict = figures(
        [
            ("phase of the output", data["phase"], ""),
            ("zeros of the output", ", ".join(zeros) if zeros else "none", "1/s" if zeros else ""),
            ("zeros, motor torque to motor angle", ", ".join(map(number, notches)) or None, "Hz"),
            ("slowest unstable time constant", data["unstable_time_constant_s"] or None, "s"),
            ("structural index", data["structural_index"], ""),
            ("preview that exact following needs", data["preview_s"], "s"),
        ]
    )
    return "\n\n".join([rest, motors, modes, verdict])


def generate(args: Namespace, tell: Tell) -> Answer:
    """Write and compile the C library."""
    check_writable(args.directory, folder=True)
    from flexgen.codegen.build import generate as generated

    robot = read_model(args)
    made = generated(robot, args.directory, progress=tell, force=args.force)
    head = f"{title(robot)}: " + ("nothing has changed" if made.cached else f"built in {made.seconds:.1f} s")
    lines = [head, "", "functions: " + ", ".join(made.functions), "", *_paths(made.files)]
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
    sources = [path for path in files if path.suffix == ".c"]
    rest = [path for path in files if path.suffix != ".c"]
    return [f"wrote {path}" for path in rest] + [f"wrote {sources[0].parent}/*.c ({len(sources)} files)"] * bool(
        sources
    )


# --- solve, simulate --------------------------------------------------------------------------------------------------


def solve(args: Namespace, tell: Tell) -> Answer:
    """Find the motor torques that make the output follow a move."""
    check_writable(args.out)
    check_writable(args.report, folder=True)
    from flexgen.solvers.solve import ACCURACY
    from flexgen.solvers.solve import solve as solved

    equations = derived(args)
    accuracy = ACCURACY if args.accuracy is None else args.accuracy
    limits = None
    if args.limits:
        from flexgen.solvers.full import limits_from_model

        limits = limits_from_model(equations.model)
    solution = solved(
        equations,
        args.move,
        args.method,
        preview=args.preview,
        mesh=args.mesh,
        limits=limits,
        verify=not args.no_verify,
        accuracy=accuracy,
        progress=tell,
    )
    data = solution.to_dict()
    text = f"{title(equations.model)}, move {solution.move.name}: {solution.status}\n\n"
    text += figures(solution_rows(solution))
    problem = inaccuracy(solution, accuracy)
    if args.out is not None:
        with writing(args.out):
            data["trajectory"] = str(solution.trajectory.save(args.out))
        text += f"\n\nwrote {args.out}"
    if args.report is not None:
        from flexgen.report import write_report

        with writing(args.report):
            data["report"] = str(write_report(equations, solution, args.report))
        text += ("\n" if args.out else "\n\n") + f"wrote {data['report']}"
    return Answer(data, text, problem, list(solution.warnings))


def inaccuracy(solution: Solution, accuracy: float) -> str:
    """Why the solution is not good enough; empty where it is."""
    if solution.status != "inaccurate":
        return ""
    worst = max(solution.tool_error_max_m or 0.0, solution.tool_error_max_rad or 0.0)
    return (
        f"inaccurate: the simulated output strays {worst:.3g} m or rad from the path, more than {accuracy:.3g}; "
        "try a finer --mesh, a longer --preview or --method full"
    )


def micro(value: float | None) -> float | None:
    """The same in millionths, for people: um, urad."""
    return None if value is None else 1e6 * value


def solution_rows(solution: Solution) -> list[tuple[str, Any, str]]:
    """What, value and unit of a solution."""
    data = plain(solution.to_dict())
    return [
        ("method", data["method"], ""),
        ("iterations", data["iterations"], ""),
        ("time to solve and verify, wall", data["wall_s"], "s"),
        ("time to solve and verify, processor", data["cpu_s"], "s"),
        ("motion begins before the path", data["lead_s"], "s"),
        ("motor torque, largest", data["torque_max_Nm"], "N m"),
        ("motor speed, largest", data["speed_max_rad_s"], "rad/s"),
        ("residual of the equations, largest", data["residual_max_Nm"], "N m"),
        ("tool error in simulation, largest", micro(data["tool_error_max_m"]), "um"),
        ("tool error in simulation, largest", micro(data["tool_error_max_rad"]), "urad"),
        ("energy error of the simulation", data["energy_error"], "relative"),
    ]


def simulate(args: Namespace, tell: Tell) -> Answer:
    """Simulate the machine under the torque of a trajectory."""
    check_writable(args.out)
    from flexgen.simulation import simulate as simulated

    equations = derived(args)
    simulation = simulated(equations, args.trajectory, progress=tell)
    data = _simulation_dict(equations.model, simulation)
    text = f"{title(equations.model)} under the torque of {args.trajectory}\n\n" + figures(
        [
            ("tool error, largest", micro(data["tool_error_max_m"]), "um"),
            ("tool error, largest", micro(data["tool_error_max_rad"]), "urad"),
            ("energy error", data["energy_error"], "relative"),
            ("motor torque, largest", data["torque_max_Nm"], "N m"),
            ("motor speed, largest", data["speed_max_rad_s"], "rad/s"),
            ("evaluations of the right-hand side", data["evaluations"], ""),
            ("time, wall", data["wall_s"], "s"),
        ]
    )
    if args.out is not None:
        with writing(args.out):
            data["trajectory"] = str(simulation.trajectory.save(args.out))
        text += f"\n\nwrote {args.out}"
    return Answer(data, text)


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
