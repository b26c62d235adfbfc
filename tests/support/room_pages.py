"""The README of each room, rendered from the docstrings of its modules.

`ORDER` states in which order a reader opens the entries of a room; entries that it does not name
follow by name. The rest is the first sentence of their docstrings. Rooms with a page of their own,
such as `exports`, are not rendered.
"""

from __future__ import annotations

import ast
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "flexgen"
ORDER = {
    "base": "errors results rows files spec checks calls motion numerics display registry version",
    "model": "elements moves friction abilities reader format urdf catalogue new_file inertia "
    "position_servo",
    "runtime": "library calls inversion streams options structs arguments identity files "
    "processor",
    "dynamics": "mechanics hysteresis dae",
    "analysis": "analyze linear second_order compliance zero_dynamics arm_linearization "
    "servo_gains control_system printing",
    "codegen": "recursion statements emission clib build",
    "paths": "path geometry timing samples reference path_table move_files force "
    "inverse_kinematics accuracy",
    "backends": "autodiff cuda",
    "simulation": "simulate start run integration driven_joints open_loop motor_feedback "
    "after_end verification result environment",
    "inversion": "solve problem choice refinement methods judge unverified_solution solution hold "
    "comparison",
    "feedback": "loop laws observers positions sampled_plant",
    "planning": "optimal fastest learning",
    "studies": "tolerances sweeps scenarios check templates",
    "views": "reports plots",
    "cli": "main parser argument_parser argument_types verb_tables verbs result",
}


def sentence(path: Path) -> str:
    """The first paragraph of a module's docstring on one line."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.partition("\n\n")[0].split())


def entries(room: Path) -> dict[str, Path]:
    """Modules and folders of a room by their names, each with the file that has its docstring."""
    modules = {path.stem: path for path in room.glob("*.py") if path.stem != "__init__"}
    return modules | {path.parent.name: path for path in room.glob("*/__init__.py")}


def page(room: Path, order: list[str]) -> str:
    """The README of a room."""
    found = entries(room)
    rows = []
    for name in [*order, *sorted(found.keys() - set(order))]:
        path = found[name]
        label = f"{name}/" if path.stem == "__init__" else path.name
        rows.append(f"- `{label}`: {sentence(path)}")
    head = (
        f"# {room.name.capitalize()}\n\n{sentence(room / '__init__.py')}\n\nIn reading order:\n\n"
    )
    return head + "\n".join(rows) + "\n"


def pages(source: Path = SOURCE) -> dict[Path, str]:
    """The text of each rendered README by its path."""
    return {
        source / name / "README.md": page(source / name, order.split())
        for name, order in ORDER.items()
    }
