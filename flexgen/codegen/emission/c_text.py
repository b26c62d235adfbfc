"""Pieces of C text that the emitted files share: comments, texts, macros, prototypes; safe
whatever they are given.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from flexgen.base.spec.ports import Port
from flexgen.codegen.emission.spec import FunctionSpec, LibrarySpec

WIDTH = 99  # characters of a line of C, at most, where it can be broken; as in .clang-format


def comment(text: str, indent: str = " * ") -> str:
    """Lines of a block comment; whatever could end or nest one is taken apart."""
    clean = "".join(c if c.isascii() and c.isprintable() else " " for c in text)
    clean = clean.replace("\\", "/").replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
    hanging = " " * (2 * (len(clean) - len(clean.lstrip())))
    return "".join(
        f"{indent}{line}".rstrip() + "\n"
        for line in textwrap.wrap(clean, WIDTH - len(indent), subsequent_indent=hanging) or [""]
    )


def quote(text: str) -> str:
    """A C string literal; whatever is not plain is written in octal."""
    plain = (
        chr(b)
        if (chr(b).isascii() and chr(b).isalnum()) or chr(b) in " .,:;/^_()*-+"
        else f"\\{b:03o}"
        for b in text.encode()
    )
    return f'"{"".join(plain)}"'


def macro(spec: LibrarySpec, name: str) -> str:
    """A macro of the library: ``<NAME>_<name>`` in capitals."""
    return f"{spec.name}_{name}".upper()


def size_macro(spec: LibrarySpec, extent: str) -> str:
    """A size in C: the macro ``<NAME>_NA`` for ``n_a``, digits as they are."""
    return macro(spec, extent.replace("_", "")) if extent in spec.sizes else extent


def count_of(spec: LibrarySpec, f: FunctionSpec, port: Port) -> str:
    """Number of entries of a port, in C."""
    return " * ".join(size_macro(spec, extent) for extent in f.extents[port.name])


def declaration(text: str) -> str:
    """A prototype or a call, broken into lines between its arguments where it is long."""
    indent = " " * (len(text) - len(text.lstrip()) + 4)
    glued = text.replace(" ", "\0").replace(",\0", ", ")
    lines = textwrap.wrap(
        glued,
        WIDTH - len(" {"),
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(lines).replace("\0", " ")


def prototype(spec: LibrarySpec, f: FunctionSpec, work: int) -> str:
    """The head of the function that evaluates one point; the last argument is a workspace where it
    needs any.
    """
    real = f"{spec.name}_real"
    arguments = [f"const {real} {p.name}[{count_of(spec, f, p)}]" for p in f.inputs]
    arguments += [f"{real} {p.name}[{count_of(spec, f, p)}]" for p in f.outputs]
    arguments += [f"{real} *work"] * (work > 0)
    return declaration(f"{spec.name}_status {spec.name}_{f.name}({', '.join(arguments)})")


def batch_prototype(spec: LibrarySpec, f: FunctionSpec, strided: bool = False) -> str:
    """The head of the C function that evaluates n points; ``strided``: arrays may hold more points
    than are evaluated, entries are then ``stride`` apart.
    """
    name = f"{spec.name}_{f.name}_batch{'_strided' * strided}"
    real = f"{spec.name}_real"
    arguments = [f"const {real} *{p.name}" for p in f.inputs] + [
        f"{real} *{p.name}" for p in f.outputs
    ]
    counts = ["int n", *(["int stride"] if strided else [])]
    return declaration(
        f"{spec.name}_status {name}({', '.join([*counts, *arguments, f'{real} *work'])})"
    )


def port_table(f: FunctionSpec) -> str:
    """The column of shapes and units of a function's arrays, as comment lines."""
    rows = []
    for kind, ports in (("in", f.inputs), ("out", f.outputs)):
        rows += [
            (kind, p.name, " x ".join(f.extents[p.name]), f"[{p.unit}]", p.doc) for p in ports
        ]
    width = [max(len(row[i]) for row in rows) for i in range(4)]
    return "".join(
        comment(" ".join(x.ljust(w) for x, w in zip(row, [*width, 0], strict=True)), " *   ")
        for row in rows
    )


def number_names(names: Iterable[str], units: Iterable[str]) -> str:
    """A list of names and units, numbered from 0."""
    return ", ".join(
        f"{i} {name} [{unit}]" for i, (name, unit) in enumerate(zip(names, units, strict=True))
    )
