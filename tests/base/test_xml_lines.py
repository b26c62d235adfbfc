"""XML texts as elements with their lines, and the texts that are refused."""

from __future__ import annotations

import pytest

from flexgen.base.spec import xml_lines


def test_elements_of_a_file_have_their_lines() -> None:
    root = xml_lines.parse(
        b'<robot name="r">\n <link a="1"/>\n\n <joint>\n  <axis\n   xyz="0"/></joint>text</robot>'
    )
    assert (root.tag, root.attributes, root.line) == ("robot", {"name": "r"}, 1)
    assert [(x.tag, x.line, x.attributes) for x in root.children] == [
        ("link", 2, {"a": "1"}),
        ("joint", 4, {}),
    ]
    assert [(x.tag, x.line, x.children) for x in root.children[1].children] == [("axis", 5, [])]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            b"<a>" * 65 + b"</a>" * 65,
            "line 1: given elements nested too deeply, expected at most 64 levels",
        ),
        (
            b"<a xmlns:x='http://xacro'>\n<x:if/></a>",
            (
                'line 2: given the element "if" of xacro, expected a URDF file that xacro has '
                "expanded"
            ),
        ),
        (
            b'<?xml version="1.0"?>\n<!DOCTYPE a>\n<a/>',
            (
                "line 2: given a document type or entities, expected a URDF file without "
                "<!DOCTYPE ...>"
            ),
        ),
        (
            b"<a>\n<b>\n</a>",
            "line 3: given text that is not XML (mismatched tag), expected a URDF file",
        ),
        (
            b'<?xml version="1.0" encoding="none"?><a/>',
            "line 1: given an unknown encoding, expected a URDF file in UTF-8",
        ),
    ],
)
def test_texts_that_are_refused_as_a_urdf_file(text: bytes, said: str) -> None:
    with pytest.raises(xml_lines.MarkupError) as refused:
        xml_lines.parse(text)
    assert str(refused.value) == said


def test_a_file_may_have_sixty_four_levels() -> None:
    node = xml_lines.parse(b"<a>" * 64 + b"</a>" * 64)
    depth = 1
    while node.children:
        (node,) = node.children
        depth = depth + 1
    assert depth == 64
