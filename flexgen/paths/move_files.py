"""Reader of files with moves and programs that are separate from the model file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, suggestion
from flexgen.base.spec.keys import Context, read
from flexgen.base.spec.tables import Table, parse_file
from flexgen.model.elements import RobotModel
from flexgen.model.format.format import PROGRAMS
from flexgen.model.moves import Move
from flexgen.model.urdf.urdf_source import from_here


@checked_types(own=("file",))
def read_moves(file: str | Path, model: RobotModel) -> tuple[Move, ...]:
    """Read moves and programs from a TOML file with ``[[move]]`` and ``[[program]]`` tables, as in
    a model file.

    Parameters
    ----------
    file : str or Path
    model : RobotModel
        The robot that executes them.

    Returns
    -------
    tuple of Move
        The moves, then the programs.

    Raises
    ------
    ModelError
        The file has an error or does not fit the robot.
    ArgumentError
        There is no such file.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = "[[move]]\\nname = 'lift'\\ntype = 'joint'\\nstart_deg = [0, 0]\\nend_deg = [30, 0]"
    >>> length = Path("moves.toml").write_text(text + "\\nduration = 0.8\\nsmoothness = 5")
    >>> (lift,) = flexgen.read_moves("moves.toml", flexgen.read("elbow"))
    >>> print(flexgen.solve("elbow", lift).status)
    solved
    """
    path = Path(file)
    try:
        there = path.is_file()
    except (OSError, ValueError):
        there = False
    if not there:
        raise ArgumentError(
            f"moves: given {str(file)!r}, which is not a file, expected the path of a .toml file"
        )
    shown = from_here(path)
    root = Table(shown, parse_file(path, shown), "")
    about: dict[str, Any] = {"output": model.output, "element": model.elements}
    # frames of the file come before those of the robot: one of the same name replaces it
    frames = (*model.frames, *PROGRAMS["frame"].read(root, Context(about)))
    found = read(root, PROGRAMS, Context({**about, "frame": frames}))
    if not found["moves"] and not found["programs"]:
        raise root.fail("program", "one or more [[move]] or [[program]] tables")
    return (*found["moves"], *found["programs"])


def find_move_in(file: str | Path | None, name: str | None, model: RobotModel) -> Move:
    """The move or program with this name (None: the first) in a file of moves; without a file, in
    the model.
    """
    if file is None:
        return model.move(name)
    found = read_moves(file, model)
    for move in found:
        if name is None or move.name == name:
            return move
    names = [move.name for move in found]
    hint = suggestion(name or "", names)
    raise ArgumentError(f"move: given {name!r}, expected one of {file}: {', '.join(names)}{hint}")
