"""Numbers and elements of XML files: every number with all its digits, every name escaped."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

import numpy as np

from flexgen.base.spec.toml_text import exact


def numbers(values: float | Iterable[float] | np.ndarray) -> str:
    """Numbers that are read back without loss; whole numbers without a decimal point."""
    return " ".join(map(exact, np.ravel(np.asarray(values, dtype=float)).tolist()))


def add(
    parent: ElementTree.Element, tag: str, **attributes: str | float | Iterable[float] | np.ndarray
) -> ElementTree.Element:
    """Append an element; a trailing underscore of a keyword is dropped (``class_``)."""
    texts = {
        key.rstrip("_"): value if isinstance(value, str) else numbers(value)
        for key, value in attributes.items()
    }
    return ElementTree.SubElement(parent, tag, texts)


def document(root: ElementTree.Element) -> str:
    """The text of a file."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
