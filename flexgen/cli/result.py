"""What a verb of the command line returns, and what all of them check before a long computation.

Nothing heavy is imported before a verb runs, so that help and usage errors appear at once.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import flexgen
from flexgen.atomic_files import check_writable
from flexgen.errors import ArgumentError
from flexgen.verb_parameters import defaults_of

if TYPE_CHECKING:
    from flexgen.environment.wall import Wall
    from flexgen.mechanics.equations import Equations
    from flexgen.model.elements import RobotModel
    from flexgen.results import Result

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


def keywords(args: Namespace, *without: str) -> dict[str, Any]:
    """The given arguments that are parameters of the public function of the verb, by name, but ``model`` and these."""
    known = defaults_of(args.row.function)
    found = {
        name: getattr(args, name)
        for name in args.given
        if name in known and name not in ("model", *without)
    }
    if "plants" in found:
        names = [name for name, _ in found["plants"]]
        if len(set(names)) != len(names):
            raise ArgumentError(f"plants: given {', '.join(names)}, expected different names")
        found["plants"] = dict(found["plants"])
    return found


def call(args: Namespace, log: Progress, *first: Any) -> Any:
    """Call the public function of the verb: with these arguments, the positional ones, and the options given."""
    function, known = args.row.function, defaults_of(args.row.function)
    places = [getattr(args, x.name) for x in args.row.options() if x.place and x.name not in known]
    told = {"progress": log} if "progress" in known else {}
    return getattr(flexgen, function)(*first, *places, **keywords(args), **told)


def read_model(args: Namespace) -> RobotModel:
    """Read the model of the command line, with its changes."""
    from flexgen.model.reader import read

    return read(args.model, overrides=dict(args.set or ()))


def derive_model(args: Namespace, log: Progress | None = None) -> Equations:
    """Derive the equations of motion of the model of the command line."""
    from flexgen.mechanics.equations import derive

    robot = read_model(args)
    if log is not None:
        log(f"deriving {robot.title}")
    return derive(robot)


def wall_of(args: Namespace) -> Wall | None:
    """The wall of ``--wall``."""
    from flexgen.environment.wall import Wall

    return None if args.wall is None else Wall(**args.wall)


def check_outputs(args: Namespace) -> None:
    """Check the paths that the options of the section "files" name, before the verb runs.

    Raises
    ------
    ArgumentError
        One cannot be written, or the folder of a report has the page of another program.
    """
    # `solve` writes under other names
    several = isinstance(getattr(args, "move", None), list) and len(args.move) > 1
    for option in args.row.sections.get("files", ()) if not several else ():
        path = getattr(args, option.parameter)
        if isinstance(path, Path):
            check_writable(path, folder=option.metavar == "DIR")
            if option.name == "report":
                check_report(path)


def check_own(path: Path | None, mark: bytes) -> None:
    """Refuse to replace a text file that flexgen did not write; ``mark``: what its own have in their first lines."""
    if path is None or not path.is_file():
        return
    with path.open("rb") as stream:
        head = stream.read(4096)
    if mark not in head:
        raise ArgumentError(
            f"output: given {str(path)!r}, a file that flexgen did not write, expected a new one or one of its own; "
            "choose another name, or move that file away"
        )


def alone(args: Namespace, option: str, *others: str) -> None:
    """ArgumentError for options that have no effect together with this one."""
    given = [name for name in others if name in args.given]
    if given:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise ArgumentError(
            f"{option}: given with {names}, expected without: with {option} that has no effect"
        )


def written(args: Namespace, result: Result) -> dict[str, Path | None]:
    """Write a result to ``--out`` and its report to ``--report``, where given: the paths by their names in JSON."""
    data: dict[str, Path | None] = {}
    for option in args.row.sections.get("files", ()):
        if option.name == "out":
            key = "trajectory" if option.kind == "trajectory_file" else "out"
            data[key] = None if args.out is None else result.save(args.out)
    if getattr(args, "report", None) is not None:
        data["report"] = result.report(args.report)
    return data


def with_files(
    text: str,
    data: Mapping[str, Any],
    files: Mapping[str, Path | None],
    problem: str = "",
    **more: Any,
) -> VerbResult:
    """The result of a verb that wrote files: their paths are in the data, and a line each below the text."""
    lines = "\n".join(f"wrote {path}" for path in files.values() if path is not None)
    paths = {key: None if path is None else str(path) for key, path in files.items()}
    return VerbResult({**data, **paths}, f"{text}\n\n{lines}" if lines else text, problem, **more)


def check_report(directory: Path | None) -> None:
    """Refuse a folder of a report that cannot be written, or that has the page of another program."""
    from flexgen.reports.folder import check_folder

    check_folder(directory)
    check_writable(directory, folder=True)
