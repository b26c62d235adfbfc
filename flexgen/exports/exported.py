"""Result of an export: one class for all kinds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.base.calls.deprecation import warn_of_old
from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import short_repr
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Table
from flexgen.model.elements import RobotModel


@checked_result
@dataclass(frozen=True)
class Exported(Result):
    """Result of an export; accepted wherever a path is, as its `path`.

    Parameters
    ----------
    kind : str
        ``"fmu"``, ``"mujoco"``, ``"ros2"`` and so on.
    model : str
        Its name.
    path : Path
        The main file, or the folder of an export that is a folder.
    files : tuple of Path
        All files: of a folder in the order of their names, else the main file first.
    variant : str
        Of the model.
    contents : tuple of str
        What is in each file; empty for a folder.
    notes : tuple of str
        What a user must know of the files: what was left out, what is still to be set.
    details : mapping
        Of an FMU: ``block``, ``version`` (of FMI), ``token``, ``binary`` (its platform, or None),
        ``variables`` and ``seconds``. Of an MJCF file: ``friction``. Of a URDF file: ``overlay``.

    Examples
    --------
    >>> written = flexgen.export_mujoco("elbow", "elbow.xml")
    >>> print(written)
    elbow.xml
    >>> written.to_dict()["friction"]
    'exact'
    """

    kind: str
    model: str
    path: Path
    files: tuple[Path, ...]
    variant: str = ""
    contents: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict, hash=False)

    __repr__ = short_repr

    def __str__(self) -> str:
        return str(self.path)

    def __fspath__(self) -> str:
        return str(self.path)

    @property
    def directory(self) -> Path:
        """The folder of the files."""
        return self.path if self.path.is_dir() else self.path.parent

    def content(self) -> tuple[Part, ...]:
        """The files and what is in them, then the notes."""
        contents = self.contents or ("",) * len(self.files)
        cells = tuple(zip(map(str, self.files), contents, strict=True))
        return (
            Prose(f"{self.model}, {self.kind}", is_title=True),
            Table((Column("file"), Column("content")), cells, "Files"),
            *(Prose(f"note: {note}", "notes") for note in self.notes),
            *self._data("details"),
            Data("directory", str(self.directory)),
            *(Data(name, value) for name, value in self.details.items()),
        )

    def summary(self) -> str:
        """The files and what is in them, then the notes, a line each."""
        files = [f"wrote {path}" for path in self.files]
        if self.contents:
            files = [f"{line}: {what}" for line, what in zip(files, self.contents, strict=True)]
        return "\n".join([*files, *(f"note: {note}" for note in self.notes)])

    # results of version 0.2: a path (mujoco), two paths (urdf), an object of its own (fmu)
    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            old = self.model + f"_{self.variant}" * bool(self.variant)
            new = "model"
            if name in self.details:
                old = self.details[name]
                new = f"details[{name!r}]"
            elif self.kind == "mujoco" and hasattr(self.path, name):
                old = getattr(self.path, name)
                new = f"path.{name}"
            elif name != "name":
                raise AttributeError(f"Exported has no attribute {name!r}")
            warn_of_old(
                f"result of export_{self.kind}: given .{name}, expected its new place, .{new}"
            )
            return old

        def __getitem__(self, index: Any) -> Any:
            if self.kind != "urdf":
                raise TypeError(
                    f"the result of export_{self.kind} is not a sequence; its files are .files"
                )
            warn_of_old(
                "result of export_urdf: given a pair of paths, expected .files, the URDF file "
                "and the overlay"
            )
            return self.files[index]


def exported(
    model: RobotModel, kind: str, files: tuple[Path, ...], contents: tuple[str, ...], **more: Any
) -> Exported:
    """The result of an export of files, the main one first."""
    return Exported(kind, model.name, files[0], files, model.variant, contents, **more)


def left_out(model: RobotModel) -> tuple[str, ...]:
    """A note that names the parts of a model which a file of its bodies, springs and motors does
    not have.
    """
    parts = {"sensor": model.sensors, "servo": model.servo}
    parts["encoder_error"] = any(motor.encoder_error is not None for motor in model.motors)
    names = [name for name, there in parts.items() if there]
    return (f"not in the file: {', '.join(names)}",) if names else ()
