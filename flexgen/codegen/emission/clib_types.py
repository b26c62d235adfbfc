"""The kinds of rows of `flexgen.codegen.emission.interface`: statuses, structs, and functions of
the hand-written C.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Status:
    """Status of an emitted function: its name and value in C, its meaning, and the exception that
    Python raises.
    """

    name: str
    code: int
    text: str
    # a class of flexgen.base.errors; none for success, and for warnings, whose codes are positive
    exception: str = ""


@dataclass(frozen=True)
class Limit:
    """A number that bounds an argument: in C the macro ``<LIBRARY>_<name>``."""

    name: str
    value: int
    doc: str


@dataclass(frozen=True)
class Enum:
    """An enumeration of the public header, in C ``<library>_<name>``; its members are numbered
    from 0.

    Parameters
    ----------
    name, doc : str
    members : tuple of (str, str)
        Name and meaning; in C ``<LIBRARY>_<NAME>_<MEMBER>``.
    """

    name: str
    doc: str
    members: tuple[tuple[str, str], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The members' names, at their numbers."""
        return tuple(name for name, _ in self.members)


@dataclass(frozen=True)
class Field:
    """A member of a struct, or an argument.

    Parameters
    ----------
    name : str
    kind : str
        Type in C: ``"real"``, ``"int"``, ``"int64_t"``, an enum of the table such as ``"hold"``,
        or a pointer to one of them or to a struct of the table, such as ``"const samples *"``.
    extents : tuple of str
        Sizes of the array that a pointer to reals points to: of the library (``"n_a"``), of other
        fields (``"n"``), or sums of these. Arrays are stored sample after sample: the last index
        runs fastest.
    unit, doc : str
    default : str
        Of a member of options, in C without the library's name; empty: the caller has to set it.
    """

    name: str
    kind: str
    extents: tuple[str, ...]
    unit: str
    doc: str
    default: str = ""

    @property
    def base(self) -> str:
        """The type without ``const`` and ``*``."""
        return self.kind.removeprefix("const ").removesuffix(" *")


@dataclass(frozen=True)
class Struct:
    """A struct of the public header, in C ``<library>_<name>``."""

    name: str
    doc: str
    fields: tuple[Field, ...]


@dataclass(frozen=True)
class CFunction:
    """A function of the hand-written C.

    Parameters
    ----------
    name : str
        In C ``<library>_<name>``.
    file : str
        The file of ``flexgen/codegen/clib/`` that defines it; empty: the source ``<library>.c``
        that is written.
    summary, notes : str
        For the header: one sentence; paragraphs.
    arguments : tuple of Field
    returns : str
        ``"status"``, ``"size"``: a number of reals, or a struct of the table.
    elastic : bool
        True: only for models with unactuated coordinates.
    parametrized : bool
        True: only for libraries with run-time parameters.
    double : bool
        True: only for libraries in double precision.
    part : str
        The optional part of the library that it belongs to; empty: it comes with every library.
    header : str
        The public header that declares it: ``"inversion"`` or ``"inverse_kinematics"``.
    """

    name: str
    file: str
    summary: str
    notes: str
    arguments: tuple[Field, ...]
    returns: str = "status"
    elastic: bool = False
    parametrized: bool = False
    double: bool = False
    part: str = ""
    header: str = "inversion"

    @property
    def signature(self) -> str:
        """Names and types in one line, for the digest of the interface."""
        return (
            f"{self.name}({','.join(f'{a.kind} {a.name}' for a in self.arguments)}){self.returns}"
        )


def signature_of(struct: Struct) -> str:
    """Names and types of the members in one line, for the digest of the interface."""
    return f"struct {struct.name}{{{','.join(f'{f.kind} {f.name}' for f in struct.fields)}}}"
