"""Parameters of public functions, read from the text of their modules: help appears without
importing them.
"""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from typing import Any

import flexgen
from flexgen.cli.verb_tables.verb_rows import Option, Verb

# Placeholder and type of the value of an option, by the annotation of its parameter.
KINDS = {
    "bool": ("", ""),
    "int": ("N", "integer"),
    "float": ("X", "number"),
    "str": ("TEXT", "text"),
    "str | Path": ("FILE", ""),
    "Sequence[float]": ("X ...", "numbers"),
    "Sequence[int]": ("N ...", "integers"),
    "Sequence[str]": ("NAME,NAME,...", "names"),
    "Trajectory | str | Path": ("TRAJECTORY", ""),
    "ServoRecord | str | Path": ("DATA", ""),
}
LEFT_OUT = ("model", "progress")  # read and given by the command line
FILES = [
    Option("out", "write the result to this file", "FILE"),
    Option("report", "write a self-contained HTML page to DIR", "DIR"),
]


@cache
def defaults_of(function: str) -> dict[str, Any]:
    """Parameters of a public function that have a default which is a number, a text or None, with
    that default.
    """
    module = _public()[function]
    return {
        arg.arg: _value(module, value)
        for arg, value in _parameters(_node(function))
        if value is not None
    }


def command_of(function: str) -> Verb:
    """The verb of a public function, from its parameters, their annotations and its docstring.

    A parameter with a default is an option, one without an argument; a first parameter ``model``
    is MODEL. A class of results as the return type gives ``--out`` and ``--report``.

    Raises
    ------
    ValueError
        A parameter without default has an annotation that is not in `KINDS`.
    """
    node = _node(function)
    docstring = ast.get_docstring(node) or ""
    defaults = defaults_of(function)
    names = [arg.arg for arg, _ in _parameters(node)]
    model = "none" if names[:1] != ["model"] else "optional" if "model" in defaults else "required"
    verb = Verb(
        function.replace("_", "-"),
        "",
        function,
        model,
        summary=" ".join(docstring.partition("\n\n")[0].split()),
    )
    for arg, value in _parameters(node):
        option = _option(arg, defaults.get(arg.arg), docstring, required=value is None)
        if arg.arg not in LEFT_OUT and option is not None:
            verb.sections.setdefault("arguments" if option.place else "settings", []).append(
                option
            )
        elif arg.arg not in LEFT_OUT and value is None:
            raise ValueError(
                f"{function}: parameter {arg.arg} cannot be given as a text, expected a row in "
                "verbs.py"
            )
    if ast.unparse(node.returns or ast.Constant(None)) in _public() and "out" not in names:
        verb.sections["files"] = FILES
    return verb


def _option(arg: ast.arg, default: Any, docstring: str, required: bool) -> Option | None:
    """The option of a parameter; None where a text cannot be its value."""
    parts = (
        ast.unparse(arg.annotation or ast.Constant(None)).replace("FilePath", "Path").split(" | ")
    )
    kind = " | ".join(part for part in parts if part != "None")
    found = re.search(
        rf"^{arg.arg} : (?P<type>.*)\n(?P<text>(?:    .*\n?)*)", docstring, re.MULTILINE
    )
    text = "" if found is None else " ".join(found["text"].replace("`", "").split()).rstrip(".")
    unit = re.search(r"\[.*\]", found["type"]) if found is not None else None
    text = f"{text[:1].lower()}{text[1:]}{f' {unit.group()}' if unit else ''}"
    text += (
        "; default: {default}" if isinstance(default, int | float | str) and kind != "bool" else ""
    )
    if kind.startswith("Literal["):
        return Option(
            arg.arg, text, "NAME", choices="/".join(ast.literal_eval(kind.removeprefix("Literal")))
        )
    if kind not in KINDS:
        return None
    off = "no_" * (default is True)
    return Option(off + arg.arg, f"{'not: ' * bool(off)}{text}", *KINDS[kind], place=required)


def _public() -> dict[str, str]:
    return dict(vars(flexgen)["_PUBLIC"])


def _node(function: str) -> ast.FunctionDef:
    """The definition of a public function."""
    body = _tree(_public()[function]).body
    return next(n for n in body if isinstance(n, ast.FunctionDef) and n.name == function)


def _parameters(node: ast.FunctionDef) -> list[tuple[ast.arg, ast.expr | None]]:
    """Parameters and their defaults."""
    places = [*node.args.posonlyargs, *node.args.args]
    values = [None] * (len(places) - len(node.args.defaults)) + node.args.defaults
    return [
        *zip(places, values, strict=True),
        *zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True),
    ]


@cache
def _tree(module: str) -> ast.Module:
    base = Path(flexgen.__file__).parent.joinpath(*module.split(".")[1:])
    file = base.with_suffix(".py")
    return ast.parse(
        (file if file.is_file() else base / "__init__.py").read_text(encoding="utf-8")
    )


def _value(module: str, node: ast.expr) -> Any:  # noqa: C901
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
