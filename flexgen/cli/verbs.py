"""The verbs of the command line: each calls one public function and returns its result as JSON data and text.

Nothing heavy is imported before a verb runs, so that help and usage errors appear at once.
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.atomic_files import followed, write_text
from flexgen.cli.printing import (
    analysis_text,
    description_text,
    one_line,
    paragraph,
    plain,
    roots,
    table,
)
from flexgen.errors import ArgumentError

if TYPE_CHECKING:
    from flexgen.analysis.analyze import Analysis
    from flexgen.library.generate import Generated
    from flexgen.mechanics.equations import Equations
    from flexgen.model.elements import RobotModel

Progress = Callable[[str], None]  # prints a progress message


@dataclass
class VerbResult:
    """The result of a verb.

    ``data``: the object for ``--json``; ``text``: the same as text; ``problem``: reason of a failure, else empty;
    ``warnings``: messages for standard error; ``details``: more text, for ``--verbose``; ``interrupted``: Ctrl-C ended
    the computation, and the result is what was reached; ``failure``: the exit status with a problem.
    """

    data: dict[str, Any]
    text: str
    problem: str = ""
    warnings: list[str] = field(default_factory=list)
    details: str = ""
    interrupted: bool = False
    failure: int = 1


def read_model(args: Namespace) -> RobotModel:
    """Read the model of the command line, with its changes."""
    from flexgen.model.reader import read

    return read(args.model, overrides=dict(args.set or ()))


def derived(args: Namespace, log: Progress | None = None) -> Equations:
    """Derive the equations of motion of the model of the command line."""
    from flexgen.mechanics.equations import derive

    robot = read_model(args)
    if log is not None:
        log(f"deriving {robot.title}")
    return derive(robot)


def check_writable(path: Path | None, *, folder: bool = False) -> None:
    """Check that an output path can be written, before a long computation starts.

    Raises
    ------
    ArgumentError
        It is a directory but a file is expected, or the reverse.
    """
    if path is None:
        return
    followed(path)
    if not folder and path.is_dir():
        raise ArgumentError(f"output: given {str(path)!r}, which is a directory, expected a file name")
    ancestor = path if folder else path.parent
    while not ancestor.exists() and ancestor != ancestor.parent:
        ancestor = ancestor.parent
    if not ancestor.is_dir():
        raise ArgumentError(f"output: given {str(path)!r}, but {str(ancestor)!r} is not a directory")


def check_own(path: Path | None, mark: bytes) -> None:
    """Refuse to replace a text file that flexgen did not write; ``mark``: what its own have in their first lines."""
    if path is None or not path.is_file():
        return
    with writing(path), path.open("rb") as stream:
        head = stream.read(4096)
    if mark not in head:
        raise ArgumentError(
            f"output: given {str(path)!r}, a file that flexgen did not write, expected a new one or one of its own; "
            "choose another name, or move that file away"
        )


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name the path in the error if it cannot be written."""
    try:
        yield
    except OSError as error:
        raise ArgumentError(f"output: cannot write {str(path)!r} ({error.strerror or error})") from None


def alone(args: Namespace, option: str, *others: str) -> None:
    """ArgumentError for options that have no effect beside this one."""
    given = [name for name in others if getattr(args, name) != args.parser.get_default(name)]
    if given:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise ArgumentError(f"{option}: given with {names}, expected without: beside {option} that has no effect")


def check_report(directory: Path | None) -> None:
    """Refuse a folder of a report that cannot be written, or that has the page of another program."""
    from flexgen.reports.folder import check_folder

    check_writable(directory, folder=True)
    check_folder(directory)


# --- models, describe -------------------------------------------------------------------------------------------------


def models(args: Namespace, log: Progress) -> VerbResult:
    """List the models by name."""
    from flexgen.model.catalogue import models as list_models

    broken: dict[str, str] = {}
    rows = list_models(broken)
    head = ("name", "motors", "actuated", "elastic", "dof", "description")
    text = table([[r["name"], r["n_m"], r["n_g"], r["n_e"], r["dof"], one_line(r["description"])] for r in rows], head)
    variants = [f"{row['name']}@{name}" for row in rows for name in row["variants"]]
    if variants:
        text += "\n\n" + paragraph("variants: " + ", ".join(variants))
    data: dict[str, Any] = {"models": rows}
    if broken:
        data["broken"] = broken
    return VerbResult(data, text, warnings=[f"model {name} is left out: {reason}" for name, reason in broken.items()])


def describe(args: Namespace, log: Progress) -> VerbResult:
    """Describe a model: coordinates, motors, moves, variants."""
    from flexgen.model.catalogue import describe as describe_model

    data = describe_model(args.model, overrides=dict(args.set or ()))
    return VerbResult(data, description_text(data))


# --- derive, analyze, generate ----------------------------------------------------------------------------------------


