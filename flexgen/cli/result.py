"""Results of the verbs of the command line, and common checks before a long computation.

Nothing heavy is imported before a verb runs, so that help and usage errors appear at once.
"""

from __future__ import annotations

import re
from argparse import Namespace
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import flexgen
from flexgen.base.calls.deadline import INTERRUPTED
from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.files.atomic_files import check_writable
from flexgen.base.registry import find_function
from flexgen.cli.verb_tables.signature_source import defaults_of

if TYPE_CHECKING:
    from flexgen.base.results import Result
    from flexgen.dynamics.mechanics.equations import Equations
    from flexgen.model.elements import RobotModel
    from flexgen.simulation.environment.wall import Wall

Progress = Callable[[str], None]  # prints a progress message
Writer = Callable[[], Path]  # writes a file of a result and returns its path
# The variants that fits add to a model file.
OF_FITS = ("calibrated", "commissioned", "identified")
# By the public function of a verb that fits: the endings of the files that its result can be
# written to, and the class of it that checks before the fit that a model file can have its
# numbers.
WRITERS = {
    "identify_load": ((".json", ".npz"), ""),
    "compare_record": ((".json", ".npz"), ""),
    "compare_shapers": ((".json",), ""),
    "identify_servo": ((".toml", ".json"), ""),
    "identify_gears": ((".toml", ".json", ".npz"), "GearFit"),
    "identify_spring": ((".toml", ".json", ".npz"), "SpringFit"),
    "identify": ((".toml",), "Estimated"),
    "calibrate": ((".toml",), "Calibration"),
    "commission": ((".toml", ".json"), "Commissioning"),
}


@dataclass
class VerbResult:
    """The result of a verb.

    ``data``: the object for ``--json``; ``text``: the same as text; ``problem``: reason of a
    failure, else empty; ``warnings``: messages for standard error; ``details``: more text, for
    ``--verbose``; ``interrupted``: Ctrl-C ended the computation, and the result is what was
    reached; ``unwritten``: a file could not be written;
    ``failure``: the exit status with a problem.
    """

    data: dict[str, Any]
    text: str
    problem: str = ""
    warnings: list[str] = field(default_factory=list)
    details: str = ""
    interrupted: bool = False
    failure: int = 1
    unwritten: bool = False


def keywords(args: Namespace, *without: str) -> dict[str, Any]:
    """The given arguments that are parameters of the public function of the verb, by name, but
    ``model`` and these.
    """
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
    """Call the public function of the verb: with these arguments, the positional ones, and the
    options given.
    """
    function = args.row.function
    known = defaults_of(args.row.function)
    places = [getattr(args, x.name) for x in args.row.options() if x.place and x.name not in known]
    told = {"progress": log} if "progress" in known else {}
    return getattr(flexgen, function)(*first, *places, **keywords(args), **told)


def read_model(args: Namespace) -> RobotModel:
    """Read the model of the command line, with its changes."""
    from flexgen.model.reader import read

    return read(args.model, overrides=dict(args.set or ()))


def derive_model(args: Namespace, log: Progress | None = None) -> Equations:
    """Derive the equations of motion of the model of the command line."""
    from flexgen.dynamics.mechanics.equations import derive

    robot = read_model(args)
    if log is not None:
        log(f"deriving {robot.title}")
    return derive(robot)


def wall_of(args: Namespace) -> Wall | None:
    """The wall of ``--wall``."""
    from flexgen.simulation.environment.wall import Wall

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


def check_model_file(args: Namespace, *given: Any) -> None:
    """Check before a fit that its result can be written to ``--out``.

    Raises
    ------
    ArgumentError, ModelError
        The name has another ending, or the file of the model cannot have the numbers.
    """
    out = getattr(args, "out", None)
    checks = WRITERS.get(args.row.function)
    if out is None or checks is None:
        return
    endings, place = checks
    if Path(out).suffix not in endings:
        raise ArgumentError(
            f"--out: given {str(out)!r}, expected a name that ends in {' or '.join(endings)}"
        )
    if place and Path(out).suffix == ".toml" and given:
        find_function(f"{place}.check_file")(out, *given)


def check_own(path: Path | None, mark: bytes) -> None:
    """Refuse to replace a text file that flexgen did not write; ``mark``: what its own have in
    their first lines.
    """
    if path is None or not path.is_file():
        return
    with path.open("rb") as stream:
        head = stream.read(4096)
    if mark not in head:
        raise ArgumentError(
            f"output: given {str(path)!r}, a file that flexgen did not write, expected a new "
            "one or one of its own; choose another name, or move that file away"
        )


def alone(args: Namespace, option: str, *others: str) -> None:
    """ArgumentError for options that have no effect together with this one."""
    given = [name for name in others if name in args.given]
    if given:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise ArgumentError(
            f"{option}: given with {names}, expected without: with {option} that has no effect"
        )


def written(args: Namespace, result: Result) -> dict[str, Writer | None]:
    """The writers of a result to ``--out`` and ``--report``, where given, by the names in JSON."""
    data: dict[str, Writer | None] = {}
    for option in args.row.sections.get("files", ()):
        if option.name == "out":
            key = "trajectory" if option.kind == "trajectory_file" else "out"
            data[key] = None if args.out is None else partial(result.save, args.out)
    if getattr(args, "report", None) is not None:
        data["report"] = partial(result.report, args.report)
    return data


def is_interrupted(result: Any) -> bool:
    """Whether Ctrl-C ended the search of a fit."""
    return INTERRUPTED in (str(getattr(result, "status", "")), getattr(result, "ended", ""))


def _words_of_variant(written: Path) -> str:
    """Where the numbers of a fit are, behind the path of a model file: its last variant."""
    path = Path(written)
    if path.suffix != ".toml" or not path.is_file():
        return ""
    found = re.findall(r"^\[variant\.(\w+)\]", path.read_text(encoding="utf-8"), re.MULTILINE)
    return f"; read it as {path}@{found[-1]}" if found and found[-1] in OF_FITS else ""


def with_files(
    text: str,
    data: Mapping[str, Any],
    files: Mapping[str, Path | Writer | None],
    problem: str = "",
    after: Mapping[str, str] | None = None,
    **more: Any,
) -> VerbResult:
    """The result of a verb with files: their paths are in the data, and a line each below the
    text.

    ``files``: paths, or functions that write a file and return its path. Where one cannot be
    written, the result has the reason as a problem, and everything else is printed. ``after``:
    words behind the paths of some.
    """
    paths: dict[str, Path | None] = {}
    failures: list[str] = []
    for key, file in files.items():
        try:
            paths[key] = file() if callable(file) else file
        except (FlexgenError, OSError) as error:
            failures.append(f"{key.replace('_', ' ')} not written: {error}")
        except KeyboardInterrupt:
            failures.append(f"{key.replace('_', ' ')} not written: interrupted")
            more["interrupted"] = True
    words = {key: _words_of_variant(path) for key, path in paths.items() if path is not None}
    words |= after or {}
    lines = "\n".join(
        f"wrote {path}{words.get(key, '')}" for key, path in paths.items() if path is not None
    )
    named = {key: None if paths.get(key) is None else str(paths[key]) for key in files}
    whole = "; ".join(filter(None, [problem, *failures]))
    more["unwritten"] = bool(failures)
    return VerbResult({**data, **named}, f"{text}\n\n{lines}" if lines else text, whole, **more)


def check_report(directory: Path | None) -> None:
    """Refuse a folder of a report that cannot be written, or that has the page of another
    program.
    """
    from flexgen.views.reports.folder import check_folder

    check_folder(directory)
    check_writable(directory, folder=True)
