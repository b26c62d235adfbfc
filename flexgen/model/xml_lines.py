"""XML text to elements that know their lines; document types, entities and references to other files are refused."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import ParseError

from defusedxml import DefusedXmlException, DTDForbidden
from defusedxml.ElementTree import DefusedXMLParser

from flexgen.model.checked_table import show

DEPTH = 64  # levels of nesting; those of URDF are four


@dataclass
class Node:
    """An element of the XML file: its tag, attributes, line and children."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Node] = field(default_factory=list)


class _Tree:
    """Receives what the XML parser finds and keeps it with the lines."""

    def __init__(self) -> None:
        self.root: Node | None = None
        self.stack: list[Node] = []
        self.parser: Any = None

    def start(self, tag: str, attributes: dict[str, str]) -> None:
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
        """Text between the elements says nothing in URDF."""

    def close(self) -> Node | None:
        return self.root


class MarkupError(Exception):
    """The text is not read: what was given and expected, and the line."""

    def __init__(self, line: int, given: str, expected: str) -> None:
        self.line, self.given, self.expected = line, given, expected
        super().__init__(f"line {line}: given {given}, expected {expected}")


def parse(raw: bytes) -> Node:
    """Parse a URDF file's bytes into its outermost element.

    Raises
    ------
    MarkupError
        Where it is not XML, has a document type (in which entities would be declared), or is nested too deeply.
    """
    tree = _Tree()
    parser = DefusedXMLParser(target=tree, forbid_dtd=True, forbid_entities=True, forbid_external=True)
    tree.parser = parser.parser
    try:
        parser.feed(raw)
        root = parser.close()
    except DTDForbidden:
        line = tree.parser.CurrentLineNumber
        raise MarkupError(line, "a document type or entities", "a URDF file without <!DOCTYPE ...>") from None
    except DefusedXmlException:
        line = tree.parser.CurrentLineNumber
        raise MarkupError(line, "entities or references to other files", "a URDF file without them") from None
    except ParseError as error:
        reason = str(error).partition(": line ")[0]
        raise MarkupError(error.position[0], f"text that is not XML ({reason})", "a URDF file") from None
    except (ValueError, LookupError):  # an encoding that there is not, or that expat cannot use
        raise MarkupError(1, "an unknown encoding", "a URDF file in UTF-8") from None
    assert isinstance(root, Node)  # a document without an element is not XML
    return root
