"""Lookup of URDF files: a path, ``package://NAME/PATH``, and the short form ``FILE#BASE:TIP`` of a
robot.
"""

from __future__ import annotations

import os
import sys
import sysconfig
import tomllib
from collections.abc import Collection, Iterator
from pathlib import Path

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.keys import Context
from flexgen.base.spec.tables import Table, show
from flexgen.base.spec.toml_lines import Entry, wrap

PACKAGE = "package://"
SEARCHED = "ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and the share folders of this Python"


def from_here(path: Path) -> str:
    """The path relative to the current directory if it is inside of it, else the absolute path."""
    try:
        absolute = Path(os.path.abspath(path))
        here = Path.cwd()
    except OSError:  # the current directory is gone
        return str(path)
    return str(absolute.relative_to(here) if absolute.is_relative_to(here) else absolute)


def find_urdf(table: Table, folder: Path) -> tuple[Path, str]:
    """The URDF file under the key ``file`` of an overlay in a folder, and its name in messages."""
    from flexgen.model.format.format import URDF

    text: str = URDF["file"].read(table, Context())
    path = locate(text, folder)
    if path is None:
        expected = (
            f"a file of a package found in {SEARCHED}"
            if text.startswith(PACKAGE)
            else "the path of a URDF file"
        )
        raise table.fail("file", expected, f"{show(text)}, which is not a file")
    return path, from_here(path)


def source_files(model_file: str) -> list[Path]:
    """The existing files that a robot was read from: its model file or URDF file, the URDF file
    of an overlay, and the YAML file of its closed loops.

    Parameters
    ----------
    model_file : str
        As in `RobotModel.file`.
    """
    from flexgen.model.urdf.urdf_loops import file_of_closures

    head, _, _ = model_file.rpartition("#")
    own = locate(head if _is_urdf(head) else model_file, Path()) if model_file else None
    if own is None:
        return []
    try:
        table = (
            tomllib.loads(own.read_text(encoding="utf-8-sig")).get("urdf")
            if own.suffix == ".toml"
            else None
        )
    except (OSError, ValueError):  # it changed since it was read
        table = None
    text = table.get("file") if isinstance(table, dict) else None
    under = locate(text, own.parent) if isinstance(text, str) else None
    files = [own] if under is None else [own, under]
    beside = None if files[-1].suffix == ".toml" else file_of_closures(files[-1])
    return files if beside is None else [*files, beside]


def locate(text: str, folder: Path) -> Path | None:
    """The regular file with this path or package URL, or None."""
    try:
        path = _in_package(text) if text.startswith(PACKAGE) else folder / text
        return path if path is not None and path.is_file() else None
    except (OSError, ValueError):  # a name that no file can have
        return None


def _in_package(text: str) -> Path | None:
    """The first existing file for ``package://NAME/PATH``, or None."""
    name, _, rest = text.removeprefix(PACKAGE).partition("/")
    if not name or not rest or ".." in (name, *rest.split("/")):
        return None
    for folder in _shares(name):
        if (folder / name / rest).is_file():
            return folder / name / rest
    return None


def _shares(name: str) -> Iterator[Path]:
    """Folders in which the package is searched: those of ROS 1, ROS 2, and of installed Python
    packages.
    """
    for place in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
        yield Path(place)
        if Path(place).name == name:
            yield Path(place).parent
    for place in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield Path(place) / "share"
    yield Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix" / "share"
    yield Path(sys.prefix) / "share"


def plain_urdf(model: object, base: str | None, tip: str | None) -> tuple[Entry, str, str] | None:
    """A URDF file without an overlay: the overlay it needs, its name in messages, and the text to
    read it again.

    None if the model is not a URDF file.

    Raises
    ------
    ArgumentError
        The file or its ends are not given or do not exist.
    """
    if not isinstance(model, (str, Path)):
        return None
    text = str(model)
    file, mark, ends = text.rpartition("#")
    if not mark or not _is_urdf(file):
        file = text
        ends = ""
    if not _is_urdf(file):
        if base is not None or tip is not None:
            raise ArgumentError(
                f"base and tip: given with the model {text!r}, expected a .urdf file with them"
            )
        return None
    if ends:
        if base is not None or tip is not None:
            raise ArgumentError(f"base and tip: given in addition to {text!r}, expected each once")
        base, _, tip = ends.partition(":")
        path = locate(file, Path()) if ":" in tip else None
        if path is not None:
            from flexgen.model.urdf.urdf import Urdf

            base, tip = split_ends(ends, Urdf(path, from_here(path)).links)
    for what, name in (("base", base), ("tip", tip)):
        if not isinstance(name, (str, type(None))):
            raise ArgumentError(f"{what}: given {name!r}, expected the name of a link")
    path = locate(file, Path())
    if path is None:
        where = f" below {SEARCHED}" if file.startswith(PACKAGE) else ""
        raise ArgumentError(
            f"model: given {file!r}, which is not a file{where}, expected the path of a .urdf file"
        )
    if not base or not tip:
        from flexgen.model.urdf.urdf import Urdf

        urdf = Urdf(path, from_here(path))
        inner = {joint.parent for joint in urdf.joints.values()}
        first = ", ".join(show(name) for name in urdf.links if name not in urdf.parent_joint)
        last = ", ".join([show(name) for name in urdf.links if name not in inner][:12])
        raise ArgumentError(
            f"model: given {text!r}, a URDF file without the two ends of the robot in it, "
            f"expected {file}#BASE:TIP (or "
            f"base and tip in Python) with the names of two links, such as {first} and one of "
            f"{last}; or an overlay, a "
            '.toml file with [urdf], file = "...", base = "...", tip = "..."'
        )
    root = wrap({"urdf": {"file": file, "base": base, "tip": tip}}, 0, file)
    return root, file, f"{file}#{base}:{tip}"


def split_ends(ends: str, links: Collection[str]) -> tuple[str, str]:
    """The two links in ``BASE:TIP``, whose names may have colons."""
    words = ends.split(":")
    for k in range(1, len(words)):
        base = ":".join(words[:k])
        tip = ":".join(words[k:])
        if base in links and tip in links:
            return base, tip
    base, _, tip = ends.partition(":")
    return base, tip


def _is_urdf(text: str) -> bool:
    return text.endswith(".urdf") or text.startswith(PACKAGE)
