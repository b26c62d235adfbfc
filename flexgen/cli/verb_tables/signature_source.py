"""Signatures of public functions, read from the text of their modules: help appears without
importing them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import flexgen


class Parameter(NamedTuple):
    """A parameter of a public function.

    Attributes
    ----------
    annotation : ast.expr or None
    default : ast.expr or None
        None where it must be given.
    unit : str
        As ``[s]``, of its line in the docstring; empty where that has none.
    text : str
        Its description in the docstring, on one line.
    """

    annotation: ast.expr | None
    default: ast.expr | None
    unit: str
    text: str


@dataclass(frozen=True)
class Signature:
    """The signature of a public function.

    Attributes
    ----------
    module : str
        In which the names of its annotations have their meaning.
    summary : str
        First paragraph of the docstring.
    returns : str
        Annotation of the result.
    parameters : dict of Parameter
        In their order.
    """

    module: str
    summary: str
    returns: str
    parameters: dict[str, Parameter]


@cache
def signature_of(function: str) -> Signature:
    """The signature of a public function."""
    module = public_names()[function]
    node = next(
        statement
        for statement in _tree(module).body
        if isinstance(statement, ast.FunctionDef) and statement.name == function
    )
    docstring = ast.get_docstring(node) or ""
    described = _read_descriptions(docstring)
    places = [*node.args.posonlyargs, *node.args.args]
    defaults = [None] * (len(places) - len(node.args.defaults)) + node.args.defaults
    pairs = [
        *zip(places, defaults, strict=True),
        *zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True),
    ]
    return Signature(
        module,
        " ".join(docstring.partition("\n\n")[0].split()),
        ast.unparse(node.returns or ast.Constant(None)),
        {
            arg.arg: Parameter(arg.annotation, default, *described.get(arg.arg, ("", "")))
            for arg, default in pairs
        },
    )


@cache
def defaults_of(function: str) -> dict[str, Any]:
    """Parameters of a public function that have a default which is a number, a text or None, with
    that default.
    """
    signature = signature_of(function)
    return {
        name: constant(signature.module, parameter.default)
        for name, parameter in signature.parameters.items()
        if parameter.default is not None
    }


def public_names() -> dict[str, str]:
    """The modules of the public names."""
    return dict(vars(flexgen)["_PUBLIC"])


def constant(module: str, node: ast.expr) -> Any:
    """The value of a literal, or of a constant of a module; None where it is neither."""
    if isinstance(node, ast.Name):
        place = definition(module, node)
        return None if place is None else constant(*place)
    try:
        return ast.literal_eval(node)
    except ValueError:
        return None


def definition(module: str, node: ast.expr) -> tuple[str, ast.expr] | None:
    """The expression of a name of a module, and the module that defines it; None
    where flexgen does not define it by an assignment.
    """
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        source = _find_import(module, node.value.id)
        return None if source is None else definition(".".join(source), ast.Name(node.attr))
    if not isinstance(node, ast.Name):
        return None
    source = _find_import(module, node.id)
    if source is not None:
        return definition(source[0], ast.Name(source[1]))
    return _find_assignment(module, node.id)


def _find_import(module: str, name: str) -> tuple[str, str] | None:
    """Module of flexgen and name of what another module imports under a name."""
    for statement in _statements(module):
        if not isinstance(statement, ast.ImportFrom):
            continue
        for alias in statement.names:
            if (alias.asname or alias.name) == name and _is_own(statement.module):
                return str(statement.module), alias.name
    return None


def _find_assignment(module: str, name: str) -> tuple[str, ast.expr] | None:
    """The value that a module assigns to a name, and the module."""
    for statement in _statements(module):
        for target, value in _assignments(statement):
            if isinstance(target, ast.Name) and target.id == name:
                return module, value
    return None


def _assignments(statement: ast.stmt) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Targets of an assignment and their values; those of a tuple one by one."""
    if isinstance(statement, ast.AnnAssign) and statement.value is not None:
        yield statement.target, statement.value
    if not isinstance(statement, ast.Assign):
        return
    for target in statement.targets:
        if isinstance(target, ast.Tuple) and isinstance(statement.value, ast.Tuple):
            yield from zip(target.elts, statement.value.elts, strict=True)
        else:
            yield target, statement.value


def _is_own(module: str | None) -> bool:
    """Whether a module has a text that can be read here."""
    return bool(module) and _file(str(module)) is not None


def _file(module: str) -> Path | None:
    """The file of a module of flexgen; None for modules of other packages."""
    first, *rest = module.split(".")
    if first != "flexgen":
        return None
    base = Path(flexgen.__file__).parent.joinpath(*rest)
    files = (base.with_suffix(".py"), base / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _statements(module: str) -> Iterator[ast.stmt]:
    """Statements of a module, also those for type checkers only."""
    for statement in _tree(module).body:
        if isinstance(statement, ast.If):
            yield from statement.body
        yield statement


@cache
def _tree(module: str) -> ast.Module:
    """Syntax tree of a module of flexgen, which is not imported: the command line stays quick."""
    file = _file(module)
    assert file is not None
    return ast.parse(file.read_text(encoding="utf-8"))


_ENTRY = re.compile(
    r"^(?P<names>\w+(?:, \w+)*)(?: : (?P<type>.*))?\n(?P<text>(?:(?:    .*)?\n?)*?)(?=^\S|\Z)",
    re.MULTILINE,
)


def _read_descriptions(docstring: str) -> dict[str, tuple[str, str]]:
    """Unit and description of each parameter in a docstring of numpydoc."""
    section = docstring.partition("Parameters\n----------\n")[2]
    section = re.split(r"^[A-Z]\w+\n-{3,}\n", section, maxsplit=1, flags=re.MULTILINE)[0]
    found = {}
    for entry in _ENTRY.finditer(section):
        unit = re.search(r"\[.*\]", entry["type"] or "")
        text = " ".join(entry["text"].split())
        for name in entry["names"].split(", "):
            found[name] = ("" if unit is None else unit.group(), text)
    return found
