"""Defaults of public functions, read from the text of their modules, so that help appears without importing them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import Any

import flexgen


@cache
def defaults_of(function: str) -> dict[str, Any]:
    """Parameters of a public function that have a default which is a number, a text or None, with that default."""
    module = vars(flexgen)["_PUBLIC"][function]
    (node,) = (n for n in _tree(module).body if isinstance(n, ast.FunctionDef) and n.name == function)
    places = [*node.args.posonlyargs, *node.args.args]
    pairs = [*zip(places[len(places) - len(node.args.defaults) :], node.args.defaults, strict=True)]
    pairs += [(arg, value) for arg, value in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True) if value]
    return {arg.arg: _value(module, value) for arg, value in pairs}


@cache
def _tree(module: str) -> ast.Module:
    base = Path(flexgen.__file__).parent.joinpath(*module.split(".")[1:])
    file = base.with_suffix(".py")
    return ast.parse((file if file.is_file() else base / "__init__.py").read_text(encoding="utf-8"))


def _value(module: str, node: ast.expr) -> Any:
    """The value of a literal, or of a constant of a module; None where it is neither."""
    if not isinstance(node, ast.Name):
        try:
            return ast.literal_eval(node)
        except ValueError:
            return None
    for statement in _tree(module).body:
        if isinstance(statement, ast.ImportFrom):
            for alias in statement.names:
                if (alias.asname or alias.name) == node.id:
                    return _value(str(statement.module), ast.Name(alias.name))
        elif isinstance(statement, ast.Assign):
            for target in statement.targets:
                if isinstance(target, ast.Name) and target.id == node.id:
                    return _value(module, statement.value)
                if isinstance(target, ast.Tuple) and isinstance(statement.value, ast.Tuple):
                    for name, value in zip(target.elts, statement.value.elts, strict=True):
                        if isinstance(name, ast.Name) and name.id == node.id:
                            return _value(module, value)
    return None
