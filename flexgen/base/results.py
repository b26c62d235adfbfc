"""The protocol of public results: `content`, and from it `to_dict`, `to_text`, `report` and a
table in notebooks; `save`, `plot`.

What an upper room draws or writes for a class in its own way is a viewer: the function
``CLASS.plot``, ``CLASS.report``, ``CLASS.to_text`` or ``CLASS._repr_html_`` of the group
``results`` of `flexgen.base.registry`.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from flexgen.base import registry
from flexgen.base.checks.type_checks import checked_methods
from flexgen.base.display import as_json, plain, short_repr, short_text
from flexgen.base.errors import ArgumentError
from flexgen.base.rows import Data, Part, Prose, Row, data_of


@checked_methods
class Result:
    """Base of the public results."""

    __repr__ = short_repr

    @property
    def problem(self) -> str:
        """Why the result cannot be used, the failure of its command; empty where it can."""
        return ""

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON types, SI units; a number that is not finite is None."""
        if not self.has_content():
            return {name: plain(value) for name, value in self._entries().items()}
        return {name: plain(value) for name, value in data_of(self.content()).items()}

    def save(self, path: str | Path) -> Path:
        """Write the result to a file, completely or not at all.

        ``.json``: what `to_dict` returns. ``.npz``: the arrays, with the other entries as JSON
        text ``meta``. A result with a trajectory writes that to ``.npz``, ``.csv`` and ``.mat``.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError
            The name ends otherwise, or the file cannot be written.
        """
        target = Path(path)
        trajectory = getattr(self, "trajectory", None)
        if target.suffix == ".json":
            from flexgen.base.files.atomic_files import write_text

            return write_text(target, as_json(self.to_dict()) + "\n")
        if trajectory is not None:
            return Path((trajectory() if callable(trajectory) else trajectory).save(target))
        arrays = {
            name: value for name, value in self._entries().items() if hasattr(value, "tolist")
        }
        if target.suffix != ".npz" or not arrays:
            kinds = ".json or .npz" if arrays else ".json"
            raise ArgumentError(
                f"path: given {target.name!r}, expected a name that ends in {kinds}"
            )
        from flexgen.base.files import array_files

        rest = {
            name: plain(value) for name, value in self._entries().items() if name not in arrays
        }
        return array_files.save(target, type(self).__name__, arrays, rest)

    def plot(self, path: str | Path | None = None) -> Any:
        """The picture of the result.

        Parameters
        ----------
        path : str or Path, optional
            Also write the picture to this file, such as ``.png`` or ``.svg``.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it.

        Raises
        ------
        ArgumentError
            There is no picture of this class, or the file cannot be written.
        """
        draw = _viewer(type(self), "plot")
        if draw is None:
            raise ArgumentError(
                f"plot: given {type(self).__name__}, which has no picture, expected a result "
                "with one; its method report writes a page with its table"
            )
        figure = draw(self)
        if path is not None:
            registry.find_function("Result.picture")(figure, path)
        return figure

    def content(self) -> tuple[Part, ...]:
        """The content of the result, stated once: text, table of notebooks, page and JSON are
        made from it.

        Here: a row for each field. A class with a content of its own is printed with tables.
        """
        kept = self._entries().items()
        rows = [Row(name.replace("_", " "), short_text(value), "", name) for name, value in kept]
        return Prose(self.short_title(), is_title=True), *rows

    def to_text(self) -> str:
        """The result as text with tables, as the command line prints it."""
        own = _viewer(type(self), "to_text")
        if own is None and self.has_content():
            own = registry.find_function("Result.content_as_text")
        return str(self) if own is None else str(own(self))

    def report(self, folder: str | Path) -> Path:
        """Write a self-contained HTML page with tables and pictures to a folder.

        Returns
        -------
        Path
            The page.

        Raises
        ------
        ArgumentError
            The folder has files of another program under these names, or cannot be written.
        """
        return Path(_viewer(type(self), "report")(self, folder))

    def _repr_html_(self) -> str:
        """The figures of the result as a table, for notebooks."""
        own = _viewer(type(self), "_repr_html_")
        if own is not None:
            return str(own(self))
        return str(registry.find_function("Result.content_as_html")(self))

    @classmethod
    def has_content(cls) -> bool:
        """Whether the class states its content, not only its fields."""
        return cls.content is not Result.content

    def _data(self, *without: str) -> tuple[Data, ...]:
        """The fields but these, as entries of JSON."""
        return tuple(
            Data(name, value) for name, value in self._entries().items() if name not in without
        )

    def short_title(self) -> str:
        """The beginning of the short text without the name of the class."""
        kind = type(self).__name__
        text = repr(self)
        return (
            text[len(kind) + 2 :].rstrip(">").partition(": ")[0]
            if text.startswith(f"<{kind} ")
            else kind
        )

    def _entries(self) -> dict[str, Any]:
        """The fields of a data class, the entries of `to_dict` of others."""
        return (
            {field.name: getattr(self, field.name) for field in fields(self)}
            if is_dataclass(self)
            else self.to_dict()
        )


@checked_methods
class ArrayResult(Result):
    """A result that is a file of arrays of a kind, with the names of those that it must have.

    It has ``data()``, its arrays and other data, and ``from_data(arrays, meta)``.
    """

    KIND: ClassVar[str]
    ARRAYS: ClassVar[str]

    def save(self, path: str | Path) -> Path:
        """Write an npz file with all data, which `load` reads; ``.json``: what `to_dict`
        returns.
        """
        if Path(path).suffix == ".json":
            return super().save(path)
        from flexgen.base.files import array_files

        return array_files.save(path, self.KIND, *self.data())  # type: ignore[attr-defined]

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file of `save`; ArgumentError where it is none."""
        from flexgen.base.files import array_files

        return array_files.load_instance(cls, path, cls.KIND, cls.ARRAYS)


def _viewer(of: type, member: str) -> Any:
    """The function that is registered for a class or the nearest of its bases; None where there is
    none.
    """
    names = [f"{base.__name__}.{member}" for base in of.__mro__]
    found = next((name for name in names if name in registry.own_names("results")), None)
    return None if found is None else registry.find_function(found)
