"""Texts of the public interface: helps, completion, names, printed results."""

from __future__ import annotations

import inspect
import os
import re
import tempfile
from enum import Enum
from pathlib import Path
from typing import Any
from unittest import mock

import flexgen
from flexgen.cli.parser import build_parser
from flexgen.cli.verb_tables.verb_texts import LISTS
from flexgen.cli.verbs import completion

FOLDER = Path(__file__).resolve().parents[1] / "golden" / "face"
MODELS = ["elbow", "four_mass"]  # that the completion scripts know
VARYING = (  # times of this computer, folders, errors at the level of rounding
    (re.compile(r"seconds=[-\d.e]+|digest='\w+'"), "..."),
    (re.compile(r"(?<=evaluations of the equations of motion</td><td>)\d+"), "..."),
    (re.compile(r"(?<=closed-form in )[-\d.e]+(?= s$)", re.MULTILINE), "..."),
    (re.compile(r"(?<=time to solve and verify</td><td>)[-\d.e]+"), "..."),
    (re.compile(r"(?<=<td>)(wall time|seconds|digest)(</td><td>)[-\d.\w]+"), r"\1\2..."),
    (re.compile(r"\b[\d.]+e-\d+(?=[ <])|0\.000\d+(?= um)"), "..."),
)


def helps() -> str:
    """``--help`` of the command line and of each verb, 120 columns wide."""
    with mock.patch.dict(os.environ, {"COLUMNS": "120"}):
        parser = build_parser()
        texts = [each.format_help() for each in (parser, *parser.verbs())]
    return "\n".join(f"=== {text}" for text in texts)


def scripts() -> str:
    """The completion scripts of all shells."""
    parser = build_parser()
    return "\n".join(getattr(completion, shell)(parser, MODELS) for shell in LISTS["SHELLS"]())


def names() -> str:
    """All public names; functions, constructors and methods with their parameters and defaults."""
    lines = []
    for name in sorted(flexgen.__all__):
        what = getattr(flexgen, name)
        lines.append(name + _parameters(what))
        if inspect.isclass(what):
            own = {
                member: getattr(what, member)
                for member in sorted(vars(what))
                if not member.startswith("_")
            }
            lines += [
                f"{name}.{member}{_parameters(one)}"
                for member, one in own.items()
                if inspect.isroutine(one)
            ]
    return "\n".join(lines) + "\n"


def _parameters(what: Any) -> str:
    """Parameters and defaults of a function or class; empty for values, errors, protocols and
    enums.
    """
    kind = inspect.isclass(what) and (
        issubclass(what, Exception | Enum) or getattr(what, "_is_protocol", False)
    )
    return "" if kind or not callable(what) else str(inspect.signature(what))


def results() -> str:
    """``repr`` and ``print`` of results that take little time, without what varies from run to
    run.
    """
    with tempfile.TemporaryDirectory() as folder:
        made = _made(Path(folder))
        parts = [f"=== {name}\n{what!r}\n--- print\n{what}\n" for name, what in made.items()]
        parts += [
            f"=== {name}._repr_html_()\n{what._repr_html_()}\n"
            for name, what in made.items()
            if _has_html(what)
        ]
        text = "\n".join(parts).replace(folder, "FOLDER")
    for pattern, put in VARYING:
        text = pattern.sub(put, text)
    return text


def _has_html(what: Any) -> bool:
    # its page is long
    return hasattr(what, "_repr_html_") and not isinstance(what, flexgen.Analysis)


def _made(folder: Path) -> dict[str, Any]:
    model = flexgen.read("elbow")
    solution = flexgen.solve(model)
    path = flexgen.plan(model)
    return {
        "model": model,
        "equations": flexgen.derive(model),
        "analysis": flexgen.analyze(model),
        "check": flexgen.check(model),
        "path": path,
        "move": path.move,
        "solution": solution,
        "trajectory": solution.trajectory,
        "simulation": solution.simulation,
        "generated": flexgen.generate(model, folder / "elbow", build=False, functions=["gravity"]),
        "exported": flexgen.export_mujoco(model, folder / "elbow.xml"),
        "limits": flexgen.Limits(torque=(10.0, 5.0)),
        "grid": flexgen.Grid(models=["elbow"]),
        "notch": flexgen.Notch(12.0),
        "gains": flexgen.PPI(),
        "hardware": flexgen.DriveHardware(),
    }


TEXTS = {"helps": helps, "scripts": scripts, "names": names, "results": results}