def derive(args: Namespace, log: Progress) -> VerbResult:
    """Derive the equations of motion and print them; of large models, print the sizes of the functions."""
    check_writable(args.out)
    form = "latex" if args.latex else "text" if args.text else ""
    if not form and args.out is not None:
        form = "latex" if args.out.suffix == ".tex" else "text"
    began = time.perf_counter()
    equations = derived(args)
    robot = equations.model
    functions = {name: int(equations.function(name).n_instructions()) for name in _function_names(robot)}
    data: dict[str, Any] = {
        "model": robot.name,
        "variant": robot.variant,
        "seconds": time.perf_counter() - began,
        "functions": functions,
    }
    sizes = table([list(row) for row in functions.items()], ("function", "instructions"))
    warnings: list[str] = []
    text = ""
    if form or not args.json:
        from flexgen.equations_text.equations import symbolic

        try:
            sheet = symbolic(robot)
            text = sheet.latex() if form == "latex" else sheet.text()
        except ArgumentError as error:
            if form:
                raise
            warnings.append(f"the equations are not printed ({error}); the table shows the sizes of the functions")
    if form:
        data[form] = text
    if args.out is not None:
        write_text(args.out, text)
        data["out"] = str(args.out)
        text = f"wrote {args.out}"
    return VerbResult(data, text.rstrip("\n") or sizes, warnings=warnings)


def _function_names(robot: RobotModel) -> list[str]:
    """The functions that the equations of a model have."""
    from flexgen.mechanics.equations import BUILDERS
    from flexgen.mechanics.signatures import FUNCTIONS, INVERSION, offered_functions

    missing = {*INVERSION, *FUNCTIONS} - set(offered_functions(robot))
    return [name for name in BUILDERS if name not in missing]


def analyze(args: Namespace, log: Progress) -> VerbResult:
    """Analyze the robot at rest at a pose: modes, poles, zeros, phase, structural index."""
    from flexgen.analysis.analyze import analyze as analyze_model

    check_report(args.report)
    equations, path = derived(args), None
    if args.move is not None:
        from flexgen.paths.path import Path as ToolPath
        from flexgen.paths.path import named_move

        path = ToolPath(equations, named_move(equations.model, args.move))
    analysis = analyze_model(equations, args.pose, path)
    data = analysis.to_dict()
    text = analysis.model.title + " in equilibrium\n\n" + _analysis_text(analysis)
    if args.report is not None:
        from flexgen.reports.analysis_page import write_analysis

        with writing(args.report):
            page = write_analysis(analysis, args.report)
        data["report"] = str(page)
        text += f"\n\nwrote {page}"
    poles = "poles, 1/s: " + ", ".join(roots(plain(data["poles"])))
    return VerbResult(data, text, details=paragraph(poles))


def _analysis_text(analysis: Analysis) -> str:
    coordinates = [(c.name, c.unit) for c in analysis.model.coordinates]
    return analysis_text(plain(analysis.to_dict()), coordinates, [motor.name for motor in analysis.model.motors])


def generate(args: Namespace, log: Progress) -> VerbResult:
    """Write and compile the C library."""
    check_writable(args.out, folder=True)
    from flexgen.codegen.c_functions import inversion_reason
    from flexgen.library.generate import generate as generate_library

    robot = read_model(args)
    library = generate_library(
        robot,
        args.out,
        build=not args.no_build,
        functions=args.functions,
        precision="single" if args.single else "double",
        parameters=args.parameters,
        native=args.native,
        openmp=args.openmp,
        isa=args.isa,
        amalgamate=args.amalgamate,
        parts=args.parts,
        progress=log,
        force=args.force,
    )
    done = f"built in {library.seconds:.1f} s" if not library.cached else "written, not compiled"
    lines = [f"{robot.title}: {done if library.written else 'nothing has changed'} in {library.directory}"]
    lines += ["", paragraph("functions: " + ", ".join(library.functions))]
    reason = inversion_reason(robot, library.functions)
    if reason is not None:
        lines += ["", paragraph(f"not in this library: invert and stream, because {reason}")]
    if library.written:
        lines += ["", *_written_files(library.files)]
    files = "\n".join(f"{path.stat().st_size:>9} bytes  {path}" for path in library.files)
    return VerbResult(generated_dict(robot, library), "\n".join(lines), details=files)


def generated_dict(robot: RobotModel, library: Generated) -> dict[str, Any]:
    """The data of a generated library for ``--json``."""
    return {
        "model": robot.name,
        "variant": robot.variant,
        "directory": str(library.directory),
        "files": [str(path) for path in library.files],
        "functions": list(library.functions),
        "digest": library.digest,
        "seconds": library.seconds,
        "cached": library.cached,
    }


def _written_files(files: tuple[Path, ...]) -> list[str]:
    """The written files a user needs by name, and the number of sources."""
    sources = [path for path in files if path.suffix == ".c" or path.parent.name == "src"]
    shown = [f"wrote {path}" for path in files if path not in sources]
    return [*shown, f"wrote {sources[0].parent} ({len(sources)} sources)"] if sources else shown


# --- sweep ------------------------------------------------------------------------------------------------------------


def sweep(args: Namespace, log: Progress) -> VerbResult:
    """Solve all cases of a grid of models, parameters, moves and methods."""
    from flexgen.cli.sweep import run

    return VerbResult(*run(args, log))
