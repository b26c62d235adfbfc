"""XML parser that keeps line numbers; document types, entities and references to other files raise
an error.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import ParseError

from defusedxml import DefusedXmlException, DTDForbidden
from defusedxml.ElementTree import DefusedXMLParser

from flexgen.base.spec.tables import show

DEPTH = 64  # levels of nesting; those of URDF are four
PREFIXES = 50  # that are declared in place of the file


@dataclass
class Node:
    """An element of the XML file: its tag, attributes, line and children."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Node] = field(default_factory=list)


class _Tree:
    """Builds the tree of elements with their lines from the events of the XML parser."""

    def __init__(self) -> None:
        self.root: Node | None = None
        self.stack: list[Node] = []
        self.parser: Any = None

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Add an element to the tree with its line; MarkupError for elements nested too deeply,
        and for those of xacro.
        """
        node = Node(tag, attributes, self.parser.CurrentLineNumber)
        if len(self.stack) == DEPTH:
            raise MarkupError(node.line, "elements nested too deeply", f"at most {DEPTH} levels")
        if "xacro" in tag:
            given = f"the element {show(tag.rpartition('}')[2])} of xacro"
            raise MarkupError(node.line, given, "a URDF file that xacro has expanded")
        if self.stack:
            self.stack[-1].children.append(node)
        else:
            self.root = node
        self.stack.append(node)

    def end(self, tag: str) -> None:
        self.stack.pop()

    def data(self, text: str) -> None:
        """Ignore text between elements: URDF has none."""

    def close(self) -> Node | None:
        return self.root


class MarkupError(Exception):
    """The text is not accepted: what was given and expected, and the line."""

    def __init__(self, line: int, given: str, expected: str) -> None:
        self.line = line
        self.given = given
        self.expected = expected
        super().__init__(f"line {line}: given {given}, expected {expected}")


def parse(raw: bytes) -> Node:
    """Parse the bytes of a URDF file into its root element.

    Two faults that other readers of URDF accept are accepted too: prefixes that are not declared,
    such as that of ``drake:acceleration``, and white space before ``<?xml``.

    Raises
    ------
    MarkupError
        The text is not XML, has a document type (which could declare entities), or is nested too
        deeply.
    """
    try:
        return _parse(raw)
    except MarkupError:
        mended = _declare_prefixes(_blank_declaration(raw))
        if mended == raw:
            raise
        try:
            return _parse(mended)
        except MarkupError:
            pass
        raise


def _blank_declaration(raw: bytes) -> bytes:
    """The text without an XML declaration that follows white space; its lines stay."""
    return re.sub(rb"\A(\s+)<\?xml[^<>]*\?>", rb"\1", raw)


def _declare_prefixes(raw: bytes) -> bytes:
    """The text with a declaration of all prefixes that it does not declare; its lines stay."""
    used = set(re.findall(rb"[<\s]([A-Za-z_][A-Za-z0-9_.-]*):[A-Za-z_]", raw))
    used -= {b"xml", b"xmlns", *re.findall(rb"xmlns:([A-Za-z_][A-Za-z0-9_.-]*)\s*=", raw)}
    names = sorted(used)[:PREFIXES]
    declared = b"".join(b' xmlns:%b="urn:undeclared"' % name for name in names)
    return re.sub(rb"<robot(?=[\s>/])", lambda found: found[0] + declared, raw, count=1)


def _parse(raw: bytes) -> Node:
    """Parse the bytes of an XML file."""
    tree = _Tree()
    parser = DefusedXMLParser(
        target=tree, forbid_dtd=True, forbid_entities=True, forbid_external=True
    )
    tree.parser = parser.parser
    try:
        parser.feed(raw)
        root = parser.close()
    except DTDForbidden:
        line = tree.parser.CurrentLineNumber
        raise MarkupError(
            line, "a document type or entities", "a URDF file without <!DOCTYPE ...>"
        ) from None
    except DefusedXmlException:
        line = tree.parser.CurrentLineNumber
        raise MarkupError(
            line, "entities or references to other files", "a URDF file without them"
        ) from None
    except ParseError as error:
        reason = str(error).partition(": line ")[0]
        raise MarkupError(
            error.position[0], f"text that is not XML ({reason})", "a URDF file"
        ) from None
    # an encoding that does not exist or that expat does not support
    except (ValueError, LookupError):
        raise MarkupError(1, "an unknown encoding", "a URDF file in UTF-8") from None
    assert isinstance(root, Node)  # a document without an element is not well-formed
    return root
