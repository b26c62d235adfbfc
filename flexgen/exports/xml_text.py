"""Numbers and elements of XML files: every number with all its digits, every name escaped."""

from __future__ import annotations

import math
from collections.abc import Iterable
from xml.etree import ElementTree

import numpy as np


def numbers(values: float | Iterable[float] | np.ndarray) -> str:
    """Numbers that are read back without loss; whole numbers without a decimal point."""
    out = []
    for value in np.ravel(np.asarray(values, dtype=float)).tolist():
        whole = math.isfinite(value) and value == int(value) and abs(value) < 1e15
        out.append(str(int(value)) if whole else repr(value))
    return " ".join(out)


def add(
    parent: ElementTree.Element, tag: str, **attributes: str | float | Iterable[float] | np.ndarray
) -> ElementTree.Element:
    """Append an element; a trailing underscore of a keyword is dropped (``class_``)."""
    texts = {key.rstrip("_"): value if isinstance(value, str) else numbers(value) for key, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def document(root: ElementTree.Element) -> str:
    """The text of a file."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
