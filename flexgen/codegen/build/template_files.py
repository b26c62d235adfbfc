"""Template files of exports with names put in.

A template is a real file of its language in which ``model_`` and ``MODEL_`` are replaced by the
name of the library, as in ``flexgen/codegen/clib/``, and words in capitals between two @ for a
text. What is put in must be safe where it stands: an identifier, a number, or a text that
`flexgen.codegen.emission.c_text.quote`, `xml_text` or `yaml_text` has escaped.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping
from importlib.resources import files
from xml.sax.saxutils import escape

from flexgen.base.errors import BuildError
from flexgen.codegen.emission.clib_files import render

_WORD = re.compile(r"@([A-Z][A-Z0-9_]*)@")


def template(
    package: str,
    file: str,
    name: str,
    words: Mapping[str, str] | None = None,
    names: Mapping[str, str] | None = None,
    parts: Collection[str] = (),
) -> str:
    """The text of a template.

    Parameters
    ----------
    package : str
        The package that holds the file.
    file : str
    name : str
        Of the library: an identifier of C.
    words : mapping of str to str
        Text for each word; every word of the template is needed.
    names : mapping of str to str
        Further names of the template, and their replacements. They are found before anything is
        put in: the library may have such a name.
    parts : collection of str
        As of `flexgen.codegen.emission.clib_files.render`.

    Raises
    ------
    BuildError
        The file is missing: flexgen is not installed completely.
    """
    path = files(package).joinpath(file)
    try:
        text = path.read_text(encoding="ascii")
    except OSError:
        raise BuildError(
            f"{path}: given no such file, expected a template of flexgen; install flexgen again"
        ) from None
    given = dict(words or {})
    for k, (own, chosen) in enumerate((names or {}).items()):
        text = text.replace(own, f"@NAME{k}@")
        given[f"NAME{k}"] = chosen
    return _WORD.sub(lambda found: given[found[1]], render(text, name, parts=parts))


def xml_text(text: str) -> str:
    """A text for the content of an element, or for an attribute in double quotes; what is not
    ASCII as a reference.

    Control characters, which XML does not allow, become spaces.
    """
    clean = "".join(c if c.isprintable() or c == "\n" else " " for c in text)
    return escape(clean, {'"': "&quot;"}).encode("ascii", "xmlcharrefreplace").decode("ascii")


def yaml_text(text: str) -> str:
    """A string of YAML in double quotes, in ASCII."""
    quoted = json.dumps(text, ensure_ascii=False)
    return "".join(c if " " <= c <= "~" else _escape(ord(c)) for c in quoted)


def _escape(code: int) -> str:
    """A character of a string of YAML by its number."""
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
