"""New model files that are written from an old one: relative paths, overlays, checks.

A model file names other files, those of sampled paths and its URDF file, relative to its own
folder. A new file in another folder gets the paths from there. A robot that was read from a URDF
file without an overlay gets an overlay.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.files.atomic_files import check_writable, temporary_folder, write_text
from flexgen.base.spec.tables import part_of
from flexgen.base.spec.toml_lines import Entry, Scanner, wrap
from flexgen.base.spec.toml_lines import Path as KeyPath
from flexgen.base.spec.toml_text import toml
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.model.urdf.urdf_source import PACKAGE

# Name of the keys whose values are paths: of the samples of a move, and of the URDF file of an
# overlay.
PATH_KEY = "file"


def text_of_model(model_file: str) -> tuple[str, Path]:
    """The text of a model file, and the folder from which its relative paths begin.

    Parameters
    ----------
    model_file : str
        As in `RobotModel.file`: the path of a ``.toml`` file, or ``FILE.urdf#BASE:TIP``, whose
        text is an overlay.

    Raises
    ------
    ArgumentError
        The model is not from a file.
    """
    urdf, mark, ends = model_file.rpartition("#")
    if mark and (urdf.endswith(".urdf") or urdf.startswith(PACKAGE)):
        base, _, tip = ends.partition(":")
        rows = [f"file = {toml(urdf)}", f"base = {toml(base)}", f"tip = {toml(tip)}"]
        return "\n".join(["[urdf]", *rows, ""]), Path()
    path = Path(model_file or "")
    if not model_file or path.suffix != ".toml" or not path.is_file():
        raise ArgumentError(
            f"model file: given a model of {model_file!r}, which is no .toml file, expected one "
            "that was read from a .toml or a .urdf file; the numbers are in the values of the "
            "result and in --json"
        )
    return path.read_text(encoding="utf-8"), path.parent


def with_overrides(model: RobotModel, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes of a new model file, after those that the model was read with.

    Parameters
    ----------
    model : RobotModel
        With the overrides of `flexgen.read`, which its file does not have.
    changes : mapping
        Dotted keys of the model file and their values.
    """
    new = _with_new_tables(model, changes)
    if model.not_measured and "not_measured" not in changes:
        new["not_measured"] = [name for name in model.not_measured if not _is_set(name, changes)]
    before = {key: value for key, value in model.overrides.items() if key not in new}
    return before | new


def _is_set(name: str, changes: Mapping[str, Any]) -> bool:
    """Whether a key of the changes has the number ``name``, such as q1.stiffness: dotted keys
    contain the owner of a number and end in its own name.
    """
    owner, _, number = name.partition(".")
    last = number.partition(".")[0]
    keys = (key.split(".") for key in changes)
    return any(owner in words and words[-1] == last for words in keys)


def _with_new_tables(model: RobotModel, changes: Mapping[str, Any]) -> dict[str, Any]:
    """The changes, those within a table that the model does not have as this table.

    A dotted key leads to tables that are there only: friction of a motor without any is
    ``motor.m1.friction = {viscous = 0.1}``.
    """
    if not model.text:
        return dict(changes)
    root = wrap(json.loads(model.text))
    found: dict[str, Any] = {}
    for dotted, value in changes.items():
        words = dotted.split(".")
        there = _depth(root, words)
        if there >= len(words) - 1:
            found[dotted] = value
            continue
        table = found.setdefault(".".join(words[: there + 1]), {})
        for word in words[there + 1 : -1]:
            table = table.setdefault(word, {})
        table[words[-1]] = value
    return found


def _depth(root: Entry, words: Sequence[str]) -> int:
    """Number of words of a dotted key that lead to a part of the file, from the first one on."""
    here = root
    for depth, word in enumerate(words):
        key, _ = part_of(here, word)
        if key is None:
            return depth
        here = here.value[key]
    return len(words)


def relocate(text: str, old: Path, new: Path) -> str:
    """The text of a model file with its relative paths from another folder.

    Parameters
    ----------
    text : str
        With paths relative to the folder ``old``.
    old, new : Path
        Folders; ``new`` may be missing still.
    """
    here = os.path.realpath(old)
    there = os.path.realpath(new)
    if here == there:
        return text
    text = text.replace("\r\n", "\n")
    data = tomllib.loads(text)
    spans = Scanner(text).spans
    for path, (start, end) in sorted(spans.items(), key=lambda item: item[1], reverse=True):
        value = _value(data, path)
        if not (isinstance(value, str) and _is_path(path, value)):
            continue
        text = text[:start] + toml(_from_folder(os.path.join(here, value), there)) + text[end:]
    return text


def _value(data: object, path: KeyPath) -> object:
    for key in path:
        data = data[key]  # type: ignore[index]
    return data


def _is_path(path: KeyPath, value: str) -> bool:
    """Whether a text of a model file is a relative path; in variants the key is a dotted one."""
    of_path = str(path[-1]).rpartition(".")[2] == PATH_KEY
    outer = str(path[0])
    known = outer in ("move", "urdf", "program", "variant")
    return of_path and known and not value.startswith(PACKAGE) and not os.path.isabs(value)


def _from_folder(path: str, folder: str) -> str:
    """A path relative to a folder; absolute where none leads there, as between disks."""
    try:
        relative = os.path.relpath(path, folder)
    except ValueError:
        return os.path.normpath(path)
    return Path(relative).as_posix()


def write_model_text(
    path: str | Path,
    text: str,
    folder: Path,
    variant: str | None = None,
    check: Callable[[RobotModel], None] | None = None,
    dry: bool = False,
) -> Path:
    """Write the text of a model file, if it can be read again.

    Parameters
    ----------
    path : str or Path
    text : str
        With paths relative to ``folder``; those of the file are relative to its own folder.
    folder : Path
    variant : str, optional
        That is read.
    check : callable, optional
        Of the model that was read; raises an error where it is not the right one.
    dry : bool
        Write nothing: everything that can refuse to be written is checked.

    Raises
    ------
    ArgumentError
        The name does not end in ``.toml``, or the file cannot be written.
    ModelError
        The text is not that of a model.
    """
    target = Path(path)
    if target.suffix != ".toml":
        raise ArgumentError(f"path: given {str(path)!r}, expected a name that ends in .toml")
    with temporary_folder() as inner:  # what cannot be read again is not written
        draft = write_text(inner / "model.toml", relocate(text, folder, inner))
        try:
            again = read(draft, variant)
        except ModelError as error:
            if error.file != str(draft):
                raise
            # The user knows the file that was asked for, not the draft.
            reason = (error.key, error.given, error.expected)
            raise ModelError(str(target), error.line, *reason) from None
    if check is not None:
        check(again)
    if dry:
        check_writable(target)
        return target
    return write_text(target, relocate(text, folder, target.parent))
