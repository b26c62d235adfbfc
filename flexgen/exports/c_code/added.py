"""Exporters of other packages, by entry points of the group ``flexgen.exports``.

An exporter is a function ``export(model, out)``: it writes a `RobotModel` to the path ``out`` and
returns the paths of the files that it wrote.
"""

from __future__ import annotations

from pathlib import Path

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.registry import added_names, extension
from flexgen.dynamics.mechanics.equations import Equations, robot_of
from flexgen.exports.exported import Exported
from flexgen.model.elements import RobotModel


@checked_types
def export(kind: str, model: str | Path | RobotModel | Equations, out: str | Path) -> Exported:
    """Write a robot by an exporter that another package has added.

    Parameters
    ----------
    kind : str
        Name of its entry point in the group ``flexgen.exports``; flexgen's own exporters are the
        functions ``export_...``.
    model : name, path, RobotModel or Equations
    out : str or Path
        File or folder to write.

    Returns
    -------
    Exported

    Raises
    ------
    ArgumentError
        There is no such exporter, or it returns something else than paths of files that it wrote.

    Examples
    --------
    With a package installed that adds an exporter ``my_format``:

        flexgen.export("my_format", "elbow", "elbow.my")
    """
    known = added_names("exports")
    if kind not in known:
        raise ArgumentError(
            f"export: given {kind!r}, expected one of "
            f"{', '.join(known) or 'none: no package adds any'}"
        )
    robot = robot_of(model)
    found = extension("exports", kind)(robot, Path(out))
    files = tuple(Path(x) for x in ([found] if isinstance(found, str | Path) else found or ()))
    if not files or not all(path.is_file() for path in files):
        raise ArgumentError(
            f"exporter {kind}: given {found!r}, expected the paths of the files that it wrote"
        )
    return Exported(kind, robot.name, Path(out), tuple(sorted(files)), robot.variant)
